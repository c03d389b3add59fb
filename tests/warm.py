"""Compile what tests need, so that it is in numba's cache before they run: `python tests/warm.py planner|people`.

Each half is one case of some tests, which call many compiled functions on small tasks. What is compiled while tests run
is listed at their end (`conftest.py`); the test that needed it first is then added here.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from conftest import kit
from recorded import people_at_work, simulated

from assist.people.choices import Choices
from planner import Limits, cost_to_go, load, sweep


def case(test: Callable[..., object]) -> Callable[..., Any]:
    """Return the function that hypothesis calls with each example."""
    return test.hypothesis.inner_test  # type: ignore[attr-defined]


def planner() -> None:
    import test_dense
    import test_sweep

    for name in ("delivery/round-trip", "gripper/balls-01", "kitting/paper"):
        task = load(name)
        sweep(task).optimal_plan()
        cost_to_go(task, max_states=10)
    large = load("kitting/ladder-4x9")  # without an answer in a millisecond, all states are tried, and then orbits
    cost_to_go(large, states=np.array([large.initial]), max_states=100_000, limits=Limits(seconds=0.001))
    test_sweep.test_costs_beyond_32_bits()
    for few in (False, True):
        for costs in (range(1, 2), range(3, 90_000, 11)):
            case(test_dense.test_tables_equal_plain_search)(1, costs, few)
    case(test_dense.test_all_that_is_said_of_reachable_states_is_true)(0)


def people() -> None:
    import test_alpha_vectors
    import test_bounded
    import test_equations
    import test_fit
    import test_fit_own
    import test_refusals
    import test_solver
    import test_trust_fit
    import test_unreliable_observations
    import test_upper_bound

    from assist import fit
    from assist.learning.advice_fit import fit_model
    from assist.learning.advice_model import AdviceModel
    from assist.learning.advice_rules import RULES
    from assist.learning.log import Log
    from assist.person.settings import Setting

    case(test_solver.test_bounds_are_ordered_everywhere)("tiny", 0)
    case(test_upper_bound.test_upper_bound_holds_wherever_the_pivots_end)(0)
    test_alpha_vectors.test_action_values_equal_those_of_a_plain_look_ahead(Choices.of(kit("tiny")), "optimal")
    case(test_fit.test_the_curvature_may_be_a_band)(0)
    test_fit.test_the_online_belief_is_the_offline_likelihood(kit("tiny"), Choices.of(kit("tiny")))
    test_fit.test_the_online_belief_with_suggestions(kit("tiny"), Choices.of(kit("tiny")))
    person = {"eta": 0.2, "lapse": 0.0, "utility_scale": 1.0}
    case(test_equations.test_the_likelihood_of_a_walk_is_that_of_the_equations)(
        [(0, 1, 1), (1, 2, 1), (0, 2, 3)], person, 0.5, float(test_equations.BETA[0]), 0
    )
    test_refusals.learned(kit("tiny"), test_refusals.ACTIONS, model="terms")
    test_bounded.test_nobody_gets_more("sealed", 4, Setting(c_suggest=0.2), test_bounded.somebody())
    fit_model(AdviceModel.of("E", RULES["outcome"]), simulated(4, 4, 0))
    rows = people_at_work(Choices.of(kit("tiny")), [0.5], np.random.default_rng(0), suggest=0.4, episodes=2)
    fit(kit("tiny"), Log.of(rows), model=test_fit_own.same)
    test_trust_fit.test_held_out_people_are_predicted_from_the_others()
    test_unreliable_observations.test_who_may_have_finished_does_nothing_more()


if __name__ == "__main__":
    {"planner": planner, "people": people}[sys.argv[1]]()
