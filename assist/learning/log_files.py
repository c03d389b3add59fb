"""File formats of logs: JSON and tables, as people, pandas, R and spreadsheets write them.

`read_records` returns a file's records with their lines and the column names of a log, and describes how the file was
interpreted. A line that is no record is a `Broken`. Ambiguous values are not guessed: they are left as they are, and
become faults with their lines.
"""

from __future__ import annotations

import difflib
import json
import re
from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE, BOM_UTF32_BE, BOM_UTF32_LE
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path, PureWindowsPath
from typing import Any
from unicodedata import category

import numpy as np

from planner.system.errors import InputFileError, plain
from planner.system.files import bytes_of

from ..people.action_names import words_of, wrong_form
from .log_json import read_json
from .log_rows import Broken, Names, Record, Row, Taken
from .log_steps import is_plain, number_times, whole
from .log_tables import has_columns, read_table

COLUMNS = ("person", "episode", "step", "action", "suggestion", "executed", "place", "order", "since", "task")
NEEDED = COLUMNS[:4]
NAMES = COLUMNS[:2]
ACTIONS = COLUMNS[3:6]
IN_TEAM = COLUMNS[6:9]
TASK = COLUMNS[9]

DASHES = frozenset(("-", "--", "---", "\N{EN DASH}", "\N{EM DASH}", "\N{MINUS SIGN}"))
"""Notations of no suggestion; no action has such a name."""

MISSING = frozenset(
    (
        "#N/A", "#N/A N/A", "#NA", "-1.#IND", "-1.#QNAN", "-NaN", "-nan", "1.#IND", "1.#QNAN", "<NA>", "N/A", "NA",
        "NULL", "NaN", "NaT", "None", "n/a", "nan", "null",
    )
)  # fmt: skip
"""Notations of a missing value besides an empty cell; the list of pandas."""

EXPECTED = 'expected an object, {"person": ..., "episode": ..., "step": ..., "action": ...}'

BINARY = {
    b"\x1f\x8b": "a compressed file",
    b"PK\x03\x04": "a spreadsheet's own file, or an archive",
    b"\xd0\xcf\x11\xe0": "a spreadsheet's own file",
    b"PAR1": "a Parquet file",
}
"""First bytes of files that are no text."""


def read_records(file: Path, columns: Mapping[str, str], taken: Taken) -> list[Record]:
    """Return a file's records with the column names of a log, of which `own_names` returns the user's.

    Raises
    ------
    InputFileError
        The file cannot be read.
    ValueError
        `columns` has a name that the file does not have.
    """
    lines = lines_of(bytes_of(file), taken)
    texts = [line for line in lines if isinstance(line, str) and line.strip()]
    head = texts[0].strip() if texts else ""
    own = set(_sources(columns).values())
    if head.startswith(("{", "[")) or not _is_table(file, texts, own):
        rows = read_json(lines, lambda key: isinstance(key, str) and plain(key).lower() in own, _owners)
        return named_rows(rows, columns, file, taken)
    return _from_table(lines, columns, file, taken)


def in_tasks(rows: list[Record], problems: Sequence[str], name: object, taken: Taken) -> list[Record]:
    """Return the rows in some tasks; rows whose task is unknown are returned, too, unless other rows have one.

    An episode belongs to one task, so that lines of others are no part of the log: they are left out first of all.

    Parameters
    ----------
    rows : list of Record
    problems : sequence of str
        Files of the tasks' problems. A log calls a task by such a name, without ending and perhaps with folders. A
        log of one task may call it otherwise. Without problems all rows are returned, and `taken` has their tasks.
    name : object
        The log, in messages.
    taken : Taken

    Raises
    ------
    InputFileError
        The log has several tasks, and none of these.
    """
    tasks = Counter(_task(record) for _, record in rows)
    called = [task for task in tasks if any(_is_called(task, problem) for problem in problems)]
    shown = ", ".join(f"{task or 'no name'} {count:,}" for task, count in tasks.items())
    own = Path(problems[0]).stem if problems else ""
    if not problems:
        taken.tasks = tuple(tasks) if len(tasks) > 1 else ()
    elif len(tasks) > 1 and not called:
        wanted = (
            f"expected lines of '{own}', as the instance is called, or of one task only, as log(task) of a team has"
        )
        other = "a column `task` that means something else needs another name"
        raise InputFileError(f"{name}: lines of several tasks ({shown}); {wanted}; {other}")
    elif len(tasks) > len(called):
        if not called:
            if any(tasks):
                taken.said.append(f"lines of the task '{next(iter(tasks))}' as those of '{own}'")
            return rows
        left = sum(tasks.values()) - sum(tasks[task] for task in called)
        taken.said.append(f"only lines of the task {' or '.join(called)}, without {left:,} others (lines: {shown})")
        return [row for row in rows if _task(row[1]) in called]
    return rows


