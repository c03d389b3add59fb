"""Options of the command line from a declared class: usual fields are options, `--set` and `--setting` reach all.

Values come from a file, from environment variables and from the command line; later ones of these take precedence.
A fault is told with the option, the variable or the line of the file that has set the value.
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING
from functools import update_wrapper
from pathlib import Path
from typing import Annotated, Any, Generic, Literal, TypeVar, get_args, get_origin

import click
from click.core import ParameterSource
from pydantic import Field

from planner.system.errors import InputFileError
from planner.system.errors import expected as meant
from planner.system.files import no_such

from . import tables
from .declared import (
    Beside,
    DeclarationError,
    Place,
    Usual,
    annotation_of,
    bare,
    checked,
    default_of,
    is_declared,
    marks,
    names_of,
    phrase,
    plain,
    sentences,
    shown,
    spelt,
)

T = TypeVar("T")
Command = TypeVar("Command", bound=Callable[..., Any])

LEADING_POINT = re.compile(r"(?<![\w.])\.(?=\d)")
"""The point of a number such as .5, which TOML does not have."""


class FieldOption(click.Option):
    """The option of a usual field; its value is what was written."""

    @property
    def field(self) -> str:
        """The name of the field."""
        return self.opts[0].removeprefix("--").replace("-", "_")


class Written(click.ParamType):  # type: ignore[type-arg]
    """A value as it is written on the command line; `Given` reads it."""

    def __init__(self, metavar: str) -> None:
        self.name = metavar


class Value(click.ParamType):  # type: ignore[type-arg]
    """A value of a declared type, such as `Count`, within limits such as `le=100`."""

    name = "n"

    def __init__(self, kind: Any, **limits: float) -> None:
        self.kind = Annotated[kind, Field(**limits)] if limits else kind  # type: ignore[call-overload]

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Read and check a value."""
        try:
            return checked(self.kind, value_of(value, self.kind) if isinstance(value, str) else value)
        except DeclarationError as error:
            self.fail(f"{value}; expected {error.right}", param, ctx)


