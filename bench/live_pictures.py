"""Screenshots of pages for `docs/live.md`, `docs/line.md` and `docs/userstudy.md`.

The live service has four people, two of whom are simulated. The user study is rehearsed, and another participant takes
part in it. The line is that of `make line`, after a while.

    python bench/live_pictures.py [--only live|line|study] [--out docs/figures]

Needs Chromium and the extra `test`.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
from live_load import PAPER, Service
from PIL import Image
from playwright.sync_api import sync_playwright
from tables import ROOT

from assist.web.client import Client
from planner import Table, cost_to_go, load

OPTIONS = ("--simulate", "2", "--set", "pace=3", "--c-move", "0.05", "--set", "population.beta=[0.1, 2]")
MISTAKES = ("(fetch box-a)", "(place pliers slot-1 box-a)", *("(return box-a)", "(fetch box-a)") * 6)
SIZES = {"desk": (1280, 800), "phone": (390, 844), "tablet": (820, 1000)}
COLOURS = 160
STUDY = ROOT / "docs" / "examples" / "kitting-study.toml"
TINY = PAPER.with_name("tiny.pddl")
SCALES = ("mental", "physical", "temporal", "performance", "effort", "frustration")


class Camera:
    """A browser that takes screenshots."""

    def __init__(self, browser: Any, out: Path) -> None:
        self.browser, self.out = browser, out

    def look(self, link: str, name: str, size: str = "desk", *, dark: bool = False, press: str | None = None) -> None:
        """Take a screenshot of a page, after clicking an element if one is given."""
        width, height = SIZES[size]
        context = self.browser.new_context(
            viewport={"width": width, "height": height}, color_scheme="dark" if dark else "light",
            is_mobile=size != "desk", has_touch=size != "desk",
        )  # fmt: skip
        page = context.new_page()
        page.goto(link)
        page.wait_for_selector("#drawing svg, .card, main > h1")
        page.wait_for_timeout(500)
        if press is not None:
            page.click(press)
            page.wait_for_timeout(300)
        file = self.out / f"live_{name}.png"
        page.screenshot(path=file)
        context.close()
        shrink(file)

    def participant(self, link: str, tables: dict[str, Table]) -> None:
        """Take screenshots of a participant's pages over the course of a study."""
        page = self.browser.new_page(viewport={"width": 820, "height": 640})

        def shot(name: str, width: int, height: int, *, dark: bool = False) -> None:
            page.set_viewport_size({"width": width, "height": height})
            page.emulate_media(color_scheme="dark" if dark else "light")
            page.evaluate("document.activeElement?.blur(); window.scrollTo(0, 0)")
            page.wait_for_timeout(300)
            page.screenshot(path=self.out / f"userstudy_{name}.png")
            shrink(self.out / f"userstudy_{name}.png")

        def work(heading: str, table: Table) -> None:
            page.wait_for_selector(f'h1:text("{heading}")')
            for action in table.optimal_plan(table.initial) or ():
                page.click(f'#actions button[data-action="{action}"]:not([disabled])')
            page.click("#onward:not([hidden])")

        page.goto(link)
        page.wait_for_selector("text=I agree and take part")
        shot("consent", 760, 460)
        page.click("text=I agree and take part")
        page.click('h2:text("What you will do") ~ form >> button')
        work("Practice", tables["tiny"])
        work("Your task", tables["paper"])
        page.wait_for_selector('[id="item mental"]')
        page.locator('[id="item mental"] input').fill("70")
        page.locator('[id="item physical"] input').fill("15")
        shot("tlx", 820, 680)
        for name in SCALES[2:]:
            page.locator(f'[id="item {name}"] input').fill("40")
        page.click('button:text("Continue")')
        page.wait_for_selector('[name="item rely"]')
        for name in ("rely", "understand"):
            page.locator(f'[name="item {name}"]').nth(5).check()
        shot("phone", 300, 583)
        shot("dark", 760, 766, dark=True)
        page.close()


def shrink(file: Path) -> None:
    """Reduce the number of colours, which makes files smaller."""
    Image.open(file).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(file, optimize=True)


