"""Memory and processors that the machine leaves to this process, limits of a search, and the errors that report them.

A container is a control group (cgroup), often nested in others. Each group may have limits, and the smallest one
applies. Linux has two versions of control groups, and some machines use both. Other systems have none.

A megabyte (MB) is a million bytes, here and in all options and records.
"""

from __future__ import annotations

import math
import os
import re
import resource
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any, Protocol

ROOT = Path("/")
"""Folder below which the system's files are read."""


def available_memory(root: Path = ROOT) -> float:
    """Return how many bytes this process can still allocate without being killed.

    Reclaimable file caches do not count as used. A tenth is left to other processes. The folder `root` contains the
    system's `proc` and `sys`.
    """
    # Share of the available memory that is left to other processes. A larger share is safer and admits fewer states.
    kept = 0.1
    free = math.inf
    with suppress(OSError):
        if found := re.search(r"MemAvailable:\s+(\d+) kB", (root / "proc/meminfo").read_text()):
            free = int(found[1]) * 1024.0
    if free == math.inf and "SC_PHYS_PAGES" in os.sysconf_names:
        free = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2
    for group in _groups("memory", root):
        names = ("memory.max", "memory.high", "memory.limit_in_bytes")
        limits = [int(limit) for name in names if (limit := _read(group / name)).isdecimal()]
        used = _read(group / "memory.current") or _read(group / "memory.usage_in_bytes")
        if limits and used:
            counts = dict(line.split()[:2] for line in _read(group / "memory.stat").splitlines() if " " in line)
            # Reclaimable memory. Version 1 counts it for the group alone, and in total, with that of its subgroups.
            totals = counts.keys() & {"total_active_file", "total_inactive_file"}
            caches = totals or counts.keys() & {"active_file", "inactive_file", "slab_reclaimable"}
            free = min(free, min(limits) - max(0, int(used) - sum(int(counts[name]) for name in caches)))
    return (1 - kept) * max(0.0, free)


def processors(root: Path = ROOT) -> int:
    """Return how many processors this process may use, by its CPU affinity and the CPU quotas of its control groups.

    The folder `root` contains the system's `proc` and `sys`.
    """
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    for group in _groups("cpu", root):
        quota, _, period = _read(group / "cpu.max").partition(" ")
        if not quota:
            quota, period = _read(group / "cpu.cfs_quota_us"), _read(group / "cpu.cfs_period_us")
        if quota.isdecimal() and period.isdecimal() and int(period) > 0:
            count = min(count, math.ceil(int(quota) / int(period)))
    return max(1, count)


def _groups(controller: str, root: Path) -> Iterator[Path]:
    """Yield the folders of the control groups of this process for a controller ("memory" or "cpu"), innermost first."""
    paths: dict[str, str] = {}  # path of the group in each hierarchy; "" is the single hierarchy of version 2
    for line in _read(root / "proc/self/cgroup").splitlines():
        _, controllers, path = line.split(":", 2)
        paths |= dict.fromkeys(controllers.split(","), path)
    for line in _read(root / "proc/self/mountinfo").splitlines():
        mount, _, system = line.partition(" - ")
        kind, _, options = (system.split() + [""] * 3)[:3]
        name = "" if kind == "cgroup2" else controller
        if name not in paths or (kind != "cgroup2" and not (kind == "cgroup" and controller in options.split(","))):
            continue
        inside, at = (re.sub(r"\\(\d{3})", lambda code: chr(int(code[1], 8)), path) for path in mount.split()[3:5])
        top = root / at.lstrip("/")
        own = PurePosixPath(paths[name])
        # A container without its own cgroup namespace sees only its own part of the hierarchy.
        below = own.relative_to(inside) if own.is_relative_to(inside) else PurePosixPath()
        for steps in range(len(below.parts), -1, -1):
            yield top.joinpath(*below.parts[:steps])


def _read(file: Path) -> str:
    """Return the text of a system file; empty if it cannot be read."""
    try:
        return file.read_text(encoding="utf-8").strip()
    except OSError:
        return ""


def used_mb(field: str = "VmRSS") -> float | None:
    """Return a field of this process's memory status in MB; None where the system does not report it."""
    found = re.search(rf"^{field}:\s+(\d+) kB", _read(Path("/proc/self/status")), re.M)
    return None if found is None else int(found[1]) * 1024 / 1e6


def reset_peak_memory() -> None:
    """Reset the peak memory of the process, so that a worker can report the peak of each instance."""
    with suppress(OSError):  # otherwise the peak covers the whole process
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def peak_memory_mb() -> float:
    """Return the peak memory of this process in MB."""
    peak = used_mb("VmHWM")
    if peak is not None:
        return peak
    unit = 1 if sys.platform == "darwin" else 1024  # bytes, or kilobytes
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


@contextmanager
def memory_limit(limit_mb: float | None) -> Iterator[None]:
    """Limit the memory of this process to `limit_mb` within the context. Allocations beyond it fail."""
    used, mapped = used_mb(), used_mb("VmSize")
    if limit_mb is None or used is None or mapped is None:
        yield
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    # The system limits mapped memory only, and libraries map much that they never use.
    resource.setrlimit(resource.RLIMIT_AS, (int((mapped + max(0.0, limit_mb - used)) * 1e6), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


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
class Deadline:
    """When a call with the argument `time_limit` ends.

    Attributes
    ----------
    at : float
        Time on the clock of `time.monotonic()`; infinite without a limit.
    """

    at: float = math.inf

    @classmethod
    def after(cls, time_limit: float | None) -> Deadline:
        """Return the deadline that is so many seconds from now.

        Raises
        ------
        ValueError
            It is not a number above 0.
        """
        if time_limit is None:
            return cls()
        is_number = isinstance(time_limit, int | float) and not isinstance(time_limit, bool)
        if not (is_number and time_limit > 0):
            raise ValueError(f"time_limit {time_limit!r}: expected a number of seconds above 0")
        return cls(time.monotonic() + time_limit)

    @property
    def passed(self) -> bool:
        """Whether the time is up."""
        return time.monotonic() >= self.at

    def check(self, done: str) -> None:
        """Raise a `LimitError` if the time is up; `done` says what had been done by then."""
        if self.passed:
            raise LimitError(f"out of time after {done}")


@dataclass(frozen=True)
class Budget:
    """The states, memory and time that a search may use.

    The `check` methods raise `LimitError` when a limit is exceeded.
    """

    max_states: int | None
    memory: float
    """Bytes that may be in use."""
    deadline: float | None
    """Time on the clock of `time.monotonic()`; None or infinite without a limit."""
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
        if self.deadline is None or self.deadline == math.inf:
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
    processor_seconds : float or None
        Processor time of the process, which does not depend on the load of the machine.
    """

    seconds: float | None = None
    memory_mb: float | None = None
    stop: StopSignal | None = None
    processor_seconds: float | None = None

    def ended_by(self, over: StopSignal) -> Limits:
        """Return the limits of a call that also ends when `over` is set."""
        return replace(self, stop=over if self.stop is None else _AnyOf((self.stop, over)))


def require_limits(given: Any) -> None:
    """Raise a `TypeError` if something else than `Limits` was given, such as a number."""
    if not isinstance(given, Limits):
        raise TypeError(f"a {type(given).__name__} where Limits were expected, such as Limits(seconds=60)")


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
