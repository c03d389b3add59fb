"""The kernel of all bridges: what happens between another protocol and the running service, whichever protocol it is.

The kernel restores lost connections of its transport, and hands reports over in order, one after the other for each
person. It answers each, and acknowledges messages when they are done with. It keeps the latest advice and instruction
of each person and robot, and sends it again after each reconnection.

A report has an id, under which the service records it once. It is answered when it is recorded or refused. A sender
that repeats a report until it is answered has each recorded exactly once, whatever happens in between.
"""

from __future__ import annotations

import asyncio
import logging
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import count
from random import Random
from typing import Any

from ...live.events import Arrived
from .errands import Errands
from .ordering import InOrder
from .session_client import SessionClient
from .tasks import Tasks, together
from .transport import Answer, Drove, Faulty, Kept, Located, Message, Output, Reported, Resumed, Transport

LOG = logging.getLogger(__name__)

ABSENT = 404  # status of a report about nobody
REMEMBERED = 1000  # numbers of a person whose ids are known, the latest
STRANGERS = 100
"""Number of senders that are remembered though their last report was about nobody in the team."""
MOST = 100_000
"""Largest number of contents that wait to be sent, besides those that are kept: some tens of megabytes."""


class _Sender:
    """The reports of one person: those that wait for their turn, and the task that hands them over one by one."""

    def __init__(self) -> None:
        self.order = InOrder[Reported]()
        self.queue = asyncio.Queue[Reported]()
        self.answered = 0  # the highest number of an answered report
        self.absent = False  # whether the last answer was that there is no such person
        self.ids = dict[int, str]()  # of the latest numbers
        self.timer: asyncio.TimerHandle | None = None
        self.task: asyncio.Task[None] | None = None


