"""Actions over OPC UA: each once, although the server is killed and forgets everything."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from conftest import kit
from serving import TINY
from starlette.testclient import TestClient
from test_mqtt import Here, done_of, free_port, plans

from assist.cli import main

asyncua = pytest.importorskip("asyncua")
ua = asyncua.ua

SETTINGS = """
[server]
url = "opc.tcp://127.0.0.1:PORT/"
[[observe]]
node = "ns=2;s=A.Pick"
person = "person-1"
action = "{action}"
id = "{id}"
answer = "ns=2;s=A.Answer"
[[observe]]
node = "ns=2;s=B.Pick"
person = "person-2"
pattern = '(?P<verb>TAKE) (?P<code>\\d+)'
action = "({verb} {code})"
answer = "ns=2;s=B.Answer"
[[observe]]
node = "ns=2;s=B.Next"
person = "person-2"
begins = true
answer = "ns=2;s=B.Answer"
[[advice]]
node = "ns=2;s=A.Light"
person = "person-1"
[names]
TAKE = "fetch"
4711 = "box-b"
"""


class Plant:
    """A server in a process of its own, which forgets everything when it is killed."""

    def __init__(self) -> None:
        self.port = free_port()
        self.start()

    def start(self) -> None:
        file = Path(__file__).with_name("opcua_server.py")
        self.process = subprocess.Popen(
            [sys.executable, file, str(self.port)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "ready\n"

    def kill(self) -> None:
        self.process.kill()
        self.process.communicate()

    def client(self) -> Any:
        return asyncua.Client(f"opc.tcp://127.0.0.1:{self.port}/")


@pytest.fixture
def plant() -> Iterator[Plant]:
    made = Plant()
    yield made
    made.kill()


class Station:
    """A station that shows a value until it is answered."""

    def __init__(self, plant: Plant, name: str) -> None:
        self.plant, self.name = plant, name

    async def show(self, value: str, identifier: str | None = None, *, at: str = "Pick") -> dict[str, Any]:
        """Show a value, again whenever the server has forgotten it; return the answer."""
        pick, answer, given_up = f"ns=2;s={self.name}.{at}", f"ns=2;s={self.name}.Answer", time.monotonic() + 60
        while time.monotonic() < given_up:
            with suppress(OSError, ua.UaError):
                async with self.plant.client() as client:
                    before = await client.get_node(answer).read_value()
                    while time.monotonic() < given_up:
                        if await client.get_node(pick).read_value() != value:
                            await client.get_node(pick).write_value(value)
                        text = await client.get_node(answer).read_value()
                        answered = json.loads(text or "{}")
                        if answered and (answered["id"] == identifier if identifier else text != before):
                            return answered
                        await asyncio.sleep(0.02)
            await asyncio.sleep(0.05)
        raise TimeoutError(f"no answer to {value}")


def test_each_action_happens_once_although_the_server_is_killed(plant: Plant, tmp_path: Path) -> None:
    """The beliefs equal those of the same events over HTTP, bit for bit."""
    (walk,) = plans(kit("tiny"), 1, 6, seed=1).values()
    people = ["person-1", "person-2"]
    here, there = Here(tmp_path / "opcua", people), Here(tmp_path / "http", people)
    (file := tmp_path / "bridge.toml").write_text(SETTINGS.replace("PORT", str(plant.port)))
    lights = list[str]()

    async def work() -> None:
        station = Station(plant, "A")
        for number, action in enumerate(walk):
            identifier = f"pick-{number}"
            answer = await station.show(json.dumps({"action": action, "id": identifier}), identifier)
            assert answer["status"] == "recorded"
            if number == len(walk) // 2:
                plant.kill()
                await asyncio.sleep(0.2)
                await asyncio.to_thread(plant.start)
        view = json.loads(here.service.views["person-1"])
        async with plant.client() as client:
            while not lights or lights[-1] != (view["suggestion"] or ""):
                lights.append(await client.get_node("ns=2;s=A.Light").read_value())
                await asyncio.sleep(0.05)
        refused = await Station(plant, "B").show("TAKE 4712")
        assert (refused["status"], "4712" in refused["detail"]) == ("refused", True)
        assert (await Station(plant, "B").show("TAKE 4711"))["status"] == "recorded"
        assert (await Station(plant, "B").show("done", at="Next"))["status"] == "recorded"

    here.run(file, work)
    with TestClient(there.app, headers=there.headers) as client:
        for action in walk:
            assert client.post("/api/people/person-1/actions", json={"action": action}).status_code == 200
        body = {"action": "(fetch box-b)"}
        assert client.post("/api/people/person-2/actions", json=body).status_code == 200
        assert client.post("/api/people/person-2/begin").status_code == 200
    expected = {"person-1": walk, "person-2": ["(fetch box-b)"]}
    for one in (here, there):
        assert done_of(one.session._course.log(), expected) == expected
    assert here.session._course.beliefs() == there.session._course.beliefs()


@pytest.mark.parametrize(
    ("wrong", "right", "message"),
    [
        ("http://a", "opc.tcp://127.0.0.1:PORT/", "expected opc.tcp://host:port/path"),
        ("A.Pick", "ns=2;s=A.Pick", "observe[1].node: 'A.Pick'; expected a node id"),
        ("A.Light", "ns=2;s=A.Light", "advice[1].node: 'A.Light'; expected a node id"),
        ("'('", "'(?P<verb>TAKE) (?P<code>\\d+)'", "is no regular expression"),
        ('"(fetch {code}"', '"({verb} {code})"', "observe[2].action: (fetch {code} opens 1 and closes 0"),
    ],
)
def test_faults_of_the_settings_are_said(wrong: str, right: str, message: str, tmp_path: Path) -> None:
    assert right in SETTINGS
    (file := tmp_path / "bridge.toml").write_text(SETTINGS.replace(right, wrong, 1).replace("PORT", "4840"))
    result = CliRunner().invoke(main, ["serve", str(TINY), "--humans", "1", "--bridge", str(file)])
    assert (result.exit_code, result.stdout) == (2, "")
    assert message in result.stderr


def test_a_node_that_the_server_does_not_have_is_named(
    plant: Plant, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The service works without it."""
    here = Here(tmp_path / "opcua", ["person-1"])
    text = SETTINGS.replace("A.Pick", "A.Picks").replace("PORT", str(plant.port))
    (file := tmp_path / "bridge.toml").write_text(text)

    async def work() -> None:
        while "node ns=2;s=A.Picks: " not in caplog.text:
            await asyncio.sleep(0.05)

    here.run(file, work)
    assert "Traceback" not in caplog.text
