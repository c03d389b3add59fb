"""The live assistant's pages in a real browser: by mouse, by keyboard only, and by touch on a phone.

Where no Chromium is installed these tests are skipped, with a message.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from conftest import KITTING, ROOT, table_of
from networks import running
from serving import Served, served

from assist.cli import main
from assist.drawing import Artist
from assist.live import Joined, Session
from assist.live.live_setting import LiveSetting
from assist.live.store import stored
from assist.people import Population
from assist.web.app import make_app
from assist.web.server import address, listen
from assist.web.service import Service
from assist.web.tokens import AccessTokens
from planner import Instance, Table

pytestmark = pytest.mark.long

PAPER = KITTING / "paper.pddl"
TRAVEL = (
    "(fetch box-a)", "(place hammer slot-1 box-a)", "(return box-a)", "(fetch box-c)", "(place tape slot-2 box-c)",
    "(return box-c)",
)  # fmt: skip
PATIENCE = 60_000  # milliseconds after which an event is taken as missing
LAST = re.compile(r"^(?:Put|Fetch|Return|Take) ")


@pytest.fixture(scope="module")
def journal(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("session") / "journal.sqlite"


@pytest.fixture(scope="module")
def desk(journal: Path) -> Iterator[Any]:
    # People are assumed to err often, so that the robot makes suggestions; simulated ones do err.
    words = "--humans 5 --simulate 2 --set pace=2.5 --set population.beta=[0.1,0.6] --c-suggest 0.2 --c-move 0.05"
    with served(*words.split(), "--data", journal.parent, instance=PAPER) as running:
        yield running


@pytest.fixture
def quiet_desk(paper: Table, tmp_path: Path) -> Iterator[Served]:
    """A service in this process, without simulated people; people are assumed to err often here, too."""
    setting, often = LiveSetting(c_suggest=0.2, c_move=0.05), Population(beta=(0.1, 0.6))
    session = Session({"paper": paper}, tmp_path / "journal.sqlite", setting=setting, population=often)
    session.report_all([Joined(person="person-2")])
    listening = listen("127.0.0.1", 0)
    access = AccessTokens.kept(tmp_path / "secret", address(listening))
    with running(make_app(Service(session, access)), listening):
        links = {"person-2": access.join_url("person-2")}
        yield Served(None, access.base, links, access.operator_url())  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def paper() -> Table:
    return table_of(Instance(PAPER, KITTING / "domain.pddl"))


@pytest.fixture(scope="module")
def artist(paper: Table) -> Artist:
    return Artist(paper.task)


class Seat:
    """A person at a page who knows the task; `do` takes an action with one input device."""

    def __init__(self, page: Any, desk: Any, person: str, table: Table, artist: Artist) -> None:
        self.page, self.desk, self.person, self.table, self.artist = page, desk, person, table, artist
        self.faults: list[str] = []
        page.set_default_timeout(PATIENCE)
        page.on("pageerror", lambda error: self.faults.append(str(error)))
        page.on("console", lambda told: self.faults.append(told.text) if told.type == "error" else None)
        page.on("request", lambda asked: self.faults.append(asked.url) if self.is_elsewhere(asked.url) else None)
        page.goto(desk.links[person])
        page.wait_for_selector("#actions button")

    def is_elsewhere(self, url: str) -> bool:
        return not url.startswith((self.desk.url, "data:", "blob:"))

    def state(self) -> int:
        """Return the person's state according to the log."""
        mine = [row for row in self.log() if row["person"] == self.person]
        if not self.steps():
            return self.table.initial
        return self.table.space.follow([row["action"] for row in mine if row["episode"] == mine[-1]["episode"]])

    def best(self) -> str:
        plan = self.table.optimal_plan(self.state())
        assert plan
        return plan[0]

    def log(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self.desk.ask("GET", "/api/log").text.splitlines()]

    def seen(self) -> dict[str, Any]:
        found: dict[str, Any] = self.desk.ask("GET", f"/api/people/{self.person}").json()
        return found

    def steps(self) -> int:
        return int(self.page.inner_text("#steps"))

    def waits_for(self, steps: int) -> None:
        self.page.wait_for_function(
            "n => document.getElementById('steps').textContent === String(n)"
            " && !document.querySelector('#actions button:disabled')",
            arg=steps,
        )
        self.page.wait_for_timeout(50)

    def errs(self) -> None:
        """Take bad actions, one or more, until the robot comes."""
        for _ in range(12):
            options = self.table.space.options(self.state())
            self.do(max(options, key=lambda action: self.table[options[action]]))
            if self.seen()["suggestion"] is None:
                self.page.wait_for_timeout(700)
            if self.seen()["suggestion"] is not None:
                self.page.locator("#advice.open").wait_for()
                return
        raise AssertionError("no suggestion came")

    def finish(self) -> None:
        for _ in range(40):
            if self.page.locator("#done:not([hidden])").count():
                return
            self.do(self.best())
            self.page.wait_for_timeout(50)
        raise AssertionError("not done after 40 steps")

    def do(self, action: str) -> None:
        before = self.steps()
        self.takes(action)
        self.waits_for(before + 1)

    def takes(self, action: str) -> None:
        raise NotImplementedError

    def has_no_faults(self) -> None:
        assert self.faults == []


