"""Processes that do not outlive the one that started them, however it went: ended, interrupted, killed or crashed.

Each process that starts others has a guard: a shell that reads from a pipe, whose other end is open in that process
only. When it is gone, the system closes the pipe, and the guard kills its own process group. What is to go with the
process is in that group from before its program begins, so that there is no moment at which it could be missed: if
the guard has gone by then, so has the group, and nothing can be started in it. A parent-death signal would do the same
on Linux only, has that moment, and is sent already when the *thread* ends that started the process.
"""

from __future__ import annotations

import os
import signal
import threading

GUARD = ("/bin/sh", "-c", "read _; kill -KILL 0")

_lock = threading.Lock()
_groups: dict[int, tuple[int, int]] = {}  # of each process, since a fork inherits this: its group, and the pipe's end


def guarded_group() -> int:
    """Give the process group that is killed when this process is gone; its guard is started if there is none yet.

    Processes are put into it by `process_group` of `subprocess.Popen`, or join it by `join`.
    """
    with _lock:
        if os.getpid() not in _groups:
            _groups.clear()
            _groups[os.getpid()] = _start_guard()
        return _groups[os.getpid()][0]


def join(group: int) -> None:
    """Put this process into a group that another one guards, or end at once if that one is gone already."""
    try:
        os.setpgid(0, group)
    except OSError:  # without its guard there is no such group
        os._exit(1)


def _start_guard() -> tuple[int, int]:
    reading, writing = os.pipe()  # which no other program inherits
    silent = [(os.POSIX_SPAWN_OPEN, number, os.devnull, os.O_WRONLY, 0) for number in (1, 2)]
    try:
        guard = os.posix_spawn(
            GUARD[0],
            GUARD,
            {},
            file_actions=[(os.POSIX_SPAWN_DUP2, reading, 0), *silent],
            setpgroup=0,
            setsigmask=(),
            setsigdef=(signal.SIGPIPE,),
        )
    finally:
        os.close(reading)
    return guard, writing
