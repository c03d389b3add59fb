"""The team at the time of a decision, from which the decision is explained later.

A `DecisionPoint` copies what events change: states, beliefs, open suggestions and the robot's place. So it costs
little while a decision is made, and all else is computed only on request.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo

from ..declare.refusals import InapplicableError
from ..people.choices import Choices
from ..people.decision import Floats
from ..people.hidden_type import is_certain
from ..people.same_costs import same_cost
from ..person.beliefs import Beliefs
from ..person.policy import Policy
from ..person.rows_of_people import by_model
from ..person.settings import Setting
from ..person.ties import first_best
from ..team.baselines import NoAssistance
from ..team.state import BASE, TeamPolicy, TeamState, beside, worth_of_actions
from .advice import Question
from .causes import CAUSES
from .contrast import Contrast, contrast
from .explanation import Explanation, Prospect, Remark, WhyNothing, WhyPerson, WhyQuestion, WhyStep
from .live_task import LiveTask
from .roster import Roster

T = TypeVar("T", bound=np.generic)


@dataclass(frozen=True, eq=False)
class DecisionPoint:
    """The team of P people at a decision.

    Attributes
    ----------
    names : tuple of str
    problems : tuple of LiveTask
    policies : list of Policy
    beliefs : Beliefs
        What the robot knows of the people; `x` has the row of each person, which the decision holds.
    model : int array, shape (P,)
        Number of each person's policy.
    said : int array, shape (P,)
        Robot action towards each person that is open; 0 for none.
    present, ended : bool arrays, shape (P,)
    questions : mapping of int to WhyQuestion
        The open questions, by the place of the person.
    here : int
        Place of the robot before the decision; -1 for its base.
    moving : float array, shape (P,)
        Cost of the robot's way to each person, in cost units.
    rule : str
        Name of the team's policy.
    extra : float
        What a suggestion by this robot costs more than in people's problems, in cost units.
    policy : callable
        Returns the team's policy.
    remarks : mapping of int to Remark
        What happened to people last in their present task, by place.
    paused : bool
        Whether suggestions are paused.
    """

    names: tuple[str, ...]
    problems: tuple[LiveTask, ...]
    policies: list[Policy]
    beliefs: Beliefs
    model: NDArray[np.int64]
    said: NDArray[np.int64]
    present: NDArray[np.bool_]
    ended: NDArray[np.bool_]
    questions: Mapping[int, WhyQuestion]
    here: int
    moving: Floats
    rule: str
    extra: float = 0.0
    policy: Callable[[], TeamPolicy] = NoAssistance
    remarks: Mapping[int, Remark] = field(default_factory=dict)
    paused: bool = False

    @classmethod
    def of(
        cls,
        team: Roster,
        here: int,
        moving: Floats,
        rule: str,
        extra: float,
        policy: Callable[[], TeamPolicy],
        asked: Question | None = None,
    ) -> DecisionPoint:
        """Return a copy of the present state of a team, in which a question is asked as well.

        The other arguments are attributes.
        """
        count, questions = len(team.records), dict(team.questions)
        if asked is not None:
            questions[team.by_name[asked.person].place] = asked

        def copy(array: NDArray[T]) -> NDArray[T]:
            return array[:count].copy()

        policies = [task.policy for task in team.tasks]
        point = cls(
            tuple(team.by_name), tuple(team.problems), policies, team.beliefs.of(np.arange(count)),
            copy(team.model), copy(team.said), copy(team.present), copy(team.ended),
            {k: _why(one) for k, one in sorted(questions.items())},
            here, moving[:count], rule, extra, policy,
            {one.place: remark for one in team.records if (remark := one.remark) is not None}, team.paused,
        )  # fmt: skip
        for number, rows in by_model(point.model, np.arange(count), len(policies)):
            policies[number].problem.hold(point, point.beliefs.x[rows])
        return point

    def explanation(
        self, place: int | None, attended: int | None, *, arrived: bool, against: str | None = None
    ) -> Explanation:
        """Return why a person has their suggestion, or none.

        Parameters
        ----------
        place : int or None
            The person's place; None to explain why there is no suggestion.
        attended : int or None
            Place of the person to whom the robot attends.
        arrived : bool
            Whether it is there.
        against : str, optional
            As in `suggested`.

        Raises
        ------
        Refusal
            As in `suggested`.
        """
        if place is None:
            return self.nothing()
        said, coming = int(self.said[place]), attended == place and not arrived
        if said or coming:
            return self.suggested(place, said, arrived=not coming, against=against)
        self._require_none(place, against)
        return self.nothing(place, elsewhere=attended not in (None, place))

    def suggested(self, place: int, said: int, *, arrived: bool, against: str | None = None) -> Explanation:
        """Return why a person is attended to, and why with this suggestion.

        Parameters
        ----------
        place : int
            The person's place.
        said : int
            The robot action; 0 without a suggestion.
        arrived : bool
            Whether the robot is there.
        against : str, optional
            An action with which the suggested step is to be compared.

        Raises
        ------
        Refusal
            The task has no such action.
        InapplicableError
            The action is not applicable now, or there is no suggestion with which it could be compared.
        """
        person = self._why_person(place, said, arrived)
        if said == 0:
            self._require_none(place, against)
            return Explanation(now=person)
        step = self._why_step(place, said)
        asked = None
        if against is not None:
            problem, _, row = self._at(place)
            slot = problem.slot(row, against)
            name = problem.choices.name(row, slot)
            asked = self._contrast(place, said, step.step, name, float(self._chances(place)[slot]))
        return self._in_words(place, Explanation(step, person, None, asked))

    def nothing(self, place: int | None = None, *, elsewhere: bool = False) -> Explanation:
        """Return why there is no suggestion, to a person or to anybody.

        Parameters
        ----------
        place : int, optional
            The person's place.
        elsewhere : bool
            Whether the robot attends to somebody else.
        """
        cause = next(one for one in CAUSES if one.when(self, place))
        about = None if place is None else self.names[place]
        why = WhyNothing(cause.key, self.rule, about=about, **cause.more(self, place))
        if why.prospect is None:
            return Explanation(nothing=why)
        at = self.names.index(str(why.prospect.person))
        return self._in_words(at, Explanation(nothing=replace(why, elsewhere=elsewhere)))

    # What causes look at.

    @property
    def working(self) -> NDArray[np.bool_]:
        """Who is at work, shape (P,)."""
        return self.present & ~self.ended

    @property
    def waiting(self) -> NDArray[np.bool_]:
        """Who is at work, and has neither a suggestion nor an open question, shape (P,)."""
        waiting = self.working & (self.said == 0)
        waiting[list(self.questions)] = False
        return waiting

    def certainly_ended(self, place: int) -> bool:
        """Return whether a person has certainly reached their goal."""
        return bool(self.ended[place] and is_certain(self.beliefs.finished(place, self._at(place)[1])))

    def asked(self, place: int | None) -> WhyQuestion | None:
        """Return the open question to a person, or the first one if nobody can get a suggestion."""
        if place is not None:
            return self.questions.get(place)
        return None if self.waiting.any() else next((one for k, one in self.questions.items() if self.working[k]), None)

    def lost(self, place: int | None) -> bool:
        """Return whether a person, or everybody who could get a suggestion, certainly is in a dead end."""
        if place is None:
            return all(self.lost(k) for k in np.flatnonzero(self.waiting).tolist())
        _, policy, _ = self._at(place)
        joint = self.beliefs.joint(place, policy)
        share = policy.pomdp.hidden.marginal(joint.joint, "goal")
        return bool(np.isinf(policy.pomdp.model.choices.goals.h[:, joint.rows(policy)].T[share > 0]).all())

    def best(self, place: int | None) -> Prospect | None:
        """Return the best suggestion to a person, or to anybody; None if there is none."""
        if place is not None:
            return self._prospects.get(place)
        return max(self._prospects.values(), key=lambda one: one.score, default=None)

    def _in_words(self, place: int, explanation: Explanation) -> Explanation:
        _, policy, row = self._at(place)
        joint = self.beliefs.joint(place, policy)
        share = float(joint.probability[joint.rows(policy) == row].sum())
        said = explanation.in_words(self.problems[place].words(explanation.actions))
        return said.in_state(1.0 if is_certain(share) else share)

    def _require_none(self, place: int, against: str | None) -> None:
        """Check that no comparison is asked for, since nothing is suggested."""
        if against is not None:
            raise InapplicableError("nothing_suggested", person=self.names[place], action=against[:80])

    def _at(self, place: int) -> tuple[LiveTask, Policy, int]:
        return self.problems[place], self.policies[self.model[place]], int(self.beliefs.x[place])

    def _known(self, place: int, said: int) -> tuple[Choices | CostToGo, int]:
        """Return all choices of a person's task, and their state there, with the goal that a suggestion is for."""
        _, policy, row = self._at(place)
        return policy.problem.task_of(self._goal(place, said)[0]), int(policy.situations(np.array([row]))[0])

    def _goal(self, place: int, said: int) -> tuple[int, float]:
        """Return the number of the goal that a suggestion is for, and its probability.

        It is the most probable of the goals for which the suggestion is optimal, or of all if there is none.
        """
        _, policy, row = self._at(place)
        pomdp, goals = policy.pomdp, policy.pomdp.model.choices.goals
        share = pomdp.hidden.shown_goals(self.beliefs.belief[place])
        optimal = goals.optimal[row, pomdp.suggested[row, said]] & ~goals.goal[:, row]
        goal = int(np.where(optimal if optimal.any() else True, share, -1.0).argmax())
        return goal, float(share[goal])

    def _contrast(self, place: int, said: int, step: str, alternative: str, probability: float) -> Contrast:
        say = self.problems[place].say
        return contrast(*self._known(place, said), step, alternative, probability=probability, say=say)

    def _chances(self, place: int) -> Floats:
        """Return how likely a person is to make each choice without a suggestion, shape (A,), under the belief."""
        _, policy, row = self._at(place)
        pomdp, choices = policy.pomdp, policy.pomdp.model.choices
        applicable = choices.applicable[row]
        p = np.einsum("ah,h->a", pomdp.chosen[row], self.beliefs.belief[place].sum(axis=1))
        return np.where(applicable, (1 - pomdp.model.lapse) * p + pomdp.model.lapse / applicable.sum(), 0.0)

    def _why_step(self, place: int, said: int) -> WhyStep:
        _, policy, row = self._at(place)
        (goal, share), pomdp = self._goal(place, said), policy.pomdp
        choices, own = pomdp.model.choices.of_goal(goal), int(pomdp.suggested[row, said])
        chances = self._chances(place)
        in_all = np.where(choices.applicable[row], choices.costs[row] + choices.h[choices.targets[row]], -np.inf)
        others = choices.applicable[row] & (np.arange(len(chances)) != own)
        worse = others & (in_all > in_all[own]) & ~same_cost(in_all, in_all[own])
        likely = None
        if others.any():
            slot = int(np.where(worse if worse.any() else others, chances, -1.0).argmax())
            names = choices.name(row, own), choices.name(row, slot)
            likely = self._contrast(place, said, *names, float(chances[slot]))
        shown = pomdp.model.choices.goals.shown(goal)
        return WhyStep(choices.name(row, own), float(chances[own]), likely, shown, share)

    def _why_person(self, place: int, said: int, arrived: bool) -> WhyPerson:
        mine, others = self._prospect(place, said), list[Prospect]()
        if self.rule != "reactive":  # which does not compare people
            others = [one for other, one in self._prospects.items() if other != place]
        others.sort(key=lambda one: -one.score)
        return WhyPerson(mine, self.here == place, arrived, tuple(others), self.rule, self.remarks.get(place))

    def _prospect(self, place: int, said: int) -> Prospect:
        """Return the prospect of one robot action, or of the best suggestion for 0."""
        q = self._values(self._at(place)[1], np.array([place]))[0]
        said = said or (1 + int(first_best(q[1:])) if len(q) > 1 else 0)
        return self._of_action(place, q, said)

    def _of_action(self, place: int, q: Floats, said: int) -> Prospect:
        _, policy, row = self._at(place)
        cost = float(policy.pomdp.robot_costs[row, said])
        return Prospect(
            self.names[place], policy.pomdp.suggestion(row, said), float(q[said] - q[0]) + cost,
            cost + self.extra, float(self.moving[place]), float(self._beside[place, said]),
        )  # fmt: skip

    @cached_property
    def _beside(self) -> Floats:
        """What the robot actions towards each person are worth beside them to the policy, shape (P, R)."""
        size, active = len(self.names), self.working
        actions = max(policy.pomdp.suggested.shape[1] for policy in self.policies)
        team = TeamState(
            np.zeros(1, np.int64), active[None], np.full((1, 1), BASE), self.model[None],
            self.beliefs.of(np.arange(size)), self.policies, Setting().travel(size),
        )  # fmt: skip
        return beside(self.policy(), team, actions)[0]

    def _values(self, policy: Policy, places: NDArray[np.int64]) -> Floats:
        """Return the Q-values of the robot actions towards some people of one policy, expected over task states."""
        return self.beliefs.expected(worth_of_actions, policy, places)

    @cached_property
    def _prospects(self) -> dict[int, Prospect]:
        """The best suggestion to each person who may get one, if there is one."""
        rows = np.flatnonzero(self.waiting)
        found = {}
        for number, mine in by_model(self.model, rows, len(self.policies)):
            values = self._values(self.policies[number], mine)
            for place, q in zip(mine.tolist(), values, strict=True):
                if len(q) > 1 and np.isfinite(q[1:].max()):
                    found[place] = self._of_action(place, q, 1 + int(first_best(q[1:])))
        return dict(sorted(found.items()))


def _why(question: Question) -> WhyQuestion:
    return WhyQuestion(question.person, question.goal, question.worth)
