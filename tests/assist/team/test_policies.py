"""Team policies: compared with their definitions in random states of teams, valid actions, and their order."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise, permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import costly
from graphs import graph_task
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq
from teams import equal, reachable, run, state

from assist import compare
from assist.people import Choices, UserCodeError
from assist.person import QMDP, AssistPOMDP, Policy, Robot, Setting, Travel, evaluate, qmdp
from assist.person.fleet import Fleet
from assist.person.known_states import KnownStates
from assist.team import AttentionSwitching, Pool, Priority, Schedule, UserPolicy, Whittle, simulate
from assist.team.attention_never import AttentionAgainstNever
from assist.team.baselines import Reactive
from assist.team.by_policy import ByPolicy
from assist.team.state import BASE, NOBODY, TeamAction, TeamState
from planner import Table, cost_to_go, load, sweep


def test_a_mistake_is_an_action_that_is_not_an_optimal_choice() -> None:
    """If costs differ or actions are free, an optimal plan may begin with an action that does not lower h*."""
    table = cost_to_go(load("delivery/one-parcel"))
    choices, reactive = Choices.of(table), Reactive()
    assert (choices.optimal & ~(choices.h[choices.targets] < choices.h[:, None])).any()
    seen: list[tuple[np.ndarray, np.ndarray]] = []

    def watched(team: TeamState) -> TeamAction:
        seen.append((team.x.copy(), team.erred.copy()))
        return reactive(team)

    simulate(Pool.sample(table, 2, seed=0), watched, humans=2, episodes=1, seed=0)
    mistakes = []
    for (before, _), (x, erred) in pairwise(seen):
        optimal = choices.optimal[before] & (choices.targets[before] == x[..., None])
        moved = ~choices.goal[before]
        assert (erred == ~optimal.any(axis=2))[moved].all()
        mistakes += erred[moved].tolist()
    assert 0 < sum(mistakes) < len(mistakes)


def test_attention_goes_to_nobody_to_say_nothing(pool: Pool) -> None:
    """If assistance has no value, the best action is to say nothing, even if it is better than never helping again."""
    x = [pool.choices(0).initial] * 2
    dear = replace(pool, policies=tuple(qmdp(replace(p.pomdp, robot_costs=1e3 * p.pomdp.robot_costs))
                                        for p in pool.policies))  # fmt: skip
    team = state(dear, x, travel=Travel.of(2, c_move=0.0))
    switching = AttentionAgainstNever(
        ByPolicy(dear.policies, lambda policy: np.full_like(policy.value_mdp, -1e6).__getitem__)
    )
    said, score = switching.scores(team)
    assert said.tolist() == [[[0, 0]]]
    assert np.isneginf(score).all()
    assert switching(team).person.tolist() == [[NOBODY]]


def test_attention_goes_nowhere_where_the_way_costs_what_it_saves(pool: Pool) -> None:
    def score(x: int, c_move: float) -> float:
        return float(AttentionSwitching().scores(at(x, c_move))[1][0, 0, 0])

    def at(x: int, c_move: float) -> TeamState:
        return state(pool, [x], travel=Travel.of(1, c_move=c_move))

    x = max(np.flatnonzero(~pool.choices(0).goal).tolist(), key=lambda x: score(x, 0.0))
    saving = score(x, 0.0)
    assert saving > 0
    assert AttentionSwitching()(at(x, saving)).person.tolist() == [[NOBODY]]
    assert AttentionSwitching()(at(x, saving - 1e-8)).person.tolist() == [[0]]


def test_a_policy_cannot_write_into_the_simulation(pool: Pool) -> None:
    """Each array that a policy can reach is read-only and keeps its values."""
    tried: set[str] = set()

    def vandal(team: TeamState) -> TeamAction:
        action = AttentionSwitching()(team)  # so that cached values exist
        team.first_optimal()
        for name, array in reachable(team, "team", {}).items():
            before = array.copy()
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0
            np.testing.assert_array_equal(array, before)
            tried.add(name)
        return action

    for episodes in (1, 3):
        expected = simulate(pool, AttentionSwitching(), humans=3, episodes=episodes, seed=0, name="same")
        assert equal(expected, simulate(pool, vandal, humans=3, episodes=episodes, seed=0, name="same"))
    arrays = {"x", "active", "erred", "location", "model", "belief", "travel.distance", "travel.c_move"}
    arrays |= {f"policies[0].{name}" for name in ("q_mdp", "pomdp.prior", "pomdp.first_optimal", "pomdp.grid.beta")}
    arrays |= {f"policies[0].pomdp.model.{name}" for name in ("q", "choices.h", "choices.targets", "choices.goal")}
    assert {f"team.{name}" for name in arrays} <= tried
    assert len(tried) > 30


def test_a_team_state_leaves_its_makers_arrays_alone(pool: Pool) -> None:
    team = state(pool, [0, 0])
    team.beliefs.x[1] = 3
    assert team.x.tolist() == [[0, 3]]
    with pytest.raises(ValueError, match="read-only"):
        team.x[0, 0] = 1


def test_a_users_policy_is_a_plain_callable_and_its_faults_are_named(pool: Pool) -> None:
    def first_who_works(team: TeamState) -> TeamAction:
        return team.act(team.active.argmax(axis=1), np.zeros_like(team.x))

    episodes = simulate(pool, first_who_works, humans=3, episodes=5, seed=0)
    assert all(e.moves >= 1 and e.interventions == 0 for e in episodes)

    def everybody(person: int, said: int):  # type: ignore[no-untyped-def]
        return lambda team: TeamAction(np.full(team.location.shape, person), np.full(team.location.shape, said))

    for policy, complaint in (
        (everybody(3, 0), "goes to person 3 in a team of 3"),
        (everybody(0, 9), "does not have"),
        (everybody(0, 0), "has finished"),
    ):
        with pytest.raises(ValueError, match=complaint):
            simulate(pool, policy, humans=3, episodes=20, seed=0)


def test_attention_is_ahead_of_reactive_is_ahead_of_none(fixed: Table) -> None:
    """300 episodes of a team of 3 from the paper's population: each difference beyond two standard errors."""
    pool = Pool.sample(Choices.of(fixed), 4, seed=0)
    actions = {}
    for name in ("none", "reactive", "attention"):
        actions[name] = run(pool, name, 3, 300, 0).actions.mean(axis=1)
    for worse, better in (("none", "reactive"), ("reactive", "attention")):
        gain = actions[worse] - actions[better]
        assert gain.mean() > 2 * gain.std(ddof=1) / np.sqrt(len(gain))


