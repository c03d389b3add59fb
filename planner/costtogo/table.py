"""Exact cost-to-go: what the cheapest way from a state to the goal costs.

`CostToGo` is what the rest of the project asks: the cost-to-go of some states, and their choices. There are
two kinds of it. A `Table` holds h* of every state of a `StateSpace` (`sweep` makes it); `OnDemand`, in the
module of that name, asks Fast Downward for one state at a time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..grounding.task import Task
from ..search.distances import UNREACHED, backward
from ..states.packing import Ints
from ..states.state_space import StateSpace, state_numbers
from ..states.successors import Transitions
from ..system.errors import MismatchError
from .cost_to_go import optimal_choices


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
