"""Progress of long computations: a bar on a terminal, a line in a notebook, or plain lines on stderr.

Commands show progress at once. Functions that may run for minutes have an argument `progress`:

- None (default): on a terminal and in a notebook, progress is shown once the work has taken two seconds. Nothing is
  shown elsewhere. The environment variable `KITASSIST_PROGRESS` decides for all places: 0 nowhere, 1 everywhere.
- True: progress is also shown elsewhere. False: it is never shown.
- A function: it is called with the description of the current stage, the number of items done, and their total.
  Nothing else is shown.
"""

from __future__ import annotations

import functools
import math
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from typing import Any, NamedTuple, TypeVar, cast

from .errors import VisibleText, visible

Progress = Callable[[str, int, int | None], None]
"""Receives the description of a stage, the number of items done, and their total (None if it is unknown)."""

Wanted = Progress | bool | None
"""Values of the argument `progress`, as this module describes them."""

F = TypeVar("F", bound=Callable[..., Any])

UNSHOWN = "KITASSIST_PROGRESS"
"""Environment variable: 0 shows progress only where the caller asks for it, 1 also where nobody looks."""

AFTER = 2.0
"""Seconds of work before progress is shown. A call that is already done by then shows nothing."""

BETWEEN_LINES = 30.0
"""Seconds between two plain lines. Shorter is more current, and makes logs longer."""

COMPILING_LINE = "compiling {purpose}; once after an installation"


class Stage(NamedTuple):
    """A stage of the work, its progress, and when it began (`time.monotonic()`); `total` is None if it is unknown.

    What was done at the beginning, `first`, such as the part of a resumed run, says nothing about the time left. The
    work ends by `until` in any case.
    """

    what: str
    done: int
    total: int | None
    begun: float
    first: int = 0
    until: float = math.inf

    def __str__(self) -> str:
        seconds = (now := time.monotonic()) - self.begun
        line = f"{visible(self.what)}, {seconds:.0f} s"
        if self.total is None:
            return f"{line}: {self.done:,}, {self.done / max(seconds, 1e-9):,.0f}/s" if self.done else line
        line, new = f"{line}: {self.done:,} of {self.total:,}", self.done - self.first
        if new <= 0:
            return line
        left = min(seconds / new * (self.total - self.done), max(0.0, self.until - now))
        return f"{line}, about {left:.0f} s left"


@contextmanager
def status_line(first: str) -> Iterator[Callable[[str], None]]:
    """Show one line that changes. Yield a function that replaces its text."""
    with _Display(0.0) as display:
        begun = time.monotonic()
        display.show(Stage(first, 0, None, begun))
        yield lambda text: display.show(Stage(text, 0, None, begun))


@contextmanager
def stages(after: float = 0.0, within: float = math.inf) -> Iterator[Progress]:
    """Show the stages of some work one after another, and yield the function that reports them.

    The function is called with the stage, the number of items done, and their total. Nothing is shown in the first
    `after` seconds. The work ends `within` a number of seconds.
    """
    until = time.monotonic() + within
    begun: dict[str, tuple[float, int]] = {}
    latest = ""
    with _Display(after) as display:

        def report(what: str, done: int, total: int | None) -> None:
            nonlocal latest
            if what not in begun or (done == 0 and what != latest):  # first, or started once more
                begun[what] = time.monotonic(), done
            latest = what
            display.show(Stage(what, done, total, *begun[what], until))

        yield report


def shows_progress(function: F) -> F:
    """Add the argument `progress` to a function, as this module describes; the function receives a callable.

    An interrupt (Ctrl-C) that comes while compiled code is called is a `KeyboardInterrupt` like any other.
    """

    @functools.wraps(function)
    def shown(*args: Any, progress: Wanted = None, **others: Any) -> Any:
        try:
            with reporting(progress) as tell:
                return function(*args, progress=tell, **others)
        except SystemError as error:  # numba returns with the exception set, which Python makes this error of
            behind: BaseException | None = error
            while isinstance(behind, SystemError):
                behind = behind.__cause__ or behind.__context__
            if isinstance(behind, KeyboardInterrupt):
                raise behind from None
            raise

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
    """Whether progress is shown by default: on a terminal and in a notebook, unless the environment decides."""
    if (wanted := os.environ.get(UNSHOWN)) in ("0", "1"):
        return wanted == "1"
    return sys.stderr.isatty() or _notebook() is not None


