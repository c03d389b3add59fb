"""A simulation study as data: populations, tasks, policies, settings and numbers of repeats.

A study, which `assist.studies.protocol` reads from a file, consists of conditions. Each condition crosses populations,
tasks, settings and priors; it draws pools of people and simulates teams of them. A `Cell` is the unit of work: one
pool. Its people and random numbers depend only on the study's seed and the number of the repeat. Policies, team sizes,
settings and conditions are therefore compared with common random numbers.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from planner import Instance

from ..declare.declared import (
    AnyText,
    Count,
    Expected,
    Number,
    Seed,
    Text,
    Texts,
    Truth,
    Whole,
    annotation_of,
    declared,
    marks,
    names_of,
    plain,
)  # fmt: skip
from ..people.ranges import Population
from ..people.user_code import sources
from ..person.settings import Setting, own_rules
from ..team.policy_names import BASELINES

SCHEMA = 1
"""Version of the format of `episodes.jsonl` and `summary.json`."""

OWN = "own"
"""The prior that equals the population from which people are drawn."""


@dataclass(frozen=True)
class Condition:
    """A condition of a study, which crosses all its populations, tasks, settings and priors.

    Attributes
    ----------
    name : str
    populations : tuple of str
        Populations from which people are drawn.
    instances : tuple of str
    policies : tuple of str
    humans : tuple of int
        Team sizes K.
    settings : tuple of pairs
        Labels and settings.
    priors : tuple of str
        Populations that the robot assumes. `OWN`: the one from which people are drawn.
    repeats : int or None
        Largest number of repeats of this condition; None: as many as the study.
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
    """The unit of work: one pool of people, and all teams that are drawn from it.

    Attributes
    ----------
    condition, setting, prior, population, instance : str
        Names and labels.
    repeat : int
        Number of the pool.
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


@declared(kw_only=True)
class EpisodeRecord:
    """A line of `episodes.jsonl`: the cell, which episode it is, its people, and what happened."""

    condition: Annotated[AnyText, Field(description="The condition.")]
    setting: Annotated[AnyText, Field(description="The differences from the study's setting.")]
    prior: Annotated[AnyText, Field(description="The population that the robot assumes.")]
    population: Annotated[AnyText, Field(description="The population from which people are drawn.")]
    instance: Annotated[AnyText, Field(description="The task.")]
    repeat: Annotated[Whole, Field(ge=0, description="The pool, from 0.")]
    policy: Annotated[AnyText, Field(description="The policy.")]
    humans: Annotated[Count, Field(description="Team size K.")]
    draw: Annotated[Whole, Field(ge=0, description="The team, from 0.")]
    trial: Annotated[Whole, Field(ge=0, description="The episode of this team, from 0.")]
    people: Annotated[
        tuple[Whole, ...],
        Field(description="Numbers in the pool from 1; this and the following lists have one entry for each person."),
    ]
    beta: Annotated[tuple[Number, ...], Field(description="True expertise.")]
    theta: Annotated[tuple[Number, ...], Field(description="True influence at the beginning.")]
    sigma: Annotated[tuple[Number, ...], Field(description="True deviation of misconceptions.")]
    actions: Annotated[tuple[Whole, ...], Field(description="Actions.")]
    costs: Annotated[
        tuple[Number, ...], Field(description="Costs of these actions, which are the time where costs are durations.")
    ]
    helped: Annotated[tuple[Whole, ...], Field(description="Suggestions received.")]
    finished: Annotated[
        tuple[Truth, ...], Expected("a list of true and false"), Field(description="Whether the goal was reached.")
    ]
    interventions: Annotated[Number, Field(description="Suggestions, and actions that the robot executed.")]
    moves: Annotated[Number, Field(description="Changes of place.")]
    steps: Annotated[Number, Field(description="Steps.")]
    discounted_return: Annotated[Number, Field(description="Sum over steps of gamma^t times the reward.")]

    def __post_init__(self) -> None:
        for name in ("people", "beta", "theta", "sigma", "actions", "costs", "helped", "finished"):
            if len(getattr(self, name)) != self.humans:
                raise ValueError(f"{name}: expected one entry for each of {self.humans} people")


@declared
class Interventions:
    """A table of `reference.interventions`: the mean number of interventions for some populations."""

    populations: Texts
    mean: Number


@declared
class Reference:
    """The table `reference`: published results that a study is compared with."""

    source: Annotated[Text, Field(description="Citation.")]
    name: Annotated[Text, Field(description="Name in reports.")] = "the reference"
    headline: Annotated[dict[str, Number], Field(description="Percentage of each headline figure, by name.")] = field(
        default_factory=dict
    )
    interventions: Annotated[tuple[Interventions, ...], Field(description="Published numbers of interventions.")] = ()
    declines: Annotated[
        Truth, Field(description="Whether the source claims that savings per person decline with the size of the team.")
    ] = False
    contrasts: Annotated[
        tuple[Text, ...], Field(description="The study's contrasts that the source claims to exceed 1.")
    ] = ()


@declared
class Contrast:
    """A table of `contrasts`: populations whose mean numbers of interventions are compared, as the ratio `of / to`."""

    name: Annotated[Text, Field(description="Name in reports.")]
    of: Annotated[Texts, Field(description="Populations of the numerator.")]
    to: Annotated[Texts, Field(description="Populations of the denominator.")]


@dataclass(frozen=True)
class Unseen:
    """Marks a field of a plan on which no episode depends: a study goes on where it was with another value."""


@declared(kw_only=True)
class StudyPlan:
    """The numbers of a study, which its file sets and its report shows."""

    seed: Annotated[Seed, Field(description="Seed of all randomness.")] = 0
    repeats: Annotated[Count, Unseen(), Field(description="Pools of people that are drawn for each combination.")] = 50
    pool: Annotated[Count, Field(description="People in a pool.")] = 12
    draws: Annotated[Count, Field(description="Teams that are drawn from each pool for each K.")] = 6
    trials: Annotated[Count, Field(description="Episodes of each team.")] = 5


IRRELEVANT = {"file", "title", "focus", "baseline", "default", "contrasts", "reference"} | {
    name for name in names_of(StudyPlan) if Unseen() in marks(annotation_of(StudyPlan, name))
}
"""Fields of a study on which no episode depends."""


@dataclass(frozen=True, kw_only=True)
class Study(StudyPlan):
    """A simulation study.

    Attributes
    ----------
    file : Path
    title : str
    focus : str
        The policy that is compared with the others.
    baseline : str or None
        The policy that all are compared with; None: those of `policy_names.BASELINES`.
    populations : tuple of pairs
        Names and populations.
    instances : tuple of pairs
        Labels and tasks.
    own_policies : tuple of pairs
        Names of user policies, with file and function.
    default : Setting
        What the settings of conditions differ from.
    conditions : tuple of Condition
        The first condition provides the headline.
    contrasts : tuple of Contrast
    reference : Reference or None
    """

    file: Path
    title: str
    focus: str
    baseline: str | None
    populations: tuple[tuple[str, Population], ...]
    instances: tuple[tuple[str, Instance], ...]
    own_policies: tuple[tuple[str, tuple[Path, str]], ...]
    default: Setting
    conditions: tuple[Condition, ...]
    contrasts: tuple[Contrast, ...]
    reference: Reference | None

    def __repr__(self) -> str:
        cells = list(self.cells())
        return f"<Study {self.title!r}: {len(cells):,} pools, {sum(map(self.episodes, cells)):,} episodes>"

    @property
    def baselines(self) -> tuple[str, ...]:
        """The policies that all others are compared with."""
        return BASELINES if self.baseline is None else (self.baseline,)

    def compared_with(self, policy: str) -> tuple[str, ...]:
        """Return the policies with which a policy is compared: the focus with all, unless the study has a baseline."""
        if policy == self.focus and self.baseline is None:
            return tuple(name for name in self.conditions[0].policies if name != policy)
        return () if policy in self.baselines else self.baselines

    def condition(self, name: str) -> Condition:
        """Return the condition of this name."""
        return next(condition for condition in self.conditions if condition.name == name)

    def cells(self) -> Iterator[Cell]:
        """Yield all cells, repeat by repeat, in the order of the results."""
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
        """Return the number of episodes of a cell."""
        condition = self.condition(cell.condition)
        return len(condition.policies) * len(condition.humans) * self.draws * self.trials

    def episodes_of(self, cell: Cell) -> Iterator[tuple[str, int, int, int]]:
        """Yield the policy, team size, draw and trial of each episode of a cell."""
        condition = self.condition(cell.condition)
        return product(condition.policies, condition.humans, range(self.draws), range(self.trials))

    def setting(self, cell: Cell) -> Setting:
        """Return the setting of a cell."""
        return dict(self.condition(cell.condition).settings)[cell.setting]

    def fingerprint(self) -> str:
        """Return a digest of the study, without `repeats`, and of the files that it names."""
        digest = hashlib.sha256()
        plain = {name: value for name, value in self._plain().items() if name not in IRRELEVANT}
        plain["schema"] = SCHEMA
        for name in ("instances", "own_policies"):
            plain[name] = [label for label, _ in getattr(self, name)]
        digest.update(json.dumps(plain, sort_keys=True).encode())
        named = [path for _, files in self.instances for path in (files.domain, files.problem)]
        settings = (setting for condition in self.conditions for _, setting in condition.settings)
        models = (people.chooses for _, people in self.populations)
        named_in: tuple[object, ...] = (
            *models,
            *(rule for setting in settings for rule in own_rules(setting).values()),
        )
        own = [*(path for _, (path, _) in self.own_policies), *(m.file for m in named_in if hasattr(m, "file"))]
        for path in (*named, *(source for file in own for source in sources(file))):
            digest.update(hashlib.sha256(path.read_bytes()).digest())
        for _, (_, function) in self.own_policies:
            digest.update(function.encode())
        return digest.hexdigest()

    def record(self) -> dict[str, Any]:
        """Return the study as plain data, with paths as strings."""
        return json.loads(json.dumps(self._plain(), default=str))

    def _plain(self) -> dict[str, Any]:
        people = [(name, plain(one)) for name, one in self.populations]
        found = asdict(self) | {"populations": people, "default": plain(self.default)}
        for condition, own in zip(found["conditions"], self.conditions, strict=True):
            condition["settings"] = tuple((label, plain(setting)) for label, setting in own.settings)
        return found

    def seed_of(self, repeat: int) -> int:
        """Return the random seed of a repeat."""
        words = np.random.SeedSequence(self.seed, spawn_key=(repeat,)).generate_state(4)
        return int.from_bytes(words.tobytes(), "little")

    def teams(self, repeat: int, humans: int) -> NDArray[np.int64]:
        """Return the team of each episode, shape (draws * trials, K). Each drawn team acts in `trials` episodes.

        A draw's team of K people is part of its team of K + 1.
        """
        rng = np.random.default_rng(np.random.SeedSequence(self.seed_of(repeat), spawn_key=(2,)))
        drawn = rng.permuted(np.tile(np.arange(self.pool), (self.draws, 1)), axis=1)[:, :humans]
        return np.repeat(drawn, self.trials, axis=0)
