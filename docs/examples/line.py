"""A line without hardware: an MQTT broker, three stations that scan, a robot that drives, and the live assistant.

    python docs/examples/line.py [kitting/paper] [--pace 2.0]

`make line` installs what it needs and runs it. It ends when all people have finished, or with Ctrl-C.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import random
import signal
import socket
import subprocess
import sys
import tempfile
from pathlib import Path

import aiomqtt
import iotcore

PEOPLE = ("person-1", "person-2", "person-3")
BRIDGE = """
[broker]
host = "127.0.0.1"
port = PORT
[observe]
topic = "line/{person}/action"
number = "{n}"
[answers]
topic = "line/{person}/answers"
[advice]
topic = "line/{person}/advice"
fields = ["suggestion", "applicable", "finished", "seq"]
[robot]
topic = "line/robot"
[arrived]
topic = "line/robot/arrived"
"""


async def station(port: int, person: str, pace: float, rng: random.Random) -> None:
    """Report what a person does, who follows most suggestions, and wait for each answer."""
    async with aiomqtt.Client("127.0.0.1", port) as client:
        await client.subscribe(f"line/{person}/+", qos=1)
        advice, number, answered = None, 0, 0
        async for message in client.messages:
            kind, said = str(message.topic).rpartition("/")[2], json.loads(message.payload or b"{}")
            if kind == "advice":
                advice = said
            elif kind == "answers" and said.get("number") == number:
                answered = said.get("seq", 0)
            if advice is None or answered is None or advice["seq"] < answered:
                continue  # there is no answer yet, or the advice is older
            if advice["finished"]:
                print(f"{person} has finished", flush=True)
                return
            await asyncio.sleep(pace * rng.uniform(0.5, 1.5))
            follows = advice["suggestion"] is not None and rng.random() < 0.9
            action = advice["suggestion"] if follows else rng.choice(advice["applicable"])
            number, answered = number + 1, None
            print(f"{person}: {action}" + " (as suggested)" * follows, flush=True)
            report = {"action": action, "id": f"{person}-{number}", "n": number}
            await client.publish(f"line/{person}/action", json.dumps(report), qos=1)


async def robot(port: int, pace: float) -> None:
    """Drive to where the assistant sends the robot, and report each arrival."""
    async with aiomqtt.Client("127.0.0.1", port) as client:
        await client.subscribe("line/robot", qos=1)
        async for message in client.messages:
            errand = json.loads(message.payload)
            if errand["person"] is not None and not errand["arrived"]:
                await asyncio.sleep(pace / 2)
                print(f"the robot is at {errand['person']}", flush=True)
                await client.publish("line/robot/arrived", json.dumps({"person": errand["person"]}), qos=1)


async def work(port: int, pace: float) -> None:
    """Let the stations and the robot work until all people have finished."""
    driving = asyncio.create_task(robot(port, pace))
    stations = [station(port, person, pace, random.Random(person)) for person in PEOPLE]
    try:
        await asyncio.gather(*stations)
    finally:
        driving.cancel()


def end(*_: object) -> None:
    """End the line at the first Ctrl-C, and ignore others while it ends."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    try:
        loop = asyncio.get_running_loop()
    except RuntimeError:
        raise KeyboardInterrupt from None
    # An exception would be raised wherever the loop is just now, even in its own functions: tasks are cancelled.
    loop.call_soon_threadsafe(lambda: [task.cancel() for task in asyncio.all_tasks(loop)])


def main() -> None:
    """Run the line, and end it with one sentence."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pace", type=float, default=2.0, help="mean seconds between two actions of a person")
    parser.add_argument("instance", nargs="?", default="kitting/paper", help="the task of all three")
    given = parser.parse_args()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)
    try:
        run(given.instance, given.pace)
    except (KeyboardInterrupt, asyncio.CancelledError):
        print("ended by Ctrl-C", flush=True)


def run(instance: str, pace: float) -> None:
    """Start the broker, the assistant, the stations and the robot, and end them all."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with tempfile.TemporaryDirectory() as folder, iotcore.Broker(port=port, listen="127.0.0.1"):
        settings = Path(folder, "bridge.toml")
        settings.write_text(BRIDGE.replace("PORT", str(port)), encoding="utf-8")
        serve = [Path(sys.executable).with_name("kitassist"), "serve", instance, "--humans", "3", "--port", "0"]
        options = ["--set", "travel_time=1", "--c-suggest", "0.01", "--c-move", "0.01", "--bridge", settings]
        service = subprocess.Popen([*serve, *options], stdout=subprocess.PIPE, text=True)
        try:
            assert service.stdout is not None
            links = json.loads(service.stdout.readline())
            print(f"the operator's page: {links['operator']}", flush=True)
            asyncio.run(work(port, pace))
        finally:
            service.send_signal(signal.SIGTERM)
            service.wait()


if __name__ == "__main__":
    main()
