"""Latency over MQTT: from a message on the broker to advice on the broker, beside HTTP with the same service.

    python bench/line.py [--people 200] [--seconds 60] [--every 5] [--instance FILE] [--record FILE]

People act first through a broker on loopback and the bridge of `kitassist serve`, then over HTTP as in
`live_load.py`. The time is from an action until the person's advice after it arrives. Each person acts at a pace of
their own: the times between two actions are drawn from a gamma distribution of shape 4, as for simulated people, with a
mean of five seconds, about that of picking one part. So 200 people report 40 actions a second, not in step.

The processor's load by other programs decides the slowest answers: a run for a record needs an idle machine.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import tempfile
import time
from pathlib import Path

import aiomqtt
import click
import iotcore
import numpy as np
from live_load import PAPER, Seen, Service, Worker, _milliseconds
from tables import Columns, cell, record_option, write_record

SETTINGS = """
[broker]
host = "127.0.0.1"
port = PORT
[[observe]]
topic = "line/{person}/action"
number = "{n}"
[[observe]]
topic = "line/{person}/begin"
event = "began"
number = "{n}"
[answers]
topic = "line/{person}/answers"
[advice]
topic = "line/{person}/advice"
fields = ["suggestion", "applicable", "finished", "seq"]
"""


def pause(rng: np.random.Generator, every: float) -> float:
    """Return the seconds until a person acts again."""
    return every * float(rng.gamma(4.0, 0.25))


class Paced(Worker):
    """A person who acts over HTTP at a pace of their own."""

    async def work(self, until: float) -> None:
        while not self.view:
            await asyncio.sleep(0.05)
        await asyncio.sleep(self.rng.uniform(0, self.every))
        while time.monotonic() < until:
            due = time.monotonic() + pause(self.rng, self.every)
            await self.act()
            await asyncio.sleep(max(0.0, due - time.monotonic()))


class Station:
    """A person's station: it reports actions and receives advice."""

    def __init__(self, client: aiomqtt.Client, name: str, every: float, seed: int) -> None:
        self.client, self.name, self.every, self.rng = client, name, every, np.random.default_rng(seed)
        self.advice: asyncio.Queue[dict] = asyncio.Queue()
        self.answers: asyncio.Queue[dict] = asyncio.Queue()
        self.latencies: list[float] = []

    async def work(self, until: float) -> None:
        view, number = await self.advice.get(), 0
        await asyncio.sleep(self.rng.uniform(0, self.every))
        while time.monotonic() < until:
            due = time.monotonic() + pause(self.rng, self.every)
            while not self.advice.empty():
                view = self.advice.get_nowait()
            number += 1
            report = {"id": f"{self.name} {number}", "n": number}
            if not view["finished"]:
                follows = view["suggestion"] is not None and self.rng.random() < 0.7
                report["action"] = view["suggestion"] if follows else str(self.rng.choice(view["applicable"]))
            begun = time.perf_counter()
            what = "begin" if view["finished"] else "action"
            await self.client.publish(f"line/{self.name}/{what}", json.dumps(report), qos=1)
            prompt(self.client)
            answer = await self.answers.get()
            assert answer["status"] == "recorded", answer
            while view["seq"] < answer["seq"]:
                view = await self.advice.get()
            self.latencies.append(time.perf_counter() - begun)
            await asyncio.sleep(max(0.0, due - time.monotonic()))


def prompt(client: aiomqtt.Client) -> None:
    """Acknowledge what has arrived at once on the level of TCP, so that no delay of this client is measured."""
    if hasattr(socket, "TCP_QUICKACK"):
        client._client.socket().setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)


async def over_mqtt(port: int, names: list[str], seconds: float, every: float) -> list[float]:
    """Return the latencies of people who act through the broker."""
    at_once = [(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)]
    async with aiomqtt.Client("127.0.0.1", port, socket_options=at_once) as client:
        client.pending_calls_threshold = len(names)
        stations = {name: Station(client, name, every, seed) for seed, name in enumerate(names)}

        async def read() -> None:
            async for message in client.messages:
                prompt(client)
                _, name, kind = str(message.topic).split("/")
                if kind in ("advice", "answers") and message.payload and not (message.retain and kind == "answers"):
                    getattr(stations[name], kind).put_nowait(json.loads(message.payload))

        for kind in ("advice", "answers"):
            await client.subscribe(f"line/+/{kind}", qos=1)
        reading = asyncio.create_task(read())
        await asyncio.gather(*(station.work(time.monotonic() + seconds) for station in stations.values()))
        reading.cancel()
        return [latency for station in stations.values() for latency in station.latencies]


async def over_http(links: dict[str, str], seconds: float, every: float) -> list[float]:
    """Return the latencies of people who act over HTTP."""
    seen = Seen()
    workers = [Paced(link, every, number, seen) for number, link in enumerate(links.values())]
    listening = [asyncio.create_task(worker.listen()) for worker in workers]
    await asyncio.gather(*(worker.work(time.monotonic() + seconds) for worker in workers))
    for task in listening:
        task.cancel()
    await asyncio.gather(*listening, return_exceptions=True)
    for worker in workers:
        await worker.hang_up()
    return seen.latencies


def processor(pid: int) -> float:
    """Return the processor time that a process has used, in seconds."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


COLUMNS: Columns = {
    "people": cell("people"),
    "through": cell("through"),
    "actions": cell("actions", ","),
    "a second": cell("rate", ".0f"),
    "load of the machine": cell("load", ".1f"),
    "processor time of the service, ms an action": cell("processor", ".1f"),
    "from action to advice: median, 95 %, slowest, ms": lambda row: " / ".join(f"{one:.0f}" for one in row["times"]),
}


@click.command()
@click.option("--people", default=200, show_default=True)
@click.option("--seconds", default=60.0, show_default=True, help="Seconds of each way.")
@click.option("--every", default=5.0, show_default=True, help="Mean seconds between two actions of a person.")
@click.option("--instance", type=Path, default=PAPER)
@record_option
def main(people: int, seconds: float, every: float, instance: Path, record: Path | None) -> None:
    """Measure both ways with one service."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "bridge.toml"
        service = Service(instance, people, Path(folder) / "data", "--bridge", str(file))
        port = service.port + 1 if service.port < 65535 else service.port - 1
        file.write_text(SETTINGS.replace("PORT", str(port)))
        with iotcore.Broker(port=port, listen="127.0.0.1"):
            links = service.start()["join"]
            pid = service.process.pid
            used = [processor(pid)]
            times = {"MQTT": asyncio.run(over_mqtt(port, list(links), seconds, every))}
            used.append(processor(pid))
            loads = [os.getloadavg()[0]]
            times["HTTP"] = asyncio.run(over_http(links, seconds, every))
            used.append(processor(pid))
            loads.append(os.getloadavg()[0])
            service.process.send_signal(signal.SIGTERM)
            service.process.communicate()
    for (through, found), begun, ended, load in zip(times.items(), used, used[1:], loads, strict=False):
        shares = [_milliseconds(found, share) for share in (0.5, 0.95, 1.0)]
        rows.append(
            {
                "people": people,
                "through": through,
                "actions": len(found),
                "rate": len(found) / seconds,
                "load": load,
                "times": shares,
                "processor": 1000 * (ended - begun) / len(found),
            }
        )
        print("; ".join(show(rows[-1]) for show in COLUMNS.values()), flush=True)
    write_record(record, COLUMNS, rows)


if __name__ == "__main__":
    main()
