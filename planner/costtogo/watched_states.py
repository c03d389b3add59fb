"""The reachable states of a trial with numbers, enumerated until a number is beyond the values that are tried."""

from __future__ import annotations

import re
from fractions import Fraction

import numpy as np

from ..grounding.task import Task
from ..pddl.numeric_expressions import Number, whole
from ..pddl.value_sets import Fluent
from ..search.packing import Packing, holds
from ..search.state_registry import RegistrySpace
from ..search.successor_generator import Expanded
from ..system.limits import Budget, LimitError


class BeyondError(LimitError):
    """A reachable state has a number beyond its values."""


class WatchedStates(RegistrySpace):
    """The states of a trial, whose enumeration ends once one has a number beyond its values."""

    def __init__(self, task: Task, most_states: int) -> None:
        self.task, self.budget = task, Budget.within(most_states)
        super().__init__(task, self.budget)
        packing = Packing.of(task)
        self._beyond = [packing.condition([fact]) for fact in task.beyond]

    def numbers(self) -> dict[Fluent, set[Number]]:
        """Return the numbers that each fluent has in the states."""
        found: dict[Fluent, set[Number]] = {}
        values = self.index.values(np.arange(len(self)))
        for variable, column in zip(self.task.variables, values.T, strict=True):
            for value in np.unique(column):
                match = re.fullmatch(r"Atom ([^()]+)\((.*)\) = (-?\d[\d./]*)", variable.facts[value])
                if match is not None:
                    fluent = (match[1], *(match[2].split(", ") if match[2] else ()))
                    found.setdefault(fluent, set()).add(whole(Fraction(match[3])))
        return found

    def expand(self, block: range) -> list[Expanded]:
        """Return the successors of a block's states."""
        parts = super().expand(block)
        for _, _, after in parts:
            if any(np.any(holds(after, *condition)) for condition in self._beyond):
                raise BeyondError("a number is beyond its values")
        return parts
