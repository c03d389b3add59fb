"""What a visitor could learn or bend by addresses, headers and comparisons: nothing about others, and no link."""

from __future__ import annotations

import asyncio
import hmac
import io
import json
import re
import zipfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, quote, urlsplit

import pytest
from conftest import ROOT
from streams import opened
from test_cases_study_identities import signature_of
from test_userstudy_pages import Web
from userstudies import SCORES, WITHOUT_PRACTICE
from uvicorn.middleware.proxy_headers import ProxyHeadersMiddleware

from assist.studies.userstudy.codes import LETTERS
from assist.web.cookies import cookie_of
from assist.web.request_limits import LARGEST, Allowance, address_of, networks
from assist.web.tokens import VISITOR, AccessTokens
from planner import Table

SCRIPT = "<script>alert(1)</script>"


@pytest.fixture
def web(tiny: Table, tmp_path: Path) -> Any:
    found = Web(tiny, tmp_path, allowance=Allowance(burst=10_000))
    with found.client:
        yield found


def test_nobody_learns_which_codes_there_are(web: Web) -> None:
    """The answer is the same whether a participant exists or not, for people's data and for withdrawal codes."""
    ann, eve = map(web.take_part, ("ann", "eve"))
    nobody = "P-" + "".join(letter for letter in LETTERS if letter not in ann)[:6]
    paths = [f"/api/people/{{}}{rest}" for rest in ("", "/drawing", "/explanation")]
    for path in [*paths, "/api/study/participants/{}/withdrawal"]:
        answers = [web.ask("GET", path.format(name), eve) for name in (ann, nobody)]
        assert {(one.status_code, one.text) for one in answers} == {(answers[0].status_code, answers[0].text)}
        assert answers[0].status_code == 403
    real = web.service.withdrawal_code(ann)
    codes = [real[:-1] + ("2" if real[-1] != "2" else "3"), f"{nobody}-{real.rpartition('-')[2]}"]
    codes += [ann, "P-", "-", f"{ann}-"]
    codes += [f"{ann}-{'2' * n}" for n in (1, 7, 9, 40)]
    said = {(one.status_code, one.text) for one in (
        web.ask("POST", "/api/study/withdrawals", VISITOR, json={"code": code}) for code in codes
    )}  # fmt: skip
    assert len(said) == 1
    assert web.ask("POST", "/api/study/withdrawals", VISITOR, json={"code": f"  {real.lower()} "}).status_code == 200


