"""Is each action recorded once and in order while messages are repeated and reordered, and the broker is killed?

    python bench/endurance.py [--through mqtt|opcua|opcua-own]... [--people 50] [--minutes 10] [--kills 5] [--record F]

People act at their own pace, and follow most suggestions. Their stations report each action, and a proxy between them
and the broker repeats some reports and delays each by another time. The broker (of MQTT) or server (of OPC UA) is
killed and started again at equal intervals, and has forgotten everything then. (The server of the assistant's own is
killed with its service.) Afterwards, the log must have each
action of each person once and in order, and the same events are posted over HTTP to a second service: all beliefs and
suggestions have to be equal to the last bit.

Over MQTT, stations do not wait for answers before the next report. Over OPC UA they do, and the proxy shows earlier
values again. A report that is not answered for 15 seconds is shown again, too.
"""

from __future__ import annotations

import asyncio
import json
import logging
import multiprocessing
import os
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Protocol

import aiomqtt
import asyncua
import click
import iotcore
import numpy as np
from asyncua import ua
from live_load import PAPER, Service
from tables import Columns, cell, record_option, write_record

from assist.web.client import Client
from planner import CostToGo, cost_to_go, load

MQTT = """
wait = 600.0
[broker]
host = "127.0.0.1"
port = PORT
[[observe]]
topic = "line/{person}/action"
number = "{n}"
[[observe]]
topic = "line/{person}/begin"
number = "{n}"
event = "began"
[answers]
topic = "line/{person}/answers"
[advice]
topic = "line/{person}/advice"
"""

OBSERVED = """
[[observe]]
node = "ns=2;s=NAME.WHAT"
person = "NAME"
action = "{action}"
id = "{id}"
answer = "ns=2;s=NAME.Answer"
"""
ADVISED = """
[[advice]]
node = "ns=2;s=NAME.Advice"
person = "NAME"
"""
NODES = "action", "begin", "Answer", "Advice"


def pause(rng: np.random.Generator, every: float) -> float:
    """Return the seconds until a person acts again."""
    return every * float(rng.gamma(4.0, 0.25))


class Person:
    """A person who acts, and the reports of their actions."""

    def __init__(self, name: str, table: CostToGo, rng: np.random.Generator) -> None:
        self.name, self.table, self.rng = name, table, rng
        self.state, self.suggestion = table.space.initial, None
        self.reports: list[dict[str, Any]] = []
        self.answers: dict[int, dict[str, Any]] = {}

    def act(self) -> dict[str, Any]:
        """Return the report of the next action, or that the task begins again after its end."""
        number, space = len(self.reports) + 1, self.table.space
        report = {"id": f"{self.name}-{number}", "n": number}
        if space.goal[self.state]:
            self.state = space.initial
        else:
            options = space.options(self.state)
            follows = self.suggestion in options and self.rng.random() < 0.7
            action = self.suggestion if follows else str(self.rng.choice(list(options)))
            self.state, report["action"] = options[action], action
        self.reports.append(report)
        return report

    def answered(self, answer: dict[str, Any]) -> None:
        """Take in an answer, which repetitions of a report do not change."""
        assert answer["status"] == "recorded", answer
        first = self.answers.setdefault(int(answer["id"].rpartition("-")[2]), answer)
        assert first["seq"] == answer["seq"], (first, answer)

    def open(self) -> list[dict[str, Any]]:
        """Return the reports without an answer."""
        return [report for report in self.reports if report["n"] not in self.answers]


def kind(report: dict[str, Any]) -> str:
    """Return what a report is about."""
    return "action" if "action" in report else "begin"


class Line(Protocol):
    """Stations, and the broker or server between them and the bridge.

    Attributes
    ----------
    counts : Counter
        Numbers of reports `sent` by stations, and of those that the proxy `repeated` and `reordered`.
    """

    counts: Counter[str]

    def settings(self) -> str:
        """Return the settings of the bridge."""

    def start(self) -> None:
        """Start the broker or server."""

    def kill(self) -> None:
        """Kill it."""

    async def run(self, until: float, every: float) -> None:
        """Let the people act until then, and return when all reports are answered."""


