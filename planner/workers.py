"""The same work on many things: in processes of this machine, or on a cluster.

`outcomes` hands out the work and gives back what has ended, as it ends. Processes of this machine do not outlive the
one that asked.
"""

from __future__ import annotations

import os
import pickle
import select
import signal
import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, as_completed
from contextlib import closing, contextmanager, nullcontext
from functools import partial
from multiprocessing import active_children, get_context, resource_tracker
from typing import TYPE_CHECKING, Any, TypeVar

from . import processes
from .errors import MissingExtraError
from .reports import Listener, Reporter

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

Item = TypeVar("Item")
Result = TypeVar("Result")

LARGE = {"numpy", "numba", "unified_planning"}
"""Packages that start threads, or make a copy of the process as slow as a new one."""


class WorkerDiedError(RuntimeError):
    """A process that ended in the middle of its work."""


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
    """Give each item with `work(item, *arguments)`, or with the exception that it ended in.

    Parameters
    ----------
    work : callable
        A function of a module, so that other processes find it.
    items, arguments : sequence
        What can be pickled.
    jobs : int
        Processes of this machine, started anew.
    scheduler : str, optional
        Address of a Dask scheduler whose workers do it instead. They have to see the same files at the same paths,
        and run one thread each.
    timeout : float, optional
        Seconds after which a process of this machine is stopped; the item then comes with a `TimeoutError`.
    hear : callable, optional
        Called, in a thread, with an item and with what the work on it reports meanwhile; for that the work takes one
        more argument, a `Reporter`. Nothing is heard of a cluster.

    Raises
    ------
    MissingExtraError
        A cluster is asked for, and the extra `cluster` is not installed.
    """
    if scheduler is not None:
        return _on_cluster(work, items, arguments if hear is None else (*arguments, Reporter(None, 0)), scheduler)
    listener = None if hear is None else Listener(lambda number, *report: hear(items[number], *report))
    return _in_processes(work, items, arguments, jobs, timeout, listener)


def _in_processes(
    work: Callable[..., Result],
    items: Sequence[Item],
    arguments: Sequence[Any],
    jobs: int,
    timeout: float | None,
    listener: Listener | None,
) -> Generator[tuple[Item, Result | Exception]]:
    with nullcontext() if listener is None else closing(listener):
        if len(items) == 1 and LARGE.isdisjoint(sys.modules):
            if listener is not None:
                arguments = (*arguments, Reporter(listener.pipe, 0))
            yield items[0], _in_a_fork(partial(work, items[0], *arguments), timeout, listener)
        elif items:
            yield from _in_a_pool(work, items, arguments, jobs, timeout, listener)


def _in_a_pool(
    work: Callable[..., Result],
    items: Sequence[Item],
    arguments: Sequence[Any],
    jobs: int,
    timeout: float | None,
    listener: Listener | None,
) -> Generator[tuple[Item, Result | Exception]]:
    from multiprocessing.connection import Connection

    from pebble import ProcessExpired, ProcessPool

    # Started by the first worker otherwise, in the thread that starts all of them, where it lets Ctrl-C through again.
    resource_tracker.ensure_running()
    others = set(active_children())
    pipe = None if listener is None else Connection(os.dup(listener.pipe), readable=False)
    pool = ProcessPool(
        max_workers=min(jobs, len(items)),
        context=get_context("spawn"),
        initializer=_begin,
        initargs=(processes.guarded_group(), pipe),
    )
    try:
        with _interrupts_left_to_this_process():
            futures: dict[Future[Result], Item] = {
                pool.schedule(_carry_out, args=(work, number, item, *arguments), timeout=timeout): item
                for number, item in enumerate(items)
            }
            if listener is not None:
                listener.start()
        for future in as_completed(futures):
            outcome: Any
            try:
                outcome = future.result()
            except ProcessExpired as error:
                outcome = _died(error.exitcode)
            except Exception as error:  # noqa: BLE001  what went wrong with one item is not to stop the others
                outcome = error
            yield futures[future], outcome
        pool.close()  # type: ignore[no-untyped-call]
    except BaseException:
        for worker in set(active_children()) - others:
            worker.kill()  # at once: `stop` gives each one three seconds, and their work is not wanted
        pool.stop()  # type: ignore[no-untyped-call]
        raise
    finally:
        pool.join()
        if pipe is not None:
            pipe.close()


_pipe: Connection | None = None  # of a worker, which is handed it as it begins


def _begin(group: int, pipe: Connection | None) -> None:
    """Begin a worker process."""
    global _pipe
    processes.join(group)
    _pipe = pipe


def _carry_out(work: Callable[..., Result], number: int, item: Item, *arguments: Any) -> Result:
    """Do one thing in a worker process."""
    return work(item, *arguments) if _pipe is None else work(item, *arguments, Reporter(_pipe.fileno(), number))


def _in_a_fork(work: Callable[[], Result], timeout: float | None, listener: Listener | None) -> Result | Exception:
    """Do one thing in a copy of this process, which starts in no time."""
    group = processes.guarded_group()
    reading, writing = os.pipe()
    with _interrupts_left_to_this_process():
        child = os.fork()
        if child == 0:
            processes.join(group)
            os.close(reading)
            with os.fdopen(writing, "wb") as stream:
                try:
                    outcome: Any = work()
                except Exception as error:  # noqa: BLE001  as with several
                    outcome = error
                pickle.dump(outcome, stream)
            os._exit(0)
        if listener is not None:
            listener.start()
    os.close(writing)
    status = None
    try:
        with os.fdopen(reading, "rb") as stream:
            if not select.select([stream], [], [], timeout)[0]:
                return TimeoutError()
            told = stream.read()
        _, status = os.waitpid(child, 0)
    finally:
        if status is None:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
    return pickle.loads(told) if told else _died(os.waitstatus_to_exitcode(status))


def _died(code: int) -> WorkerDiedError:
    return WorkerDiedError(f"the worker process died with exit code {code}, probably out of memory")


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
                    outcome = WorkerDiedError("its workers died, probably out of memory")
                except Exception as error:  # noqa: BLE001  as above
                    outcome = error
                yield futures[future], outcome
        finally:
            client.cancel(list(futures))


@contextmanager
def _interrupts_left_to_this_process() -> Iterator[None]:
    """Block Ctrl-C for threads and processes that are started meanwhile, from their very beginning."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
