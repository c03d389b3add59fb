"""Pages in a browser over the networks that people have: nothing is lost, and the page says how things are.

The intervals are short here: a sign of life every .3 s instead of every 15 s, after whose absence for .8 s, instead of
40 s, a page counts its stream as lost.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from networks import NGINX, Wire, ask, conducted, free_port, proxy, running
from test_live_pages import violations
from userstudies import PLAN

from assist.live import Joined, Session
from assist.live.live_setting import LiveSetting
from assist.web.app import make_app
from assist.web.client import Client
from assist.web.server import listen
from assist.web.service import Service
from assist.web.tokens import AccessTokens
from planner import Table

pytestmark = pytest.mark.long
behind_nginx = pytest.mark.skipif(NGINX is None, reason="nginx is not installed: `apt-get install nginx-light`")
PATIENCE = 60_000  # milliseconds after which an event is taken as missing
PING = 0.3


class Line:
    """A team of ann and bob, their service, and pages in a browser."""

    def __init__(self, table: Table, folder: Path, chromium: Any, base: str, ping: float = PING) -> None:
        self.session = Session(
            {"tiny": table},
            folder / "journal.sqlite",
            setting=LiveSetting(suggestions="all", c_suggest=0.02, tick=60.0),
        )
        if not self.session.people:
            self.session.report_all([Joined(person=name) for name in ("ann", "bob")])
        self.access = AccessTokens.kept(folder / "secret", base)
        self.service = Service(self.session, self.access, ping=ping, check=0.1)
        self.app = make_app(self.service)
        self.context = chromium.new_context(ignore_https_errors=True)
        self.faults: list[str] = []

    def page(self, person: str | None = "ann", context: Any = None) -> Any:
        """Open the page of a person, or of the operator."""
        page = (context or self.context).new_page()
        page.set_default_timeout(PATIENCE)
        page.on("pageerror", lambda error: self.faults.append(str(error)))
        page.goto(self.access.operator_url() if person is None else self.access.join_url(person))
        page.wait_for_selector("#people li" if person is None else "#actions button")
        return page

    def acts(self, action: str, person: str = "ann") -> None:
        """Report an action by another way than the page."""
        if self.behind is not None:
            Client(f"{self.behind}{self.path}/operator#{self.access.operator}").observe(person, action)

    behind: str | None = None
    path = ""


@contextmanager
def line(table: Table, folder: Path, chromium: Any, **more: Any) -> Iterator[Line]:
    """Serve a team whose pages connect directly."""
    listening = listen("127.0.0.1", 0)
    base = f"http://127.0.0.1:{listening.getsockname()[1]}"
    found = Line(table, folder, chromium, base, **more)
    found.behind = base
    with running(found.app, listening):
        yield found
        found.context.close()
    assert found.faults == []


def says(page: Any, state: str) -> None:
    """Wait until the page says so of its connection."""
    page.wait_for_function("state => document.getElementById('connection').textContent === state", arg=state)


def has_done(page: Any, steps: int) -> None:
    page.wait_for_function("n => document.getElementById('steps').textContent === String(n)", arg=steps)


def is_hidden(page: Any, hidden: bool) -> None:
    """Hide a tab, or show it: a browser without windows shows all."""
    page.evaluate(
        """hidden => {
            Object.defineProperty(document, "hidden", { value: hidden, configurable: true });
            document.dispatchEvent(new Event("visibilitychange"));
        }""",
        hidden,
    )


def test_of_many_windows_some_rest_and_a_hidden_one_is_current_when_it_is_shown(
    chromium: Any, tiny: Table, tmp_path: Path
) -> None:
    """Windows that rest leave connections for the requests of all; a hidden one has no stream. Here two may be open."""
    with line(tiny, tmp_path, chromium) as here:

        def few(route: Any) -> None:
            answer = route.fetch()
            assert "const MOST = 4;" in answer.text()
            route.fulfill(response=answer, body=answer.text().replace("const MOST = 4;", "const MOST = 2;"))

        here.context.route("**/connection.js", few)
        pages = [here.page(name) for name in ("bob", "ann", "bob")]
        for page in pages[1:]:
            says(page, "Connected")
        says(pages[0], "Updates when this window is used")
        pages[2].click('#actions button[data-action="(fetch box-a)"]')
        has_done(pages[2], 1)
        has_done(pages[1], 0)  # ann's
        pages[0].mouse.click(5, 5)
        has_done(pages[0], 1)
        says(pages[0], "Connected")
        says(pages[1], "Updates when this window is used")
        for page in pages[1:]:
            page.close()
        operator = here.page(None)
        connected = '.card:has-text("bob"):not(:has-text("not connected"))'
        operator.wait_for_selector(connected)
        is_hidden(pages[0], True)
        operator.wait_for_selector('.card:has-text("bob"):has-text("not connected")')
        here.acts("(return box-a)", "bob")
        operator.wait_for_selector('.card:has-text("bob"):has-text("2 step")')
        assert pages[0].inner_text("#steps") == "1"
        is_hidden(pages[0], False)
        has_done(pages[0], 2)
        operator.wait_for_selector(connected)


@pytest.mark.slow
def test_without_cookies_and_with_large_ones_of_other_programs_pages_work(
    chromium: Any, tiny: Table, tmp_path: Path
) -> None:
    with line(tiny, tmp_path, chromium) as here:
        without = chromium.new_context()

        def forgets(route: Any) -> None:
            answer = route.fetch()
            kept = {name: value for name, value in answer.headers.items() if name != "set-cookie"}
            without.clear_cookies()  # before the page goes on
            route.fulfill(response=answer, headers=kept)

        without.route("**/api/session", forgets)
        page = here.page("ann", without)
        page.click('#actions button[data-action="(fetch box-a)"]')
        has_done(page, 1)
        says(page, "Connected")
        assert page.evaluate("location.hash")  # a reload needs the token
        without.close()
        large = [{"name": f"other-{number}", "value": "x" * 3900, "url": here.access.base} for number in range(10)]
        here.context.add_cookies(large)
        page = here.page("ann")
        says(page, "Connected")
        page.click('#actions button[data-action="(return box-a)"]')
        has_done(page, 2)


def test_a_half_open_connection_is_noticed_and_replaced_and_nothing_is_lost(
    chromium: Any, tiny: Table, tmp_path: Path
) -> None:
    listening, port = listen("127.0.0.1", 0), free_port()
    here = Line(tiny, tmp_path, chromium, f"http://127.0.0.1:{port}")
    here.behind = f"http://127.0.0.1:{listening.getsockname()[1]}"
    wire = Wire(port, listening.getsockname()[1])
    with running(here.app, listening):
        page, operator = here.page(), here.page(None)
        for one in (page, operator):
            says(one, "Connected")
            one.evaluate("window.said = []")
            one.evaluate(
                """new MutationObserver(() => said.push(document.getElementById("connection").textContent))
                .observe(document.getElementById("connection"), { childList: true })"""
            )
        wire.hold()
        here.acts("(fetch box-a)")
        has_done(page, 1)
        operator.wait_for_selector('.card:has-text("ann"):has-text("1 step")')
        for one in (page, operator):
            says(one, "Connected")
            assert one.evaluate("said")[0] == "Reconnecting\u2026"
        for _ in range(3):  # a proxy that closes connections from time to time
            wire.cut()
        here.acts("(return box-a)")
        has_done(page, 2)
        says(page, "Connected")
        here.context.close()
    wire.close()
    assert here.faults == []


@behind_nginx
@pytest.mark.slow
@pytest.mark.parametrize(
    ("more", "ping"),
    [("", PING), ("proxy_buffering on; proxy_read_timeout 4s;", PING), ("proxy_read_timeout 4s;", 60.0)],
    ids=["plain", "buffering", "closing"],
)
def test_pages_behind_nginx_with_tls_and_a_path_are_told_of_everything(
    chromium: Any, tiny: Table, tmp_path: Path, more: str, ping: float
) -> None:
    listening, port = listen("127.0.0.1", 0), free_port()
    behind = f"http://127.0.0.1:{listening.getsockname()[1]}"
    here = Line(tiny, tmp_path, chromium, f"https://127.0.0.1:{port}/kits", ping=ping)
    here.behind, here.path = behind, "/kits"
    with running(here.app, listening), proxy(tmp_path, port, behind, more):
        page, operator = here.page(), here.page(None)
        says(page, "Connected")
        (first,) = here.service._watchers["ann"]
        for steps in range(1, 4):
            page.wait_for_timeout(1500)  # longer than nginx waits, in all
            here.acts(("(return box-a)", "(fetch box-a)")[steps % 2])
            has_done(page, steps)
            operator.wait_for_selector(f'.card:has-text("ann"):has-text("{steps} step")')
        says(page, "Connected")
        if ping == PING:  # signs of life keep the stream open
            assert here.service._watchers["ann"] == {first}
        here.context.close()
    assert here.faults == []
    assert not re.search(r"[\w-]{32}", (tmp_path / "access.log").read_text())  # no token


@behind_nginx
@pytest.mark.slow
def test_a_restart_behind_nginx_loses_nothing(chromium: Any, tiny: Table, tmp_path: Path) -> None:
    listening, port = listen("127.0.0.1", 0), free_port()
    number = listening.getsockname()[1]
    here = Line(tiny, tmp_path, chromium, f"https://127.0.0.1:{port}/kits")
    with ExitStack() as held:
        held.enter_context(proxy(tmp_path, port, f"http://127.0.0.1:{number}"))
        with running(here.app, listening):
            page, operator = here.page(), here.page(None)
            says(page, "Connected")
        for one in (page, operator):
            says(one, "Reconnecting\u2026")
        page.click('#actions button[data-action="(fetch box-a)"]')
        page.wait_for_selector('#problem:has-text("Not sent yet")')
        again = Line(tiny, tmp_path, chromium, here.access.base)
        with running(again.app, listen("127.0.0.1", number)):
            has_done(page, 1)
            for one in (page, operator):
                says(one, "Connected")
            assert page.locator("#problem").is_hidden()
            operator.wait_for_selector('.card:has-text("ann"):has-text("1 step")')
            many = [{"name": f"o-{n}", "value": "x" * 3900, "url": here.access.base} for n in range(12)]
            here.context.add_cookies(many)
            is_hidden(page, True)
            is_hidden(page, False)  # nginx refuses what is so large
            page.wait_for_selector('#problem:has-text("Cookies of other programs at this address are too large.")')
            here.context.clear_cookies(name=re.compile("^o-"))
            says(page, "Connected")
            here.context.close()
    assert " 502 " in (tmp_path / "access.log").read_text()
    assert here.faults == []


@contextmanager
def broken(here: Line) -> Iterator[None]:
    """A disk that is full, and a broker that is lost, while a station waits for a report that did not arrive."""
    store = here.session._store
    here.service.bridges["MqttBridge"] = SimpleNamespace(  # type: ignore[assignment]
        connected=False, counts={}, waits=["MQTT: ann: 2 reports wait for the number 4, which has not arrived"]
    )
    store.fault = lambda: "No space left on device at the last attempt"  # type: ignore[method-assign]
    yield
    del here.service.bridges["MqttBridge"], store.fault


def test_a_full_disk_and_a_lost_broker_are_on_all_pages_also_on_a_phone(
    chromium: Any, tiny: Table, tmp_path: Path
) -> None:
    with line(tiny, tmp_path, chromium) as here:
        phone = chromium.new_context(viewport={"width": 360, "height": 640}, has_touch=True, is_mobile=True)
        seat, operator = here.page("bob", phone), here.page(None)
        for page in (seat, operator):
            says(page, "Connected")
            assert page.locator("#fault").is_hidden()
        with broken(here):
            for page in (seat, operator):
                says(page, "Connected, but with a fault")
                assert page.locator("#connection.lost").is_visible()
            full = "Actions cannot be saved at the moment (No space left on device at the last attempt)."
            assert seat.inner_text("#fault").startswith(full)
            assert seat.locator("#fault").bounding_box()["y"] < 640  # without scrolling
            assert violations(seat) == []
            told = operator.inner_text("#fault")
            assert "MqttBridge is not connected." in told
            assert "Events cannot be saved: No space left on device at the last attempt." in told
            assert "MQTT: ann: 2 reports wait for the number 4, which has not arrived." in told
            late = here.page()  # whoever comes now is told, too
            says(late, "Connected, but with a fault")
        for page in (seat, operator):
            says(page, "Connected")
            assert page.locator("#fault").is_hidden()
        phone.close()


def test_clicks_and_the_focus_are_kept_where_people_work(chromium: Any, tiny: Table, tmp_path: Path) -> None:
    """A page that changes between press and release of the mouse changes after the release."""
    with line(tiny, tmp_path, chromium) as here:
        page, operator = here.page(), here.page(None)
        says(page, "Connected")
        page.wait_for_selector("#drawing svg")  # which moves what is below it
        page.hover('#actions button[data-action="(fetch box-b)"]')
        page.mouse.down()
        Client(f"{here.behind}/operator#{here.access.operator}").pause()
        operator.wait_for_selector("#pause[aria-pressed=true]")
        page.wait_for_timeout(300)
        assert page.locator('[data-line="paused"]').is_hidden()
        page.mouse.up()
        has_done(page, 1)
        assert here.session.person("ann")["applicable"][0].endswith("box-b)")
        page.wait_for_selector('[data-line="paused"]')

        held: list[Any] = []
        page.route("**/drawing?*", lambda route: held.append(route))
        for steps, action in enumerate(("(return box-b)", "(fetch box-a)"), start=2):
            # While a report is under way buttons are disabled, and cannot have the focus.
            page.focus(f'#actions button[data-action="{action}"]:enabled')
            page.keyboard.press("Enter" if steps % 2 else "Space")
            has_done(page, steps)
            page.wait_for_function("() => document.activeElement.closest('#actions')")
            if held:  # the words of actions come with the drawing: the focus stays on its action, not on its words
                page.focus('#actions button[data-action="(fetch box-b)"]:enabled')
                page.unroute("**/drawing?*")  # which lets those go on that were held
                page.wait_for_function("() => document.activeElement.textContent.startsWith('Fetch')")
                assert page.evaluate("document.activeElement.dataset.action") == "(fetch box-b)"
                held.clear()
        page.focus("#undo")
        page.keyboard.press("Enter")
        has_done(page, 2)
        page.wait_for_function("() => document.activeElement.id === 'undo'")
        operator.on("dialog", lambda dialog: dialog.accept())
        operator.wait_for_selector('.card:has-text("ann"):has-text("2 steps")')
        operator.focus('[aria-label="Undo the last step of ann"]')
        operator.keyboard.press("Enter")
        operator.wait_for_selector('.card:has-text("ann"):has-text("1 step")')
        assert operator.evaluate("document.activeElement.ariaLabel") == "Undo the last step of ann"
        operator.focus('[aria-label="Remove bob"]')
        operator.keyboard.press("Enter")
        operator.wait_for_selector('.card:has-text("bob")', state="detached")
        operator.wait_for_function("() => document.activeElement.id === 'people-title'")


# Two tabs of one participant, of which one was left at an earlier stage: each step counts once, where it was meant.


def heading(page: Any, words: str) -> None:
    page.wait_for_function("words => document.getElementById('stage-title')?.textContent === words", arg=words)


def test_a_tab_that_was_left_behind_does_nothing_twice_and_catches_up(
    chromium: Any, tiny: Table, tmp_path: Path
) -> None:
    plan = list(tiny.optimal_plan(tiny.initial) or ())
    with conducted(tiny, tmp_path, PLAN) as service:
        context = chromium.new_context()
        late, ahead = context.new_page(), context.new_page()
        for page in (late, ahead):
            page.set_default_timeout(PATIENCE)
            page.goto(service.join_url())
            heading(page, "Taking part")
        assert len(service.session.people) == 1  # of one browser
        (person,) = service.session.people

        def stage() -> str:
            return str(service.session.person(person)["study"]["stage"])

        # Forms: what the late tab shows was sent by the other one.
        ahead.click("#form button.main")
        for page in (late, ahead):
            heading(page, "What you will do")
        is_hidden(late, True)
        ahead.click("#form button.main")
        ahead.wait_for_selector(f'#actions button[data-action="{plan[0]}"]')
        heading(late, "What you will do")
        late.click("#form button.main")
        late.wait_for_selector(f'#actions button[data-action="{plan[0]}"]')
        assert stage() == "practice"

        # Tasks: an action in practice is none in the task.
        is_hidden(late, True)
        for steps, action in enumerate(plan, start=1):
            ahead.click(f'#actions button[data-action="{action}"]')
            if steps < len(plan):
                has_done(ahead, steps)
        ahead.click("button.main:visible:has-text('Continue')")
        has_done(ahead, 0)
        assert stage() == "task tiny"
        late.click(f'#actions button[data-action="{plan[0]}"]')
        late.wait_for_function("() => !document.title.includes('Practice')")
        assert service.session.person(person)["steps"] == 0
        has_done(late, 0)
        late.click(f'#actions button[data-action="{plan[0]}"]')
        for page in (late, ahead):
            has_done(page, 1)
        context.close()
    actions = [row for row in service.session.log() if row["person"] == person]
    assert len(actions) == 1


@pytest.mark.parametrize("ends", [pytest.param("thanks", marks=pytest.mark.slow), "withdrew"])
def test_nothing_that_somebody_typed_stays_in_the_browser_for_the_next_person(
    chromium: Any, tiny: Table, tmp_path: Path, ends: str
) -> None:
    """In a laboratory the tab stays open; a participant may also have withdrawn by the code, on another device."""
    first = PLAN.index("[[questionnaires]]")
    last = PLAN.index('[[questionnaires]]\nform = "text"')
    plan = (PLAN[:first] + PLAN[last:]).replace('form = "text"', 'form = "text"\nwhen = "before"')
    with conducted(tiny, tmp_path, plan) as service:
        context = chromium.new_context()
        page = context.new_page()
        page.set_default_timeout(PATIENCE)
        page.goto(service.join_url())
        for words in ("Taking part", "What you will do"):
            heading(page, words)
            page.click("#form button.main")
        heading(page, "In your own words")
        page.fill("#form textarea", "Quittenmus am Dienstag")
        kept = "() => JSON.stringify([...Object.entries(sessionStorage), ...Object.entries(localStorage)])"
        page.wait_for_function(f"() => ({kept})().includes('Quittenmus')")
        page.reload()
        page.wait_for_function("() => document.querySelector('#form textarea')?.value.startsWith('Quittenmus')")
        (person,) = service.session.people

        if ends == "thanks":
            page.click("#form button.main")
            page.wait_for_selector("#actions button")
            for stage in ("practice", "task tiny"):
                for action in tiny.optimal_plan(tiny.initial) or ():
                    ask(service, "POST", f"/api/people/{person}/actions", json={"action": action})
                ask(service, "POST", f"/api/study/participants/{person}/onward", json={"stage": stage})
            heading(page, "Thank you")
        else:
            ask(service, "POST", f"/api/study/participants/{person}/withdraw", json={})
            heading(page, "You have left the study")
        page.wait_for_function(f"() => !({kept})().includes('Quittenmus')")
        context.close()
