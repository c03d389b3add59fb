"""Load test of the live service: many people who act every few seconds, and a service that may be killed repeatedly.

    python bench/live_load.py [--people 200] [--seconds 300] [--every 2] [--kills 0]... [--miss 0] [--confusion 0]
                              [--instance FILE] [--data DIR] [--record FILE]

Each person has a connection that receives pushed views, posts actions, and measures the time from a post to the
resulting push. An unanswered post is repeated under the same id until it is answered. At the end, the log must contain
exactly the acknowledged actions, in order and once each. An uninterrupted run of the same events must give the same
beliefs to the last bit.

With `--miss` or `--confusion`, a second run has a service that expects such errors, and clients that post no action, or
another applicable one, with these probabilities.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import closing, suppress
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlsplit

import click
import numpy as np
from tables import Columns, cell, record_option, write_record

from assist.live.events import Acted
from assist.live.session import Session
from assist.person.observation_model import ObservationModel
from assist.person.settings import Setting
from planner import cost_to_go, load

PAPER = Path(__file__).parent.parent / "domains/kitting/paper.pddl"
RETRY = 0.1
C_SUGGEST = 0.2
PERFECT = ObservationModel(0.0, 0.0)


@dataclass
class Seen:
    """Measurements of a run."""

    latencies: list[float] = field(default_factory=list)
    answers: list[float] = field(default_factory=list)
    acknowledged: dict[str, list[str]] = field(default_factory=dict)
    repeated: int = 0
    refused: list[str] = field(default_factory=list)
    resumed: list[float] = field(default_factory=list)
    memory: list[float] = field(default_factory=list)
    processor: float = 0.0
    starting: list[float] = field(default_factory=list)
    ready: float = 0.0
    stopped: float = 0.0
    behind: set[str] = field(default_factory=set)
    lost: int = 0
    doubled: int = 0


class Worker:
    """A simulated client: one connection that listens, and one that posts."""

    def __init__(
        self, link: str, every: float, seed: int, seen: Seen, noise: ObservationModel = PERFECT
    ) -> None:  # fmt: skip
        self.parts = urlsplit(link)
        _, self.name = self.parts.path.strip("/").split("/")
        self.token = self.parts.fragment
        self.every, self.seen, self.rng = every, seen, np.random.default_rng(seed)
        self.noise, self.view = noise, dict[str, Any]()
        self.changed = asyncio.Condition()
        self.streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None
        self.count = 0
        seen.acknowledged[self.name] = []

    async def listen(self) -> None:
        asks = (
            f"GET /api/people/{quote(self.name)}/events HTTP/1.1\r\nHost: {self.parts.netloc}\r\n"
            f"Authorization: Bearer {self.token}\r\n\r\n"
        ).encode()
        while True:
            with suppress(OSError):
                reader, writer = await asyncio.open_connection(self.parts.hostname, self.parts.port, limit=1 << 20)
                with closing(writer):
                    writer.write(asks)
                    kind = b""
                    while line := await reader.readline():
                        name, _, value = line.rstrip().partition(b": ")
                        kind = value if name == b"event" else kind
                        if name == b"data" and kind == b"view":
                            view = json.loads(value)
                            async with self.changed:
                                if view["seq"] >= self.view.get("seq", 0):
                                    self.view = view
                                self.changed.notify_all()
            await asyncio.sleep(RETRY)

    async def post(self, what: str, body: dict) -> dict:
        """Post a request until it is answered."""
        content = json.dumps(body).encode()
        head = (
            f"POST /api/people/{quote(self.name)}/{what} HTTP/1.1\r\nHost: {self.parts.netloc}\r\n"
            f"Authorization: Bearer {self.token}\r\nContent-Type: application/json\r\n"
            f"Content-Length: {len(content)}\r\n\r\n"
        ).encode()
        first = True
        while True:
            try:
                if self.streams is None:
                    self.streams = await asyncio.open_connection(self.parts.hostname, self.parts.port)
                self.seen.repeated += not first
                first = False
                reader, writer = self.streams
                writer.write(head + content)
                status = int((await reader.readline()).split()[1])
                length = 0
                while (line := await reader.readline()) not in (b"\r\n", b""):
                    if line.lower().startswith(b"content-length:"):
                        length = int(line.split(b":")[1])
                answer = json.loads(await reader.readexactly(length))
            except (OSError, EOFError, IndexError, ValueError):
                await self.hang_up()
                await asyncio.sleep(RETRY)
                continue
            if status != 200:
                self.seen.refused.append(f"{status} {answer}")
            return answer

    async def hang_up(self) -> None:
        if self.streams is not None:
            self.streams[1].close()
            with suppress(OSError):
                await self.streams[1].wait_closed()
            self.streams = None

    async def act(self) -> None:
        view, self.count = self.view, self.count + 1
        identity = f"{self.name}-{self.count}"
        begun = time.perf_counter()
        if view["finished"]:
            answer = await self.post("begin", {"id": identity})
        else:
            options = view["applicable"]
            advised = view["suggestion"] if self.rng.random() < 0.7 else None
            action = advised or options[int(self.rng.integers(len(options)))]
            if self.rng.random() < self.noise.miss:
                return
            if self.rng.random() < self.noise.confusion:
                action = options[int(self.rng.integers(len(options)))]
            answer = await self.post("actions", {"action": action, "id": identity, "seq": view["seq"]})
            self.seen.acknowledged[self.name].append(action)
        self.seen.answers.append(time.perf_counter() - begun)
        if self.name in self.seen.behind:
            self.seen.behind.discard(self.name)
            if not self.seen.behind:
                self.seen.resumed.append(time.monotonic() - self.seen.ready)
        if "seq" not in answer:
            return
        async with self.changed:
            await self.changed.wait_for(lambda: self.view["seq"] >= answer["seq"])
        self.seen.latencies.append(time.perf_counter() - begun)

    async def work(self, until: float) -> None:
        while not self.view:
            await asyncio.sleep(0.05)
        await asyncio.sleep(self.rng.uniform(0, self.every))
        while time.monotonic() < until:
            due = time.monotonic() + self.every
            await self.act()
            await asyncio.sleep(max(0.0, due - time.monotonic()))


class Service:
    """The process of the service, which is restarted on the same port and data."""

    def __init__(self, instance: Path, people: int, data: Path, *options: str) -> None:
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        self.command = [
            str(Path(sys.executable).with_name("kitassist")), "serve", str(instance), "--humans", str(people),
            "--port", str(self.port), "--data", str(data), "--c-suggest", str(C_SUGGEST), *options,
        ]  # fmt: skip

    def start(self) -> dict:
        """Start the process; return its first line of output."""
        self.process = subprocess.Popen(self.command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        said = json.loads(self.process.stdout.readline())
        self.before = self.processor()
        return said

    def processor(self) -> float:
        """Return the processor seconds of all threads."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def worked(self) -> float:
        """Return the processor seconds since the service was ready."""
        return self.processor() - self.before

    def memory(self) -> float:
        for line in Path(f"/proc/{self.process.pid}/status").read_text().splitlines():
            if line.startswith("VmRSS"):
                return int(line.split()[1]) * 1024 / 1e6
        return 0.0


