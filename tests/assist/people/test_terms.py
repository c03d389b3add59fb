"""Terms of choice models: features of actions besides cost."""

from __future__ import annotations

import numpy as np
import pytest

from assist.people import NOTHING_YET, TERMS, Choices, Situation, Vocabulary, features, goals_met
from planner import OnDemand, Table


def after(table: Table, *actions: str) -> Situation:
    """Return the situation of a person after these actions from the initial state."""
    states = [table.initial, *(table.space.follow(actions[: n + 1]) for n in range(len(actions)))]
    choices, state = Choices.of(table), np.array(states[-1:])
    met = goals_met(table, np.arange(len(table)))
    return Situation(
        choices.names, Vocabulary.of(choices.names), state, choices.applicable[state], choices.actions[state],
        choices.targets[state], met[state], met[choices.targets[state]],
        np.array([table.task.numbers_of[actions[-1]][0] if actions else NOTHING_YET]),
        np.array([states[-2] if actions else NOTHING_YET]),
    )  # fmt: skip


def by_action(situation: Situation, term: str) -> dict[str, float]:
    values = features(situation, {term: TERMS[term]})[0, :, 0]
    here = zip(situation.actions[0], values, situation.applicable[0], strict=True)
    return {situation.names[action]: value for action, value, held in here if held}


def test_terms_are_those_that_hand_and_eye_find(tiny: Table) -> None:
    fetched = after(tiny, "(fetch box-a)")
    assert by_action(fetched, "goals") == {
        "(place hammer slot-1 box-a)": 1.0,
        "(place hammer slot-2 box-a)": 0.0,
        "(return box-a)": 1.0,
    }
    assert by_action(fetched, "arguments") == {
        "(place hammer slot-1 box-a)": 1 / 3,
        "(place hammer slot-2 box-a)": 1 / 3,
        "(return box-a)": 1.0,
    }
    assert by_action(fetched, "name") == dict.fromkeys(by_action(fetched, "goals"), 0.0)
    assert by_action(fetched, "back") == {
        "(place hammer slot-1 box-a)": 0.0,
        "(place hammer slot-2 box-a)": 0.0,
        "(return box-a)": 1.0,
    }
    returned = after(tiny, "(fetch box-a)", "(return box-a)")
    assert by_action(returned, "goals") == {"(fetch box-a)": -1.0, "(fetch box-b)": -1.0}
    placed = after(tiny, "(fetch box-a)", "(place hammer slot-2 box-a)")
    assert by_action(placed, "arguments") == {"(remove hammer slot-2 box-a)": 1.0, "(return box-a)": 1.0}
    assert by_action(placed, "back") == {"(remove hammer slot-2 box-a)": 1.0, "(return box-a)": 0.0}
    removed = after(tiny, "(fetch box-a)", "(place hammer slot-2 box-a)", "(remove hammer slot-2 box-a)")
    assert by_action(removed, "back")["(place hammer slot-2 box-a)"] == 1.0
    again = after(tiny, "(fetch box-b)", "(return box-b)", "(fetch box-a)")
    assert set(by_action(again, "name").values()) == {0.0}
    assert by_action(returned, "name") == {"(fetch box-a)": 0.0, "(fetch box-b)": 0.0}


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
