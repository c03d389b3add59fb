"""The OPC UA bridge: picks and moves that a station shows as values of nodes, and advice written to nodes.

A value counts as a report when it changes and is not empty. OPC UA keeps nothing for a client that is away: of several
values in that time, only the last is seen. A station that shows the next value when the answer to the last one has been
written loses nothing, and one that gives its values ids has each recorded exactly once.

The value that a node has when the bridge starts may be old. It is a report only if it has an id, under which it happens
once.
"""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import AsyncIterator, Iterable, Iterator, Mapping
from contextlib import asynccontextmanager, contextmanager
from hashlib import sha256
from types import ModuleType
from typing import Any

from planner.system.errors import require_package

from .messages import fields_of_value
from .opcua_settings import Observed, OpcUaSettings, password
from .transport import Answer, Message, Output, Transport

PERIOD = 50.0
"""Milliseconds between two looks of the server at the nodes; values that change twice in it can be missed."""


def library() -> ModuleType:
    """Return the OPC UA library.

    Raises
    ------
    MissingExtraError
        The extra `opcua` is not installed.
    """
    require_package("the OPC UA bridge needs", "asyncua", "opcua")
    import asyncua

    logging.getLogger("asyncua").setLevel(logging.CRITICAL)  # it reports each lost connection several times
    return asyncua


class _Handler:
    """Receives the changes of nodes during a connection."""

    def __init__(self, transport: OpcUa) -> None:
        self._transport, self._seen = transport, set[str]()

    def datachange_notification(self, node: Any, value: Any, data: Any) -> None:
        """Take in the value of a node; the first after a connection is the one that it had before."""
        name = node.nodeid.to_string()
        self._transport.changed(name, value, data.monitored_item.Value, first=name not in self._seen)
        self._seen.add(name)

    def status_change_notification(self, status: Any) -> None:
        """Do nothing when the subscription ends: the connection has."""


class OpcUa(Transport):
    """Another program's OPC UA server.

    Parameters
    ----------
    settings : OpcUaSettings
    robots : int
        Without effect, as nodes have no instructions.

    Raises
    ------
    MissingExtraError
        The extra `opcua` is not installed.
    """

    name, reads = "OPC UA", OpcUaSettings
    settings: OpcUaSettings

    def __init__(self, settings: OpcUaSettings, robots: int = 1) -> None:
        super().__init__()
        self.settings, self._library = settings, library()
        self.lost = (OSError, self._library.ua.UaError)
        self._observed = {one.node: one for one in settings.observe}
        self._last: dict[str, Any] = {}  # the last value of each node
        self._received = asyncio.Queue[tuple[Any, Message | None]]()  # with the connection

    def address(self) -> str:
        """Return the server's address."""
        return self.settings.server.url

    def initially(self) -> Iterable[Output]:
        """Yield an empty suggestion for each node, until the service has told more."""
        yield from (Output(one.node, "", keep=True) for one in self.settings.advice)

    @asynccontextmanager
    async def connect(self) -> AsyncIterator[None]:
        """Connect to the server, and subscribe to the nodes."""
        client = self._client = self._library.Client(self.settings.server.url)
        if self.settings.server.username is not None:
            client.set_user(self.settings.server.username)
            client.set_password(password() or "")

        async def over(_: Exception) -> None:
            self._received.put_nowait((client, None))

        client.connection_lost_callback = over
        async with client:
            subscription = await client.create_subscription(PERIOD, _Handler(self))
            for node in self._observed:
                with self._naming(node):
                    await subscription.subscribe_data_change(
                        client.get_node(node), queuesize=100, sampling_interval=PERIOD
                    )
            yield

    async def messages(self) -> AsyncIterator[Message]:
        """Yield what values report, until the connection is lost."""
        while True:
            client, message = await self._received.get()
            if message is not None:
                yield message
            elif client is self._client:
                return

    async def send(self, key: str, content: str) -> None:
        """Write a text to a node."""
        ua = self._library.ua
        with self._naming(key):
            await self._client.get_node(key).write_value(ua.Variant(content, ua.VariantType.String))

    @contextmanager
    def _naming(self, node: str) -> Iterator[None]:
        """Raise an error of the library with the name of the node."""
        try:
            yield
        except self._library.ua.UaError as error:
            raise self._library.ua.UaError(f"node {node}: {error}") from error

    def changed(self, node: str, value: Any, data: Any, *, first: bool) -> None:
        """Take in a value of a node.

        Parameters
        ----------
        node : str
        value : object
        data : ua.DataValue
            The value with its times.
        first : bool
            Whether it is the first one after a connection.
        """
        observed = self._observed[node]
        old = first and observed.id is None and (node not in self._last or value == self._last[node])
        self._last[node] = value
        if value not in (None, "") and not old:
            self._received.put_nowait((self._client, self._message(observed, str(value), data)))

    def _message(self, observed: Observed, text: str, data: Any) -> Message:
        """Return what a value reports."""
        own = {}
        if observed.id is None:
            at = data.SourceTimestamp or data.ServerTimestamp
            own["id"] = sha256(f"{observed.node} {at} {text}".encode()).hexdigest()
        return self.reported(observed, lambda: {**fields_of_value(text, observed.pattern), **own}, origin=observed.node)

    # What goes where.

    def advice(self, person: str, view: Mapping[str, Any] | None) -> Iterable[Output]:
        """Yield a person's suggestion, and an empty text where there is none."""
        suggestion = "" if view is None else view["suggestion"] or ""
        yield from (Output(one.node, suggestion, keep=True) for one in self.settings.advice if one.person == person)

    def answer(self, answer: Answer) -> Iterable[Output]:
        """Yield the answer to a report, for the node that goes with that of the report."""
        node = self._observed[answer.origin or ""].answer
        if node is not None:
            yield Output(node, json.dumps(answer.as_dict()), keep=True)
