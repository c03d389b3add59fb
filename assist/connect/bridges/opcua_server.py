"""An OPC UA server of the assistant's own, for systems that only poll: they read advice and write reports.

A value that clients write (`opcua_nodes`) is a report when it differs from the one before and is not empty, so systems
may write their outputs in every cycle. Values with ids of their own happen once, even when they are written again after
a restart.

When `Answer` shows a report, `Suggestion` is not older than it.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import uuid
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from contextlib import asynccontextmanager, suppress
from dataclasses import replace
from functools import partial
from typing import Any

from ...declare.refusals import Refusal
from .messages import LONGEST_ID, Report, fields_of_value
from .opcua import library
from .opcua_nodes import NAMESPACE, UNKNOWN, Nodes
from .opcua_settings import OwnServerSettings, password
from .transport import Answer, Message, Output, Reported, Transport

ARGUMENTS = (str, str, int)
"""Types of the arguments of `Report`; each may be null."""


class _Users:
    """Who may use the server: all clients, or those with the name and password."""

    def __init__(self, settings: OwnServerSettings, user: Callable[[], Any]) -> None:
        self._name, self._password, self._user = settings.own_server.username, password(), user

    def get_user(self, _: Any, username: str | None = None, password: str | None = None, **__: Any) -> Any:
        """Return the user, who may write only where the nodes allow it; None for a stranger."""
        if self._name is None:
            return self._user()
        expected, given = (f"{self._name}\n{self._password}", f"{username}\n{password}")
        return self._user() if hmac.compare_digest(expected.encode(), given.encode(errors="replace")) else None


class OwnServer(Transport):
    """An OPC UA server of a running service; "connected" means that it listens.

    Parameters
    ----------
    settings : OwnServerSettings
    robots : int

    Raises
    ------
    MissingExtraError
        The extra `opcua` is not installed.
    """

    name, reads = "OPC UA", OwnServerSettings
    settings: OwnServerSettings

    def __init__(self, settings: OwnServerSettings, robots: int = 1) -> None:
        super().__init__()
        self.settings, self._library, self.robots = settings, library(), robots
        self._received, self._last = asyncio.Queue[Message](), dict[str, Any]()

    def address(self) -> str:
        """Return the address at which it listens."""
        return self.settings.own_server.url

    @asynccontextmanager
    async def connect(self) -> AsyncIterator[None]:
        """Listen; there are no people and robots at first."""
        # The library's own nodes take seconds, in which the service would answer nobody.
        server = self._server = await asyncio.to_thread(asyncio.run, self._prepared())
        await server.start()
        try:
            yield
        finally:
            await server.stop()

    async def _prepared(self) -> Any:
        """Return a server with the objects `People` and `Robots`."""
        ua, users = self._library.ua, self._library.crypto.permission_rules
        server = self._library.Server(
            user_manager=_Users(self.settings, lambda: users.User(role=users.UserRole.User, name="line"))
        )
        await server.init()
        server.set_endpoint(self.settings.own_server.url)
        server.set_server_name("kitassist")
        server.set_security_policy([ua.SecurityPolicyType.NoSecurity], permission_ruleset=users.SimpleRoleRuleset())
        anonymous = self.settings.own_server.username is None
        server.set_identity_tokens([ua.AnonymousIdentityToken if anonymous else ua.UserNameIdentityToken])
        self._nodes = Nodes(ua, server, await server.register_namespace(NAMESPACE), self, self._last)
        await self._nodes.prepare()
        server.subscribe_server_callback(self._library.common.callback.CallbackType.PostWrite, self._written)
        return server

    async def messages(self) -> AsyncIterator[Message]:
        """Yield what clients write and call."""
        while True:
            yield await self._received.get()

    async def send(self, key: str, content: Mapping[str, Any] | None) -> None:
        """Show values of a person or robot, whose nodes are made when they are first needed; None removes them."""
        if content is None:
            await self._nodes.remove(key)
        else:
            await self._nodes.show(key, content)

    # What is written and called.

    async def _written(self, event: Any, _: Any) -> None:
        """Take in what a client has written."""
        if not event.is_external:
            return
        for written, status in zip(event.request_params.NodesToWrite, event.response_params, strict=True):
            value = written.Value.Value
            if status.is_good() and value is not None:
                message = self._nodes.written(written.NodeId.to_string(), value.Value)
                if message is not None:
                    self.counts["values"] += 1
                    self._received.put_nowait(message)

    async def called(self, person: str, parent: Any, *given: Any) -> Any:
        """Answer a call of `Report` with its status, a refusal's reason, and the number of the event."""
        self.counts["calls"] += 1
        codes, values = self._library.ua.StatusCodes, [one.Value for one in given]
        if len(values) != len(ARGUMENTS):
            few = len(values) < len(ARGUMENTS)
            return self._library.ua.StatusCode(codes.BadArgumentsMissing if few else codes.BadTooManyArguments)
        if not all(isinstance(one, kind | None) for one, kind in zip(values, ARGUMENTS, strict=True)):
            return self._library.ua.StatusCode(codes.BadInvalidArgument)
        action, identifier, seq = values
        report = self._report(person, action or "", identifier or uuid.uuid4().hex)
        if seq not in (None, UNKNOWN):
            report = replace(report, values={**report.values, "seq": seq})
        answered = asyncio.get_running_loop().create_future()
        self._received.put_nowait(Reported(report, answered=partial(_resolve, answered)))
        answer: Answer = await answered
        seq_now = UNKNOWN if answer.seq is None else answer.seq
        return [self._nodes.typed(value) for value in (answer.status, answer.detail or "", seq_now)]

    def acted(self, person: str, text: str) -> Message:
        """Return what a text reports that was written."""
        return Reported(self._report(person, text))

    def begun(self, person: str, identifier: str) -> Message:
        """Return the report that a person begins the next task; the value is its id."""
        report = Report(person, identifier, "began")
        if len(identifier) > LONGEST_ID:
            why = f"an id of {len(identifier)} characters; expected 1 to {LONGEST_ID}"
            report = replace(report, id="", fault=why)
        return Reported(report)

    def _report(self, person: str, text: str, identifier: str | None = None) -> Report:
        """Return what a text reports; a fault is part of it."""
        source = self.settings.own_server
        if identifier is None and source.id is None:
            identifier = uuid.uuid4().hex
        if identifier is not None:
            source = replace(source, id=None)
        try:
            fields = {**fields_of_value(text, source.pattern), "person": person}
            if identifier is not None:
                fields["id"] = identifier
            return source.report(fields, self.settings.names)
        except Refusal as error:
            return Report(person, identifier or "", fault=str(error))

    # What goes where.

    def advice(self, person: str, view: Mapping[str, Any] | None) -> Iterable[Output]:
        """Yield a person's advice; when they have left, their nodes are removed."""
        shown = None if view is None else {
            "Suggestion": view["suggestion"], "Finished": view["finished"], "Seq": view["seq"],
        }  # fmt: skip
        yield Output(f"People/{person}", shown, keep=True)

    def answer(self, answer: Answer) -> Iterable[Output]:
        """Yield the answer to a value."""
        yield Output(f"People/{answer.person}", {"Answer": json.dumps(answer.as_dict())})

    def instruction(self, robot: int, errand: Mapping[str, Any]) -> Iterable[Output]:
        """Yield where a robot is to go and what it suggests there."""
        shown = {"Person": errand["person"], "Suggestion": errand["suggestion"]}
        yield Output(f"Robots/{robot}", shown, keep=True)


def _resolve(answered: asyncio.Future[Answer], answer: Answer) -> None:
    with suppress(asyncio.InvalidStateError):  # the client has disconnected
        answered.set_result(answer)
