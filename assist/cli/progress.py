"""How far a command is: a bar on a terminal, elsewhere a plain line now and then; always on stderr."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, NamedTuple

import click

if TYPE_CHECKING:
    from .bars import Bar

BETWEEN_LINES = 30.0  # seconds

COMPILING_LINE = "compiling, once after an installation: it takes up to a minute, and is kept"


class Stage(NamedTuple):
    """What is under way, since a time on `time.monotonic()`'s clock; `total` is None where nobody knows."""

    what: str
    done: int
    total: int | None
    begun: float

    def __str__(self) -> str:
        seconds = time.monotonic() - self.begun
        line = f"{self.what}, {seconds:.0f} s"
        if self.total is None:
            return f"{line}: {self.done:,}, {self.done / max(seconds, 1e-9):,.0f}/s" if self.done else line
        left = f", about {seconds / self.done * (self.total - self.done):.0f} s left" if self.done else ""
        return f"{line}: {self.done:,} of {self.total:,}{left}"


@contextmanager
def progress_bar(what: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show how many of `total` are done, with rate and time left; call what is given with how many more are."""
    done, lock = 0, threading.Lock()
    with stages() as show:

        def advance(count: int) -> None:
            nonlocal done
            with lock:
                done += count
                show(what, done, total)

        advance(0)
        yield advance


@contextmanager
def status_line(first: str) -> Iterator[Callable[[str], None]]:
    """Show one line that changes; call what is given with the next."""
    with _display() as show:
        begun = time.monotonic()
        show(Stage(first, 0, None, begun))
        yield lambda text: show(Stage(text, 0, None, begun))


@contextmanager
def stages() -> Iterator[Callable[[str, int, int | None], None]]:
    """Show one thing after the other; call what is given with its name, how many are done, and of how many."""
    begun: dict[str, float] = {}
    latest = ""
    with _display() as show:

        def report(what: str, done: int, total: int | None) -> None:
            nonlocal latest
            if what not in begun or (done == 0 and what != latest):  # for the first time, or anew
                begun[what] = time.monotonic()
            latest = what
            show(Stage(what, done, total, begun[what]))

        yield report


def compiling_line() -> Callable[[], None]:
    """Give a function that says on stderr, when it is first called, that something is compiled, and for how long."""
    said = False

    def say() -> None:
        nonlocal said
        if not said:
            said = True
            click.echo(COMPILING_LINE, err=True)

    return say


@contextmanager
def _display() -> Iterator[Callable[[Stage], None]]:
    """Show stages, from the first on."""
    shown: list[Bar | _Lines] = []

    def show(stage: Stage) -> None:
        if not shown:
            if sys.stderr.isatty():
                from .bars import Bar

                shown.append(Bar())
            else:
                shown.append(_Lines())
        shown[0].show(stage, stage.done, stage.total)

    try:
        yield show
    finally:
        for display in shown:
            display.close()


class _Lines:
    """Prints a line now and then."""

    def __init__(self) -> None:
        self._line: object = ""
        self._ended = threading.Event()
        threading.Thread(target=self._print, daemon=True).start()

    def show(self, line: object, done: int, total: int | None) -> None:  # noqa: ARG002  the line has them
        self._line = line

    def close(self) -> None:
        self._ended.set()

    def _print(self) -> None:
        with suppress(OSError, ValueError):  # nobody reads stderr any more
            while not self._ended.wait(BETWEEN_LINES):
                click.echo(str(self._line), err=True)
