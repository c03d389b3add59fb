"""Team policies and simulation: the rules of each policy, the laws of an episode, the paper's order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from assist.attention import BASE, NOBODY, AttentionSwitching, NoAssistance, Reactive, TeamAction, TeamState, distances
from assist.choices import Choices
from assist.human import Population, choice
from assist.simulate import POLICIES, Pool, Setting, Trace, illustrative, simulate, summarise
from planner import Table


@pytest.fixture(scope="module")
def pool(tiny_choices: Choices) -> Pool:
    return Pool.sample(tiny_choices, 5, seed=3)


def state(pool: Pool, x: list[int], *, erred: list[bool] | None = None, location: int = BASE) -> TeamState:
    """One team of the pool's first people."""
    people = np.arange(len(x))[None]
    choices = pool.choices
    at = np.array([x])
    prior = np.array([policy.pomdp.prior for policy in pool.policies])[pool.model(people)]
    return TeamState(
        at, ~choices.goal[at], np.array([erred or [False] * len(x)]), np.array([location]), pool.model(people), prior
    )


def test_no_assistance_does_nothing(pool: Pool) -> None:
    action = NoAssistance()(state(pool, [pool.choices.initial] * 3, erred=[True] * 3))
    assert (action.person.tolist(), action.robot.tolist()) == ([NOBODY], [0])


def test_reactive_goes_to_whoever_erred_and_stays_on_ties(pool: Pool) -> None:
    reactive, start = Reactive(pool.policies), [pool.choices.initial] * 3
    assert reactive(state(pool, start)).person.tolist() == [NOBODY]
    assert reactive(state(pool, start, erred=[False, True, True])).person.tolist() == [1]
    assert reactive(state(pool, start, erred=[True, True, True], location=2)).person.tolist() == [2]
    action = reactive(state(pool, start, erred=[True, False, False], location=2))
    assert action.person.tolist() == [0]
    slot = pool.policies[0].pomdp.suggested[start[0], action.robot[0]]
    assert pool.choices.optimal[start[0], slot]


def test_attention_follows_algorithm_1(pool: Pool) -> None:
    """Score each person by hand: Q(best) - Q(nothing) - c_move * distance, and act on the largest."""
    rng = np.random.default_rng(0)
    far = np.array([[0, 1, 5, 2], [1, 0, 3, 2], [5, 3, 0, 0.1], [2, 2, 0.1, 0]])
    open_states = np.flatnonzero(~pool.choices.goal)
    helped = 0
    for c_move, location in [(0.0, 0), (0.3, 0), (0.3, 1), (0.3, BASE), (50.0, 2)] * 8:
        x = rng.choice(open_states, 3).tolist()
        team = state(pool, x, location=location)
        scores = []
        for k in range(3):
            q = np.einsum(
                "sbt,bt->s", np.nan_to_num(pool.policies[k].q_mdp[x[k]], neginf=-1e9), pool.policies[k].pomdp.prior
            )
            scores.append(q.max() - q[0] - c_move * far[location, k])
        action = AttentionSwitching(pool.policies, c_move, far)(team)
        if max(scores) <= 0:
            assert action.person.tolist() == [NOBODY]
        else:
            helped += 1
            assert action.person.tolist() == [int(np.argmax(scores))]
    assert helped > 5


def test_attention_leaves_out_whoever_has_finished(pool: Pool) -> None:
    goal = int(np.flatnonzero(pool.choices.goal)[0])
    action = AttentionSwitching(pool.policies, 0.0, distances(3))(state(pool, [goal, goal, goal]))
    assert action.person.tolist() == [NOBODY]


