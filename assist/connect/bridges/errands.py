"""Drives of robots: each robot is sent to where it is to go, and its arrival is reported.

While a robot is to go to a person, there is a drive. If it fails, or the connection is lost, there is another one. If
the robot is to go elsewhere, the drive is cancelled.
"""

from __future__ import annotations

import asyncio
import logging
import uuid
from collections.abc import Awaitable, Callable, Coroutine, Iterable
from dataclasses import dataclass
from typing import Any

from ...declare.refusals import Refusal
from .transport import Drove, Output, Transport

LOG = logging.getLogger(__name__)


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
    drive : str or None
        Id of the drive in progress.
    """

    robot: int
    instruction: dict[str, Any] | None = None
    to: str | None = None
    drive: str | None = None

    def take(self, instruction: dict[str, Any] | None) -> None:
        """Take in an instruction, unless there is a newer one: answers and the stream come by different ways."""
        if instruction is not None and (self.instruction is None or instruction["seq"] >= self.instruction["seq"]):
            self.instruction = instruction


class Errands:
    """The drives of the robots of a bridge.

    Parameters
    ----------
    transport : Transport
    put : callable
        Sends what begins and cancels drives.
    arrived : callable
        Reports that a robot is at a person; returns its next instruction, or None if that is refused.
    start : callable
        Runs a coroutine at the same time as others.
    retry : float
        Seconds after which a robot is sent again, if it did not arrive.
    """

    def __init__(
        self, transport: Transport, put: Callable[[Iterable[Output]], None],
        arrived: Callable[[int, str | None, str | None], Awaitable[dict[str, Any] | None]],
        start: Callable[[Coroutine[Any, Any, None]], object], retry: float,
    ) -> None:  # fmt: skip
        self._transport, self._put, self._arrived, self._start = transport, put, arrived, start
        self._retry, self._connected = retry, False
        self._ways = [_Way(number) for number in range(1, transport.robots + 1)]

    def connected(self) -> None:
        """Send all robots to where they are to go."""
        self._connected = True
        for way in self._ways:
            self._go(way)

    def lost(self) -> None:
        """Forget all drives: what becomes of them cannot be heard any more."""
        self._connected = False
        for way in self._ways:
            way.to = way.drive = None

    def instructed(self, robot: int, errand: dict[str, Any]) -> None:
        """Send a robot to where it is to go now."""
        self._ways[robot - 1].take(errand)
        self._go(self._ways[robot - 1])

    def _go(self, way: _Way) -> None:
        """Send a robot to where it is to go, unless it has been sent there."""
        errand = way.instruction
        if errand is None or not self._connected:
            return
        to = None if errand["arrived"] else errand["person"]
        if to == way.to:
            return
        if way.drive is not None:
            self._put(self._transport.drive(way.robot, None, way.drive))
        way.to, way.drive = to, None
        if to is None:
            return
        drive = uuid.uuid4().hex
        try:
            self._put(list(self._transport.drive(way.robot, to, drive)))
        except Refusal as error:
            LOG.warning("%s: robot %d is to go to %s, but %s", self._transport.name, way.robot, to, error)
            return
        way.drive = drive
        self._transport.counts["goals"] += 1

    def drove(self, message: Drove) -> None:
        """Take in that a drive has ended."""
        for way in self._ways:
            if way.drive == message.id:
                self._start(self._ended(way, message))

    async def _ended(self, way: _Way, message: Drove) -> None:
        """Report a robot's arrival, or try again."""
        person, way.drive = way.to, None
        if message.reached:
            self._transport.counts["arrivals"] += 1
            way.take(await self._arrived(way.robot, person, message.id))
        else:
            name = self._transport.name
            LOG.warning("%s: robot %d did not reach %s: %s", name, way.robot, person, message.why)
            await asyncio.sleep(self._retry)
        if way.drive is None and way.to == person:
            way.to = None
        self._go(way)
