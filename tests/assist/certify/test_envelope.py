"""Bounds with neighbours who see each other: against brute force on tiny tasks, and against simulated policies."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from conftest import thinned
from joint import informed_optimum
from solved import by_hand

from assist.certify import upper_bound
from assist.certify.comparison import Comparison
from assist.certify.envelope import Envelope
from assist.people import Choices, Goals, Population, Reliability
from assist.people.neighbours import Neighbours, SeenEvent, SeenFollowed, SeenOutcome, SeenRule, SeenSteps
from assist.person import Setting, truncated_bound
from assist.team.pool import Pool
from planner import OnDemand, Table, sweep_goals

# A way back at each step; and a longer one.
TASKS = {
    "two steps": by_hand([[1, 0], [2, 0], []], [2.0, 1.0, 0.0]),
    "three steps": by_hand([[1, 0], [2, 0], [3, 1], []], [3.0, 2.0, 1.0, 0.0]),
}
RULES = {"outcome": SeenOutcome(0.3), "followed": SeenFollowed(0.2, 0.1), "steps": SeenSteps(1.0, 1.5)}


PEOPLE = Population(beta=(0.6, 0.6), theta=(0.3, 0.8))


def pool_of(task: Choices | Table | OnDemand | Goals, rule: SeenRule, **fields: object) -> Pool:
    given = {"c_suggest": 0.2, "c_move": 0.1, "gamma": 0.9, "knowledge": "exact"} | fields
    setting = Setting(neighbours=Neighbours(rule=rule, matrix=((0, 0.9), (0.6, 0))), **given)  # type: ignore[arg-type]
    return Pool.sample(task, 2, seed=1, setting=setting, population=PEOPLE)


@pytest.mark.parametrize("task", thinned(TASKS))
def test_the_bound_is_at_least_the_optimum_with_theta_in_sight(task: str) -> None:
    pool = pool_of(TASKS[task], SeenOutcome(0.5), c_suggest=0.05, c_move=0.02, eta=0.0)
    optimum, bound = informed_optimum(pool), upper_bound(pool, [0, 1])
    assert optimum - 1e-6 <= bound.upper <= optimum + 0.1 * abs(optimum)
    # A bound without what they see would be too low: the test can fail.
    alone = Pool.sample(TASKS[task], 2, seed=1, setting=replace(pool.setting, neighbours=None), population=PEOPLE)
    assert upper_bound(alone, [0, 1]).upper_seen < optimum


@pytest.mark.parametrize("case", thinned(itertools.product(RULES, (1, 2)), 3), ids=str)
def test_no_simulated_policy_exceeds_the_bound(tiny: Table, case: tuple[str, int]) -> None:
    rule, robots = case
    pool = pool_of(tiny, RULES[rule], robots=robots)
    bound = upper_bound(pool, [0, 1])
    for name in ("attention", "attention-outlook", "priority"):
        found = bound.certify(name, episodes=200)
        assert found.value - 3 * found.value_stderr <= bound.upper


def test_values_are_lifted_to_the_largest_within_the_envelope(tiny: Table) -> None:
    pool = pool_of(tiny, SeenFollowed(0.2, 0.1), robots=2)
    envelope = Envelope.of(pool, (0, 1), (0,))
    assert isinstance(envelope, Envelope)
    reach = envelope.reach
    theta, value = reach.grid.theta, np.random.default_rng(1).normal(size=(3, 2, 10))
    np.testing.assert_allclose(reach.high[2], np.clip(theta + 0.36, 0, 1))
    np.testing.assert_allclose(reach.low[1], np.clip(theta - 0.09, 0, 1))
    fine = np.linspace(0, 1, 1801)
    for events in range(3):
        lifted = reach.lifted(value, events)
        for x, h, t in np.ndindex(value.shape):
            within = fine[(fine >= reach.low[events, t] - 1e-9) & (fine <= reach.high[events, t] + 1e-9)]
            assert lifted[x, h, t] == pytest.approx(np.interp(within, theta, value[x, h]).max(), abs=1e-9)


def test_sweeps_end_with_the_time_and_their_values_are_bounds(tiny: Table, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of the first answer and the bound does one sweep and one look-ahead for each set of values."""
    sweeps, backup = list[int](), Envelope._q

    def counted(self: Envelope, visits: Any, value: np.ndarray, states: np.ndarray) -> np.ndarray:
        sweeps.append(len(states))
        return backup(self, visits, value, states)

    pool = pool_of(tiny, SeenFollowed(0.2, 0.1))
    limits = {"window": 0, "episodes": 2, "seed": 1, "progress": lambda *_: None, "first": lambda _: None}
    whole = Comparison.of(pool, {}, time_limit=None, **limits)  # type: ignore[arg-type]
    monkeypatch.setattr(Envelope, "_q", counted)
    hurried = Comparison.of(pool, {}, time_limit=1e-9, **limits)  # type: ignore[arg-type]
    assert len(sweeps) == 2 + 2 * 2
    assert whole.bound.upper < hurried.bound.upper < 0.8 * whole.bound.upper
    found = whole.bound.certify("attention", episodes=50)  # nothing is known of how far a search would lower it
    assert found.slack_percent == found.gap_percent > 0


@dataclass(frozen=True)
class Boundless:
    """A rule that does not say how far theta can come."""

    def update(self, theta: np.ndarray, event: SeenEvent) -> np.ndarray:
        return np.clip(theta + event.weight * event.gain, 0, 1)


