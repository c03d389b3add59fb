"""A log: what people did and what had been suggested to them, line by line, as a file has it.

`read_log` reads JSON Lines, as `kitassist simulate --trace` writes them, or a table with the same names of columns,
into `Entry`s. What cannot be used becomes a `Fault`, which says where it is and what would be right.

An episode is of use only if none of its actions is missing: what came after a missing one would be taken for actions
in other states than people were in. So a line that cannot be used costs its episode, and no other; and where a number
of a step is missing, so is a line. What is left of a broken line often says whose it was. Where it does not, whatever
episode may have begun with it is left out.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import Any

from planner.system.arrays import outline

from ..people.action_names import words_of, wrong_form
from .log_files import NEEDED, Broken, Names, Row, Taken, is_hidden, own_names, read_records, tidy

EXPECTED = 'expected an object, {"person": ..., "episode": ..., "step": ..., "action": ...}'

EXAMPLES = 3
"""Faults of a kind that are told one by one."""


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
    spoils : bool
        Whether the whole episode is left out.
    """

    line: int
    person: str | None
    episode: str | None
    message: str
    spoils: bool = True

    def __str__(self) -> str:
        whose = "" if self.person is None else f"person '{self.person}', "
        left_out = ", which is left out" if self.spoils else ""
        return whose + ("" if self.episode is None else f"episode '{self.episode}'{left_out}: ") + self.message


@dataclass(frozen=True)
class Entry:
    """One line of a log: an action of a person, and what the robot had suggested to them, or had done itself.

    Attributes
    ----------
    line : int
    person, episode : str
    step : int
    action : str or None
        None where the robot's own action left nothing to do.
    suggestion, executed : str or None
        What the robot said, and what it did itself, before the person acted.
    """

    line: int
    person: str
    episode: str
    step: int
    action: str | None
    suggestion: str | None = None
    executed: str | None = None

    @property
    def names(self) -> Names:
        """Whose it is."""
        return self.person, self.episode

    @property
    def texts(self) -> list[str]:
        """All actions that it names."""
        return [text for text in (self.action, self.suggestion, self.executed) if text is not None]


@dataclass(frozen=True)
class Log:
    """What a log has, but for the episodes that cannot be used.

    Attributes
    ----------
    entries : tuple of Entry
        In the order of the lines.
    faults : tuple of Fault
        In the order of the lines.
    people : frozenset of str
        Everybody who is named in it.
    called : frozenset of str
        The names of all actions in it, also of those that cannot be used; in lower case.
    name : str
        Of the file.
    note : str
        What was taken for what as the file was read, such as 'NA' as a missing value; empty for a plain file.
    """

    entries: tuple[Entry, ...]
    faults: tuple[Fault, ...] = ()
    people: frozenset[str] = frozenset()
    called: frozenset[str] = frozenset()
    name: str = "log"
    note: str = ""

    __repr__ = outline

    @classmethod
    def of(cls, records: Iterable[Mapping[str, Any]], *, gaps: bool = False, name: str = "log") -> Log:
        """Return a log of records as its lines have them, such as a simulation's trace; they count as lines."""
        taken = Taken()
        rows = tidy(enumerate(records, start=1), taken)
        return _log(rows, gaps, name, str(taken))


def read_log(file: str | PathLike[str], *, gaps: bool = False, columns: Mapping[str, str] | None = None) -> Log:
    """Read a log of recorded actions: JSON, or a table as pandas, R and spreadsheets write it.

    Parameters
    ----------
    file : path
        JSON Lines, a JSON list, or a table with a first line of names, separated by commas, semicolons, tabs, bars or
        blanks. Other columns than those of `Entry` are ignored. Person and episode may be numbers.
    gaps : bool
        Whether `step` may skip numbers without a line missing, as where it counts what several people do.
    columns : mapping of str to str, optional
        What the file calls a column, by its name in a log, such as {"person": "worker"}.

    Raises
    ------
    OSError
        The file cannot be read.
    ValueError
        `columns` has a name that a log does not have, or the file does not.
    """
    path = Path(file)
    rows, note = read_records(path, own_names(columns))
    return _log(rows, gaps, str(path), note)


def told(faults: Iterable[Fault], name: object) -> list[str]:
    """Give a line for each fault, as compilers do.

    What is wrong with many lines is said once, and of what differs in names and numbers only `EXAMPLES` are given: the
    log of another task has hardly a line that fits.
    """
    kinds: dict[str, dict[str, list[Fault]]] = {}
    for fault in faults:
        kind = re.sub(r"""\d+|\([^()]*\)|'[^']*'|"(?:[^"\\]|\\.)*"|;.*""", "", fault.message)
        kinds.setdefault(kind, {}).setdefault(fault.message, []).append(fault)
    lines = []
    for alike in kinds.values():
        several = list(alike.values())
        for first, *others in several[:EXAMPLES]:
            also = f" (and so {len(others)} more, to line {others[-1].line})" if others else ""
            lines.append(f"{name}:{first.line}: {first}{also}")
        rest = [fault.line for faults in several[EXAMPLES:] for fault in faults]
        if rest:
            lines.append(f"{name}:{min(rest)}: {len(rest):,} more of this kind, to line {max(rest)}")
    return lines


