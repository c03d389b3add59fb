"""Console output of every command: JSON, tables, and one-line errors with exit codes."""

from __future__ import annotations

import json
import logging
import signal
import sys
from codecs import lookup
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from enum import IntEnum
from typing import TYPE_CHECKING, Any, NoReturn, TextIO, cast

import click

from planner import LimitError, PDDLError
from planner.grounding.fast_downward import FastDownwardError
from planner.system.errors import InputFileError, MissingExtraError, VisibleText, in_words, visible
from planner.system.processes import NO_MORE_THREADS

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions
    from rich.segment import Segment
    from rich.table import Table


class ExitCode(IntEnum):
    """The exit codes of commands that do not succeed, as `docs/commands.md` has them."""

    FAILED = 1
    USAGE = 2


def fail(message: str, exit_code: int) -> NoReturn:
    """Print one line on stderr and exit."""
    click.echo(message, err=True)
    sys.exit(exit_code)


def note(text: str) -> None:
    """Print a line to stderr, or log it where the log has one object a line (`serve --log-format json`)."""
    log = logging.getLogger("assist.cli")
    if log.isEnabledFor(logging.INFO):
        log.info(text)
    else:
        click.echo(text, err=True)


@contextmanager
def one_line_errors(interrupted: str = "interrupted") -> Iterator[None]:
    """Turn expected errors into one line on stderr and a documented exit code."""
    try:
        yield
    except InputFileError as error:
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
        fail(in_words(error), ExitCode.FAILED)
    except KeyboardInterrupt as error:
        fail(interrupted, _code_of(error))


@contextmanager
def usage_errors(*others: type[ValueError]) -> Iterator[None]:
    """Turn what is wrong with a given value into a usage error; errors of other kinds pass."""
    try:
        yield
    except others:
        raise
    except ValueError as error:
        raise click.UsageError(str(error)) from None


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
        end_after_showing(error)


def end_after_showing(error: KeyboardInterrupt) -> None:
    """Let a command that was interrupted show what is finished; it ends with the interrupt's exit code afterwards."""
    code = _code_of(error)
    click.get_current_context().call_on_close(lambda: fail("interrupted; what was finished by then is shown", code))


def _code_of(error: KeyboardInterrupt) -> int:
    """Return the exit code of an interrupted command, as shells report it: 128 and the number of the signal."""
    return 128 + int(error.args[0] if error.args else signal.SIGINT)


@contextmanager
def printable_output() -> Iterator[None]:
    """Make both outputs safe for any terminal.

    Control characters of messages are written out, so that no file's content or name moves the cursor or changes
    colours. Characters that the encoding of stdout lacks are replaced; where it is ASCII, UTF-8 is written.
    """
    for stream in (sys.stdout, sys.stderr):
        if stream is not None and hasattr(stream, "reconfigure"):
            if lookup(stream.encoding).name == "ascii":
                stream.reconfigure(encoding="utf-8")
            stream.reconfigure(errors="replace" if stream is sys.stdout else "backslashreplace")
    before = sys.stdout, sys.stderr
    if sys.stdout is not None:
        sys.stdout = cast(TextIO, VisibleText(sys.stdout))
    if sys.stderr is not None:
        sys.stderr = cast(TextIO, VisibleText(sys.stderr))
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def print_json(document: Any) -> None:
    """Print a result as JSON."""
    click.echo(json.dumps(document, indent=2))


def print_table(
    head: Sequence[str], rows: Iterable[Sequence[str]], *, left: Collection[int] = (0,), width: int = 140
) -> None:  # fmt: skip
    """Print a table with the terminal's width, or with `width` characters if stdout is a file or a pipe.

    Parameters
    ----------
    head : sequence of str
        The columns' names; all are empty in a table without a head.
    rows : iterable of sequence of str
    left : collection of int
        Numbers of the columns that are aligned to the left; all others have numbers.
    width : int
    """
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False, show_header=any(head))
    for number, name in enumerate(head):
        table.add_column(name, justify="left" if number in left else "right", overflow="fold")
    for row in rows:
        table.add_row(*row)
    terminal = sys.stdout.isatty()
    console = Console(width=None if terminal else width, markup=False, emoji=False)
    with console.capture() as printed:
        console.print(_Cells(table))
    click.echo(printed.get(), nl=False, file=getattr(sys.stdout, "rich_proxied_file", sys.stdout))


class _Cells:
    """A table whose texts are printed with their control characters written out."""

    def __init__(self, table: Table) -> None:
        self._table = table

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Segment]:
        """Yield the table's parts."""
        for part in console.render(self._table, options):
            yield part if part.control else part._replace(text=visible(part.text))
