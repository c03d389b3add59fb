"""Nobody takes part twice, nobody takes the places of others, and identifiers are the same however they are copied."""

from __future__ import annotations

import asyncio
import csv
import io
import time
import unicodedata
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import pytest
from hypothesis import given
from hypothesis import strategies as st
from starlette.testclient import TestClient
from streams import watching
from test_userstudy_pages import Web
from userstudies import PLAN, WITHOUT_PRACTICE

from assist.declare import catalogue
from assist.studies.userstudy.codes import identifier
from assist.studies.userstudy.csv_tables import is_formula, written
from assist.web import request_limits
from assist.web.request_limits import Allowance
from assist.web.tokens import VISITOR, AccessTokens
from planner import Table

KEY = {"key": "k" * 24}
FEW = PLAN.replace("seed = 3", "seed = 3\nparticipants = 3")


def joins(web: Web, **body: Any) -> Any:
    return web.ask("POST", "/api/study/seats", VISITOR, json=body)


def signature_of(web: Web, participant: str) -> tuple[str, str]:
    """Return the participant and the signature in the link that the operator makes."""
    made = web.ask("POST", "/api/study/links", json={"participants": [participant]}).json()["links"][participant]
    query = parse_qs(urlsplit(made).query)
    return query["participant"][0], query["signature"][0]


SAME = [
    "7a", " 7a", "7a ", "7a\u00a0", "\u30007a", "7\u200ba", "\ufeff7a", "\uff17\uff41", "7a\u2060", "7\u00ada",
    "7a\x00", "\t7a\n",
]  # fmt: skip


def test_an_id_is_the_same_however_it_was_copied(tiny: Table, tmp_path: Path) -> None:
    """Blanks around it, invisible signs, other forms of the same signs, and what is composed or not."""
    assert {identifier(one) for one in SAME} == {"7a"}
    assert identifier("Zoe\u0308") == identifier("Zo\u00eb") == "Zo\u00eb"
    assert identifier("a  b") == "a b"
    assert identifier(" \u200b\u3000") == ""
    assert identifier("A7") != identifier("a7")  # services distinguish them
    web = Web(tiny, tmp_path)
    with web.client:
        seats = [joins(web, id=f"participant {one}", **KEY).json()["person"] for one in SAME]
        assert len(set(seats)) == 1
        assert web.ask("GET", "/api/study").json()["taken"] == 1
        for nothing in ("participant ", "participant \u200b", "participant \u3000 "):
            refused = joins(web, id=nothing, **KEY)
            assert (refused.status_code, "expected an ID" in refused.json()["detail"]) == (422, True)
        found = {signature_of(web, one) for one in SAME}
        assert len(found) == 1
        ((named, signature),) = found
        assert named == "7a"
        assert joins(web, id="participant 7a\u200b", signature=signature).json()["person"] == seats[0]


@given(st.text(max_size=40))
def test_an_identifier_has_one_form(text: str) -> None:
    once = identifier(text)
    assert identifier(once) == once == once.strip()
    assert unicodedata.is_normalized("NFKC", once)
    assert identifier(f"\u200b {text}\u3000") == once


def test_where_signed_links_were_made_nobody_joins_without_one(tiny: Table, tmp_path: Path) -> None:
    """Neither by leaving out the signature, nor the whole query; who has joined goes on."""
    web = Web(tiny, tmp_path)
    with web.client:
        early = web.come("early").json()
        named, signature = signature_of(web, "7")
        first = joins(web, id=f"participant {named}", signature=signature).json()
        attempts: list[dict[str, Any]] = [
            {"id": "participant 7 8", **KEY}, {"id": "participant 8", **KEY}, {"id": "another browser"},
            {"id": "participant 8", "signature": signature}, {"id": "PARTICIPANT 7"}, {"id": "participant7"},
            {"id": "participant 7", "signature": signature[:-1]}, {"id": "participant 7", "signature": ""},
            {"id": "participant 7", "signature": signature.lower()}, {"id": "participant 7" + "\u0661", **KEY},
        ]  # fmt: skip
        for body in attempts:
            refused = joins(web, **body)
            assert refused.status_code == 403, body
            assert "use the complete link" in refused.json()["detail"]
        assert joins(web, id="participant 7", signature=signature).json() == first
        assert web.come("early").json() == early
        assert web.ask("GET", "/api/study").json()["taken"] == 2
    web = Web(tiny, tmp_path)
    with web.client:  # also after a restart
        assert web.come("another browser").status_code == 403


