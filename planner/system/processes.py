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
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

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


def python(module: str, *arguments: str) -> list[str]:
    """Return the command that runs a module as a program, from where this process would import it.

    Files and folders of the working directory do not stand in for modules of the same names, and settings in the
    environment (`PYTHONPATH`, `PYTHONWARNINGS`, ...) have no effect of their own.
    """
    path, own = [entry for entry in sys.path if entry], str(Path(__file__).parents[2])
    if own not in path:
        path.insert(0, own)
    if "" in sys.path:  # of an interactive session; last, so that it adds modules and replaces none
        path.append(str(Path.cwd()))
    code = (
        f"import runpy, sys; sys.path[:] = {path!a}; runpy.run_module({module!a}, run_name='__main__', alter_sys=True)"
    )
    quiet = ["-B"] if sys.dont_write_bytecode else []
    return [sys.executable, "-I", "-u", *quiet, "-c", code, *arguments]


@contextmanager
def safe_path() -> Iterator[None]:
    """Let Python programs that are started meanwhile import nothing from the working directory.

    This is for `multiprocessing`, whose programs are started by name and import modules before they know the path.
    """
    before = os.environ.get("PYTHONSAFEPATH")
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop("PYTHONSAFEPATH", None)
        else:
            os.environ["PYTHONSAFEPATH"] = before


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
