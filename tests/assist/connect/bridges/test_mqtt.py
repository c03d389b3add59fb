"""Actions over MQTT: each once and in order, whatever happens to messages and to the broker."""

from __future__ import annotations

import asyncio
import json
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import click
import pytest
from beside import Here, acted, done_of, plans, until
from conftest import ROOT, kit
from networks import free_port
from serving import served

from assist.cli.options.bridges import bridge_of
from assist.connect.bridges import Bridge, Mqtt, MqttSettings
from assist.live import Left
from assist.live.live_setting import LiveSetting
from assist.web.server import listen

aiomqtt = pytest.importorskip("aiomqtt")
iotcore = pytest.importorskip("iotcore")

SETTINGS = """
wait = 60.0
[broker]
host = "127.0.0.1"
port = PORT
[observe]
topic = "line/{person}/action"
number = "{n}"
[advice]
topic = "line/{person}/advice"
[answers]
topic = "line/{person}/answers"
[robot]
topic = "line/robot"
[arrived]
topic = "line/robot/arrived"
[status]
topic = "line/assistant"
"""


SECURED = """
id = 0
[router]
id = 0
max_connections = 100
max_outgoing_packet_count = 200
max_segment_size = 104857600
max_segment_count = 10
[v4.1]
name = "secured"
listen = "127.0.0.1:PORT"
next_connection_delay_ms = 1
[v4.1.tls]
certpath = "AT/cert.pem"
keypath = "AT/key.pem"
[v4.1.connections]
connection_timeout_ms = 60000
max_payload_size = 20480
max_inflight_count = 100
dynamic_filters = true
[v4.1.connections.auth]
kits = "secret"
"""
"""Settings of a broker that speaks TLS and asks for a password."""


class Broker:
    """A real broker in a process of its own, which forgets everything when it is killed."""

    def __init__(self, secured: Path | None = None) -> None:
        self.port = free_port()
        options: dict[str, Any] = {"port": self.port, "listen": "127.0.0.1"}
        if secured is not None:
            (file := secured / "broker.toml").write_text(
                SECURED.replace("PORT", str(self.port)).replace("AT", str(secured))
            )
            options = {"config_path": str(file)}
        self._broker = iotcore.Broker(**options)
        self._broker.start()

    def kill(self) -> None:
        process, self._broker._process = self._broker._process, None
        process.stdin.close()
        process.kill()
        process.wait()

    def start(self) -> None:
        self._broker.start()

    def stop(self) -> None:
        if self._broker._process is not None:
            self.kill()

    def client(self, **options: Any) -> Any:
        return aiomqtt.Client("127.0.0.1", self.port, timeout=5.0, **options)


@pytest.fixture
def broker() -> Iterator[Broker]:
    made = Broker()
    yield made
    made.stop()


def settings_file(folder: Path, broker: Broker, text: str = SETTINGS) -> Path:
    file = folder / "bridge.toml"
    file.write_text(text.replace("PORT", str(broker.port)))
    return file


