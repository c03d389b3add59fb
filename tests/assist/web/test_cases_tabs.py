"""Two tabs of one participant, of which one was left at an earlier stage: each step counts once, where it was meant."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from networks import ask, conducted
from test_cases_networks import has_done, is_hidden
from test_userstudy_pages import PATIENCE
from userstudies import PLAN

from planner import Table

pytestmark = pytest.mark.long


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
