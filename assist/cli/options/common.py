"""Parameter types and options that several commands share."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.core import ParameterSource

from planner.batch.results_folder import SolveOptions
from planner.system import files

if TYPE_CHECKING:
    pass

Command = TypeVar("Command", bound=Callable[..., Any])
Option = Callable[[Command], Command]


class Number(click.FloatRange):
    """A finite real number, optionally within a range."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Parse and check a value."""
        found: float = super().convert(value, param, ctx)
        if not math.isfinite(found):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return found

    def _describe_range(self) -> str:
        return "" if self.min is self.max is None else super()._describe_range()


GAP = Number(min=0)
SECONDS = Number(min=0, max=1e9, min_open=True)
MEGABYTES = Number(min=0, max=1e12, min_open=True)
JOBS = click.IntRange(min=1, max=10_000)
SEED = click.IntRange(min=0)


class Output(click.Path):
    """An output file, or an output folder. It is checked before the work begins."""

    def __init__(self, *, folder: bool = False) -> None:
        super().__init__(file_okay=not folder, dir_okay=folder, path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Parse a path. Files have to be writable."""
        if not os.fspath(value):
            self.fail(f"expected the name of a {'folder' if self.dir_okay else 'file'}.", param, ctx)
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        if self.file_okay:
            try:
                files.writable(path)
            except OSError as error:
                self.fail(f"{path}: {error.strerror}.", param, ctx)
        return path


INPUT_FILE = click.Path(exists=True, dir_okay=False, path_type=Path)
OUTPUT_FILE = Output()
OUTPUT_FOLDER = Output(folder=True)


GIVEN = {ParameterSource.COMMANDLINE, ParameterSource.ENVIRONMENT, ParameterSource.DEFAULT_MAP}


def is_given(name: str) -> bool:
    """Whether the user set this parameter of the running command, in whatever way."""
    return click.get_current_context().get_parameter_source(name) in GIVEN


def separate_files(outputs: Mapping[str, Path | None], inputs: Mapping[str, Path | None] | None = None) -> None:
    """Raise an error if two outputs are the same file, or if an output is one of the command's input files.

    Parameters
    ----------
    outputs, inputs : mapping
        Each file, keyed by its option; None if the option is not given.

    Raises
    ------
    click.UsageError
    """
    seen = {_identity(path): name for name, path in (inputs or {}).items() if path is not None}
    for name, path in outputs.items():
        if path is None or (path.exists() and not path.is_file()):  # a pipe or a device may receive several outputs
            continue
        other = seen.setdefault(_identity(path), name)
        if other != name:
            raise click.UsageError(f"{name} {path}: the same file as {other}; expected another one")


def _identity(path: Path) -> Any:
    """Return a key that all paths to the same file share, hard links included."""
    try:
        status = path.stat()
    except OSError:
        return os.path.realpath(path)
    return status.st_dev, status.st_ino


def with_options(command: Command, options: Sequence[Option[Any]]) -> Command:
    """Add options to a command, in the order in which the help shows them."""
    for option in reversed(options):
        command = option(command)
    return command


def apart(options: Mapping[str, object]) -> None:
    """Raise a usage error if more than one of these mutually exclusive options is given."""
    given = [name for name, value in options.items() if value]
    if len(given) > 1:
        raise click.UsageError(f"{' and '.join(given)}: expected one of them")


def gap_option(text: str) -> Option[Any]:
    """Return the option `--gap`, the relative gap between the bounds at which a solver stops."""
    return click.option("--gap", type=GAP, default=1e-3, show_default=True, help=text)


def seconds_option(text: str, default: float | None = None) -> Option[Any]:
    """Return the option `--time-limit`. Without a default, time is unlimited."""
    return click.option(
        "--time-limit", type=SECONDS, default=default, show_default=default is not None, metavar="SECONDS", help=text
    )


def megabytes_option(text: str, default: float | None = None) -> Option[Any]:
    """Return the option `--memory-limit`. Without a default, memory is unlimited."""
    return click.option(
        "--memory-limit", type=MEGABYTES, default=default, show_default=default is not None, metavar="MB", help=text
    )


def max_states_option(text: str) -> Option[Any]:
    """Return the option `--max-states`, the largest number of states that is enumerated."""
    return click.option(
        "--max-states", type=click.IntRange(min=1), default=SolveOptions.max_states, show_default=True, help=text
    )


instance_argument = click.argument("instance", metavar="INSTANCE")
domain_option = click.option(
    "--domain",
    type=click.Path(),
    help="Domain file. Unless given, the file in the problem's folder that defines the problem's domain.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as one JSON document.")
