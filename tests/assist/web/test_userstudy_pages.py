"""A user study for participants and the experimenter: the interface, and the pages in a real browser."""

from __future__ import annotations

import hashlib
import hmac
import io
import json
import re
import signal
import time
import zipfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from serving import served
from starlette.testclient import TestClient
from streams import watching
from test_live_pages import violations
from userstudies import PLAN, SCORES, WITHOUT_PRACTICE, written

from assist.declare import catalogue, languages
from assist.studies.userstudy import StudySession, read
from assist.web.app import make_app
from assist.web.request_limits import Allowance
from assist.web.tokens import VISITOR, AccessTokens
from assist.web.user_study.routes import router
from assist.web.user_study.service import StudyService
from planner import Table

LONG = re.compile(r"[\w-]{32}")  # a token in an address
PATIENCE = 60_000  # milliseconds after which an event is taken as missing


class Web:
    """A study in this process."""

    def __init__(
        self, table: Table, folder: Path, text: str = PLAN, *, allowance: Allowance | None = None,
        base: str = "http://testserver", **options: Any,
    ) -> None:  # fmt: skip
        study = read(written(folder / "study.toml", text))
        session = StudySession(study, {"tiny": table, "practice": table}, folder / "data")
        self.access = AccessTokens.kept(folder / "data" / "secret", base)
        self.service = StudyService(session, self.access, **options)
        self.app = make_app(self.service, allowance=allowance, more=[router])
        self.client = TestClient(self.app, raise_server_exceptions=False)

    def ask(self, method: str, path: str, who: str | None = None, **more: Any) -> Any:
        token = self.access.operator if who is None else self.access.token(who)
        self.client.cookies.clear()  # each request is of another browser
        return self.client.request(method, path, headers={"Authorization": f"Bearer {token}"}, **more)

    def come(self, visit: str) -> Any:
        return self.ask("POST", "/api/study/seats", VISITOR, json={"id": visit})

    def take_part(self, visit: str, *stages: str) -> str:
        """Let somebody come and complete these stages; return their code."""
        code = str(self.come(visit).json()["person"])
        for stage in stages:
            assert self.onward(code, stage).status_code == 200
        return code

    def onward(self, code: str, stage: str, **more: Any) -> Any:
        return self.ask("POST", f"/api/study/participants/{code}/onward", code, json={"stage": stage, **more})


@pytest.fixture
def web(tiny: Table, tmp_path: Path) -> Iterator[Web]:
    found = Web(tiny, tmp_path)
    with found.client:
        yield found


def test_everybody_gets_a_place_of_their_own_once(web: Web) -> None:
    with ThreadPoolExecutor(20) as threads:
        seats = list(threads.map(lambda number: web.come(f"visit {number % 20}"), range(40)))
    assert [seat.status_code for seat in seats] == [200] * 40
    assert len({seat.json()["person"] for seat in seats}) == 20  # the same browser twice: the same place
    assert all(seat.json()["part"].startswith(f"/part/{seat.json()['person']}#") for seat in seats)
    assert web.ask("GET", "/api/study").json()["taken"] == 20


def test_the_operator_sees_who_is_simulated_in_a_rehearsal(web: Web) -> None:
    web.service.rehearsal = True
    web.ask("POST", "/api/study/seats", VISITOR, json={"id": "robot", "simulated": True})
    assert [one["simulated"] for one in web.ask("GET", "/api/team").json()["people"]] == [True]
    assert [one["simulated"] for one in web.ask("GET", "/api/study").json()["participants"]] == [True]


def test_a_waiting_room_of_a_hundred_people_is_admitted_at_the_same_second(tiny: Table, tmp_path: Path) -> None:
    """All have the same link and the same network address; here is a twentieth of them, who ask a twentieth as often.

    Guesses of tokens have a limit of their own.
    """
    web = Web(tiny, tmp_path, allowance=Allowance(burst=Allowance().burst / 20, clock=lambda: 0.0))
    with web.client:
        guess = {"Authorization": "Bearer x"}
        assert {web.client.get("/api/study", headers=guess).status_code for _ in range(50)} == {401, 429}
        page = web.client.get("/study")
        pieces = [link for link in re.findall(r'(?:src|href)="([^"]+)"', page.text) if not link.startswith("data:")]
        assert len(pieces) >= 3
        for number in range(5):
            answers = [web.client.get(f"/{piece}") for piece in ["study", *pieces, "pages/connection.js"]]
            answers += [web.ask("POST", "/api/session", VISITOR), web.ask("GET", "/api/me", VISITOR)]
            answers += [web.ask("GET", "/api/study/form", VISITOR), seat := web.come(f"visit {number}")]
            path, _, token = seat.json()["part"].partition("#")
            answers += [web.client.get(path), web.client.get(f"/api/people/{seat.json()['person']}",
                        headers={"Authorization": f"Bearer {token}"})]  # fmt: skip
            assert {answer.status_code for answer in answers} == {200}


