"""Appearance of a domain's drawings: read from `drawing.toml` next to `domain.pddl`, or inferred from the task.

The file defines how objects of each type look, and what each predicate means in a picture:

    [types]
    slot = {shape = "slot", in = "kit", holds = 1}   # default location of objects of this type
    box = {shape = "crate", of = "holds ?1"}         # without PDDL types: argument 1 of a constant fact
    [things]
    kit = {title = "Kit"}                            # a drawn thing that is not an object of the task
    [places]
    in-slot = "?1 in ?2"                             # ?1 is drawn within ?2, as with `at`; `on` stacks
    [marks]
    shut = "?1 shut"                                 # a mark on an object; also with others: "?1 has ?2"
    parts = "?1 parts ?2, size"                      # "parts = 3 of 6", where (size ?1) is 6
    [links]
    road = "?1 to ?2, length"                        # a note on ?1, with the value of a function
    [colours]
    belongs = "?1 as ?2"                             # ?1 has the colour of ?2
    [words]
    place = "Put ?i into ?s"                         # an action in words
    [hide]
    predicates = ["slot-free"]                       # predicates that are not shown
    [texts.de]                                       # all titles, marks and words in another language
    "Put ?i into ?s" = "?i in ?s legen"

`language = "de"` in the first line says that the texts themselves are German. If several facts place the same
object, the first of their predicates in the file decides.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field
from pydantic_core import PydanticCustomError

from planner.pddl.reader import Domain
from planner.system.errors import expected

from ..declare.catalogue import FIRST, TAG, Catalogue, catalogue, languages
from ..declare.declared import Count, Expected, Text, Truth, declared
from ..declare.tables import convert, fault, load
from .subject import Atom, Subject, atom, is_number

FILE = "drawing.toml"
Shape = Literal[
    "chip", "crate", "slot", "panel", "block", "ball", "person", "robot", "van", "tray", "locker", "parcel", "part",
]  # fmt: skip
SHAPE = Field(description="Its shape: a part unless given, a thing's is a panel, and that of a type's objects a chip.")


@declared
class Look:
    """The appearance of a named place within an object."""

    shape: Annotated[Shape, SHAPE] = "part"
    title: Annotated[Text | None, Field(description="The text on it; its name unless given.")] = None
    inside: Annotated[Text | None, Field(alias="in", description="Its location if no fact places it.")] = None
    holds: Annotated[Count | None, Field(description="Number of objects for which space is reserved.")] = None
    high: Annotated[Count, Field(description="Number of stacked objects for which space is reserved.")] = 1
    parts: Annotated[dict[str, Look], Field(description="Named places within it.")] = field(
        default_factory=dict, hash=False
    )
    hidden: Annotated[Truth, Field(description="Whether it is not drawn.")] = False


@declared
class ThingLook(Look):
    """The appearance of a thing that is not an object."""

    shape: Annotated[Shape, SHAPE] = "panel"


def _listed(given: Any) -> Any:
    return [given] if isinstance(given, str) else given


@declared
class TypeLook(Look):
    """The appearance of the objects of a type."""

    shape: Annotated[Shape, SHAPE] = "chip"
    of: Annotated[
        tuple[Annotated[Text, Field(pattern=r"^[\w-]+ \?\d$")], ...],
        BeforeValidator(_listed),
        Expected("something like 'holds ?1', or a list of such"),
        Field(description="Without PDDL types: the objects that are this argument of a constant fact."),
    ] = ()


@dataclass(frozen=True)
class Rule:
    """The meaning of a predicate in a picture: `what` is `how` `where`, such as "?1 in ?2".

    Attributes
    ----------
    what, where : int or str
        The number of an argument, from 1, or a name.
    how : str
        "in", "at", "on", "to", "as"; empty if `where` is the text of a mark.
    part : str or None
        The place within `where`; of links and marks, the function whose value follows.
    """

    what: int | str
    how: str
    where: int | str
    part: str | None = None

    def of(self, fact: Atom) -> tuple[str, str]:
        """Return the keys of the two nodes that a fact relates: `object`, `object#part` or `#thing`.

        For a mark the second value is its text, with the arguments of the fact inserted.
        """
        if not self.how:
            what = fact[self.what] if isinstance(self.what, int) else f"#{self.what}"
            return what, re.sub(r"\?(\d)", lambda end: fact[int(end[1])], str(self.where))
        what, where = (fact[end] if isinstance(end, int) else f"#{end}" for end in (self.what, self.where))
        return what, where if self.part is None else f"{where}#{self.part}"


@dataclass(frozen=True)
class Profile:
    """The appearance of a domain's drawings.

    Attributes
    ----------
    types, things : dict of str to Look
    places, links, colours, marks : dict of str to Rule
        Rules by predicate.
    words : dict of str to str
        Each action in words; parameters have their question marks.
    hidden : frozenset of str
        Predicates that are not shown.
    guessed : bool
        Whether it was inferred from the task.
    own : dict of str to Look
        The appearance of objects that a constant fact selects (`of` in the file).
    texts : Catalogue
        The words between those of the domain.
    language : str
        The tag of the language of all texts.
    names : dict of str to str
        Translated names of things, parts and types.
    """

    types: dict[str, Look] = field(default_factory=dict)
    things: dict[str, Look] = field(default_factory=dict)
    places: dict[str, Rule] = field(default_factory=dict)
    marks: dict[str, Rule] = field(default_factory=dict)
    links: dict[str, Rule] = field(default_factory=dict)
    colours: dict[str, Rule] = field(default_factory=dict)
    words: dict[str, str] = field(default_factory=dict)
    hidden: frozenset[str] = frozenset()
    guessed: bool = False
    own: dict[str, Look] = field(default_factory=dict)
    texts: Catalogue = field(default_factory=catalogue)
    language: str = FIRST
    names: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, subject: Subject, texts: Catalogue | None = None) -> Profile:
        """Return the profile in the file next to the task's domain, or the inferred one if there is no file.

        Its language is that of `texts` if the file has all its texts in this language, else that of the file.

        Raises
        ------
        InputFileError
            The file is invalid.
        """
        file = subject.task.instance.domain.parent / FILE
        return read(file, subject, texts) if file.is_file() else guess(subject, texts)

    def look(self, subject: Subject, name: str) -> Look:
        """Return the appearance of an object."""
        if name in self.own:
            return self.own[name]
        return next((self.types[kind] for kind in subject.types(name) if kind in self.types), TypeLook())

    def name(self, key: str) -> str:
        """Return the name of a node in sentences."""
        owner, _, part = key.partition("#")
        return f"{owner} {self.names.get(part, part)}".strip()


PATTERNS = {
    "places": r"(?P<what>\?\d|[\w-]+) (?P<how>in|at|on) (?P<where>\?\d|[\w-]+)(?:\.(?P<part>[\w-]+))?",
    "marks": r"(?P<what>\?\d|[\w-]+) (?P<where>.+?)(?:, (?P<part>[\w-]+))?",
    "links": r"(?P<what>\?\d) (?P<how>to) (?P<where>\?\d)(?:, (?P<part>[\w-]+))?",
    "colours": r"(?P<what>\?\d) (?P<how>as) (?P<where>\?\d)",
}
EXAMPLES = {"places": "?1 in ?2", "marks": "?1 shut", "links": "?1 to ?2, length", "colours": "?1 as ?2"}


def _rules(table: str) -> Any:
    """Return the declaration of a table of rules."""
    rule = Annotated[Text, Field(pattern=f"^(?:{PATTERNS[table]})$"), Expected(f"something like {EXAMPLES[table]!r}")]
    return Annotated[dict[str, rule], Field(description=f"Rules by predicate, such as {EXAMPLES[table]!r}.")]


def _tag(text: str) -> str:
    if not TAG.fullmatch(text):
        raise PydanticCustomError("kind", "a language's tag")
    return text


Tag = Annotated[Text, AfterValidator(_tag), Expected("a language's tag, such as 'de'")]


@declared
class HideTable:
    """What is not shown."""

    predicates: Annotated[
        tuple[Text, ...], Expected("a list of predicates"), Field(description="Predicates that are not shown.")
    ] = ()


@declared
class ProfileFile:
    """A `drawing.toml`."""

    language: Annotated[Tag, Field(description="Language of the file's own texts.")] = FIRST
    types: Annotated[dict[str, TypeLook], Field(description="Looks of objects by their type.")] = field(
        default_factory=dict
    )
    things: Annotated[dict[str, ThingLook], Field(description="Looks of things that are no objects.")] = field(
        default_factory=dict
    )
    places: _rules("places") = field(default_factory=dict)  # type: ignore[valid-type]
    marks: _rules("marks") = field(default_factory=dict)  # type: ignore[valid-type]
    links: _rules("links") = field(default_factory=dict)  # type: ignore[valid-type]
    colours: _rules("colours") = field(default_factory=dict)  # type: ignore[valid-type]
    words: Annotated[dict[str, Text], Field(description="Each action in words; parameters have question marks.")] = (
        field(default_factory=dict)
    )
    hide: Annotated[HideTable, Field(description="What is not shown.")] = HideTable()
    texts: Annotated[
        dict[Tag, dict[str, Text]], Field(description="Titles, marks and words in other languages, by their tags.")
    ] = field(default_factory=dict)


def read(file: Path, subject: Subject, texts: Catalogue | None = None) -> Profile:
    """Return the profile in a `drawing.toml`, checked against the domain; the language as in `Profile.of`.

    Raises
    ------
    InputFileError
        The file is not TOML, or has an entry that is unknown, malformed or not of the domain.
    """
    content = convert(load(file), ProfileFile, file)
    arities = {fact[0]: len(fact) - 1 for fact in (*subject.constant, *subject.changing)}
    if subject.domain is not None:
        _require_known(file, content, subject, subject.domain)
    rules = {
        table: {
            predicate: _rule(file, table, predicate, text, content.things, arities)
            for predicate, text in getattr(content, table).items()
        }
        for table in PATTERNS
    }
    own: dict[str, Look] = {}
    for look in content.types.values():
        for name in _known_by(look.of, subject):
            own.setdefault(name, look)
    profile = Profile(
        types=dict(content.types), own=own, things=dict(content.things), words=content.words,
        hidden=frozenset(content.hide.predicates), places=rules["places"], marks=rules["marks"],
        links=rules["links"], colours=rules["colours"],
    )  # fmt: skip
    return _translated(file, content.texts, profile, texts or catalogue(), content.language)


def _require_known(file: Path, content: ProfileFile, subject: Subject, domain: Domain) -> None:
    """Check that what a file names is in the domain, or in the file itself."""
    for place, what, name, known in _named(content, subject, domain):
        if name not in known:
            right = expected(name, known) if known else "there is none"
            raise fault(file, place, f"there is no {what} '{name}'; {right}")


def _named(content: ProfileFile, subject: Subject, domain: Domain) -> Iterator[tuple[str, str, str, Collection[str]]]:
    """Yield each name that a file refers to: its place, what it names, the name, and those that there are."""
    facts = (*domain.predicates, *domain.functions)
    parts = {part for look in content.types.values() for part, _ in _names(look.parts)}
    for table, pattern in PATTERNS.items():
        for predicate, text in getattr(content, table).items():
            yield f"{table}.{predicate}", "predicate", predicate, facts
            found = re.fullmatch(pattern, text)
            part = None if found is None else found.groupdict().get("part")
            if part is not None:
                within = ("part", parts) if table == "places" else ("function", domain.functions)
                yield f"{table}.{predicate}", within[0], part, within[1]
    alone = [name for name, one in domain.predicates.items() if len(one.parameters) == 1]
    for kind, look in content.types.items():
        if not look.of:
            yield f"types.{kind}", "type", kind, (*domain.types.parents, *alone)
        for one in look.of:
            yield f"types.{kind}.of", "predicate", one.partition(" ")[0], domain.predicates
        if look.inside is not None:
            yield f"types.{kind}.in", "thing", look.inside, content.things
    for number, predicate in enumerate(content.hide.predicates, start=1):
        yield f"hide.predicates[{number}]", "predicate", predicate, facts
    for action, text in content.words.items():
        yield f"words.{action}", "action", action, subject.parameters
        for parameter in _arguments(text):
            yield f"words.{action}", "parameter", parameter, subject.parameters[action]


def _rule(
    file: Path, table: str, predicate: str, text: str, things: Mapping[str, Look], arities: Mapping[str, int]
) -> Rule:
    """Return the rule of a predicate, after checking the objects and arguments that it names."""
    found = re.fullmatch(PATTERNS[table], text)
    assert found is not None
    what, how, where, part = (found.groupdict().get(group) for group in ("what", "how", "where", "part"))
    rule = Rule(_end(what or ""), how or "", _end(where or ""), part)
    within = [int(end) for end in re.findall(r"\?(\d)", where or "")] if table == "marks" else []
    for end in (rule.what, {"places": rule.where, "marks": rule.what}.get(table, 1), *within):
        if isinstance(end, str) and end not in things:
            raise fault(file, f"{table}.{predicate}", f"'{end}' is not among [things]")
        if isinstance(end, int) and end > arities.get(predicate, end):
            raise fault(file, f"{table}.{predicate}", f"?{end}; the predicate has {arities[predicate]} arguments")
    return rule


def _translated(
    file: Path, tables: Mapping[str, Mapping[str, str]], profile: Profile, texts: Catalogue, language: str
) -> Profile:
    """Return a profile in the language of `texts`, if the file has its texts in it, else in that of the file."""
    named = dict(_names(profile.things)) | {
        part: title for look in profile.types.values() for part, title in _names(look.parts)
    }
    titles = {look.title for look in profile.types.values() if look.title}
    marks = {str(rule.where) for rule in profile.marks.values()}
    shown = sorted(
        one for one in {*named.values(), *titles, *marks, *profile.words.values()} if re.search("[^?0-9: ]", one)
    )
    for tag, table in tables.items():
        for text in [*shown, *table]:
            said = table.get(text)
            if text not in shown and text not in profile.types:
                raise fault(file, f"texts.{tag}", f"{text!r} is none of this file's titles, marks and words")
            if said is None or _arguments(said) != _arguments(text):
                with_all = " with ".join(["a text", " and ".join(_arguments(text))][: 1 + bool(_arguments(text))])
                found = "there is none" if said is None else repr(said)
                raise fault(file, f"texts.{tag}", f"{text!r}: {found}; expected {with_all}")
    spoken = next((tag for tag in (texts.tag, texts.tag.partition("-")[0]) if tag == language or tag in tables), None)
    if spoken is None and shown:
        return replace(profile, texts=catalogue(language if language in languages() else FIRST), language=language)
    if spoken is None or spoken not in tables:
        return replace(profile, texts=texts, language=texts.tag)
    own = dict(tables[spoken])

    def look(name: str | None, one: Look) -> Look:
        title = own.get(one.title or name or "", one.title)
        return replace(one, title=title, parts={part: look(part, inner) for part, inner in one.parts.items()})

    return replace(
        profile,
        types={name: look(None, one) for name, one in profile.types.items()},
        own={name: look(None, one) for name, one in profile.own.items()},
        things={name: look(name, one) for name, one in profile.things.items()},
        marks={name: replace(rule, where=own.get(str(rule.where), rule.where)) for name, rule in profile.marks.items()},
        words={action: own[text] for action, text in profile.words.items()},
        names=own | {name: own[title] for name, title in named.items()},
        texts=texts,
        language=spoken,
    )


def _names(looks: Mapping[str, Look]) -> Iterator[tuple[str, str]]:
    """Yield the names of things or parts, and of their parts, each with its title."""
    for name, look in looks.items():
        yield name, look.title or name
        yield from _names(look.parts)


def _arguments(text: str) -> list[str]:
    """Return the arguments in a text: `?1` in marks, and a word such as `?item` in words for an action."""
    return sorted(set(re.findall(r"\?\d|(?<!\S)\?\S+", text)))


def _known_by(of: Iterable[str], subject: Subject) -> Iterator[str]:
    """Yield the objects that are the given argument of a constant fact, such as `holds ?1`."""
    for one in of:
        predicate, end = one.split(" ?")
        yield from (
            fact[int(end)] for fact in sorted(subject.constant) if fact[0] == predicate and 0 < int(end) < len(fact)
        )


def _end(text: str) -> int | str:
    return int(text[1:]) if re.fullmatch(r"\?\d", text) else text


def guess(subject: Subject, texts: Catalogue | None = None) -> Profile:
    """Return a profile that is inferred from the variables of the task.

    If the facts of a variable share exactly one object, the variable describes the place or condition of this object.
    Facts with two arguments place the object at the other argument. Facts with one argument are marks.
    """
    votes: Counter[tuple[str, int]] = Counter()
    for variable in subject.task.variables:
        facts = [one for fact in variable.facts if (one := atom(fact)) in subject.changing and one]
        if len(facts) > 1 and not any(map(is_number, facts)):
            shared = set.intersection(*(set(fact[1:]) for fact in facts))
            if len(shared) == 1:
                name = next(iter(shared))
                votes.update({(fact[0], fact.index(name, 1)): 1 for fact in facts if len(fact) == 3})
    places = {}
    for predicate in sorted({predicate for predicate, _ in votes}):
        first, second = votes[predicate, 1], votes[predicate, 2]
        places[predicate] = Rule(1, "in", 2) if first >= second else Rule(2, "in", 1)
    unary = sorted({fact[0] for fact in subject.changing if len(fact) == 2 and not is_number(fact)})
    ends = [places[fact[0]].of(fact) for fact in subject.changing | subject.constant if fact[0] in places]
    moving, places_of = ({subject.objects.get(pair[end]) for pair in ends} for end in (0, 1))
    types = {kind: Look(shape="crate" if kind in moving else "panel") for kind in sorted(filter(None, places_of))}
    marks = {name: Rule(1, "", name) for name in unary}
    texts = texts or catalogue()
    return Profile(types=types, places=places, marks=marks, guessed=True, texts=texts, language=texts.tag)
