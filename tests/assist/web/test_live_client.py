"""The Python client behind a reverse proxy that sometimes does not reach the service."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest

from assist.connect.bridges.session_client import SessionClient
from assist.declare.refusals import Refusal
from assist.web.client import Client

PAGE = b"<html><h1>Bad Gateway</h1></html>"
BROKEN = 0
"""In place of a status: the connection breaks within the answer."""


STREAM = b'event: ping\ndata: {"seconds": 15}\n\nevent: view\ndata: {"seq": %d}\n\n'


class Answering(BaseHTTPRequestHandler):
    """Answers with each of the server's answers in turn, then with 200 and the service's JSON.

    A small number is that of the view in a stream, which may then be silent.
    """

    server: Any

    def do_POST(self) -> None:
        self.server.ids.append(json.loads(self.rfile.read(int(self.headers["Content-Length"])))["id"])
        code = self.server.answers.pop(0) if self.server.answers else 200
        if code == BROKEN:
            self.wfile.write(b'HTTP/1.1 200 OK\r\nContent-Length: 100\r\n\r\n{"steps"')
            return
        self.send_response(code)
        self.end_headers()
        self.wfile.write(b'{"steps": 1}' if code == 200 else PAGE)

    def do_GET(self) -> None:
        answer = self.server.answers.pop(0)
        self.send_response(answer if answer > 100 else 200)
        self.end_headers()
        self.wfile.write(PAGE if answer > 100 else STREAM % answer)
        self.wfile.flush()
        if answer < 100 and self.server.silent:
            self.server.goes_on.wait(60)  # a half-open connection

    def log_message(self, *_: object) -> None:
        """Print nothing."""


@contextmanager
def proxy(*answers: int, silent: bool = False) -> Iterator[Any]:
    server: Any = ThreadingHTTPServer(("127.0.0.1", 0), Answering)
    with server:
        server.answers, server.silent, server.goes_on = list(answers), silent, threading.Event()
        server.ids, server.link = [], f"http://127.0.0.1:{server.server_port}/join/ann#token"
        threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
        yield server
        server.goes_on.set()
        server.shutdown()


def test_a_report_is_sent_until_the_proxy_reaches_the_service() -> None:
    with proxy(502, 504, BROKEN) as server:
        assert Client(server.link, pause=0.01).observe("ann", "(fetch box-a)") == {"steps": 1}
    assert len(server.ids) == 4
    assert len(set(server.ids)) == 1


def test_a_refusal_without_json_is_one_sentence() -> None:
    with proxy(404) as server, pytest.raises(Refusal, match="404 Not Found"):
        Client(server.link).observe("ann", "(fetch box-a)")


@pytest.mark.parametrize(("status", "is_restored"), [(502, True), (503, True), (403, False)])
def test_a_watcher_waits_for_a_service_that_a_proxy_does_not_reach(status: int, is_restored: bool) -> None:
    with proxy(status, status, 1, 2) as server:
        watched = Client(server.link, pause=0.01).watch()
        if is_restored:
            assert [next(watched), next(watched)] == [{"seq": 1}, {"seq": 2}]  # also after a stream that ends
        else:
            with pytest.raises(Refusal, match="403") as refused:
                next(watched)
            assert refused.value.status == 403


def test_a_silent_stream_is_opened_again_by_programs_and_bridges() -> None:
    with proxy(1, 2, silent=True) as server:
        watched = Client(server.link, pause=0.01, silence=0.1).watch()
        assert [next(watched), next(watched)] == [{"seq": 1}, {"seq": 2}]

    async def followed(link: str) -> list[Any]:
        session = SessionClient(link, pause=0.01, silence=0.1)
        found = []
        async for change in session.changes():
            found.append(change)
            if len(found) == 2:
                break
        await session.close()
        return found

    with proxy(502, 1, 2, silent=True) as server:
        assert asyncio.run(followed(server.link)) == [("view", {"seq": 1}), ("view", {"seq": 2})]
