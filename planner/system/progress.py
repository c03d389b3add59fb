"""How far long work is: a bar on a terminal, a line in a notebook, elsewhere a plain line now and then on stderr.

Commands show it at once. Functions that may work for minutes have an argument `progress`:

- None, unless given: on a terminal and in a notebook a bar is shown as soon as the work has taken two seconds. Nothing
  is shown elsewhere, or where the environment variable `KITASSIST_PROGRESS` is 0.
- True: it is shown elsewhere, too. False: it never is.
- A function: it is called with what is under way, how much of it is done, and of how much. Nothing else is shown.
"""

from __future__ import annotations

import functools
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple, Protocol, TypeVar, cast

from .progress_reports import Progress as Progress

Wanted = Progress | bool | None
"""Who is told how far work is: a function, or somebody who looks on."""

F = TypeVar("F", bound=Callable[..., Any])

UNSHOWN = "KITASSIST_PROGRESS"
"""The environment variable that is 0 where nothing is to be shown unasked."""

AFTER = 2.0  # seconds that work takes before anybody who did not ask is told
BETWEEN_LINES = 30.0  # seconds
IN_A_NOTEBOOK = 0.5  # seconds between two changes of its line

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
    with stages() as show:
        yield adding(show, what, total)


@contextmanager
def status_line(first: str) -> Iterator[Callable[[str], None]]:
    """Show one line that changes; call what is given with the next."""
    with _display() as show:
        begun = time.monotonic()
        show(Stage(first, 0, None, begun))
        yield lambda text: show(Stage(text, 0, None, begun))


@contextmanager
def stages(after: float = 0.0) -> Iterator[Progress]:
    """Show one thing after the other; call what is given with its name, how many are done, and of how many.

    Parameters
    ----------
    after : float
        Nothing is shown that takes no more seconds in all.
    """
    begun: dict[str, float] = {}
    latest = ""
    with _display(after) as show:

        def report(what: str, done: int, total: int | None) -> None:
            nonlocal latest
            if what not in begun or (done == 0 and what != latest):  # for the first time, or anew
                begun[what] = time.monotonic()
            latest = what
            show(Stage(what, done, total, begun[what]))

        yield report


def shows_progress(function: F) -> F:
    """Let a function have an argument `progress` as this module says; the function itself is given one to call."""

    @functools.wraps(function)
    def shown(*args: Any, progress: Wanted = None, **others: Any) -> Any:
        with told(progress) as tell:
            return function(*args, progress=tell, **others)

    return cast(F, shown)


@contextmanager
def told(progress: Wanted) -> Iterator[Progress]:
    """Show long work to those who want it shown; call what is given as `stages` says.

    Work that is part of other work is not shown by itself: the caller of the whole has said what is wanted.
    """
    part = bool(_displays or _work)
    _work.append(token := object())
    try:
        if callable(progress):
            yield progress
        elif part or not (_looked_at() if progress is None else progress):
            yield lambda *_: None
        else:
            with stages(after=AFTER) as show:
                yield show
    finally:
        _work.remove(token)


def adding(show: Progress, what: str, total: int) -> Callable[[int], None]:
    """Say that none of so many is done; give what is called with how many more are, by any thread."""
    done, lock = 0, threading.Lock()

    def advance(count: int) -> None:
        nonlocal done
        with lock:
            done += count
            show(what, done, total)

    advance(0)
    return advance


def _looked_at() -> bool:
    """Whether somebody looks on who did not ask for it."""
    return os.environ.get(UNSHOWN) != "0" and (sys.stderr.isatty() or _notebook() is not None)


def _notebook() -> Callable[..., Any] | None:
    """Give the function that shows something in the notebook in which this runs, if it runs in one."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return ipython.display.display if ipython is not None and hasattr(shell, "kernel") else None


def compiling_line() -> Callable[[], None]:
    """Give a function that says on stderr, when it is first called, that something is compiled, and for how long."""
    said = False

    def say() -> None:
        nonlocal said
        if not said:
            said = True
            print(COMPILING_LINE, file=sys.stderr, flush=True)

    return say


class _Display(Protocol):
    """Shows a stage: so many of so many, and a line in words, as `str` gives it at the time."""

    def show(self, line: object, done: int, total: int | None) -> None: ...

    def close(self) -> None: ...


_displays: list[_Display] = []
"""What is shown now."""

_work: list[object] = []
"""What is under way now of which `told` knows, shown or not."""


@contextmanager
def _display(after: float = 0.0) -> Iterator[Callable[[Stage], None]]:
    """Show stages, from the first on."""
    shown: list[_Display] = []

    def show(stage: Stage) -> None:
        if not shown:
            shown.append(_Delayed(after) if after else _made())
            _displays.append(shown[0])
        shown[0].show(stage, stage.done, stage.total)

    try:
        yield show
    finally:
        for display in shown:
            _displays.remove(display)
            display.close()


def _made() -> _Display:
    if sys.stderr.isatty():
        from .progress_bars import Bar

        return Bar()
    notebook = _notebook()
    return _Lines() if notebook is None else _Line(notebook)


class _Delayed:
    """Shows what takes longer than some seconds."""

    def __init__(self, seconds: float) -> None:
        self._lock, self._display = threading.Lock(), list[_Display]()
        self._latest: tuple[object, int, int | None] | None = None
        self._timer = threading.Timer(seconds, self._begin)
        self._timer.daemon = True
        self._timer.start()

    def show(self, line: object, done: int, total: int | None) -> None:
        with self._lock:
            self._latest = line, done, total
            for display in self._display:
                display.show(*self._latest)

    def close(self) -> None:
        self._timer.cancel()
        with self._lock:
            self._latest = None
            for display in self._display:
                display.close()

    def _begin(self) -> None:
        with self._lock:
            if self._latest is not None:
                self._display.append(_made())
                self._display[0].show(*self._latest)


class _Lines:
    """Prints a line now and then."""

    def __init__(self, between: float | None = None) -> None:
        self._line: object = ""
        self._between = BETWEEN_LINES if between is None else between
        self._ended = threading.Event()
        threading.Thread(target=self._print, daemon=True).start()

    def show(self, line: object, done: int, total: int | None) -> None:  # noqa: ARG002  the line has them
        self._line = line

    def close(self) -> None:
        self._ended.set()

    def _print(self) -> None:
        with suppress(OSError, ValueError):  # nobody reads stderr any more
            while not self._ended.wait(self._between):
                self._write(str(self._line))

    def _write(self, line: str) -> None:
        print(line, file=sys.stderr, flush=True)


class _Line(_Lines):
    """Shows one line in a notebook, which changes and goes away."""

    def __init__(self, display: Callable[..., Any]) -> None:
        self._shown = display({"text/plain": ""}, raw=True, display_id=True)
        super().__init__(IN_A_NOTEBOOK)

    def close(self) -> None:
        super().close()
        self._write("")

    def _write(self, line: str) -> None:
        self._shown.update({"text/plain": line}, raw=True)
