"""Grids of beta and theta, priors and intervals by hand, and compiled filters beside the equations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from silence import Rested

from assist.live.live_task import LiveTask
from assist.people.belief import Grid, ImpossibleObservationError, update
from assist.people.choices import Choices
from assist.people.hidden_type import HiddenType
from assist.people.human import Human, HumanModel
from assist.people.misconception import perceived_cost_to_go
from assist.people.ranges import Population, advice_takers
from assist.people.spread import Spread
from assist.people.trust_rules import EquationSeven, Reliability, TrustRule, constant, outcome, outcome_at_disagreement
from assist.person.behaviour import Behaviour
from assist.person.belief_filter import child, new_parts, posterior, split
from assist.person.belief_filter import update as compiled_update
from assist.person.pomdp import AssistPOMDP
from assist.person.problem_arrays import ProblemArrays
from assist.person.qmdp import qmdp
from assist.person.robots import OfRobots
from assist.person.settings import Setting
from planner import Table

GRID = Grid(np.array([0.2, 1.0, 2.5]), np.array([0.0, 0.3, 0.7, 1.0]))


def person(choices: Choices) -> HumanModel:
    h = perceived_cost_to_go(choices, 0.7, np.random.default_rng(5))
    return HumanModel.own(choices, Human(1.0, 0.6, 0.7, h))


def test_a_person_who_acts_against_every_expectation_keeps_a_belief(tiny: Table, tiny_choices: Choices) -> None:
    """The person makes the least likely choice two hundred times, against the right suggestion."""
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
    likelihood = np.array([[[1.0, 0.0]], [[0.0, 1.0]], [[0.0, 0.0]]])
    belief, nowhere = np.array([[[0.5, 0.5]], [[1.0, 0.0]], [[0.5, 0.5]]]), np.zeros((3, 2))
    message = r"row 1: the observation has probability 0 under the belief \[\[1.0, 0.0\]\]; a lapse rate above 0"
    with pytest.raises(ImpossibleObservationError, match=message):
        update(belief, likelihood, nowhere.astype(int), nowhere)
    likelihood[1] = np.nan
    with pytest.raises(ImpossibleObservationError, match="row 1: the observation has probability nan"):
        update(belief, likelihood, nowhere.astype(int), nowhere)


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


def test_a_grid_with_counts_by_hand() -> None:
    """Two goals, two values of beta and of theta, and up to two outcomes."""
    grid = Grid(np.array([1, 2]), np.array([0, 1])).with_counts(2)
    assert grid.beta.dtype == grid.theta.dtype == float
    assert (grid.theta.tolist(), grid.values.tolist(), grid.shape) == ([0, 1, 0, 1, 0, 1], [0, 1], (2, 6))
    assert grid.count.tolist() == [0, 0, 1, 1, 2, 2]
    low, weight = grid.shares([0.25, 1.0, 0.5], [2, 1, 0])
    assert (low.tolist(), weight.tolist()) == ([4, 2, 0], [0.25, 1.0, 0.5])
    prior = grid.prior(Population(beta=(2.0, 2.0), theta=(0.25, 0.25)))
    assert prior.tolist() == [[0] * 6, [0.75, 0.25, 0, 0, 0, 0]]
    belief = np.zeros((4, 6))
    belief[[0, 1, 2, 3], [1, 3, 5, 4]] = 0.1, 0.2, 0.3, 0.4  # theta is 1, 1, 1 and 0
    hidden = HiddenType({"one": 0.5, "other": 0.5}, grid.beta)
    beta, theta = grid.spreads(belief, hidden)
    assert (beta.mean, theta.mean) == pytest.approx((1.6, 0.6))
    assert grid.spreads(np.eye(1, 24, 5).reshape(4, 6), hidden)[1] == Spread(1.0, pytest.approx(0.525), 1.0)


def test_a_regular_grid_has_the_middles_of_equal_cells() -> None:
    population = Population(beta=(1.0, 4.0))
    grid = Grid.regular(population, betas=3, thetas=5)
    assert grid.beta.tolist() == [1.5, 2.5, 3.5]
    assert grid.theta.tolist() == [0, 0.25, 0.5, 0.75, 1]
    assert Grid.regular(population).shape == (6, 10)
    assert Grid.regular(Population(beta=(2.0, 2.0))).beta.tolist() == [2]
    two = Population.mixed((Population(beta=(0.0, 1.0)), Population(beta=(2.0, 3.0))), (0.5, 0.5))
    assert Grid.regular(two, betas=3).beta.tolist() == [0.5, 1.5, 2.5]


def test_shares_by_hand() -> None:
    low, weight = GRID.shares([0.0, 0.15, 0.3, 0.4, 0.7, 1.0, -0.2, 1.2])
    assert low.tolist() == [0, 0, 1, 1, 2, 2, 0, 2]
    np.testing.assert_allclose(weight, [0, 0.5, 0, 0.25, 0, 1, 0, 1], atol=1e-15)
    assert low.dtype == np.int64


@pytest.mark.parametrize(
    ("beta", "expected"),
    [((0.2, 1.0), [0.5, 0.5, 0]), ((1.0, 2.5), [0, 0.5, 0.5]), ((0.0, 3.0), [1 / 3, 1 / 3, 1 / 3]),
     ((1.2, 1.6), [0, 1, 0]), ((0.5, 0.9), [0, 1, 0]), ((0.3, 0.5), [1, 0, 0]), ((2.6, 9.0), [0, 0, 1])],
)  # fmt: skip
def test_a_prior_of_beta_by_hand(beta: tuple[float, float], expected: list[float]) -> None:
    """The prior is uniform over the grid's values 0.2, 1 and 2.5 that are in the range.

    If none is, it is the value nearest to the middle of the range.
    """
    prior = GRID.prior(Population(beta=beta))
    np.testing.assert_allclose(prior.sum(axis=1), expected, atol=1e-15)


@pytest.mark.parametrize(
    ("theta", "expected"),
    [((0.3, 0.7), [0, 1 / 2, 1 / 2, 0]), ((0.0, 0.7), [3 / 14, 1 / 2, 2 / 7, 0]), ((0.4, 0.4), [0, 0.75, 0.25, 0]),
     ((1.0, 1.0), [0, 0, 0, 1]), ((0.4, 0.6), [0, 1 / 2, 1 / 2, 0]), ((0.1, 0.5), [1 / 6, 17 / 24, 1 / 8, 0])],
)  # fmt: skip
def test_a_prior_of_theta_by_hand(theta: tuple[float, float], expected: list[float]) -> None:
    """Grid values divide the range into pieces; each is split between its two neighbours, linearly at its middle."""
    prior = GRID.prior(Population(theta=theta))
    np.testing.assert_allclose(prior.sum(axis=0), expected, atol=1e-15)
    np.testing.assert_allclose(prior, np.outer(prior.sum(axis=1), expected), atol=1e-15)


def test_a_prior_of_a_mixture_is_the_mixture_of_priors() -> None:
    novices, experts = Population(beta=(0.2, 0.2), theta=(0.0, 0.0)), Population(beta=(2.5, 2.5), theta=(1.0, 1.0))
    prior = GRID.prior(Population.mixed((novices, experts), (0.25, 0.7500005)))  # rounded shares from a file
    assert prior.sum() == pytest.approx(1, abs=1e-15)
    assert prior[0, 0] == pytest.approx(0.25, abs=1e-6)
    assert prior[2, 3] == pytest.approx(0.75, abs=1e-6)


def test_where_a_distribution_lies() -> None:
    """The cells of 1, 2, 4 and 5 end at 0.5, 1.5, 3, 4.5 and 5.5."""
    values = np.array([1.0, 2.0, 4.0, 5.0])
    assert Spread.of(values, np.full(4, 0.25)) == Spread(3.0, pytest.approx(0.7), pytest.approx(5.3))
    assert Spread.of(values, np.array([0.0, 0.5, 0.5, 0.0])) == Spread(3.0, pytest.approx(1.65), pytest.approx(4.35))
    assert Spread.of(values, np.array([0.05, 0.45, 0.45, 0.05])) == Spread(3.0, pytest.approx(1.5), pytest.approx(4.5))
    assert Spread.of(values, np.full(4, 0.25), level=0) == Spread(3.0, pytest.approx(3.0), pytest.approx(3.0))
    assert Spread.of(values, np.full(4, 0.25), level=1) == Spread(3.0, 0.5, 5.5)
    # Nearly all mass is at one value, and the rest so far away that the mean is beyond the 90 % quantile.
    far = Spread.of(np.array([1.0, 2.0, 3.0, 1000.0]), np.array([0.0, 0.97, 0.0, 0.03]))
    assert far == Spread(pytest.approx(31.94), pytest.approx(1.5 + 0.05 / 0.97), pytest.approx(31.94))
    nobody = Spread.of(values, np.array([0.5, np.nan, 0.25, 0.25]))
    assert np.isnan([nobody.mean, nobody.low, nobody.high]).all()
    assert Spread.of(np.array([0.7]), np.array([1.0])) == Spread(0.7, 0.7, 0.7)
    with pytest.raises(ValueError, match="from 0 to 1"):
        Spread.of(values, np.full(4, 0.25), level=1.5)


def test_cells_of_a_geometric_sequence_are_even_in_the_logarithm() -> None:
    found = Spread.of(np.geomspace(0.1, 10, 5), np.array([0.0, 0.0, 1.0, 0.0, 0.0]))
    assert (found.low, found.high) == pytest.approx((10**-0.225, 10**0.225))
    assert Spread.of(np.geomspace(0.1, 10, 5), np.full(5, 0.2), level=1).low == pytest.approx(10**-1.25)


@st.composite
def distributions(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray, tuple[float, float]]:
    """Draw values, probabilities and limits as in beliefs: grids of beta, geometric ones, and grids of theta."""
    steps = draw(st.lists(st.floats(0.01, 1.0), min_size=1, max_size=9))
    values, limits = np.cumsum([draw(st.sampled_from([0.0, 0.1, 1.0])), *steps]), (0.0, np.inf)
    kind = draw(st.sampled_from(["beta", "geometric", "theta"]))
    if kind == "geometric":
        values = np.geomspace(0.01, 10 ** draw(st.floats(-1, 2)), len(values))
    elif kind == "theta":
        values, limits = (values - values[0]) / (values[-1] - values[0]), (0.0, 1.0)
    some = st.one_of(st.floats(0, 1), st.sampled_from([0.0, 0.0, 1.0, 30.0]))
    chances = np.array(draw(st.lists(some, min_size=len(values), max_size=len(values)).filter(lambda c: sum(c) > 1e-6)))
    return values, chances / chances.sum(), limits


@given(distributions(), st.floats(0, 1), st.floats(0, 1))
def test_an_interval_has_the_mean_and_grows_with_its_level(
    distribution: tuple[np.ndarray, np.ndarray, tuple[float, float]], one: float, other: float
) -> None:
    values, chances, limits = distribution
    middle = Spread.of(values, chances, level=0, limits=limits)
    inner, outer = (Spread.of(values, chances, level=level, limits=limits) for level in sorted([one, other]))
    assert limits[0] <= outer.low <= inner.low + 1e-12
    assert inner.high - 1e-12 <= outer.high <= limits[1]
    assert inner.low <= inner.mean <= inner.high
    # At level 0 it is what lies between mean and median.
    assert inner.low - 1e-12 <= middle.low <= middle.high <= inner.high + 1e-12


@given(distributions(), st.floats(0, 1))
def test_an_interval_shrinks_with_information(
    distribution: tuple[np.ndarray, np.ndarray, tuple[float, float]], share: float
) -> None:
    """On an even grid, when a share of the belief goes over to the value that is already in the middle.

    The mean may be at a limit, which is the end of a cell. The interval is extended to it, by a twentieth of a cell.
    """
    _, chances, limits = distribution
    even = np.linspace(0, 1, len(chances)) if limits[1] == 1 else 0.1 + np.arange(len(chances))
    sure = np.eye(len(even))[np.searchsorted(chances.cumsum(), 0.5)]
    widths = []
    for belief in (chances, (1 - share) * chances + share * sure, sure):
        found = Spread.of(even, belief, limits=limits)
        widths.append(found.high - found.low)
    slack = 1e-9 + 0.05 * (even[1] - even[0])
    assert widths[2] - slack <= widths[1] <= widths[0] + slack
    assert widths[2] <= 0.95 * (even[1] - even[0]) + 1e-9


def test_chances_sum_to_one_where_the_person_is_almost_certain(tiny_choices: Choices) -> None:
    """With theta = 0 the suggestion is never followed, however unlikely the other actions are."""
    grid = Grid(np.array([4.0, 8.0, 12.0]), np.array([0.0, 0.5, 1.0]))
    pomdp = AssistPOMDP.of(HumanModel.exact(tiny_choices), grid=grid, suggestions="all")
    x, action = np.nonzero(np.arange(pomdp.suggested.shape[1]) < pomdp.robot_actions[:, None])
    x, action = x[~tiny_choices.goal[x]], action[~tiny_choices.goal[x]]
    total = np.zeros((len(x), *grid.shape))
    for slot in range(tiny_choices.applicable.shape[1]):
        there = tiny_choices.applicable[x, slot]
        total[there] += pomdp.likelihood(x[there], action[there], np.full(there.sum(), slot))
    np.testing.assert_allclose(total, 1, rtol=1e-13)


def test_where_nothing_moves_trust_suggestions_into_dead_ends_do_not_either(sealed: Table) -> None:
    """With eta 0 and a value of minus infinity, beliefs stay valid, and harmful suggestions are not made."""
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


@settings(deadline=None)
@given(
    st.integers(0, 10**6),
    st.sampled_from(
        [
            EquationSeven(0.3),
            constant(),
            outcome(0.5, 1.0),
            outcome_at_disagreement(0.2, 0.5, 1.0),
            Reliability(2, 0.1, 2),
            Rested(),
        ]
    ),
    st.sampled_from([0.0, 1e-3, 0.3]),
    st.booleans(),
)
def test_compiled_filters_are_the_equations(
    tiny_choices: Choices, seed: int, rule: TrustRule, lapse: float, execute: bool
) -> None:
    """One choice at a time, all choices at a time, and numpy give the same posterior and the same probability.

    The person's misconceptions, the grid, the belief and the robot action are random.
    """
    rng = np.random.default_rng(seed)
    h = perceived_cost_to_go(tiny_choices, 0.7, rng)
    betas, thetas = np.sort(rng.uniform(0, 3, rng.integers(1, 5))), np.sort(rng.random(rng.integers(0, 6)))
    grid = Grid(betas, np.array([0.0, *thetas, 1.0]))
    pomdp = AssistPOMDP.of(
        HumanModel.own(tiny_choices, Human(1.0, 0.6, 0.7, h), lapse=lapse), grid=grid, suggestions="all",
        behaviour=Behaviour(trust=rule), robot=OfRobots(execute=execute),
    )  # fmt: skip
    m = ProblemArrays.of(pomdp)
    x = int(rng.choice(np.flatnonzero(~tiny_choices.goal)))
    action = int(rng.integers(pomdp.robot_actions[x]))
    belief = rng.dirichlet(np.full(pomdp.prior.size, 0.3))
    belief[(rng.random(len(belief)) < 0.2) & (belief < belief.max())] = 0.0
    belief /= belief.sum()
    parts = new_parts(len(belief), m.uses_answer)
    acting, suggested = split(parts, belief, x, action, m)
    if tiny_choices.goal[acting]:
        return
    for slot in range(int(m.counts[acting])):
        one, of_all = np.empty_like(belief), np.empty_like(belief)
        mass = posterior(belief, one, x, action, slot, m)
        same = child(of_all, acting, slot, suggested, parts, m)
        assert same == pytest.approx(mass, rel=1e-12)
        at = tuple(np.array([each]) for each in (x, action, slot))
        likelihood = pomdp.likelihood(*at)[0].ravel()
        assert mass == pytest.approx(likelihood @ belief, abs=1e-12)
        np.testing.assert_allclose(one, of_all, atol=1e-12)
        if mass > 0:
            expected = pomdp.update(belief.reshape(1, *pomdp.grid.shape), *at)[0]
            np.testing.assert_allclose(one / mass, expected.ravel(), atol=1e-12)
            now = belief.copy()
            compiled_update(now, np.empty_like(now), x, action, slot, m)
            np.testing.assert_allclose(now, expected.ravel(), atol=1e-12)


def test_a_belief_does_not_depend_on_where_it_is_in_memory(tiny: Table) -> None:
    """Sessions have the same beliefs after a restart, bit for bit."""
    policy = LiveTask(tiny, Setting(c_suggest=0.05).for_real_people(), advice_takers()).policy
    arrays, prior = policy.arrays, policy.pomdp.prior
    before = np.random.default_rng(0).dirichlet(np.ones(prior.size)).reshape(prior.shape)
    silent = np.full_like(arrays.suggested, -1)
    silent.flags.writeable = False
    memory, found = np.zeros(1000), set()
    for gap in range(80):
        for first in (0, prior.size + gap):  # the belief is before the work array, or behind it
            at = prior.size + gap - first
            belief, after = (memory[begin : begin + prior.size] for begin in (first, at))
            belief[:] = before.ravel()
            compiled_update(belief, after, 0, 0, 0, arrays._replace(suggested=silent))
            found.add(belief.tobytes())
    assert len(found) == 1
