"""Resources that a machine and its control groups leave to a process, read from folders with the files of Linux."""

from __future__ import annotations

import os
import resource
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from planner.system.limits import available_memory, memory_limit, peak_memory_mb, processors, used_mb

MACHINE = {"proc/meminfo": "MemTotal: 9000 kB\nMemAvailable:    8000 kB\n"}
FREE = 8000 * 1024
UNLIMITED = "9223372036854771712\n"
"""Value of version 1 for a group without a limit."""

V2 = {
    "proc/self/cgroup": "0::/kubepods/pod7/box\n",
    "proc/self/mountinfo": "30 23 0:26 / /sys/fs/cgroup rw,nosuid - cgroup2 cgroup2 rw,nsdelegate\n",
}
V1 = {
    "proc/self/cgroup": "9:name=systemd:/\n4:memory:/kubepods/pod7/box\n1:cpu,cpuacct:/kubepods/pod7/box\n0::/\n",
    "proc/self/mountinfo": (
        "31 23 0:28 / /sys/fs/cgroup rw - tmpfs tmpfs rw,mode=755\n"
        "32 31 0:29 / /sys/fs/cgroup/cpu,cpuacct rw shared:9 - cgroup cgroup rw,cpu,cpuacct\n"
        "35 31 0:32 / /sys/fs/cgroup/memory rw - cgroup cgroup rw,memory\n"
        "41 31 0:38 / /sys/fs/cgroup/unified rw - cgroup2 cgroup2 rw\n"
    ),
}
GROUP2, GROUP1, PROCESSOR1 = (
    f"sys/fs/cgroup/{hierarchy}kubepods/pod7/" for hierarchy in ("", "memory/", "cpu,cpuacct/")
)


def machine(folder: Path, *parts: Mapping[str, str]) -> Path:
    """A folder with the files of a system."""
    for name, text in {name: text for part in (MACHINE, *parts) for name, text in part.items()}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder


def memory2(group: str, most: int | str, used: int, **stat: int) -> dict[str, str]:
    counts = "".join(f"{name} {count}\n" for name, count in stat.items())
    return {f"{group}memory.max": f"{most}\n", f"{group}memory.current": f"{used}\n", f"{group}memory.stat": counts}


def memory1(group: str, most: int | str, used: int, **stat: int) -> dict[str, str]:
    counts = "".join(f"{name} {count}\n" for name, count in stat.items())
    names = {"memory.limit_in_bytes": most, "memory.usage_in_bytes": used, "memory.stat": counts}
    return {f"{group}{name}": f"{text}\n" for name, text in names.items()}


@pytest.mark.parametrize(
    ("files", "free"),
    [
        ([], FREE),
        ([V2], FREE),
        ([V2, memory2(f"{GROUP2}box/", "max", 7_000_000)], FREE),
        ([V2, memory2(f"{GROUP2}box/", 5_000_000, 1_000_000)], 4_000_000),
        # Cached files can be evicted; files in a memory file system cannot.
        (
            [V2, memory2(f"{GROUP2}box/", 5_000_000, 4_900_000,
                         anon=1_000_000, file=3_500_000, shmem=500_000, inactive_file=2_000_000,
                         active_file=1_000_000, slab_reclaimable=100_000)],
            3_200_000,
        ),
        # The smallest limit on the way up, whichever group has it.
        ([V2, memory2(f"{GROUP2}box/", "max", 0), memory2(GROUP2, 3_000_000, 1_000_000)], 2_000_000),
        ([V2, memory2(f"{GROUP2}box/", 9_000_000, 0), memory2(GROUP2, 3_000_000, 1_000_000)], 2_000_000),
        ([V2, memory2(f"{GROUP2}box/", 1_500_000, 0), memory2(GROUP2, 3_000_000, 1_000_000)], 1_500_000),
        ([V2, memory2(f"{GROUP2}other/", 1_000, 0)], FREE),
        ([V2, memory2(f"{GROUP2}box/", "max", 500_000), {f"{GROUP2}box/memory.high": "2500000\n"}], 2_000_000),
        ([V2, memory2(f"{GROUP2}box/", 1_000_000, 1_200_000)], 0),
        ([V1, memory1(f"{GROUP1}box/", UNLIMITED, 7_000_000)], FREE),
        (
            [V1, memory1(f"{GROUP1}box/", 6_000_000, 4_000_000, cache=9, inactive_file=500_000, active_file=0,
                         total_inactive_file=1_000_000, total_active_file=2_000_000)],
            5_000_000,
        ),
        ([V1, memory1(f"{GROUP1}box/", UNLIMITED, 0), memory1(GROUP1, 4_000_000, 1_000_000)], 3_000_000),
        # Inside a container, with and without a separate view of the groups.
        (
            [V2, {"proc/self/cgroup": "0::/\n"}, memory2("sys/fs/cgroup/", 5_000_000, 1_000_000)],
            4_000_000,
        ),
        (
            [
                V1,
                {"proc/self/mountinfo": "3 1 0:32 /kubepods/pod7/box /sys/fs/my\\040groups ro - cgroup - ro,memory\n"},
                memory1("sys/fs/my groups/", 5_000_000, 1_000_000),
            ],
            4_000_000,
        ),
        ([V2, {f"{GROUP2}box/memory.max": "5000000\n"}], FREE),  # the usage is not reported
    ],
)  # fmt: skip
def test_the_memory_that_is_left(tmp_path: Path, files: list[Mapping[str, str]], free: float) -> None:
    assert available_memory(machine(tmp_path, *files)) == pytest.approx(0.9 * free)