def _notebook() -> Callable[..., Any] | None:
    """Return the display function of the notebook in which this runs; None outside of notebooks."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return ipython.display.display if ipython is not None and hasattr(shell, "kernel") else None


def _on_stderr(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def compiling_line(tell: Callable[[str], None] = _on_stderr) -> Callable[[str], None]:
    """Return a function that tells, on stderr by default, what is compiled, once for each purpose."""
    said: set[str] = set()

    def say(purpose: str) -> None:
        if purpose not in said:
            said.add(purpose)
            tell(COMPILING_LINE.format(purpose=purpose))

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


class _Display:
    """Shows the latest stage at regular intervals, from a thread: a bar, a line in a notebook, or plain lines.

    Nothing is shown within `after` seconds, nor after the context.
    """

    def __init__(self, after: float) -> None:
        self._after = after
        self._stage: Stage | None = None
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    def show(self, stage: Stage) -> None:
        """Show a stage; its text is that at the time of drawing."""
        self._stage = stage
        if self._thread is None:  # only now: where nothing is reported, this process can be forked
            self._thread = threading.Thread(target=self._draw, daemon=True)
            self._thread.start()

    def __enter__(self) -> _Display:
        _work.append(self)
        return self

    def __exit__(self, *_: object) -> None:
        _work.remove(self)
        self._ended.set()
        if self._thread is not None:
            self._thread.join()

    def _draw(self) -> None:
        if self._after and self._ended.wait(self._after):
            return
        notebook = _notebook()
        shown: AbstractContextManager[Callable[[Stage], None]]
        if sys.stderr.isatty():
            shown, between = _bar(), 0.1
        elif notebook is not None:
            shown, between = _notebook_line(notebook), 0.5
        else:
            shown, between = nullcontext(_print), BETWEEN_LINES
        with suppress(OSError, ValueError), shown as draw:  # stderr has been closed
            ended = draw is _print and self._ended.wait(between)
            while not ended:
                if self._stage is not None:
                    draw(self._stage)
                ended = self._ended.wait(between)
            if draw is not _print and self._stage is not None:
                draw(self._stage)


def _print(stage: Stage) -> None:
    print(stage, file=sys.stderr, flush=True)


@contextmanager
def _bar() -> Iterator[Callable[[Stage], None]]:
    """Yield a function that draws a progress bar with a line of text on a terminal."""
    from rich.console import Console  # only where something is shown
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn

    text = TextColumn("{task.fields[stage]}", markup=False)
    console = Console(file=getattr(sys.stderr, "rich_proxied_file", sys.stderr))
    bars = Progress(SpinnerColumn(), BarColumn(), text, console=console, transient=True, auto_refresh=False)
    task = bars.add_task("", total=None, stage="")
    with_controls_written_out = [name for name in ("stdout", "stderr") if isinstance(getattr(sys, name), VisibleText)]

    def draw(stage: Stage) -> None:
        if bars.tasks[0].total != stage.total:
            bars.reset(task, total=stage.total)
        bars.update(task, completed=stage.done, stage=stage, refresh=True)

    with bars:  # replaces both streams
        for name in with_controls_written_out:
            setattr(sys, name, VisibleText(getattr(sys, name)))
        yield draw


@contextmanager
def _notebook_line(display: Callable[..., Any]) -> Iterator[Callable[[object], None]]:
    """Yield a function that replaces one line in a notebook, which is empty at the end."""
    shown = display({"text/plain": ""}, raw=True, display_id=True)

    def draw(stage: object) -> None:
        shown.update({"text/plain": str(stage)}, raw=True)

    yield draw
    draw("")
