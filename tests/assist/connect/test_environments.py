"""Teams as environments of Gymnasium and PettingZoo: the libraries' own checks, and the simulator's episodes."""

from __future__ import annotations

import importlib
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from conftest import kit, thinned
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test
from pettingzoo.utils.conversions import parallel_to_aec
from test_unknown_goals import three_goals

from assist import Pool, simulate
from assist.connect import parallel_env
from assist.connect.gymnasium import ID, TeamEnv, TeamVectorEnv
from assist.people import Choices, Population, outcome_at_disagreement
from assist.person import Robot, Setting, shared_task
from assist.team.policy_names import POLICIES
from planner import OnDemand, Table

EPISODES = 3


def total(env: TeamEnv, policy: str) -> list[float]:
    """Return the discounted return of each episode in which a team policy decides."""
    chooses = env.pool.policy(policy, env.team.travel)
    returns = []
    for episode in range(EPISODES):
        env.reset(seed=5 if episode == 0 else None)
        discounted, step, over = 0.0, 0, False
        while not over:
            action = env.encode(chooses(env.team)) if env.is_free else np.zeros_like(env.action_space.sample())
            _, reward, terminated, truncated, info = env.step(action)
            assert not np.any(info["illegal"])
            discounted += env.pool.setting.gamma**step * reward
            step, over = step + 1, terminated or truncated
        returns.append(discounted)
    return returns


@pytest.mark.parametrize("policy", thinned(POLICIES, every=4))
def test_an_episode_is_the_simulators(pool: Pool, policy: str) -> None:
    found = simulate(pool, policy, humans=2, episodes=EPISODES, seed=5)
    assert total(TeamEnv(pool, 2), policy) == pytest.approx(found.discounted_return.tolist(), abs=1e-9)


RULE = Setting(c_suggest=0.0, c_move=0.0, trust=outcome_at_disagreement(-4.0, 4.0, 4.0), max_steps=40)
FAR = Setting(c_suggest=0.1, travel_time=2.0, max_steps=8)
TWO = Setting(c_suggest=0.1, robots=2, max_steps=30)
DIFFERENT = replace(
    TWO, robots=(Robot(execute=True, c_execute=0.1, c_move=0.4), Robot(c_suggest=0.05, travel_time=1.0))
)


@pytest.mark.parametrize(
    ("policy", "setting", "world"),
    [
        ("attention", RULE, "people"),
        ("priority", FAR, "model"),
        ("priority", replace(TWO, travel_time=2.0), "people"),
        ("priority", DIFFERENT, "people"),
    ],
)
def test_an_episode_is_the_simulators_whatever_the_setting(
    tiny_choices: Choices, policy: str, setting: Setting, world: str
) -> None:
    pool = Pool.sample(tiny_choices, 4, seed=2, setting=setting)
    found = simulate(pool, policy, humans=3, episodes=EPISODES, seed=5, world=world)
    assert found.interventions.any()
    assert found.executed.any() == (setting is DIFFERENT)
    assert not found.finished.all() or setting is not FAR  # where some are cut off
    assert total(TeamEnv(pool, 3, world=world), policy) == pytest.approx(found.discounted_return.tolist())


def test_what_a_robot_cannot_do_is_masked(tiny_choices: Choices) -> None:
    _, info = TeamEnv(Pool.sample(tiny_choices, 4, seed=2, setting=DIFFERENT), 3).reset(seed=1)
    first, second = info["action_mask"]
    assert first.sum() > second.sum() > 1


def test_many_teams_at_a_time_have_the_simulators_first_episodes(pool: Pool) -> None:
    found = simulate(
        pool, "attention", humans=2, episodes=70, seed=5
    )  # random numbers are drawn for 64 episodes at a time
    env = TeamVectorEnv(pool, 70, 2)
    chooses = pool.policy("attention")
    env.reset(seed=5)
    assert env.np_random_seed == 5
    returns, going, begun = np.zeros(70), np.ones(70, dtype=bool), 0
    for step in range(pool.setting.max_steps):
        assert (env.team.clock[going] == step).all()
        seen, reward, terminated, truncated, info = env.step(env.encode(chooses(env.team)))
        assert seen in env.observation_space
        assert (info["action_mask"] == seen["action_mask"]).all()
        returns[going] += pool.setting.gamma**step * reward[going]
        ended = terminated | truncated
        begun += int((~going & (seen["active"].all(axis=1)) & (seen["location"] == 0)).sum())
        going &= ~ended
        if not going.any():
            break
    assert returns == pytest.approx(found.discounted_return)
    assert begun > 0  # finished teams are reset while others continue
    assert env.team.clock.min() < env.team.step


