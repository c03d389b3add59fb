"""A conversation with a fake rosbridge: actions, advice and goals of the robot, by version 2 of the protocol."""

from __future__ import annotations

import asyncio
import json
import random
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest
from beside import Here, done_of, plans
from conftest import kit
from networks import free_port
from rosbridge import Rosbridge

from assist.connect.bridges import Ros2Settings
from assist.live import Acted, Left
from assist.live.store import stored
from assist.person.settings import Setting
from planner.system.errors import InputFileError

SETTINGS = """
[rosbridge]
url = "ws://127.0.0.1:PORT"
[observe]
topic = "/line/action"
[advice]
topic = "/line/advice"
[answers]
topic = "/line/answers"
[go_to]
action = "/go_to"
type = "line_msgs/action/GoTo"
goal = {name = "{person}", label = "bench of {person}", at = ["{x}", 0.5]}
[go_to.places]
person-1 = {x = 1.0}
person-2 = {x = 2.0}
person-3 = {x = 3.5}
"""
DRIVES = Setting(c_suggest=0.01, c_move=0.01, travel_time=1)


def converse(
    here: Here, folder: Path, settings: str, work: Callable[[Rosbridge], Coroutine[Any, Any, None]]
) -> Rosbridge:
    """Let a bridge converse with a fake rosbridge; return it, after it has found no fault."""
    port = free_port()
    (file := folder / "bridge.toml").write_text(settings.replace("PORT", str(port)))
    ros: list[Rosbridge] = []

    async def all_of_it() -> None:
        ros.append(Rosbridge())
        await ros[0].start(port)
        await work(ros[0])
        await ros[0].stop()

    here.run(file, all_of_it, again=0.2, retry=0.05)
    assert ros[0].faults == []
    return ros[0]


def answers_of(ros: Rosbridge) -> dict[str, dict[str, Any]]:
    found = [json.loads(one["data"]) for one in ros.published("/line/answers")]
    return {one["id"]: one for one in found}


def test_two_robots_drive_by_an_action_each(tmp_path: Path) -> None:
    setting = Setting(c_suggest=0.01, c_move=0.01, trust="paper", travel_time=1, robots=2)
    here = Here(tmp_path / "session", ["person-1", "person-2"], setting)

    async def work(_: Rosbridge) -> None:
        for name in ("person-1", "person-2"):
            for action in ("(fetch box-a)", "(place hammer slot-2 box-a)"):
                await here.service.report(Acted(person=name, action=action))
        while {one.location for one in here.session.outlook().robots if one.arrived} != {"person-1", "person-2"}:
            await asyncio.sleep(0.05)

    settings = SETTINGS.replace('"/go_to"', '"/robot{robot}/go_to"')
    ros = converse(here, tmp_path, settings, work)
    sent = {one["action"]: one["args"]["name"] for one in ros.heard if one["op"] == "send_action_goal"}
    assert sorted(sent) == ["/robot1/go_to", "/robot2/go_to"]
    assert [sent[f"/robot{number}/go_to"] for number in (1, 2)] == [
        one.location for one in here.session.outlook().robots
    ]
    (file := tmp_path / "one.toml").write_text(SETTINGS.replace("PORT", "1"))
    with pytest.raises(InputFileError, match=r"go_to.action: '/go_to'; expected {robot} in it"):
        Ros2Settings.read(file, 2)


def test_three_people_act_and_the_robot_drives_although_the_connection_is_lost(tmp_path: Path) -> None:
    walks = plans(kit("tiny"), 3, 4, seed=1)
    here, rng = Here(tmp_path / "session", list(walks), DRIVES), random.Random(2)

    def arrived() -> list[str]:
        events = stored(tmp_path / "session" / "journal.sqlite")[1]
        found = [record["event"] for _, record in events]
        return [event["person"] for event in found if event["kind"] == "arrived"]

    async def work(ros: Rosbridge) -> None:
        async def station(name: str) -> None:
            for number, action in enumerate(walks[name], start=1):
                identifier = f"{name}-{number}"
                report = {"data": json.dumps({"person": name, "action": action, "id": identifier})}
                while answers_of(ros).get(identifier, {}).get("status") != "recorded":
                    for _ in range(rng.choice((1, 2))):
                        await ros.publish("/line/action", report)
                    await asyncio.sleep(0.1)

        ros.fails = 1
        stations = asyncio.gather(*map(station, walks))
        await ros.until(lambda: len(answers_of(ros)) >= 4)
        await ros.lose()
        await stations
        while len(arrived()) < 2:
            await asyncio.sleep(0.05)

    ros = converse(here, tmp_path, SETTINGS, work)
    assert done_of(here.session.history.log(), walks) == walks
    assert here.bridge.counts["connections"] == 2
    assert set(arrived()) <= {goal["name"] for goal in ros.arrivals}
    goal = ros.arrivals[0]
    assert goal == {"name": goal["name"], "label": f"bench of {goal['name']}", "at": [goal["at"][0], 0.5]}
    assert goal["at"][0] in (1.0, 2.0, 3.5)


