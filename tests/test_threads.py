"""Work on several threads: what each part comes to, also where threads do not begin, or end without a word."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable

import pytest

from planner.system import threads
from planner.system.threads import on_threads


def test_every_part_is_done_once_and_in_order() -> None:
    by, together = set[int](), threading.Barrier(3)

    def square(number: int) -> int:
        if number < 3:
            together.wait(60)  # three at a time, or never
        by.add(threading.get_ident())
        return number * number

    assert on_threads(square, range(50), 3) == [number * number for number in range(50)]
    assert 1 < len(by) <= 3
    assert on_threads(square, range(3, 5), 1) == [9, 16]
    assert on_threads(square, [], 4) == []


def test_what_fails_is_raised_and_nothing_is_begun_after_it() -> None:
    done = []

    def work(number: int) -> None:
        done.append(number)
        raise ValueError(f"part {number}")

    with pytest.raises(ValueError, match="part 0"):
        on_threads(work, range(100), 1)
    assert done == [0]
    with pytest.raises(ValueError, match="part "):
        on_threads(work, range(100), 3)
    assert len(done) < 10


def never(*_: object) -> int:
    """Say that a thread was started whose beginning then found no memory."""
    return 0


def refuse(*_: object) -> int:
    raise RuntimeError("can't start new thread")


@pytest.mark.parametrize("start", [never, refuse])
def test_threads_that_do_not_begin_are_not_waited_for(
    start: Callable[..., int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(threads._thread, "start_new_thread", start)
    assert on_threads(str, range(5), 3) == ["0", "1", "2", "3", "4"]


@pytest.mark.parametrize("when", ["at work", "waiting"])
def test_ctrl_c_leaves_no_thread_at_work(when: str) -> None:
    """The caller is interrupted in its own part, or while it waits for the part of another thread."""
    main, others, interrupted, working = threading.get_ident(), [], threading.Event(), set[int]()

    def interrupt() -> None:
        interrupted.set()
        signal.pthread_kill(main, signal.SIGINT)

    def work(number: int) -> None:
        if threading.get_ident() == main:
            while not others:
                time.sleep(0.001)
            if when == "at work":
                interrupt()
            return
        others.append(number)
        working.add(number)
        if when == "waiting":
            time.sleep(0.1)  # until then the caller has probably done all that is left; another moment has to do, too
            interrupt()
        assert interrupted.wait(60)
        time.sleep(0.1)
        working.remove(number)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            on_threads(work, range(2 if when == "waiting" else 100), 2)
        assert not working
        assert len(others) < 10
    finally:
        signal.signal(signal.SIGINT, before)
