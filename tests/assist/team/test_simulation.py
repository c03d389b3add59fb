"""Simulation: properties of episodes, compared with the equations of people and with values by hand."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from conftest import costly
from hypothesis import given
from hypothesis import strategies as st
from teams import equal, run

from assist.people import Choices, HumanModel, ImpossibleObservationError, Population
from assist.people.decision import choice, influence, lapse, perceived_value, trust
from assist.person import AssistPOMDP, OfRobots, Setting, Travel, qmdp
from assist.person.beliefs import PersonModel
from assist.person.dynamics import act
from assist.person.known_states import KnownStates
from assist.person.lazy_policy import LazyPolicy
from assist.person.people_arrays import Minds, PeopleArrays
from assist.person.problem_arrays import Acts
from assist.team import POLICIES, AttentionSwitching, Episodes, Pool, Schedule, simulate
from assist.team.illustration import typical
from assist.team.state import NOBODY, TeamAction, TeamState
from assist.team.trace import Trace
from planner import LimitError, Table


@pytest.mark.parametrize("name", POLICIES)
def test_an_episodes_records_and_trace_agree(pool: Pool, tiny: Table, name: str) -> None:
    trace: Trace = []
    episodes = run(pool, name, 3, 1 if name == "rollout" else 4, 1, trace=trace)
    assert [one.people for one in episodes] == [one.people for one in run(pool, "none", 3, 4, 1)][: len(episodes)]
    for episode in episodes:
        rows = [row for row in trace if row["episode"] == f"{name}-{episode.episode}"]
        discounted = sum(pool.setting.gamma ** row["step"] * row["reward"] for row in rows)
        assert episode.discounted_return == pytest.approx(discounted, abs=1e-9)
        assert episode.interventions == sum(row["suggestion"] is not None for row in rows)
        places = [next(r["robot_places"][0] for r in rows if r["step"] == step) for step in range(episode.steps)]
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
            x = tiny.initial
            for row in own:  # what is done and suggested is possible in the task
                options = tiny.space.options(x)
                assert row["suggestion"] is None or row["suggestion"] in options
                x = options[row["action"]]
            assert tiny.space.goal[x] == episode.finished[k]


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ({"humans": 0}, "humans 0: expected a whole number of 1 or more"),
        ({"humans": True}, "humans True"),
        ({"humans": 2.0}, "humans 2.0"),
        ({"humans": float("nan")}, "humans nan"),
        ({"humans": 6}, "6 people per team: expected 1 to 5, the size of the pool"),
        ({"humans": []}, r"team \[\]: expected names of people, or their numbers"),
        ({"humans": [0.5, 1.0]}, "expected names of people, or their numbers from 0 to 4"),
        ({"humans": [True, False]}, "expected names of people"),
        ({"episodes": 0}, "episodes 0: expected a whole number of 1 or more"),
        ({"episodes": []}, "expected how many, or the number of one or more of them"),
        ({"episodes": [-1]}, "expected whole numbers of 0 or more"),
        ({"episodes": 2.0}, "episodes 2.0"),
        ({"seed": -1}, "seed -1"),
        ({"seed": 0.5}, "seed 0.5"),
        ({"jobs": 0}, "jobs 0"),
        ({"world": "moon"}, "world 'moon': expected 'people' or 'model'"),
        ({"policy": "Attention"}, "unknown policy 'Attention'; did you mean 'attention'"),
        ({"memory_limit_mb": 0}, "memory_limit_mb 0: expected more than 0"),
    ],
)
def test_simulations_that_cannot_be(pool: Pool, arguments: dict[str, Any], complaint: str) -> None:
    given = {"policy": "none", "humans": 2, "episodes": 2, "seed": 0, **arguments}
    with pytest.raises(ValueError, match=complaint):
        simulate(pool, given.pop("policy"), **given)


def test_any_kind_of_integer_and_a_generator_will_do(pool: Pool) -> None:
    plain = simulate(pool, "attention", humans=2, episodes=3, seed=4)
    typed = simulate(pool, "attention", humans=np.int64(2), episodes=np.int32(3), seed=np.uint8(4))
    assert equal(plain, typed)
    assert plain.policy == "attention"
    drawn = [simulate(pool, "none", humans=2, episodes=3, seed=np.random.default_rng(n)) for n in (1, 1, 2)]
    assert equal(drawn[0], drawn[1])
    assert not equal(drawn[0], drawn[2])


def test_more_episodes_than_fit_the_memory_are_refused(pool: Pool) -> None:
    with pytest.raises(
        LimitError, match=r"99,999,999,999 episodes of 2 people take about 15,\d{3},\d{3} MB .* at most 25,9"
    ):
        simulate(pool, "none", humans=2, episodes=99_999_999_999, seed=0)


def test_episodes_do_not_depend_on_the_number_of_processes(pool: Pool) -> None:
    alone = run(pool, "attention", 3, 100, 7)
    parts = [list(range(0, 30)), list(range(30, 100))]
    with ProcessPoolExecutor(2) as workers:
        runs = [
            workers.submit(simulate, pool, pool.policy("attention"), humans=3, episodes=part, seed=7, name="attention")
            for part in parts
        ]
        assert equal(alone, Episodes.joined([r.result() for r in runs]))


def test_summary_by_hand(pool: Pool) -> None:
    three = run(pool, "none", 2, 3, 0)
    made = replace(
        three, actions=np.array([[6, 8], [6, 12], [8, 14]]), interventions=np.array([0, 4, 2]), moves=np.ones(3)
    )
    summary = made.summary()
    assert summary.actions == (9.0, pytest.approx(2 / np.sqrt(3)))
    assert summary.interventions == (2.0, pytest.approx(2 / np.sqrt(3)))
    assert summary.moves == (1.0, 0.0)
    said = "none: actions per person 9.00 ± 1.15, cost per person 9.33 ± 0.67, suggestions 2.00 ± 1.15, "
    assert str(summary).startswith(said)
    assert "cost per person" not in str(three.summary())  # where all actions cost 1
    assert typical(made, replace(made, actions=np.full((3, 2), 20))).actions == (6, 12)


def test_compiled_steps_follow_the_equations(tiny_choices: Choices) -> None:
    """Frequencies of what many equal people do, their trust, and the belief, against the functions of arrays."""
    rng = np.random.default_rng(5)
    human = Population().sample(tiny_choices, 1, rng)[0]
    model = HumanModel.own(tiny_choices, human, lapse=0.05)
    pomdp = AssistPOMDP.of(model, robot=OfRobots(execute=True))
    n, (betas, thetas), q = 4_000, pomdp.grid.shape, model.q[:, :, 0]
    value = perceived_value(tiny_choices, q)
    open_states = np.flatnonzero(~tiny_choices.goal)
    for x in rng.choice(open_states, 6):
        for said in range(pomdp.robot_actions[x]):
            beta, theta = rng.uniform(0.1, 3), rng.uniform(0, 1)
            belief = rng.dirichlet(np.ones(betas * thetas)).reshape(betas, thetas)
            people = PeopleArrays(
                np.full(n, x), np.full(n, said), np.zeros(n, dtype=np.int64), np.full(n, theta),
                np.zeros(n, dtype=np.int64), rng.random((n, 2)), np.zeros(n, dtype=np.int64), np.zeros(n),
            )  # fmt: skip
            known = KnownStates(people.x, np.repeat(belief[None], n, axis=0), np.zeros(n, dtype=bool))
            modelled = PersonModel.of(LazyPolicy(pomdp, qmdp))
            alone = choice(q, tiny_choices.applicable, np.full(len(tiny_choices), beta))
            minds = Minds.of_model(pomdp)._replace(
                goal=np.zeros(1, dtype=np.int64), p=alone[None], value=value[None], eta=model.eta, on_grid=False
            )
            act(np.arange(n), people, minds, modelled.arrays)
            acts = Acts(np.full(n, x), people.heard, people.slot, np.zeros(n, dtype=bool))
            known.observe(acts, people.heard, [(modelled, np.arange(n))], lambda _: np.empty(0))
            place, told = pomdp.afterstate[x, said], pomdp.suggested[x, said]
            if tiny_choices.goal[place]:
                assert (people.x == place).all()
                assert (people.slot == -1).all()
                continue
            p = influence(choice(q[place], tiny_choices.applicable[place], beta), told, theta)
            p = lapse(p, tiny_choices.applicable[place], model.lapse)
            seen = np.bincount(people.slot, minlength=len(p)) / n
            assert (np.abs(seen - p) < 5 * np.sqrt(p * (1 - p) / n) + 1e-12).all()
            assert (people.x == tiny_choices.targets[place, people.slot]).all()
            assert (people.cost == tiny_choices.costs[place, people.slot]).all()
            assert (known.erred == ~tiny_choices.optimal[place, people.slot]).all()
            after = theta
            if told >= 0:
                after = trust(theta, value[x], value[tiny_choices.targets[x, told]], model.eta)
            np.testing.assert_allclose(people.theta, after, rtol=1e-12)
            some = np.arange(50)
            expected = pomdp.update(
                np.repeat(belief[None], 50, axis=0), np.full(50, x), np.full(50, said), people.slot[some]
            )
            np.testing.assert_allclose(known.belief[some], expected, rtol=1e-9, atol=1e-15)


def test_in_the_models_world_the_belief_is_right_on_average(pool: Pool) -> None:
    """People drawn from the prior, on its grid: of those believed to be of a cell with chance p, a share p is."""
    grid = pool.policies[0].pomdp.grid
    mean: list[np.ndarray] = []

    def watched(team: TeamState) -> TeamAction:
        if team.step == 5:
            mean.append(team.belief.sum(axis=3)[:, 0])
        return AttentionSwitching()(team)

    episodes = simulate(pool, watched, humans=[0], episodes=4000, seed=2, world="model")
    assert set(episodes.beta.ravel()) <= set(grid.beta)
    assert set(episodes.theta.ravel()) <= set(grid.theta)
    truth = (episodes.beta == grid.beta).mean(axis=0)
    np.testing.assert_allclose(truth, pool.policies[0].pomdp.prior.sum(axis=1), atol=0.03)
    believed = np.concatenate(mean)
    here = (episodes.beta == grid.beta)[episodes.steps > 5]
    assert len(here) == len(believed)
    sure = believed > 0.3  # calibration where the belief is informative
    assert abs(here[sure].mean() - believed[sure].mean()) < 4 * 0.5 / np.sqrt(sure.sum())


def test_travel_by_hand() -> None:
    far = [[0, 2, 1], [2, 0, 0.5], [1, 0.5, 0]]
    travel = Travel.of(2, c_move=0.4, travel_time=1.5, distance=far)
    one, place = np.zeros(1, dtype=np.int64), np.arange(3)
    assert travel.steps_between(one, place[:, None], place).tolist() == [[0, 3, 2], [3, 0, 1], [2, 1, 0]]
    assert travel.steps_from(place[:, None]).tolist() == [[[0, 3]], [[3, 0]], [[2, 1]]]
    assert travel.entry.tolist() == pytest.approx([0.4, 0.2])
    assert travel.entry_steps.tolist() == [2, 1]
    for wrong in ([[0, 1], [1, 0]], [[0, 2, 1], [2, 0, -1], [1, 1, 0]], [[1, 2, 1], [2, 0, 1], [1, 1, 0]]):
        with pytest.raises(ValueError, match="distance"):
            Travel.of(2, distance=wrong)


def matrices(places: int) -> st.SearchStrategy[np.ndarray]:
    def build(values: list[float]) -> np.ndarray:
        matrix = np.array(values).reshape(places + 1, places + 1)
        return matrix * (1 - np.eye(places + 1))

    size = (places + 1) ** 2
    return st.lists(st.sampled_from([0.0, 0.5, 1.0, 2.5]), min_size=size, max_size=size).map(build)


@costly(5, 25)
@given(st.data())
def test_laws_with_travel_and_people_who_come_and_go(pool: Pool, data: st.DataObject) -> None:
    """The robot acts only on people who are present, pays for travel only when it moves, and rewards add up."""
    humans = data.draw(st.integers(1, 4))
    name = data.draw(st.sampled_from([*POLICIES, "restless"]))
    travel = Travel.of(
        humans,
        c_move=data.draw(st.sampled_from([0.0, 0.3, 1.0])),
        travel_time=data.draw(st.sampled_from([0.0, 1.0, 2.0])),
        distance=data.draw(matrices(humans)),
    )
    joins = data.draw(st.lists(st.integers(0, 6), min_size=humans, max_size=humans))
    stays = data.draw(st.lists(st.integers(1, 30), min_size=humans, max_size=humans))
    presence = Schedule.of(humans, joins, np.add(joins, stays))
    rng = np.random.default_rng(0)

    def restless(team: TeamState) -> TeamAction:
        return team.act(np.array([rng.choice(np.flatnonzero(row)) for row in team.active]), team.first_optimal())

    inner = restless if name == "restless" else pool.policy(name, travel)
    decided: list[tuple[int, int, int, int]] = []

    def watched(team: TeamState) -> TeamAction:
        action = inner(team)
        if team.belief is not None:
            np.testing.assert_allclose(team.belief.sum(axis=(2, 3)), 1, atol=1e-9)
        decided.append((team.step, int(team.location[0, 0]), int(action.person[0, 0]), int(action.action[0, 0])))
        return action

    watched.uses_belief = getattr(inner, "uses_belief", True)  # type: ignore[attr-defined]
    trace: Trace = []
    episode = simulate(
        pool, watched, humans=humans, episodes=[7], seed=data.draw(st.integers(0, 99)), travel=travel,
        presence=presence, trace=trace,
    )[0]  # fmt: skip
    assert episode.discounted_return == pytest.approx(sum(0.99 ** r["step"] * r["reward"] for r in trace), abs=1e-9)
    moves, busy_until = 0, 0
    paid = {(row["step"], row["place"]): -row["reward"] - row["cost"] for row in trace}
    for step, location, person, said in decided:
        assert step >= busy_until  # committed while under way
        if person == NOBODY:
            continue
        assert joins[person] <= step < joins[person] + stays[person]
        moved = location != person
        moves += moved
        busy_until = step + int(travel.steps_between(np.array(0), np.array(location), np.array(person)))
        assert said == 0 or busy_until == step
        expected = travel.c_move[0] * travel.distance[location, person] + 0.5 * (said > 0)
        assert paid.pop((step, person)) == pytest.approx(expected, abs=1e-9)
    assert episode.moves == moves
    assert sum(episode.helped) == episode.interventions
    assert all(rest == pytest.approx(0, abs=1e-9) for rest in paid.values())
    for k in range(humans):
        own = [row["step"] for row in trace if row["place"] == k]
        assert own == list(range(joins[k], joins[k] + episode.actions[k]))
        assert episode.finished[k] or episode.actions[k] == min(stays[k], 500 - joins[k])


def test_execution_by_the_robot(tiny_choices: Choices) -> None:
    """If execution is free, the robot does half of the work of a single person."""
    setting = Setting(execute=True, c_execute=0.0, c_move=0.0)
    pool = Pool.sample(tiny_choices, 2, seed=0, setting=setting)
    trace: Trace = []
    episodes = simulate(pool, pool.policy("attention"), humans=1, episodes=50, seed=0, trace=trace)
    assert episodes.finished.all()
    assert episodes.actions.min() == 3
    done = sum(row["executed"] is not None for row in trace)
    said = sum(row["suggestion"] is not None for row in trace)
    assert (episodes.executed.sum(), episodes.helped.sum()) == (done, done + said)
    summary = episodes.summary().record()
    assert summary["executions"]["mean"] * 50 == pytest.approx(done)
    assert summary["suggestions"]["mean"] + summary["executions"]["mean"] == summary["interventions"]["mean"]
    assert done > 0
    assert sum(row["reward"] for row in trace) == pytest.approx(-episodes.costs.sum())


def test_teams_may_differ_from_episode_to_episode(tiny_choices: Choices) -> None:
    pool = Pool.sample(tiny_choices, 4, seed=0)
    teams = np.array([[0, 1], [2, 3], [0, 1]])
    episodes = simulate(pool, pool.policy("attention"), humans=teams, episodes=3, seed=1)
    assert episodes.people.tolist() == teams.tolist()
    alone = simulate(pool, pool.policy("attention"), humans=[2, 3], episodes=[1], seed=1)
    assert episodes[1] == alone[0]
    with pytest.raises(ValueError, match="one row for each of 3 episodes"):
        simulate(pool, pool.policy("none"), humans=teams[:2], episodes=3, seed=1)
    with pytest.raises(ValueError, match="from 0 to 3"):
        simulate(pool, pool.policy("none"), humans=teams + 1, episodes=3, seed=1)


def test_people_who_left_are_not_cut_off(pool: Pool) -> None:
    """An episode is cut off if a person could have continued after the last step."""
    short = replace(pool, setting=replace(pool.setting, max_steps=3))
    for leaves, cut in ((1, 0), (3, 0), (4, 20)):
        presence = Schedule.of(2, leaves=[leaves, leaves])
        episodes = simulate(short, "none", humans=2, episodes=20, seed=0, presence=presence)
        assert not episodes.finished.any()
        assert all(one.actions == (min(leaves, 3),) * 2 for one in episodes)
        assert episodes.summary().cut_off == cut


def test_a_model_without_lapses_that_people_contradict_is_an_error(tiny: Table) -> None:
    """The robot believes that everybody chooses by true costs and follows at once; these people do not."""
    people = Population(theta=(0.9, 0.95), sigma=(2.0, 3.0))
    setting = Setting(knowledge="exact", c_suggest=0.01, lapse=0.0, eta=1.0)
    pool = Pool.sample(tiny, 6, seed=3, population=people, setting=setting)
    with pytest.raises(ImpossibleObservationError, match="a lapse rate above 0 in the model rules this out"):
        simulate(pool, "attention", humans=3, episodes=300, seed=1)