def test_refusals_types_of_messages_and_people_who_leave(tmp_path: Path) -> None:
    here = Here(tmp_path / "session", ["ann", "bob"], DRIVES)
    settings = """
        [rosbridge]
        url = "ws://127.0.0.1:PORT"
        [[observe]]
        topic = "/line/action"
        type = "line_msgs/msg/Action"
        seq = "{seq}"
        [[observe]]
        topic = "/scan"
        pattern = '(?P<person>\\w+) (?P<id>\\w+): (?P<verb>TAKE) (?P<code>\\d+)'
        action = "({verb} {code})"
        [[observe]]
        topic = "/next"
        event = "began"
        [answers]
        topic = "/line/answers"
        [advice]
        topic = "/line/advice"
        type = "line_msgs/msg/Advice"
        fields = ["person", "suggestion", "finished"]
        [go_to]
        action = "/go_to"
        type = "line_msgs/action/GoTo"
        goal = {name = "{person}"}
        [names]
        TAKE = "fetch"
        4711 = "box-b"
        """

    async def work(ros: Rosbridge) -> None:
        ros.drive = 600.0  # before the first goal, which may come at once
        await ros.until(lambda: {one["person"] for one in ros.published("/line/advice")} == {"ann", "bob"})
        await ros.publish("/line/action", {"person": "ann", "action": "fetch(box-a)", "id": "1", "seq": 2, "ok": True})
        await ros.publish("/line/action", {"person": "ann", "action": "fetch(box-z)", "id": "2", "seq": 2})
        await ros.publish("/line/action", {"person": "eve", "action": "fetch(box-a)", "id": "3", "seq": 2})
        await ros.publish("/line/action", {"person": "ann", "id": "4", "seq": 2})
        await ros.publish("/scan", {"data": "bob s5: TAKE 4711"})
        await ros.publish("/scan", {"data": "a scratch"})
        await ros.publish("/scan", {})
        assert ros._socket is not None
        for text in ("[]", "{", '{"op": "publish"}', '{"op": "action_result", "id": "x"}', '{"op": 7}'):
            await ros._socket.send(text)
        await ros.until(lambda: {"1", "2", "3", "4", "s5"} <= set(answers_of(ros)))
        await ros.publish("/next", {"data": '{"person": "ann", "id": "6"}'})
        await ros.until(lambda: "6" in answers_of(ros))
        await ros.until(lambda: ros.goals)
        (to,) = [one["args"]["name"] for one in ros.heard if one["op"] == "send_action_goal"][-1:]
        ros.drive = 0.01
        await here.service.report(Left(person=to))  # the goal is cancelled, and the robot goes to the other one
        await ros.until(lambda: {"name": "bob" if to == "ann" else "ann"} in ros.arrivals)

    ros = converse(here, tmp_path, settings, work)
    answers = answers_of(ros)
    assert {one: answers[one]["status"] for one in ("1", "2", "3", "4", "s5", "6")} == {
        "1": "recorded", "2": "refused", "3": "refused", "4": "refused", "s5": "recorded", "6": "recorded",
    }  # fmt: skip
    assert "box-z" in answers["2"]["detail"]
    assert "'eve' is not in the team" in answers["3"]["detail"]
    assert answers["4"]["detail"] == "there is no field 'action'; the message has person, id, seq"
    assert "cancel_action_goal" in {one["op"] for one in ros.heard}


def test_advice_is_repeated_for_those_who_subscribe_late(tmp_path: Path) -> None:
    here = Here(tmp_path / "session", ["ann"])

    async def work(ros: Rosbridge) -> None:
        await ros.until(lambda: ros.published("/line/advice"))
        ros.heard.clear()
        await ros.until(lambda: ros.published("/line/advice"))

    converse(here, tmp_path, SETTINGS, work)
