"""Markup in anything that people or researchers write has no effect: on no page, in no report, in no file."""

from __future__ import annotations

import io
import re
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlencode

import httpx2 as httpx
import pytest
from conftest import KITTING
from networks import ask, conducted
from test_cases_networks import has_done, line
from test_userstudy_pages import PATIENCE
from userstudies import PLAN, SCORES, Part, written

from assist.drawing import Artist, plan_frames, save
from assist.studies.reports.report_files import html_page
from assist.studies.reports.study_report import Report
from assist.studies.reports.userstudy_report import write_report
from assist.studies.study import Study
from assist.studies.userstudy import StudySession, read
from planner import Table, cost_to_go, load
from planner.system.results import markdown_cell, markdown_table

IMAGE = "<img src=x onerror=window.ran=1>"
RUNS = f"</title></script><script>window.ran=1</script>{IMAGE}[x](javascript:window.ran=1)"
ATTACKED = (
    PLAN.replace("A small study", RUNS)
    .replace('text = "I was wary."', f'text = "{RUNS}"')
    .replace('name = "attention"\n', f'name = "{IMAGE} $x_{{$"\n')
    .replace("Do you *agree*?", f"Do you *agree*? {RUNS} <a href='javascript:window.ran=1' id=evil>me</a>")
    .replace("Anything else?", f"{RUNS}\\n# {RUNS}")
    .replace("[[questionnaires]]", f"# {RUNS}\n[[questionnaires]]", 1)
    + f"""
[[questionnaires]]
form = "choice"
name = "which"
title = "{RUNS}"
introduction = "{RUNS}"
items = [{{ name = "which", text = "{RUNS}", options = ["{RUNS}", "{IMAGE}"], required = false }}]
"""
)
WATCH = """
window.blocked = [];
addEventListener("securitypolicyviolation", (event) => window.blocked.push(event.violatedDirective));
"""


def test_a_report_shows_markup_as_it_is_written() -> None:
    text = "\n\n".join([
        f"# {RUNS}", "![Each measure](figures/outcomes.png)", markdown_table(["a", "b"], [[RUNS, "p < .001"]]),
        f"<div onclick='window.ran=1'>\n{RUNS}\n</div>", "<!-- a comment -->", "[x]: javascript:window.ran=1",
        "[x] [y][x]",
        "![z](https://evil.example/z.png) ![z](//evil.example/z.png) ![z][x]", "<https://evil.example>",
    ])  # fmt: skip
    page = html_page(RUNS, text, dark=True)
    body = page.partition("</style>")[2].removesuffix("</html>\n")
    for tag in ("<script", "<img src=x", "<div", "<a ", "<!--", 'src="http', 'src="//', "href="):
        assert tag not in body, tag
    assert "&lt;script&gt;window.ran=1" in body
    assert 'figures/outcomes.svg"' in body
    assert "p &lt; .001" in body
    assert page.count("<title>") == page.count("</title>") == 1
    assert "default-src 'none'" in page


def test_a_cell_is_one_line_of_one_cell() -> None:
    assert markdown_cell("a|b\n| c |\r\n# d <script> 1 < 2") == "a\\|b \\| c \\| # d &lt;script> 1 < 2"


def test_no_script_in_a_report_runs(chromium: Any, tiny: Table, tmp_path: Path) -> None:
    """The reason of an exclusion, titles, names of conditions, questions and their options; figures are shown."""
    study = read(written(tmp_path / "study.toml", ATTACKED))
    session = StudySession(study, {"tiny": tiny, "practice": tiny}, tmp_path / "data")
    for name in ("ann", "bob"):
        part = Part(session, name)
        part.come()
        part.to("questionnaire which")
        part.onward({"which": RUNS})
    part.report("excluded", reason=RUNS)
    session.close()
    write_report(tmp_path / "data", tmp_path / "report")
    context = chromium.new_context()
    context.add_init_script(WATCH)
    page = context.new_page()
    page.goto((tmp_path / "report" / "report.html").as_uri())
    assert page.evaluate("[window.ran, window.blocked]") == [None, []]
    assert page.evaluate("[...document.images].every((one) => one.naturalWidth > 0) && document.images.length") >= 3
    assert page.locator("script, a, div").count() == 0
    assert page.locator(f"td:has-text('{IMAGE}')").count() >= 1
    figures = list((tmp_path / "report" / "figures").glob("*.svg"))
    assert figures
    for figure in figures:
        page.goto(figure.as_uri())
        assert page.evaluate("window.ran ?? null") is None
        assert page.locator("script").count() == 0