class MqttLine:
    """A line with a broker."""

    def __init__(self, people: list[Person], port: int, rng: np.random.Generator) -> None:
        self.people, self.port, self.rng = people, port, rng
        self.counts, self._last = Counter[str](), Counter[str]()
        self._broker = iotcore.Broker(port=port, listen="127.0.0.1")
        self._station: aiomqtt.Client | None = None
        self._ways = set[asyncio.Task[None]]()

    def settings(self) -> str:
        return MQTT.replace("PORT", str(self.port))

    def start(self) -> None:
        self._broker.start()

    def kill(self) -> None:
        process, self._broker._process = self._broker._process, None
        process.kill()
        process.wait()
        process.stdin.close()

    async def run(self, until: float, every: float) -> None:
        clients = [asyncio.create_task(self._connected(one)) for one in (self._stations, self._proxy)]
        await asyncio.gather(*(self._work(person, until, every) for person in self.people))
        for task in (*clients, *self._ways):
            task.cancel()
        await asyncio.gather(*clients, *self._ways, return_exceptions=True)

    async def _work(self, person: Person, until: float, every: float, ahead: int = 5, again: float = 3.0) -> None:
        sent = dict[int, float]()
        due = time.monotonic() + pause(person.rng, every)
        while time.monotonic() < until or person.open():
            now = time.monotonic()
            if due < now < until and len(person.open()) < ahead:
                person.act()
                due = now + pause(person.rng, every)
            for report in person.open():
                if sent.get(report["n"], 0.0) < now - again and self._station is not None:
                    sent[report["n"]] = now
                    self.counts["sent"] += 1
                    with suppress(aiomqtt.MqttError):
                        topic = f"proxy/{person.name}/{kind(report)}"
                        await self._station.publish(topic, json.dumps(report), qos=1)
            await asyncio.sleep(0.1)

    async def _connected(self, work: Callable[[aiomqtt.Client], Any]) -> None:
        while True:
            with suppress(aiomqtt.MqttError, OSError):
                async with aiomqtt.Client("127.0.0.1", self.port) as client:
                    client.pending_calls_threshold = 10 * len(self.people)
                    await work(client)
            await asyncio.sleep(0.2)

    async def _stations(self, client: aiomqtt.Client) -> None:
        known = {person.name: person for person in self.people}
        for what in ("answers", "advice"):
            await client.subscribe(f"line/+/{what}", qos=1)
        self._station = client
        try:
            async for message in client.messages:
                _, name, what = str(message.topic).split("/")
                content = json.loads(message.payload)
                if what == "answers":
                    known[name].answered(content)
                else:
                    known[name].suggestion = content["suggestion"]
        finally:
            self._station = None

    async def _proxy(self, client: aiomqtt.Client) -> None:
        await client.subscribe("proxy/#", qos=1)
        async for message in client.messages:
            copies = 1 + int(self.rng.random() < 0.3)
            self.counts["repeated"] += copies - 1
            for _ in range(copies):
                task = asyncio.create_task(self._pass_on(client, str(message.topic), message.payload))
                self._ways.add(task)
                task.add_done_callback(self._ways.discard)

    async def _pass_on(self, client: aiomqtt.Client, topic: str, payload: bytes) -> None:
        await asyncio.sleep(self.rng.exponential(2.0))
        _, name, what = topic.split("/")
        number = json.loads(payload)["n"]
        self.counts["reordered"] += number < self._last[name]
        self._last[name] = max(number, self._last[name])
        with suppress(aiomqtt.MqttError):
            await client.publish(f"line/{name}/{what}", payload, qos=1)


