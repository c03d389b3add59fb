"""Streams of events: answers of type `text/event-stream`, which pages and programs follow.

A stream begins with the present state and goes on with every change. Its first event, repeated from time to time, is
`ping`: it says after how many seconds the next one comes. A client that hears nothing for much longer than this, or
whose stream ends, asks again. It misses nothing, since each stream begins with the present state.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from typing import Any

from fastapi import APIRouter
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from ..declare.refusals import Refusal
from .authorization import READ, Desk, Operator, Own, refusals
from .service import Service
from .watchers import Watcher, streamed

MEDIA = "text/event-stream"
DESCRIBED: dict[int | str, dict[str, Any]] = {200: {"content": {MEDIA: {"schema": {"type": "string"}}}}}
"""A stream in the description of the interface."""

router = APIRouter()


class EventStream(Response):
    """An answer that sends events until there are no more, or the client has disconnected.

    Parameters
    ----------
    events : async iterator of bytes
        Encoded events.
    every : float
        Seconds between two events `ping`. Proxies close connections that are idle for longer, usually a minute.
    left : callable
        Called when the stream has ended.
    """

    media_type = MEDIA

    def __init__(self, events: AsyncIterator[bytes], every: float, left: Callable[[], None]) -> None:
        # The second header makes nginx pass on each event at once.
        super().__init__(headers={"cache-control": "no-store, no-transform", "x-accel-buffering": "no"})
        del self.headers["content-length"]
        self._events, self._every, self._left = events, every, left

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:  # noqa: ARG002
        """Send the events."""
        sending = asyncio.create_task(self._send(send))
        reading = asyncio.create_task(_disconnected(receive))
        try:
            await asyncio.wait({sending, reading}, return_when=asyncio.FIRST_COMPLETED)
        except asyncio.CancelledError:
            pass  # the server ends and waits no longer; it would log a traceback of each connection
        finally:
            for task in (sending, reading):
                task.cancel()
            await asyncio.wait({sending, reading})
            self._left()
        if not sending.cancelled():
            sending.result()

    async def _send(self, send: Send) -> None:
        await send({"type": "http.response.start", "status": 200, "headers": self.raw_headers})
        ping = streamed("ping", json.dumps({"seconds": self._every}).encode())
        body, following = ping, asyncio.ensure_future(anext(self._events))
        try:
            while True:
                await send({"type": "http.response.body", "body": body, "more_body": True})
                await asyncio.wait({following}, timeout=self._every)
                if not following.done():
                    body = ping
                    continue
                try:
                    body = following.result()
                except StopAsyncIteration:
                    break
                following = asyncio.ensure_future(anext(self._events))
            await send({"type": "http.response.body", "body": b""})
        finally:
            following.cancel()


async def _disconnected(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass


async def _all(watcher: Watcher) -> AsyncIterator[bytes]:
    """Yield what a watcher is told."""
    while events := await watcher.take():
        yield b"".join(events)


def view_stream(service: Service, kind: str, view: Callable[[], Any]) -> EventStream:
    """Return a stream of one view of everything, for an operator's page: now, and after every change.

    Parameters
    ----------
    service : Service
    kind : str
        Name of the events.
    view : callable
        Returns an awaitable of the present view, as JSON.
    """
    watcher = service.operator()

    async def events() -> AsyncIterator[bytes]:
        while await watcher.take():
            yield streamed(kind, await view())
            await watcher.rest(service.pause_between)

    return EventStream(events(), service.ping, lambda: service.operator_leaves(watcher))


@router.get(
    "/api/people/{person}/events", tags=["people"], response_class=Response, responses=READ | refusals(429) | DESCRIBED
)
async def person_events(person: Own, service: Desk) -> Response:
    """Stream a person's view (`view`), and what keeps their actions from being saved (`faults`)."""
    if service.is_crowded(person):
        raise Refusal("crowded")
    watcher = service.watch(person)
    return EventStream(_all(watcher), service.ping, lambda: service.leave(person, watcher))


@router.get("/api/team/events", tags=["team"], response_class=Response, responses=refusals(403) | DESCRIBED)
async def team_events(_: Operator, service: Desk) -> Response:
    """Stream the operator's view (`team`)."""
    return view_stream(service, "team", service.team)


@router.get("/api/team/changes", tags=["team"], response_class=Response, responses=refusals(403) | DESCRIBED)
async def team_changes(_: Operator, service: Desk) -> Response:
    """Stream who is present (`people`), then each changed person (`view`), departure (`left`) and robot (`robot`)."""
    watcher = service.follow()
    return EventStream(_all(watcher), service.ping, lambda: service.unfollow(watcher))
