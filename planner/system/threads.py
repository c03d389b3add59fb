"""Work on several threads, also where there may be no memory for one to begin.

`ThreadPoolExecutor` waits for ever for a thread that finds no memory to begin, and for what one was doing that found
none to tell of its end. Here no thread is waited for that has not begun: the caller works, too, and does what others
leave.
"""

from __future__ import annotations

import _thread
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import TypeVar

NO_MORE_THREADS = "can't start new thread"
"""What Python's `RuntimeError` says where there is too little memory, or whatever else a thread needs."""

S = TypeVar("S")
T = TypeVar("T")


def on_threads(work: Callable[[S], T], parts: Iterable[S], threads: int) -> list[T]:
    """Do a piece of work for each part on so many threads, of which the caller's is one; return all results in order.

    No thread works any more when this returns or raises, also where Ctrl-C has interrupted it.

    Raises
    ------
    MemoryError
        A thread ended in the middle of its work without a word.
    Exception
        What the first piece that failed has raised; no other is begun after that.
    """
    waiting = deque(enumerate(parts))
    parts_to_do = len(waiting)
    found: dict[int, T] = {}
    failures: list[BaseException] = []

    def do_what_waits() -> None:
        try:
            while waiting and not failures:
                try:
                    number, part = waiting.popleft()
                except IndexError:  # another thread has taken the last one
                    return
                found[number] = work(part)
        except BaseException as error:  # noqa: BLE001  the caller raises it
            failures.append(error)

    def help_out(at_work: _thread.LockType) -> None:
        if at_work.acquire(blocking=False):  # all is done otherwise
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
        except BaseException as error:  # noqa: BLE001  raised below, once no helper works any more; Ctrl-C as well
            failures.append(error)
    if failures:
        raise failures[0]
    if len(found) < parts_to_do:
        raise MemoryError
    return [found[number] for number in range(parts_to_do)]
