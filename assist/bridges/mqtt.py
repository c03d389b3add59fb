"""The MQTT bridge: actions from an MQTT broker to the running service, and its advice to the broker.

Messages may be lost, repeated and reordered. A report has an id, under which the service records it once, and is
answered on the topic `answers` when it is recorded or refused. A sender that repeats a report until it is answered has
each recorded exactly once, whatever happens to the broker, the bridge or the service in between. Numbers of reports
restore their order. The broker gets its acknowledgement of a message only when the report is recorded (or held back,
where it is numbered), so that it delivers the message again after a crash.

Advice is published retained, and again after each reconnection, since a broker may have forgotten it.
"""

from __future__ import annotations

import asyncio
import json
import logging
import re
import socket
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from itertools import count
from random import Random
from types import ModuleType
from typing import TYPE_CHECKING, Any

from planner.system.errors import MissingExtraError

from ..web.client import RefusedError, robot_path
from .messages import LONGEST_ID, MessageError, Report, fields_of
from .mqtt_settings import MqttSettings
from .ordering import Acknowledgements, InOrder
from .session_client import SessionClient
from .tasks import Tasks, together
from .team_watch import TeamWatch

if TYPE_CHECKING:
    import aiomqtt

ONLINE, OFFLINE = b"online", b"offline"
WILD = re.compile(r"[/+#\0]")  # characters that a level of a topic cannot have
ABSENT = 404  # status of a report about nobody

LOG = logging.getLogger(__name__)

Acknowledge = Callable[[], object]
"""Acknowledges a message to the broker."""


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


class _Sender:
    """The reports of one person: those that wait for their turn, and the task that hands them over one by one."""

    def __init__(self) -> None:
        self.order = InOrder[tuple[Report, Acknowledge]]()
        self.queue = asyncio.Queue[tuple[Report, Acknowledge]]()
        self.answered = 0  # the highest number of an answered report
        self.timer: asyncio.TimerHandle | None = None
        self.task: asyncio.Task[None] | None = None


