"""Actions over OPC UA: each once, although the server is killed and forgets everything."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import click
import pytest
from beside import Here, acted, plans
from conftest import TESTS, kit
from networks import free_port

from assist.cli.options.bridges import bridge_of
from assist.live import Left
from assist.person.settings import Setting

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
event = "began"
answer = "ns=2;s=B.Answer"
[[advice]]
node = "ns=2;s=A.Light"
person = "person-1"
[names]
TAKE = "fetch"
4711 = "box-b"
"""


@pytest.fixture(scope="module")
def servers() -> Iterator[subprocess.Popen[str]]:
    """A process that starts servers."""
    command = [sys.executable, TESTS / "opcua_server.py"]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        yield process
        process.kill()


class Plant:
    """A server in a process of its own, which forgets everything when it is killed."""

    def __init__(self, servers: subprocess.Popen[str], *known: str) -> None:
        self.servers, self.port, self.known = servers, free_port(), known
        self.start()

    def start(self) -> None:
        stdin, stdout = self.servers.stdin, self.servers.stdout
        assert stdin is not None
        assert stdout is not None
        print(self.port, *self.known, file=stdin, flush=True)
        self.process = int(stdout.readline())

    def kill(self) -> None:
        os.kill(self.process, signal.SIGKILL)

    def client(self) -> Any:
        return asyncua.Client(f"opc.tcp://127.0.0.1:{self.port}/")


@pytest.fixture
def plant(servers: subprocess.Popen[str]) -> Iterator[Plant]:
    made = Plant(servers)
    yield made
    made.kill()


class Station:
    """A station that shows a value until it is answered."""

    def __init__(self, plant: Plant, name: str) -> None:
        self.plant, self.name = plant, name

    async def show(self, value: str, identifier: str | None = None, *, at: str = "Pick") -> dict[str, Any]:
        """Show a value, again whenever the server has forgotten it; return the answer."""
        pick, answer, given_up = f"ns=2;s={self.name}.{at}", f"ns=2;s={self.name}.Answer", time.monotonic() + 60
        before = None  # what was answered before this value, also if the connection is lost after it was answered
        while time.monotonic() < given_up:
            with suppress(OSError, ua.UaError):
                async with self.plant.client() as client:
                    if before is None:
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
    (walk,) = plans(kit("tiny"), 1, 6, seed=1).values()
    here = Here(tmp_path / "opcua", ["person-1", "person-2"])
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
    reports = [acted("person-1", action) for action in walk]
    reports += [acted("person-2", "(fetch box-b)"), ("people/person-2/begin", {})]
    here.is_as_over_http(reports, {"person-1": walk, "person-2": ["(fetch box-b)"]})


