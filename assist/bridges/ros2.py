"""The ROS 2 bridge: actions from ROS topics to the running service, its advice to a topic, and goals that move a robot.

It speaks version 2 of the rosbridge protocol, in JSON over a WebSocket, so that the service needs no ROS. The library
roslibpy is not used: its Twisted reactor is one for the whole process, in a thread of its own, and cannot be restarted.

Topics of ROS keep nothing for those who are away. Advice is therefore repeated every few seconds. A report has an id,
under which the service records it once, and is answered on the topic `answers`: a sender that repeats it until then
loses nothing.

While the robot is to go to a person, the action `go_to` has a goal. Its success is reported as the robot's arrival. If
the goal fails, or the connection is lost, there is another one. If the robot is to go elsewhere, the goal is cancelled.
"""

from __future__ import annotations

import asyncio
import json
import logging
import uuid
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count
from random import Random
from typing import Any

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake

from ..web.client import RefusedError, robot_path
from .messages import MessageError, Report
from .ros2_settings import STRING, Observed, Output, Ros2Settings
from .session_client import SessionClient
from .tasks import Tasks, together
from .team_watch import TeamWatch

LOG = logging.getLogger(__name__)


def _succeeded(message: Mapping[str, Any]) -> bool:
    """Return whether a goal was reached; 4 is ROS's status of success, which not all servers of the protocol send."""
    return message.get("result") is True and message.get("status", 4) == 4


@dataclass
class _Way:
    """Where a robot is sent.

    Attributes
    ----------
    robot : int
        The robot's number, from 1.
    instruction : dict or None
        The service's last one.
    to : str or None
        Person to whom the robot has been sent.
    goal : str or None
        Id of the goal in progress.
    """

    robot: int
    instruction: dict[str, Any] | None = None
    to: str | None = None
    goal: str | None = None