class Input(click.Path):
    """An input file, or also a folder. Of one that does not exist, the most similar name in its folder is told."""

    def __init__(self, *, folder: bool = False) -> None:
        super().__init__(exists=True, dir_okay=folder, path_type=Path)
        self.missing = f"no such file{' or folder' * folder}"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Parse a path."""
        path = Path(os.fspath(value))
        if os.fspath(value) and not path.exists():
            self.fail(f"{path}: {no_such(path, self.missing)}", param, ctx)
        return Path(os.fsdecode(super().convert(value, param, ctx)))


class Given(Generic[T]):
    """The values of a declared class that were given, each with its source.

    Attributes
    ----------
    kind : type
    values : dict
        Plain data; fields that are declared classes themselves are dictionaries.
    sources : dict of tuple to (str or Path, str)
        Source of each value by its place: an option, a variable, or a file and the table in which its values stand.
    """

    def __init__(self, kind: type[T]) -> None:
        self.kind = kind
        self.values: dict[str, Any] = {}
        self.sources: dict[Place, tuple[str | Path, str]] = {}

    def __contains__(self, name: str) -> bool:
        """Whether a field, or a part of it, was given."""
        return any(place[0] == name and not self._is_default(place) for place in self.sources)

    def _is_default(self, place: Place) -> bool:
        """Whether a file sets the value at a place to its default, as the file of `printed` does for every field."""
        if not isinstance(self.sources[place][0], Path):
            return False
        value: Any = self.values
        default: Any = default_of(self.kind, str(place[0]))
        for number, part in enumerate(map(str, place)):
            value, default = value[part], getattr(default, part, MISSING) if number else default
        return default is not MISSING and bool(value == plain(default))

    def put(self, place: Place, value: Any, source: str | Path, table: str = "") -> None:
        """Set the value at a place; a table sets each of its fields."""
        kind = _kind_at(self.kind, place)
        if isinstance(value, Mapping) and is_declared(bare(kind)):
            for name, inner in value.items():
                self.put((*place, name), inner, source, table)
            return
        within = self.values
        for name in place[:-1]:
            within = within.setdefault(str(name), {})
            if not isinstance(within, dict):
                raise click.UsageError(f"{source}: {name} is set as a whole already; expected one of them")
        if isinstance(within.get(str(place[-1])), dict) and not isinstance(value, Mapping):
            if not any(isinstance(self.sources[one][0], Path) for one in self.sources if one[0] == place[0]):
                raise click.UsageError(f"{source}: a part of {spelt(place)} is set already; expected one of them")
            self.sources = {one: said for one, said in self.sources.items() if one[: len(place)] != place}
        within[str(place[-1])] = value
        self.sources[place] = (source, table)

    def file(self, file: Path, content: Mapping[str, Any], table: str = "") -> None:
        """Set the values of a file, or of one of its tables; paths begin in the file's folder."""
        for name, value in tables.beside(self.kind, content, file.parent).items():
            self.put((name,), value, file, table)

    def text(self, name: str, text: str, source: str) -> None:
        """Set a field, such as `c_suggest` or `population.beta`, to a value that is written in TOML, or a plain text.

        The source names the field, too.

        Raises
        ------
        click.UsageError
            There is no such field.
        """
        place: Place = ()
        for part in name.split("."):
            kind = _kind_at(self.kind, place)
            known = names_of(bare(kind))
            if not known:
                own = f"{spelt(place)} has no parts"
                raise click.UsageError(f"{source}: {own}; expected --set {spelt(place)}=VALUE, which is {phrase(kind)}")
            if part not in known:
                raise click.UsageError(f"{source}: unknown; {meant(part, known)}")
            place = (*place, part)
        self.put(place, value_of(text, _kind_at(self.kind, place)), source)

    def files(self) -> dict[str, Path | None]:
        """Return the files among the values, such as that of a population, by their fields."""
        return {
            name: Path(value)
            for name, value in self.values.items()
            if isinstance(value, str) and any(isinstance(one, Beside) for one in marks(_kind_at(self.kind, (name,))))
        }

    def refuse(self, names: Iterable[str], reason: str) -> None:
        """Raise a usage error if some of these fields were given, as they have no effect; it names all of them.

        Parameters
        ----------
        names : iterable of str
        reason : str
            Why, such as "without several goals".
        """
        faults = list[str]()
        for name in names:
            parts = tuple(name.split("."))
            for place in self.sources:
                if place[: len(parts)] == parts and not self._is_default(place):
                    faults.append(f"{self._told_by(place, name)} has no effect {reason}")
        if faults:
            raise click.UsageError("; ".join(faults))

    def _told_by(self, place: Place, name: str) -> str:
        """Return the source of the value at a place, and in a file its line and the name of the field."""
        source, table = self.sources[place]
        if not isinstance(source, Path):
            return source
        line = tables.line_of(source, f"{table}.{spelt(place)}".strip("."))
        return f"{source}:{line}: {f'{table}.{name}'.strip('.')}"

    def read(self) -> T:
        """Return the object of the class.

        Raises
        ------
        click.UsageError
            A value is faulty.
        """
        try:
            return self.kind(**self.values)
        except DeclarationError as error:
            raise click.UsageError(self.told(error)) from None

    def told(self, error: DeclarationError) -> str:
        """Return the message of a fault with the source of the value."""
        place = error.place
        for length in range(len(place), 0, -1):
            if place[:length] not in self.sources:
                continue
            source, table = self.sources[place[:length]]
            if isinstance(source, Path):
                what = f"{table}.{spelt(place)}".strip(".")
                return f"{source}:{tables.line_of(source, what)}: {what}: {error.told}"
            return f"{source}: {f'{spelt(place)}: ' * (len(place) > length)}{error.told}"
        for field in error.fields:
            for one, (source, table) in self.sources.items():
                if isinstance(source, Path) and one[: len(place) + 1] == (*place, field):
                    line = tables.line_of(source, f"{table}.{spelt(one)}".strip("."))
                    what = f"{table}.{spelt(place)}".strip(".")
                    return f"{source}:{line}: {what}{': ' * bool(what)}{error.told}"
        return str(error)


