"""What connected clients have not been sent yet.

A watcher keeps the latest event of each person only, so that a client that reads slowly costs no memory and others do
not wait. It can reconnect at any time and receives the current view.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress


def streamed(kind: str, data: bytes) -> bytes:
    """Return an event of a stream, whose data is JSON in one line."""
    return b"event: %s\ndata: %s\n\n" % (kind.encode(), data)


class Watcher:
    """What a connected client has not been sent yet: the latest event for each key, in the order of the changes."""

    def __init__(self) -> None:
        self._events: dict[str, bytes] = {}
        self._changed, self._over = asyncio.Event(), asyncio.Event()

    def tell(self, key: str, event: bytes = b"") -> None:
        """Note an event, in place of an earlier one for this key that has not been sent."""
        self._events.pop(key, None)
        self._events[key] = event
        self._changed.set()

    def end(self) -> None:
        """End the stream of events."""
        self._over.set()
        self._changed.set()

    async def take(self) -> list[bytes]:
        """Wait for events, and return them; return none if the stream has ended."""
        await self._changed.wait()
        if self._over.is_set():
            return []
        self._changed.clear()
        found, self._events = list(self._events.values()), {}
        return found

    async def rest(self, seconds: float) -> None:
        """Wait for some seconds, or until the stream ends."""
        with suppress(TimeoutError):
            await asyncio.wait_for(self._over.wait(), seconds)
