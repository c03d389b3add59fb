"""What it saves to carry beliefs in people from task to task, against beginning each task with the prior.

    python bench/carried.py [--people 20000] [--tasks 5] [--instance FILE] [--record FILE]

Simulated people do several tasks one after the other, each with a robot of their own: once with the belief of the last
task, as `PeopleStore` keeps it, and once with the prior. The people and the random numbers of each task are the same.
Influence theta goes on from task to task in both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Any

import click
import numpy as np
from live_load import PAPER
from tables import Columns, cell, record_option, write_record

from assist.people.decision import Floats
from assist.people.real_people import advice_takers
from assist.person.settings import Setting
from assist.reports.statistics import IntervalEstimate, mean
from assist.simulation.beginning import Beginning
from assist.simulation.common_random_numbers import CommonRandomNumbers
from assist.simulation.model_group import ModelGroup
from assist.simulation.pool import Pool
from assist.simulation.run import Ints, Simulation, Watcher
from assist.simulation.schedule import Schedule
from assist.team.engine import Engine, StepTaken
from assist.team.questions import Asked
from assist.team.state import TeamAction, TeamState
from planner import CostToGo, cost_to_go, load

MEASURES = "cost", "return", "actions", "suggestions", "declined"


@dataclass(frozen=True)
class Task(Simulation):
    """A task that everybody in a pool does alone.

    Attributes
    ----------
    before : Engine or None
        The same people after the task before.
    carries : bool
        Whether the robot begins with its beliefs after the task before.
    """

    before: Engine | None = None
    carries: bool = False

    def begin(self, people: Ints, began: Beginning, draws: CommonRandomNumbers, *, beliefs: bool) -> Engine:
        """Return the people as the task before has left them."""
        engine = super().begin(people, began, draws, beliefs=beliefs)
        if self.before is not None:
            engine.people.theta[:], engine.people.seen[:] = self.before.people.theta, self.before.people.seen
            if self.carries:
                engine.beliefs.belief[:] = self.before.beliefs.belief
        return engine


class Declined(Watcher):
    """Counts the suggestions that are not followed.

    Attributes
    ----------
    number : int array, shape (N, 1)
    engine : Engine
        The people, after the task.
    """

    engine: Engine

    def __init__(self, people: int) -> None:
        self.number = np.zeros((people, 1), dtype=np.int64)

    def asked(self, engine: Engine, asked: Sequence[tuple[Asked, bool]]) -> None:
        """See questions, of which there are none."""

    def decided(self, engine: Engine, team: TeamState, action: TeamAction, teams: Ints) -> None:
        """See what robots do."""

    def took(self, engine: Engine, taken: StepTaken) -> None:
        """Count what is not followed in a step."""
        self.engine = engine
        (group,) = engine.tasks.groups.values()  # one, since the robot does not know what people are mistaken about
        told = taken.now.active & (taken.robot > 0)
        self.number[told] += taken.slot[told] != group.arrays.suggested[taken.before[told], taken.robot[told]]


def measured(table: CostToGo, setting: Setting, people: int, tasks: int, seed: int, *, carries: bool) -> Floats:
    """Return the measures of each person in each task, shape (people, tasks, len(MEASURES))."""
    pool = Pool.sample(table, people, population=advice_takers(), setting=setting, seed=seed)
    policy, travel, presence = pool.policy("attention"), setting.travel(1), Schedule.of(1)
    groups, numbers = {0: ModelGroup(pool, 0, "people")}, np.arange(people)
    before, found = None, list[Floats]()
    for number in range(tasks):
        declined = Declined(people)
        done = Task(
            pool, policy, "attention", tasks * seed + number, travel, presence, "people", "inferred", groups,
            questions=None, over=Event(), before=before, carries=carries,
        ).chunk(numbers, numbers[:, None], declined)  # fmt: skip
        before = declined.engine
        cost = done.costs[:, 0] + setting.c_suggest * done.interventions
        measures = cost, done.discounted_return, done.actions[:, 0], done.interventions, declined.number[:, 0]
        found.append(np.column_stack(measures).astype(float))
    return np.stack(found, axis=1)


def interval(one: IntervalEstimate) -> str:
    """Return a mean with its 95 % interval."""
    return f"{one.value:.3f} [{one.low:.3f}, {one.high:.3f}]"


def row_of(task: str, anew: Floats, carried: Floats) -> dict[str, Any]:
    """Return a row of the table for measures of shape (people, tasks, len(MEASURES))."""
    row: dict[str, Any] = {"people": len(anew), "task": task}
    for number, name in enumerate(MEASURES):
        first, second = (measures[:, :, number].sum(axis=1) for measures in (anew, carried))
        row[name] = first.mean()
        row[f"{name} saved"] = mean(second - first if name == "return" else first - second)
    return row


TITLES = {
    "cost": "cost saved", "return": "return gained", "actions": "fewer actions", "suggestions": "fewer suggestions",
    "declined": "fewer not followed",
}  # fmt: skip
COLUMNS: Columns = {"people": cell("people", ","), "task": cell("task")} | {
    title: show
    for name in MEASURES
    for title, show in (
        (f"{'not followed' if name == 'declined' else name}, anew", cell(name, ".2f")),
        (TITLES[name], lambda row, name=name: interval(row[f"{name} saved"])),
    )
}


@click.command()
@click.option("--people", default=20_000, show_default=True)
@click.option("--tasks", default=5, show_default=True)
@click.option("--instance", type=Path, default=PAPER)
@click.option("--together", default=1000, show_default=True, help="People who are simulated at a time.")
@record_option
def main(people: int, tasks: int, instance: Path, together: int, record: Path | None) -> None:
    """Let people do their tasks both ways."""
    table, setting = cost_to_go(load(instance)), Setting(c_suggest=0.2, c_move=0.0, knowledge="exact").for_real_people()
    sizes = [min(together, people - start) for start in range(0, people, together)]
    anew, carried = (
        np.concatenate(
            [measured(table, setting, size, tasks, seed, carries=carries) for seed, size in enumerate(sizes)]
        )
        for carries in (False, True)
    )
    chosen = {str(number + 1): slice(number, number + 1) for number in range(tasks)} | {f"all {tasks}": slice(None)}
    rows = [row_of(name, anew[:, where], carried[:, where]) for name, where in chosen.items()]
    for row in rows:
        print("; ".join(show(row) for show in COLUMNS.values()), flush=True)
    write_record(record, COLUMNS, rows)


if __name__ == "__main__":
    main()