def _kind_at(kind: Any, place: Place) -> Any:
    for part in place:
        inner = bare(kind)
        if not is_declared(inner) or part not in names_of(inner):
            return Any
        kind = annotation_of(inner, str(part))
    return kind


def value_of(text: str, kind: Any) -> Any:
    """Return the value of a text: texts and words as they are, all else as TOML has it."""
    inner = bare(kind)
    if inner is str or get_origin(inner) is Literal:
        return text
    for written in (text, LEADING_POINT.sub("0.", text)):
        with suppress(tomllib.TOMLDecodeError):
            found = tomllib.loads(f"value = {written}")
            return found["value"] if len(found) == 1 else text
    with suppress(ValueError):
        return float(text) if inner is float else text  # 5. is no TOML
    return text


def usual(kind: Any) -> Iterator[tuple[str, Usual]]:
    """Yield the name of each usual field of a declared class, and its mark."""
    for name in names_of(kind):
        mark = next((one for one in marks(annotation_of(kind, name)) if isinstance(one, Usual)), None)
        if mark is not None:
            yield name, mark


def setting_options(
    kind: type[Any], *, without: Sequence[str] = (), environment: str | None = None
) -> Callable[[Command], Command]:
    """Return a decorator that adds the options of a declared class to a command's function.

    The function is called with `setting`, the object, and `given`, the `Given` from which it was read.

    Parameters
    ----------
    kind : type
        A declared class.
    without : sequence of str
        Usual fields that are no options of this command.
    environment : str, optional
        Prefix of environment variables that set fields, such as KITASSIST_C_SUGGEST.
    """

    def add(function: Command) -> Command:
        def run(**parameters: Any) -> Any:
            given = gathered(kind, parameters, environment)
            return function(setting=given.read(), given=given, **parameters)

        command: Any = update_wrapper(run, function)
        command = click.option(
            "--set", "changes", multiple=True, metavar="NAME=VALUE",
            help="Any other field of the setting; `kitassist settings` lists them.",
        )(command)  # fmt: skip
        command = click.option(
            "--setting", "setting_file", type=Input(),
            metavar="FILE.toml", help="Fields of the setting from a file, as `kitassist settings` prints them.",
        )(command)  # fmt: skip
        for name, mark in reversed([one for one in usual(kind) if one[0] not in without]):
            command = _option(kind, name, mark)(command)
        return command

    return add


def _option(kind: Any, name: str, mark: Usual) -> Callable[[Command], Command]:
    annotation, default = annotation_of(kind, name), default_of(kind, name)
    inner, text = bare(annotation), sentences(kind)[name]
    options: dict[str, Any] = {"type": Written(mark.metavar or "VALUE"), "metavar": mark.metavar}
    if get_origin(inner) is Literal:
        options = {"type": click.Choice(list(get_args(inner)))}
    elif inner is bool:
        options = {"is_flag": True}
    if mark.default is not None or isinstance(default, str | int | float):
        text += "" if default is False else f"  [default: {mark.default or default}]"
    return click.option(f"--{name.replace('_', '-')}", cls=FieldOption, default=None, help=text, **options)


