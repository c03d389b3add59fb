"""States and plans as objects that say what they are, and that are pictures in a notebook."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from ..grounding.task import Task
from ..system.results import Pictured


@dataclass(frozen=True, repr=False)
class State(Pictured):
    """A state of a task.

    Attributes
    ----------
    task : Task
    number : int
        Number in the table.
    values : tuple of int
        Value of each variable.
    h : float
        Exact cost-to-go h* in the file's unit; infinite at a dead end.
    """

    task: Task
    number: int
    values: tuple[int, ...]
    h: float

    @property
    def facts(self) -> list[str]:
        """The atoms that hold, among those that can change, sorted."""
        return self.task.facts(self.values)

    def __repr__(self) -> str:
        return f"<State {self.number} of {self.task.name}, h* {self.h:g}: {', '.join(self.facts)}>"


class Plan(list[str], Pictured):
    """A plan: a list of ground actions, with the state in which it begins.

    Parameters
    ----------
    actions : iterable of str
    task : Task
    start : sequence of int, shape (variables,)
        Values of the state; those of the initial state unless given.
    """

    def __init__(self, actions: Iterable[str], task: Task, start: Iterable[int] | None = None) -> None:
        super().__init__(actions)
        self.task = task
        self.start = task.initial if start is None else tuple(start)

    def __reduce__(self) -> tuple[Any, ...]:
        return Plan, (list(self), self.task, self.start)
