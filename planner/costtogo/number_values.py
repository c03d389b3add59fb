"""Grounding of an instance whose numbers may have no proven bound: values are tried, and more while these are left.

A number without a proven bound is given few values, those that are near to the first one. A change to another value
leads *beyond*. The trial is made with twice as many values as long as a reachable state has a number beyond its values.

Claim: once all reachable states of a trial are enumerated, and no number is beyond, the task has exactly the states,
actions and costs of the original one.

Proof: by induction over the number of actions from the initial state. Where no number is beyond, a state of the trial
is a state of the original task, and the applicable actions and their effects are the same, apart from those that lead
beyond. There are none, so that the states after one more action are the same.

The values are then known to be all, and are compiled as such. Where there are too many states to enumerate, or no trial
is closed, the task keeps its beyond facts. It is no longer swept, and its states are solved on demand (`astar`). A
trial is then large enough if a plan from the initial state is optimal within it. If no trial is, the number is refused.

Trials end after numbers of states, operators, rows of relations and ways to satisfy conditions, never because time is
short: a file has the same values everywhere. Where time is short, there is an error instead.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

from ..grounding.task import Task
from ..grounding.translation import ground
from ..pddl.compilation import MOST_VALUES, Compilation, without_recursive_quantifiers
from ..pddl.instances import PDDLError
from ..pddl.numeric_compiler import Compiler
from ..pddl.reader import Reading
from ..pddl.value_ranges import UnprovenError
from ..pddl.value_sets import Trial
from ..system.errors import UnsuitedError
from ..system.limits import NO_LIMITS, LimitError, Limits, MemoryLimitError

FIRST_VALUES = 8
"""Values of a number in the first trial."""
MOST_STATES = 1_000_000
"""States that are enumerated in all trials of an instance."""
MOST_SEARCHED = 300_000
"""States that the search for a cheapest plan meets within one trial."""
MOST_OPERATORS = 15_000
"""No trial is made that is expected to have more operators, since it would take minutes to ground."""
MOST_ROWS_OF_TRIAL = 100_000
"""No trial is made with more rows of relations and ways to satisfy conditions; so many are grounded in five seconds."""
TRIAL_SECONDS = 120.0
"""Longest processor time to ground one trial. To reach it is an error."""


def grounded(
    reading: Reading, limits: Limits = NO_LIMITS, most_values: int = MOST_VALUES
) -> tuple[Compilation, Task]:  # fmt: skip
    """Compile and ground an instance; a number may have `most_values` values.

    A `PDDLError` says what cannot be compiled, a `LimitError` that the limits of the grounding are reached.
    """
    reading = without_recursive_quantifiers(reading)
    if not reading.numeric:
        return Compilation(reading), ground(Compilation(reading), limits)
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
        self._unknown: tuple[Compilation, Task] | None = None
        """The last trial of which it is not known that a cheapest plan leaves it."""

    def _left(self) -> Limits:
        """Return the limits of one step."""
        left = None if self._end is None else self._end - time.monotonic()
        if left is not None and left <= 0:
            raise LimitError("out of time while the values of numbers without a proven bound were tried")
        return replace(self._limits, seconds=left, processor_seconds=TRIAL_SECONDS)

    def sufficient(self, refusal: UnprovenError) -> tuple[Compilation, Task]:
        """Return the compilation and the task of a trial that suffices; if there is none, raise the refusal."""
        from ..search.search_space import explore  # slow to import, and seldom needed
        from .trial_states import WatchedStates

        states, open_trials = MOST_STATES, list[tuple[Compilation, Task]]()
        for trial, compilation, task, decided in self._made():
            if not decided:
                if not task.beyond:
                    return compilation, task
                open_trials.append((compilation, task))
            watched = WatchedStates(task, states)
            try:
                explore(watched, watched.budget, 1, lambda *_: None)  # one thread: the same states are met each time
            except UnsuitedError:
                states -= len(watched)
            except MemoryLimitError:
                raise
            except LimitError:  # too many states
                break
            else:
                closed = self._compiler.compilation(replace(trial, known=watched.numbers()))
                return closed, ground(closed, self._left())
        found = self._optimal(open_trials, refusal) or self._unknown
        if found is None:
            raise refusal
        return found

    def _optimal(
        self, open_trials: list[tuple[Compilation, Task]], refusal: UnprovenError
    ) -> tuple[Compilation, Task] | None:
        """Return the first trial within which a plan is known to be optimal; no trial is asked twice."""
        from .trial_states import stays_within

        while open_trials:
            compilation, task = open_trials.pop(0)
            self._left()  # which raises an error if the caller's time is over
            stays = stays_within(task, MOST_SEARCHED)
            if stays is False:
                continue
            said = f"{refusal.message.partition(';')[0]}: no bound is proven, so that states are solved on demand"
            self._unknown = compilation, replace(task, note="; ".join(filter(None, (task.note, said))))
            if stays:
                return self._unknown
        return None

    def _made(self) -> Iterator[tuple[Trial, Compilation, Task, bool]]:
        """Yield the trials, and whether the translator decides that there is no plan within their values.

        In the task of such a trial another goal is reached, so that its states can be enumerated.
        """
        values, before = FIRST_VALUES, 0
        while True:
            trial = Trial(min(values, self._most_values))
            try:
                compilation = self._compiler.compilation(trial, MOST_ROWS_OF_TRIAL)
            except PDDLError:  # too many combinations of values
                return
            try:
                task = ground(compilation, self._left())
                decided = task.decided_by_translator and not holds_initially(task)
                if decided:
                    task = ground(compilation.with_open_goal(), self._left())
            except LimitError as error:
                tried = f"while {values} values were tried of numbers without a proven bound"
                raise type(error)(f"{error} {tried}") from None
            yield trial, compilation, task, decided
            size = len(task.operators)
            if values >= self._most_values or size**2 > MOST_OPERATORS * max(before, size // 2):
                return  # the size grows by the same factor as before, at least doubling at first
            values, before = 2 * values, size


def holds_initially(task: Task) -> bool:
    """Return whether the goal of a task that the translator decided holds in the initial state."""
    return all(task.initial[variable] == value for variable, value in task.goal)
