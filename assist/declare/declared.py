"""The decorator `declared`, the types of declared fields, and errors of one sentence.

    @declared
    class Robot:
        c_move: Annotated[Number, Field(ge=0, le=MOST, description="Cost of moving by a distance of 1.")] = 0.5

`Robot(c_move=-1)` raises "c_move -1: expected a number from 0 to 1e+15", `Robot(c_mov=1)` proposes the nearest name.
Numbers of any kind are accepted, numpy's scalars too, and become Python's own; truth values are no numbers. Mappings
and lists become the declared classes and tuples of fields, so that plain data need no conversion of their own.
"""

from __future__ import annotations

import dataclasses
import json
import math
import operator
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, wraps
from numbers import Real
from pathlib import Path
from types import UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    TypeVar,
    Union,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
    overload,
)

from pydantic import BeforeValidator, ConfigDict, Field, Strict, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass as validated
from pydantic_core import PydanticCustomError

from planner.system.errors import expected as meant

T = TypeVar("T")
Place = tuple[str | int, ...]

MOST = 1e15
"""Largest cost, rate or size: sums of larger numbers are not exact in floating point, and products overflow."""

CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False, populate_by_name=True)


@dataclasses.dataclass(frozen=True)
class Kind:
    """What a value of a type is, as messages say it; the limits of the field follow."""

    text: str


@dataclasses.dataclass(frozen=True)
class Expected:
    """What a field's value is, limits included, where its type does not say it well."""

    text: str


@dataclasses.dataclass(frozen=True)
class Usual:
    """Marks a field that is an option of the command line; other fields are set with `--set` or in a file.

    Attributes
    ----------
    metavar : str, optional
        Placeholder of the value in help texts.
    default : str, optional
        The default in help texts, where it is not plain.
    """

    metavar: str | None = None
    default: str | None = None


@dataclasses.dataclass(frozen=True)
class Beside:
    """Marks a text that may be a path, which in a file is one from the file's folder.

    Attributes
    ----------
    found : callable
        Takes the folder and the text, and returns the text from there.
    """

    found: Callable[[Path, str], str] = lambda folder, text: str(folder / text)


@dataclasses.dataclass(frozen=True)
class Seldom:
    """Marks a field of a view that its JSON has only where it differs from its default."""


def real_number(value: Any) -> float:
    """Return a real number of any type as a float, an infinite one if it is too large; truth values are none."""
    try:
        if type(value) is not bool and isinstance(value, Real):
            return float(value)
    except OverflowError:
        return math.inf
    raise PydanticCustomError("kind", "a number")


def whole_number(value: Any) -> int:
    """Return a whole number of any type as Python's own; truth values are none."""
    try:
        found = None if isinstance(value, bool) or type(value).__name__ == "bool" else operator.index(value)
    except TypeError:
        found = None
    if found is None:
        raise PydanticCustomError("kind", "a whole number")
    return found


def _truth(value: Any) -> bool:
    if isinstance(value, bool) or type(value).__name__ == "bool":  # numpy's has that name, too
        return bool(value)
    raise PydanticCustomError("kind", "a truth value")


def _pair(value: Any) -> Any:
    """Return a sequence or an array of one axis as a tuple."""
    listed = value.tolist() if hasattr(value, "tolist") else value
    return tuple(listed) if isinstance(listed, list) else listed


Number = Annotated[float, BeforeValidator(real_number), Kind("a number")]
AnyNumber = Annotated[float, Field(allow_inf_nan=True), BeforeValidator(real_number), Kind("a number")]
Seconds = Annotated[float, BeforeValidator(real_number), Field(gt=0, le=1e9), Kind("a number of seconds")]
Whole = Annotated[int, BeforeValidator(whole_number), Kind("a whole number")]
Truth = Annotated[bool, BeforeValidator(_truth), Kind("true or false")]
Count = Annotated[Whole, Field(ge=1)]
Seed = Annotated[Whole, Field(ge=0)]
Text = Annotated[str, Strict(), Field(min_length=1), Expected("a text")]
Range = Annotated[tuple[Number, Number], BeforeValidator(_pair), Expected("two numbers, [low, high]")]
AnyText = Annotated[str, Strict(), Expected("a text")]
Texts = Annotated[tuple[Text, ...], Field(min_length=1), Expected("a list of one text or more")]
Counts = Annotated[tuple[Count, ...], Field(min_length=1), Expected("a list of whole numbers of 1 or more")]
AnyTable = Annotated[dict[str, Any], Strict(), Expected("a table")]


