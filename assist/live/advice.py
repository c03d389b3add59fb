"""What the assistant says: to whom to go, what to suggest, and why, in numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

from ..explain.explanation import Explanation
from ..people.belief import Grid
from ..people.decision import Floats
from ..people.spread import Spread


@dataclass(frozen=True, slots=True)
class Reason:
    """Why a person is to be helped: the numbers of Algorithm 1, whatever the team's policy goes by.

    Attributes
    ----------
    saving : float
        By how much the suggestion improves the person's expected discounted return, in cost units: what they and
        the suggestion cost, against saying nothing in this step. While the robot has a way to go, that of the best
        suggestion there would be now.
    moving : float
        Cost of going there, in cost units.
    score : float
        `saving` less `moving`.
    beta, theta : float
        What is believed of their expertise, and of the robot's influence on them: means.
    beta_interval, theta_interval : pair of float
        Between these lie nine tenths of the belief, and its mean.
    suggestions, followed : int
        How many suggestions the person has answered in this task, and how many of them they followed.
    follow : float
        Probability that they follow this one, under the belief.
    follow_interval : pair of float
        Between these lie nine tenths of the probabilities that pairs of beta and theta give, weighted by the belief,
        and their mean.
    """

    saving: float
    moving: float
    score: float
    beta: float
    beta_interval: tuple[float, float]
    theta: float
    theta_interval: tuple[float, float]
    suggestions: int = 0
    followed: int = 0
    follow: float = 0.0
    follow_interval: tuple[float, float] = (0.0, 1.0)

    @classmethod
    def of(cls, plain: Mapping[str, Any]) -> Reason:
        """Read what `dataclasses.asdict` made, and JSON may have kept.

        Raises
        ------
        ValueError
            It did not.
        """
        values: dict[str, Any] = {n: tuple(value) if isinstance(value, list) else value for n, value in plain.items()}
        for name, value in values.items():
            pair = name.endswith("_interval")
            numbers = value if pair and isinstance(value, tuple) and len(value) == 2 else () if pair else (value,)
            if not numbers or not all(type(one) in (int, float) and math.isfinite(one) for one in numbers):
                raise ValueError(f"reason {str(name)[:40]!r}: {str(value)[:40]}")
        return cls(**values)


@dataclass(frozen=True)
class Advice:
    """What the robot is to do next.

    Attributes
    ----------
    person : str or None
        To whom it goes; None where nothing is worth saying to anybody.
    suggestion : str or None
        The action that it suggests to them, in PDDL; None on the way, and where it is only to be there.
    reason : Reason or None
        None where there is no person.
    arrived : bool
        Whether the robot is there: False until `Assistant.arrived`, where the way takes time.
    """

    person: str | None
    suggestion: str | None
    reason: Reason | None
    arrived: bool

    def explained_by(self, source: Callable[[], Explanation]) -> Advice:
        """Let `explanation` be the result of a function, which is called on first use; return the advice."""
        vars(self)["_source"] = source
        return self

    @cached_property
    def explanation(self) -> Explanation:
        """Why this step, why this person now, or why nothing, as at the decision; computed on first use.

        Raises
        ------
        ValueError
            The advice is from a record. `Assistant.explain` explains what is suggested now.
        """
        source = vars(self).pop("_source", None)
        if source is None:
            raise ValueError("this advice is from a record, and has no explanation; `Assistant.explain` gives one")
        return source()

    def __getstate__(self) -> dict[str, Any]:
        return {one.name: getattr(self, one.name) for one in fields(self)}

    @classmethod
    def of(cls, plain: Mapping[str, Any]) -> Advice:
        """Read what `dataclasses.asdict` made, and JSON may have kept.

        Raises
        ------
        ValueError
            It did not.
        """
        reason, arrived = plain["reason"], plain["arrived"]
        person, suggestion = plain["person"], plain["suggestion"]
        if not isinstance(arrived, bool) or not all(isinstance(one, str | None) for one in (person, suggestion)):
            raise ValueError(f"advice {str(dict(plain))[:60]}")
        if person is None and (suggestion is not None or reason is not None):
            raise ValueError("advice for nobody")
        return cls(
            plain["person"], plain["suggestion"], None if reason is None else Reason.of(reason), plain["arrived"]
        )


@dataclass(frozen=True)
class PersonState:
    """What is known of one person of a live team.

    Attributes
    ----------
    person : str
    present : bool
        Whether they are there; people who have left can come back.
    finished : bool
        Whether they have reached their goal.
    state : int
        The state of their task, as the task's `CostToGo` numbers it.
    applicable : tuple of str
        What they can do, in PDDL.
    suggestion : str or None
        What was suggested to them since their last action.
    cost_to_go : float
        Exact, in cost units; infinite in a dead end.
    steps : int
        Their actions in this task so far.
    grid : Grid
        The values of beta and theta that the belief distinguishes.
    belief : float array, shape (B, T)
        How likely each pair of them is.
    """

    person: str
    present: bool
    finished: bool
    state: int
    applicable: tuple[str, ...]
    suggestion: str | None
    cost_to_go: float
    steps: int
    grid: Grid
    belief: Floats

    def __post_init__(self) -> None:
        self.belief.flags.writeable = False

    @property
    def beta(self) -> Spread:
        """The belief in their expertise."""
        return self.grid.spreads(self.belief)[0]

    @property
    def theta(self) -> Spread:
        """The belief in the robot's influence on them."""
        return self.grid.spreads(self.belief)[1]
