"""Progress of long computations: a bar on a terminal, a line in a notebook, or plain lines on stderr.

Commands show progress at once. Functions that may run for minutes have an argument `progress`:

- None (default): on a terminal and in a notebook, progress is shown once the work has taken two seconds. Nothing is
  shown elsewhere, or if the environment variable `KITASSIST_PROGRESS` is 0.
- True: progress is also shown elsewhere. False: it is never shown.
- A function: it is called with the description of the current stage, the number of items done, and their total.
  Nothing else is shown.
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

from .signs import VisibleText, visible

Progress = Callable[[str, int, int | None], None]
"""Receives the description of a stage, the number of items done, and their total (None if it is unknown)."""

Wanted = Progress | bool | None
"""Values of the argument `progress`, as this module describes them."""

F = TypeVar("F", bound=Callable[..., Any])

UNSHOWN = "KITASSIST_PROGRESS"
"""Environment variable that is set to 0 to show progress only where the caller asks for it."""

AFTER = 2.0
"""Seconds of work before progress is shown. A call that is already done by then shows nothing."""

BETWEEN_LINES = 30.0
"""Seconds between two plain lines. Shorter is more current, and makes logs longer."""

COMPILING_LINE = "compiling, once after an installation: it takes up to a minute, and is kept"


class Stage(NamedTuple):
    """A stage of the work, its progress, and when it began (`time.monotonic()`); `total` is None if it is unknown.

    What was done at the beginning, `first`, such as the part of a resumed run, says nothing about the time left.
    """

    what: str
    done: int
    total: int | None
    begun: float
    first: int = 0

    def __str__(self) -> str:
        seconds = time.monotonic() - self.begun
        line = f"{visible(self.what)}, {seconds:.0f} s"
        if self.total is None:
            return f"{line}: {self.done:,}, {self.done / max(seconds, 1e-9):,.0f}/s" if self.done else line
        new = self.done - self.first
        left = f", about {seconds / new * (self.total - self.done):.0f} s left" if new > 0 else ""
        return f"{line}: {self.done:,} of {self.total:,}{left}"


@contextmanager
def progress_bar(what: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show how many of `total` items are done, with the time left. Yield a function that adds to the count."""
    with stages() as show:
        yield adding(show, what, total)


@contextmanager
def status_line(first: str) -> Iterator[Callable[[str], None]]:
    """Show one line that changes. Yield a function that replaces its text."""
    with _display() as show:
        begun = time.monotonic()
        show(Stage(first, 0, None, begun))
        yield lambda text: show(Stage(text, 0, None, begun))


@contextmanager
def stages(after: float = 0.0) -> Iterator[Progress]:
    """Show the stages of some work one after another, and yield the function that reports them.

    The function is called with the stage, the number of items done, and their total.
    """
    begun: dict[str, tuple[float, int]] = {}
    latest = ""
    with _display(after) as show:

        def report(what: str, done: int, total: int | None) -> None:
            nonlocal latest
            if what not in begun or (done == 0 and what != latest):  # first, or started once more
                begun[what] = time.monotonic(), done
            latest = what
            show(Stage(what, done, total, *begun[what]))

        yield report


def shows_progress(function: F) -> F:
    """Add the argument `progress` to a function, as this module describes; the function receives a callable."""

    @functools.wraps(function)
    def shown(*args: Any, progress: Wanted = None, **others: Any) -> Any:
        with reporting(progress) as tell:
            return function(*args, progress=tell, **others)

    return cast(F, shown)


@contextmanager
def reporting(progress: Wanted) -> Iterator[Progress]:
    """Yield the function that receives progress reports; it shows them where `progress` asks for it.

    Work that is part of other work is not shown by itself. The caller of the outer work has decided.
    """
    part = bool(_work)
    with _working():
        if callable(progress):
            yield progress
        elif part and progress is None and _parts_shown:
            show, resume = _parts_shown[-1]
            try:
                yield show
            finally:
                resume()
        elif part or not (_looked_at() if progress is None else progress):
            yield lambda *_: None
        else:
            with stages(after=AFTER) as show:
                yield show


@contextmanager
def parts_shown(show: Progress, resume: Callable[[], None]) -> Iterator[None]:
    """Let parts of the work that are not announced, such as what a user's function calls, report their own stages.

    `show` receives their reports. `resume` is called after each part, to report the stage of the work again.
    """
    _parts_shown.append(heard := (show, resume))
    try:
        yield
    finally:
        _parts_shown.remove(heard)


def adding(show: Progress, what: str, total: int, done: int = 0) -> Callable[[int], None]:
    """Return a thread-safe function that adds to a count of finished items and reports it, at once as it is first."""
    lock = threading.Lock()

    def advance(count: int) -> None:
        nonlocal done
        with lock:
            done += count
            show(what, done, total)

    advance(0)
    return advance


