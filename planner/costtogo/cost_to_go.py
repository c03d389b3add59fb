"""What provides the exact cost-to-go, the optimal choices that follow from it, and its states and plans.

States and plans say what they are, and are pictures in a notebook.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..grounding.task import Task
from ..search.state_space import Transitions
from ..system.arrays import Ints
from ..system.errors import MismatchError
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


class TransitionSystem(Protocol):
    """The states of a task, their transitions and the goal states. States are identified by numbers."""

    @property
    def task(self) -> Task:
        """The task."""

    @property
    def initial(self) -> int:
        """Number of the initial state."""

    def choices(self, states: ArrayLike) -> Transitions:
        """Return the transitions of states, shape (N,), as compressed rows."""

    def is_goal(self, states: ArrayLike) -> NDArray[np.bool_]:
        """Return whether each state is a goal state, shape (N,)."""


class CostToGo(TransitionSystem, Protocol):
    """Exact cost-to-go h* of a task, by any method."""

    @property
    def method(self) -> Literal["sweep", "on-demand"]:
        """Method that computes the cost-to-go."""

    @property
    def searches(self) -> bool:
        """Whether `lookup` may run a slow search."""

    def __len__(self) -> int:
        """Return the number of states that have been numbered."""

    def lookup(self, states: ArrayLike) -> NDArray[np.float64]:
        """Return h* of states in the file's unit of cost, shape (N,); infinite at dead ends."""

    def whole(self, states: ArrayLike) -> NDArray[np.float64]:
        """Return h* of states as whole numbers, multiples of the task's `unit`, shape (N,); infinite at dead ends."""

    def values(self, states: ArrayLike) -> Ints:
        """Return the values, shape (N, variables), of states, shape (N,)."""

    def numbers(self, values: ArrayLike) -> Ints:
        """Return the numbers, shape (N,), of states with the given values, shape (N, variables)."""

    def plan_lengths(self, states: ArrayLike) -> Ints:
        """Return the least number of actions of an optimal plan, shape (N,); `UNREACHED` at dead ends."""

    def optimal_plan(self, state: int | None = None) -> list[str] | None:
        """Return an optimal plan from a state (default: the initial state); None from a dead end."""


def optimal_choices(known: CostToGo, states: ArrayLike, rows: Transitions) -> NDArray[np.bool_]:
    """Return whether each transition of the given states, shape (m,), is optimal, that is, begins an optimal plan.

    If the task has actions of cost zero, only optimal plans with the fewest actions count. Claim: a policy that makes
    any optimal choice in each state reaches the goal from every state with finite h*. Proof: each optimal choice
    decreases h* or, if h* stays equal, the least number of actions of an optimal plan. Both are whole numbers of 0 or
    more, so the decrease ends, and it ends in a goal state.

    Parameters
    ----------
    known : CostToGo
    states : int array, shape (N,)
    rows : Transitions
        Their transitions, as `known.choices` returns them.
    """
    costs, counts = np.asarray(known.task.costs), np.diff(rows.offsets)
    h = np.repeat(known.whole(states), counts)
    cheapest = np.isfinite(h) & (costs[rows.actions] + known.whole(rows.targets) == h)
    if 0 not in costs:
        return cheapest
    sources = np.repeat(np.asarray(states, dtype=np.int64), counts)
    both = np.concatenate([sources[cheapest], rows.targets[cheapest]])
    before, after = np.split(known.plan_lengths(both), 2)
    cheapest[cheapest] = after < before
    return cheapest


def optimal_plan(known: CostToGo, start: int) -> Plan | None:
    """Return an optimal plan from a state, by looking up successors; None from a dead end.

    If actions of cost zero exist, the plan has the fewest actions among the optimal plans. If no successor of a state
    has the cost-to-go that its own implies, this raises a `MismatchError`.
    """
    if not np.isfinite(known.whole([start])[0]):
        return None
    # Actions of cost zero can form cycles. Greedy descent could then loop, so this is a breadth-first search.
    costs = np.asarray(known.task.costs)
    descent = 0 not in costs
    seen = np.zeros(len(known), dtype=bool)
    layer = np.array([start])
    came: list[tuple[Ints, Ints, Ints]] = []  # of each layer: its states, their predecessors and the actions
    while not (ends := known.is_goal(layer)).any():
        seen[layer] = True
        rows = known.choices(layer)
        seen = np.append(seen, np.zeros(len(known) - len(seen), dtype=bool))  # some may have been met only now
        sources = np.repeat(layer, np.diff(rows.offsets))
        cheapest = costs[rows.actions] + known.whole(rows.targets) == known.whole(sources)
        cheapest &= ~seen[rows.targets]
        targets, first = np.unique(rows.targets[cheapest], return_index=True)
        if descent:  # h* decreases with every action, so one successor suffices
            targets, first = targets[:1], first[:1]
        came.append((targets, sources[cheapest][first], rows.actions[cheapest][first]))
        if not len(targets):
            h = known.whole(layer[:1])[0]
            raise MismatchError(f"no cheapest way leads on from state {layer[0]}, {h:g} from the goal")
        layer = targets
    at, plan = layer[ends.argmax()], []
    for targets, sources, actions in reversed(came):
        place = np.searchsorted(targets, at)
        plan.append(known.task.actions[actions[place]])
        at = sources[place]
    return Plan(plan[::-1], known.task, known.values([start])[0].tolist())