class Clicking(Seat):
    """Take an action with the mouse, by a click on one of its objects in the drawing."""

    def press(self, selector: str) -> None:
        # The upper left corner of a box, since items lie in it.
        self.page.locator(selector).click(position={"x": 12, "y": 12})

    def takes(self, action: str) -> None:
        objects = action.strip("()").split()[1:]
        before = self.steps()
        for name in objects:
            self.press(f'#targets [data-object="{name}"]')
            self.page.wait_for_timeout(60)
            if self.steps() != before or self.page.locator("#menu").is_hidden():
                return  # nothing else was possible with these
        self.press(f'#menu-list button:text-is("{self.artist.say(action)}")')


class Touching(Clicking):
    """Take an action by touch."""

    def press(self, selector: str) -> None:
        self.page.locator(selector).tap(position={"x": 12, "y": 12})


class Typing(Seat):
    """Take an action with the keyboard only."""

    def focus(self, wanted: str) -> None:
        """Go forward with the Tab key until something of this name has the focus."""
        for _ in range(120):
            self.page.keyboard.press("Tab")
            named = "(e => e.getAttribute('aria-label') ?? e.textContent)(document.activeElement)"
            if self.page.evaluate(named).startswith(wanted):
                return
        raise AssertionError(f"{wanted}: not reached with the Tab key")

    def takes(self, action: str) -> None:
        self.focus(self.artist.say(action))
        self.page.keyboard.press("Enter")


def violations(page: Any, *, dark: bool = True, within: list[str] | None = None) -> list[Any]:
    """Return the violations found by axe-core: all rules in light mode, and colour contrast in dark mode.

    With `within`, only these parts of the page are looked at.
    """
    from axe_playwright_python.sync_playwright import Axe

    def run(options: dict[str, Any]) -> list[Any]:
        options["resultTypes"] = ["violations"]
        asked = [{"include": within or ["html"]}, options]
        found: list[Any] = page.evaluate("asked => axe.run(...asked).then(found => found.violations)", asked)
        return found

    if page.evaluate("() => window.axe === undefined"):  # once a page, as reading the script takes as long as the rules
        page.evaluate(Axe().axe_script)
    found = run({})
    if dark:
        page.emulate_media(color_scheme="dark")
        found += run({"runOnly": ["color-contrast"]})
        page.emulate_media(color_scheme=None)
    return [(one["id"], [node["html"] for node in one["nodes"]]) for one in found]


