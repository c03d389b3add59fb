"""The ROS 2 bridge: actions from ROS topics to the running service, its advice to a topic, and goals that move a robot.

It speaks version 2 of the rosbridge protocol, in JSON over a WebSocket, so that the service needs no ROS. The library
roslibpy is not used: its Twisted reactor is one for the whole process, in a thread of its own, and cannot be restarted.

Topics of ROS keep nothing for those who are away. Advice is therefore repeated every few seconds. While a robot is to
go to a person, the action `go_to` has a goal. Its success is reported as the robot's arrival.
"""

from __future__ import annotations

import json
import logging
from collections.abc import AsyncIterator, Iterable, Mapping
from contextlib import asynccontextmanager
from typing import Any

from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake

from .mqtt_settings import ADVICE
from .ros2_settings import ANSWER, STRING, Ros2Settings
from .ros2_settings import Output as RosOutput
from .transport import Answer, Drove, Message, Output, Transport

LOG = logging.getLogger(__name__)


def _succeeded(message: Mapping[str, Any]) -> bool:
    """Return whether a goal was reached; 4 is ROS's status of success, which not all servers of the protocol send."""
    return message.get("result") is True and message.get("status", 4) == 4


class Ros2(Transport):
    """A rosbridge server.

    Parameters
    ----------
    settings : Ros2Settings
    robots : int
    """

    name, reads = "ROS 2", Ros2Settings
    settings: Ros2Settings
    again = 5.0  # for those who have joined the topic meanwhile; fewer seconds add load
    lost = (OSError, InvalidHandshake, ConnectionClosed, TimeoutError)

    def __init__(self, settings: Ros2Settings, robots: int = 1) -> None:
        super().__init__()
        self.settings = settings
        self.drives = settings.go_to is not None
        self.robots = robots if self.drives else 0
        self._observed = {one.topic: one for one in settings.sources}

    def address(self) -> str:
        """Return the server's address."""
        return self.settings.rosbridge.url

    @asynccontextmanager
    async def connect(self) -> AsyncIterator[None]:
        """Connect to the server, advertise and subscribe."""
        settings = self.settings
        # A connection over which the server does not answer a ping within ten seconds is closed.
        async with connect(settings.rosbridge.url, proxy=None, ping_interval=10, ping_timeout=10) as self._socket:
            for output in (settings.advice, settings.answers):
                if output is not None:
                    await self._say(op="advertise", topic=output.topic, type=output.type)
            for one in settings.sources:
                await self._say(op="subscribe", topic=one.topic, type=one.type)
            yield

    async def _say(self, **message: Any) -> None:
        await self._socket.send(json.dumps(message))

    async def messages(self) -> AsyncIterator[Message]:
        """Yield what the server sends."""
        async for text in self._socket:
            found = self._message(text)
            if found is not None:
                yield found

    async def send(self, key: str, content: Mapping[str, Any] | None) -> None:
        """Send a message of the protocol; nothing for advice to a person who has left."""
        if content is not None:
            await self._say(**content)

    # What messages mean.

    def _message(self, text: str | bytes) -> Message | None:
        """Return what a message of the server reports; None for others."""
        try:
            message = json.loads(text)
            op = message["op"]
        except (ValueError, TypeError, KeyError, RecursionError):
            LOG.warning("ROS 2: %r is no message of rosbridge", text[:40])
            return None
        if op == "publish" and message.get("topic") in self._observed and isinstance(message.get("msg"), dict):
            observed, said = self._observed[message["topic"]], message["msg"]
            return self.reported(observed, lambda: observed.fields(said))
        if op == "action_result" and message.get("id") is not None:
            return Drove(str(message["id"]), _succeeded(message), str(message.get("values"))[:200])
        if op == "status" and message.get("level") in ("error", "warning"):
            LOG.warning("ROS 2: the server reports: %s", str(message.get("msg"))[:300])
        return None

    # What goes where.

    def advice(self, person: str, view: Mapping[str, Any] | None) -> Iterable[Output]:
        """Yield a person's advice, until they leave."""
        if self.settings.advice is not None:
            content = None if view is None else _published(self.settings.advice, view, ADVICE)
            yield Output(f"advice {person}", content, keep=True)

    def answer(self, answer: Answer) -> Iterable[Output]:
        """Yield the answer to a report."""
        if self.settings.answers is not None:
            told = {**answer.as_dict(), "person": answer.person, "seq": answer.seq or 0}
            yield Output("answers", _published(self.settings.answers, told, ANSWER))

    def instruction(self, robot: int, errand: Mapping[str, Any]) -> Iterable[Output]:
        """Yield nothing: robots are sent by goals."""
        return ()

    def drive(self, robot: int, person: str | None, id: str) -> Iterable[Output]:
        """Yield the goal that takes a robot to a person, or cancels such a goal."""
        go_to = self.settings.go_to
        assert go_to is not None
        action = go_to.action.replace("{robot}", str(robot))
        content: dict[str, Any] = {"op": "cancel_action_goal", "id": id, "action": action}
        if person is not None:
            goal = {"action_type": go_to.type, "args": go_to.goal_for(person)}
            content = {"op": "send_action_goal", "id": id, "action": action, **goal}
        yield Output(action, content, passing=True)


def _published(output: RosOutput, fields: Mapping[str, Any], usual: tuple[str, ...]) -> dict[str, Any]:
    """Return the message that publishes fields; messages of ROS have no absent values, but empty texts."""
    chosen = {name: fields.get(name) for name in output.fields or usual}
    if output.type == STRING:
        content: dict[str, Any] = {"data": json.dumps(chosen)}
    else:
        content = {name: "" if value is None else value for name, value in chosen.items()}
    return {"op": "publish", "topic": output.topic, "msg": content}
