"""Who is in a live team, and where everybody is: a record for each person, and arrays as a team policy reads them."""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Floats
from ..team.state import Ask, by_model
from .live_task import LiveTask, TaskPart, UnknownError

NAMED = 10  # people, in a message

ANSWERS = 8
"""Questions of which the answers are kept; policies ask one or two."""


Named = dict[str, str | None]
"""An action and a suggestion, in PDDL."""


class Step(NamedTuple):
    """An action of a person: at which place of their task, after what of the robot's, and which; both also in PDDL."""

    place: int
    robot: int
    slot: int
    action: str
    suggestion: str | None

    def named(self) -> Named:
        """Give it in PDDL."""
        return {"action": self.action, "suggestion": self.suggestion}


Numbers = dict[str | None, int]
"""Of all actions that were done or suggested, in the order in which they came first; None stands for nothing."""


class FinishedTasks:
    """The tasks that somebody has left behind, with what was done and suggested in each: eight bytes an action.

    Parameters
    ----------
    numbers : dict
        Of actions, shared by a team.
    """

    def __init__(self, numbers: Numbers) -> None:
        self._numbers = numbers
        self._problems: list[LiveTask] = []
        self._ends, self._done = array("q"), array("i")  # of each step its action and its suggestion, in turn

    def add(self, problem: LiveTask, steps: list[Step]) -> None:
        """Keep a task."""
        for step in steps:
            for name in step.action, step.suggestion:
                self._done.append(self._numbers.setdefault(name, len(self._numbers)))
        self._problems.append(problem)
        self._ends.append(len(self._done))

    def __iter__(self) -> Iterator[tuple[LiveTask, list[Named]]]:
        """Give each task with its steps."""
        names, begin = list(self._numbers), 0
        for problem, end in zip(self._problems, self._ends, strict=True):
            yield (
                problem,
                [
                    {"action": names[self._done[at]], "suggestion": names[self._done[at + 1]]}
                    for at in range(begin, end, 2)
                ],
            )
            begin = end


@dataclass
class RosterEntry:
    """The task that somebody is at, their steps in it, and what was believed of them when they began it."""

    name: str
    place: int
    problem: LiveTask
    before: Floats
    past: FinishedTasks
    steps: list[Step] = field(default_factory=list)

    def episodes(self) -> list[tuple[LiveTask, list[Named]]]:
        """Give all tasks that they have been at, with their steps."""
        return [*self.past, (self.problem, [step.named() for step in self.steps])]


@dataclass
class _Answers:
    """What somebody asked about everybody, shape (P, W), and to what change of each person it belongs."""

    values: Floats
    change: NDArray[np.int64]


class Roster:
    """The people of a team, at places 0 to P - 1; whoever leaves keeps theirs.

    Attributes
    ----------
    parts : list of TaskPart
        Of everybody's tasks, numbered; a number is used again when nobody is there any more.
    records : list of RosterEntry
        By place.
    x, model : int arrays, shape (P,)
        The row of everybody's state, and the number of its part.
    robot : int array, shape (P,)
        What was suggested to them since their last action; 0 for nothing.
    erred, present, ended : bool arrays, shape (P,)
        Whose last action was not an optimal choice; who is there; who has reached their goal.
    belief : float array, shape (P, B, T)
    """

    def __init__(self, places: int) -> None:
        self.parts: list[TaskPart] = []
        self._people: list[int] = []  # in each part
        self._number: dict[TaskPart, int] = {}
        self._actions: Numbers = {}
        self.records: list[RosterEntry] = []
        self.by_name: dict[str, RosterEntry] = {}
        self.x, self.model, self.robot = (np.zeros(places, dtype=np.int64) for _ in range(3))
        self.erred, self.present, self.ended = (np.zeros(places, dtype=bool) for _ in range(3))
        self.belief = np.zeros((places, 0, 0))
        self._change = np.zeros(places, dtype=np.int64)
        self._answers: dict[Ask, _Answers] = {}

    def __len__(self) -> int:
        return len(self.x)

    @property
    def names(self) -> tuple[str, ...]:
        """Who is there."""
        return tuple(record.name for record in self.records if self.present[record.place])

    def known(self, name: str) -> RosterEntry:
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

    def add(self, name: str, problem: LiveTask) -> None:
        """Take somebody new in, at the next place, which there has to be."""
        part, row = problem.at(problem.initial)
        prior = part.policy.pomdp.prior
        if not self.records:
            self.belief = np.zeros((len(self), *prior.shape))
        elif prior.shape != self.belief.shape[1:]:
            raise ValueError(f"{name}: a belief of shape {prior.shape}; expected {self.belief.shape[1:]}, as in others")
        record = RosterEntry(name, len(self.records), problem, prior.copy(), FinishedTasks(self._actions))
        self.records.append(record)
        self.by_name[name] = record
        self.present[record.place] = True
        self.belief[record.place] = prior
        self.put(record, part, row)

    def part(self, record: RosterEntry) -> tuple[TaskPart, int]:
        """Give the part in which somebody is, and their row there."""
        return self.parts[self.model[record.place]], int(self.x[record.place])

    def grow(self, places: int) -> None:
        """Make room for so many people."""

        def longer(array: NDArray[Any], fill: Any = 0) -> NDArray[Any]:
            more = np.full((places - len(array), *array.shape[1:]), fill, dtype=array.dtype)
            return np.concatenate([array, more])

        for name in ("x", "model", "robot", "erred", "present", "ended", "belief"):
            setattr(self, name, longer(getattr(self, name)))
        self._change, self._answers = longer(self._change), {}

    def put(self, record: RosterEntry, part: TaskPart, row: int, *, erred: bool = False, robot: int = 0) -> None:
        """Put somebody into a state."""
        k = record.place
        if self._change[k]:
            self._people[self.model[k]] -= 1
        self.model[k], self.x[k], self.erred[k], self.robot[k] = self._numbered(part), row, erred, robot
        self._people[self.model[k]] += 1
        self.ended[k] = part.choices.goal[row]
        self._change[k] += 1

    def _numbered(self, part: TaskPart) -> int:
        """Give the number of a part, which may be that of one in which nobody is any more."""
        if part not in self._number:
            free = self._people.index(0) if 0 in self._people else len(self.parts)
            if free < len(self.parts):
                del self._number[self.parts[free]]
                self.parts[free] = part
            else:
                self.parts.append(part)
                self._people.append(0)
            self._number[part] = free
        return self._number[part]

    def of_each(self, ask: Ask, active: NDArray[np.bool_]) -> Floats:
        """Give the answers about everybody, shape (P, W), up to date for those who are active.

        Only about those of whom something has changed it is asked anew.
        """
        if ask not in self._answers and len(self._answers) >= ANSWERS:
            self._answers.clear()
        kept = self._answers.setdefault(ask, _Answers(np.full((len(self), 1), -np.inf), np.full(len(self), -1)))
        rows = np.flatnonzero((kept.change != self._change) & active)
        for number, mine in by_model(self.model, rows, len(self.parts)):
            values = ask(self.parts[number].policy, self.x[mine], self.belief[mine])
            wider = values.shape[1] - kept.values.shape[1]
            if wider > 0:
                kept.values = np.pad(kept.values, ((0, 0), (0, wider)), constant_values=-np.inf)
            kept.values[mine] = -np.inf
            kept.values[mine, : values.shape[1]] = values
        kept.change[rows] = self._change[rows]
        return kept.values
