"""Random PDDL files in all forms that the grammar allows, compared with answers that need no PDDL reader.

    python bench/random_pddl.py [COUNT] [--first N] [--jobs N] [--record FILE]

Each instance has a number, which is the seed of everything in it: a small task (`random_tasks.py`), the form of its two
files (`random_writing.py`), and a fault in every second one. The task is grounded and solved by brute force from what
was drawn, not from the files. Without a fault, the files must be read. This project's cost and number of reachable
states must then agree with brute force, as must Dijkstra's algorithm on the translator's grounded task with
`planner.grounding.task`, and the plan's cost when it is executed by the meaning of the files. With a fault, the
files must be refused with file and line, or have the same answer if the fault is harmless.
Anything else is a violation; it is printed, and the exit code is 1.
"""

from __future__ import annotations

import heapq
import math
import sys
import tempfile
import traceback
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import click
import numpy as np
import random_tasks
import random_writing
from random_tasks import Drawn
from tables import Columns, cell, record_option, write_record

from planner import Instance, PDDLError, Task, astar, load, sweep
from planner.grounding.task import derived, replay, successors
from planner.pddl.plan_execution import execute


@dataclass
class Outcome:
    """The result of one instance."""

    number: int
    fault: str
    result: str
    note: str | None = None
    violation: str = ""


def written(number: int) -> tuple[Drawn, random_writing.Written]:
    """Draw an instance and write it."""
    rng = np.random.default_rng(number)
    task = random_tasks.draw(rng)
    return task, random_writing.write(task, rng, faulty=number % 2 == 1)


def dijkstra(task: Task) -> float:
    """Return the cost of an optimal plan of a grounded task, by Dijkstra's algorithm on its operators."""
    first = tuple(derived(task, task.initial))
    best, queue = {first: 0}, [(0, first)]
    while queue:
        cost, state = heapq.heappop(queue)
        if cost > best[state]:
            continue
        if all(state[variable] == value for variable, value in task.goal):
            return cost
        for action, after in successors(task, state).items():
            new, values = cost + task.costs[action], tuple(after)
            if new < best.get(values, math.inf):
                best[values] = new
                heapq.heappush(queue, (new, values))
    return math.inf


def compare(instance: Instance, truth: random_tasks.Answer) -> tuple[str | None, str]:
    """Solve an instance; return the note of its task, and the difference from the true answer."""
    task = load(instance)
    if task.decided_by_translator:
        found = astar(task)[0]
    else:
        table = sweep(task)
        found = float(table[table.initial])
        if len(table) != truth.states:
            return task.note, f"{len(table)} states, {truth.states} by brute force"
        plan = table.optimal_plan()
        if plan is not None and not replay(task, plan) == execute(instance, plan).cost == found:
            return task.note, f"a plan of another cost than {found}"
        if (oracle := dijkstra(task)) != found:
            return task.note, f"cost {found}, {oracle} by Dijkstra on the grounded task"
    return task.note, "" if found == truth.cost else f"cost {found}, {truth.cost} by brute force"


def check(number: int) -> Outcome:
    """Check the instance of a number."""
    task, files = written(number)
    truth = random_tasks.solve(task)
    with tempfile.TemporaryDirectory() as folder:
        instance = Instance(Path(folder) / "problem.pddl", Path(folder) / "domain.pddl")
        instance.domain.write_text(files.domain)
        instance.problem.write_text(files.problem)
        try:
            note, differs = compare(instance, truth)
        except PDDLError as error:
            bad = "" if files.fault and error.line is not None else f"{error}"
            return Outcome(number, files.fault, "refused", violation=bad)
    return Outcome(number, files.fault, "harmless" if files.fault else "solved", note, differs)


def checked(number: int) -> Outcome:
    """Check the instance of a number. An exception counts as a violation, so that the other instances are still
    checked.
    """
    try:
        return check(number)
    except Exception as error:  # noqa: BLE001
        return Outcome(number, "", "failed", violation="".join(traceback.format_exception(error)))


@click.command()
@click.argument("count", type=click.IntRange(1), default=20)
@click.option("--first", type=click.IntRange(0), default=0, show_default=True, help="The number of the first instance.")
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Instances at a time.")
@record_option
def main(count: int, first: int, jobs: int, record: Path | None) -> None:
    """Check COUNT instances."""
    outcomes = []
    with ProcessPoolExecutor(jobs, get_context("spawn")) as processes:
        for outcome in processes.map(checked, range(first, first + count)):
            outcomes.append(outcome)
            if outcome.violation:
                print(f"instance {outcome.number} ({outcome.fault or 'no fault'}): {outcome.violation}", flush=True)
    kinds = Counter((outcome.fault, outcome.result) for outcome in outcomes)
    for (fault, result), number in sorted(kinds.items()):
        print(f"{number:6,} {result}: {fault or 'no fault'}")
    for note, number in Counter(outcome.note for outcome in outcomes if outcome.note).most_common(8):
        print(f"{number:6,} with the note: {note}")
    wrong = [outcome.number for outcome in outcomes if outcome.violation]
    row = {
        "instances": len(outcomes),
        "without a fault": sum(not outcome.fault for outcome in outcomes),
        "read and solved": sum(outcome.result == "solved" for outcome in outcomes),
        "with a fault": sum(bool(outcome.fault) for outcome in outcomes),
        "refused with their line": sum(outcome.result == "refused" for outcome in outcomes),
        "harmless faults": sum(outcome.result == "harmless" for outcome in outcomes),
        "violations": len(wrong),
    }
    print(*(f"{name} {number:,}" for name, number in row.items()), sep=", ")
    write_record(record, COLUMNS, [row])
    if wrong:
        print(f"violations in instances {', '.join(map(str, wrong))}")
        sys.exit(1)


COLUMNS: Columns = {
    name: cell(name, ",")
    for name in (
        "instances", "without a fault", "read and solved", "with a fault", "refused with their line",
        "harmless faults", "violations",
    )
}  # fmt: skip


if __name__ == "__main__":
    main()
