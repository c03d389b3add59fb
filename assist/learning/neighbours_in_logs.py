"""What people saw of suggestions to their neighbours, from the log of a team, for estimates of how it moved them.

Who were a team, and who acted when, follows from columns of the log. With `order`, all of the log is of one team, whose
events it numbers, as the log of a live team has it; `since` is the number when the person came. Without it people who
have the same episode are a team, and count its steps together, as in the trace of a simulation. Whoever acts has seen
the suggestions to neighbours before. The gain of a neighbour's step is the fall of the cost-to-go.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..people.decision import NOTHING
from ..people.neighbourhood import Neighbourhood
from ..people.neighbours import Neighbours
from .evidence import Evidence
from .log import Entry
from .observations import Ints, Observations, Seen

BEFORE_ALL = -(2**63)
"""Number before that of every action: a person is there from the beginning."""


class _Told(NamedTuple):
    """A suggestion in a team: when it was answered, at which place, what was gained, and whether it was followed."""

    order: int
    place: int
    gain: float
    followed: bool


class _Acts(NamedTuple):
    """When a person acted: the team, the order, and since when they were there, of each of their N choices."""

    team: list[str]
    order: Ints
    since: Ints
    place: list[int]


def with_neighbours(evidence: Evidence, neighbours: Neighbours | None) -> list[Observations]:
    """Return each person's observations, with what they saw of neighbours.

    Their places are those in the log or, if it has none, follow from the order of their names.

    Parameters
    ----------
    evidence : Evidence
        A replayed log, in the task of one goal.
    neighbours : Neighbours or None
        Who sees whom. By a rule that moves nothing, nobody sees anybody.

    Raises
    ------
    ValueError
        Each episode has one of several goals, or the graph has fewer stations than the log.
    """
    people = evidence.observations()
    places = _places(evidence, people)
    graph = Neighbourhood.of(neighbours, 1 + max(places.values(), default=0))
    if not graph.watched.any():
        return people
    if evidence.goals:
        raise ValueError("neighbours: expected a log whose goal is known")
    entries = {(*one.names, one.step): one for one in evidence.log.entries}
    steps = [evidence.recording.step[evidence.recording.person == number] for number in range(len(people))]
    acts = [_acts(o, step, entries, places) for o, step in zip(people, steps, strict=True)]
    told: dict[str, list[_Told]] = {}
    for o, own in zip(people, acts, strict=True):
        gained = o.cost_to_go - o.ahead[np.arange(len(o)), o.chosen]
        for row in np.flatnonzero(o.suggested != NOTHING).tolist():
            one = _Told(
                int(own.order[row]), own.place[row], float(gained[row]), bool(o.chosen[row] == o.suggested[row])
            )
            told.setdefault(own.team[row], []).append(one)
    return [replace(o, seen=_seen(o, own, told, graph)) for o, own in zip(people, acts, strict=True)]


def _places(evidence: Evidence, people: Iterable[Observations]) -> Mapping[tuple[str, str], int]:
    """Return the place of each person in each episode."""
    given = {one.names: one.place for one in evidence.log.entries if one.place is not None}
    if min(given.values(), default=0) < 0:
        raise ValueError(f"place {min(given.values())}: expected a number from 0")
    if given:
        return given
    of_team: dict[str, list[str]] = {}
    for o in people:
        for name in o.episodes:
            of_team.setdefault(name, []).append(o.person)
    return {(person, name): k for name, those in of_team.items() for k, person in enumerate(those)}


def _acts(
    o: Observations, step: Ints, entries: Mapping[tuple[str, str, int], Entry], places: Mapping[tuple[str, str], int]
) -> _Acts:
    """Return when a person acted, whose choices have these steps."""
    episode = np.array(o.episodes)[o.begins.cumsum() - 1].tolist() if len(o) else []
    rows = [entries[o.person, name, at] for name, at in zip(episode, step.tolist(), strict=True)]
    try:
        place = [places[one.names] for one in rows]
    except KeyError as error:
        raise ValueError(f"place: expected one of {error.args[0]}, as others have one") from None
    return _Acts(
        ["" if one.order is not None else one.episode for one in rows],
        np.array([one.step if one.order is None else one.order for one in rows], dtype=np.int64),
        np.array([BEFORE_ALL if one.since is None else one.since for one in rows], dtype=np.int64),
        place,
    )


def _seen(o: Observations, own: _Acts, told: Mapping[str, list[_Told]], graph: Neighbourhood) -> Seen:
    """Return what a person saw: all that was told in their teams before their last action, while they were there."""
    rows, number = [], o.begins.cumsum() - 1
    heard = np.flatnonzero(o.suggested != NOTHING)
    team = np.array(own.team)
    for name in dict.fromkeys(own.team):
        mine = np.flatnonzero(team == name)
        sees = graph.seen_from(own.place[mine[0]])
        for one in sorted(told.get(name, [])):
            later = np.flatnonzero(own.order[mine] > one.order)
            if one.place not in sees or not len(later):
                continue
            row = int(mine[later[0]])  # the first choice after it
            if own.since[row] >= one.order:
                continue
            before = int(np.searchsorted(heard, row))
            now = before < len(heard) and number[heard[before]] == number[row]
            rows.append((before, now, one.gain, one.followed, sees[one.place]))
    columns = list(zip(*rows, strict=True)) or [()] * 5
    kinds = (np.int64, np.bool_, np.float64, np.bool_, np.float64)
    return Seen(*(np.array(c, dtype=kind) for c, kind in zip(columns, kinds, strict=True)))
