"""The states of several goals' tasks at once, so that one log is replayed for all goals."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner import CostToGo, LimitError, Transitions

from ..people.decision import Floats
from .observations import Ints
from .replay import Recording


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

    def cost_to_go(self, recording: Recording, *, strict: bool) -> tuple[Floats, list[str]]:
        """Return h* of each goal in all joint states, shape (G, states), and notes; NaN if not wanted or unknown."""
        wanted = recording.wanted()
        own, notes = self._own(wanted), list[str]()
        h = np.full((len(self._goals), len(self)), np.nan)
        for goal, (costs, place) in enumerate(zip(self._goals, self._place, strict=True)):
            try:
                h[goal, wanted] = costs.lookup(own[place])
            except LimitError as error:
                known = getattr(costs, "known", None)
                if strict or known is None:
                    raise
                notes.append(str(error))
                h[goal, wanted] = known(own[place])
        return h, notes


def _enumeration(costs: CostToGo) -> object:
    """Return the object that numbers the states: tables with the same one give a state the same number."""
    space = getattr(costs, "space", None)
    return costs if space is None else space.numbering