def test_a_system_without_such_files_has_memory_and_processors(tmp_path: Path) -> None:
    assert available_memory(tmp_path) > 1e6
    assert processors(tmp_path) == len(os.sched_getaffinity(0)) >= processors() >= 1


@pytest.mark.parametrize(
    ("files", "count"),
    [
        ([V2, {f"{GROUP2}box/cpu.max": "max 100000\n"}], 64),
        ([V2, {f"{GROUP2}box/cpu.max": "300000 100000\n"}], 3),
        ([V2, {f"{GROUP2}box/cpu.max": "150000 100000\n"}], 2),
        ([V2, {f"{GROUP2}box/cpu.max": "1000 100000\n"}], 1),
        ([V2, {f"{GROUP2}box/cpu.max": "max 100000\n", f"{GROUP2}cpu.max": "200000 50000\n"}], 4),
        ([V2, {f"{GROUP2}box/cpu.max": "900000 10000\n", f"{GROUP2}cpu.max": "200000 50000\n"}], 4),
        ([V1, {f"{PROCESSOR1}box/cpu.cfs_quota_us": "-1\n", f"{PROCESSOR1}box/cpu.cfs_period_us": "100000\n"}], 64),
        ([V1, {f"{PROCESSOR1}box/cpu.cfs_quota_us": "250000\n", f"{PROCESSOR1}box/cpu.cfs_period_us": "100000\n"}], 3),
        ([V1, {f"{PROCESSOR1}cpu.cfs_quota_us": "250000\n", f"{PROCESSOR1}cpu.cfs_period_us": "100000\n"}], 3),
        ([V1, {f"{GROUP1}box/cpu.cfs_quota_us": "1000\n", f"{GROUP1}box/cpu.cfs_period_us": "1000\n"}], 64),
    ],
)  # fmt: skip
def test_the_processors_that_may_be_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, files: list[Mapping[str, str]], count: int
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(64)), raising=False)
    assert processors(machine(tmp_path, *files)) == count


def test_those_that_a_process_is_confined_to() -> None:
    before = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {min(before)})
        assert processors() == 1
    finally:
        os.sched_setaffinity(0, before)


def test_megabytes_are_millions_of_bytes() -> None:
    most = peak_memory_mb()
    block = np.ones(50_000_000, dtype=np.uint8)
    used = used_mb()
    assert used is not None
    assert used > 50
    assert peak_memory_mb() >= max(most, used)
    mapped = used_mb("VmSize")
    assert mapped is not None
    before = resource.getrlimit(resource.RLIMIT_AS)
    with memory_limit(used + 100):
        assert resource.getrlimit(resource.RLIMIT_AS)[0] == pytest.approx((mapped + 100) * 1e6, abs=20e6)
        with pytest.raises(MemoryError):
            np.ones(150_000_000, dtype=np.uint8)
    assert resource.getrlimit(resource.RLIMIT_AS) == before
    assert len(block) == 50_000_000
