"""The people of a live team: a record for each person, and the arrays that a team policy reads."""

from __future__ import annotations

from abc import ABC, abstractmethod
from array import array
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from sys import intern
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..declare.refusals import AbsentError
from ..people.decision import Floats
from ..people.hidden_type import is_certain
from ..people.trust_rules import TrustRule
from ..person.beliefs import Ask
from ..person.joint_belief import JointBelief
from ..person.rows_of_people import by_model
from ..person.settings import Setting
from ..person.uncertain_states import UncertainStates
from .advice import Question, Reason
from .explanation import Remark
from .live_task import LiveTask

V = TypeVar("V")

Said = tuple[str | None, str | None, bool]
"""An action and the suggestion before it, in PDDL notation, and whether the action is doubtful."""


class Offer(NamedTuple):
    """A suggestion to a person that is open until they act: the robot action, the action in PDDL notation, and why.

    `number` is that of the event after which it was made, and `time` when that was, in seconds.
    """

    said: int
    action: str
    reason: Reason | None
    number: int
    time: float


class Step(NamedTuple):
    """A person's action: where it was taken, what was suggested before it, its slot, and the action in PDDL notation.

    `situation` is one of `LiveTask`. `seen` is what was seen if the action is uncertain: `likelihoods`, or the
    probability `missed` that one was missed. The action is then the likeliest one, or None. It is also `doubtful` if
    the robot sees all actions unreliably.
    """

    situation: int
    offer: Offer | None
    slot: int
    action: str | None
    seen: Mapping[str, Any] | None = None
    doubtful: bool = False

    @property
    def said(self) -> int:
        """The robot action before it; 0 for none."""
        return 0 if self.offer is None else self.offer.said

    @property
    def suggestion(self) -> str | None:
        """What was suggested."""
        return None if self.offer is None else self.offer.action


@dataclass(frozen=True)
class News(ABC):
    """What becomes known of a person, or moves them, between actions: after so many `steps` in their task.

    They are no part of what two have in common, as actions before it may be taken back.
    """

    steps: int = field(compare=False)

    @abstractmethod
    def tell(self, team: Roster, record: RosterEntry, setting: Setting) -> None:
        """Update the belief in the person.

        Raises
        ------
        InapplicableError
            It is impossible under the belief. Nothing has changed.
        """

    def moved(self, theta: Floats, rule: TrustRule) -> Floats:  # noqa: ARG002
        """Return the person's own theta after it, under their rule; as it is unless they are moved."""
        return theta

    @property
    def remark(self) -> Remark | None:
        """What an explanation says of it, if anything."""
        return None


Numbers = dict[str | None, int]
"""Number of each action that was done or suggested, in the order of first occurrence; None stands for no action."""


class FinishedTasks:
    """The actions and suggestions in a person's finished tasks; an action takes eight bytes.

    Parameters
    ----------
    numbers : dict
        Numbers of actions, shared by the team.
    """

    def __init__(self, numbers: Numbers) -> None:
        self._numbers = numbers
        # Action, or its complement if it is doubtful, and suggestion of each step alternate.
        self._ends, self._done = array("q"), array("i")

    def add(self, steps: list[Step]) -> None:
        """Append a task that was finished or left, with its steps."""
        for step in steps:
            action, said = (
                self._numbers.setdefault(name, len(self._numbers)) for name in (step.action, step.suggestion)
            )
            self._done.extend((~action if step.doubtful else action, said))
        self._ends.append(len(self._done))

    def __iter__(self) -> Iterator[list[Said]]:
        """Yield the steps of each task."""
        names, begin = list(self._numbers), 0
        for end in self._ends:
            pairs = [(self._done[at], self._done[at + 1]) for at in range(begin, end, 2)]
            yield [(names[max(action, ~action)], names[said], action < 0) for action, said in pairs]
            begin = end


