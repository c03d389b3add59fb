"""A transport for a message queue in memory: three methods, and what the kernel makes of them."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from test_mqtt import Here

import assist.connect
from assist.cli.options.bridges import bridge_of
from assist.connect.bridges import Bridge, Faulty, Located, Message, Report, Reported, Transport
from assist.declare.refusals import Refusal
from assist.live import Acted, Left
from assist.web.server import listen, run
from planner.system.errors import MissingExtraError


class Queues(Transport):
    """Two queues in memory, which can fail."""

    name = "queues"
    robots = 1

    def __init__(self) -> None:
        super().__init__()
        self.inbox, self.sent = asyncio.Queue[Any](), list[tuple[str, Any]]()
        self.broken = False

    @asynccontextmanager
    async def connect(self) -> AsyncIterator[None]:
        if self.broken:
            raise OSError("no queue")
        yield

    async def messages(self) -> AsyncIterator[Message]:
        while (received := await self.inbox.get()) is not None:
            yield received

    async def send(self, key: str, content: Any) -> None:
        if self.broken:
            raise OSError("the queue is gone")
        self.sent.append((key, content))

    def of(self, key: str) -> list[Any]:
        return [content for where, content in self.sent if where == key]


async def until(said: Callable[[], Any]) -> None:
    while not said():
        await asyncio.sleep(0.01)


def served(tmp_path: Path, work: Callable[[Here, Queues, Bridge], Coroutine[Any, Any, None]]) -> Here:
    """Run a service with a bridge until the work is done."""
    here, listening, failed = Here(tmp_path / "session", ["ann", "bob"]), listen("127.0.0.1", 0), list[Exception]()
    link = f"http://127.0.0.1:{listening.getsockname()[1]}/operator#{here.service.access.operator}"

    async def beside() -> None:
        bridge = Bridge(queues := Queues(), link, longest_pause=0.1)
        running = asyncio.create_task(bridge.run())
        try:
            await asyncio.wait_for(work(here, queues, bridge), 60)
        except Exception as error:  # noqa: BLE001  raised when the service has ended
            failed.append(error)
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)

    asyncio.run(run(here.app, listening, lambda: None, beside(), ends=True))
    assert failed == []
    return here


def act(person: str, action: str, id: str, number: int | None = None, **more: Any) -> Reported:
    return Reported(Report(person, id, values={"action": action}, number=number), **more)


def test_reports_are_recorded_once_in_order_and_answered(tmp_path: Path) -> None:
    done: list[str] = []

    async def work(_: Here, queues: Queues, bridge: Bridge) -> None:
        put = queues.inbox.put_nowait
        put(act("ann", "(place hammer slot-1 box-a)", "2", 2))  # before the first
        put(act("ann", "(fetch box-a)", "1", 1))
        put(act("bob", "(fetch box-b)", "b", done=lambda: done.append("b")))
        put(act("bob", "(fetch box-b)", "b"))  # a repetition
        put(act("bob", "(fly)", "c"))
        put(Faulty("no words", "bob", "d"))
        put(Reported(Report("bob", "u", "undone")))  # any kind of event
        put(Located(1, "ann"))
        await until(lambda: len(queues.of("answers/bob")) == 5 and len(queues.of("answers/ann")) == 2)
        told = {one["id"]: one["status"] for one in queues.of("answers/bob")}
        assert told == {"b": "recorded", "c": "refused", "d": "refused", "u": "recorded"}
        assert [one["number"] for one in queues.of("answers/ann")] == [1, 2]
        await until(lambda: [one["location"] for one in queues.of("robots/1")][-1:] == ["ann"])
        assert (bridge.counts["recorded"], bridge.counts["refused"]) == (5, 2)

    here = served(tmp_path, work)
    assert [row["action"] for row in here.session.log()] == ["(fetch box-a)", "(place hammer slot-1 box-a)"]
    assert done == ["b"]


def test_a_number_has_one_id_also_when_it_was_recorded_or_refused(tmp_path: Path) -> None:
    async def work(_: Here, queues: Queues, __: Bridge) -> None:
        put, answers = queues.inbox.put_nowait, partial(queues.of, "answers/ann")
        for number, (id, action) in enumerate(
            [("1", "(fetch box-a)"), ("2", "(fly)"), ("1b", "(return box-a)"), ("2b", "(return box-a)")]
        ):
            put(act("ann", action, id, number % 2 + 1))
            await until(lambda told=number + 1: len(answers()) == told)
        assert [one["status"] for one in answers()] == ["recorded", "refused", "refused", "refused"]
        for number, told in enumerate(answers()[2:], start=1):
            assert told["detail"] == f"the number {number} belongs to the id '{number}'; expected one id for each"
            assert (told["number"], told["next"]) == (number, 3)
        put(act("ann", "(fetch box-a)", "1", 1))  # a repetition gets the first answer
        put(act("ann", "(return box-a)", "3", 3))
        await until(lambda: len(answers()) == 6)
        assert [one["status"] for one in answers()[4:]] == ["recorded", "recorded"]

    here = served(tmp_path, work)
    assert [row["action"] for row in here.session.log()] == ["(fetch box-a)", "(return box-a)"]


def test_arrivals_of_a_robot_are_recorded_in_order_though_one_is_sent_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def work(here: Here, queues: Queues, bridge: Bridge) -> None:
        report, failed = here.service.report, list[Any]()

        async def busy_once(event: Any) -> Any:
            if not failed:
                failed.append(event)
                raise Refusal("busy", n=5000)
            return await report(event)

        monkeypatch.setattr(here.service, "report", busy_once)
        await until(lambda: bridge.connected)
        before = here.service.outlook.seq
        for number, person in enumerate(("ann", "bob", None, "bob", "ann")):
            queues.inbox.put_nowait(Located(1, person, str(number)))
        await until(lambda: here.service.outlook.seq == before + 5)
        assert here.service.outlook.robots[0].location == "ann"

    served(tmp_path, work)


def test_advice_is_sent_again_after_a_connection_was_lost_and_removed_when_somebody_leaves(tmp_path: Path) -> None:
    async def work(here: Here, queues: Queues, bridge: Bridge) -> None:
        await until(lambda: queues.of("advice/ann") and queues.of("advice/bob"))
        queues.broken = True
        queues.inbox.put_nowait(None)  # the connection ends
        await until(lambda: not bridge.connected)
        queues.sent.clear()
        await here.service.report(Acted(person="ann", action="(fetch box-a)"))
        queues.broken = False
        await until(lambda: queues.of("advice/ann") and queues.of("advice/bob"))
        await until(lambda: queues.of("advice/ann")[-1]["steps"] == 1)
        await here.service.report(Left(person="bob"))
        await until(lambda: queues.of("advice/bob")[-1] is None)
        assert bridge.counts["connections"] == 2

    served(tmp_path, work)


MQTT = "[observe]\ntopic = 'line/{person}'"
ROS2 = "[rosbridge]\nurl = 'ws://robot'\n[observe]\ntopic = '/line'"
OPCUA = "[own_server]\nurl = 'opc.tcp://station'\naction = '{item}'\nid = '{n}'"


@pytest.mark.parametrize(
    ("text", "needed", "unneeded", "message"),
    [
        (MQTT, "aiomqtt", "websockets", r"the MQTT bridge needs aiomqtt: .*\[mqtt\]"),
        (MQTT, "httpx2", "asyncua", r"the MQTT bridge needs httpx2: .*\[mqtt\]"),
        (ROS2, "websockets", "aiomqtt", r"the ROS 2 bridge needs websockets.*\[ros2\]"),
        (OPCUA, "asyncua", "aiomqtt", r"the OPC UA bridge needs asyncua: .*\[opcua\]"),
    ],
)
def test_a_bridge_needs_its_own_extra_only(
    text: str, needed: str, unneeded: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (file := tmp_path / "bridge.toml").write_text(text)

    def without(package: str) -> None:
        for name in [*sys.modules]:
            if name.startswith("assist.connect.bridges"):  # to be imported anew
                monkeypatch.delitem(sys.modules, name)
            elif name.partition(".")[0] == package:
                monkeypatch.setitem(sys.modules, name, None)
        monkeypatch.setitem(sys.modules, package, None)
        monkeypatch.delattr(assist.connect, "bridges", raising=False)

    without(unneeded)
    bridge_of(file)
    without(needed)
    with pytest.raises(MissingExtraError, match=message):
        bridge_of(file)
