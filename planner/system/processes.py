"""Child processes that never outlive the process that started them, and work on many items in processes or threads.

Each process that starts children has a guard: a shell that reads from a pipe. The other end of the pipe is open in that
process only. When the process ends, even if it is killed or crashes, the system closes the pipe, and the guard kills
its own process group. A child joins this group before its program begins. There is thus no moment at which it could be
missed: if the guard has already ended, its group is gone, and nothing can be started in it. A parent-death signal works
on Linux only, and it leaves such a moment. It is also sent when the *thread* that started the child ends.

`outcomes` distributes work on many items, among processes of this machine or on a cluster, and yields results in the
order of completion. Each worker has one pipe, on which its progress comes before the result that it leads to.
`on_threads` does work on threads, robust against a lack of memory for new threads.
"""

from __future__ import annotations

import _thread
import os
import pickle
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from .errors import MissingExtraError
from .progress import UNSHOWN

if TYPE_CHECKING:
    from multiprocessing.connection import Connection


Item = TypeVar("Item")
Result = TypeVar("Result")

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


def outcomes(
    work: Callable[..., Result],
    items: Sequence[Item],
    arguments: Sequence[Any] = (),
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    timeout: float | None = None,
    hear: Callable[..., None] | None = None,
) -> Generator[tuple[Item, Result | Exception]]:
    """Yield each item with `work(item, *arguments)`, or with the exception that was raised.

    The work is a module-level function, so that other processes can import it; items and arguments are picklable.
    It is done by `jobs` processes of this machine, each a new interpreter, or by the workers of a Dask `scheduler`
    at an address. Workers of a cluster must see the same files at the same paths, and run one thread each. After
    `timeout` seconds, a process of this machine is stopped, and its item is yielded with a `TimeoutError`. With
    `jobs=0`, a fork of this process does the work: it starts at once, and this process survives it. Where a fork is
    not safe, since this process has other threads or compiled code, this process does the work itself, without a
    timeout.

    `hear` is called with an item and the values that its work reports, while the next outcome is waited for. The work
    then receives a function that reports picklable values as an additional last argument; what it has reported is heard
    even if its process dies. Workers of a cluster do not report.
    """
    if scheduler is not None:
        return _on_cluster(work, items, arguments if hear is None else (*arguments, _unheard), scheduler)
    if jobs == 0 and not _may_fork():
        return _here(work, items, arguments, hear)
    return _in_processes(work, items, arguments, jobs, timeout, hear)


def _unheard(*_: Any) -> None:
    """Report nothing."""


def _here(
    work: Callable[..., Result], items: Sequence[Item], arguments: Sequence[Any], hear: Callable[..., None] | None
) -> Generator[tuple[Item, Result | Exception]]:
    for item in items:
        outcome: Any
        try:
            outcome = work(item, *arguments, *([] if hear is None else [partial(hear, item)]))
        except Exception as error:  # noqa: BLE001  as in a worker
            outcome = error
        yield item, outcome


def _may_fork() -> bool:
    """Whether a fork of this process can do any work: a fork has no other threads, nor those of compiled code."""
    return sys.platform == "linux" and threading.active_count() == 1 and "numba" not in sys.modules


def _in_processes(
    work: Callable[..., Result],
    items: Sequence[Item],
    arguments: Sequence[Any],
    jobs: int,
    timeout: float | None,
    hear: Callable[..., None] | None,
) -> Generator[tuple[Item, Result | Exception]]:
    from multiprocessing.connection import wait

    workers: list[_Worker] = []
    waiting = deque(range(len(items)))
    with safe_path():
        begin = (work, arguments, guarded_group(), hear is not None)
        try:
            while waiting or workers:
                while waiting and len(workers) < max(1, jobs):
                    forked = jobs == 0 and _may_fork()
                    workers.append(_Worker(begin, waiting.popleft(), items, timeout, forked=forked))
                left = min(worker.deadline for worker in workers) - time.monotonic()
                said = wait([worker.connection for worker in workers], None if left == inf else max(0.0, left))
                for worker in list(workers):
                    worker.stop_if_late()
                    if worker.connection not in said:
                        continue
                    (what, value), number, heard = worker.received(), worker.number, time.monotonic()
                    if what == BEGUN:
                        worker.give(number)
                    elif what == REPORT and hear is not None:
                        hear(items[number], *value)
                    elif what == OUTCOME:
                        if worker.ended or not waiting:
                            workers.remove(worker)
                            worker.end()
                        else:
                            worker.give(waiting.popleft())
                        yield items[number], value
                    for other in workers:  # which may have waited for the caller to hear their reports
                        other.deadline += time.monotonic() - heard
        finally:  # what is still at work was left by an exception
            for worker in workers:
                worker.kill()
            for worker in workers:
                worker.end()


