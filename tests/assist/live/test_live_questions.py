"""A live robot that asks people about their goal and about what they did last."""

from __future__ import annotations

import json
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT, kit
from histories import Steps, by_enumeration
from test_uncertain_actions import NOISY
from test_unknown_goals import LAPSE, SMALL, three_goals

from assist.declare import InapplicableError, Refusal
from assist.live import Assistant, Question, Session
from assist.people import Goals
from assist.person import ObservationModel, Setting
from assist.team.questions import GoalQuestion
from assist.team.state import NOBODY, TeamAction, TeamState
from planner import load, sweep_goals

ASKS = Setting(c_suggest=0.0, c_move=0.0, c_ask=0.01)
BOTH = Setting(c_suggest=0.0, c_move=0.0, c_ask=0.01, observation=ObservationModel(0.05, 0.1))


def desk(setting: Setting = ASKS, task: Any = None) -> Assistant:
    return Assistant(three_goals("tiny") if task is None else task, ["ann"], setting=setting)


def asked(team: Assistant) -> Question:
    question = team.recommend().question
    assert question is not None
    return question


@pytest.mark.parametrize("setting", [ASKS, BOTH])
def test_the_robot_asks_and_suggests_only_when_the_answer_is_there(setting: Setting) -> None:
    team = desk(setting)
    question = asked(team)
    assert (question.kind, question.person, team.questions) == ("goal", "ann", (question,))
    assert question.worth > 0
    assert team.recommend().suggestion is None
    assert desk(Setting(c_suggest=0.0, c_move=0.0)).recommend().suggestion is not None  # which would have helped
    team.answer("ann", True)
    assert team.person("ann").goals[str(question.goal)] == pytest.approx(1, abs=1e-12)
    assert (team.person("ann").question, team.recommend().question) == (None, None)
    assert (team.recommend().suggestion is not None) or setting is BOTH  # which has few suggestions for this goal


def test_who_has_said_what_their_goal_is_is_known_as_if_it_had_been_known_before() -> None:
    goal = str(asked(team := desk()).goal)
    team.answer("ann", True)
    known = desk(
        ASKS,
        Goals(
            dict(three_goals("tiny").tables),
            {name: float(name == goal) for name in three_goals("tiny").tables},
            sharpness=1,
        ),
    )
    for _ in range(3):
        action = team.recommend().suggestion
        assert action is not None
        assert (known.recommend().suggestion, known.recommend().question) == (action, None)
        for one in (team, known):
            one.observe("ann", action)
        np.testing.assert_allclose(team.person("ann").belief, known.person("ann").belief, rtol=0, atol=1e-12)


@pytest.mark.cases
def test_a_goal_that_is_certain_is_told_with_100_percent() -> None:
    """Sums of rounded probabilities, a little below or above 1, were told as 99 % or as 1.0000000000000002."""
    names = ("travel", "mend", "mount")
    tables = sweep_goals([load(ROOT / f"docs/examples/kits/{name}.pddl") for name in names])
    goals = Goals(dict(zip(names, tables, strict=True)), {"travel": 1.0, "mend": 0.0, "mount": 0.0})
    team = Assistant(goals, ["ann"], setting=Setting(c_suggest=0.01, c_move=0.01))
    said = 0
    while (action := team.recommend().suggestion) is not None:
        assert team.person("ann").goals == {"travel": 1.0, "mend": 0.0, "mount": 0.0}
        assert "your goal is travel (100 % likely)" in team.explain("ann").text()
        team.observe("ann", action)
        said += 1
    assert said == 6