def asks_where_several_things_are_possible(clicked: Seat) -> None:
    page = clicked.page
    page.click('#targets [data-object="box-b"]', position={"x": 12, "y": 12})  # there is only one action with it
    clicked.waits_for(1)
    page.click('#targets [data-object="wrench"]')  # this can go into all slots
    assert page.inner_text("#menu-title") == "With wrench:"
    options = [f"Put wrench into slot-{number}" for number in (1, 2, 3, 4)]
    assert page.locator("#menu-list button").all_inner_texts() == options
    assert violations(page) == []
    page.keyboard.press("Escape")
    assert page.locator("#menu").is_hidden()
    page.click("#undo")
    clicked.waits_for(0)
    page.locator("#actions button").first.dblclick(delay=150)  # the second click would meet another action
    clicked.waits_for(1)
    page.click("#undo")
    clicked.waits_for(0)


def follows_one_suggestion_and_ignores_another(clicked: Seat) -> None:
    page = clicked.page
    clicked.errs()
    assert violations(page) == []
    told = page.inner_text("#suggestion")
    assert LAST.match(told)
    page.click("summary:text('Why?')")
    page.wait_for_selector("#why li")
    why = page.inner_text("#why")
    assert re.search(r"^On average, this should save (about|less than) [\d.]+; the hint costs", why, re.M)
    assert "I assume that you" in why
    options = page.locator("#against option").all_inner_texts()
    assert options[0] == "Choose an action"
    assert told not in options
    page.select_option("#against", index=1)
    page.wait_for_selector("#compared:not(:empty)")
    assert page.inner_text("#compared").startswith(("If you ", "You could just as well "))
    assert violations(page) == []
    before = clicked.steps()
    page.click("#accept")
    clicked.waits_for(before + 1)
    row = [row for row in clicked.log() if row["person"] == clicked.person][-1]
    assert row["action"] == row["suggestion"]
    assert clicked.artist.say(row["action"]) == told

    if not page.locator("#advice.open").count():
        clicked.errs()
    page.click("#ignore")
    assert page.locator("#advice.open").count() == 0
    suggestion = clicked.seen()["suggestion"]
    options = clicked.table.space.options(clicked.state())
    other = max(
        (action for action in options if action != suggestion), key=lambda action: clicked.table[options[action]]
    )
    clicked.do(other)
    row = [row for row in clicked.log() if row["person"] == clicked.person][-1]
    assert (row["action"], row["suggestion"]) == (other, suggestion)


def acted_since_the_first_of(person: str, journal: Path) -> list[str]:
    """Return who acted, action by action, from the person's first action on."""
    events = [record["event"] for _, record in stored(journal)[1]]
    people = [event["person"] for event in events if event["kind"] == "acted"]
    return people[people.index(person) :]


