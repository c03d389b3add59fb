"""Connections that bring no request, or half of one: whoever opens thousands of them keeps nobody else out."""

from __future__ import annotations

import resource
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import httpx2 as httpx
import pytest
from networks import running
from serving import served
from starlette.responses import PlainTextResponse, StreamingResponse
from starlette.types import Receive, Scope, Send
from userstudies import PLAN, written

from assist.web import connections
from assist.web.server import listen

FILES = 512
HALVES = (
    b"", b"P", b"POST /api/study/seats HTTP/1.1\r\nHost: x\r\nX-A: ",
    b"POST /api/study/seats HTTP/1.1\r\nHost: x\r\nContent-Length: 9\r\n\r\n{",
)  # fmt: skip


def few_files() -> None:
    resource.setrlimit(resource.RLIMIT_NOFILE, (FILES, FILES))


@pytest.mark.slow
def test_connections_that_bring_nothing_keep_no_participant_out_and_fill_no_log(tmp_path: Path) -> None:
    """More than the process may open files: silent ones, half a head, half a body, and what is no HTTP."""
    file = written(tmp_path / "study.toml", PLAN)
    options: Any = {"instance": None, "preexec_fn": few_files}
    with ExitStack() as held, served("--study", file, "--data", tmp_path / "data", **options) as study:
        host, _, port = study.url.removeprefix("http://").partition(":")
        seat = study.ask("POST", "/api/study/seats", "everybody", json={"id": "early"}).json()
        headers = {"Authorization": f"Bearer {study.token()}"}
        path = f"{study.url}/api/people/{seat['person']}/events"
        with httpx.stream("GET", path, headers=headers, timeout=60) as stream:
            lines = stream.iter_lines()
            assert next(line for line in lines if '"consent"' in line)
            for number in range(2 * FILES):
                one = held.enter_context(socket.create_connection((host, int(port)), 20))
                one.sendall(HALVES[number % len(HALVES)])
            for number in range(30):
                with socket.create_connection((host, int(port)), 20) as other:
                    other.sendall(b"\x16\x03\x01 no request\r\n\r\n")
                late = study.ask("POST", "/api/study/seats", "everybody", json={"id": f"late {number}"})
                assert late.status_code == 200, late.text
            study.ask("POST", f"/api/study/participants/{seat['person']}/onward", json={"stage": "consent"})
            for line in lines:  # the participant's stream was never closed
                if line.startswith("data") and '"instructions"' in line:
                    break
        code, said = study.end()
    assert (code, said.count("\n")) == (0, 2), said[:2000]  # what it does, and where it is saved


async def answers(scope: Scope, receive: Receive, send: Send) -> None:
    if scope["type"] == "lifespan":
        for kind in ("startup", "shutdown"):
            await receive()
            await send({"type": f"lifespan.{kind}.complete"})
    elif scope["path"] == "/stream":

        async def parts() -> Any:
            yield "a"
            while (await receive())["type"] != "http.disconnect":
                pass

        await StreamingResponse(parts())(scope, receive, send)
    else:
        await PlainTextResponse("here")(scope, receive, send)


@contextmanager
def service(monkeypatch: pytest.MonkeyPatch, silent: float, most: int) -> Iterator[int]:
    monkeypatch.setattr(connections, "SILENT", silent)
    monkeypatch.setattr(connections, "most", lambda: most)
    listening = listen("127.0.0.1", 0)
    with running(answers, listening):
        yield int(listening.getsockname()[1])


def connected(port: int, sent: bytes = b"") -> socket.socket:
    made = socket.create_connection(("127.0.0.1", port), 20)
    made.sendall(sent)
    return made


def is_closed(one: socket.socket) -> bool:
    """Read until the other end closes; whether it does so in time."""
    one.settimeout(20)
    try:
        while one.recv(4096):
            pass
    except ConnectionResetError:
        return True
    except TimeoutError:
        return False
    return True


GET = b"GET / HTTP/1.1\r\nHost: x\r\n\r\n"


def test_a_head_that_does_not_arrive_is_given_up_also_the_second_one(monkeypatch: pytest.MonkeyPatch) -> None:
    with service(monkeypatch, 0.3, 99) as port:
        with connected(port) as silent, connected(port, GET[:9]) as slow, connected(port, GET + GET[:9]) as second:
            for one in (silent, slow, second):
                assert is_closed(one)
        with connected(port, GET.replace(b"/", b"/stream", 1)) as stream, connected(port, GET) as idle:
            time.sleep(1)
            for one in (stream, idle):
                assert one.recv(4096).startswith(b"HTTP/1.1 200")
            idle.sendall(GET)  # on a connection that was kept
            assert idle.recv(4096).startswith(b"HTTP/1.1 200")


def test_the_connection_that_waits_for_longest_makes_room_and_no_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    with service(monkeypatch, 60, 4) as port, ExitStack() as held:
        streams = [held.enter_context(connected(port, GET.replace(b"/", b"/stream", 1))) for _ in range(2)]
        for one in streams:
            while not one.recv(4096).endswith(b"a\r\n"):
                pass
        slow = held.enter_context(connected(port, b"POST / HTTP/1.1\r\nHost: x\r\n"))
        time.sleep(0.3)
        idle = held.enter_context(connected(port, GET))
        assert idle.recv(4096).startswith(b"HTTP/1.1 200")
        held.enter_context(connected(port, GET))
        assert is_closed(slow)
        held.enter_context(connected(port, GET))
        assert is_closed(idle)
        for one in streams:
            one.setblocking(False)
            with pytest.raises(BlockingIOError):
                one.recv(4096)