@pytest.mark.parametrize(
    "options", thinned([{"goals": True}, {"knowledge": "exact", "suggestions": "all"}, {}, {"robots": 2}], every=4)
)
def test_on_rows_that_grow_all_is_seen_as_on_the_whole_task(
    tiny: Table, options: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The spaces are the same, and so is whatever is seen and received in many episodes of actions at random."""
    task, setting = (
        (three_goals("tiny") if options.pop("goals", False) else tiny),
        Setting(c_suggest=0.1, max_steps=25, **options),
    )
    monkeypatch.setattr(shared_task, "ROWS", 30)
    whole, part = (
        TeamVectorEnv(Pool.sample(task, 3, seed=1, setting=setting, **size), 5, 2)
        for size in ({}, {"states": 1, "region": 10**6})
    )
    assert part.pool.policies[0].problem.region is not None
    assert part.observation_space == whole.observation_space
    assert part.action_space == whole.action_space
    rng, helped = np.random.default_rng(3), 0
    seen, other = (env.reset(seed=4)[0] for env in (whole, part))
    for _ in range(40):
        for name, array in seen.items():
            np.testing.assert_allclose(other[name], array, rtol=1e-6, err_msg=name)
        mask = seen["action_mask"].reshape(5, len(setting.fleet), -1).astype(float)
        actions = np.array([[rng.choice(row.size, p=row / row.sum()) for row in team] for team in mask])
        actions = actions.reshape(whole.action_space.shape)
        helped += int((actions > 0).sum())
        found, same = whole.step(actions), part.step(actions)
        for k in range(1, 4):
            np.testing.assert_allclose(same[k], found[k], atol=1e-12)
        seen, other = found[0], same[0]
    assert helped > 40


@pytest.mark.parametrize("name", thinned(["tiny", "sealed"]))
def test_states_on_demand_give_the_episodes_of_the_whole_task(name: str) -> None:
    """Of the spaces, the numbers of states and of robot actions are upper bounds; states are numbered as met."""
    table, setting = kit(name), Setting(c_suggest=0.1, max_steps=25, suggestions="all")
    whole, asked = (
        TeamVectorEnv(Pool.sample(task, 3, seed=1, setting=setting, region=10**6), 5, 2)
        for task in (table, OnDemand(table.task, jobs=1))
    )
    few, many = (env.single_observation_space["alone"].shape[1] for env in (whole, asked))
    assert few <= many == 1 + table.task.most_at_once
    assert np.diff(table.space.transitions.offsets).max() <= table.task.most_at_once
    assert (asked.single_observation_space["state"].nvec >= len(table)).all()
    rng, seen, other = np.random.default_rng(3), *(env.reset(seed=4)[0] for env in (whole, asked))
    for _ in range(40):
        for field, array in seen.items():
            if field not in ("action_mask", "alone", "state", "cost_to_go"):
                np.testing.assert_allclose(other[field], array, rtol=1e-6, err_msg=field)
        dead = seen["cost_to_go"] == whole.single_observation_space["cost_to_go"].high
        lost = asked.single_observation_space["cost_to_go"].high
        assert (lost == 25 * table.task.action_costs.max(initial=1.0) + 1).all()
        np.testing.assert_array_equal(other["cost_to_go"], np.where(dead, lost, seen["cost_to_go"]))
        np.testing.assert_allclose(other["alone"][..., :few], seen["alone"], rtol=1e-6)
        assert not other["alone"][..., few:].any()
        assert asked.observation_space.contains(other)
        actions = np.array([rng.choice(np.flatnonzero(mask)) for mask in seen["action_mask"]])
        person, robot = np.divmod(actions - 1, few)
        found, same = whole.step(actions), asked.step(np.where(actions == 0, 0, 1 + person * many + robot))
        assert not same[4]["illegal"].any()
        for k in range(1, 4):
            np.testing.assert_allclose(same[k], found[k], atol=1e-12)
        seen, other = found[0], same[0]


@pytest.mark.slow
def test_an_environment_of_a_task_on_demand_passes_the_library_check(tiny: Table) -> None:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*not able to test alternative render modes.*")
        check_env(TeamEnv(OnDemand(tiny.task, jobs=1), 2), skip_render_check=True)
    parallel_api_test(parallel_env(OnDemand(tiny.task, jobs=1), 2), num_cycles=20)


def test_gymnasium_finds_nothing_wrong(pool: Pool) -> None:
    env = gymnasium.make("kitassist/Team-v0", instance="kitting/tiny", humans=2)
    assert "belief" in env.observation_space.spaces
    check_env(env.unwrapped)
    unseen = TeamEnv(pool, 2, beliefs=False)
    assert "belief" not in unseen.observation_space.spaces
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*not able to test alternative render modes.*")
        check_env(unseen, skip_render_check=True)


def test_it_is_found_by_its_module_with_nothing_imported_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(gymnasium.registry, ID)
    monkeypatch.delitem(sys.modules, "assist.connect.gymnasium")
    monkeypatch.setattr("assist.connect.gymnasium", None)  # is put back afterwards
    env = gymnasium.make(f"assist.connect.gymnasium:{ID}", instance="kitting/tiny", humans=1)
    assert env.spec is not None
    assert env.spec.id == ID


def test_many_are_made_natively() -> None:
    env = gymnasium.make_vec(ID, num_envs=3, instance="kitting/tiny", humans=2)
    assert isinstance(env.unwrapped, TeamVectorEnv)
    first, _ = env.reset(seed=[1, 2, 3])
    again, _ = env.reset(seed=[1, 2, 3])
    assert all((first[name] == again[name]).all() for name in first)
    unseen = TeamVectorEnv(env.unwrapped.pool, 3, 2, beliefs=False)
    other, _ = unseen.reset(seed=[1, 2, 3])
    assert {*first} - {*other} == {"belief"}
    for _ in range(3):  # without beliefs, the dynamics are the same
        first, *_ = env.step(np.zeros(3, dtype=int))
        other, *_ = unseen.step(np.zeros(3, dtype=int))
        assert (first["state"] == other["state"]).all()


def test_what_is_not_possible_does_nothing_and_says_so(pool: Pool) -> None:
    env, quiet = TeamEnv(pool, 2), TeamEnv(pool, 2)
    env.reset(seed=1)
    quiet.reset(seed=1)
    env.step(0)
    quiet.step(0)
    (forbidden, *_) = np.flatnonzero(~env.action_masks())
    seen, reward, *_, info = env.step(int(forbidden))
    other, same, *_, said = quiet.step(0)
    assert (info["illegal"], said["illegal"]) == (True, False)
    assert reward == same
    assert all(np.array_equal(seen[name], other[name]) for name in seen)
    with pytest.raises(ValueError, match="expected a whole number from 0 to"):
        env.step(1000)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"episode": 1.7}, "episode 1.7: expected a whole number"),
        ({"episode": -1}, "episode -1: expected a whole number"),
        ({"team": [0]}, "team of 1: expected 2 people"),
        ({"team": [0, 1, 2]}, "team of 3: expected 2 people"),
        ({"team": [-1, 0]}, "expected names of people, or their numbers"),
        ({"team": [0.9, 1.2]}, "expected names of people, or their numbers"),
        ({"team": [99, 0]}, "expected names of people, or their numbers"),
    ],
)
def test_options_of_an_episode_that_do_not_fit_are_refused(pool: Pool, options: dict[str, Any], words: str) -> None:
    env = TeamEnv(pool, 2)
    env.reset(seed=1)
    with pytest.raises(ValueError, match=words):
        env.reset(options=options)
    assert env.reset()[1]["episode_number"] == 1  # none was begun
    assert env.reset(options={"team": pool.names[1::-1]})[1]["people"].tolist() == [1, 0]


def test_options_that_there_are_not_are_warned_of(pool: Pool) -> None:
    with pytest.warns(UserWarning, match="'episod' has no effect; did you mean 'episode'"):
        assert TeamEnv(pool, 2).reset(seed=1, options={"episod": 3})[1]["episode_number"] == 0
    with pytest.warns(UserWarning, match="'episode' has no effect"):
        TeamVectorEnv(pool, 2).reset(seed=1, options={"episode": 3})


@pytest.mark.parametrize("action", [1.7, "1", True, None])
def test_actions_are_whole_numbers(pool: Pool, action: Any) -> None:
    one, many = TeamEnv(pool, 2), TeamVectorEnv(pool, 2)
    for env, given in ((one, action), (many, [action, action])):
        env.reset(seed=1)
        with pytest.raises(ValueError, match=r"expected (a whole number|whole numbers) from 0"):
            env.step(given)
        env.step(np.zeros_like(given, dtype=np.uint8))  # of any size


def test_environments_know_the_worlds_that_simulations_know(pool: Pool) -> None:
    for made in (TeamEnv, TeamVectorEnv):
        with pytest.raises(ValueError, match="world 'modle': expected 'people' or 'model'"):
            made(pool, world="modle")


def test_a_suggestion_is_heard(pool: Pool) -> None:
    """After a suggestion, the observation of the person changes and the robot is there."""
    env = TeamEnv(pool, 2)
    seen, info = env.reset(seed=2)
    action = int(np.flatnonzero(info["action_mask"])[-1])
    after, reward, *_ = env.step(action)
    assert (seen["location"], after["location"]) == (0, 2)
    assert reward == pytest.approx(-(2 + pool.setting.c_move + pool.setting.c_suggest))
    assert not np.array_equal(seen["belief"][1], after["belief"][1])


def test_a_team_is_drawn() -> None:
    env = gymnasium.make(ID, instance="kitting/tiny", humans=2, render_mode="rgb_array")
    env.reset(seed=0)
    first = env.render()
    env.step(0)
    second = env.render()
    assert first.dtype == np.uint8
    assert first.shape[2] == 3
    assert first.shape != second.shape or not np.array_equal(first, second)
    drawn = TeamEnv("kitting/tiny", 1, render_mode="svg")
    drawn.reset(seed=0)
    assert "person 1, step 0" in drawn.render()


@pytest.mark.parametrize("actions", [{"robot_0": -1, "robot_1": 0}, {"robot_0": 99, "robot_1": 0}, {"robot_1": 0}])
def test_an_action_of_an_agent_is_one_of_its_robot(tiny_choices: Choices, actions: dict[str, int]) -> None:
    env = parallel_env(Pool.sample(tiny_choices, 2, seed=2, setting=Setting(robots=2)), 2)
    env.reset(seed=1)
    with pytest.raises(
        ValueError, match=r"expected (a whole number from 0 to \d+, for each of 2 robots|one of robot_0)"
    ):
        env.step(actions)


def test_an_environment_needs_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from planner.system.errors import MissingExtraError

    monkeypatch.setitem(sys.modules, "gymnasium", None)
    for name in ("assist.connect.gymnasium", "assist.connect.pettingzoo"):
        monkeypatch.delitem(sys.modules, name)
        with pytest.raises(MissingExtraError, match=r"environments need gymnasium: .*\[gym\]"):
            importlib.import_module(name)
    assert tmp_path.exists()


def test_robots_that_differ_and_act_at_random_never_attend_to_the_same_person(tiny_choices: Choices) -> None:
    robots = (Robot(execute=True), Robot(c_move=0.1), Robot(travel_time=1.0))
    pool = Pool.sample(tiny_choices, 4, seed=2, setting=Setting(robots=robots, max_steps=30))
    env = parallel_env(pool, 3)
    rng, made_room = np.random.default_rng(0), False
    for episode in range(5):
        _, info = env.reset(seed=episode)
        while env.agents:
            before = env.team.location[0].copy()
            wanted = {agent: int(rng.choice(np.flatnonzero(info[agent]["action_mask"]))) for agent in env.agents}
            *_, info = env.step(wanted)
            there = env.team.location[0]
            assert len(set(there[there >= 0].tolist())) == (there >= 0).sum()
            made_room |= bool(((there < 0) & (before >= 0)).any())
    assert made_room


def test_two_robots_that_act_at_random_never_attend_to_the_same_person() -> None:
    slow = {"instance": "kitting/tiny", "humans": 3, "setting": Setting(robots=2, travel_time=1)}
    env = gymnasium.make("kitassist/Team-v0", **slow)
    check_env(env.unwrapped, skip_render_check=True)
    many = gymnasium.make_vec("kitassist/Team-v0", num_envs=16, **slow)
    seen, info = many.reset(seed=1)
    many.action_space.seed(1)
    collided = False
    for _ in range(30):
        assert seen in many.observation_space
        assert ((seen["location"][:, 0] != seen["location"][:, 1]) | (seen["location"] == 0).all(axis=1)).all()
        assert (info["action_mask"][~seen["ready"].astype(bool)][:, 1:] == 0).all()
        numbers = many.action_space.sample()
        allowed = np.take_along_axis(info["action_mask"], numbers[..., None], axis=2)[..., 0] > 0
        seen, *_, info = many.step(numbers)
        collided |= bool((info["illegal"] & allowed).any())
    assert collided
    with pytest.raises(ValueError, match=r"expected a whole number from 0 to \d+, for each of 2 robots"):
        env.unwrapped.step(0)


@pytest.mark.parametrize(
    "robots", [pytest.param(1, marks=pytest.mark.slow), 2, pytest.param(3, marks=pytest.mark.slow)]
)
def test_pettingzoo_finds_nothing_wrong_with_moving_robots(
    tiny_choices: Choices, robots: int, capsys: pytest.CaptureFixture[str]
) -> None:
    pool = Pool.sample(tiny_choices, 3, seed=2, setting=Setting(robots=robots, travel_time=1, max_steps=30))

    def make() -> object:
        return parallel_env(instance=pool, humans=2)

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*(action mask|Action mask|observation|NaN).*")
        parallel_api_test(make(), num_cycles=60)
        parallel_seed_test(make, num_cycles=20)
        api_test(parallel_to_aec(make()), num_cycles=60)
    assert capsys.readouterr().out.count("Passed") == 2
    assert make().possible_agents == [f"robot_{number}" for number in range(robots)]


@pytest.mark.parametrize("robots", [1, 2])
def test_an_episode_of_agents_is_the_simulators(tiny_choices: Choices, robots: int) -> None:
    """Agents that follow a team policy: same returns; each sees its own place first, and possible actions are legal."""
    pool = Pool.sample(tiny_choices, 4, seed=2, setting=Setting(c_suggest=0.1, robots=robots))
    found = simulate(pool, "priority", humans=3, episodes=EPISODES, seed=5)
    env = parallel_env(pool, 3)
    chooses, returns = pool.policy("priority", env.team.travel), []
    for episode in range(EPISODES):
        seen, _ = env.reset(seed=5 if episode == 0 else None)
        discounted, step = 0.0, 0
        while env.agents:
            for agent in env.agents:
                assert seen[agent] in env.observation_space(agent)
            first = [int(seen[agent]["location"][0]) for agent in env.agents]
            assert first == (env.team.location.reshape(-1) + 1).tolist()
            actions = env.encode(chooses(env.team))
            assert all(seen[agent]["action_mask"][number] for agent, number in actions.items())
            seen, reward, *_, info = env.step(actions)
            assert not any(info[agent]["illegal"] for agent in info)
            assert len(set(reward.values())) == 1
            discounted += pool.setting.gamma**step * reward["robot_0"]
            step += 1
        returns.append(discounted)
    assert returns == pytest.approx(found.discounted_return.tolist())


def test_of_two_robots_that_want_the_same_person_the_first_goes_there(tiny_choices: Choices) -> None:
    env = parallel_env(Pool.sample(tiny_choices, 2, seed=2, setting=Setting(robots=2)), 2)
    env.reset(seed=1)
    seen, *_, info = env.step({"robot_0": 1, "robot_1": 1})
    assert [info[agent]["illegal"] for agent in env.agents] == [False, True]
    assert seen["robot_0"]["location"].tolist() == [1, 0]
    assert seen["robot_1"]["location"].tolist() == [0, 1]
    with pytest.raises(ValueError, match="actions: expected one of robot_1"):
        env.step({"robot_0": 0})
    with pytest.raises(ValueError, match=r"action .* expected a whole number from 0 to"):
        env.step({"robot_0": 0, "robot_1": 999})


@pytest.mark.parametrize("world", ["people", "model"])
def test_an_episode_is_the_simulators_where_goals_are_unknown(world: str) -> None:
    """A learner is shown the mean cost-to-go under its belief, as a team policy is."""
    setting = Setting(c_suggest=0.01, c_move=0.0, knowledge="exact", max_steps=30)
    pool = Pool.sample(three_goals("tiny"), 4, seed=2, setting=setting, population=Population(beta=(0.1, 0.4)))
    for policy in ("reactive", "attention"):
        found = simulate(pool, policy, humans=2, episodes=EPISODES, seed=5, world=world)
        assert found.interventions.any()
        assert total(TeamEnv(pool, 2, world=world), policy) == pytest.approx(found.discounted_return.tolist(), abs=1e-9)
    env = TeamEnv(pool, 2, world=world)
    seen, _ = env.reset(seed=3)
    for _ in range(5):
        np.testing.assert_allclose(seen["cost_to_go"], env.team.cost_to_go()[0], rtol=1e-6)
        seen = env.step(0)[0]
    assert seen["belief"].shape == (2, *pool.policies[0].pomdp.prior.shape)