@dataclass(eq=False)
class RosterEntry:
    """A person's current task, the steps in it, and the belief about the person at its beginning.

    `earlier` is the joint belief before the last action. `news` is what else became known of them in this task, in its
    order, and `asked` the kinds of questions since the last action. `done` holds the events of this task that can be
    taken back.
    `tasks` names all tasks, the present one last, and `times` has the time of each action in them, in seconds.
    `history` has the time and the cost-to-go after each event of this task, infinite in dead ends. `seq` and `asked_at`
    are the numbers of the last event that changed the person's view, and of that of the last question.
    `order` has the number of the event of each action, and `since` that of the person's coming, or coming back, before
    it; `came` is that number now.
    What every decision copies is kept by the team, by place: a copy of few objects is fast. A record
    holds the row of the person.
    """

    name: str
    place: int
    team: Roster = field(repr=False, compare=False)
    before: Floats
    past: FinishedTasks
    steps: list[Step] = field(default_factory=list)
    earlier: JointBelief | None = None
    news: list[News] = field(default_factory=list)
    asked: set[str] = field(default_factory=set)
    done: list[Any] = field(default_factory=list)
    tasks: list[str] = field(default_factory=list)
    times: array[float] = field(default_factory=lambda: array("d"))
    history: list[tuple[float, float]] = field(default_factory=list)
    seq: int = 0
    asked_at: int = 0
    order: array[int] = field(default_factory=lambda: array("q"))
    since: array[int] = field(default_factory=lambda: array("q"))
    came: int = 0

    def did(self, step: Step, time: float) -> None:
        """Append an action."""
        self.steps.append(step)
        self.times.append(time)
        self.order.append(self.team.event)
        self.since.append(self.came)

    def undo(self) -> Step:
        """Remove the last action, and return it."""
        for each in (self.times, self.order, self.since):
            each.pop()
        return self.steps.pop()

    def begin(self, problem: LiveTask, name: str) -> None:
        """Begin a task."""
        self.past.add(self.steps)
        self.problem, self.steps, self.news = problem, [], []
        self.tasks.append(intern(name))
        self.done.clear()
        self.history.clear()

    @property
    def problem(self) -> LiveTask:
        """The present task."""
        return self.team.problems[self.place]

    @problem.setter
    def problem(self, problem: LiveTask) -> None:
        self.team.problems[self.place] = problem

    @property
    def joint(self) -> JointBelief | None:
        """The belief over task states and types, or None if all actions of this task were certain."""
        return self.team.beliefs.joints.get(self.place)

    @joint.setter
    def joint(self, joint: JointBelief | None) -> None:
        _set(self.team.beliefs.joints, self.place, joint)

    @property
    def question(self) -> Question | None:
        """The open question."""
        return self.team.questions.get(self.place)

    @question.setter
    def question(self, question: Question | None) -> None:
        _set(self.team.questions, self.place, question)

    @property
    def offer(self) -> Offer | None:
        """The open suggestion."""
        return self.team.offers.get(self.place)

    def log(self) -> Iterator[dict[str, Any]]:
        """Yield all actions as `fit` reads them, with their tasks and times; what was perhaps missed has no row.

        Those that were seen with doubt are marked as `uncertain`.
        """
        times, now = (
            zip(self.times, self.order, self.since, strict=True),
            [(step.action, step.suggestion, step.doubtful) for step in self.steps],
        )
        for number, (task, steps) in enumerate(zip(self.tasks, [*self.past, now], strict=True), start=1):
            count = 0
            for (action, suggestion, doubtful), (time, order, since) in zip(steps, times, strict=False):
                row = {"person": self.name, "episode": str(number), "step": count, "action": action}
                if action is not None:
                    doubt = {"uncertain": True} if doubtful else {}
                    among = {"place": self.place, "order": order, "since": since}
                    yield row | {"suggestion": suggestion, "task": task, "time": time, **among, **doubt}
                count += action is not None

    @property
    def remark(self) -> Remark | None:
        """What an explanation says of the last news in this task, if anything."""
        return next((said for one in reversed(self.news) if (said := one.remark) is not None), None)

    def close_questions(self) -> None:
        """Close the open question, because the person has acted."""
        self.question = None
        self.asked.clear()


def _set(values: dict[int, V], place: int, value: V | None) -> None:
    """Set or, with None, remove the value at a place."""
    if value is None:
        values.pop(place, None)
    else:
        values[place] = value


@dataclass
class _Answers:
    """Cached answers to a question about all people, shape (P, W).

    `change` has, for each person, the number of changes after which the answer was computed.
    """

    values: Floats
    change: NDArray[np.int64]


