"""The header of a saved session: its tasks and settings, with which alone its events can be applied again."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from hashlib import sha256
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from planner import CostToGo
from planner.system.errors import InputFileError

from ..declare.declared import plain
from ..people.belief import Grid
from ..people.choice_model import chances
from ..people.choices import Choices
from ..people.decision import perceived_cost
from ..people.goals import Goals, first_of
from ..people.ranges import Population
from ..person.person_problem import WHOLE, is_whole
from .desk import Desk
from .live_task import digest
from .record import TeamRecord

OTHER_VERSION = "{file}: was recorded by kitassist {version}, and only that version reads it; expected another folder"


def header_of(desk: Desk, tasks: Mapping[str, CostToGo | Goals], distance: ArrayLike | None) -> dict[str, Any]:
    """Return the header of a session."""
    return {
        "format": TeamRecord.format,
        "version": metadata.version("kitassist"),
        "policy": desk.policy if isinstance(desk.policy, str) else getattr(desk.policy, "name", None),
        "setting": plain(desk.setting),
        "population": plain(desk.population),
        "distance": None if distance is None else np.asarray(distance, dtype=float).tolist(),
        "tasks": {name: digest(task) for name, task in tasks.items()},
        "files": files_of(tasks),
        "chances": None
        if desk.population.chooses is None
        else {name: _chances(task, desk.population) for name, task in tasks.items()},
    }


def files_of(tasks: Mapping[str, CostToGo | Goals]) -> dict[str, str | None]:
    """Return the problem file of each task; None for that of a policy."""
    known = {name: getattr(getattr(first_of(task), "task", None), "instance", None) for name, task in tasks.items()}
    return {name: None if instance is None else str(instance.problem) for name, instance in known.items()}


def _chances(task: CostToGo | Goals, population: Population) -> str:
    """Return a hash of the choice probabilities of a function, which identifies it better than its name."""
    if isinstance(task, Goals) or not is_whole(task):
        raise ValueError(f"people who choose by a function: expected a task of at most {WHOLE:,} states, all known")
    choices = Choices.of(task)
    q = perceived_cost(choices, choices.h)
    p = chances(population.typical, choices, q, Grid.regular(population).beta)
    return sha256(p.tobytes()).hexdigest()[:32]


def require_version(file: Path, found: Mapping[str, Any], format: str) -> None:
    """Check that a saved session is not one of another version.

    Parameters
    ----------
    file : Path
    found : mapping
        Its header.
    format : str
        The format identifier of this version.

    Raises
    ------
    InputFileError
        It is; the message states which version reads it.
    """
    known = str(found.get("format", ""))
    if known != format and _kind(known) == _kind(format):
        raise InputFileError(OTHER_VERSION.format(file=file, version=found.get("version", "1.0")))


def require_same(file: Path, found: Mapping[str, Any], expected: Mapping[str, Any]) -> None:
    """Check that the header of a saved session is the expected one.

    Raises
    ------
    InputFileError
        The file belongs to another session; the message states the difference.
    """
    if "format" in expected:
        require_version(file, found, expected["format"])
    files = expected.get("files", {})
    for name, value in expected.items():
        if name not in ("files", "version") and found.get(name) != value:
            if name == "tasks" and isinstance(found.get(name), dict):
                raise InputFileError(f"{file}: {_others(found, value, files)}")
            raise InputFileError(
                f"{file}: the session there has {_shown(name, found.get(name), value)}; "
                "expected the same, or another folder"
            )


def _kind(format: str) -> str:
    """Return a format identifier without its number."""
    return format.rpartition(" ")[0]


def _others(header: Mapping[str, Any], tasks: dict[str, str], files: dict[str, str | None]) -> str:
    """Return a message that names the session's tasks and the expected ones."""
    before, kept = header["tasks"], header.get("files") or {}
    wrong = [name for name in tasks if before.get(name) != tasks[name]] or list(tasks)
    same = [name for name in wrong if name in before and kept.get(name, files.get(name)) == files.get(name)]
    if same:
        return f"the task {same[0]} is another than when the session began; expected the same files, or another folder"

    def named(names: Iterable[str], where: Mapping[str, str | None]) -> str:
        return ", ".join(f"{name} ({where[name]})" if where.get(name) else name for name in names)

    return (
        f"the session there is of the task {named(before, kept)}, not {named(tasks, files)}; "
        "expected the same, or another folder"
    )


def _shown(name: str, found: Any, expected: Any) -> str:
    """Return a short description of the difference."""
    with suppress(AttributeError):
        for part, value in expected.items():
            if found.get(part) != value:
                return f"{name} {part} {str(found.get(part))[:60]}, not {str(value)[:60]}"
    return f"{name} {str(found)[:60]}, not {str(expected)[:60]}"
