"""Limits on the states, memory and time of a search, and the errors that report them."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Protocol

from .machine import available_memory

MAX_STATES = 50_000_000
"""Default for the largest number of states that are enumerated. It bounds both time and memory."""

Check = Callable[[float], None]
"""A check that long computations call repeatedly with the number of bytes in use. It may raise `LimitError`."""


def unchecked(_needed: float) -> None:
    """Check nothing."""


class StopSignal(Protocol):
    """A flag that another thread sets to end a call, such as a `threading.Event`."""

    def is_set(self) -> bool:
        """Whether the call should end."""
        ...


@dataclass(frozen=True)
class Budget:
    """The states, memory and time that a search may use.

    The `check` methods raise `LimitError` when a limit is exceeded.
    """

    max_states: int | None
    memory: float
    """Bytes that may be in use."""
    deadline: float | None
    """Time on the clock of `time.monotonic()`."""
    stop: StopSignal | None = None
    """Flag that ends the search: once it is set, the time is up."""
    reserved_bytes: Callable[[], float] = float
    """Returns the bytes of `memory` that are currently reserved for something else."""
    held: float = 0.0
    """Bytes that are permanently in use, in addition to those that are checked."""

    @classmethod
    def within(
        cls,
        max_states: int | None,
        memory_mb: float | None = None,
        deadline: float | None = None,
        stop: StopSignal | None = None,
        reserved_bytes: Callable[[], float] = float,
    ) -> Budget:
        """Return a budget of `memory_mb` megabytes, or of the memory available on the machine if that is less."""
        memory = available_memory() if memory_mb is None else min(available_memory(), memory_mb * 1e6)
        return cls(max_states, memory, deadline, stop, reserved_bytes)

    @property
    def room(self) -> float:
        """Bytes that may be in use now, in addition to those that are held."""
        return self.memory - self.reserved_bytes() - self.held

    def part(self, share: float) -> Budget:
        """Return the budget with a share of the remaining time."""
        if self.deadline is None:
            return self
        now = time.monotonic()
        return replace(self, deadline=now + share * (self.deadline - now))

    def beside(self, held: float) -> Budget:
        """Return the budget with `held` more bytes permanently in use."""
        return replace(self, held=self.held + held)

    def during(self, phase: str) -> Check:
        """Return a check of time and memory for a phase before the first state, such as "a ranking was looked for"."""

        def check(needed: float) -> None:
            self._check_time(f"while {phase}")
            self.check_memory(needed)

        return check

    def check_time(self, states: int) -> None:
        """Check the deadline and the stop signal; `states` appears in the message."""
        self._check_time(f"after {_counted(states)}")

    def _check_time(self, when: str) -> None:
        if self.stop is not None and self.stop.is_set():
            raise LimitError(f"stopped {when}")
        if self.deadline is not None and time.monotonic() > self.deadline:
            raise LimitError(f"out of time {when}")

    def check_states(self, states: int) -> None:
        """Raise `LimitError` if there are more states than allowed."""
        if self.max_states is not None and states > self.max_states:
            raise LimitError(f"more than {_counted(self.max_states)}")

    def check_memory(self, needed: float) -> None:
        """Raise `LimitError` if so many bytes may not be allocated; called before the allocation."""
        if needed > self.room:
            needed, allowed = needed + self.held, self.room + self.held
            raise MemoryLimitError(f"{needed / 1e6:.0f} MB of memory needed, {allowed / 1e6:.0f} MB allowed")


def _counted(states: int) -> str:
    return f"{states} state{'' if states == 1 else 's'}"


class LimitError(RuntimeError):
    """A limit of time, memory or states was reached before the result was known."""


class CostLimitError(LimitError):
    """A cost, or a sum of costs, is too large for the method."""


class MemoryLimitError(LimitError):
    """The computation needs more memory than is allowed."""


@dataclass(frozen=True)
class Limits:
    """Limits of one call; None means no limit.

    Attributes
    ----------
    seconds : float or None
        Wall-clock time.
    memory_mb : float or None
        Memory in megabytes.
    stop : StopSignal or None
        Flag that ends the call when it is set, such as a `threading.Event`.
    lower_priority_after : float or None
        Seconds after which the process gets the lowest scheduling priority.
    processor_seconds : float or None
        Processor time of the process, which does not depend on the load of the machine.
    """

    seconds: float | None = None
    memory_mb: float | None = None
    stop: StopSignal | None = None
    lower_priority_after: float | None = None
    processor_seconds: float | None = None

    def ended_by(self, over: StopSignal) -> Limits:
        """Return the limits of a call that also ends when `over` is set."""
        return replace(self, stop=over if self.stop is None else _AnyOf((self.stop, over)))


@dataclass(frozen=True)
class _AnyOf:
    """A stop signal that is set when one of several signals is set."""

    signals: tuple[StopSignal, ...]

    def is_set(self) -> bool:
        """Whether one of the signals is set."""
        return any(signal.is_set() for signal in self.signals)


NO_LIMITS = Limits()


def limit_process(pid: int, memory_mb: float | None, processor_seconds: float | None = None) -> None:
    """Limit a process that has just been started, where the system can do so."""
    memory, seconds = (None if memory_mb is None else int(memory_mb * 1e6)), processor_seconds
    limits = ((resource.RLIMIT_AS, memory), (resource.RLIMIT_CPU, None if seconds is None else int(seconds) + 1))
    for what, value in limits:
        if hasattr(resource, "prlimit") and value is not None:
            with suppress(ProcessLookupError):  # the process has ended already
                _, hard = resource.prlimit(pid, what)
                resource.prlimit(pid, what, (value if hard == resource.RLIM_INFINITY else min(value, hard), hard))
