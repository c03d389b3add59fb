"""The cost-to-go of one state by Fast Downward's A*, within the range of its 32-bit cost sums, and checks of tables.

A table is compared with A* (`verify`), with its own successors, and along a plan.
`Early` runs A* in the background while all states are being enumerated. A task whose numbers may leave the values that
they were given is searched as one in which leaving is a second way to the goal (`with_leaving`).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from math import inf, isfinite
from types import TracebackType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..grounding import fast_downward
from ..grounding.fast_downward import FastDownwardError
from ..grounding.task import Effect, Operator, Task, Variable, plan_cost, replay, steps_along, successors
from ..search.state_space import can_hold
from ..system.errors import MismatchError
from ..system.limits import NO_LIMITS, CostLimitError, LimitError, Limits, MemoryLimitError, available_memory, used_mb
from ..system.processes import on_threads
from .cost_to_go import CostToGo, Plan
from .load import task_of

if TYPE_CHECKING:
    from .load import AnyTask
    from .table import Table

OVERFLOW = 1 << 31
"""Fast Downward's cost sums must stay below this (signed 32-bit integers)."""

LARGE = OVERFLOW // 1000
"""Cost from which no heuristic is trusted: the sums inside heuristics are unknown, and a thousand such costs overflow.
"""


def search_of(task: Task) -> str:
    """Return the configuration of Fast Downward that finds the plans of a task: the first that supports it."""
    large = max(task.reduced.costs, default=1) >= LARGE
    return fast_downward.ASTAR_WITH_AXIOMS if task.axioms or large else fast_downward.ASTAR


def astar(
    task: AnyTask, state: Sequence[int] | None = None, *, search: str | None = None, limits: Limits = NO_LIMITS
) -> tuple[float, Plan | None]:
    """Return h* of one state and an optimal plan from it, computed by Fast Downward's A*.

    Parameters
    ----------
    task : Task, or whatever `load` takes
    state : sequence of int, shape (variables,), optional
        A reachable state; the initial state by default.
    search : str, optional
        An optimal search configuration of Fast Downward; by default that of `search_of`.
    limits : Limits
        Limits of the search.

    Returns
    -------
    h : float
        h* of the state in the file's unit of cost; infinite if Fast Downward proves that there is no plan.
    plan : list of str or None
        Ground actions of an optimal plan.

    Raises
    ------
    LimitError
        Out of time or memory, or costs are too large for Fast Downward, or a cheapest plan may need a value of a number
        that was not tried (`Task.beyond`). Nothing is known about the state.

    Notes
    -----
    Fast Downward adds costs in 32 bits. Costs are first divided by their greatest common divisor. Let c be the largest
    cost then. If c is at least `LARGE`, the search is blind, whatever `search` says.

    Claim: a plan of cost P that the blind search finds is optimal if P + 2 c < `OVERFLOW`.

    Proof: let C be the optimal cost, so that C <= P. A* expands only states whose distance g from the start is at
    most C. Their successors have g <= C + c, and the blind heuristic adds at most c. Hence no sum exceeds
    C + 2 c <= P + 2 c, no sum overflows, and A* is exact. Any other plan is refused with a `CostLimitError`.
    """
    task = task_of(task)
    if not task.goal:  # Fast Downward requires a goal that mentions each variable at most once
        return 0.0, Plan([], task, state)
    if not can_hold(task.goal):
        return float("inf"), None
    dearest = max(task.reduced.costs, default=1)
    own_limit = dearest >= LARGE and limits.seconds is None
    if search is None or dearest >= LARGE:
        search = search_of(task)
    if own_limit:  # some searches with costs above 2^29 were observed not to terminate
        limits = replace(limits, seconds=60.0)
    if dearest >= OVERFLOW:
        raise CostLimitError(f"{task.instance}: a cost of {dearest} is more than Fast Downward can read")
    if state is not None:  # Fast Downward expects the default values of derived variables
        state = tuple(
            value if variable.axiom_layer < 0 else default
            for value, default, variable in zip(state, task.initial, task.variables, strict=True)
        )
    searched, start = task.reduced, state
    if task.beyond:
        if state is not None and any(state[variable] == value for variable, value in task.beyond):
            raise LimitError(out_of_range(task))
        searched, start = with_leaving(task.reduced), None if state is None else (*state, 0)
    try:
        plan = fast_downward.optimal_plan(searched.sas, start, search=search, limits=limits)
    except LimitError as error:
        if own_limit and not isinstance(error, MemoryLimitError):
            raise CostLimitError(f"{error}, at costs of up to {dearest}") from None
        raise
    if task.beyond:
        plan = without_leaving(task, plan)
    if plan is None:
        return float("inf"), None
    cost = plan_cost(task, plan, state)
    if plan_cost(task.reduced, plan, state) + 2 * dearest >= OVERFLOW:
        raise CostLimitError(f"{task.instance}: Fast Downward's sums of costs may overflow, its plan costs {cost}")
    return float(task.in_unit(cost)), Plan(plan, task, state)