def _task(record: Mapping[str, Any]) -> str:
    """Return the name of a record's task; an empty one if it has none."""
    value = record.get(TASK)
    return "" if value is None or _is_missing(value, Taken()) else plain(str(value))


def _is_called(task: str, problem: str) -> bool:
    """Return whether a task's name is that of a problem's file: without ending, perhaps with its last folders.

    Folders are separated by either sign, whichever system wrote the log.
    """
    own, name = (PureWindowsPath(text.lower().removesuffix(".pddl")).parts for text in (problem, task))
    return bool(name) and own[-len(name) :] == name


def own_names(columns: Mapping[str, str] | None) -> dict[str, str]:
    """Return the columns that a user has named, in lower case.

    Raises
    ------
    ValueError
        A log has no such column, or two columns have the same name.
    """
    found: dict[str, str] = {}
    for name, own in (columns or {}).items():
        key = name.strip().lower()
        if key not in COLUMNS:
            near = difflib.get_close_matches(key, COLUMNS, n=1)
            turned = own.strip().lower()
            meant = f"did you mean '{near[0]}'?" if near else f"it has {', '.join(COLUMNS)}"
            meant = f"did you mean {turned}={name}?" if turned in COLUMNS else meant
            raise ValueError(f"columns {name}={own}: a log has no column '{name}'; {meant}")
        if own.strip().lower() in found.values():
            raise ValueError(f"columns {name}={own}: '{own}' stands for another column already")
        found[key] = own.strip().lower()
    for key, own in found.items():
        if own in NEEDED and own not in found:
            raise ValueError(f"columns {key}={own}: '{own}' is the column of the {own} already; expected another one")
    return found


def _sources(columns: Mapping[str, str]) -> dict[str, str]:
    """Return the file's name of each column of a log; one that a user has named is no other's."""
    named = set(columns.values())
    return {name: columns.get(name, name) for name in COLUMNS if name in columns or name not in named}


def tidy(rows: list[Record], taken: Taken, *, gaps: bool = False) -> list[Record]:
    """Return records with None for missing values, plain names, and integers for steps in any notation.

    Records that have neither an action nor a step, or name no episode, are left out, since they are no part of one:
    programs for experiments write a row for instructions, too. A record that has no field `action` at all is broken:
    where nothing was done, it is null.
    """
    for number, record in rows:
        _tidy(record, number, taken)
    if any(record.get("action") is not None for _, record in rows):
        rows = [row for row in rows if row[1].get("action") is not None or _is_part(*row, taken)]
    for _, record in rows:
        step = record.get("step")
        integer = whole(step)
        if integer is not None:
            record["step"] = integer
            taken.steps += [str(step)] * (not is_plain(step))
        for key in IN_TEAM:
            record[key] = value if type(value := record.get(key)) is int else whole(value)
    if gaps:
        taken.times, unclear = number_times(rows)
        midnight = "times of the clock that seem to go on after midnight; expected dates, too"
        taken.broken += [(number, Broken(midnight, _owner(record))) for number, record in unclear]
        which = {id(record) for _, record in unclear}
        rows = [row for row in rows if id(row[1]) not in which]
    return rows


def _is_part(number: int, record: Mapping[str, Any], taken: Taken) -> bool:
    """Return whether a record without an action is a line of an episode, in which nothing was done."""
    nothing = all(record.get(key) is None for key in ACTIONS)
    if nothing and any(record.get(key) is None for key in NEEDED[:3]):
        taken.outside.append(number)
        return False
    if "action" not in record:
        taken.broken.append((number, Broken("no action; expected null if nothing was done", _owner(record))))
        return False
    taken.idle += [number] * (record.get("executed") is None)
    return True


def _tidy(record: dict[str, Any], number: int, taken: Taken) -> None:
    """Replace the values of one record."""
    for key in record.keys() & set(COLUMNS):
        value = record[key] = record[key].item() if isinstance(record[key], np.generic) else record[key]
        if isinstance(value, str) and not is_hidden(value):
            record[key] = taken.plain(value, number)
    for key in ("step", *ACTIONS):
        if key in record and _is_missing(record[key], taken):
            record[key] = None
    for key in NAMES:
        if record.get(key) == "":
            record[key] = None
        elif isinstance(record.get(key), float) and record[key] == record[key]:
            record[key] = str(record[key])


