"""One cell of a study: sampling its people, preparing policies, and simulating teams."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from planner import Cache, CostToGo, Instance, Table, cost_to_go, load
from planner.system.errors import InputFileError
from planner.system.progress import Progress, adding

from ..declare.tables import fault
from ..people.arguments import require_goal
from ..people.choices import Choices
from ..people.memory import choices_of
from ..people.ranges import Population
from ..people.user_code import UserCodeError
from ..person.assumptions import Assumptions
from ..person.leaf_bounds import LeafBounds
from ..person.person_problem import is_whole
from ..person.qmdp import qmdp
from ..person.settings import require_effect
from ..person.solution_cache import SolutionCache
from ..person.state_cache import StateCache
from ..person.truncated_task import TruncatedTask
from ..team.episodes import Episodes
from ..team.policies import UserPolicy
from ..team.pool import Pool
from ..team.simulate import simulate
from ..team.state import TeamPolicy
from .study import OWN, Cell, Study

MEASURED = (
    "actions", "costs", "helped", "finished", "interventions", "moves", "steps", "discounted_return",
)  # fmt: skip
"""What the record of an episode has as the episode says it."""


def pool_of(study: Study, cell: Cell) -> Pool:
    """Draw a cell's pool of people, and solve the POMDP of each person.

    Parameters
    ----------
    study : Study
    cell : Cell
    """
    population, prior = _people(study, cell)
    task = _task_of(study, cell)
    whole = isinstance(task, Choices)
    tolerance = 1e-3  # of values, in cost units; far below any cost that a policy weighs
    return Pool.sample(
        task, study.pool, seed=study.seed_of(cell.repeat), setting=study.setting(cell),
        population=population, prior=prior, solver=partial(_solutions().qmdp, tolerance=tolerance) if whole else qmdp,
    )  # fmt: skip


def policy_of(study: Study, name: str, pool: Pool) -> TeamPolicy:
    """Return a team policy of the package, or a policy of the user.

    Parameters
    ----------
    study : Study
    name : str
    pool : Pool
    """
    own = dict(study.own_policies)
    return _own(*own[name]) if name in own else pool.policy(name, solver=_solutions().qmdp)


@dataclass(frozen=True)
class Outcome:
    """The results of a cell.

    Attributes
    ----------
    lines : str
        A line of JSON for each episode.
    seconds : dict
        Wall-clock seconds of each part of the work.
    """

    lines: str
    seconds: dict[str, float]


def carry_out(cell: Cell, study: Study) -> Outcome:
    """Simulate all teams of a cell under all policies of its condition.

    Parameters
    ----------
    cell : Cell
    study : Study
    """
    seconds: dict[str, float] = {}
    start = time.perf_counter()

    def lap(what: str) -> None:
        nonlocal start
        now = time.perf_counter()
        seconds[what], start = seconds.get(what, 0.0) + now - start, now

    _task_of(study, cell)
    lap("cost-to-go")
    pool = pool_of(study, cell)
    lap("people's POMDPs")
    condition = study.condition(cell.condition)
    lines: list[str] = []
    for name in condition.policies:
        chosen = policy_of(study, name, pool)
        lap(f"preparing {name}")
        for humans in condition.humans:
            teams = study.teams(cell.repeat, humans)
            episodes = simulate(
                pool, chosen, humans=teams, episodes=len(teams), seed=study.seed_of(cell.repeat), name=name,
            )  # fmt: skip
            lap(f"simulating {name}")
            lines += [json.dumps(record) + "\n" for record in _records(cell, episodes, humans, study.trials)]
            lap("records")
    return Outcome("".join(lines), seconds)


def _records(cell: Cell, episodes: Episodes, humans: int, trials: int) -> Iterator[dict[str, Any]]:
    """Yield the record of `episodes.jsonl` for each episode. People's parameters are rounded to four digits."""
    for episode in episodes:
        draw, trial = divmod(episode.episode, trials)
        yield {
            **asdict(cell), "policy": episode.policy, "humans": humans, "draw": draw, "trial": trial,
            "people": [int(name.rpartition("-")[2]) for name in episode.people],
            **{name: [round(one, 4) for one in getattr(episode, name)] for name in ("beta", "theta", "sigma")},
            **{name: getattr(episode, name) for name in MEASURED},
        }  # fmt: skip


