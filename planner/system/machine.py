"""Memory and processors that the machine and the control groups leave to this process.

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
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath

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
