"""A service in this process with a bridge beside it, and the same reports over HTTP, for comparison."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Coroutine, Iterable
from pathlib import Path
from typing import Any

from conftest import kit
from starlette.testclient import TestClient

from assist.cli.options.bridges import bridge_of
from assist.connect.bridges import Bridge
from assist.live import Joined, Session
from assist.live.live_setting import LiveSetting
from assist.person.settings import Setting
from assist.web.app import make_app
from assist.web.server import listen, run
from assist.web.service import Service
from assist.web.tokens import AccessTokens
from planner import Table

Reports = Iterable[tuple[str, dict[str, Any]]]
"""Paths below /api, with bodies."""


class Here:
    """A service in this process, with a bridge beside it."""

    def __init__(self, folder: Path, people: list[str], setting: Setting | None = None) -> None:
        folder.mkdir(exist_ok=True)
        # No decisions by the clock: what a session does then follows from its events alone.
        self.setting = setting or LiveSetting(c_suggest=0.1, tick=3600.0)
        self.people, self.folder = people, folder
        self.session = Session({"tiny": kit("tiny")}, folder / "journal.sqlite", setting=self.setting)
        self.session.report_all([Joined(person=name) for name in people])
        self.service = Service(self.session, AccessTokens.kept(folder / "secret", "http://testserver"))
        self.app = make_app(self.service)
        self.headers = {"Authorization": f"Bearer {self.service.access.operator}"}

    def run(
        self, made: Path | Callable[[str], Bridge], work: Callable[[], Coroutine[Any, Any, None]], **options: Any
    ) -> None:
        """Serve until the work is done; a bridge runs meanwhile: one with the settings in a file, or one of a link."""
        listening = listen("127.0.0.1", 0)
        link = f"http://127.0.0.1:{listening.getsockname()[1]}/operator#{self.service.access.operator}"
        failed = list[Exception]()

        async def beside() -> None:
            robots = len(self.session.outlook().robots)
            self.bridge = (bridge_of(made, robots) if isinstance(made, Path) else made)(link, **options)
            bridge = asyncio.create_task(self.bridge.run())
            try:
                await asyncio.wait_for(work(), 120)
                assert not bridge.done()
            except Exception as error:  # noqa: BLE001  raised when the service has ended
                failed.append(error)
            finally:
                bridge.cancel()
                await asyncio.gather(bridge, return_exceptions=True)

        asyncio.run(run(self.app, listening, lambda: None, beside(), ends=True))
        for error in failed:
            raise error

    def is_as_over_http(self, reports: Reports, done: dict[str, list[str]]) -> None:
        """Check that beliefs are those of the same events over HTTP, bit for bit, and that people did these actions."""
        there = Here(self.folder / "http", self.people, self.setting)
        with TestClient(there.app, headers=there.headers) as client:
            for path, body in reports:
                assert client.post(f"/api/{path}", json=body).status_code == 200
        for one in (self, there):
            assert done_of(one.session.history.log(), done) == done
        assert self.session.history.beliefs() == there.session.history.beliefs()


async def until(said: Callable[[], Any]) -> None:
    while not said():
        await asyncio.sleep(0.01)


def acted(name: str, action: str, **more: Any) -> tuple[str, dict[str, Any]]:
    """Return the report that a person acts."""
    return f"people/{name}/actions", {"action": action, **more}


def done_of(rows: Iterable[dict[str, Any]], people: Iterable[str]) -> dict[str, list[str]]:
    listed = list(rows)
    return {name: [row["action"] for row in listed if row["person"] == name] for name in people}


def plans(table: Table, people: int, length: int, seed: int) -> dict[str, list[str]]:
    """Return a random walk for each person that ends before the goal."""
    rng, goal = random.Random(seed), table.space.goal
    found = {}
    for number in range(1, people + 1):
        state, plan = table.space.initial, list[str]()
        while len(plan) < length:
            options = {action: to for action, to in table.space.options(state).items() if not goal[to]}
            action = rng.choice(list(options))
            state = options[action]
            plan.append(action)
        found[f"person-{number}"] = plan
    return found