def with_them(pool: Pool, price: object, step: int, x: list[int]) -> list[float]:
    """Return the value of attending to each person in this step at these prices, and of staying with the first."""
    team = replace(state(pool, x, location=0), clock=np.array([step]))
    _, going, holding = Priority.of(pool.policies, team.travel, price).worth(team)
    return [*going[0, 0].tolist(), *holding[0].tolist()]


def test_teams_that_began_at_different_times_have_each_the_price_of_their_own_step(pool: Pool) -> None:
    """As in vectorised environments, where one team begins an episode while others continue theirs."""
    x, prices = [pool.choices(0).initial] * 3, np.array([0.3, 0.0, 0.5, 0.1, 0.4, 0.2])
    clock, alone = np.array([2, 0, 2, 9, 4]), state(pool, x, location=0)
    n, travel = len(clock), alone.travel
    prior = np.array([policy.pomdp.prior for policy in pool.policies])[alone.model[0]]
    known = KnownStates(np.tile(x, n), np.tile(prior, (n, 1, 1)), np.zeros(3 * n, dtype=bool))
    team = TeamState(
        clock, np.ones((n, 3), dtype=bool), np.zeros((n, 1), dtype=np.int64), np.tile(alone.model, (n, 1)), known,
        pool.policies, travel, fleet=pool.setting.fleet,
    )  # fmt: skip
    assert team.step == 9
    policy = Priority.of(pool.policies, travel, prices)
    _, going, holding = policy.worth(team)
    each = [with_them(pool, prices, step, x) for step in clock.tolist()]
    np.testing.assert_array_equal(np.concatenate([going[:, 0], holding], axis=1), each)
    assert policy(team).person.tolist() == [policy(team.of(np.array([k]))).person[0].tolist() for k in range(n)]
    assert len({tuple(one) for one in each}) == 4


