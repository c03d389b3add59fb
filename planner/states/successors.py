"""The transition function of a task on arrays of packed states.

States are packed into 64-bit words, so that an operator is tested in thousands of states with one comparison per word.
`Successors` covers everything that the translator produces, conditional effects and derived variables included.

A packed state contains the derived variables. The axioms determine them from the other variables.
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
    """The transitions of n states as compressed rows.

    Attributes
    ----------
    offsets : int64 array, shape (n + 1,)
        The transitions of the i-th state are the rows `offsets[i]:offsets[i + 1]` of the other two arrays.
    actions : int32 array, shape (m,)
        Ground actions, strictly ascending within a state.
    targets : int32 or int64 array, shape (m,)
        Successor state of each transition.
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
        Layout of the packed states.
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
        """Return the rows of `states` in which an operator is applicable."""
        return np.flatnonzero(holds(states, *self.conditions[operator]))

    def apply(self, states: Words, operator: int) -> Words:
        """Return the successors, shape (n, words), by an operator that is applicable in all the states."""
        after = states.copy()
        for mask, value, cleared, assigned in self.effects[operator]:
            rows = holds(states, mask, value)[:, None]
            after = np.where(rows, (after & ~cleared) | assigned, after)
        return self.derive(after)

    def derive(self, states: Words) -> Words:
        """Return the states with their derived variables, evaluated layer by layer to the least fixed point."""
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
        """Apply every operator to states, shape (n, words).

        Returns
        -------
        rows : int64 array, shape (m,)
            Row of the state where each edge starts.
        actions : int32 array, shape (m,)
        after : uint64 array, shape (m, words)
            Successor states. Edges are in the order of the operators. Operators of one ground action (a disjunctive
            precondition) may yield duplicates.
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
        """Return the transitions of states, shape (n, words).

        `offsets` and `actions` are as in `Transitions`. The third array, shape (m, words), holds the packed successors.
        """
        rows, actions, after = self.edges(states)
        kept = distinct(rows, actions)
        offsets = np.concatenate([[0], np.cumsum(np.bincount(rows[kept], minlength=len(states)))])
        return offsets.astype(np.int64), actions[kept], after[kept]

    def follow(self, states: Words, action: int) -> Words:
        """Return the successors by a ground action that is applicable in all the states.

        Raises
        ------
        ValueError
            The action is not applicable in one of them.
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
    """Return the indices of the distinct edges, sorted by row and action."""
    order = np.lexsort((actions, rows))
    first = np.ones(len(order), dtype=bool)
    first[1:] = (np.diff(rows[order]) != 0) | (np.diff(actions[order]) != 0)
    return order[first]