def _looked_at() -> bool:
    """Whether progress is shown by default: on a terminal and in a notebook, unless the environment forbids it."""
    return os.environ.get(UNSHOWN) != "0" and (sys.stderr.isatty() or _notebook() is not None)


def _notebook() -> Callable[..., Any] | None:
    """Return the display function of the notebook in which this runs; None outside of notebooks."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return ipython.display.display if ipython is not None and hasattr(shell, "kernel") else None


def compiling_line() -> Callable[[], None]:
    """Return a function that prints, on its first call only, a line on stderr about the compilation."""
    said = False

    def say() -> None:
        nonlocal said
        if not said:
            said = True
            print(COMPILING_LINE, file=sys.stderr, flush=True)

    return say


_work: list[object] = []
"""A token of each display and each call of `reporting` that is active, whether something is shown or not."""

_parts_shown: list[tuple[Progress, Callable[[], None]]] = []
"""The functions of each active `parts_shown`."""


@contextmanager
def _working() -> Iterator[None]:
    _work.append(token := object())
    try:
        yield
    finally:
        _work.remove(token)


class _Display(Protocol):
    """Shows a stage; its text is that at the time of drawing."""

    def show(self, stage: Stage) -> None: ...

    def close(self) -> None: ...


@contextmanager
def _display(after: float = 0.0) -> Iterator[Callable[[Stage], None]]:
    """Yield a function that shows stages; the display is created with the first one, but not within `after` seconds."""
    shown: list[_Display] = []
    latest: list[Stage] = []
    lock, due = threading.Lock(), not after

    def draw() -> None:
        nonlocal due
        with lock:
            due = True
            if latest:
                if not shown:
                    shown.append(_made())
                shown[0].show(latest[0])

    def show(stage: Stage) -> None:
        latest[:] = [stage]
        if due:
            draw()

    timer = threading.Timer(after, draw)
    timer.daemon = True
    with _working():
        if after:
            timer.start()
        try:
            yield show
        finally:
            timer.cancel()
            with lock:
                latest.clear()
                for display in shown:
                    display.close()


def _made() -> _Display:
    notebook = _notebook()
    if sys.stderr.isatty():
        return _Bar()
    return _Lines() if notebook is None else _NotebookLine(notebook)


class _Bar:
    """A progress bar with a line of text, on a terminal."""

    def __init__(self) -> None:
        from rich.console import Console  # only where something is shown
        from rich.progress import BarColumn, SpinnerColumn, TextColumn
        from rich.progress import Progress as Bars

        text = TextColumn("{task.fields[stage]}", markup=False)
        console = Console(file=getattr(sys.stderr, "rich_proxied_file", sys.stderr))
        self._bars = Bars(SpinnerColumn(), BarColumn(), text, console=console, transient=True)
        self._task = self._bars.add_task("", total=None, stage="")
        with_controls_written_out = [
            name for name in ("stdout", "stderr") if isinstance(getattr(sys, name), VisibleText)
        ]
        self._bars.start()  # replaces both streams, until it stops
        for name in with_controls_written_out:
            setattr(sys, name, VisibleText(getattr(sys, name)))

    def show(self, stage: Stage) -> None:
        if self._bars.tasks[0].total != stage.total:
            self._bars.reset(self._task, total=stage.total)
        self._bars.update(self._task, completed=stage.done, stage=stage)

    def close(self) -> None:
        self._bars.stop()


class _Lines:
    """Prints a line at regular intervals."""

    def __init__(self, between: float | None = None) -> None:
        self._stage: object = ""
        self._between = BETWEEN_LINES if between is None else between
        self._ended = threading.Event()
        threading.Thread(target=self._print, daemon=True).start()

    def show(self, stage: Stage) -> None:
        self._stage = stage

    def close(self) -> None:
        self._ended.set()

    def _print(self) -> None:
        with suppress(OSError, ValueError):  # stderr has been closed
            while not self._ended.wait(self._between):
                self._write(str(self._stage))

    def _write(self, line: str) -> None:
        print(line, file=sys.stderr, flush=True)


class _NotebookLine(_Lines):
    """Updates one line in a notebook, and clears it at the end."""

    def __init__(self, display: Callable[..., Any]) -> None:
        in_a_notebook = 0.5  # seconds between two updates of the line in a notebook
        self._shown = display({"text/plain": ""}, raw=True, display_id=True)
        super().__init__(in_a_notebook)

    def close(self) -> None:
        super().close()
        self._write("")

    def _write(self, line: str) -> None:
        self._shown.update({"text/plain": line}, raw=True)
