"""A fake rosbridge server for tests, which checks every message of its client against version 2 of the protocol.

Fields, their types and what may follow what are those of the specification of August 2025 (rosbridge_suite,
ROSBRIDGE_PROTOCOL.md). Types of messages are checked too: the server knows the fields of those that it offers.
"""

from __future__ import annotations

import asyncio
import json
from contextlib import suppress
from typing import Any

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed

TEXT, LIST, OBJECT = str, list, dict

REQUIRED: dict[str, dict[str, type]] = {
    "advertise": {"topic": TEXT, "type": TEXT},
    "unadvertise": {"topic": TEXT},
    "publish": {"topic": TEXT, "msg": OBJECT},
    "subscribe": {"topic": TEXT},
    "unsubscribe": {"topic": TEXT},
    "send_action_goal": {"action": TEXT, "action_type": TEXT},
    "cancel_action_goal": {"id": TEXT, "action": TEXT},
}
OPTIONAL: dict[str, dict[str, type]] = {
    "subscribe": {"type": TEXT, "throttle_rate": int, "queue_length": int, "fragment_size": int, "compression": TEXT},
    "send_action_goal": {"args": OBJECT, "feedback": bool, "fragment_size": int, "compression": TEXT},
}
TYPES: dict[str, dict[str, type]] = {
    "std_msgs/msg/String": {"data": str},
    "line_msgs/msg/Action": {"person": str, "action": str, "id": str, "seq": int},
    "line_msgs/msg/Advice": {"person": str, "suggestion": str, "finished": bool},
}
ACTIONS: dict[str, str] = dict.fromkeys(("/go_to", "/robot1/go_to", "/robot2/go_to"), "line_msgs/action/GoTo")
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6  # of action_msgs/msg/GoalStatus


class Rosbridge:
    """The server, with a robot that drives for a moment to each goal.

    Attributes
    ----------
    faults : list of str
        What was wrong in the client's messages; empty after a test.
    heard : list of dict
        All messages of the client.
    fails : int
        Number of goals that the robot will not reach.
    """

    def __init__(self, drive: float = 0.05) -> None:
        self.faults, self.heard, self.fails, self.drive = list[str](), list[dict[str, Any]](), 0, drive
        self.goals: dict[str, asyncio.Task[None]] = {}
        self.arrivals = list[Any]()
        self._socket: ServerConnection | None = None
        self._server: Server | None = None
        self._advertised: dict[str, str] = {}
        self._subscribed = set[str]()
        self._news = asyncio.Condition()

    async def start(self, port: int) -> None:
        self._server = await serve(self._converse, "127.0.0.1", port)

    async def stop(self) -> None:
        assert self._server is not None
        self._server.close()
        await self._server.wait_closed()

    async def lose(self) -> None:
        """Lose the connection, and all goals with it."""
        assert self._socket is not None
        self._socket.transport.abort()
        await self._socket.wait_closed()

    async def publish(self, topic: str, message: dict[str, Any]) -> bool:
        """Send a message to the client if it has subscribed to the topic; return whether it was sent."""
        if self._socket is None or topic not in self._subscribed:
            return False
        try:
            await self._socket.send(json.dumps({"op": "publish", "topic": topic, "msg": message}))
        except ConnectionClosed:  # between the end of a connection and the beginning of the next
            return False
        return True

    async def until(self, done: Any) -> None:
        """Wait until something is true of the messages that have arrived."""
        async with self._news:
            await self._news.wait_for(done)

    def published(self, topic: str) -> list[dict[str, Any]]:
        return [one["msg"] for one in self.heard if one["op"] == "publish" and one["topic"] == topic]

    async def _converse(self, socket: ServerConnection) -> None:
        self._socket, self._advertised, self._subscribed, self.goals = socket, {}, set(), {}
        goals = self.goals
        await socket.send(json.dumps({"op": "status", "level": "info", "msg": "welcome"}))
        with suppress(ConnectionClosed):
            async for text in socket:
                fault = self._fault(text)
                if fault is not None:
                    self.faults.append(f"{text!r}: {fault}")
                    await socket.send(json.dumps({"op": "status", "level": "error", "msg": fault}))
                    continue
                message = json.loads(text)
                self.heard.append(message)
                self._obey(message)
                async with self._news:
                    self._news.notify_all()
        if self._socket is socket:
            self._socket = None
        for goal in goals.values():
            goal.cancel()

    def _fault(self, text: str | bytes) -> str | None:
        """Return what is wrong in a message; None if nothing is."""
        if isinstance(text, bytes):
            return "binary"
        message = json.loads(text)
        op = message.get("op")
        if op not in REQUIRED:
            return "unknown operation"
        known: dict[str, type] = REQUIRED[op] | OPTIONAL.get(op, {}) | {"op": TEXT, "id": TEXT}
        for name, value in message.items():
            if name not in known or type(value) is not known[name]:
                return f"field {name}"
        if missing := set(REQUIRED[op]) - set(message):
            return f"missing {missing}"
        match op:
            case "advertise" | "subscribe":
                if message.get("type", "std_msgs/msg/String") not in TYPES:
                    return "unknown type"
            case "publish":
                if message["topic"] not in self._advertised:
                    return "topic is not advertised"
                fields = TYPES[self._advertised[message["topic"]]]
                if {name: type(value) for name, value in message["msg"].items()} != fields:
                    return "not of the topic's type"
            case "send_action_goal":
                if ACTIONS.get(message["action"]) != message["action_type"]:
                    return "unknown action"
                if message.get("id") in self.goals:
                    return "the id is in use"
            case "cancel_action_goal":
                if message["id"] not in self.goals:
                    return "no such goal in progress"
        return None

    def _obey(self, message: dict[str, Any]) -> None:
        match message["op"]:
            case "advertise":
                self._advertised[message["topic"]] = message["type"]
            case "subscribe":
                self._subscribed.add(message["topic"])
            case "send_action_goal":
                self.goals[message["id"]] = asyncio.create_task(self._drive(message))
            case "cancel_action_goal":
                self.goals.pop(message["id"]).cancel()

    async def _drive(self, goal: dict[str, Any]) -> None:
        await asyncio.sleep(self.drive)
        self.goals.pop(goal["id"])
        failed = self.fails > 0
        self.fails -= failed
        if not failed:
            self.arrivals.append(goal["args"])
        result = {"op": "action_result", "id": goal["id"], "action": goal["action"], "values": {}, "result": True}
        async with self._news:
            self._news.notify_all()
        assert self._socket is not None
        await self._socket.send(json.dumps(result | {"status": ABORTED if failed else SUCCEEDED}))