def test_a_server_may_ask_for_a_password_and_a_node_that_it_does_not_have_is_named(
    servers: subprocess.Popen[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A server that is asked for a node has let the bridge in; the service works without the node."""
    plant, here = Plant(servers, "plc", "secret"), Here(tmp_path / "opcua", ["person-1"])
    text = SETTINGS.replace('PORT/"', f"{plant.port}/\"\nusername = 'plc'").replace("A.Pick", "A.Picks")
    (file := tmp_path / "bridge.toml").write_text(text)
    with pytest.raises(click.UsageError, match=r"server\.username: has no password; expected it in KITASSIST_OPCUA"):
        bridge_of(file)
    monkeypatch.setenv("KITASSIST_OPCUA_PASSWORD", "secret")

    async def work() -> None:
        while "node ns=2;s=A.Picks: " not in caplog.text:
            await asyncio.sleep(0.05)

    try:
        here.run(file, work)
    finally:
        plant.kill()
    assert "Traceback" not in caplog.text


OWN = """
[own_server]
url = "opc.tcp://127.0.0.1:PORT/"
action = "{action}"
id = "{id}"
username = "plc"
"""


class Poller:
    """A system that only polls: it reads and writes nodes of the assistant's server."""

    def __init__(self, client: Any) -> None:
        self.client = client

    def node(self, path: str) -> Any:
        return self.client.get_node(f"ns=2;s={path}")

    async def read(self, path: str) -> Any:
        return await self.node(path).read_value()

    async def until(self, path: str, wanted: Callable[[Any], bool]) -> Any:
        """Poll a node until it has the wanted value; one that is not there yet has none."""
        while True:
            with suppress(ua.UaError):
                if wanted(value := await self.read(path)):
                    return value
            await asyncio.sleep(0.02)

    async def report(self, person: str, action: str, identifier: str) -> dict[str, Any]:
        """Write a report twice, as a system does that writes in each cycle, and poll for its answer."""
        text = json.dumps({"action": action, "id": identifier})
        for _ in range(2):
            await self.node(f"People/{person}/Action").write_value(text)
        return await self.answer(person, identifier)

    async def answer(self, person: str, identifier: str) -> dict[str, Any]:
        found = await self.until(
            f"People/{person}/Answer", lambda text: json.loads(text or "{}").get("id") == identifier
        )
        return dict(json.loads(found))


async def connected(port: int, **options: Any) -> Any:
    """Return a client, as soon as the server listens."""
    while True:
        client = asyncua.Client(f"opc.tcp://127.0.0.1:{port}/", timeout=30)
        for name, value in options.items():
            getattr(client, f"set_{name}")(value)
        with suppress(OSError):
            await client.connect()
            return client
        await asyncio.sleep(0.05)


def test_systems_that_poll_have_a_server_with_a_password_once_its_address_is_free(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """They report by values and calls."""
    monkeypatch.setenv("KITASSIST_OPCUA_PASSWORD", "secret")
    (walk,) = plans(kit("tiny"), 1, 6, seed=1).values()
    here = Here(tmp_path / "opcua", ["ann", "bob"], Setting(c_suggest=0.01, c_move=0.01))
    port = free_port()
    (file := tmp_path / "bridge.toml").write_text(OWN.replace("PORT", str(port)))
    suggested = list[str]()

    async def work() -> None:
        with socket.create_server(("127.0.0.1", port)):
            while f"no connection to opc.tcp://127.0.0.1:{port}" not in caplog.text:
                await asyncio.sleep(0.05)
            assert not here.bridge.connected
        client = await connected(port, user="plc", password="secret")
        for options in ({}, {"user": "plc", "password": "secrets"}):
            with pytest.raises(ua.UaError):
                await connected(port, **options)
        poll = Poller(client)
        try:
            for number, action in enumerate(walk):
                await poll.until("People/ann/Suggestion", lambda _: True)
                answer = await poll.report("ann", action, f"pick-{number}")
                assert (answer["status"], answer["seq"]) == ("recorded", await poll.read("People/ann/Seq"))
                suggested.append(await poll.read("People/ann/Suggestion"))
                assert suggested[-1] == (json.loads(here.service.views["ann"])["suggestion"] or "")
            again = json.dumps({"action": walk[0], "id": "pick-0"})  # much later
            await poll.node("People/ann/Action").write_value(again)
            assert (await poll.answer("ann", "pick-0"))["status"] == "recorded"
            assert await poll.read("People/ann/Seq") == answer["seq"]

            bob, method = poll.node("People/bob"), poll.node("People/bob/Report").nodeid
            call = partial(bob.call_method, method)
            unseen = ua.Variant(0, ua.VariantType.Int64)
            status, detail, _ = await call('{"action": "(fetch box-z)"}', "", unseen)
            assert (status, "box-z" in detail) == ("refused", True)
            status, _, seq = await call('{"action": "(fetch box-b)"}', "call-1", unseen)
            assert (status, seq) == ("recorded", await poll.read("People/bob/Seq"))
            assert (await call('{"action": "(fetch box-b)"}', "call-1", unseen))[2] == seq
            for wrong, code in (
                (("x",), "BadArgumentsMissing"), (("x", "2", unseen, "4"), "BadTooManyArguments"),
                (("x", 7, unseen), "BadInvalidArgument"),
            ):  # fmt: skip
                with pytest.raises(ua.UaError, match=code):
                    await call(*wrong)
            for number, why in ((-2, "seq -2: expected"), (10**18, f"seq {10**18}: there is no such view yet")):
                status, detail, _ = await call(
                    '{"action": "(fetch box-a)"}', "", ua.Variant(number, ua.VariantType.Int64)
                )
                assert (status, why in detail) == ("refused", True), detail
            await poll.node("People/bob/Begin").write_value("next-1")
            assert (await poll.answer("bob", "next-1"))["status"] == "recorded"

            await poll.node("Robots/1/Arrived").write_value("bob")
            while (errand := here.session.outlook().robots[0]).location != "bob":
                await asyncio.sleep(0.02)
            await poll.until("Robots/1/Person", lambda person: person == (errand.person or ""))
            await poll.node("Robots/1/Arrived").write_value("")  # at its base
            while here.session.outlook().robots[0].location is not None:
                await asyncio.sleep(0.02)
            for path in ("People/ann/Suggestion", "People/ann/Answer", "Robots/1/Person"):
                with pytest.raises(ua.UaError, match="BadUserAccessDenied"):
                    await poll.node(path).write_value("mine")
            with pytest.raises(ua.UaError):
                await client.nodes.objects.add_object(2, "mine")
            await here.service.report(Left(person="bob"))
            while True:
                try:
                    await poll.read("People/bob/Suggestion")
                except ua.UaError:
                    break
                await asyncio.sleep(0.02)
        finally:
            await client.disconnect()

    here.run(file, work)
    assert "Traceback" not in caplog.text
    assert any(suggested)
    reports = [acted("ann", action) for action in walk]
    reports += [acted("bob", "(fetch box-b)", seq=0), ("people/bob/begin", {})]
    reports += [("robots/1/arrived", {"person": "bob"}), ("people/bob/leave", {})]
    here.is_as_over_http(reports, {"ann": walk, "bob": ["(fetch box-b)"]})
    counted = {"values": 10, "calls": 8, "messages": 13, "recorded": 10, "refused": 3}
    assert counted.items() <= here.bridge.counts.items()
