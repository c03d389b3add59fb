"""A transport for a message queue in memory: three methods, and what the kernel makes of them."""

from __future__ import annotations

import asyncio
import json
import sys
import unicodedata
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from beside import Here, until

import assist.connect
from assist.cli.options.bridges import bridge_of
from assist.connect.bridges import Bridge, Faulty, Located, Message, Report, Reported, Transport, kernel
from assist.connect.bridges.errands import Errands
from assist.connect.bridges.mqtt_settings import MqttSettings
from assist.connect.bridges.transport import Drove, Output
from assist.declare.refusals import Refusal
from assist.live import Acted, Joined, Left
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


def served(tmp_path: Path, work: Callable[[Here, Queues, Bridge], Coroutine[Any, Any, None]]) -> Here:
    """Run a service with a bridge until the work is done."""
    here = Here(tmp_path / "session", ["ann", "bob"])

    def made(link: str) -> Bridge:
        return Bridge(Queues(), link, longest_pause=0.1)

    async def all_of_it() -> None:
        assert isinstance(here.bridge.transport, Queues)
        await work(here, here.bridge.transport, here.bridge)

    here.run(made, all_of_it)
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


def test_what_was_under_way_when_a_connection_broke_is_sent_in_order_and_advice_is_the_newest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gates = list[asyncio.Future[None]]()
    at_once = Queues.send

    async def acknowledged_late(self: Queues, key: str, content: Any) -> None:
        for gate in gates:
            await gate
        await at_once(self, key, content)

    monkeypatch.setattr(Queues, "send", acknowledged_late)
    monkeypatch.setattr(Queues, "at_once", 8)  # messages, as with MQTT

    async def work(here: Here, queues: Queues, bridge: Bridge) -> None:
        await until(lambda: bridge.connected and queues.of("advice/ann"))
        gates.append(asyncio.get_running_loop().create_future())
        for number, action in enumerate(("(fetch box-a)", "(return box-a)", "(fetch box-a)"), start=1):
            queues.inbox.put_nowait(act("ann", action, str(number), number))
            await until(lambda: bridge.counts["recorded"] == number)  # noqa: B023
            await asyncio.sleep(0.01)  # the answer and the advice are under way
        queues.sent.clear()
        gates.pop().set_exception(OSError("the broker is gone"))
        await until(lambda: len(queues.of("answers/ann")) == 3 and queues.of("advice/ann"))
        assert [one["next"] for one in queues.of("answers/ann")] == [2, 3, 4]
        assert queues.of("advice/ann")[-1]["seq"] == json.loads(here.service.view("ann"))["seq"]

    served(tmp_path, work)


def test_a_name_is_the_same_sender_in_any_form_of_unicode(tmp_path: Path) -> None:
    composed, apart = (unicodedata.normalize(form, "Zoë") for form in ("NFC", "NFD"))

    async def work(here: Here, queues: Queues, bridge: Bridge) -> None:
        await until(lambda: bridge.connected)
        await here.service.report(Joined(person=composed))
        queues.inbox.put_nowait(Reported(MqttSettings(observe={"topic": "line/{person}/action"}).sources[0].report(
            {"person": f" {apart} ", "action": "(fetch box-a)", "id": "a"}, {})))  # fmt: skip
        await until(lambda: bridge.counts["recorded"])
        await here.service.report(Left(person=composed))
        await until(lambda: queues.of(f"advice/{composed}")[-1:] == [None])
        assert not any(apart in key for key, _ in queues.sent)

    served(tmp_path, work)


def test_messages_about_nobody_cost_no_memory_and_a_sender_whose_report_is_under_way_is_not_forgotten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their first report came before they joined; while strangers report, the second one meets a busy service."""

    async def work(here: Here, queues: Queues, bridge: Bridge) -> None:
        report, gate = here.service.report, asyncio.Event()

        async def slow_for_eve(event: Any) -> Any:
            if event.person == "eve":
                await gate.wait()
            return await report(event)

        await until(lambda: bridge.connected)
        queues.inbox.put_nowait(act("eve", "(fetch box-a)", "1", 1))
        await until(lambda: bridge.counts["refused"] == 1)
        await report(Joined(person="eve"))
        monkeypatch.setattr(here.service, "report", slow_for_eve)
        queues.inbox.put_nowait(act("eve", "(fetch box-a)", "2", 2))
        for number in range(2 * strangers):
            queues.inbox.put_nowait(act(f"stranger-{number}", "(fetch box-a)", "1", 1))
        await until(lambda: bridge.counts["refused"] == 1 + 2 * strangers)
        queues.inbox.put_nowait(act("eve", "(return box-a)", "3", 3))
        await until(lambda: bridge.counts["messages"] == 3 + 2 * strangers)
        assert bridge.waits == []  # the third one does not wait for the first
        gate.set()
        await until(lambda: bridge.counts["recorded"] == 2)
        assert len(bridge._senders) <= strangers + 1
        assert {"eve", f"stranger-{2 * strangers - 1}"} <= bridge._senders.keys()

    strangers = 5
    monkeypatch.setattr(kernel, "STRANGERS", strangers)
    served(tmp_path, work)


def test_an_instruction_that_the_stream_told_is_not_replaced_by_an_older_answer() -> None:
    """The drive to a new person was cancelled, and the robot was not sent again."""

    async def work() -> list[str | None]:
        put, answer = list[str | None](), asyncio.get_running_loop().create_future()
        transport = Queues()
        transport.drive = lambda _, person, drive: [Output("drive", (person, drive))]  # type: ignore[method-assign]
        drives = list[str]()

        def note(outputs: Any) -> None:
            for output in outputs:
                put.append(output.content[0])
                drives.append(output.content[1])

        async def arrived(*_: Any) -> Any:
            return await answer

        errands = Errands(transport, note, arrived, asyncio.create_task, 0.1)
        errands.connected()
        errands.instructed(1, {"person": "ann", "arrived": False, "seq": 3})
        errands.drove(Drove(drives[-1], True))
        await asyncio.sleep(0)
        errands.instructed(1, {"person": "bob", "arrived": False, "seq": 5})
        answer.set_result({"person": "ann", "arrived": True, "seq": 4})
        await asyncio.sleep(0.01)
        return put

    assert asyncio.run(work()) == ["ann", "bob"]


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


@pytest.fixture
def imported_anew(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Bridges are imported again in the test; afterwards all modules are as before, also those first imported in it."""

    def kept() -> dict[str, Any]:
        return {name: module for name, module in sys.modules.items() if name.startswith("assist.connect.bridges")}

    before = kept()
    monkeypatch.delattr(assist.connect, "bridges", raising=False)
    yield
    for name in kept():
        del sys.modules[name]
    sys.modules.update(before)


@pytest.mark.usefixtures("imported_anew")
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
            if name.startswith("assist.connect.bridges"):
                del sys.modules[name]
            elif name.partition(".")[0] == package:
                monkeypatch.setitem(sys.modules, name, None)
        monkeypatch.setitem(sys.modules, package, None)
        monkeypatch.delattr(assist.connect, "bridges", raising=False)

    without(unneeded)
    bridge_of(file)
    without(needed)
    with pytest.raises(MissingExtraError, match=message):
        bridge_of(file)
