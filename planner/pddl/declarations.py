"""Declarations of a PDDL file: its sections and requirements, and types, objects, predicates and functions.

Fast Downward's translator grounds classical planning with action costs, to which `compilation` reduces numbers and
durations. Everything else is refused here, with its place. `docs/planning.md` lists what is supported.

All other modules obtain the names from here. An invalid declaration is refused with its place.
"""

from __future__ import annotations

import difflib
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import NoReturn

from .instances import Expression, Instance, PDDLError, Place

REQUIREMENTS = (
    ":strips", ":adl", ":typing", ":negation", ":equality", ":negative-preconditions", ":disjunctive-preconditions",
    ":existential-preconditions", ":universal-preconditions", ":quantified-preconditions", ":conditional-effects",
    ":derived-predicates", ":action-costs",
)  # fmt: skip
"""Requirements that Fast Downward's translator accepts."""

NUMERIC = (":fluents", ":numeric-fluents", ":durative-actions", ":duration-inequalities")
"""Requirements for numbers and durations, which are compiled away."""

AT_THEIR_PLACE = (
    ":timed-initial-literals", ":continuous-effects", ":object-fluents", ":preferences", ":constraints",
)  # fmt: skip
"""Requirements of which only the use is refused, with its place: files declare them without using them."""

OUTSIDE = {
    ":constraints": "trajectory constraints",
    ":process": "processes",
    ":event": "events",
    ":task": "hierarchical tasks",
    ":method": "hierarchical tasks",
    ":htn": "hierarchical tasks",
    ":object-fluents": "object fluents",
    ":continuous-effects": "continuous effects",
    ":timed-initial-literals": "timed initial literals",
    ":timed-effects": "timed effects",
    ":preferences": "preferences",
    ":goal-utilities": "preferences",
    ":contingent": "contingent planning",
    ":probabilistic-effects": "probabilistic effects",
    ":rewards": "rewards",
    ":time": "processes and events",
    ":hierarchy": "hierarchical tasks",
    ":method-preconditions": "hierarchical tasks",
    ":multi-agent": "several agents",
    ":observe": "sensing actions",
    ":sensing": "sensing actions",
}
"""Sections and requirements of other PDDL dialects, which are not supported, with the name of the feature."""

CLASSICAL = "write actions with conditions and effects"
INSTEAD = {
    "processes": "write a durative action with the whole change at its end",
    "events": "write their effects into the actions that cause them",
    "trajectory constraints": "write them as conditions of actions, or as goals",
}
"""What to write instead of some of these features."""


def check_supported(instance: Instance, domain: Expression, problem: Expression) -> None:
    """Check both files of an instance: that their names match, and that their sections and requirements are supported.

    A fault raises a `PDDLError` with its place.
    """
    _check_names(instance, domain, problem)
    counts = Counter(each.word for whole in (domain, problem) for each in whole.walk() if each.word.endswith("-"))
    of_domains = (
        ":requirements",
        ":types",
        ":constants",
        ":predicates",
        ":functions",
        ":derived",
        ":action",
        ":durative-action",
    )
    of_problems = (":domain", ":requirements", ":objects", ":init", ":goal", ":metric")
    for file, whole, sections in ((instance.domain, domain, of_domains), (instance.problem, problem, of_problems)):
        _check_hyphens(file, whole, counts)
        _check_sections(file, whole, sections)
        _check_requirements(file, whole)


def _check_names(instance: Instance, domain: Expression, problem: Expression) -> None:
    """Compare the domain's name in the two files, which unified-planning does not do."""

    def named(whole: Expression, head: str) -> Expression | None:
        part = whole.section(head)
        return part.parts[1] if part is not None and len(part.parts) > 1 and part.parts[1].word else None

    defined, wanted = named(domain, "domain"), named(problem, ":domain")
    if defined is None and named(domain, "problem") and named(problem, "domain"):
        refuse(instance.domain, domain, "this is a problem, and the other file its domain: swap them")
    if defined is None:
        refuse(instance.domain, domain, "not a PDDL domain: (domain NAME) is missing")
    if wanted is None:
        refuse(instance.problem, problem, "not a PDDL problem: (:domain NAME) is missing")
    for file, whole, head in ((instance.domain, domain, "domain"), (instance.problem, problem, "problem")):
        title = whole.section(head)
        if title is None or len(title.parts) != 2 or not title.parts[1].word:
            refuse(file, whole if title is None else title, f"expected ({head} NAME), and one word for NAME")
        if whole.head != "define" or whole.parts[1] is not title:
            refuse(file, whole, f"expected (define ({head} {title.parts[1]}) ...)")
    if defined.word != wanted.word:
        refuse(
            instance.problem,
            wanted,
            f"the problem is written for domain '{wanted.word}', but {instance.domain} defines '{defined.word}'",
        )


def _check_hyphens(file: Path, whole: Expression, counts: Mapping[str, int]) -> None:
    """Refuse a hyphen that touches a name: PDDL readers differ on whether it belongs to the name.

    A name may end in a hyphen. A word that ends in one and occurs only once is taken for a mistake.
    """
    for each in whole.walk():
        word = each.word
        if len(word) < 2 or word[0] != "-" != word[-1]:
            continue
        if counts[word] == 1 if word[0] != "-" else not re.fullmatch(r"-[\d.]+", word):
            refuse(file, each, f"'{word}': expected a blank before and after the hyphen that stands before a type")


def _check_sections(file: Path, whole: Expression, sections: tuple[str, ...]) -> None:
    seen: dict[str, int] = {}
    for part in whole.parts[2:]:
        if part.head in OUTSIDE:
            refuse(
                file,
                part,
                f"{OUTSIDE[part.head]} ({part.head}) are not supported; {INSTEAD.get(OUTSIDE[part.head], CLASSICAL)}",
            )
        if part.head not in sections:
            shown = part.word or f"({part.head}"
            refuse(file, part, f"'{shown}' is not expected here{meant(part.head, sections)}")
        if part.head in seen and part.head not in (":action", ":durative-action", ":derived"):
            refuse(file, part, f"a second ({part.head} ...); the first is on line {seen[part.head]}")
        seen[part.head] = part.place.line


def _check_requirements(file: Path, whole: Expression) -> None:
    wanted = whole.section(":requirements")
    for requirement in () if wanted is None else wanted.parts[1:]:
        if requirement.word in AT_THEIR_PLACE:
            continue
        if requirement.word in OUTSIDE:
            refuse(file, requirement, f"{requirement} is not supported: {OUTSIDE[requirement.word]}")
        if requirement.word not in REQUIREMENTS and requirement.word not in NUMERIC:
            near = meant(requirement.word, REQUIREMENTS + NUMERIC)
            refuse(file, requirement, f"unknown requirement '{requirement}'{near}")


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
