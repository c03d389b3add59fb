"""A study as data: who is assisted, in which tasks, by which policies, and how often all of it is repeated.

A study, which `assist.study.protocol` reads from a file, consists of conditions. Each draws pools of
people from some populations, for some tasks, under some settings, and simulates teams of them. What is done in
one go is a `Cell`: one pool. Its people and their luck depend on the study's seed and the number of the repeat
alone, so that policies, team sizes, settings and conditions are compared on the same people with the same luck.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner import Instance, LimitError, load, sweep

from ..people.choices import Choices
from ..people.human import Mixture, Population
from ..person.qmdp import qmdp
from ..simulation.episodes import Episodes
from ..simulation.simulate import simulate
from ..team.policies import OwnPolicy
from ..team.pool import SIMULATED_STATES, Pool
from ..team.settings import Setting
from ..team.state import PolicyError, TeamPolicy

SCHEMA = 1
"""The version of what `episodes.jsonl` and `summary.json` hold."""

TOLERANCE = 1e-3  # of people's values, in cost units; far below any cost that a policy weighs
OF_NO_CONSEQUENCE = {"file", "title", "repeats", "focus", "contrasts", "reference"}  # for what episodes there are
OWN = "own"
"""The prior that is the population from which people are drawn."""


class StudyError(ValueError):
    """A study that cannot be carried out: what is wrong with which file, and what would be right."""


@dataclass(frozen=True)
class Condition:
    """A part of a study: all its populations, tasks, settings and priors are crossed.

    Attributes
    ----------
    name : str
    populations : tuple of str
        From whom people are drawn.
    instances : tuple of str
    policies : tuple of str
    humans : tuple of int
        Team sizes K.
    settings : tuple of pairs
        The label of each, and the setting itself.
    priors : tuple of str
        From which population the robot takes people to be drawn; `OWN`: from the one they are drawn from.
    repeats : int or None
        The most that this condition is repeated; None: as often as the study.
    """

    name: str
    populations: tuple[str, ...]
    instances: tuple[str, ...]
    policies: tuple[str, ...]
    humans: tuple[int, ...]
    settings: tuple[tuple[str, Setting], ...]
    priors: tuple[str, ...]
    repeats: int | None


@dataclass(frozen=True)
class Cell:
    """What is done in one go: one pool of people, and all teams that are drawn from it.

    Attributes
    ----------
    condition, setting, prior, population, instance : str
        Names and labels.
    repeat : int
        The number of the pool.
    """

    condition: str
    setting: str
    prior: str
    population: str
    instance: str
    repeat: int

    def __str__(self) -> str:
        named = (self.condition, self.setting, self.population, self.instance, f"repeat {self.repeat}")
        return ", ".join(part for part in named if part)


@dataclass(frozen=True)
class Reference:
    """What somebody has published, that a study is compared with.

    Attributes
    ----------
    source : str
        Where it stands.
    name : str
        What reports call it.
    headline : tuple of pairs
        The name and the percentage of each figure of the headline.
    interventions : tuple of pairs
        Populations, and the interventions that they got on average.
    declines : bool
        Whether it is claimed that less is saved in large teams than in small ones.
    contrasts : tuple of str
        The study's contrasts that are claimed to be more than 1.
    """

    source: str
    name: str = "the reference"
    headline: tuple[tuple[str, float], ...] = ()
    interventions: tuple[tuple[tuple[str, ...], float], ...] = ()
    declines: bool = False
    contrasts: tuple[str, ...] = ()


@dataclass(frozen=True)
class Contrast:
    """Two groups of populations, of which it is asked how many more interventions the first get.

    Attributes
    ----------
    name : str
    of, to : tuple of str
        Names of populations.
    """

    name: str
    of: tuple[str, ...]
    to: tuple[str, ...]


@dataclass(frozen=True)
class Study:
    """A study.

    Attributes
    ----------
    file : Path
    title : str
    seed : int
    repeats : int
        Pools that are drawn for each combination.
    pool : int
        People in a pool.
    draws, trials : int
        Teams that are drawn from each pool for each K, and episodes of each team.
    focus : str
        The policy that is compared with the others.
    populations : tuple of pairs
        Names, and who they are.
    instances : tuple of pairs
        Labels, and their files.
    own_policies : tuple of pairs
        Names, and the file and function of each.
    conditions : tuple of Condition
        The headline is that of the first.
    contrasts : tuple of Contrast
    reference : Reference or None
    """

    file: Path
    title: str
    seed: int
    repeats: int
    pool: int
    draws: int
    trials: int
    focus: str
    populations: tuple[tuple[str, Population | Mixture], ...]
    instances: tuple[tuple[str, Instance], ...]
    own_policies: tuple[tuple[str, tuple[Path, str]], ...]
    conditions: tuple[Condition, ...]
    contrasts: tuple[Contrast, ...]
    reference: Reference | None

    def condition(self, name: str) -> Condition:
        """Give a condition by its name."""
        return next(condition for condition in self.conditions if condition.name == name)

    def cells(self) -> Iterator[Cell]:
        """Give all that is to be done, repeat by repeat, in the order of the results."""
        for repeat in range(self.repeats):
            for condition in self.conditions:
                if condition.repeats is not None and repeat >= condition.repeats:
                    continue
                for setting, _ in condition.settings:
                    for prior in condition.priors:
                        for population in condition.populations:
                            for instance in condition.instances:
                                yield Cell(condition.name, setting, prior, population, instance, repeat)

    def episodes(self, cell: Cell) -> int:
        """Give how many episodes a cell has."""
        condition = self.condition(cell.condition)
        return len(condition.policies) * len(condition.humans) * self.draws * self.trials

    def setting(self, cell: Cell) -> Setting:
        """Give what a cell takes for granted."""
        return dict(self.condition(cell.condition).settings)[cell.setting]

    def fingerprint(self) -> str:
        """Give a digest of all that results depend on: the study, and the files that it names, but not `repeats`."""
        digest = hashlib.sha256()
        plain = {name: value for name, value in asdict(self).items() if name not in OF_NO_CONSEQUENCE}
        plain["schema"] = SCHEMA
        for name in ("instances", "own_policies"):
            plain[name] = [label for label, _ in getattr(self, name)]
        digest.update(json.dumps(plain, sort_keys=True).encode())
        named = [path for _, files in self.instances for path in (files.domain, files.problem)]
        for path in (*named, *(path for _, (path, _) in self.own_policies)):
            digest.update(hashlib.sha256(path.read_bytes()).digest())
        for _, (_, function) in self.own_policies:
            digest.update(function.encode())
        return digest.hexdigest()

    def record(self) -> dict[str, Any]:
        """Give the study as plain data, file names as texts."""
        return json.loads(json.dumps(asdict(self), default=str))

    def people(self, cell: Cell) -> Pool:
        """Draw a cell's pool, and solve the POMDP of each person."""
        populations = dict(self.populations)
        population = populations[cell.population]
        return Pool.sample(
            _choices(dict(self.instances)[cell.instance]), self.pool, seed=self.luck(cell.repeat),
            setting=self.setting(cell), population=population, solver=partial(qmdp, tolerance=TOLERANCE),
            prior=population if cell.prior == OWN else populations[cell.prior],
        )  # fmt: skip

    def luck(self, repeat: int) -> int:
        """Give the seed of a repeat."""
        words = np.random.SeedSequence(self.seed, spawn_key=(repeat,)).generate_state(4)
        return int.from_bytes(words.tobytes(), "little")

    def teams(self, repeat: int, humans: int) -> NDArray[np.int64]:
        """Give the team of each episode, shape (draws * trials, K): who has been drawn acts in some trials.

        A draw's team of K is part of its team of K + 1.
        """
        rng = np.random.default_rng(np.random.SeedSequence(self.luck(repeat), spawn_key=(2,)))
        drawn = rng.permuted(np.tile(np.arange(self.pool), (self.draws, 1)), axis=1)[:, :humans]
        return np.repeat(drawn, self.trials, axis=0)

    def policy(self, name: str, pool: Pool) -> TeamPolicy:
        """Make a team policy: one of the package's, or the study's own."""
        own = dict(self.own_policies)
        return _function(*own[name]) if name in own else pool.policy(name)


