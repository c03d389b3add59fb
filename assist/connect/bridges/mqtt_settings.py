"""The settings of the MQTT bridge, from one TOML file. Passwords and certificates come from the environment."""

from __future__ import annotations

import os
import ssl
from collections.abc import Iterator, Mapping
from dataclasses import field
from typing import Annotated

from pydantic import BeforeValidator, Field

from ...declare.declared import Expected, Place, Seconds, Text, Texts, Truth, Whole, declared, names_of
from ...live.views import PersonView, RobotView
from .messages import (
    EventKind,
    Fields,
    Observing,
    Source,
    Template,
    Topic,
    content_of,
    require_among,
    wrong,
)

ENVIRONMENT = "KITASSIST_MQTT_"
VARIABLES = tuple(f"{ENVIRONMENT}{name}" for name in ("PASSWORD", "CA", "CERTIFICATE", "KEY"))
"""Environment variables that set the password, and files of certificates."""

ADVICE = "person", "suggestion", "finished", "seq"
VIEW = {*names_of(PersonView)}
ROBOT = "person", "suggestion", "arrived", "seq"
ERRAND = {*names_of(RobotView)}

Port = Annotated[Whole, Field(ge=1, le=65535), Expected("a port, 1 to 65535")]
TopicText = Annotated[Topic, BeforeValidator(Topic.of), Expected("a text")]


@declared
class Broker:
    """The table `broker`."""

    host: Text = "localhost"
    port: Annotated[Port | None, Field(description="1883 unless given, and 8883 with TLS.")] = None
    client: Annotated[
        Text, Field(description="Name of the bridge at the broker, which keeps messages for it while it is away.")
    ] = "kitassist"
    username: Text | None = None
    tls: Truth = False


@declared(kw_only=True)
class Observed(Source):
    """A table `observe`: a topic with reports."""

    topic: TopicText
    person: Template = "{person}"
    event: EventKind = "acted"
    number: Annotated[Template | None, Field(description="Template of the place among the person's reports.")] = None
    seq: Annotated[Template | None, Field(description="Template of `seq` of the view on which they acted.")] = None

    def fields(self, topic: str, payload: bytes) -> Fields:
        """Return the fields of a message; those of its topic take precedence.

        Raises
        ------
        Refusal
            As in `content_of`.
        """
        return {**content_of(payload, self.pattern), **(self.topic.fields(topic) or {})}


@declared
class Output:
    """A table `advice` or `robot`: a topic on which parts of a view are published."""

    topic: TopicText
    fields: Texts | None = None


@declared
class Plain:
    """A table `answers`, `arrived` or `status`: a topic."""

    topic: TopicText


@declared(kw_only=True)
class MqttSettings(Observing):
    """Settings of the MQTT bridge. With several robots, their topics have the field `{robot}`, a number from 1."""

    observe: Annotated[
        Observed | Annotated[tuple[Observed, ...], Field(min_length=1)],
        Field(description="Topics on which people's actions are published."),
        Expected("a table or more"),
    ]
    broker: Annotated[Broker, Field(description="The broker.")] = field(default_factory=Broker)
    advice: Annotated[Output | None, Field(description="Where suggestions are published.")] = None
    answers: Annotated[Plain | None, Field(description="Where reports are answered.")] = None
    robot: Annotated[Output | None, Field(description="Where the robots' instructions are published.")] = None
    arrived: Annotated[Plain | None, Field(description="Where robots report their places.")] = None
    status: Annotated[Plain | None, Field(description="Where the bridge shows that it works.")] = None
    wait: Annotated[
        Seconds, Field(le=3600, description="Seconds for which later messages of a person wait for an earlier one.")
    ] = 10.0

    def require(self, robots: int) -> None:
        """Refuse topics without the fields that they need, fields that a view does not have, and files of no use."""
        for place, table in self._tables():
            names = ["person"] if place in ("advice", "answers") else []
            if place in ("robot", "arrived") and (robots > 1 or "{robot}" in table.topic.text):
                names = ["robot"]
            if sorted(table.topic.names) != names:
                expected = " and ".join(f"{{{name}}}" for name in names) or "no field"
                raise wrong(f"{table.topic.text!r}; expected {expected} in it", place, "topic")
        for place, output, known in (("advice", self.advice, VIEW), ("robot", self.robot, ERRAND)):
            require_among(None if output is None else output.fields, known, place)
        super().require(robots)
        self.context()

    def uses(self) -> Iterator[tuple[Place, str, bool]]:
        """Yield the topics; also the last answers and advice are read, from what a broker keeps."""
        for place, source in self.reporting():
            yield (*place, "topic"), source.topic.text, True  # type: ignore[attr-defined]
        for name, table in self._tables():
            yield (name, "topic"), table.topic.text, name not in ("robot", "status")

    def _tables(self) -> Iterator[tuple[str, Output | Plain]]:
        for name in ("advice", "answers", "status", "robot", "arrived"):
            if (table := getattr(self, name)) is not None:
                yield name, table

    @property
    def port(self) -> int:
        """The broker's port."""
        return self.broker.port or (8883 if self.broker.tls else 1883)

    def context(self, environment: Mapping[str, str] = os.environ) -> ssl.SSLContext | None:
        """Return the TLS settings, with the files of the environment; None without TLS.

        Raises
        ------
        OSError
            A file cannot be read, or is no certificate or key.
        """
        if not self.broker.tls:
            return None
        name = "CA"
        try:
            context = ssl.create_default_context(cafile=environment.get(f"{ENVIRONMENT}CA"))
            if certificate := environment.get(f"{ENVIRONMENT}CERTIFICATE"):
                name = "CERTIFICATE"
                context.load_cert_chain(certificate, environment.get(f"{ENVIRONMENT}KEY"))
        except OSError as error:
            why = error.strerror or "it is no file in PEM format"
            raise OSError(error.errno, f"{ENVIRONMENT}{name}: {why}", environment.get(f"{ENVIRONMENT}{name}")) from None
        return context

    def password(self, environment: Mapping[str, str] = os.environ) -> str | None:
        """Return the password, from the environment."""
        return environment.get(f"{ENVIRONMENT}PASSWORD")
