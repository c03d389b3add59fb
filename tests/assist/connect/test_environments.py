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
from assist.connect import RobotsEnv, parallel_env
from assist.connect.gymnasium import ID, TeamEnv, TeamVectorEnv
from assist.people import Choices, Population, outcome_at_disagreement
from assist.person import Robot, Setting, shared_task
from assist.team.policy_names import POLICIES
from planner import OnDemand, Table

EPISODES = 3


def total(env: Any, policy: str) -> list[float]:
    """Return the discounted return of each episode in which a team policy decides, in an environment or for agents."""
    chooses, agents = env.pool.policy(policy, env.team.travel), isinstance(env, RobotsEnv)
    returns = []
    for episode in range(EPISODES):
        seen, info = env.reset(seed=5 if episode == 0 else None)
        discounted, step, over = 0.0, 0, False
        assert not any(one["erred"].any() for one in (seen.values() if agents else [seen]))
        while not over:
            if agents:  # each sees its own place first, and possible actions are legal
                assert all(seen[agent] in env.observation_space(agent) for agent in env.agents)
                first = [int(seen[agent]["location"][0]) for agent in env.agents]
                assert first == (env.team.location.reshape(-1) + 1).tolist()
                actions = env.encode(chooses(env.team))
                assert all(seen[agent]["action_mask"][number] for agent, number in actions.items())
                seen, rewards, *_, info = env.step(actions)
                assert len(set(rewards.values())) == 1
                illegal, reward, over = [one["illegal"] for one in info.values()], rewards["robot_0"], not env.agents
            else:
                np.testing.assert_allclose(seen["cost_to_go"], env.team.cost_to_go()[0], rtol=1e-6)
                action = env.encode(chooses(env.team)) if env.is_free else np.zeros_like(env.action_space.sample())
                seen, reward, terminated, truncated, info = env.step(action)
                illegal, over = info["illegal"], terminated or truncated
            assert not np.any(illegal)
            discounted += env.pool.setting.gamma**step * reward
            step += 1
        returns.append(discounted)
    return returns


PLAIN = Setting(c_suggest=0.5)
RULE = Setting(c_suggest=0.0, c_move=0.0, trust=outcome_at_disagreement(-4.0, 4.0, 4.0), max_steps=40)
FAR = Setting(c_suggest=0.1, travel_time=2.0, max_steps=8)
TWO = Setting(c_suggest=0.1, robots=2, max_steps=30)
DIFFERENT = replace(
    TWO, robots=(Robot(execute=True, c_execute=0.1, c_move=0.4), Robot(c_suggest=0.05, travel_time=1.0))
)
GOALS = Setting(c_suggest=0.01, c_move=0.0, knowledge="exact", max_steps=30)