async def run(
    instance: Path, people: int, seconds: float, every: float, kills: int, data: Path, seed: int = 0,
    noise: ObservationModel = PERFECT,
) -> Seen:  # fmt: skip
    """Let people work, and kill the service `kills` times; check the saved data."""
    errors = (
        []
        if noise.is_perfect
        else ["--set", f"observation.miss={noise.miss}", "--set", f"observation.confusion={noise.confusion}"]
    )
    seen, service = Seen(), Service(instance, people, data, *errors)
    said = await asyncio.to_thread(service.start)
    seen.ready = time.monotonic()
    workers = [Worker(link, every, seed + number, seen, noise) for number, link in enumerate(said["join"].values())]
    until = time.monotonic() + seconds
    listening = [asyncio.create_task(worker.listen()) for worker in workers]
    working = [asyncio.create_task(worker.work(until)) for worker in workers]
    rng = np.random.default_rng(seed)
    moments = np.sort(rng.uniform(0.05, 0.95, kills)) * seconds
    begun = time.monotonic()
    for moment in moments:
        await asyncio.sleep(max(0.0, begun + moment - time.monotonic()))
        seen.processor += service.worked()
        service.process.kill()
        service.process.communicate()
        killed = time.monotonic()
        await asyncio.to_thread(service.start)
        seen.starting.append(time.monotonic() - killed)
        seen.ready, seen.behind = time.monotonic(), {worker.name for worker in workers}
    seen.memory.append(service.memory())
    while not all(task.done() for task in working):
        seen.memory.append(service.memory())
        await asyncio.wait(working, timeout=5.0)
    await asyncio.gather(*working)
    for task in listening:
        task.cancel()
    await asyncio.gather(*listening, return_exceptions=True)
    for worker in workers:
        await worker.hang_up()
    seen.processor += service.worked()
    service.process.send_signal(signal.SIGTERM)
    stopping = time.monotonic()
    await asyncio.to_thread(service.process.communicate)
    seen.stopped = time.monotonic() - stopping
    assert service.process.returncode == 0
    check(instance, data, seen, noise)
    return seen