def serve_nodes(port: int, names: list[str], ready: Any) -> None:
    """Run an OPC UA server with the nodes of stations."""

    async def serve() -> None:
        server = asyncua.Server()
        await server.init()
        server.set_endpoint(f"opc.tcp://127.0.0.1:{port}/")
        server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        space = await server.register_namespace("line")
        for name in names:
            folder = await server.nodes.objects.add_object(space, name)
            for what in NODES:
                node = await folder.add_variable(ua.NodeId(f"{name}.{what}", space), what, "")
                await node.set_writable()
        async with server:
            ready.set()
            await asyncio.sleep(1e6)

    asyncio.run(serve())


class OpcUaLine:
    """A line with an OPC UA server."""

    def __init__(self, people: list[Person], port: int, rng: np.random.Generator) -> None:
        self.people, self.port, self.rng, self.counts = people, port, rng, Counter[str]()
        self._client: asyncua.Client | None = None

    def settings(self) -> str:
        text = f'[server]\nurl = "opc.tcp://127.0.0.1:{self.port}/"\n'
        for person in self.people:
            for what in ("action", "begin"):
                text += OBSERVED.replace("NAME", person.name).replace("WHAT", what) + 'event = "began"\n' * (
                    what == "begin"
                )
        return text + "".join(ADVISED.replace("NAME", person.name) for person in self.people)

    def start(self) -> None:
        spawning = multiprocessing.get_context("spawn")
        ready = spawning.Event()
        self._process = spawning.Process(
            target=serve_nodes, args=(self.port, [one.name for one in self.people], ready), daemon=True
        )
        self._process.start()
        assert ready.wait(120)

    def kill(self) -> None:
        self._process.kill()
        self._process.join()

    @staticmethod
    def node(name: str, what: str) -> str:
        return f"ns=2;s={name}.{what}"

    @staticmethod
    def text(report: dict[str, Any]) -> str:
        return json.dumps(report)

    async def run(self, until: float, every: float) -> None:
        client = asyncio.create_task(self._connected())
        await asyncio.gather(*(self._work(person, until, every) for person in self.people))
        client.cancel()
        await asyncio.gather(client, return_exceptions=True)

    async def _connected(self) -> None:
        known = {self.node(person.name, what): (person, what) for person in self.people for what in NODES[2:]}

        class Seen:
            def datachange_notification(self, node: Any, value: str, _: Any) -> None:
                person, what = known[node.nodeid.to_string()]
                if what == "Advice":
                    person.suggestion = value or None
                elif value:
                    person.answered(json.loads(value))

            def status_change_notification(self, status: Any) -> None:
                pass

        while True:
            lost = asyncio.Event()

            async def over(_: Exception, lost: asyncio.Event = lost) -> None:
                lost.set()

            with suppress(OSError, ua.UaError):
                client = asyncua.Client(f"opc.tcp://127.0.0.1:{self.port}/")
                client.connection_lost_callback = over
                async with client:
                    subscription = await client.create_subscription(50, Seen())
                    # Each answer is seen, also if another one follows within the interval.
                    await subscription.subscribe_data_change([client.get_node(node) for node in known], queuesize=100)
                    self._client = client
                    await lost.wait()
            self._client = None
            await asyncio.sleep(0.2)

    async def _work(
        self, person: Person, until: float, every: float, again: float = 1.0, patience: float = 15.0
    ) -> None:
        before = None
        while time.monotonic() < until:
            await asyncio.sleep(pause(person.rng, every))
            report, last, began = person.act(), -again, time.monotonic()
            while person.open():
                if time.monotonic() > last + again:
                    last = time.monotonic()
                    if last > began + patience:  # the answer may have been lost with the server that had it
                        began = last
                        await self._clear(person, report)
                    await self._show(person, report, before)
                await asyncio.sleep(0.05)
            before = report

    async def _clear(self, person: Person, report: dict[str, Any]) -> None:
        """Empty the node of a report, so that the same report is a change of its value again."""
        with suppress(OSError, ua.UaError):
            if self._client is not None:
                await self._client.get_node(self.node(person.name, kind(report))).write_value("")

    async def _show(self, person: Person, report: dict[str, Any], before: dict[str, Any] | None) -> None:
        """Write a report to its node, unless it is there; the proxy may write the one before once more."""
        with suppress(OSError, ua.UaError):
            if (client := self._client) is None:
                return
            node = client.get_node(self.node(person.name, kind(report)))
            text = self.text(report)
            if await node.read_value() == text:
                return
            self.counts["sent"] += 1
            drawn = self.rng.random()
            again = drawn < 0.3 and before is not None
            if again and drawn < 0.15:  # the same value later, in the wrong order
                await node.write_value(text)
            if again:
                old = client.get_node(self.node(person.name, kind(before)))
                await old.write_value("")
                await old.write_value(self.text(before))
                self.counts["repeated" if drawn >= 0.15 else "reordered"] += 1
            if not again or drawn >= 0.15:
                await node.write_value(text)


