"""Work on several threads: what each part comes to, also where threads do not begin, or end without a word."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest

from planner import threads
from planner.threads import on_threads


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
