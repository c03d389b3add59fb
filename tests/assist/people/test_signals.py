"""Actions recovered from facts: never wrong where all changes are reported, and never guessed."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
import signals  # bench/signals.py
from conftest import DOMAINS, KITTING, costly, kit, table_of
from hypothesis import given
from hypothesis import strategies as st

from assist.declare.refusals import Refusal
from assist.people import ActionRecovery, FactChange
from planner import Instance

TASKS = [
    ("kitting", "paper-fixed"), ("blocks", "blocks-4"), ("delivery", "three-parcels"), ("gripper", "balls-05"),
    ("lockers", "two-parcels"), ("stations", "two-benches"), ("tower", "swap"), ("depot", "two-boxes"),
]  # fmt: skip


def recovery_of(domain: str, name: str, **options: int) -> ActionRecovery:
    return ActionRecovery(
        table_of(Instance(DOMAINS / domain / f"{name}.pddl", DOMAINS / domain / "domain.pddl")), **options
    )


@costly(30, 100)
@given(st.sampled_from(TASKS), st.integers(0, 2**32), st.integers(1, 3), st.integers(0, 8))
def test_nothing_is_recovered_wrongly_from_complete_reports(
    task: tuple[str, str], seed: int, count: int, start: int
) -> None:
    """Up to three actions behind one call, anywhere on a random walk; actions that change nothing are not reported."""
    recovery = recovery_of(*task)
    steps = list(signals.walk(recovery.known, start + count, np.random.default_rng(seed)))
    before, last = [recovery.known.initial, *(state for _, state, _ in steps)], steps[start:]
    if not last:
        return
    truth = tuple(action for action, _, changes in last if changes)
    found = recovery.recover(before[start], [change for _, _, changes in last for change in changes])
    if found.kind == "recovered":
        assert (found.actions, found.state) == (truth, before[-1])
    else:
        assert found.kind == "ambiguous"
        assert truth in found.explanations
    if len(truth) == 1:
        assert found.kind == "recovered", "in these tasks, no two actions change the same facts of a state"


@costly(20, 60)
@given(st.sampled_from(TASKS), st.integers(0, 2**32), st.data())
def test_one_action_with_lost_reports_is_never_recovered_wrongly(
    task: tuple[str, str], seed: int, data: st.DataObject
) -> None:
    recovery = recovery_of(*task, unreported=2)
    steps = [step for step in signals.walk(recovery.known, 4, np.random.default_rng(seed)) if step[2]]
    state = recovery.known.initial if len(steps) < 2 else steps[-2][1]
    action, after, changes = steps[-1]
    lost = data.draw(st.sets(st.sampled_from(changes), max_size=min(2, len(changes) - 1)))
    found = recovery.recover(state, [change for change in changes if change not in lost])
    assert (action,) in found.explanations
    if found.kind == "recovered":
        assert found.state == after


def test_an_action_of_which_nothing_was_reported_is_allowed_for_on_request() -> None:
    """Shutting an empty locker changes one fact only; whether it happened before a push cannot be known."""
    usual, careful = (recovery_of("lockers", "two-parcels", unreported=2, unseen=unseen) for unseen in (0, 1))
    space = careful.known.space
    options = space.options(space.initial)
    push = next(action for action in options if action.startswith("(push"))
    shut = next(action for action in options if action.startswith("(shut-door"))
    before, after = (set(space.facts(state)) for state in (space.initial, options[push]))
    changes = [FactChange(f, False) for f in before - after] + [FactChange(f, True) for f in after - before]
    assert usual.recover(space.initial, changes).actions == (push,)
    found = careful.recover(space.initial, changes)
    assert found.kind == "ambiguous"
    assert set(found.explanations) == {(push,), (shut, push)}


def test_the_explanations_are_all_that_there_are() -> None:
    """Beside a search through all sequences that knows nothing of the algorithm."""
    known = kit("paper-fixed")
    recovery, space = ActionRecovery(known), known.space

    def changes(state: int, to: int) -> list[FactChange]:
        before, after = set(space.facts(state)), set(space.facts(to))
        return [FactChange(f, False) for f in before - after] + [FactChange(f, True) for f in after - before]

    sequences: list[tuple[tuple[str, ...], int, list[FactChange]]] = [((), space.initial, [])]
    everything = []
    for _ in range(3):
        sequences = [
            ((*actions, action), to, [*seen, *changes(state, to)])
            for actions, state, seen in sequences
            for action, to in space.options(state).items()
        ]
        everything += sequences
    for _, _, reported in everything[:: max(1, len(everything) // 60)]:
        expected = {actions for actions, _, seen in everything if Counter(seen) == Counter(reported)}
        assert set(recovery.recover(space.initial, reported).explanations) == expected


def test_facts_may_be_written_as_people_write_them() -> None:
    tiny = ActionRecovery(kit("tiny"))
    written = ["(NOT (in-storage box-b))", "on-platform(box-b)", FactChange("( not-a-fact )", True)]
    with pytest.raises(Refusal, match=r"\(not-a-fact\) is no visible fact"):
        tiny.recover(0, written)
    written[-1] = FactChange("platform-free", False)
    assert tiny.recover(tiny.known.initial, written).actions == ("(fetch box-b)",)
    with pytest.raises(Refusal, match=r"did you mean \(on-platform box-b\)"):
        tiny.recover(0, ["(on-platfrom box-b)"])
    with pytest.raises(Refusal, match="expected"):
        tiny.recover(0, ["(on-platform (box-b)"])


def test_what_is_impossible_or_ambiguous_is_said_and_not_guessed() -> None:
    tiny = ActionRecovery(kit("tiny"))
    impossible = tiny.recover(tiny.known.initial, ["(on-platform box-a)", "(on-platform box-b)"])
    assert (impossible.kind, impossible.state) == ("impossible", None)
    with pytest.raises(ValueError, match="no sequence of actions explains"):
        _ = impossible.actions
    assert tiny.recover(tiny.known.initial, []).actions == ()
    careless = ActionRecovery(kit("tiny"), unreported=2)
    ambiguous = careless.recover(tiny.known.initial, ["(not (platform-free))"])
    assert set(ambiguous.explanations) == {("(fetch box-a)",), ("(fetch box-b)",)}
    with pytest.raises(ValueError, match=r"may be \(fetch box-[ab]\) or \(fetch box-[ab]\)"):
        _ = ambiguous.actions


def test_sensors_may_see_some_predicates_only() -> None:
    tiny = ActionRecovery(kit("tiny"), predicates=["on-platform"])
    assert tiny.recover(tiny.known.initial, ["(on-platform box-a)"]).actions == ("(fetch box-a)",)
    with pytest.raises(Refusal, match="no visible fact"):
        tiny.recover(tiny.known.initial, ["(not (platform-free))"])
    with pytest.raises(Refusal, match="no fact of this predicate"):
        ActionRecovery(kit("tiny"), predicates=["on-platfrom"])


@pytest.mark.parametrize(("longest", "unreported"), [(0, 0), (1, -1)])
def test_limits_are_checked(longest: int, unreported: int) -> None:
    with pytest.raises(ValueError, match="expected at least 1, 0 and 0"):
        ActionRecovery(kit("tiny"), longest=longest, unreported=unreported)


def test_the_benchmark_counts_nothing_wrong_where_all_is_reported() -> None:
    recovery = ActionRecovery(kit("tiny"))
    row = signals.row_of(recovery, "tiny", 20, 6, 0.0, 0)
    assert (row["recovered"], row["wrong"]) == (100.0, 0.0)
    lossy = signals.row_of(ActionRecovery(kit("tiny"), unreported=2), KITTING.name, 20, 6, 0.3, 0)
    assert lossy["recovered"] < 100.0
