"""People who pursue one of several goals: the belief, the policy, the simulation and the live assistant."""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT, invoke, kit, thinned
from graphs import graph_task
from histories import Steps, by_enumeration
from hypothesis import given, settings
from hypothesis import strategies as st
from teams import equal

from assist.certify import upper_bound
from assist.declare.declared import plain
from assist.learning import Log, infer_goals
from assist.live import Assistant, Session
from assist.people import Choices, Goals, HumanModel, Population, boltzmann
from assist.people.hidden_type import HiddenType
from assist.person import AssistPOMDP, ObservationModel, OfRobots, Setting, qmdp
from assist.person.known_states import KnownStates
from assist.team import Pool, Schedule, simulate
from assist.team.belief_trace import Watched
from assist.team.questions import GoalQuestion, Questions, benefit
from planner import InputFileError, LimitError, Table, sweep, sweep_goals

PRIOR = {"a": 0.5, "b": 0.2, "c": 0.3}
LAPSE, ETA = 0.01, 0.2
KITS = ROOT / "docs" / "examples" / "kits"


@cache
def three_goals(name: str) -> Goals:
    """A shipped kitting task with its own goal, and with some facts of two states on a random walk."""
    table, rng = kit(name), np.random.default_rng(5)
    task, at, goals = table.task, table.initial, [table.task.goal]
    first = table.values([at])[0][-2:].tolist()
    while len(goals) < 3:
        at = int(rng.choice(table.choices([at]).targets))
        facts = tuple(enumerate(table.values([at])[0].tolist()))[-2:]
        if [value for _, value in facts] != first and facts not in goals:
            goals.append(facts)
    tables = sweep_goals([replace(task, goal=goal) for goal in goals])
    return Goals(dict(zip("abc", tables, strict=True)), PRIOR, sharpness=1)


SMALL = Population(beta=(0.2, 1.4), theta=(0.3, 0.8))


