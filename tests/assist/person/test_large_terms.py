"""People whose choices have terms, on tasks of any size: what is computed pair by pair is that of all pairs."""

from __future__ import annotations

from random import Random
from typing import Any

import numpy as np
import pytest
from conftest import kit, thinned

from assist.certify import BoundOptions, upper_bound
from assist.live import Assistant
from assist.people import Population
from assist.person import PersonProblem, Setting, person_problem, solve
from assist.team import Pool, simulate
from planner import OnDemand, Table

EVERYTHING = 10**6  # states of a region
HABITS = Population(
    weights={"goals": (0.2, 0.6), "arguments": (0.5, 1.5), "name": (0.1, 0.4), "back": (-1.0, -0.5)}
)  # fmt: skip


def pools(table: Table, monkeypatch: pytest.MonkeyPatch, **options: Any) -> tuple[Pool, Pool]:
    """The same people, on all pairs and on those where somebody has been."""
    sample = {"seed": 1, "population": HABITS, **options}
    whole = Pool.sample(table, 3, **sample)
    with monkeypatch.context() as within:
        within.setattr("assist.team.solving.MAX_ENUMERATED", 1)
        return whole, Pool.sample(table, 3, **{"region": EVERYTHING, **sample})


@pytest.mark.parametrize("knowledge", thinned(["own", "exact"]))
@pytest.mark.parametrize("prior", thinned([None, Population()]))
@pytest.mark.parametrize("task", thinned(["tiny", "sealed"]))
def test_episodes_with_terms_are_those_of_the_whole_task(
    task: str, prior: Any, knowledge: Any, monkeypatch: Any
) -> None:
    setting = Setting(c_suggest=0.1, c_move=0.1, knowledge=knowledge)
    both = pools(kit(task), monkeypatch, setting=setting, prior=prior)
    for policy in ("none", "attention", "priority"):
        one, other = (simulate(pool, policy, humans=2, episodes=8, seed=3) for pool in both)
        np.testing.assert_array_equal(one.actions, other.actions)
        np.testing.assert_allclose(one.discounted_return, other.discounted_return, rtol=0, atol=1e-9)
        assert (policy == "none") == (not one.interventions.any())


@pytest.mark.parametrize("task", thinned(["tiny", "sealed"]))
def test_values_with_terms_are_those_of_the_whole_task(task: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Q-values along random walks, to 1e-9, and probabilities of choices and effects on trust to rounding."""
    setting, rng = Setting(c_suggest=0.1, suggestions="all"), Random(5)
    whole, part = (pool.policies[0] for pool in pools(kit(task), monkeypatch, setting=setting))
    every, compared = whole.pomdp.model.choices, 0
    task_states = every.of_task(np.arange(every.task_states))
    for _ in range(12):
        row, place = every.initial, part.problem.task.initial
        for _ in range(15):
            if every.goal[row]:
                break
            belief = np.random.default_rng(compared).dirichlet(np.ones(60)).reshape(1, 6, 10)
            own = part.rows(np.array([place]))
            expected, found = whole.q_values(np.array([row]), belief)[0], part.q_values(own, belief)[0]
            count = int(whole.pomdp.robot_actions[row])
            np.testing.assert_allclose(found[:count], expected[:count], rtol=0, atol=1e-9)
            slots = int(every.applicable[row].sum())
            for name, size in (("chosen", slots), ("weight", count)):
                one, other = (getattr(policy.pomdp, name) for policy in (part, whole))
                np.testing.assert_allclose(one[own[0], :size], other[row, :size], rtol=1e-12)
            compared += 1
            slot = rng.randrange(slots)
            row = int(every.targets[row, slot])
            place = int(part.situations(part.pomdp.model.choices.targets[own, slot])[0])
            assert part.problem.states(np.array([place])).tolist() == [task_states[row]]
    assert compared > 60


def test_bounds_with_terms_hold_for_the_whole_task(tiny: Table) -> None:
    """The interval of a part contains that of all pairs, which it becomes as the part grows."""
    setting = Setting(c_suggest=0.1, gamma=0.95)
    whole = PersonProblem.of(tiny, setting=setting, population=HABITS)
    exact = solve(whole.pomdp, gap=1e-4)
    wide = 0.0
    for states in (100, 12):
        problem = PersonProblem.of(OnDemand(tiny.task), setting=setting, population=HABITS, states=states)
        assert problem.known.values(problem.states).shape == (len(problem.states), len(tiny.task.variables))
        found = solve(problem.pomdp, gap=1e-4)
        assert found.lower <= exact.lower + 1e-4 * abs(exact.lower)
        assert found.upper >= exact.upper - 1e-4 * abs(exact.upper)
        assert found.upper - found.lower >= wide
        wide = found.upper - found.lower
    assert wide > 0.1


@pytest.mark.slow
def test_a_bound_on_a_team_with_terms(tiny: Table, monkeypatch: pytest.MonkeyPatch) -> None:
    setting = Setting(c_suggest=0.2, gamma=0.95)
    bounds = [
        upper_bound(pool, [0, 1], window=3, gap=1e-4, seed=1, options=BoundOptions(price_rounds=8))
        for pool in pools(tiny, monkeypatch, setting=setting)
    ]
    assert bounds[1].upper == pytest.approx(bounds[0].upper, rel=1e-3)
    certificate = bounds[1].certify("priority", episodes=500)
    assert certificate.value - 3 * certificate.value_stderr < bounds[1].upper


def test_a_live_robot_knows_the_habits_of_people_at_a_large_task(tiny: Table, monkeypatch: Any) -> None:
    said = list[list[Any]]()
    for whole in (True, False):
        monkeypatch.setattr(person_problem, "is_whole", lambda _, whole=whole: whole)
        desk = Assistant(tiny, ["ann"], setting=Setting(c_suggest=0.05, c_move=0.0), population=HABITS)
        rng, found = Random(1), list[Any]()
        for step in range(12):
            advice, seen = desk.recommend(), desk.person("ann")
            found.append((advice.suggestion, seen.applicable, seen.state, seen.cost_to_go, seen.belief.tobytes()))
            found.append(desk.explain().text() if advice.suggestion else None)
            if not seen.applicable:
                break
            desk.observe("ann", rng.choice(seen.applicable))
            if step % 5 == 4:
                desk.undo("ann")
        said.append(found)
    assert said[0] == said[1]
    assert any(isinstance(one, str) for one in said[0])


def test_who_executes_meets_people_without_memory(monkeypatch: pytest.MonkeyPatch, tiny: Table) -> None:
    monkeypatch.setattr("assist.team.solving.MAX_ENUMERATED", 1)
    with pytest.raises(ValueError, match="execute: expected people without memory"):
        Pool.sample(tiny, 2, seed=1, population=HABITS, setting=Setting(execute=True))
