"""Streams of an application in this process, whose events a test takes one by one."""

from __future__ import annotations

import asyncio
import json
import queue
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any
from urllib.parse import unquote

from starlette.testclient import TestClient

PATIENCE = 60  # seconds after which an event is taken as missing


class EndedError(Exception):
    """The stream has ended."""


class Stream:
    """A stream that is open: the status and the headers of its answer, and its events."""

    def __init__(self) -> None:
        self.status, self.headers = 0, dict[str, str]()
        self._came: queue.Queue[dict[str, Any]] = queue.Queue()
        self._rest = ""
        self._body = b""

    def begin(self) -> None:
        start = self._came.get(timeout=PATIENCE)
        self.status = start["status"]
        self.headers = {name.decode(): value.decode() for name, value in start["headers"]}

    @property
    def detail(self) -> str:
        """The reason of a refusal."""
        return str(json.loads(self._came.get(timeout=PATIENCE)["body"])["detail"])

    def any(self) -> tuple[str, Any]:
        """Return the next event, also a sign of life."""
        while "\n\n" not in self._rest:
            message = self._came.get(timeout=PATIENCE)
            if not message.get("more_body"):
                raise EndedError
            self._rest += message["body"].decode()
        first, self._rest = self._rest.split("\n\n", 1)
        kind, data = first.split("\n")
        return kind.removeprefix("event: "), json.loads(data.removeprefix("data: "))

    def next(self) -> tuple[str, Any]:
        """Return the next event."""
        while (found := self.any())[0] == "ping":
            pass
        return found

    def rest(self) -> list[tuple[str, Any]]:
        """Return all events until the stream ends."""
        found = list[tuple[str, Any]]()
        with suppress(EndedError):
            while True:
                found.append(self.any())
        return found

    def view(self) -> Any:
        """Return the next view of a person, of the team or of a study."""
        while (found := self.next())[0] not in ("view", "team", "study"):
            pass
        return found[1]


@contextmanager
def opened(client: TestClient, path: str, headers: Mapping[str, str]) -> Iterator[Stream]:
    """Open a stream with the client's cookies; it is closed as by a client that goes."""
    stream, gone = Stream(), asyncio.Event()
    sent = [(b"host", b"testserver"), *((name.lower().encode(), value.encode()) for name, value in headers.items())]
    if kept := "; ".join(f"{one.name}={one.value}" for one in client.cookies.jar):
        sent.append((b"cookie", kept.encode()))
    asked = [{"type": "http.request", "body": b"", "more_body": False}]

    async def receive() -> dict[str, Any]:
        if asked:
            return asked.pop()
        await gone.wait()
        return {"type": "http.disconnect"}

    async def send(message: Any) -> None:
        stream._came.put(message)

    scope = {
        "type": "http", "method": "GET", "scheme": "http", "http_version": "1.1", "path": unquote(path),
        "raw_path": path.encode(), "query_string": b"", "root_path": "", "headers": sent, "client": ("testclient", 1),
        "server": ("testserver", 80), "state": dict(client.app_state),
    }  # fmt: skip
    assert client.portal is not None
    running = client.portal.start_task_soon(client.app, scope, receive, send)  # type: ignore[arg-type]
    try:
        stream.begin()
        yield stream
    finally:
        client.portal.call(gone.set)
        running.result(PATIENCE)


def watching(web: Any, person: str) -> Any:
    """Open the stream of a person of a service, which has a `client` and the `access` tokens."""
    headers = {"Authorization": f"Bearer {web.access.token(person)}"}
    return opened(web.client, f"/api/people/{person}/events", headers)
