"""Declarations of a PDDL file: types, objects, predicates and functions, each with its place.

All other modules obtain these names from here. An invalid declaration is refused with its place.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import NoReturn

from .instances import PDDLError
from .s_expressions import Expression, Place

OBJECT = "object"
"""Root of the type hierarchy."""

RESERVED = frozenset(
    ("and", "or", "not", "imply", "forall", "exists", "when", "either", "increase", "decrease", "assign", "scale-up",
     "scale-down", "<", ">", "<=", ">=", "-", "+", "*", "/")
)  # fmt: skip
"""Keywords of conditions, effects and numeric expressions. They cannot be names of predicates or functions."""


@dataclass(frozen=True)
class Typed:
    """An entry of a typed list: an object, a variable or a type; `kinds` is its type, or those of `(either ...)`."""

    name: str
    kinds: tuple[str, ...]
    place: Place


@dataclass(frozen=True)
class Symbol:
    """A predicate or a function."""

    name: str
    parameters: tuple[Typed, ...]
    place: Place


@dataclass(frozen=True)
class Types:
    """The type hierarchy of a domain."""

    parents: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: {OBJECT: ()})
    """Direct supertypes of each type. `object` has none, and is a supertype of all others."""
    places: Mapping[str, Place] = field(default_factory=dict)
    """Place of the first mention of each type."""

    @cached_property
    def _above(self) -> dict[str, frozenset[str]]:
        found: dict[str, frozenset[str]] = {}
        for name in self.ordered:
            found[name] = frozenset((name,)).union(*(found[parent] for parent in self.parents[name]))
        return found

    @cached_property
    def ordered(self) -> tuple[str, ...]:
        """All types, each after its supertypes."""
        return tuple(TopologicalSorter(self.parents).static_order())

    def fits(self, kind: str, wanted: Iterable[str]) -> bool:
        """Whether a type is a subtype of, or equal to, one of the wanted types."""
        return not self._above[kind].isdisjoint(wanted)

    def overlap(self, kinds: Sequence[str], others: Sequence[str]) -> bool:
        """Whether one of `kinds` and one of `others` have a common subtype, so that one object may belong to both."""
        return any(self.fits(each, kinds) and self.fits(each, others) for each in self.parents)

    def reduced(self, kinds: Iterable[str]) -> tuple[str, ...]:
        """Return the types of `kinds` that are not subtypes of another of them, sorted."""
        return tuple(sorted(a for a in kinds if not any(a != b and self.fits(a, (b,)) for b in kinds)))

    def common(self, kinds: Iterable[str]) -> str:
        """Return the lowest common supertype, or `object` where there is no unique one."""
        shared = frozenset.intersection(*(self._above[kind] for kind in kinds))
        return next((name for name in shared if all(other in self._above[name] for other in shared)), OBJECT)


@dataclass(frozen=True)
class Names:
    """Names that conditions and effects may use."""

    types: Types
    predicates: Mapping[str, Symbol]
    functions: Mapping[str, Symbol]
    objects: Mapping[str, Typed]


def meant(name: str, words: Iterable[str]) -> str:
    """Return the part of a message that suggests the most similar of the words; empty if none is similar."""
    near = difflib.get_close_matches(name.lstrip("?"), sorted({word.lstrip("?") for word in words} - {name}), n=1)
    return f"; did you mean '{'?' if name.startswith('?') else ''}{near[0]}'?" if near else ""


def refuse(file: Path, at: Expression | Place | None, message: str) -> NoReturn:
    """Raise a `PDDLError` with the place of the fault."""
    line, column = (at.place if isinstance(at, Expression) else at) or (None, None)
    raise PDDLError(file, line, message, column)


def shown(expression: Expression) -> str:
    """Return the text of an expression for a message, shortened if it is long."""
    text, longest = str(expression), 60  # characters
    return text if len(text) <= longest else f"{text[:longest]} ..."


def types(file: Path, section: Expression | None) -> Types:
    """Read the types of a domain.

    A type that is its own parent, or that occurs only as a parent, is a direct subtype of `object`. `object` need not
    be listed.
    """
    if section is None:
        return Types()
    parents: dict[str, list[str]] = {OBJECT: []}
    places: dict[str, Place] = {}
    for each in typed(file, section.parts[1:], "a type"):
        if len(each.kinds) > 1:
            refuse(file, each.place, f"type '{each.name}' is under (either ...); expected one type")
        parent = each.kinds[0]
        if "number" in (each.name, parent):
            refuse(file, each.place, "'number' is not a type of objects")
        if each.name == OBJECT and parent != OBJECT:
            refuse(file, each.place, f"'{OBJECT}' is above all types, and cannot be under '{parent}'")
        if each.name == OBJECT:
            continue
        for name in (each.name, parent):
            places.setdefault(name, each.place)
            parents.setdefault(name, [])
        if parent not in (each.name, *parents[each.name]):
            parents[each.name].append(parent)
    for name, above in parents.items():
        if name != OBJECT and not above:
            above.append(OBJECT)
        elif len(above) > 1 and OBJECT in above:
            above.remove(OBJECT)
    _check_circles(file, parents, places)
    return Types({name: tuple(above) for name, above in parents.items()}, places)


def _check_circles(file: Path, parents: Mapping[str, Sequence[str]], places: Mapping[str, Place]) -> None:
    try:
        TopologicalSorter(parents).prepare()
    except CycleError as error:
        circle = error.args[1][::-1]
        refuse(file, places[circle[0]], f"circular types: {' - '.join(circle)}")


def typed(
    file: Path, parts: Iterable[Expression], what: str, *, variables: bool = False, known: Types | None = None
) -> list[Typed]:
    """Read a typed list such as `a b - t c`. Entries without a type have type `object`.

    Messages call the entries `what`. Types are checked only if the `known` ones are given.
    """
    names: list[Expression] = []
    found: list[Typed] = []
    words = iter(parts)
    for part in words:
        if part.word == "-":
            kind = next(words, None)
            if kind is None or kind.word == "-":
                refuse(file, part, "expected a type after '-'")
            if not names:
                refuse(file, part, f"expected {what} before '-'")
            kinds = _kinds(file, kind, known)
            found += [Typed(name.word, kinds, name.place) for name in names]
            names = []
        elif not part.word:
            refuse(file, part, f"'{shown(part)}' is not expected here: expected {what}")
        elif part.word.startswith("?") is not variables or part.word == "?":
            refuse(file, part, f"'{part}' is not {what}{', which begins with a question mark' if variables else ''}")
        else:
            names.append(part)
    return found + [Typed(name.word, (OBJECT,), name.place) for name in names]


def _kinds(file: Path, kind: Expression, known: Types | None) -> tuple[str, ...]:
    if kind.parts and (kind.head != "either" or len(kind.parts) == 1 or not all(part.word for part in kind.parts)):
        refuse(file, kind, f"'{shown(kind)}' is not a type; expected TYPE or (either TYPE ...)")
    if not kind.word and not kind.parts:
        refuse(file, kind, "'()' is not a type")
    names = kind.parts[1:] or (kind,)
    for name in names:
        if known is not None and name.word not in known.parents:
            refuse(file, name, f"unknown type '{name}'{meant(name.word, known.parents)}")
    return tuple(dict.fromkeys(name.word for name in names))


def parameters(file: Path, parts: Iterable[Expression], known: Types) -> tuple[Typed, ...]:
    """Read a list of distinct variables."""
    found = typed(file, parts, "a variable", variables=True, known=known)
    names: set[str] = set()
    for each in found:
        if each.name in names:
            refuse(file, each.place, f"'{each.name}' occurs twice in one list of variables")
        names.add(each.name)
    return tuple(found)


def objects(
    file: Path, section: Expression | None, known: Types, before: Mapping[str, Typed], where: str
) -> dict[str, Typed]:
    """Read the objects of a section. None of those that the file `where` has declared `before` may occur again."""
    found: dict[str, Typed] = {}
    for each in typed(file, () if section is None else section.parts[1:], "an object", known=known):
        if len(each.kinds) > 1:
            refuse(file, each.place, f"object '{each.name}' is of (either ...); expected the one type that it has")
        if (other := found.get(each.name)) is not None:
            refuse(file, each.place, f"'{each.name}' is defined twice, on line {other.place.line} as well")
        if (other := before.get(each.name)) is not None:
            refuse(file, each.place, f"'{each.name}' is defined twice, on line {other.place.line} of {where} as well")
        found[each.name] = each
    return found


def _symbol(file: Path, part: Expression, known: Types, what: str) -> Symbol:
    if not part.head:
        refuse(file, part, f"'{shown(part)}' declares no {what}; expected ({what.upper()} ?VARIABLE - TYPE ...)")
    if part.head in RESERVED or part.head.startswith(("?", ":")):
        refuse(file, part, f"'{part.head}' cannot be the name of a {what}")
    if "@" in part.head:  # `type@part`, `new-axiom@0` and others
        refuse(file, part, f"'{part.head}' cannot be the name of a {what}: Fast Downward has names with '@' of its own")
    found = typed(file, part.parts[1:], "a variable", variables=True, known=known)  # their names have no meaning
    return Symbol(part.head, tuple(found), part.place)


def predicates(file: Path, section: Expression | None, known: Types) -> dict[str, Symbol]:
    """Read the predicates. A predicate that is declared twice may have arguments of either declaration's types."""
    found: dict[str, Symbol] = {}
    for part in () if section is None else section.parts[1:]:
        new = _symbol(file, part, known, "predicate")
        if new.name == "=":  # some domains declare equality
            continue
        if (old := found.get(new.name)) is not None:
            if len(old.parameters) != len(new.parameters):
                refuse(
                    file, part, f"'{new.name}' is declared with {len(new.parameters)} arguments, and with "
                    f"{len(old.parameters)} on line {old.place.line}",
                )  # fmt: skip
            both = zip(old.parameters, new.parameters, strict=True)
            merged = (Typed(a.name, tuple(dict.fromkeys(a.kinds + b.kinds)), a.place) for a, b in both)
            new = Symbol(new.name, tuple(merged), old.place)
        found[new.name] = new
    return found


def functions(file: Path, section: Expression | None, known: Types) -> dict[str, Symbol]:
    """Read the functions. All of them are numeric."""
    found: dict[str, Symbol] = {}
    words = iter(() if section is None else section.parts[1:])
    for part in words:
        if part.word == "-":
            kind = next(words, None)
            if kind is None or kind.word != "number" or not found:
                refuse(file, part, "functions give numbers: expected (FUNCTION ?VARIABLE - TYPE ...) - number")
            continue
        new = _symbol(file, part, known, "function")
        if (old := found.get(new.name)) is not None:
            refuse(file, part, f"'{new.name}' is declared twice, on line {old.place.line} as well")
        found[new.name] = new
    return found
