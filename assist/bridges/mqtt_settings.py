"""The settings of the MQTT bridge, from one TOML file. Passwords and certificates come from the environment."""

from __future__ import annotations

import os
import ssl
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from ..declare import tables as toml
from ..declare.declared import Expected, Number, Text, Texts, Truth, Whole, declared
from ..declare.tables import convert, fault, located
from .messages import Names, ObserveTables, Source, Topic, chosen, observed_in, source_of

ENVIRONMENT = "KITASSIST_MQTT_"
"""Prefix of the environment variables PASSWORD, CA, CERTIFICATE and KEY."""

Port = Annotated[Whole, Field(ge=1, le=65535), Expected("a port, 1 to 65535")]
Seconds = Annotated[Number, Field(gt=0, le=3600), Expected("seconds above 0, at most 3600")]


@declared
class BrokerTable:
    """The table `broker`."""

    host: Text = "localhost"
    port: Port | None = None
    client: Text = "kitassist"
    username: Text | None = None
    tls: Truth = False


@declared
class ObserveTable:
    """A table `observe`."""

    topic: Text
    action: Text = "{action}"
    id: Text = "{id}"
    person: Text = "{person}"
    number: Text | None = None
    seq: Text | None = None
    pattern: Text | None = None
    event: Text = "acted"


@declared
class OutputTable:
    """A table `advice` or `robot`."""

    topic: Text
    fields: Texts | None = None


@declared
class TopicTable:
    """A table `answers`, `arrived` or `status`."""

    topic: Text


@declared
class FileTables:
    """The whole file."""

    observe: ObserveTables
    broker: BrokerTable = field(default_factory=BrokerTable)
    advice: OutputTable | None = None
    answers: TopicTable | None = None
    robot: OutputTable | None = None
    arrived: TopicTable | None = None
    status: TopicTable | None = None
    names: Names | None = None
    wait: Seconds = 10.0


@dataclass(frozen=True)
class Output:
    """A topic on which parts of a view are published.

    Attributes
    ----------
    topic : Topic
    fields : tuple of str
        Fields of the view.
    """

    topic: Topic
    fields: tuple[str, ...]


ADVICE = "person", "suggestion", "finished", "seq"
VIEW = {*ADVICE, "task", "present", "paused", "applicable", "reason", "cost_to_go", "steps", "explained"}
ROBOT = "person", "suggestion", "arrived", "seq"
ERRAND = {*ROBOT, "reason", "location"}


@dataclass(frozen=True)
class MqttSettings:
    """Settings of the MQTT bridge.

    Attributes
    ----------
    sources : tuple of Source
        Messages that report actions.
    host : str
    port : int
    client : str
        Name of the bridge at the broker, which keeps messages for it while it is away.
    username : str or None
    tls : bool
    advice, robot : Output or None
        Where suggestions and the robot's instructions are published.
    answers, arrived, status : Topic or None
        Where reports are answered, where the robot reports its place, and where the bridge shows that it works.
    wait : float
        Seconds for which later messages of a person wait for an earlier one.
    robots : int
        Number of robots; several have the field `{robot}`, a number from 1, in their topics.
    """

    sources: tuple[Source, ...]
    host: str = "localhost"
    port: int = 1883
    client: str = "kitassist"
    username: str | None = None
    tls: bool = False
    advice: Output | None = None
    answers: Topic | None = None
    robot: Output | None = None
    arrived: Topic | None = None
    status: Topic | None = None
    wait: float = 10.0
    robots: int = 1

    @classmethod
    def read(cls, file: str | Path, robots: int = 1) -> MqttSettings:
        """Read the settings for so many robots from a TOML file.

        Raises
        ------
        InputFileError
            A field is missing, unknown or of the wrong type; the message has its place.
        """
        file = Path(file)
        with located(file):
            tables = convert(toml.load(file), FileTables, file)
            broker = tables.broker
            port = broker.port or (8883 if broker.tls else 1883)
            names = tables.names or {}
            sources = tuple(_source(one, names, file, place) for place, one in observed_in(tables.observe, file))
            return cls(
                sources, broker.host, port, broker.client, broker.username, broker.tls,
                advice=_output(tables.advice, ["person"], ADVICE, VIEW, file, "advice"),
                answers=_topic(tables.answers, ["person"], file, "answers"),
                robot=_output(tables.robot, _of_robot(tables.robot, robots), ROBOT, ERRAND, file, "robot"),
                arrived=_topic(tables.arrived, _of_robot(tables.arrived, robots), file, "arrived"),
                status=_topic(tables.status, [], file, "status"),
                wait=tables.wait, robots=robots,
            )  # fmt: skip

    def context(self, environment: Mapping[str, str] = os.environ) -> ssl.SSLContext | None:
        """Return the TLS settings, with the files of the environment; None without TLS.

        Raises
        ------
        OSError
            A file cannot be read, or is no certificate or key.
        """
        if not self.tls:
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


def _checked(text: str, names: list[str], file: Path, place: str) -> Topic:
    """Return a topic that has exactly the given fields."""
    try:
        topic = Topic(text)
    except ValueError as error:
        raise fault(file, f"{place}.topic", str(error)) from None
    if sorted(topic.names) != names:
        expected = " and ".join(f"{{{name}}}" for name in names) or "no field"
        raise fault(file, f"{place}.topic", f"{text!r}; expected {expected} in it")
    return topic


def _of_robot(table: OutputTable | TopicTable | None, robots: int) -> list[str]:
    """Return the fields that the topic of robots needs: a number, which may be absent if there is one robot."""
    return ["robot"] if robots > 1 or (table is not None and "{robot}" in table.topic) else []


def _topic(table: TopicTable | None, names: list[str], file: Path, place: str) -> Topic | None:
    return None if table is None else _checked(table.topic, names, file, place)


def _output(
    table: OutputTable | None, names: list[str], usual: tuple[str, ...], known: set[str], file: Path, place: str
) -> Output | None:
    if table is None:
        return None
    return Output(_checked(table.topic, names, file, place), chosen(table.fields, usual, known, file, place))


def _source(content: Any, names: Mapping[str, str], file: Path, place: str) -> Source:
    table = convert(content, ObserveTable, file, place)
    try:
        topic = Topic(table.topic)
    except ValueError as error:
        raise fault(file, f"{place}.topic", str(error)) from None
    return source_of(table, topic, names, file, place)
