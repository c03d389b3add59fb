"""A hostile visitor of a user study: every attack is refused in one sentence, and the study is undisturbed."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

from streams import opened
from test_userstudy_pages import Web
from userstudies import SCORES, WITHOUT_PRACTICE

from assist.web.cookies import cookie_of
from assist.web.request_limits import Allowance
from assist.web.tokens import VISITOR
from planner import Table

SCRIPT, FORMULA = "<script>alert(1)</script>", '=HYPERLINK("http://evil.example";"x")'
CONNECTIONS = 8
BURST = 60  # requests at once of one caller, fewer than by default, so that a flood is short


def test_a_hostile_visitor_is_refused_and_disturbs_nobody(tiny: Table, tmp_path: Path) -> None:
    web = Web(
        tiny, tmp_path, WITHOUT_PRACTICE, allowance=Allowance(burst=BURST, clock=lambda: 0.0), connections=CONNECTIONS
    )
    with web.client:
        attacks(web, tiny)


def attacks(web: Web, table: Table) -> None:
    ask, key = web.ask, {"key": "k" * 24}

    def joins(**body: Any) -> Any:
        return ask("POST", "/api/study/seats", VISITOR, json=body)

    eve = joins(id="eve").json()["person"]  # before there are signed links
    links = ask("POST", "/api/study/links", json={"participants": ["7", "8"]}).json()["links"]
    seven, eight = (parse_qs(urlsplit(link).query)["signature"][0] for link in links.values())
    ann = joins(id="participant 7", signature=seven).json()["person"]
    own, hers = f"/api/people/{ann}", f"/api/study/participants/{ann}"
    mine = f"/api/study/participants/{eve}"
    assert web.onward(ann, "consent", id="once").status_code == 200
    named = {
        "Cookie": f"{cookie_of(web.access.base, f'person {ann}')}={web.access.token(ann)}",
        "Kitassist-Caller": f"person%20{ann}",
    }
    cross = {**named, "Origin": "https://evil.example", "Sec-Fetch-Site": "cross-site"}

    def raw(method: str, path: str, **more: Any) -> Callable[[], Any]:
        return lambda: web.client.request(method, path, **more)

    def by(who: str | None, method: str, path: str, **body: Any) -> Callable[[], Any]:
        return lambda: ask(method, path, who, **({"json": body} if body else {}))

    refused: dict[str, tuple[int, Callable[[], Any]]] = {
        # Other people's rows.
        "no token": (401, raw("GET", own)),
        "everybody's data without a token": (401, raw("GET", "/api/study/export")),
        "the form without a token": (401, raw("GET", "/api/study/form")),
        "a guessed token": (401, raw("GET", own, headers={"Authorization": "Bearer " + "a" * 32})),
        "another's view": (403, by(eve, "GET", own)),
        "another's view by the join link": (403, by(VISITOR, "GET", own)),
        "another's drawing": (403, by(eve, "GET", f"{own}/drawing")),
        "another's action": (403, by(eve, "POST", f"{own}/actions", action="(fetch box-a)")),
        "another's progress": (403, by(eve, "POST", f"{hers}/onward", stage="instructions")),
        "another's withdrawal": (403, by(eve, "POST", f"{hers}/withdraw")),
        "another's withdrawal code": (403, by(eve, "GET", f"{hers}/withdrawal")),
        "a guessed withdrawal code": (404, by(VISITOR, "POST", "/api/study/withdrawals", code=f"{ann}-22222222")),
        "another's records erased": (403, by(eve, "DELETE", f"{own}/records?reason=x")),
        "another excluded": (403, by(eve, "POST", f"{hers}/exclude", reason="x")),
        "everybody's stages": (403, by(eve, "GET", "/api/study")),
        "everybody's data": (403, by(eve, "GET", "/api/study/export")),
        "everybody's data by a guessed link": (404, raw("GET", "/study/export/x")),
        "everybody's actions": (403, by(eve, "GET", "/api/log")),
        "the secret by its path": (404, raw("GET", "/study/pages/..%2f..%2f..%2fsecret")),
        # Seats.
        "a seat by its ID": (403, lambda: joins(id="participant 7")),
        "a seat by its ID and a key": (409, lambda: joins(id="participant 7", **key)),
        "a seat by a forged signature": (403, lambda: joins(id="participant 7", signature="a" * 32)),
        "a seat by another's signature": (403, lambda: joins(id="participant 7", signature=eight)),
        "signed links": (403, by(VISITOR, "POST", "/api/study/links", participants=["9"])),
        "a second seat": (403, by(eve, "POST", "/api/study/seats", id="second")),
        "a simulated seat": (403, lambda: joins(id="bot", simulated=True)),
        # Replay, and stages out of order.
        "a stage again": (409, by(ann, "POST", f"{hers}/onward", stage="consent")),
        "the last stage at once": (409, by(eve, "POST", f"{mine}/onward", stage="thanks")),
        "an action before the task": (409, by(eve, "POST", f"/api/people/{eve}/actions", action="(fetch box-a)")),
        "an undone action": (404, by(eve, "POST", f"/api/people/{eve}/undo")),
        "a drawing before the task": (409, by(eve, "GET", f"/api/people/{eve}/drawing")),
        "a person who is added as to a team": (404, by(None, "POST", "/api/team/people", person="mallory")),
        "a pause as of a team": (404, by(None, "POST", "/api/team/pause", paused=True)),
        "a number as a stage": (422, by(eve, "POST", f"{mine}/onward", stage=1)),
        # What is too large or of another form.
        "answers where none are asked": (422, by(eve, "POST", f"{mine}/onward", stage="consent", answers={"a": 1})),
        "markup as a stage": (409, by(eve, "POST", f"{mine}/onward", stage=SCRIPT)),
        "markup as a code": (404, by(VISITOR, "POST", "/api/study/withdrawals", code=SCRIPT)),
        "markup as a participant": (404, by(None, "GET", f"/api/people/{SCRIPT.replace('/', '%2F')}")),
        # Another site's page, in the browser of a participant.
        "a cross-site post": (403, raw("POST", f"{hers}/withdraw", headers=cross)),
        "a cross-site form": (403, raw("POST", f"{hers}/withdraw", headers=cross, data={"a": "b"})),
        "a cross-site reading": (403, raw("GET", own, headers=cross)),
    }  # fmt: skip
    events, view = ask("GET", "/api/study").json()["events"], ask("GET", own, ann).json()
    assert len(refused) >= 30
    for name, (status, attack) in refused.items():
        answer = attack()
        assert answer.status_code == status, (name, answer.status_code, answer.text[:200])
        said = answer.json()
        assert set(said) == {"detail"}, name
        assert "\n" not in said["detail"].strip(), name
        assert 5 < len(said["detail"]) < 300, (name, said)
        assert "Traceback" not in said["detail"]

    for headers in (bearer(web, eve), cross):
        with opened(web.client, f"/api/people/{ann}/events", headers) as refusal:
            assert refusal.status == 403

    # Floods: of a participant's streams, and of requests. Neither stops another participant.
    with ExitStack() as held:
        statuses = [200]
        while statuses[-1] == 200:
            statuses.append(
                held.enter_context(opened(web.client, f"/api/people/{eve}/events", bearer(web, eve))).status
            )
        assert statuses[1:] == [200] * CONNECTIONS + [429]
    flood = [web.client.get(own).status_code for _ in range(2 * BURST)]
    assert flood[-1] == 429
    assert "too many requests" in web.client.get(own).json()["detail"]

    # Nothing has changed, a repeated request has one effect, and the participant goes on to the end.
    assert ask("GET", own, ann).json() == view
    assert ask("GET", "/api/study").json()["events"] == events
    web.onward(ann, "consent", id="once")
    assert ask("GET", own, ann).json() == view
    web.onward(ann, "instructions")
    for action in table.optimal_plan(table.initial) or ():
        assert ask("POST", f"{own}/actions", ann, json={"action": action}).status_code == 200
    web.onward(ann, "task tiny")
    bad = [{}, {"mental": SCRIPT}, {**SCORES["nasa-tlx"], "mental": 105}, {**SCORES["nasa-tlx"], FORMULA: 5}]
    for answers in bad:
        answer = web.onward(ann, "questionnaire nasa-tlx", answers=answers)
        assert (answer.status_code, set(answer.json())) == (422, {"detail"})
        assert answer.json()["detail"].startswith("answers.")
    web.onward(ann, "questionnaire nasa-tlx", answers=SCORES["nasa-tlx"])
    web.onward(ann, "questionnaire trust", answers=SCORES["trust"])
    too_long = web.onward(ann, "questionnaire remarks", answers={"remarks": "x" * 4001})
    assert too_long.json()["detail"] == "answers.remarks: expected a text of at most 4,000 characters"
    done = web.onward(ann, "questionnaire remarks", answers={"remarks": FORMULA + SCRIPT})
    assert done.json()["study"]["kind"] == "thanks"
    packed = zipfile.ZipFile(io.BytesIO(ask("GET", "/api/study/export").content))
    everything = {name: packed.read(name).decode() for name in packed.namelist() if name.endswith(".csv")}
    people = everything["participants.csv"].splitlines()[1:]
    assert [(row.split(",")[0], row.split(",")[1]) for row in people] == [(eve, "false"), (ann, "false")]
    cells = [cell for name, text in everything.items() for row in text.splitlines() for cell in row.split(",")]
    assert any(cell.startswith("\"'=HYPERLINK") for cell in cells)  # a text, not a formula
    assert not any(cell.startswith(("=", '"=')) for cell in cells)
    assert json.loads(done.text)["study"]["completion"] in everything["participants.csv"]


def bearer(web: Web, who: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {web.access.token(who)}", "Content-Type": "application/json"}
