"""The same work on many things: in processes of this machine, or on a cluster.

`outcomes` hands out the work and gives back what has ended, as it ends. Processes of this machine do not outlive the
one that asked.
"""

from __future__ import annotations

import os
import pickle
import signal
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, as_completed
from contextlib import closing, contextmanager, nullcontext
from multiprocessing import active_children, get_context, resource_tracker
from typing import TYPE_CHECKING, Any, TypeVar

from . import processes
from .errors import MissingExtraError
from .progress import UNSHOWN
from .progress_reports import Listener, Reporter

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

Item = TypeVar("Item")
Result = TypeVar("Result")


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
        Processes of this machine, each a new interpreter.
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
    with nullcontext() if listener is None else closing(listener), processes.safe_path():
        if items:
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
    """Begin a worker process, which shows nothing by itself on the terminal that it shares."""
    global _pipe
    os.environ[UNSHOWN] = "0"
    processes.join(group)
    _pipe = pipe


def _carry_out(work: Callable[..., Result], number: int, item: Item, *arguments: Any) -> Result:
    """Do one thing in a worker process."""
    if _pipe is not None:
        arguments = (*arguments, Reporter(_pipe.fileno(), number))
    try:
        return _sendable(work(item, *arguments))
    except Exception as error:  # noqa: BLE001  raised in the other process
        raise _sendable(error) from None
    except BaseException as error:  # noqa: BLE001  SystemExit, for instance; the pool would wait for a result for ever
        raise WorkerDiedError(f"the worker process was ended by {error!r}") from None


def _sendable(outcome: Result) -> Result:
    """Return the result of some work, or its exception, if another process can read it.

    Raises
    ------
    WorkerDiedError
        It cannot be pickled, or not be read again.
    """
    try:
        pickle.loads(pickle.dumps(outcome))
    except Exception as error:  # noqa: BLE001  whatever the classes of the outcome do when they are pickled
        raise WorkerDiedError(f"{outcome!r} cannot be sent to another process: {error}") from None
    return outcome


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