def test_without_the_key_nobody_can_connect_ids_and_codes(tiny: Table, tmp_path: Path) -> None:
    """Codes and stored ids follow from the key only, not from anything else in the folder or from the links."""
    key = {"key": "k" * 24}
    found = []
    for attempt in range(3):
        web = Web(tiny, tmp_path)
        with web.client:
            found.append(web.ask("POST", "/api/study/seats", VISITOR, json={"id": "participant 7", **key}).json())
            operator = web.access.operator.encode()
            computed = hmac.new(operator, b"participant 7 " + key["key"].encode(), hashlib.sha256).hexdigest()
            assert computed[16:].encode() not in b"".join(file.read_bytes() for file in web.service.folder.iterdir())
        if attempt == 1:
            (web.service.folder / "codes.key").unlink()
    assert found[0]["person"] == found[1]["person"] != found[2]["person"]
    assert (web.service.folder / "secret").stat().st_mode & 0o077 == 0


def test_data_are_withdrawn_by_code_after_the_end(web: Web) -> None:
    ann, bob = map(web.take_part, ("ann", "bob"))
    path = f"/api/study/participants/{ann}"
    found = web.ask("GET", f"{path}/withdrawal", ann).json()
    assert found["code"].startswith(f"{ann}-")
    assert (found["address"], found["until"]) == (web.service.withdrawal_url(), None)
    assert web.onward(ann, "consent").status_code == 200
    withdrawals = "/api/study/withdrawals"
    for status, who, code in (
        (404, VISITOR, f"{ann}-22222222"), (404, VISITOR, ann), (404, VISITOR, "\u00e9"), (422, VISITOR, ""),
        (403, bob, found["code"]),
    ):  # fmt: skip
        refused = web.ask("POST", withdrawals, who, json={"code": code})
        assert (refused.status_code, set(refused.json())) == (status, {"detail"})
    assert web.ask("GET", f"/api/people/{ann}", ann).json()["study"]["kind"] == "instructions"
    for code in (found["code"], f" {found['code'].lower()}"):  # also as people type it; a second time changes nothing
        assert web.ask("POST", withdrawals, VISITOR, json={"code": code}).json() == {"done": True}
        assert web.ask("GET", f"/api/people/{ann}", ann).json()["study"]["kind"] == "withdrew"
    assert web.ask("POST", f"/api/study/participants/{bob}/exclude", bob, json={"reason": "x"}).status_code == 403
    assert web.ask("POST", f"/api/study/participants/{bob}/exclude", json={"reason": "late"}).json()["person"] == bob
    people = {one["code"]: one["excluded"] for one in web.ask("GET", "/api/study").json()["participants"]}
    assert people == {ann: None, bob: "late"}


def test_a_fault_of_the_program_is_one_sentence_and_stops_nobody(web: Web, monkeypatch: pytest.MonkeyPatch) -> None:
    ann = web.come("ann").json()
    with monkeypatch.context() as patch:
        patch.setattr(type(web.service.session.history), "happen", lambda *_: 1 / 0)
        answer = web.onward(ann["person"], ann["study"]["stage"])
        assert answer.status_code == 500
        assert "ZeroDivisionError" in answer.json()["detail"]
    assert web.onward(ann["person"], ann["study"]["stage"]).status_code == 200


def test_nothing_of_others_of_conditions_and_of_external_names_is_shown(web: Web) -> None:
    ann = web.take_part("ann")
    # Tokens in paths would be in the logs of proxies.
    for path in (
        "/study/x",
        f"/study/{web.access.operator}",
        f"/part/{ann}/{web.access.token(ann)}",
        "/study/export/x",
    ):
        page = web.client.get(path, headers={"Accept": "text/html"})
        assert (page.status_code, "This link is not valid" in page.text) == (404, True)
    seen = web.onward(ann, "consent", id="1").json()
    assert web.onward(ann, "consent", id="1").json() == seen  # a repeated request has one effect
    assert "condition" not in json.dumps(seen)
    packed = zipfile.ZipFile(io.BytesIO(web.ask("GET", "/api/study/export").content))
    assert ann in packed.read("participants.csv").decode()
    web.come("participant 5f3a-of-a-recruiting-service")
    journal = b"".join(file.read_bytes() for file in web.service.folder.glob("journal*"))
    assert b"visited" in journal
    assert b"recruiting" not in journal  # an external name is not stored
    assert web.ask("GET", "/api/team").status_code == 200