class Jumps(Boundless):
    """A rule after which those who trust little trust most."""

    def update(self, theta: np.ndarray, event: SeenEvent) -> np.ndarray:  # noqa: ARG002
        return np.where(theta < 0.5, 1.0, theta)

    def envelope(self, theta: np.ndarray, gain: tuple[float, float], weight: float) -> tuple[np.ndarray, np.ndarray]:  # noqa: ARG002
        return theta, np.where(theta < 0.5, 1.0, theta)


@dataclass(frozen=True)
class Falls:
    """A rule by which theta falls whatever is seen: its envelope leaves out who sees nothing."""

    def update(self, theta: np.ndarray, event: SeenEvent) -> np.ndarray:
        return np.maximum(theta - 0.4 * event.weight, 0)

    def envelope(self, theta: np.ndarray, gain: tuple[float, float], weight: float) -> tuple[np.ndarray, np.ndarray]:  # noqa: ARG002
        return np.maximum(theta - 0.4 * weight, 0), np.maximum(theta - 0.2 * weight, 0)


def test_who_sees_nothing_in_a_step_keeps_their_theta() -> None:
    pool = pool_of(TASKS["three steps"], Falls(), c_suggest=0.0, c_move=0.0, trust="constant")
    optimum, bound = informed_optimum(pool), upper_bound(pool, [0, 1])
    assert optimum - 1e-6 <= bound.upper
    envelope = Envelope.of(pool_of(TASKS["three steps"], Falls(), robots=2), (0, 1), (0,))
    assert isinstance(envelope, Envelope)
    reach = envelope.reach
    assert (reach.high == reach.grid.theta).all()
    np.testing.assert_allclose(reach.low[2], np.maximum(reach.grid.theta - 2 * 0.36, 0))


class Tilts(Boundless):
    """A rule whose envelope rises on the grid of theta, and falls between its points, where it comes by two events."""

    def envelope(self, theta: np.ndarray, gain: tuple[float, float], weight: float) -> tuple[np.ndarray, np.ndarray]:  # noqa: ARG002
        on_grid = np.isclose(theta * 9, np.round(theta * 9))
        return theta, np.minimum(theta + np.where(on_grid, 0.2, 0.0), 1.0)

    def update(self, theta: np.ndarray, event: SeenEvent) -> np.ndarray:  # noqa: ARG002
        return theta


def test_an_envelope_rises_wherever_it_is_used(tiny: Table) -> None:
    assert isinstance(Envelope.of(pool_of(tiny, Tilts()), (0, 1), (0,)), Envelope)
    with pytest.raises(ValueError, match="the envelope of Tilts falls somewhere as theta rises"):
        Envelope.of(pool_of(tiny, Tilts(), robots=2), (0, 1), (0,))


def test_refusals(tiny: Table) -> None:
    with pytest.raises(ValueError, match="the envelope of Jumps falls somewhere as theta rises; a bound expects"):
        upper_bound(pool_of(tiny, Jumps()), [0, 1], time_limit=3)
    with pytest.raises(ValueError, match="Boundless does not say how far theta can come; a bound expects a rule"):
        upper_bound(pool_of(tiny, Boundless()), [0, 1], time_limit=3)
    with pytest.raises(ValueError, match="paths 4: expected 0, as sample paths do not have what people see"):
        upper_bound(pool_of(tiny, SeenFollowed()), [0, 1], time_limit=3, paths=4)


def test_a_bound_holds_for_a_rule_that_counts_outcomes(tiny: Table) -> None:
    """The grid of theta repeats for each count, where it falls from 1 to 0."""
    trust = Reliability(weight=3.0, counts=2)
    bound = upper_bound(pool_of(tiny, SeenFollowed(), trust=trust), [0, 1], window=0)
    value = bound.certify("attention", episodes=100)
    assert value.value - 4 * value.value_stderr <= bound.proven


@pytest.mark.parametrize("rule", thinned(RULES))
def test_a_bound_on_a_part_is_one_of_the_task(tiny: Table, rule: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where gains move theta, those of a part may have any size; otherwise all of the task has the task's bound."""
    whole, bounds = pool_of(tiny, RULES[rule]), list[float]()
    exact = upper_bound(whole, [0, 1], window=0).upper
    for task, size in ((tiny, 3), (tiny, 8), (OnDemand(tiny.task, jobs=1), 12), (tiny, 10_000)):
        monkeypatch.setattr(truncated_bound, "SIZES", replace(truncated_bound.SIZES, hidden=size, hidden_least=size))
        pool = Pool.sample(task, 2, seed=1, setting=whole.setting, population=PEOPLE, states=1)
        bounds.append(upper_bound(pool, [0, 1], window=0).upper)
    assert min(bounds) > exact - 1e-9
    assert sorted(bounds, reverse=True) == pytest.approx(bounds, abs=1e-9)
    assert (bounds[-1] == pytest.approx(exact, abs=1e-4)) == (rule != "outcome")


def test_the_bound_holds_with_several_goals(tiny: Table) -> None:
    (one, first), (two, second) = tiny.task.goal[-2:]
    other = replace(tiny.task, goal=(*tiny.task.goal[:-2], (one, second), (two, first)))  # the slots change places
    goals = Goals(dict(zip(("own", "other"), sweep_goals([tiny.task, other]), strict=True)), {"own": 0.6, "other": 0.4})
    pool = pool_of(goals, SeenOutcome(0.3), c_suggest=0.05)
    bound = upper_bound(pool, [0, 1], window=0)
    for name in ("attention-outlook", "priority"):
        found = bound.certify(name, episodes=200)
        assert found.value - 3 * found.value_stderr <= bound.upper
