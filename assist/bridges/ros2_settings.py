"""The settings of the ROS 2 bridge, from one TOML file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from ..declare import tables as toml
from ..declare.declared import AnyTable, Expected, Text, Texts, declared
from ..declare.tables import convert, fault, located
from .messages import (
    FIELD,
    Fields,
    MessageError,
    Names,
    ObserveTables,
    Source,
    Topic,
    chosen,
    fields_of,
    observed_in,
    source_of,
    texts_of,
)
from .mqtt_settings import ADVICE, VIEW

STRING = "std_msgs/msg/String"
NAME = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
TYPE = re.compile(r"[a-z]\w*/((msg|action)/)?[A-Z]\w*", re.ASCII)

ANSWER = "person", "id", "status", "detail", "seq"
NULLABLE = {"reason", "cost_to_go"}  # which messages of ROS cannot contain

Places = Annotated[dict[str, dict[str, Any]], Expected("a table for each person")]


@declared
class RosbridgeTable:
    """The table `rosbridge`."""

    url: Text


@declared
class ObserveTable:
    """A table `observe`."""

    topic: Text
    type: Text = STRING
    action: Text = "{action}"
    id: Text = "{id}"
    person: Text = "{person}"
    seq: Text | None = None
    pattern: Text | None = None
    event: Text = "acted"


@declared
class OutputTable:
    """A table `advice` or `answers`."""

    topic: Text
    type: Text = STRING
    fields: Texts | None = None


@declared
class GoToTable:
    """The table `go_to`."""

    action: Text
    type: Text
    goal: AnyTable
    places: Places = field(default_factory=dict)


@declared
class FileTables:
    """The whole file."""

    rosbridge: RosbridgeTable
    observe: ObserveTables
    advice: OutputTable | None = None
    answers: OutputTable | None = None
    go_to: GoToTable | None = None
    names: Names | None = None


@dataclass(frozen=True)
class Observed:
    """A ROS topic whose messages report actions.

    Attributes
    ----------
    topic, type : str
    source : Source
        Templates of what a message reports. Fields are those of the message, or of the JSON object in a String.
    """

    topic: str
    type: str
    source: Source

    def fields(self, message: Mapping[str, Any]) -> Fields:
        """Return the fields of a message.

        Raises
        ------
        MessageError
            It is a String without a JSON object in it, or does not match the pattern.
        """
        if self.type == STRING:
            return fields_of(str(message.get("data", "")).encode(errors="replace"), self.source.pattern)
        return texts_of(message)


@dataclass(frozen=True)
class Output:
    """A ROS topic on which the bridge publishes.

    Attributes
    ----------
    topic, type : str
    fields : tuple of str
        Fields of the message, or of the JSON object in a String.
    """

    topic: str
    type: str
    fields: tuple[str, ...]


@dataclass(frozen=True)
class GoToAction:
    """The ROS action that takes the robot to a person.

    Attributes
    ----------
    action, type : str
        In the action's name, `{robot}` is a robot's number, from 1.
    goal : dict
        The goal, in which `{person}` and the fields of the person's place are filled in.
    places : mapping of str to dict
        Fields of each person's place, such as coordinates.
    """

    action: str
    type: str
    goal: Mapping[str, Any]
    places: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def goal_for(self, person: str) -> dict[str, Any]:
        """Return the goal that takes the robot to a person.

        Raises
        ------
        MessageError
            The person has no place.
        """
        fields = {**self.places.get(person, {}), "person": person}
        if missing := sorted(_fields(self.goal) - set(fields)):
            raise MessageError(f"go_to.places: {person!r} has no {' and no '.join(missing)}")
        found: dict[str, Any] = _filled(self.goal, fields)
        return found


def _fields(template: Any) -> set[str]:
    """Return the fields that occur in a goal."""
    if isinstance(template, str):
        return set(FIELD.findall(template))
    values = template.values() if isinstance(template, Mapping) else template if isinstance(template, list) else ()
    return set[str]().union(*map(_fields, values))


def _filled(template: Any, fields: Mapping[str, Any]) -> Any:
    """Return a goal with its fields filled in; a text of one field only becomes its value, whatever type that has."""
    if isinstance(template, Mapping):
        return {name: _filled(value, fields) for name, value in template.items()}
    if isinstance(template, list):
        return [_filled(value, fields) for value in template]
    if not isinstance(template, str):
        return template
    alone = FIELD.fullmatch(template)
    return fields[alone[1]] if alone else FIELD.sub(lambda found: str(fields[found[1]]), template)


@dataclass(frozen=True)
class Ros2Settings:
    """Settings of the ROS 2 bridge.

    Attributes
    ----------
    url : str
        Address of the rosbridge server, `ws://host:port` or `wss://host:port`.
    observed : tuple of Observed
    advice, answers : Output or None
        Where suggestions are published, and where reports are answered.
    go_to : GoTo or None
    robots : int
        Number of robots; each of several has an action of its own.
    """

    url: str
    observed: tuple[Observed, ...]
    advice: Output | None = None
    answers: Output | None = None
    go_to: GoToAction | None = None
    robots: int = 1

    @classmethod
    def read(cls, file: str | Path, robots: int = 1) -> Ros2Settings:
        """Read the settings for so many robots from a TOML file.

        Raises
        ------
        InputFileError
            A field is missing, unknown or of the wrong type; the message has its place.
        """
        file = Path(file)
        with located(file):
            tables = convert(toml.load(file), FileTables, file)
            if not re.fullmatch(r"wss?://[^\s/:]+(:\d+)?(/\S*)?", tables.rosbridge.url):
                raise fault(file, "rosbridge.url", f"{tables.rosbridge.url!r}; expected ws://host:port or wss://host")
            names = tables.names or {}
            observed = tuple(_observed(one, names, file, place) for place, one in observed_in(tables.observe, file))
            if len({one.topic for one in observed}) < len(observed):
                raise fault(file, "observe", "a topic occurs twice; expected one table for each")
            return cls(
                tables.rosbridge.url, observed,
                advice=_output(tables.advice, ADVICE, VIEW, file, "advice"),
                answers=_output(tables.answers, ANSWER, {*ANSWER}, file, "answers"),
                go_to=_go_to(tables.go_to, file, robots), robots=robots,
            )  # fmt: skip


def _checked(topic: str, type: str, file: Path, place: str) -> None:
    """Check a name and a type of ROS."""
    key = "action" if place == "go_to" else "topic"
    if not NAME.fullmatch(topic):
        raise fault(file, f"{place}.{key}", f"{topic!r}; expected a name of ROS: letters, digits, _ and / between them")
    if not TYPE.fullmatch(type):
        raise fault(file, f"{place}.type", f"{type!r}; expected a type of ROS, such as {STRING}")


def _observed(content: Any, names: Mapping[str, str], file: Path, place: str) -> Observed:
    table = convert(content, ObserveTable, file, place)
    _checked(table.topic, table.type, file, place)
    if table.pattern is not None and table.type != STRING:
        raise fault(file, f"{place}.pattern", f"applies to texts; expected the type {STRING}")
    return Observed(table.topic, table.type, source_of(table, Topic("topic"), names, file, place))


def _output(
    table: OutputTable | None, usual: tuple[str, ...], known: set[str], file: Path, place: str
) -> Output | None:
    if table is None:
        return None
    _checked(table.topic, table.type, file, place)
    known = known if table.type == STRING else known - NULLABLE
    return Output(table.topic, table.type, chosen(table.fields, usual, known, file, place))


def _go_to(table: GoToTable | None, file: Path, robots: int) -> GoToAction | None:
    if table is None:
        return None
    if robots > 1 and "{robot}" not in table.action:
        raise fault(file, "go_to.action", f"{table.action!r}; expected {{robot}} in it")
    _checked(table.action.replace("{robot}", "1"), table.type, file, "go_to")
    go_to = GoToAction(table.action, table.type, table.goal, table.places)
    for person in table.places:
        try:
            go_to.goal_for(person)
        except MessageError as error:
            raise fault(file, f"go_to.places.{person}", str(error).partition(": ")[2]) from None
    return go_to