class Ros2Bridge:
    """A bridge between a rosbridge server and a running service.

    Parameters
    ----------
    settings : Ros2Settings
    link : str
        The operator's link, as `kitassist serve` prints it.
    every : float
        Seconds after which advice is repeated for those who have joined the topic meanwhile. Fewer add load.
    again : float
        Seconds after which the robot gets another goal, if the last one failed.
    longest_pause : float
        Largest number of seconds between two attempts to reach the server. The first pause is a tenth of a second.

    Attributes
    ----------
    counts : Counter
        Numbers of `messages`, of reports `recorded` and `refused`, of `connections` to the server, of messages
        `published`, of `goals` and of `arrivals`.
    connected : bool
        Whether the bridge is connected to the server.
    waits : tuple
        Empty: no report waits for another one.
    """

    def __init__(
        self, settings: Ros2Settings, link: str, *, every: float = 5.0, again: float = 5.0, longest_pause: float = 30.0
    ) -> None:
        self.settings, self.counts = settings, Counter[str]()
        self._session = SessionClient(link)
        self._every, self._again, self._longest_pause = every, again, longest_pause
        self._observed = {one.topic: one for one in settings.observed}
        instructed = None if settings.go_to is None else self._instructed
        self._watch = TeamWatch(self._session, self._advise, instructed)
        self._tasks = Tasks()
        self._reports: dict[str, asyncio.Queue[Report]] = {}
        self._kept: dict[str | int, dict[str, Any]] = {}  # the last advice to each person, as messages
        self._waiting: dict[str | int, dict[str, Any]] = {}  # to be sent, in this order
        self._keys, self._wake = count(), asyncio.Event()
        self.connected, self.waits = False, ()
        self._ways = [_Way(number) for number in range(1, settings.robots + 1)]

    async def run(self) -> None:
        """Work until cancelled. Lost connections to the server and to the service are restored.

        Raises
        ------
        RefusedError
            The service does not accept the link.
        """
        try:
            await together(self._watch.run(), self._server(), self._repeat())
        finally:
            await self._tasks.cancel()
            await self._session.close()

    # The server.

    async def _server(self) -> None:
        """Stay connected to the server."""
        shortest, steady = 0.1, 5.0  # seconds; a connection that lasts for less counts as another failure
        pause, lost, loop, random = shortest, False, asyncio.get_running_loop(), Random()
        while True:
            began = loop.time()
            try:
                # The bridge closes a connection over which the server does not answer a ping within ten seconds.
                async with connect(self.settings.url, proxy=None, ping_interval=10, ping_timeout=10) as socket:
                    lost = False
                    self.counts["connections"] += 1
                    await self._converse(socket)
                LOG.warning("ROS 2: the connection to %s was closed", self.settings.url)
            except (OSError, InvalidHandshake, ConnectionClosed, TimeoutError) as error:
                if not lost:
                    LOG.warning("ROS 2: no connection to %s: %s", self.settings.url, error)
            lost = True
            if loop.time() > began + steady:
                pause = shortest
            await asyncio.sleep(pause * random.uniform(0.5, 1.0))
            pause = min(2 * pause, self._longest_pause)

    async def _converse(self, socket: ClientConnection) -> None:
        """Receive and send until the connection is lost."""
        settings = self.settings
        for output in (settings.advice, settings.answers):
            if output is not None:
                await socket.send(json.dumps({"op": "advertise", "topic": output.topic, "type": output.type}))
        for one in settings.observed:
            await socket.send(json.dumps({"op": "subscribe", "topic": one.topic, "type": one.type}))
        self._waiting = {**self._kept, **self._waiting}
        self.connected = True
        for way in self._ways:
            self._go(way)
        sending = asyncio.create_task(self._send(socket))
        try:
            async for text in socket:
                self._received(text)
        finally:
            self.connected = False
            for way in self._ways:
                way.to = way.goal = None
            sending.cancel()
            await asyncio.gather(sending, return_exceptions=True)
            # Results of goals cannot arrive any more. The next connection has a goal of its own.
            self._waiting = {key: one for key, one in self._waiting.items() if one["op"] == "publish"}

    async def _send(self, socket: ClientConnection) -> None:
        while True:
            while not self._waiting:
                self._wake.clear()
                await self._wake.wait()
            key = next(iter(self._waiting))
            message = self._waiting.pop(key)
            try:
                await socket.send(json.dumps(message))
            except BaseException:
                self._waiting = {key: message} | self._waiting  # unless there is a newer one
                raise
            self.counts["published"] += message["op"] == "publish"

    def _queue(self, message: dict[str, Any], key: str | int | None = None) -> None:
        """Queue a message, in place of an earlier one with this key."""
        most = 100_000  # some tens of megabytes
        if key is not None or len(self._waiting) < most:
            self._waiting[next(self._keys) if key is None else key] = message
            self._wake.set()

    def _published(self, output: Output, fields: Mapping[str, Any]) -> dict[str, Any]:
        """Return the message that publishes fields; messages of ROS have no absent values, but empty texts."""
        chosen = {name: fields.get(name) for name in output.fields}
        if output.type == STRING:
            content: dict[str, Any] = {"data": json.dumps(chosen)}
        else:
            content = {name: "" if value is None else value for name, value in chosen.items()}
        return {"op": "publish", "topic": output.topic, "msg": content}

    def _received(self, text: str | bytes) -> None:
        try:
            message = json.loads(text)
            op = message["op"]
        except (ValueError, TypeError, KeyError, RecursionError):
            LOG.warning("ROS 2: %r is no message of rosbridge", text[:40])
            return
        if op == "publish" and message.get("topic") in self._observed and isinstance(message.get("msg"), dict):
            self._reported(self._observed[message["topic"]], message["msg"])
        elif op == "action_result" and message.get("id") is not None:
            for way in self._ways:
                if message["id"] == way.goal:
                    self._tasks.start(self._ended(way, message))
        elif op == "status" and message.get("level") in ("error", "warning"):
            LOG.warning("ROS 2: the server reports: %s", str(message.get("msg"))[:300])

    # Reports.

    def _reported(self, observed: Observed, message: Mapping[str, Any]) -> None:
        """Take in a message that reports an action."""
        self.counts["messages"] += 1
        fields: Mapping[str, str] = {}
        try:
            fields = observed.fields(message)
            report = observed.source.report(dict(fields))
        except MessageError as error:
            self._answer(fields.get("person"), fields.get("id"), "refused", str(error))
            return
        queue = self._reports.get(report.person)
        if queue is None:
            queue = self._reports[report.person] = asyncio.Queue()
            self._tasks.start(self._deliver(report.person, queue))
        queue.put_nowait(report)

    async def _deliver(self, person: str, queue: asyncio.Queue[Report]) -> None:
        """Report one person's actions to the service, one after the other."""
        try:
            while not queue.empty():
                report = queue.get_nowait()
                try:
                    view = await self._session.report(report)
                except RefusedError as error:
                    self._answer(person, report.id, "refused", str(error))
                else:
                    self._answer(person, report.id, "recorded", seq=view["seq"])
        finally:
            del self._reports[person]

    def _answer(
        self, person: str | None, identifier: str | None, status: str, detail: str | None = None, seq: int = 0
    ) -> None:
        self.counts[status] += 1
        if detail is not None:
            LOG.warning("ROS 2: a report of %s: %s", person, detail)
        if self.settings.answers is not None:
            fields = {"person": person, "id": identifier, "status": status, "detail": detail, "seq": seq}
            self._queue(self._published(self.settings.answers, fields))

    # Advice.

    def _advise(self, person: str, view: Mapping[str, Any] | None) -> None:
        """Publish a person's advice after every change, until they leave."""
        if view is None or self.settings.advice is None:
            self._kept.pop(person, None)
            return
        message = self._published(self.settings.advice, view)
        if self._kept.get(person) != message:
            self._kept[person] = message
            self._queue(message, person)

    async def _repeat(self) -> None:
        """Publish all advice again from time to time."""
        while True:
            await asyncio.sleep(self._every)
            if self.connected:
                for person, message in self._kept.items():
                    self._queue(message, person)

    # Robots.

    def _instructed(self, robot: int, errand: dict[str, Any]) -> None:
        way = self._ways[robot - 1]
        way.instruction = errand
        self._go(way)

    def _go(self, way: _Way) -> None:
        """Send a robot to where it is to go, unless it has been sent there."""
        go_to, errand = self.settings.go_to, way.instruction
        if go_to is None or errand is None or not self.connected:
            return
        to = None if errand["arrived"] else errand["person"]
        if to == way.to:
            return
        action = go_to.action.replace("{robot}", str(way.robot))
        if way.goal is not None:
            self._queue({"op": "cancel_action_goal", "id": way.goal, "action": action})
        way.to, way.goal = to, None
        if to is None:
            return
        try:
            goal = go_to.goal_for(to)
        except MessageError as error:
            LOG.warning("ROS 2: the robot is to go to %s, but %s", to, error)
            return
        way.goal = uuid.uuid4().hex
        self.counts["goals"] += 1
        self._queue(
            {
                "op": "send_action_goal",
                "id": way.goal,
                "action": action,
                "action_type": go_to.type,
                "args": goal,
            }
        )

    async def _ended(self, way: _Way, message: Mapping[str, Any]) -> None:
        """Report a robot's arrival when a goal has been reached, or try again."""
        person, goal, way.goal = way.to, message["id"], None
        if _succeeded(message):
            self.counts["arrivals"] += 1
            try:
                there = {"person": person, "id": goal}
                way.instruction = await self._session.ask("POST", f"{robot_path(way.robot)}/arrived", there)
            except RefusedError as error:
                LOG.warning("ROS 2: arrival of the robot: %s", error)
        else:
            LOG.warning("ROS 2: the robot did not reach %s: %s", person, str(message.get("values"))[:200])
            await asyncio.sleep(self._again)
        if way.goal is None and way.to == person:
            way.to = None
        self._go(way)
