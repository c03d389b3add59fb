"""The MQTT bridge: actions from an MQTT broker to the running service, and its advice to the broker.

Messages may be lost, repeated and reordered. A report is answered on the topic `answers` when it is recorded or
refused. Numbers of reports restore their order. The broker gets its acknowledgement of a message only when the report
is recorded (or held back, where it is numbered), so that it delivers the message again after a crash.

Advice is published retained, and again after each reconnection, since a broker may have forgotten it.
"""

from __future__ import annotations

import asyncio
import json
import logging
import re
import socket
from collections.abc import AsyncIterator, Iterable, Iterator, Mapping
from contextlib import asynccontextmanager, suppress
from types import ModuleType
from typing import TYPE_CHECKING, Any

from planner.system.errors import MissingExtraError

from ...declare.refusals import Refusal
from .messages import LONGEST_ID, fields_of, unusable
from .mqtt_settings import ADVICE, ROBOT, MqttSettings
from .ordering import Acknowledgements
from .transport import Answer, Faulty, Kept, Located, Message, Output, Reported, Resumed, Transport

if TYPE_CHECKING:
    import aiomqtt

LOG = logging.getLogger(__name__)

ONLINE, OFFLINE = b"online", b"offline"
QUIET = 0.3
"""Seconds without a message after which a broker has sent all that it keeps."""
WILD = re.compile(r"[/+#\0]")  # characters that a level of a topic cannot have


def library() -> ModuleType:
    """Return the MQTT library.

    Raises
    ------
    MissingExtraError
        The extra `mqtt` is not installed.
    """
    try:
        import aiomqtt
    except ImportError:
        raise MissingExtraError("the MQTT bridge needs", "aiomqtt", "mqtt") from None
    return aiomqtt


def _confirm(broker: aiomqtt.Client) -> None:
    """Acknowledge at once, by TCP, what has arrived; many brokers send a connection nothing more until then.

    The system would wait for 40 ms for data to send along, and the next report would wait as well.
    """
    connection = broker._client.socket()
    if connection is not None and hasattr(socket, "TCP_QUICKACK"):  # on Linux
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)


