"""A client of the running service for event loops: requests over open connections, and a stream of changes."""

from __future__ import annotations

import asyncio
import hashlib
import json
from collections.abc import AsyncIterator
from typing import Any
from urllib.parse import urlsplit

import httpx2

from ...declare.refusals import Refusal
from ...live.event_base import Event
from ...web.client import AGAIN, Client, EventReader, request_of

PATIENCE = 60.0
"""Seconds after which an unanswered request is sent again. It must exceed the time of a slow decision."""

MOST = 8
"""Requests at a time. More share a write to the disk, but the client looks at every connection at each request."""


class SessionClient:
    """A connection to the service with the operator's rights; requests are repeated until they are answered.

    Parameters
    ----------
    link : str
        The operator's link.
    pause : float
        Seconds before a request or connection is tried again. Fewer add load, more add delay.
    silence : float
        Seconds without a sign of life after which the stream counts as lost. The service sends one every 15 s.

    Attributes
    ----------
    session : str
        A short text that identifies the session; the links cannot be told from it.
    """

    def __init__(self, link: str, *, pause: float = 0.5, silence: float = 40.0) -> None:
        token = urlsplit(link).fragment
        self.session = hashlib.sha256(token.encode()).hexdigest()[:16]
        self._pause, self._silence = pause, httpx2.Timeout(silence, pool=None)
        # A request waits without limit for one of the connections; one more has the stream.
        self._http = httpx2.AsyncClient(
            base_url=Client(link).url, headers={"Authorization": f"Bearer {token}"},
            timeout=httpx2.Timeout(PATIENCE, pool=None), trust_env=False,
            limits=httpx2.Limits(max_connections=MOST + 1, max_keepalive_connections=MOST + 1),
        )  # fmt: skip

    async def ask(self, method: str, path: str, body: Any = None) -> Any:
        """Send a request until it is answered, and return the answer.

        Raises
        ------
        Refusal
            The service refused the request.
        """
        while True:
            try:
                answer = await self._http.request(method, path, json=body)
                content = answer.json()
                if answer.is_success:
                    return content
                if answer.status_code not in AGAIN:
                    raise Refusal.answered(answer.status_code, str(content["detail"]))
            except (httpx2.TransportError, KeyError, TypeError, json.JSONDecodeError):
                pass  # no answer, or one of a proxy
            await asyncio.sleep(self._pause)

    async def send(self, event: Event) -> Any:
        """Report an event; return the view of the person, or of the robot.

        Raises
        ------
        Refusal
            The service refused it.
        """
        return await self.ask(*request_of(event))

    async def changes(self) -> AsyncIterator[tuple[str, dict[str, Any]]]:
        """Yield what changes in the team, as `Client.changes` does. A lost connection is restored.

        Raises
        ------
        Refusal
            The service does not accept the link.
        """
        while True:
            try:
                async with self._http.stream("GET", "/api/team/changes", timeout=self._silence) as answer:
                    if answer.is_success:
                        reader = EventReader()
                        async for line in answer.aiter_lines():
                            if (found := reader.take(line)) is not None:
                                yield found
                    elif answer.status_code not in AGAIN:
                        content = json.loads(await answer.aread())
                        raise Refusal.answered(answer.status_code, str(content["detail"]))
            except (httpx2.TransportError, KeyError, TypeError, json.JSONDecodeError):
                pass  # the stream was cut, or the answer is one of a proxy
            await asyncio.sleep(self._pause)

    async def close(self) -> None:
        """Close all connections."""
        await self._http.aclose()
