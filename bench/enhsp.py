"""Numeric tasks solved by this project and by ENHSP, an independent planner for numbers: equal costs, and times.

    python bench/enhsp.py [NAME...] [--drawn 24] [--seconds 60] [--record FILE]

ENHSP (the package up-enhsp, which needs Java) searches with `opt-hrmax`, an optimal A*. The tasks are those of
`domains/stock`, the numeric cases of `tests/test_cases_numbers.py`, tasks that `tests/random_numeric.py` draws, and,
where the environment variable NUMERIC_PDDL names a folder with a folder for each pair (`domain.pddl` and `p.pddl`),
those without durations. Each runs in a process of its own, from the files to an optimal plan. Times are processor
seconds of the whole process, Python's and Java's start included. Costs that differ are printed, and the exit code is 1.
Without Java or the package the script says so and does nothing.

ENHSP reads its plan's cost from the metric; without a metric each action costs 1. A function without an initial value
makes an effect that reads it impossible here; ENHSP may see that otherwise, so that such tasks are left out.
"""

from __future__ import annotations

import importlib.util
import json
import os
import re
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
from tables import Columns, cell, record_option, write_record

ROOT = Path(__file__).resolve().parent.parent
STOCK = ROOT / "domains" / "stock"

COLUMNS: Columns = {
    "task": cell("task"),
    "outcome": cell("outcome"),
    "cost": cell("cost"),
    "kitassist, s": lambda row: "" if row["own"] is None else f"{row['own']:.2f}",
    "ENHSP, s": lambda row: "" if row["other"] is None else f"{row['other']:.2f}",
}


def jar() -> Path | None:
    """Return ENHSP's program; None where the package or Java is missing."""
    found = importlib.util.find_spec("up_enhsp")
    if found is None or found.origin is None or shutil.which("java") is None:
        return None
    return Path(found.origin).parent / "ENHSP" / "enhsp.jar"


def tasks(folder: Path, drawn: int) -> Iterator[tuple[str, Path, Path]]:
    """Yield names, domain files and problem files; those that are generated are written into the folder."""
    for problem in sorted(STOCK.glob("*.pddl")):
        if problem.stem != "domain":
            yield f"stock/{problem.stem}", STOCK / "domain.pddl", problem
    sys.path.insert(0, str(ROOT / "tests"))
    import random_numeric
    from test_cases_numbers import CASES

    for name, case in CASES.items():
        if not case.said and "durative" not in case.domain:
            texts = [f"(define (domain d) {case.domain})", f"(define (problem p) (:domain d) {case.problem})"]
            yield f"case: {name}", *_written(folder / name.replace(" ", "-"), *texts)
    seed = count = 0
    while count < drawn:
        texts_of = random_numeric.draw(seed)
        seed += 1
        if "durative" in texts_of.domain or "(u" in texts_of.domain or "total-time" in texts_of.problem:
            continue
        count += 1
        yield f"drawn: {seed - 1}", *_written(folder / f"drawn-{seed}", texts_of.domain, texts_of.problem)
    if place := os.environ.get("NUMERIC_PDDL"):
        for problem in sorted(Path(place).glob("*/p.pddl")):
            domain = problem.parent / "domain.pddl"
            text = domain.read_text(encoding="utf-8", errors="replace")
            if ":durative-action" not in text and re.search(r"\b(increase|decrease|assign)\b", text):
                yield f"public: {problem.parent.name}", domain, problem


def _written(folder: Path, domain: str, problem: str) -> tuple[Path, Path]:
    folder.mkdir()
    files = folder / "domain.pddl", folder / "p.pddl"
    for file, text in zip(files, (domain, problem), strict=True):
        file.write_text(text, encoding="utf-8")
    return files


def timed(command: list[str], seconds: float) -> tuple[str, float]:
    """Return the output of a process, "limit" if it does not end in time, and its processor time in seconds."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    try:
        said = subprocess.run(command, capture_output=True, text=True, timeout=seconds, check=False).stdout
    except subprocess.TimeoutExpired:
        said = "limit"
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return said, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def ours(domain: Path, problem: Path) -> str:
    """Return this project's answer, in this process: a cost, "no plan", or a refusal."""
    from planner import PDDLError, astar, load

    try:
        cost, plan = astar(load(problem, domain))
    except PDDLError as error:
        return f"refused: {error.message}"
    return "no plan" if plan is None else f"{cost:.9g}"


def theirs(said: str) -> str:
    """Return ENHSP's answer by its output."""
    if found := re.search(r"Metric \(Search\):\s*([-\d.E]+)", said):
        return f"{float(found[1]):.9g}"
    if re.search(r"unsolvable|Problem is not solvable|No plan|unreachable", said, re.I):
        return "no plan"
    return "limit" if said == "limit" else "refused"


def compared(name: str, domain: Path, problem: Path, program: Path, seconds: float) -> dict[str, Any]:
    """Return both answers to a task, and how they compare."""
    command = [sys.executable, __file__, "--one", str(domain), str(problem)]
    said, own = timed(command, seconds)
    mine = "limit" if said == "limit" else json.loads(said)
    output, other = timed(
        ["java", "-jar", str(program), "-o", str(domain), "-f", str(problem), "-planner", "opt-hrmax"], seconds
    )
    their = theirs(output)
    answers = (mine, their)
    if not any(each == "limit" or each.startswith("refused") for each in answers):
        same = mine == their or ("no plan" not in answers and abs(float(mine) - float(their)) < 1e-6)
        outcome = "equal" if same else f"DIFFERENT: ENHSP {their}"
    else:
        outcome = ", ".join(
            f"{who}: {each.partition(':')[0]}" for who, each in (("kitassist", mine), ("ENHSP", their))
            if each == "limit" or each.startswith("refused")
        )  # fmt: skip
    return {"task": name, "outcome": outcome, "cost": mine.partition(":")[0], "own": own, "other": other}


@click.command()
@click.argument("names", nargs=-1)
@click.option("--drawn", default=24, show_default=True, help="Number of tasks that are drawn.")
@click.option("--seconds", default=60.0, show_default=True, help="Limit of each search.")
@click.option("--one", type=click.Path(path_type=Path), nargs=2, hidden=True)
@record_option
def main(
    names: tuple[str, ...], drawn: int, seconds: float, one: tuple[Path, Path] | None, record: Path | None
) -> None:
    """Compare costs and times with ENHSP."""
    if one is not None:
        print(json.dumps(ours(*one)))
        return
    program = jar()
    if program is None:
        print("ENHSP is not compared: it needs Java, and the package up-enhsp.")
        return
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name, domain, problem in tasks(Path(folder), drawn):
            if names and name not in names:
                continue
            rows.append(row := compared(name, domain, problem, program, seconds))
            print("  ".join(show(row) for show in COLUMNS.values()), flush=True)
    equal = [row for row in rows if row["outcome"] == "equal"]
    if equal:
        ratio = statistics.median(row["other"] / row["own"] for row in equal)
        print(f"{len(equal)} of {len(rows)} compared and equal; ENHSP's time is {ratio:.2f} of ours (median)")
    write_record(record, COLUMNS, rows)
    sys.exit(any(row["outcome"].startswith("DIFFERENT") for row in rows))


if __name__ == "__main__":
    main()
