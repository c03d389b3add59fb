"""Child processes that never outlive the process that started them, even if it is killed or crashes.

Each process that starts children has a guard: a shell that reads from a pipe. The other end of the pipe is open in that
process only. When the process ends, the system closes the pipe, and the guard kills its own process group. A child
joins this group before its program begins. There is thus no moment at which it could be missed: if the guard has
already ended, its group is gone, and nothing can be started in it. A parent-death signal works on Linux only, and it
leaves such a moment. It is also sent when the *thread* that started the child ends.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_lock = threading.Lock()
_guard: tuple[int, int] | None = None
"""Process group of the guard, and the end of the pipe that this process holds open."""


def guarded_group() -> int:
    """Return the process group that is killed when this process ends; the first call starts its guard.

    Children are put into it by `process_group` of `subprocess.Popen`, or they call `join`.
    """
    global _guard
    with _lock:
        if _guard is None:
            _guard = _start_guard()
        return _guard[0]


def _forget_guard() -> None:
    """Close the inherited pipe in a fork, which would keep it open after the parent's end.

    A fork starts its own guard.
    """
    global _guard, _lock
    _lock = threading.Lock()  # another thread of the parent may hold the inherited lock
    if _guard is not None:
        os.close(_guard[1])
    _guard = None


os.register_at_fork(after_in_child=_forget_guard)


def join(group: int) -> None:
    """Move this process into a group that another process guards, or exit at once if the group no longer exists."""
    try:
        os.setpgid(0, group)
    except OSError:  # the guard has ended, and its group with it
        os._exit(1)


def python(module: str, *arguments: str) -> list[str]:
    """Return the command that runs a module as a program, found on the import path of this process.

    Files in the working directory do not shadow modules, and environment settings (`PYTHONPATH`, `PYTHONWARNINGS`, ...)
    are ignored.
    """
    path, own = [entry for entry in sys.path if entry], str(Path(__file__).parents[2])
    if own not in path:
        path.insert(0, own)
    if "" in sys.path:  # an interactive session; at the end, where it shadows no module
        path.append(str(Path.cwd()))
    code = (
        f"import runpy, sys; sys.path[:] = {path!a}; runpy.run_module({module!a}, run_name='__main__', alter_sys=True)"
    )
    quiet = ["-B"] if sys.dont_write_bytecode else []
    return [sys.executable, "-I", "-u", *quiet, "-c", code, *arguments]


@contextmanager
def safe_path() -> Iterator[None]:
    """Keep Python programs that are started within the context from importing from the working directory.

    This is for `multiprocessing`, whose programs import modules before they receive the import path.
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
    reading, writing = os.pipe()  # other programs do not inherit it
    silent = [(os.POSIX_SPAWN_OPEN, number, os.devnull, os.O_WRONLY, 0) for number in (1, 2)]
    try:
        guard = os.posix_spawn(
            "/bin/sh",
            ("/bin/sh", "-c", "read _; kill -KILL 0"),  # waits for the end of the pipe, then kills the process group
            {},
            file_actions=[(os.POSIX_SPAWN_DUP2, reading, 0), *silent],
            setpgroup=0,
            setsigmask=(),
            setsigdef=(signal.SIGPIPE,),
        )
    finally:
        os.close(reading)
    return guard, writing
