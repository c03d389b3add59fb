"""The settings of commands: classes of declared fields, from which their options, `--set` and `--setting` follow."""

from __future__ import annotations

from dataclasses import field
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BeforeValidator, Field

from planner.batch.results_folder import SolveOptions
from planner.system.files import read_json

from ...declare.declared import (
    Beside,
    Count,
    DeclarationError,
    Expected,
    Number,
    Range,
    Seconds,
    Text,
    Truth,
    Usual,
    Whole,
    declared,
)
from ...learning.method import Method
from ...live.live_setting import LiveSetting
from ...people.ranges import OF_ADVICE_TAKERS, OwnModel, Population, advice_takers
from ...person.settings import Setting
from .common import Megabytes

T = TypeVar("T")


def _goal_prior(given: Any) -> Any:
    """Return probabilities of goals, which may be a text such as travel=0.7,mend=0.3."""
    if not isinstance(given, str):
        return given
    prior: dict[str, float] = {}
    for pair in filter(None, (pair.strip() for pair in given.split(","))):
        name, _, share = (part.strip() for part in pair.rpartition("="))
        try:
            value = float(share)
        except ValueError:
            name = ""
        if not name or name in prior:
            raise ValueError(f"{pair}; expected GOAL=PROBABILITY, once for each goal")
        prior[name] = value
    return prior


Prior = Annotated[
    dict[str, Number],
    BeforeValidator(_goal_prior),
    Expected("GOAL=PROBABILITY for each goal, or a table such as {travel = 0.7, mend = 0.3}"),
    Field(description="Probability of each goal, by the problem's name; all are equal unless given."),
]


Distances = Annotated[
    Text | None,
    Beside(),
    Expected("a file"),
    Field(
        description="File with the distances between the K stations and the base, which comes last (JSON list of "
        "lists); all are 1 unless given."
    ),
]


def record_of(file: Path) -> dict[str, Any]:
    """Return the record that `fit --write-population` wrote.

    Raises
    ------
    ValueError
        The file is none.
    """
    record = read_json(file)
    return record if isinstance(record, dict) else {}


def _population(given: Any) -> Any:
    """Return a population; a text is the name of a file that `fit --write-population` wrote."""
    if not isinstance(given, str):
        return given
    from ...learning import distribution as populations

    record = record_of(Path(given))  # whose faults have the file's name
    try:
        return populations.mixture(record)
    except ValueError as error:
        raise ValueError(f"{given}: {error}") from None


def _real(given: Any) -> Any:
    """Return a population whose influence, unless given, is as wide as that of real people."""
    if not isinstance(given, dict) or "theta" in given or "parts" in given:
        return _population(given)
    found = Population(**given)
    if others := set(given) - {*OF_ADVICE_TAKERS}:
        right = f"{' and '.join(sorted(others))} without theta; expected theta as well"
        raise DeclarationError.among(right, *sorted(others))
    return advice_takers(found.beta, found.sigma, chooses=found.chooses)


REGION_STATES = 20_000
"""States of the truncated problem of a larger task, if a setting has no number."""

FILE = "a file that `fit --write-population` wrote, or a table of ranges"
PRIOR = "The robot's prior over people, as `population`; the true population unless given."
PEOPLE = "The people: a file that `fit --write-population` wrote, or ranges of their parameters."

INFLUENCE = (
    "Unless theta is given, it is that of real people: from 0 to 1, above 0.85 for half, below 0.5 for one in nine."
)


@declared
class TaskSetting(Setting):
    """The setting of a command that solves a task and assists people in it."""

    goal_prior: Prior = field(default_factory=dict, hash=False)
    max_states: Annotated[
        Count,
        Field(description="Largest number of states solved exhaustively; states of larger tasks are solved on demand."),
    ] = SolveOptions.max_states
    region_states: Annotated[
        Count | None,
        Field(
            description="States of the truncated problem of a larger task; unless given, as many as suit the task "
            "and the command."
        ),
    ] = None
    memory_limit: Annotated[Megabytes, Field(description="Memory for policies, in MB.")] = 4000.0


