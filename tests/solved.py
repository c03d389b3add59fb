"""Solutions of one person's POMDP that several test files share, and beliefs at which they are tested."""

from __future__ import annotations

from functools import cache

import numpy as np
from conftest import KITTING, costly, table_of
from hypothesis import strategies as st
from test_qmdp import GRID

from assist.people import Choices, Human, HumanModel, perceived_cost_to_go
from assist.person import AssistPOMDP, OfRobots, Solution, solve
from planner import Instance


def by_hand(
    targets: list[list[int]], h: list[float], costs: list[list[float]] | None = None, initial: int = 0
) -> Choices:
    """A task written as the states that each state's actions lead to; a goal has none."""
    n, slots = len(targets), max(map(len, targets))
    applicable = np.array([[a < len(row) for a in range(slots)] for row in targets])
    target = np.array([row + [x] * (slots - len(row)) for x, row in enumerate(targets)])
    cost = np.where(applicable, 1.0, 0.0)
    if costs is not None:
        cost = np.array([row + [0.0] * (slots - len(row)) for row in costs])
    value = np.array(h)
    with np.errstate(invalid="ignore"):
        optimal = applicable & (np.abs(cost + value[target] - value[:, None]) < 1e-9)
    names = tuple(f"({x}-{a})" for x in range(n) for a in range(slots))
    actions = np.where(applicable, np.arange(n * slots).reshape(n, slots), -1)
    return Choices(value, ~applicable.any(axis=1), applicable, actions, target, cost, optimal, names, initial)


def problem(name: str, gamma: float, c_suggest: float, sigma: float, **options: object) -> AssistPOMDP:
    """A kitting task and a person whose misconception the robot knows; options as in `AssistPOMDP.of`."""
    choices = Choices.of(table_of(Instance(KITTING / f"{name}.pddl", KITTING / "domain.pddl")))
    model = HumanModel.own(
        choices, Human(1.0, 0.5, sigma, perceived_cost_to_go(choices, sigma, np.random.default_rng(0)))
    )
    return AssistPOMDP.of(model, **{"gamma": gamma, "robot": OfRobots(c_suggest=c_suggest), **options})  # type: ignore[arg-type]


@cache
def solution_of(name: str) -> Solution:
    """Return a solution whose bounds differ, so that a violated law can be noticed."""
    if name == "paper-fixed":
        return solve(problem("paper-fixed", 0.95, 0.5, 0.5), gap=5e-3)
    if name == "sealed":
        return solve(problem("sealed", 0.9, 0.3, 0.5, suggestions="all"), gap=5e-3)
    return solve(
        problem("tiny", 0.95, 0.3, 0.9, robot=OfRobots(c_suggest=0.3, execute=True, c_execute=0.7), grid=GRID), gap=1e-4
    )


def some_beliefs(solution: Solution, seed: int, count: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Return states and beliefs: even ones, concentrated ones, and mixtures of stored ones."""
    rng = np.random.default_rng(seed)
    stored = np.flatnonzero(np.diff(solution.first))
    x = np.where(rng.random(count) < 0.7, rng.choice(stored, count), rng.integers(0, len(solution.corner), count))
    cells = solution.pomdp.prior.size
    belief = np.stack([rng.dirichlet(np.full(cells, a)) for a in rng.choice([0.02, 0.3, 3.0], count)])
    for i in np.flatnonzero(rng.random(count) < 0.6):
        mine = solution.point[solution.first[x[i]] : solution.first[x[i] + 1]].reshape(-1, cells)
        if len(mine):
            weights = rng.dirichlet(np.full(len(mine), 0.2))
            belief[i] = 0.95 * weights @ mine + 0.05 * belief[i] * (rng.random() < 0.5)
            belief[i] /= belief[i].sum()
    return x, belief.reshape(count, *solution.pomdp.grid.shape)


NAMES = ["tiny", "sealed", "paper-fixed"]
seeds = st.integers(0, 2**31)
few = costly(5, 25)
