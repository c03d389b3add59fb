"""What people of a live team see of each other's suggestions, and how it moves what the robots believe of them.

What somebody saw belongs to their present task, between two of their own actions. Who takes an action back takes it
back from those who saw it; what these saw in a task that they have finished stays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..declare.declared import MOST
from ..declare.refusals import Refusal
from ..people.decision import Floats
from ..people.neighbourhood import NOBODY_SEES, Neighbourhood
from ..people.neighbours import SeenEvent, parts_of
from ..people.trust_rules import TrustRule
from ..person.settings import Setting
from ..team.seen import answers
from .beliefs import believe_again
from .explanation import Remark
from .roster import News, Roster, RosterEntry


@dataclass(frozen=True)
class Saw(News):
    """What a person saw of a neighbour's suggestion.

    `neighbour` is the name, and `number` that of the event.
    """

    neighbour: str
    number: int
    followed: bool
    gain: float
    weight: float

    @property
    def event(self) -> SeenEvent:
        """The event, for rules."""
        return SeenEvent(np.array(self.gain), np.array(self.followed), np.array(self.weight))

    def tell(self, team: Roster, record: RosterEntry, setting: Setting) -> None:  # noqa: ARG002
        """Move the belief in the person who saw it."""
        belief, grid = team.belief[record.place, None], record.problem.policy.pomdp.grid
        team.belief[record.place] = team.beliefs.neighbours.after(belief, grid, self.event)[0]

    def moved(self, theta: Floats, rule: TrustRule) -> Floats:
        """Return the person's own theta after it, under their rule."""
        return parts_of(rule)[1].update(theta, self.event)

    @property
    def remark(self) -> Remark:
        """That the person saw it."""
        return Remark("saw_followed" if self.followed else "saw_declined", self.neighbour)


class SeenSuggestions:
    """Who of a live team sees whom, and what was shown.

    Parameters
    ----------
    team : Roster
    setting : Setting
    """

    def __init__(self, team: Roster, setting: Setting) -> None:
        self._team, self._setting, self._room, self._of_all = team, setting, 0, NOBODY_SEES

    def make_room(self, people: int) -> None:
        """Let a number of people see each other.

        Raises
        ------
        ValueError
            The graph has no station for one of them.
        """
        graph = self._setting.neighbours
        if people > self._room and graph is not None:  # with room for more, as a graph of many takes time
            self._room = max(people, min(2 * people, graph.stations))
            self._of_all = Neighbourhood.of(graph, self._room).believed  # those of a pair may still come
        self._team.beliefs.neighbours = self._of_all.first(people)

    def require_all_seen(self) -> None:
        """Check that robots need not know what people see of each other, of whom an action is uncertain.

        Raises
        ------
        Refusal
            They need to.
        """
        if self._team.beliefs.neighbours.needs_all_seen:
            raise Refusal("other", why="neighbours: expected actions that are all seen as they are")

    def whom(self, record: RosterEntry) -> dict[str, float]:
        """Return whom a person sees of those who are present, with the weight of each."""
        seen = self._team.beliefs.neighbours.seen_from(record.place).items()
        each = ((self._team.records[place], weight) for place, weight in seen)
        return {other.name: weight for other, weight in each if self._team.present[other.place]}

    def onlookers(self, record: RosterEntry) -> list[tuple[RosterEntry, float]]:
        """Return those who are present and see a person, with the weight of each."""
        team = self._team
        _, who, weight = team.beliefs.neighbours.onlookers(np.array([record.place]), team.present[None])
        return [(team.records[place], one) for place, one in zip(who.tolist(), weight.tolist(), strict=True)]

    def came_or_went(self, record: RosterEntry) -> None:
        """Tell that something else is known of those who see a person."""
        for other, _ in self.onlookers(record):
            self._team.changed(other)

    def shown_by(self, record: RosterEntry, action: str | None, *, heard: bool) -> tuple[bool, float] | None:
        """Return what neighbours see if a person does an action; None if they see nothing that moves them.

        That is whether the open suggestion is followed, and what comes of the action, in cost units. `heard` is whether
        the person had seen it.

        Raises
        ------
        Refusal
            The action is uncertain, or not possible.
        """
        if action is None:
            self.require_all_seen()
        team, offer = self._team, record.offer if heard else None
        seen = team.beliefs.neighbours.watched[record.place : record.place + 1].any()
        if action is None or offer is None or not seen or team.stopped(record):
            return None
        problem, row = record.problem, team.row(record)
        slot = problem.slot(row, action)
        step = (np.array([one]) for one in (row, offer.said, slot, problem.after(row, slot)))
        told, followed, gain = answers(problem.policy, *step)
        return (bool(followed[0]), min(max(float(gain[0]), -MOST), MOST)) if told[0] else None

    def let_see(self, record: RosterEntry, followed: bool, gain: float) -> None:
        """Let those who are present and see a person see what came of a suggestion by the present event."""
        for other, weight in self.onlookers(record):
            one = Saw(len(other.steps), record.name, self._team.event, followed, gain, weight)
            one.tell(self._team, other, self._setting)
            other.news.append(one)
            self._team.changed(other)

    def shown_last(self, record: RosterEntry) -> int | None:
        """Return the number of the event of a person's last action, if somebody has seen it in their present task."""
        last = record.order[-1] if record.steps else -1
        return last if self._who_saw(last) else None

    def take_back(self, number: int) -> None:
        """Let nobody have seen what they saw by an event."""
        for other in self._who_saw(number):
            other.news[:] = [one for one in other.news if not _is_of(one, number)]
            believe_again(self._team, other, self._setting, offer=other.offer)

    def _who_saw(self, number: int) -> list[RosterEntry]:
        """Return those who have seen something in their present task by an event."""
        return [other for other in self._team.records if any(_is_of(one, number) for one in other.news)]


def _is_of(news: News, number: int) -> bool:
    """Return whether it was seen by the event of this number."""
    return isinstance(news, Saw) and news.number == number