class Mqtt(Transport):
    """A broker.

    Parameters
    ----------
    settings : MqttSettings
    robots : int
    at_once : int
        Messages that may wait for the broker's acknowledgement at a time. More help over slow networks.

    Raises
    ------
    MissingExtraError
        The extra `mqtt` is not installed.
    OSError
        A file of the TLS settings cannot be read.
    """

    name, reads = "MQTT", MqttSettings

    def __init__(self, settings: MqttSettings, robots: int = 1, *, at_once: int = 8) -> None:
        super().__init__()
        self.settings, self.at_once, self.wait, self._mqtt = settings, at_once, settings.wait, library()
        self.lost = (self._mqtt.MqttError, OSError)
        self._count = robots
        self.robots = 0 if settings.robot is None else robots
        self._context = settings.context()
        self._begun, self._asked = list[Message](), False

    def address(self) -> str:
        """Return the broker's host and port."""
        return f"{self.settings.broker.host}:{self.settings.port}"

    @asynccontextmanager
    async def connect(self) -> AsyncIterator[None]:
        """Connect to the broker, and subscribe."""
        settings = self.settings
        async with self._client() as broker:
            self._broker, self._open = broker, Acknowledgements(broker._client.ack)
            for topic in self._topics():
                await broker.subscribe(topic, qos=1)
            if not self._asked:  # later the bridge itself knows how far numbers are, and what it has published
                self._begun, self._asked = await self._retained(), True
            if settings.status is not None:
                await broker.publish(settings.status.topic.text, ONLINE, qos=1, retain=True)
            try:
                yield
            finally:
                self._open.close()
                if settings.status is not None:
                    with suppress(self._mqtt.MqttError):
                        await broker.publish(settings.status.topic.text, OFFLINE, qos=1, retain=True, timeout=1.0)

    def _client(self) -> aiomqtt.Client:
        settings, will = self.settings, None
        if settings.status is not None:
            will = self._mqtt.Will(settings.status.topic.text, OFFLINE, qos=1, retain=True)
        client = self._named(settings.broker.client, clean_session=False, will=will)
        client._client.manual_ack_set(True)  # aiomqtt itself would acknowledge what has not been recorded
        return client

    def _named(self, name: str, **options: Any) -> aiomqtt.Client:
        settings = self.settings
        client: aiomqtt.Client = self._mqtt.Client(
            settings.broker.host, settings.port, username=settings.broker.username, password=settings.password(),
            identifier=name, tls_context=self._context, keepalive=15,
            socket_options=[(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)], **options,
        )  # fmt: skip
        return client

    async def _retained(self) -> list[Message]:
        """Return what the broker keeps: where numbers go on, after the last answers in this session, and old advice.

        Some brokers send what they keep to new subscribers only, so that a client of its own asks for it.
        """
        outputs = (self.settings.answers, self.settings.advice)
        topics, found = [one.topic for one in outputs if one is not None], list[Message]()
        if not topics:
            return found
        try:
            async with self._named(f"{self.settings.broker.client}-answers", clean_session=True, timeout=3.0) as reader:
                for topic in topics:
                    await reader.subscribe(topic.filter, qos=1)
                with suppress(TimeoutError):
                    while True:
                        message = await asyncio.wait_for(anext(reader.messages), QUIET)
                        found += self._before(str(message.topic), message.payload)
        except self.lost as error:
            LOG.warning("MQTT: the last answers cannot be read, so that numbers begin at 1 again: %s", error)
        return found

    def _topics(self) -> list[str]:
        settings = self.settings
        topics = [source.topic.filter for source in settings.sources]
        return topics + ([settings.arrived.topic.filter] if settings.arrived is not None else [])

    async def messages(self) -> AsyncIterator[Message]:
        """Yield what the broker delivers."""
        while self._begun:
            yield self._begun.pop()
        async for message in self._broker.messages:
            done = self._open.expect(message.mid, message.qos)
            yield self.message(str(message.topic), message.payload, done)

    async def send(self, key: str, content: tuple[bytes, bool]) -> None:
        """Publish a payload, retained or not."""
        payload, retain = content
        await self._broker.publish(key, payload, qos=1, retain=retain)
        _confirm(self._broker)

    # What messages mean.

    def message(self, topic: str, payload: bytes, done: Any) -> Message:
        """Return what a message reports."""
        arrived = self.settings.arrived
        if arrived is not None and (fields := arrived.topic.fields(topic)) is not None:
            return self._located(fields.get("robot", "1"), payload, done)
        source = next((one for one in self.settings.sources if one.topic.fields(topic) is not None), None)
        if source is None:  # a subscription of an earlier configuration
            return Message(done=done)
        fields = dict(source.topic.fields(topic) or {})
        try:
            fields = source.fields(topic, payload)
            return Reported(source.report(fields, self.settings.names), done=done)
        except Refusal as error:
            return Faulty(str(error), fields.get("person"), fields.get("id"), done=done)

    def _before(self, topic: str, payload: bytes) -> Iterator[Message]:
        """Yield what follows from a message that the broker has kept; the one last answer may be of this session."""
        answers, advice = self.settings.answers, self.settings.advice
        if answers is not None and (own := answers.topic.fields(topic)) is not None:
            with suppress(ValueError):
                fields = fields_of(payload)
                if fields.get("session") == self.session and "next" in fields:
                    yield Resumed(own["person"], int(fields["next"]))
                    return
            yield Kept(own["person"])
        if advice is not None and (own := advice.topic.fields(topic)) is not None:
            yield Kept(own["person"])

    def _located(self, robot: str, payload: bytes, done: Any) -> Message:
        try:
            if robot not in map(str, range(1, self._count + 1)):
                raise unusable(f"robot {robot[:40]!r}; expected a number from 1 to {self._count}")
            fields = fields_of(payload)
        except Refusal as error:
            LOG.warning("MQTT: arrival of a robot: %s", error)
            return Message(done=done)
        return Located(int(robot), fields.get("person"), fields.get("id"), done=done)

    # What goes where.

    def advice(self, person: str, view: Mapping[str, Any] | None) -> Iterable[Output]:
        """Yield a person's advice; when they have left, the broker is to keep nothing of them."""
        output = self.settings.advice
        if output is not None:
            payload = b"" if view is None else _json(view, output.fields or ADVICE)
            yield Output(output.topic.fill(person=person), (payload, True), keep=True)

    def answer(self, answer: Answer) -> Iterable[Output]:
        """Yield the answer to a report; that to a numbered one is retained, with the number that comes next."""
        topic, person = self.settings.answers, answer.person
        if topic is not None and person and len(person) <= LONGEST_ID and not WILD.search(person):
            session = {} if answer.next is None else {"session": self.session}
            payload = json.dumps(answer.as_dict() | session).encode()
            yield Output(topic.topic.fill(person=person), (payload, answer.number is not None))

    def forget(self, person: str) -> Iterable[Output]:
        """Yield what removes the last answer to a person who has left."""
        if self.settings.answers is not None:
            yield Output(self.settings.answers.topic.fill(person=person), (b"", True))

    def instruction(self, robot: int, errand: Mapping[str, Any]) -> Iterable[Output]:
        """Yield a robot's instruction."""
        output = self.settings.robot
        if output is not None:
            yield Output(output.topic.fill(robot=str(robot)), (_json(errand, output.fields or ROBOT), True), keep=True)


def _json(view: Mapping[str, Any], fields: Iterable[str]) -> bytes:
    return json.dumps({name: view.get(name) for name in fields}).encode()
