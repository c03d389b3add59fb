"""Numeric and durative PDDL of other people: how much of it is compiled, grounded and solved, and whether costs agree.

    NUMERIC_PDDL=FOLDER python bench/numeric_pddl.py --refusals [--record FILE]
    NUMERIC_PDDL=FOLDER python bench/numeric_pddl.py [NAME...] [--out FILE] [--seconds 30] [--search 30] [--direct 20]
        [--record FILE]

FOLDER has a folder for each pair, with `domain.pddl` and `p.pddl`, and a list `pairs.txt`: a line for each, with its
name, repository, domain and problem. The record lists these too, each with its outcome. Each pair runs in a process of
its own. It is compiled and grounded within a limit of processor time, so that the outcome does not depend on the load
of the machine. An optimal plan is searched, and a direct search over the original meaning (`tests/direct_search.py`)
answers, each within its own limit. A plan must replay in that meaning with the same cost, and where both searches end,
their costs must agree. A difference is a violation: it is printed, and the exit code is 1. Pairs that --out has already
are not run again. With --refusals the files are only read, and what is refused is counted by kind.
"""

from __future__ import annotations

import json
import math
import os
import re
import resource
import signal
import subprocess
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

import click
from tables import Columns, cell, record_option, write_record

TESTS = Path(__file__).parent.parent / "tests"
MEMORY = 6e9  # bytes of a pair's processes
STATES = 20_000  # of the direct search
MOST_WAITING = 8  # wall-clock seconds for a second of processor time

KINDS = (
    ("PDDL+", r"processes|events"), ("continuous effects", r"#t|continuous"),
    ("timed initial literals", r"timed initial literal"), ("preferences", r"preference"),
    ("constraints", r"constraint"), ("maximize", r"maximi"),
    ("object fluents", r"object fluent|functions give numbers"),
    ("a duration that is free", r"\?duration"), ("no bound is proven", r"without a limit|no proven limit"),
    ("too many values or combinations", r"values|combinations|objects"), ("a metric that falls", r"metric"),
    ("costs that are too large", r"units"),
    ("a hyphen without blanks", r"before and after the hyphen"),
    ("one name for two objects", r"is defined twice|is declared twice"),
    ("an unknown name", r"unknown (?:predicate|object|type)|no such function|is written for domain"),
    ("wrong arguments", r"argument of the wrong type|takes \d+ arguments?, not"),
    ("parentheses", r"is missing between|is not closed|that it closes|is not within \(define"),
    ("no goal", r"has no \(:goal"), ("unknown words", r"is not expected here|unknown requirement"),
    ("another fault of the file", r""),
)  # fmt: skip
"""Kinds of refusals, and words in the message of each."""
FAULTS = tuple(kind for kind, _ in KINDS[KINDS.index(("costs that are too large", r"units")) + 1 :])
"""Kinds of faults that the files have by themselves."""
LEFT_OUT = ("PDDL+", "continuous effects", "timed initial literals", "preferences", "constraints", "maximize",
            "object fluents", *FAULTS)  # fmt: skip
"""Kinds that no planner for one person who acts in sequence can answer, which are left out of the shares."""


def kind_of(message: str) -> str:
    """Return the kind of a refusal."""
    return next(kind for kind, words in KINDS if re.search(words, message))


def used() -> float:
    """Return the processor seconds of this process and its children."""
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def work(folder: Path, seconds: float, search: float, direct: float) -> dict[str, Any]:
    """Return what becomes of a pair, in this process."""
    from planner import LimitError, Limits, PDDLError, astar, instance
    from planner.costtogo.number_values import grounded
    from planner.pddl.reader import read

    domain, problem = folder / "domain.pddl", folder / "p.pddl"
    row: dict[str, Any] = {"status": "", "said": ""}
    start = used()
    try:
        made, task = grounded(
            read(instance(problem, domain)), Limits(MOST_WAITING * seconds, processor_seconds=seconds)
        )
        row |= {"ground": round(used() - start, 3), "operators": len(task.operators), "compiled": dict(made.compiled)}
        row |= {"variables": len(task.variables), "tried": bool(task.beyond)}
        if row["ground"] > seconds:
            raise LimitError("grounded too late")
        row["status"] = "grounded"
        start = used()
        cost, plan = astar(task, limits=Limits(search, MEMORY / 1e6))
        row |= {"search": round(used() - start, 3), "status": "solved" if plan is not None else "no plan"}
        row |= {"cost": str(Fraction(cost).limit_denominator(10**9)) if plan is not None else None, "plan": plan}
    except PDDLError as error:
        row |= {"status": "refused", "said": error.message, "kind": kind_of(error.message)}
    except LimitError as error:
        row |= {"status": row["status"] or "limit", "said": str(error)}
    return row | independent(domain, problem, row.get("plan"), direct)