UNIT = 1000
"""Factor of a cost in the combined costs, where each action adds 1. Plans with this many actions are not labelled."""


def priced(task: Task) -> tuple[Task, int]:
    """Return the task with the costs that Fast Downward is given, and the factor of a unit of cost in them.

    If some actions cost nothing, each action costs `UNIT` times its cost plus one. An optimal plan of that task is then
    an optimal plan with the fewest actions, unless a cheaper plan has at least `UNIT` actions more.
    """
    return (task, 1) if min(task.costs, default=1) > 0 else (counted(task), UNIT)


def counted(task: Task) -> Task:
    """Return the task with combined costs: `UNIT` times the cost of each action, plus one."""
    return replace(task, costs=tuple(cost * UNIT + 1 for cost in task.costs))


ADMISSIBLE = (
    fast_downward.ASTAR,
    "astar(landmark_cost_partitioning(lm_hm(m=2)))",
    "astar(lmcut())",
    "astar(hmax())",
)
"""Search configurations of which the fastest is chosen."""


class Chosen(NamedTuple):
    """A search configuration, whether it solved the initial state, and the plan (None at a dead end).

    It has not solved the state if no comparison was needed, or if the sums of costs of its plan may overflow.
    """

    search: str
    solved: bool
    plan: list[str] | None


def fastest_search(task: Task, *, limits: Limits = NO_LIMITS) -> Chosen:
    """Return the search configuration of `ADMISSIBLE` that solves a task's initial state fastest.

    Each configuration gets the time that the best one so far took. Once one took at most 0.05 seconds, no other is
    tried, since most of that time is Fast Downward's start. Tasks with derived variables or large costs use blind
    search without a comparison. If no configuration solves the initial state, this raises a `LimitError`.
    """
    if not task.goal or not can_hold(task.goal):
        return Chosen(fast_downward.ASTAR, True, None if task.goal else [])
    if task.axioms or max(task.reduced.costs, default=1) >= LARGE:
        return Chosen(fast_downward.ASTAR_WITH_AXIOMS, False, None)
    best, shortest = None, limits.seconds
    for search in ADMISSIBLE:
        start = time.monotonic()
        try:
            plan = astar(task, search=search, limits=replace(limits, seconds=shortest))[1]
        except CostLimitError:
            return Chosen(search, False, None)
        except (LimitError, FastDownwardError):
            continue
        seconds = time.monotonic() - start
        if shortest is None or seconds < shortest:
            best, shortest = Chosen(search, True, plan), seconds
            if seconds <= 0.05:
                break
    if best is None:
        raise LimitError("no search configuration solved the initial state within the limits")
    return best


Answer = tuple[float, list[str] | None]
"""Cost of an optimal plan, and the plan; infinite and None if there is none."""