def in_order(name: str) -> list[tuple[int, int, str]]:
    """Give a key by which names are sorted, numbers in them by their size: episode 9 comes before episode 10."""
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in re.split(r"(\d+)", name)]


def _log(records: Iterable[Row], gaps: bool, name: str, note: str) -> Log:
    """Sort lines into entries and faults."""
    entries: list[Entry] = []
    faults: list[Fault] = []
    lost: list[int] = []  # lines that may have been of any episode
    for number, record in records:
        if isinstance(record, Broken):
            spoils = not record.ends
            faults += [Fault(number, *names, record.message, spoils) for names in sorted(record.owners)]
            if not record.owners:
                faults.append(Fault(number, None, None, record.message, spoils))
                lost += [number] * spoils
            continue
        message = _fault(record)
        if message is None:
            entries.append(
                Entry(
                    number, str(record["person"]), str(record["episode"]), record["step"], record["action"],
                    record.get("suggestion"), record.get("executed"),
                )
            )  # fmt: skip
        else:
            known = record if isinstance(record, Mapping) else {}
            own = _name(known.get("person")), _name(known.get("episode"))
            faults.append(Fault(number, *own, message))
            lost += [number] * (None in own)
    called = {words[0] for entry in entries for words in map(words_of, entry.texts) if words}
    people = {entry.person for entry in entries} | {fault.person for fault in faults if fault.person is not None}
    spoilt = {(fault.person, fault.episode) for fault in faults if fault.spoils}
    entries = [entry for entry in entries if entry.names not in spoilt]
    incomplete = _incomplete(entries, sorted(lost), gaps)
    faults += incomplete.values()
    return Log(
        tuple(entry for entry in entries if entry.names not in incomplete),
        tuple(sorted(faults, key=lambda fault: fault.line)), frozenset(people), frozenset(called), name, note,
    )  # fmt: skip


def _incomplete(entries: Sequence[Entry], lost: Sequence[int], gaps: bool) -> dict[Names, Fault]:
    """Find episodes of which an action is missing, or may be because of the lines that may have been of any."""
    episodes: dict[Names, list[Entry]] = {}
    for entry in entries:
        episodes.setdefault(entry.names, []).append(entry)
    first = {names: min(rows, key=lambda entry: entry.step) for names, rows in episodes.items()}
    starts = [entry.step for entry in first.values()]
    begin = 1 if 0 not in starts and starts.count(1) > 1 else 0  # what this log begins to count with
    found = {}
    for names, rows in episodes.items():
        if gaps:
            last = max(rows, key=lambda entry: entry.line)
            if lost and lost[0] < last.line:
                found[names] = Fault(last.line, *names, f"line {lost[0]}, which cannot be read, may be of it")
            continue
        if lost and first[names].step != begin:
            message = f"step {first[names].step} is its first; line {lost[0]}, which cannot be read, may be of it"
            found[names] = Fault(first[names].line, *names, message)
            continue
        rows = sorted(rows, key=lambda entry: entry.step)
        for before, after in pairwise(rows):
            if after.step > before.step + 1:
                message = f"step {after.step} comes after step {before.step}, as if a line were missing"
                found[names] = Fault(after.line, *names, f"{message}; --gaps if the log counts otherwise")
                break
    return found


def _name(value: object) -> str | None:
    return str(value) if isinstance(value, str | int) and not is_hidden(str(value)) else None


def _fault(record: Any) -> str | None:
    """Say what is wrong with a record; None where nothing is."""
    if not isinstance(record, Mapping):
        return EXPECTED
    executed = record.get("executed")
    for key, types, wanted in (
        ("person", (str, int), "a name"),
        ("episode", (str, int), "a name"),
        ("step", (int,), "a whole number"),
        ("action", (str, type(None)) if executed is not None else (str,), 'an action as text, "(name argument ...)"'),
        ("suggestion", (str, type(None)), "an action as text, or null"),
        ("executed", (str, type(None)), "an action as text, or null"),
    ):
        if key not in record and key in NEEDED:
            return f"there is no '{key}'; expected {wanted}"
        value = record.get(key)
        if not isinstance(value, types) or isinstance(value, bool):
            return f"'{key}' is {json.dumps(value, default=str)}; expected {wanted}"
        if isinstance(value, str) and is_hidden(value):
            return f"'{key}' is {json.dumps(value)}, which cannot be shown; expected {wanted}"
    if not -(2**63) <= record["step"] < 2**63:
        return "'step' is too large; expected a whole number of at most 64 bits"
    for key in ("action", "suggestion", "executed"):
        wrong = wrong_form(record.get(key) or "")
        if wrong is not None:
            return f"'{key}' {wrong}"
    return None
