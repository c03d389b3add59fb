"""The views of everybody in a team and the robots' instructions, kept current for a bridge."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from ..web.client import robot_path
from .session_client import SessionClient
from .tasks import Tasks, together


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
        try:
            await together(self._team(), self._robot())
        finally:
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