def both_simulated_people_act_meanwhile(clicked: Seat, journal: Path) -> None:
    """Wait for simulated people, who act at their own pace and have many actions left."""
    for _ in range(PATIENCE // 100):
        if {"simulated-1", "simulated-2"} <= set(acted_since_the_first_of(clicked.person, journal)):
            return
        clicked.page.wait_for_timeout(100)
    raise AssertionError("the simulated people do not work while somebody else does")


def has_a_second_tab_and_loses_the_connection(clicked: Seat, chromium: Any) -> None:
    page, desk = clicked.page, clicked.desk
    clicked.has_no_faults()
    page.click("#again")
    clicked.waits_for(0)
    second = Clicking(chromium.new_page(), desk, clicked.person, clicked.table, clicked.artist)
    second.do("(fetch box-a)")
    clicked.waits_for(1)  # the other tab sees it
    second.page.close()  # and its end changes nothing
    page.context.set_offline(True)
    page.click('#actions button:has-text("Return")')
    page.wait_for_selector("#problem:not([hidden])")
    assert "as soon as the server can be reached" in page.inner_text("#problem")
    page.context.set_offline(False)
    clicked.waits_for(2)
    actions = [row["action"] for row in clicked.log() if row["person"] == clicked.person][-2:]
    assert actions == ["(fetch box-a)", "(return box-a)"]  # once
    clicked.faults.clear()  # an offline browser reports errors


def sees_everybody_pauses_corrects_and_exports(chromium: Any, desk: Any, clicked: Seat, tmp_path: Path) -> None:
    page = chromium.new_page(viewport={"width": 1280, "height": 900})
    faults: list[str] = []
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.goto(desk.operator)
    page.set_default_timeout(PATIENCE)
    page.wait_for_selector(".card")
    assert page.locator(".card h3").all_inner_texts()[0].startswith(clicked.person)
    assert page.locator(".card").count() == 5
    assert page.locator(".card .plot[role=img]").count() == 15
    assert page.locator('.card:has-text("simulated-1") .badge').all_inner_texts()[-1] in ("simulated", "finished")
    assert violations(page) == []

    page.click("#pause")
    page.wait_for_selector("#pause[aria-pressed=true]")
    assert clicked.seen()["paused"] is True
    clicked.page.wait_for_selector('[data-line="paused"]')
    assert clicked.page.inner_text('[data-line="paused"]') == "Suggestions are paused. You can continue to work."
    assert violations(clicked.page) == []
    assert violations(page, within=["header", ".robot", ".tools"]) == []  # of people it shows the same as above
    page.click("#pause")
    page.wait_for_selector("#pause[aria-pressed=false]")

    page.fill("#name", "dora")
    page.keyboard.press("Enter")
    page.wait_for_selector('.card:has-text("dora")')
    link = page.input_value('input[aria-label="Link for dora"]')
    assert link.startswith(f"{desk.url}/join/dora#")
    dora = chromium.new_page()
    dora.goto(link)
    dora.wait_for_selector("#actions button")
    page.on("dialog", lambda dialog: dialog.accept())
    page.click('[aria-label="Remove dora"]')
    page.wait_for_selector('.card:has-text("dora")', state="detached")
    dora.wait_for_selector("#problem:not([hidden])")
    assert "no longer in this team" in dora.inner_text("#problem")
    assert dora.locator("button:visible").count() == 0
    assert violations(dora) == []
    dora.close()

    steps = clicked.steps()
    clicked.do("(fetch box-b)")
    page.click(f'[aria-label="Undo the last step of {clicked.person}"]')
    clicked.waits_for(steps)

    with page.expect_download() as download:
        page.click("#export")
    download.value.save_as(tmp_path / "log.jsonl")
    assert faults == []


def is_fitted(log: Path, person: str) -> None:
    result = CliRunner().invoke(main, ["fit", str(PAPER), str(log), "--json"])
    assert result.exit_code == 0, result.output
    people = {one["person"]: one for one in json.loads(result.stdout)}
    assert {person, "simulated-1", "simulated-2"} <= people.keys()
    mine = [row for row in map(json.loads, log.read_text().splitlines()) if row["person"] == person]
    assert people[person]["actions"] == len(mine)
    assert people[person]["suboptimal_actions"] > 0
    assert all(people[f"simulated-{number}"]["actions"] > 0 for number in (1, 2))


@pytest.mark.slow
def test_somebody_completes_the_task_by_clicking_and_the_log_is_fitted(
    chromium: Any, desk: Any, journal: Path, paper: Table, artist: Artist, tmp_path: Path
) -> None:
    page = chromium.new_page(viewport={"width": 1280, "height": 800})
    clicked = Clicking(page, desk, "person-1", paper, artist)
    asks_where_several_things_are_possible(clicked)
    assert violations(page) == []
    follows_one_suggestion_and_ignores_another(clicked)
    both_simulated_people_act_meanwhile(clicked, journal)
    page.reload()  # all is as it was
    page.wait_for_selector("#actions button")
    steps = clicked.steps()
    clicked.finish()
    assert "You reached the goal" in page.inner_text("#done-text")
    assert page.inner_text("#goal-word") == "Goal 7 of 7"
    assert clicked.steps() > steps
    acted = acted_since_the_first_of(clicked.person, journal)
    last = len(acted) - acted[::-1].index(clicked.person)
    assert {"simulated-1", "simulated-2"} <= set(acted[:last])  # between the person's actions are theirs
    assert violations(page) == []
    has_a_second_tab_and_loses_the_connection(clicked, chromium)
    sees_everybody_pauses_corrects_and_exports(chromium, desk, clicked, tmp_path)
    is_fitted(tmp_path / "log.jsonl", clicked.person)
    clicked.has_no_faults()


def test_somebody_works_by_keyboard_only(chromium: Any, quiet_desk: Served, paper: Table, artist: Artist) -> None:
    page = chromium.new_page(viewport={"width": 1024, "height": 768}, color_scheme="dark")
    seat = Typing(page, quiet_desk, "person-2", paper, artist)
    seat.focus("box-a: Fetch")  # the drawing itself
    page.keyboard.press("Space")
    seat.waits_for(1)
    seat.focus("hammer: 4 possible actions")
    page.keyboard.press("Enter")
    page.wait_for_selector("#menu:not([hidden])")
    assert page.evaluate("document.activeElement.textContent") == "Put hammer into slot-1"
    page.keyboard.press("Escape")
    assert page.evaluate("document.activeElement.dataset.object") == "hammer"
    seat.focus("Undo")
    page.keyboard.press("Enter")
    seat.waits_for(0)
    seat.errs()
    assert page.inner_text("#said").startswith("The assistant suggests: ") or "done" in page.inner_text("#said")
    before = seat.steps()
    seat.focus("Do it")
    page.keyboard.press("Enter")
    seat.waits_for(before + 1)
    for action in paper.optimal_plan(seat.state()) or ():
        quiet_desk.ask("POST", "/api/people/person-2/actions", json={"action": action})
    page.wait_for_function("() => document.activeElement.id === 'done-title'")
    seat.has_no_faults()


@pytest.mark.slow
def test_somebody_completes_the_task_on_a_phone_by_touch(
    chromium: Any, desk: Any, paper: Table, artist: Artist
) -> None:
    context = chromium.new_context(
        viewport={"width": 360, "height": 740}, has_touch=True, is_mobile=True, device_scale_factor=2
    )
    seat = Touching(context.new_page(), desk, "person-3", paper, artist)
    assert violations(seat.page) == []
    assert seat.page.evaluate("document.documentElement.scrollWidth") <= 360
    seat.finish()
    assert seat.steps() == 10
    assert violations(seat.page) == []
    seat.has_no_faults()


@pytest.mark.slow
def test_pages_beside_those_of_the_team_can_be_used_by_everybody(chromium: Any, desk: Any) -> None:
    page = chromium.new_page()
    for path in (desk.links["person-1"].removeprefix(desk.url).replace("#", "/"), "/operator/wrong", "/"):
        assert page.goto(desk.url + path).status == 404
        assert page.inner_text("h1") == "This link is not valid"
        assert violations(page) == []


@pytest.mark.slow
def test_the_interface_is_described_without_a_foreign_server(chromium: Any, desk: Any) -> None:
    """Swagger UI is another project's page; our style sheet and script mend what axe finds."""
    page = chromium.new_page()
    asked, errors = [], []
    page.on("request", lambda request: asked.append(request.url))
    page.on("console", lambda said: errors.append(said.text) if said.type == "error" else None)
    page.goto(f"{desk.url}/docs")
    page.click("[data-path='/api/people/{person}/actions']")
    page.click(".opblock.is-open .try-out__btn")
    page.wait_for_selector(".opblock.is-open .body-param textarea")
    assert violations(page, dark=False) == []
    page.click(".btn.authorize")
    page.wait_for_selector(".modal-ux")
    assert violations(page, dark=False, within=[".modal-ux"]) == []
    assert errors == []
    assert all(url.startswith((desk.url, "data:")) for url in asked)


def test_an_animation_is_a_page_that_everybody_can_use_and_has_no_script(
    chromium: Any, artist: Artist, tmp_path: Path
) -> None:
    from assist.drawing import plan_frames, save

    file = tmp_path / "plan.html"
    save(artist, plan_frames(artist, ["(fetch box-a)", "(return box-a)"]), file)
    page = chromium.new_page(java_script_enabled=False)
    page.goto(file.as_uri())
    assert page.locator("script, [onclick]").count() == 0

    def shown() -> list[str]:
        return [str(one).partition(" of ")[0] for one in page.locator("figure:visible b").all_inner_texts()]

    assert shown() == ["1"]
    page.keyboard.press("ArrowRight")
    assert shown() == ["2"]
    assert "Return box-a to storage" in page.inner_text("figure:visible figcaption")
    page.click("figure:visible .turn:has-text('Next')")
    assert shown() == ["3"]
    page.keyboard.press("ArrowLeft")
    assert shown() == ["2"]
    page.get_by_label("Play", exact=True).check()
    for number in "123":  # each in turn
        page.wait_for_selector(f"#picture-{number}:visible")
        assert len(shown()) == 1
    page.get_by_label("Pause").check()
    assert len(shown()) == 1
    page.get_by_label("By hand").check()
    assert shown() == ["2"]
    page.close()
    page = chromium.new_page()
    page.goto(file.as_uri())
    assert violations(page) == []


@pytest.mark.slow
def test_people_and_the_operator_see_and_answer_questions_about_probable_goals(chromium: Any, tmp_path: Path) -> None:
    kits = ROOT / "docs" / "examples" / "kits"
    asks = ("--set", "c_ask=0.01", "--c-suggest", 0.05, "--c-move", 0, "--data", tmp_path)
    with served("--goals", kits, "--humans", 2, *asks, instance=kits / "travel.pddl") as running:
        page, seat = chromium.new_page(), chromium.new_page()
        page.goto(running.operator)
        shown = page.locator('.card:has-text("person-1") .plot[aria-label^="Goal"]')
        shown.wait_for()
        assert shown.get_attribute("aria-label") == "Goal: travel 33 %, mend 33 %, mount 33 %"
        seat.goto(running.links["person-1"])
        seat.locator('#asked:has-text("Is your goal travel?")').wait_for()
        assert violations(seat) == []
        seat.locator("#goal-word").wait_for(state="hidden")  # once the drawing is there
        seat.click('#answers button:has-text("Yes")')
        seat.wait_for_selector("#question", state="hidden")
        page.wait_for_selector('.plot[aria-label="Goal: travel 100 %, mend 0 %, mount 0 %"]')
        assert seat.inner_text("#told-text") == "Your answer: the goal is travel."
        assert seat.inner_text("#advice-title") == "The assistant suggests"
        assert violations(seat) == []
        assert violations(page) == []
        seat.click("#retract")
        seat.locator('#asked:has-text("Is your goal travel?")').wait_for()
        assert seat.locator("#told").is_hidden()
        assert seat.inner_text("#advice-title") == "The assistant asks"
        seat.click("#reasons summary")
        seat.locator('#why:has-text("First I would like to know whether your goal is travel")').wait_for()
        seat.click('#answers button:has-text("No"):not(:has-text("answer"))')
        page.get_by_label("Take back the answer of person-1").click()
        seat.locator('#asked:has-text("Is your goal travel?")').wait_for()
        asked = page.locator('.card:has-text("person-2") p:has-text("Asked: is the goal travel?")')
        asked.wait_for()
        assert violations(page) == []
        page.get_by_label("Answer of person-2: No answer").click()
        asked.wait_for(state="hidden")
        seat.goto(running.links["person-2"])
        for action in TRAVEL:
            running.ask("POST", "/api/people/person-2/actions", json={"action": action})
        seat.locator('#done-text:has-text("You have probably reached your goal: was that all?")').wait_for()
        assert seat.locator("#actions button").count() > 0
        assert violations(seat) == []


@pytest.mark.slow
def test_an_operator_sees_changes_and_readmits_a_person(chromium: Any, tmp_path: Path) -> None:
    tasks = KITTING / "tiny.pddl", KITTING / "sealed.pddl"
    with served(tasks[1], "--humans", 1, "--data", tmp_path, instance=tasks[0]) as running:
        page = chromium.new_page()
        page.set_default_timeout(PATIENCE)
        page.goto(running.operator)
        page.wait_for_selector('.card:has-text("person-1")')
        running.ask("POST", "/api/team/people", json={"person": "dora", "task": "sealed"})
        page.wait_for_selector('.card:has-text("dora")')
        page.on("dialog", lambda dialog: dialog.accept())
        page.click('[aria-label="Remove dora"]')
        page.wait_for_selector('.card:has-text("dora")', state="detached")
        page.fill("#name", "dora")
        page.keyboard.press("Enter")
        page.wait_for_selector('.card:has-text("sealed: "):has-text("dora")')  # at the task that they left
        assert page.locator("#problem").is_hidden()


@pytest.mark.slow
def test_a_person_says_what_they_did_last_when_it_was_seen_badly(chromium: Any, tmp_path: Path) -> None:
    asks = ("--set", "suggestions=all", "--set", "c_ask=0", "--c-suggest", 0.01, "--c-move", 0, "--data", tmp_path)
    with served("--humans", 1, *asks, "--set", "language=de", instance=PAPER) as running:
        seat = chromium.new_page(viewport={"width": 390, "height": 844})
        seat.goto(running.links["person-1"])
        seat.wait_for_selector("#actions button")
        options = running.ask("GET", "/api/people/person-1").json()["applicable"]
        doubt = {"likelihoods": dict.fromkeys(options, 1.0)}
        seen = running.ask("POST", "/api/people/person-1/actions", json=doubt).json()
        asked = seen["question"]
        assert (asked["goal"], set(asked["options"])) == (None, set(options))
        seat.locator('#asked:has-text("Was haben Sie zuletzt getan?")').wait_for()
        assert seat.inner_text("#advice-title") == "Der Assistent fragt"
        assert violations(seat) == []
        told = asked["options"].index("(fetch box-b)")
        seat.locator("#answers button").nth(told).click()
        seat.wait_for_selector("#question", state="hidden")
        seat.locator('#actions button[data-action="(return box-b)"]').wait_for()
        assert "question" not in running.ask("GET", "/api/people/person-1").json()
        assert json.loads(running.ask("GET", "/api/log").text)["action"] == "(fetch box-b)"


EVERYTHING_SHOWN = """() => {
  window.shown = new Set();
  const look = () => document.body.innerText.split("\\n").forEach((line) => shown.add(line.trim()));
  new MutationObserver(look).observe(document.body, { subtree: true, childList: true, characterData: true });
}"""
"""Collects all lines that a page shows, however briefly."""


@pytest.mark.slow
def test_two_robots_serve_six_people_and_the_page_shows_both(chromium: Any, tmp_path: Path) -> None:
    words = "--humans 6 --simulate 6 --set pace=0.2 --set population.beta=[0.1,0.3] --c-suggest 0.05 --c-move 0.01"
    words += " --robots 2 --set travel_time=1"
    script = [sys.executable, ROOT / "docs" / "examples" / "robot.py"]
    with served(*words.split(), "--data", tmp_path) as running, ExitStack() as held:
        page = chromium.new_page()
        page.set_default_timeout(PATIENCE)
        page.goto(running.operator)
        headings = page.get_by_role("region", name="The robots").get_by_role("heading", level=3)
        headings.nth(1).wait_for()
        assert headings.all_inner_texts() == ["Robot 1", "Robot 2"]
        page.evaluate(EVERYTHING_SHOWN)
        robots = []
        for number in (1, 2):
            command = [*script, running.operator, str(number)]
            robots.append(held.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True)))
            held.callback(robots[-1].kill)
        page.wait_for_function("() => [...shown].some((line) => line.startsWith('Serves'))")
        assert violations(page) == []
        said = [robot.communicate(timeout=120)[0].splitlines() for robot in robots]
        shown = page.evaluate("() => [...shown]")
        seen = running.ask("GET", "/api/team").json()
        page.close()
    assert {"robot 1 here", "robot 2 here"} <= set(shown)
    assert any(line.startswith(("On the way to", "Goes to")) for line in shown)
    for lines in said:
        assert any(line.startswith("going to simulated-") for line in lines)
    assert any(line.startswith("to simulated-") for lines in said for line in lines)
    assert len(seen["robots"]) == 2
    assert all(person["finished"] for person in seen["people"])
