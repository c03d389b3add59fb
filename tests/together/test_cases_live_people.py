"""Names of any script, actions in any form, robots that are idle: what people and operators of a line met."""

from __future__ import annotations

import asyncio
import json
import unicodedata
from pathlib import Path
from typing import Any

import pytest
from beside import Here
from conftest import costly, kit
from hypothesis import given
from hypothesis import strategies as st
from sessions import EASY, SETTING
from test_live_web import Web
from test_mqtt import Broker, broker, settings_file

from assist.connect.bridges.ordering import FAR, InOrder
from assist.declare import Refusal
from assist.live import Acted, Assistant, Elapsed, JournalError, Session
from assist.live.live_setting import LiveSetting
from assist.live.names import is_name, name_of
from assist.people.action_names import in_pddl
from assist.person.settings import Setting
from assist.web.server import ServedTeam
from planner import InputFileError, Table

__all__ = ["broker"]
NAMES = [
    "O'Brien", "D\u2019Angelo", "Zo\u00eb", "Zoe\u0308", "\u738b\u5c0f\u660e", "\u0645\u062d\u0645\u062f",
    "\u0905\u0928\u0940\u0924\u093e", "\u0dc1\u0dca\u200d\u0dbb\u0dd3",
    "\u05d2\u05f3\u05d5\u05e8\u05d2\u05f3", "\u0e2a\u0e21\u0e0a\u0e32\u0e22", "Nguy\u1ec5n",
    "Nguye\u0302\u0303n", "Mar\u00e7al\u00b7la", "\u0645\u06cc\u200c\u0646\u0627", "anna-lena", "J. R. Smith",
    "person_1", "\u0391\u03bb\u03ad\u03be\u03b7\u03c2", "\u11abx",
]  # fmt: skip
NO_NAMES = [
    "", " ", ".", "..", "../ann", "a/b", "a\\b", "a#b", "a+b", "a\x00b", "a\nb", "a\tb", "<b>", "a\u200bb",
    "ann\u200d", "a\u202eb", "x" * 65, "ann.", "'", "\u0301", "a\u200cb", "a;b", 'a"b', "a&b", "a%2fb",
    "\ud800", "\ufeffann",
]  # fmt: skip


def test_names_of_any_script_are_names_composed_or_not(tiny: Table, tmp_path: Path) -> None:
    session = Session(tiny, tmp_path / "journal.sqlite", setting=SETTING)
    for name in NAMES:
        if name_of(name) not in session.people:
            session.join(name)
        assert session.observe(unicodedata.normalize("NFD", name), "(fetch box-a)")["person"] == name_of(name)
        session.undo(f" {name} ")
    expected = list(dict.fromkeys(map(name_of, NAMES)))
    assert len(expected) == len(NAMES) - 2  # two are the same names, written in another way
    assert list(session.people) == expected
    for name in NO_NAMES:
        if name.strip() != "ann":
            with pytest.raises(Refusal, match="expected a name of up to 64 letters"):
                session.join(name)
    session.erase(unicodedata.normalize("NFD", "Zo\u00eb"), "as asked")
    assert "Zo\u00eb" not in session.people
    session.close()
    session = Session(tiny, tmp_path / "journal.sqlite", setting=SETTING)
    assert [name for name in session.people if name not in expected] == []
    session.close()


@costly(9, 100)
@given(st.text(max_size=70))
def test_a_name_has_one_form_and_no_path(text: str) -> None:
    once = name_of(text)
    assert name_of(once) == once
    if is_name(once):
        assert not set(once) & set('/\\#+?%<>&"\n\t\x00')
        assert once not in (".", "..")


@pytest.mark.parametrize("name", ["D\u2019Angelo", "Zoe\u0308"])
def test_a_person_of_any_name_has_a_link_and_a_page(tmp_path: Path, name: str) -> None:
    web = Web(kit("tiny"), tmp_path)
    with web.client:
        joined = web.ask("POST", "/api/team/people", None, json={"person": name})
        assert joined.status_code == 200
        link, _, token = joined.json()["join"].partition("#")
        assert web.client.get(link.replace("http://testserver", "")).status_code == 200
        own = {"Authorization": f"Bearer {token}"}
        for written in (name, unicodedata.normalize("NFD", name), unicodedata.normalize("NFC", name)):
            assert web.client.get(f"/api/people/{written}", headers=own).json()["person"] == name_of(name)
        assert web.client.get("/api/people/ann", headers=own).status_code == 403


def test_actions_are_shown_and_recorded_as_the_task_names_them(tiny: Table, tmp_path: Path) -> None:
    """Whatever the form of a report, its first and last letters are kept: `(fetch box-a)`, not `etch box-`."""
    session = Session(tiny, tmp_path / "journal.sqlite", setting=SETTING)
    forms = ["(fetch box-a)", "fetch box-a", "fetch(box-a)", " FETCH( Box-A ) ", "(fetch box-a)"]
    assert {in_pddl(form) for form in forms} == {"(fetch box-a)"}
    for number, form in enumerate(forms):
        session.join(f"person-{number}")
        session.observe(f"person-{number}", form)
    assert {row["action"] for row in session.log()} == {"(fetch box-a)"}
    assert {event["action"] for event in session.outlook().log if event["event"] == "acted"} == {"(fetch box-a)"}
    session.close()


