"""A mistake is an action that is not an optimal choice, in a log, in a simulation and in a live session."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from recorded import lines, log_of, people_at_work

from assist.learning import EvaluatedStates, Observations, fit, observe, observed, replay
from assist.live import Assistant
from assist.people.choices import Choices
from planner import CostToGo, OnDemand, Table, cost_to_go, load

DELIVERIES = ["one-parcel", "round-trip", "three-parcels", "one-way"]
"""Shipped tasks with free actions; the last one has dead ends."""


@cache
def delivery(name: str) -> Table:
    table = cost_to_go(load(f"delivery/{name}"))
    assert isinstance(table, Table)
    return table


@cache
def at_work(name: str) -> list[dict]:
    """Return the log of two people, one of whom makes many mistakes; an episode has at most 60 actions."""
    rows = people_at_work(Choices.of(delivery(name)), [0.3, 1.0], np.random.default_rng(5), suggest=0.2)
    return [row for row in rows if row["step"] < 60]


def on(known: CostToGo, rows: list[dict]) -> list[Observations]:
    """Read rows with the costs-to-go of single states."""
    recording, faults = replay(log_of(rows), known)
    assert faults == []
    wanted, goal = recording.wanted(), np.zeros(len(known), dtype=bool)
    goal[wanted] = known.is_goal(wanted)
    return observe(recording, EvaluatedStates.of(known, wanted, known.lookup(wanted), wanted, len(known)), goal)


@pytest.mark.parametrize("name", DELIVERIES)
def test_a_log_has_the_mistakes_of_the_task(name: str) -> None:
    choices, others = Choices.of(delivery(name)), 0
    for o in observed(delivery(name), at_work(name)):
        width = o.applicable.shape[1]
        assert not choices.applicable[o.state, width:].any()
        assert (o.applicable == choices.applicable[o.state, :width]).all()
        assert (o.optimal == choices.optimal[o.state, :width]).all()
        assert (o.mistake == ~choices.optimal[o.state, o.chosen]).all()
        assert o.suboptimal == o.mistake.sum() > 0
        assert o.mistake[o.regret > 0].all()
        others += int((o.mistake & (o.regret == 0)).sum())
    assert others > 0  # free actions that lead nowhere cost nothing, and are mistakes


@pytest.mark.parametrize("name", DELIVERIES[:3])
def test_a_live_session_has_the_same_mistakes(name: str) -> None:
    (o, *_) = observed(delivery(name), at_work(name))
    rows = [row for row in at_work(name) if row["person"] == o.person and row["episode"] == o.episodes[0]]
    desk = Assistant(delivery(name), policy="none", people=["ann"])
    for row, mistake in zip(rows, o.mistake, strict=False):
        desk.observe("ann", row["action"])
        assert desk.erred("ann") == mistake


def test_mistakes_are_the_same_where_states_are_asked_for() -> None:
    for one, other in zip(
        observed(delivery("one-parcel"), at_work("one-parcel")),
        on(OnDemand(delivery("one-parcel").task), at_work("one-parcel")),
        strict=True,
    ):
        np.testing.assert_array_equal(one.optimal, other.optimal)
        assert one.suboptimal == other.suboptimal


def test_a_fit_counts_mistakes() -> None:
    people = fit(delivery("one-parcel"), log_of(at_work("one-parcel")))
    for record, o in zip(people.people, observed(delivery("one-parcel"), at_work("one-parcel")), strict=True):
        assert record.suboptimal_actions == o.mistake.sum() == record.as_dict()["suboptimal_actions"]


def test_in_a_dead_end_nothing_is_optimal() -> None:
    """The person acts at random until three actions after entering a dead end."""
    table, rng = delivery("one-way"), np.random.default_rng(0)
    at, actions, lost = table.initial, list[str](), 0
    while lost < 3:
        lost += bool(np.isinf(table[at]))
        options = table.space.options(at)
        actions.append(list(options)[int(rng.integers(len(options)))])
        at = options[actions[-1]]
    (o,) = observed(table, lines(*actions))
    assert o.mistake[-4:].all()  # including the one that led there
    assert (o.mistake == ~Choices.of(table).optimal[o.state, o.chosen]).all()