class Stations:
    """Stations that repeat each report until it is answered, and a network that repeats and reorders messages."""

    def __init__(self, broker: Broker, plans: dict[str, list[str]], seed: int, again: float = 0.3) -> None:
        self.broker, self.rng, self.again = broker, random.Random(seed), again
        self.open = {
            (name, n): {"action": action, "id": f"{name}-{n}", "n": n}
            for name, plan in plans.items()
            for n, action in enumerate(plan, start=1)
        }
        self.total = len(self.open)
        self.answers: dict[str, dict[str, Any]] = {}

    async def work(self, window: int = 4) -> None:
        while self.open:
            with suppress(aiomqtt.MqttError, OSError):
                async with self.broker.client() as client:
                    await client.subscribe("line/+/answers", qos=1)
                    reading = asyncio.create_task(self._read(client))
                    try:
                        while self.open and not reading.done():
                            await self._send(client, window)
                            await asyncio.sleep(self.again)
                    finally:
                        reading.cancel()
                        await asyncio.gather(reading, return_exceptions=True)
            await asyncio.sleep(0.05)

    async def _send(self, client: Any, window: int) -> None:
        lowest = dict(sorted(self.open, reverse=True))
        messages = [key for key in self.open if key[1] < lowest[key[0]] + window]
        messages += self.rng.sample(messages, len(messages) // 2)
        self.rng.shuffle(messages)
        for name, n in messages:
            if (name, n) in self.open:
                await client.publish(f"line/{name}/action", json.dumps(self.open[name, n]), qos=1)

    async def _read(self, client: Any) -> None:
        async for message in client.messages:
            answer = json.loads(message.payload)
            first = self.answers.setdefault(answer["id"], answer)
            assert answer["status"] == "recorded", answer
            assert first["seq"] == answer["seq"]  # a repetition gets the first answer
            self.open.pop((str(message.topic).split("/")[1], answer["number"]), None)


def reports_of(stations: Stations, plans: dict[str, list[str]]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield each report in the order in which the service recorded them."""
    events = sorted((answer["seq"], identifier) for identifier, answer in stations.answers.items())
    assert len({seq for seq, _ in events}) == len(events) == stations.total
    for _, identifier in events:
        name, _, number = identifier.rpartition("-")
        yield acted(name, plans[name][int(number) - 1], id=identifier)


async def with_kills(broker: Broker, stations: Stations, kills: int) -> None:
    """Let the stations work, and kill the broker after equal parts of the reports."""
    working = asyncio.create_task(stations.work())
    for kill in range(1, kills + 1):
        while len(stations.answers) < stations.total * kill // (kills + 1):
            await asyncio.sleep(0.02)
            assert not working.done(), working
        broker.kill()
        await asyncio.sleep(0.3)
        await asyncio.to_thread(broker.start)
    await working


def test_each_action_happens_once_although_messages_and_the_broker_are_lost(broker: Broker, tmp_path: Path) -> None:
    walks = plans(kit("tiny"), 4, 6, seed=1)
    here, stations = Here(tmp_path / "mqtt", list(walks)), Stations(broker, walks, seed=2)

    async def work() -> None:
        await with_kills(broker, stations, 1)
        expected = {f"line/{name}/advice": json.loads(here.service.views[name]) for name in walks}
        async with broker.client() as client:  # advice is retained, also by a broker that was killed
            await client.subscribe("line/#", qos=1)
            found = dict[str, bytes]()
            async for message in client.messages:
                found[str(message.topic)] = message.payload
                if set(expected) <= set(found) and all(
                    json.loads(found[topic]) == {key: view[key] for key in ("person", "suggestion", "finished", "seq")}
                    for topic, view in expected.items()
                ) and found.get("line/assistant") == b"online" and "line/robot" in found:  # fmt: skip
                    return

    here.run(settings_file(tmp_path, broker), work)
    assert here.bridge.counts["connections"] == 2
    here.is_as_over_http(reports_of(stations, walks), walks)


def test_advice_of_an_earlier_session_is_removed_and_that_of_this_one_is_kept(
    broker: Broker, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO", logger="assist.connect")
    here = Here(tmp_path / "session", ["ann"])

    async def work() -> None:
        async with broker.client() as client:
            await client.subscribe("line/#", qos=1)
            found = dict[str, bytes]()
            while found.get("line/eve/advice") != b"" or found.get("line/eve/answers") != b"":
                message = await anext(client.messages)
                found[str(message.topic)] = message.payload
                assert (str(message.topic), message.payload) != ("line/ann/advice", b"")
            while json.loads(found["line/ann/advice"]).get("question", 0) is not None:
                message = await anext(client.messages)
                found[str(message.topic)] = message.payload

    async def earlier() -> None:
        async with broker.client() as client:
            for topic in ("line/eve/advice", "line/eve/answers", "line/ann/advice"):
                await client.publish(topic, b'{"session": "another", "next": 3}', qos=1, retain=True)

    asyncio.run(earlier())
    text = SETTINGS.replace('topic = "line/{person}/advice"', 'topic = "line/{person}/advice"\nfields = ["question"]')
    here.run(settings_file(tmp_path, broker, text), work)
    assert [one.message for one in caplog.records] == [f"MQTT: connected to 127.0.0.1:{broker.port}"]


@pytest.mark.slow
def test_twenty_people_and_five_kills_of_the_broker(broker: Broker, tmp_path: Path) -> None:
    """Every action happens once and in order, and the beliefs equal those of the same events over HTTP, bit for bit.

    Of twenty people with equal pasts, many are equally worth a suggestion. So another last bit of one belief would
    alter suggestions, and with them other beliefs.
    """
    walks = plans(kit("tiny"), 20, 12, seed=3)
    options = ("--humans", 20, "--set", "tick=3600", "--c-suggest", 0.1)
    # Stations that repeat everything three times a second would keep a small machine busy with repetitions.
    stations = Stations(broker, walks, seed=4, again=1.0)
    with served(*options, "--bridge", settings_file(tmp_path, broker)) as mqtt, served(*options) as http:
        asyncio.run(with_kills(broker, stations, 5))
        for path, body in reports_of(stations, walks):
            assert http.ask("POST", f"/api/{path}", json=body).status_code == 200
        for one in (mqtt, http):
            assert done_of(map(json.loads, one.ask("GET", "/api/log").text.splitlines()), walks) == walks
        here, there = (one.ask("GET", "/api/team").json()["people"] for one in (mqtt, http))
        for mine, theirs in zip(here, there, strict=True):
            assert (mine["belief"], mine["suggestion"]) == (theirs["belief"], theirs["suggestion"])
        mqtt.process.kill()

        async def will() -> None:
            async with broker.client() as client:
                await client.subscribe("line/assistant", qos=1)
                async for message in client.messages:
                    if message.payload == b"offline":
                        return

        asyncio.run(asyncio.wait_for(will(), 30))


@pytest.mark.slow
def test_the_line_without_hardware_runs_to_its_end() -> None:
    command = [sys.executable, ROOT / "docs" / "examples" / "line.py", "kitting/tiny", "--pace", "0.02"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert all(f"person-{number} has finished" in done.stdout for number in (1, 2, 3))
    assert "the robot is at person-" in done.stdout
    assert {line for line in done.stderr.splitlines() if "MQTT:" in line and ": connected to " not in line} == set()


@pytest.mark.slow
def test_ctrl_c_ends_the_line_and_all_that_it_has_started() -> None:
    command = [sys.executable, ROOT / "docs" / "examples" / "line.py", "kitting/tiny", "--pace", "0.2"]
    line = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)
    try:
        assert line.stdout is not None
        while not line.stdout.readline().startswith("person-"):
            assert line.poll() is None
        os.killpg(line.pid, signal.SIGINT)  # as a terminal does
        time.sleep(0.05)
        with suppress(ProcessLookupError):
            os.killpg(line.pid, signal.SIGINT)  # of somebody who does not wait
        said, faults = line.communicate(timeout=60)
    finally:
        line.kill()
    assert line.returncode == 0, faults
    assert said.splitlines()[-1] == "ended by Ctrl-C"
    assert "Traceback" not in faults
    assert "KeyboardInterrupt" not in faults
    with pytest.raises(ProcessLookupError):
        os.killpg(line.pid, 0)


def test_nothing_that_the_service_sends_waits_for_more() -> None:
    """A connection that collects small pieces sends the body of an answer 40 ms after its head."""
    with listen("127.0.0.1", 0) as listening, socket.create_connection(listening.getsockname()):
        accepted, _ = listening.accept()
        with accepted:
            assert accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


LINE = """
[broker]
host = "127.0.0.1"
port = PORT
[[observe]]
topic = "scan/{person}"
pattern = '(?P<scan>\\w+): (?P<verb>TAKE|PUT) (?P<code>\\d+)'
action = "({verb} {code})"
id = "{scan}"
[[observe]]
topic = "worker"
person = "{name}"
[[observe]]
topic = "next/{person}"
event = "began"
[answers]
topic = "answers/{person}"
[advice]
topic = "advice/{person}"
[arrived]
topic = "robot/{robot}/arrived"
[robot]
topic = "robot/{robot}"
fields = ["person", "location", "arrived"]
[names]
TAKE = "fetch"
4711 = "box-b"
"""


def test_texts_of_scanners_refusals_and_two_robots(
    broker: Broker, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:  # fmt: skip
    setting = LiveSetting(c_suggest=0.01, c_move=0.01, trust="paper", travel_time=1, robots=2, tick=3600.0)
    here, seen = Here(tmp_path / "session", ["ann", "bob"], setting), dict[str, Any]()

    async def work() -> None:
        async with broker.client() as client:
            for topic in ("answers/+", "advice/+", "robot/+"):
                await client.subscribe(topic, qos=1)

            async def until(done: Callable[[], bool]) -> None:
                while not done():
                    message = await anext(client.messages)
                    topic, said = str(message.topic), json.loads(message.payload or b"null")
                    seen[said["id"] if topic.startswith("answers") else topic] = said and said | {"to": topic}

            def to(number: int) -> Any:
                return seen[f"robot/{number}"]["person"]

            await until(lambda: {"advice/ann", "advice/bob", "robot/1", "robot/2"} <= set(seen))  # the bridge is there
            worker = [
                b'{"name": "ann", "action": "fetch(box-a)", "id": 6}',
                b'{"name": "ann", "action": "place(hammer, slot-2, box-a)", "id": "a2"}',
                b'{"name": "bob", "action": "fetch(box-a)", "id": 7}',
                b'{"name": "bob", "action": "place(hammer, slot-2, box-a)", "id": "b2"}',
                b'{"name": "../ann", "action": "fetch(box-a)", "id": "x/y"}', b'{"name": "bob", "id": "without"}',
                b"[]", b'{"id": ' + b"9" * 5000 + b"}", b'{"name": "bob", "id": "\\ud800"}',
                b'{"person": "' + b"x" * 9000 + b'"}',
            ]  # fmt: skip
            scans = (b"s2: TAKE 4712", b"a scratch", b"\xff")
            arrived = [(f"robot/{number}/arrived", b'{"person": "ann"}') for number in ("0", "3", "x")]
            for topic, payload in (
                *(("worker", one) for one in worker), ("scan/eve", b"s3: TAKE 4711"), *arrived,
                ("robot/1/arrived", b"?"), *(("scan/ann", one) for one in scans),
            ):  # fmt: skip
                await client.publish(topic, payload, qos=1)
            await until(lambda: {"6", "a2", "7", "b2", "without", "s2", "s3"} <= set(seen) and to(1) != to(2))
            assert not any(seen[f"robot/{number}"]["arrived"] for number in (1, 2))
            await client.publish("robot/2/arrived", json.dumps({"person": to(2), "id": "r"}), qos=1)
            await until(lambda: seen["robot/2"]["arrived"])
            assert not seen["robot/1"]["arrived"]
            assert here.session.outlook().robots[1].location == seen["robot/2"]["person"]
            await client.publish("next/ann", b'{"id": "again"}', qos=1)
            for _ in range(2):  # a repetition is answered, and changes nothing
                await client.publish("scan/ann", b"s1: TAKE 4711", qos=1)
                await until(lambda: "s1" in seen)
                answer = seen.pop("s1")
            assert (answer["status"], answer["to"]) == ("recorded", "answers/ann")
            assert json.loads(here.service.views["ann"])["steps"] == 1
            await here.service.report(Left(person="bob"))
            await until(lambda: seen["advice/bob"] is None)

    file = settings_file(tmp_path, broker, LINE)
    here.run(file, work)
    assert here.bridge.counts["connections"] == 1  # a broker ends the connection of a client that breaks its rules
    assert {seen[one]["status"] for one in ("6", "a2", "7", "b2", "again")} == {"recorded"}
    for one, why in (("s2", "4712"), ("s3", "'eve' is not in the team"), ("without", "no field 'action'; the message")):
        assert why in seen[one]["detail"]
    for number in ("0", "3", "x"):
        assert f"MQTT: arrival of a robot: robot '{number}'; expected a number from 1 to 2" in caplog.text
    for topic, wrong in (('"robot/{robot}"', '"robot"'), ("robot/{robot}/arrived", "robots/arrived")):
        file = settings_file(tmp_path, broker, LINE.replace(topic, wrong))
        bridge_of(file)  # one robot needs no number
        with pytest.raises(click.UsageError, match=rf"topic: '{wrong}'; expected {{robot}} in it".replace('"', "")):
            bridge_of(file, 2)


@pytest.mark.skipif(shutil.which("openssl") is None, reason="needs openssl for a certificate")
def test_a_broker_with_tls_and_a_password(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    command = "openssl req -x509 -newkey rsa:2048 -nodes -keyout key.pem -out cert.pem -days 2 -subj /CN=localhost"
    name = ("-addext", "subjectAltName=IP:127.0.0.1")
    subprocess.run([*command.split(), *name], cwd=tmp_path, check=True, capture_output=True)
    monkeypatch.setenv("KITASSIST_MQTT_PASSWORD", "secret")
    monkeypatch.setenv("KITASSIST_MQTT_CA", str(tmp_path / "cert.pem"))
    here, secured = Here(tmp_path / "session", ["ann"]), Broker(tmp_path)
    file = settings_file(tmp_path, secured, SETTINGS.replace("[broker]", '[broker]\ntls = true\nusername = "kits"'))

    async def work() -> None:
        options = {"username": "kits", "password": "secret", "tls_context": MqttSettings.read(file).context()}
        async with secured.client(**options) as client:
            await client.subscribe("line/ann/answers", qos=1)
            await client.publish(
                "line/ann/action", '{"action": "(fetch box-a)", "id": "1", "n": 1}', qos=1, retain=True
            )
            answer = json.loads((await anext(client.messages)).payload)
            assert (answer["status"], answer["next"]) == ("recorded", 2)

    try:
        here.run(file, work)
    finally:
        secured.stop()


@pytest.mark.parametrize("wait", ["60.0", "0.01"])
def test_a_missing_number_is_waited_for_and_passed_over(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, wait: str
) -> None:
    """Three of fifty numbers may be on their way; the operator's page says who waits for which."""
    (file := tmp_path / "bridge.toml").write_text(SETTINGS.replace("PORT", "1").replace("60.0", wait))

    async def waits() -> list[list[str]]:
        transport = Mqtt(MqttSettings.read(file))
        bridge = Bridge(transport, "http://127.0.0.1:1/operator#t")
        found = []
        for number in (4, 6, 1, 2, 3) if wait == "60.0" else (2,):
            payload = json.dumps({"action": "(fetch box-a)", "id": str(number), "n": number}).encode()
            bridge.take(transport.message("line/ann/action", payload, lambda: None))
            found.append(bridge.waits)
        while wait == "0.01" and bridge.waits:
            await asyncio.sleep(0.01)
        await bridge._tasks.cancel()
        return found

    said = asyncio.run(asyncio.wait_for(waits(), 60))
    passed = "MQTT: ann: no report with number 1 arrived where `observe` listens; later ones go ahead"
    if wait == "0.01":
        assert passed in caplog.text
        return
    words = "MQTT: ann: {} reports wait for the number {}, which has not arrived"
    assert [said[k] for k in (0, 1, 3, 4)] == [[words.format(*n)] for n in ((1, 1), (2, 1), (2, 3), (1, 5))]
    assert passed not in caplog.text


def test_numbers_go_on_after_the_service_has_started_again(broker: Broker, tmp_path: Path) -> None:
    """The broker keeps the subscriptions of the bridge, and this one sends what it keeps to new subscribers only."""
    file = settings_file(tmp_path, broker)
    for number, action in enumerate(("(fetch box-a)", "(return box-a)"), start=1):
        here = Here(tmp_path / "session", ["ann"] if number == 1 else [])

        async def work(number: int = number, action: str = action, here: Here = here) -> None:
            await until(lambda: here.bridge.connected)
            async with broker.client() as client:
                await client.subscribe("line/ann/answers", qos=1)
                report = {"action": action, "id": str(number), "n": number}
                await client.publish("line/ann/action", json.dumps(report), qos=1)
                answer: dict[str, Any] = {}
                while answer.get("id") != str(number):  # first comes the last one of before, which the broker keeps
                    answer = json.loads((await anext(client.messages)).payload)
                assert (answer["status"], answer["next"]) == ("recorded", number + 1)

        here.run(file, work)
