"""Goal recognition on public problems: `infer_goals` beside cost differences (Ramírez and Geffner, AAAI 2010).

    GOAL_RECOGNITION=FOLDER python bench/goals.py [--per-domain N] [--domain NAME] [--record FILE]

FOLDER is a checkout of `pucrs-automated-planning/goal-plan-recognition-dataset`: for each problem a domain, an initial
state, candidate goals, the true goal and the recorded plan, all of whose actions are observed. Without the variable
nothing is measured. Problems are drawn at random from each domain, among those of at most `--max-states` states
and with searches of at most `SECONDS`.

Both methods see the same first part of each plan, know the same candidate goals, and begin with equal probabilities.
The likelihood of the baseline is 1 / (1 + exp(c(O) - c(not O))) for each goal: c(O) is the cost of an optimal plan in
which the observations occur in their order, c(not O) that of an optimal plan in which they do not. Fast Downward
computes both on tasks with a further variable, the number of observations so far. If c(O) exceeds the cost of an
optimal plan, the latter is c(not O), and needs no search.
"""

from __future__ import annotations

import math
import os
import random
import re
import tarfile
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from tables import Columns, cell, record_option, write_record

from assist.learning import Log, infer_goals
from planner import (
    Effect,
    LimitError,
    Limits,
    Operator,
    PDDLError,
    Table,
    Task,
    Variable,
    astar,
    load,
    sweep,
    sweep_goals,
)  # fmt: skip

SHARES = (0.1, 0.3, 0.5, 0.7, 1.0)
SECONDS = 20.0  # of each sweep and of each of Fast Downward's searches
COLUMNS: Columns = {
    "domain": cell("domain"),
    "share of the plan": lambda row: f"{100 * row['share']:.0f} %",
    "problems": cell("problems"),
    "accuracy": cell("accuracy", ".2f", "accuracy_error"),
    "accuracy, cost differences": cell("baseline_accuracy", ".2f", "baseline_accuracy_error"),
    "Brier score": cell("brier", ".2f", "brier_error"),
    "Brier score, cost differences": cell("baseline_brier", ".2f", "baseline_brier_error"),
}


class Problem:
    """A recognition problem: the task of each candidate goal, the number of the true one, and the plan.

    Parameters
    ----------
    file : Path
        Archive of the problem.
    max_states : int
    """

    def __init__(self, file: Path, max_states: int) -> None:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            with tarfile.open(file) as archive:
                archive.extractall(folder, filter="data")
            text = (folder / "template.pddl").read_text()
            goals = list(dict.fromkeys(_lines(folder / "hyps.dat")))
            self.plan = _lines(folder / "obs.dat")
            (true,) = _lines(folder / "real_hyp.dat")

            def task_of(goal: str) -> Task:
                problem = folder / f"goal-{goals.index(goal)}.pddl"
                problem.write_text(text.replace("<HYPOTHESIS>", goal.replace(",", " ")))
                return load(problem, folder / "domain.pddl")

            sweep(task_of(true), max_states=max_states, deadline=time.monotonic() + SECONDS)  # is it small enough?
            tasks = {goal: task_of(goal) for goal in goals}
        # A goal that the translator decides needs no actions, or cannot be reached.
        tasks = {goal: task for goal, task in tasks.items() if not task.decided_by_translator}
        self.true = list(tasks).index(true)
        tables = sweep_goals(list(tasks.values()))
        self.tables: dict[str, Table] = dict(zip(tasks, tables, strict=True))
        self.cost = [_cost(table.task) for table in tables]


def _lines(file: Path) -> list[str]:
    return [line.strip().lower() for line in file.read_text().splitlines() if line.strip()]


def _cost(task: Task) -> float:
    return astar(task, limits=Limits(seconds=SECONDS))[0]


def observed(task: Task, seen: Sequence[str], *, complied: bool) -> Task:
    """Return the task whose plans contain the observations in their order, or, if not `complied`, do not."""
    progress, count = len(task.variables), len(seen)
    counter = Variable("observed", tuple(f"Atom observed({number})" for number in range(count + 1)), -1)
    operators = []
    for operator in task.operators:
        action = task.actions[operator.action]
        if action not in seen:
            operators.append(operator)
            continue
        for number in range(count + 1):
            before = (*operator.preconditions, (progress, number))
            if number == count or seen[number] != action:
                operators.append(Operator(operator.action, before, operator.effects))
            elif complied or number + 1 < count:
                effects = (*operator.effects, Effect((), progress, number + 1))
                operators.append(Operator(operator.action, before, effects))
    goal = (*task.goal, (progress, count)) if complied else task.goal
    return replace(
        task, variables=(*task.variables, counter), operators=tuple(operators), initial=(*task.initial, 0), goal=goal
    )