def test_whoever_conducts_a_study_sees_which_orders_are_drawn(tiny: Table, tmp_path: Path) -> None:
    web = Web(tiny, tmp_path, PLAN.replace("seed = 3", 'seed = 3\ndesign = "within"'))
    with web.client:
        found = web.ask("GET", "/api/study").json()
    assert found["design"] == "within"
    rows = [(row["name"], row["policy"]) for row in found["conditions"]]
    assert sorted(rows) == [("attention > none",) * 2, ("none > attention",) * 2]


def test_who_is_not_connected_for_long_is_gone_and_may_come_back(tiny: Table, tmp_path: Path) -> None:
    plan = PLAN.replace("away = 10", "away = 0.01").replace("seed = 3", "seed = 3\nparticipants = 1")
    web = Web(tiny, tmp_path, plan, check=0.02)
    with web.client:
        ann = web.take_part("ann")
        path = f"/api/people/{ann}"
        with watching(web, ann) as tab:
            assert tab.view()["study"]["kind"] == "consent"
            time.sleep(0.8)  # longer than away, but connected
            assert web.ask("GET", path, ann).json()["study"]["kind"] == "consent"
        deadline = time.monotonic() + PATIENCE / 1000
        while web.ask("GET", path).json()["study"]["kind"] != "gone":
            assert time.monotonic() < deadline
            time.sleep(0.02)
        assert web.ask("GET", "/api/study").json()["taken"] == 0
        back = web.ask("POST", f"/api/study/participants/{ann}/return", ann).json()
        assert back["study"]["kind"] == "consent"


class Later:
    """An event loop whose clock is ahead."""

    def __init__(self, loop: Any) -> None:
        self._loop, self.seconds = loop, 0.0

    def time(self) -> float:
        return float(self._loop.time()) + self.seconds

    def __getattr__(self, name: str) -> Any:
        return getattr(self._loop, name)


def test_who_works_where_no_connection_can_be_kept_is_present(tiny: Table, tmp_path: Path) -> None:
    web = Web(tiny, tmp_path, check=1e6)  # `away` is ten minutes
    with web.client:
        clock: Any = Later(web.service._loop)
        web.service._loop = clock
        ann, bob = map(web.take_part, ("ann", "bob"))

        def left() -> set[str | None]:
            return {event.person for event in web.service.session.see(web.service._due) if event.kind == "left"}

        assert left() == set()
        for _ in range(2):
            clock.seconds += 6 * 60
            assert web.ask("GET", f"/api/people/{ann}", ann).status_code == 200
            assert web.ask("GET", f"/api/people/{bob}").status_code == 200  # by the experimenter
        assert left() == {bob}
        clock.seconds += 11 * 60
        assert left() == {ann, bob}
        assert web.ask("POST", f"/api/people/{ann}/leave").status_code == 200
        back = web.ask("POST", f"/api/study/participants/{ann}/return")  # by the experimenter, for ann
        assert back.json()["study"]["kind"] == "consent"
        assert left() == {bob}


