"""The settings of the ROS 2 bridge, from one TOML file."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import field
from typing import Annotated, Any, get_origin

from pydantic import Field

from ...declare.declared import AnyTable, Expected, Place, Text, Texts, annotation_of, bare, declared
from ...declare.refusals import Refusal
from ...live.views import PersonView
from ...people.action_names import Words
from .messages import (
    FIELD,
    EventKind,
    Fields,
    Observing,
    Source,
    Template,
    content_of,
    matching,
    require_among,
    sendable,
    unusable,
    wrong,
)
from .mqtt_settings import VIEW

STRING = "std_msgs/msg/String"
ANSWER = "person", "id", "status", "detail", "seq"
IN_MESSAGES = {*ANSWER} | {
    name for name in VIEW
    if (kind := bare(annotation_of(PersonView, name))) in (str, int, bool) or get_origin(kind) is tuple
}  # fmt: skip
"""Fields that messages of ROS can have: always there, and no objects."""


Name = Annotated[
    Text,
    matching(
        r"/?[A-Za-z_](\w|\{robot\})*(/[A-Za-z_](\w|\{robot\})*)*",
        "a name of ROS: letters, digits, _ and / between them",
    ),
]
Type = Annotated[Text, matching(r"[a-z]\w*/((msg|action)/)?[A-Z]\w*", f"a type of ROS, such as {STRING}")]
Url = Annotated[Text, matching(r"wss?://[^\s/:]+(:\d+)?(/\S*)?", "ws://host:port or wss://host")]


@declared
class Rosbridge:
    """The table `rosbridge`."""

    url: Url


@declared(kw_only=True)
class Observed(Source):
    """A table `observe`: a topic with reports, whose fields are the message's, or of the JSON object in a String."""

    topic: Name
    type: Type = STRING
    person: Template = "{person}"
    event: EventKind = "acted"
    seq: Template | None = None

    def __post_init__(self) -> None:
        """Refuse a pattern for messages that are no texts."""
        if self.pattern is not None and self.type != STRING:
            raise wrong(f"applies to texts; expected the type {STRING}", "pattern")

    def fields(self, message: Mapping[str, Any]) -> Fields:
        """Return the fields of a message.

        Raises
        ------
        Refusal
            It is a String without a JSON object in it, or does not match the pattern.
        """
        if self.type == STRING:
            return content_of(str(message.get("data", "")).encode(errors="replace"), self.pattern)
        return sendable(dict(message))


@declared
class Output:
    """A table `advice` or `answers`: a topic on which fields are published, or a JSON object of them in a String."""

    topic: Name
    type: Type = STRING
    fields: Texts | None = None


@declared
class GoToAction:
    """The table `go_to`: the ROS action that takes a robot to a person."""

    action: Annotated[Name, Field(description="Its name, in which `{robot}` is a robot's number, from 1.")]
    type: Type
    goal: Annotated[
        AnyTable, Field(description="The goal, in which `{person}` and the fields of their place are filled in.")
    ]
    places: Annotated[
        Annotated[dict[str, dict[str, Any]], Expected("a table for each person")],
        Field(description="Fields of each person's place, such as coordinates."),
    ] = field(default_factory=dict)

    def goal_for(self, person: str) -> dict[str, Any]:
        """Return the goal that takes the robot to a person.

        Raises
        ------
        Refusal
            The person has no place.
        """
        fields = {**self.places.get(person, {}), "person": person}
        if missing := sorted(_fields(self.goal) - set(fields)):
            raise unusable(f"go_to.places: {person!r} has no {' and no '.join(missing)}")
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


@declared(kw_only=True)
class Ros2Settings(Observing):
    """Settings of the ROS 2 bridge."""

    rosbridge: Annotated[Rosbridge, Field(description="The server of rosbridge.")]
    observe: Annotated[
        Observed | Annotated[tuple[Observed, ...], Field(min_length=1)],
        Field(description="Topics on which people's actions are published."),
        Expected("a table or more"),
    ]
    advice: Annotated[Output | None, Field(description="Where suggestions are published.")] = None
    answers: Annotated[Output | None, Field(description="Where reports are answered.")] = None
    go_to: Annotated[GoToAction | None, Field(description="The action that sends a robot to a person.")] = None

    def require(self, robots: int) -> None:
        """Refuse topics that occur twice, unknown fields, and goals that lack a field or the robot's number."""
        super().require(robots)
        for place, output, known in (("advice", self.advice, VIEW), ("answers", self.answers, {*ANSWER})):
            if output is not None:
                require_among(output.fields, known if output.type == STRING else known & IN_MESSAGES, place)
        go_to = self.go_to
        if go_to is not None and robots > 1 and "{robot}" not in go_to.action:
            raise wrong(f"{go_to.action!r}; expected {{robot}} in it", "go_to", "action")
        for person in () if go_to is None else go_to.places:
            try:
                go_to.goal_for(person)  # type: ignore[union-attr]
            except Refusal as error:
                raise wrong(str(error).partition(": ")[2], "go_to", "places", person) from None

    def require_possible(self, actions: Collection[Words], *, travels: bool) -> None:
        """Refuse also goals that are never sent, as a robot that takes no time is always there."""
        if self.go_to is not None and not travels:
            raise wrong("has no effect without travel_time", "go_to")
        super().require_possible(actions, travels=travels)

    def uses(self) -> Iterator[tuple[Place, str, bool]]:
        """Yield the topics."""
        for place, source in self.reporting():
            yield (*place, "topic"), source.topic, True  # type: ignore[attr-defined]
        for name, output in (("advice", self.advice), ("answers", self.answers)):
            if output is not None:
                yield (name, "topic"), output.topic, False

    def named(self) -> Iterator[tuple[Place, str]]:
        """Yield also the people whose places are named."""
        yield from super().named()
        for person in {} if self.go_to is None else self.go_to.places:
            yield ("go_to", "places", person), person
