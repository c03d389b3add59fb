"""What people of a live team see of each other's suggestions, and how it moves what the robots believe of them.

What somebody saw belongs to their present task, between two of their own actions (`roster.Saw`). Who takes an action
back takes it back from those who saw it; what these saw in a task that they have finished stays.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..declare.declared import MOST
from ..people.decision import NOTHING
from ..team.seen import gained
from .roster import Roster, RosterEntry, Saw

Shown = tuple[bool, float]
"""What neighbours see of an action after a suggestion: whether it was followed, and the gain of it, in cost units."""


def shown_by(team: Roster, record: RosterEntry, action: str, robot: int) -> Shown | None:
    """Return what neighbours see if a person does an action after a robot action; None if they see nothing.

    Raises
    ------
    Refusal
        The action is not possible.
    """
    if not team.beliefs.neighbours.watched[record.place : record.place + 1].any():
        return None
    problem, row = record.problem, team.row(record)
    suggested = int(problem.policy.pomdp.suggested[row, robot])
    if suggested == NOTHING or team.stopped(record):
        return None
    slot = problem.slot(row, action)
    gain = float(gained(problem.policy, np.array([row]), np.array([problem.after(row, slot)]))[0])
    return slot == suggested, min(max(gain, -MOST), MOST)


def onlookers(team: Roster, record: RosterEntry) -> list[tuple[RosterEntry, float]]:
    """Return those who are present and see a person, with the weight of each."""
    _, who, weight = team.beliefs.neighbours.onlookers(np.array([record.place]), team.present[None])
    return [(team.records[place], one) for place, one in zip(who.tolist(), weight.tolist(), strict=True)]


def let_see(team: Roster, record: RosterEntry, what: Shown) -> None:
    """Let those who are present and see a person see what came of a suggestion."""
    record.shown += 1
    for other, weight in onlookers(team, record):
        one = Saw(len(other.steps), record.name, record.shown, *what, weight)
        see(team, other, [one])
        other.saw.append(one)
        team.changed(other)


def see(team: Roster, record: RosterEntry, what: Iterable[Saw]) -> None:
    """Move the belief in a person by what they saw."""
    grid = record.problem.policy.pomdp.grid
    for one in what:
        low, weight = grid.shares(team.beliefs.neighbours.rule.update(grid.theta, one.event), grid.count)
        team.beliefs.moved(np.array([record.place]), low[None], weight[None])


def forget_last(team: Roster, record: RosterEntry) -> list[RosterEntry]:
    """Remove what was seen last of a person from what others saw; return those others, to be believed of again."""
    found = []
    for other in team.records:
        kept = [one for one in other.saw if (one.neighbour, one.number) != (record.name, record.shown)]
        if len(kept) < len(other.saw):
            other.saw[:] = kept
            found.append(other)
    record.shown -= 1
    return found
