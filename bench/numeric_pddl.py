"""Numeric and durative PDDL of other people: how much of it is compiled, grounded and solved, and whether costs agree.

    NUMERIC_PDDL=FOLDER python bench/numeric_pddl.py [NAME...] [--out FILE] [--seconds 30] [--direct 20] [--record FILE]

FOLDER has a folder for each pair, with `domain.pddl` and `p.pddl`. Each pair runs in a process of its own. It is
compiled and grounded within a limit of time. An optimal plan is searched within the same limit. A direct search over
the original meaning (`tests/direct_search.py`) answers within its own. A plan must replay in that meaning with the same
cost, and where both searches end, their costs must agree. A difference is a violation: it is printed, and the exit code
is 1.
"""

from __future__ import annotations

import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections import Counter
from fractions import Fraction
from pathlib import Path
from typing import Any

import click
from tables import Columns, cell, record_option, write_record

TESTS = Path(__file__).parent.parent / "tests"
MEMORY = 6e9  # bytes of a pair's processes
STATES = 20_000  # of the direct search

KINDS = (
    ("PDDL+", r"processes|events"), ("continuous effects", r"#t|continuous"),
    ("timed initial literals", r"timed initial literal"), ("preferences", r"preference"),
    ("constraints", r"constraint"), ("maximize", r"maximi"), ("object fluents", r"object fluent|not a number"),
    ("a duration that is free", r"\?duration"), ("no bound", r"bound|grows|without (a )?limit|values"),
    ("falling metric", r"metric"), ("a fault of the file", r""),
)  # fmt: skip
"""Kinds of refusals, and words in the message of each."""


def kind_of(message: str) -> str:
    """Return the kind of a refusal."""
    return next(kind for kind, words in KINDS if re.search(words, message))


def work(folder: Path, seconds: float, direct: float) -> dict[str, Any]:
    """Return what becomes of a pair, in this process."""
    from planner import LimitError, Limits, PDDLError, astar, instance, load
    from planner.pddl.compilation import compiled
    from planner.pddl.reader import read

    domain, problem = folder / "domain.pddl", folder / "p.pddl"
    row: dict[str, Any] = {"status": "", "said": ""}
    start = time.monotonic()
    try:
        made = compiled(read(instance(problem, domain)))
        row |= {"compile": round(time.monotonic() - start, 3), "compiled": dict(made.compiled)}
        start = time.monotonic()
        task = load(problem, domain, limits=Limits(seconds))
        row |= {"ground": round(time.monotonic() - start, 3), "operators": len(task.operators)}
        row |= {"variables": len(task.variables), "status": "grounded"}
        start = time.monotonic()
        cost, plan = astar(task, limits=Limits(seconds, MEMORY / 1e6))
        row |= {"search": round(time.monotonic() - start, 3), "status": "solved" if plan is not None else "no plan"}
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

    signal.signal(signal.SIGALRM, ended)
    signal.setitimer(signal.ITIMER_REAL, seconds)
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
        signal.setitimer(signal.ITIMER_REAL, 0)
    return row


def violation(row: dict[str, Any]) -> str:
    """Return how a pair's answers differ; empty if they agree, or if only one of them is known."""
    if row["status"] == "died":
        return row["said"]
    if row.get("direct said", "").startswith("AssertionError"):
        return row["direct said"]
    if row.get("replayed") not in (None, row.get("cost")):
        return f"the plan costs {row['replayed']}, not {row['cost']}"
    if row.get("known") and row["status"] in ("solved", "no plan") and row["direct"] != row.get("cost"):
        return f"{row.get('cost')}, and {row['direct']} by the direct search"
    return ""


COLUMNS: Columns = {"outcome": cell("outcome"), "pairs": cell("pairs", ","), "compared": cell("compared", ",")}


@click.command()
@click.argument("names", nargs=-1)
@click.option("--out", type=click.Path(path_type=Path), help="File of one line of JSON for each pair.")
@click.option("--seconds", default=30.0, show_default=True, help="Limit of grounding, and of the search.")
@click.option("--direct", default=20.0, show_default=True, help="Limit of the direct search, in seconds.")
@click.option("--one", type=click.Path(path_type=Path), hidden=True)
@record_option
def main(
    names: tuple[str, ...], out: Path | None, seconds: float, direct: float, one: Path | None, record: Path | None
) -> None:
    """Compile, ground and solve public numeric and durative pairs."""
    if one is not None:
        resource.setrlimit(resource.RLIMIT_AS, (int(MEMORY), int(MEMORY)))
        print(json.dumps(work(one, seconds, direct)))
        return
    place = os.environ.get("NUMERIC_PDDL")
    if not place:
        raise click.UsageError("NUMERIC_PDDL names no folder of pairs")
    folders = sorted(path.parent for path in Path(place).glob("*/p.pddl"))
    rows = []
    for folder in [each for each in folders if not names or each.name in names]:
        limits = ["--seconds", str(seconds), "--direct", str(direct)]
        own = [sys.executable, __file__, "--one", str(folder), *limits]
        try:
            ran = subprocess.run(own, capture_output=True, text=True, timeout=4 * seconds + direct, check=False)
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
    counts = Counter(f"refused: {row['kind']}" if row["status"] == "refused" else row["status"] for row in rows)
    compared = Counter(
        f"refused: {row['kind']}" if row["status"] == "refused" else row["status"] for row in rows if row.get("known")
    )
    table = [{"outcome": what, "pairs": n, "compared": compared[what]} for what, n in counts.most_common()]
    write_record(record, COLUMNS, table)
    sys.exit(any(row["violation"] for row in rows))


if __name__ == "__main__":
    main()