BEGUN, REPORT, OUTCOME = "begun", "report", "outcome"
"""What a worker sends, each with a value: once that it has begun, then reports and an outcome of each item."""


class _Worker:
    """A process of this machine that works on one item at a time; `number` is that of its item."""

    def __init__(
        self, begin: tuple[Any, ...], number: int, items: Sequence[Any], timeout: float | None, *, forked: bool
    ) -> None:
        from multiprocessing import Pipe, get_context, resource_tracker  # only where there are processes

        if not forked:
            resource_tracker.ensure_running()  # otherwise the first worker starts it, and unblocks Ctrl-C
        self.number, self.deadline, self.ended = number, inf, False
        self._items, self._timeout, self._late = items, timeout, False
        self.connection, other = Pipe()
        context: Any = get_context("fork" if forked else "spawn")
        self._process = context.Process(target=_serve, args=(other, forked, *begin), daemon=True)
        with other, _interrupts_left_to_this_process():
            self._process.start()

    def give(self, number: int) -> None:
        """Let the process, which has nothing to do, work on an item."""
        self.number = number
        self.deadline = inf if self._timeout is None else time.monotonic() + self._timeout
        with suppress(OSError):  # it has died, which `received` finds
            self.connection.send(self._items[number])

    def received(self) -> tuple[str, Any]:
        """Return what the process has sent; its end is the outcome of its item."""
        try:
            sent: tuple[str, Any] = self.connection.recv()
        except (EOFError, OSError):
            self._process.join()
            self.ended = True
            if self._late:
                return OUTCOME, TimeoutError(f"it took more than {self._timeout:g} s")
            code = self._process.exitcode
            return OUTCOME, ChildProcessError(f"the worker process died with exit code {code}, probably out of memory")
        return sent

    def stop_if_late(self) -> None:
        """Stop the process if the time for its item is over; what it has sent by then is still received."""
        if time.monotonic() >= self.deadline:
            self.deadline, self.ended, self._late = inf, True, True
            self.kill()

    def kill(self) -> None:
        """Stop the process at its work."""
        self._process.kill()

    def end(self) -> None:
        """End the process, which has nothing to do or was killed."""
        self._process.terminate()
        self._process.join(3.0)
        self._process.kill()  # where it ignores that it was asked
        self._process.join()
        self.connection.close()


def _serve(
    connection: Connection, forked: bool, work: Callable[..., Any], arguments: Sequence[Any], group: int, heard: bool
) -> None:
    """Work on items in a process that shares the terminal, and shows no progress of its own."""
    os.environ[UNSHOWN] = "0"
    join(group)
    if forked:  # it has the other process's ways to end
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
    os.set_inheritable(connection.fileno(), False)  # its end is seen when this process ends
    one_at_a_time = threading.Lock()

    def report(*values: Any) -> None:
        with suppress(OSError), one_at_a_time:  # the other process has ended
            connection.send((REPORT, values))

    with suppress(EOFError, OSError):  # the other process has ended
        connection.send((BEGUN, None))
        while True:
            outcome = _outcome(work, connection.recv(), *arguments, *([report] if heard else []))
            with one_at_a_time:
                connection.send((OUTCOME, outcome))


