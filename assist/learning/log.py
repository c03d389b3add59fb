"""Logs: people's actions and the suggestions to them, line by line.

`read_log` reads JSON Lines, as `kitassist simulate --trace` writes them, or a table with the same column names, into
entries. A line that cannot be used becomes a `Fault` with its place and the expected content.

An episode can be used only if all its actions are there, because later actions would be assigned to wrong states
otherwise. So an unusable line excludes its episode, and no other. A missing step number means a missing line, and so
does a first step above that of other episodes. The rest of a broken line often names its episode. If it does not, all
episodes that may contain the line are excluded.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import Any, cast

from planner.system.errors import InputFileError
from planner.system.results import Result

from ..people.action_names import words_of, wrong_form
from .log_files import IN_TEAM, NEEDED, in_tasks, is_hidden, lacking_column, named_rows, own_names, read_records, tidy
from .log_rows import Names, Taken
from .log_steps import days_in_disorder, expected_date, moment

SUGGESTION = "suggestion "
"""Begins what is wrong with a suggestion, behind the step."""

SHOWN = 5
"""People who are named in a message."""

GAPS = "--set gaps=true (in Python gaps=True)"


@dataclass(frozen=True)
class Fault:
    """A line of a log that cannot be used.

    Attributes
    ----------
    line : int
        Line of the file, counted from 1.
    person, episode : str or None
        Person and episode of the line; None if unknown.
    message : str
        The error, and what was expected.
    spoils : bool
        Whether the line's whole episode is excluded because of it.
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
    """One line of a log: a person's action, and the robot's suggestion or own action before it.

    Attributes
    ----------
    line : int
    person, episode : str
    step : int
    action : str or None
        None if the person did nothing.
    suggestion, executed : str or None
        The robot's suggestion, and its own action, before the person acted.
    place : int or None
        The person's place in their team, from 0; None if unknown, as `order` and `since` are.
    order : int or None
        Number of the action among the events of the whole team, of which all episodes of the log are.
    since : int or None
        Number of the event by which the person came, or came back.
    """

    line: int
    person: str
    episode: str
    step: int
    action: str | None
    suggestion: str | None = None
    executed: str | None = None
    place: int | None = None
    order: int | None = None
    since: int | None = None

    @property
    def names(self) -> Names:
        """The person and the episode, which together identify a sequence of steps."""
        return self.person, self.episode

    @property
    def texts(self) -> list[str]:
        """The actions in the line: what was done, suggested or executed."""
        return [text for text in (self.action, self.suggestion, self.executed) if text is not None]


@dataclass(frozen=True, eq=False, repr=False)
class Log(Result):
    """The usable episodes of a log, and its faults.

    Attributes
    ----------
    entries : tuple of Entry
        Usable lines, in their order.
    faults : tuple of Fault
        Faults, in the order of their lines.
    people : frozenset of str
        All people who are named in the log.
    called : frozenset of str
        The names of all actions in the log, without arguments and in lower case, also of excluded episodes.
    name : str
        Name of the file.
    note : str
        How the file was interpreted, such as 'NA' as a missing value; empty for a plain file.
    questions : tuple of str
        A sentence, also in `note`, for each column that is not read and may have the suggestions.
    simulated : bool
        Whether a simulation wrote it, in which theta begins anew in each episode: it has its policy and the true theta.
    goals : tuple of str
        The true goals that a simulation with several goals wrote.
    tasks : tuple of str
        Names of the tasks, if lines of several are together here, which no task has; else empty.
    """

    entries: tuple[Entry, ...]
    faults: tuple[Fault, ...] = ()
    people: frozenset[str] = frozenset()
    called: frozenset[str] = frozenset()
    name: str = "log"
    note: str = ""
    questions: tuple[str, ...] = ()
    simulated: bool = False
    goals: tuple[str, ...] = ()
    tasks: tuple[str, ...] = ()

    def __repr__(self) -> str:
        episodes, faults = len({entry.names for entry in self.entries}), len(self.faults)
        bad = f", {faults} faults" if faults else ""
        return f"<Log {self.name}: {len(self.people)} people, {episodes} episodes, {len(self.entries)} lines{bad}>"

    def records(self) -> list[dict[str, Any]]:
        """Return a row for each usable line, with the columns of a log."""
        return [vars(entry) for entry in self.entries]

    @classmethod
    def of(
        cls, records: Iterable[Mapping[str, Any]], *, gaps: bool = False, columns: Mapping[str, str] | None = None,
        name: str = "log",
    ) -> Log:  # fmt: skip
        """Return a log of records, such as a simulation's trace, or of a data frame.

        Parameters
        ----------
        records : iterable of mappings, or data frame
            Each record, or each row of a data frame of pandas or polars, counts as a line.
        gaps, columns
            As in `read_log`.
        name : str
            Name of the log in messages.
        """
        return _log(records, gaps, columns, name)


