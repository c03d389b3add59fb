"""The first result for a task: cost and plan of its initial state, while all states are still being enumerated.

`Early` runs Fast Downward's A* in a subprocess, and waits for it in a thread. The search starts after half a second,
so that short tasks are not disturbed. A part of the memory is reserved for it until it ends. After ten seconds it
gets the lowest priority, so that a hard search hardly delays the other work.
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

Answer = tuple[float, list[str] | None]
"""Cost of an optimal plan, and the plan; infinite and None if there is none."""


class Early:
    """A context manager that searches from the initial state in the background until the context is left.

    The search starts after `delay` seconds. `limits.memory_mb` is that of the whole process and the search together.
    The `answer` is None while it is unknown; then `tell` is called with it, in a thread.
    """

    def __init__(self, task: Task, limits: Limits, tell: Callable[[Answer], None], *, delay: float = 0.5) -> None:
        self._task, self._limits, self._tell, self._delay = task, limits, tell, delay
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
            if not self._stop.wait(self._delay):
                seconds = None if self._limits.seconds is None else max(0.01, self._limits.seconds - self._delay)
                own = Limits(seconds, self._memory_mb, self._stop, lower_priority_after=10.0)
                answer = astar(self._task, limits=own)
                if answer[1] is not None:
                    replay(self._task, answer[1])
                self.answer = answer
        except (LimitError, FastDownwardError, InvalidPlanError) as error:
            self._fault = error
        except (OSError, MemoryError, RuntimeError):
            pass  # `wait` repeats the search when the other work is done
        finally:
            self._ended.set()
        if self.answer is not None and not self._stop.is_set():
            with suppress(OSError):  # the receiver's disk or pipe may be full
                self._tell(self.answer)
