"""What every command does on the console: pairs of numbers in; JSON, tables, progress and errors out."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from planner import InstanceError, LimitError, PDDLError
from planner.batch import ResultsExistError
from planner.errors import MissingExtraError
from planner.fast_downward import FastDownwardError

EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_INTERRUPTED = 130

Range = tuple[float, float]


def range_option(name: str, default: Range, text: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """An option with two numbers."""
    return click.option(name, nargs=2, type=float, metavar="LOW HIGH", default=default, show_default=True, help=text)


def fail(message: str, exit_code: int) -> NoReturn:
    """Say in one line on stderr what is wrong, and end."""
    click.echo(message, err=True)
    sys.exit(exit_code)


@contextmanager
def one_line_errors(interrupted: str = "interrupted") -> Iterator[None]:
    """Turn what is wrong with the input into one line and the exit code of the contract."""
    try:
        yield
    except (InstanceError, ResultsExistError) as error:
        fail(str(error), EXIT_USAGE)
    except (PDDLError, LimitError, FastDownwardError, MissingExtraError) as error:
        fail(str(error), EXIT_FAILED)
    except OSError as error:
        fail(f"{error.filename}: {error.strerror}", EXIT_FAILED)
    except KeyboardInterrupt:
        fail(interrupted, EXIT_INTERRUPTED)


class Rate(ProgressColumn):
    """How many are done per second."""

    def render(self, task: Task) -> Text:
        """Give the mean rate since the start."""
        return Text("" if not task.elapsed else f"{task.completed / task.elapsed:.1f}/s")


@contextmanager
def progress_bar(what: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show a bar with rate and time left on stderr, where that is a terminal."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), Rate(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda count: bar.advance(task, count)


def print_json(document: Any) -> None:
    """Print a result as programs read it."""
    click.echo(json.dumps(document, indent=2))


def print_table(table: Table, width: int = 140) -> None:
    """Print a table as wide as the terminal, or as `width` where a file or a pipe has no width of its own."""
    Console(width=None if sys.stdout.isatty() else width).print(table)
