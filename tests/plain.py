"""A simple enumeration of a task's states in numpy, as a reference for the sweep."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planner.grounding.task import Fact, Task
from planner.states.packing import Ints, Packing, Words, holds
from planner.states.state_space import StateSpace
from planner.states.successors import Successors, Transitions, distinct


def sort_keys(states: Words) -> NDArray[np.generic]:
    """Return one sortable key, shape (n,), for each packed state, shape (n, words)."""
    if states.shape[1] == 1:
        return states[:, 0]
    return np.ascontiguousarray(states.astype(">u8")).view(f"S{8 * states.shape[1]}")[:, 0]


@dataclass(frozen=True)
class Listed:
    """States numbered breadth first, layers in the order of their keys.

    Attributes
    ----------
    packing : Packing
    states : uint64 array, shape (n, words)
    rows : Transitions
    """

    packing: Packing
    states: Words
    rows: Transitions

    @cached_property
    def _sorted(self) -> tuple[NDArray[np.generic], Ints]:
        keys = sort_keys(self.states)
        order = np.argsort(keys, kind="stable")
        return keys[order], order

    def numbers(self, values: Ints) -> Ints:
        """Return the numbers of the states with these values, shape (n, variables); -1 for values that are no state."""
        sizes = np.left_shift(1, self.packing.bits)
        legal = np.all((values >= 0) & (values < sizes), axis=1)
        wanted = sort_keys(self.packing.pack(np.where(legal[:, None], values, 0)))
        keys, order = self._sorted
        at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        return np.where(legal & (keys[at] == wanted), order[at], -1)

    def values(self, numbers: Ints) -> Ints:
        """Return the values of states, shape (n, variables)."""
        return self.packing.unpack(self.states[numbers])

    def where(self, facts: Sequence[Fact]) -> NDArray[np.bool_]:
        """Return whether facts hold in each state, shape (states,)."""
        return holds(self.states, *self.packing.condition(facts))

    def transitions(self, states: int, transitions: int) -> Transitions:
        """Return the transitions of all states."""
        assert (len(self.states), len(self.rows.actions)) == (states, transitions)
        return self.rows


def explore(task: Task) -> StateSpace:
    """Enumerate the reachable states of any task, breadth first, with all transitions in memory."""
    packing = Packing.of(task)
    successors = Successors(task, packing)
    layer = successors.derive(packing.pack([task.initial]))
    layers = [layer]
    seen = sort_keys(layer)  # sorted
    edges: list[tuple[Ints, NDArray[np.int32], Words]] = []
    first = 0  # the number of a layer's first state
    while len(layer):
        rows, actions, after = successors.edges(layer)
        edges.append((rows + first, actions, after))
        first += len(layer)
        keys, places = np.unique(sort_keys(after), return_index=True)
        at = np.minimum(np.searchsorted(seen, keys), len(seen) - 1)
        new = seen[at] != keys
        layer = after[places[new]]
        seen = np.sort(np.concatenate([seen, keys[new]]))
        layers.append(layer)

    states = np.concatenate(layers)
    keys = sort_keys(states)
    order = np.argsort(keys, kind="stable")
    sources, actions, after = (np.concatenate([edge[part] for edge in edges]) for part in range(3))
    kept = distinct(sources, actions)
    targets = order[np.searchsorted(keys[order], sort_keys(after[kept]))]
    offsets = np.concatenate([[0], np.cumsum(np.bincount(sources[kept], minlength=len(states)))]).astype(np.int64)
    numbering = Listed(packing, states, Transitions(offsets, actions[kept], targets))
    return StateSpace(task, len(states), 0, len(kept), numbering)