class MqttBridge:
    """A bridge between a broker and a running service.

    Parameters
    ----------
    settings : MqttSettings
    link : str
        The operator's link, as `kitassist serve` prints it.
    longest_pause : float
        Largest number of seconds between two attempts to reach the broker. The first pause is a tenth of a second;
        each next one is twice as long, with a random part, so that not all clients return at once.
    publishers : int
        Messages that may wait for the broker's acknowledgement at a time. More help over slow networks.

    Attributes
    ----------
    counts : Counter
        Numbers of `messages`, of reports `recorded` and `refused`, of `connections` to the broker and messages
        `published`.
    connected : bool
        Whether the bridge is connected to the broker, and subscribed.

    Raises
    ------
    MissingExtraError
        The extra `mqtt` is not installed.
    """

    def __init__(self, settings: MqttSettings, link: str, *, longest_pause: float = 30.0, publishers: int = 8) -> None:
        self.settings, self._mqtt = settings, library()
        self.counts, self.connected = Counter[str](), False
        self._session = SessionClient(link)
        self._longest_pause, self._publishers = longest_pause, publishers
        self._senders: dict[str, _Sender] = {}
        self._tasks = Tasks()
        instructed = None if settings.robot is None else self._instructed
        self._watch = TeamWatch(self._session, self._advise, instructed)
        self._kept: dict[str, bytes] = {}  # retained messages by topic
        self._waiting: dict[str | int, tuple[str, bytes, bool]] = {}  # to be published, in this order
        self._keys = count()
        self._wake = asyncio.Event()

    @property
    def waits(self) -> list[str]:
        """What reports wait for that have arrived before others of their sender."""
        return [
            f"MQTT: {person}: {len(order.held)} reports wait for the number {order.next}, which has not arrived"
            for person, order in ((person, sender.order) for person, sender in self._senders.items())
            if order.held
        ]

    async def run(self) -> None:
        """Work until cancelled. Lost connections to the broker and to the service are restored.

        Raises
        ------
        RefusedError
            The service does not accept the link.
        OSError
            A file of the TLS settings cannot be read.
        """
        context = await asyncio.to_thread(self.settings.context)
        try:
            await together(self._watch.run(), self._broker(context))
        finally:
            await self._tasks.cancel()
            for sender in self._senders.values():
                if sender.timer is not None:
                    sender.timer.cancel()
            await self._session.close()

    # The broker.

    async def _broker(self, context: Any) -> None:
        """Stay connected to the broker."""
        shortest, steady = 0.1, 5.0  # seconds; a connection that lasts for less counts as another failure
        pause, lost, loop, random = shortest, False, asyncio.get_running_loop(), Random()
        while True:
            began = loop.time()
            try:
                async with self._connection(context) as broker:
                    if lost:
                        LOG.warning("MQTT: connected to %s again", self.settings.host)
                    lost, began = False, loop.time()
                    self.counts["connections"] += 1
                    await self._converse(broker)
            except (self._mqtt.MqttError, OSError) as error:
                if not lost:
                    LOG.warning("MQTT: no connection to %s:%d: %s", self.settings.host, self.settings.port, error)
                lost = True
            if loop.time() > began + steady:
                pause = shortest
            await asyncio.sleep(pause * random.uniform(0.5, 1.0))
            pause = min(2 * pause, self._longest_pause)

    def _connection(self, context: Any) -> aiomqtt.Client:
        settings = self.settings
        will = None
        if settings.status is not None:
            will = self._mqtt.Will(settings.status.text, OFFLINE, qos=1, retain=True)
        client: aiomqtt.Client = self._mqtt.Client(
            settings.host, settings.port, username=settings.username, password=settings.password(),
            identifier=settings.client, clean_session=False, will=will, tls_context=context, keepalive=15,
            socket_options=[(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)],
        )  # fmt: skip
        client._client.manual_ack_set(True)  # aiomqtt itself would acknowledge what has not been recorded
        return client

    async def _converse(self, broker: aiomqtt.Client) -> None:
        """Receive and publish until the connection is lost."""
        settings = self.settings
        numbered = any(source.number is not None for source in settings.sources)
        topics = [source.topic.filter for source in settings.sources]
        topics += [settings.arrived.filter] if settings.arrived is not None else []
        if numbered and settings.answers is not None:  # the last answers say which number comes next
            topics.insert(0, settings.answers.filter)
        for topic in topics:
            await broker.subscribe(topic, qos=1)
        if settings.status is not None:
            self._publish(settings.status.text, ONLINE)
        for topic, payload in self._kept.items():
            self._waiting.setdefault(topic, (topic, payload, True))
        self._wake.set()
        self.connected = True
        tasks = [asyncio.create_task(self._publisher(broker)) for _ in range(self._publishers)]
        open_messages = Acknowledgements(broker._client.ack)
        tasks.append(asyncio.create_task(self._receiver(broker, open_messages)))
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        except asyncio.CancelledError:
            if settings.status is not None:
                with suppress(self._mqtt.MqttError):
                    await broker.publish(settings.status.text, OFFLINE, qos=1, retain=True, timeout=1.0)
            raise
        finally:
            self.connected = False
            open_messages.close()
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _publisher(self, broker: aiomqtt.Client) -> None:
        while True:
            while not self._waiting:
                self._wake.clear()
                await self._wake.wait()
            key = next(iter(self._waiting))
            topic, payload, retain = self._waiting.pop(key)
            try:
                await broker.publish(topic, payload, qos=1, retain=retain)
            except BaseException:
                self._waiting = {key: (topic, payload, retain)} | self._waiting  # unless there is a newer one
                raise
            _confirm(broker)
            self.counts["published"] += 1

    def _publish(self, topic: str, payload: bytes) -> None:
        """Publish a retained message, in place of an earlier one on this topic."""
        if self._kept.get(topic) == payload and topic != getattr(self.settings.status, "text", None):
            return
        self._kept[topic] = payload
        self._waiting[topic] = (topic, payload, True)
        self._wake.set()

    async def _receiver(self, broker: aiomqtt.Client, open_messages: Acknowledgements) -> None:
        async for message in broker.messages:
            acknowledge = open_messages.expect(message.mid, message.qos)
            topic, payload = str(message.topic), message.payload
            answers, arrived = self.settings.answers, self.settings.arrived
            own = None if answers is None else answers.fields(topic)
            if own is not None:
                if message.retain:
                    self._resume(own["person"], payload)
                acknowledge()
            elif arrived is not None and (fields := arrived.fields(topic)) is not None:
                self._tasks.start(self._arrived(fields.get("robot", "1"), payload, acknowledge))
            else:
                self._observed(topic, payload, acknowledge)

    # Reports.

    def _observed(self, topic: str, payload: bytes, acknowledge: Acknowledge) -> None:
        """Take in a message that reports an action."""
        self.counts["messages"] += 1
        source = next((one for one in self.settings.sources if one.topic.fields(topic) is not None), None)
        if source is None:  # a subscription of an earlier configuration
            acknowledge()
            return
        fields = dict(source.topic.fields(topic) or {})
        try:
            fields = source.fields(topic, payload)
            report = source.report(fields)
        except MessageError as error:
            self._answer(fields.get("person"), fields.get("id"), None, "refused", str(error))
            acknowledge()
            return
        sender = self._senders.setdefault(report.person, _Sender())
        if report.number is None:
            self._hand_over(report.person, [(report, acknowledge)])
            return
        acknowledge()  # before it is recorded: a broker sends only so many messages ahead, and one of them is missing
        order, number = sender.order, report.number
        before = order.held.get(number)
        if order.late(number):
            self._answer(report.person, report.id, None, "refused", "later actions were recorded before it arrived")
        elif before is not None and before[0].id != report.id:
            why = f"the number {number} belongs to the id {before[0].id!r}; expected one id for each"
            self._answer(report.person, report.id, None, "refused", why)
        elif order.jumps(number):
            missing = order.missing(number)
            why = f"number {number}: the numbers {missing[0]} to {missing[-1]} did not arrive; expected {missing[0]}"
            self._answer(report.person, report.id, None, "refused", why)
        else:
            self._hand_over(report.person, order.take(number, (report, lambda: None)))

    def _hand_over(self, person: str, items: list[tuple[Report, Acknowledge]]) -> None:
        """Queue reports for the service, and see to it that those held back are not forgotten."""
        sender = self._senders[person]
        for item in items:
            sender.queue.put_nowait(item)
        if items and (sender.task is None or sender.task.done()):
            sender.task = self._tasks.start(self._deliver(person, sender))
        if items or not sender.order.held:
            if sender.timer is not None:
                sender.timer.cancel()
            sender.timer = None
        if sender.order.held and sender.timer is None:
            loop = asyncio.get_running_loop()
            sender.timer = loop.call_later(self.settings.wait, self._pass_over, person)

    def _pass_over(self, person: str) -> None:
        sender = self._senders[person]
        sender.timer = None
        missing = range(sender.order.next, min(sender.order.held))
        LOG.warning("MQTT: %s: no report with number %d arrived; later ones go ahead", person, missing[0])
        self._hand_over(person, sender.order.pass_over())

    def _resume(self, person: str, payload: bytes) -> None:
        """Continue after the last answer in this session, which the broker has kept."""
        with suppress(MessageError, ValueError):
            fields = fields_of(payload)
            if fields.get("session") == self._session.session and "next" in fields:
                sender = self._senders.setdefault(person, _Sender())
                self._hand_over(person, sender.order.resume(int(fields["next"])))

    async def _deliver(self, person: str, sender: _Sender) -> None:
        """Report one person's actions to the service, one after the other."""
        while not sender.queue.empty():
            report, acknowledge = sender.queue.get_nowait()
            try:
                view = await self._session.report(report)
            except RefusedError as error:
                self._answer(person, report.id, report.number, "refused", str(error))
                if error.status == ABSENT and report.number is None and sender.queue.empty():
                    self._senders.pop(person, None)  # a message about nobody costs no memory
            else:
                self._answer(person, report.id, report.number, "recorded", seq=view["seq"])
            acknowledge()

    def _answer(
        self, person: str | None, identifier: str | None, number: int | None, status: str,
        detail: str | None = None, **more: Any,
    ) -> None:  # fmt: skip
        """Publish the answer to a report; that to a numbered one is retained, with the number that comes next."""
        self.counts[status] += 1
        if detail is not None:
            LOG.warning("MQTT: a report of %.80s: %s", person or "nobody", detail)
        if self.settings.answers is None or not person or len(person) > LONGEST_ID or WILD.search(person):
            return
        answer: dict[str, Any] = {"id": identifier, "status": status, **more}
        answer |= {} if detail is None else {"detail": detail}
        sender = self._senders.get(person)
        if number is not None and sender is not None:
            sender.answered = max(sender.answered, number)
            answer |= {"number": number, "next": sender.answered + 1, "session": self._session.session}
        topic, most = self.settings.answers.fill(person=person), 100_000  # some tens of megabytes
        if len(self._waiting) < most:
            self._waiting[next(self._keys)] = (topic, json.dumps(answer).encode(), number is not None)
            self._wake.set()

    async def _arrived(self, robot: str, payload: bytes, acknowledge: Acknowledge) -> None:
        """Report where a robot is: at a person, or at its base if there is none."""
        try:
            if robot not in map(str, range(1, self.settings.robots + 1)):
                raise MessageError(f"robot {robot[:40]!r}; expected a number from 1 to {self.settings.robots}")
            fields = fields_of(payload)
            body = {"person": fields.get("person")} | ({"id": fields["id"]} if "id" in fields else {})
            await self._session.ask("POST", f"{robot_path(int(robot))}/arrived", body)
        except (MessageError, RefusedError) as error:
            LOG.warning("MQTT: arrival of a robot: %s", error)
        acknowledge()

    # Advice.

    def _advise(self, person: str, view: dict[str, Any] | None) -> None:
        """Publish a person's advice after every change; when they have left, the broker is to keep nothing of them."""
        output = self.settings.advice
        if output is not None:
            advice = b"" if view is None else json.dumps({name: view[name] for name in output.fields}).encode()
            self._publish(output.topic.fill(person=person), advice)
        answered = person in self._senders and self._senders[person].answered
        if view is None and self.settings.answers is not None and answered:
            self._waiting[next(self._keys)] = (self.settings.answers.fill(person=person), b"", True)
            self._wake.set()

    def _instructed(self, robot: int, errand: dict[str, Any]) -> None:
        """Publish a robot's instruction whenever it has changed."""
        output = self.settings.robot
        assert output is not None
        self._publish(
            output.topic.fill(robot=str(robot)), json.dumps({name: errand[name] for name in output.fields}).encode()
        )