def _people(study: Study, cell: Cell) -> tuple[Population, Population]:
    """Return the population from which a cell's people are drawn, and the robot's prior."""
    populations = dict(study.populations)
    population = populations[cell.population]
    return population, population if cell.prior == OWN else populations[cell.prior]


def _task_of(study: Study, cell: Cell) -> CostToGo | Choices:
    """Return a cell's task, with the terms that its people's choices depend on."""
    names = dict.fromkeys(name for people in _people(study, cell) for name in people.weights)
    return _task(dict(study.instances)[cell.instance], tuple(names))


@cache  # consecutive cells of a process often share the task
def _task(instance: Instance, names: tuple[str, ...] = ()) -> CostToGo | Choices:
    """Read and solve a task, once in each process for each set of terms. Small tasks are enumerated.

    What is enumerated is the same for all cells, and so are its solutions (`_solutions`). A truncated task has neither.
    """
    task = load(instance)
    known = cost_to_go(task, cache=Cache(task))
    try:
        require_goal(float(known.lookup([known.initial])[0]))
    except ValueError as error:
        raise InputFileError(f"{instance}: {error}") from None
    return choices_of(known, names) if isinstance(known, Table) and (names or is_whole(known)) else known


def _part(task: CostToGo | Choices) -> tuple[Choices, LeafBounds | None]:
    """Return the task's choices, or those of a small truncated problem, for checking a setting."""
    if isinstance(task, Choices):
        return task, None
    region = TruncatedTask.around(StateCache(task), np.array([task.initial]))
    bound = np.zeros(len(region.frontier))
    return region.choices, LeafBounds(region.frontier, np.zeros((len(bound), 1, 2)), bound[:, None, None])


@cache
def _solutions() -> SolutionCache:
    """Return the solutions that the cells of a process share. Neither priors nor people's true rule matter to them."""
    return SolutionCache()


@cache
def _own(file: Path, name: str) -> UserPolicy:
    """Load a user's policy, once in each process."""
    return UserPolicy.load(file, name)


def check(study: Study, progress: Progress = lambda *_: None) -> None:
    """Check all tasks, user policies and settings, so that errors are reported before the work begins.

    Parameters
    ----------
    study : Study
    progress : callable
        Receives the number of tasks that are solved, as in `planner.system.progress`.

    Raises
    ------
    InputFileError, planner.PDDLError
    """
    once, most = replace(study, repeats=1), 100_000_000  # whose records take about 50 GB
    if (episodes := study.repeats * sum(map(once.episodes, once.cells()))) > most:
        raise InputFileError(f"{study.file}: {episodes:.3g} episodes; expected at most {most:,}")
    advance = adding(progress, "solving tasks", len(study.instances))
    for _, files in study.instances:
        _task(files)
        advance(1)
    for _, (file, name) in study.own_policies:
        try:
            _own(file, name)
        except UserCodeError as error:
            raise InputFileError(str(error)) from None
    try:
        require_effect(setting for condition in study.conditions for _, setting in condition.settings)
    except ValueError as error:
        raise fault(study.file, "setting", str(error)) from None
    for number, condition in enumerate(study.conditions, start=1):
        for which, (label, setting) in enumerate(condition.settings, start=1):
            for name in condition.instances:
                try:
                    choices, frontier = _part(_task(dict(study.instances)[name]))
                    Assumptions.of(setting, None, Population()).problem(choices, frontier)
                    setting.require_questions(possible=choices.goals.distinguished)
                    for places in condition.humans:
                        setting.neighbourhood(places)
                except ValueError as error:
                    place = f"conditions[{number}].settings[{which}]" if label else "setting"
                    raise fault(study.file, place, str(error)) from None
