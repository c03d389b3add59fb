"""What a search may use: states, memory and time, checked before it is too late."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

from .machine import available_memory

MAX_STATES = 50_000_000
"""States that are enumerated, unless another number is given."""

Check = Callable[[float], None]
"""Called again and again by what may take long, with the bytes that it has in use; it may raise `LimitError`."""


def unchecked(_needed: float) -> None:
    """Check nothing."""


class StopSignal(Protocol):
    """Whatever ends a call from another thread, such as a `threading.Event`."""

    def is_set(self) -> bool:
        """Whether the call is to end."""
        ...


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
    stop : StopSignal or None
        Once it is set there is no time left.
    lent : callable
        How many of the bytes something else may take for now.
    held : float
        Bytes that are in use all the time, beside those that are checked.
    """

    max_states: int | None
    memory: float
    deadline: float | None
    stop: StopSignal | None = None
    lent: Callable[[], float] = float
    held: float = 0.0

    @classmethod
    def within(
        cls,
        max_states: int | None,
        memory_mb: float | None,
        deadline: float | None,
        stop: StopSignal | None,
        lent: Callable[[], float] = float,
    ) -> Budget:
        """Allow so many megabytes of memory, but no more than the machine has left."""
        memory = available_memory()
        return cls(max_states, memory if memory_mb is None else min(memory, memory_mb * 1e6), deadline, stop, lent)

    @property
    def room(self) -> float:
        """Return how many bytes may be in use now, beside those that are held."""
        return self.memory - self.lent() - self.held

    def part(self, share: float) -> Budget:
        """Give a share of the time that is left."""
        if self.deadline is None:
            return self
        now = time.monotonic()
        return replace(self, deadline=now + share * (self.deadline - now))

    def beside(self, held: float) -> Budget:
        """Return the same budget where so many bytes more are in use all the time."""
        return replace(self, held=self.held + held)

    def during(self, phase: str) -> Check:
        """Return a check for a phase in which no state is found yet, such as "an index was looked for"."""

        def check(needed: float) -> None:
            self._check_time(f"while {phase}")
            self.check_memory(needed)

        return check

    def check_time(self, states: int) -> None:
        """Check the deadline; `states` is for the message."""
        self._check_time(f"after {_counted(states)}")

    def _check_time(self, when: str) -> None:
        if self.stop is not None and self.stop.is_set():
            raise LimitError(f"stopped {when}")
        if self.deadline is not None and time.monotonic() > self.deadline:
            raise LimitError(f"out of time {when}")

    def check_states(self, states: int) -> None:
        """Check the number of states."""
        if self.max_states is not None and states > self.max_states:
            raise LimitError(f"more than {_counted(self.max_states)}")

    def check_memory(self, needed: float) -> None:
        """Check a number of bytes that is about to be in use."""
        if needed > self.room:
            needed, allowed = needed + self.held, self.room + self.held
            raise MemoryLimitError(f"{needed / 1e6:.0f} MB of memory needed, {allowed / 1e6:.0f} MB allowed")


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
    stop : StopSignal or None
        The call ends as well once this is set; a `threading.Event` is one.
    first : float or None
        Seconds after which it lets all other work on the machine go first.
    """

    seconds: float | None = None
    memory_mb: float | None = None
    stop: StopSignal | None = None
    first: float | None = None

    def ended_by(self, over: StopSignal) -> Limits:
        """Return the same limits for a call that ends once `over` is set, too."""
        return replace(self, stop=over if self.stop is None else _AnyOf((self.stop, over)))


@dataclass(frozen=True)
class _AnyOf:
    """Set once one of several is."""

    signals: tuple[StopSignal, ...]

    def is_set(self) -> bool:
        """Whether one of them is set."""
        return any(signal.is_set() for signal in self.signals)


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
