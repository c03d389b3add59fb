"""The transition function of a task, on arrays of packed states.

States are bit-packed into 64-bit words, so that thousands of them are tested against an operator with one
comparison per word. `Successors` takes packed states to what each action leads to; it covers all that the
translator produces, conditional effects and derived variables included.

Derived variables are part of a packed state: they follow from the others by the axioms.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..grounding.task import Effect, Fact, Task
from ..system.arrays import outline
from .packing import Ints, Packing, Words, can_hold, holds


class Transitions(NamedTuple):
    """The choices of n states as compressed rows.

    Attributes
    ----------
    offsets : int64 array, shape (n + 1,)
        The choices of the i-th state are the rows `offsets[i]:offsets[i + 1]` of the next two.
    actions : int32 array, shape (m,)
        Ground actions, ascending within a state, none twice.
    targets : int32 or int64 array, shape (m,)
        The state that each leads to.
    """

    offsets: Ints
    actions: NDArray[np.int32]
    targets: NDArray[np.signedinteger]

    def __repr__(self) -> str:
        return outline(self)


class Successors:
    """The transition function of a task on arrays of packed states.

    Parameters
    ----------
    task : Task
    packing : Packing
        How its states are packed.
    """

    def __init__(self, task: Task, packing: Packing) -> None:
        self.packing = packing
        self.actions = np.array([operator.action for operator in task.operators], dtype=np.int32)
        self.conditions = [packing.condition(operator.preconditions) for operator in task.operators]
        self.effects = [self._effects(operator.effects) for operator in task.operators]
        derived = [v for v, variable in enumerate(task.variables) if variable.axiom_layer >= 0]
        self.defaults = packing.condition([(v, task.initial[v]) for v in derived])
        self.layers = [
            self._effects([axiom for axiom in task.axioms if task.variables[axiom.variable].axiom_layer == layer])
            for layer in sorted({task.variables[v].axiom_layer for v in derived})
        ]

    def _effects(self, effects: Sequence[Effect]) -> list[tuple[Words, Words, Words, Words]]:
        """Group effects by their conditions: condition mask and bits, then cleared and set bits."""
        groups: dict[tuple[Fact, ...], list[Fact]] = {}
        for effect in effects:
            if can_hold(effect.conditions):
                groups.setdefault(effect.conditions, []).append((effect.variable, effect.value))
        return [
            (*self.packing.condition(conditions), *self.packing.condition(facts))
            for conditions, facts in groups.items()
        ]

    def applicable(self, states: Words, operator: int) -> NDArray[np.int64]:
        """Give the rows of `states` in which an operator can be applied."""
        return np.flatnonzero(holds(states, *self.conditions[operator]))

    def apply(self, states: Words, operator: int) -> Words:
        """Give the states, shape (n, words), after an operator that is applicable in all of them."""
        after = states.copy()
        for mask, value, cleared, assigned in self.effects[operator]:
            rows = holds(states, mask, value)[:, None]
            after = np.where(rows, (after & ~cleared) | assigned, after)
        return self.derive(after)

    def derive(self, states: Words) -> Words:
        """Set the derived variables: layer by layer, each to its least fixed point."""
        if not self.layers:
            return states
        cleared, assigned = self.defaults
        states = (states & ~cleared) | assigned
        for layer in self.layers:
            changed = True
            while changed:
                before = states
                for mask, value, cleared, assigned in layer:
                    rows = holds(states, mask, value)[:, None]
                    states = np.where(rows, (states & ~cleared) | assigned, states)
                changed = bool((states != before).any())
        return states

    def edges(self, states: Words) -> tuple[Ints, NDArray[np.int32], Words]:
        """Apply every operator to states of shape (n, words).

        Returns
        -------
        rows : int64 array, shape (m,)
            The state from which each edge starts.
        actions : int32 array, shape (m,)
        after : uint64 array, shape (m, words)
            The edges stand in the order of the operators; operators that come from one ground action (a
            disjunctive precondition) give equal ones.
        """
        rows: list[Ints] = [np.empty(0, dtype=np.int64)]
        actions = [np.empty(0, dtype=np.int32)]
        after = [np.empty((0, self.packing.words), dtype=np.uint64)]
        for operator, action in enumerate(self.actions):
            applicable = self.applicable(states, operator)
            if len(applicable):
                rows.append(applicable)
                actions.append(np.full(len(applicable), action, dtype=np.int32))
                after.append(self.apply(states[applicable], operator))
        return np.concatenate(rows), np.concatenate(actions), np.concatenate(after)

    def choices(self, states: Words) -> tuple[Ints, NDArray[np.int32], Words]:
        """Give the choices of states of shape (n, words).

        `offsets` and `actions` are as in `Transitions`; the third array, shape (m, words), are the states
        that they lead to.
        """
        rows, actions, after = self.edges(states)
        kept = distinct(rows, actions)
        offsets = np.concatenate([[0], np.cumsum(np.bincount(rows[kept], minlength=len(states)))])
        return offsets.astype(np.int64), actions[kept], after[kept]

    def follow(self, states: Words, action: int) -> Words:
        """Give the states after a ground action that is applicable in all of them.

        Raises
        ------
        ValueError
            It is not.
        """
        after = states.copy()
        missing = np.ones(len(states), dtype=bool)
        for operator in np.flatnonzero(self.actions == action):
            rows = self.applicable(states, int(operator))
            after[rows] = self.apply(states[rows], int(operator))
            missing[rows] = False
        if missing.any():
            raise ValueError(f"action {action} is not applicable in {int(missing.sum())} of {len(states)} states")
        return after


def distinct(rows: Ints, actions: NDArray[np.int32]) -> Ints:
    """Order edges by row and action, and keep one of each."""
    order = np.lexsort((actions, rows))
    first = np.ones(len(order), dtype=bool)
    first[1:] = (np.diff(rows[order]) != 0) | (np.diff(actions[order]) != 0)
    return order[first]
