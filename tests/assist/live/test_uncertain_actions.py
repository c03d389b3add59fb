"""Live people whose actions are seen with some doubt."""

from __future__ import annotations

import json
import re
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from conftest import kit
from test_unreliable_observations import by_enumeration, problem

from assist.declare import InapplicableError, Refusal
from assist.learning.log import Log
from assist.live import Assistant, Session
from assist.live.uncertain_actions import after_answers
from assist.people.ranges import advice_takers
from assist.person import QMDP, Assumptions, ObservationModel, Setting, TruncatedPolicy, person_problem, qmdp
from assist.person.shared_task import SharedTask
from assist.team.questions import worth_of_knowing
from planner import Table

FETCH, OTHER = "(fetch box-a)", "(fetch box-b)"
SURE = Setting(c_suggest=0.05, suggestions="all")
NOISY = Setting(c_suggest=0.05, observation=ObservationModel(0.05, 0.1))


def desk(setting: Setting = NOISY, policy: str = "priority") -> Assistant:
    return Assistant(kit("paper-fixed"), ["ann"], setting=setting, policy=policy)


def walk(team: Assistant, seed: int, steps: int) -> None:
    """Let a person take some actions that are applicable in the most probable state."""
    rng = np.random.default_rng(seed)
    for _ in range(steps):
        team.recommend()
        team.observe("ann", str(rng.choice(team.person("ann").applicable)))


def test_a_certain_likelihood_is_an_action() -> None:
    plain, given = desk(SURE), desk(SURE)
    rng = np.random.default_rng(2)
    for _ in range(6):
        assert plain.recommend() == given.recommend() or plain.recommend().suggestion == given.recommend().suggestion
        action = str(rng.choice(plain.person("ann").applicable))
        plain.observe("ann", action)
        given.observe("ann", likelihoods={action.upper(): 3.0})
        one, other = plain.person("ann"), given.person("ann")
        assert (one.state, one.applicable, one.steps) == (other.state, other.applicable, other.steps)
        np.testing.assert_allclose(other.belief, one.belief, rtol=0, atol=1e-12)
    assert [row["action"] for row in plain.log()] == [row["action"] for row in given.log()]


def test_actions_that_were_missed_before_one_that_was_seen_are_enumerated() -> None:
    """Two actions are seen; before each, up to three may have been missed. More have a probability of 1e-5."""
    policy: QMDP = qmdp(problem(several=False))
    model = NOISY.observation
    assert model is not None
    team = Assistant(policy, ["ann"], setting=NOISY, policy="none")
    seen = [policy.pomdp.model.choices.name(policy.pomdp.model.choices.initial, 0)]
    team.observe("ann", seen[0])
    seen.append(team.person("ann").applicable[-1])
    team.observe("ann", seen[1])
    unseen, total = (model, None, None), np.zeros(1)
    for counts in product(range(4), repeat=2):
        first, second = ([unseen] * count for count in counts)
        steps = [*first, (model, None, seen[0]), *second, (model, None, seen[1])]
        total = total + by_enumeration(policy.pomdp, steps, works=False)
    np.testing.assert_allclose(team.person("ann").belief, total.sum(axis=(0, 1)) / total.sum(), rtol=0, atol=1e-4)
    assert team.person("ann").state == total.sum(axis=(1, 2, 3)).argmax()


@pytest.mark.parametrize("policy", ["reactive", "attention", "priority"])
def test_a_wrong_observation_is_survived_taken_back_and_saved(policy: str) -> None:
    team = desk(policy=policy)
    walk(team, 1, 3)
    before = team.person("ann")
    team.observe("ann", before.applicable[0])
    assert team.undo("ann") == before.applicable[0]
    np.testing.assert_array_equal(team.person("ann").belief, before.belief)
    team.observe("ann", likelihoods=dict.fromkeys(before.applicable, 1.0))
    team.recommend()
    team.observe("ann", missed=0.3)
    walk(team, 4, 3)
    team.begin("ann")
    walk(team, 5, 2)
    again = Assistant.from_json(team.to_json(), kit("paper-fixed"))
    np.testing.assert_array_equal(again.person("ann").belief, team.person("ann").belief)
    assert again.person("ann").state == team.person("ann").state
    assert again.recommend() == team.recommend()
    assert len(team.log()) == 3 + 1 + 3 + 2  # an action that perhaps was missed is in no log
    assert json.loads(again.to_json()) == json.loads(team.to_json())


