"""Options of a command from a configuration file and from environment variables.

The option `--config FILE.toml` sets any option of its command under its long name, with `_` for `-`, and in its table
`setting` any field of the command's setting. Environment
variables, such as KITASSIST_C_SUGGEST, override the file; options on the command line override both.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Sequence
from glob import glob
from pathlib import Path
from typing import Annotated, Any, Literal

import click
from click.core import ParameterSource

from planner.system import progress
from planner.system.errors import InputFileError, nearest

from ...declare.options import FieldOption, Value, places, variable_of
from ...people.user_code import function_beside
from .common import INPUT_FILE, Option

ENVIRONMENT = "KITASSIST_"


TABLES = ("tasks", "setting")
"""Tables of a configuration: people's tasks, and the fields of the command's setting."""


def of_kubernetes(name: str) -> bool:
    """Whether Kubernetes has set a variable by itself, as it does in containers beside a service called kitassist."""
    if not os.environ.get(f"{ENVIRONMENT}PORT", "").startswith(("tcp://", "udp://")):
        return False
    return re.match(f"{ENVIRONMENT}(SERVICE_|PORT$|PORT_[0-9]+_)", name) is not None


def configurable(command: click.Command) -> click.Command:
    """Let environment variables set the options of a command; errors state where a faulty value is from."""
    for option in command.params:
        if not isinstance(option, FieldOption):  # the setting reads its own
            option.envvar = ENVIRONMENT + _name(option).upper()
    return command


def variables_that_set_nothing(command: click.Command, kind: type[Any]) -> Iterator[str]:
    """Yield a sentence for each environment variable that looks like one of a command's and sets nothing.

    Parameters
    ----------
    command : click.Command
    kind : type
        The class of its setting.
    """
    from ...connect.bridges import mqtt_settings, opcua_settings

    options = {str(one.envvar) for one in command.params if not isinstance(one, FieldOption)}
    fields = {variable_of(ENVIRONMENT, place) for place in places(kind)}
    known = sorted({*options, *fields, *mqtt_settings.VARIABLES, opcua_settings.PASSWORD, progress.UNSHOWN})
    for name in sorted(os.environ):
        if name.startswith(ENVIRONMENT) and name not in known and not of_kubernetes(name):
            near = nearest(name.removeprefix(ENVIRONMENT), [one.removeprefix(ENVIRONMENT) for one in known])
            meant = "" if near is None else f"; did you mean {ENVIRONMENT}{near}?"
            yield f"{name} in the environment sets nothing{meant}"


def config_option() -> Option[Any]:
    """Return the option `--config`; its file has the tables `TABLES`, too."""

    def read(context: click.Context, _: click.Parameter, file: Path | None) -> Path | None:
        if file is not None:
            context.default_map = read_config(file, context.command.params)
        return file

    return click.option(
        "--config", type=INPUT_FILE, metavar="FILE.toml", is_eager=True, callback=read,
        help="Options from a file, with a table `setting` for all fields of the setting. Environment variables, such "
             "as KITASSIST_C_SUGGEST, and options override them.",
    )  # fmt: skip


def read_config(file: Path, options: Sequence[click.Parameter]) -> dict[str, Any]:
    """Return the values that a file sets, by the names of the options' parameters; paths are relative to its folder.

    Parameters
    ----------
    file : Path
    options : sequence of click.Parameter
        The options that the file may set.

    Raises
    ------
    click.UsageError
        The file cannot be read, or a value is unknown or faulty.
    """
    from ...declare import tables as toml
    from ...declare.declared import names_of
    from .settings import ServeSetting

    without = {"config", "changes", "setting_file"}
    known = {_name(one): one for one in options if one.name not in without and not isinstance(one, FieldOption)}
    try:
        content = toml.load(file)
        for name in names_of(ServeSetting):
            if name in content and name not in known:
                what = "unknown; expected it in the table `setting`, or a file for --setting"
                raise toml.fault(file, name, what)
        table = toml.convert(content, _kinds(known), file)
    except InputFileError as error:
        raise click.UsageError(str(error)) from None
    found = {name: value for name, value in vars(table).items() if value is not None}
    values: dict[str, Any] = {name: dict(found[name]) for name in TABLES if name in found}
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


BESIDE: dict[str, Callable[[Path, str], str]] = {
    "instances": _problem_beside, "problems": _problem_beside, "policy": function_beside,
}  # fmt: skip
"""Options whose texts may be paths, and how these begin in a folder."""


def _kinds(options: dict[str, click.Parameter]) -> type[Any]:
    """Return the declared class of the whole file."""
    from ...declare.declared import AnyTable, Expected, Text, declared

    kinds = {name: _kind(option) for name, option in options.items()}
    kinds |= {"tasks": Annotated[dict[str, Text], Expected("a table of texts")], "setting": AnyTable}
    fields = {name: kind | None for name, kind in kinds.items()}
    return declared(type("Config", (), {"__annotations__": fields, **dict.fromkeys(kinds)}))


def _kind(option: click.Parameter) -> Any:
    """Return the type that an option's value has in a file."""
    from ...declare.declared import Text, Texts, Truth

    if getattr(option, "is_flag", False):
        return Truth
    if getattr(option, "multiple", False) or option.nargs == -1:
        return Texts
    kind = option.type
    if isinstance(kind, click.Choice):
        return Literal[tuple(kind.choices)]  # noqa: RUF100
    return kind.kind if isinstance(kind, Value) else Text