@pytest.mark.parametrize(
    ("policy", "setting", "world", "kind"),
    [
        ("attention", RULE, "people", TeamEnv),
        ("priority", FAR, "model", TeamEnv),
        ("priority", replace(TWO, travel_time=2.0), "people", TeamEnv),
        ("priority", DIFFERENT, "people", TeamEnv),
        ("attention", GOALS, "people", TeamEnv),
        ("reactive", GOALS, "model", TeamEnv),
        ("priority", Setting(c_suggest=0.1), "people", RobotsEnv),
        ("priority", TWO, "people", RobotsEnv),
    ]
    + [pytest.param(*one.values, PLAIN, "people", TeamEnv, marks=one.marks) for one in thinned(POLICIES, every=4)],
)
def test_an_episode_is_the_simulators(
    tiny_choices: Choices, policy: str, setting: Setting, world: Any, kind: type[Any]
) -> None:
    """A learner is shown the mean cost-to-go under its belief, as a team policy is."""
    task, easy = (three_goals("tiny"), Population(beta=(0.1, 0.4))) if setting is GOALS else (tiny_choices, None)
    pool = Pool.sample(task, 4, seed=2, setting=setting, population=easy)
    found = simulate(pool, policy, humans=3, episodes=EPISODES, seed=5, world=world)
    assert found.interventions.any() or setting is PLAIN
    assert found.executed.any() == (setting is DIFFERENT)
    assert not found.finished.all() or setting is not FAR  # where some are cut off
    assert total(kind(pool, 3, world=world), policy) == pytest.approx(found.discounted_return.tolist(), abs=1e-9)


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
    "options",
    thinned([{"goals": True}, {"knowledge": "exact", "suggestions": "all"}, {}, {"robots": 2}], every=4)
    + thinned([{"on demand": "tiny", "suggestions": "all"}, {"on demand": "sealed", "suggestions": "all"}]),
)
def test_on_rows_that_grow_all_is_seen_as_on_the_whole_task(
    options: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The spaces are the same, and so is whatever is seen and received in many episodes of actions at random.

    On demand, the numbers of states and of robot actions are upper bounds; states are numbered as met.
    """
    chosen = dict(options)
    asked = chosen.pop("on demand", None)
    table = kit(asked or "tiny")
    task: Any = three_goals("tiny") if chosen.pop("goals", False) else table
    setting = Setting(c_suggest=0.1, max_steps=25, **chosen)
    monkeypatch.setattr(shared_task, "ROWS", 30)
    size = {"region": 10**6} if asked else {"states": 1, "region": 10**6}
    whole, part = (
        TeamVectorEnv(Pool.sample(one, 3, seed=1, setting=setting, **more), 5, 2)
        for one, more in ((task, {}), (OnDemand(table.task, jobs=1) if asked else task, size))
    )
    assert part.pool.policies[0].problem.region is not None
    few, many = (env.single_observation_space["alone"].shape[1] for env in (whole, part))
    dead, lost = (env.single_observation_space["cost_to_go"].high for env in (whole, part))
    if asked:
        assert few <= many == 1 + table.task.most_at_once
        assert np.diff(table.space.transitions.offsets).max() <= table.task.most_at_once
        assert (part.single_observation_space["state"].nvec >= len(table)).all()
        assert (lost == 25 * table.task.action_costs.max(initial=1.0) + 1).all()
    else:
        assert (part.observation_space, part.action_space) == (whole.observation_space, whole.action_space)
    rng, helped = np.random.default_rng(3), 0
    seen, other = (env.reset(seed=4)[0] for env in (whole, part))
    for _ in range(40):
        if asked:
            seen["cost_to_go"] = np.where(seen["cost_to_go"] == dead, lost, seen["cost_to_go"])
            assert part.observation_space.contains(other)
            assert not other["alone"][..., few:].any()
            other["alone"] = other["alone"][..., :few]
        for name, array in seen.items():
            if not asked or name not in ("action_mask", "state"):
                np.testing.assert_allclose(other[name], array, rtol=1e-6, err_msg=name)
        mask = seen["action_mask"].reshape(5, len(setting.fleet), -1).astype(float)
        actions = np.array([[rng.choice(row.size, p=row / row.sum()) for row in team] for team in mask])
        actions = actions.reshape(whole.action_space.shape)
        helped += int((actions > 0).sum())
        person, robot = np.divmod(actions - 1, few)
        found, same = whole.step(actions), part.step(np.where(actions == 0, 0, 1 + person * many + robot))
        assert not asked or not same[4]["illegal"].any()
        for k in range(1, 4):
            np.testing.assert_allclose(same[k], found[k], atol=1e-12)
        seen, other = found[0], same[0]
    assert helped > 40


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


def test_of_two_robots_that_want_the_same_person_the_first_goes_there(tiny_choices: Choices) -> None:
    env = parallel_env(Pool.sample(tiny_choices, 2, seed=2, setting=Setting(robots=2)), 2)
    env.reset(seed=1)
    seen, *_, info = env.step({"robot_0": 1, "robot_1": 1})
    assert [info[agent]["illegal"] for agent in env.agents] == [False, True]
    assert seen["robot_0"]["location"].tolist() == [1, 0]
    assert seen["robot_1"]["location"].tolist() == [0, 1]
    for actions in ({"robot_0": -1, "robot_1": 0}, {"robot_0": 0, "robot_1": 999}, {"robot_0": 0}, {"robot_1": 0}):
        with pytest.raises(ValueError, match=r"a whole number from 0 to \d+, for each of 2 robots|one of robot_[01]"):
            env.step(actions)
