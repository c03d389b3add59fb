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
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from random import Random
from types import ModuleType
from typing import Any

from planner.system.errors import MissingExtraError

from ..web.client import RefusedError
from .messages import MessageError, fields_of_value
from .opcua_settings import Observed, OpcUaSettings, password
from .session_client import SessionClient
from .tasks import together
from .team_watch import TeamWatch

LOG = logging.getLogger(__name__)


def library() -> ModuleType:
    """Return the OPC UA library.

    Raises
    ------
    MissingExtraError
        The extra `opcua` is not installed.
    """
    try:
        import asyncua
    except ImportError:
        raise MissingExtraError("the OPC UA bridge needs", "asyncua", "opcua") from None
    logging.getLogger("asyncua").setLevel(logging.CRITICAL)  # it reports each lost connection several times
    return asyncua


class _Handler:
    """Receives the changes of nodes."""

    def __init__(self, bridge: OpcUaBridge) -> None:
        self._bridge, self._seen = bridge, set[str]()

    def datachange_notification(self, node: Any, value: Any, data: Any) -> None:
        """Take in the value of a node; the first after a connection is the one that it had before."""
        name = node.nodeid.to_string()
        self._bridge.changed(name, value, data.monitored_item.Value, first=name not in self._seen)
        self._seen.add(name)

    def status_change_notification(self, status: Any) -> None:
        """Do nothing when the subscription ends: the connection has."""


class OpcUaBridge:
    """A bridge between an OPC UA server and a running service.

    Parameters
    ----------
    settings : OpcUaSettings
    link : str
        The operator's link, as `kitassist serve` prints it.
    period : float
        Milliseconds between two looks of the server at the nodes; values that change twice in it can be missed.
    longest_pause : float
        Largest number of seconds between two attempts to reach the server. The first pause is a tenth of a second.

    Attributes
    ----------
    counts : Counter
        Numbers of `values`, of reports `recorded` and `refused`, and of `connections` to the server.
    connected : bool
        Whether the bridge is connected to the server, and subscribed.
    waits : tuple
        Empty: no report waits for another one.

    Raises
    ------
    MissingExtraError
        The extra `opcua` is not installed.
    """

    def __init__(
        self, settings: OpcUaSettings, link: str, *, period: float = 50.0, longest_pause: float = 30.0
    ) -> None:
        self.settings, self._library = settings, library()
        self.counts, self.connected, self.waits = Counter[str](), False, ()
        self._session = SessionClient(link)
        self._period, self._longest_pause = period, longest_pause
        self._observed = {one.node: one for one in settings.observed}
        self._last: dict[str, Any] = {}  # the last value of each node
        self._reports = asyncio.Queue[tuple[Observed, dict[str, str]]]()
        self._kept: dict[str, str] = {}  # what each node of the server is to show
        self._waiting: dict[str, str] = {}
        self._wake = asyncio.Event()

    async def run(self) -> None:
        """Work until cancelled. Lost connections to the server and to the service are restored."""
        for node, _ in self.settings.advice:
            self._write(node, "")  # until the service has told more
        try:
            await together(self._server(), self._deliver(), TeamWatch(self._session, self._advise).run())
        finally:
            await self._session.close()

    async def _server(self) -> None:
        """Stay connected to the server."""
        pause, lost, random = 0.1, False, Random()
        while True:
            try:
                await self._converse()
            except (OSError, self._library.ua.UaError) as error:
                if not lost:
                    LOG.warning("OPC UA: no connection to %s: %s", self.settings.url, error or type(error).__name__)
            else:
                pause = 0.1  # seconds
            self.connected, lost = False, True
            await asyncio.sleep(pause * random.uniform(0.5, 1.0))
            pause = min(2 * pause, self._longest_pause)

    async def _converse(self) -> None:
        """Observe nodes and write to them until the connection is lost.

        Raises
        ------
        OSError, ua.UaError
            There is no connection, or no such node.
        """
        ua, ended = self._library.ua, asyncio.Event()
        client = self._library.Client(self.settings.url)
        if self.settings.username is not None:
            client.set_user(self.settings.username)
            client.set_password(password() or "")

        async def over(_: Exception) -> None:
            ended.set()
            self._wake.set()

        client.connection_lost_callback = over
        async with client:
            self.counts["connections"] += 1
            subscription = await client.create_subscription(self._period, _Handler(self))
            for node in self._observed:
                with self._naming(node):
                    await subscription.subscribe_data_change(
                        client.get_node(node), queuesize=100, sampling_interval=self._period
                    )
            self._waiting = {**self._kept, **self._waiting}
            self.connected = True
            while not ended.is_set():
                while self._waiting:
                    node, text = next(iter(self._waiting.items()))
                    with self._naming(node):
                        await client.get_node(node).write_value(ua.Variant(text, ua.VariantType.String))
                    if self._waiting[node] == text:  # and no newer one
                        del self._waiting[node]
                self._wake.clear()
                await self._wake.wait()

    @contextmanager
    def _naming(self, node: str) -> Iterator[None]:
        """Raise an error of the library with the name of the node."""
        try:
            yield
        except self._library.ua.UaError as error:
            raise self._library.ua.UaError(f"node {node}: {error}") from error

    def _write(self, node: str, text: str) -> None:
        self._kept[node] = self._waiting[node] = text
        self._wake.set()

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
        observed, text = self._observed[node], str(value)
        old = first and not observed.has_id and (node not in self._last or value == self._last[node])
        self._last[node] = value
        if value in (None, "") or old:
            return
        self.counts["values"] += 1
        try:
            fields = fields_of_value(text, observed.source.pattern)
        except MessageError as error:
            self._answer(observed, None, "refused", detail=str(error))
            return
        if not observed.has_id:
            at = data.SourceTimestamp or data.ServerTimestamp
            fields["id"] = sha256(f"{node} {at} {text}".encode()).hexdigest()
        self._reports.put_nowait((observed, fields))

    async def _deliver(self) -> None:
        """Report the actions to the service, one after the other."""
        while True:
            observed, fields = await self._reports.get()
            identifier = fields.get("id")
            try:
                report = observed.source.report(fields)
                identifier = report.id
                view = await self._session.report(report)
            except (MessageError, RefusedError) as error:
                self._answer(observed, identifier, "refused", detail=str(error))
            else:
                self._answer(observed, identifier, "recorded", seq=view["seq"])

    def _answer(self, observed: Observed, identifier: str | None, status: str, **more: Any) -> None:
        self.counts[status] += 1
        if status == "refused":
            LOG.warning("OPC UA: %s: %s", observed.node, more["detail"])
        if observed.answer is not None:
            self._write(observed.answer, json.dumps({"id": identifier, "status": status, **more}))

    def _advise(self, person: str, view: dict[str, Any] | None) -> None:
        """Write a person's suggestion after every change, and an empty text where there is none."""
        suggestion = "" if view is None else view["suggestion"] or ""
        for node, whose in self.settings.advice:
            if whose == person and self._kept.get(node) != suggestion:
                self._write(node, suggestion)
