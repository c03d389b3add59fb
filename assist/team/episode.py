"""Episodes as plain data: the record of one, a data frame of many, and their summary."""

from __future__ import annotations

import importlib.util
import math
from dataclasses import asdict, dataclass, fields
from typing import Any

from planner.system.errors import MissingExtraError

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
    """The record of one episode.

    Attributes
    ----------
    policy : str
    episode : int
    people : tuple of str
        Names of the team's people; the next tuples have one entry per person.
    beta, theta, sigma : tuple of float
        True parameters; theta is that at the beginning.
    actions : tuple of int
        Number of actions until the goal or the end of the episode.
    costs : tuple of float
        Costs of these actions, in cost units.
    finished : tuple of bool
    helped : tuple of int
        Number of suggestions to each person and of actions executed for them.
    executed : tuple of int
        Number of these that are executions.
    interventions, moves, steps : int
        Number of suggestions and executions, of changes of place, and of steps until all had finished.
    discounted_return : float
        Sum over steps of gamma^t times the reward, in cost units.
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


def episode_of(episodes: Any, row: int) -> Episode:
    """Return the record of one of many episodes (`Episodes`), given by its position."""
    names = [field.name for field in fields(Episode) if field.name not in ("policy", "people")]
    own: dict[str, Any] = {name: getattr(episodes, name)[row].tolist() for name in names}
    own = {name: tuple(value) if isinstance(value, list) else value for name, value in own.items()}
    return Episode(episodes.policy, people=tuple(episodes.names[number] for number in episodes.people[row]), **own)


def to_frame(episodes: Any) -> Any:
    """Return the data frame of episodes, as `Episodes.to_frame` describes it."""
    if importlib.util.find_spec("pandas") is None:
        raise MissingExtraError("a data frame needs", "pandas", "study")
    import pandas as pd

    number, people = episodes.people.shape
    own = {"beta": "beta", "theta": "theta", "sigma": "sigma", "actions": "actions", "cost": "costs",
           "finished": "finished", "helped": "helped", "executed": "executed"}  # fmt: skip
    whole = ("interventions", "moves", "steps", "discounted_return")
    return pd.DataFrame(
        {
            "policy": episodes.policy,
            "episode": episodes.episode.repeat(people),
            "person": [episodes.names[one] for one in episodes.people.ravel().tolist()],
            **{column: getattr(episodes, name).ravel() for column, name in own.items()},
            **{name: getattr(episodes, name).repeat(people) for name in whole},
        },
        index=range(number * people),
    )


def plain_summary(summary: Any) -> dict[str, Any]:
    """Return a `Summary` as plain data; an unknown standard error is None."""
    record: dict[str, Any] = {"policy": summary.policy, "episodes": summary.episodes}
    for name, label in {**SHOWN, "suggestions": "suggestions", "executions": "executions"}.items():
        mean, error = getattr(summary, name)
        record[label] = {"mean": mean, "stderr": None if math.isnan(error) else error}
    return {
        **record,
        "cut_off": summary.cut_off,
        "c_suggest_too_high": summary.c_suggest_too_high,
        **({} if summary.pruned is None else {"pruned": summary.pruned}),
        **({} if summary.questions is None else {"questions": summary.questions}),
    }
