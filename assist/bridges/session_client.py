"""A client of the running service for event loops: requests over connections that stay open, and pushed views."""

from __future__ import annotations

import asyncio
import hashlib
import json
from collections.abc import AsyncIterator
from typing import Any
from urllib.parse import quote, urlsplit

import httpx2
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus

from ..web.client import AGAIN, Client, RefusedError
from .messages import Report

REMOVED = 4404  # close code of the service when a person leaves
UNUSABLE = 422  # status of a report without an action


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
        Requests at a time. More share a write to the disk, but the client looks at every connection at each request.

    Attributes
    ----------
    session : str
        A short text that identifies the session; the links cannot be told from it.
    """

    def __init__(self, link: str, *, pause: float = 0.5, patience: float = 60.0, most: int = 8) -> None:
        self._url = Client(link).url
        parts = urlsplit(link)
        token = parts.fragment or parts.path.rstrip("/").rpartition("/")[2]
        self.session = hashlib.sha256(token.encode()).hexdigest()[:16]
        self._pause, self._headers = pause, {"Authorization": f"Bearer {token}"}
        # A request waits without limit for one of the connections.
        self._http = httpx2.AsyncClient(
            base_url=self._url, headers=self._headers, timeout=httpx2.Timeout(patience, pool=None),
            limits=httpx2.Limits(max_connections=most, max_keepalive_connections=most), trust_env=False,
        )  # fmt: skip

    async def ask(self, method: str, path: str, body: Any = None) -> Any:
        """Send a request until it is answered, and return the answer.

        Raises
        ------
        RefusedError
            The service refused the request.
        """
        while True:
            try:
                answer = await self._http.request(method, path, json=body)
                content = answer.json()
                if answer.is_success:
                    return content
                if answer.status_code not in AGAIN:
                    raise RefusedError(answer.status_code, str(content["detail"]))
            except (httpx2.TransportError, KeyError, TypeError, json.JSONDecodeError):
                pass  # no answer, or one of a proxy
            await asyncio.sleep(self._pause)

    async def report(self, report: Report) -> Any:
        """Record what a message reports; return the person's new view.

        Raises
        ------
        RefusedError
            The service refused it, or the message has no usable action.
        """
        what, body = "begin", dict[str, Any](id=report.id)
        if not report.begins:
            what, body["action"] = "actions", report.action
        if report.seq is not None:
            body["seq"] = report.seq
        if report.fault is not None:
            raise RefusedError(UNUSABLE, report.fault)
        return await self.ask("POST", f"/api/people/{quote(report.person, safe='')}/{what}", body)

    async def watch(self, person: str) -> AsyncIterator[dict[str, Any]]:
        """Yield a person's view now and after every change, until they leave. A lost connection is restored."""
        url = f"ws{self._url[4:]}/api/people/{quote(person, safe='')}/events"
        while True:
            try:
                async with connect(url, additional_headers=self._headers, proxy=None) as socket:
                    async for message in socket:
                        yield json.loads(message)
                    if socket.close_code == REMOVED:
                        return
            except InvalidStatus as error:
                if error.response.status_code < 500:
                    return  # the person is not in the team any more
            except ConnectionClosed as error:
                if error.rcvd is not None and error.rcvd.code == REMOVED:
                    return
            except (OSError, InvalidHandshake):
                pass
            await asyncio.sleep(self._pause)

    async def close(self) -> None:
        """Close all connections."""
        await self._http.aclose()