def test_an_action_without_all_arguments_is_answered_with_those_that_begin_so() -> None:
    said = (
        "(fetch): with an observation model, and in likelihoods, actions have all arguments; expected (fetch box-a), "
    )
    noisy = desk()
    with pytest.raises(Refusal, match=re.escape(said)):
        noisy.observe("ann", "(fetch)")
    with pytest.raises(Refusal, match=re.escape(said)):
        desk(SURE).observe("ann", likelihoods={"(fetch)": 1.0})
    for misspelt in ("(fetch box-aa)", "fetsh(box-a)"):
        with pytest.raises(Refusal, match=r"did you mean \(fetch box-a\)\?"):
            noisy.observe("ann", misspelt)


def test_the_log_marks_what_was_seen_with_doubt_and_a_reader_of_it_is_told() -> None:
    """Also in tasks that are finished or left; not an action that its person has confirmed."""
    team = desk(SURE)
    team.observe("ann", FETCH)
    team.observe("ann", likelihoods=dict.fromkeys(team.person("ann").applicable, 1.0))
    team.begin("ann")
    team.observe("ann", likelihoods={FETCH: 0.7, OTHER: 0.3})
    assert [row.get("uncertain") for row in team.log()] == [None, True, True]
    team.answer("ann", FETCH)
    assert [row.get("uncertain") for row in team.log()] == [None, True, None]
    noisy = desk()
    noisy.observe("ann", FETCH)
    assert [row.get("uncertain") for row in noisy.log()] == [True]
    said = "read line 1, with an action that was seen with doubt (`uncertain`), as if it was done"
    assert (Log.of(noisy.log()).note, Log.of([{**noisy.log()[0], "uncertain": False}]).note) == (said, "")


def test_a_question_is_worth_something_where_the_answer_changes_what_the_robot_does() -> None:
    team = desk(SURE)
    options = team.person("ann").applicable
    assert team.worth_of_asking("ann") == 0
    with pytest.raises(InapplicableError, match="ann has done nothing yet"):
        team.answer("ann", options[0])
    team.observe("ann", likelihoods={options[0]: 1.0})
    assert team.worth_of_asking("ann") == pytest.approx(0, abs=1e-9)  # only one action is possible
    team.undo("ann")
    team.observe("ann", likelihoods=dict.fromkeys(options, 1.0))
    worth = team.worth_of_asking("ann")
    assert worth > 0
    with pytest.raises(InapplicableError, match="in no probable state"):
        team.answer("ann", FETCH if FETCH not in options else "(return box-a)")
    assert team.worth_of_asking("ann") == worth
    team.answer("ann", options[1])
    told = desk(SURE)
    told.observe("ann", options[1])
    one, other = team.person("ann"), told.person("ann")
    assert (one.state, one.steps, len(one.states)) == (other.state, 1, 1)
    np.testing.assert_allclose(one.belief, other.belief, rtol=0, atol=1e-12)
    again = Assistant.from_json(team.to_json(), kit("paper-fixed"))
    np.testing.assert_array_equal(again.person("ann").belief, one.belief)


def test_answers_are_as_probable_as_the_actions_were() -> None:
    team = desk()
    walk(team, 3, 2)
    record = team.roster.known("ann")
    after = after_answers(record, NOISY.observation)
    assert record.joint is not None
    assert sum(one.evidence for one in after.values()) == pytest.approx(record.joint.evidence, rel=1e-5)
    assert team.worth_of_asking("ann") >= 0


def test_the_state_that_is_shown_is_at_most_certain() -> None:
    team = Assistant(kit("tiny"), ["ann"], setting=Setting(suggestions="all"))
    team.observe("ann", likelihoods={"(fetch box-b)": 0.7})
    for action in ("(place wrench slot-1 box-b)", "(remove wrench slot-1 box-b)", "(place wrench slot-2 box-b)"):
        team.observe("ann", action)
    assert max(team.person("ann").states.values()) == 1  # the sum of its rounded parts is 1.0000000000000004


