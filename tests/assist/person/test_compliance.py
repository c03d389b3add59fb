"""The value for fully compliant people is an upper bound for all people, and is close to that at theta 1."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from conftest import kit

from assist.declare.declared import declared
from assist.people import Choices, Grid, Human, HumanModel, Population
from assist.person import AssistPOMDP, Assumptions, OfRobots, qmdp
from assist.person.compliance_relaxation import breadth_first, compliance_bounds
from assist.person.frontier_bounds import never_erring

GAMMA, LAPSE = 0.95, 0.02
ROBOT = OfRobots(c_suggest=0.3)


@declared
class Discounted(OfRobots):
    """A robot whose suggestions cost a tenth of what the setting says."""

    @property
    def costs(self) -> tuple[float, float, float]:
        return 0.0, 0.1 * self.c_suggest, self.c_execute


def somebody(sigma: float) -> Human:
    (human,) = Population(sigma=(sigma, sigma)).sample(None, 1, np.random.default_rng(3))
    return human


def solved(
    task: str, human: Human | None, grid: Grid, eta: float, most: int, robot: OfRobots = ROBOT, **options: Any
) -> tuple[Any, Any, Any]:  # fmt: skip
    """Return the MDP values of some states, (m, B, T), the bound, (m, B), and the bound without errors."""
    table = kit(task)
    choices = Choices.of(table)
    known = {"eta": eta, "lapse": LAPSE}
    model = HumanModel.exact(choices, **known) if human is None else HumanModel.own(choices, human, **known)
    suggestions = "optimal" if options.get("optimal", True) else "all"
    pomdp = AssistPOMDP.of(model, grid=grid, gamma=GAMMA, robot=robot, suggestions=suggestions)
    states = breadth_first(table, np.array([table.initial]), most)
    assumed = Assumptions(human=human, gamma=GAMMA, robot=robot, lapse=LAPSE)
    found = compliance_bounds(table, states, grid.beta, assumed, **options)
    np.testing.assert_array_equal(found.at(states[::-1]), found.value[::-1])
    nobody_errs = never_erring(choices.h[states], table.task.costs, GAMMA)[:, None]
    return qmdp(pomdp).value_mdp[states], found.value, nobody_errs


@pytest.mark.parametrize(
    ("task", "most", "optimal", "known"),
    [
        ("sealed", 10**6, True, True),
        ("costs/ways", 10**6, True, True),
        ("tiny", 10**6, False, True),
        ("tiny", 12, True, False),
    ],
)
def test_nobody_gets_more(task: str, most: int, optimal: bool, known: bool) -> None:
    """This holds for every theta, with dead ends, with free actions, and at the frontier of a part."""
    grid = Grid(np.array([0.0, 0.5, 3.0]), np.array([0.0, 0.3, 0.7, 1.0]))
    values, bound, nobody_errs = solved(task, somebody(1.0) if known else None, grid, 0.2, most, optimal=optimal)
    assert (bound[:, :, None] >= values - 1e-6).all()
    assert (bound <= nobody_errs + 1e-9).all()
    assert (bound < nobody_errs - 0.3).any()  # it is known that they err
    assert (bound - values[:, :, 1]).max() > 0.2  # with a doubtful person the value is lower


def test_a_suggestion_costs_what_the_robot_says() -> None:
    grid, robot = Grid(np.array([0.0, 0.5]), np.array([0.0, 0.3, 1.0])), Discounted(c_suggest=3.0)
    values, bound, _ = solved("tiny", None, grid, 0.0, 10**6, robot=robot)
    assert (bound[:, :, None] >= values - 1e-6).all()


def test_who_always_complies_gets_as_much() -> None:
    """If theta is always 1 and avoiding a suggestion never pays, the bound is the value."""
    grid = Grid(np.array([0.2, 2.0]), np.array([0.0, 1.0]))
    values, bound, _ = solved("tiny", somebody(0.5), grid, 0.0, 10**6)
    np.testing.assert_allclose(bound, values[:, :, 1], atol=0.2)


def test_states_are_met_layer_by_layer() -> None:
    table = kit("tiny")
    layers = [np.array([table.initial])]
    for _ in range(3):
        targets = [table.choices(layers[-1]).targets]
        layers.append(np.unique(np.concatenate([layers[-1], *targets])))
    for layer in layers:
        np.testing.assert_array_equal(breadth_first(table, np.array([table.initial]), len(layer)), layer)
    assert len(breadth_first(table, layers[1], 1)) == len(layers[1])  # the given states are always included
    assert len(breadth_first(table, layers[0], 10**6)) == len(table)


def test_people_who_are_mistaken_about_actions_are_refused() -> None:
    (human,) = Population(noise="action").sample(None, 1, np.random.default_rng(0))
    with pytest.raises(ValueError, match="expected a person who is mistaken about states"):
        solved("tiny", human, Grid(np.array([1.0]), np.array([0.0, 1.0])), 0.2, 10**6)