@pytest.mark.parametrize("name", POLICIES)
def test_an_episodes_records_and_trace_agree(pool: Pool, name: str) -> None:
    trace: Trace = []
    episodes = simulate(pool, pool.policy(name, 3), humans=3, episodes=20, seed=1, name=name, trace=trace)
    for episode in episodes:
        rows = [row for row in trace if row["episode"] == f"{name}-{episode.episode}"]
        discounted = sum(pool.setting.gamma ** row["step"] * row["reward"] for row in rows)
        assert episode.discounted_return == pytest.approx(discounted, abs=1e-9)
        assert episode.interventions == sum(row["suggestion"] is not None for row in rows)
        places = [next(r["robot_place"] for r in rows if r["step"] == step) for step in range(episode.steps)]
        assert episode.moves == sum(a != b for a, b in zip([None, *places], places, strict=False))
        paid = -sum(row["reward"] + row["cost"] for row in rows)
        expected = pool.setting.c_suggest * episode.interventions + pool.setting.c_move * episode.moves
        assert paid == pytest.approx(expected, abs=1e-9)
        for k, person in enumerate(episode.people):
            own = [row for row in rows if row["place"] == k]
            assert [row["step"] for row in own] == list(range(episode.actions[k]))
            assert {row["person"] for row in own} == {person}
            assert episode.costs[k] == sum(row["cost"] for row in own)
            assert (own[-1]["cost_to_go_after"] == 0) == episode.finished[k]
            assert own[0]["theta"] == episode.theta[k]


def test_traced_actions_are_possible_in_the_task(tiny: Table, pool: Pool) -> None:
    trace: Trace = []
    simulate(pool, pool.policy("attention", 2), humans=2, episodes=10, seed=2, trace=trace)
    for episode in range(10):
        for place in (0, 1):
            own = [row for row in trace if row["episode"] == f"policy-{episode}" and row["place"] == place]
            end = tiny.space.follow([row["action"] for row in own])
            assert tiny.space.goal[end]
            x = tiny.initial
            for row in own:
                assert row["suggestion"] is None or row["suggestion"] in tiny.space.options(x)
                x = tiny.space.options(x)[row["action"]]


def test_episodes_do_not_depend_on_how_they_are_divided(pool: Pool) -> None:
    attention = pool.policy("attention", 3)
    together = simulate(pool, attention, humans=3, episodes=12, seed=7)
    apart = [e for n in range(12) for e in simulate(pool, attention, humans=3, episodes=[n], seed=7)]
    assert together == apart
    assert together != simulate(pool, attention, humans=3, episodes=12, seed=8)


def test_policies_meet_the_same_people(pool: Pool) -> None:
    runs = [simulate(pool, pool.policy(name, 3), humans=3, episodes=10, seed=5, name=name) for name in POLICIES]
    for none, reactive, attention in zip(*runs, strict=True):
        assert none.people == reactive.people == attention.people
        assert len(set(none.people)) == 3


def test_unaided_people_choose_as_the_model_says(tiny_choices: Choices) -> None:
    """First choices of many episodes against the Boltzmann probabilities of the person's own costs."""
    population = Population(beta=(1.0, 1.0), theta=(0.6, 0.6), sigma=(1.0, 1.0))
    pool = Pool.sample(tiny_choices, 1, seed=9, population=population)
    trace: Trace = []
    simulate(pool, NoAssistance(), humans=1, episodes=4000, seed=0, trace=trace)
    first = [row["action"] for row in trace if row["step"] == 0]
    human, start = pool.people[0], tiny_choices.initial
    for slot in np.flatnonzero(tiny_choices.applicable[start]):
        q = tiny_choices.costs[start] + human.h[tiny_choices.targets[start]]
        p = choice(np.where(tiny_choices.applicable[start], q, np.inf), tiny_choices.applicable[start], 1.0)[slot]
        share = np.mean([action == tiny_choices.name(start, int(slot)) for action in first])
        assert abs(share - p) < 4 * np.sqrt(p * (1 - p) / 4000)


def test_the_robots_grid_covers_the_people_it_is_told_of(tiny_choices: Choices) -> None:
    experts = Population(beta=(5.0, 8.0), theta=(0.8, 0.9))
    pomdp = Pool.sample(tiny_choices, 1, seed=0, population=experts).policies[0].pomdp
    assert 5 < pomdp.grid.beta[0] < pomdp.grid.beta[-1] < 8
    assert pomdp.prior.sum(axis=1) @ pomdp.grid.beta == pytest.approx(6.5)
    assert pomdp.prior.sum(axis=0) @ pomdp.grid.theta == pytest.approx(0.85)


