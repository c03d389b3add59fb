"""The views of everybody in a team and the robots' instructions, kept current for a bridge."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from .session_client import SessionClient


class TeamWatch:
    """Follows everybody in the team, and where robots are to go.

    Parameters
    ----------
    session : SessionClient
    seen : callable
        Called with a person and the person's view now and after every change, and with None when the person has left.
    instructed : callable or None
        Called with a robot's number, from 1, and its instruction, now and after every change.
    """

    def __init__(
        self,
        session: SessionClient,
        seen: Callable[[str, dict[str, Any] | None], None],
        instructed: Callable[[int, dict[str, Any]], None] | None = None,
    ) -> None:
        self._session, self._seen, self._instructed = session, seen, instructed
        self._present: set[str] = set()

    async def run(self) -> None:
        """Follow until cancelled.

        Raises
        ------
        RefusedError
            The service does not accept the link.
        """
        async for kind, content in self._session.changes():
            if kind == "people":
                for person in self._present - set(content["people"]):  # they left while there was no connection
                    self._left(person)
            elif kind == "view":
                self._present.add(content["person"])
                self._seen(content["person"], content)
            elif kind == "left":
                self._left(content["person"])
            elif kind == "robot" and self._instructed is not None:
                self._instructed(content["robot"], content["instruction"])

    def _left(self, person: str) -> None:
        self._present.discard(person)
        self._seen(person, None)
