"""The paper's team policies in random states of teams, compared with their definitions and with all assignments."""

from __future__ import annotations

from itertools import permutations
from typing import Any

import numpy as np
import pytest
from conftest import costly
from hypothesis import given
from hypothesis import strategies as st

from assist.people.choices import Choices
from assist.person.fleet import Fleet
from assist.person.mdp_values import evaluate
from assist.person.policy import Policy
from assist.person.pomdp import AssistPOMDP
from assist.person.qmdp import QMDP, qmdp
from assist.person.robots import Robot
from assist.person.seen_beliefs import Seen
from assist.person.settings import Setting
from assist.person.travel import Travel
from assist.team.attention import AttentionSwitching
from assist.team.attention_never import AttentionAgainstNever
from assist.team.baselines import NoAssistance, Reactive
from assist.team.by_policy import ByPolicy
from assist.team.pool import Pool
from assist.team.state import BASE, NOBODY, TeamAction, TeamState

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
    known = Seen(x.ravel(), belief, rng.random(x.size) < 0.6)
    alike = Fleet.of((Robot(),) * robots)
    return TeamState(0, active, location, model, known, pool.policies, travel, fleet=alike)


def is_best(team: TeamState, action: TeamAction, worth: np.ndarray, robot: np.ndarray) -> None:
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
            assert made[n, m] == (robot[n, k] if there else 0)


examples = costly(12, 50)
teams = {"seed": st.integers(0, 10**6), "robots": st.integers(1, 3), "equally_far": st.booleans()}


@examples
@given(**teams, travel_time=st.sampled_from([0.0, 0.0, 1.0]))
def test_reactive_assistance_as_defined(people: Pool, robots: int, **options: Any) -> None:
    team = random_state(people, robots=robots, **options)
    choices, far = people.choices(0), team.travel.distance
    action = Reactive()(team)
    robot = np.zeros(team.x.shape, dtype=np.int64)
    for n, k in np.argwhere(team.erred & team.active):
        offered = people.policies[people.model[k]].pomdp.suggested[team.x[n, k]]
        optimal = [r for r, slot in enumerate(offered) if slot >= 0 and choices.optimal[team.x[n, k], slot]]
        robot[n, k] = optimal[0] if optimal else 0
    for n in range(TEAMS):
        assert np.sum(action.person[n] != NOBODY) == min(robots, np.count_nonzero(robot[n]))
    near = np.where(robot[:, None] > 0, 1 + far.max() - far[team.location][:, :, :-1], -np.inf)
    is_best(team, action, near, robot)


@examples
@given(**teams, never=st.booleans(), travel_time=st.sampled_from([0.0, 0.0, 1.0]))
def test_attention_switching_as_defined(people: Pool, robots: int, never: bool, **options: Any) -> None:
    """The score of a person is the advantage of their policy's action, minus the cost of the way."""
    team = random_state(people, robots=robots, **options)
    switching = AttentionAgainstNever.of(people.policies) if never else AttentionSwitching()
    assert team.belief is not None
    score, best = np.full((TEAMS, robots, PEOPLE), -np.inf), np.zeros(team.x.shape, dtype=np.int64)
    alone = [evaluate(one.pomdp, np.zeros(len(one.pomdp.robot_actions), dtype=np.int64)) for one in people.policies]
    for n, k in np.argwhere(team.active):
        policy, x, belief = people.policies[people.model[k]], team.x[n, k], team.belief[n, k]
        q = policy.q_values(np.array([x]), belief[None])[0]
        best[n, k] = q.argmax()
        reference = (alone[people.model[k]][x] * belief).sum() if never else q[0]
        if best[n, k]:
            score[n, :, k] = q.max() - reference - team.travel.c_move * team.travel.distance[team.location[n], k]
    robot, found = switching.scores(team)
    np.testing.assert_array_equal(robot.swapaxes(1, 2)[team.active], best[team.active][:, None].repeat(robots, axis=1))
    np.testing.assert_allclose(found, score, atol=1e-9)
    is_best(team, switching(team), score, best)


@pytest.mark.parametrize("robots", [1, 2])
def test_no_assistance_is_no_action(people: Pool, robots: int) -> None:
    team = random_state(people, 0, robots, equally_far=True)
    action = NoAssistance()(team)
    for array, none in ((action.person, NOBODY), (action.action, 0)):
        assert (array.shape, array.dtype) == (team.location.shape, np.dtype(np.int64))
        assert (array == none).all()


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