@pytest.mark.parametrize("name", thinned(["sealed", "tiny"]))
@settings(max_examples=2, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_the_belief_is_that_of_enumerated_histories(name: str, seed: int) -> None:
    """Through suggestions, trust, lapses, and the knowledge that a person goes on."""
    goals = three_goals(name)
    setting = Setting(knowledge="exact", lapse=LAPSE, eta=ETA, suggestions="all", c_suggest=0.0, max_steps=4)
    pool = Pool.sample(goals, 2, seed=seed, setting=setting, population=SMALL)
    choices, trace = pool.choices(0), list[dict[str, Any]]()
    rng = np.random.default_rng(seed)

    def anything(team: Any) -> Any:
        count = team.policies[0].pomdp.robot_actions[team.x]
        return team.act(np.where(team.active.any(axis=1), team.active.argmax(axis=1), -1), rng.integers(count))

    watched = Watched(anything)
    simulate(pool, watched, humans=2, episodes=1, seed=seed, trace=trace)
    for place in (0, 1):
        steps, x = Steps(), choices.initial
        for row in (row for row in trace if row["place"] == place):
            if steps:
                known = by_enumeration(pool.policies[0].pomdp, steps, works=False)[x]
                np.testing.assert_allclose(_going_on(known, goals, x), watched.seen[row["step"]][place], atol=1e-12)
            steps.append((ObservationModel(), row["suggestion"], row["action"]))
            slot = [choices.name(x, a) for a in range(choices.applicable[x].sum())].index(row["action"])
            x = int(choices.targets[x, slot])


def _going_on(belief: np.ndarray, goals: Goals, x: int) -> np.ndarray:
    """Condition a belief on the fact that the person has not reached their goal in a state."""
    reached = np.array([table.is_goal([x])[0] for table in goals.tables.values()])
    parts = np.where(reached[:, None, None], 0, belief)
    return (parts / parts.sum()).reshape(-1, belief.shape[-1])


def test_a_single_goal_changes_nothing(tiny: Table) -> None:
    one = Goals({"kit": tiny})
    setting = Setting(c_suggest=0.2)
    terms = Population(weights={"goals": (0.0, 1.0)})
    for pools in (
        [Pool.sample(task, 2, seed=1, setting=setting) for task in (tiny, one)],
        [Pool.sample(task, 2, seed=1, setting=setting, population=terms) for task in (tiny, one)],
        [Pool.sample(task, 2, seed=1, setting=setting, states=1, region=5) for task in (tiny, one)],
    ):
        assert equal(*(simulate(pool, "priority", humans=2, episodes=20, seed=4) for pool in pools))
    told = []
    for task in (tiny, one):
        desk = Assistant(task, ["ann"], setting=setting)
        for action in ("(fetch box-a)", "(place hammer slot-2 box-a)"):
            told.append((desk.recommend().as_dict(), desk.person("ann").belief.tobytes(), desk.explain().as_dict()))
            desk.observe("ann", action)
    assert told[:2] == told[2:]


def problem_of(goals: Goals, **more: Any) -> AssistPOMDP:
    return AssistPOMDP.of(HumanModel.exact(goals.choices()), population=SMALL, **more)


@pytest.mark.parametrize("name", thinned(["tiny", "sealed"]))
def test_values_are_averages_over_the_goals(name: str) -> None:
    """With the same robot actions for all goals, the values are those of people whose goal is known."""
    goals, rng = three_goals(name), np.random.default_rng(1)
    unknown = qmdp(problem_of(goals, suggestions="all", robot=OfRobots(c_suggest=0.2)))
    single = [
        qmdp(problem_of(Goals({key: table}), suggestions="all", robot=OfRobots(c_suggest=0.2)))
        for key, table in goals.tables.items()
    ]
    belief = rng.random((50, *unknown.pomdp.prior.shape))
    belief /= belief.sum(axis=(1, 2), keepdims=True)
    x = rng.integers(len(goals) // 3, size=50)
    reached = np.array([table.is_goal(x) for table in goals.tables.values()])
    parts = belief.reshape(50, 3, -1, belief.shape[2])
    expected = sum(one.value(x, parts[:, g]) for g, one in enumerate(single))
    np.testing.assert_allclose(unknown.value(x, belief), expected, atol=1e-5)
    before = ~reached.any(axis=0)
    q = sum(one.q_values(x[before], parts[before, g]) for g, one in enumerate(single))
    np.testing.assert_allclose(unknown.q_values(x, belief)[before], q, atol=1e-5)


def test_a_suggestion_after_the_goal_costs_and_no_more() -> None:
    goals = three_goals("tiny")
    policy = qmdp(problem_of(goals, robot=OfRobots(c_suggest=0.2)))
    certain = policy.pomdp.prior.reshape(3, -1) * np.array([[0], [1], [0]])
    certain = (certain / certain.sum()).reshape(1, *policy.pomdp.prior.shape)
    x = np.flatnonzero(goals.tables["b"].is_goal(np.arange(len(goals) // 3)))[:1]
    q = policy.q_values(x, certain)[0]
    assert q[0] == 0
    np.testing.assert_allclose(q[1 : policy.pomdp.robot_actions[x[0]]], -0.2)


def test_what_the_robot_knows_of_goals_is_worth_something() -> None:
    """A robot that is told the goals acts on certainty; one that acts on the likeliest goal sees no other."""
    pool = Pool.sample(three_goals("tiny"), 4, seed=2, setting=Setting(c_suggest=0.05, c_move=0.0, knowledge="exact"))
    seen: dict[str, np.ndarray] = {}
    for knows in ("known", "likeliest", "inferred"):
        watched = Watched(pool.policy("attention"))
        trace: list[dict[str, Any]] = []
        simulate(pool, watched, humans=2, episodes=1, seed=5, goals=knows, trace=trace)  # type: ignore[arg-type]
        seen[knows] = np.array([belief.reshape(2, 3, -1).sum(axis=2) for belief in watched.seen.values()])
        if knows == "known":
            own = [next(row["goal"] for row in trace if row["place"] == place) for place in (0, 1)]
            true = np.array([np.array([*"abc"]) == goal for goal in own])
            np.testing.assert_allclose(seen[knows], np.broadcast_to(true, seen[knows].shape))
    np.testing.assert_allclose(seen["likeliest"].max(axis=2), 1)
    np.testing.assert_allclose(seen["inferred"][0], [list(PRIOR.values())] * 2)
    returns = [
        simulate(pool, "attention", humans=2, episodes=300, seed=5, goals=knows).discounted_return.mean()
        for knows in ("known", "inferred")
    ]
    assert returns[0] > returns[1] > simulate(pool, "none", humans=2, episodes=300, seed=5).discounted_return.mean()


def test_goals_occur_as_often_as_the_prior_says() -> None:
    pool = Pool.sample(three_goals("tiny"), 2, seed=2, setting=Setting(max_steps=1, knowledge="exact"))
    for world in ("people", "model"):
        trace: list[dict[str, Any]] = []
        simulate(pool, "none", humans=2, episodes=2000, seed=1, world=world, trace=trace)  # type: ignore[arg-type]
        share = [np.mean([row["goal"] == name for row in trace]) for name in PRIOR]
        assert share == pytest.approx(list(PRIOR.values()), abs=0.03)


def test_a_policy_does_not_see_the_goal() -> None:
    """It is shown the mean cost-to-go under its belief."""
    pool = Pool.sample(three_goals("tiny"), 2, seed=2, setting=Setting(knowledge="exact"))
    tables = three_goals("tiny").tables.values()

    def looks(team: Any) -> Any:
        h = np.stack([table.lookup(team.x) for table in tables], axis=2)
        share = team.belief.reshape(*team.x.shape, 3, -1).sum(axis=3)
        np.testing.assert_allclose(team.cost_to_go(), np.where(team.active, (share * h).sum(axis=2), 0.0))
        return team.act(np.full(len(team.x), -1), np.zeros_like(team.x))

    simulate(pool, looks, humans=2, episodes=5, seed=1)


@pytest.mark.parametrize("policy", thinned(["priority", "attention-never", "whittle"], 3))
def test_with_certainty_a_policy_does_what_it_does_for_people_with_that_goal(policy: str) -> None:
    """Travel takes time, so that the robot stays, comes and goes, with its own values of each."""
    goals, setting = three_goals("tiny"), Setting(c_suggest=0.05, suggestions="all", c_move=0.1, travel_time=1)
    found = []
    for task, knows in ((goals.tables["b"], "inferred"), (Goals(goals.tables, {"a": 0, "b": 1, "c": 0}), "inferred")):
        pool = Pool.sample(task, 3, seed=2, setting=setting)
        found.append(simulate(pool, policy, humans=3, episodes=50, seed=5, goals=knows))  # type: ignore[arg-type]
    assert found[0].interventions.any()
    assert equal(*found)


@pytest.mark.parametrize("policy", thinned(["attention", "attention-never", "priority"], 3))
def test_a_policy_may_assume_the_likeliest_goal_itself(policy: str) -> None:
    """So that the live assistant can, too: as in a simulation whose robot sees that goal only."""
    goals, setting = three_goals("tiny"), Setting(c_suggest=0.05, c_move=0.1, knowledge="exact")
    assuming = replace(goals, assume_likeliest=True)
    options: dict[str, Any] = {"humans": 2, "episodes": 30, "seed": 5}
    plain, own = (Pool.sample(task, 3, seed=2, setting=setting) for task in (goals, assuming))
    found = simulate(own, policy, **options)
    assert equal(found, simulate(plain, policy, goals="likeliest", **options))
    assert not equal(found, simulate(plain, policy, **options))
    desk = Assistant(assuming, ["ann"], setting=setting, policy=policy)
    desk.recommend()
    assert desk.person("ann").goals == pytest.approx(PRIOR)


def test_the_most_probable_goal_alone() -> None:
    belief = np.array([[[0.1, 0.1], [0.3, 0.0], [0.2, 0.3]], [[0.5, 0.0], [0.2, 0.3], [0.0, 0.0]]])
    found = HiddenType(PRIOR, np.ones(1)).given_likeliest(belief)
    np.testing.assert_allclose(found, [[[0, 0], [0, 0], [0.4, 0.6]], [[1, 0], [0, 0], [0, 0]]])


class TestLive:
    """The live assistant infers the goal."""

    setting = Setting(c_suggest=0.01, c_move=0.0, lapse=LAPSE)

    def desk(self, name: str = "tiny") -> Assistant:
        return Assistant(three_goals(name), ["ann", "bob"], setting=self.setting, population=SMALL)

    def test_the_posterior_is_that_of_infer_goals(self) -> None:
        """Without suggestions, for two tasks in a row."""
        goals, rng = three_goals("sealed"), np.random.default_rng(3)
        table, desk, rows = goals.tables["a"], self.desk("sealed"), list[dict[str, Any]]()
        for episode in ("1", "2"):
            x = table.initial
            for step in range(5):
                found = table.choices([x])
                pick = rng.integers(len(found.actions))
                action, x = table.task.actions[found.actions[pick]], int(found.targets[pick])
                desk.observe("ann", action)
                rows.append({"person": "ann", "episode": episode, "step": step, "action": action})
            shown = desk.person("ann").goals
            desk.begin("ann")
        assert desk.person("ann").goals == pytest.approx(PRIOR)
        grid = desk.person("ann").grid
        known = infer_goals(goals.tables, Log.of(rows), prior=PRIOR, beta=grid.beta, lapse=LAPSE).episodes[-1]
        np.testing.assert_allclose(list(shown.values()), known.posterior[-1], atol=1e-12)

    def test_it_is_saved_taken_back_and_explained(self) -> None:
        desk, said = self.desk(), []
        for _ in range(3):
            before = desk.person("ann").belief
            advice = desk.recommend()
            if advice.person == "ann":
                assert sum(advice.reason.goals.values()) == pytest.approx(1)
                said.append(advice.explanation)
            action = desk.person("ann").applicable[0]
            desk.observe("ann", action)
            assert desk.undo("ann") == action
            assert (desk.person("ann").belief == before).all()
            desk.observe("ann", action)
        again = Assistant.from_json(desk.to_json(), three_goals("tiny"))
        assert (again.person("ann").belief == desk.person("ann").belief).all()
        assert again.recommend().as_dict() == desk.recommend().as_dict()
        step = said[0].step
        assert step.goal in PRIOR
        assert f"your goal is {step.goal}" in said[0].text()
        with pytest.raises(ValueError, match="is not among"):
            Assistant.from_json(desk.to_json(), three_goals("sealed"))

    def test_who_has_probably_finished_gets_no_advice(self) -> None:
        goals, desk = three_goals("tiny"), self.desk()
        plan = goals.tables["a"].optimal_plan()
        assert plan is not None
        for action in plan:
            assert not desk.person("ann").finished
            desk.observe("ann", action)
        assert desk.person("ann").goals["a"] > 0.5
        assert desk.person("ann").finished
        assert desk.recommend().person != "ann"
        before = desk.person("ann").goals["a"]
        desk.observe("ann", desk.person("ann").applicable[0])  # it was another goal after all, or a lapse
        assert desk.person("ann").goals["a"] < before
        assert not desk.person("ann").finished


def test_a_session_keeps_goals(tmp_path: Path) -> None:
    """The operator's view has the posterior over goals, and the belief in beta and theta; a restart changes nothing."""
    seen = []
    for _ in range(2):
        session = Session(three_goals("tiny"), tmp_path / "journal", setting=Setting(c_suggest=0.1))
        if not seen:
            session.join("ann")
            session.observe("ann", "(fetch box-a)")
        entry = session.entry("ann")
        seen.append(entry)
        assert set(entry["goals"]) == set(PRIOR)
        assert np.shape(entry["belief"]) == tuple(len(values) for values in entry["grid"].values())
        assert np.sum(entry["belief"]) == pytest.approx(1)
        assert session.task_and_state("ann")[0] is three_goals("tiny")
        session.close()
    assert seen[0] | {"history": None} == seen[1] | {"history": None}
    for change in ({"prior": {"a": 0.2, "b": 0.2, "c": 0.6}}, {"sharpness": 2.0}, {"assume_likeliest": True}):
        with pytest.raises(InputFileError, match="another"):
            Session(replace(three_goals("tiny"), **change), tmp_path / "journal", setting=Setting(c_suggest=0.1))


class Surer:
    """A choice model that has the same name with any parameter."""

    def __init__(self, factor: float) -> None:
        self.factor, self.__name__ = factor, "surer"

    def __call__(self, choices: Choices, q: np.ndarray, beta: np.ndarray) -> np.ndarray:
        return boltzmann(choices, q, self.factor * beta)


@pytest.mark.parametrize("several", [True, False])
def test_a_session_knows_how_people_choose_with_each_goal(several: bool, tmp_path: Path) -> None:
    task = three_goals("tiny") if several else three_goals("tiny").tables["a"]
    with closing(Session(task, tmp_path / "journal", population=Population(chooses=Surer(1.0)))) as session:
        session.join("ann")
        advice = session.recommend()
    with closing(Session(task, tmp_path / "journal", population=Population(chooses=Surer(1.0)))) as session:
        assert session.recommend() == advice
    with pytest.raises(InputFileError, match="chances"):
        Session(task, tmp_path / "journal", population=Population(chooses=Surer(2.0)))


def test_what_cannot_know_goals_yet_says_so(tiny: Table) -> None:
    goals = three_goals("tiny")
    pool = Pool.sample(goals, 2, seed=1)
    expected = "expected people whose goal is known, and there are 3 goals"
    for refused in (
        lambda: upper_bound(pool, paths=30), lambda: problem_of(goals, robot=OfRobots(execute=True)),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=expected):
            refused()
    with pytest.raises(ValueError, match="people with weights of terms: expected one goal"):
        Pool.sample(goals, 2, seed=1, population=Population(weights={"goals": (0, 1)}))
    with pytest.raises(ValueError, match="people with 1 and 3 goals: expected as many for everybody"):
        Pool.joined([pool, Pool.sample(tiny, 2, seed=1)])
    with pytest.raises(
        ValueError, match=r"has states of its own, as its table .* or as the goal compares a number of which"
    ):
        Goals({"a": tiny, "b": sweep(tiny.task)})
    with pytest.raises(ValueError, match="holds in the initial state"):
        Goals({"a": sweep(replace(tiny.task, goal=tuple(enumerate(tiny.task.initial))))})
    road = graph_task([(0, 1, 0), (0, 2, 2)], goal=1, start=0)
    free = Goals(dict(zip("ab", sweep_goals([road, replace(road, goal=((0, 2),))]), strict=True)))
    assert free.tables["a"].lookup([road.initial]) == [0.0]  # it costs nothing, and has to be pursued
    with pytest.raises(ValueError, match=r"goals 'none': expected 'inferred', 'likeliest', 'known'"):
        simulate(pool, "none", humans=1, episodes=1, seed=1, goals="none")  # type: ignore[arg-type]
    desk = Assistant(tiny, ["ann"])
    with pytest.raises(ValueError, match="the next task has 3 goals; expected 1"):
        desk.begin("ann", goals)


def test_too_many_goals_for_the_memory_are_refused() -> None:
    """The estimate is above what the values of a policy take, whose robot actions are those of all goals."""
    goals = three_goals("sealed")
    solved: Any = Pool.sample(goals, 1, seed=1).policies[0].prepare()
    limit = (solved.q_mdp.nbytes + solved.value_mdp.nbytes) / 1e6
    with pytest.raises(LimitError, match="policies for one person on a task of 836 states and 3 goals take about"):
        Pool.sample(goals.choices(), 1, seed=1, memory_limit_mb=limit)  # choices are enumerated in any case


@pytest.mark.parametrize("error", [0.0, 0.2])
def test_an_answer_is_a_bayesian_update_and_worth_what_it_changes(error: float) -> None:
    policy, rng = qmdp(problem_of(three_goals("tiny"))), np.random.default_rng(2)
    belief = rng.random((4, *policy.pomdp.prior.shape))
    belief /= belief.sum(axis=(1, 2), keepdims=True)
    x, ask = np.arange(4), Questions([policy], 0.0, error)
    goal, worth = ask.best(policy, x, belief, np.ones(4))

    def reached(b: np.ndarray, at: int) -> float:
        return float((b * benefit(policy)(at)).reshape(3, -1).sum(axis=1).max())

    for at, one in enumerate(belief):
        shares, found = one.reshape(3, -1).sum(axis=1), []
        for g in range(3):
            yes = (1 - error) * shares[g] + error * (1 - shares[g])
            told = KnownStates(np.full(2, at), np.array([one, one]), np.zeros(2, dtype=bool))
            for person, said in enumerate((True, False)):
                told.answered(person, GoalQuestion(g, policy.pomdp.hidden, error).likelihood(said), policy)
            after = [reached(belief, at) for belief in told.belief]
            assert told.belief[0].reshape(3, -1).sum(axis=1)[g] == pytest.approx((1 - error) * shares[g] / yes)
            found.append(yes * after[0] + (1 - yes) * after[1] - reached(one, at))
        assert worth[at] == pytest.approx(max(found))
        assert found[goal[at]] == pytest.approx(max(found))
    cost = Questions([policy], 0.3, error).best(policy, x, belief, np.full(4, 0.5))[1]
    np.testing.assert_allclose(cost, worth / 2 - 0.3)


def test_questions_are_asked_where_they_are_worth_their_cost() -> None:
    options: dict[str, Any] = {"humans": 2, "episodes": 200, "seed": 5}
    found = {}
    for cost in (None, 0.01, 100.0):
        error = 0.0 if cost is None else 0.1
        setting = Setting(c_suggest=0.05, c_move=0.0, knowledge="exact", c_ask=cost, ask_error=error)
        found[cost] = simulate(Pool.sample(three_goals("tiny"), 4, seed=2, setting=setting), "attention", **options)
    assert found[None].questions is None
    assert not found[100.0].questions.any()
    assert found[0.01].questions.mean() > 0.5
    np.testing.assert_array_equal(found[None].discounted_return, found[100.0].discounted_return)
    assert found[0.01].discounted_return.mean() > found[None].discounted_return.mean()
    assert Setting(**plain(setting)) == setting
    with pytest.raises(ValueError, match=r"ask_error 0\.7: expected a number of 0 or more and below 0\.5"):
        Setting(c_ask=1, ask_error=0.7)


def test_sharper_probabilities_lie_between_the_posterior_and_the_likeliest_goal() -> None:
    belief = problem_of(three_goals("tiny")).prior[None]
    known = replace(problem_of(three_goals("tiny")).hidden, sharpness=1)
    assert known.acted_on(belief) is belief
    square = replace(known, sharpness=2).acted_on(belief)
    np.testing.assert_allclose(known.marginal(square, "goal")[0], np.array([0.25, 0.04, 0.09]) / 0.38)
    sharp, likeliest = replace(known, sharpness=200), replace(known, assume_likeliest=True)
    np.testing.assert_allclose(sharp.acted_on(belief), likeliest.acted_on(belief), atol=1e-12)
    with pytest.raises(ValueError, match="sharpness 0: expected a number from 1 upwards"):
        replace(three_goals("tiny"), sharpness=0)


def test_the_command(tmp_path: Path) -> None:
    given = ["simulate", KITS / "travel.pddl", "--goals", KITS, "--humans", "2", "--pool", "2", "--episodes", "4"]
    given += ["--set", "knowledge=exact"]
    results = {}
    for knows in ("inferred", "known"):
        result = invoke(
            *given, "--set", f"goal_knowledge={knows}", "--set", "goal_prior=travel=.5,mend=.5,mount=0", "--json"
        )
        assert (result.exit_code, result.stderr) == (0, "")
        results[knows] = json.loads(result.stdout)
        assert results[knows]["goals"] == {"travel": 0.5, "mend": 0.5, "mount": 0}
    assert results["inferred"]["policies"] != results["known"]["policies"]
    result = invoke(*given[:2], *given[4:], "--set", "goal_prior=travel=1")
    assert (result.exit_code, "--set goal_prior has no effect without --goals" in result.stderr) == (2, True)
    asks = invoke(*given, "--set", "c_ask=0.1", "--trace", tmp_path / "asked.jsonl", "--json")
    questions = json.loads(asks.stdout)["policies"][0]["questions"]
    assert questions > 0
    trace = [json.loads(line) for line in (tmp_path / "asked.jsonl").read_text().splitlines()]
    assert {row["goal"] for row in trace} == {"travel", "mend", "mount"}
    asked = [(row["question"], row["goal"]) for row in trace if "question" in row]
    assert len(asked) == 4 * questions
    assert all(one["answer"] == (one["goal"] == goal) and one["worth"] > 0 for one, goal in asked)
    for options, message in (
        (
            ["--set", "c_ask=1", "--set", "observation.miss=0.1"],
            "c_ask with observation: expected actions that are all seen as they are",
        ),
        (
            ["--set", "goal_knowledge=likeliest", "--set", "observation.confusion=0.1"],
            "likeliest with observation: expected inferred or k",
        ),
        (["--set", "reasons=true"], "--set reasons has no effect without --trace"),
    ):
        result = invoke(*given, *options)
        assert (result.exit_code, message in " ".join(result.stderr.split())) == (2, True)
    result = invoke(*given[:2], *given[4:], "--set", "c_ask=1")
    assert (result.exit_code, "--set c_ask has no effect without --goals" in result.stderr) == (2, True)
    result = invoke(*given, "--set", "max_states=10")
    assert (result.exit_code, "expected a task of at most 10 states" in result.stderr) == (1, True)


@pytest.mark.parametrize("joins", thinned([(0, 10, 25), (0, 0, 0)]))
@pytest.mark.parametrize("error", thinned([0.2, 0.0]))
def test_questions_of_an_episode_do_not_depend_on_the_other_episodes(error: float, joins: tuple[int, ...]) -> None:
    """In some steps only other episodes have a free robot, or anybody at work."""
    roads = [(a, b, 1) for a in range(12) for b in ((a + 1) % 12, (a - 1) % 12)]
    tables = sweep_goals([replace(graph_task(roads, goal=6, start=0), goal=((0, node),)) for node in (4, 8, 6)])
    setting = Setting(knowledge="exact", c_suggest=0.1, travel_time=3, c_move=0.1, c_ask=0.02, ask_error=error)
    pool = Pool.sample(
        Goals(dict(zip("abc", tables, strict=True))), 3, seed=1, setting=setting, population=Population(beta=(0.1, 0.4))
    )
    policy = pool.policy("attention", setting.travel(3))
    presence = Schedule.of(3, joins)
    together = simulate(pool, policy, humans=3, episodes=12, seed=1, presence=presence)
    assert (together.questions > 0).any()
    for number in range(12):
        alone = simulate(pool, policy, humans=3, episodes=[number], seed=1, presence=presence)
        assert alone.discounted_return[0] == together.discounted_return[number]
        assert alone.questions[0] == together.questions[number]
