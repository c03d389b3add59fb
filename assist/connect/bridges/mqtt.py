"""The MQTT bridge: actions from an MQTT broker to the running service, and its advice to the broker.

Messages may be lost, repeated and reordered. A report is answered on the topic `answers` when it is recorded or
refused. Numbers of reports restore their order. The broker gets its acknowledgement of a message only when the report
is recorded (or held back, where it is numbered), so that it delivers the message again after a crash.

Advice is published retained, and again after each reconnection, since a broker may have forgotten it.
"""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import TYPE_CHECKING, Any

from planner.system.errors import require_package

from .mqtt_settings import MqttSettings
from .mqtt_topics import Topics
from .ordering import Acknowledgements
from .transport import Message

if TYPE_CHECKING:
    import aiomqtt

LOG = logging.getLogger(__name__)

ONLINE, OFFLINE = b"online", b"offline"
QUIET = 0.3
"""Seconds without a message after which a broker has sent all that it keeps."""


def _confirm(broker: aiomqtt.Client) -> None:
    """Acknowledge at once, by TCP, what has arrived; many brokers send a connection nothing more until then.

    The system would wait for 40 ms for data to send along, and the next report would wait as well.
    """
    connection = broker._client.socket()
    if connection is not None and hasattr(socket, "TCP_QUICKACK"):  # on Linux
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)


class Mqtt(Topics):
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

    def __init__(self, settings: MqttSettings, robots: int = 1, *, at_once: int = 8) -> None:
        require_package("the MQTT bridge needs", "aiomqtt", "mqtt")
        import aiomqtt

        super().__init__(settings, robots)
        self.at_once, self._mqtt = at_once, aiomqtt
        self.lost = (self._mqtt.MqttError, OSError)
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
            for topic in self.topics():
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
        topics, found = self.kept(), list[Message]()
        if not topics:
            return found
        try:
            async with self._named(f"{self.settings.broker.client}-answers", clean_session=True, timeout=3.0) as reader:
                for topic in topics:
                    await reader.subscribe(topic, qos=1)
                with suppress(TimeoutError):
                    while True:
                        message = await asyncio.wait_for(anext(reader.messages), QUIET)
                        found += self.before(str(message.topic), message.payload)
        except self.lost as error:
            LOG.warning("MQTT: the last answers cannot be read, so that numbers begin at 1 again: %s", error)
        return found

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
