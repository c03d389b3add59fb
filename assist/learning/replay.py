"""Replay of logs in a task: the alternatives and the choice of people at every step.

`replay` applies the actions of each episode, one step of all episodes at a time, and returns a `Recording`. It needs
the choices of visited states only, and no cost-to-go. So a task may have any number of states.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo, TransitionSystem
from planner.system.arrays import read_only
from planner.system.results import Result

from ..declare.refusals import Refusal
from ..people.action_names import Matcher, Words, words_of
from ..people.choices import STAND_STILL, WAIT
from ..people.decision import NOTHING
from ..people.terms import NOTHING_YET, Situation, Vocabulary, goals_met
from .log import SUGGESTION, Entry, Fault, Log, in_order
from .log_rows import Names


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Result):
    """The alternatives and choices of people, step by step; N steps of up to A choices.

    Steps are sorted by person, episode and step; people and episodes are in the order of their names.

    Attributes
    ----------
    people : tuple of str
        Names of the people.
    episodes : tuple of str
        Names of the episodes.
    person, episode : int arrays, shape (N,)
        Indices into the two.
    step : int array, shape (N,)
        Step number in the log.
    state : int array, shape (N,)
        State in which the choice was made, as a number of the replayed task's `CostToGo`.
    applicable : bool array, shape (N, A)
        Whether each slot holds a choice; slots are filled from the left, in the order of the actions' numbers.
    targets : int array, shape (N, A)
        Successor of each choice; the state itself in empty slots.
    costs : float array, shape (N, A)
        Cost of each choice, in cost units.
    chosen, suggested : int arrays, shape (N,)
        Slots; `NOTHING` without a suggestion.
    actions : int array, shape (N, A)
        Ground action of each slot; `WAIT` in empty slots, and if the person could only wait.
    last, previous : int arrays, shape (N,)
        Ground action of the person's previous choice, and its state; `NOTHING_YET` at the beginning of an episode.
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

    def __post_init__(self) -> None:
        read_only(self)

    def __len__(self) -> int:
        return len(self.state)

    def records(self) -> list[dict[str, Any]]:
        """Return a row for each step: person, episode, step, the state's number, and the number of alternatives."""
        return [
            {"person": self.people[k], "episode": self.episodes[e], "step": step, "state": state, "alternatives": count}
            for k, e, step, state, count in zip(
                self.person.tolist(), self.episode.tolist(), self.step.tolist(), self.state.tolist(),
                self.applicable.sum(axis=1).tolist(), strict=True,
            )
        ]  # fmt: skip

    def wanted(self) -> NDArray[np.int64]:
        """Return the states whose cost-to-go is needed, ascending: the successors of choices."""
        return np.unique(self.targets[self.applicable])

    def evaluated(self, h: NDArray[np.float64]) -> tuple[Recording, dict[str, int]]:
        """Return the recording without choices whose cost-to-go is unknown, and how many of each person are excluded.

        If there was a suggestion at such a choice, its effect on trust is unknown. Then the rest of the episode is
        excluded as well.

        Parameters
        ----------
        h : float array, shape (states,)
            Cost-to-go; NaN if unknown.
        """
        rows = np.arange(len(self))
        unknown = (self.applicable & np.isnan(h[self.targets])).any(axis=1)
        begins = np.ones(len(self), dtype=bool)
        begins[1:] = self.episode[1:] != self.episode[:-1]
        lost = np.maximum.accumulate(np.where(unknown & (self.suggested != NOTHING), rows, -1))
        kept = ~unknown & (lost < np.maximum.accumulate(np.where(begins, rows, 0)))
        who, person = np.unique(self.person[kept], return_inverse=True)
        counts = np.bincount(self.person[~kept], minlength=len(self.people))
        steps: dict[str, Any] = {
            name: array[kept] for name, array in vars(self).items() if isinstance(array, np.ndarray)
        }
        left = replace(self, **(steps | {"people": tuple(self.people[k] for k in who), "person": person}))
        return left, {self.people[k]: int(counts[k]) for k in np.flatnonzero(counts)}


