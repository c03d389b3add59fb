"""The human model compared with values computed by hand on `tiny.pddl`, and its properties."""

from __future__ import annotations

from math import exp
from pathlib import Path

import numpy as np
import pytest
from conftest import write_instance
from hypothesis import given
from hypothesis import strategies as st

from assist.declare import plain
from assist.people.choices import WAIT, Choices
from assist.people.decision import NOTHING, choice, influence, lapse, perceived_cost, perceived_value, trust
from assist.people.human import Human, HumanModel
from assist.people.misconception import perceived_cost_to_go
from assist.people.ranges import Population
from planner import Table, load, sweep

ALL = np.ones(3, dtype=bool)


def slots(choices: Choices, state: int) -> dict[str, int]:
    return {choices.name(state, slot): slot for slot in np.flatnonzero(choices.applicable[state])}


def test_values_by_hand_on_the_tiny_kit(tiny: Table, tiny_choices: Choices) -> None:
    """After fetching box-a there are three choices: the right slot (4 to go), the wrong slot, or going back.

    With the hammer in slot-2 and box-a on the platform there are 6 actions to go: remove, place, return, fetch, place,
    return. After `(return box-a)` there are 6 again. So Q is 5, 7 and 7.
    """
    c = tiny_choices
    q = perceived_cost(c, c.h)
    start = slots(c, c.initial)
    assert sorted(start) == ["(fetch box-a)", "(fetch box-b)"]
    assert q[c.initial, list(start.values())].tolist() == [6, 6]
    x = tiny.space.follow(["(fetch box-a)"])
    at = slots(c, x)
    right, wrong, back = at["(place hammer slot-1 box-a)"], at["(place hammer slot-2 box-a)"], at["(return box-a)"]
    assert (q[x, right], q[x, wrong], q[x, back]) == (5, 7, 7)

    beta = 0.7
    p = choice(q[x], c.applicable[x], beta)
    e = exp(-2 * beta)  # exp(-beta (7 - 5))
    assert p[right] == pytest.approx(1 / (1 + 2 * e), rel=1e-14)
    assert p[wrong] == p[back] == pytest.approx(e / (1 + 2 * e), rel=1e-14)

    heard = influence(p, right, 0.8)
    total = 0.8 * p[right] + 0.2 * (p[wrong] + p[back])
    assert heard[right] == pytest.approx(0.8 * p[right] / total, rel=1e-14)
    assert heard[back] == pytest.approx(0.2 * p[back] / total, rel=1e-14)

    value = perceived_value(c, q)
    assert value[x] == -5
    assert value[c.targets[x, right]] == -4
    assert value[c.targets[x, wrong]] == -6
    # A good suggestion raises theta by eta times one action; a bad one lowers it by as much.
    assert trust(0.6, value[x], value[c.targets[x, right]], 0.2) == pytest.approx(0.8)
    assert trust(0.6, value[x], value[c.targets[x, wrong]], 0.2) == pytest.approx(0.4)
    assert trust(0.6, value[x], value[c.targets[x, right]], 0.2, utility_scale=6) == pytest.approx(0.6 + 0.2 / 6)
    assert trust(0.95, value[x], value[c.targets[x, right]], 0.2) == 1
    # The last action reaches the goal, whose value is 0: the gain is 1 like everywhere else.
    last = int(np.flatnonzero(c.h == 1)[0])
    goal = c.targets[last, np.flatnonzero(c.optimal[last])[0]]
    assert c.goal[goal]
    assert trust(0.5, value[last], value[goal], 0.2) == pytest.approx(0.7)


def test_choice_is_stable_at_any_scale() -> None:
    q = np.array([1e6, 1e6 + 1, 1e9])
    assert choice(q, ALL, 3.0)[1] == pytest.approx(exp(-3) / (1 + exp(-3)), rel=1e-9)
    assert choice(q, ALL, 1e6).tolist() == [1, 0, 0]


def test_suggestions_are_weighed_state_by_state() -> None:
    p = np.array([[0.5, 0.3, 0.2], [0.1, 0.1, 0.8], [0.2, 0.2, 0.6]])
    heard = influence(p, [1, NOTHING, 2], [0.9, 0.9, 0.5])
    np.testing.assert_allclose(heard[0], np.array([0.05, 0.27, 0.02]) / 0.34)
    np.testing.assert_allclose(heard[1:], p[1:])


costs = st.lists(st.one_of(st.floats(0, 1e4), st.just(float("inf"))), min_size=1, max_size=6)


@given(costs, st.floats(0, 50), st.floats(0, 1), st.integers(0, 5), st.floats(0, 0.5))
def test_choices_are_distributions(q: list[float], beta: float, theta: float, suggestion: int, rate: float) -> None:
    applicable = np.ones(len(q), dtype=bool)
    p = choice(np.array(q), applicable, beta)
    heard = influence(p, suggestion % len(q), theta)
    for distribution in (p, heard, lapse(heard, applicable, rate)):
        assert (distribution >= 0).all()
        assert distribution.sum() == pytest.approx(1, abs=1e-12)
    assert (lapse(heard, applicable, rate) >= rate / len(q)).all()