@declared
class PersonSetting(TaskSetting):
    """The setting of one person's problem."""

    population: Annotated[
        Population, BeforeValidator(_population), Usual("FILE"), Beside(), Expected(FILE), Field(description=PEOPLE)
    ] = Population()
    sigma: Annotated[
        Number,
        Field(
            ge=0, description="Standard deviation of the person's misconception, which the robot knows, in cost units."
        ),
    ] = 0.0


@declared
class TeamSetting(TaskSetting):
    """The setting of a team of simulated people."""

    goal_knowledge: Annotated[
        Literal["inferred", "likeliest", "known"],
        Field(description="How the robot knows goals: from a posterior, from the most probable goal only, or exactly."),
    ] = "inferred"
    population: Annotated[
        Population, BeforeValidator(_population), Usual("FILE"), Beside(), Expected(FILE), Field(description=PEOPLE)
    ] = Population()
    distances: Distances = None
    reasons: Annotated[Truth, Field(description="Whether --trace explains each suggestion.")] = False
    prior: Annotated[
        Population | None, BeforeValidator(_population), Beside(), Expected(FILE), Field(description=PRIOR)
    ] = None


@declared
class ServeSetting(LiveSetting):
    """The setting of the command that serves a live session."""

    goal_prior: Prior = field(default_factory=dict, hash=False)
    distances: Distances = None
    population: Annotated[
        Population,
        BeforeValidator(_real),
        Usual("FILE"),
        Beside(),
        Expected(FILE),
        Field(description=f"{PEOPLE} {INFLUENCE}"),
    ] = advice_takers()


@declared
class DrawSetting:
    """The setting of a picture."""

    width: Annotated[Whole, Usual("N"), Field(ge=200, le=4000, description="Approximate width in pixels.")] = 760
    goal_prior: Prior = field(default_factory=dict, hash=False)


@declared
class ReadingSetting:
    """How a log is read, and how the states that it visits are evaluated."""

    gaps: Annotated[
        Truth, Field(description="Accept gaps in step numbers; otherwise a gap means that lines are missing.")
    ] = False
    max_states: Annotated[
        Count,
        Field(description="Largest task that is solved whole; else only visited states and their successors are."),
    ] = SolveOptions.max_states
    time_limit: Annotated[
        Seconds | None, Field(description="Seconds for each of these states; no limit unless given.")
    ] = None
    cache: Annotated[
        Text | None,
        Beside(),
        Expected("a folder"),
        Field(description="Folder for the cost-to-go of solved states; in the user's cache folder unless given."),
    ] = None


OF_INFLUENCE = ("theta_per_episode", "neighbours")
"""Fields that are about how theta moves."""


@declared
class EstimateSetting(Method, ReadingSetting):
    """The setting of an estimation from a log."""

    theta_per_episode: Annotated[
        Truth | None,
        Field(
            description="Whether influence (theta) begins anew in each episode; of simulated people only, unless given."
        ),
    ] = None
    confidence: Annotated[
        Literal["own", "one"],
        Field(
            description="What confidences in the file of --advice are about: the own choice, or the chance that "
            "choice 1 is right."
        ),
    ] = "own"
    chooses: Annotated[
        OwnModel,
        Field(description="Your own choice model FILE.py:FUNCTION, in place of choice by cost-to-go."),
    ] = None
    goal_prior: Prior = field(default_factory=dict, hash=False)


@declared
class GoalSetting(ReadingSetting):
    """The setting of the inference of goals from a log."""

    beta: Annotated[
        Range,
        Expected("two numbers, 0 <= low <= high"),
        Field(description="Range of people's expertise, over which the posterior is averaged."),
    ] = Population().beta
    lapse: Annotated[Number, Field(ge=0, lt=1, description="Weight of a uniform choice.")] = 1e-3
    goal_prior: Prior = field(default_factory=dict, hash=False)
