"""Exact cost-to-go: what the cheapest way from a state to the goal costs.

`CostToGo` is what the rest of the project asks: the cost-to-go of some states, and their choices. There are
two kinds of it. A `Table` holds h* of every state of a `StateSpace` (`sweep` makes it); `OnDemand`, in the
module of that name, asks Fast Downward for one state at a time.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..grounding.task import Task
from ..states.state_space import StateSpace, state_numbers
from ..states.successors import Ints, Transitions
from ..system.errors import MismatchError

UNREACHED = np.iinfo(np.int64).max


class CostToGo(Protocol):
    """The exact cost-to-go of a task, however it is come by. States are named by numbers."""

    @property
    def task(self) -> Task:
        """The task."""

    @property
    def initial(self) -> int:
        """The number of the initial state."""

    @property
    def method(self) -> Literal["sweep", "on-demand"]:
        """How the answers are come by."""

    @property
    def searches(self) -> bool:
        """Whether looking a state up may take a search of its own, which takes its time."""

    def __len__(self) -> int:
        """Count the states that have numbers."""

    def lookup(self, states: ArrayLike) -> NDArray[np.float64]:
        """Give h* of states, shape (N,), infinite at dead ends."""

    def choices(self, states: ArrayLike) -> Transitions:
        """Give the choices of states, shape (N,), as compressed rows."""

    def is_goal(self, states: ArrayLike) -> NDArray[np.bool_]:
        """Tell of states, shape (N,), which are goal states."""

    def values(self, states: ArrayLike) -> Ints:
        """Give the values, shape (N, variables), of states of shape (N,)."""

    def numbers(self, values: ArrayLike) -> Ints:
        """Give the numbers, shape (N,), of states with values of shape (N, variables)."""

    def plan_lengths(self, states: ArrayLike) -> Ints:
        """Give how many actions the shortest of the cheapest plans from states has, shape (N,); `UNREACHED` if none."""

    def optimal_plan(self, state: int | None = None) -> list[str] | None:
        """Give an optimal plan from a state (the initial one unless given); None from a dead end."""


def optimal_choices(known: CostToGo, states: ArrayLike, rows: Transitions) -> NDArray[np.bool_]:
    """Tell of each choice of some states, shape (m,), whether a cheapest way to the goal begins with it.

    Where a task has actions of cost zero, only the cheapest ways with the fewest actions count. So optimal choices lead
    to no circles: each lowers the cost-to-go or, that being equal, the number of actions to come, and who follows them,
    whichever, reaches the goal.

    Parameters
    ----------
    known : CostToGo
    states : int array, shape (N,)
    rows : Transitions
        Their choices, as `known.choices` gives them.
    """
    costs, counts = np.asarray(known.task.costs), np.diff(rows.offsets)
    h = np.repeat(known.lookup(states), counts)
    cheapest = np.isfinite(h) & (costs[rows.actions] + known.lookup(rows.targets) == h)
    if 0 not in costs:
        return cheapest
    sources = np.repeat(np.asarray(states, dtype=np.int64), counts)
    both = np.concatenate([sources[cheapest], rows.targets[cheapest]])
    before, after = np.split(known.plan_lengths(both), 2)
    cheapest[cheapest] = after < before
    return cheapest


@dataclass(frozen=True)
class Table:
    """The exact cost-to-go of every state of a state space.

    Attributes
    ----------
    space : StateSpace
    distance : unsigned integer array, shape (n,)
        h* in the task's cost units, in the smallest type that holds it; the type's largest value marks
        a dead end.
    note : str or None
        Why it was made in a way that takes much longer than usual, if it was.
    """

    space: StateSpace
    distance: NDArray[np.unsignedinteger]
    note: str | None = None

    def __post_init__(self) -> None:
        self.distance.flags.writeable = False

    def __len__(self) -> int:
        return len(self.space)

    def __repr__(self) -> str:
        cost, dead = self[self.initial], int(self.dead_end.sum())
        first = "no way to the goal" if cost == math.inf else f"cost {cost:g}"
        return f"<Table of {self.task.name}: {len(self):,} states, {first} from the initial one, {dead:,} dead ends>"

    @property
    def method(self) -> Literal["sweep", "on-demand"]:
        """How it was come by."""
        return "sweep"

    @property
    def searches(self) -> bool:
        """Whether looking a state up may take a search of its own: no."""
        return False

    @property
    def task(self) -> Task:
        """The task."""
        return self.space.task

    @property
    def initial(self) -> int:
        """The number of the initial state."""
        return self.space.initial

    @property
    def dead_end(self) -> NDArray[np.bool_]:
        """Which states have no way to the goal, shape (n,)."""
        return self.distance == np.iinfo(self.distance.dtype).max

    @cached_property
    def h(self) -> NDArray[np.float64]:
        """h* of every state, shape (n,), infinite at dead ends."""
        return self.lookup(slice(None))

    def __getitem__(self, state: int) -> float:
        """h* of one state, infinite at a dead end."""
        return float(self.lookup([state])[0])

    def lookup(self, states: ArrayLike | slice) -> NDArray[np.float64]:
        """Give h* of states, shape (N,), infinite at dead ends.

        Raises
        ------
        IndexError
            One of them is not the number of a state.
        """
        distance = self.distance[states if isinstance(states, slice) else state_numbers(states, len(self))]
        return np.where(distance == np.iinfo(distance.dtype).max, np.inf, distance)

    def choices(self, states: ArrayLike) -> Transitions:
        """Give the choices of states, shape (N,), as compressed rows."""
        return self.space.choices(states)

    def is_goal(self, states: ArrayLike) -> NDArray[np.bool_]:
        """Tell of states, shape (N,), which are goal states."""
        values = self.values(states)
        variables, wanted = np.array(self.task.goal, dtype=np.int64).reshape(len(self.task.goal), 2).T
        return (values[:, variables] == wanted).all(axis=1)

    def values(self, states: ArrayLike) -> Ints:
        """Give the values, shape (N, variables), of states of shape (N,)."""
        return self.space.values(states)

    def numbers(self, values: ArrayLike) -> Ints:
        """Give the numbers, shape (N,), of states with values of shape (N, variables)."""
        return self.space.numbers(values)

    def plan_lengths(self, states: ArrayLike) -> Ints:
        """Give how many actions the shortest of the cheapest plans has, shape (N,); `UNREACHED` from dead ends.

        Only states on cheapest plans are looked at.
        """
        wanted = state_numbers(states, len(self))
        costs = np.asarray(self.task.costs)
        seen = np.zeros(len(self), dtype=bool)
        layer = np.unique(wanted[np.isfinite(self.lookup(wanted))])
        edges = [np.empty((2, 0), dtype=np.int64)]
        while len(layer):
            seen[layer] = True
            rows = self.space.transitions if len(layer) == len(self) else self.choices(layer)
            sources = np.repeat(layer, np.diff(rows.offsets))
            cheapest = costs[rows.actions] + self.lookup(rows.targets) == self.lookup(sources)
            edges.append(np.stack([rows.targets, sources])[:, cheapest])
            layer = np.unique(rows.targets[cheapest & ~seen[rows.targets]])
        place = np.cumsum(seen) - 1
        targets, sources = place[np.hstack(edges)]
        lengths = backward(targets, sources, np.ones_like(targets), self.is_goal(np.flatnonzero(seen)))
        result, known = np.full(len(wanted), UNREACHED), seen[wanted]
        result[known] = lengths[place[wanted[known]]]
        return result

    def optimal_choices(self) -> NDArray[np.bool_]:
        """Tell of each choice of all states, shape (m,), whether it is optimal, as the function of that name has it."""
        return optimal_choices(self, np.arange(len(self)), self.space.transitions)

    def optimal_plan(self, state: int | None = None) -> list[str] | None:
        """Read an optimal plan off the table; None from a dead end.

        Of the cheapest plans it is one with the fewest actions.
        """
        start = self.initial if state is None else state
        if not np.isfinite(self[start]):
            return None
        # Actions of cost zero can lead in circles, so this is a search breadth first, not a mere descent.
        costs = np.asarray(self.task.costs)
        descent = 0 not in costs
        seen = np.zeros(len(self), dtype=bool)
        layer = np.array([start])
        came: list[tuple[Ints, Ints, Ints]] = []  # of each layer: its states, where they were reached from, and how
        while not (ends := self.is_goal(layer)).any():
            seen[layer] = True
            rows = self.choices(layer)
            sources = np.repeat(layer, np.diff(rows.offsets))
            cheapest = costs[rows.actions] + self.lookup(rows.targets) == self.lookup(sources)
            cheapest &= ~seen[rows.targets]
            targets, first = np.unique(rows.targets[cheapest], return_index=True)
            if descent:  # any one way will do
                targets, first = targets[:1], first[:1]
            came.append((targets, sources[cheapest][first], rows.actions[cheapest][first]))
            if not len(targets):
                raise MismatchError(
                    f"no cheapest way leads on from state {layer[0]}, {self[int(layer[0])]:g} from the goal"
                )
            layer = targets
        at, plan = layer[ends.argmax()], []
        for targets, sources, actions in reversed(came):
            place = np.searchsorted(targets, at)
            plan.append(self.task.actions[actions[place]])
            at = sources[place]
        return plan[::-1]


def smallest_type(largest: int) -> type[np.unsignedinteger]:
    """Choose the type for distances; its own largest value is kept for dead ends."""
    types: tuple[type[np.unsignedinteger], ...] = (np.uint8, np.uint16, np.uint32, np.uint64)
    return next(t for t in types if largest < np.iinfo(t).max)


def compact(distance: Ints) -> NDArray[np.unsignedinteger]:
    """Give distances in the smallest type that holds them, its largest value for `UNREACHED`."""
    finite = distance != UNREACHED
    dtype = smallest_type(int(distance[finite].max(initial=0)))
    result = np.full(len(distance), np.iinfo(dtype).max, dtype=dtype)
    result[finite] = distance[finite]
    return result


def backward(
    targets: NDArray[np.signedinteger],
    sources: Ints,
    costs: Ints,
    goal: NDArray[np.bool_],
    *,
    check: Callable[[int], None] = lambda _states: None,
) -> Ints:
    """Compute the distance of every state to the goal states along given edges (Dijkstra 1959).

    All states of one distance are settled at once.

    Parameters
    ----------
    targets, sources, costs : int arrays, shape (m,)
        Edges from `sources` to `targets`; costs of 0 or more.
    goal : bool array, shape (n,)
    check : callable, optional
        Called with n before each distance; it may raise `LimitError`.

    Returns
    -------
    int64 array, shape (n,)
        `UNREACHED` where there is no way.
    """
    by_target = np.argsort(targets, kind="stable")
    into = np.concatenate([[0], np.cumsum(np.bincount(targets, minlength=len(goal)))])
    sources, costs = sources[by_target], costs[by_target]

    distance = np.full(len(goal), UNREACHED)
    distance[goal] = 0
    waiting = {0: [np.flatnonzero(goal)]}  # states by tentative distance
    while waiting:
        check(len(goal))
        d = min(waiting)
        frontier = np.unique(np.concatenate(waiting.pop(d)))
        frontier = frontier[distance[frontier] == d]  # the others are nearer, and have been settled
        counts = into[frontier + 1] - into[frontier]
        starts = into[frontier] - np.concatenate([[0], np.cumsum(counts)[:-1]])
        rows = np.repeat(starts, counts) + np.arange(counts.sum())
        reached, through = sources[rows], d + costs[rows]
        better = through < distance[reached]
        reached, through = reached[better], through[better]
        np.minimum.at(distance, reached, through)
        for value in np.unique(through):
            waiting.setdefault(int(value), []).append(reached[through == value])
    return distance
