"""Terms of choice models: features of actions besides cost."""

from __future__ import annotations

import numpy as np
import pytest
from recorded import BACK, FETCH, RIGHT, WRONG

from assist.people import NOTHING_YET, TERMS, Choices, Situation, Vocabulary, features, goals_met
from planner import OnDemand, Table


def situation(table: Table, x: int, last: int, previous: int) -> Situation:
    """Return a situation for terms, computed from the task itself."""
    choices = Choices.of(table)
    targets = choices.targets[[x]]
    return Situation(
        choices.names, Vocabulary.of(choices.names), np.array([x]), choices.applicable[[x]], choices.actions[[x]],
        targets, goals_met(table, [x]), goals_met(table, targets[0])[None], np.array([last]), np.array([previous]),
    )  # fmt: skip


def after(table: Table, *actions: str) -> Situation:
    """Return the situation of a person after these actions from the initial state."""
    states = [table.initial, *(table.space.follow(actions[: n + 1]) for n in range(len(actions)))]
    if not actions:
        return situation(table, states[0], NOTHING_YET, NOTHING_YET)
    return situation(table, states[-1], table.task.numbers_of[actions[-1]][0], states[-2])


def by_action(situation: Situation, term: str) -> dict[str, float]:
    values = features(situation, {term: TERMS[term]})[0, :, 0]
    here = zip(situation.actions[0], values, situation.applicable[0], strict=True)
    return {situation.names[action]: value for action, value, held in here if held}


def test_terms_are_those_that_hand_and_eye_find(tiny: Table) -> None:
    removal = "(remove hammer slot-2 box-a)"
    fetched = after(tiny, FETCH)
    assert by_action(fetched, "goals") == {RIGHT: 1.0, WRONG: 0.0, BACK: 1.0}
    assert by_action(fetched, "arguments") == {RIGHT: 1 / 3, WRONG: 1 / 3, BACK: 1.0}
    assert by_action(fetched, "name") == {RIGHT: 0.0, WRONG: 0.0, BACK: 0.0}
    assert by_action(fetched, "back") == {RIGHT: 0.0, WRONG: 0.0, BACK: 1.0}
    returned = after(tiny, FETCH, BACK)
    assert by_action(returned, "goals") == {FETCH: -1.0, "(fetch box-b)": -1.0}
    assert by_action(returned, "name") == {FETCH: 0.0, "(fetch box-b)": 0.0}
    placed = after(tiny, FETCH, WRONG)
    assert by_action(placed, "arguments") == {removal: 1.0, BACK: 1.0}
    assert by_action(placed, "back") == {removal: 1.0, BACK: 0.0}
    assert by_action(after(tiny, FETCH, WRONG, removal), "back")[WRONG] == 1.0
    assert set(by_action(after(tiny, "(fetch box-b)", "(return box-b)", FETCH), "name").values()) == {0.0}


def test_the_same_name_is_seen() -> None:
    words = Vocabulary.of(["(lift a)", "(lift b)", "(drop a b b)", "(rest)"])
    one = np.array([[0, 1, 2, 3]])
    situation = Situation(
        ("(lift a)", "(lift b)", "(drop a b b)", "(rest)"), words, np.array([0]), one >= 0, one, one, np.array([0]),
        one, np.array([0]), np.array([5]),
    )  # fmt: skip
    assert TERMS["name"](situation).tolist() == [[1.0, 1.0, 0.0, 0.0]]
    assert TERMS["arguments"](situation).tolist() == [[1.0, 0.0, 0.5, 0.0]]  # an argument counts once


def test_before_the_first_choice_there_is_no_memory(tiny: Table) -> None:
    begun = after(tiny)
    assert by_action(begun, "goals") == {"(fetch box-a)": -1.0, "(fetch box-b)": -1.0}
    for term in ("arguments", "name", "back"):
        assert set(by_action(begun, term).values()) == {0.0}


def test_goal_facts_are_counted_alike_in_a_table_and_on_demand(tiny: Table) -> None:
    states, walked = np.arange(len(tiny)), OnDemand(tiny.task)
    met = goals_met(tiny, states)
    assert (met == len(tiny.task.goal)).tolist() == tiny.space.goal.tolist()
    assert goals_met(walked, walked.numbers(tiny.values(states))).tolist() == met.tolist()
    held = [set(tiny.space.facts(state)) for state in range(len(tiny))]
    goal = {tiny.task.variables[v].facts[value].removeprefix("Atom ") for v, value in tiny.task.goal}
    assert met.tolist() == [len(goal & facts) for facts in held]


def test_a_term_that_is_no_number_for_each_choice_is_refused(tiny: Table) -> None:
    here = after(tiny)
    with pytest.raises(ValueError, match="term 'flat': shape"):
        features(here, {"flat": lambda s: np.zeros(len(s.state))})
    with pytest.raises(ValueError, match="term 'odd': expected a finite number"):
        features(here, {"odd": lambda s: np.full(s.applicable.shape, np.nan)})