@dataclass(frozen=True)
class Outcome:
    """What became of a cell.

    Attributes
    ----------
    lines : str
        A line of JSON for each episode.
    seconds : dict
        How long each part of the work took.
    """

    lines: str
    seconds: dict[str, float]


def carry_out(cell: Cell, study: Study) -> Outcome:
    """Simulate all teams of a cell under all policies of its condition."""
    seconds: dict[str, float] = {}
    start = time.perf_counter()

    def lap(what: str) -> None:
        nonlocal start
        now = time.perf_counter()
        seconds[what], start = seconds.get(what, 0.0) + now - start, now

    _choices(dict(study.instances)[cell.instance])
    lap("cost-to-go")
    pool = study.people(cell)
    lap("people's POMDPs")
    condition = study.condition(cell.condition)
    lines = []
    for name in condition.policies:
        policy = study.policy(name, pool)
        lap(f"preparing {name}")
        for humans in condition.humans:
            teams = study.teams(cell.repeat, humans)
            episodes = simulate(
                pool, policy, humans=teams, episodes=len(teams), seed=study.luck(cell.repeat), name=name
            )
            lap(f"simulating {name}")
            lines += [json.dumps(record) + "\n" for record in _records(cell, episodes, humans, study.trials)]
            lap("records")
    return Outcome("".join(lines), seconds)


