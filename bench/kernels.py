"""What compiled code saves: each group of kernels against numpy, or against its own loops in plain Python.

    python bench/kernels.py [--repeat 3] [--record FILE]

A kernel with a readable definition in numpy is compared with that: the readable one serves small work, where compiling
takes longer than it saves. The others are loops that numpy does not express. They run once more without the compiler,
in a process of their own. Times are processor seconds, the least of some runs; compiling does not count.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import click
import numpy as np
from tables import Columns, cell, record_option, write_record

from assist.certify import coupled, upper_bound
from assist.people import Choices, HumanModel
from assist.people.belief import Grid
from assist.person import AssistPOMDP, Assumptions, ObservationModel, OfRobots, Setting, qmdp, sparse_iteration
from assist.person import beliefs as storages
from assist.person.compliance_relaxation import compliance_bounds
from assist.person.dynamics import act
from assist.person.expected_values import expected, expected_of_few
from assist.person.solver import solve
from assist.team import Pool, simulate
from assist.team import model_group as groups
from planner import load, sweep

COLUMNS: Columns = {
    "kernels": cell("name"), "case": cell("case"), "instead": cell("instead"), "without, s": cell("without", ".3f"),
    "compiled, s": cell("compiled", ".4f"), "ratio": cell("ratio", ".1f"),
}  # fmt: skip
TINY, PAPER = "kitting/tiny", "kitting/paper"


def problem(task: str, betas: int = 6, thetas: int = 10) -> AssistPOMDP:
    """Return the problem of a person."""
    grid = Grid(np.linspace(0.3, 2.8, betas), np.linspace(0.0, 1.0, thetas))
    model = HumanModel.exact(Choices.of(sweep(load(task))))
    return AssistPOMDP.of(model, grid=grid, robot=OfRobots(c_suggest=0.3), gamma=0.9)


def simulated(task: str, **setting: Any) -> Callable[[], object]:
    """Return a simulation of four people whose policies are ready."""
    pool = Pool.sample(load(task), 4, seed=0, setting=Setting(knowledge="exact", c_suggest=0.3, **setting))
    return partial(simulate, pool, pool.policy("attention"), humans=4, episodes=500 if task == PAPER else 20, seed=0)


def with_readable(name: str) -> tuple[str, Callable[[], object], Any]:
    """Return a case, a function that runs it, and what replaces the compiled kernel by the readable one."""
    if name == "steps of people":
        return f"500 episodes, {PAPER}", simulated(PAPER), patch.object(groups, "act", act.readable)
    if name == "beliefs, states seen":
        update = storages._update.readable
        return f"500 episodes, {PAPER}", simulated(PAPER), patch.object(storages, "_update", update)
    if name == "values":
        small = patch.object(sparse_iteration, "MOST_VALUES", 10**9)
        return "kitting/ladder-3x5", partial(qmdp, problem("kitting/ladder-3x5")), small
    pomdp, rng = problem(PAPER), np.random.default_rng(0)
    x, belief = rng.integers(0, 836, 8000), rng.dirichlet(np.ones(60), 8000).reshape(-1, 6, 10)
    solved = qmdp(pomdp)
    readable = patch("__main__.expected", expected_of_few)
    return f"8,000 people, {PAPER}", lambda: expected(solved.q_mdp, pomdp.robot_actions, x, belief), readable


def loops(name: str) -> tuple[str, Callable[[], object]]:
    """Return a case of kernels that are loops only, and a function that runs it."""
    few = problem(TINY, 2, 3)
    if name == "beliefs, states uncertain":
        return f"20 episodes, {TINY}", simulated(TINY, observation=ObservationModel(miss=0.1), trust="constant")
    if name == "search for bounds, hulls":
        return f"{TINY}, 6 types and thetas", partial(solve, few, gap=0.02)
    if name == "alpha vectors":
        found, rng = solve(few, gap=0.02), np.random.default_rng(0)
        x, belief = rng.integers(0, 21, 200), rng.dirichlet(np.ones(6), 200).reshape(-1, 2, 3)
        return "200 beliefs", lambda: (found.q_values(x, belief), found.upper_bound(x, belief))
    if name == "compliance":
        table = sweep(load(TINY))
        return TINY, partial(compliance_bounds, table, np.arange(len(table)), few.grid.beta, Assumptions(gamma=0.9))
    if name == "bounds from samples":
        setting = Setting(knowledge="exact", c_suggest=0.1, gamma=0.6, max_steps=10)
        pool = Pool.sample(load(TINY), 2, seed=0, setting=setting)
        short = replace(pool, setting=setting)
        return f"100 paths, {TINY}", partial(upper_bound, short, paths=100, gap=0.3, window=0, jobs=1)
    rng = np.random.default_rng(0)
    agents = coupled.Agents(rng.dirichlet(np.ones(3), (3, 2, 3)), -rng.random((3, 2, 3)), gamma=0.9)
    prices = coupled.bound(agents, 1)
    if name == "coupled, rollout":
        rollout = coupled.policy(agents, "rollout", 1, solved=prices)
        return "20 steps of 3 agents", partial(coupled.simulate, agents, rollout, 1, runs=1, steps=20)
    return "3 agents of 3 states", partial(coupled.sampled_bound, agents, 1, paths=200, solved=prices)


READABLE = ("steps of people", "beliefs, states seen", "values", "expected values")
LOOPS = (
    "beliefs, states uncertain", "search for bounds, hulls", "alpha vectors", "compliance",
    "bounds from samples", "coupled, bounds from samples", "coupled, rollout",
)  # fmt: skip


def seconds(function: Callable[[], object], repeat: int) -> float:
    """Return the least processor time of some runs."""
    found = []
    for _ in range(repeat):
        begun = time.process_time()
        function()
        found.append(time.process_time() - begun)
    return min(found)


@click.command()
@click.option("--repeat", type=click.IntRange(min=1), default=3, show_default=True, help="Runs; the least time counts.")
@click.option("--interpreted", hidden=True, help="Print the time of this case without the compiler.")
@record_option
def main(repeat: int, interpreted: str | None, record: Path | None) -> None:
    """Measure all groups of kernels."""
    if interpreted:
        print(json.dumps(seconds(loops(interpreted)[1], 1)))
        return
    rows: list[dict[str, Any]] = []

    def add(name: str, case: str, instead: str, without: float, compiled: float) -> None:
        times = {"without": without, "compiled": compiled, "ratio": without / compiled}
        rows.append({"name": name, "case": case, "instead": instead, **times})
        print(" | ".join(show(rows[-1]) for show in COLUMNS.values()), flush=True)

    with patch("planner.system.jit.ReadableFirst.enough", -1):
        for name in READABLE:
            case, function, readable = with_readable(name)
            with readable:
                without = seconds(function, repeat)
            with patch.object(sparse_iteration, "MOST_VALUES", 0):
                function()
                add(name, case, "numpy", without, seconds(function, repeat))
        for name in LOOPS:
            case, function = loops(name)
            function()
            command = [sys.executable, __file__, "--interpreted", name]
            alone = subprocess.run(
                command, env=os.environ | {"NUMBA_DISABLE_JIT": "1"}, capture_output=True, text=True, check=True
            )
            add(name, case, "loops in Python", float(alone.stdout), seconds(function, repeat))
    write_record(record, COLUMNS, rows)


if __name__ == "__main__":
    main()
