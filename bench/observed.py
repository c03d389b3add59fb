"""Time of QMDP's values by policy iteration, compared with sweeps alone (Gauss-Seidel value iteration).

    python bench/observed.py [TASK ...] [--limit SECONDS] [--repeat N] [--record FILE]

A TASK is a shipped task, or one of `square`, `random` and `lost`, followed by a number of states: people walk in a
square; on a graph with four random roads from each place; or on one from half of which no road leads back. `,own` after
it stands for people with misconceptions that the robot knows, and `,gamma=.999` for another discount factor.

Both methods run in one process, in turn, on the same problems; times are processor time of one thread at a time, the
least of N runs. Sweeps alone end at the time limit; then there is no difference to show.
"""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

import click
import numpy as np
from graphs import graph_task
from tables import Columns, cell, record_option, write_record

from assist.people.choices import Choices
from assist.people.decision import Floats
from assist.people.human import Human, HumanModel
from assist.people.misconception import perceived_cost_to_go
from assist.person import AssistPOMDP
from assist.person import policy_iteration as iteration
from assist.person.action_values import BEST
from assist.person.mdp_values import initial_upper_bounds, sweep_order, value_iteration
from assist.person.problem_arrays import ProblemArrays, read_only
from assist.person.qmdp import load_compiled
from planner import Table, cost_to_go, load

TASKS = [
    "kitting/paper", "kitting/ladder-5x5", "kitting/ladder-5x5,own", "kitting/ladder-5x5,own,gamma=.999",
    "kitting/sealed", "stations/one-way", "delivery/one-way", "square 10000,gamma=.999", "random 10000", "lost 10000",
]  # fmt: skip
TOLERANCE = 1e-6

COLUMNS: Columns = {
    "task": cell("task"),
    "states": cell("states", ","),
    "dead ends": cell("dead", ","),
    "sweeps alone": lambda row: cell("sweeps", ",")(row) if row["difference"] is not None else "-",
    "seconds alone": lambda row: f"{'' if row['difference'] is not None else 'over '}{row['alone']:.2f}",
    "sweeps": cell("few", ","),
    "seconds": cell("seconds", ".2f"),
    "largest difference": lambda row: "-" if row["difference"] is None else f"{row['difference']:.0e}",
}


def roads_of(kind: str, states: int) -> list[tuple[int, int, int]]:
    """Return the roads (from, to, cost) of a random task or a square; the goal is place 0."""
    rng = np.random.default_rng(0)
    if kind == "square":
        side = math.isqrt(states)
        steps = ((0, 1), (1, 0), (0, -1), (-1, 0))
        places = [(i, j, a, b) for i in range(side) for j in range(side) for a, b in steps]
        inside = [(i, j, i + a, j + b) for i, j, a, b in places if 0 <= i + a < side and 0 <= j + b < side]
        return [(i * side + j, y * side + z, 1) for i, j, y, z in inside]
    half = states // 2 if kind == "lost" else states
    roads = [(i, i - 1, 1) for i in range(1, half)]
    for i in range(states):
        to = rng.integers(0, states, 4) if i < half else rng.integers(half, states, 4)
        roads += [(i, int(j), int(cost)) for j, cost in zip(to, rng.integers(1, 5, 4), strict=True)]
    return [road for road in roads if road[0] != road[1]]


def problem_of(text: str) -> AssistPOMDP:
    """Return the problem that a TASK names."""
    name, *options = text.split(",")
    kind, *size = name.split()
    known = cost_to_go(graph_task(roads_of(kind, int(size[0]))) if size else load(name))
    assert isinstance(known, Table)
    choices = Choices.of(known)
    model = HumanModel.exact(choices)
    if "own" in options:
        h = perceived_cost_to_go(choices, 0.9, np.random.default_rng(1))
        model = HumanModel.own(choices, Human(1.0, 0.6, 0.9, h))
    gamma = next((float(one.removeprefix("gamma=")) for one in options if one.startswith("gamma=")), 0.99)
    return AssistPOMDP.of(model, gamma=gamma)


def swept_alone(pomdp: AssistPOMDP, limit: float) -> tuple[Floats | None, int, float]:
    """Return the values by sweeps alone, their number, and the seconds; no values after the time limit."""
    value, arrays, order = initial_upper_bounds(pomdp), ProblemArrays.of(pomdp), read_only(sweep_order(pomdp, 0))
    robot, number, begun = read_only(np.full(len(value), BEST)), 0, time.process_time()
    for b in range(value.shape[1]):
        own, policy = value[:, b : b + 1].copy(), np.zeros((len(value), value.shape[2]), dtype=np.int32)
        chosen, unsuggested = (read_only(part[:, :, b : b + 1]) for part in (arrays.chosen, arrays.unsuggested))
        goal = read_only(np.zeros(1, dtype=np.int64))
        own_arrays = arrays._replace(chosen=chosen, unsuggested=unsuggested, goal_of=goal)
        change = math.inf
        while change * pomdp.gamma / (1 - pomdp.gamma) > TOLERANCE:
            rise, fall, _ = iteration.sweep(own, order, iteration.ONLY, robot, policy, iteration.NOWHERE, own_arrays)
            change, number = max(rise, fall), number + 1
            if time.process_time() > begun + limit:
                return None, number, time.process_time() - begun
        value[:, b] = own[:, 0]
    return value, number, time.process_time() - begun


def iterated(pomdp: AssistPOMDP) -> tuple[Floats, int, float]:
    """Return the values by policy iteration, the number of sweeps over a region, and the seconds."""
    done: list[None] = []
    one, begun = iteration.sweep, time.process_time()

    def counted(*given: Any) -> tuple[float, float, int]:
        done.append(None)
        return one(*given)

    iteration.sweep = counted
    try:
        value = initial_upper_bounds(pomdp)
        value_iteration(pomdp, value, tolerance=TOLERANCE)
    finally:
        iteration.sweep = one
    return value, len(done), time.process_time() - begun


def measured(task: str, limit: float, repeat: int) -> dict[str, Any]:
    """Return the row of a task."""
    pomdp = problem_of(task)
    load_compiled(pomdp)
    alone, seconds = math.inf, math.inf
    for _ in range(repeat):  # in turn, so that both meet the same load of the machine
        value, few, now = iterated(pomdp)
        seconds = min(seconds, now)
        plain, sweeps, now = swept_alone(pomdp, limit)
        alone = min(alone, now)
    difference = None if plain is None else float(np.abs(plain - value).max())
    dead = int(np.isinf(pomdp.model.choices.h).sum())
    return {
        "task": task, "states": len(value), "dead": dead, "sweeps": sweeps, "alone": alone, "few": few,
        "seconds": seconds, "difference": difference,
    }  # fmt: skip


@click.command()
@click.argument("tasks", nargs=-1)
@click.option("--limit", default=60.0, show_default=True, help="Processor seconds for sweeps alone.")
@click.option("--repeat", default=1, show_default=True)
@record_option
def main(tasks: tuple[str, ...], limit: float, repeat: int, record: Path | None) -> None:
    """Compare policy iteration with sweeps alone."""
    rows = []
    for task in tasks or TASKS:
        rows.append(measured(task, limit, repeat))
        click.echo("  ".join(show(rows[-1]) for show in COLUMNS.values()))
    write_record(record, COLUMNS, rows)


if __name__ == "__main__":
    main()