class DeclarationError(ValueError):
    """A value that a declared field does not have. The message is one sentence.

    Attributes
    ----------
    place : tuple of str and int
        Names of fields, and numbers within lists from 0; empty if the fault is one of several fields together.
    found : str or None
        The value, as a file has it; None if there is none to show.
    right : str
        What is expected, or what is wrong if `found` is None.
    fields : tuple of str
        Of a fault of several fields together, or of one of them: those fields of the object at the place, the one that
        should be changed first. Empty if the place says it.
    """

    def __init__(self, place: Place, found: Any, right: str, message: str, fields: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.place, self.found, self.right, self.fields = place, found, right, fields

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.place, self.found, self.right, str(self), self.fields)

    @classmethod
    def among(cls, right: str, *fields: str) -> DeclarationError:
        """Return a fault of fields of an object, which its class finds when it is made."""
        return cls((), None, right, right, fields)

    def within(self, place: Place) -> DeclarationError:
        """Return the fault as one of the object at a place."""
        message = f"{spelt(place)}: {self}" if place else str(self)
        return DeclarationError((*place, *self.place), self.found, self.right, message, self.fields)

    @property
    def told(self) -> str:
        """The fault as it is told after the place in a file."""
        return self.right if self.found is None else f"{self.found}; expected {self.right}"

    @classmethod
    def of(cls, kind: Any, error: ValidationError, given: Any) -> DeclarationError:
        """Return the error of a type, such as a declared class, that a validation of what was given found first."""
        faults = error.errors(include_url=False)
        unknown = next((one for one in faults if one["type"] in UNKNOWN), None)
        unknown = unknown if faults[0]["type"] in {*UNKNOWN, *MISSING} else None
        here = [one for one in faults if one["loc"][:1] == faults[0]["loc"][:1]]
        fault = unknown or max(here, key=lambda one: len(_place(kind, one["loc"])[0]))  # of a union the nearest member
        if fault["type"] in UNKNOWN:
            place, owner = _place(kind, fault["loc"][:-1])
            name = str(fault["loc"][-1])
            right = f"unknown; {meant(name, names_of(owner))}"
            where = (*place, name)
            return cls(where, None, right, f"{_short(spelt(where))}: {right}")
        is_key = fault["loc"][-1:] == ("[key]",)
        place, owner = _place(kind, fault["loc"][:-2] if is_key else fault["loc"])
        if is_key:
            owner = next(get_args(bare(one))[0] for one in _members(owner) if get_origin(bare(one)) in (dict, Mapping))
        if fault["type"] == "value_error":
            inner = fault["ctx"]["error"]
            if isinstance(inner, DeclarationError):
                return inner.within(place)
            return cls(place, None, str(inner), f"{spelt(place)}: {inner}" if place else str(inner))
        is_half = fault["type"] == "string_unicode"  # half a character, of a text or the name of a field
        right = "Unicode text" if is_half else phrase(owner)
        if fault["type"] in MISSING and isinstance(fault["loc"][-1], str):
            return cls(place, None, f"is missing; expected {right}", f"{spelt(place)}: is missing; expected {right}")
        found = fault["input"] if is_key or is_half else _at(given, place, fault["input"])
        text = f"{found:g}" if isinstance(found, float) and "whole" not in right else repr(found)
        what, at = "key " * is_key, _short(spelt(place)) + ":" * is_key
        message = f"{at} {what}{_short(text)}: expected {right}".lstrip()
        return cls(place, what + _short(shown(found)), right, message)


