"""What somebody gets at most who complies bounds what anybody gets, and hardly exceeds what the most trusting do."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from conftest import KITTING, table_of

from assist.people.belief import Grid
from assist.people.choices import Choices
from assist.people.human import Human, HumanModel, Population
from assist.person import AssistPOMDP, qmdp
from assist.person.compliance import TOLERANCE, at_most
from assist.person.region import never_erring
from planner import Instance

GAMMA, LAPSE, C_SUGGEST = 0.95, 0.02, 0.3


def solved(task: str, human: Human | None, grid: Grid, eta: float, **options: Any) -> tuple[Any, Any]:
    """Give the values with beta and theta seen, shape (n, B, T), and the bound, shape (n, B)."""
    table = table_of(Instance(file := KITTING / f"{task}.pddl", file.parent / "domain.pddl"))
    choices = Choices.of(table)
    known = {"eta": eta, "lapse": LAPSE}
    model = HumanModel.exact(choices, **known) if human is None else HumanModel.own(choices, human, **known)
    suggestions = "optimal" if options.get("optimal", True) else "all"
    pomdp = AssistPOMDP.of(model, grid=grid, gamma=GAMMA, c_suggest=C_SUGGEST, suggestions=suggestions)
    bound = at_most(table, human, grid.beta, gamma=GAMMA, c_suggest=C_SUGGEST, lapse=LAPSE, **options)
    assert (bound <= never_erring(choices.h, table.task.costs, GAMMA)[:, None] + 1e-9).all()
    return qmdp(pomdp).value_mdp, bound


@pytest.mark.parametrize(
    ("task", "optimal", "known"),
    [("sealed", True, True), ("costs/ways", True, True), ("tiny", False, True), ("sealed", True, False)],
)
def test_nobody_gets_more(task: str, optimal: bool, known: bool) -> None:
    """In tasks with dead ends, and with actions that cost nothing; whatever theta is, those who resist included."""
    (human,) = Population(sigma=(1.0, 1.0)).sample(None, 1, np.random.default_rng(3))
    grid = Grid(np.array([0.0, 0.5, 3.0]), np.array([0.0, 0.3, 0.7, 1.0]))
    values, bound = solved(task, human if known else None, grid, 0.2, optimal=optimal)
    assert (bound[:, :, None] >= values - 1e-6).all()
    assert (bound - values[:, :, 1]).max() > 10 * TOLERANCE  # a doubtful person gets less


def test_who_always_complies_gets_as_much() -> None:
    """Where theta is 1 for ever and it never pays that a suggestion is avoided, the bound is the value."""
    (human,) = Population(sigma=(0.5, 0.5)).sample(None, 1, np.random.default_rng(3))
    values, bound = solved("tiny", human, Grid(np.array([0.2, 2.0]), np.array([0.0, 1.0])), 0.0)
    np.testing.assert_allclose(bound, values[:, :, 1], atol=10 * TOLERANCE)


def test_people_who_are_mistaken_about_actions_are_refused() -> None:
    (human,) = Population(noise="action").sample(None, 1, np.random.default_rng(0))
    with pytest.raises(ValueError, match="expected somebody who is mistaken about states"):
        solved("tiny", human, Grid(np.array([1.0]), np.array([0.0, 1.0])), 0.2)
