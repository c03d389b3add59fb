"""A running service and its clients, for tests: the command as a user starts it, with short names for requests."""

from __future__ import annotations

import json
import os
import signal
import ssl
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx2 as httpx
from conftest import KITTING, ROOT

TINY = KITTING / "tiny.pddl"
NO_TLS = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
"""Without certificates: to load all of them, as is done otherwise, takes twenty milliseconds of each request."""


@dataclass
class Served:
    """A running service: its process, its first line of output, and clients."""

    process: subprocess.Popen[str]
    url: str
    links: dict[str, str]
    operator: str

    def token(self, person: str | None = None) -> str:
        return (self.operator if person is None else self.links[person]).partition("#")[2]

    def ask(self, method: str, path: str, person: str | None = None, **more: Any) -> httpx.Response:
        headers = {"Authorization": f"Bearer {self.token(person)}"}
        return httpx.request(method, self.url + path, headers=headers, timeout=120, verify=NO_TLS, **more)

    def end(self, number: signal.Signals = signal.SIGTERM) -> tuple[int, str]:
        """Stop the service; return its exit code and its output on stderr."""
        self.process.send_signal(number)
        _, said = self.process.communicate(timeout=120)
        return self.process.returncode, said


@contextmanager
def served(*options: object, instance: Path | None = TINY, **more: Any) -> Iterator[Served]:
    command = [str(Path(sys.executable).with_name("kitassist")), "serve", *([str(instance)] if instance else [])]
    command += ["--port", "0"]
    process = subprocess.Popen(
        [*command, *map(str, options)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
        env={**os.environ, "PYTHONUNBUFFERED": "1"}, **more,
    )  # fmt: skip
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line, process.communicate()[1]
        said = json.loads(line)
        yield Served(process, said["url"], said["join"], said["operator"])
    finally:
        process.terminate()  # which leaves coverage.py the time to write what it has seen
        try:
            process.communicate(timeout=10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
