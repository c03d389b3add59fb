"""The settings of the OPC UA bridges, from one TOML file. Passwords come from the environment."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Annotated

from pydantic import AfterValidator, Field

from ...declare.declared import Expected, Place, Text, declared
from ...live.names import name_of
from .messages import ActionTemplate, BridgeSettings, EventKind, Observing, Source, Template, matching

PASSWORD = "KITASSIST_OPCUA_PASSWORD"


def password() -> str | None:
    """Return the password of the user, from the environment."""
    return os.environ.get(PASSWORD)


def _user(name: str) -> str:
    if not password():
        raise ValueError(f"has no password; expected it in {PASSWORD}")
    return name


Node = Annotated[Text, matching(r"(ns=\d+;)?[isgb]=.+", "a node id, such as ns=2;s=Station.Pick")]
Url = Annotated[Text, matching(r"opc\.tcp://[^\s/:]+(:\d+)?(/\S*)?", "opc.tcp://host:port/path")]
User = Annotated[Text, AfterValidator(_user)]


@declared
class Server:
    """The table `server`."""

    url: Url
    username: Annotated[User | None, Field(description="Name of a user; the password is in the environment.")] = None


@declared(kw_only=True)
class Observed(Source):
    """A table `observe`: a node whose values are reports. Their fields are those of a JSON object, or `value`."""

    node: Node
    person: Template
    event: EventKind = "acted"
    action: ActionTemplate = "{value}"
    id: Annotated[
        Template | None, Field(description="Template of a value's own id; else it is made of the value and its time.")
    ] = None
    answer: Annotated[Node | None, Field(description="Node to which the answer to each report is written.")] = None


@declared
class Advice:
    """A table `advice`: a node to which suggestions are written, and whose they are."""

    node: Node
    person: Annotated[Text, AfterValidator(name_of)]


@declared(kw_only=True)
class OpcUaSettings(Observing):
    """Settings of the bridge to another program's OPC UA server."""

    server: Annotated[Server, Field(description="The server of the other program.")]
    observe: Annotated[
        tuple[Observed, ...],
        Field(min_length=1, description="What is read from the server."),
        Expected("one table or more"),
    ]
    advice: Annotated[tuple[Advice, ...], Field(description="Where suggestions are written.")] = ()

    def uses(self) -> Iterator[tuple[Place, str, bool]]:
        """Yield the nodes; answers to several may be written to one."""
        for number, observed in enumerate(self.observe):
            yield ("observe", number, "node"), observed.node, True
        for number, observed in enumerate(self.observe):
            if observed.answer is not None:
                yield ("observe", number, "answer"), observed.answer, False
        for number, advice in enumerate(self.advice):
            yield ("advice", number, "node"), advice.node, False

    def named(self) -> Iterator[tuple[Place, str]]:
        """Yield also the people whose suggestions are written."""
        yield from super().named()
        for number, advice in enumerate(self.advice):
            yield ("advice", number, "person"), advice.person


@declared(kw_only=True)
class OwnServer(Source):
    """The table `own_server`: a value's fields are those of a JSON object, or `value`, and `person`."""

    url: Annotated[Url, Field(description="Address at which it listens.")]
    action: ActionTemplate = "{value}"
    id: Annotated[Template | None, Field(description="Template of a value's own id, if it has one.")] = None
    seq: Template | None = None
    username: Annotated[
        User | None, Field(description="Name of the only user; without one, all who reach the address may report.")
    ] = None


@declared(kw_only=True)
class OwnServerSettings(BridgeSettings):
    """Settings of an OPC UA server of the assistant's own."""

    own_server: Annotated[OwnServer, Field(description="The server of the assistant.")]

    def reporting(self) -> Iterator[tuple[Place, Source]]:
        """Yield the table `own_server`."""
        yield ("own_server",), self.own_server
