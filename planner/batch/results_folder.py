"""A folder of results: records of instances, their tables and plans, and what these depend on.

It is a `ResumableFolder` (`system.files`), as a study's is. Scripts depend on the fields of the records, which
`docs/commands.md` lists.

The file `fingerprints` contains a line of JSON for each record in `results.jsonl`. It holds the `fingerprint` of what
the result depends on (the contents of both files, the relevant options, the programs), the `place` of the table and the
plan, their sizes, and a digest of the `record`. A later run keeps a record only if all of these are unchanged.
"""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from ..grounding import fast_downward
from ..pddl.compilation import MOST_VALUES
from ..pddl.instances import Instance
from ..system.errors import InputFileError
from ..system.files import ResumableFolder, read_records
from ..system.limits import MAX_STATES

SolveRecord = dict[str, Any]

SWEEPING = "solved on demand: the sweep had not ended"
PLANNING = "A* had not found its plan"
COMPARING = "the comparison with A* had not ended"
VALIDATING = "unified-planning had not answered"
"""Notes in the records of unfinished instances."""


@dataclass(frozen=True)
class SolveOptions:
    """Options for solving an instance."""

    time_limit: float | None = None
    """Wall-clock seconds for one instance; None for no limit."""
    memory_limit: float | None = None
    """Memory in MB for one instance; None for all available memory."""
    max_states: int = MAX_STATES
    """Largest number of states that are swept. A larger task is solved from its initial state only."""
    most_values: int = MOST_VALUES
    """Largest number of values of one number, such as a stock or a battery."""
    verify: int | None = None
    """Number of states compared with Fast Downward's A*, the initial state first, within the limits. By default, up to
    20 states are compared: of a small task all of them, of others as many as `comparison_share` and
    `comparison_seconds` allow, and none if A* does not answer soon for the initial state.
    """
    threads: int | None = None
    """Threads of the sweep; by default one per processor."""
    first_answer_after: float = 0.5
    """Seconds after which cost and plan are reported before all states are known, since most tasks are swept in less.
    """
    soon: float = 10.0
    """Seconds in which A* answers soon. Its plan is waited for so long, also after the sweep; else the table's is
    taken.
    """
    small: int = 10_000
    """Tasks of at most so many states are searched and compared whatever it takes, so that their records do not depend
    on the load of the machine. Blind search takes about a second for so many states.
    """
    sweep_share: float = 0.75
    """Share of `time_limit` after which the sweep ends. The rest is reserved for the initial state alone."""
    comparison_share: float = 0.25
    comparison_seconds: float = 1.0
    """The default comparison of a larger task takes at most this share of the search's time, or these seconds if that
    is longer.
    """


COMPILING = "compiling"
"""Stage that is reported while code is compiled that is not in the cache."""


def versions() -> dict[str, str]:
    """Return the versions of the programs that a result depends on."""
    import importlib.metadata  # slow to import

    packages = {"kitassist": "kitassist", "unified_planning": "unified-planning", "numpy": "numpy"}
    found = {key: importlib.metadata.version(package) for key, package in packages.items()}
    return {**found, "fast_downward": fast_downward.version(), "python": platform.python_version()}


def empty_record(instance: Instance, status: str, error: dict[str, Any] | None) -> SolveRecord:
    """Return a record without results."""
    return {
        "instance": str(instance.problem),
        "domain": str(instance.domain),
        "status": status,
        "cost": None,
        "plan": None,
        "plan_by": None,
        "states": None,
        "transitions": None,
        "dead_ends": None,
        "max_cost_to_go": None,
        "method": None,
        "verified": 0,
        "consistent": 0,
        "compiled": None,
        "seconds": {},
        "peak_memory_mb": None,
        "versions": versions(),
        "error": error,
        "note": None,
    }


def unsolved(instance: Instance, status: str, message: str) -> SolveRecord:
    """Return the record of an instance that was not solved, with the reason, which may begin with the instance."""
    return empty_record(instance, status, error_entry(instance.problem, None, message.removeprefix(f"{instance}: ")))


def error_entry(file: Path, line: int | None, message: str) -> dict[str, Any]:
    """Return the field `error` of a record."""
    return {"file": str(file), "line": line, "message": message}


def unfinished(record: SolveRecord, why: str) -> SolveRecord:
    """Return an intermediate record as the final one, with the reason for the early end in its note."""
    return {**record, "note": f"{record['note']}; {why}"}


def saved_files(place: Path) -> tuple[Path, Path]:
    """Return the files of an instance's table and plan."""
    return place.with_name(f"{place.name}.npz"), place.with_name(f"{place.name}.plan")


RESULTS, FINGERPRINTS = "results.jsonl", "fingerprints"
Key = tuple[str, str]
"""Identifier of an instance: the paths of its problem and domain. One problem may be solved with several domains."""

DONE = frozenset({"solved", "unsolvable"})  # statuses that a resumed run keeps; the others are tried again


