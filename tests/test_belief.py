"""Beliefs against brute-force enumeration of everything that could have happened."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from assist.people.belief import Grid, ImpossibleObservationError, update
from assist.people.choices import Choices
from assist.people.decision import choice, influence, lapse, perceived_cost_to_go, trust
from assist.people.human import Human, HumanModel, Population
from assist.person.pomdp import AssistPOMDP
from assist.person.qmdp import qmdp
from planner import Table

GRID = Grid(np.array([0.2, 1.0, 2.5]), np.array([0.0, 0.3, 0.7, 1.0]))


def person(choices: Choices) -> HumanModel:
    h = perceived_cost_to_go(choices, 0.7, np.random.default_rng(5))
    return HumanModel.own(choices, Human(1.0, 0.6, 0.7, h))


def enumerate_posterior(pomdp: AssistPOMDP, history: list[tuple[int, int, int]]) -> np.ndarray:
    """Sum over every beta and every sequence of theta's grid points, straight from the model's equations."""
    model, grid = pomdp.model, pomdp.grid
    c = model.choices
    value = np.where(c.goal, 0.0, -model.q.min(axis=1))
    steps = len(history)
    posterior = np.zeros(grid.shape)
    for b, path in product(range(grid.shape[0]), product(range(grid.shape[1]), repeat=steps + 1)):
        weight = pomdp.prior[b, path[0]]
        for (x, robot, action), before, after in zip(history, path, path[1:], strict=False):
            suggestion = int(pomdp.suggested[x, robot])
            p = choice(model.q[x], c.applicable[x], grid.beta[b])
            p = lapse(influence(p, suggestion, grid.theta[before]), c.applicable[x], model.lapse)
            weight *= p[action]
            theta = grid.theta[before]
            if suggestion >= 0:
                theta = float(trust(theta, value[x], value[c.targets[x, suggestion]], model.eta))
            # Probability of the grid point after: the hat function that peaks there.
            hat = np.interp(theta, grid.theta, np.eye(grid.shape[1])[after])
            weight *= hat
        posterior[b, path[-1]] += weight
    return posterior / posterior.sum()


@pytest.mark.parametrize("seed", range(6))
def test_belief_equals_brute_force_enumeration(tiny_choices: Choices, seed: int) -> None:
    rng = np.random.default_rng(seed)
    pomdp = AssistPOMDP.of(person(tiny_choices), grid=GRID, suggestions="all")
    x, history = tiny_choices.initial, []
    belief = pomdp.prior[None]
    for _ in range(4):
        robot = int(rng.integers((pomdp.suggested[x] >= 0).sum() + 1))
        action = int(rng.choice(np.flatnonzero(tiny_choices.applicable[x])))
        history.append((x, robot, action))
        belief = pomdp.update(belief, np.array([x]), np.array([robot]), np.array([action]))
        x = int(tiny_choices.targets[x, action])
    np.testing.assert_allclose(belief[0], enumerate_posterior(pomdp, history), rtol=0, atol=1e-12)


def test_a_person_who_acts_against_every_expectation_keeps_a_belief(tiny: Table, tiny_choices: Choices) -> None:
    """Two hundred times the choice that the model holds least likely, with the right action suggested each time."""
    pomdp = AssistPOMDP.of(person(tiny_choices))
    x = tiny.space.follow(["(fetch box-a)"])
    belief = pomdp.prior[None]
    for _ in range(200):
        slots = np.flatnonzero(tiny_choices.applicable[x])
        at = np.full(len(slots), x)
        likely = pomdp.likelihood(at, np.ones_like(at), slots)
        action = slots[np.einsum("abt,bt->a", likely, belief[0]).argmin()]
        belief = pomdp.update(belief, np.array([x]), np.array([1]), np.array([action]))
        assert np.isfinite(belief).all()
        assert (belief >= 0).all()
        assert belief.sum() == pytest.approx(1, abs=1e-12)
        x = int(tiny_choices.targets[x, action])
        if tiny_choices.goal[x]:
            x = tiny_choices.initial
    assert belief[0].sum(axis=1).argmax() == 0  # the least expert


def test_without_lapses_an_impossible_observation_is_an_error() -> None:
    with pytest.raises(ImpossibleObservationError, match="lapse rate"):
        update(np.full((1, 3, 4), 1 / 12), np.zeros((1, 3, 4)), np.zeros((1, 4), dtype=int), np.zeros((1, 4)))


def test_watching_an_expert_and_a_novice(tiny_choices: Choices) -> None:
    """Simulated actions without suggestions: the belief finds beta and leaves theta alone."""
    grid = Grid.regular(Population())
    for beta, k in ((0.1, 0), (2.8, 5)):
        pomdp = AssistPOMDP.of(HumanModel.exact(tiny_choices), grid=grid)
        rng = np.random.default_rng(1)
        belief, x = pomdp.prior[None], tiny_choices.initial
        for _ in range(300):
            p = choice(pomdp.model.q[x], tiny_choices.applicable[x], beta)
            action = int(rng.choice(len(p), p=p))
            belief = pomdp.update(belief, np.array([x]), np.array([0]), np.array([action]))
            x = int(tiny_choices.targets[x, action])
            x = tiny_choices.initial if tiny_choices.goal[x] else x
        assert belief[0].sum(axis=1).argmax() == k
        np.testing.assert_allclose(belief[0].sum(axis=0), pomdp.prior.sum(axis=0), atol=1e-12)


@given(
    st.tuples(st.floats(0.1, 3), st.floats(0.1, 3)).map(sorted), st.tuples(st.floats(0, 1), st.floats(0, 1)).map(sorted)
)
def test_prior_is_a_distribution_with_the_populations_mean_theta(beta: list[float], theta: list[float]) -> None:
    grid = Grid.regular(Population())
    prior = grid.prior(Population(beta=(beta[0], beta[1]), theta=(theta[0], theta[1])))
    assert prior.shape == (6, 10)
    assert (prior >= 0).all()
    assert prior.sum() == pytest.approx(1)
    assert prior.sum(axis=0) @ grid.theta == pytest.approx((theta[0] + theta[1]) / 2)


@given(st.floats(0, 1))
def test_sharing_keeps_theta(theta: float) -> None:
    low, weight = GRID.shares(theta)
    assert 0 <= weight <= 1
    assert (1 - weight) * GRID.theta[low] + weight * GRID.theta[low + 1] == pytest.approx(theta, abs=1e-12)


@pytest.mark.parametrize(
    ("beta", "theta"), [([1.0, 0.5], [0, 1]), ([], [0, 1]), ([1.0], [0.5]), ([1.0], [0.1, 1]), ([-1.0], [0, 1])]
)
def test_a_grid_is_checked(beta: list[float], theta: list[float]) -> None:
    with pytest.raises(ValueError, match="expected"):
        Grid(np.array(beta), np.array(theta, dtype=float))


def test_chances_sum_to_one_where_the_person_is_almost_certain(tiny_choices: Choices) -> None:
    """With theta = 0 what is suggested is out of the question, however small the chance of anything else was."""
    grid = Grid(np.array([4.0, 8.0, 12.0]), np.array([0.0, 0.5, 1.0]))
    pomdp = AssistPOMDP.of(HumanModel.exact(tiny_choices), grid=grid, suggestions="all")
    x, robot = np.nonzero(np.arange(pomdp.suggested.shape[1]) < pomdp.robot_actions[:, None])
    x, robot = x[~tiny_choices.goal[x]], robot[~tiny_choices.goal[x]]
    total = np.zeros((len(x), *grid.shape))
    for slot in range(tiny_choices.applicable.shape[1]):
        there = tiny_choices.applicable[x, slot]
        total[there] += pomdp.likelihood(x[there], robot[there], np.full(there.sum(), slot))
    np.testing.assert_allclose(total, 1, rtol=1e-13)


def test_where_nothing_moves_trust_suggestions_into_dead_ends_do_not_either(sealed: Table) -> None:
    """Eta 0 and a value of minus infinity: nobody's belief is lost, and nothing is suggested that only does harm."""
    choices = Choices.of(sealed)
    problem = AssistPOMDP.of(HumanModel.exact(choices, eta=0.0), suggestions="all")
    slot = np.maximum(problem.suggested, 0)
    into = (problem.suggested >= 0) & np.isinf(choices.h[np.take_along_axis(choices.targets, slot, axis=1)])
    alive = np.isfinite(choices.h) & ~choices.goal
    assert (into[alive].any(axis=1)).sum() > 50
    expected = np.broadcast_to(problem.grid.theta, problem.weight.shape)
    at = problem.grid.theta[problem.low]
    np.testing.assert_allclose(at + problem.weight * (problem.grid.theta[problem.low + 1] - at), expected, atol=1e-12)
    best, x = qmdp(problem), np.flatnonzero(alive)
    for theta in range(problem.grid.shape[1]):
        belief = np.zeros((len(x), *problem.grid.shape))
        belief[:, :, theta] = 1 / problem.grid.shape[0]
        assert not into[x, best.choose(x, belief)].any()
