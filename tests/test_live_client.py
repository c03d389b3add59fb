"""The Python client behind a reverse proxy that sometimes does not reach the service."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest
from websockets.sync.server import ServerConnection, serve

from assist.web.client import Client, RefusedError

PAGE = b"<html><h1>Bad Gateway</h1></html>"


class Proxy(HTTPServer):
    """Answers requests with the given status codes in turn, then with 200 and the service's JSON."""

    def __init__(self, *codes: int) -> None:
        self.codes, self.ids = list(codes), list[str]()
        super().__init__(("127.0.0.1", 0), Answering)

    @property
    def link(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/join/ann/token"


class Answering(BaseHTTPRequestHandler):
    server: Proxy

    def do_POST(self) -> None:
        self.server.ids.append(json.loads(self.rfile.read(int(self.headers["Content-Length"])))["id"])
        code = self.server.codes.pop(0) if self.server.codes else 200
        self.send_response(code)
        self.end_headers()
        self.wfile.write(b'{"steps": 1}' if code == 200 else PAGE)

    def log_message(self, *_: object) -> None:
        """Print nothing."""


@pytest.fixture
def proxy(request: pytest.FixtureRequest) -> Iterator[Proxy]:
    with Proxy(*request.param) as server:
        threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
        yield server
        server.shutdown()


@pytest.mark.parametrize("proxy", [(502, 504, 503)], indirect=True)
def test_a_report_is_sent_until_the_proxy_reaches_the_service(proxy: Proxy) -> None:
    assert Client(proxy.link, pause=0.01).act("(fetch box-a)") == {"steps": 1}
    assert len(proxy.ids) == 4
    assert len(set(proxy.ids)) == 1


@pytest.mark.parametrize("proxy", [(404,)], indirect=True)
def test_a_refusal_without_json_is_one_sentence(proxy: Proxy) -> None:
    with pytest.raises(RefusedError, match="404 Not Found"):
        Client(proxy.link).act("(fetch box-a)")


@pytest.mark.parametrize(("status", "is_restored"), [(502, True), (503, True), (403, False)])
def test_a_watcher_waits_for_a_service_that_a_proxy_does_not_reach(status: int, is_restored: bool) -> None:
    answers = [status, status, None]

    def first(connection: ServerConnection, _: object) -> object:
        found = answers.pop(0)
        return None if found is None else connection.respond(found, "no service")

    with serve(lambda connection: connection.send('{"seq": 1}'), "127.0.0.1", 0, process_request=first) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        watched = Client(f"http://127.0.0.1:{server.socket.getsockname()[1]}/join/ann#t", pause=0.01).watch()
        if is_restored:
            assert next(watched) == {"seq": 1}
        else:
            with pytest.raises(ConnectionRefusedError, match="403"):
                next(watched)
        watched.close()  # type: ignore[attr-defined]
        server.shutdown()
        thread.join()
