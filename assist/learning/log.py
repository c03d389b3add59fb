"""Recorded actions: what people did, as a log has it and as the task has it.

`read` takes a log, JSON Lines as `kitassist simulate --trace` writes them, to `Entry`s; `replay` follows each
episode through the task, one step of all episodes at a time, and gives a `Recording`: arrays of what each person
could choose from in every step, and what they chose. What cannot be used becomes a `Fault`, which says where it is
and what would be right; a fault costs its own episode and no other.

Nothing here needs a cost-to-go: only the choices of states that were visited are asked for, so that a task may
have any number of states.
"""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo

from ..people.human import NOTHING

STAND_STILL = "(wait)"
"""What the only choice in a state without applicable actions is called."""


@dataclass(frozen=True)
class Fault:
    """Something in a log that cannot be used.

    Attributes
    ----------
    line : int
        Line of the file, counted from 1.
    person, episode : str or None
        Whose it is; None where the line does not say so.
    message : str
        What is wrong, and what would be right.
    """

    line: int
    person: str | None
    episode: str | None
    message: str


@dataclass(frozen=True)
class Entry:
    """One line of a log: an action of a person, and what had been suggested to them."""

    line: int
    person: str
    episode: str
    step: int
    action: str
    suggestion: str | None


def read(file: Path) -> tuple[list[Entry], list[Fault]]:
    """Read a log.

    Fields other than those of `Entry` are ignored. Person and episode may be numbers.

    Returns
    -------
    entries : list of Entry
        In the order of the lines; those of an episode of which a line is at fault are left out.
    faults : list of Fault
        Lines that are no entries.

    Raises
    ------
    OSError
        The file cannot be read.
    """
    entries: list[Entry] = []
    faults: list[Fault] = []
    text = file.read_text(encoding="utf-8", errors="replace")
    for number, line in enumerate(text.split("\n"), start=1):
        if not line.strip():
            continue
        try:
            record = json.loads(line)
        except (json.JSONDecodeError, RecursionError):
            cut = number == text.count("\n") + 1  # a whole last line ends with a line feed
            what = "the last line is cut off; the lines before it are used" if cut else "no JSON; expected one object"
            faults.append(Fault(number, None, None, what))
            continue
        fault = _fault(record)
        if fault is not None:
            names = record if isinstance(record, dict) else {}
            person, episode = (_name(names.get(key)) for key in ("person", "episode"))
            faults.append(Fault(number, person, episode, fault))
            continue
        suggestion = record.get("suggestion")
        entries.append(
            Entry(number, str(record["person"]), str(record["episode"]), record["step"], record["action"], suggestion)
        )
    spoilt = {(fault.person, fault.episode) for fault in faults}
    return [entry for entry in entries if (entry.person, entry.episode) not in spoilt], faults


def in_order(name: str) -> list[tuple[int, int, str]]:
    """Give a key by which names are sorted, numbers in them by their size: episode 9 comes before episode 10."""
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in re.split(r"(\d+)", name)]


def _name(value: object) -> str | None:
    return str(value) if isinstance(value, str | int) else None


def _fault(record: Any) -> str | None:
    """Say what is wrong with a line's JSON; None where nothing is."""
    if not isinstance(record, dict):
        return 'expected an object, {"person": ..., "episode": ..., "step": ..., "action": ...}'
    for key, types, wanted in (
        ("person", (str, int), "a name"),
        ("episode", (str, int), "a name"),
        ("step", (int,), "a whole number"),
        ("action", (str,), 'an action as text, "(name argument ...)"'),
    ):
        if key not in record:
            return f"there is no '{key}'; expected {wanted}"
        if not isinstance(record[key], types) or isinstance(record[key], bool):
            return f"'{key}' is {json.dumps(record[key])}; expected {wanted}"
    if not isinstance(record.get("suggestion"), str | None):
        return f"'suggestion' is {json.dumps(record['suggestion'])}; expected an action as text, or null"
    return None


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

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

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
            **{
                name: getattr(self, name)[kept]
                for name in ("episode", "step", "state", "applicable", "targets", "costs", "chosen", "suggested")
            },
        )
        return left, {self.people[k]: int(counts[k]) for k in np.flatnonzero(counts)}