def independent(domain: Path, problem: Path, plan: list[str] | None, seconds: float) -> dict[str, Any]:
    """Return what the direct search finds, and the cost of the plan by its definitions."""
    sys.path.insert(0, str(TESTS))
    from direct_search import Direct, TooLargeError, UnsupportedError

    def ended(*_: object) -> None:
        raise TimeoutError

    signal.signal(signal.SIGPROF, ended)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    row: dict[str, Any] = {}
    try:
        task = Direct(domain, problem)
        if plan is not None:
            row["replayed"] = str(task.replay(plan))
        answer = task.search(STATES, whole=False)
        row |= {"direct": str(answer.cost) if answer.cost is not None else None, "known": answer.known}
    except (UnsupportedError, TooLargeError, TimeoutError) as error:
        row["direct said"] = str(error) or "time"
    except Exception as error:  # noqa: BLE001  # the reference fails at faulty files in any way
        row["direct said"] = f"{type(error).__name__}: {error}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    return row


def same(exact: str | None, cost: str | None) -> bool:
    """Return whether an exact cost is that of a search, which answers a floating-point number; None: no plan."""
    if exact is None or cost is None:
        return exact == cost
    return math.isclose(Fraction(exact), Fraction(cost), rel_tol=1e-12)


def violation(row: dict[str, Any]) -> str:
    """Return how a pair's answers differ; empty if they agree, or if only one of them is known."""
    if row["status"] == "died":
        return row["said"]
    if row.get("direct said", "").startswith("AssertionError"):
        return row["direct said"]
    if row.get("replayed") is not None and not same(row["replayed"], row.get("cost")):
        return f"the plan costs {row['replayed']}, not {row['cost']}"
    if row.get("known") and row["status"] in ("solved", "no plan") and not same(row["direct"], row.get("cost")):
        return f"{row.get('cost')}, and {row['direct']} by the direct search"
    return ""


COLUMNS: Columns = {
    "outcome": cell("outcome"), "pairs": cell("pairs", ","), "repositories": cell("repositories", ","),
    "costs compared": cell("compared", ","),
}  # fmt: skip
OUTCOMES = {
    "solved": "solved", "no plan": "no plan, proven", "grounded": "grounded, no plan found in time",
    "limit": "compiled, not grounded in time", "died": "out of memory",
}  # fmt: skip


