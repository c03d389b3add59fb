"""A client of the running service for event loops: requests in threads, and pushed views."""

from __future__ import annotations

import asyncio
import hashlib
import json
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any
from urllib.parse import quote, urlsplit

from planner.system.errors import MissingExtraError

from ..web.client import AGAIN, Client, RefusedError

REMOVED = 4404  # close code of the service when a person leaves


class SessionClient:
    """A connection to the service with the operator's rights; requests are repeated until they are answered.

    Parameters
    ----------
    link : str
        The operator's link.
    pause : float
        Seconds before a request or connection is tried again. Fewer add load, more add delay.
    threads : int
        Requests at a time. More would only wait for the service's disk.

    Attributes
    ----------
    session : str
        A short text that identifies the session; the links cannot be told from it.
    """

    def __init__(self, link: str, *, pause: float = 0.5, threads: int = 8) -> None:
        # A short patience: threads that wait would delay the end of the process. `ask` goes on without them.
        self._client = Client(link, patience=2.0)
        parts = urlsplit(link)
        self._token = parts.fragment or parts.path.rstrip("/").rpartition("/")[2]
        self.session = hashlib.sha256(self._token.encode()).hexdigest()[:16]
        self._pause = pause
        self._threads = ThreadPoolExecutor(threads, thread_name_prefix="bridge")

    async def ask(self, method: str, path: str, body: Any = None) -> Any:
        """Send a request until it is answered, and return the answer.

        Raises
        ------
        RefusedError
            The service refused the request.
        """
        loop = asyncio.get_running_loop()
        while True:
            try:
                return await loop.run_in_executor(self._threads, partial(self._client.ask, method, path, body))
            except RefusedError as error:
                if error.status not in AGAIN:
                    raise
            except (OSError, ValueError):  # the connection was lost, perhaps within an answer
                pass
            await asyncio.sleep(self._pause)

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
        url = f"ws{self._client.url[4:]}/api/people/{quote(person, safe='')}/events"
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
        """Give up the requests that wait."""
        self._threads.shutdown(wait=False, cancel_futures=True)
