"""Messages of a line and what they report: topics, the fields of a payload, and the action that they make.

A topic such as `line/{person}/action` has fields instead of some levels. A payload is a JSON object, or a text of which
the named groups of a regular expression are the fields. Templates such as `(place {item} {slot})` are filled with both.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import AfterValidator, BeforeValidator, Field, ValidationError
from pydantic_core import PydanticCustomError

from planner.system.errors import expected as meant

from ...declare import tables as toml
from ...declare.declared import DeclarationError, Expected, Place, Text, declared, spelt
from ...declare.refusals import Refusal
from ...declare.tables import convert, told
from ...live.event_base import OfPerson, fault_of
from ...live.events import kinds
from ...live.names import name_of
from ...people.action_names import Words, words_of, wrong_form
from ...people.choices import STAND_STILL

Fields = Mapping[str, Any]
"""Fields of a message: values of JSON, or texts."""

FIELD = re.compile(r"\{(\w+)\}")
LEVEL = re.compile(r"\{(\w+)\}|[^{}+#]*")
WORD = re.compile(r"[^\s()]+")
MANY = 20  # names that a message lists
LONGEST_ID = 128  # characters, as the service accepts


def unusable(why: str) -> Refusal:
    """Return the refusal of a message that reports nothing usable, with its reason."""
    return Refusal("other", why=why)


@dataclass(frozen=True)
class Topic:
    """A topic with fields, such as `line/{person}/action`.

    Raises
    ------
    ValueError
        A field is not a whole level, or occurs twice, or there is a wildcard.
    """

    text: str

    def __post_init__(self) -> None:
        """Check the levels."""
        names = self.names
        if not self.text or len(set(names)) < len(names) or not all(map(LEVEL.fullmatch, self.text.split("/"))):
            raise ValueError(f"{self.text!r}; expected levels that are texts or one field each: line/{{person}}/action")

    @property
    def names(self) -> list[str]:
        """The names of the fields."""
        return FIELD.findall(self.text)

    @classmethod
    def of(cls, text: Any) -> Topic:
        """Return the topic of a text in a file."""
        if not isinstance(text, str) or not text:
            raise PydanticCustomError("kind", "a text")
        return cls(text)

    @property
    def filter(self) -> str:
        """The filter with which a client subscribes."""
        return FIELD.sub("+", self.text)

    def fill(self, **fields: str) -> str:
        """Return the topic for these values of its fields."""
        return FIELD.sub(lambda found: fields[found[1]], self.text)

    def fields(self, topic: str) -> Fields | None:
        """Return the values of the fields in a topic; None if it is another topic."""
        found = {}
        levels, given = self.text.split("/"), topic.split("/")
        if len(levels) != len(given):
            return None
        for level, value in zip(levels, given, strict=True):
            name = FIELD.fullmatch(level)
            if name is not None and value:
                found[name[1]] = value
            elif level != value:
                return None
        return found


def meet(one: str, other: str) -> bool:
    """Return whether some topic is one of both, which may have fields."""
    levels, others = one.split("/"), other.split("/")
    return len(levels) == len(others) and all(
        FIELD.fullmatch(level) or FIELD.fullmatch(own) or level == own
        for level, own in zip(levels, others, strict=True)
    )


def text_of(value: Any) -> str | None:
    """Return a text as it is, and a number or truth value as in JSON; None for all else."""
    if isinstance(value, int | float):
        return json.dumps(value)
    return value if isinstance(value, str) else None


def filled(template: str, fields: Fields, names: Mapping[str, str]) -> str:
    """Return a template with its fields filled in.

    Parameters
    ----------
    template : str
        A template of one field only takes its value as it is; in longer ones, each value is one word.
    fields : mapping of str to object
    names : mapping of str to str
        The task's names of values that are written otherwise, such as bar codes.

    Raises
    ------
    Refusal
        A field is missing, a list or a table, or its value is not one word.
    """
    alone = FIELD.fullmatch(template) is not None

    def value(found: re.Match[str]) -> str:
        given = text_of(fields.get(found[1]))
        if given is None and fields.get(found[1]) is not None:
            raise unusable(f"field {found[1]!r} is {json.dumps(fields[found[1]])[:40]}; expected a text or a number")
        if given is None:
            names_of = (
                ", ".join(name[:40] for name in [one for one in fields if fields[one] is not None][:MANY]) or "none"
            )
            raise unusable(f"there is no field {found[1]!r}; the message has {names_of}")
        named = names.get(given, given)
        if not alone and not WORD.fullmatch(named):
            raise unusable(f"field {found[1]!r} is {given[:40]!r}; expected one word")
        return named

    return FIELD.sub(value, template)


def content_of(payload: bytes, pattern: re.Pattern[str] | None = None) -> dict[str, Any]:
    """Return the content of a payload: a JSON object, or the named groups of a pattern in a text.

    Raises
    ------
    Refusal
        It is neither, or has half a character (an escape in JSON), which cannot be sent.
    """
    try:
        text = payload.decode()
        content = json.loads(text) if pattern is None else pattern.search(text)
    except (ValueError, RecursionError):  # a ValueError for integers of thousands of digits, too
        expected = "a JSON object" if pattern is None else "text"
        raise unusable(f"{payload[:40].decode(errors='replace')!r}; expected {expected} in UTF-8") from None
    if isinstance(content, re.Match):
        return {name: value for name, value in content.groupdict().items() if value is not None}
    if pattern is not None:
        raise unusable(f"{text[:40]!r} does not match {pattern.pattern}")
    if not isinstance(content, dict):
        raise unusable(f"{text[:40]}; expected a JSON object")
    return sendable(content)


def sendable(content: dict[str, Any]) -> dict[str, Any]:
    """Return the content of a message; a `Refusal` if it is nested too deeply, or has half a character."""
    try:
        json.dumps(content, ensure_ascii=False).encode()
    except UnicodeEncodeError as error:
        before = max(error.start - 20, 0)
        raise unusable(f"{error.object[before : error.end]!r}; expected Unicode text") from None
    except RecursionError:  # where reading had a little more of the stack
        raise unusable("lists or tables within so many others; expected fewer") from None
    return content


def fields_of_value(text: str, pattern: re.Pattern[str] | None = None) -> Fields:
    """Return the fields of a value: those of a JSON object or of a pattern, or `value` for any other text.

    Raises
    ------
    Refusal
        The text begins as an object and is none, or does not match the pattern.
    """
    if pattern is not None or text.lstrip().startswith("{"):
        return content_of(text.encode(errors="replace"), pattern)
    return {"value": text}


@dataclass(frozen=True)
class Report:
    """An event of a person, as a message reports it.

    Attributes
    ----------
    person : str
    id : str
        The same for repetitions of the message.
    kind : str
        The kind of event (`assist.live.events`).
    values : mapping of str to object
        Its other fields, as the message or the event has them.
    number : int or None
        Its place among the reports of this person, counted from 1.
    fault : str or None
        Why it cannot be recorded.
    """

    person: str
    id: str
    kind: str = "acted"
    values: Mapping[str, Any] = field(default_factory=dict)
    number: int | None = None
    fault: str | None = None

    def event(self) -> OfPerson:
        """Return the event.

        Raises
        ------
        Refusal
            The message has none that can be recorded.
        """
        if self.fault is not None:
            raise unusable(self.fault)
        if self.kind not in kinds(OfPerson):
            raise unusable(f"event {self.kind[:40]!r}; {meant(self.kind, kinds(OfPerson))}")
        kind: type[OfPerson] = kinds(OfPerson)[self.kind]
        given: dict[str, Any] = {**self.values, "person": self.person, "id": self.id}
        try:
            return _made(kind, given)
        except ValidationError as error:
            raise unusable(fault_of(kind, error, given)) from None


def _made(kind: type[OfPerson], given: dict[str, Any]) -> OfPerson:
    """Return an event; texts stand for truth values, null, numbers and tables where these are expected."""
    read = {name: _read(value) for name, value in given.items() if name not in ("person", "id")}
    try:
        return kind.model_validate(given | read)
    except ValidationError as error:
        texts = {str(one["loc"][0]) for one in error.errors() if one["loc"]} & read.keys()
        return kind.model_validate(given | read | {name: given[name] for name in texts})


def _read(value: Any) -> Any:
    """Return what a text says that is JSON of another type; other values as they are."""
    try:
        found = json.loads(value) if isinstance(value, str) else value
    except (ValueError, RecursionError):
        return value
    return value if isinstance(found, str) else found


def _template(text: str) -> str:
    rest = FIELD.sub("x", text)
    if "{" in rest or "}" in rest:
        raise ValueError(f"{text!r}; expected fields as {{name}}, and no other braces")
    return text


def _of_action(text: str) -> str:
    if wrong_here := wrong_form(FIELD.sub("x", _template(text))):
        raise ValueError(f"{text} {wrong_here}")
    return text


def _pattern(text: Any) -> re.Pattern[str]:
    if not isinstance(text, str):
        raise PydanticCustomError("kind", "a text")
    try:
        return re.compile(text)
    except re.error as error:
        raise ValueError(f"{text!r} is no regular expression: {error}") from None


def _event(kind: str) -> str:
    if kind not in kinds(OfPerson):
        raise ValueError(f"{kind!r}; {meant(kind, kinds(OfPerson))}")
    return kind


Template = Annotated[Text, AfterValidator(_template)]
"""A text with fields such as `{person}`, which take their values from a message."""
ActionTemplate = Annotated[Text, AfterValidator(_of_action)]
EventKind = Annotated[Text, AfterValidator(_event)]


@declared(kw_only=True)
class Source:
    """Messages that report events of one kind. Fields of a message named as other fields of the event are its values.

    Subclasses have what the protocol says of where messages come from, and may have templates `person`, `number` and
    `seq`, and `event`, the kind of event.
    """

    action: Annotated[ActionTemplate, Field(description="Template of the action.")] = "{action}"
    id: Annotated[Template | None, Field(description="Template of the message's id, if messages have one.")] = "{id}"
    pattern: Annotated[
        Annotated[re.Pattern[str], BeforeValidator(_pattern), Expected("a text")] | None,
        Field(description="Pattern whose named groups are the fields of a text; None for JSON objects."),
    ] = None

    def report(self, fields: Fields, names: Mapping[str, str]) -> Report:
        """Return what a message with these fields reports; `names` are the task's names of values.

        An unusable action or number is part of the report: it is answered with the report's id, and others may wait for
        the report's number.

        Raises
        ------
        Refusal
            The person or the id is missing or unsuitable.
        """
        identifier = filled(self.id or "{id}", fields, {})
        if not 0 < len(identifier) <= LONGEST_ID:
            raise unusable(f"an id of {len(identifier)} characters; expected 1 to {LONGEST_ID}")
        person = name_of(filled(getattr(self, "person", "{person}"), fields, {}))  # as the team has it
        kind = getattr(self, "event", "acted")
        number, seq = None, None
        try:
            number = self._whole("number", fields, 1)
            seq = self._whole("seq", fields, 0)
        except Refusal as error:
            return Report(person, identifier, kind, number=number, fault=str(error))
        known = [*kinds(OfPerson)[kind].fields()]
        values = {
            name: value for name, value in fields.items()
            if name in known and name not in ("person", "id", "action", "seq")
            and (value is not None or name in kinds(OfPerson)[kind].never_left_out)
        }  # fmt: skip
        values |= {} if seq is None else {"seq": seq}
        try:
            values |= {"action": filled(self.action, fields, names)} if "action" in known else {}
        except Refusal as error:
            if values.keys() & kinds(OfPerson)[kind].in_place_of_action:
                return Report(person, identifier, kind, values, number)
            return Report(person, identifier, kind, values, number, str(error))
        return Report(person, identifier, kind, values, number)

    def impossible(self, actions: Collection[Words]) -> str | None:
        """Return what is wrong with the template of an action, if it can never be one of these; else None."""
        words = words_of(FIELD.sub("{}", self.action))
        if words in ((), ("{}",)) or "action" not in kinds(OfPerson)[getattr(self, "event", "acted")].fields():
            return None
        there = {*actions, words_of(STAND_STILL)}
        for place, word in enumerate(words):
            among = {action[place] for action in there if len(action) > place}
            there = {action for action in there if len(action) > place and ("{" in word or action[place] == word)}
            if not there:
                return f"{self.action!r} fits no action of the tasks; {_meant(word, among)}"
        return None

    def _whole(self, name: str, fields: Fields, least: int) -> int | None:
        """Return the whole number that a template stands for; None without a template."""
        template: str | None = getattr(self, name, None)
        if template is None:
            return None
        text = filled(template, fields, {})
        if not re.fullmatch(r"\d{1,15}", text, re.ASCII) or int(text) < least:
            raise unusable(f"{template} is {text[:40]!r}; expected a whole number of {least} or more")
        return int(text)


def wrong(message: str, *place: str | int) -> DeclarationError:
    """Return the error of a value at a place of the settings."""
    return DeclarationError(place, None, message, f"{spelt(place)}: {message}")


def matching(pattern: str, right: str) -> AfterValidator:
    """Return a validator that refuses texts without this pattern; `right` says what is expected."""

    def checked(text: str) -> str:
        if not re.fullmatch(pattern, text, re.ASCII):
            raise ValueError(f"{text!r}; expected {right}")
        return text

    return AfterValidator(checked)


def _meant(name: str, known: Collection[str]) -> str:
    """Return the hint of a message about an unknown name: the nearest one, or the first of all."""
    near = get_close_matches(name, known, n=1, cutoff=0.75)  # a slip of the hand, not another word
    if near:
        return f"did you mean {near[0]!r}?"
    listed = sorted(known)
    return f"expected some of {', '.join(listed[:MANY])}{', ...' * (len(listed) > MANY)}" if listed else "expected less"


def require_among(fields: tuple[str, ...] | None, known: set[str], place: str) -> None:
    """Refuse fields of a view that it does not have."""
    for name in fields or ():
        if name not in known:
            raise wrong(f"{name!r}; {_meant(name, known)}", place, "fields")


@declared(kw_only=True)
class BridgeSettings:
    """The settings of a bridge, from one TOML file."""

    names: Annotated[
        Annotated[dict[str, str], Expected("a table of texts")],
        Field(description="The task's names of values that messages have otherwise, such as bar codes."),
    ] = field(default_factory=dict)

    def require(self, robots: int) -> None:
        """Refuse settings that do not fit so many robots, with a `DeclarationError`."""

    def reporting(self) -> Iterator[tuple[Place, Source]]:
        """Yield the places of messages that report, in the file, and what they report."""
        yield from ()

    def named(self) -> Iterator[tuple[Place, str]]:
        """Yield the places where a person is named, and the person."""
        for place, source in self.reporting():
            person = getattr(source, "person", "{person}")
            if FIELD.search(person) is None:
                yield (*place, "person"), person

    def require_possible(self, actions: Collection[Words], *, travels: bool) -> None:
        """Refuse actions, and names of values, that no task has, and what has no effect.

        Parameters
        ----------
        actions : collection of tuple of str
            The actions of all tasks, in lower case: their names and arguments.
        travels : bool
            Whether robots take time to go to people.

        Raises
        ------
        DeclarationError
            An action can never be taken, or a table has no effect.
        """
        for place, source in self.reporting():
            if (why := source.impossible(actions)) is not None:
                raise wrong(why, *place, "action")
        known = {word for action in actions for word in action}
        for name, value in self.names.items():
            if strange := [word for word in words_of(value) if word not in known]:
                raise wrong(f"{strange[0]!r} is in no action of the tasks; {_meant(strange[0], known)}", "names", name)

    def strangers(self, people: Collection[str]) -> list[str]:
        """Return a remark for each place that names somebody who is not among these people."""
        return [
            f"{spelt(place)}: {person!r} is not in the team yet; {_meant(person, people)}"
            for place, person in self.named() if person not in people
        ]  # fmt: skip

    @classmethod
    def read(cls, file: str | Path, robots: int = 1) -> Self:
        """Read the settings for so many robots from a TOML file.

        Raises
        ------
        InputFileError
            A field is missing, unknown or of the wrong type; the message has its place.
        """
        file = Path(file)
        with told(file):
            found = convert(toml.load(file), cls, file)
            found.require(robots)
            return found


@declared(kw_only=True)
class Observing(BridgeSettings):
    """The settings of a bridge that reads what another program publishes."""

    observe: Annotated[Source | tuple[Source, ...], Field(description="What is read.")]

    def require(self, robots: int) -> None:
        """Refuse to read, as two things, what comes from one topic or node, and what the bridge itself sends."""
        uses = [*self.uses()]
        for number, (place, name, read) in enumerate(uses):
            for before, other, was_read in uses[:number]:
                if (read or was_read) and meet(name, other):
                    raise wrong(f"{name!r} is also {spelt(before)}; expected one of its own", *place)

    def uses(self) -> Iterator[tuple[Place, str, bool]]:
        """Yield the places that name a topic or node, this, and whether it is read."""
        yield from ()

    @property
    def sources(self) -> tuple[Any, ...]:
        """The tables `observe`."""
        return self.observe if isinstance(self.observe, tuple) else (self.observe,)

    def reporting(self) -> Iterator[tuple[Place, Source]]:
        """Yield the tables `observe`, each with its number if there is a list of them."""
        for number, source in enumerate(self.sources):
            yield ("observe", number) if isinstance(self.observe, tuple) else ("observe",), source