def _records(cell: Cell, episodes: Episodes, humans: int, trials: int) -> Iterator[dict[str, Any]]:
    """Give a line of `episodes.jsonl` for each episode; a person's parameters are rounded, the rest is exact."""
    for episode in episodes:
        draw, trial = divmod(episode.episode, trials)
        yield {
            **asdict(cell),
            "policy": episode.policy,
            "humans": humans,
            "draw": draw,
            "trial": trial,
            "people": [int(name.rpartition("-")[2]) for name in episode.people],
            "beta": [round(number, 4) for number in episode.beta],
            "theta": [round(number, 4) for number in episode.theta],
            "sigma": [round(number, 4) for number in episode.sigma],
            "actions": episode.actions,
            "helped": episode.helped,
            "finished": episode.finished,
            "interventions": episode.interventions,
            "moves": episode.moves,
            "steps": episode.steps,
            "discounted_return": episode.discounted_return,
        }


@cache  # cells of one task follow one another in a process
def _choices(instance: Instance) -> Choices:
    """Read and solve a task, once in each process."""
    try:
        table = sweep(load(instance), max_states=SIMULATED_STATES)
    except LimitError as error:
        raise StudyError(
            f"{instance}: {error}; people are simulated on tasks of up to {SIMULATED_STATES:,} states"
        ) from None
    if not np.isfinite(table[table.initial]):
        raise StudyError(f"{instance}: the goal cannot be reached from the initial state, so there is nobody to assist")
    return Choices.of(table)


@cache
def _function(file: Path, name: str) -> OwnPolicy:
    """Load a policy from a Python file, once in each process."""
    return OwnPolicy.load(file, name)


def check(study: Study) -> None:
    """Read all tasks and own policies and try all settings, so that what is wrong is said before the work begins.

    Raises
    ------
    StudyError, planner.PDDLError
    """
    for _, files in study.instances:
        _choices(files)
    for _, (file, name) in study.own_policies:
        try:
            _function(file, name)
        except PolicyError as error:
            raise StudyError(str(error)) from error
    for condition in study.conditions:
        for label, setting in condition.settings:
            for name in condition.instances:
                try:
                    setting.problem(_choices(dict(study.instances)[name]), None, Population())
                except ValueError as error:
                    place = f"condition '{condition.name}', setting '{label}'" if label else "setting"
                    raise StudyError(f"{study.file}: {place}: {error}") from None