@contextmanager
def study(data: Path) -> Iterator[dict[str, Any]]:
    """Serve the study; yield its first line of output."""
    command = [str(Path(sys.executable).with_name("kitassist")), "serve", "--study", str(STUDY), "--port", "0"]
    process = subprocess.Popen([*command, "--data", str(data)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        yield json.loads(process.stdout.readline())
    finally:
        process.terminate()
        process.wait()


def rehearse(data: Path) -> None:
    """Let simulated participants take all places of the study."""
    command = [str(Path(sys.executable).with_name("kitassist")), "serve", "--study", str(STUDY), "--rehearse", "24"]
    subprocess.run([*command, "--data", str(data)], check=True, stdout=subprocess.DEVNULL)


def finish(table: Table, ann: Client, operator: Client) -> None:
    """Complete a task optimally."""
    while not ann.see()["finished"]:
        mine = [row["action"] for row in operator.log() if row["person"] == ann.name]
        plan = table.optimal_plan(table.space.follow(mine))
        assert plan
        ann.observe("person-1", plan[0])


@click.command()
@click.option("--out", type=Path, default=Path("docs/figures"), show_default=True)
@click.option(
    "--only", type=click.Choice(["live", "line", "study"]),
    help="Only the pages of the live assistant, of the line, or of the study.",
)  # fmt: skip
def main(out: Path, only: str | None) -> None:
    """Take the screenshots."""
    for name, take in (("live", live), ("line", line), ("study", studied)):
        if only in (None, name):
            take(out)


def line(out: Path) -> None:
    """Take a screenshot of the operator's page of the line without hardware, when each person has acted a few times."""
    command = [sys.executable, ROOT / "docs" / "examples" / "line.py", "--pace", "1.5"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    link = process.stdout.readline().split()[-1]
    acted = 0
    while acted < 12:  # actions, of which the page shows the last
        acted += process.stdout.readline().startswith("person-")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 900, "height": 760})
        page.goto(link)
        page.wait_for_selector("#people > *")
        page.wait_for_timeout(1000)
        page.screenshot(path=out / "line_operator.png")
        browser.close()
    process.terminate()
    process.communicate()
    shrink(out / "line_operator.png")


def studied(out: Path) -> None:
    """Take the screenshots of a study."""
    tables = {file.stem: cost_to_go(load(file)) for file in (PAPER, TINY)}
    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        camera = Camera(browser, out)
        with study(Path(name) / "alone") as said:
            camera.participant(said["join"]["everybody"], tables)
        rehearse(Path(name) / "rehearsed")
        with study(Path(name) / "rehearsed") as said:
            page = browser.new_page(viewport={"width": 800, "height": 764})
            page.goto(said["operator"])
            page.wait_for_selector("#people tr")
            page.screenshot(path=out / "userstudy_operator.png")
            shrink(out / "userstudy_operator.png")
        browser.close()


def live(out: Path) -> None:
    """Take the screenshots of people's and operators' pages."""
    table = cost_to_go(load(PAPER))
    assert isinstance(table, Table)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        service = Service(PAPER, 4, Path(folder), *OPTIONS)
        said = service.start()
        link, ann, operator = said["join"]["person-1"], Client(said["join"]["person-1"]), Client(said["operator"])
        time.sleep(9)  # simulated people act a few times; the robot stays with a person for several pictures
        for number, action in enumerate(MISTAKES):
            if ann.observe("person-1", action)["suggestion"] and number > 2:
                break
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        camera = Camera(browser, out)
        camera.look(link, "worker", press="summary:text('Why?')")
        camera.look(link, "dark", dark=True)
        camera.look(link, "phone", "phone")
        camera.look(link, "tablet", "tablet", press='#targets [data-object="hammer"]')
        camera.look(said["operator"], "operator")
        camera.look(said["operator"], "operator_dark", dark=True)
        camera.look(said["operator"], "operator_phone", "phone")
        finish(table, ann, operator)
        camera.look(link, "done", "phone")
        camera.look(link[:-1], "nowhere", "phone")
        browser.close()
        service.process.terminate()
        service.process.wait()


if __name__ == "__main__":
    main()
