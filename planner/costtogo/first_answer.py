"""The first answer to a task: cost and plan of its initial state, while all states are still being looked for.

`Early` asks Fast Downward's A* in a thread, which only waits for it. What takes less than a moment anyway is left
alone: the search begins after `ALONE`. It has a part of the memory until it is over. Once it has taken `ABREAST`, it
goes on with what time the other work leaves of the processors, so that a task whose plan is hard to find takes hardly
longer than without it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType

from ..grounding.fast_downward import FastDownwardError
from ..grounding.semantics import replay
from ..grounding.task import Task
from ..pddl.validation import InvalidPlanError
from ..system.limits import LimitError, Limits, MemoryLimitError
from ..system.machine import available_memory, used_mb
from .astar import astar

ALONE = 0.5
"""Seconds for which other work has the processors for itself; most tasks are swept in less."""

ABREAST = 10.0
"""Seconds for which the search shares the processors with other work."""

SHARE = 0.25
"""Of the memory that is left, the search may take so much."""

Answer = tuple[float, list[str] | None]
"""The cost of an optimal plan, and the plan; infinite and None where there is none."""


class Early:
    """A search from the initial state, which begins when it is entered as a context and is ended when it is left.

    Parameters
    ----------
    task : Task
    limits : Limits
        Of the search; memory is that of the search and of all that goes on beside it.
    tell : callable
        Called with the answer, in a thread, as soon as it is there.

    Attributes
    ----------
    answer : Answer or None
        What has been found by now.
    """

    def __init__(self, task: Task, limits: Limits, tell: Callable[[Answer], None]) -> None:
        self._task, self._limits, self._tell = task, limits, tell
        left = available_memory() / 1e6
        if limits.memory_mb is not None:
            left = min(left, limits.memory_mb - (used_mb() or 0.0))
        self._memory_mb = max(1.0, SHARE * left)
        self._stop, self._ended = threading.Event(), threading.Event()
        self._thread: threading.Thread | None = None
        self._fault: Exception | None = None
        self.answer: Answer | None = None

    def __enter__(self) -> Early:
        if self._task.decided_by_translator:
            self._ended.set()  # what is asked for at the end takes no time
        else:
            thread = threading.Thread(target=self._run, daemon=True)
            try:
                thread.start()
                self._thread = thread
            except RuntimeError:  # it finds no memory to begin
                self._ended.set()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.end()

    def end(self) -> None:
        """End the search; an answer that is there already stays."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()

    def lent(self) -> float:
        """Return how many bytes the search may take for now."""
        return 0.0 if self._ended.is_set() else self._memory_mb * 1e6

    def wait(self, limits: Limits) -> Answer:
        """Wait for the answer; the search has all the machine now, and these limits if it has to be done again.

        Raises
        ------
        LimitError
            Out of time or memory, or costs too large for Fast Downward.
        """
        self._ended.wait()
        if self.answer is not None:
            return self.answer
        if self._fault is None or isinstance(self._fault, MemoryLimitError):
            return astar(self._task, limits=limits)
        raise self._fault

    def _run(self) -> None:
        try:
            if not self._stop.wait(ALONE):
                seconds = None if self._limits.seconds is None else max(0.01, self._limits.seconds - ALONE)
                own = Limits(seconds, self._memory_mb, self._stop, ABREAST)
                answer = astar(self._task, limits=own)
                if answer[1] is not None:
                    replay(self._task, answer[1])
                self.answer = answer
        except (LimitError, FastDownwardError, InvalidPlanError) as error:
            self._fault = error
        except (OSError, MemoryError, RuntimeError):
            pass  # it is asked again when the other work is over
        finally:
            self._ended.set()
        if self.answer is not None and not self._stop.is_set():
            with suppress(OSError):  # where it is told, something is full
                self._tell(self.answer)
