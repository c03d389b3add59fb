"""How far a command is: a bar on a terminal, elsewhere a plain line now and then; always on stderr."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import click
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

BETWEEN_LINES = 30.0  # seconds


class Rate(ProgressColumn):
    """How many are done per second."""

    def render(self, task: Task) -> Text:
        """Give the mean rate since the start."""
        return Text("" if not task.elapsed else f"{task.completed / task.elapsed:.1f}/s")


@contextmanager
def progress_bar(what: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show how many of `total` are done, with rate and time left; call what is given with how many more are."""
    with _display(BarColumn(), MofNCompleteColumn(), Rate(), TimeRemainingColumn()) as (bar, task):
        bar.update(task.id, description=what, total=total)
        yield lambda count: bar.advance(task.id, count)


@contextmanager
def stages() -> Iterator[Callable[[str, int, int], None]]:
    """Show one thing after the other; call what is given with its name, how many are done, and of how many."""
    with _display(BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()) as (bar, task):

        def show(what: str, done: int, total: int) -> None:
            if what != task.description:
                bar.reset(task.id, total=total, description=what)
            bar.update(task.id, completed=done)

        yield show


@contextmanager
def status_line(first: str) -> Iterator[Callable[[str], None]]:
    """Show one line that changes; call what is given with the next."""
    with _display(SpinnerColumn()) as (bar, task):
        bar.update(task.id, description=first)
        yield lambda text: bar.update(task.id, description=text)


@contextmanager
def _display(*columns: ProgressColumn) -> Iterator[tuple[Progress, Task]]:
    console = Console(stderr=True)
    described = TextColumn("{task.description}", markup=False)
    with Progress(
        *columns[:-3], described, *columns[-3:], console=console, disable=not console.is_terminal, transient=True
    ) as bar:
        bar.add_task("", total=None)
        (task,) = bar.tasks
        if console.is_terminal:
            yield bar, task
            return
        ended = threading.Event()
        lines = threading.Thread(target=_print_lines, args=(task, ended), daemon=True)
        lines.start()
        try:
            yield bar, task
        finally:
            ended.set()


def _print_lines(task: Task, ended: threading.Event) -> None:
    with suppress(OSError, ValueError):  # nobody reads stderr any more
        while not ended.wait(BETWEEN_LINES):
            click.echo(_line(task), err=True)


def _line(task: Task) -> str:
    line = f"{task.description}, {task.elapsed or 0:.0f} s"
    if task.total is None:
        return line
    left = "" if task.time_remaining is None else f", about {task.time_remaining:.0f} s left"
    return f"{line}: {task.completed:,.0f} of {task.total:,.0f}{left}"
