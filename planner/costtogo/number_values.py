"""Grounding of an instance whose numbers may have no proven bound: values are tried, and more while these are left.

A number without a proven bound is given few values, those that are near to the first one. A change to another value
leads *beyond*. The trial is made with twice as many values as long as

- the translator alone decides that there is no plan, or
- a reachable state has a number beyond its values.

Claim: once all reachable states of a trial are enumerated, and no number is beyond, the task has exactly the states,
actions and costs of the original one.

Proof: by induction over the number of actions from the initial state. Where no number is beyond, a state of the trial
is a state of the original task, and the applicable actions and their effects are the same, apart from those that lead
beyond. There are none, so that the states after one more action are the same.

The values are then known to be all, and are compiled as such. Where there are too many states to enumerate, or no trial
is closed, the task keeps its beyond facts. It is no longer swept, and its states are solved on demand (`leaving`). A
trial is then large enough if a plan from the initial state is optimal within it. If no trial is, the number is refused.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

from ..grounding import fast_downward
from ..grounding.fast_downward import ASTAR, ASTAR_WITH_AXIOMS
from ..grounding.leaving import REACH, with_leaving
from ..grounding.task import Task
from ..grounding.translation import ground
from ..pddl.compilation import MOST_VALUES, Compilation, Compiler
from ..pddl.instances import PDDLError
from ..pddl.reader import Reading
from ..pddl.value_ranges import UnprovenError
from ..pddl.value_sets import Trial
from ..system.limits import NO_LIMITS, LimitError, Limits

FIRST_VALUES = 8
"""Values of a number in the first trial."""
MOST_STATES = 1_000_000
"""States that are enumerated in all trials of an instance."""
MOST_OPERATORS = 30_000
"""A trial with more operators is not enlarged: the next one would take minutes to ground."""
TRIAL_SECONDS = 30.0
"""Longest processor time to ground one trial, or to search for a plan within it."""


def grounded(
    reading: Reading, limits: Limits = NO_LIMITS, most_values: int = MOST_VALUES
) -> tuple[Compilation, Task]:  # fmt: skip
    """Compile and ground an instance; a number may have `most_values` values.

    A `PDDLError` says what cannot be compiled, a `LimitError` that the limits of the grounding are reached.
    """
    compiler = Compiler(reading, most_values)
    end = None if limits.seconds is None else time.monotonic() + limits.seconds
    try:
        compilation = compiler.compilation()
    except UnprovenError as error:
        return _Trials(compiler, limits, end, most_values).sufficient(error)
    return compilation, ground(compilation, limits)


class _Trials:
    """The trials of an instance; `end` is the time, on the clock of `time.monotonic()`, at which they end."""

    def __init__(self, compiler: Compiler, limits: Limits, end: float | None, most_values: int) -> None:
        self._compiler = compiler
        self._limits, self._end = limits, end
        self._most_values = most_values

    def _left(self) -> Limits:
        """Return the limits of one step."""
        left = None if self._end is None else self._end - time.monotonic()
        if left is not None and left <= 0:
            raise LimitError("out of time while the values of numbers without a proven bound were tried")
        return replace(self._limits, seconds=left, processor_seconds=TRIAL_SECONDS)

    def sufficient(self, refusal: UnprovenError) -> tuple[Compilation, Task]:
        """Return the compilation and the task of a trial that suffices; if there is none, raise the refusal."""
        from ..search.forward_search import explore  # slow to import, and seldom needed
        from .watched_states import BeyondError, WatchedStates

        states, open_trials = MOST_STATES, []
        for trial, compilation, task in self._made():
            if not task.beyond:
                return compilation, task
            open_trials.append((compilation, task))
            watched = WatchedStates(task, states)
            try:
                explore(watched, watched.budget, 1, lambda *_: None)  # one thread: the same states are met each time
            except BeyondError:
                states -= len(watched)
            except LimitError:  # too many states
                break
            else:
                closed = self._compiler.compilation(replace(trial, known=watched.numbers()))
                return closed, ground(closed, self._left())
            if len(task.operators) > MOST_OPERATORS:
                break
        for compilation, task in open_trials:
            if self._has_optimum(task):
                note = f"{refusal.message.partition(';')[0]}: no bound is proven, so that states are solved on demand"
                return compilation, replace(task, note="; ".join(filter(None, (task.note, note))))
        raise refusal

    def _has_optimum(self, task: Task) -> bool:
        """Return whether a cheapest plan stays within the values, as far as can be found in time."""
        whole = with_leaving(task)
        search = ASTAR_WITH_AXIOMS if task.axioms else ASTAR
        try:
            plan = fast_downward.optimal_plan(whole.reduced.sas, search=search, limits=self._left())
        except LimitError:
            return True  # it is to be found later, under the limits of who asks
        return plan is None or plan[-1] == REACH

    def _made(self) -> Iterator[tuple[Trial, Compilation, Task]]:
        """Yield the trials of which the translator does not decide that there is no plan."""
        values = FIRST_VALUES
        while True:
            trial, left = Trial(min(values, self._most_values)), self._left()
            try:
                compilation = self._compiler.compilation(trial)
                task = ground(compilation, left)
            except (PDDLError, LimitError):  # too many combinations of values, or for too long
                self._left()  # which raises an error if it is the caller's time that is over
                return
            if not task.decided_by_translator or holds_initially(task):
                yield trial, compilation, task
            if values >= self._most_values:
                return
            values *= 2


def holds_initially(task: Task) -> bool:
    """Return whether the goal of a task that the translator decided holds in the initial state."""
    return all(task.initial[variable] == value for variable, value in task.goal)
