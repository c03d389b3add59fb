"""Records of simulated episodes, their means, and both as plain data."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.system.errors import require_package
from planner.system.results import Result

from ..people.decision import Floats
from ..person.fleet import Fleet
from ..person.policy import not_worth_its_cost
from .state import TeamPolicy

SHOWN = {
    "actions": "human_actions_per_person",
    "costs": "cost_per_person",
    "interventions": "interventions",
    "moves": "moves",
    "discounted_return": "return",
}
"""Summarised fields, with their names in records."""


@dataclass(frozen=True)
class Episode:
    """The record of one episode: an entry of each array of `Episodes`.

    What concerns people is a tuple with one entry per person. The meanings are those of the arrays of `Episodes`.

    Attributes
    ----------
    policy : str
    episode : int
    people : tuple of str
        Their names.
    beta, theta, sigma, costs : tuples of float
    actions, helped, executed : tuples of int
    finished : tuple of bool
    interventions, moves, steps : int
    discounted_return : float
    """

    policy: str
    episode: int
    people: tuple[str, ...]
    beta: tuple[float, ...]
    theta: tuple[float, ...]
    sigma: tuple[float, ...]
    actions: tuple[int, ...]
    costs: tuple[float, ...]
    finished: tuple[bool, ...]
    helped: tuple[int, ...]
    executed: tuple[int, ...]
    interventions: int
    moves: int
    steps: int
    discounted_return: float

    def record(self) -> dict[str, Any]:
        """Return the fields as plain data."""
        return asdict(self)


@dataclass(frozen=True, eq=False, repr=False)
class Episodes(Result):
    """The records of N episodes of K people, as arrays; a sequence of `Episode`.

    Attributes
    ----------
    policy : str
    episode : int array, shape (N,)
    people : int array, shape (N, K)
        Numbers in the pool, from 0.
    names : tuple of str
        What each person of the pool is called.
    seed : int
        Episodes of one number and of one seed have the same random numbers.
    beta, theta, sigma : float arrays, shape (N, K)
        True parameters; theta is that at the beginning.
    actions, costs : int and float arrays, shape (N, K)
        Number of actions until the goal or the end of the episode, and their costs, in cost units.
    finished : bool array, shape (N, K)
    helped, executed : int arrays, shape (N, K)
        Number of suggestions and executions for each person, and of executions alone.
    interventions, moves, steps : int arrays, shape (N,)
        Number of suggestions and executions, of changes of place, and of steps until all had finished.
    discounted_return : float array, shape (N,)
        Sum over steps of gamma^t times the reward, in cost units.
    cut_off : bool array, shape (N,)
        Whether a person had neither finished nor left at the step limit.
    c_suggest_too_high : float or None
        Cost of a suggestion, in cost units, if the policy weighs costs and made none.
    questions : int array, shape (N,), or None
        Number of questions about people's goals; None if the robot does not ask.
    pruned : float array, shape (N,), or None
        Probability of the task states that the robot left out, summed over steps and people; None if it sees all
        actions as they are.
    """

    policy: str
    episode: NDArray[np.int64]
    people: NDArray[np.int64]
    names: tuple[str, ...]
    seed: int
    beta: Floats
    theta: Floats
    sigma: Floats
    actions: NDArray[np.int64]
    costs: Floats
    finished: NDArray[np.bool_]
    helped: NDArray[np.int64]
    executed: NDArray[np.int64]
    interventions: NDArray[np.int64]
    moves: NDArray[np.int64]
    steps: NDArray[np.int64]
    discounted_return: Floats
    cut_off: NDArray[np.bool_]
    c_suggest_too_high: float | None = None
    pruned: Floats | None = None
    questions: NDArray[np.int64] | None = None

    def __repr__(self) -> str:
        return f"<Episodes of {self.summary()}>"

    def records(self) -> list[dict[str, Any]]:
        """Return one row: means over episodes, each with its standard error."""
        return self.summary().records()

    @classmethod
    def joined(cls, parts: Sequence[Episodes]) -> Episodes:
        """Return the union of episodes of one policy."""
        names = [field.name for field in fields(cls) if getattr(parts[0], field.name) is not None]
        names = [name for name in names if name not in ("policy", "names", "seed", "c_suggest_too_high")]
        arrays: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        costs = [part.c_suggest_too_high for part in parts]
        none_made = None if None in costs else costs[0]
        first = parts[0]
        return cls(first.policy, names=first.names, seed=first.seed, c_suggest_too_high=none_made, **arrays)

    def summary(self) -> Summary:
        """Return means and their standard errors."""
        return Summary(
            policy=self.policy,
            episodes=len(self),
            actions=_mean_and_error(self.actions.mean(axis=1)),
            costs=_mean_and_error(self.costs.mean(axis=1)),
            interventions=_mean_and_error(self.interventions),
            suggestions=_mean_and_error(self.interventions - self.executed.sum(axis=1)),
            executions=_mean_and_error(self.executed.sum(axis=1)),
            moves=_mean_and_error(self.moves),
            discounted_return=_mean_and_error(self.discounted_return),
            cut_off=int(self.cut_off.sum()),
            c_suggest_too_high=self.c_suggest_too_high,
            pruned=None if self.pruned is None else float(self.pruned.mean()),
            questions=None if self.questions is None else float(self.questions.mean()),
        )

    def to_frame(self) -> Any:
        """Return a `pandas.DataFrame` with a row for each person of each episode; with the extra `study`.

        Its columns are `policy`, `episode`, `person` (their name in the pool), `beta` (per cost unit), `theta` (at the
        beginning) and `sigma` (cost units) of the person, `actions` (number), `cost` (of these actions, in cost units),
        `finished`, `helped` (number of suggestions and executions) and `executed` (number of executions); and of the
        episode, in each of its rows, `interventions` and `moves` (numbers), `steps` (number) and `discounted_return`
        (cost units).

        Raises
        ------
        MissingExtraError
            pandas is not installed.
        """
        require_package("a data frame needs", "pandas", "study")
        import pandas as pd

        number, people = self.people.shape
        own = ("beta", "theta", "sigma", "actions", "costs", "finished", "helped", "executed")
        whole = ("interventions", "moves", "steps", "discounted_return")
        found = {
            "policy": self.policy,
            "episode": self.episode.repeat(people),
            "person": [self.names[one] for one in self.people.ravel().tolist()],
            **{name: getattr(self, name).ravel() for name in own},
            **{name: getattr(self, name).repeat(people) for name in whole},
        }
        return pd.DataFrame(found, index=range(number * people)).rename(columns={"costs": "cost"})

    def __len__(self) -> int:
        return len(self.episode)

    def __getitem__(self, row: int) -> Episode:
        names = [field.name for field in fields(Episode) if field.name not in ("policy", "people")]
        own: dict[str, Any] = {name: getattr(self, name)[row].tolist() for name in names}
        own = {name: tuple(value) if isinstance(value, list) else value for name, value in own.items()}
        return Episode(self.policy, people=tuple(self.names[number] for number in self.people[row]), **own)

    def __iter__(self) -> Iterator[Episode]:
        return (self[row] for row in range(len(self)))


@dataclass(frozen=True, eq=False)
class Summary(Result):
    """Means and standard errors over the episodes of one policy.

    Attributes
    ----------
    policy : str
    episodes : int
    actions, costs, interventions, suggestions, executions, moves, discounted_return : tuple of float
        Mean and standard error of: actions per person; their costs per person, in cost units, which are the person's
        time where costs are durations; interventions, which are suggestions and executions; each of
        these two; changes of place; and the return of an episode.
    cut_off : int
        Number of episodes in which a person had neither finished nor left at the step limit.
    c_suggest_too_high : float or None
        Cost of a suggestion, in cost units, if the policy weighs costs and made none.
    questions : float or None
        Mean number of questions per episode; None if the robot does not ask.
    pruned : float or None
        Mean of `Episodes.pruned`; None if the robot sees all actions as they are.
    """

    policy: str
    episodes: int
    actions: tuple[float, float]
    costs: tuple[float, float]
    interventions: tuple[float, float]
    suggestions: tuple[float, float]
    executions: tuple[float, float]
    moves: tuple[float, float]
    discounted_return: tuple[float, float]
    cut_off: int
    c_suggest_too_high: float | None = None
    pruned: float | None = None
    questions: float | None = None

    def records(self) -> list[dict[str, Any]]:
        """Return one row: the policy, the number of episodes, each mean with its standard error, and `cut_off`."""
        names = "actions", "costs", "interventions", "suggestions", "executions", "moves", "discounted_return"
        means = {name: with_error(*getattr(self, name)) for name in names}
        return [{"policy": self.policy, "episodes": self.episodes, **means, "cut_off": self.cut_off}]

    def record(self) -> dict[str, Any]:
        """Return the summary as plain data; an unknown standard error is None."""
        record: dict[str, Any] = {"policy": self.policy, "episodes": self.episodes}
        for name, label in {**SHOWN, "suggestions": "suggestions", "executions": "executions"}.items():
            mean, error = getattr(self, name)
            record[label] = {"mean": mean, "stderr": None if math.isnan(error) else error}
        more = {name: getattr(self, name) for name in ("pruned", "questions") if getattr(self, name) is not None}
        return {**record, "cut_off": self.cut_off, "c_suggest_too_high": self.c_suggest_too_high, **more}

    def __str__(self) -> str:
        shown = [
            f"{what} {with_error(mean, error)}"
            for what, (mean, error) in (
                ("actions per person", self.actions), ("cost per person", self.costs),
                ("suggestions", self.suggestions),
                ("executions", self.executions), ("moves", self.moves), ("return", self.discounted_return),
            )
            if (what != "executions" or mean) and (what != "cost per person" or self.costs[0] != self.actions[0])
        ]  # fmt: skip
        cut = f", {self.cut_off} of them cut off" if self.cut_off else ""
        why = "" if self.c_suggest_too_high is None else f"; {not_worth_its_cost(self.c_suggest_too_high)}"
        return f"{self.policy}: {', '.join(shown)} ({self.episodes} episode{'s'[: self.episodes > 1]}{cut}){why}"


def with_cost(found: Episodes, fleet: Fleet, policy: TeamPolicy) -> Episodes:
    """Return episodes with the cost of a suggestion, if the policy weighs it and made none."""
    costs = set(fleet.each("c_suggest").tolist())
    weighs_costs = getattr(policy, "weighs_costs", False) and len(costs) == 1
    if not weighs_costs or found.interventions.any() or not found.actions.any():
        return found
    return replace(found, c_suggest_too_high=costs.pop())


def with_error(mean: float, error: float) -> str:
    """Return a mean as text, with its standard error if it is known; a single episode has none."""
    return f"{mean:.2f}" if math.isnan(error) else f"{mean:.2f} ± {error:.2f}"


def _mean_and_error(values: NDArray[Any]) -> tuple[float, float]:
    error = values.std(ddof=1) / math.sqrt(len(values)) if len(values) > 1 else math.nan
    return float(values.mean()), float(error)
