"""What a search may use: states, memory and time, checked before it is too late."""

from __future__ import annotations

import resource
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from .machine import available_memory

MAX_STATES = 50_000_000
"""States that are enumerated, unless another number is given."""


@dataclass(frozen=True)
class Budget:
    """What a sweep may use; each method raises `LimitError` when that is not enough.

    Attributes
    ----------
    max_states : int or None
    memory : float
        Bytes.
    deadline : float or None
        A time on `time.monotonic()`'s clock.
    stop : threading.Event or None
        Once it is set there is no time left.
    lent : callable
        How many of the bytes something else may take for now.
    """

    max_states: int | None
    memory: float
    deadline: float | None
    stop: threading.Event | None = None
    lent: Callable[[], float] = float

    @classmethod
    def within(
        cls,
        max_states: int | None,
        memory_mb: float | None,
        deadline: float | None,
        stop: threading.Event | None,
        lent: Callable[[], float] = float,
    ) -> Budget:
        """Allow so many megabytes of memory, but no more than the machine has left."""
        memory = available_memory()
        return cls(max_states, memory if memory_mb is None else min(memory, memory_mb * 1e6), deadline, stop, lent)

    @property
    def room(self) -> float:
        """Return how many bytes may be in use now."""
        return self.memory - self.lent()

    def part(self, share: float) -> Budget:
        """Give a share of the time that is left."""
        if self.deadline is None:
            return self
        now = time.monotonic()
        return replace(self, deadline=now + share * (self.deadline - now))

    def check_time(self, states: int) -> None:
        """Check the deadline; `states` is for the message."""
        if self.stop is not None and self.stop.is_set():
            raise LimitError(f"stopped after {_counted(states)}")
        if self.deadline is not None and time.monotonic() > self.deadline:
            raise LimitError(f"out of time after {_counted(states)}")

    def check_states(self, states: int) -> None:
        """Check the number of states."""
        if self.max_states is not None and states > self.max_states:
            raise LimitError(f"more than {_counted(self.max_states)}")

    def check_memory(self, needed: float) -> None:
        """Check a number of bytes that is about to be in use."""
        if needed > self.room:
            raise MemoryLimitError(f"{needed / 1e6:.0f} MB of memory needed, {self.room / 1e6:.0f} MB allowed")


def _counted(states: int) -> str:
    return f"{states} state{'' if states == 1 else 's'}"


class LimitError(RuntimeError):
    """A limit of time, memory or states was reached before the answer was known."""


class CostLimitError(LimitError):
    """Costs are so large that Fast Downward's sums, of 32 bits, may overflow."""


class MemoryLimitError(LimitError):
    """More memory would be needed than is allowed."""


@dataclass(frozen=True)
class Limits:
    """What one call may use; `None` for no limit.

    Attributes
    ----------
    seconds : float or None
        Of wall-clock time.
    memory_mb : float or None
        Megabytes.
    stop : threading.Event or None
        It ends as well once this is set.
    first : float or None
        Seconds after which it lets all other work on the machine go first.
    """

    seconds: float | None = None
    memory_mb: float | None = None
    stop: threading.Event | None = None
    first: float | None = None


NO_LIMITS = Limits()


def limit_memory(pid: int, limits: Limits) -> None:
    """Limit the memory of a process that has just been started."""
    if hasattr(resource, "prlimit") and limits.memory_mb is not None:
        _limit(pid, resource.RLIMIT_AS, int(limits.memory_mb * 1e6))


def _limit(pid: int, what: int, value: int) -> None:
    try:
        _, hard = resource.prlimit(pid, what)
        resource.prlimit(pid, what, (value if hard == resource.RLIM_INFINITY else min(value, hard), hard))
    except ProcessLookupError:
        pass  # it has ended already