@given(costs, st.floats(0, 5), st.integers(0, 5))
def test_neutral_influence_leaves_the_choice_untouched(q: list[float], beta: float, suggestion: int) -> None:
    p = choice(np.array(q), np.ones(len(q), dtype=bool), beta)
    np.testing.assert_allclose(influence(p, suggestion % len(q), 0.5), p, atol=1e-15)
    np.testing.assert_array_equal(influence(p, NOTHING, 0.9), p)


@given(st.lists(st.floats(0, 20), min_size=2, max_size=6), st.floats(0.01, 5), st.floats(0.01, 0.98))
def test_more_influence_makes_the_suggestion_likelier(q: list[float], beta: float, theta: float) -> None:
    p = choice(np.array(q), np.ones(len(q), dtype=bool), beta)
    assert influence(p, 0, theta + 0.01)[0] >= influence(p, 0, theta)[0]


def test_a_suggestion_that_leaves_nothing_possible_is_ignored() -> None:
    assert influence(np.array([1.0, 0.0]), 0, 0.0).tolist() == [1, 0]
    assert influence(np.array([1.0, 0.0]), 1, 1.0).tolist() == [1, 0]


@given(st.floats(0, 1), st.floats(-50, 0), st.floats(-50, 0), st.floats(0, 2))
def test_trust_stays_in_its_range_and_moves_with_the_gain(
    theta: float, value: float, expected: float, eta: float
) -> None:
    after = float(trust(theta, value, expected, eta))
    assert 0 <= after <= 1
    assert (after - theta) * (expected - value) >= 0


def test_trust_and_dead_ends() -> None:
    assert trust(0.6, -4.0, -np.inf, 0.2) == 0
    assert trust(0.6, -np.inf, -np.inf, 0.2) == 0.6


def test_perceived_cost_to_go_is_a_lasting_misconception(sealed: Table) -> None:
    choices = Choices.of(sealed)
    h = perceived_cost_to_go(choices, 0.5, np.random.default_rng(4))
    assert (h[choices.goal] == 0).all()
    assert (np.isinf(h) == sealed.dead_end).all()
    alive = ~sealed.dead_end & ~choices.goal
    error = h[alive] - choices.h[alive]
    assert abs(error.mean()) < 4 * 0.5 / np.sqrt(alive.sum())
    assert error.std() == pytest.approx(0.5, rel=0.15)
    np.testing.assert_array_equal(h, perceived_cost_to_go(choices, 0.5, np.random.default_rng(4)))
    np.testing.assert_array_equal(perceived_cost_to_go(choices, 0.0, np.random.default_rng(4)), choices.h)


def test_who_is_mistaken_about_actions_sees_each_outcome_for_itself(sealed: Table) -> None:
    choices = Choices.of(sealed)
    h = perceived_cost_to_go(choices, 0.5, np.random.default_rng(4), "action")
    x, slot = np.nonzero(choices.applicable)
    after = choices.targets[x, slot]
    assert (h[x, slot][choices.goal[after]] == 0).all()
    assert (np.isinf(h[x, slot]) == np.isinf(choices.h[after])).all()
    mistaken = ~choices.goal[after] & np.isfinite(choices.h[after])
    eps = h[x, slot][mistaken] - choices.h[after][mistaken]
    assert len(np.unique(eps.round(9))) == len(
        eps
    )  # a separate value for each choice, although several lead to the same state
    assert len(np.unique(after[mistaken])) < len(eps)
    assert abs(eps.mean()) < 4 * 0.5 / np.sqrt(len(eps))
    assert eps.std() == pytest.approx(0.5, rel=0.15)
    np.testing.assert_array_equal(
        perceived_cost(choices, h)[choices.applicable], (choices.costs + h)[choices.applicable]
    )


def test_the_same_generator_draws_the_same_people(tiny_choices: Choices) -> None:
    """Beta, theta and sigma are drawn first, in this order, then the misconceptions."""
    population = Population(beta=(1.0, 2.0), theta=(0.2, 0.4), sigma=(0.5, 0.7), noise="action")
    person, other = population.sample(tiny_choices, 2, np.random.default_rng(3))
    rng = np.random.default_rng(3)
    assert (person.beta, person.theta, person.sigma) == (
        rng.uniform(1, 2),
        rng.uniform(0.2, 0.4),
        rng.uniform(0.5, 0.7),
    )
    np.testing.assert_array_equal(person.h, perceived_cost_to_go(tiny_choices, person.sigma, rng, "action"))
    assert other.beta == rng.uniform(1, 2)
    with pytest.raises(ValueError, match="read-only"):
        person.h[0, 0] = 0.0


