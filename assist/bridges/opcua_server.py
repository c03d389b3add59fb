"""An OPC UA server of the assistant's own, for systems that only poll: they read advice and write reports.

Each person in the team has an object with the variables `Suggestion`, `Finished`, `Seq`, `Action`, `Begin` and `Answer`
and the method `Report`; each robot has one with `Person`, `Suggestion` and `Arrived`. Clients may write `Action`,
`Begin` and `Arrived`. A value that they write is a report when it differs from the one before and is not empty, so
systems may write their outputs in every cycle. Values with ids of their own happen once, even when they are written
again after a restart.

When `Answer` shows a report, `Suggestion` is not older than it.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import logging
import uuid
from collections import Counter
from collections.abc import Callable, Coroutine
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from ..web.client import RefusedError, robot_path
from .messages import LONGEST_ID, MessageError, Report, fields_of_value
from .opcua import library
from .opcua_settings import OwnServerSettings, password
from .session_client import SessionClient
from .tasks import Tasks, together
from .team_watch import TeamWatch

LOG = logging.getLogger(__name__)

NAMESPACE = "urn:kitassist"
UNKNOWN = -1  # `Seq` in a call that does not say which advice the person had seen


class _Users:
    """Who may use the server: all clients, or those with the name and password."""

    def __init__(self, settings: OwnServerSettings, user: Callable[[], Any]) -> None:
        self._name, self._password, self._user = settings.username, password(), user

    def get_user(self, _: Any, username: str | None = None, password: str | None = None, **__: Any) -> Any:
        """Return the user, who may write only where the nodes allow it; None for a stranger."""
        if self._name is None:
            return self._user()
        expected, given = (f"{self._name}\n{self._password}", f"{username}\n{password}")
        return self._user() if hmac.compare_digest(expected.encode(), given.encode(errors="replace")) else None


@dataclass
class _Nodes:
    """The nodes of a person or robot.

    Attributes
    ----------
    object : Node
    seq : int
        Number of the last event that they show.
    variables : dict of str to Node
    turn : Lock
        Held while a report is delivered, so that reports keep their order.
    """

    object: Any
    seq: int = -1
    variables: dict[str, Any] = field(default_factory=dict)
    turn: asyncio.Lock = field(default_factory=asyncio.Lock)


class OpcUaServer:
    """An OPC UA server of a running service.

    Parameters
    ----------
    settings : OwnServerSettings
    link : str
        The operator's link, as `kitassist serve` prints it.
    longest_pause : float
        Largest number of seconds between two attempts to listen at the address. The first pause is a second.

    Attributes
    ----------
    counts : Counter
        Numbers of `values` written, of `calls`, and of reports `recorded` and `refused`.
    connected : bool
        Whether the server listens.
    waits : tuple
        Empty: no report waits for another one.

    Raises
    ------
    MissingExtraError
        The extra `opcua` is not installed.
    """

    def __init__(self, settings: OwnServerSettings, link: str, *, longest_pause: float = 30.0) -> None:
        self.settings, self._library = settings, library()
        self.counts, self.connected, self.waits = Counter[str](), False, ()
        self._session = SessionClient(link)
        self._watch = TeamWatch(self._session, self._seen, self._instructed)
        self._longest_pause = longest_pause
        self._tasks = Tasks()
        self._people: dict[str, _Nodes] = {}
        self._robots: dict[int, _Nodes] = {}
        self._changes = asyncio.Queue[Callable[[], Coroutine[Any, Any, None]]]()
        self._inputs: dict[str, Callable[[str], Coroutine[Any, Any, None]]] = {}  # what is done with written values
        self._last: dict[str, Any] = {}  # the last value of each node that clients write

    async def run(self) -> None:
        """Work until cancelled. The service may be restarted meanwhile.

        Raises
        ------
        RefusedError
            The service does not accept the link.
        """
        self._server = await self._listening()
        try:
            await together(self._watch.run(), self._change())
        finally:
            self.connected = False
            await self._tasks.cancel()
            await self._session.close()
            await self._server.stop()

    async def _listening(self) -> Any:
        """Return the server, which listens; as long as the address is taken, try again."""
        pause = 1.0
        while True:
            # The library's own nodes take seconds, in which the service would answer nobody.
            server = await asyncio.to_thread(asyncio.run, self._prepared())
            try:
                await server.start()
            except OSError as error:
                if pause == 1.0:
                    LOG.warning("OPC UA: no server at %s: %s", self.settings.url, error)
                await asyncio.sleep(pause)
                pause = min(2 * pause, self._longest_pause)
                continue
            self.connected = True
            return server

    async def _prepared(self) -> Any:
        """Return a server with the objects `People` and `Robots`."""
        ua, users = self._library.ua, self._library.crypto.permission_rules
        server = self._library.Server(
            user_manager=_Users(self.settings, lambda: users.User(role=users.UserRole.User, name="line"))
        )
        await server.init()
        server.set_endpoint(self.settings.url)
        server.set_server_name("kitassist")
        server.set_security_policy([ua.SecurityPolicyType.NoSecurity], permission_ruleset=users.SimpleRoleRuleset())
        anonymous = self.settings.username is None
        server.set_identity_tokens([ua.AnonymousIdentityToken if anonymous else ua.UserNameIdentityToken])
        self._space = await server.register_namespace(NAMESPACE)
        for name in ("People", "Robots"):
            await server.nodes.objects.add_folder(ua.NodeId(name, self._space), f"{self._space}:{name}")
        server.subscribe_server_callback(self._library.common.callback.CallbackType.PostWrite, self._written)
        return server

    # Nodes.

    async def _change(self) -> None:
        """Change the nodes, one after the other."""
        while True:
            await (await self._changes.get())()

    async def _object(self, folder: str, name: str) -> _Nodes:
        ua = self._library.ua
        parent = self._server.get_node(ua.NodeId(folder, self._space))
        return _Nodes(await parent.add_object(ua.NodeId(f"{folder}/{name}", self._space), f"{self._space}:{name}"))

    async def _variable(
        self, nodes: _Nodes, name: str, value: Any, take: Callable[[str], Coroutine[Any, Any, None]] | None = None
    ) -> None:
        """Add a variable; if clients may write it, with what is done with the values."""
        ua = self._library.ua
        path = f"{nodes.object.nodeid.Identifier}/{name}"
        node = await nodes.object.add_variable(
            ua.NodeId(path, self._space), f"{self._space}:{name}", self._typed(value)
        )
        nodes.variables[name] = node
        if take is not None:
            await node.set_writable()
            self._inputs[node.nodeid.to_string()] = take

    def _typed(self, value: Any) -> Any:
        """Return a value with its type in OPC UA; None becomes an empty text."""
        types = self._library.ua.VariantType
        kind = {bool: types.Boolean, int: types.Int64}.get(type(value), types.String)
        return self._library.ua.Variant("" if value is None else value, kind)

    async def _show(self, nodes: _Nodes, seq: int, **values: Any) -> None:
        """Show values of the service, unless newer ones are shown."""
        if seq < nodes.seq:
            return
        nodes.seq = seq
        for name, value in values.items():
            await nodes.variables[name].write_value(self._typed(value))

    def _seen(self, person: str, view: dict[str, Any] | None) -> None:
        """Show a person's advice after every change, and remove the nodes of those who have left."""
        self._changes.put_nowait(partial(self._left, person) if view is None else partial(self._advised, person, view))

    async def _left(self, person: str) -> None:
        nodes = self._people.pop(person, None)
        if nodes is not None:
            for node in nodes.variables.values():
                self._inputs.pop(node.nodeid.to_string(), None)
                self._last.pop(node.nodeid.to_string(), None)
            await self._server.delete_nodes([nodes.object], recursive=True)

    async def _advised(self, person: str, view: dict[str, Any]) -> None:
        if person not in self._people:
            types = self._library.ua.VariantType
            nodes = await self._object("People", person)
            for name, value in (("Suggestion", ""), ("Finished", False), ("Seq", UNKNOWN), ("Answer", "")):
                await self._variable(nodes, name, value)
            await self._variable(nodes, "Action", "", partial(self._acted, person, nodes))
            await self._variable(nodes, "Begin", "", partial(self._began, person, nodes))
            await nodes.object.add_method(
                self._library.ua.NodeId(f"People/{person}/Report", self._space), f"{self._space}:Report",
                partial(self._called, person, nodes),
                [types.String, types.String, types.Int64], [types.String, types.String, types.Int64],
            )  # fmt: skip
            self._people[person] = nodes
        await self._show_advice(self._people[person], view)

    async def _show_advice(self, nodes: _Nodes, view: dict[str, Any]) -> None:
        seq = view["seq"]
        await self._show(nodes, seq, Suggestion=view["suggestion"], Finished=view["finished"], Seq=seq)

    def _instructed(self, robot: int, errand: dict[str, Any]) -> None:
        self._changes.put_nowait(partial(self._sent, robot, errand))

    async def _sent(self, robot: int, errand: dict[str, Any]) -> None:
        """Show where a robot is to go and what it suggests there."""
        if robot not in self._robots:
            nodes = self._robots[robot] = await self._object("Robots", str(robot))
            for name in ("Person", "Suggestion"):
                await self._variable(nodes, name, "")
            await self._variable(nodes, "Arrived", "", partial(self._arrived, robot, nodes))
        await self._show(self._robots[robot], errand["seq"], Person=errand["person"], Suggestion=errand["suggestion"])

    # Reports.

    async def _written(self, event: Any, _: Any) -> None:
        """Take in what a client has written."""
        if not event.is_external:
            return
        for written, status in zip(event.request_params.NodesToWrite, event.response_params, strict=True):
            node, value = written.NodeId.to_string(), written.Value.Value
            if node not in self._inputs or not status.is_good() or value is None:
                continue
            before, self._last[node] = self._last.get(node), value.Value
            if value.Value not in (None, "", before):
                self.counts["values"] += 1
                self._tasks.start(self._inputs[node](str(value.Value)))

    async def _acted(self, person: str, nodes: _Nodes, text: str) -> None:
        await self._answered(nodes, self._report(person, text))

    async def _began(self, person: str, nodes: _Nodes, identifier: str) -> None:
        report = Report(person, "", identifier, begins=True)
        if len(identifier) > LONGEST_ID:
            report = replace(report, id="", fault=f"an id of {len(identifier)} characters; expected 1 to {LONGEST_ID}")
        await self._answered(nodes, report)

    async def _called(self, person: str, nodes: _Nodes, _: Any, action: Any, identifier: Any, seq: Any) -> list[Any]:
        """Answer a call of `Report` with its status, a refusal's reason, and the number of the event."""
        self.counts["calls"] += 1
        report = self._report(person, str(action.Value or ""), identifier.Value or uuid.uuid4().hex)
        if seq.Value is not None and seq.Value > UNKNOWN:
            report = replace(report, seq=seq.Value)
        answer = await self._delivered(nodes, report)
        return [
            self._typed(answer.get(name, other)) for name, other in (("status", ""), ("detail", ""), ("seq", UNKNOWN))
        ]

    def _report(self, person: str, text: str, identifier: str | None = None) -> Report:
        """Return what a text reports; a fault is part of it."""
        fields, source = {"person": person}, self.settings.source
        if identifier is None and not self.settings.has_id:
            identifier = uuid.uuid4().hex
        if identifier is not None:
            source = replace(source, id="{id}")
        try:
            fields = {**fields_of_value(text, source.pattern), **fields}
            if identifier is not None:
                fields["id"] = identifier
            return source.report(fields)
        except MessageError as error:
            return Report(person, "", identifier or "", fault=str(error))

    async def _delivered(self, nodes: _Nodes, report: Report) -> dict[str, Any]:
        """Deliver a report to the service, show the advice after it, and return the answer."""
        async with nodes.turn:
            try:
                view = await self._session.report(report)
            except RefusedError as error:
                LOG.warning("OPC UA: a report of %.80s: %s", report.person, error)
                answer = {"id": report.id, "status": "refused", "detail": str(error)}
            else:
                with suppress(self._library.ua.UaError):  # the person has left meanwhile
                    await self._show_advice(nodes, view)
                answer = {"id": report.id, "status": "recorded", "seq": view["seq"]}
            self.counts[answer["status"]] += 1
            return answer

    async def _answered(self, nodes: _Nodes, report: Report) -> None:
        answer = await self._delivered(nodes, report)
        with suppress(self._library.ua.UaError):
            await nodes.variables["Answer"].write_value(self._typed(json.dumps(answer)))

    async def _arrived(self, robot: int, nodes: _Nodes, person: str) -> None:
        """Report that a robot is at a person."""
        async with nodes.turn:
            try:
                await self._session.ask("POST", f"{robot_path(robot)}/arrived", {"person": person})
            except RefusedError as error:
                LOG.warning("OPC UA: arrival of a robot: %s", error)
