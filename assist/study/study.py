"""A study as data: who is assisted, in which tasks, by which policies, and how often all of it is repeated.

A study, which `assist.study.protocol` reads from a file, consists of conditions. Each draws pools of
people from some populations, for some tasks, under some settings, and simulates teams of them. What is done in
one go is a `Cell`: one pool. Its people and their luck depend on the study's seed and the number of the repeat
alone, so that policies, team sizes, settings and conditions are compared on the same people with the same luck.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner import Instance

from ..people.human import Mixture, Population
from ..people.user_code import UserChoiceModel
from ..team.settings import Setting

SCHEMA = 1
"""The version of what `episodes.jsonl` and `summary.json` hold."""

OF_NO_CONSEQUENCE = {"file", "title", "repeats", "focus", "contrasts", "reference"}  # for what episodes there are
OWN = "own"
"""The prior that is the population from which people are drawn."""


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

    def episodes_of(self, cell: Cell) -> Iterator[tuple[str, int, int, int]]:
        """Give the policy, team size, draw and trial of each episode of a cell."""
        condition = self.condition(cell.condition)
        return product(condition.policies, condition.humans, range(self.draws), range(self.trials))

    def setting(self, cell: Cell) -> Setting:
        """Give what a cell takes for granted."""
        return dict(self.condition(cell.condition).settings)[cell.setting]

    def fingerprint(self) -> str:
        """Give a digest of all that results depend on: the study, and the files that it names, but not `repeats`."""
        digest = hashlib.sha256()
        plain = {name: value for name, value in self._plain().items() if name not in OF_NO_CONSEQUENCE}
        plain["schema"] = SCHEMA
        for name in ("instances", "own_policies"):
            plain[name] = [label for label, _ in getattr(self, name)]
        digest.update(json.dumps(plain, sort_keys=True).encode())
        named = [path for _, files in self.instances for path in (files.domain, files.problem)]
        models = (people.chooses for _, people in self.populations)
        own = [
            *(path for _, (path, _) in self.own_policies),
            *(m.file for m in models if isinstance(m, UserChoiceModel)),
        ]
        for path in (*named, *own):
            digest.update(hashlib.sha256(path.read_bytes()).digest())
        for _, (_, function) in self.own_policies:
            digest.update(function.encode())
        return digest.hexdigest()

    def record(self) -> dict[str, Any]:
        """Give the study as plain data, file names as texts."""
        return json.loads(json.dumps(self._plain(), default=str))

    def _plain(self) -> dict[str, Any]:
        return asdict(self) | {"populations": [(name, people.as_dict()) for name, people in self.populations]}

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