def test_exact_knowledge_shares_one_policy(tiny_choices: Choices) -> None:
    pool = Pool.sample(tiny_choices, 6, seed=0, setting=Setting(knowledge="exact"))
    assert len(pool.policies) == 1
    helped = simulate(pool, pool.policy("attention", 3), humans=3, episodes=200, seed=0)
    alone = simulate(pool, pool.policy("none", 3), humans=3, episodes=200, seed=0)
    assert summarise(helped).actions[0] < summarise(alone).actions[0]


def test_episodes_are_cut_off(tiny_choices: Choices) -> None:
    pool = Pool.sample(tiny_choices, 2, seed=0, setting=Setting(max_steps=4))
    episodes = simulate(pool, NoAssistance(), humans=2, episodes=5, seed=0)
    assert all(e.steps == 4 and e.actions == (4, 4) and not any(e.finished) for e in episodes)
    assert summarise(episodes).cut_off == 5


def test_summary_by_hand(pool: Pool) -> None:
    episode = simulate(pool, NoAssistance(), humans=2, episodes=1, seed=0)[0]
    made = [replace(episode, actions=a, interventions=i, moves=1) for a, i in (((6, 8), 0), ((6, 12), 4), ((8, 14), 2))]
    summary = summarise(made)
    assert summary.actions == (9.0, pytest.approx(2 / np.sqrt(3)))
    assert summary.interventions == (2.0, pytest.approx(2 / np.sqrt(3)))
    assert summary.moves == (1.0, 0.0)
    assert illustrative(made, [replace(e, actions=(20, 20)) for e in made]) == made[1]


def test_a_users_policy_is_a_plain_callable_and_its_faults_are_named(pool: Pool) -> None:
    def first_who_works(team: TeamState) -> TeamAction:
        return TeamAction(team.active.argmax(axis=1), np.zeros(len(team.x), dtype=np.int64))

    episodes = simulate(pool, first_who_works, humans=3, episodes=5, seed=0)
    assert all(e.moves >= 1 and e.interventions == 0 for e in episodes)

    def everybody(person: int, robot: int):  # type: ignore[no-untyped-def]
        return lambda team: TeamAction(np.full(len(team.x), person), np.full(len(team.x), robot))

    for policy, complaint in (
        (everybody(3, 0), "goes to person 3 in a team of 3"),
        (everybody(0, 9), "does not have"),
        (everybody(0, 0), "has finished"),
    ):
        with pytest.raises(ValueError, match=complaint):
            simulate(pool, policy, humans=3, episodes=20, seed=0)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 5), st.sampled_from(POLICIES))
def test_laws_of_every_episode(pool: Pool, seed: int, humans: int, name: str) -> None:
    seen: list[TeamState] = []
    inner = pool.policy(name, humans)

    def watched(team: TeamState) -> TeamAction:
        seen.append(team)
        action = inner(team)
        goes = np.flatnonzero(action.person != NOBODY)
        assert team.active[goes, action.person[goes]].all()
        return action

    watched.uses_belief = inner.uses_belief  # type: ignore[attr-defined]
    for episode in simulate(pool, watched, humans=humans, episodes=3, seed=seed):
        assert all(actions >= 6 for actions in episode.actions)  # nobody beats the exact cost-to-go
        assert episode.discounted_return <= 0
        assert episode.moves <= episode.steps
        assert episode.interventions <= episode.steps
    for team in seen:
        if team.belief is not None:
            np.testing.assert_allclose(team.belief.sum(axis=(2, 3)), 1, atol=1e-9)


def test_attention_is_ahead_of_reactive_is_ahead_of_none(fixed: Table) -> None:
    """500 episodes of a team of 3 from the paper's population: each difference beyond two standard errors."""
    pool = Pool.sample(Choices.of(fixed), 12, seed=0)
    actions = {}
    for name in POLICIES:
        episodes = simulate(pool, pool.policy(name, 3), humans=3, episodes=500, seed=0, name=name)
        actions[name] = np.array([np.mean(episode.actions) for episode in episodes])
    for worse, better in (("none", "reactive"), ("reactive", "attention")):
        gain = actions[worse] - actions[better]
        assert gain.mean() > 2 * gain.std(ddof=1) / np.sqrt(len(gain))
