"""Who is in a live team, and where everybody is: a record for each person, and arrays as a team policy reads them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Floats
from ..team.state import by_model
from .problem import Part, Problem, UnknownError

NAMED = 10  # people, in a message


class Step(NamedTuple):
    """An action of a person: where, after what of the robot's, and which."""

    part: int
    row: int
    robot: int
    slot: int


@dataclass
class Record:
    """The task that somebody is at, their steps in it, and what was believed of them when they began it."""

    name: str
    place: int
    problem: Problem
    before: Floats
    steps: list[Step] = field(default_factory=list)
    past: list[tuple[Problem, list[Step]]] = field(default_factory=list)

    def episodes(self) -> list[tuple[Problem, list[Step]]]:
        """Give all tasks that they have been at, with their steps."""
        return [*self.past, (self.problem, self.steps)]


class Roster:
    """The people of a team, at places 0 to P - 1; whoever leaves keeps theirs.

    Attributes
    ----------
    parts : list of Part
        Of all tasks.
    records : list of Record
        By place.
    x, model : int arrays, shape (P,)
        The row of everybody's state, and in which part.
    robot : int array, shape (P,)
        What was suggested to them since their last action; 0 for nothing.
    erred, present, ended : bool arrays, shape (P,)
        Whose last action was no progress; who is there; who has reached their goal.
    belief : float array, shape (P, B, T)
    """

    def __init__(self, parts: list[Part], places: int) -> None:
        self.parts = parts
        self.records: list[Record] = []
        self.by_name: dict[str, Record] = {}
        self.x, self.model, self.robot = (np.zeros(places, dtype=np.int64) for _ in range(3))
        self.erred, self.present, self.ended = (np.zeros(places, dtype=bool) for _ in range(3))
        self.belief = np.zeros((places, 0, 0))
        self._worth = np.full((places, 1), -np.inf)
        self._stale = np.ones(places, dtype=bool)

    def __len__(self) -> int:
        return len(self.x)

    @property
    def names(self) -> tuple[str, ...]:
        """Who is there."""
        return tuple(record.name for record in self.records if self.present[record.place])

    def known(self, name: str) -> Record:
        """Give the record of somebody who is there.

        Raises
        ------
        UnknownError
            Who is not; says who is.
        """
        record = self.by_name.get(name)
        if record is None or not self.present[record.place]:
            names = self.names
            there = ", ".join(names[:NAMED]) + f" and {len(names) - NAMED} more" * (len(names) > NAMED)
            raise UnknownError(f"{name!r} is not in the team; who is there: {there or 'nobody'}")
        return record

    def add(self, name: str, problem: Problem) -> None:
        """Take somebody new in, at the next place, which there has to be."""
        number, row = problem.at(problem.initial)
        prior = self.parts[number].policy.pomdp.prior
        if not self.records:
            self.belief = np.zeros((len(self), *prior.shape))
        elif prior.shape != self.belief.shape[1:]:
            raise ValueError(f"{name}: a belief of shape {prior.shape}; expected {self.belief.shape[1:]}, as in others")
        record = Record(name, len(self.records), problem, prior.copy())
        self.records.append(record)
        self.by_name[name] = record
        self.present[record.place] = True
        self.belief[record.place] = prior
        self.put(record, number, row)

    def grow(self, places: int) -> None:
        """Make room for so many people."""

        def longer(array: NDArray[Any], fill: Any = 0) -> NDArray[Any]:
            more = np.full((places - len(array), *array.shape[1:]), fill, dtype=array.dtype)
            return np.concatenate([array, more])

        for name in ("x", "model", "robot", "erred", "present", "ended", "belief"):
            setattr(self, name, longer(getattr(self, name)))
        self._worth, self._stale = longer(self._worth, -np.inf), longer(self._stale, True)

    def put(self, record: Record, number: int, row: int, *, erred: bool = False, robot: int = 0) -> None:
        """Put somebody into a state."""
        k = record.place
        self.model[k], self.x[k], self.erred[k], self.robot[k] = number, row, erred, robot
        self.ended[k] = self.parts[number].choices.goal[row]
        self._stale[k] = True

    def worth(self, active: NDArray[np.bool_]) -> Floats:
        """Give what each robot action is worth for each person, shape (P, R), up to date for those who are active.

        Only for those of whom something has changed it is worked out anew.
        """
        policies = [part.policy for part in self.parts]
        widest = max(policy.pomdp.suggested.shape[1] for policy in policies)
        if widest > self._worth.shape[1]:
            self._worth = np.pad(self._worth, ((0, 0), (0, widest - self._worth.shape[1])), constant_values=-np.inf)
        rows = np.flatnonzero(self._stale & active)
        for number, mine in by_model(self.model, rows, len(policies)):
            values = policies[number].q_values(self.x[mine], self.belief[mine])
            self._worth[mine] = -np.inf
            self._worth[mine, : values.shape[1]] = values
        self._stale[rows] = False
        return self._worth