@pytest.mark.parametrize(
    ("setting", "is_prepared"), [(NOISY, True), (Setting(suggestions="all"), True), (Setting(), False)]
)
def test_what_uncertain_reports_need_is_compiled_before_the_first(
    monkeypatch: pytest.MonkeyPatch, setting: Setting, is_prepared: bool
) -> None:
    prepared: list[object] = []
    monkeypatch.setattr("assist.live.decisions.prepare_uncertain", prepared.append)
    desk(setting)
    assert len(prepared) == is_prepared


def test_a_view_says_how_probable_its_state_is(tmp_path: Path) -> None:
    session = Session(kit("tiny"), tmp_path / "journal.sqlite", setting=NOISY)
    assert "state_probability" not in session.join("ann")
    action = session.person("ann")["applicable"][0]
    once = session.observe("ann", action)["state_probability"]
    twice = session.observe("ann", action)["state_probability"]  # though it is applicable once
    assert 0 < twice < once < 1
    session.close()


def test_a_suggestion_stays_open_while_nothing_was_probably_missed() -> None:
    team = desk(policy="attention")
    while team.recommend().suggestion is None:
        walk(team, 3, 1)
    said = team.person("ann").suggestion
    team.observe("ann", missed=0.1)
    assert team.person("ann").suggestion == said
    team.observe("ann", missed=0.9)
    assert team.person("ann").suggestion is None
    assert team.undo("ann") is None


def test_people_who_have_probably_finished_get_no_advice() -> None:
    team = desk()
    for action in kit("paper-fixed").optimal_plan():
        assert not team.finished
        team.observe("ann", action)
    assert team.finished
    assert team.recommend().person is None


def test_what_is_in_no_probable_state_or_needs_an_observation_model_is_refused() -> None:
    certain = desk(SURE)
    certain.observe("ann", likelihoods={FETCH: 1.0})
    with pytest.raises(InapplicableError, match="in no probable state of ann; in the most probable one there are: "):
        certain.observe("ann", FETCH)
    with pytest.raises(ValueError, match="an uncertain action: expected a setting with an observation model"):
        desk(Setting()).observe("ann", missed=0.1)


def test_what_an_answer_is_worth_does_not_depend_on_the_size_of_the_task(
    tiny: Table, monkeypatch: pytest.MonkeyPatch
) -> None:
    worth = list[float]()
    for size in (True, False):
        monkeypatch.setattr(person_problem, "is_whole", lambda _, size=size: size)
        team = Assistant(tiny, ["ann"], setting=NOISY)
        other = team.person("ann").applicable[-1]
        team.observe("ann", likelihoods={FETCH: 0.8, other: 0.2})
        record = team.roster.by_name["ann"]
        assert record.joint is not None
        assert (record.problem.policy.problem.region is None) == size
        worth.append(worth_of_knowing(record.problem.policy, record.joint))
    assert worth[1] == pytest.approx(worth[0], abs=1e-9)
    assert 0 < worth[0] < 10


def test_uncertain_actions_on_a_task_that_is_not_enumerated(tiny: Table) -> None:
    """Beliefs, decisions and what answers are worth are those on the enumerated task."""
    part = TruncatedPolicy(SharedTask(tiny, size=len(tiny)), Assumptions.of(NOISY, None, advice_takers()))
    whole, some = (Assistant(task, ["ann", "bob"], setting=NOISY) for task in (tiny, part))
    assert some.person("ann").states == {}
    for team in (whole, some):
        other = team.person("bob").applicable[-1]
        team.observe("ann", FETCH)
        team.observe("ann", missed=0.3)
        team.observe("bob", likelihoods={FETCH: 0.8, other: 0.2})
    assert some.worth_of_asking("bob") == pytest.approx(whole.worth_of_asking("bob"), abs=0.02)
    one, same = whole.recommend(), some.recommend()
    assert (one.person, one.suggestion) == (same.person, same.suggestion)
    for team in (whole, some):
        team.answer("bob", FETCH)
        team.undo("ann")
        team.observe("ann", OTHER)
    for name in ("ann", "bob"):
        expected, found = whole.person(name), some.person(name)
        assert found.states == pytest.approx(expected.states, abs=1e-9)
        np.testing.assert_allclose(found.belief, expected.belief, rtol=0, atol=1e-9)
    assert len(found.states) >= 1
