"""Erasure and withdrawal of a running service: what the person said is in no byte of its folder or of its log."""

from __future__ import annotations

import json
import signal
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pytest
from serving import served
from test_event_store import content
from test_userstudy_report import run
from userstudies import PLAN, SCORES, written

from assist.studies.userstudy import StudySession, read
from planner import Table

WORDS = "Quittenmus am Dienstag"
NAME = "Zdenka Ungewöhnlich"


def bytes_of(text: str) -> set[bytes]:
    """Return a text in the forms in which it could be stored: as UTF-8, escaped as in JSON, and in an address."""
    return {text.encode(), json.dumps(text)[1:-1].encode(), quote(text).encode(), text.encode("utf-16-le")}


def assert_no_trace(*texts: str, folder: Path, said: str = "") -> None:
    everything = content(folder) + said.encode()
    assert [one for text in texts for one in bytes_of(text) if one in everything] == []


@pytest.mark.slow
@pytest.mark.parametrize("ends", [signal.SIGTERM, signal.SIGKILL], ids=["stopped", "killed"])
def test_who_is_erased_is_in_no_byte_of_a_team(tmp_path: Path, ends: signal.Signals) -> None:
    """The journal, its log, the store of people, and what the service says on stderr, also of what it refused."""
    people = f"people_store={tmp_path / 'people.sqlite'}"
    options = (*["--humans", "1", "--set", "tick=3600", "--set"], people, "--data", tmp_path / "data")
    with served(*options, "--log-format", "json") as team:
        added = team.ask("POST", "/api/team/people", json={"person": NAME})
        assert added.status_code == 200, added.text
        path = f"/api/people/{NAME}"
        for number, action in enumerate(("(fetch box-a)", "(return box-a)", "(fly away)", "(fetch box-b)")):
            answer = team.ask("POST", f"{path}/actions", json={"action": action, "id": f"zdenkas-{number}"})
            assert answer.status_code == (422 if "fly" in action else 200), answer.text
        assert team.ask("GET", f"{path}/explanation").status_code == 200
        assert team.ask("POST", f"{path}/undo", json={"id": "zdenkas-9"}).status_code == 200
        assert NAME.encode() in content(tmp_path)
        erased = team.ask("DELETE", f"{path}/records", params={"reason": "wrote a letter"})
        assert erased.status_code == 200, erased.text
        assert_no_trace(NAME, "zdenkas-", folder=tmp_path)  # at once, while it runs
        assert team.ask("GET", "/api/team").status_code == 200
        _, said = team.end(ends)
    assert '"event": "acted"' in said  # the log has been kept
    assert_no_trace(NAME, "zdenkas-", folder=tmp_path, said=said)
    with served(*options) as team:
        assert NAME not in json.dumps(team.ask("GET", "/api/team").json(), ensure_ascii=False)
        assert team.ask("POST", "/api/people/person-1/actions", json={"action": "(fetch box-a)"}).status_code == 200
    assert_no_trace(NAME, "zdenkas-", folder=tmp_path)


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_who_withdraws_is_in_no_byte_of_a_study(tiny: Table, tmp_path: Path) -> None:
    """The journal, the export and the report within the folder, and the log; the rows of others stay."""
    file = written(tmp_path / "study.toml", PLAN.replace("simulated = 2", "simulated = 1"))
    data = tmp_path / "data"
    with served("--study", file, "--data", data, "--log-format", "json", instance=None) as study:

        def takes_part(words: str) -> str:
            seat = study.ask("POST", "/api/study/seats", "everybody", json={"id": f"a visit {words}"})
            assert seat.status_code == 200, seat.text
            person = str(seat.json()["person"])
            view: Any = study.ask("GET", f"/api/people/{person}").json()
            while view["study"]["kind"] != "thanks":
                at = view["study"]
                if at["kind"] in ("practice", "task"):
                    for action in tiny.optimal_plan(tiny.initial) or ():
                        assert study.ask("POST", f"/api/people/{person}/actions", json={"action": action}).is_success
                answers = {"remarks": words} if at["what"] == "remarks" else SCORES.get(at["what"])
                body = {"stage": at["stage"], "answers": answers if at["kind"] == "questionnaire" else None}
                answer = study.ask("POST", f"/api/study/participants/{person}/onward", json=body)
                assert answer.status_code == 200, answer.text
                view = answer.json()
            return person

        leave = {how: takes_part(f"{WORDS} {how}") for how in ("withdraw", "code", "erase")}
        stays = takes_part("die Worte der anderen")
        run("study-report", data)
        gone: list[str] = []
        for how, person in leave.items():
            (data / "user-study.zip").write_bytes(study.ask("GET", "/api/study/export").content)
            words, path = f"{WORDS} {how}", f"/api/study/participants/{person}"
            assert words.encode() in content(data)
            completion = study.ask("GET", f"/api/people/{person}").json()["study"]["completion"]
            if how == "withdraw":
                answer = study.ask("POST", f"{path}/withdraw", json={})
            elif how == "code":
                code = study.ask("GET", f"{path}/withdrawal").json()["code"]
                answer = study.ask("POST", "/api/study/withdrawals", "everybody", json={"code": code})
            else:
                answer = study.ask("DELETE", f"/api/people/{person}/records", params={"reason": "a letter"})
            assert answer.status_code == 200, answer.text
            gone += [words, completion, *([person] if how == "erase" else [])]
            assert_no_trace(*gone, folder=data)
            assert not (data / "user-study.zip").exists()
        _, said = study.end(signal.SIGKILL)
    assert_no_trace(*gone, folder=data, said=said)
    assert not any(person in said for person in leave.values())
    assert b"die Worte der anderen" in content(data)
    with closing(StudySession(read(file), {"tiny": tiny, "practice": tiny}, data)) as again:
        assert again.person(stays)["study"]["kind"] == "thanks"
        assert [again.person(leave[how])["study"]["kind"] for how in ("withdraw", "code")] == ["withdrew"] * 2
        assert leave["erase"] not in again.people
    assert_no_trace(*gone, folder=data)