def is_hidden(text: str) -> bool:
    """Return whether a text has characters that cannot be shown or written."""
    return any(category(sign) in ("Cc", "Cs") for sign in " ".join(text.split()))


def _owner(record: Mapping[str, Any]) -> frozenset[Names]:
    """Return whose line a record is; nobody if it does not say so."""
    person, episode = (record.get(key) for key in NAMES)
    return frozenset({(str(person), str(episode))}) if person is not None and episode is not None else frozenset()


def _is_missing(value: object, taken: Taken) -> bool:
    if value is None or (isinstance(value, str) and not value.strip()):
        return True
    word = str(value).strip() if not isinstance(value, int) else ""
    if word in MISSING | DASHES:
        taken.missing.setdefault(word)
        return True
    return False


def lines_of(data: bytes, taken: Taken) -> list[str | Broken]:
    """Return the lines of a file; the last one is empty if the file ends with a line break."""
    for mark, kind in BINARY.items():
        if data.startswith(mark):
            return [Broken(f"this is {kind}; expected a text file, CSV or JSON Lines")]
    encoding = _foreign(data)
    if encoding is None:
        return [_decoded(line) for line in re.split(rb"\r\n|\r|\n", data.removeprefix(BOM_UTF8))]
    taken.said.append(f"as {encoding[:6].upper()}")
    try:
        text, damaged = data.decode(encoding), False
    except UnicodeDecodeError:
        text, damaged = data.decode(encoding, errors="replace"), True
    lines = re.split(r"\r\n|\r|\n", text.removeprefix("\ufeff"))
    message = f"its bytes are not {encoding[:6].upper()}, as those of other lines are"
    return [Broken(message, _owners_but_damaged(line)) if damaged and "\ufffd" in line else line for line in lines]


def _foreign(data: bytes) -> str | None:
    """Return the likely encoding of a text that is not UTF-8."""
    for mark, name in (
        (BOM_UTF32_LE, "utf-32"), (BOM_UTF32_BE, "utf-32"), (BOM_UTF16_LE, "utf-16"), (BOM_UTF16_BE, "utf-16"),
    ):  # fmt: skip
        if data.startswith(mark):
            return name
    zeros = tuple(k for k, byte in enumerate(data[:4]) if byte == 0)
    return {(1, 3): "utf-16-le", (0, 2): "utf-16-be", (1, 2, 3): "utf-32-le", (0, 1, 2): "utf-32-be"}.get(zeros)


def _decoded(line: bytes) -> str | Broken:
    try:
        return line.decode("utf-8")
    except UnicodeDecodeError:
        text = line.decode("utf-8", errors="replace")
        return Broken("its bytes are not UTF-8; expected a file in that encoding", _owners_but_damaged(text))


def _owners_but_damaged(text: str) -> frozenset[Names]:
    return frozenset(names for names in _owners(text) if "\ufffd" not in "".join(names))


NAMED = re.compile(r'"(person|episode)"\s*:\s*(?:("(?:[^"\\]|\\.)*")|(-?\d+)(?=\s*[,}]))')


def _owners(text: str) -> frozenset[Names]:
    """Return the people and episodes that a broken line names; it may hold several records or parts of them."""
    found: dict[str, list[str]] = {"person": [], "episode": []}
    for key, quoted, number in NAMED.findall(text):
        try:
            found[key].append(json.loads(quoted) if quoted else number)
        except ValueError:
            return frozenset()
    known = len(found["person"]) == len(found["episode"]) and not any(
        map(is_hidden, found["person"] + found["episode"])
    )
    pairs = (map(plain, found[key]) for key in NAMES)
    return frozenset(zip(*pairs, strict=True)) if known else frozenset()


def named_rows(
    rows: Sequence[Row], columns: Mapping[str, str], name: object, taken: Taken, head: Iterable[str] = ()
) -> list[Record]:
    """Return records with the column names of a log, from the user's names in any case; `head` has names of a table."""
    records = [(number, record) for number, record in rows if isinstance(record, Mapping)]
    others = [(number, other) for number, other in rows if not isinstance(other, Mapping)]
    taken.broken += [(number, one if isinstance(one, Broken) else Broken(EXPECTED)) for number, one in others]
    every = dict.fromkeys([*head, *(str(key) for _, record in records for key in record)])
    keys = {key: plain(key).lower() for key in every}
    _check(columns, list(keys.values()), name)
    taken.simulated = set(keys.values()) >= OF_A_SIMULATION
    if taken.simulated:
        each = (record.get("goal") for _, record in records)
        taken.goals = tuple(dict.fromkeys(goal for goal in each if isinstance(goal, str) and goal))
    source = _sources(columns)
    renamed = {key: name for name, own in source.items() for key, plain_key in keys.items() if plain_key == own}
    found: list[Record] = []
    for number, record in records:
        taken.doubtful += [number] * (record.get("uncertain") is True)
        own = [key for key in record if key in renamed]
        mine = {renamed[key]: record[key] for key in own}
        if len(mine) == len(own):
            found.append((number, mine))
        else:
            twice = Counter(renamed[key] for key in own).most_common(1)[0][0]
            taken.broken.append((number, Broken(f"two fields are called {source[twice]}")))
    if "suggestion" not in renamed.values():
        actions = [record.get("action") for _, record in found]
        cells = {key: [record.get(key) for _, record in records] for key in keys if key not in renamed}
        taken.asked += _asked(cells, actions)
    return found


