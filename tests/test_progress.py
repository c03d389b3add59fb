"""What commands say of how far they are: a line now and then, a bar on a terminal, and that something is compiled."""

from __future__ import annotations

import io
import os
import pty
import re
import sys
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from pathlib import Path

import numba
import pytest

from assist.cli.solving import solving
from planner import Instance, progress
from planner.compiled import compiling


class Heard(io.StringIO):
    """A file that is no terminal, and that tells when what is waited for has been written."""

    def __init__(self, awaited: str) -> None:
        super().__init__()
        self.awaited, self.said = awaited, threading.Event()

    def write(self, text: str) -> int:
        written = super().write(text)
        if re.search(self.awaited, self.getvalue(), re.M):
            self.said.set()
        return written


def stage(what: str, done: int, total: int | None, seconds: float) -> str:
    return str(progress.Stage(what, done, total, time.monotonic() - seconds))


def test_a_line_says_what_is_known_and_nothing_else() -> None:
    assert stage("reading", 0, None, 3) == "reading, 3 s"
    assert stage("states", 3000, None, 2) == "states, 2 s: 3,000, 1,500/s"
    assert stage("cost-to-go", 0, 4000, 5) == "cost-to-go, 5 s: 0 of 4,000"
    assert stage("cost-to-go", 3000, 4000, 6) == "cost-to-go, 6 s: 3,000 of 4,000, about 2 s left"


@pytest.mark.parametrize(
    ("display", "told", "line"),
    [
        (lambda: progress.progress_bar("solving", 3), (2,), r"^solving, \d+ s: 2 of 3, about \d+ s left$"),
        (lambda: progress.stages(), ("people", 1, 12), r"^people, \d+ s: 1 of 12, about \d+ s left$"),
        (lambda: progress.status_line("reading"), ("searching",), r"^searching, \d+ s$"),
    ],
    ids=["progress_bar", "stages", "status_line"],
)
def test_a_line_comes_now_and_then(
    display: Callable[[], AbstractContextManager[Callable[..., None]]],
    told: tuple[object, ...],
    line: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys, "stderr", heard := Heard(line))
    monkeypatch.setattr(progress, "BETWEEN_LINES", 0.01)
    with display() as tell:
        tell(*told)
        assert heard.said.wait(60), heard.getvalue()
    assert "\x1b" not in heard.getvalue()


def test_what_takes_no_time_says_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", heard := Heard("."))
    with progress.progress_bar("solving", 3) as advance:
        advance(3)
    assert heard.getvalue() == ""


def test_on_a_terminal_there_is_a_bar_which_goes_away(monkeypatch) -> None:
    inner, outer = pty.openpty()
    with os.fdopen(outer, "w") as terminal, monkeypatch.context() as changed:
        changed.setattr(sys, "stderr", terminal)
        changed.setenv("TERM", "xterm")
        changed.setenv("COLUMNS", "100")
        with progress.stages() as show:
            show("states", 0, None)
            show("cost-to-go", 5, 10)
    shown = ""
    with suppress(OSError):  # Linux says so when the other side is closed
        while more := os.read(inner, 1 << 16):
            shown += more.decode()
    os.close(inner)
    assert re.search(r"cost-to-go, \d+ s: 5 of 10", shown)


def test_compiling_is_said_at_once_and_once(capsys) -> None:
    @numba.njit
    def twice(number):
        return 2 * number

    with compiling(progress.compiling_line()):
        assert capsys.readouterr().err == ""
        twice(1)
        assert capsys.readouterr().err == f"{progress.COMPILING_LINE}\n"
        twice(1.5)
    twice(1j)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("count", "expected"),
    [(1, ["compiling", "states"]), (2, ["0 of 2 solved; p.pddl: compiling", "1 of 2 solved; q.pddl: states"])],
)
def test_instances_say_how_far_they_are(count, expected, monkeypatch, capsys) -> None:
    shown = []
    monkeypatch.setattr("planner.progress._Lines.show", lambda _, line, *__: shown.append(line.what))
    monkeypatch.setattr("assist.cli.solving.compiling_line", progress.compiling_line)
    with solving(count, lambda _: None) as (solved, told):
        told(Instance(Path("p.pddl"), Path("domain.pddl")), "compiling", 0, None)
        solved({})
        told(Instance(Path("q.pddl"), Path("domain.pddl")), "states", 5, None)
    assert shown == expected
    assert capsys.readouterr().err == f"{progress.COMPILING_LINE}\n"
