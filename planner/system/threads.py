"""Parallel work on threads that is robust against a lack of memory for new threads.

`ThreadPoolExecutor` may wait forever for a thread that could not start for lack of memory, or that could not report its
end. Here, no thread is awaited that has not started. The caller's thread works too, and does all that the others leave.
"""

from __future__ import annotations

import _thread
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from threading import Event
from typing import TypeVar

NO_MORE_THREADS = "can't start new thread"
"""Message of Python's `RuntimeError` where there is too little memory, or another resource, for a thread."""

S = TypeVar("S")
T = TypeVar("T")


def on_threads(work: Callable[[S], T], parts: Iterable[S], threads: int, over: Event | None = None) -> list[T]:
    """Apply a function to each part on at most `threads` threads, the caller's included. Return the results in order.

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
    found: dict[int, T] = {}
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