def test_a_browser_has_one_place_at_a_time(tiny: Table, tmp_path: Path) -> None:
    web = Web(tiny, tmp_path, FEW)
    with web.client:
        token = {"Authorization": f"Bearer {web.access.token(VISITOR)}"}

        def browser(**body: Any) -> Any:
            """The same browser, whose cookies are kept."""
            return web.client.post("/api/study/seats", headers=token, json=body)

        first = browser(id="a tab")
        assert "httponly" in first.headers["set-cookie"].lower()
        assert "samesite=strict" in first.headers["set-cookie"].lower()
        place = first.json()["person"]
        for number in range(20):
            assert browser(id=f"another tab {number}").json()["person"] == place
        refused = browser(id="participant 8", **KEY)
        assert (refused.status_code, refused.json()["detail"]) == (
            409, "another participant has begun in this browser and has not finished",
        )  # fmt: skip
        assert web.ask("GET", "/api/study").json()["taken"] == 1
        kept = dict(web.client.cookies)
        web.onward(place, "consent")
        assert web.ask("POST", f"/api/study/participants/{place}/withdraw", place).status_code == 200
        web.client.cookies.update(kept)
        assert browser(id="the next participant").json()["person"] != place  # in a laboratory
        forged = {name: value.replace(place, place[:-1] + "2") for name, value in kept.items()}
        web.client.cookies.clear()
        web.client.cookies.update(forged)
        assert browser(id="a forger").json()["person"] not in (place, place[:-1] + "2")


def test_places_that_nobody_uses_are_free_again(tiny: Table, tmp_path: Path) -> None:
    """Places of joins without a page, and of tabs that are open but were left alone; not those of a task."""
    web = Web(tiny, tmp_path, FEW.replace("away = 10", "away = 0.03"), check=0.05)
    with web.client:
        assert [web.come(f"flood {number}").status_code for number in range(5)] == [200] * 3 + [409] * 2
        until = time.monotonic() + 20
        while web.come("somebody").status_code != 200 and time.monotonic() < until:
            time.sleep(0.1)
        seat = web.come("somebody").json()
        with watching(web, seat["person"]) as tab:
            kinds = [tab.view()["study"]["kind"]]
            while kinds[-1] != "gone":  # after three times `away` without anything done
                kinds.append(tab.view()["study"]["kind"])
        back = web.ask("POST", f"/api/study/participants/{seat['person']}/return", seat["person"])
        assert back.json()["study"]["kind"] == "consent"


def test_a_machine_cannot_hold_all_places_of_a_public_link(tiny: Table, tmp_path: Path) -> None:
    """A script that renews its requests has as many places as one address may have before a task has begun."""
    web = Web(tiny, tmp_path, WITHOUT_PRACTICE.replace("seed = 3", "seed = 3\nparticipants = 4\nper_address = 2"))
    with web.client:
        script = [web.come(f"script {number}") for number in range(4)]
        assert [answer.status_code for answer in script] == [200, 200, 409, 409]
        assert "try again later" in script[-1].json()["detail"]
        assert all(web.come(f"script {number % 2}").status_code == 200 for number in range(6))  # the same places
        elsewhere = TestClient(web.client.app, client=("192.0.2.7", 1))
        elsewhere.portal = web.client.portal  # the event loop of the service
        headers = {"Authorization": f"Bearer {web.access.token(VISITOR)}"}
        assert elsewhere.post("/api/study/seats", headers=headers, json={"id": "somebody"}).status_code == 200
        ann = script[0].json()["person"]
        stage = "consent"
        while stage != "task tiny":  # whoever works makes room for another one
            stage = web.onward(ann, stage).json()["study"]["stage"]
        assert web.come("another").status_code == 200