class UserCodeError(DeclarationError):
    """A user's function, class or file does not exist, fails, or does not return what it should.

    Attributes
    ----------
    code : object
        The team policy at fault; None if it is other code, or not known, as after pickling.
    """

    def __init__(self, message: str, place: Place = (), *, code: object = None) -> None:
        super().__init__(place, None, message, f"{spelt(place)}: {message}" if place else message)
        self.code = code

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.right, self.place)

    def within(self, place: Place) -> UserCodeError:
        """Return the fault as one of the code at a place."""
        return UserCodeError(self.right, (*place, *self.place), code=self.code)


def checked(kind: Any, value: Any) -> Any:
    """Return a value as a declared type has it.

    Raises
    ------
    DeclarationError
        The type does not have it.
    """
    try:
        return TypeAdapter(kind, config=CONFIG).validate_python(value)
    except ValidationError as error:
        fault = DeclarationError.of(kind, error, value)
    raise fault


UNKNOWN = {"unexpected_keyword_argument", "extra_forbidden"}
MISSING = {"missing", "missing_argument"}


class View:
    """What is shown or told, with its JSON."""

    def as_dict(self) -> dict[str, Any]:
        """Return the fields in the types that JSON has; a number that is not finite is None."""
        found: dict[str, Any] = _in_json(self)
        return found


@cache
def _told(kind: Any) -> list[tuple[str, Any]]:
    """Return the fields that the JSON of a view has, each with the value at which it is left out."""
    return [
        (name, default_of(kind, name) if Seldom() in field.metadata else dataclasses.MISSING)
        for name, field in kind.__pydantic_fields__.items() if not field.exclude
    ]  # fmt: skip


def _in_json(value: Any) -> Any:
    if value is None or isinstance(value, str | int):
        return value
    if isinstance(value, View):
        kind: Any = type(value)
        every = ((name, usual, getattr(value, name)) for name, usual in _told(kind))
        return {name: _in_json(own) for name, usual, own in every if own != usual}
    if isinstance(value, Mapping):
        return {str(name): _in_json(own) for name, own in value.items()}
    if isinstance(value, tuple | list):
        return [_in_json(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@overload
def declared(cls: type[T]) -> type[T]: ...
@overload
def declared(*, partial: bool = ..., kw_only: bool = ...) -> Callable[[type[T]], type[T]]: ...


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field,))
def declared(cls: type[T] | None = None, *, partial: bool = False, kw_only: bool = False) -> Any:
    """Make a class one of declared fields: frozen, checked, compared by its values, with its fields in its docstring.

    Parameters
    ----------
    cls : type
    partial : bool
        Whether the fields of its base are None in it unless they are given. Those of its own are as they are declared.
    kw_only : bool
        Whether fields are given by their names alone, so that those without a default may follow others.
    """
    if cls is None:
        return lambda one: _declared(one, partial=partial, kw_only=kw_only)
    return _declared(cls, partial=partial, kw_only=kw_only)


def _declared(cls: type[T], *, partial: bool, kw_only: bool) -> type[T]:
    if partial:
        base = cls.__mro__[1]
        hints, said = get_type_hints(base, include_extras=True), sentences(base)
        own, new = cls.__annotations__, {name: text for name, text in said.items() if name not in cls.__annotations__}
        cls.__annotations__ = {
            name: Annotated[hints[name] | None, Field(description=text)] for name, text in new.items()
        } | own
        for name in new:
            setattr(cls, name, None)
    made: Any = validated(frozen=True, repr=False, kw_only=kw_only, config=CONFIG)(cls)
    bare = made.__init__
    positional = [one.name for one in dataclasses.fields(made) if not one.kw_only]

    @wraps(bare)
    def __init__(self: Any, *given: Any, **named: Any) -> None:  # noqa: N807
        every = dict(zip(positional, given, strict=False)) | named
        if len(every) < len(given) + len(named):
            raise TypeError(f"{type(self).__name__}: too many arguments, or one that is there twice")
        try:
            bare(self, **every)
            return
        except ValidationError as error:
            fault = DeclarationError.of(type(self), error, every)
        raise fault  # without a context, with which Dask's workers could not send it

    made.__init__ = __init__
    if made.__repr__ is object.__repr__:  # a base's own is kept
        made.__repr__ = _outline
    rows = [f"{name}\n    {text}" for name, text in sentences(made).items() if text]
    if made.__doc__ and rows and "Attributes\n" not in made.__doc__:
        made.__doc__ = "\n".join([made.__doc__.rstrip(), "", "Attributes", "----------", *rows, ""])
    return made