class Early:
    """A context manager that searches from the initial state in the background until the context is left.

    Fast Downward's A* runs in a subprocess, and a thread waits for it. Its plan is the one that is shown and saved, so
    that a task has the same plan each time, whichever of the two is done first. A part of the memory is reserved for
    the search until it ends.

    `limits.memory_mb` is that of the whole process and the search together. The `answer` is None while it is unknown.
    Then `tell` is called with it, in a thread, but not before `delay` seconds have passed: most tasks are done by then.
    """

    def __init__(self, task: Task, limits: Limits, tell: Callable[[Answer], None], *, delay: float = 0.5) -> None:
        self._task, self._limits, self._tell, self._delay = task, limits, tell, delay
        self._begun = time.monotonic()
        left = available_memory() / 1e6
        if limits.memory_mb is not None:
            left = min(left, limits.memory_mb - (used_mb() or 0.0))
        self._memory_mb = max(1.0, 0.25 * left)  # the rest is left to the sweep
        self._stop, self._ended = threading.Event(), threading.Event()
        self._thread: threading.Thread | None = None
        self._fault: Exception | None = None
        self.answer: Answer | None = None

    def __enter__(self) -> Early:
        if self._task.decided_by_translator:
            self._ended.set()  # `wait` then solves the task at once
        else:
            thread = threading.Thread(target=self._run, daemon=True)
            try:
                thread.start()
                self._thread = thread
            except RuntimeError:  # no memory for a thread
                self._ended.set()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.end()

    def end(self) -> None:
        """Stop the search; an answer that was found is kept."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()

    def reserved_bytes(self) -> float:
        """Return the number of bytes that are reserved for the search now."""
        return 0.0 if self._ended.is_set() else self._memory_mb * 1e6

    def ended_within(self, seconds: float) -> bool:
        """Wait until the search has run for so many seconds; return whether it has ended by then."""
        return self._ended.wait(max(0.0, self._begun + seconds - time.monotonic()))

    def within(self, seconds: float, limits: Limits) -> str | None:
        """Wait for the answer until the search has run for so many seconds, or as `limits` say; then stop it.

        Return the reason why there is no `answer`, or None if there is one. A search that failed for lack of memory is
        repeated, since the other work is done.
        """
        allowed = seconds if limits.seconds is None else min(seconds, time.monotonic() - self._begun + limits.seconds)
        left = self._begun + allowed - time.monotonic()
        in_time = self._ended.wait(min(max(0.0, left), threading.TIMEOUT_MAX))
        self.end()
        if self.answer is not None:
            return None
        if not in_time:
            return f"A* did not answer within {allowed:.0f} s"
        try:
            most = min(seconds, inf if limits.seconds is None else limits.seconds)
            self.answer = self.wait(replace(limits, seconds=most if isfinite(most) else None))
        except (LimitError, FastDownwardError, MismatchError, OSError) as error:
            return str(error)
        return None

    def wait(self, limits: Limits) -> Answer:
        """Wait for the answer, which may be that the search failed: its error is raised.

        If it failed for lack of memory, or could not run, the search is repeated under `limits`.
        """
        self._ended.wait()
        if self.answer is not None:
            return self.answer
        if self._fault is None or isinstance(self._fault, MemoryLimitError):
            return astar(self._task, limits=limits)
        raise self._fault

    def _run(self) -> None:
        try:
            answer = astar(self._task, limits=Limits(self._limits.seconds, self._memory_mb, self._stop))
            if answer[1] is not None:
                replay(self._task, answer[1])
            self.answer = answer
        except (LimitError, FastDownwardError, MismatchError) as error:
            self._fault = error
        except (OSError, MemoryError, RuntimeError):
            pass  # `wait` repeats the search when the other work is done
        finally:
            self._ended.set()
        if self.answer is not None and not self._stop.wait(self._begun + self._delay - time.monotonic()):
            with suppress(OSError):  # the receiver's disk or pipe may be full
                self._tell(self.answer)


REACH, LEAVE = "(reach-the-goal)", "(leave-the-values)"


def with_leaving(task: Task) -> Task:
    """Return a task in which leaving the values of numbers is a second way to the goal; its last variable is the goal.

    The compilation of a number without a proven bound has some of its values only. Another value is *beyond* these, and
    nothing is known of a state in which a number is beyond (`Task.beyond`). Let L be the task in which a state that has
    a beyond fact, or satisfies the goal, reaches a new goal at no cost.

    Claim: if an optimal plan of L from a state s ends in a state that satisfies the goal and has no beyond fact before
    its end, it is an optimal plan of the original task from s. If L has no plan from s, neither has the original task.

    Proof: as long as no number is beyond, both tasks have the same states, actions and costs. A plan of the original
    task from s either never leaves the values, and is a plan of L of the same cost; or its part up to the first state
    with a beyond fact is one, of at most that cost. So the optimal cost of L is at most that of the original task, and
    infinite only if that is. A plan of L that reaches the goal itself is a plan of the original task, so that its cost
    is at least the optimal one. Hence both are equal.
    """
    new, first = len(task.variables), len(task.actions)
    reached = (Effect((), new, 1),)
    leave = tuple(Operator(first + 1, (fact,), reached) for fact in task.beyond)
    return replace(
        task,
        variables=(*task.variables, Variable("end", ("Atom open()", "Atom ended()"), -1)),
        actions=(*task.actions, REACH, LEAVE),
        costs=(*task.costs, 0, 0),
        operators=(*task.operators, Operator(first, task.goal, reached), *leave),
        initial=(*task.initial, 0),
        goal=((new, 1),),
    )


def without_leaving(task: Task, plan: Sequence[str] | None) -> list[str] | None:
    """Return the plan of a task for one of L; a `LimitError` says if that leaves the values."""
    if plan is None:
        return None
    if plan[-1] == LEAVE:
        raise LimitError(out_of_range(task))
    return list(plan[:-1])


def out_of_range(task: Task) -> str:
    """Return which numbers have no proven bound, as a sentence for a limit."""
    facts = (task.variables[variable].facts[value] for variable, value in task.beyond)
    names = sorted({fact.removeprefix("Atom ").partition("(")[0] for fact in facts})
    return f"a cheapest plan may need more values of {', '.join(names)} than were tried, as no bound is proven"


def verify(
    table: Table,
    count: int,
    rng: np.random.Generator,
    *,
    seconds: float | None = None,
    limits: Limits = NO_LIMITS,
    jobs: int = 1,
    known: Mapping[int, float] | None = None,
    progress: Callable[[int], None] | None = None,
) -> int:
    """Compare a random sample of a table's states, the initial state first, with Fast Downward's A*.

    States whose search reaches its limits, or fails, are skipped.

    Parameters
    ----------
    table : Table
    count : int
        States to compare (all, where there are fewer).
    rng : numpy.random.Generator
    seconds : float, optional
        Time after which the comparison stops and running searches are ended.
    limits : Limits
        Limits of each search.
    jobs : int
        Number of states that are compared in parallel.
    known : mapping of int to float, optional
        Results of A* that are known already, by state.
    progress : callable, optional
        Called with the number of states compared so far.

    Returns
    -------
    int
        Number of states compared; all values were equal.

    Raises
    ------
    MismatchError
        The values of a state differ.
    """
    space, said, start, compared = table.space, known or {}, time.monotonic(), 0
    over, counting = threading.Event(), threading.Lock()

    def asked(state: int) -> float | None:
        if state in said:
            return said[state]
        own = limits.ended_by(over)
        if seconds is not None:
            left = seconds - (time.monotonic() - start)
            own = replace(own, seconds=left if limits.seconds is None else min(left, limits.seconds))
            if left <= 0:
                return None
        if over.is_set():
            return None
        try:
            return astar(space.task, space.values([state])[0].tolist(), limits=own)[0]
        except (LimitError, FastDownwardError):
            return None

    def compare(state: int) -> None:
        nonlocal compared
        expected = asked(state)
        if expected is None:
            return
        if expected != table[state]:
            raise mismatch(table, state, expected)
        with counting:
            compared += 1
            if progress is not None:
                progress(compared)

    on_threads(compare, sample(len(table), table.initial, count, rng), jobs, over)
    return compared


def check_successors(table: Table, count: int, rng: np.random.Generator, *, seconds: float | None = None) -> int:
    """Check the Bellman equation of a table in a random sample of states, the initial state first.

    In a goal state h* must be 0. In any other state it must be the minimum over actions of the cost plus h* of the
    successor. Successors are computed from the operators of the grounded task, independently of the sweep. The check
    also covers states that are too far from the goal for A*.

    At most `count` states are checked, none after so many `seconds`; their number is returned. A generator in the same
    state yields the sample of `verify`. If the equation fails, or a successor is no state of the table, this raises a
    `MismatchError`.
    """
    space, task, states = table.space, table.task, sample(len(table), table.initial, count, rng)
    start = time.monotonic()
    for done, state in enumerate(states):
        if seconds is not None and done and time.monotonic() - start > seconds:
            return done
        values = space.values([state])[0].tolist()
        if all(values[variable] == value for variable, value in task.goal):
            least = np.zeros(1)
        else:
            after = successors(task, values)
            targets = np.array(list(after.values()), dtype=np.int64).reshape(len(after), len(values))
            try:
                least = np.array([task.costs[action] for action in after]) + table.whole(space.numbers(targets))
            except KeyError as error:
                raise MismatchError(f"state {state} leads to {error}, which is no state of the table") from error
        expected = float(least.min(initial=np.inf))
        if table.whole([state])[0] != expected:
            raise mismatch(table, state, task.in_unit(expected), "its successors say")
    return len(states)


def check_plan(known: CostToGo, plan: Sequence[str]) -> int:
    """Check h* along a plan from the initial state: it must be the cost of the rest of the plan. Return the states.

    The states follow from the operators of the grounded task, independently of the sweep. This raises a
    `MismatchError`.
    """
    task = known.task
    values, costs = steps_along(task, plan)
    rest = np.append(np.cumsum(costs[::-1], dtype=np.int64)[::-1], 0)
    try:
        found = known.whole(known.numbers(np.array(values, dtype=np.int64)))
    except KeyError as error:
        raise MismatchError(f"the plan leads to {error}, which is no state of the table") from error
    for step, (h, cost) in enumerate(zip(found.tolist(), rest.tolist(), strict=True)):
        if h != cost:
            after, others = task.in_unit(h), task.in_unit(cost)
            raise MismatchError(
                f"cost-to-go after step {step} of the plan is {after:g}, but its other steps cost {others:g}"
            )
    return len(values)


def sample(states: int, initial: int, count: int, rng: np.random.Generator) -> list[int]:
    """Return a random sample of `count` distinct states, the initial state first; all states if there are no more."""
    count = max(0, count - 1)
    if count >= states - 1:
        return [initial, *(state for state in range(states) if state != initial)]
    drawn: dict[int, None] = {}
    while len(drawn) < count:  # a permutation of all states would take more memory than the table
        drawn.update((int(s), None) for s in rng.integers(states, size=count) if s != initial)
    return [initial, *list(drawn)[:count]]


def mismatch(table: Table, state: int, expected: float, who: str = "Fast Downward's A* says") -> MismatchError:
    """Return the error for a state whose value differs from another result."""
    return MismatchError(
        f"cost-to-go of state {state} is {table[state]:g}, but {who} {expected:g} "
        f"({', '.join(table.space.facts(state))})"
    )