def replay(
    entries: Iterable[Entry],
    answers: CostToGo,
    *,
    drop: Sequence[str] = (),
    rename: Mapping[str, str] | None = None,
) -> tuple[Recording, list[Fault]]:
    """Follow recorded actions through the task.

    An action is matched without regard to case. It may be given by its name and the first of its arguments where
    exactly one applicable ground action begins so. Steps are taken in the order of their numbers, which need not
    be consecutive.

    Parameters
    ----------
    entries : iterable of Entry
    answers : CostToGo
        Only its `choices` and `is_goal` are asked for.
    drop : sequence of str
        Names of actions that are no choices (a log may say so of standing still); their lines are left out.
    rename : mapping of str to str, optional
        Names in the log, and what the task calls those actions.

    Returns
    -------
    recording : Recording
        Of all episodes without a fault.
    faults : list of Fault
        In the order of the lines.
    """
    dropped = {name.lower() for name in drop}
    renamed = {old.lower(): new.lower() for old, new in (rename or {}).items()}
    faults: list[Fault] = []
    episodes: dict[tuple[str, str], list[tuple[Entry, Words, Words | None]]] = {}
    for entry in entries:
        action = _words(entry.action, renamed)
        suggestion = None if entry.suggestion is None else _words(entry.suggestion, renamed)
        if action and action[0] in dropped:
            continue
        episodes.setdefault((entry.person, entry.episode), []).append((entry, action, suggestion))
    walks = []
    for key in sorted(episodes, key=lambda names: [in_order(name) for name in names]):
        rows = sorted(episodes[key], key=lambda row: (row[0].step, row[0].line))
        twice = [(a[0], b[0]) for a, b in pairwise(rows) if a[0].step == b[0].step]
        if twice:
            first, second = twice[0]
            faults.append(
                _at(
                    second,
                    f"step {second.step} is on line {first.line} already; are these two episodes, or two people?",
                )
            )
        else:
            walks.append(_Walk(rows))
    matcher = _Matcher(answers.task.actions)
    for step in range(max((len(walk.rows) for walk in walks), default=0)):
        going = [walk for walk in walks if walk.fault is None and step < len(walk.rows)]
        if not going:
            break
        states = np.array([walk.states[-1] if walk.states else answers.initial for walk in going], dtype=np.int64)
        finished = answers.is_goal(states)
        offsets, actions, targets = answers.choices(states)
        for i, walk in enumerate(going):
            entry, words, suggestion = walk.rows[step]
            if finished[i]:
                walk.fault = _at(entry, "the goal was reached before this step")
                continue
            options = actions[offsets[i] : offsets[i + 1]]
            try:
                slot = matcher.slot(words, options)
                told = NOTHING if suggestion is None else matcher.slot(suggestion, options)
            except _UnmatchedError as error:
                walk.fault = _at(entry, f"step {entry.step}: {error}")
                faults += walk.unknown(step + 1, matcher)
                continue
            walk.take(int(states[i]), options, targets[offsets[i] : offsets[i + 1]], slot, told)
    faults += [walk.fault for walk in walks if walk.fault is not None]
    costs = np.asarray(answers.task.costs, dtype=float)
    return _record([walk for walk in walks if walk.fault is None], costs), sorted(faults, key=lambda fault: fault.line)


Words = tuple[str, ...]


def _words(action: str, renamed: Mapping[str, str]) -> Words:
    """Split an action into its name and arguments, in lower case; brackets are optional."""
    words = action.lower().replace("(", " ").replace(")", " ").split()
    return (renamed.get(words[0], words[0]), *words[1:]) if words else ()


def _at(entry: Entry, message: str) -> Fault:
    return Fault(entry.line, entry.person, entry.episode, message)


class _Walk:
    """An episode in progress: its lines, and where they have led."""

    def __init__(self, rows: list[tuple[Entry, Words, Words | None]]) -> None:
        self.rows = rows
        self.fault: Fault | None = None
        self.states: list[int] = []  # after each step
        self.taken: list[tuple[int, NDArray[np.int32], NDArray[np.int64], int, int]] = []

    def take(
        self, state: int, actions: NDArray[np.int32], targets: NDArray[np.signedinteger], slot: int, told: int
    ) -> None:
        if not len(actions):  # the person can only stand still
            targets = np.array([state], dtype=np.int64)
        self.taken.append((state, actions, targets.astype(np.int64), slot, told))
        self.states.append(int(targets[slot]))

    def unknown(self, start: int, matcher: _Matcher) -> list[Fault]:
        """Name the lines from a step on that fit no action of the task, whatever the state."""
        rows = [(entry, own) for entry, *both in self.rows[start:] for own in both if own is not None]
        reasons = [(entry, matcher.unknown(own)) for entry, own in rows]
        return [_at(entry, f"step {entry.step}: {why}") for entry, why in reasons if why is not None]