def test_priority_goes_by_the_prices_of_the_steps_to_come(tiny_choices: Choices) -> None:
    """If all prices are equal they act as one price; prices of past steps have no effect."""
    pool = Pool.sample(tiny_choices, 3, seed=3, setting=Setting(c_suggest=0.05, gamma=0.9))
    x, prices = [pool.choices(0).initial] * 3, np.array([0.3, 0.0, 0.5, 0.1, 0.4, 0.2])
    # Fetching a box and returning it leads back.
    assert with_them(pool, np.full(100, 0.2), 2, x) == pytest.approx(with_them(pool, 0.2, 0, x), abs=1e-4)
    later = with_them(pool, prices, 2, x)
    np.testing.assert_allclose(later, with_them(pool, prices[2:], 0, x), atol=1e-4)
    assert np.abs(np.subtract(later, with_them(pool, prices, 0, x))).max() > 0.01
    np.testing.assert_allclose(with_them(pool, prices, 6, x), with_them(pool, 0.0, 0, x), atol=1e-4)


def test_prices_of_steps_are_for_people_who_begin_together(pool: Pool) -> None:
    table, travel = pool.choices(0), pool.setting.travel(3)
    nearly = int(np.flatnonzero((table.h > 0) & (table.h <= table.h[table.h > 0].min()))[0])
    with pytest.raises(ValueError, match="nobody can be so soon: with prices of steps all begin at step 0"):
        with_them(pool, np.full(4, 0.2), 1, [table.initial, nearly, table.initial])
    # Late joiners are in states that earlier ones cannot be in.
    policy = Priority.of(pool.policies, travel, np.full(4, 0.2))
    late = Schedule.of(3, joins=[0, 0, 1])
    with pytest.raises(ValueError, match="nobody can be so soon: with prices of steps all begin at step 0"):
        simulate(pool, policy, humans=3, episodes=4, seed=0, presence=late)


