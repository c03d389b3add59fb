"""The views of everybody in a team and the robots' instructions, kept current for a bridge."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Coroutine
from typing import Any

from ..web.client import robot_path
from .session_client import SessionClient

LOG = logging.getLogger(__name__)


class Tasks:
    """Coroutines that run at the same time; the failure of one is logged."""

    def __init__(self) -> None:
        self._tasks: set[asyncio.Task[None]] = set()

    def start(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        """Run a coroutine at the same time as the others."""
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._ended)
        return task

    def _ended(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            LOG.error("a part of the bridge failed", exc_info=error)

    async def cancel(self) -> None:
        """Cancel all, and wait until they have ended."""
        tasks = list(self._tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


class TeamWatch:
    """Watches everybody in the team, and where robots are to go.

    Parameters
    ----------
    session : SessionClient
    seen : callable
        Called with a person and the person's view now and after every change, and with None when the person has left.
    instructed : callable or None
        Called with a robot's number, from 1, and its instruction, whenever it may have changed.
    every : float
        Seconds between two looks at who is in the team. Fewer add load, more delay the first advice to those who join.
    robots : int
        Number of robots.
    """

    def __init__(
        self,
        session: SessionClient,
        seen: Callable[[str, dict[str, Any] | None], None],
        instructed: Callable[[int, dict[str, Any]], None] | None = None,
        *,
        every: float = 5.0,
        robots: int = 1,
    ) -> None:
        self._session, self._seen, self._instructed, self._every = session, seen, instructed, every
        self._robots = robots
        self._watched: dict[str, asyncio.Task[None]] = {}
        self._tasks, self._moved = Tasks(), asyncio.Event()

    async def run(self) -> None:
        """Watch until cancelled.

        Raises
        ------
        RefusedError
            The service does not accept the link.
        """
        tasks = [asyncio.create_task(one) for one in (self._team(), self._robot())]
        try:
            await asyncio.gather(*tasks)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            await self._tasks.cancel()

    async def _team(self) -> None:
        while True:
            team = await self._session.ask("GET", "/api/team/names")
            for person in team["people"]:
                self.follow(person)
            self.moved()
            await asyncio.sleep(self._every)

    def follow(self, person: str) -> None:
        """Watch a person from now on, unless the person is watched already."""
        task = self._watched.get(person)
        if task is None or task.done():
            self._watched[person] = self._tasks.start(self._watch(person))

    async def _watch(self, person: str) -> None:
        async for view in self._session.watch(person):
            self._seen(person, view)
            self.moved()
        self._seen(person, None)

    def moved(self) -> None:
        """Ask for the robots' instructions again."""
        self._moved.set()

    async def _robot(self) -> None:
        while self._instructed is not None:
            await self._moved.wait()
            self._moved.clear()
            for number in range(1, self._robots + 1):
                self._instructed(number, await self._session.ask("GET", robot_path(number)))