class _UnmatchedError(ValueError):
    """Words that stand for no applicable action, or for several."""


class _Matcher:
    """Finds the ground action that is meant."""

    def __init__(self, actions: Sequence[str]) -> None:
        self.actions = actions
        self.words = [tuple(action[1:-1].lower().split()) for action in actions]
        self.number = {words: number for number, words in enumerate(self.words)}
        self.beginnings = {words[:end] for words in self.words for end in range(1, len(words) + 1)}

    def slot(self, words: Words, options: NDArray[np.int32]) -> int:
        """Give the slot of the action that is meant among those that are applicable (ground actions, ascending)."""
        if not len(options):
            if words == (STAND_STILL[1:-1],):
                return 0
            raise _UnmatchedError(f"{_shown(words)} is not applicable; here one can only stand still, {STAND_STILL}")
        number = self.number.get(words)
        if number is not None:
            slot = int(np.searchsorted(options, number))
            if slot < len(options) and options[slot] == number:
                return slot
        slots = [slot for slot, option in enumerate(options) if self.words[option][: len(words)] == words]
        if words and len(slots) == 1:
            return slots[0]
        if words and slots:
            several = ", ".join(self.actions[options[slot]] for slot in slots)
            raise _UnmatchedError(f"{_shown(words)} may be any of {several}")
        why = self.unknown(words) or f"{_shown(words)} is not applicable here"
        raise _UnmatchedError(f"{why}; {self._nearest(words, options)}")

    def unknown(self, words: Words) -> str | None:
        """Say why words stand for no action of the task, in whatever state; None if they may."""
        if not words:
            return "an empty action"
        if words in self.beginnings or words == (STAND_STILL[1:-1],):
            return None
        if words[:1] not in self.beginnings:
            return f"{_shown(words)}: no action of the task is called '{words[0]}'"
        return f"{_shown(words)} is no action of the task"

    def _nearest(self, words: Words, options: NDArray[np.int32]) -> str:
        """Name the applicable actions that are nearest in writing, three at the most."""
        applicable = [self.actions[option] for option in options]
        near = difflib.get_close_matches(_shown(words), applicable, n=3, cutoff=0.5) or applicable[:3]
        return f"nearest of the {len(applicable)} applicable: {', '.join(near)}"


def _shown(words: Words) -> str:
    return f"({' '.join(words)})"


def _record(walks: Sequence[_Walk], costs: NDArray[np.float64]) -> Recording:
    """Arrange what episodes consist of."""
    people = tuple(sorted({walk.rows[0][0].person for walk in walks}, key=in_order))
    number = {person: place for place, person in enumerate(people)}
    size = sum(len(walk.rows) for walk in walks)
    width = max((len(targets) for walk in walks for _, _, targets, _, _ in walk.taken), default=1)
    person, episode, step, state, chosen, suggested = (np.zeros(size, dtype=np.int64) for _ in range(6))
    applicable, price = np.zeros((size, width), dtype=bool), np.zeros((size, width))
    after = np.zeros((size, width), dtype=np.int64)
    row = 0
    for place, walk in enumerate(walks):
        for (entry, _, _), (x, actions, targets, slot, told) in zip(walk.rows, walk.taken, strict=True):
            person[row], episode[row], step[row], state[row] = number[entry.person], place, entry.step, x
            chosen[row], suggested[row] = slot, told
            applicable[row, : len(targets)] = True
            after[row] = x
            after[row, : len(targets)] = targets
            price[row, : len(targets)] = costs[actions] if len(actions) else 1.0
            row += 1
    names = tuple(walk.rows[0][0].episode for walk in walks)
    return Recording(people, names, person, episode, step, state, applicable, after, price, chosen, suggested)