def kits(folder: Path) -> Path:
    """Write a task whose file is named like markup, with words of a domain that are markup; return the file."""
    folder.mkdir()
    for file in ("domain.pddl", "drawing.toml"):
        shutil.copy(KITTING / file, folder / file)
    words = (folder / "drawing.toml").read_text(encoding="utf-8")
    for own in ("Fetch ?c", "Storage", "Kit"):
        words = words.replace(f'"{own}', f'"{IMAGE} {own}')
    (folder / "drawing.toml").write_text(words, encoding="utf-8")
    return Path(shutil.copy(KITTING / "tiny.pddl", folder / f"{IMAGE}.pddl"))


@pytest.mark.parametrize("last", ["practice", pytest.param("thanks", marks=pytest.mark.slow)])
def test_no_script_on_a_page_runs_and_no_page_needs_one_of_its_own(chromium: Any, tmp_path: Path, last: str) -> None:
    """Every page obeys a policy without inline scripts. What the policy had to stop is only what researchers wrote."""
    task = kits(tmp_path / "kits")
    table, plan = cost_to_go(load(task)), ATTACKED.replace(str(KITTING / "tiny.pddl"), str(task))
    assert isinstance(table, Table)
    with conducted(table, tmp_path, plan) as service:
        base, link = service.access.base, service.join_url()
        context = chromium.new_context()
        context.add_init_script(WATCH)
        page = context.new_page()
        page.set_default_timeout(PATIENCE)
        marked = f"{link.replace('#', '?' + urlencode({'participant': IMAGE, 'withdraw': IMAGE, 'x': RUNS}) + '#')}"
        named = [f"{base}/{kind}/{quote(IMAGE, safe='')}#{quote(IMAGE)}" for kind in ("part", "join")]
        own = [base + path for path in ("/", "/study/nowhere")]
        for address in (*own, marked, *named, f"{base}/study/operator?{urlencode({'x': IMAGE})}#{quote(IMAGE)}"):
            page.goto(address)
            page.wait_for_selector("h1", state="attached")
            page.wait_for_load_state("networkidle")
            assert page.evaluate("[window.ran ?? null, window.blocked]") == [None, []], address
        page.goto("about:blank")
        context.clear_cookies()
        page.goto(link)
        page.wait_for_selector("#form button")
        page.click("#evil")
        assert page.evaluate("window.ran ?? null") is None
        person = page.url.partition("/part/")[2].partition("#")[0]
        for stage in ("consent", "instructions"):
            ask(service, "POST", f"/api/study/participants/{person}/onward", json={"stage": stage})
        page.wait_for_selector(f"#actions button:has-text('{IMAGE} Fetch box-a')")  # the page goes there by itself
        page.wait_for_selector("#drawing svg")
        page.click("#actions button")
        page.wait_for_function("() => document.getElementById('steps').textContent === '1'")
        assert page.evaluate("[window.ran ?? null, window.blocked]") == [None, []]
        ask(service, "POST", f"/api/people/{person}/actions", json={"action": "(return box-a)"})
        view = ask(service, "GET", f"/api/people/{person}").json()
        while view["study"]["kind"] != last:  # the pages of all later stages
            at, what = view["study"], view["study"]["what"]
            if at["kind"] in ("practice", "task"):
                page.wait_for_selector("#drawing svg")
                for action in table.optimal_plan() or []:
                    ask(service, "POST", f"/api/people/{person}/actions", json={"action": action})
            else:
                page.wait_for_selector("#form button")
            assert page.evaluate("window.ran ?? null") is None, at
            body = {"stage": at["stage"], "answers": SCORES.get(what, {}) if at["kind"] == "questionnaire" else None}
            view = ask(service, "POST", f"/api/study/participants/{person}/onward", json=body).json()
        if last == "thanks":
            page.wait_for_selector("#stage-title:has-text('Thank you')")
        assert page.evaluate("[window.ran ?? null, window.blocked]") == [None, []]
        ask(service, "POST", f"/api/study/participants/{person}/exclude", json={"reason": RUNS})
        page.goto(service.operator_url())
        page.wait_for_selector(f"#people td:has-text('{IMAGE}')")
        assert page.evaluate("[window.ran ?? null, window.blocked]") == [None, []]
        page.goto(link.replace("/study#", "/study?withdraw#"))
        page.fill("#code", IMAGE)
        page.click("#withdraw button")
        page.wait_for_selector("#text:has-text('no such code')")
        assert page.evaluate("[window.ran ?? null, window.blocked]") == [None, []]
        packed = zipfile.ZipFile(io.BytesIO(ask(service, "GET", "/api/study/export").content))
        assert not any("/" in name or name.startswith(".") for name in packed.namelist())