def _outcome(work: Callable[..., Any], *arguments: Any) -> Any:
    """Return the result of some work, or its exception, as another process can receive it."""
    outcome: Any
    try:
        outcome = work(*arguments)
    except Exception as error:  # noqa: BLE001  a failure of one item does not stop the others
        outcome = error
    except BaseException as error:  # noqa: BLE001  SystemExit, for instance
        return ChildProcessError(f"the worker process was ended by {error!r}")
    try:
        pickle.loads(pickle.dumps(outcome))
    except Exception as error:  # noqa: BLE001  pickling may run any code of the outcome's classes
        return ChildProcessError(f"{outcome!r} cannot be sent to another process: {error}")
    return outcome


def _on_cluster(
    work: Callable[..., Result], items: Sequence[Item], arguments: Sequence[Any], scheduler: str
) -> Generator[tuple[Item, Result | Exception]]:
    try:
        from distributed import Client, KilledWorker
        from distributed import as_completed as as_completed_on_cluster
    except ImportError:
        raise MissingExtraError("a cluster needs", "Dask", "cluster") from None

    with Client(scheduler) as client:
        futures = {client.submit(work, item, *arguments, pure=False): item for item in items}
        try:
            for future in as_completed_on_cluster(list(futures)):
                outcome: Any
                try:
                    outcome = future.result()
                except KilledWorker:
                    outcome = ChildProcessError("its workers died, probably out of memory")
                except Exception as error:  # noqa: BLE001  as above
                    outcome = error
                yield futures[future], outcome
        finally:
            client.cancel(list(futures))


@contextmanager
def _interrupts_left_to_this_process() -> Iterator[None]:
    """Block Ctrl-C for threads and processes that start within the context, from their start on."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


NO_MORE_THREADS = "can't start new thread"
"""Message of Python's `RuntimeError` where there is too little memory, or another resource, for a thread."""


def on_threads(
    work: Callable[[Item], Result], parts: Iterable[Item], threads: int, over: threading.Event | None = None
) -> list[Result]:
    """Apply a function to each part on at most `threads` threads, the caller's included. Return the results in order.

    `ThreadPoolExecutor` may wait forever for a thread that could not start for lack of memory, or that could not report
    its end. Here, no thread is awaited that has not started. The caller's thread works too, and does all that the
    others leave.

    No thread is still working when this returns or raises, even after Ctrl-C. The event `over` is set as soon as there
    is an exception, so that long work on other threads can stop early.

    Raises
    ------
    MemoryError
        A thread ended during its work without an exception.
    Exception
        The first exception of `work`. No further part is started after it.
    """
    waiting = deque(enumerate(parts))
    parts_to_do = len(waiting)
    found: dict[int, Result] = {}
    failures: list[BaseException] = []

    def fail(error: BaseException) -> None:
        failures.append(error)
        if over is not None:
            over.set()

    def do_what_waits() -> None:
        try:
            while waiting and not failures:
                try:
                    number, part = waiting.popleft()
                except IndexError:  # another thread has taken the last one
                    return
                found[number] = work(part)
        except BaseException as error:  # noqa: BLE001  raised in the caller's thread
            fail(error)

    def help_out(at_work: _thread.LockType) -> None:
        if at_work.acquire(blocking=False):  # otherwise the caller holds it: all parts are done
            try:
                do_what_waits()
            finally:
                at_work.release()

    helpers = [_thread.allocate_lock() for _ in range(min(threads, parts_to_do) - 1)]
    begun = False
    while True:
        try:
            if not begun:
                begun = True
                with suppress(RuntimeError):  # `NO_MORE_THREADS`
                    for at_work in helpers:
                        _thread.start_new_thread(help_out, (at_work,))
                do_what_waits()
            for at_work in helpers:
                with at_work:
                    pass
            break
        except BaseException as error:  # noqa: BLE001  raised below, once all helpers have stopped; Ctrl-C included
            fail(error)
    if failures:
        raise failures[0]
    if len(found) < parts_to_do:
        raise MemoryError
    return [found[number] for number in range(parts_to_do)]