def test_withdrawal_codes_cannot_be_tried_at_will(tiny: Table, tmp_path: Path) -> None:
    web = Web(tiny, tmp_path, PLAN.replace("seed = 3", 'seed = 3\nlanguage = "de"'))
    with web.client:
        now = [0.0]
        web.service.guesses = Allowance(rate=1 / 30, burst=20, clock=lambda: now[0])
        ann = web.take_part("ann")
        web.onward(ann, "consent")
        code = web.service.withdrawal_code(ann)

        def tries(code: str) -> Any:
            return web.ask("POST", "/api/study/withdrawals", VISITOR, json={"code": code})

        assert {tries(f"{ann}-{number:08d}").status_code for number in range(20)} == {404}
        refused = tries(code)
        assert (refused.status_code, refused.headers["retry-after"]) == (429, "30")
        assert refused.json()["detail"] == catalogue("de")("refusals.guesses", n="30")
        assert web.ask("GET", f"/api/people/{ann}", ann).json()["study"]["kind"] == "instructions"
        now[0] = 31.0
        assert tries(code).json() == {"done": True}


def test_a_flood_of_joins_is_stopped_and_who_has_joined_goes_on(tiny: Table, tmp_path: Path) -> None:
    web = Web(tiny, tmp_path)
    with web.client:
        now = [0.0]
        web.service.arrivals = Allowance(rate=1.0, burst=5, clock=lambda: now[0])
        seats = [web.come(f"flood {number}") for number in range(8)]
        assert [seat.status_code for seat in seats] == [200] * 5 + [429] * 3
        assert seats[-1].json()["detail"] == "too many participants join at once; try again in 1 seconds"
        assert seats[-1].headers["retry-after"] == "1"
        assert all(web.come("flood 1").json() == seats[1].json() for _ in range(20))  # the page is opened again
        now[0] = 1.5
        assert web.come("another").status_code == 200
        assert web.ask("GET", "/api/study").json()["taken"] == 6


def test_nobody_fills_the_disk_with_actions_and_whoever_does_can_withdraw(tiny: Table, tmp_path: Path) -> None:
    """A script that takes and puts back a box all day; the others act as before."""
    web = Web(tiny, tmp_path)
    with web.client:
        now = [0.0]
        web.service.often = Allowance(rate=1.0, burst=20, clock=lambda: now[0])
        ann, eve = (web.take_part(name, "consent", "instructions") for name in ("ann", "eve"))

        def acts(name: str, number: int) -> int:
            action = ("(fetch box-a)", "(return box-a)")[number % 2]
            return int(web.ask("POST", f"/api/people/{name}/actions", name, json={"action": action}).status_code)

        assert [acts(eve, number) for number in range(20)] == [200] * 17 + [429] * 3
        assert acts(ann, 0) == 200
        now[0] = 2.5
        assert [acts(eve, number) for number in (1, 0, 1)] == [200, 200, 429]
        assert web.ask("POST", f"/api/study/participants/{eve}/withdraw", eve).status_code == 200
        assert acts(ann, 1) == 200


def test_a_body_that_does_not_arrive_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(request_limits, "SLOWEST", 0.05)
    sent: list[Any] = []

    async def app(*_: Any) -> None:
        raise AssertionError("the request is not complete")

    async def receive() -> Any:
        await asyncio.sleep(0.03)  # a byte at a time
        return {"type": "http.request", "body": b"x", "more_body": True}

    async def send(message: Any) -> None:
        sent.append(message)

    access = AccessTokens(b"k" * 32, "http://testserver")
    headers = [(b"authorization", f"Bearer {access.operator}".encode())]
    scope = {"type": "http", "path": "/api/team/people", "method": "POST", "headers": headers, "client": ("::1", 1)}
    asyncio.run(request_limits.Guard(app, access)(scope, receive, send))
    assert sent[0]["status"] == 408
    assert b"the body did not arrive within 0.05 seconds" in sent[1]["body"]
    assert (b"connection", b"close") in sent[0]["headers"]