def read_log(file: str | PathLike[str], *, gaps: bool = False, columns: Mapping[str, str] | None = None) -> Log:
    """Return the log in a file: JSON, or a table as pandas, R and spreadsheets write it.

    Parameters
    ----------
    file : path
        JSON Lines, a JSON list, or a table whose first line has column names, separated by commas, semicolons, tabs,
        bars or blanks. Columns that `Entry` does not have are ignored. Person and episode may be numbers.
    gaps : bool
        Whether `step` may skip numbers although no line is missing, for instance if it counts several people's actions.
        Steps may then be times, too: seconds, dates with times (ISO 8601), or times of the clock.
    columns : mapping of str to str, optional
        The file's name for a column of a log, such as {"person": "worker"}.

    Raises
    ------
    InputFileError
        The file cannot be read.
    ValueError
        `columns` has a name that a log does not have, or the file does not.
    """
    return _log(Path(file), gaps, columns)


def log_of(
    log: Log | str | PathLike[str] | Iterable[Mapping[str, Any]], problems: Sequence[str], *, gaps: bool = False,
    columns: Mapping[str, str] | None = None,
) -> Log:  # fmt: skip
    """Return the log of some tasks in any form: itself, its file, records, or a data frame; options as in `read_log`.

    Parameters
    ----------
    log : Log, path, iterable of mappings, or data frame
    problems : sequence of str
        Files of the tasks' problems. Lines of other tasks are left out, as `note` says.

    Raises
    ------
    InputFileError
        The log has several tasks, and none of these; or it was read already with the lines of several.
    TypeError
        It is no log, or it was read already and there are options of reading.
    """
    if isinstance(log, Log):
        if gaps or columns:
            raise TypeError(f"{'columns' if columns else 'gaps'}: expected a file, records or a frame, not a log")
        if log.tasks:
            several = f"lines of several tasks ({', '.join(task or 'no name' for task in log.tasks)})"
            wanted = "expected the file, records or frame itself, of which only the instance's lines are then read"
            raise InputFileError(f"{log.name}: {several} were read; {wanted}")
        return log
    return _log(Path(log) if isinstance(log, str | PathLike) else log, gaps, columns, problems=problems)


def _records(records: Any) -> Iterable[Mapping[str, Any]]:
    """Return records, also those of a data frame."""
    if hasattr(records, "to_dicts"):  # polars
        return cast(Iterable[Mapping[str, Any]], records.to_dicts())
    if hasattr(records, "to_dict"):  # pandas
        return cast(Iterable[Mapping[str, Any]], records.to_dict("records"))
    if isinstance(records, str | bytes | Mapping) or not isinstance(records, Iterable):
        wanted = "a Log, the name of its file, a list of dictionaries, or a data frame"
        raise TypeError(f"a {type(records).__name__} where a log was expected: {wanted}")
    return cast(Iterable[Mapping[str, Any]], records)


def told(faults: Iterable[Fault], name: object) -> list[str]:
    """Return a line for each fault, in the form FILE:LINE: MESSAGE.

    Equal faults are listed once. Of faults that differ in names and numbers only, three are listed, as most lines
    of another task's log are faults.
    """
    kinds: dict[str, dict[str, list[Fault]]] = {}
    for fault in faults:
        kind = re.sub(r"""\d+|\([^()]*\)|'[^']*'|"(?:[^"\\]|\\.)*"|;.*""", "", fault.message)
        kinds.setdefault(kind, {}).setdefault(fault.message, []).append(fault)
    lines = []
    for alike in kinds.values():
        several = list(alike.values())
        shown, hidden = several[:3], several[3:]
        for first, *others in shown:
            also = f" (and so {len(others)} more, to line {others[-1].line})" if others else ""
            lines.append(f"{name}:{first.line}: {first}{also}")
        rest = [fault.line for faults in hidden for fault in faults]
        if rest:
            lines.append(f"{name}:{min(rest)}: {len(rest):,} more of this kind, to line {max(rest)}")
    return lines