def by_cost_differences(problem: Problem, seen: Sequence[str]) -> NDArray[np.float64]:
    """Return the posterior over goals of Ramírez and Geffner."""
    likelihood = []
    for table, optimal in zip(problem.tables.values(), problem.cost, strict=True):
        complied = _cost(observed(table.task, seen, complied=True))
        other = optimal if complied > optimal else _cost(observed(table.task, seen, complied=False))
        difference = math.inf if math.isinf(complied) else complied - other
        likelihood.append(1 / (1 + math.exp(min(difference, 700.0))) if difference < math.inf else 0.0)
    total = sum(likelihood)
    return np.array(likelihood) / total if total else np.full(len(likelihood), 1 / len(likelihood))


def scores(posterior: NDArray[np.float64], true: int) -> tuple[float, float]:
    """Return the probability that the most probable goal is the true one, with random ties, and the Brier score."""
    best = posterior >= posterior.max() - 1e-9
    truth = np.arange(len(posterior)) == true
    return float(best[true] / best.sum()), float(((posterior - truth) ** 2).sum())


def measured(problem: Problem) -> Iterator[dict[str, float]]:
    """Yield the scores of both methods for each share of the plan."""
    rows = [{"person": "agent", "episode": "plan", "step": n, "action": a} for n, a in enumerate(problem.plan)]
    (episode,) = infer_goals(problem.tables, Log.of(rows)).episodes
    for share in SHARES:
        length = max(1, round(share * len(problem.plan)))
        ours = scores(episode.posterior[length - 1], problem.true)
        theirs = scores(by_cost_differences(problem, problem.plan[:length]), problem.true)
        names = "accuracy", "brier", "baseline_accuracy", "baseline_brier"
        yield {"share": share, **dict(zip(names, (*ours, *theirs), strict=True))}


def sampled(folder: Path, count: int, max_states: int, seed: int) -> Iterator[list[dict[str, float]]]:
    """Yield the scores of up to `count` problems of a domain, drawn at random."""
    files = sorted((folder / "100").glob("*.tar.bz2"))
    random.Random(seed).shuffle(files)
    refused: set[str] = set()
    for file in files:
        base = re.sub(r"_(hyp|generic).*", "", file.name)  # problems that differ in the true goal
        if count == 0 or base in refused:
            continue
        begun = time.monotonic()
        try:
            problem = Problem(file, max_states)
            own = list(measured(problem))
        except (LimitError, PDDLError, ValueError) as error:
            print(f"{folder.name}/{base}: {error}", flush=True)
            refused.add(base)
            continue
        count -= 1
        told = " ".join(f"{one['accuracy']:.2f}/{one['baseline_accuracy']:.2f}" for one in own)
        seconds = time.monotonic() - begun
        print(f"{folder.name}/{file.name}: {len(problem.tables)} goals, {told}, {seconds:.0f} s", flush=True)
        yield own


def averaged(domain: str, results: Sequence[Sequence[dict[str, float]]]) -> Iterator[dict[str, Any]]:
    """Yield a row for each share: means over problems, with standard errors."""
    for of_share in zip(*results, strict=True):
        row: dict[str, Any] = {"domain": domain, "share": of_share[0]["share"], "problems": len(of_share)}
        for name in ("accuracy", "brier", "baseline_accuracy", "baseline_brier"):
            values = np.array([one[name] for one in of_share])
            row[name] = values.mean()
            row[f"{name}_error"] = values.std(ddof=1) / math.sqrt(len(values)) if len(values) > 1 else math.nan
        yield row


@click.command()
@click.option("--per-domain", type=click.IntRange(min=1), default=4, show_default=True, help="Problems of each domain.")
@click.option("--domain", "domains", multiple=True, help="Only these domains.")
@click.option("--max-states", type=click.IntRange(min=1), default=700_000, show_default=True)
@click.option("--seed", type=int, default=1, show_default=True)
@record_option
def main(per_domain: int, domains: tuple[str, ...], max_states: int, seed: int, record: Path | None) -> None:
    """Compare both methods by the share of the plan that they have seen."""
    place = os.environ.get("GOAL_RECOGNITION")
    if not place:
        print("nothing is measured: GOAL_RECOGNITION does not name a checkout of the problems")
        return
    results: dict[str, list[list[dict[str, float]]]] = {}
    for folder in sorted(Path(place).iterdir()):
        wanted = folder.name in domains if domains else not folder.name.endswith("-noisy")
        if not (wanted and (folder / "100").is_dir()):
            continue
        if own := list(sampled(folder, per_domain, max_states, seed)):
            results[folder.name] = own
    rows = list(averaged("all", [one for own in results.values() for one in own]))
    for domain, own in results.items():
        rows += averaged(domain, own)
    for row in rows:
        print(" | ".join(show(row) for show in COLUMNS.values()))
    write_record(record, COLUMNS, rows)


if __name__ == "__main__":
    main()
