"""What people saw of suggestions to neighbours, in order of time: who saw what, and how it moves theta.

A team's log has who was told what, and who acted when (`Acting`). From it and the visibility graph follow each person's
`Sights`; those of several people are a `SightTable`, whose `moves` apply a rule to arrays of theta.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from planner.system.arrays import read_only
from planner.system.results import ByContent

from .decision import Bools, Floats, Ints
from .neighbourhood import Neighbourhood
from .neighbours import SeenEvent, parts_of
from .trust_rules import TrustRule


class Acting(NamedTuple):
    """What a person did when and where: N choices in teams.

    Attributes
    ----------
    team : sequence of str
        Name of the team.
    order, since : int arrays, shape (N,)
        When it was, in the order of the team, and since when the person was there.
    place : sequence of int
    episode : int array, shape (N,)
        Number of the person's episode.
    heard : int array, shape (S,)
        The choices before which something was suggested to the person.
    gain : float array, shape (N,)
        What came of each choice.
    followed : bool array, shape (N,)
    """

    team: Sequence[str]
    order: Ints
    since: Ints
    place: Sequence[int]
    episode: Ints
    heard: Ints
    gain: Floats
    followed: Bools


def sights_of(people: Sequence[Acting], graph: Neighbourhood) -> list[Sights]:
    """Return what each person saw of suggestions to the others, who see each other by a graph."""
    told: dict[str, list[tuple[int, int, float, bool]]] = {}
    for one in people:
        for row in one.heard.tolist():
            event = int(one.order[row]), one.place[row], float(one.gain[row]), bool(one.followed[row])
            told.setdefault(one.team[row], []).append(event)
    return [Sights.among(one, told, graph) for one in people]


@dataclass(frozen=True, eq=False, repr=False)
class Sights(ByContent):
    """What a person saw of suggestions to neighbours, in order of time; E events.

    Attributes
    ----------
    before : int array, shape (E,)
        Number of suggestions to the person until then, in all episodes.
    now : bool array, shape (E,)
        Whether it was in the episode of the next suggestion to the person; after the last, in the episode of the last.
    gain : float array, shape (E,)
    followed : bool array, shape (E,)
    weight : float array, shape (E,)
        As in `SeenEvent`.
    """

    before: Ints
    now: Bools
    gain: Floats
    followed: Bools
    weight: Floats

    def __post_init__(self) -> None:
        read_only(self)

    @classmethod
    def of(cls, rows: Iterable[tuple[int, bool, float, bool, float]] = ()) -> Sights:
        """Return the sights of rows, one for each event; none unless given."""
        columns = list(zip(*rows, strict=True)) or [()] * 5
        kinds = (np.int64, np.bool_, np.float64, np.bool_, np.float64)
        return cls(*(np.array(c, dtype=kind) for c, kind in zip(columns, kinds, strict=True)))

    @classmethod
    def among(
        cls, own: Acting, told: Mapping[str, Sequence[tuple[int, int, float, bool]]], graph: Neighbourhood
    ) -> Sights:
        """Return what a person saw: what was told in their teams before their last action, while they were there.

        Parameters
        ----------
        own : Acting
        told : mapping of str to sequence of tuples
            The suggestions in each team, by its name: order, place, gain, and whether it was followed.
        graph : Neighbourhood
        """
        rows, team = [], np.array(own.team)
        for name in dict.fromkeys(own.team):
            mine = np.flatnonzero(team == name)
            sees = graph.seen_from(own.place[mine[0]])
            for order, place, gain, followed in sorted(told.get(name, [])):
                later = np.flatnonzero(own.order[mine] > order)
                if place not in sees or not len(later):
                    continue
                row = int(mine[later[0]])  # the first choice after it
                if own.since[row] >= order:
                    continue
                before = int(np.searchsorted(own.heard, row))
                near = own.heard[before : before + 1] if before < len(own.heard) else own.heard[-1:]
                now = own.episode[near] == own.episode[row]
                rows.append((before, bool(now.any()), gain, followed, sees[place]))
        return cls.of(rows)


@dataclass(frozen=True, eq=False, repr=False)
class SightTable(ByContent):
    """What K people saw before each of up to H suggestions to themselves, and after the last.

    Attributes
    ----------
    events : float array, shape (K, H + 1, E, 4)
        Up to E events at a time: the gain, whether it was followed, the weight (0 for none), and whether it was in the
        episode of this suggestion or, after the last, of the last one.
    """

    events: Floats

    def __post_init__(self) -> None:
        read_only(self)

    @classmethod
    def of(cls, sights: Sequence[Sights], heard: Sequence[int], most: int) -> SightTable:
        """Return the table of people who heard so many suggestions each, at most `most`."""
        each: list[list[list[tuple[float, ...]]]] = []
        for one, last in zip(sights, heard, strict=True):
            of_person: list[list[tuple[float, ...]]] = [[] for _ in range(most + 1)]
            columns = (one.before, one.gain, one.followed, one.weight, one.now)
            for before, *event in zip(*(column.tolist() for column in columns), strict=True):
                of_person[before if before < last else -1].append(tuple(map(float, event)))
            each.append(of_person)
        width = max((len(events) for of_person in each for events in of_person), default=0)
        found = np.zeros((len(each), most + 1, width, 4))
        for k, of_person in enumerate(each):
            for h, events in enumerate(of_person):
                found[k, h, : len(events)] = np.reshape(events, (len(events), 4))
        return cls(found)

    def only(self, people: Bools) -> SightTable:
        """Return the table of some people, shape (K,)."""
        return SightTable(self.events[people])

    def moves(self, rule: TrustRule) -> Callable[[Floats, int, bool], Floats]:
        """Return a function of theta, shape (K, T), a suggestion, and whether what was seen was in its episode.

        It returns theta after what was seen then, by the part of a trust rule that is about neighbours.
        """
        update, (gain, followed, weight, current) = parts_of(rule)[1].update, np.moveaxis(self.events, 3, 0)[..., None]
        moves = [(weight > 0) & (current == now) for now in (False, True)]
        some = [[np.flatnonzero(row) for row in one.any(axis=(0, 3))] for one in moves]

        def moved(theta: Floats, h: int, now: bool) -> Floats:
            for e in some[now][h].tolist():
                event = SeenEvent(gain[:, h, e], followed[:, h, e] > 0, weight[:, h, e])
                theta = np.where(moves[now][:, h, e], update(theta, event), theta)
            return theta

        return moved
