"""The same work on many items, in processes of this machine or on a cluster.

`outcomes` distributes the work and yields results in the order of completion. Worker processes do not outlive the
process that started them. They report their progress through a pipe, by a `Reporter`. Writing never blocks: a report is
lost if the pipe is full or closed.
"""

from __future__ import annotations

import json
import os
import pickle
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from math import inf
from multiprocessing import Pipe, get_context, resource_tracker
from typing import TYPE_CHECKING, Any, TypeVar

from . import processes
from .errors import MissingExtraError
from .progress import UNSHOWN

if TYPE_CHECKING:
    from multiprocessing.connection import Connection


Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Reporter:
    """Reports the progress of one item of work, by its number, to a pipe, or to nobody if there is no listener."""

    pipe: int | None
    number: int

    def __call__(self, *report: Any) -> None:
        """Report values that JSON can represent."""
        # Largest report in bytes. POSIX guarantees that writes of up to 512 bytes to a pipe are atomic; longer
        # reports are lost.
        longest = 512
        line = json.dumps([self.number, *report]).encode() + b"\n"
        if self.pipe is not None and len(line) <= longest:
            with suppress(OSError):  # the pipe is closed or full
                os.write(self.pipe, line)


class Listener:
    """Receives reports in a thread, from `start` to `close`.

    Reporters write to `pipe` without blocking. Worker processes get a copy of this descriptor.
    """

    def __init__(self, hear: Callable[..., None]) -> None:
        """Create the pipe. `hear` will be called with the number of the item and the reported values."""
        self._reading, self.pipe = os.pipe()
        os.set_blocking(self.pipe, False)
        self._thread = threading.Thread(target=self._listen, args=(hear,), daemon=True)

    def start(self) -> None:
        """Start the thread that receives reports, unless it has begun. Ctrl-C is left to other threads."""
        if self._thread.ident is None:
            with _interrupts_left_to_this_process():
                self._thread.start()

    def close(self) -> None:
        """Receive the reports that were sent, and stop.

        It waits at most one second if another process still holds a copy of the pipe.
        """
        os.close(self.pipe)
        if self._thread.ident is not None:
            self._thread.join(1.0)
        else:
            os.close(self._reading)

    def _listen(self, hear: Callable[..., None]) -> None:
        with os.fdopen(self._reading, encoding="utf-8") as lines:
            for line in lines:
                hear(*json.loads(line))


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

    `hear` is called in a thread with an item and the values that its work reports. The work then receives a `Reporter`
    as an additional last argument. Workers of a cluster do not report.
    """
    if scheduler is not None:
        return _on_cluster(work, items, arguments if hear is None else (*arguments, Reporter(None, 0)), scheduler)
    if jobs == 0 and not _may_fork():
        return _here(work, items, arguments, hear)
    return _in_processes(work, items, arguments, jobs, timeout, hear)


def _here(
    work: Callable[..., Result], items: Sequence[Item], arguments: Sequence[Any], hear: Callable[..., None] | None
) -> Generator[tuple[Item, Result | Exception]]:
    for item in items:
        outcome: Any
        try:
            outcome = work(item, *arguments, *([] if hear is None else [partial(hear, item)]))
        except Exception as error:  # noqa: BLE001  as in a pool
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
    from multiprocessing.connection import Connection, wait

    listener = None if hear is None else Listener(lambda number, *report: hear(items[number], *report))
    workers: list[_Worker] = []
    waiting = deque(range(len(items)))
    with (
        nullcontext() if listener is None else closing(listener),
        nullcontext() if listener is None else Connection(os.dup(listener.pipe), readable=False) as pipe,
        processes.safe_path(),
    ):
        begin = (work, arguments, processes.guarded_group(), pipe)
        try:
            while waiting or workers:
                while waiting and len(workers) < max(1, jobs):
                    forked = jobs == 0 and _may_fork()
                    workers.append(_Worker(begin, waiting.popleft(), items, timeout, forked=forked))
                if listener is not None:
                    listener.start()  # after a fork, which has no other threads
                left = min(worker.deadline for worker in workers) - time.monotonic()
                heard = wait([worker.connection for worker in workers], None if left == inf else max(0.0, left))
                for worker in list(workers):
                    done, number = worker.outcome(worker.connection in heard), worker.number
                    if not done:
                        continue
                    if worker.ended or not waiting:
                        workers.remove(worker)
                        worker.end()
                    else:
                        worker.give(waiting.popleft())
                    yield items[number], done[0]
        finally:  # what is still at work was left by an exception
            for worker in workers:
                worker.kill()
            for worker in workers:
                worker.end()


class _Worker:
    """A process of this machine that works on one item at a time; `number` is that of its item.

    It sends an empty tuple when it has started, and then a tuple of one outcome for each item that it is given.
    """

    def __init__(
        self, begin: tuple[Any, ...], number: int, items: Sequence[Any], timeout: float | None, *, forked: bool
    ) -> None:
        if not forked:
            resource_tracker.ensure_running()  # otherwise the first worker starts it, and unblocks Ctrl-C
        self.number, self.deadline, self.ended = number, inf, False
        self._items, self._timeout = items, timeout
        self.connection, other = Pipe()
        context: Any = get_context("fork" if forked else "spawn")
        self._process = context.Process(target=_serve, args=(other, forked, *begin), daemon=True)
        with other, _interrupts_left_to_this_process():
            self._process.start()

    def give(self, number: int) -> None:
        """Let the process, which has nothing to do, work on an item."""
        self.number = number
        self.deadline = inf if self._timeout is None else time.monotonic() + self._timeout
        with suppress(OSError):  # it has died, which `outcome` finds
            self.connection.send((number, self._items[number]))

    def outcome(self, heard: bool) -> tuple[Any, ...]:
        """Return a tuple of the outcome of its item, empty if it is still at work; `heard` is whether it has sent."""
        try:
            if heard:
                done: tuple[Any, ...] = self.connection.recv()
                if not done:
                    self.give(self.number)
                return done
        except (EOFError, ConnectionResetError):
            self._process.join()
            self.ended = True
            return (_died(self._process.exitcode or 0),)
        if time.monotonic() < self.deadline:
            return ()
        self.kill()
        self.ended = True
        return (TimeoutError(f"it took more than {self._timeout:g} s"),)

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
    connection: Connection,
    forked: bool,
    work: Callable[..., Any],
    arguments: Sequence[Any],
    group: int,
    pipe: Connection | None,
) -> None:
    """Work on items in a process that shares the terminal, and shows no progress of its own."""
    os.environ[UNSHOWN] = "0"
    processes.join(group)
    if forked:  # it has the other process's ways to end
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
    for given in (connection, pipe):
        if given is not None:
            os.set_inheritable(given.fileno(), False)  # its end is seen when this process ends
    with suppress(EOFError, OSError):  # the other process has ended
        connection.send(())
        while True:
            number, item = connection.recv()
            reports = () if pipe is None else (Reporter(pipe.fileno(), number),)
            connection.send((_outcome(work, item, *arguments, *reports),))


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


def _died(code: int) -> ChildProcessError:
    return ChildProcessError(f"the worker process died with exit code {code}, probably out of memory")


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
