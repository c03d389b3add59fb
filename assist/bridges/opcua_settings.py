"""The settings of the OPC UA bridges, from one TOML file. Passwords come from the environment."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field

from ..declare import tables as toml
from ..declare.declared import Expected, Text, declared
from ..declare.tables import convert, fault, located
from .messages import Names, Source, Topic, source_of

PASSWORD = "KITASSIST_OPCUA_PASSWORD"
NODE = re.compile(r"(ns=\d+;)?[isgb]=.+")


@declared
class ServerTable:
    """The table `server`."""

    url: Text
    username: Text | None = None


@declared
class ObserveTable:
    """A table of `observe`."""

    node: Text
    person: Text
    action: Text = "{value}"
    id: Text | None = None
    pattern: Text | None = None
    answer: Text | None = None
    event: Text = "acted"


@declared
class AdviceTable:
    """A table of `advice`."""

    node: Text
    person: Text


@declared
class OwnServerTable:
    """The table `own_server`."""

    url: Text
    action: Text = "{value}"
    id: Text | None = None
    seq: Text | None = None
    pattern: Text | None = None
    username: Text | None = None


@declared
class OwnServerFileTables:
    """The whole file, for a server of the assistant's own."""

    own_server: OwnServerTable
    names: Names | None = None


@declared
class FileTables:
    """The whole file, for another program's server."""

    server: ServerTable
    observe: Annotated[tuple[ObserveTable, ...], Field(min_length=1), Expected("one table or more")]
    advice: tuple[AdviceTable, ...] = ()
    names: Names | None = None


@dataclass(frozen=True)
class Observed:
    """A node whose values report actions.

    Attributes
    ----------
    node : str
        Node id, such as `ns=2;s=Station.Pick`.
    source : Source
        Templates of what a value reports. Fields are those of a JSON object, or `value`.
    has_id : bool
        Whether values have an id of their own; otherwise the id is made from the value and its time.
    answer : str or None
        Node to which the answer to each report is written.
    """

    node: str
    source: Source
    has_id: bool
    answer: str | None


@dataclass(frozen=True)
class OpcUaSettings:
    """Settings of the OPC UA bridge.

    Attributes
    ----------
    url : str
        Address of the server, `opc.tcp://host:port/path`.
    observed : tuple of Observed
    advice : tuple of (str, str)
        Nodes to which suggestions are written, and whose they are.
    username : str or None
        Name of a user at the server; the password is in the environment.
    """

    url: str
    observed: tuple[Observed, ...]
    advice: tuple[tuple[str, str], ...] = ()
    username: str | None = None

    @classmethod
    def read(cls, file: str | Path) -> OpcUaSettings:
        """Read the settings from a TOML file.

        Raises
        ------
        InputFileError
            A field is missing, unknown or of the wrong type; the message has its place.
        """
        file = Path(file)
        with located(file):
            tables = convert(toml.load(file), FileTables, file)
            _require_url(tables.server.url, file, "server.url")
            observed = []
            for number, one in enumerate(tables.observe, start=1):
                place = f"observe[{number}]"
                nodes = (_node(one.node, file, f"{place}.node"), _node(one.answer, file, f"{place}.answer"))
                source = source_of(one, Topic("node"), tables.names or {}, file, place)
                observed.append(Observed(nodes[0] or "", source, one.id is not None, nodes[1]))
            advice = [
                (_node(one.node, file, f"advice[{number}].node") or "", one.person)
                for number, one in enumerate(tables.advice, start=1)
            ]
            _require_password(tables.server.username, file, "server.username")
            return cls(tables.server.url, tuple(observed), tuple(advice), tables.server.username)


@dataclass(frozen=True)
class OwnServerSettings:
    """Settings of an OPC UA server of the assistant's own.

    Attributes
    ----------
    url : str
        Address at which it listens, `opc.tcp://host:port/path`.
    source : Source
        Templates of what a value reports. Fields are those of a JSON object, or `value`, and `person`.
    has_id : bool
        Whether values have an id of their own.
    username : str or None
        Name of the only user; without one, all who reach the address may read and report.
    robots : int
        Number of robots.
    """

    url: str
    source: Source
    has_id: bool = False
    username: str | None = None
    robots: int = 1

    @classmethod
    def read(cls, file: str | Path, robots: int = 1) -> OwnServerSettings:
        """Read the settings for so many robots from a TOML file.

        Raises
        ------
        InputFileError
            A field is missing, unknown or of the wrong type; the message has its place. Or there is a user name, and no
            password in the environment.
        """
        file = Path(file)
        with located(file):
            tables = convert(toml.load(file), OwnServerFileTables, file)
            table = tables.own_server
            _require_url(table.url, file, "own_server.url")
            source = source_of(table, Topic("node"), tables.names or {}, file, "own_server")
            _require_password(table.username, file, "own_server.username")
            return cls(table.url, source, table.id is not None, table.username, robots)


def password() -> str | None:
    """Return the password of the user, from the environment."""
    return os.environ.get(PASSWORD)


def _require_password(username: str | None, file: Path, place: str) -> None:
    if username is not None and not password():
        raise fault(file, place, f"has no password; expected it in {PASSWORD}")


def _require_url(url: str, file: Path, place: str) -> None:
    if not re.fullmatch(r"opc\.tcp://[^\s/:]+(:\d+)?(/\S*)?", url):
        raise fault(file, place, f"{url!r}; expected opc.tcp://host:port/path")


def _node(node: str | None, file: Path, place: str) -> str | None:
    if node is not None and not NODE.fullmatch(node):
        raise fault(file, place, f"{node!r}; expected a node id, such as ns=2;s=Station.Pick")
    return node