def as_one_goal(log: Log) -> str | None:
    """Return a sentence on a log of several goals that is read as if all pursued one; None for any other log."""
    if len(log.goals) < 2:
        return None
    shown = ", ".join(log.goals[:SHOWN]) + (", ..." if len(log.goals) > SHOWN else "")
    wanted = "expected --goals (in Python a task for each goal)"
    return f"all episodes are read as if they had one goal, and a simulation wrote {shown}; {wanted}"


def selected(log: Log, faults: Iterable[Fault]) -> str | None:
    """Return a sentence on the episodes that are left out because of faults; None if there are none.

    People who make mistakes, or meet unusual suggestions, lose more of their episodes than others.
    """
    spoilt = {(one.person, one.episode) for one in faults if one.spoils and one.episode is not None}
    every = {one.names for one in log.entries} | spoilt
    if not spoilt:
        return None
    of_person = Counter(str(person) for person, _ in spoilt)
    whole = Counter(str(person) for person, _ in every)
    people = [f"{person} {count} of {whole[person]}" for person, count in sorted(of_person.items())]
    more = f" and {len(people) - SHOWN} more people" if len(people) > SHOWN else ""
    used, whose = f"{len(every) - len(spoilt)} of {len(every)} episodes are used", ", ".join(people[:SHOWN])
    said = f"{used}; left out are {whose}{more}, which are no random choice, so that estimates may be biased"
    advised = {(one.person, one.episode) for one in faults if one.spoils and f": {SUGGESTION}" in one.message}
    if advised:
        said += f"; {len(advised)} by the column suggestion: without it, all of these give expertise (beta) alone"
    return said


def in_order(name: str) -> list[tuple[int, int, str]]:
    """Return a sort key for a name, by which numbers in it are compared as numbers: episode 9 before episode 10."""
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in re.split(r"(\d+)", name)]


def _log(
    source: Path | Iterable[Mapping[str, Any]], gaps: bool, columns: Mapping[str, str] | None, name: str = "log",
    problems: Sequence[str] = (),
) -> Log:  # fmt: skip
    """Return the log in a file, which has the file's name, or of records."""
    taken, named = Taken(), own_names(columns)
    if isinstance(source, Path):
        name = str(source)
        rows = read_records(source, named, taken)
    else:
        rows = named_rows(list(enumerate(_records(source), start=1)), named, name, taken)
        if hasattr(source, "columns") and (lacking := lacking_column(list(map(str, source.columns)), named)):
            rows, taken.broken = [], [(1, lacking)]
    rows = tidy(in_tasks(rows, problems, name, taken), taken, gaps=gaps)
    note = str(taken)
    entries: list[Entry] = []
    faults: list[Fault] = []
    for number, record in rows:
        message = _fault(record)
        if message is None:
            entries.append(
                Entry(
                    number, str(record["person"]), str(record["episode"]), record["step"], record["action"],
                    record.get("suggestion"), record.get("executed"), *(record.get(key) for key in IN_TEAM),
                )
            )  # fmt: skip
        else:
            faults.append(Fault(number, _name(record.get("person")), _name(record.get("episode")), message))
    for number, broken in taken.broken:
        owners: list[tuple[str | None, str | None]] = [*sorted(broken.owners)] or [(None, None)]
        faults += [Fault(number, *names, broken.message, not broken.ends) for names in owners]
    lost = sorted(fault.line for fault in faults if fault.spoils and None in (fault.person, fault.episode))
    called = {words[0] for entry in entries for words in map(words_of, entry.texts) if words}
    people = {entry.person for entry in entries} | {fault.person for fault in faults if fault.person is not None}
    spoilt = {(fault.person, fault.episode) for fault in faults if fault.spoils}
    lowest = min((entry.step for entry in entries), default=0)
    if lowest and not gaps:
        counted = f"steps that count from {lowest}: a first line that is missing in every episode is not noticed"
        note = f"{note}; {counted}" if note else f"read {counted}"
    episodes: dict[str, list[str]] = {}
    for owner, episode in sorted({entry.names for entry in entries}, key=lambda names: [*map(in_order, names)]):
        episodes.setdefault(owner, []).append(episode)
    disorder = next(filter(None, map(days_in_disorder, episodes.values())), None)
    if disorder is not None:
        said = f"episodes such as '{disorder}' in the order of these numbers, perhaps not of days; expected 2026-03-01"
        note = f"{note}; {said}" if note else f"read {said}"
    entries = [entry for entry in entries if entry.names not in spoilt]
    incomplete = _incomplete(entries, lost, gaps, lowest)
    faults += incomplete.values()
    return Log(
        tuple(entry for entry in entries if entry.names not in incomplete),
        tuple(sorted(faults, key=lambda fault: fault.line)), frozenset(people), frozenset(called), name, note,
        tuple(taken.asked), taken.simulated, taken.goals, taken.tasks,
    )  # fmt: skip


