"""What it saves to carry beliefs in people from task to task, against beginning each task with the prior.

    python bench/carried.py [--people 20000] [--tasks 5] [--instance FILE] [--record FILE]

Simulated people do several tasks one after the other, each with a robot of their own: once with the belief of the last
task, as `PeopleStore` keeps it, and once with the prior. The people and the random numbers of each task are the same.
Influence theta goes on from task to task in both.
"""

from __future__ import annotations

from pathlib import Path
from threading import Event
from typing import Any

import click
import numpy as np
from live_load import PAPER
from tables import Columns, cell, record_option, write_record

from assist.people.decision import Floats
from assist.people.real_people import advice_takers
from assist.reports.statistics import IntervalEstimate, mean
from assist.simulation.model_group import ModelGroup
from assist.simulation.pool import Pool
from assist.simulation.run import Run, StepTaken
from assist.simulation.schedule import Schedule
from assist.team.settings import Setting
from planner import CostToGo, cost_to_go, load

MEASURES = "cost", "return", "actions", "suggestions", "declined"


class Task(Run):
    """A task that everybody in a pool does alone.

    Attributes
    ----------
    declined : int array, shape (N, 1)
        Numbers of suggestions that were not followed.
    """

    def __init__(self, pool: Pool, group: ModelGroup, seed: int, before: Task | None, *, carries: bool) -> None:
        people = np.arange(len(pool.people))
        super().__init__(
            pool, pool.policy("attention"), teams=people[:, None], numbers=people, seed=seed, name="attention",
            travel=pool.setting.travel(1), presence=Schedule.of(1), world="people", over=Event(),
            groups={0: group}, questions=None, goals="inferred",
        )  # fmt: skip
        self.declined = np.zeros(self.places.shape, dtype=np.int64)
        if before is not None:
            self.theta, self.seen = before.theta.copy(), before.seen.copy()
        if before is not None and before.belief is not None and carries:
            self.belief = before.belief.copy()

    def watch(self, taken: StepTaken) -> None:
        """Count the suggestions that are not followed."""
        (group,) = self.groups.values()  # one for all, since the robot does not know what people are mistaken about
        rows = taken.flat[taken.robot.reshape(-1)[taken.flat] > 0]
        suggested = group.arrays.suggested[taken.before.reshape(-1)[rows], taken.robot.reshape(-1)[rows]]
        self.declined.reshape(-1)[rows] += taken.slot[rows] != suggested

    def measures(self) -> Floats:
        """Return the measures of each person, shape (N, len(MEASURES))."""
        done = self.run()
        cost = self.costs[:, 0] + self.pool.setting.c_suggest * done.interventions
        return np.column_stack(
            (cost, self.discounted, self.actions[:, 0], done.interventions, self.declined[:, 0])
        ).astype(float)


def measured(table: CostToGo, setting: Setting, people: int, tasks: int, seed: int, *, carries: bool) -> Floats:
    """Return the measures of each person in each task, shape (people, tasks, len(MEASURES))."""
    pool = Pool.sample(table, people, population=advice_takers(), setting=setting, seed=seed)
    group, before, found = ModelGroup(pool, 0, "people"), None, list[Floats]()
    for number in range(tasks):
        before = Task(pool, group, tasks * seed + number, before, carries=carries)
        found.append(before.measures())
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
