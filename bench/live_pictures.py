"""The pictures of pages in `docs/live.md`: a service with four people, of whom two are simulated, seen in a browser.

    python bench/live_pictures.py [--out docs/figures]

Needs Chromium, and the extra `test`.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import click
from live_load import PAPER, Service
from PIL import Image
from playwright.sync_api import sync_playwright

from assist.live.client import Client
from planner import Table, cost_to_go, load

OPTIONS = ("--simulate", "2", "--pace", "0.4", "--c-move", "0.05", "--beta", "0.1", "2.0")
MISTAKES = ("(fetch box-a)", "(place pliers slot-1 box-a)", *("(return box-a)", "(fetch box-a)") * 6)
SIZES = {"desk": (1280, 800), "phone": (390, 844), "tablet": (820, 1000)}
COLOURS = 160


class Camera:
    """A browser that looks at pages."""

    def __init__(self, browser: Any, out: Path) -> None:
        self.browser, self.out = browser, out

    def look(self, link: str, name: str, size: str = "desk", *, dark: bool = False, press: str | None = None) -> None:
        """Take a picture of a page, after something has been pressed there."""
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
        Image.open(file).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(file, optimize=True)


def finish(table: Table, ann: Client, operator: Client) -> None:
    """Do the rest of a task without a mistake."""
    while not ann.see()["finished"]:
        mine = [row["action"] for row in operator.log() if row["person"] == ann.name]
        plan = table.optimal_plan(table.space.follow(mine))
        assert plan
        ann.act(plan[0])


@click.command()
@click.option("--out", type=Path, default=Path("docs/figures"), show_default=True)
def main(out: Path) -> None:
    """Write the pictures."""
    table = cost_to_go(load(PAPER))
    assert isinstance(table, Table)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        service = Service(PAPER, 4, Path(folder), *OPTIONS)
        said = service.start()
        link, ann, operator = said["join"]["person-1"], Client(said["join"]["person-1"]), Client(said["operator"])
        for number, action in enumerate(MISTAKES):
            if ann.act(action)["suggestion"] and number > 2:
                break
        time.sleep(2)
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