def _outline(self: Any) -> str:
    every = (f"{one.name}={getattr(self, one.name)!r}" for one in dataclasses.fields(self))
    return f"{type(self).__qualname__}({', '.join(every)})"


def is_declared(kind: Any) -> bool:
    """Whether this is a declared class."""
    return isinstance(kind, type) and hasattr(kind, "__pydantic_fields__")


def names_of(kind: Any) -> list[str]:
    """Return the names of the fields of a declared class, or of those in a union."""
    return [name for one in _members(kind) if is_declared(one) for name in _fields(one)]


def _fields(kind: Any) -> dict[str, Any]:
    """Return the fields of a declared class by their names in files: a field that is a word of Python has an alias."""
    return {field.alias or name: field for name, field in kind.__pydantic_fields__.items()}


def annotation_of(kind: Any, name: str) -> Any:
    """Return the annotation of a field of a declared class, with all that is declared of it."""
    field = _fields(kind)[name]
    return Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation


def default_of(kind: Any, name: str) -> Any:
    """Return the default of a field of a declared class; `dataclasses.MISSING` if it has none."""
    names = dict(zip(_fields(kind), kind.__pydantic_fields__, strict=True))
    field = kind.__dataclass_fields__[names[name]]
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return field.default


def sentences(kind: Any) -> dict[str, str]:
    """Return the sentence about each field of a declared class."""
    return {name: field.description or "" for name, field in _fields(kind).items()}


def marks(kind: Any) -> Iterator[Any]:
    """Yield what is declared of a type: limits, placeholders and phrases, the outermost first."""
    if get_origin(kind) is Annotated:
        for one in reversed(kind.__metadata__):
            yield from reversed(getattr(one, "metadata", [one]))
        yield from marks(get_args(kind)[0])
    else:
        one = [part for part in _members(kind) if part is not type(None)]
        if len(one) == 1 and one[0] is not kind:
            yield from marks(one[0])


def bare(kind: Any) -> Any:
    """Return a type without what is declared of it, and without None."""
    if get_origin(kind) is Annotated:
        return bare(get_args(kind)[0])
    one = [part for part in _members(kind) if part is not type(None)]
    return bare(one[0]) if len(one) == 1 and one[0] is not kind else kind


def phrase(kind: Any) -> str:
    """Return what a value of a type is, such as "a number from 0 to 1"."""
    said = list(marks(kind))
    whole = next((one.text for one in said if isinstance(one, Expected)), None)
    if whole is not None:
        return whole
    inner = bare(kind)
    if get_origin(inner) is Literal:
        return " or ".join(map(shown, get_args(inner)))
    several = [part for part in _members(inner) if part is not type(None)]
    if len(several) > 1:
        return " or ".join(dict.fromkeys(map(phrase, several)))
    if is_declared(inner) or get_origin(inner) is dict or inner is dict:
        return "a table"
    if get_origin(inner) in (tuple, list):
        return "a list of " + re.sub(r"^(whole number|\w+)", r"\1s", phrase(get_args(inner)[0]).removeprefix("a "))
    what = next((one.text for one in said if isinstance(one, Kind)), {str: "a text"}.get(inner, "another value"))
    return what + limits(said)


