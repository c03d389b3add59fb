"""What it saves to carry beliefs in people from task to task, against beginning each task with the prior.

    python bench/carried.py [--people 200] [--tasks 5] [--instance FILE] [--record FILE]

Simulated people do several tasks one after the other, each with a robot of their own: once with a belief that is taken
from a `PeopleStore` and saved there, and once without. The people and all their random numbers are the same.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import click
import numpy as np
from live_load import PAPER
from tables import Columns, cell, record_option, write_record

from assist.live import Assistant, PeopleStore
from assist.live.live_task import LiveTask
from assist.live.people_store import model_of
from assist.live.simulated_person import SimulatedPerson
from assist.people.mixture import advice_takers
from assist.person.policy import Policy
from assist.reports.statistics import IntervalEstimate, mean
from assist.team.settings import Setting
from planner import CostToGo, cost_to_go, load


def cost(
    team: Assistant, task: CostToGo, person: SimulatedPerson, c_suggest: float, most: int = 500
) -> tuple[float, float]:
    """Return the costs of a person's actions and of the suggestions, and the number of suggestions not followed."""
    total, declined = 0.0, 0.0
    for _ in range(most):
        seen = team.person("ann")
        if seen.finished:
            break
        suggestion = team.recommend().suggestion
        action = person.act(task, seen.state, seen.applicable, suggestion)
        number = {name: n for n, name in enumerate(task.task.actions)}[action]
        total += float(task.task.costs[number]) + c_suggest * (suggestion is not None)
        declined += suggestion not in (None, action)
        team.observe("ann", action)
    return total, declined


def costs(
    task: CostToGo, solved: Policy, setting: Setting, seed: int, tasks: int, store: PeopleStore | None
) -> list[tuple[float, float]]:
    """Return the costs of one person's tasks, in their order, and the suggestions not followed."""
    population, found = advice_takers(), list[tuple[float, float]]()
    person = SimulatedPerson(population, trust=setting.for_real_people().trust_rule(), seed=seed)
    model = model_of(population.as_dict(), setting.as_dict())
    for number in range(tasks):
        person.rng = np.random.default_rng([seed, number])  # the same in both ways, whatever happened before
        team = Assistant(solved, setting=setting)
        team.join("ann", belief=None if store is None else store.belief("ann", model))
        found.append(cost(team, task, person, setting.c_suggest))
        if store is not None:
            store.save("ann", model, team.person("ann").belief)
    return found


def interval(one: IntervalEstimate) -> str:
    """Return a mean with its 95 % interval."""
    return f"{one.value:.2f} [{one.low:.2f}, {one.high:.2f}]"


COLUMNS: Columns = {
    "people": cell("people"),
    "task": cell("task"),
    "cost anew": cell("anew", ".2f"),
    "saved by carrying": lambda row: interval(row["saved"]),
    "suggestions not followed, anew": cell("declined", ".2f"),
    "fewer by carrying": lambda row: interval(row["fewer"]),
}


@click.command()
@click.option("--people", default=200, show_default=True)
@click.option("--tasks", default=5, show_default=True)
@click.option("--instance", type=Path, default=PAPER)
@record_option
def main(people: int, tasks: int, instance: Path, record: Path | None) -> None:
    """Let people do their tasks both ways."""
    task, setting = cost_to_go(load(instance)), Setting(c_suggest=0.2, c_move=0.0)
    solved = LiveTask(task, setting.for_real_people(), advice_takers()).policy
    anew, carried = np.empty((people, tasks, 2)), np.empty((people, tasks, 2))
    for seed in range(people):
        anew[seed] = costs(task, solved, setting, seed, tasks, None)
        with tempfile.TemporaryDirectory() as folder:
            store = PeopleStore(Path(folder) / "people.sqlite")
            carried[seed] = costs(task, solved, setting, seed, tasks, store)
    rows = []
    for number in range(tasks + 1):
        chosen = slice(None) if number == tasks else slice(number, number + 1)
        saved, fewer = (mean((anew - carried)[:, chosen, one].sum(axis=1)) for one in (0, 1))
        name = f"all {tasks}" if number == tasks else str(number + 1)
        cost, declined = anew[:, chosen].sum(axis=1).mean(axis=0)
        rows.append(
            {"people": people, "task": name, "anew": cost, "saved": saved, "declined": declined, "fewer": fewer}
        )  # fmt: skip
        print("; ".join(show(rows[-1]) for show in COLUMNS.values()), flush=True)
    write_record(record, COLUMNS, rows)


if __name__ == "__main__":
    main()
