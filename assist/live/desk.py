"""Queries on the state of a live team: whether an event is possible, advice, explanations and views of people."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from numpy.typing import ArrayLike

from planner import CostToGo

from ..declare.refusals import AbsentError, InapplicableError, Refusal
from ..people.action_names import in_pddl
from ..people.goals import Goals
from ..person.policy import Policy
from ..person.travel import Travel
from ..team.state import BASE
from .advice import Advice, PersonState, Question
from .beliefs import answers, is_uncertain, likeliest_cost_to_go, worth_of_asking
from .explanation import Explanation
from .knowledge import Knowledge
from .names import is_name
from .roster import RosterEntry
from .uncertain_actions import seen_of

Task = CostToGo | Goals | Policy

IDLE = Advice(None, None, None, arrived=True)
"""The advice of a robot that does nothing."""


class Desk(Knowledge):
    """What the robots know of a live team, and what it answers; parameters and attributes as in `Knowledge`."""

    def require(self, person: str) -> None:
        """Check that a person is present.

        Raises
        ------
        AbsentError
            The person is not present.
        """
        if not self.is_present(person):
            raise AbsentError("unknown", person=repr(person[:80]))

    def require_robot(self, number: int) -> None:
        """Check the number of a robot.

        Raises
        ------
        AbsentError
            There is no robot of this number.
        """
        self._places.number(number)

    def require_task(self, name: str) -> None:
        """Check the name of a task.

        Raises
        ------
        Refusal
            There is no such task.
        """
        if name not in self.tasks:
            raise Refusal("other", why=f"task {name[:80]!r}: expected one of {', '.join(self.tasks)}")

    def require_asked(self, person: str, seq: int | None) -> None:
        """Check that a person's open question had been asked when the event of this number was recorded.

        Raises
        ------
        InapplicableError
            It was asked later.
        """
        if seq is not None and seq < self.entry(person).asked_at:
            raise InapplicableError("later_question")

    def task_of_newcomer(self, person: str, task: str | None, *, more: bool = False) -> str | None:
        """Return the task of a person who joins, perhaps with `more` of their own; None if they return to theirs.

        Raises
        ------
        Refusal
            They cannot join, or not with this task.
        """
        if not is_name(person):
            raise Refusal("no_name", person=repr(person[:80]))
        if self.is_present(person):
            raise InapplicableError("there_already", person=person)
        if self.has_met(person):
            if task is not None or more:
                raise InapplicableError(
                    "other", why=f"{person} returns to the task that they left; `begin` gives them another"
                )
            return None
        most = 10_000  # people over a whole session, which bounds its memory
        if self.size >= most:
            raise InapplicableError("other", why=f"{most} people have been here; there is no place for {person}")
        found = next(iter(self.tasks)) if task is None else task
        self.require_task(found)
        return found

    def has_heard(
        self, person: str, action: str | None, *, heard: bool, followed: bool | None, seq: int | None
    ) -> bool:
        """Return whether a person who acted on a view can have seen the open suggestion, unless it is said that not.

        Raises
        ------
        Refusal
            What is said about a suggestion that was followed is impossible.
        """
        if action is None and followed is not None:
            raise Refusal("other", why="followed: expected an action that was seen")
        entry = self.known(person)
        offer = entry.offer
        if followed and (offer is None or offer.action.lower() != self._meant(entry, action or "")):
            said = "nothing is suggested" if offer is None else f"{offer.action} is suggested"
            raise InapplicableError("other", why=f"followed is true and the action {action}, but {said}")
        if followed and not heard:
            raise Refusal("other", why="followed is true, but heard is false; expected one of them")
        return heard and (offer is None or seq is None or seq >= offer.number or bool(followed))

    def _meant(self, entry: RosterEntry, action: str) -> str:
        """Return the action that a report means, in lower case; last ones may be missing where states are certain."""
        if is_uncertain(entry, self.setting.observation):
            return in_pddl(action)
        row = self.roster.row(entry)
        return entry.problem.choices.name(row, entry.problem.slot(row, action)).lower()

    @property
    def finished(self) -> bool:
        """Whether everybody who is present has reached their goal."""
        return not (self.roster.present & ~self.roster.ended).any()

    def seen_of(
        self, person: str, action: str | None, likelihoods: Mapping[str, float] | None, missed: float | None
    ) -> dict[str, Any]:
        """Return what is recorded of an uncertain action, after checking it; arguments and errors as in `Reports`."""
        return seen_of(self.known(person).problem, self.setting, action, likelihoods, missed) or {}

    def worth_of_asking(self, person: str) -> float:
        """Return what it is worth to learn what a person's last action was, in cost units, if they answer truthfully.

        It is the expected increase of the QMDP value of the person's own problem. A question that costs less is worth
        asking; `Reports.answer` records the answer. It is 0 if the last action is certain.
        """
        return worth_of_asking(self.known(person), self.setting)[0]

    @property
    def questions(self) -> tuple[Question, ...]:
        """The open questions, of people who have not answered them or acted since."""
        return tuple(question for _, question in sorted(self.roster.questions.items()))

    def erred(self, person: str) -> bool:
        """Return whether a person's last action was not an optimal choice."""
        return bool(self.roster.erred[self.known(person).place])

    def recommend(self, robot: int = 1) -> Advice:
        """Return what the robot does next: to whom it goes, and what it suggests.

        The advice is the same as before if nothing has happened since.

        Parameters
        ----------
        robot : int
            Number of the robot, from 1.
        """
        return self.recommend_all()[self._places.number(robot)]

    def recommend_all(self) -> tuple[Advice, ...]:
        """Return what each robot does next."""
        if self.paused:
            return (IDLE,) * len(self.robots)
        return self._advice or self.follow(self._decisions.decide(self._step), self._step + 1)

    def other_travel(self, distance: ArrayLike) -> Travel:
        """Return the travel over other distances; arguments and errors as in `rearranged`."""
        return self._places.other_travel(distance, len(self.roster.records))

    @property
    def distance(self) -> list[list[float]] | None:
        """The given distances; None if all are 1."""
        return None if self._places.distance is None else self._places.distance.tolist()

    def explain(self, person: str | None = None, *, against: str | None = None) -> Explanation:
        """Return why a person has the present suggestion, or none, by the present beliefs.

        `Advice.explanation` explains a decision by the beliefs at that time.

        Parameters
        ----------
        person : str, optional
            By default, why there is no suggestion; the advice explains any other decision.
        against : str, optional
            An action of the person with which the suggested step is compared.

        Raises
        ------
        Refusal
            There is no such person, or no such action in their task.
        InapplicableError
            The action is not applicable now, or nothing is suggested to the person.
        """
        return self.explain_later(person, against=against)()

    def explain_later(self, person: str | None = None, *, against: str | None = None) -> Callable[[], Explanation]:
        """Return a function that explains what `explain` would, whatever happens in the meantime.

        This takes little time. The function may be called from another thread.
        """
        place = None if person is None else self.known(person).place
        number = self._explaining(place)
        at_work = self._places.at[number] == place or self._attends(number)
        location = self._places.at[number] if at_work else BASE
        return partial(
            self._decisions.point(number).explanation, place, None if location == BASE else location,
            arrived=not self._places.under_way[number], against=against,
        )  # fmt: skip

    def person(self, person: str) -> PersonState:
        """Return the state of a person, present or not, and the belief about the person."""
        record = self.entry(person)
        k, row, problem, offer = record.place, self.roster.row(record), record.problem, record.offer
        choices, pomdp, belief = problem.choices, problem.policy.pomdp, self.roster.belief[k].copy()
        names = () if self.roster.stopped(record) else tuple(
            choices.name(row, slot) for slot in range(int(choices.applicable[row].sum()))
        )  # fmt: skip
        return PersonState(
            person, bool(self.roster.present[k]), bool(self.roster.ended[k]), problem.state(row), names,
            None if offer is None else offer.action, self.cost_to_go(person), len(record.steps), pomdp.grid,
            pomdp.hidden, belief, pomdp.hidden.goals_shown(belief),
            {} if record.joint is None else record.joint.states(problem.policy), record.question,
            next(((one.goal, one.yes) for one in reversed(answers(record))), None),
        )  # fmt: skip

    def cost_to_go(self, person: str) -> float:
        """Return the cost-to-go of a person's present state, in cost units; the person may be absent.

        If they pursue one of several goals, it is that of the most probable one.
        """
        return likeliest_cost_to_go(self.roster, self.entry(person))

    @property
    def step(self) -> int:
        """The number of decisions."""
        return self._step

    @property
    def robots(self) -> tuple[str | None, ...]:
        """For each robot, the person at whom it is, or to whom it is under way; None at its base."""
        return tuple(None if place == BASE else self.roster.records[place].name for place in self._places.at)

    def log(self) -> list[dict[str, Any]]:
        """Return all actions as `fit` reads them: one dictionary each, for each person in order."""
        return [row for record in self.roster.records for row in record.log()]