class Results:
    """The results of a run, updated while it runs: `records` are those so far, by instance (`key`)."""

    def __init__(self, folder: Path, instances: Sequence[Instance], options: SolveOptions, *, resume: bool) -> None:
        """Prepare the folder for a run of the given instances; with `resume`, valid records in it are kept.

        Results in the folder without `resume` raise a `InputFileError`, and files that are not results of this
        program an `InputFileError`.
        """
        self._folder, self._options = folder, options
        self._kept: ResumableFolder[Key] = ResumableFolder(folder / RESULTS, folder / FINGERPRINTS, resume=resume)
        before = {_key_of(record): record for record in _records(folder / RESULTS) if record["status"] in DONE}
        lines = {_key_of(line): line for line in read_records(folder / FINGERPRINTS) if _is_line(line)}
        current = {key(instance): fingerprint(instance, options) for instance in instances}
        self.records: dict[Key, SolveRecord] = {
            name: record
            for name, record in before.items()
            if name not in current or (name in lines and self._holds(record, lines[name], current[name]))
        }
        self._lines: dict[Key, dict[str, Any]] = {name: lines[name] for name in self.records if name in lines}
        taken = {line["place"] for line in self._lines.values()}
        for instance in instances:
            name = key(instance)
            if name not in self._lines:
                place = _free_place(instance, taken)
                taken.add(place)
                self._lines[name] = {
                    "instance": name[0], "domain": name[1], "fingerprint": current[name], "place": place,
                }  # fmt: skip
                if resume:  # outdated results of an earlier run
                    for file in saved_files(folder / place):
                        file.unlink(missing_ok=True)
        self._kept.begin(
            {name: _text(record) for name, record in self.records.items()},
            {name: self._lines[name] for name in self.records if name in self._lines},
            ((folder / line["place"]).parent for line in self._lines.values()),
        )

    def place(self, instance: Instance) -> Path:
        """Return the path of an instance's table and plan, without their file endings."""
        return self._folder / self._lines[key(instance)]["place"]

    def add(self, record: SolveRecord, *, lasting: bool = True) -> None:
        """Add a record, which replaces an earlier one of the instance.

        A later run keeps the record only if it is `lasting`, that is, if its table and plan have been saved, and if the
        instance's files have not been changed since this run began. Otherwise it is unknown which contents were solved.
        """
        if not lasting:
            self._kept.add_passing(_text(record))
            return
        line = self._lines[_key_of(record)]
        if fingerprint(Instance(record["instance"], record["domain"]), self._options) != line["fingerprint"]:
            line["fingerprint"] = None
        line |= {"files": self._sizes(line), "record": _digest(record)}
        self._kept.add(_key_of(record), _text(record), line)
        self.records[_key_of(record)] = record

    def finish(self, instances: Sequence[Instance]) -> None:
        """Sort the records in the order of the instances; records of other instances are last."""
        self._kept.finish([*map(key, instances), *self.records])

    def remove_unfinished(self) -> None:
        """Remove temporary files that stopped processes have left."""
        self._kept.remove_unfinished()

    def _holds(self, record: SolveRecord, line: dict[str, Any], current: str | None) -> bool:
        is_now = {"fingerprint": current, "files": self._sizes(line), "record": _digest(record)}
        return current is not None and all(line.get(name) == value for name, value in is_now.items())

    def _sizes(self, line: dict[str, Any]) -> dict[str, int]:
        files = saved_files(self._folder / line["place"])
        return {file.name: file.stat().st_size for file in files if file.is_file()}


def key(instance: Instance) -> Key:
    """Return the identifier of an instance."""
    return str(instance.problem), str(instance.domain)


def _key_of(record: Mapping[str, Any]) -> Key:
    return record["instance"], record["domain"]


def _is_line(line: Mapping[str, Any]) -> bool:
    """Whether a line of `FINGERPRINTS` says of which instance it is, and where its files are."""
    return all(isinstance(line.get(name), str) for name in ("instance", "domain", "place"))


def fingerprint(instance: Instance, options: SolveOptions) -> str | None:
    """Return a hash of all that the result of an instance depends on; None if its files cannot be read.

    Limits of time and memory are not included. They determine whether there is a result, but not the result.
    """
    try:
        files = fast_downward.digest(instance, options.most_values)
    except OSError:
        return None
    what = (files, _programs(), str(instance.domain), options.max_states, options.verify)
    return hashlib.sha256(repr(what).encode()).hexdigest()


@cache
def _programs() -> str:
    """Return a hash of the package's source files, so that a changed program recomputes its results."""
    found = hashlib.sha256()
    for file in sorted(Path(__file__).parents[1].rglob("*.py")):
        found.update(hashlib.sha256(file.read_bytes()).digest())
    return found.hexdigest()


def _text(record: SolveRecord) -> str:
    return json.dumps(record) + "\n"


def _digest(record: SolveRecord) -> str:
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()


def _records(file: Path) -> list[SolveRecord]:
    records = read_records(file)
    for number, record in enumerate(records, start=1):
        if not _is_record(record):
            raise InputFileError.of(file, number, "expected a record of `kitassist solve`; choose another folder")
    return records


def _is_record(record: Mapping[str, Any]) -> bool:
    """Whether a line has the form of a record of `solve`, so that it can be displayed."""
    error, plan = record.get("error", 0), record.get("plan", 0)
    return (
        all(isinstance(record.get(field), str) for field in ("instance", "domain", "status"))
        and all(record.get(field, "") is None or isinstance(record.get(field), int | float)
                for field in ("cost", "states", "transitions", "dead_ends", "max_cost_to_go", "verified"))
        and isinstance(record.get("seconds"), dict)
        and (error is None or (isinstance(error, dict) and {"file", "line", "message"} <= set(error)))
        and (plan is None or (isinstance(plan, list) and all(isinstance(action, str) for action in plan)))
    )  # fmt: skip


def _free_place(instance: Instance, taken: set[str]) -> str:
    """Return the path for an instance's files in the folder: its own path, numbered if that is taken."""
    parts = [part for part in instance.problem.parts if part not in (instance.problem.anchor, "..")]
    place = str(Path(*parts).with_suffix(""))
    numbers = iter(range(2, len(taken) + 3))
    free = place
    while free in taken:
        free = f"{place}-{next(numbers)}"
    return free
