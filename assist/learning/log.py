"""A log: what people did and what had been suggested to them, line by line, as a file has it.

`read_log` takes JSON Lines, as `kitassist simulate --trace` writes them, or CSV with the same names of columns, to
`Entry`s. What cannot be used becomes a `Fault`, which says where it is and what would be right.

An episode is of use only if none of its actions is missing: what came after a missing one would be taken for actions
in other states than people were in. So a line that cannot be used costs its episode, and no other; and where a number
of a step is missing, so is a line. What is left of a broken line often says whose it was. Where it does not, whatever
episode may have begun with it is left out.
"""

from __future__ import annotations

import csv
import json
import re
from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE, BOM_UTF32_BE, BOM_UTF32_LE
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import Any
from unicodedata import category

from .actions import words_of

COLUMNS = ("person", "episode", "step", "action", "suggestion", "executed")
NEEDED = COLUMNS[:4]
EXPECTED = 'expected an object, {"person": ..., "episode": ..., "step": ..., "action": ...}'

EXAMPLES = 3
"""Faults of a kind that are told one by one."""

Names = tuple[str, str]
"""A person and one of their episodes."""


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
    """

    entries: tuple[Entry, ...]
    faults: tuple[Fault, ...] = ()
    people: frozenset[str] = frozenset()
    called: frozenset[str] = frozenset()
    name: str = "log"

    @classmethod
    def of(cls, records: Iterable[Mapping[str, Any]], *, gaps: bool = False, name: str = "log") -> Log:
        """Take records as a log's lines have them, such as a simulation's trace, for a log; they count as lines."""
        return _log(((number, record) for number, record in enumerate(records, start=1)), gaps, name)


def read_log(file: str | PathLike[str], *, gaps: bool = False) -> Log:
    """Read a log of recorded actions, JSON Lines or CSV.

    Parameters
    ----------
    file : path
        UTF-8, with or without a byte order mark. Other columns than those of `Entry` are ignored. Person and episode
        may be numbers.
    gaps : bool
        Whether `step` may skip numbers without a line missing, as where it counts what several people do.

    Raises
    ------
    OSError
        The file cannot be read.
    """
    path = Path(file)
    data = path.read_bytes()
    encoding = _foreign(data)
    if encoding:
        return Log((), (Fault(1, None, None, f"the file is encoded in {encoding}; expected UTF-8"),), name=str(path))
    raw = data.removeprefix(BOM_UTF8).split(b"\n")
    lines = [_decoded(line) for line in raw]
    head = next((line for line in lines if isinstance(line, str) and line.strip()), "")
    delimiter = _delimiter(head)
    if delimiter is None and path.suffix.lower() == ".csv":
        delimiter = ","
    return _log(_objects(lines) if delimiter is None else _rows(lines, delimiter), gaps, str(path))


def told(faults: Iterable[Fault], name: object) -> list[str]:
    """Give a line for each fault, as compilers do.

    What is wrong with many lines is said once, and of what differs in names and numbers only `EXAMPLES` are given: the
    log of another task has hardly a line that fits.
    """
    kinds: dict[str, dict[str, list[Fault]]] = {}
    for fault in faults:
        kind = re.sub(r"\d+|\([^()]*\)|'[^']*'|;.*", "", fault.message)
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


@dataclass(frozen=True)
class _Broken:
    """A line that is no record.

    Attributes
    ----------
    message : str
    owners : set of Names
        Whose it was, by what is left of it; empty where that does not say so.
    ends : bool
        Whether the file breaks off with it, so that nothing came after it.
    """

    message: str
    owners: frozenset[Names] = frozenset()
    ends: bool = False


def _foreign(data: bytes) -> str | None:
    """Name the encoding of a text that cannot be UTF-8."""
    for mark, name in (
        (BOM_UTF32_LE, "UTF-32"), (BOM_UTF32_BE, "UTF-32"), (BOM_UTF16_LE, "UTF-16"), (BOM_UTF16_BE, "UTF-16"),
    ):  # fmt: skip
        if data.startswith(mark):
            return name
    zeros = [k for k, byte in enumerate(data[:4]) if byte == 0]
    return {(1, 3): "UTF-16", (0, 2): "UTF-16", (1, 2, 3): "UTF-32", (0, 1, 2): "UTF-32"}.get(tuple(zeros))


def _decoded(line: bytes) -> str | _Broken:
    try:
        return line.decode("utf-8")
    except UnicodeDecodeError:
        text = line.decode("utf-8", errors="replace")
        owners = frozenset(names for names in _owners(text) if "\ufffd" not in "".join(names))
        return _Broken("its bytes are no UTF-8; expected a file in that encoding", owners)


def _objects(lines: Sequence[str | _Broken]) -> Iterator[tuple[int, Any]]:
    """Read JSON Lines."""
    for number, line in enumerate(lines, start=1):
        if isinstance(line, _Broken):
            yield number, line
        elif line.strip():
            try:
                yield number, json.loads(line)
            except (ValueError, RecursionError):
                if number == len(lines):  # a whole last line ends with a line feed
                    cut = "the last line is cut off; the lines before it are used"
                    yield number, _Broken(cut, _owners(line), ends=True)
                else:
                    yield number, _Broken("no JSON; expected one object in every line", _owners(line))


NAMED = re.compile(r'"(person|episode)"\s*:\s*(?:("(?:[^"\\]|\\.)*")|(-?\d+)(?=\s*[,}]))')


def _owners(text: str) -> frozenset[Names]:
    """Read off a broken line whose it was; it may hold several records, whole or in part."""
    found: dict[str, list[str]] = {"person": [], "episode": []}
    for key, quoted, number in NAMED.findall(text):
        try:
            found[key].append(json.loads(quoted) if quoted else number)
        except ValueError:
            return frozenset()
    known = len(found["person"]) == len(found["episode"]) and not any(map(_hidden, found["person"] + found["episode"]))
    return frozenset(zip(found["person"], found["episode"], strict=True)) if known else frozenset()


def _delimiter(head: str) -> str | None:
    """Give what separates the columns that a first line names; None if it names none."""
    names = {delimiter: _columns(head, delimiter) for delimiter in ",;\t"}
    best = max(names, key=lambda delimiter: len(set(names[delimiter]) & set(COLUMNS)))
    return best if "person" in names[best] else None


def _columns(head: str, delimiter: str) -> list[str]:
    try:
        return [cell.strip().lower() for cell in next(csv.reader([head], delimiter=delimiter))]
    except csv.Error:
        return []


def _rows(lines: Sequence[str | _Broken], delimiter: str) -> Iterator[tuple[int, Any]]:
    """Read CSV; an empty cell stands for null."""
    broken = [(number, line) for number, line in enumerate(lines, start=1) if isinstance(line, _Broken)]
    yield from broken
    texts = [line if isinstance(line, str) else "" for line in lines]
    reader = csv.reader((f"{text}\n" for text in texts), delimiter=delimiter, strict=True)
    columns: list[str] = []
    while True:
        number = reader.line_num + 1
        try:
            cells = next(reader, None)
        except csv.Error as error:
            yield number, _Broken(f"no CSV ({error}); what comes after it is not read")
            return
        if cells is None:
            return
        if not any(cell.strip() for cell in cells):
            continue
        if not columns:
            columns = [cell.strip().lower() for cell in cells]
            missing = [name for name in NEEDED if name not in columns]
            if missing:
                yield number, _Broken(f"no column is called {' or '.join(missing)}; expected {', '.join(COLUMNS[:5])}")
                return
        elif len(cells) != len(columns):
            whole = dict(zip(columns, cells[:-1], strict=False))  # the last cell may be cut off
            names = whole.get("person", ""), whole.get("episode", "")
            owners = frozenset({names}) if all(names) and len(cells) < len(columns) else frozenset()
            message = f"{len(cells)} cells; expected {len(columns)}, as in the first line"
            ends = number == len(lines)
            yield (
                number,
                _Broken("the last line is cut off; the lines before it are used" if ends else message, owners, ends),
            )
        else:
            record: dict[str, Any] = {name: cell.strip() or None for name, cell in zip(columns, cells, strict=True)}
            step = record["step"]
            if step is not None and re.fullmatch(r"[+-]?\d{1,20}", step):
                record["step"] = int(step)
            yield number, record


def _log(records: Iterable[tuple[int, Any]], gaps: bool, name: str) -> Log:
    """Sort lines into entries and faults."""
    entries: list[Entry] = []
    faults: list[Fault] = []
    lost: list[int] = []  # lines that may have been of any episode
    for number, record in records:
        if isinstance(record, _Broken):
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
        tuple(sorted(faults, key=lambda fault: fault.line)), frozenset(people), frozenset(called), name,
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
    return str(value) if isinstance(value, str | int) and not _hidden(str(value)) else None


def _hidden(text: str) -> bool:
    """Whether a text has signs that no terminal can show, or no file hold."""
    return any(category(sign) in ("Cc", "Cs") for sign in " ".join(text.split()))


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
        if isinstance(value, str) and _hidden(value):
            return f"'{key}' is {json.dumps(value)}, which cannot be shown; expected {wanted}"
    if not -(2**63) <= record["step"] < 2**63:
        return "'step' is too large; expected a whole number of at most 64 bits"
    for key in ("action", "suggestion", "executed"):
        text = (record.get(key) or "").strip()
        if text.startswith("(") != text.endswith(")"):
            return f"'{key}' is {json.dumps(text)}, with one bracket; expected (name argument ...)"
    return None