def test_participants_are_not_told_how_far_they_are_unless_the_study_says_so(tiny: Table, tmp_path: Path) -> None:
    showing = PLAN.replace("seed = 3", "seed = 3\ncost_to_go = true")
    for number, (text, shown) in enumerate(((PLAN, False), (showing, True))):
        folder = tmp_path / str(number)
        folder.mkdir()
        web = Web(tiny, folder, text)
        with web.client:
            ann = web.take_part("ann")
            for stage in ("consent", "instructions"):
                answer = web.onward(ann, stage).json()
            assert (answer["cost_to_go"] is not None) == shown
            path, body = f"/api/people/{ann}/actions", {"action": "(fetch box-a)", "id": "1"}
            acted, again = (web.ask("POST", path, ann, json=body).json() for _ in range(2))
            view = web.ask("GET", f"/api/people/{ann}", ann).json()
            assert {(one["cost_to_go"] is not None) for one in (acted, again, view)} == {shown}
            with watching(web, ann) as tab:
                assert (tab.view()["cost_to_go"] is not None) == shown
            (entry,) = web.ask("GET", "/api/team").json()["people"]
            assert entry["cost_to_go"] is not None  # the researcher sees it


FORMULAS = [
    "=1", "+1", "-1", "@x", "\t=1", " =1", "\u3000=1", "\u00a0 =1", "\u200b=1", "\ufeff=1", "\uff1d1", "\uff0b1",
    "\uff0d1", "\uff20x", "\u3000\uff1d1", "\ufe661", "\u22121", "\n=1", "\r=1", "'=1", "' =1", " '=1", "\u2028=1",
]  # fmt: skip
TEXTS = ["x=1", "a", "", "1=1", "\u00e9", "' a", "3 - 2", "(=1)"]
CELLS = {"=1+1": "'=1+1", "\rx": "'\nx", "a\r\nb": "a\nb", "": "", None: "", -1: "-1", True: "true"}


def test_no_cell_is_a_formula_and_every_text_comes_back() -> None:
    """Spreadsheets skip blanks and invisible signs before a formula, and take full-width signs for the usual ones."""
    for text in FORMULAS:
        assert is_formula(text), ascii(text)
        (cell,) = list(csv.reader(io.StringIO(written(("any",), [{"any": text}]), newline="")))[1]
        assert cell.startswith("'"), ascii(text)
    for text in TEXTS:
        assert not is_formula(text)
    for found, cell in CELLS.items():
        (row,) = list(csv.reader(io.StringIO(written(("any",), [{"any": found}]), newline="")))[1:]
        assert (row or [""]) == [cell]


def test_signs_that_are_no_text_end_no_file() -> None:
    cells = ["a\x00b", "\x00=1", "\x1a", "\ud800", "\x7f", "a\x08b"]
    found = written(("any",), [{"any": cell} for cell in cells])
    assert found.encode("utf-8").count("\ufffd".encode()) == len(cells)
    assert found.splitlines()[1:] == ["a\ufffdb", "\ufffd=1", "\ufffd", "\ufffd", "\ufffd", "a\ufffdb"]


def test_answers_that_are_no_text_are_refused_and_the_export_stays_whole(tiny: Table, tmp_path: Path) -> None:
    """A lone half of a sign outside the basic plane, which JSON can name, cannot be written as UTF-8."""
    first = 'form = "text"\nname = "first"\nwhen = "before"\nitems = [{ name = "first", text = "Why?" }]'
    web = Web(tiny, tmp_path, PLAN.replace('form = "nasa-tlx"', first))
    with web.client:
        ann = web.take_part("ann", "consent", "instructions")
        headers = {"Authorization": f"Bearer {web.access.token(ann)}", "Content-Type": "application/json"}
        path, stage = f"/api/study/participants/{ann}/onward", "questionnaire first"
        for bad in ("\\ud800", "a\\udc00b", "\\u0000", "a\\u0000b"):
            body = f'{{"stage": "{stage}", "answers": {{"first": "{bad}"}}}}'
            refused = web.client.post(path, headers=headers, content=body)
            assert refused.status_code == 422, bad
            assert "answers.first: expected a text" in refused.json()["detail"]
        good = f'{{"stage": "{stage}", "answers": {{"first": "\\ud83d\\ude00 \\u3000=1"}}}}'
        assert web.client.post(path, headers=headers, content=good).status_code == 200
        assert web.ask("GET", "/api/study/export").status_code == 200
