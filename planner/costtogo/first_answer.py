"""The plan of a task: that of one search, which runs while all states are being enumerated.

`Early` runs Fast Downward's A* in a subprocess, and waits for it in a thread. Its plan is the one that is shown and
saved, so that a task has the same plan each time, whichever of the two is done first. A part of the memory is reserved
for the search until it ends.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from math import inf, isfinite
from types import TracebackType

from ..grounding.fast_downward import FastDownwardError
from ..grounding.semantics import replay
from ..grounding.task import Task
from ..pddl.validation import InvalidPlanError
from ..system.limits import LimitError, Limits, MemoryLimitError, available_memory, used_mb
from .astar import astar

Answer = tuple[float, list[str] | None]
"""Cost of an optimal plan, and the plan; infinite and None if there is none."""


class Early:
    """A context manager that searches from the initial state in the background until the context is left.

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
        except (LimitError, FastDownwardError, InvalidPlanError, OSError) as error:
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
        except (LimitError, FastDownwardError, InvalidPlanError) as error:
            self._fault = error
        except (OSError, MemoryError, RuntimeError):
            pass  # `wait` repeats the search when the other work is done
        finally:
            self._ended.set()
        if self.answer is not None and not self._stop.wait(self._begun + self._delay - time.monotonic()):
            with suppress(OSError):  # the receiver's disk or pipe may be full
                self._tell(self.answer)
