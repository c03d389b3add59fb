"""Connections of clients: those on which no complete request has arrived make room for others.

Whoever opens a connection needs no token. Without a limit, connections that bring nothing would take all files that
the process may open, and nobody else could connect.
"""

from __future__ import annotations

import asyncio
import resource

from uvicorn.protocols.http.h11_impl import H11Protocol

SILENT = 30.0
"""Seconds within which the head of a request has to arrive; bodies have a limit of their own."""

AT_ONCE = 32
"""Connections that are accepted in one turn of the event loop. Others are closed for them a few turns later."""

FILES = 8192
"""Files that the process may open where the system allows it: a stream for each of some thousand pages."""

OTHERS = 4 * AT_ONCE + 128
"""Files for connections that are accepted or closed at the moment, and for all else."""


def allow_files() -> None:
    """Let this process open up to `FILES` files, as far as the system allows it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < FILES:
        resource.setrlimit(
            resource.RLIMIT_NOFILE, (FILES if hard == resource.RLIM_INFINITY else min(FILES, hard), hard)
        )


def most() -> int:
    """Return how many connections the process may have, given how many files it may open."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return max(16, (FILES if soft == resource.RLIM_INFINITY else soft) - OTHERS)


def protocol(limit: int) -> type[asyncio.Protocol]:
    """Return the protocol of a server's connections, of which there are at most so many.

    A further connection closes the one on which for the longest time no request has been complete: neither has its head
    or its body arrived as a whole, nor has a further request followed. Requests that are being answered, and so
    streams, are never closed.
    """
    unfinished: dict[H11Protocol, None] = {}  # in the order in which they began to be unfinished

    class Connection(H11Protocol):
        head: asyncio.TimerHandle | None = None

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            self._note()
            if len(self.connections) > limit:
                oldest = next(iter(unfinished))
                del unfinished[oldest]  # it takes some turns until it is closed
                oldest.transport.abort()

        def data_received(self, data: bytes) -> None:
            super().data_received(data)
            self._note()

        def on_response_complete(self) -> None:
            super().on_response_complete()
            self._note(began=bool(self.conn.trailing_data[0]))

        def connection_lost(self, exc: Exception | None) -> None:
            unfinished.pop(self, None)
            self._limit(waits=False)
            super().connection_lost(exc)

        def _note(self, *, began: bool = True) -> None:
            """Note whether a request has arrived as a whole; `began`: whether a further one is to follow soon."""
            waits = self.cycle is None or self.cycle.response_complete
            if (waits or self.cycle.more_body) and not self.transport.is_closing():
                unfinished[self] = None
            else:
                unfinished.pop(self, None)
            self._limit(waits=waits and began)

        def _limit(self, *, waits: bool) -> None:
            """Close the connection after `SILENT` seconds of waiting for the head of a request."""
            if self.head is not None and not waits:
                self.head.cancel()
                self.head = None
            elif self.head is None and waits:
                self.head = self.loop.call_later(SILENT, self.transport.abort)

    return Connection