@pytest.mark.parametrize("language", languages())
@pytest.mark.long
@pytest.mark.slow
def test_a_participant_goes_the_whole_way_though_the_service_is_killed(
    chromium: Any, tmp_path: Path, tiny: Table, language: str
) -> None:
    said = catalogue(language)
    fetch = {"en": "Fetch box-a onto the platform", "de": "box-a auf die Plattform holen"}
    file = written(tmp_path / "study.toml", PLAN.replace("seed = 3", f'seed = 3\nlanguage = "{language}"'))
    options = ("--study", file, "--data", tmp_path / "data")
    context = chromium.new_context(viewport={"width": 360, "height": 740})
    page, faults = context.new_page(), list[str]()
    page.set_default_timeout(PATIENCE)
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.on("request", lambda asked: faults.append(asked.url) if "//127.0.0.1" not in asked.url[:20] else None)
    page.on("request", lambda asked: faults.append(asked.url) if LONG.search(asked.url.partition("#")[0]) else None)

    def named(element: str, key: str) -> str:
        return f'{element}:text("{said(key)}")'

    def work() -> None:
        for action in tiny.optimal_plan(tiny.initial) or ():
            page.click(f'#actions button[data-action="{action}"]:not([disabled])')
        page.wait_for_selector("#onward:not([hidden])")

    def is_well(page: Any = page) -> None:
        """On a desktop and a phone; dark colours are those of all languages."""
        for width, height in ((1280, 800), (360, 740)):
            page.set_viewport_size({"width": width, "height": height})
            assert page.evaluate("document.documentElement.scrollWidth") <= width
        operator = "/operator" in page.url  # whose page is English
        if language == "en" or not operator:
            assert violations(page, dark=language == "en") == []
        assert page.evaluate("document.documentElement.lang") == ("en" if operator else language)

    with ExitStack() as services:
        study = services.enter_context(served(*options, instance=None))
        port = study.url.rsplit(":", 1)[1]
        page.goto(study.links["everybody"])
        page.click(f"text={said('study.disagree')} >> visible=true", trial=True)
        page.wait_for_function("() => location.hash === ''")  # a cookie stands for the token
        assert page.evaluate("document.cookie") == ""
        assert page.inner_html("#body em") == "agree"
        is_well()
        page.click(f"text={said('study.agree')}")
        page.click(named("h2", "study.instructions") + " ~ form >> button")
        page.wait_for_selector(named("h1", "task.practice"))
        page.wait_for_selector(f'#actions[lang="{language}"] button:text("{fetch[language]}")')
        assert page.get_attribute("#drawing svg", "lang") == language
        work()
        is_well()
        page.click("#onward")
        page.wait_for_selector(named("h1", "task.title"))
        page.click("#actions button >> nth=0")
        page.wait_for_function("() => document.getElementById('steps').textContent === '1'")
        if language == "en":  # nothing of this depends on the language
            study.end(signal.SIGKILL)
            study = services.enter_context(served(*options, "--port", port, instance=None))
        page.click('#actions button[data-action^="(return"]')  # back to where the task begins, and all of it
        page.wait_for_function("() => document.getElementById('steps').textContent === '2'")
        work()
        page.click("#onward")
        page.wait_for_selector(named("h2", "form.workload"))
        page.click(named("button", "page.continue"))
        assert page.locator(".error:visible").count() == 6  # no scale is marked by default
        is_well()
        for name in list(SCORES["nasa-tlx"])[:3]:
            page.locator(f'[id="item {name}"] input').press("ArrowRight")
        page.reload()  # marks survive a reload
        page.wait_for_selector('[id="item mental"] output:text("55")')
        for name in list(SCORES["nasa-tlx"])[3:]:
            page.locator(f'[id="item {name}"] input').press("Enter")
        second = context.new_page()  # of the same browser
        second.set_default_timeout(PATIENCE)
        second.goto(study.links["everybody"])
        second.wait_for_selector(named("h2", "form.workload"))
        page.click(named("button", "page.continue"))
        second.wait_for_selector(named("h2", "form.view"))
        page.locator('[name="item rely"]').nth(5).check()
        page.locator('[name="item wary"]').nth(2).check()
        is_well()
        page.click(named("button", "page.continue"))
        page.fill("textarea", "=1+1, no")
        page.click("#leave-button")
        is_well()
        page.click("#stay")
        page.click(named("button", "page.continue"))
        code = page.input_value("#code")
        is_well()
        assert second.input_value("#code") == code
        page.click("#leave-button")
        page.wait_for_selector(named("h2", "study.withdrawing"))
        is_well()
        page.click("#stay")
        assert page.input_value("#code") == code
        second.goto(study.links["everybody"])
        is_well(second)
        second.click(named("button", "study.begin_next"))
        second.click(f"text={said('study.agree')}")
        second.click(named("h2", "study.instructions") + " ~ form >> button")
        second.wait_for_selector("#drawing svg")  # the drawing moves the link when it appears
        second.click('#leave:not([hidden]) a[href*="?leave"]')  # in the middle of practice
        second.click("#stay")
        second.wait_for_selector("#drawing svg")
        second.click('#leave:not([hidden]) a[href*="?leave"]')
        second.click("#leave-now")
        second.wait_for_selector(named("h2", "study.left"))
        second.goto(study.operator)
        second.wait_for_selector("#people tr")
        is_well(second)
        with second.expect_download() as download:
            second.click("#export")
        packed = zipfile.ZipFile(download.value.path())
        second.on("dialog", lambda dialog: dialog.accept("asked by post"))
        second.click('#people button:text("Exclude")')
        second.wait_for_selector('#people td:text("completed; excluded: asked by post")')
        second.click('#people button:text("Include")')
        second.wait_for_selector('#people button:text("Exclude")')
        withdraws = context.new_page()
        withdraws.goto(re.search(r"http\S+\?withdraw", page.inner_text("#withdrawal"))[0])  # type: ignore[index]
        withdraws.fill("#code", "P-222222-22222222")
        withdraws.click("#withdraw button")
        withdraws.wait_for_selector(f"text={said.refusal('code')}")
        is_well(withdraws)
        withdraws.fill("#code", re.search(r"P-\w{6}-\w{8}", page.inner_text("#withdrawal"))[0])  # type: ignore[index]
        withdraws.click("#withdraw button")
        withdraws.wait_for_selector(f"text={said('study.withdrawn')}")
        page.wait_for_selector(named("h2", "study.left"))
        second.click('#people button:text("Erase") >> nth=-1')
        second.wait_for_selector('#people td:text("(erased 1)")')
        page.wait_for_selector(f"text={said('page.invalid')}")
    people = [line.split(",") for line in packed.read("participants.csv").decode().splitlines()[1:]]
    assert [(row[4], row[5], row[7]) for row in people] == [("done", "thanks", code), ("withdrew", "practice", "")]
    answers = [line.split(",") for line in packed.read("answers.csv").decode().splitlines()[1:]]
    assert [row[-3:-1] for row in answers[:8]] == [
        *[["55", "55"]] * 3, *[["50", "50"]] * 3, ["6", "6"], ["3", "5"],
    ]  # fmt: skip
    assert "'=1+1" in packed.read("answers.csv").decode()
    actions = [json.loads(line)["action"] for line in packed.read("log-tiny.jsonl").decode().splitlines()]
    assert actions[2:] == tiny.optimal_plan(tiny.initial)
    assert faults == []