def test_ranges_may_be_a_point_and_reach_their_ends(tiny_choices: Choices) -> None:
    one = Population(beta=(0.0, 0.0), theta=(1.0, 1.0), sigma=(0.0, 0.0)).sample(
        tiny_choices, 1, np.random.default_rng(0)
    )[0]
    assert (one.beta, one.theta, one.sigma) == (0, 1, 0)
    np.testing.assert_array_equal(one.h, tiny_choices.h)


def test_a_population_as_plain_data() -> None:
    ranges = {"beta": [0.0, 3.0], "theta": [0.5, 0.95], "sigma": [0.1, 1.0], "noise": "state"}
    whole = Population(beta=(0, 3))
    assert plain(whole) == ranges
    assert all(type(end) is float for end in whole.beta)
    assert plain(Population(beta=(0, 3), weights={"back": (0, 1)})) == {**ranges, "weights": {"back": [0.0, 1.0]}}

    def uniform(choices: Choices, _q: np.ndarray, beta: np.ndarray) -> np.ndarray:
        return np.broadcast_to(choices.applicable, (len(beta), *choices.applicable.shape)) * 1.0

    assert plain(Population(beta=(0, 3), chooses=uniform)) == {**ranges, "chooses": "uniform"}


def test_a_mixture_draws_from_each_part_by_its_share(tiny_choices: Choices) -> None:
    parts = (
        Population(beta=(0.1, 0.2), theta=(0.6, 0.7), sigma=(0.3, 0.4)),
        Population(beta=(1.0, 2.0), theta=(0.5, 0.9), sigma=(0.0, 0.2)),
        Population(beta=(0.3, 0.4), theta=(0.1, 0.2), sigma=(0.9, 1.0)),
    )
    mixture = Population.mixed(parts, (0.7500005, 0.25, 0.0))  # within rounding of 1
    assert (mixture.beta, mixture.theta, mixture.sigma) == ((0.1, 2.0), (0.1, 0.9), (0.0, 1.0))
    drawn = mixture.sample(tiny_choices, 400, np.random.default_rng(0))
    novices = sum(person.beta <= 0.2 for person in drawn)
    assert len(drawn) == 400
    assert novices == pytest.approx(300, abs=4 * np.sqrt(400 * 0.75 * 0.25))
    assert sum(1 <= person.beta <= 2 and person.sigma <= 0.2 for person in drawn) == 400 - novices


SWITCH = """
(define (domain switch) (:requirements :strips) (:predicates (up) (idle))
  (:action raise :parameters () :precondition (idle) :effect (up))
  (:action stop :parameters () :precondition (idle) :effect (not (idle))))
"""


def test_standing_still_is_the_only_choice_where_nothing_can_be_done(tmp_path: Path) -> None:
    problem = "(define (problem p) (:domain switch) (:init (idle)) (:goal (up)))"
    table = sweep(load(write_instance(tmp_path, SWITCH, problem)))
    space, choices = table.space, Choices.of(table)
    stuck = space.follow(["(stop)"])
    assert np.isinf(choices.h[stuck])
    assert np.flatnonzero(choices.applicable[stuck]).tolist() == [0]
    assert choices.actions[stuck, 0] == WAIT
    assert choices.name(stuck, 0) == "(wait)"
    assert (choices.targets[stuck, 0], choices.costs[stuck, 0]) == (stuck, 1)


def test_a_model_is_of_the_task_or_of_the_person(tiny_choices: Choices) -> None:
    person = Human(1.0, 0.6, 0.5, perceived_cost_to_go(tiny_choices, 0.5, np.random.default_rng(0)))
    known = {"eta": 0.0, "lapse": 0.0, "utility_scale": 2.5}
    for model, h in (
        (HumanModel.exact(tiny_choices, **known), tiny_choices.h),
        (HumanModel.own(tiny_choices, person, **known), person.h),
    ):
        assert model.choices is tiny_choices
        assert (model.eta, model.lapse, model.utility_scale) == (0.0, 0.0, 2.5)
        expected = tiny_choices.costs + h[tiny_choices.targets]
        np.testing.assert_array_equal(model.q[tiny_choices.applicable, 0], expected[tiny_choices.applicable])
        with pytest.raises(ValueError, match="read-only"):
            model.q[0, 0, 0] = 0.0
    for model in (HumanModel.exact(tiny_choices), HumanModel.own(tiny_choices, person)):
        assert (model.eta, model.lapse, model.utility_scale) == (0.2, 1e-3, 1.0)


def test_a_lapse_is_uniform_over_what_each_state_offers() -> None:
    p = np.array([[0.5, 0.5, 0.0], [1.0, 0.0, 0.0]])
    applicable = np.array([[True, True, True], [True, True, False]])
    expected = 0.9 * p + 0.1 * np.array([[1 / 3, 1 / 3, 1 / 3], [1 / 2, 1 / 2, 0.0]])
    np.testing.assert_allclose(lapse(p, applicable, 0.1), expected, atol=1e-15)
