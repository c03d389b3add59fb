"""Recorded actions as the task has them: what people could choose from in every step, and what they chose.

`replay` follows each episode of a log through the task, one step of all episodes at a time, and gives a `Recording`.
Nothing here needs a cost-to-go: only the choices of states that were visited are asked for, so that a task may have
any number of states.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo
from planner.system.arrays import outline, read_only

from ..people.action_names import Matcher, UnmatchedError, Words, words_of
from ..people.choices import STAND_STILL, WAIT
from ..people.decision import NOTHING
from ..people.terms import NOTHING_YET, Situation, Vocabulary, goals_met
from .log import Entry, Fault, Log, in_order
from .log_files import Names

OF_STEPS = (
    "episode", "step", "state", "applicable", "targets", "costs", "chosen", "suggested", "actions", "last", "previous",
)  # fmt: skip
"""What a recording has of each step, but for who took it."""


@dataclass(frozen=True)
class Recording:
    """What people could choose from, step by step, and what they chose; N steps of up to A choices.

    The steps of an episode are in order, episodes of a person follow each other in the order of their names, and so
    do people.

    Attributes
    ----------
    people : tuple of str
        Their names.
    episodes : tuple of str
        The name of each episode.
    person, episode : int arrays, shape (N,)
        Places in the two.
    step : int array, shape (N,)
        As the log counts.
    state : int array, shape (N,)
        The state in which the choice was made: a number of the `CostToGo` that the log was replayed on.
    applicable : bool array, shape (N, A)
        Which slots hold a choice; they are filled from the left, in the order of the actions' numbers.
    targets : int array, shape (N, A)
        The state after each choice; the state itself in empty slots.
    costs : float array, shape (N, A)
        What each costs, in cost units.
    chosen, suggested : int arrays, shape (N,)
        Slots; `NOTHING` where nothing was suggested.
    actions : int array, shape (N, A)
        The ground action in each slot; `WAIT` in empty ones, and where the person could only stand still.
    last, previous : int arrays, shape (N,)
        The ground action of the person's choice before, and the state in which they made it; `NOTHING_YET` where an
        episode begins.
    """

    people: tuple[str, ...]
    episodes: tuple[str, ...]
    person: NDArray[np.int64]
    episode: NDArray[np.int64]
    step: NDArray[np.int64]
    state: NDArray[np.int64]
    applicable: NDArray[np.bool_]
    targets: NDArray[np.int64]
    costs: NDArray[np.float64]
    chosen: NDArray[np.int64]
    suggested: NDArray[np.int64]
    actions: NDArray[np.int64]
    last: NDArray[np.int64]
    previous: NDArray[np.int64]

    __repr__ = outline

    def __post_init__(self) -> None:
        read_only(self)

    def __len__(self) -> int:
        return len(self.state)

    def wanted(self) -> NDArray[np.int64]:
        """Give the states whose cost-to-go the choices depend on, ascending: those that a choice leads to."""
        return np.unique(self.targets[self.applicable])

    def evaluated(self, h: NDArray[np.float64]) -> tuple[Recording, dict[str, int]]:
        """Leave out choices that depend on a cost-to-go that is not known; say how many of whom.

        Where something was suggested in such a choice, nobody knows what that did to trust, so that the rest of the
        episode is left out as well.

        Parameters
        ----------
        h : float array, shape (states,)
            The cost-to-go, NaN where it is not known.
        """
        rows = np.arange(len(self))
        unknown = (self.applicable & np.isnan(h[self.targets])).any(axis=1)
        begins = np.ones(len(self), dtype=bool)
        begins[1:] = self.episode[1:] != self.episode[:-1]
        lost = np.maximum.accumulate(np.where(unknown & (self.suggested != NOTHING), rows, -1))
        kept = ~unknown & (lost < np.maximum.accumulate(np.where(begins, rows, 0)))
        who, person = np.unique(self.person[kept], return_inverse=True)
        counts = np.bincount(self.person[~kept], minlength=len(self.people))
        left = replace(
            self,
            people=tuple(self.people[k] for k in who),
            person=person,
            **{name: getattr(self, name)[kept] for name in OF_STEPS},
        )
        return left, {self.people[k]: int(counts[k]) for k in np.flatnonzero(counts)}


def situation(recording: Recording, costs: CostToGo) -> Situation:
    """Give what people could choose from, and what they had done last, in the form that terms look at.

    Parameters
    ----------
    recording : Recording
    costs : CostToGo
        The one that the log was replayed on.
    """
    r = recording
    met = np.zeros(len(costs), dtype=np.int64)
    seen = np.unique(np.concatenate([r.state, r.targets.ravel()]))
    met[seen] = goals_met(costs, seen)
    names = costs.task.actions
    return Situation(
        names, Vocabulary.of(names), r.state, r.applicable, r.actions, r.targets, met[r.state], met[r.targets], r.last,
        r.previous,
    )  # fmt: skip


def replay(
    log: Log,
    answers: CostToGo,
    *,
    drop: Sequence[str] = (),
    rename: Mapping[str, str] | None = None,
) -> tuple[Recording, list[Fault]]:
    """Follow recorded actions through the task.

    What the robot did itself is no choice of anybody: it moves the task on before the person chooses. What comes
    after the goal is left out.

    Parameters
    ----------
    log : Log
    answers : CostToGo
        Only its `choices` and `is_goal` are asked for.
    drop : sequence of str
        Actions that are no choices, each by its name and the first of its arguments; they are left out. A log may say
        so of standing still, or of a ground action that never changes anything, which the grounded task leaves out.
    rename : mapping of str to str, optional
        Names in the log, and what the task calls those actions.

    Returns
    -------
    recording : Recording
        Of all episodes that can be followed.
    faults : list of Fault
        What the replay has found, in the order of the lines; those of `log.faults` are not among them.

    Raises
    ------
    ValueError
        `drop` or `rename` has a name that is nowhere in the log, or in the task.
    """
    matcher = Matcher(answers.task.actions)
    renamed = {old.lower(): new.lower() for old, new in (rename or {}).items()}
    dropped = {words_of(action) for action in drop}
    _check_names(log, matcher, dropped, renamed)
    episodes: dict[Names, list[Entry]] = {}
    for entry in log.entries:
        episodes.setdefault(entry.names, []).append(entry)
    walks, faults = [], []
    for names in sorted(episodes, key=lambda names: [in_order(name) for name in names]):
        rows = sorted(episodes[names], key=lambda entry: (entry.step, entry.line))
        twice = next(((a, b) for a, b in pairwise(rows) if a.step == b.step), None)
        if twice is None:
            walks.append(_Walk([event for entry in rows for event in _Event.of(entry, dropped, renamed)]))
        else:
            first, second = twice
            where = f"step {second.step} is on line {first.line} already"
            faults.append(_at(second, f"{where}; are these two episodes, or two people?"))
    for number in range(max((len(walk.events) for walk in walks), default=0)):
        going = [walk for walk in walks if walk.fault is None and number < len(walk.events)]
        if not going:
            break
        states = np.array([answers.initial if walk.state is None else walk.state for walk in going], dtype=np.int64)
        finished = answers.is_goal(states)
        offsets, actions, targets = answers.choices(states)
        for i, walk in enumerate(going):
            event = walk.events[number]
            if finished[i]:
                message = "the goal was reached before this step; the actions up to it are used"
                walk.fault = _at(event.entry, message, spoils=False)
                continue
            here = slice(offsets[i], offsets[i + 1])
            try:
                walk.go(event, int(states[i]), actions[here], targets[here], matcher)
            except UnmatchedError as error:
                walk.fault = _at(event.entry, f"step {event.entry.step}: {error}")
                faults += walk.unknown(number + 1, matcher)
    faults += [walk.fault for walk in walks if walk.fault is not None]
    used = [walk for walk in walks if walk.taken and (walk.fault is None or not walk.fault.spoils)]
    costs = np.asarray(answers.task.costs, dtype=float)
    return _recording(used, costs), sorted(faults, key=lambda fault: fault.line)


def _check_names(log: Log, matcher: Matcher, dropped: set[Words], renamed: Mapping[str, str]) -> None:
    """Refuse names that stand for nothing: they are misspelt."""
    called = log.called
    if not called:
        return
    known = {words[0] for words in matcher.words} | {STAND_STILL[1:-1]} | {words[0] for words in dropped if words}
    for old, new in renamed.items():
        if old not in called:
            raise ValueError(f"rename {old}={new}: no action in {log.name} is called '{old}'")
        if new not in known:
            raise ValueError(f"rename {old}={new}: no action of the task is called '{new}'")
    for words in dropped:
        if words[:1] not in {(renamed.get(old, old),) for old in called}:
            raise ValueError(f"drop {' '.join(words)}: no action in {log.name} is called so")


def _at(entry: Entry, message: str, *, spoils: bool = True) -> Fault:
    return Fault(entry.line, entry.person, entry.episode, message, spoils)


@dataclass(frozen=True)
class _Event:
    """One action of an episode, the person's or the robot's."""

    entry: Entry
    action: Words
    suggestion: Words | None
    robot: bool

    @classmethod
    def of(cls, entry: Entry, dropped: set[Words], renamed: Mapping[str, str]) -> list[_Event]:
        """Give what happens in a line of the log, in that order."""
        events = []
        if entry.executed is not None:
            events.append(cls(entry, words_of(entry.executed, renamed), None, robot=True))
        action = () if entry.action is None else words_of(entry.action, renamed)
        if entry.action is not None and not any(action[: len(words)] == words for words in dropped):
            suggestion = None if entry.suggestion is None else words_of(entry.suggestion, renamed)
            events.append(cls(entry, action, suggestion, robot=False))
        return events


@dataclass(frozen=True)
class _Choice:
    """What a person could choose from in one step, and what they chose; slots as in `Recording`."""

    entry: Entry
    state: int
    actions: NDArray[np.int32]
    targets: NDArray[np.int64]
    chosen: int
    suggested: int


class _Walk:
    """An episode in progress: what happens in it, and where that has led."""

    def __init__(self, events: list[_Event]) -> None:
        self.events = events
        self.fault: Fault | None = None
        self.state: int | None = None  # None: the initial one
        self.taken: list[_Choice] = []

    def go(
        self, event: _Event, state: int, actions: NDArray[np.int32], targets: NDArray[np.signedinteger],
        matcher: Matcher,
    ) -> None:  # fmt: skip
        """Follow an event from a state; raise `UnmatchedError` where it cannot happen there."""
        if not len(actions):  # the person can only stand still
            targets = np.array([state], dtype=np.int64)
        chosen = matcher.slot(event.action, actions)
        suggested = NOTHING if event.suggestion is None else matcher.slot(event.suggestion, actions)
        if not event.robot:
            self.taken.append(_Choice(event.entry, state, actions, targets.astype(np.int64), chosen, suggested))
        self.state = int(targets[chosen])

    def unknown(self, start: int, matcher: Matcher) -> list[Fault]:
        """Name the lines from an event on that fit no action of the task, whatever the state."""
        found = []
        for event in self.events[start:]:
            for words in (event.action, event.suggestion):
                why = None if words is None else matcher.unknown(words)
                if why is not None:
                    found.append(_at(event.entry, f"step {event.entry.step}: {why}"))
        return found


def _recording(walks: Sequence[_Walk], costs: NDArray[np.float64]) -> Recording:
    """Arrange what episodes consist of."""
    people = tuple(sorted({walk.taken[0].entry.person for walk in walks}, key=in_order))
    number = {person: place for place, person in enumerate(people)}
    taken = [(episode, choice) for episode, walk in enumerate(walks) for choice in walk.taken]
    width = max((len(choice.targets) for _, choice in taken), default=1)
    person, episode, step, state, chosen, suggested = (np.zeros(len(taken), dtype=np.int64) for _ in range(6))
    applicable, price = np.zeros((len(taken), width), dtype=bool), np.zeros((len(taken), width))
    after = np.zeros((len(taken), width), dtype=np.int64)
    actions = np.full((len(taken), width), WAIT, dtype=np.int64)
    last, previous = (np.full(len(taken), NOTHING_YET, dtype=np.int64) for _ in range(2))
    for row, (place, choice) in enumerate(taken):
        person[row], episode[row], step[row] = number[choice.entry.person], place, choice.entry.step
        state[row], chosen[row], suggested[row] = choice.state, choice.chosen, choice.suggested
        filled = slice(0, len(choice.targets))
        applicable[row, filled] = True
        after[row] = choice.state
        after[row, filled] = choice.targets
        price[row, filled] = costs[choice.actions] if len(choice.actions) else 1.0
        actions[row, : len(choice.actions)] = choice.actions
        if row and place == episode[row - 1]:
            last[row], previous[row] = actions[row - 1, chosen[row - 1]], state[row - 1]
    names = tuple(walk.taken[0].entry.episode for walk in walks)
    return Recording(
        people, names, person, episode, step, state, applicable, after, price, chosen, suggested, actions, last,
        previous,
    )  # fmt: skip