def situation(recording: Recording, costs: CostToGo) -> Situation:
    """Return the alternatives and the last actions of people, in the form on which terms depend.

    Parameters
    ----------
    recording : Recording
    costs : CostToGo
        Cost-to-go of the replayed task.
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
    answers: TransitionSystem,
    *,
    drop: Sequence[str] = (),
    rename: Mapping[str, str] | None = None,
) -> tuple[Recording, list[Fault]]:
    """Apply recorded actions in the task, and return the recording and its faults.

    The robot's own actions are no choices: they change the state before the person chooses. Actions after the goal are
    excluded.

    Parameters
    ----------
    log : Log
    answers : TransitionSystem
        States of the task, such as a `CostToGo`.
    drop : sequence of str
        Actions that are no choices, each by its name and possibly its first arguments; they, and suggestions of them,
        are ignored. Examples are waiting, and ground actions without effect, which the grounded task does not contain.
    rename : mapping of str to str, optional
        The task's names for action names in the log.

    Returns
    -------
    recording : Recording
        All episodes that can be replayed.
    faults : list of Fault
        Faults of the replay, in the order of the lines; `log.faults` are not included.

    Raises
    ------
    ValueError
        `drop` or `rename` has a name that the log, or the task, does not have.
    """
    matcher = Matcher(answers.task.actions)
    drop = (drop,) if isinstance(drop, str) else drop
    renamed = {old.lower(): new.lower() for old, new in (rename or {}).items()}
    dropped = {words_of(action) for action in drop}
    _check_names(log, matcher, dropped, renamed)
    episodes: dict[Names, list[_Event]] = {}
    for entry in log.entries:
        episodes.setdefault(entry.names, []).extend(_Event.of(entry, dropped, renamed))
    walks, faults = [], []
    for names in sorted(episodes, key=lambda names: [in_order(name) for name in names]):
        events = sorted(episodes[names], key=lambda event: (event.entry.step, event.entry.line))
        steps = ((a.entry, b.entry) for a, b in pairwise(events) if a.entry is not b.entry)
        twice = next(((a, b) for a, b in steps if a.step == b.step), None)
        if twice is None:
            walks.append(_Walk(events))
        else:
            first, second = twice
            where = f"its step, or time, is on line {first.line} already"
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
            except Refusal as error:
                walk.fault = _at(event.entry, f"step {event.entry.step}: {error}{_renamed(event.action, matcher)}")
                faults += walk.unknown(number + 1, matcher)
    faults += [walk.fault for walk in walks if walk.fault is not None]
    used = [walk for walk in walks if walk.taken and (walk.fault is None or not walk.fault.spoils)]
    return _recording(used, answers.task.action_costs), sorted(faults, key=lambda fault: fault.line)


def _check_names(log: Log, matcher: Matcher, dropped: set[Words], renamed: Mapping[str, str]) -> None:
    """Check that names exist in the log and the task, as others are misspelt."""
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


def _renamed(words: Words, matcher: Matcher) -> str:
    """Return how an action is renamed whose name the task does not have, nor one of similar spelling."""
    if not words or words[:1] in matcher.beginnings or matcher.meant(words[:1]) or words == (STAND_STILL[1:-1],):
        return ""
    return f"; if the task calls it otherwise, --rename {words[0]}=NAME (in Python rename={{'{words[0]}': NAME}})"


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
        """Return the events of a line of the log, in order."""

        def kept(text: str | None) -> Words | None:
            """Return an action, unless there is none, or it is to be dropped."""
            action = None if text is None else words_of(text, renamed)
            return None if action is None or any(action[: len(words)] == words for words in dropped) else action

        executed, action = kept(entry.executed), kept(entry.action)
        by_robot = [] if executed is None else [cls(entry, executed, None, robot=True)]
        return by_robot + ([] if action is None else [cls(entry, action, kept(entry.suggestion), robot=False)])


@dataclass(frozen=True)
class _Choice:
    """A person's alternatives and choice at one step; slots as in `Recording`."""

    entry: Entry
    state: int
    actions: NDArray[np.int32]
    targets: NDArray[np.int64]
    chosen: int
    suggested: int


class _Walk:
    """An episode during the replay: its remaining events, and the state reached."""

    def __init__(self, events: list[_Event]) -> None:
        self.events = events
        self.fault: Fault | None = None
        self.state: int | None = None  # None: the initial one
        self.taken: list[_Choice] = []

    def go(
        self, event: _Event, state: int, actions: NDArray[np.int32], targets: NDArray[np.signedinteger],
        matcher: Matcher,
    ) -> None:  # fmt: skip
        """Apply an event in a state; raise an `Refusal` if it is not possible there."""
        if not len(actions):  # the person can only wait
            targets = np.array([state], dtype=np.int64)
        chosen = matcher.slot(event.action, actions)
        try:
            suggested = NOTHING if event.suggestion is None else matcher.slot(event.suggestion, actions)
        except Refusal as error:
            raise Refusal("other", why=f"{SUGGESTION}{error}") from None
        if not event.robot:
            self.taken.append(_Choice(event.entry, state, actions, targets.astype(np.int64), chosen, suggested))
        self.state = int(targets[chosen])

    def unknown(self, start: int, matcher: Matcher) -> list[Fault]:
        """Return the faults of lines, from an event on, that match no action of the task in any state."""
        found = []
        for event in self.events[start:]:
            for what, words in (("", event.action), (SUGGESTION, event.suggestion)):
                why = None if words is None else matcher.unknown(words)
                if why is not None:
                    found.append(_at(event.entry, f"step {event.entry.step}: {what}{why}"))
        return found


def _recording(walks: Sequence[_Walk], costs: NDArray[np.float64]) -> Recording:
    """Return the recording of the choices of all episodes."""
    people = tuple(sorted({walk.taken[0].entry.person for walk in walks}, key=in_order))
    number = {person: place for place, person in enumerate(people)}
    taken = [(episode, choice) for episode, walk in enumerate(walks) for choice in walk.taken]
    width = max((len(choice.targets) for _, choice in taken), default=1)
    person, episode, step, state, chosen, suggested = (np.zeros(len(taken), dtype=np.int64) for _ in range(6))
    applicable, cost = np.zeros((len(taken), width), dtype=bool), np.zeros((len(taken), width))
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
        cost[row, filled] = costs[choice.actions] if len(choice.actions) else 1.0
        actions[row, : len(choice.actions)] = choice.actions
        if row and place == episode[row - 1]:
            last[row], previous[row] = actions[row - 1, chosen[row - 1]], state[row - 1]
    names = tuple(walk.taken[0].entry.episode for walk in walks)
    return Recording(
        people, names, person, episode, step, state, applicable, after, cost, chosen, suggested, actions, last,
        previous,
    )  # fmt: skip
