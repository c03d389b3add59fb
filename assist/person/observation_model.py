"""How reliably the robot sees people's actions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from planner.system.errors import nearest

from ..declare.declared import DeclarationError, Number, declared

if TYPE_CHECKING:
    from ..people.choices import Choices
    from ..people.decision import Floats
    from .evidence import Evidence

Table = Mapping[str, Mapping[str, float]]


Share = Annotated[Number, Field(ge=0, lt=1)]


@declared
class ObservationModel:
    """How often the robot misses a person's action, or takes it for another one.

    A number as `confusion` applies to all actions: the other one is any of those that are applicable, with equal
    probability. A mapping has, for an action, the probability of each action that is seen in its place; actions are in
    PDDL notation.
    """

    miss: Annotated[Share, Field(description="Probability that an action is not seen.")] = 0.0
    confusion: Annotated[
        Share | dict[str, dict[str, Share]],
        Field(
            description="Probability that an action that is seen is taken for another one; or, for some actions, a "
            "table of the actions that are seen in their place, with probabilities."
        ),
    ] = field(default=0.0, hash=False)

    def __post_init__(self) -> None:
        if not isinstance(self.confusion, Mapping):
            return
        rows: dict[str, Mapping[str, float]] = {}
        for action, row in self.confusion.items():
            others = {_plain(seen): p for seen, p in row.items()}
            if not _total(others) < 1:
                right = f"confusion of {action}: sum {_total(others):g}: expected a number below 1"
                raise DeclarationError.among(right, "confusion")
            if _plain(action) in others:
                right = f"confusion of {action}: expected other actions only, and it is one of them"
                raise DeclarationError.among(right, "confusion")
            rows[_plain(action)] = others
        object.__setattr__(self, "confusion", rows)

    @property
    def is_perfect(self) -> bool:
        """Whether every action is seen as it is."""
        table = self.confusion
        confused = any(map(_total, table.values())) if isinstance(table, Mapping) else table
        return not (self.miss or confused)

    def require_actions_of(self, choices: Choices) -> None:
        """Raise a ValueError if a table of confusions has an action that is none of a task's."""
        if isinstance(self.confusion, Mapping):
            _numbers(choices, self.confusion)

    def evidence(self, choices: Choices, seen: int | None) -> Evidence:
        """Return the likelihood of each action of a task after an action was seen, or nothing (None)."""
        import numpy as np

        from .evidence import Evidence

        if seen is None:
            return Evidence.none(choices)
        if not isinstance(self.confusion, Mapping):
            return Evidence(np.empty(0), seen, self.confusion)
        likelihood, number_of = np.zeros(len(choices.names) + 1), _numbers(choices, self.confusion)
        likelihood[seen] = 1 - _total(self.confusion.get(choices.action_name(seen), {}))
        for action, row in self.confusion.items():
            likelihood[number_of[action]] += row.get(choices.action_name(seen), 0.0)
        return Evidence(likelihood)

    def draw(self, choices: Choices, x: int, slot: int, uniform: Sequence[float] | Floats) -> int | None:
        """Return the ground action that is seen when a person acts; None if nothing is seen.

        Parameters
        ----------
        choices : Choices
        x, slot : int
            The person's state, and the slot of their choice.
        uniform : sequence of float
            Two uniform numbers in [0, 1).
        """
        if uniform[0] < self.miss:
            return None
        action, remaining = int(choices.actions[x, slot]), uniform[1]
        if isinstance(self.confusion, Mapping):
            for seen, p in self.confusion.get(choices.action_name(action), {}).items():
                if remaining < p:
                    return _numbers(choices, self.confusion)[seen]
                remaining -= p
            return action
        others = int(choices.applicable[x].sum()) - 1
        if others < 1 or remaining >= self.confusion:
            return action
        other = min(int(remaining / self.confusion * others), others - 1)
        return int(choices.actions[x, other + (other >= slot)])


def _numbers(choices: Choices, table: Table) -> dict[str, int]:
    """Return the ground action of each name, after checking that the table's names are among them."""
    from ..people.choices import STAND_STILL, WAIT

    numbers = {STAND_STILL: WAIT}
    for n, name in enumerate(choices.names):
        numbers.setdefault(name, n)  # as in `choices.actions`
    for name in (*table, *(seen for row in table.values() for seen in row)):
        if name not in numbers:
            near = nearest(name, numbers) or next(iter(choices.names))
            raise ValueError(
                f"observation: confusion: {name} is no action of the task; expected actions with all arguments, "
                f"such as {near}"
            )
    return numbers


def _total(row: Mapping[str, float]) -> float:
    return sum(row.values())


def _plain(action: str) -> str:
    from ..people.action_names import words_of

    return f"({' '.join(words_of(action))})"
