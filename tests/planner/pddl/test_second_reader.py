"""The second reader, unified-planning in another process, is asked beside other work, and may die, hang or be late."""

from __future__ import annotations

import os
import signal
from dataclasses import replace

import pytest

from planner import MismatchError, instance
from planner.pddl.reader import read
from planner.pddl.validation import LATE, SecondReader


def process_of(second: SecondReader) -> int:
    assert second._process is not None
    return second._process.popen.pid


@pytest.mark.slow
def test_a_second_reader_that_dies_gives_a_reason_and_another_one_answers() -> None:
    reading = read(instance("kitting/tiny"))
    with SecondReader(reading) as second:
        os.kill(process_of(second), signal.SIGKILL)
        second.ask(["(fetch box-a)"])
        assert second.answer(60.0) == "its process died"
    with SecondReader(reading) as second:
        assert second.answer(60.0) is None


def test_a_second_reader_serves_one_instance_after_another() -> None:
    processes = set()
    for name in ("kitting/tiny", "kitting/paper"):
        with SecondReader(read(instance(name))) as second:
            processes.add(process_of(second))
            assert second.answer(60.0) is None
    assert len(processes) == 1
    with SecondReader(read(instance("kitting/tiny"))) as second:
        second.ask([])
        with pytest.raises(MismatchError):
            second.answer(60.0)


def test_asking_a_second_reader_that_hangs_takes_no_time() -> None:
    """Neither a long text nor a long plan waits for a process that reads nothing."""
    reading = read(instance("kitting/tiny"))
    long = replace(reading, problem=replace(reading.problem, name="p" * 10_000_000))
    with SecondReader(long) as second:
        os.kill(process_of(second), signal.SIGSTOP)
        second.ask(["(fetch box-a)"] * 100_000)
        assert second.answer(0.2) == LATE
