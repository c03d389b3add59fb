"""Services in a thread, and networks before them: nginx, and a wire that a test cuts or holds."""

from __future__ import annotations

import asyncio
import os
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx2 as httpx
from starlette.types import ASGIApp
from userstudies import written

from assist.studies.userstudy import StudySession, read
from assist.web.app import make_app
from assist.web.server import listen, server_of
from assist.web.tokens import AccessTokens
from assist.web.user_study.routes import router
from assist.web.user_study.service import StudyService
from planner import Table

NGINX = shutil.which("nginx", path=f"{os.environ.get('PATH', '')}:/usr/sbin")  # where Debian has it
CONFIGURATION = """
daemon off;
{user}
pid {folder}/nginx.pid;
error_log {folder}/error.log;
events {{ worker_connections 256; }}
http {{
    access_log {folder}/access.log combined;
    client_body_temp_path {folder}/body; proxy_temp_path {folder}/proxy; fastcgi_temp_path {folder}/fastcgi;
    uwsgi_temp_path {folder}/uwsgi; scgi_temp_path {folder}/scgi;
    server {{
        listen 127.0.0.1:{port} ssl;
        ssl_certificate {folder}/cert.pem;
        ssl_certificate_key {folder}/key.pem;
        location /kits/ {{
            if (-f {folder}/down) {{ return 502; }}
            proxy_pass http://{behind};
            proxy_http_version 1.1;
            proxy_set_header Host $http_host;
            proxy_set_header Connection "";
            proxy_set_header X-Forwarded-For $proxy_add_x_forwarded_for;
            {more}
        }}
    }}
}}
"""


def free_port() -> int:
    """Return a port that nothing uses."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


@contextmanager
def proxy(folder: Path, port: int, behind: str, more: str = "") -> Iterator[None]:
    """Run nginx with TLS under the path /kits/; it answers 502 while there is a file `down` in the folder."""
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2",
         "-subj", "/CN=127.0.0.1", "-addext", "subjectAltName=IP:127.0.0.1", "-keyout", folder / "key.pem",
         "-out", folder / "cert.pem"],
        check=True, capture_output=True,
    )  # fmt: skip
    user = "user root;" if os.geteuid() == 0 else ""  # so that its workers can read this folder
    (folder / "nginx.conf").write_text(
        CONFIGURATION.format(folder=folder, port=port, behind=behind.removeprefix("http://"), user=user, more=more)
    )
    process = subprocess.Popen([str(NGINX), "-p", str(folder), "-c", str(folder / "nginx.conf")])
    try:
        deadline = time.monotonic() + 20
        while True:
            try:
                socket.create_connection(("127.0.0.1", port), 1).close()
                break
            except OSError:
                assert time.monotonic() < deadline
                assert process.poll() is None
                time.sleep(0.05)
        yield
    finally:
        process.terminate()
        process.wait(20)


@contextmanager
def running(app: ASGIApp, listening: socket.socket) -> Iterator[None]:
    """Serve an application in a thread."""
    ready = threading.Event()
    server = server_of(app, ready.set)
    thread = threading.Thread(target=lambda: asyncio.run(server.serve([listening])))
    thread.start()
    try:
        assert ready.wait(60)
        yield
    finally:
        server.should_exit = True
        thread.join(30)


@contextmanager
def conducted(table: Table, folder: Path, plan: str) -> Iterator[StudyService]:
    """Serve a user study in a thread; all its tasks have the same table."""
    listening = listen("127.0.0.1", 0)
    base = f"http://127.0.0.1:{listening.getsockname()[1]}"
    study = read(written(folder / "study.toml", plan))
    session = StudySession(study, {name: table for name, _ in study.tasks} | {"practice": table}, folder / "data")
    service = StudyService(session, AccessTokens.kept(folder / "data" / "secret", base), ping=0.3)
    with running(make_app(service, more=[router]), listening):
        yield service


def ask(service: StudyService, method: str, path: str, **more: Any) -> httpx.Response:
    """Ask a service that is running, as its operator."""
    headers = {"Authorization": f"Bearer {service.access.operator}"}
    answer = httpx.request(method, service.access.base + path, headers=headers, timeout=60, **more)
    assert answer.is_success, answer.text
    return answer


class Wire:
    """Connections to a service, which a test cuts, or holds: a held one stays open, and brings nothing any more."""

    def __init__(self, port: int, behind: int) -> None:
        self._port, self._behind = port, behind
        self._pairs: list[tuple[socket.socket, socket.socket]] = []
        self._held: set[socket.socket] = set()
        self._listening = socket.create_server(("127.0.0.1", port))
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                client, _ = self._listening.accept()
                server = socket.create_connection(("127.0.0.1", self._behind))
                self._pairs.append((client, server))
                for one, other in ((client, server), (server, client)):
                    threading.Thread(target=self._forward, args=(one, other), daemon=True).start()

    def _forward(self, one: socket.socket, other: socket.socket) -> None:
        with suppress(OSError):
            while data := one.recv(65536):
                if one not in self._held:
                    other.sendall(data)
            if one not in self._held:
                other.shutdown(socket.SHUT_WR)

    def hold(self) -> None:
        """Let all present connections be half-open: both ends believe in them."""
        self._held.update(end for pair in self._pairs for end in pair)

    def cut(self) -> None:
        """Close all present connections."""
        for pair in self._pairs:
            for end in pair:
                with suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self.cut()
        self._listening.close()
