"""What people of a live team see of each other's suggestions, and how it moves what the robots believe of them.

What somebody saw belongs to their present task, between two of their own actions (`roster.Saw`). Who takes an action
back takes it back from those who saw it; what these saw in a task that they have finished stays.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..declare.declared import MOST
from ..people.decision import NOTHING
from ..people.neighbourhood import Neighbourhood
from ..people.neighbours import SeenEvent
from ..person.settings import Setting
from ..team.seen import gained
from .roster import Roster, RosterEntry, Saw

Shown = tuple[bool, float]
"""What neighbours see of an action after a suggestion: whether it was followed, and the gain of it, in cost units."""


def neighbourhood(team: Roster, setting: Setting) -> Neighbourhood | None:
    """Return who sees whom, by place, shape (P, P); None if the robots know of nothing that moves theta.

    Raises
    ------
    ValueError
        The graph has fewer stations than there are people.
    """
    seen = setting.neighbourhood(len(team.records))
    if seen is None or not seen.known:
        return None
    more = (0, len(team) - len(team.records))
    return Neighbourhood(seen.rule, np.pad(seen.sees, (more, more)))


def shown_by(team: Roster, record: RosterEntry, action: str, robot: int) -> Shown | None:
    """Return what neighbours see if a person does an action after a robot action; None if it suggests nothing.

    Raises
    ------
    Refusal
        The action is not possible.
    """
    problem, row = record.problem, team.row(record)
    suggested = int(problem.policy.pomdp.suggested[row, robot])
    if suggested == NOTHING or team.stopped(record):
        return None
    slot = problem.slot(row, action)
    gain = float(gained(problem.policy, np.array([row]), np.array([problem.after(row, slot)]))[0])
    return slot == suggested, min(max(gain, -MOST), MOST)


def let_see(team: Roster, record: RosterEntry, what: Shown, setting: Setting) -> None:
    """Let those who are present and see a person see what came of a suggestion."""
    seen = neighbourhood(team, setting)
    if seen is None:
        return
    record.shown += 1
    for place in np.flatnonzero((seen.sees[:, record.place] > 0) & team.present).tolist():
        other = team.records[place]
        one = Saw(len(other.steps), record.name, record.shown, *what, float(seen.sees[place, record.place]))
        see(team, other, [one], setting)
        other.saw.append(one)
        team.changed(other)


def see(team: Roster, record: RosterEntry, what: Iterable[Saw], setting: Setting) -> None:
    """Move the belief in a person by what they saw."""
    grid, rule = record.problem.policy.pomdp.grid, None if setting.neighbours is None else setting.neighbours.rule
    for one in what:
        assert rule is not None
        event = SeenEvent(np.array(one.gain), np.array(one.followed), np.array(one.weight))
        low, weight = grid.shares(rule.update(grid.theta, event), grid.count)
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