class Roster:
    """The people of a team, at places 0 to P - 1; a person who leaves keeps their place.

    Attributes
    ----------
    tasks : list of LiveTask
        The tasks on which people have worked.
    records : list of RosterEntry
        Records by place.
    problems : list of LiveTask
        Present tasks by place.
    beliefs : UncertainStates
        What the robot knows of the people, by place: in `x` the row of each person's state, and in `erred` whether the
        last action was not an optimal choice.
    questions : dict of int to Question
        Open questions by place.
    offers : dict of int to Offer
        Open suggestions by place.
    model : int array, shape (P,)
        Index of each person's task in `tasks`.
    said : int array, shape (P,)
        Robot action towards each person since their last action, that of their open suggestion; 0 for none.
    present, ended : bool arrays, shape (P,)
        Whether the person is present, and has (probably) reached the goal.
    event, time : int, float
        Number of the present event, and when it happened, in seconds, or was tried to: time that passed without an
        effect, too.
    paused : bool
        Whether the robots make no suggestions.
    touched : set of str
        The people of whom something else is known since the last event began.
    """

    def __init__(self, places: int) -> None:
        self.tasks: list[LiveTask] = []
        self._actions: Numbers = {}
        self.records: list[RosterEntry] = []
        self.problems: list[LiveTask] = []
        self.questions: dict[int, Question] = {}
        self.offers: dict[int, Offer] = {}
        self.by_name: dict[str, RosterEntry] = {}
        self.model, self.said = np.zeros((2, places), dtype=np.int64)
        self.present, self.ended = np.zeros((2, places), dtype=bool)
        self.beliefs = UncertainStates(
            np.zeros(places, dtype=np.int64), np.zeros((places, 0, 0)), np.zeros(places, dtype=bool)
        )  # fmt: skip
        self.event, self.time, self.touched = 0, 0.0, set[str]()
        self.paused = False
        self._change = np.zeros(places, dtype=np.int64)
        self._answers: dict[Ask, _Answers] = {}

    def __len__(self) -> int:
        return len(self.model)

    @property
    def x(self) -> NDArray[np.int64]:
        """The row of each person's state, the most probable one, shape (P,)."""
        return self.beliefs.x

    @property
    def erred(self) -> NDArray[np.bool_]:
        """Whether each person's last action was (probably) a mistake, shape (P,)."""
        return self.beliefs.erred

    @property
    def belief(self) -> Floats:
        """The belief in each person's type, shape (P, H, T)."""
        return self.beliefs.belief

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all people who are present."""
        return tuple(record.name for record in self.records if self.present[record.place])

    def known(self, name: str) -> RosterEntry:
        """Return the record of a person who is present.

        Raises
        ------
        AbsentError
            The person is not present; the message lists who is.
        """
        record = self.by_name.get(name)
        if record is None or not self.present[record.place]:
            names, more = self.names[:10], len(self.names) - 10
            there = ", ".join(names) + f" and {more} more" * (more > 0)
            raise AbsentError("other", why=f"{name!r} is not in the team; present: {there or 'nobody'}")
        return record

    def add(self, name: str, problem: LiveTask, task: str, belief: ArrayLike | None = None) -> None:
        """Add a new person at the first empty place, with a belief or the prior. `grow` makes places."""
        row, pomdp = problem.row(problem.initial), problem.policy.pomdp
        prior, hidden = pomdp.prior, pomdp.hidden
        carried = None if belief is None else _distribution(name, belief, hidden.of_people(prior).shape)
        if not self.records:
            self.beliefs.belief = np.zeros((len(self), *prior.shape))
        elif prior.shape != self.belief.shape[1:]:
            raise ValueError(f"{name}: a belief of shape {prior.shape}; expected {self.belief.shape[1:]}, as in others")
        before = prior if carried is None else hidden.with_goals(carried)
        record = RosterEntry(
            name, len(self.records), self, before.copy(), FinishedTasks(self._actions), tasks=[intern(task)]
        )  # fmt: skip
        self.records.append(record)
        self.problems.append(problem)
        self.by_name[name] = record
        self.present[record.place] = True
        self.belief[record.place] = before
        self.put(record, row)

    def row(self, record: RosterEntry) -> int:
        """Return the row of a person in their present task, the most probable one."""
        return int(self.x[record.place])

    def suggest(self, record: RosterEntry, action: str | None, reason: Reason | None = None) -> None:
        """Open a suggestion to a person, or none."""
        said = record.problem.said(self.row(record), action)
        self._open(record, None if action is None else Offer(said, action, reason, self.event, self.time))

    def give_reason(self, record: RosterEntry, reason: Reason) -> None:
        """Let the open suggestion to a person have another reason."""
        self.offers[record.place] = self.offers[record.place]._replace(reason=reason)

    def _open(self, record: RosterEntry, offer: Offer | None) -> None:
        _set(self.offers, record.place, offer)
        self.said[record.place] = 0 if offer is None else offer.said

    def ask(self, question: Question | None) -> None:
        """Open a question, if there is one and its person is known."""
        record = None if question is None else self.by_name.get(question.person)
        if question is not None and record is not None:
            record.question, record.asked_at = question, self.event
            record.asked.add(question.kind)

    def resize(self, places: int) -> None:
        """Change the number of places, of which those without people are at the end."""

        def longer(array: NDArray[Any]) -> NDArray[Any]:
            more = np.zeros((max(0, places - len(array)), *array.shape[1:]), dtype=array.dtype)
            return np.concatenate([array[:places], more])

        for name in ("model", "said", "present", "ended"):
            setattr(self, name, longer(getattr(self, name)))
        for name in ("x", "belief", "erred"):
            setattr(self.beliefs, name, longer(getattr(self.beliefs, name)))
        self._change, self._answers = longer(self._change), {}

    def put(self, record: RosterEntry, row: int, *, erred: bool = False, offer: Offer | None = None) -> None:
        """Set the row of a person in their present task, what led to it, and the suggestion that is open there.

        A suggestion is withdrawn if it is not possible there.
        """
        k, problem = record.place, record.problem
        if problem not in self.tasks:
            self.tasks.append(problem)
        self.model[k], self.x[k] = self.tasks.index(problem), row
        self.erred[k] = erred
        said = 0 if offer is None else problem.said_at(row, offer.action)
        self._open(record, offer._replace(said=said) if offer is not None and said else None)
        problem.policy.problem.hold(record, self.x[k : k + 1].copy())
        self.ended[k] = self.finished(record) > 1 / 2
        self.changed(record)

    def changed(self, record: RosterEntry) -> None:
        """Tell that what is known of a person has changed."""
        self._change[record.place] += 1
        self.touched.add(record.name)

    def finished(self, record: RosterEntry) -> float:
        """Return the probability that a person has reached their goal, of which several may be possible."""
        return self.beliefs.finished(record.place, record.problem.policy)

    def stopped(self, record: RosterEntry) -> bool:
        """Return whether a person has certainly reached their goal."""
        return bool(is_certain(self.finished(record)))

    def of_each(self, ask: Ask, active: NDArray[np.bool_]) -> Floats:
        """Return the answers about all people, shape (P, W); those of active people are up to date.

        The question is asked again only about people who have changed since the last time.
        """
        if ask not in self._answers and len(self._answers) >= 8:  # policies ask one or two questions
            self._answers.clear()
        kept = self._answers.setdefault(ask, _Answers(np.full((len(self), 1), -np.inf), np.full(len(self), -1)))
        rows = np.flatnonzero((kept.change != self._change) & active)
        for number, mine in by_model(self.model, rows, len(self.tasks)):
            values = self.answers_about(ask, number, mine)
            wider = values.shape[1] - kept.values.shape[1]
            if wider > 0:
                kept.values = np.pad(kept.values, ((0, 0), (0, wider)), constant_values=-np.inf)
            kept.values[mine] = -np.inf
            kept.values[mine, : values.shape[1]] = values
        kept.change[rows] = self._change[rows]
        return kept.values

    def answers_about(self, ask: Ask, number: int, places: NDArray[np.int64]) -> Floats:
        """Return the answers about people of one task, given by their places, shape (N, W)."""
        return self.beliefs.expected(ask, self.tasks[number].policy, places)

    def changes(self, place: int) -> int:
        """Return how often what is known of the person at a place has changed."""
        return int(self._change[place])


def _distribution(name: str, belief: ArrayLike, shape: tuple[int, ...]) -> Floats:
    """Return a belief as an array of this shape.

    Raises
    ------
    ValueError
        It is no distribution on as many pairs of beta and theta.
    """
    found = np.array(belief, dtype=float)
    size, rounding = int(np.prod(shape)), 1e-9
    if found.size != size or not (found >= 0).all() or not abs(found.sum() - 1.0) <= rounding:
        raise ValueError(
            f"{name}: a belief of {found.size} numbers with the sum {found.sum():.6g}; expected {size} "
            "numbers of 0 or more with the sum 1"
        )
    return found.reshape(shape)
