"""Tasks by hand, and a simple enumeration of states by the definition of actions, as a reference for the sweep."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner import Effect, Operator, Variable, instance
from planner.grounding.task import Fact, Task, derived, successors
from planner.search.state_space import UNREACHED, Part, StateSpace
from planner.system.arrays import Ints

Move = tuple[dict[int, int], dict[int, int]]
"""Values of variables that an action needs, and those that it then gives them."""


def task_of(sizes: Sequence[int], operators: Iterable[Move | Operator], **fields: Any) -> Task:
    """Return a task of variables with these numbers of values, in which each move is an action.

    Unless fields of the task are given, all variables are 0 first, actions cost 1, and the goal is empty.
    """
    found = [
        one
        if isinstance(one, Operator)
        else Operator(number, tuple(one[0].items()), tuple(Effect((), v, value) for v, value in one[1].items()))
        for number, one in enumerate(operators)
    ]
    count = len(fields.get("costs", ())) or 1 + max((one.action for one in found), default=-1)
    values: dict[str, Any] = {
        "instance": instance("made.pddl"),
        "variables": tuple(
            Variable(f"var{v}", tuple(f"Atom v{v}({a})" for a in range(size)), -1) for v, size in enumerate(sizes)
        ),
        "actions": tuple(f"(a{a:04})" for a in range(count)),
        "costs": (1,) * count,
        "operators": tuple(found),
        "axioms": (),
        "initial": (0,) * len(sizes),
        "goal": (),
    }
    return Task(**values | fields)


@dataclass(frozen=True)
class Listed:
    """States in the order of their discovery, breadth first.

    Attributes
    ----------
    number : dict
        Number of each state.
    after : list of dict
        State after each applicable action of each state.
    """

    number: dict[tuple[int, ...], int]
    after: list[dict[int, list[int]]]

    def numbers(self, values: Ints) -> Ints:
        """Return the numbers of the states with these values, shape (n, variables); -1 for values that are no state."""
        return np.array([self.number.get(tuple(row), -1) for row in values.tolist()], dtype=np.int64)

    def values(self, numbers: Ints) -> Ints:
        """Return the values of states, shape (n, variables)."""
        return np.array(list(self.number))[numbers]

    def where(self, facts: Sequence[Fact]) -> NDArray[np.bool_]:
        """Return whether facts hold in each state, shape (states,)."""
        return np.array([all(state[v] == value for v, value in facts) for state in self.number])

    def transitions(self, numbers: Ints | None = None) -> Iterator[Part]:
        """Yield the transitions of states, one state at a time."""
        for state in range(len(self.after)) if numbers is None else numbers:
            found = self.after[state]
            targets = [self.number[tuple(values)] for values in found.values()]
            yield np.array([len(found)], np.int32), np.array(list(found), np.int32), np.array(targets, np.int64)


def explore(task: Task) -> StateSpace:
    """Enumerate the reachable states of any task, breadth first."""
    waiting = [tuple(derived(task, task.initial))]
    number = {waiting[0]: 0}
    after = []
    for state in waiting:  # which grows meanwhile
        after.append(successors(task, state))
        for values in map(tuple, after[-1].values()):
            if values not in number:
                number[values] = len(waiting)
                waiting.append(values)
    return StateSpace(task, len(number), 0, sum(map(len, after)), Listed(number, after))


def distances(space: StateSpace) -> Ints:
    """Return the cost-to-go of every state (Dijkstra 1959); `UNREACHED` where there is none."""
    before: list[list[tuple[int, int]]] = [[] for _ in range(len(space))]
    for target, source, cost in zip(space.transitions.targets, space.sources, space.costs, strict=True):
        before[target].append((int(source), int(cost)))
    found = np.full(len(space), UNREACHED)
    waiting = [(0, int(state)) for state in np.flatnonzero(space.goal)]
    while waiting:
        distance, state = heapq.heappop(waiting)
        if found[state] == UNREACHED:
            found[state] = distance
            for source, cost in before[state]:
                heapq.heappush(waiting, (distance + cost, source))
    return found