@pytest.mark.slow
def test_the_pages_of_a_team_obey_the_policy_too(chromium: Any, tiny: Table, tmp_path: Path) -> None:
    with line(tiny, tmp_path, chromium) as here:
        here.context.add_init_script(WATCH)
        operator, seat = here.page(None), here.page()
        headers = {"Authorization": f"Bearer {here.access.operator}"}
        erased = httpx.delete(f"{here.behind}/api/people/bob/records", params={"reason": IMAGE}, headers=headers)
        assert erased.status_code == 200
        operator.wait_for_selector(".card:has-text('bob')", state="detached")
        operator.fill("#name", "d'Arc")
        operator.click("#add button")
        operator.wait_for_selector('.card:has-text("d\'Arc")')
        operator.fill("#name", IMAGE)
        operator.click("#add button")
        operator.wait_for_selector("#problem:not([hidden])")
        seat.click("#actions button")
        has_done(seat, 1)
        seat.click("#undo")
        has_done(seat, 0)
        operator.wait_for_selector("#log td:has-text('undone')")
        for page in (operator, seat):
            assert page.evaluate("[window.ran ?? null, window.blocked]") == [None, []]
            page.evaluate(
                "markup => { document.querySelector('main').insertAdjacentHTML('beforeend', markup); }", IMAGE
            )
            page.wait_for_function("() => window.blocked.length")  # the policy is in force
            assert page.evaluate("window.ran ?? null") is None


def test_no_script_in_a_drawing_or_its_animation_runs(chromium: Any, tmp_path: Path) -> None:
    """A file name of a task, and the words of a domain; without the page's own policy, too."""
    task = load(kits(tmp_path / "kits"))
    artist = Artist(task)
    frames = plan_frames(artist, ["(fetch box-a)", "(return box-a)"])
    for name in ("plan.html", "plan.svg"):
        save(artist, frames, tmp_path / name)
    text = (tmp_path / "plan.html").read_text(encoding="utf-8")
    (tmp_path / "bare.html").write_text(re.sub(r"<meta http-equiv[^>]*>", "", text), encoding="utf-8")
    context = chromium.new_context()
    context.add_init_script(WATCH)
    page = context.new_page()
    for name in ("plan.html", "bare.html", "plan.svg"):
        page.goto((tmp_path / name).as_uri())
        assert page.evaluate("[window.ran ?? null, window.blocked]") == [None, []], name
        assert page.locator("script, img").count() == 0
        assert IMAGE in page.evaluate("document.documentElement.textContent")


@pytest.mark.usefixtures("one_picture")
def test_the_report_of_a_study_with_simulated_people_shows_markup_as_it_is_written(
    small_study: tuple[Study, Path, dict[str, Any]],
) -> None:
    """Its conditions and tasks have names that are markup."""
    study, folder, _ = small_study
    found = Report.of(study, folder)
    page = replace(found, text=found.text.replace("tiny", markdown_cell(RUNS))).page(RUNS)
    assert "&lt;script&gt;window.ran=1" in page
    assert "<script" not in page
    assert IMAGE not in page
