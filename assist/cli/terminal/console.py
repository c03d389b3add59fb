"""Console output of every command: JSON, tables, and one-line errors with exit codes."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import IntEnum
from typing import TYPE_CHECKING, Any, NoReturn

import click

from planner import InstanceError, LimitError, PDDLError
from planner.grounding.fast_downward import FastDownwardError
from planner.system.errors import DamagedFileError, MissingExtraError, ResultsExistError
from planner.system.threads import NO_MORE_THREADS

if TYPE_CHECKING:
    from rich.table import Table


class ExitCode(IntEnum):
    """The exit codes of commands that do not succeed, as `docs/commands.md` has them."""

    FAILED = 1
    USAGE = 2


def fail(message: str, exit_code: int) -> NoReturn:
    """Print one line on stderr and exit."""
    click.echo(message, err=True)
    sys.exit(exit_code)


@contextmanager
def one_line_errors(interrupted: str = "interrupted") -> Iterator[None]:
    """Turn expected errors into one line on stderr and a documented exit code."""
    try:
        yield
    except (InstanceError, ResultsExistError, DamagedFileError) as error:
        fail(str(error), ExitCode.USAGE)
    except (PDDLError, LimitError, FastDownwardError, MissingExtraError) as error:
        fail(str(error), ExitCode.FAILED)
    except MemoryError as error:
        fail(f"out of memory{f': {error}' if str(error) else ''}", ExitCode.FAILED)
    except RuntimeError as error:
        if str(error) != NO_MORE_THREADS:
            raise
        fail(f"out of memory: {error}", ExitCode.FAILED)
    except OSError as error:
        if isinstance(error, BrokenPipeError) and error.filename is None:
            raise  # the reader closed the pipe; click exits silently
        fail(_said(error), ExitCode.FAILED)
    except KeyboardInterrupt as error:
        fail(interrupted, _code_of(error))


@contextmanager
def kept_if_interrupted(finished: Callable[[], object]) -> Iterator[None]:
    """Let an interrupted command go on, so that it shows what is finished; the interrupt ends it afterwards.

    It ends at once if `finished` returns nothing.
    """
    try:
        yield
    except KeyboardInterrupt as error:
        if not finished():
            raise
        code = _code_of(error)
        click.get_current_context().call_on_close(lambda: fail("interrupted; what was finished by then is shown", code))


def _code_of(error: KeyboardInterrupt) -> int:
    """Return the exit code of an interrupted command, as shells report it: 128 and the number of the signal."""
    code: int = getattr(error, "exit_code", 130)
    return code


def _said(error: OSError) -> str:
    """Return a system error as one line; some libraries raise it without its fields."""
    what = error.strerror or " ".join(str(error).split()) or type(error).__name__
    return what if error.filename is None else f"{error.filename}: {what}"


def print_in_any_encoding() -> None:
    """Make stdout replace characters that its encoding lacks. Where the encoding is ASCII, click writes UTF-8."""
    if hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(errors="replace")


def print_json(document: Any) -> None:
    """Print a result as JSON."""
    click.echo(json.dumps(document, indent=2))


def print_table(table: Table, width: int = 140) -> None:
    """Print a table with the terminal's width, or with `width` characters if stdout is a file or a pipe."""
    from rich.console import Console

    console = Console(width=None if sys.stdout.isatty() else width)
    with console.capture() as printed:
        console.print(table)
    click.echo(printed.get(), nl=False)