EARLIER = """() => {
  for (const key of Object.keys(sessionStorage)) {
    if (key.startsWith("kitassist began")) sessionStorage.setItem(key, String(Date.now() - 600000));
  }
}"""
"""Moves the times at which tasks began back by ten minutes."""


@pytest.mark.long
@pytest.mark.slow
def test_a_refusal_stays_on_the_page_and_each_task_has_a_clock_of_its_own(
    chromium: Any, tmp_path: Path, tiny: Table
) -> None:
    """Two tasks, each with a questionnaire, and a date for withdrawals that is over."""
    remarks = PLAN[PLAN.index('[[questionnaires]]\nform = "text"') : PLAN.index("[[conditions]]")]
    before, after = WITHOUT_PRACTICE.index("[[questionnaires]]"), WITHOUT_PRACTICE.index("[[conditions]]")
    text = WITHOUT_PRACTICE[:before] + remarks + WITHOUT_PRACTICE[after:]
    text = text.replace("seed = 3", 'seed = 3\ndesign = "within"\nwithdraw_until = 2020-01-01')
    file = written(tmp_path / "study.toml", text)
    context = chromium.new_context()
    context.set_default_timeout(PATIENCE)
    page = context.new_page()

    def works() -> None:
        for action in tiny.optimal_plan(tiny.initial) or ():
            page.click(f'#actions button[data-action="{action}"]:not([disabled])')
        page.click("#onward")
        page.wait_for_selector("textarea")
        page.evaluate(EARLIER)  # the questions take ten minutes
        page.click('button:text("Continue")')

    with served("--study", file, "--data", tmp_path / "data", instance=None) as study:
        page.goto(study.links["everybody"])
        page.click("text=I agree and take part")
        page.click('h2:text("What you will do") ~ form >> button')
        page.wait_for_selector("#actions button")
        page.evaluate(EARLIER)
        page.reload()
        page.wait_for_selector('#time:text("10:")')
        works()
        page.wait_for_selector("#actions button")
        page.wait_for_function("() => document.getElementById('time').textContent !== '0:00'")
        assert page.inner_text("#time").startswith("0:")
        works()
        page.wait_for_selector("#code")
        page.click("#leave-button")
        with page.expect_response("**/withdraw"):
            page.click("#leave-now")
        page.wait_for_selector('#problem:text("2020-01-01")')
        page.wait_for_selector("#leave-now:not([disabled])")
        assert page.inner_text("#problem") == "Data could be withdrawn until 2020-01-01."
        page.click("#stay")
        page.wait_for_selector("#problem", state="hidden")

        conducts = context.new_page()  # later, as a page in the background is slow
        conducts.goto(study.operator)
        code = conducts.inner_text("#people td >> nth=0")
        conducts.on("dialog", lambda dialog: dialog.accept(f"{code} asked for it"))
        conducts.click('#people button:text("Erase")')
        conducts.wait_for_selector('#problem:text("without the person\'s name")')
        another = chromium.new_context().new_page()  # whose arrival updates the page
        another.goto(study.links["everybody"])
        another.click("text=I agree and take part")
        conducts.wait_for_selector("#people tr >> nth=1")
        another.context.close()
        assert conducts.is_visible("#problem")
        conducts.click('#people button:text("Exclude")')
        conducts.wait_for_selector("#problem", state="hidden")