class Bridge:
    """A bridge between a transport and a running service.

    Parameters
    ----------
    transport : Transport
    link : str
        The operator's link, as `kitassist serve` prints it.
    longest_pause : float
        Largest number of seconds between two attempts to connect. The first pause is a tenth of a second; each next one
        is twice as long, with a random part, so that not all clients return at once.
    retry : float
        Seconds after which a robot is sent again, if it did not arrive.
    again : float, optional
        Seconds after which what is kept is sent again; by default those of the transport.

    Attributes
    ----------
    connected : bool
        Whether the transport is connected, and subscribed.
    """

    def __init__(
        self, transport: Transport, link: str, *, longest_pause: float = 30.0, retry: float = 5.0,
        again: float | None = None,
    ) -> None:  # fmt: skip
        self.transport, self._longest_pause = transport, longest_pause
        self.connected, self._again = False, transport.again if again is None else again
        self._session = SessionClient(link)
        transport.session = self._session.session
        self._present: set[str] = set()
        self._met, self._old = False, set[str]()  # whether it is known who is present; whom old advice is for
        self._errands: Errands | None = None
        self._senders: dict[str, _Sender] = {}
        self._tasks = Tasks()
        self._seen: dict[str, int] = {}  # `seq` of the view that was sent last of each person
        self._kept: dict[str, Any] = {}  # by key
        self._waiting: dict[str | int, Output] = {}  # to be sent, in this order
        self._under_way: dict[str | int, Output] = {}  # being sent, in this order
        self._keys, self._wake = count(), asyncio.Event()
        self._turns = defaultdict[int, asyncio.Lock](asyncio.Lock)  # of robots: they wait in the order of their coming
        if transport.drives:
            self._errands = Errands(transport, self.put, self._arrived, self._tasks.start, retry)

    @property
    def name(self) -> str:
        """The name of the transport."""
        return self.transport.name

    @property
    def counts(self) -> Counter[str]:
        """What the transport has counted."""
        return self.transport.counts

    @property
    def waits(self) -> list[str]:
        """What reports wait for that have arrived before others of their sender."""
        return [
            f"{self.name}: {person}: {len(order.held)} reports wait for the number {order.next}, which has not arrived"
            for person, order in ((person, sender.order) for person, sender in self._senders.items())
            if order.held
        ]

    async def run(self) -> None:
        """Work until cancelled. Lost connections to the other side and to the service are restored.

        Raises
        ------
        Refusal
            The service does not accept the link.
        """
        self.put(self.transport.initially())
        try:
            await together(self._follow(), self._stay_connected(), self._repeat())
        finally:
            self.connected = False
            await self._tasks.cancel()
            for sender in self._senders.values():
                if sender.timer is not None:
                    sender.timer.cancel()
            await self._session.close()

    # The connection.

    async def _stay_connected(self) -> None:
        shortest, steady = 0.1, 5.0  # seconds; a connection that lasts for less counts as another failure
        pause, lost, loop, random = shortest, False, asyncio.get_running_loop(), Random()
        transport = self.transport
        while True:
            began = loop.time()
            try:
                async with transport.connect():
                    if lost or not self.counts["connections"]:
                        again = " again" if self.counts["connections"] else ""
                        LOG.log(logging.WARNING if lost else logging.INFO, "%s: connected to %s%s", self.name,
                                transport.address(), again)  # fmt: skip
                    lost, began = False, loop.time()
                    self.counts["connections"] += 1
                    await self._converse()
            except transport.lost as error:
                why = str(error) or type(error).__name__
            finally:
                self.connected = False
            if not lost:
                LOG.warning("%s: no connection to %s: %s", self.name, transport.address(), why)
            lost = True
            if loop.time() > began + steady:
                pause = shortest
            await asyncio.sleep(pause * random.uniform(0.5, 1.0))
            pause = min(2 * pause, self._longest_pause)

    async def _converse(self) -> None:
        """Receive and send until the connection is lost."""
        for key, content in self._kept.items():
            self._waiting.setdefault(key, Output(key, content, keep=True))
        self._wake.set()
        self.connected = True
        if self._errands is not None:
            self._errands.connected()
        try:
            await together(self._receive(), *(self._publish() for _ in range(self.transport.at_once)))
        finally:
            self.connected = False
            unsent = self._under_way | self._waiting  # in their order; of one key, the newest
            self._waiting = {key: output for key, output in unsent.items() if not output.passing}
            self._under_way = {}
            if self._errands is not None:
                self._errands.lost()

    async def _publish(self) -> None:
        while True:
            while not self._waiting:
                self._wake.clear()
                await self._wake.wait()
            key = next(iter(self._waiting))
            output = self._under_way[key] = self._waiting.pop(key)
            await self.transport.send(output.key, output.content)
            if self._under_way.get(key) is output:  # and no newer one of this key
                del self._under_way[key]
            self.counts["published"] += 1

    def put(self, outputs: Iterable[Output]) -> None:
        """Queue what is to be sent."""
        for output in outputs:
            if output.keep:
                self._kept[output.key] = output.content
                self._waiting[output.key] = output
            elif len(self._waiting) < MOST:
                self._waiting[next(self._keys)] = output
            self._wake.set()

    def _put_changed(self, outputs: Iterable[Output]) -> None:
        """Queue what differs from what was sent before."""
        self.put(
            one for one in outputs if not (one.keep and one.key in self._kept and self._kept[one.key] == one.content)
        )

    async def _repeat(self) -> None:
        """Send what is kept again from time to time, if the other side keeps nothing."""
        while self._again is not None:
            await asyncio.sleep(self._again)
            if self.connected:
                for key, content in self._kept.items():
                    self._waiting.setdefault(key, Output(key, content, keep=True))
                self._wake.set()

    async def _receive(self) -> None:
        async for message in self.transport.messages():
            self.take(message)
        raise ConnectionError("the connection was closed")

    # Reports.

    def take(self, message: Message) -> None:
        """Take in what was received."""
        match message:
            case Reported():
                self.counts["messages"] += 1
                self._reported(message)
                return
            case Faulty():
                self.counts["messages"] += 1
                self._answer(Answer(message.person, message.id, "refused", message.why, origin=message.origin))
            case Located():
                self._tasks.start(self._located(message))
                return
            case Resumed():
                sender = self._senders.setdefault(message.person, _Sender())
                sender.answered = max(sender.answered, message.next - 1)
                self._hand_over(message.person, sender.order.resume(message.next))
            case Kept():
                self._old.add(message.person)
                self._remove_old()
            case Drove() if self._errands is not None:
                self._errands.drove(message)
        message.done()

    def _reported(self, message: Reported) -> None:
        report = message.report
        sender = self._senders.setdefault(report.person, _Sender())
        if report.number is None:
            self._hand_over(report.person, [message])
            return
        message.done()  # before it is recorded: a broker sends only so many messages ahead, and one of them is missing
        order, number = sender.order, report.number
        known = order.held[number].report.id if number in order.held else sender.ids.get(number, report.id)
        why = None
        if order.late(number):
            why = "later actions were recorded before it arrived"
        elif known != report.id:
            why = f"the number {number} belongs to the id {known!r}; expected one id for each"
        elif order.jumps(number):
            missing = order.missing(number)
            why = f"number {number}: the numbers {missing[0]} to {missing[-1]} did not arrive; expected {missing[0]}"
        if why is not None:
            refused = Answer(report.person, report.id, "refused", why, origin=message.origin)
            self._answer(replace(refused, number=number, next=sender.answered + 1), message)
        else:
            self._hand_over(report.person, order.take(number, message))

    def _hand_over(self, person: str, messages: list[Reported]) -> None:
        """Queue reports for the service, and see to it that those held back are not forgotten."""
        sender = self._senders[person]
        for message in messages:
            sender.queue.put_nowait(message)
            sender.absent = False  # until this one is answered
            if message.report.number is not None:
                sender.ids[message.report.number] = message.report.id
                if len(sender.ids) > REMEMBERED:
                    del sender.ids[next(iter(sender.ids))]
        if messages and (sender.task is None or sender.task.done()):
            sender.task = self._tasks.start(self._deliver(person, sender))
        if messages or not sender.order.held:
            if sender.timer is not None:
                sender.timer.cancel()
            sender.timer = None
        if sender.order.held and sender.timer is None:
            loop = asyncio.get_running_loop()
            sender.timer = loop.call_later(self.transport.wait, self._pass_over, person)

    def _pass_over(self, person: str) -> None:
        sender = self._senders[person]
        sender.timer = None
        missing = range(sender.order.next, min(sender.order.held))
        said = "%s: %s: no report with number %d arrived where `observe` listens; later ones go ahead"
        LOG.warning(said, self.name, person, missing[0])
        self._hand_over(person, sender.order.pass_over())

    async def _deliver(self, person: str, sender: _Sender) -> None:
        """Hand one person's reports over to the service, one after the other."""
        while not sender.queue.empty():
            message = sender.queue.get_nowait()
            report, refused = message.report, None
            try:
                view = await self._session.send(report.event())
            except ValueError as error:
                refused = error
                answer = Answer(person, report.id, "refused", str(error), origin=message.origin)
            else:
                self._advise(person, view)
                answer = Answer(person, report.id, "recorded", seq=view["seq"], origin=message.origin)
            if report.number is not None:
                sender.answered = max(sender.answered, report.number)
                answer = replace(answer, number=report.number, next=sender.answered + 1)
            self._answer(answer, message)
            if report.number is None:
                message.done()
            sender.absent = getattr(refused, "status", None) == ABSENT
            if sender.absent:
                self._senders[person] = self._senders.pop(person, sender)  # as the latest
                self._forget_strangers()

    def _forget_strangers(self) -> None:
        """Forget the senders of reports about nobody, but for the latest, whose numbers go on when they join."""
        strangers = [name for name, one in self._senders.items() if one.absent]
        for name in strangers[:-STRANGERS]:
            if self._senders[name].queue.empty() and not self._senders[name].order.held:
                del self._senders[name]

    def _answer(self, answer: Answer, message: Reported | None = None) -> None:
        self.counts[answer.status] += 1
        if answer.detail is not None:
            LOG.warning("%s: a report of %.80s: %s", self.name, answer.person or "nobody", answer.detail)
        if message is not None and message.answered is not None:
            message.answered(answer)
        else:
            self.put(self.transport.answer(answer))

    # Advice.

    async def _follow(self) -> None:
        """Follow everybody in the team, and where robots are to go."""
        async for kind, content in self._session.changes():
            if kind == "people":
                for person in self._present - set(content["people"]):  # they left while there was no connection
                    self._advise(person, None)
                self._present, self._met = set(content["people"]), True
                self._remove_old()
            elif kind in ("view", "left"):
                self._advise(content["person"], content if kind == "view" else None)
                (self._present.add if kind == "view" else self._present.discard)(content["person"])
            elif kind == "robot" and self.transport.robots:
                self._instruct(content["robot"], content["instruction"])

    def _advise(self, person: str, view: Mapping[str, Any] | None) -> None:
        """Send what has changed for a person, unless a newer view was sent."""
        if view is None:
            self._seen.pop(person, None)
            sender = self._senders.get(person)
            self._put_changed(self.transport.advice(person, None))
            if sender is not None and sender.answered:
                self.put(self.transport.forget(person))
        elif view["seq"] >= self._seen.get(person, 0):
            self._seen[person] = view["seq"]
            self._put_changed(self.transport.advice(person, view))

    def _remove_old(self) -> None:
        """Remove advice to people who are not present, as soon as it is known who is."""
        while self._met and self._old:
            if (person := self._old.pop()) not in self._present:
                self.put(self.transport.advice(person, None))
                self.put(self.transport.forget(person))

    # Robots.

    def _instruct(self, robot: int, errand: dict[str, Any]) -> None:
        self._put_changed(self.transport.instruction(robot, errand))
        if self._errands is not None:
            self._errands.instructed(robot, errand)

    async def _located(self, message: Located) -> None:
        await self._arrived(message.robot, message.person, message.id)
        message.done()

    async def _arrived(self, robot: int, person: str | None, id: str | None) -> dict[str, Any] | None:
        """Report where a robot is; return its next instruction, None if the report was refused.

        Reports of a robot are handed over one after the other, since the last one says where it is.
        """
        try:
            async with self._turns[robot]:
                found: dict[str, Any] = await self._session.send(Arrived(person=person, robot=robot, id=id))
        except ValueError as error:
            LOG.warning("%s: arrival of robot %d: %s", self.name, robot, error)
            return None
        return found