OF_A_SIMULATION = frozenset(("policy", "theta"))
"""Columns with what only a simulation knows, which writes both."""

HINTS = frozenset(
    ("advice", "advised", "hint", "hints", "proposal", "recommendation", "recommended", "suggested", "suggestions")
)
"""Names of columns that may have suggestions."""


def _asked(cells: Mapping[str, Sequence[Any]], actions: Sequence[Any]) -> list[str]:
    """Return a question for each column that is not read, and has a name of suggestions, or actions that people did."""
    called = _first_words(actions)
    asked = []
    for key, column in cells.items():
        there = [value for value in column if value is not None and not _is_missing(value, Taken())]
        words = _first_words(there)
        if there and (plain(key).lower() in HINTS or (words and words <= called)):
            how = f"--columns suggestion={key} (in Python columns={{'suggestion': '{key}'}})"
            asked.append(f"column '{key}' is not read; {how} if it has suggestions")
    return asked


def _first_words(actions: Sequence[Any]) -> set[str]:
    """Return the names of actions; a value that is no action has the name ''."""
    texts = [text if isinstance(text, str) and wrong_form(text) is None else "" for text in actions if text is not None]
    return {(*words_of(text), "")[0] for text in texts}


def _is_table(file: Path, texts: Sequence[str], sought: Collection[str]) -> bool:
    """Return whether a file whose first line is no JSON is a table."""
    if file.suffix.lower() in (".csv", ".tsv", ".txt"):
        return True
    if any(line.lstrip().startswith("{") for line in texts) or not texts:
        return False
    return file.suffix.lower() not in (".jsonl", ".json") or has_columns(texts, sought)


def _from_table(lines: Sequence[str | Broken], columns: Mapping[str, str], file: Path, taken: Taken) -> list[Record]:
    """Return the records of a table with the column names of a log; an empty cell is None."""
    source = _sources(columns)

    def owners(cells: Mapping[str, str]) -> frozenset[Names]:
        return _owner({name: plain(cells[source[name]]) for name in NAMES if cells.get(source[name])})

    (number, head), rows = read_table(lines, source.values(), owners, taken)
    found = [
        (line, {name: _cell(name, cell, taken) for name, cell in record.items()})
        for line, record in named_rows(rows, columns, file, taken, head)
    ]
    lacking = None if number in dict(taken.broken) else lacking_column(head, columns)
    if lacking is None:
        return found
    taken.broken.append((number, lacking))
    return []


def lacking_column(head: Sequence[str], columns: Mapping[str, str]) -> Broken | None:
    """Return the fault of a table with some names of columns that lacks one; None if it has all, or no columns."""
    names = [plain(cell).lower() for cell in head]
    missing = [name for name in NEEDED if _sources(columns)[name] not in names]
    if not names or not missing:
        return None
    return Broken(
        f"no column is called {' or '.join(missing)}; expected {', '.join(COLUMNS[:5])}, or --columns "
        f"{missing[0]}=NAME (in Python columns={{'{missing[0]}': NAME}}) with one of {', '.join(filter(None, names))}"
    )


def _check(columns: Mapping[str, str], there: Sequence[str], file: object) -> None:
    for name, own in columns.items():
        if there and own not in there:
            near = difflib.get_close_matches(own, there, n=1)
            meant = f"; did you mean '{near[0]}'?" if near else f"; it has {', '.join(filter(None, there))}"
            raise ValueError(f"columns {name}={own}: {file} has no column '{own}'{meant}")


def _cell(name: str, cell: str, taken: Taken) -> Any:
    if not cell or (name in NAMES and cell in MISSING - {"NA"}):
        return None
    if name in ACTIONS and cell.upper() in ("TRUE", "FALSE"):
        return cell.upper() == "TRUE"
    if name in NAMES and cell == "NA" and (note := f"NA as the name of a {name}") not in taken.said:
        taken.said.append(note)
    return cell
