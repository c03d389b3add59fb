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
_guard: tuple[int, int] | None = None
"""The group of this process, and the end of the pipe that its guard reads from."""


def guarded_group() -> int:
    """Return the process group that is killed when this process is gone; its guard is started if there is none yet.

    Processes are put into it by `process_group` of `subprocess.Popen`, or join it by `join`.
    """
    global _guard
    with _lock:
        if _guard is None:
            _guard = _start_guard()
        return _guard[0]


def _forget_guard() -> None:
    """Close the pipe in a fork, which would keep it open after its parent's end; a fork has a guard of its own."""
    global _guard, _lock
    _lock = threading.Lock()  # another thread of the parent may have held it
    if _guard is not None:
        os.close(_guard[1])
    _guard = None


os.register_at_fork(after_in_child=_forget_guard)


def join(group: int) -> None:
    """Put this process into a group that another one guards, or end at once if the group is gone already."""
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
