"""Numeric tasks solved by this project and by ENHSP, an independent planner for numbers: equal costs, and times.

    python bench/enhsp.py [NAME...] [--drawn 24] [--seconds 60] [--record FILE]

ENHSP (the package up-enhsp, which needs Java) searches with `opt-hrmax`, an optimal A*. The tasks are those of
`domains/stock`, the numeric cases of `tests/planner/pddl/test_cases_numbers.py`, and some of `tests/random_numeric.py`.
Where the environment variable NUMERIC_PDDL names a folder with a folder for each pair (`domain.pddl` and `p.pddl`),
those without durations are too. Each runs in a process of its own, from the files to an optimal plan. Times are
processor seconds of the whole process, Python's and Java's start included. Where costs differ, a direct search over the
original meaning decides; if it does not agree with this project, the exit code is 1. Without Java or the package the
script says so and does nothing.

ENHSP reads its plan's cost from the metric; without a metric each action costs 1. A function without an initial value
makes an effect that reads it impossible here; ENHSP may see that otherwise, so that such tasks are left out.
"""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
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
    sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "tests" / "planner" / "pddl")]
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
    with tempfile.TemporaryFile("w+") as output:
        limited = ["timeout", str(seconds), *command]
        process = subprocess.Popen(limited, stdout=output, stderr=subprocess.DEVNULL)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        output.seek(0)
        said = "limit" if process.returncode == 124 else output.read()  # the exit code of `timeout`
    return said, used.ru_utime + used.ru_stime


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
        return f"{float(found[1]):.9g}" if float(found[1]) >= 0 else "no plan"
    if re.search(r"unsolvable|Problem is not solvable|No plan|unreachable", said, re.I):
        return "no plan"
    return "limit" if said == "limit" else "refused"


def settled(mine: str, domain: Path, problem: Path) -> str:
    """Return what the direct search says where the answers differ (`tests/direct_search.py`)."""
    from direct_search import Direct

    answer = Direct(domain, problem).search(20_000)
    if not answer.known:
        return "DIFFERENT"
    right = "no plan" if answer.cost is None else f"{float(answer.cost):.9g}"
    return f"the direct search agrees with kitassist ({right})" if right == mine else f"DIFFERENT, {right} is right"


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
        outcome = "equal" if same else f"ENHSP {their}: {settled(mine, domain, problem)}"
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
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True, help="Tasks at a time.")
@click.option("--one", type=click.Path(path_type=Path), nargs=2, hidden=True)
@record_option
def main(
    names: tuple[str, ...], drawn: int, seconds: float, jobs: int, one: tuple[Path, Path] | None, record: Path | None
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
        chosen = [task for task in tasks(Path(folder), drawn) if not names or task[0] in names]
        for row in ThreadPoolExecutor(jobs).map(lambda task: compared(*task, program, seconds), chosen):
            rows.append(row)
            print("  ".join(show(row) for show in COLUMNS.values()), flush=True)
    equal = [row for row in rows if row["outcome"] == "equal"]
    if equal:
        ratio = statistics.median(row["other"] / row["own"] for row in equal)
        print(f"{len(equal)} of {len(rows)} compared and equal; ENHSP's time is {ratio:.2f} of ours (median)")
    write_record(record, COLUMNS, rows)
    sys.exit(any("DIFFERENT" in row["outcome"] for row in rows))


if __name__ == "__main__":
    main()