def test_secrets_are_compared_in_constant_time(web: Web, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tokens, signatures and withdrawal codes: no answer comes earlier because the first letters are wrong."""
    compared: list[tuple[bytes, bytes]] = []
    compare = hmac.compare_digest
    monkeypatch.setattr(hmac, "compare_digest", lambda a, b: compared.append((a, b)) or compare(a, b))
    ann = web.take_part("ann")
    code = web.service.withdrawal_code(ann)
    for guess in (code, code[:-1] + "2", "2" + code[1:], "x"):
        compared.clear()
        web.ask("POST", "/api/study/withdrawals", VISITOR, json={"code": guess})
        assert any(guess.upper().encode() in pair for pair in compared), guess
    named, signature = signature_of(web, "7")
    for guess in (signature, "a" + signature[1:], ""):
        compared.clear()
        body = {"id": f"participant {named}", "signature": guess}
        web.ask("POST", "/api/study/seats", VISITOR, json=body)
        assert any(guess.encode() in pair for pair in compared), guess
    # Tokens are found by their digest, about which the time of a look-up says nothing.
    compared.clear()
    assert web.access.whose(web.access.token(ann)) is not None
    assert compared
    assert web.access.whose("x" * 32) is None


def test_tokens_of_another_study_or_another_use_open_nothing(web: Web) -> None:
    ann = web.take_part("ann")
    foreign = AccessTokens(b"k" * 32, web.access.base)
    own = web.access
    tokens = [foreign.operator, foreign.token(ann), own.signature(f"person {ann}"), own.signed("seat", ann)]
    tokens += [own.token(ann)[:-1], own.token(ann).lower(), own.token(ann) + "=", own.token(ann.lower())]
    for token in tokens:
        headers = {"Authorization": f"Bearer {token}"}
        assert web.client.get(f"/api/people/{ann}", headers=headers).status_code in (401, 403), token
        assert web.client.get("/api/study", headers=headers).status_code in (401, 403), token
    for scheme in ("Basic", "Token", "", "Bearer Bearer"):
        headers = {"Authorization": f"{scheme} {own.operator}"}
        assert web.client.get("/api/study", headers=headers).status_code == 401
    asked = web.client.get(f"/api/study?token={own.operator}&access_token={own.operator}")
    assert asked.status_code == 401  # a token in an address would be in the log of a proxy


PATHS = (
    "/pages/..%2f..%2fserver.py", "/pages/..%2fapp.py", "/pages/%2e%2e%2fapp.py", "/pages/....//app.py", "/pages/.",
    "/study/pages/..%2froutes.py", "/study/pages/..%5croutes.py", "/study/pages//etc/passwd", "/pages/%2fetc%2fpasswd",
    "/pages/worker.js%00.css", "/pages/head.html", "/pages/worker.html", "/study/pages/part.html", "/secret",
    "/journal.sqlite", "/data/journal.sqlite", "/study.toml", "/..%2fstudy.toml", "/study/pages/../../../secret",
)  # fmt: skip


def test_no_path_leads_to_another_file(web: Web) -> None:
    for path in PATHS:
        answer = web.client.get(path)
        assert answer.status_code == 404, path
        assert "import" not in answer.text
        assert "CREATE TABLE" not in answer.text
    ann = web.take_part("ann")
    for language in ("../../study.toml", "/etc/passwd", "study.toml", "de.toml", "xx", "de\x00", SCRIPT):
        path = f"/api/people/{ann}/explanation?language={quote(language)}"
        assert web.ask("GET", path).status_code in (409, 422), language


@pytest.mark.parametrize("kind", ["join", "part", "study", "operator"])
def test_what_stands_in_an_address_is_not_in_its_page(web: Web, kind: str) -> None:
    """Pages are the same for every name; nothing of the address is in their text or in their headers."""
    for name in (SCRIPT, "a\r\nSet-Cookie: x=1", "{texts}", "{study.title}", "\u202e", '"><img src=x>'):
        rest = f"?participant={quote(name)}" if kind in ("study", "operator") else f"/{quote(name, safe='')}"
        answer = web.client.get(f"/{kind}{rest}")
        assert name not in answer.text
        assert "x=1" not in str(answer.headers)
        assert "script-src 'self';" in answer.headers["content-security-policy"]


def test_no_header_bends_a_link_or_names_another_address(web: Web) -> None:
    forged = {"Host": "evil.example", "X-Forwarded-Host": "evil.example", "Forwarded": "host=evil.example"}
    forged |= {"X-Forwarded-Prefix": "/evil", "X-Original-URL": "/api/study", "X-HTTP-Method-Override": "DELETE"}
    ann = web.take_part("ann")
    headers = {"Authorization": f"Bearer {web.access.operator}", **forged}
    links = web.client.post("/api/study/links", headers=headers, json={"participants": ["7"]})
    assert "evil" not in links.text
    withdrawal = web.client.get(f"/api/study/participants/{ann}/withdrawal", headers=headers)
    assert "evil" not in withdrawal.text
    page = web.client.get("/study", headers=forged)
    assert "evil" not in page.text
    own = {"Authorization": f"Bearer {web.access.token(ann)}", **forged}
    assert web.client.get(f"/api/people/{ann}", headers=own).status_code == 200  # read, not deleted
    assert web.client.get("/api/study", headers=own).status_code == 403


def test_bodies_of_every_size_and_kind_are_refused_before_they_are_kept(web: Web) -> None:
    ann = web.take_part("ann")
    headers = {"Authorization": f"Bearer {web.access.token(ann)}", "Content-Type": "application/json"}
    path = f"/api/study/participants/{ann}/onward"

    def parts(size: int) -> Any:
        return (b"x" * 1000 for _ in range(size // 1000))

    kinds: dict[str, tuple[Any, dict[str, str], int]] = {
        "one byte too many": (b" " * (LARGEST + 1), {}, 413),
        "without a length": (parts(4 * LARGEST), {}, 413),
        "a length that is a lie": (b"{}", {"Content-Length": "99999999999999"}, 413),
        "a length that is no number": (b"{}", {"Content-Length": "-1"}, 422),
        "a deep list": (b"[" * 30_000, {}, 422),
        "deep answers": (b'{"stage": "consent", "answers": {"a": ' + b"[" * 500 + b"]" * 500 + b"}}", {}, 422),
        "no text": (b"\xff\x00", {}, 422),
        "a long number": (b'{"stage": ' + b"1" * 6000 + b"}", {}, 400),
        "not a number": (b'{"stage": NaN}', {}, 422),
        "two stages": (b'{"stage": "thanks", "stage": "task tiny"}', {}, 409),
        "a form": (b"stage=consent", {"Content-Type": "application/x-www-form-urlencoded"}, 422),
        "a file": (b"--x\r\n", {"Content-Type": "multipart/form-data; boundary=x"}, 422),
        "compressed": (b"\x1f\x8b" + bytes(50), {"Content-Encoding": "gzip"}, 422),
    }  # fmt: skip
    before = web.ask("GET", "/api/study").json()["events"]
    for name, (content, more, status) in kinds.items():
        answer = web.client.post(path, content=content, headers=headers | more)
        assert answer.status_code in (status, 400, 422 if status != 413 else 413), (name, answer.text)
        assert set(answer.json()) == {"detail"}, name
        assert "\n" not in answer.json()["detail"].strip(), name
        assert len(answer.json()["detail"]) < 300, name
    for method in ("PUT", "PATCH", "TRACE", "CONNECT", "OPTIONS", "HEAD", "PROPFIND"):
        answer = web.client.request(method, path, headers=headers)
        assert answer.status_code in (404, 405), method
    assert web.ask("GET", "/api/study").json()["events"] == before
    assert web.onward(ann, "consent").status_code == 200


@pytest.mark.parametrize(
    ("path", "body", "why"),
    [
        ("withdrawals", {"kode": "x"}, "kode: unknown; did you mean 'code'?"),
        ("withdrawals", {}, "code: is missing; expected a text"),
        ("withdrawals", {"code": 7}, "code 7: expected a text"),
        ("links", {"participants": "ann"}, "participants 'ann': expected a list of texts"),
        ("seats", {"id": "7", "simulated": 1}, "simulated 1: expected"),
    ],
)
def test_a_fault_in_a_body_is_told_as_everywhere(web: Web, path: str, body: dict[str, Any], why: str) -> None:
    answer = web.ask("POST", f"/api/study/{path}", None if path == "links" else VISITOR, json=body)
    assert answer.status_code == 422
    assert why in answer.json()["detail"]


def test_a_page_cannot_be_framed_and_its_address_goes_nowhere(web: Web) -> None:
    pages = ("/", "/study", "/study/operator", "/part/P-2B4C6D", "/join/P-2B4C6D", "/docs", "/nowhere")
    for path in (*pages, "/api/me", "/openapi.json"):
        headers = web.client.get(path).headers
        policy = headers["content-security-policy"]
        assert policy.startswith("default-src 'none'; script-src 'self'")
        assert "frame-ancestors 'none'" in policy, path
        assert "'unsafe-inline'" not in policy, path
        assert "'unsafe-eval'" not in policy, path
        assert (headers["referrer-policy"], headers["x-content-type-options"]) == ("no-referrer", "nosniff")
        assert headers["cache-control"] == "no-store"
        assert "access-control-allow-origin" not in headers
        assert "server" not in headers


INLINE = re.compile(
    r"<script(?![^>]*\bsrc=)(?![^>]*application/json)|\son\w+\s*=\s*[\"']|javascript:|style\s*=\s*[\"']", re.I
)


def test_no_shipped_page_has_a_script_or_a_style_within_an_element() -> None:
    root = ROOT / "assist"
    files = [file for kind in ("*.html", "*.html.jinja") for file in root.rglob(kind)]
    assert len(files) >= 9
    for file in files:
        assert not INLINE.search(file.read_text(encoding="utf-8")), file


def test_the_many_addresses_of_one_household_count_as_one() -> None:
    """Whoever has an IPv6 network has 2^64 addresses, and has not as many attempts at codes and places."""

    def of(address: str, *claims: str, trusted: str = "127.0.0.1") -> str:
        headers, seen = [(b"x-forwarded-for", claim.encode()) for claim in claims], list[str]()

        async def app(scope: Any, *_: Any) -> None:
            seen.append(address_of(scope))

        scope = {"type": "http", "client": (address, 1), "headers": headers}
        asyncio.run(ProxyHeadersMiddleware(app, list(networks([trusted])))(scope, None, None))
        return seen[0]

    one = {of(f"2001:db8:0:7:{n:x}::{n:x}") for n in range(1, 50)}
    assert one == {"2001:db8:0:7::/64"}
    assert of("2001:db8:0:8::1") not in one
    assert of("127.0.0.1", "2001:db8:0:7::9") in one
    assert of("::1", "2001:db8:0:7::9", trusted="::1") in one
    assert of("192.0.2.1") == of("::ffff:192.0.2.1") == "192.0.2.1"
    assert of("192.0.2.1") != of("192.0.2.2")
    assert of("testclient") == "testclient"


# A hostile visitor of a user study: every attack is refused in one sentence, and the study is undisturbed.


FORMULA = '=HYPERLINK("http://evil.example";"x")'
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
