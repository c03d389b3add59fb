"""What a search may use: states, memory and time, checked before it is too late."""

from __future__ import annotations

import math
import os
import re
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path

from .fast_downward import LimitError
from .fast_downward import MemoryLimitError as MemoryLimitError

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
    """

    max_states: int | None
    memory: float
    deadline: float | None
    stop: threading.Event | None = None

    @classmethod
    def within(
        cls, max_states: int | None, memory_mb: float | None, deadline: float | None, stop: threading.Event | None
    ) -> Budget:
        """Allow so many megabytes of memory, but no more than the machine has left."""
        memory = available_memory()
        return cls(max_states, memory if memory_mb is None else min(memory, memory_mb * 1e6), deadline, stop)

    def part(self, share: float) -> Budget:
        """Give a share of the time that is left."""
        if self.deadline is None:
            return self
        now = time.monotonic()
        return replace(self, deadline=now + share * (self.deadline - now))

    def check_time(self, states: int) -> None:
        """Check the deadline; `states` is for the message."""
        if self.stop is not None and self.stop.is_set():
            raise LimitError(f"stopped after {states} states")
        if self.deadline is not None and time.monotonic() > self.deadline:
            raise LimitError(f"out of time after {states} states")

    def check_states(self, states: int) -> None:
        """Check the number of states."""
        if self.max_states is not None and states > self.max_states:
            raise LimitError(f"more than {self.max_states} states")

    def check_memory(self, needed: float) -> None:
        """Check a number of bytes that is about to be in use."""
        if needed > self.memory:
            raise MemoryLimitError(f"{needed / 1e6:.0f} MB of memory needed, {self.memory / 1e6:.0f} MB allowed")


def available_memory() -> float:
    """Bytes that this process can still take without being killed: the machine's and its control group's."""
    free = math.inf
    meminfo = Path("/proc/meminfo")
    if meminfo.is_file() and (found := re.search(r"MemAvailable:\s+(\d+) kB", meminfo.read_text())):
        free = int(found[1]) * 1024.0
    elif hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        free = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2
    group = Path("/sys/fs/cgroup")
    if (group / "memory.max").is_file() and (most := (group / "memory.max").read_text().strip()) != "max":
        free = min(free, int(most) - int((group / "memory.current").read_text()))
    return 0.9 * free


def processors() -> int:
    """Count the processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
