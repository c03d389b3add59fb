"""The states of several goals' tasks at once, so that one log is replayed for all goals."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner import CostToGo, LimitError, Transitions

from ..people.decision import Floats
from .observations import EvaluatedStates, Ints


class JointStates:
    """The states of several goals' tasks at once, numbered in the order of their first use: a `TransitionSystem`.

    Goals on one enumeration share its state numbers. A joint state has a number for each enumeration.
    """

    def __init__(self, goals: Mapping[str, CostToGo]) -> None:
        self._goals = tuple(goals.values())
        self.task = self._goals[0].task
        places: dict[int, int] = {}
        heads: list[CostToGo] = []
        self._place = []
        for name, costs in goals.items():
            same = costs.task.actions == self.task.actions
            if not same or not np.array_equal(costs.task.action_costs, self.task.action_costs):
                raise ValueError(
                    f"goal '{name}' has other actions than the first; expected the same domain and objects"
                )
            if not np.isfinite(costs.lookup([costs.initial])[0]):
                raise ValueError(f"goal '{name}' cannot be reached from the initial state; expected goals that can")
            place = places.setdefault(id(_enumeration(costs)), len(heads))
            heads += [costs] * (place == len(heads))
            self._place.append(place)
        self._heads = tuple(heads)
        self.initial = 0
        start = tuple(head.initial for head in heads)
        self._states, self._numbers = [start], {start: 0}

    def __len__(self) -> int:
        return len(self._states)

    def _own(self, states: ArrayLike) -> list[Ints]:
        """Return the number of joint states, shape (N,), in each enumeration."""
        joint = [self._states[state] for state in np.asarray(states).tolist()]
        return list(np.array(joint, dtype=np.int64).reshape(len(joint), len(self._heads)).T)

    def choices(self, states: ArrayLike) -> Transitions:
        """Return the transitions of states, shape (N,), as compressed rows."""
        rows = [head.choices(own) for head, own in zip(self._heads, self._own(states), strict=True)]
        first = rows[0]
        if any(not np.array_equal(first.actions, other.actions) for other in rows):
            raise ValueError(f"{self.task.instance}: other actions apply with another goal; expected one domain")
        targets = []
        for target in zip(*(row.targets.tolist() for row in rows), strict=True):
            if target not in self._numbers:
                self._numbers[target] = len(self._states)
                self._states.append(target)
            targets.append(self._numbers[target])
        return Transitions(first.offsets, first.actions, np.array(targets, dtype=np.int64))

    def reached(self, states: ArrayLike) -> NDArray[np.bool_]:
        """Return whether each goal holds in each state, shape (G, N)."""
        own = self._own(states)
        return np.stack([costs.is_goal(own[place]) for costs, place in zip(self._goals, self._place, strict=True)])

    def is_goal(self, states: ArrayLike) -> NDArray[np.bool_]:
        """Return whether all goals hold in each state, shape (N,)."""
        return np.logical_and.reduce(self.reached(states), axis=0)

    def evaluated(self, states: Ints, *, strict: bool) -> tuple[list[EvaluatedStates], list[str]]:
        """Return the data of joint states with each goal, and notes; NaN in other states, and where h* is unknown.

        Plan lengths only concern which of several cheapest plans a person should prefer, so that they are left out.
        """
        own, notes, found = self._own(states), list[str](), list[EvaluatedStates]()
        for costs, place in zip(self._goals, self._place, strict=True):
            h = np.full(len(self), np.nan)
            h[states], more = looked_up(costs, own[place], strict=strict)
            notes += more
            found.append(EvaluatedStates(h, None))
        return found, notes


def looked_up(costs: CostToGo, states: Ints, *, strict: bool) -> tuple[Floats, list[str]]:
    """Return h* of states, NaN if it took too long, and a note then; with `strict`, that is an error."""
    try:
        return costs.lookup(states), []
    except LimitError as error:
        known = getattr(costs, "known", None)
        if strict or known is None:
            raise
        return known(states), [str(error)]


def _enumeration(costs: CostToGo) -> object:
    """Return the object that numbers the states: tables with the same one give a state the same number."""
    space = getattr(costs, "space", None)
    return costs if space is None else space.numbering
