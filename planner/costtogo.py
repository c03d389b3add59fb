"""Exact cost-to-go: what the cheapest way from a state to the goal costs.

`CostToGo` is what the rest of the project asks: the cost-to-go of some states, and their choices. There are
two kinds of it. A `Table` holds h* of every state of a `StateSpace` (`sweep` makes it); `OnDemand`, in the
module of that name, asks Fast Downward for one state at a time. `verify` compares a table with Fast Downward.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import replay
from .astar import astar
from .errors import MismatchError
from .fast_downward import NO_LIMITS, LimitError, Limits
from .statespace import StateSpace, state_numbers
from .successors import Ints, Transitions
from .task import Task

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


def verify(
    table: Table,
    count: int,
    rng: np.random.Generator,
    *,
    seconds: float | None = None,
    limits: Limits = NO_LIMITS,
    jobs: int = 1,
    searches: Sequence[str | None] = (None,),
    progress: Callable[[int], None] | None = None,
) -> int:
    """Compare a random sample of a table with Fast Downward's A*, the initial state first.

    Parameters
    ----------
    table : Table
    count : int
        States to compare (all, where there are fewer).
    rng : numpy.random.Generator
    seconds : float, optional
        Stop after this time, or a second later: each search is limited to what is left of it.
    limits : Limits
        Of each single search; where one reaches them, no further state is compared.
    jobs : int
        States at a time.
    searches : sequence of str or None
        Configurations as `astar` takes them; all search from a state at the same time, and the first answer counts.
    progress : callable, optional
        Called with how many states have been compared.

    Returns
    -------
    int
        How many states were compared, all of them equal.

    Raises
    ------
    MismatchError
        A state whose values differ.
    """
    space, states = table.space, _sample(table.space, count, rng)
    start, over = time.monotonic(), threading.Event()

    def asked(state: int) -> float | None:
        left = None if seconds is None else seconds - (time.monotonic() - start)
        if over.is_set() or (left is not None and left < 0 and state != space.initial):
            return None
        own = limits
        if left is not None and (limits.seconds is None or left < limits.seconds):
            own = replace(limits, seconds=max(1.0, left))  # a search that has begun may take a second
        try:
            return _first(space.task, space.values([state])[0].tolist(), searches, own)
        except LimitError:
            return None

    with ThreadPoolExecutor(jobs) as pool:
        # One at a time without a thread: where no memory is left for its beginning, Python waits for it for ever.
        each = pool.map if jobs > 1 else map
        try:
            for done, expected in enumerate(each(asked, states)):
                if expected is None:
                    return done
                if expected != table[states[done]]:
                    raise _mismatch(table, states[done], "Fast Downward's A* says", expected)
                if progress is not None:
                    progress(done + 1)
        finally:
            over.set()
    return len(states)


def _first(task: Task, state: Sequence[int], searches: Sequence[str | None], limits: Limits) -> float:
    """Give what the first of several searches says of a state."""
    if len(searches) == 1:
        return astar(task, state, search=searches[0], limits=limits)[0]
    done = threading.Event()
    with ThreadPoolExecutor(len(searches)) as pool:
        try:
            own = replace(limits, stop=done)
            for each in as_completed([pool.submit(astar, task, state, search=one, limits=own) for one in searches]):
                with suppress(LimitError):
                    return each.result()[0]
        finally:
            done.set()
    raise LimitError("no search was done in time")


def check_successors(table: Table, count: int, rng: np.random.Generator, *, seconds: float | None = None) -> int:
    """Compare a random sample of a table with the values of what comes after, the initial state first.

    In a goal state the cost-to-go is 0, in any other the least sum of an action's cost and the cost-to-go after it.
    What comes after is computed from the operators of the grounded task, not by what made the table. Of states that
    are too far from the goal for A* this can be told as well.

    Parameters
    ----------
    table : Table
    count : int
        States to compare (all, where there are fewer); those that `verify` takes with the same generator.
    rng : numpy.random.Generator
    seconds : float, optional
        No further state is compared after this time.

    Returns
    -------
    int
        How many states were compared, all of them equal.

    Raises
    ------
    MismatchError
        A state whose values differ, or that leads to something that is no state of the table.
    """
    space, task, states = table.space, table.task, _sample(table.space, count, rng)
    start = time.monotonic()
    for done, state in enumerate(states):
        if seconds is not None and done and time.monotonic() - start > seconds:
            return done
        values = space.values([state])[0].tolist()
        if all(values[variable] == value for variable, value in task.goal):
            expected = 0.0
        else:
            after = replay.successors(task, values)
            targets = np.array([target for _, target in after], dtype=np.int64).reshape(len(after), len(values))
            try:
                least = np.array([cost for cost, _ in after]) + table.lookup(space.numbers(targets))
            except KeyError as error:
                raise MismatchError(f"state {state} leads to {error}, which is no state of the table") from error
            expected = float(least.min(initial=np.inf))
        if table[state] != expected:
            raise _mismatch(table, state, "its successors say", expected)
    return len(states)


def _sample(space: StateSpace, count: int, rng: np.random.Generator) -> list[int]:
    """Draw states to compare, the initial one first."""
    return [space.initial, *random_states(space, max(0, count - 1), rng)]


def _mismatch(table: Table, state: int, who_says: str, expected: float) -> MismatchError:
    return MismatchError(
        f"cost-to-go of state {state} is {table[state]:g}, but {who_says} {expected:g} "
        f"({', '.join(table.space.facts(state))})"
    )


def random_states(space: StateSpace, count: int, rng: np.random.Generator) -> list[int]:
    """Draw states other than the initial one without replacement; all of them where there are fewer."""
    if count >= len(space) - 1:
        return [state for state in range(len(space)) if state != space.initial]
    drawn: dict[int, None] = {}
    while len(drawn) < count:  # a permutation of all states would take more memory than the table
        drawn.update((int(s), None) for s in rng.integers(len(space), size=count) if s != space.initial)
    return list(drawn)[:count]
