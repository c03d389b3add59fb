"""Parameter types and options that several commands share."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import update_wrapper
from pathlib import Path
from typing import Annotated, Any, TypeVar

import click
from click.core import ParameterSource
from pydantic import Field

from planner.system import files

from ...declare.declared import Count, Expected, Kind, Number, Seconds, Seed
from ...declare.options import Input, Value

Command = TypeVar("Command", bound=Callable[..., Any])
Option = Callable[[Command], Command]


Megabytes = Annotated[Number, Field(gt=0, le=1e12), Kind("a number of MB")]


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


INPUT_FILE = Input()
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


def together(name: str, kind: type[Any], options: Sequence[Option[Any]]) -> Option[Any]:
    """Return a decorator that adds options; the command's function gets their values as one object of this name.

    Parameters
    ----------
    name : str
    kind : type
        A named tuple, whose fields are the names of the values.
    options : sequence of decorators
    """

    def add(function: Command) -> Command:
        def run(**parameters: Any) -> Any:
            values = {field: parameters.pop(field) for field in kind._fields}
            return function(**{name: kind(**values)}, **parameters)

        return with_options(update_wrapper(run, function), options)  # type: ignore[return-value]

    return add


def apart(options: Mapping[str, object]) -> None:
    """Raise a usage error if more than one of these mutually exclusive options is given."""
    given = [name for name, value in options.items() if value]
    if len(given) > 1:
        raise click.UsageError(f"{' and '.join(given)}: expected one of them")


GAP = Annotated[Number, Field(ge=0, le=1), Expected("a fraction from 0 to 1, such as 0.05 for 5 %")]
gap_option = click.option(
    "--gap", type=Value(GAP), default=1e-3, show_default=True, metavar="FRACTION",
    help="Relative gap between the bounds of each person's problem, (upper - lower) / |lower|, that is small enough.",
)  # fmt: skip
time_limit_option = click.option(
    "--time-limit", type=Value(Seconds), default=300.0, show_default=True, metavar="SECONDS",
    help="Time for an instance, or for a bound. What is known by then is reported.",
)  # fmt: skip
jobs_option = click.option(
    "--jobs", type=Value(Count, le=10_000), help="Number of processors to use. All unless given."
)
scheduler_option = click.option(
    "--scheduler", metavar="ADDRESS", help="Use the workers of a Dask cluster (extra `cluster`)."
)
resume_option = click.option("--resume", is_flag=True, help="Keep what is finished in --out, and do the rest.")
seed_option = click.option(
    "--seed", type=Value(Seed), default=0, show_default=True, help="Random seed."
)  # fmt: skip
json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
baseline_option = click.option("--baseline", metavar="NAME", help="Which of those compared differences refer to.")
figures_option = click.option("--figures", type=OUTPUT_FOLDER, help="Folder for figures.")


def out_option(what: str, *, folder: bool = False, required: bool = False) -> Option[Any]:
    """Return the option `--out`: where a command writes its result, which is described in words."""
    kind = OUTPUT_FOLDER if folder else OUTPUT_FILE
    return click.option("--out", type=kind, required=required, help=f"Where the result is written: {what}.")


def humans_option(*, required: bool) -> Option[Any]:
    """Return the option `--humans`."""
    return click.option(
        "--humans", type=Value(Count, le=10_000), required=required, metavar="K",
        help="Number of people in the team.",
    )  # fmt: skip


def data_option(*, required: bool) -> Option[Any]:
    """Return the option `--data`."""
    return click.option(
        "--data", type=OUTPUT_FOLDER, required=required, metavar="DIR",
        help="Folder of the session or study, which is resumed if it has begun.",
    )  # fmt: skip


def new_folder() -> Path:
    """Make a temporary folder for a session without `--data`, and return its path."""
    return Path(tempfile.mkdtemp(prefix="kitassist-"))


instance_argument = click.argument("instance", metavar="INSTANCE")
domain_option = click.option(
    "--domain",
    type=click.Path(),
    help="Domain file. Unless given, the file in the problem's folder that defines the problem's domain.",
)
