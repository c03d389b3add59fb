"""Work on several threads: the results of each part, also if threads cannot start or end silently."""

from __future__ import annotations

import copy
import signal
import subprocess
import sys
import threading
import time
from unittest.mock import Mock

import numpy as np
import pytest
from conftest import KITTING

from planner.search.state_registry import GrowingArray, StateRegistry
from planner.system import processes
from planner.system.processes import on_threads


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


@pytest.mark.parametrize("fault", [None, RuntimeError("can't start new thread")])
def test_threads_that_do_not_begin_are_not_waited_for(fault: Exception | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory may end when a thread is made, or when it has been made and begins."""
    monkeypatch.setattr(processes._thread, "start_new_thread", Mock(side_effect=fault))
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


def test_rows_that_somebody_looks_at_stay_where_they_are() -> None:
    growing = GrowingArray(np.int64, 2)
    growing.append(0, np.ones((3, 2), dtype=np.int64))
    address = growing.rows.ctypes.data
    looked_at = growing.rows[:3]
    growing.append(3, np.full((1 << 16, 2), 7))
    assert growing.rows.ctypes.data != address
    assert looked_at.base is not growing.rows
    assert looked_at.tolist() == [[1, 1]] * 3
    assert growing.trimmed(4).tolist() == [[1, 1]] * 3 + [[7, 7]]
    growing = GrowingArray(np.int64)
    before = id(growing.rows)
    growing.append(0, np.arange(1 << 16))
    assert id(growing.rows) == before  # no copy is made: the array itself has grown


def test_a_copy_of_numbered_states_is_one_moment_of_them() -> None:
    """Another thread numbers states at the same time."""
    met, over = StateRegistry(1), threading.Event()

    def number() -> None:
        for begin in range(0, 1 << 17, 256):
            if over.is_set():
                break
            met.numbers(np.arange(begin, begin + 256, dtype=np.uint64)[:, None])

    thread = threading.Thread(target=number)
    thread.start()
    try:
        for _ in range(8):
            other = copy.deepcopy(met)
            held = len(other)
            assert other.states(slice(0, held))[:, 0].tolist() == list(range(held))
            assert other.numbers(np.arange(held, dtype=np.uint64)[:, None]).tolist() == list(range(held))
    finally:
        over.set()
        thread.join()


INTERRUPTED = """
import _thread, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # also where the tests run in the background
sys.path[:0] = {paths!r}
import numpy as np
from importlib import import_module
from test_dense import tied
from planner import OnDemand, instance, load, sweep
shipped = {shipped!r}
module, task = import_module("planner.costtogo.table"), tied(1, 2, 26)
before = _thread._count()

def begun(*_):
    global begun
    begun = lambda *_: None
    print("begun", flush=True)

try:
    {work}
    print("it has come to an end")
except KeyboardInterrupt:
    print(_thread._count() - before, "threads at work")
"""
WORK = {
    "by index": "sweep(task, threads=3, memory_limit_mb=4000, progress=lambda *_: begun())",
    "listed": """
    module.split_operators = lambda *_: None
    sweep(task, threads=3, memory_limit_mb=4000, progress=lambda *_: begun())
""",
    "on demand": """
    module = import_module("planner.costtogo.on_demand")
    search, asked = module.astar, OnDemand(load(instance(shipped)), jobs=3)
    before = _thread._count()  # loading has started one that serves the process
    asked._search = "astar(blind(),max_time=infinity)"
    module.astar = lambda *given, **options: (begun(), search(*given, **options))[1]
    asked.lookup([asked.initial])
""",
}


@pytest.mark.slow
@pytest.mark.parametrize("work", WORK)
def test_ctrl_c_in_a_sweep_leaves_no_thread_at_work(work: str) -> None:
    """Sweeps of 2^27 states, and a blind search through 10^11, take much longer than the signal."""
    large = str(KITTING / "ladder-6x12.pddl")
    script = INTERRUPTED.format(paths=sys.path, shipped=large, work=WORK[work])
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "begun\n"
            process.send_signal(signal.SIGINT)
            assert process.communicate(timeout=120)[0] == "0 threads at work\n"
        finally:
            process.kill()
