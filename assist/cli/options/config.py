"""Options of a command from a configuration file and from environment variables.

The option `--config FILE.toml` sets any option of its command under its long name, with `_` for `-`. Environment
variables, such as KITASSIST_C_SUGGEST, override the file; options on the command line override both.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from glob import glob
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import click
from click.core import ParameterSource

from planner.system.errors import InputFileError, MissingExtraError

from ...people.user_code import parse
from .common import INPUT_FILE, ROBOTS, Option

if TYPE_CHECKING:
    from msgspec import Struct

ENVIRONMENT = "KITASSIST_"


def configurable(command: click.Command) -> click.Command:
    """Let environment variables set the options of a command; errors state where a faulty value is from."""
    for option in command.params:
        option.envvar = ENVIRONMENT + _name(option).upper()
    return command


def config_option(*tables: str) -> Option[Any]:
    """Return the option `--config`; the file may have the `tables` of texts, too, which `tables_of` returns."""

    def read(context: click.Context, _: click.Parameter, file: Path | None) -> Path | None:
        if file is not None:
            settings = read_config(file, context.command.params, tables)
            context.default_map = settings
        return file

    return click.option(
        "--config", type=INPUT_FILE, metavar="FILE.toml", is_eager=True, callback=read,
        help="Options from a file, such as c_suggest = 0.2. Environment variables, such as KITASSIST_C_SUGGEST, and "
             "options override them.",
    )  # fmt: skip


def read_config(file: Path, options: Sequence[click.Parameter], tables: Sequence[str] = ()) -> dict[str, Any]:
    """Return the values that a file sets, by the names of the options' parameters; paths are relative to its folder.

    Parameters
    ----------
    file : Path
    options : sequence of click.Parameter
        The options that the file may set.
    tables : sequence of str
        Names of tables of texts, which are returned like values.

    Raises
    ------
    click.UsageError
        The file cannot be read, or a value is unknown or faulty.
    MissingExtraError
        The library for typed tables is not installed.
    """
    try:
        from assist.texts import typed_toml
    except ImportError as error:
        raise MissingExtraError("a configuration file needs", str(error.name), "web") from None
    known = {_name(option): option for option in options if option.name != "config"}
    try:
        with typed_toml.located(file):
            found = typed_toml.given(typed_toml.convert(typed_toml.load(file), _kinds(known, tables), file))
    except InputFileError as error:
        raise click.UsageError(str(error)) from None
    values: dict[str, Any] = {name: dict(found[name]) for name in tables if name in found}
    for name, option in known.items():
        if name in found:
            values[option.name or name] = _beside(file, option, found[name])
    return values


def named(error: click.BadParameter) -> click.BadParameter:
    """Return an error of an option with the file or variable that has set it."""
    context, option = error.ctx, error.param
    if context is None or option is None:
        return error
    source = context.get_parameter_source(option.name or "")
    origins = {ParameterSource.ENVIRONMENT: option.envvar, ParameterSource.DEFAULT_MAP: context.params.get("config")}
    if source not in origins:
        return error
    return click.BadParameter(f"{error.message} (from {origins[source]})", context, option, error.param_hint)


def _name(option: click.Parameter) -> str:
    """Return the name of an option in files."""
    return option.opts[0].lstrip("-").replace("-", "_")


def _beside(file: Path, option: click.Parameter, value: Any) -> Any:
    """Return a value; a relative path in it is one from the file's folder."""
    if isinstance(option.type, click.Path):
        return str(file.parent / value)
    beside = BESIDE.get(option.name or "")
    if beside is None:
        return value
    return beside(file.parent, value) if isinstance(value, str) else tuple(beside(file.parent, one) for one in value)


def _problem_beside(folder: Path, text: str) -> str:
    """Return the path of problems that are in a folder; other texts, which may name bundled tasks, as they are."""
    there = (folder / text).exists() or glob(text, root_dir=folder)  # noqa: PTH207  which takes absolute patterns, too
    return str(folder / text) if there else text


def _function_beside(folder: Path, text: str) -> str:
    """Return FILE.py:FUNCTION with a path from a folder; other names unchanged."""
    place = parse(text, folder)
    return text if place is None else f"{place[0]}:{place[1]}"


def _texts_beside(folder: Path, text: str) -> str:
    """Return a file of texts with a path from a folder; a language unchanged."""
    return str(folder / text) if text.endswith(".toml") else text


BESIDE: dict[str, Callable[[Path, str], str]] = {
    "instances": _problem_beside, "problems": _problem_beside, "policy": _function_beside, "people": _function_beside,
    "language": _texts_beside,
}  # fmt: skip
"""Options whose texts may be paths, and how these begin in a folder."""


def _kinds(options: dict[str, click.Parameter], tables: Sequence[str]) -> type[Struct]:
    """Return the type of the whole file."""
    import msgspec
    from msgspec import UNSET, UnsetType

    from assist.texts.typed_toml import Text

    texts = Annotated[dict[str, Text], msgspec.Meta(description="a table of texts")]
    kinds = {name: _kind(option) for name, option in options.items()} | dict.fromkeys(tables, texts)
    fields: list[tuple[str, Any, Any]] = [(name, kind | UnsetType, UNSET) for name, kind in kinds.items()]
    return msgspec.defstruct("Config", fields, forbid_unknown_fields=True)


def _kind(option: click.Parameter) -> Any:
    """Return the type that an option's value has in a file."""
    from msgspec import Meta

    from assist.texts.typed_toml import Pair, Text, Texts, Truth, WholeOrTables

    if getattr(option, "is_flag", False):
        return Truth
    if getattr(option, "multiple", False) or option.nargs == -1:
        return Texts
    if option.nargs == 2:
        return Pair
    kind = option.type
    if kind is ROBOTS:
        return WholeOrTables
    if isinstance(kind, click.Choice):
        choices = tuple(kind.choices)
        return Annotated[Literal[choices], Meta(description=" or ".join(f'"{one}"' for one in choices))]
    if isinstance(kind, click.IntRange):
        return Annotated[int, Meta(ge=kind.min, le=kind.max, description=f"a whole number{_range(kind.min, kind.max)}")]
    if isinstance(kind, click.FloatRange):
        if kind.min_open:
            return Annotated[float, Meta(gt=kind.min, le=kind.max, description=f"a number above {kind.min:g}")]
        return Annotated[float, Meta(ge=kind.min, le=kind.max, description=f"a number{_range(kind.min, kind.max)}")]
    return Text


def _range(least: float | None, most: float | None) -> str:
    if least is None:
        return ""
    return f" of {least:g} or more" if most is None else f" from {least:g} to {most:g}"
