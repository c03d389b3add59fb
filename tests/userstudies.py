"""A small user study for tests, and a participant without a network."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from conftest import KITTING

from assist.live.event_base import TeamEvent
from assist.live.events import kinds
from assist.studies.userstudy import StudySession, forecast, read
from assist.studies.userstudy.csv_tables import written as written_rows
from assist.studies.userstudy.events import StudyEvent
from assist.studies.userstudy.forecast import Forecast
from assist.studies.userstudy.tables import COLUMNS
from planner import Table

Open = Callable[..., StudySession]

PLAN = f"""title = "A small study"
tasks = ["{KITTING}/tiny.pddl"]
practice = "{KITTING}/tiny.pddl"
reference = "none"
simulated = 2
away = 10
seed = 3
consent = \"\"\"
Do you *agree*?
\"\"\"
instructions = "Put everything where it belongs."

[setting]
c_suggest = 0.02
c_move = 0.01

[[questionnaires]]
form = "nasa-tlx"

[[questionnaires]]
form = "likert"
name = "trust"
items = [
    {{ name = "rely", text = "I could rely on it." }}, {{ name = "wary", text = "I was wary.", reversed = true }},
]

[[questionnaires]]
form = "text"
name = "remarks"
items = [{{ name = "remarks", text = "Anything else?" }}]

[[conditions]]
name = "none"
policy = "none"

[[conditions]]
name = "attention"
policy = "attention"
"""

WITHOUT_PRACTICE = PLAN.replace(f'practice = "{KITTING}/tiny.pddl"\n', "")
ALONE = WITHOUT_PRACTICE.replace("simulated = 2", "simulated = 0")

ALIKE = PLAN.replace("seed = 3", "seed = 3\npopulation = { beta = [0.3, 1], theta = [0.7, 1] }")
"""A study of people who are so much alike that few of them tell the difference of two conditions."""

SCORES: dict[str, dict[str, Any]] = {
    "nasa-tlx": {
        "mental": 50, "physical": 10, "temporal": 20, "performance": 30, "effort": 40, "frustration": 0,
    },
    "trust": {"rely": 6, "wary": 3},
    "remarks": {"remarks": "=1+1, no"},
}  # fmt: skip


def written(file: Path, text: str = PLAN) -> Path:
    file.write_text(text, encoding="utf-8")
    return file


def exported(folder: Path, text: str = PLAN, tables: Mapping[str, Any] | None = None, **rows: Any) -> Path:
    """Write an unpacked export of a study with the given rows of its tables, in which fields may be missing."""
    folder.mkdir(exist_ok=True)
    written(folder / "study.toml", text)
    for name, columns in COLUMNS.items():
        plain = [dict.fromkeys(columns) | row for row in ({**(tables or {}), **rows}).get(name, [])]
        (folder / f"{name}.csv").write_text(written_rows(columns, plain))
    return folder


@pytest.fixture(scope="session")
def foreseen(tiny: Table, tmp_path_factory: pytest.TempPathFactory) -> Forecast:
    """What 24 people who are alike would show, by one round of 40 simulated people."""
    text = ALIKE.replace("seed = 3", "seed = 3\nparticipants = 24")
    study = read(written(tmp_path_factory.mktemp("foreseen") / "study.toml", text))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(forecast, "PEOPLE", 40)
        patch.setattr(forecast, "EFFORT", 0)
        return Forecast.of(study, {"tiny": tiny})


@pytest.fixture
def opened(tiny: Table, tmp_path: Path) -> Iterator[Open]:
    """A function that opens a study in a folder, and begins it or goes on with it; all are closed after the test."""
    held: list[StudySession] = []

    def open_it(text: str = PLAN, folder: Path = tmp_path / "data") -> StudySession:
        study = read(written(tmp_path / "study.toml", text))
        held.append(StudySession(study, {"tiny": tiny, "practice": tiny}, folder))
        return held[-1]

    yield open_it
    for session in held:
        session.close()


class Part:
    """A participant."""

    def __init__(self, session: StudySession, name: str) -> None:
        self.session, self.name = session, name

    @property
    def stage(self) -> str:
        return str(self.session.person(self.name)["study"]["stage"])

    @property
    def what(self) -> str:
        return str(self.session.person(self.name)["study"]["what"])

    @property
    def kind(self) -> str:
        return str(self.session.person(self.name)["study"]["kind"])

    def report(self, kind: str, **more: Any) -> dict[str, Any]:
        outcome = self.session.report_all([(kinds(TeamEvent) | kinds(StudyEvent))[kind](person=self.name, **more)])[0]
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    def come(self) -> dict[str, Any]:
        return self.report("visited", id=f"visit {self.name}")

    def onward(self, answers: dict[str, Any] | None = None) -> dict[str, Any]:
        stage = self.stage
        return self.report("onward", stage=stage, answers=answers or SCORES.get(self.what))

    def errs(self) -> None:
        """Take the action whose successor has the largest h*."""
        table, state = self.session.task_and_state(self.name)
        rows = table.choices([state])
        costs = table.lookup(rows.targets)
        self.report("acted", action=table.task.actions[int(rows.actions[int(costs.argmax())])])

    def finish(self) -> None:
        while not self.session.person(self.name)["study"]["over"]:
            table, state = self.session.task_and_state(self.name)
            rows = table.choices([state])
            best = int(rows.actions[int(table.lookup(rows.targets).argmin())])
            self.report("acted", action=table.task.actions[best])

    def to(self, stage: str) -> None:
        while self.stage != stage:
            if self.kind in ("practice", "task"):
                self.finish()
            self.onward()
