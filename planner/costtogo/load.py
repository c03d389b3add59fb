"""Loading an instance: it is read, checked, and grounded by Fast Downward."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from ..grounding import fast_downward
from ..grounding.task import Task
from ..grounding.translation import from_sas
from ..pddl import built_problems, instances
from ..pddl.compilation import MOST_VALUES
from ..pddl.reader import read
from ..system.files import atomic
from ..system.limits import NO_LIMITS, Limits, require_limits
from .number_values import grounded

if TYPE_CHECKING:
    from unified_planning.model import Problem


class HasTask(Protocol):
    """A cost-to-go, for instance."""

    @property
    def task(self) -> Task:
        """The task."""


AnyTask: TypeAlias = "str | Path | instances.Instance | Task | HasTask | Problem"
"""All types that stand for a task: a name, a file, an instance, a task, a cost-to-go, or a built problem."""


def task_of(problem: AnyTask) -> Task:
    """Return the task of a problem in any form: all that `load` takes, or a cost-to-go.

    Parameters
    ----------
    problem : str, Path, Instance, Task, cost-to-go, or Problem of unified-planning

    Raises
    ------
    TypeError
        It is no problem.
    """
    found: Any = getattr(problem, "task", problem)
    return load(found)


def load(
    problem: str | Path | instances.Instance | Task | Problem,
    domain: str | Path | None = None,
    *,
    limits: Limits = NO_LIMITS,
    cache: str | Path | None = None,
    most_values: int = MOST_VALUES,
) -> Task:
    """Read, check and ground a PDDL instance.

    Parameters
    ----------
    problem : path, Instance, Task, or Problem of unified-planning
        Problem file, name of a bundled task (`kitting/paper`), or a problem that was built in Python. The task keeps
        the names of the latter. A `Task` is returned as it is.
    domain : path, optional
        Domain file; by default `instances.instance` searches for it.
    limits : Limits
        Time and memory of the grounding.
    cache : path, optional
        Folder in which results are cached by the contents of the files. Files that were grounded before are neither
        checked nor grounded again.
    most_values : int
        Largest number of values of one number, such as a stock or a battery.

    Raises
    ------
    PDDLError
        The files are not valid, with file and line.
    LimitError
        Grounding ran out of time or memory.
    TypeError
        It is no problem.
    """
    require_limits(limits)
    if isinstance(problem, Task):
        return problem
    if isinstance(problem, str | Path):
        problem = instances.instance(problem, domain)
        if not problem.problem.exists():
            raise instances.PDDLError(
                problem.problem, None, instances.not_there(problem.problem, "no such problem file")
            )
    if not isinstance(problem, instances.Instance):
        if not any(kind.__module__.startswith("unified_planning.") for kind in type(problem).__mro__):
            wanted = (
                "its name, such as 'kitting/tiny', its file, a Task, its cost-to-go, or a Problem of unified-planning"
            )
            raise TypeError(f"a {type(problem).__name__} where a task was expected: {wanted}")
        return _load_built(problem, limits, most_values)
    instance, stored = problem, None
    if cache is not None and instance.domain.is_file() and instance.problem.is_file():
        stored = Path(cache) / f"{fast_downward.digest(instance, most_values)}.sas"
        if (kept := _kept(stored)) is not None:
            note, unit, sas = kept
            return replace(from_sas(sas, instance, note), unit=unit)
    task = grounded(read(instance), limits, most_values)[1]
    # The files may have been changed since their digest was made.
    if stored is not None and stored.stem == fast_downward.digest(instance, most_values):
        content = f"{task.note or ''}\n{task.unit}\n{task.sas}"
        with atomic(stored) as path:
            path.write_text(f"{_digest(content)}\n{content}", encoding="utf-8")
    return task


def _kept(file: Path) -> tuple[str | None, Fraction, str] | None:
    """Return the note, the unit and the SAS text of a cache file; None if there is none, or it is damaged."""
    try:
        digest, _, content = file.read_text(encoding="utf-8").partition("\n")
    except (FileNotFoundError, UnicodeDecodeError):
        return None
    if digest != _digest(content):
        return None
    note, unit, sas = content.split("\n", 2)
    return note or None, Fraction(unit), sas


def _digest(content: str) -> str:
    return hashlib.sha256(content.encode()).hexdigest()


def _load_built(problem: Problem, limits: Limits, most_values: int) -> Task:
    with built_problems.written(problem) as files:
        task = grounded(read(files.instance), limits, most_values)[1]
    named = built_problems.named(problem)
    return replace(from_sas(built_problems.restore_names(task.sas, files.own_names), named, task.note), unit=task.unit)
