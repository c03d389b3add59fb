"""What people saw of suggestions to their neighbours, from the log of a team, for estimates of how it moved them.

People of a team have the same episode in a log, and count its steps together. Whoever acts later in an episode has seen
the suggestions to neighbours until then. The gain of a neighbour's step is the fall of the cost-to-go.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..people.decision import NOTHING
from ..people.neighbours import Neighbours
from .evidence import Evidence
from .observations import Observations, Seen

Places = Mapping[tuple[str, str], int]
"""Place of each person in each episode, from 0."""


class _Told(NamedTuple):
    """A suggestion in an episode: its step, to whom, what was gained, and whether it was followed."""

    step: int
    person: str
    gain: float
    followed: bool


def places_of(rows: Iterable[Mapping[str, Any]]) -> dict[tuple[str, str], int]:
    """Return the place of each person in each episode, from the rows of a simulation's trace.

    Parameters
    ----------
    rows : iterable of mappings
        Each with the person, the episode and the place.
    """
    return {(str(row["person"]), str(row["episode"])): int(row["place"]) for row in rows}


def with_neighbours(evidence: Evidence, neighbours: Neighbours, places: Places | None = None) -> list[Observations]:
    """Return each person's observations, with what they saw of neighbours.

    Parameters
    ----------
    evidence : Evidence
        A replayed log, in the task of one goal.
    neighbours : Neighbours
        Who sees whom; its rule does not matter.
    places : mapping of pairs of str to int, optional
        Place of each person in each episode, from 0; in the order of their names unless given.

    Raises
    ------
    ValueError
        Each episode has one of several goals, or a place is missing.
    """
    if evidence.goals:
        raise ValueError("neighbours: expected a log whose goal is known")
    recording, people = evidence.recording, evidence.observations()
    told: dict[str, list[_Told]] = {}
    members: dict[str, list[str]] = {}
    steps = [recording.step[recording.person == number] for number in range(len(people))]
    for o, step in zip(people, steps, strict=True):
        episode = np.array(o.episodes)[o.begins.cumsum() - 1] if len(o) else np.zeros(0, dtype=str)
        gained = o.cost_to_go - o.ahead[np.arange(len(o)), o.chosen]
        for name in o.episodes:
            members.setdefault(name, []).append(o.person)
        for row in np.flatnonzero(o.suggested != NOTHING).tolist():
            one = _Told(int(step[row]), o.person, float(gained[row]), bool(o.chosen[row] == o.suggested[row]))
            told.setdefault(str(episode[row]), []).append(one)
    at = places or {(person, name): k for name, those in members.items() for k, person in enumerate(those)}
    weights = neighbours.weights(1 + max(at.values(), default=0))
    order = {(person, name): place for (person, name), place in at.items()}
    found = []
    for o, step in zip(people, steps, strict=True):
        rows, number = [], o.begins.cumsum() - 1
        heard = np.flatnonzero(o.suggested != NOTHING)
        for k, name in enumerate(o.episodes):
            own = step[number == k]
            here = step[heard[number[heard] == k]]
            earlier = int((number[heard] < k).sum())
            for one in sorted(told.get(name, []), key=lambda event: (event.step, order.get((event.person, name), 0))):
                if one.person == o.person or one.step >= own.max():
                    continue
                try:
                    weight = weights[order[o.person, name], order[one.person, name]]
                except KeyError as error:
                    raise ValueError(f"places: expected one of {error.args[0]}") from None
                before = int((here <= one.step).sum())
                if weight > 0:
                    rows.append((earlier + before, before < len(here), one.gain, one.followed, weight))
        columns = list(zip(*rows, strict=True)) or [()] * 5
        kinds = (np.int64, np.bool_, np.float64, np.bool_, np.float64)
        found.append(replace(o, seen=Seen(*(np.array(c, dtype=kind) for c, kind in zip(columns, kinds, strict=True)))))
    return found