def test_an_idle_robot_is_not_busy_elsewhere() -> None:
    """The reason that holds is the cost; with all robots at work, it is that they are at work."""
    table = kit("paper")
    for robots, busy in ((2, False), (1, True)):
        setting = Setting(c_suggest=0.2, c_move=0.1)
        desk = Assistant(table, ["ann", "ben", "cleo"], setting=setting, robots=robots)
        for action in ("(fetch box-a)", "(place hammer slot-3 box-a)"):
            desk.observe("ann", action)
        desk.observe("ben", "(fetch box-a)")
        assert [desk.recommend(number).person for number in range(1, robots + 1)] == ["ann", None][:robots]
        assert ("Somebody else has my attention" in desk.explain("cleo").text()) == busy
        assert "the hint costs 0.2" in desk.explain("cleo").text()


def test_a_number_far_ahead_is_no_reason_to_wait() -> None:
    order = InOrder[int]()
    assert order.take(1, 1) == [1]
    far = FAR + 3
    assert not order.jumps(far - 1)  # as many may be under way
    assert order.jumps(far)
    assert list(order.missing(far)) == list(range(2, far))
    assert order.take(2, 2) == [2]  # the numbers go on
    assert order.take(4, 4) == []
    assert order.jumps(1000)
    assert order.jumps(1000)  # repeated, it still stands alone
    assert not order.jumps(1001)  # the sender goes on from there
    assert order.take(1001, 1001) == [4, 1001]
    assert order.late(1000)
    assert order.take(1002, 1002) == [1002]


def test_a_gap_in_numbers_is_answered_and_the_line_goes_on(tmp_path: Path, broker: Broker) -> None:
    here, answers = Here(tmp_path / "session", ["ann"]), dict[str, dict[str, Any]]()

    async def work() -> None:
        async with broker.client() as client:
            await client.subscribe("line/ann/answers", qos=1)
            while not here.bridge.connected:
                await asyncio.sleep(0.02)

            async def asks(number: int, action: str) -> dict[str, Any]:
                body = {"action": action, "id": f"s{number}", "n": number}
                await client.publish("line/ann/action", json.dumps(body), qos=1)
                while f"s{number}" not in answers:
                    answer = json.loads((await anext(client.messages)).payload)
                    answers[answer["id"]] = answer
                return answers.pop(f"s{number}")

            assert (await asks(1, "(fetch box-a)"))["status"] == "recorded"
            refused = await asks(99, "(return box-a)")
            assert refused["status"] == "refused"
            assert refused["detail"] == "number 99: the numbers 2 to 98 did not arrive; expected 2"
            assert (await asks(2, "(return box-a)"))["status"] == "recorded"
            assert (await asks(3, "(fetch box-b)"))["status"] == "recorded"
            assert (await asks(200, "(return box-b)"))["status"] == "refused"  # a station whose count was set anew
            assert (await asks(201, "(return box-b)"))["status"] == "recorded"
            assert (await asks(202, "(fetch box-b)"))["status"] == "recorded"

    here.run(settings_file(tmp_path, broker), work)


def test_what_keeps_events_from_being_saved_is_shown_to_the_operator(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    web = Web(kit("tiny"), tmp_path)
    with web.client:
        assert web.ask("GET", "/api/team", None).json()["problems"] == []

        def full(*_: Any, **__: Any) -> None:
            raise JournalError(28, "No space left on device; nothing was recorded", "journal.sqlite")

        with monkeypatch.context() as patch:
            patch.setattr(web.service.session._store, "add", full)
            refused = web.ask("POST", "/api/team/people", None, json={"person": "eve"})
            assert (refused.status_code, refused.json()["detail"]) == (
                507, "No space left on device; nothing was recorded",
            )  # fmt: skip
            problems = web.ask("GET", "/api/team", None).json()["problems"]
        assert problems == ["events cannot be saved: No space left on device at the last attempt"]
        assert web.ask("POST", "/api/team/people", None, json={"person": "eve"}).status_code == 200
        assert web.ask("GET", "/api/team", None).json()["problems"] == []


def test_a_session_goes_on_with_as_many_people_as_it_began_with(tiny: Table, tmp_path: Path) -> None:
    """Whoever was added, removed or erased later; a mistyped number is refused, and nothing is changed."""

    def served(humans: int) -> Session:
        people = {f"person-{number}": "tiny" for number in range(1, humans + 1)}
        options: Any = {"policy": "attention", "setting": LiveSetting(), "population": EASY, "distance": None}
        options |= {"simulated": ()}
        team = ServedTeam({"tiny": tiny}, tmp_path, people, **options)
        return team.session()

    session = served(3)
    session.join("person-4")  # before anything else has happened
    session.join("eve")
    session.leave("person-2")
    session.close()
    for humans in (1, 2, 4, 30):
        with pytest.raises(InputFileError, match=f"has humans 3, not {humans}"):
            served(humans)
    session = served(3)
    assert session.people == ("person-1", "person-3", "person-4", "eve")
    session.erase("person-3", "as asked")
    session.close()
    served(3).close()
    with pytest.raises(InputFileError):
        served(5)


def test_an_event_carries_a_persons_name_in_one_form() -> None:
    assert Acted(person=" Zoe\u0308 ").person == Acted(person="Zo\u00eb").person == "Zo\u00eb"
    assert Elapsed().who is None
