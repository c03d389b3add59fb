"""The record of an instance, and the options that it depends on.

Scripts depend on the fields of the records, which `docs/commands.md` lists.
"""

from __future__ import annotations

import platform
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..grounding import fast_downward
from ..pddl.compilation import MOST_VALUES
from ..pddl.instances import Instance
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