def _incomplete(entries: Sequence[Entry], lost: Sequence[int], gaps: bool, lowest: int) -> dict[Names, Fault]:
    """Return episodes of which an action is missing, or may be missing because a lost line may belong to it.

    A log may count from any number, but from the same one in every episode: from `lowest`, that of its first steps. An
    unreadable line may have been the first of every episode, so that only 0 and 1 are known to be first then.
    """
    episodes: dict[Names, list[Entry]] = {}
    for entry in entries:
        episodes.setdefault(entry.names, []).append(entry)
    first = {names: min(rows, key=lambda entry: entry.step) for names, rows in episodes.items()}
    starts = [entry.step for entry in first.values()]
    begin = 1 if 0 not in starts and starts.count(1) > 1 else 0  # the first step number of this log
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
        if rows[0].step != lowest:
            message = f"step {rows[0].step} is its first and {lowest} that of others, as if a line were missing"
            found[names] = Fault(rows[0].line, *names, f"{message}; {GAPS} if the log counts otherwise")
            continue
        for before, after in pairwise(rows):
            if after.step > before.step + 1:
                message = f"step {after.step} comes after step {before.step}, as if a line were missing"
                found[names] = Fault(after.line, *names, f"{message}; {GAPS} if the log counts otherwise")
                break
    return found


def _name(value: object) -> str | None:
    return str(value) if isinstance(value, str | int) and not is_hidden(str(value)) else None


def _short(value: object) -> str:
    """Return a value as JSON has it; a long one is cut."""
    text, most = json.dumps(value, default=str), 60  # characters, so that a message stays on a line or two
    return text if len(text) <= most else f"{text[:most]}..."


def _fault(record: Mapping[str, Any]) -> str | None:
    """Return what is wrong with a record; None if nothing is."""
    for key, types, wanted in (
        ("person", (str, int), "a name"),
        ("episode", (str, int), "a name"),
        ("step", (int,), "a whole number"),
        ("action", (str, type(None)), 'an action as text, "(name argument ...)", or null'),
        ("suggestion", (str, type(None)), "an action as text, or null"),
        ("executed", (str, type(None)), "an action as text, or null"),
    ):
        if key not in record and key in NEEDED:
            return f"there is no '{key}'; expected {wanted}"
        value = record.get(key)
        if not isinstance(value, types) or isinstance(value, bool):
            time = f", or {GAPS} if steps are times" if key == "step" and moment(value) is not None else ""
            date = expected_date(value) if key == "step" and not time else ""
            return f"'{key}' is {_short(value)}; expected {wanted}{time or date}"
        if isinstance(value, str) and is_hidden(value):
            return f"'{key}' is {json.dumps(value)}, which cannot be shown; expected {wanted}"
    if not -(2**63) <= record["step"] < 2**63:
        return "'step' is too large; expected a whole number of at most 64 bits"
    for key in ("action", "suggestion", "executed"):
        wrong = wrong_form(record.get(key) or "")
        if wrong is not None:
            return f"'{key}' {wrong}"
    return None