@click.command()
@click.argument("names", nargs=-1)
@click.option("--out", type=click.Path(path_type=Path), help="File of one line of JSON for each pair.")
@click.option("--seconds", default=30.0, show_default=True, help="Processor seconds of compiling and grounding.")
@click.option("--search", default=30.0, show_default=True, help="Seconds of the search.")
@click.option("--direct", default=20.0, show_default=True, help="Processor seconds of the direct search.")
@click.option("--refusals", is_flag=True, help="Only read the files, and count what is refused.")
@click.option("--one", type=click.Path(path_type=Path), hidden=True)
@record_option
def main(
    names: tuple[str, ...], out: Path | None, seconds: float, search: float, direct: float, refusals: bool,
    one: Path | None, record: Path | None,
) -> None:  # fmt: skip
    """Compile, ground and solve public numeric and durative pairs."""
    if one is not None:
        resource.setrlimit(resource.RLIMIT_AS, (int(MEMORY), int(MEMORY)))
        print(json.dumps(work(one, seconds, search, direct)))
        return
    place = os.environ.get("NUMERIC_PDDL")
    if not place:
        raise click.UsageError("NUMERIC_PDDL names no folder of pairs")
    folders = sorted(path.parent for path in Path(place).glob("*/p.pddl"))
    if refusals:
        write_record(record, REFUSALS, refused(folders, Path(place) / "pairs.txt"))
        return
    rows = [json.loads(line) for line in out.read_text().splitlines()] if out is not None and out.exists() else []
    done = {row["pair"] for row in rows}
    for folder in [each for each in folders if each.name not in done and (not names or each.name in names)]:
        limits = ["--seconds", str(seconds), "--search", str(search), "--direct", str(direct)]
        own = [sys.executable, __file__, "--one", str(folder), *limits]
        try:
            most = 2 * MOST_WAITING * seconds
            ran = subprocess.run(own, capture_output=True, text=True, timeout=most, check=False)
            lines = ran.stdout.splitlines()
            fault = (ran.stderr.strip().splitlines() or [f"exit {ran.returncode}"])[-1]
            row = json.loads(lines[-1]) if lines else {"status": "died", "said": fault}
        except subprocess.TimeoutExpired:
            row = {"status": "limit", "said": "no end"}
        row = {"pair": folder.name, **row, "violation": violation(row)}
        rows.append(row)
        said = f"VIOLATION: {row['violation']}" if row["violation"] else row["said"]
        print(f"{row['pair']}: {row['status']} {row.get('cost') or ''} {said}", file=sys.stderr)
        if out is not None:
            with out.open("a") as stream:
                stream.write(json.dumps(row) + "\n")
    listed = Path(place) / "pairs.txt"
    write_record(record, COLUMNS, summary(rows, listed), pairs=each_outcome(rows, listed))
    sys.exit(any(row["violation"] for row in rows))


REFUSALS: Columns = {
    "what": cell("what"), "pairs": cell("pairs", ","), "repositories": cell("repositories", ","),
}  # fmt: skip


def refused(folders: list[Path], listed: Path) -> list[dict[str, Any]]:
    """Read all pairs, print what is refused, and return the numbers of pairs and of repositories by kind."""
    from planner import PDDLError, instance
    from planner.pddl.reader import read

    repositories = dict(line.split("\t")[:2] for line in listed.read_text().splitlines())
    groups: dict[str, list[str]] = {}
    for folder in folders:
        what = "read"
        try:
            read(instance(folder / "p.pddl", folder / "domain.pddl"))
        except PDDLError as error:
            what = kind_of(error.message)
            print(f"{folder.name}: {what}: {error}")
        groups.setdefault(what, []).append(repositories[folder.name])
    rows = [*sorted(groups.items(), key=lambda each: -len(each[1])), ("all", [*repositories.values()])]
    return [{"what": what, "pairs": len(found), "repositories": len(set(found))} for what, found in rows]


def each_outcome(rows: list[dict[str, Any]], listed: Path) -> list[str]:
    """Return a line for each pair: its repository, domain, problem and outcome."""
    files = {name: rest for name, *rest in (line.split("\t") for line in listed.read_text().splitlines())}
    return sorted(" | ".join((*files[row["pair"]], row.get("kind") or row["status"])) for row in rows)


def summary(rows: list[dict[str, Any]], listed: Path) -> list[dict[str, Any]]:
    """Return the table: outcomes with their numbers of pairs and of costs compared, then the shares."""
    repositories = dict(line.split("\t")[:2] for line in listed.read_text().splitlines())
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        what = f"refused: {row['kind']}" if row["status"] == "refused" else OUTCOMES[row["status"]]
        groups.setdefault(what, []).append(row)
    counted = [row for row in rows if row.get("kind") not in LEFT_OUT]
    shares = {
        "all": rows,
        "that count: without what no sequential plan can have, and faults of the files": counted,
        "of these compiled": [row for row in counted if row["status"] not in ("refused", "died")],
        "of these grounded within 30 s": [row for row in counted if row["status"] in ("grounded", "solved", "no plan")],
        "of these on demand, without a proven bound": [row for row in counted if row.get("tried")],
    }
    table = sorted(groups.items(), key=lambda each: -len(each[1]))
    return [
        {
            "outcome": what, "pairs": len(found), "repositories": len({repositories[row["pair"]] for row in found}),
            "compared": sum(bool(row.get("known")) and row["status"] in ("solved", "no plan") for row in found),
        }
        for what, found in [*table, *shares.items()]
    ]  # fmt: skip


if __name__ == "__main__":
    main()
