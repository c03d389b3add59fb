"""What commands say of how far they are, off a terminal: a line on stderr now and then."""

from __future__ import annotations

import io
import re
import sys
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager

import pytest

from assist.cli import progress


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


@pytest.mark.parametrize(
    ("display", "told", "line"),
    [
        (lambda: progress.progress_bar("solving", 3), (2,), r"^solving, \d+ s: 2 of 3(, about \d+ s left)?$"),
        (lambda: progress.stages(), ("people", 1, 12), r"^people, \d+ s: 1 of 12(, about \d+ s left)?$"),
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