def test_a_function_in_a_file_is_tried_once_for_memory(pool: Pool, tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(
        "CALLS = []\n"
        "def third(team):\n"
        "    CALLS.append(team.step)\n"
        "    return team.act(team.active.argmax(axis=1), team.first_optimal() * (len(CALLS) % 3 > 0))\n"
        "def first(team):\n"
        "    CALLS.append(team.step)\n"
        "    return team.act(team.active.argmax(axis=1), team.first_optimal())\n"
    )
    third, first = (UserPolicy.load(tmp_path / "own.py", name) for name in ("third", "first"))
    with pytest.raises(UserCodeError, match=r"own\.py:2: third .* without memory of former calls"):
        simulate(pool, third, humans=2, episodes=2, seed=0)
    simulate(pool, third.function, humans=2, episodes=2, seed=0)  # a callable is taken as it is
    calls: list[int] = first.function.__globals__["CALLS"]  # type: ignore[attr-defined]
    calls.clear()
    counts = []
    for _ in range(3):
        simulate(pool, first, humans=2, episodes=2, seed=0)
        counts.append(len(calls))
        calls.clear()
    assert counts[0] > 3 * counts[1] == 3 * counts[2]


TEAMS, PEOPLE = 6, 3


@pytest.fixture(scope="module")
def people(tiny_choices: Choices) -> Pool:
    return Pool.sample(tiny_choices, PEOPLE, seed=2, setting=Setting(c_suggest=0.02))


def random_state(pool: Pool, seed: int, robots: int, *, equally_far: bool, travel_time: float = 0.0) -> TeamState:
    rng, choices = np.random.default_rng(seed), pool.choices(0)
    distance = rng.choice([0.1, 0.5, 2.0], (PEOPLE + 1, PEOPLE + 1)) * (1 - np.eye(PEOPLE + 1))
    travel = Travel.of(
        PEOPLE, c_move=np.full(robots, rng.choice([0.0, 0.05])), distance=None if equally_far else distance,
        travel_time=travel_time,
    )  # fmt: skip
    x = rng.integers(len(choices), size=(TEAMS, PEOPLE))
    model = np.broadcast_to(pool.model, x.shape)
    prior = pool.policies[0].pomdp.prior
    belief = rng.dirichlet(np.ones(prior.size), x.size).reshape(-1, *prior.shape)
    location = np.array([rng.choice([BASE, *range(PEOPLE)], robots, replace=False) for _ in range(TEAMS)])
    active = ~choices.goal[x] & (rng.random(x.shape) < 0.8)
    known = KnownStates(x.ravel(), belief, rng.random(x.size) < 0.6)
    alike = Fleet.of((Robot(),) * robots)
    return TeamState(
        np.zeros(len(active), np.int64), active, location, model, known, pool.policies, travel, fleet=alike
    )


def is_best(team: TeamState, action: TeamAction, worth: np.ndarray, said: np.ndarray) -> None:
    """Check that robots serve people with the largest total worth, shape (N, M, K), and make these robot actions."""
    person, made, number = action.person, action.action, np.arange(team.robots)
    steps = team.travel.steps_between(number, team.location, person)
    for n, own in enumerate(worth):
        gains = np.where(own > 0, own, 0.0)
        pairs = [(m, k) for m, k in enumerate(person[n]) if k != NOBODY]
        assert len({k for _, k in pairs}) == len(pairs)
        assert all(own[m, k] > 0 for m, k in pairs)
        best = max(
            sum(gains[m, k] for m, k in enumerate(order) if k < PEOPLE)
            for order in permutations(range(PEOPLE + len(own)), len(own))
        )
        assert sum(own[m, k] for m, k in pairs) == pytest.approx(best, abs=1e-9)
        for m, k in enumerate(person[n]):
            there = k != NOBODY and steps[n, m] == 0
            assert made[n, m] == (said[n, k] if there else 0)


examples = costly(12, 50)
teams = {"seed": st.integers(0, 10**6), "robots": st.integers(1, 3), "equally_far": st.booleans()}


@examples
@given(**teams, travel_time=st.sampled_from([0.0, 0.0, 1.0]))
def test_reactive_assistance_as_defined(people: Pool, robots: int, **options: Any) -> None:
    team = random_state(people, robots=robots, **options)
    choices, far = people.choices(0), team.travel.distance
    action = Reactive()(team)
    said = np.zeros(team.x.shape, dtype=np.int64)
    for n, k in np.argwhere(team.erred & team.active):
        offered = people.policies[people.model[k]].pomdp.suggested[team.x[n, k]]
        optimal = [r for r, slot in enumerate(offered) if slot >= 0 and choices.optimal[team.x[n, k], slot]]
        said[n, k] = optimal[0] if optimal else 0
    for n in range(TEAMS):
        assert np.sum(action.person[n] != NOBODY) == min(robots, np.count_nonzero(said[n]))
    near = np.where(said[:, None] > 0, 1 + far.max() - far[team.location][:, :, :-1], -np.inf)
    is_best(team, action, near, said)


@examples
@given(**teams, never=st.booleans(), travel_time=st.sampled_from([0.0, 0.0, 1.0]))
def test_attention_switching_as_defined(people: Pool, robots: int, never: bool, **options: Any) -> None:
    """The score of a person is the advantage of their policy's action, minus the cost of the way."""
    team = random_state(people, robots=robots, **options)
    switching = AttentionAgainstNever.of(people.policies) if never else AttentionSwitching()
    score, best = np.full((TEAMS, robots, PEOPLE), -np.inf), np.zeros(team.x.shape, dtype=np.int64)
    alone = [evaluate(one.pomdp, np.zeros(len(one.pomdp.robot_actions), dtype=np.int64)) for one in people.policies]
    for n, k in np.argwhere(team.active):
        policy, x, belief = people.policies[people.model[k]], team.x[n, k], team.belief[n, k]
        q = policy.q_values(np.array([x]), belief[None])[0]
        best[n, k] = q.argmax()
        reference = (alone[people.model[k]][x] * belief).sum() if never else q[0]
        if best[n, k]:
            score[n, :, k] = q.max() - reference - team.travel.c_move * team.travel.distance[team.location[n], k]
    said, found = switching.scores(team)
    np.testing.assert_array_equal(said.swapaxes(1, 2)[team.active], best[team.active][:, None].repeat(robots, axis=1))
    np.testing.assert_allclose(found, score, atol=1e-9)
    is_best(team, switching(team), score, best)


def test_what_a_policy_needs_is_computed_beforehand(tiny_choices: Choices) -> None:
    solved: list[AssistPOMDP] = []

    def solver(pomdp: AssistPOMDP) -> QMDP:
        solved.append(pomdp)
        return qmdp(pomdp)

    one = Pool.sample(tiny_choices, 2, seed=1, solver=solver).policies
    plain, never = AttentionSwitching(), list[Policy]()
    plain.prepare(one[0])
    AttentionAgainstNever(ByPolicy(one, lambda policy: never.append(policy))).prepare(one[1])  # type: ignore[arg-type]
    assert (solved, never) == ([one[0].pomdp, one[1].pomdp], [one[1]])
    exact = evaluate(one[1].pomdp, np.zeros(len(tiny_choices), dtype=np.int64))
    np.testing.assert_array_equal(AttentionAgainstNever.of(one).never[one[1]](np.arange(len(exact))), exact)


def index_of(pomdp: AssistPOMDP, x: int, b: int, t: int) -> float:
    """Return the exact index of a person with known beta and theta, to whom the robot comes at no cost."""
    n, R = pomdp.suggested.shape
    choices = pomdp.model.choices
    states, P, cost = np.arange(n), np.zeros((R, n, n)), np.zeros((R, n))
    for said in range(R):
        for slot in range(choices.targets.shape[1]):
            chance = pomdp.likelihood(states, np.full(n, said), np.full(n, slot))[:, b, t] * choices.applicable[:, slot]
            np.add.at(P[said], (states, choices.targets[:, slot]), chance)
            cost[said] += chance * choices.costs[:, slot]
    padding = (np.arange(R)[:, None] >= pomdp.robot_actions) & (np.arange(R)[:, None] > 0)
    working = ~pomdp.ends

    def advantage(price: float) -> float:
        """Return what presence brings, less the price of this step; staying silently is presence as well."""
        value = np.zeros(n)
        while True:
            q = -cost - pomdp.robot_costs.T + pomdp.gamma * P @ value
            silent = q[0]
            present = np.where(padding, -np.inf, q).max(axis=0) - price
            new = np.where(working, np.maximum(silent, present), 0.0)
            if np.abs(new - value).max() < 1e-11:
                return float(present[x] - silent[x])
            value = new

    return float(brentq(advantage, 0, 50, xtol=1e-9))


def test_indices_equal_those_by_bisection(tiny: Table) -> None:
    setting = Setting(gamma=0.9, c_move=0, c_suggest=0.02, knowledge="exact", trust="constant", lapse=0)
    pool = Pool.sample(tiny, 2, seed=0, setting=setting)
    pomdp, rng = pool.policies[0].pomdp, np.random.default_rng(0)
    policy = Whittle.of(pool.policies, setting.travel(2), np.linspace(0, 1, 51).tolist())
    B, T = pomdp.prior.shape
    compared = 0
    for x in np.flatnonzero(~pomdp.ends).tolist():
        b, t = int(rng.integers(B // 2)), int(rng.integers(T // 2, T))
        belief = np.zeros((2, B, T))
        belief[:, b, t] = 1
        _, going, _ = policy.worth(state(pool, [x, x], belief=belief))
        if (going[0] > 0).all():  # people who do not need the robot have a negative index, which is not exact
            assert going[0] == pytest.approx(index_of(pomdp, x, b, t), abs=2e-3)
            compared += 1
    assert compared >= 8


def test_the_robot_goes_to_the_largest_index_and_not_for_less_than_the_way(tiny: Table) -> None:
    pool = Pool.sample(tiny, 3, seed=2, setting=Setting(c_suggest=0.02, c_move=0.01, knowledge="exact"))
    one = state(pool, [pool.choices(0).initial] * 3)
    policy = pool.policy("whittle")
    _, going, staying = policy.worth(one)
    assert policy(one).person[0] == going[0].argmax()
    assert staying[0] == 0
    far = state(pool, [pool.choices(0).initial] * 3, travel=Setting(c_move=50).travel(3))
    assert Whittle.of(pool.policies, far.travel)(far).person[0] == NOBODY


@pytest.mark.parametrize("prices", [[], [0.2, 0.1], [-1.0, 0.0]])
def test_prices_that_are_no_grid_are_refused(tiny: Table, prices: list[float]) -> None:
    pool = Pool.sample(tiny, 2, seed=0)
    with pytest.raises(ValueError, match="expected at least one, none below 0, in ascending order"):
        Whittle.of(pool.policies, pool.setting.travel(2), prices)


def test_prices_are_in_units_of_the_cheapest_action_that_is_not_free() -> None:
    roads = [(0, 1, 1), (1, 0, 1), (1, 2, 0), (2, 1, 0), (2, 3, 2), (1, 3, 5)]
    pool = Pool.sample(sweep(graph_task(roads, goal=3, start=0)), 2, seed=1, setting=Setting(knowledge="exact"))
    assert pool.policies[0].problem.cheapest == 1
    returns = {
        name: simulate(pool, name, humans=2, episodes=20, seed=1).discounted_return.mean()
        for name in ("none", "whittle", "priority", "rollout")
    }
    assert min(returns, key=lambda name: returns[name]) == "none"
    free = Pool.sample(sweep(graph_task([(0, 1, 0), (1, 2, 0)], goal=2)), 2, seed=1)
    assert simulate(free, "whittle", humans=2, episodes=5, seed=1).discounted_return.tolist() == [0.0] * 5


@pytest.mark.cases
def test_a_policy_of_the_users_own_that_fails_is_told_with_its_line() -> None:
    """As with the commands; the original error is the cause. A policy of the package fails as it is."""

    def failing(team: TeamState) -> TeamAction:
        return team.nowhere  # type: ignore[attr-defined, no-any-return]

    class Failing:
        def __call__(self, team: TeamState) -> TeamAction:
            return failing(team)

    pool = Pool.sample(sweep(load("kitting/tiny")), 2, seed=0)
    for policy in (failing, Failing()):
        with pytest.raises(UserCodeError, match=r"test_policies\.py:\d+: AttributeError: .*nowhere") as error:
            simulate(pool, policy, humans=2, episodes=1, seed=0)
        assert isinstance(error.value.__cause__, AttributeError)
        with pytest.raises(UserCodeError, match=r"test_policies\.py:\d+: AttributeError: .*nowhere"):
            compare(pool, {"own": policy, "none": "none"}, humans=2, episodes=1, seed=0)
