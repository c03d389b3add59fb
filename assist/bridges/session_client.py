"""A client of the running service for event loops: requests over connections that stay open, and pushed views."""

from __future__ import annotations

import asyncio
import hashlib
import json
from collections.abc import AsyncIterator
from typing import Any
from urllib.parse import quote, urlsplit

from planner.system.errors import MissingExtraError

from ..web.client import AGAIN, Client, RefusedError

REMOVED = 4404  # close code of the service when a person leaves

Connection = tuple[asyncio.StreamReader, asyncio.StreamWriter]


class SessionClient:
    """A connection to the service with the operator's rights; requests are repeated until they are answered.

    Parameters
    ----------
    link : str
        The operator's link.
    pause : float
        Seconds before a request or connection is tried again. Fewer add load, more add delay.
    patience : float
        Seconds after which an unanswered request is sent again. It must exceed the time of a slow decision.
    most : int
        Requests at a time. More would only wait for the service's disk.

    Attributes
    ----------
    session : str
        A short text that identifies the session; the links cannot be told from it.
    """

    def __init__(self, link: str, *, pause: float = 0.5, patience: float = 60.0, most: int = 64) -> None:
        self._url = Client(link).url
        parts = urlsplit(link)
        self._token = parts.fragment or parts.path.rstrip("/").rpartition("/")[2]
        self.session = hashlib.sha256(self._token.encode()).hexdigest()[:16]
        self._pause, self._patience, self._most = pause, patience, asyncio.Semaphore(most)
        self._idle: list[Connection] = []

    async def ask(self, method: str, path: str, body: Any = None) -> Any:
        """Send a request until it is answered, and return the answer.

        Raises
        ------
        RefusedError
            The service refused the request.
        """
        while True:
            reused = bool(self._idle)
            try:
                async with self._most, asyncio.timeout(self._patience):
                    status, content = await self._once(method, path, body)
                answer = json.loads(content)
                if status < 400:
                    return answer
                if status not in AGAIN:
                    raise RefusedError(status, str(answer["detail"]))
            except (OSError, EOFError, KeyError, TypeError, IndexError, json.JSONDecodeError):
                if reused:
                    continue  # the service may have closed an idle connection
            await asyncio.sleep(self._pause)

    async def _once(self, method: str, path: str, body: Any) -> tuple[int, bytes]:
        """Send a request, and return the status and the content of the answer.

        Raises
        ------
        OSError, EOFError
            The connection was lost.
        """
        at = urlsplit(self._url)
        if self._idle:
            reader, writer = self._idle.pop()
        else:
            port = at.port or (443 if at.scheme == "https" else 80)
            reader, writer = await asyncio.open_connection(at.hostname, port, ssl=at.scheme == "https" or None)
        try:
            content = b"" if body is None else json.dumps(body).encode()
            head = (
                f"{method} {at.path}{path} HTTP/1.1\r\nHost: {at.netloc}\r\nAuthorization: Bearer {self._token}\r\n"
                f"Content-Type: application/json\r\nContent-Length: {len(content)}\r\n\r\n"
            )
            writer.write(head.encode() + content)
            status, length = int((await reader.readline()).split()[1]), 0
            while (line := await reader.readline()) not in (b"\r\n", b""):
                name, _, value = line.partition(b":")
                length = int(value) if name.lower() == b"content-length" else length
            answer = await reader.readexactly(length)
        except BaseException:
            writer.close()
            raise
        self._idle.append((reader, writer))
        return status, answer

    async def watch(self, person: str) -> AsyncIterator[dict[str, Any]]:
        """Yield a person's view now and after every change, until they leave. A lost connection is restored.

        Raises
        ------
        MissingExtraError
            The extra `web` is not installed.
        """
        try:
            from websockets.asyncio.client import connect
            from websockets.exceptions import ConnectionClosed, InvalidHandshake
        except ImportError:
            raise MissingExtraError("watching needs", "websockets", "web") from None
        url = f"ws{self._url[4:]}/api/people/{quote(person, safe='')}/events"
        headers = {"Authorization": f"Bearer {self._token}"}
        while True:
            try:
                async with connect(url, additional_headers=headers, proxy=None) as socket:
                    async for message in socket:
                        yield json.loads(message)
                    if socket.close_code == REMOVED:
                        return
            except InvalidHandshake:
                return  # the person is not in the team any more
            except ConnectionClosed as error:
                if error.rcvd is not None and error.rcvd.code == REMOVED:
                    return
            except OSError:
                pass
            await asyncio.sleep(self._pause)

    def close(self) -> None:
        """Close all connections."""
        for _, writer in self._idle:
            writer.close()
        self._idle.clear()