class OwnServerLine(OpcUaLine):
    """Stations that read and write the OPC UA server of the assistant, which is killed with its service."""

    service: Service | None = None  # once it runs

    def settings(self) -> str:
        return f'[own_server]\nurl = "opc.tcp://127.0.0.1:{self.port}/"\naction = "{{action}}"\nid = "{{id}}"\n'

    def start(self) -> None:
        if self.service is not None:
            self.service.start()

    def kill(self) -> None:
        if self.service is not None:
            self.service.process.kill()
            self.service.process.wait()

    @staticmethod
    def node(name: str, what: str) -> str:
        return f"ns=2;s=People/{name}/{'Suggestion' if what == 'Advice' else what.capitalize()}"

    @staticmethod
    def text(report: dict[str, Any]) -> str:
        return json.dumps(report) if "action" in report else str(report["id"])


logging.getLogger("asyncua").setLevel(logging.CRITICAL)  # it reports each lost connection several times

LINES: dict[str, Callable[..., Line]] = {"mqtt": MqttLine, "opcua": OpcUaLine, "opcua-own": OwnServerLine}


@contextmanager
def serving(instance: Path, people: int, *options: str) -> Iterator[Client]:
    """Run a service that makes no decisions by the clock: all then follows from the events."""
    with tempfile.TemporaryDirectory() as folder:
        service = Service(instance, people, Path(folder) / "data", "--set", "tick=3600", *options)
        try:
            yield Client(service.start()["operator"], patience=120.0)
        finally:
            service.process.send_signal(signal.SIGTERM)
            service.process.communicate()


def seen(client: Client) -> tuple[list[dict[str, Any]], list[Any]]:
    """Return the log, and what is believed and suggested."""
    team = client.team()["people"]
    return client.log(), [[one["belief"], one["suggestion"]] for one in team]


def compare(instance: Path, people: list[Person], client: Client) -> dict[str, Any]:
    """Compare what is recorded with what people did, and the beliefs with those of the same events over HTTP."""
    log, beliefs = seen(client)
    done = {person.name: [row["action"] for row in log if row["person"] == person.name] for person in people}
    meant = {person.name: [one["action"] for one in person.reports if "action" in one] for person in people}
    lost = sum((Counter(meant[name]) - Counter(done[name])).total() for name in meant)
    doubled = sum((Counter(done[name]) - Counter(meant[name])).total() for name in meant)
    events = sorted(
        (person.answers[report["n"]]["seq"], person.name, report) for person in people for report in person.reports
    )
    assert len({seq for seq, *_ in events}) == len(events)
    with serving(instance, len(people)) as other:
        for _, name, report in events:
            body = {what: report[what] for what in ("id", "action") if what in report}
            other.ask("POST", f"/api/people/{name}/{'actions' if 'action' in body else 'begin'}", body)
        log_there, beliefs_there = seen(other)
    logs = [[(row["person"], row["action"]) for row in one] for one in (log, log_there)]
    return {
        "actions": sum(map(len, meant.values())), "lost": lost, "doubled": doubled,
        "disordered": sum(done[name] != meant[name] for name in meant),
        "differ": sum(mine != theirs for mine, theirs in zip(beliefs, beliefs_there, strict=True)),
        "logs": logs[0] == logs[1],
    }  # fmt: skip