@pytest.mark.parametrize("name", ["tiny", "sealed"])
def test_the_belief_after_answers_is_that_of_enumerated_histories(name: str) -> None:
    goals, error, rng = three_goals(name), 0.1, np.random.default_rng(3)
    setting = replace(ASKS, c_ask=0.0, ask_error=error, lapse=LAPSE)
    team = Assistant(goals, ["ann"], setting=setting, population=SMALL)
    pomdp = team.roster.known("ann").problem.policy.pomdp
    steps, told, share = Steps(), 0, np.ones(len(goals.tables))
    for _ in range(4):
        question = team.recommend().question
        if question is not None:
            yes = bool(rng.random() < 0.5)
            team.answer("ann", yes)
            said = GoalQuestion(list(goals.tables).index(str(question.goal)), pomdp.hidden, error).likelihood(yes)
            told, share = told + 1, share * said[:: len(said) // 3, 0]
        team.elapse()
        seen = team.person("ann")
        action = seen.applicable[rng.integers(len(seen.applicable))]
        steps.append((ObservationModel(), None, action))
        team.observe("ann", action, heard=False)
    expected = by_enumeration(pomdp, steps, works=None)[team.person("ann").state]
    expected = (expected * share[:, None, None]).reshape(-1, expected.shape[-1])
    assert told > 0
    np.testing.assert_allclose(team.person("ann").belief, expected / expected.sum(), rtol=0, atol=1e-12)


def test_who_has_said_what_their_goal_is_finishes_for_certain() -> None:
    told, silent = desk(), desk()
    goal = str(asked(told).goal)
    told.answer("ann", True)
    for action in three_goals("tiny").tables[goal].optimal_plan():
        told.observe("ann", action)
        silent.observe("ann", action)
    assert (told.finished, told.person("ann").applicable) == (True, ())
    assert told.explain("ann").text() == "You have reached the goal."
    with pytest.raises(InapplicableError, match="ann has reached the goal"):
        told.observe("ann", "(fetch box-a)")
    assert silent.person("ann").applicable
    assert not silent.finished or silent.explain("ann").text() == "You have probably reached the goal."


def test_a_question_is_open_until_it_is_answered_declined_or_overtaken() -> None:
    team = desk()
    question = asked(team)
    with pytest.raises(Refusal, match="answer 3: expected an action, true, false or null"):
        team.answer("ann", 3)  # type: ignore[arg-type]
    for text in ("yes", "mend"):
        said = f"answer: the question is whether the goal is {question.goal}; expected true, false or null"
        with pytest.raises(Refusal, match=said) as refused:
            team.answer("ann", text)
        assert refused.value.status == 422
    team.elapse()
    assert (team.recommend().question, team.recommend().suggestion, team.questions) == (None, None, (question,))
    team.answer("ann", None)
    assert team.recommend().question is None  # asked once, until the person acts
    assert team.recommend().suggestion is not None
    with pytest.raises(InapplicableError, match="ann has no open question"):
        team.answer("ann", True)
    team.observe("ann", team.person("ann").applicable[0])
    asked(team)
    team.observe("ann", team.person("ann").applicable[0])
    assert team.person("ann").question is None
    asked(team)
    team.leave("ann")
    assert team.questions == ()


@pytest.mark.parametrize("setting", [ASKS, BOTH])
def test_answers_are_kept_when_actions_are_taken_back_and_saved(setting: Setting) -> None:
    team = desk(setting)
    goal = str(asked(team).goal)
    team.answer("ann", False)
    told = team.person("ann").belief.copy()
    team.observe("ann", team.person("ann").applicable[-1])
    team.undo("ann")
    np.testing.assert_array_equal(team.person("ann").belief, told)
    team.observe("ann", team.person("ann").applicable[-1])
    if team.recommend().question is not None:
        team.answer("ann", team.recommend().question.kind == "goal" and False)  # type: ignore[union-attr]
    assert team.person("ann").goals[goal] == pytest.approx(0, abs=1e-12)
    team.begin("ann")
    asked(team)
    again = Assistant.from_json(team.to_json(), three_goals("tiny"))
    np.testing.assert_array_equal(again.person("ann").belief, team.person("ann").belief)
    assert (again.questions, again.recommend()) == (team.questions, team.recommend())
    assert json.loads(again.to_json()) == json.loads(team.to_json())


@pytest.mark.parametrize("setting", [ASKS, BOTH])
def test_the_robot_says_why_it_asks_before_it_suggests(setting: Setting) -> None:
    team = desk(setting)
    question = asked(team)
    why = team.explain("ann")
    assert why.nothing is not None
    assert why.nothing.question is not None
    assert (why.nothing.reason, why.nothing.question.worth) == ("asked", question.worth)
    assert why.sentences() == [
        f"First I would like to know whether your goal is {question.goal}, as my hint depends on it.",
        f"On average, the answer should save about {question.worth:.2g} more than the question costs.",
    ]
    assert team.recommend().explanation.sentences()[0] == "I have asked ann a question, and wait for the answer."
    team.answer("ann", None)
    assert "question" not in team.explain("ann").text()


@pytest.mark.parametrize("setting", [ASKS, BOTH])
def test_an_answer_that_is_taken_back_leaves_no_trace(setting: Setting) -> None:
    team, silent = desk(setting), desk(setting)
    question = asked(team)
    team.answer("ann", True)
    assert team.person("ann").answered == (question.goal, True)
    action = team.person("ann").applicable[0]
    for one in (team, silent):
        one.observe("ann", action)
    team.recommend()
    assert team.undo("ann", of="answered") is True
    seen = team.person("ann")
    np.testing.assert_array_equal(seen.belief, silent.person("ann").belief)
    assert (seen.answered, seen.suggestion, seen.question, len(team.log())) == (None, None, None, 1)
    assert (seen.state, seen.states) == (silent.person("ann").state, silent.person("ann").states)
    assert team.recommend().question == silent.recommend().question is not None
    with pytest.raises(InapplicableError, match="ann has given no answer about the goal that could be taken back"):
        team.undo("ann", of="answered")


def test_who_has_named_another_goal_by_mistake_can_finish_their_own() -> None:
    team = desk()
    wrong = str(asked(team).goal)
    team.answer("ann", True)
    for action in three_goals("tiny").tables[wrong].optimal_plan():
        team.observe("ann", action)
    assert (team.finished, team.person("ann").applicable) == (True, ())
    team.undo("ann", of="answered")
    assert team.person("ann").applicable


def test_an_impossible_answer_changes_nothing() -> None:
    team = desk(Setting(c_suggest=0.0, c_move=0.0, c_ask=0.0))
    for _ in range(2):  # until one goal is left
        asked(team)
        team.answer("ann", False)
        team.observe("ann", team.person("ann").applicable[0])
    record = team.roster.known("ann")
    left = max(team.person("ann").goals, key=lambda name: team.person("ann").goals[name])
    record.question = Question("ann", left, (), 1.0)
    before = team.to_json()
    with pytest.raises(InapplicableError, match=rf"the answer no of ann is impossible: the goal {left} is certain"):
        team.answer("ann", False)
    assert team.to_json() == before


def test_what_was_done_last_is_asked_where_that_is_worth_more_than_it_costs() -> None:
    for cost in (0.001, 100.0):
        team = desk(Setting(c_suggest=0.05, suggestions="all", c_ask=cost), kit("paper-fixed"))
        assert team.recommend().question is None
        options = team.person("ann").applicable
        team.observe("ann", likelihoods=dict.fromkeys(options, 1.0))
        worth, question = team.worth_of_asking("ann"), team.recommend().question
        assert (question is not None) == (worth > cost)
        if question is not None:
            assert (question.kind, question.goal, set(question.options)) == ("action", None, set(options))
            assert question.worth == pytest.approx(worth - cost)
            with pytest.raises(InapplicableError, match="ann has no open question about the goal"):
                team.answer("ann", True)
            team.answer("ann", question.options[1])
            assert len(team.person("ann").states) == 1
            assert team.recommend().question is None


def test_a_policy_that_never_suggests_never_asks() -> None:
    assert Assistant(three_goals("tiny"), ["ann"], setting=ASKS, policy="none").recommend().question is None


def test_malformed_reports_are_refused_in_one_sentence_and_change_nothing(tmp_path: Path) -> None:
    session = Session(kit("tiny"), tmp_path / "journal.sqlite", setting=NOISY)
    session.join("ann")
    first, believed = session.person("ann")["applicable"][0], session.beliefs()
    nan = float("nan")
    for wrong, kind, message in (
        ({}, Refusal, "expected an action, its likelihoods, or the probability"),
        ({"action": first, "likelihoods": {first: 1.0}}, Refusal, "expected an action, its likelihoods"),
        ({"action": first, "missed": 0.1}, Refusal, "expected an action, its likelihoods"),
        ({"action": "(fly away)"}, ValueError, "fly"),
        ({"missed": nan}, Refusal, "missed nan: expected a number"),
        ({"missed": -0.1}, Refusal, "missed -0.1: expected a probability"),
        ({"likelihoods": {}}, Refusal, "likelihoods: expected finite numbers of 0 or more, one of them positive"),
        ({"likelihoods": {first: 0.0}}, Refusal, "one of them positive"),
        ({"likelihoods": {first: 1.0, "(fetch box-b)": nan}}, Refusal, "nan: expected a number"),
        ({"likelihoods": {first: -1.0}}, Refusal, "expected finite numbers"),
        ({"likelihoods": {first: "much"}}, Refusal, "likelihoods.* 'much': expected a number"),
        ({"likelihoods": {"(fly)": 1.0}}, ValueError, "fly"),
        ({"likelihoods": {first: 1.0}, "followed": True}, Refusal, "followed: expected an action that was seen"),
    ):
        with pytest.raises(kind, match=message):
            session.observe("ann", **wrong)  # type: ignore[arg-type]
    for answer, message in ((True, "no open question"), (first, "has done nothing yet"), (1, "expected an action")):
        with pytest.raises(ValueError, match=message):
            session.answer("ann", answer)  # type: ignore[arg-type]
    assert session.beliefs() == believed
    session.observe("ann", likelihoods={first: 1e300, first.upper(): 1e300, "(fetch box-b)": 1e-300})
    assert session.person("ann")["steps"] == 1
    session.close()
    certain = Session(kit("tiny"), tmp_path / "other.sqlite", setting=Setting(c_suggest=0.05))
    certain.join("ann")
    with pytest.raises(Refusal, match="an uncertain action: expected a setting with an observation model"):
        certain.observe("ann", missed=0.1)
    certain.close()


def test_an_answer_to_an_earlier_question_is_refused(tmp_path: Path) -> None:
    session = Session(three_goals("tiny"), tmp_path / "journal.sqlite", setting=ASKS)
    seen = session.join("ann")
    assert seen["question"]["goal"] in three_goals("tiny").tables
    later = session.observe("ann", seen["applicable"][0])
    assert "question" in later
    with pytest.raises(InapplicableError, match="there is a later question; expected an answer to that"):
        session.answer("ann", True, seq=seen["seq"])
    assert [one.as_dict() for one in session.outlook().robots[0].questions] == [later["question"]]
    assert "question" not in session.answer("ann", True, seq=later["seq"])
    assert not session.outlook().robots[0].questions
    session.close()


class Failing:
    """A policy that fails when it is told to."""

    name, uses_belief, fails = "failing", True, False

    def __call__(self, team: TeamState) -> TeamAction:
        if self.fails:
            raise RuntimeError("a sensor is away")
        return TeamAction(np.full(team.location.shape, NOBODY), np.zeros_like(team.location))


def test_nothing_is_asked_by_a_policy_that_fails(tmp_path: Path) -> None:
    policy = Failing()
    session = Session(three_goals("tiny"), tmp_path / "journal.sqlite", setting=ASKS, policy=policy)
    assert "question" in session.join("bob")
    session.answer("bob", None)
    policy.fails = True
    assert "question" not in session.join("ann")
    assert session.outlook().fault == "a sensor is away"
    with pytest.raises(InapplicableError, match="ann has no open question"):
        session.answer("ann", True)
    policy.fails = False
    session.elapse()
    assert session.person("ann")["question"]["goal"] in three_goals("tiny").tables
    answered = session.answer("ann", True)
    session.close()
    again = Session(three_goals("tiny"), tmp_path / "journal.sqlite", setting=ASKS, policy=policy)
    assert again.person("ann") == answered
    again.close()


def test_a_journal_with_an_answer_to_an_unrecorded_question_is_opened(tmp_path: Path) -> None:
    """Earlier versions saved an answer, but not its question, if the policy failed after asking."""
    session = Session(three_goals("tiny"), tmp_path / "journal.sqlite", setting=ASKS, policy=Failing())
    session.join("ann")
    believed = session.beliefs()
    session.answer("ann", True)
    session.undo("ann", of="answered")
    last = session.answer("ann", None)["seq"]
    session.close()
    with closing(sqlite3.connect(tmp_path / "journal.sqlite")) as db, db:
        db.execute("UPDATE events SET record = json_remove(record, '$.advice')")
    again = Session(three_goals("tiny"), tmp_path / "journal.sqlite", setting=ASKS, policy=Failing())
    assert (again.outlook().seq, again.person("ann")["seq"]) == (last, last)
    assert again.beliefs() == believed
    again.close()


def test_confused_actions_that_the_task_does_not_have_are_refused_at_once() -> None:
    with pytest.raises(ValueError, match=r"confusion: \(fly\) is no action of the task"):
        Assistant(kit("tiny"), ["ann"], setting=Setting(observation=ObservationModel(0, {"(fly)": {"(a)": 0.5}})))