def limits(said: Sequence[Any]) -> str:
    """Return the limits of a number in words."""
    low, most = _limit(said, "ge"), _limit(said, "le")
    above, below = _limit(said, "gt"), _limit(said, "lt")
    if low is not None and most is not None:
        return f" from {low:g} to {most:g}"
    least = "" if low is None else f" of {low:g} or more"
    least = least if above is None else f" above {above:g}"
    if most is not None:
        return f"{least}, at most {most:g}" if least else f" of at most {most:g}"
    if below is not None:
        return f"{least} and below {below:g}" if least else f" below {below:g}"
    return least


def _limit(said: Sequence[Any], name: str) -> float | None:
    return next((getattr(one, name) for one in said if getattr(one, name, None) is not None), None)


def _members(kind: Any) -> tuple[Any, ...]:
    if get_origin(kind) is Annotated:
        return _members(get_args(kind)[0])
    return get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)


def has_none(kind: Any) -> bool:
    """Whether None is a value of a type."""
    return type(None) in _members(kind)


def _place(kind: Any, parts: Sequence[str | int]) -> tuple[Place, Any]:
    """Return the place of a fault without the names of a union's members, and the type that is expected there."""
    place: list[str | int] = []
    named = False
    for part in parts:
        if not named and sum(one is not type(None) for one in _members(kind)) > 1:
            named = True  # this part is the name of a member
            continue
        inner = _inner(kind, part)
        if isinstance(part, int) and not is_declared(bare(inner)) and any(isinstance(m, Expected) for m in marks(kind)):
            break  # what is expected of the whole list is said in one phrase
        if inner is not None:
            kind, named = inner, False
            place.append(part)
    return tuple(place), kind


def _inner(kind: Any, part: str | int) -> Any:
    for one in _members(kind):
        one = _members(one)[0] if get_origin(one) is Annotated else one
        arguments = get_args(one)
        if is_declared(one) and part in _fields(one):
            return annotation_of(one, str(part))
        if isinstance(part, int) and get_origin(one) in (tuple, list):
            return arguments[0] if get_origin(one) is list or arguments[-1] is Ellipsis else arguments[part]
        if isinstance(part, str) and get_origin(one) in (dict, Mapping):
            return arguments[1]
    return None


def _at(given: Any, place: Place, otherwise: Any) -> Any:
    """Return the value at a place of what was given; `otherwise` where plain data end."""
    for part in place:
        try:
            given = given[part]
        except (KeyError, IndexError, TypeError):
            return otherwise
    return given


def spelt(place: Place) -> str:
    """Return a place as text, such as `robots[2].c_move`."""
    text = "".join(f"[{part + 1}]" if isinstance(part, int) else f".{part}" for part in place)
    return text.removeprefix(".")


def shown(value: Any) -> str:
    """Return a value as JSON text, for messages."""
    return json.dumps(value, default=str, ensure_ascii=False)


LONGEST = 200  # characters of a value in a message


def _short(text: str) -> str:
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."


NOTHING: tuple[Any, ...] = (None, (), {})


def plain(value: Any) -> Any:
    """Return a declared object as plain data, without what is None or empty; its class makes an equal one from them.

    An object of one of several classes begins with what `tag` says of it, such as `{"rule": "outcome"}`.

    A user's own function or rule is a text, which says what it was.

    Parameters
    ----------
    value : object
        A declared object, a mapping, a sequence, a text, a number or None; or a user's own.
    """
    if is_declared(type(value)):
        named = zip(names_of(type(value)), type(value).__pydantic_fields__, strict=True)
        every = ((shown_as, getattr(value, name)) for shown_as, name in named)
        return getattr(value, "tag", {}) | {name: plain(own) for name, own in every if own not in NOTHING}
    if isinstance(value, Mapping):
        return {str(name): plain(own) for name, own in value.items()}
    if isinstance(value, tuple | list):
        return [plain(one) for one in value]
    if value is None or isinstance(value, str | int | float):
        return value
    name = getattr(value, "__name__", None)
    if name is None and dataclasses.is_dataclass(value):
        name = repr(value)
    return str(name or type(value).__name__)