def gathered(kind: type[T], parameters: dict[str, Any], environment: str | None = None) -> Given[T]:
    """Return what the running command was given of a class; its options are taken from the parameters.

    Parameters
    ----------
    kind : type
    parameters : dict
        Values of the command's options.
    environment : str, optional
        Prefix of environment variables.

    Raises
    ------
    click.UsageError
        A file cannot be read, a name is unknown, or a field is set twice.
    """
    context = click.get_current_context()
    given = Given(kind)
    config = (context.default_map or {}).get("setting")
    if config is not None:
        given.file(context.params["config"], config, "setting")
    file = parameters.pop("setting_file")
    if file is not None:
        try:
            given.file(file, _of_setting(file, kind, context.command))
        except InputFileError as error:
            raise click.UsageError(str(error)) from None
    if environment is not None:
        for place in places(kind):
            variable = variable_of(environment, place)
            if text := os.environ.get(variable):  # an empty one is as none, as for other options
                given.put(place, value_of(text, _kind_at(kind, place)), variable)
    written: set[str] = set()
    for option in context.command.params:
        if isinstance(option, FieldOption) and option.name is not None:
            value = parameters.pop(option.name)
            if context.get_parameter_source(option.name) is ParameterSource.COMMANDLINE:
                if isinstance(value, str):
                    value = value_of(value, annotation_of(kind, option.field))
                given.put((option.field,), value, option.opts[0])
                written.add(option.field)
    for change in parameters.pop("changes"):
        name, equals, text = change.partition("=")
        name = name.strip()
        if not name or not equals:
            raise click.UsageError(f"--set {change}: expected NAME=VALUE, such as gamma=0.95")
        if any(f"{one}.".startswith(f"{name}.") or name.startswith(f"{one}.") for one in written):
            raise click.UsageError(f"--set {name}: it is set twice; expected one value")
        written.add(name)
        given.text(name, text.strip(), f"--set {name}")
    return given


def _of_setting(file: Path, kind: Any, command: click.Command) -> dict[str, Any]:
    """Return the content of a file for `--setting`; one for the command's `--config` is refused as such."""
    content, known = tables.load(file), names_of(kind)
    options = {one.opts[0].lstrip("-").replace("-", "_") for one in command.params} | {"setting", "tasks"}
    meant_for_config = [name for name in content if name in options and name not in known]
    if meant_for_config and "config" in options:
        raise tables.fault(file, meant_for_config[0], "unknown; this is a file for --config")
    return content


def variable_of(environment: str, place: tuple[str, ...]) -> str:
    """Return the environment variable that sets the field at a place, given the prefix of all."""
    return environment + "_".join(place).upper()


def places(kind: Any) -> Iterator[tuple[str, ...]]:
    """Yield the place of each field of a declared class, and of the fields of declared classes in it."""
    for name in names_of(kind):
        yield (name,)
        inner = bare(annotation_of(kind, name))
        if is_declared(inner) and inner is not kind:
            yield from ((name, *place) for place in places(inner) if len(place) == 1)


def printed(kind: Any) -> str:
    """Return a TOML file with all fields of a declared class, their sentences and defaults; it can be read as it is."""
    return "\n".join(_lines(kind, ""))


def _lines(kind: Any, hidden: str, usual: Any = None) -> list[str]:
    """Return the lines of a table; `hidden` is "# " where the table is not set.

    Where another object of the class, `usual`, stands for a table that is not set, fields that it has otherwise are
    without a value: their sentence, or that of the table, says what holds.
    """
    lines, tables_after = list[str](), list[str]()
    for name in names_of(kind):
        annotation, default = annotation_of(kind, name), default_of(kind, name)
        inner, text = bare(annotation), f"# {sentences(kind)[name]}"
        if is_declared(inner):
            unset = hidden if default == inner() else "# "
            tables_after += ["", text, f"{unset}[{name}]", *_lines(inner, unset, default)]
            continue
        lines.append(f"{text} It is {phrase(annotation)}.")
        otherwise = is_declared(type(usual)) and getattr(usual, name) != default
        value = "" if default is MISSING or otherwise else plain(default)
        lines.append(f"# {name} =" if value in ("", None, [], {}) else f"{hidden}{name} = {toml(value)}")
    return lines + tables_after


def toml(value: Any) -> str:
    """Return plain data as a value in TOML."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{name} = {toml(own)}" for name, own in value.items()) + "}"
    if isinstance(value, list):
        return f"[{', '.join(map(toml, value))}]"
    return shown(value)