def endure(through: str, instance: Path, count: int, minutes: float, kills: int, every: float) -> dict[str, Any]:
    """Let people work over a protocol, and return the measurements."""
    rng, table = np.random.default_rng(0), cost_to_go(load(instance))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "bridge.toml"
        file.touch()
        service = Service(instance, count, Path(folder) / "data", "--set", "tick=3600", "--bridge", str(file))
        port = service.port + 1 if service.port < 65535 else service.port - 1
        people = [Person(f"person-{number}", table, np.random.default_rng(number)) for number in range(1, count + 1)]
        line = LINES[through](people, port, rng)
        file.write_text(line.settings())
        line.start()
        client = Client(service.start()["operator"], patience=120.0)
        if isinstance(line, OwnServerLine):
            line.service = service

        async def work() -> None:
            until = time.monotonic() + 60 * minutes
            working = asyncio.create_task(line.run(until, every))
            for kill in range(kills):
                moment = until - 60 * minutes * (kills - kill) / (kills + 1)
                await asyncio.wait([working], timeout=max(0.0, moment - time.monotonic()))
                assert not working.done(), working.exception()
                line.kill()
                await asyncio.sleep(rng.uniform(0.5, 3.0))
                await asyncio.to_thread(line.start)
            await working

        try:
            asyncio.run(work())
            load_then = os.getloadavg()[0]
            found = compare(instance, people, client)
        finally:
            service.process.send_signal(signal.SIGTERM)
            service.process.wait()
            line.kill()
    return {
        "through": through, "people": count, "minutes": minutes, "kills": kills, "load": load_then,
        **line.counts, **found,
    }  # fmt: skip


NAMES = {"mqtt": "MQTT", "opcua": "OPC UA", "opcua-own": "OPC UA, own server"}
COLUMNS: Columns = {
    "through": lambda row: NAMES[row["through"]],
    "people": cell("people"),
    "minutes": cell("minutes", "g"),
    "kills": cell("kills"),
    "actions": cell("actions", ","),
    "reports sent": cell("sent", ","),
    "repeated by the proxy": lambda row: f"{row.get('repeated', 0):,}",
    "reordered": lambda row: f"{row.get('reordered', 0):,}",
    "actions lost, doubled": lambda row: f"{row['lost']}, {row['doubled']}",
    "people with actions out of order": cell("disordered"),
    "people with other beliefs than over HTTP": cell("differ"),
}


@click.command()
@click.option("--through", type=click.Choice(list(LINES)), default=tuple(LINES), show_default=True, multiple=True)
@click.option("--people", default=50, show_default=True)
@click.option("--minutes", default=10.0, show_default=True)
@click.option("--kills", default=5, show_default=True, help="Kills of the broker or server.")
@click.option("--every", default=5.0, show_default=True, help="Mean seconds between two actions of a person.")
@click.option("--instance", type=Path, default=PAPER)
@record_option
def main(
    through: tuple[str, ...], people: int, minutes: float, kills: int, every: float, instance: Path,
    record: Path | None,
) -> None:  # fmt: skip
    """Run each protocol and print the measurements."""
    rows = []
    for protocol in through:
        rows.append(endure(protocol, instance, people, minutes, kills, every))
        print("; ".join(f"{name}: {show(rows[-1])}" for name, show in COLUMNS.items()), flush=True)
        assert not any(rows[-1][name] for name in ("lost", "doubled", "disordered", "differ"))
        assert rows[-1]["logs"]
    write_record(record, COLUMNS, rows)


if __name__ == "__main__":
    main()