def check(instance: Path, data: Path, seen: Seen, noise: ObservationModel) -> None:
    """Compare the acknowledged actions with the log, and the beliefs with an uninterrupted run."""
    tasks = {instance.stem: cost_to_go(load(instance))}
    options = {"setting": Setting(c_suggest=C_SUGGEST, observation=noise)}
    kept = Session(tasks, data / "journal.sqlite", **options)
    found: dict[str, list[str]] = {person: [] for person in kept.people}
    for row in kept.log():
        found[row["person"]].append(row["action"])
    for person, actions in seen.acknowledged.items():
        there, said = Counter(found[person]), Counter(actions)
        seen.lost += (said - there).total()
        seen.doubled += (there - said).total()
    assert found == seen.acknowledged, f"{seen.lost} acknowledged actions are lost, {seen.doubled} are there twice"
    assert not seen.refused, seen.refused[:3]
    with tempfile.TemporaryDirectory() as folder:
        anew = Session(tasks, Path(folder) / "journal.sqlite", **options)
        for record in kept._store:
            event = record.event
            if isinstance(event, Acted) and not event.heard:  # that it was not seen is said by the view: none
                event = event.model_copy(update={"heard": True, "seq": 0})
            anew.report(event)
        assert anew.beliefs() == kept.beliefs(), "the beliefs are those of an uninterrupted run"
        assert anew.recommend() == kept.recommend()
        anew.close()
    kept.close()


def _milliseconds(times: list[float], share: float) -> float:
    return 1e3 * float(np.quantile(times, share))


COLUMNS: Columns = {
    "people": cell("people"),
    "missed": cell("miss", ".0%"),
    "confused": cell("confusion", ".0%"),
    "minutes": cell("minutes", ".1f"),
    "kills": cell("kills"),
    "actions": cell("actions", ","),
    "from post to push: median, 95 %, slowest, ms": lambda r: " / ".join(f"{one:.0f}" for one in r["pushed"]),
    "processor time per action, ms": cell("processor", ".1f"),
    "memory since the last start, by quarters, MB": lambda r: " / ".join(f"{one:.0f}" for one in r["memory"]),
    "from a kill until ready, at most, s": lambda r: f"{r['starting']:.1f}" if r["kills"] else "",
    "then until everybody had acted, at most, s": lambda r: f"{r['resumed']:.1f}" if r["kills"] else "",
    "lost, doubled": cell("wrong"),
}


@click.command()
@click.option("--instance", type=Path, default=PAPER)
@click.option("--people", default=200, show_default=True)
@click.option("--seconds", default=300.0, show_default=True)
@click.option("--every", default=2.0, show_default=True, help="Seconds between two actions of a person.")
@click.option(
    "--kills",
    default=(0,),
    show_default=True,
    multiple=True,
    help="Number of kills. May be repeated, for a run with each.",
)
@click.option("--miss", default=0.0, show_default=True, help="Probability that an action is not seen.")
@click.option("--confusion", default=0.0, show_default=True, help="Probability that another one is seen.")
@click.option("--data", type=Path)
@record_option
def main(
    instance: Path, people: int, seconds: float, every: float, kills: tuple[int, ...], miss: float, confusion: float,
    data: Path | None, record: Path | None,
) -> None:  # fmt: skip
    """Run the tests and print the measurements."""
    rows = []
    every_noise = dict.fromkeys([PERFECT, ObservationModel(miss, confusion)])
    for noise, count in product(every_noise, kills):
        with tempfile.TemporaryDirectory() as folder:
            where = data or Path(folder) / "data"
            seen = asyncio.run(run(instance, people, seconds, every, count, where, noise=noise))
        rows.append({
            "people": people, "miss": noise.miss, "confusion": noise.confusion, "minutes": seconds / 60,
            "kills": count, "actions": len(seen.answers),
            "wrong": f"{seen.lost}, {seen.doubled}",
            "pushed": [*(_milliseconds(seen.latencies, share) for share in (0.5, 0.95, 1.0))],
            "processor": 1e3 * seen.processor / len(seen.answers),
            "memory": [seen.memory[round(at)] for at in np.linspace(0, len(seen.memory) - 1, 5)],
            "starting": max(seen.starting, default=0.0), "resumed": max(seen.resumed, default=0.0),
        })  # fmt: skip
        for name, show in COLUMNS.items():
            print(f"{name}: {show(rows[-1])}")
        answered = f"{_milliseconds(seen.answers, 0.5):.1f} ms, 95 % {_milliseconds(seen.answers, 0.95):.1f} ms"
        print(f"answered: median {answered}; {seen.repeated} posts repeated; SIGTERM took {seen.stopped:.1f} s")
        print("nothing lost, nothing twice, the beliefs of an uninterrupted run to the bit")
    write_record(record, COLUMNS, rows)


if __name__ == "__main__":
    main()
