"""What the robots know of a live team, and what each event changes of it.

That is the state of each person's task and the belief in them, where the robots are, open suggestions and questions.

The classes of `events` call the methods that change it; `Assistant` and `Team` decide and show.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from planner import CostToGo

from ..explain.explanation import Explanation
from ..people.action_names import in_pddl
from ..people.decision import NOTHING
from ..people.goals import Goals
from ..people.ranges import Population
from ..people.real_people import advice_takers
from ..person.joint_belief import same_suggestions
from ..person.policy import Policy
from ..person.settings import Setting
from ..person.travel import Travel
from ..team.state import BASE, NOBODY, TeamPolicy
from ..texts.refusals import AbsentError, InapplicableError, Refusal
from .advice import Advice, PersonState, Question
from .beliefs import (
    begin_task,
    believe,
    believe_again,
    correct,
    goals_of,
    hear,
    is_uncertain,
    likeliest_cost_to_go,
    worth_of_asking,
)  # fmt: skip
from .decisions import Decisions
from .live_task import LiveTask
from .names import is_name
from .robot_places import RobotPlaces
from .roster import Roster, RosterEntry, Step, Told
from .uncertain_actions import seen_of

Task = CostToGo | Goals | Policy

IDLE = Advice(None, None, None, arrived=True)
"""The advice of a robot that does nothing."""


class Change(Protocol):
    """What changes what the robots know: an event of a team, as in `events`."""

    @property
    def concerned(self) -> str | None:
        """The person whose state it may change."""

    @property
    def can_be_taken_back(self) -> bool:
        """Whether it can be undone."""

    def change(self, desk: Desk, time: float) -> Any:
        """Change what the robots know; return what was taken back, if anything."""

    def take_back(self, desk: Desk) -> Any:
        """Undo it."""


class Desk:
    """What the robots know of a live team.

    Parameters
    ----------
    tasks : mapping of str to CostToGo, Goals or Policy
        Tasks by name; the first is the default. It is not copied.
    policy, setting, population, distance
        As in `Assistant`.
    people : int
        Number of people for whom there are places at first.

    Attributes
    ----------
    paused : bool
        Whether the robots make no suggestions.
    populations : dict of str to Population
        Priors of people who have others than the team's, by name.
    """

    def __init__(
        self,
        tasks: Mapping[str, Task],
        *,
        policy: str | TeamPolicy = "attention",
        setting: Setting | None = None,
        population: Population | None = None,
        distance: ArrayLike | None = None,
        people: int = 0,
    ) -> None:
        self.setting, self.population = (setting or Setting()).for_real_people(), population or advice_takers()
        if self.setting.fleet.executes:
            raise ValueError("execute: expected a robot that suggests; one that acts itself can only be simulated")
        self.policy = policy
        if policy == "rollout":
            self.setting.require_all_seen("policy 'rollout'")
        self.tasks, self.populations, self.paused = tasks, dict[str, Population](), False
        self._advice: tuple[Advice, ...] | None = None
        self._step = 0
        self._places = RobotPlaces(self.setting, people, distance)
        self.roster = Roster(len(self._places.travel))
        self._decisions = Decisions(self.setting, policy, self.roster, self._places)

    # What happens.

    def take(self, event: Change, time: float = 0.0) -> Any:
        """Apply an event; return what was taken back, if anything.

        Raises
        ------
        ValueError
            It is not possible. Nothing has changed.
        """
        found = event.change(self, time)
        self._advice = None
        if event.concerned is not None:
            entry = self.entry(event.concerned)
            entry.history.append((time, likeliest_cost_to_go(self.roster, entry)))
            if event.can_be_taken_back:
                entry.done.append(event)
        return found

    def known(self, person: str) -> RosterEntry:
        """Return what is known of a person who is present.

        Raises
        ------
        AbsentError
            The person is not present.
        """
        return self.roster.known(person)

    # What events ask before they are recorded.

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
        if not 1 <= number <= len(self._places.at):
            raise AbsentError("other", why=f"robot {number}: expected a number from 1 to {len(self._places.at)}")

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
        """Check that a question to a person is one that was asked by the event of this number.

        Raises
        ------
        InapplicableError
            It was asked later.
        """
        if seq is not None and seq < self.entry(person).asked_at:
            raise InapplicableError("later_question")

    def task_of_newcomer(self, person: str, task: str | None) -> str | None:
        """Return the task of a person who joins; None if they return to theirs.

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
            if task is not None:
                raise InapplicableError("other", why=f"{person} returns to the task that they left")
            return None
        most = 10_000  # people over a whole session, which bounds its memory
        if self.size >= most:
            raise InapplicableError("other", why=f"{most} people have been here; there is no place for {person}")
        found = task or next(iter(self.tasks))
        self.require_task(found)
        return found

    def has_heard(self, person: str, action: str | None, followed: bool | None, seq: int | None) -> bool:
        """Return whether a person who acted on a view can have seen the open suggestion, or there is none.

        Raises
        ------
        Refusal
            What is said about a suggestion that was followed is impossible.
        """
        if action is None and followed is not None:
            raise Refusal("other", why="followed: expected an action that was seen")
        entry = self.known(person)
        stands = self.roster.suggestion(entry)
        if followed and (stands is None or stands.lower() != in_pddl(action or "")):
            said = "nothing is suggested" if stands is None else f"{stands} is suggested"
            raise InapplicableError("other", why=f"followed is true and the action {action}, but {said}")
        late = seq is not None and seq < entry.suggested
        return not (stands is not None and late and followed is None)

    def in_pddl(self, action: str | None) -> str | None:
        """Return an action in PDDL notation."""
        return None if action is None else in_pddl(action)

    # Who is there.

    def entry(self, person: str) -> RosterEntry:
        """Return what is known of a person who has been in the team, present or not.

        Raises
        ------
        AbsentError
            The person has never been there.
        """
        return self.roster.by_name.get(person) or self.known(person)

    def has_met(self, person: str) -> bool:
        """Whether a person has been in the team, present or not."""
        return person in self.roster.by_name

    def is_present(self, person: str) -> bool:
        """Whether a person is in the team."""
        record = self.roster.by_name.get(person)
        return record is not None and bool(self.roster.present[record.place])

    @property
    def size(self) -> int:
        """The number of people who have been in the team."""
        return len(self.roster.records)

    @property
    def people(self) -> tuple[str, ...]:
        """The names of the people who are present, in the order of their first arrival."""
        return self.roster.names

    @property
    def finished(self) -> bool:
        """Whether everybody who is present has reached their goal."""
        return not (self.roster.present & ~self.roster.ended).any()

    def joined(
        self, person: str, task: str | None = None, *, population: str | None = None, belief: ArrayLike | None = None
    ) -> None:
        """Add a person, at the beginning of a task, or let one return to the task that they left.

        Parameters
        ----------
        person : str
        task : str, optional
            Name of the task; by default the first.
        population : str, optional
            Name of this person's prior; by default that of the team.
        belief : array, optional
            Belief in a new person from which to begin; by default the prior.
        """
        if not person.strip():
            raise ValueError(f"person {person!r}: expected a name")
        team = self.roster
        if person in team.by_name:
            place = team.by_name[person].place
            if team.present[place]:
                raise ValueError(f"{person} is there already")
            if task is not None or population is not None or belief is not None:
                raise ValueError(f"{person} returns to the task that they left; `begin` gives them another")
            team.present[place] = True
        else:
            place = len(team.records)
            if place == len(team) and self._places.distance is not None:
                raise ValueError(
                    f"{person}: there is a place for {place} people; expected a larger matrix of distances"
                )
            name = next(iter(self.tasks)) if task is None else task
            problem = self._problem(name, population)
            if place == len(team):
                self._places.grow(2 * place)
                team.resize(2 * place)
            team.add(person, problem, name, belief)

    def left(self, person: str) -> None:
        """Remove a person from the team, finished or not."""
        record = self.known(person)
        self.roster.present[record.place], record.question = False, None

    def began(self, person: str, task: str | None = None, *, population: str | None = None) -> None:
        """Let a person begin the next task, finished or not; the belief in them remains.

        Parameters
        ----------
        person : str
        task : str, optional
            Name of the task; by default the same again.
        population : str, optional
            Name of the prior for the policy of this task; by default as before.
        """
        record = self.known(person)
        problem, name = record.problem, record.tasks[-1] if task is None else task
        if task is not None or population is not None:
            prior = record.problem.prior if population is None else self.populations[population]
            problem = self._decisions.problem(self.tasks[name], prior)
        row, (before, after) = problem.row(problem.initial), (one.policy.pomdp for one in (record.problem, problem))
        here, there, goals, next_goals = before.grid, after.grid, len(before.hidden.goals), len(after.hidden.goals)
        if not (np.array_equal(here.beta, there.beta) and np.array_equal(here.theta, there.theta)):
            raise ValueError(f"{person}: the next task distinguishes other values of beta and theta; expected the same")
        if goals != next_goals:
            raise ValueError(f"{person}: the next task has {next_goals} goals; expected {goals}")
        record.begin(problem, name)
        begin_task(self.roster, record)
        record.close_questions()
        self.roster.put(record, row)

    def _problem(self, task: str, population: str | None) -> LiveTask:
        prior = self.population if population is None else self.populations[population]
        return self._decisions.problem(self.tasks[task], prior)

    def acted(
        self,
        person: str,
        action: str | None = None,
        *,
        heard: bool = True,
        likelihoods: Mapping[str, float] | None = None,
        missed: float | None = None,
        time: float = 0.0,
    ) -> None:
        """Record a person's action: as it was seen, or what is known of it; arguments and errors as in `Reports`.

        With an observation model in the setting, `action` is what was seen, right or wrong, and earlier actions may
        have been missed. After uncertain actions, the belief is over task states, too (`assist.person.JointBelief`).
        """
        record = self.roster.known(person)
        k, problem, row = record.place, record.problem, self.roster.row(record)
        if self.roster.stopped(record):
            raise InapplicableError("reached", person=person)
        robot = int(self.roster.robot[k]) if heard else 0
        suggestion, still = problem.policy.pomdp.suggestion(row, robot), 0
        seen = seen_of(problem, self.setting, action, likelihoods, missed)
        if seen is None and not is_uncertain(record, self.setting.observation):
            slot = problem.slot(row, action or "")
            to = problem.after(row, slot)
            step = Step(problem.place(row), robot, slot, problem.choices.name(row, slot), suggestion)
            erred = believe(self.roster, record, step, self.setting)
        else:
            if seen is not None and likelihoods is not None:
                action = max(seen["likelihoods"], key=seen["likelihoods"].get)
            elif action is not None:
                action = problem.named(action)
            step = Step(problem.place(row), robot, NOTHING, action, suggestion, seen)
            erred = believe(self.roster, record, step, self.setting)
            to = self.roster.row(record)
            if missed is not None and missed < 1 / 2:
                still = int(same_suggestions(problem.policy.pomdp, np.array([row]), np.array([to]))[0, robot])
        record.did(step, time)
        record.close_questions()
        self.roster.put(record, to, erred=erred, robot=still)

    def seen_of(
        self, person: str, action: str | None, likelihoods: Mapping[str, float] | None, missed: float | None
    ) -> dict[str, Any]:
        """Return what is recorded of an uncertain action, after checking it; arguments and errors as in `Reports`."""
        return seen_of(self.known(person).problem, self.setting, action, likelihoods, missed) or {}

    def worth_of_asking(self, person: str) -> float:
        """Return what it is worth to learn what a person's last action was, in cost units, if they answer truthfully.

        It is the expected increase of the QMDP value of the person's own problem. A question that costs less is worth
        asking; `answer` takes the answer. It is 0 if the last action is certain.
        """
        return worth_of_asking(self.known(person), self.setting)[0]

    @property
    def questions(self) -> tuple[Question, ...]:
        """The open questions, of people who have not answered them or acted since."""
        return tuple(question for _, question in sorted(self.roster.questions.items()))

    def answered(self, person: str, answer: str | bool | None) -> None:
        """Record a person's answer, after which the open question is closed; errors as in `Reports.answer`."""
        record = self.known(person)
        if isinstance(answer, str):
            if not record.steps:
                raise InapplicableError("nothing_to_ask", person=person)
            record.problem.policy.require_enumerated("an uncertain action")
            correct(self.roster, record, record.problem.named(answer), self.setting)
        else:
            question = record.question
            if question is None or (answer is not None and question.goal is None):
                raise InapplicableError("no_question_about_goal" if question else "no_question", person=person)
            if answer is not None:
                hear(self.roster, record, [Told(len(record.steps), str(question.goal), answer)], self.setting)
        record.question = None

    def take_back_answer(self, person: str) -> bool:
        """Take back a person's last answer about the goal of their task, as if it had not been given, and return it.

        Actions since then stay. An open suggestion, which may rest on the answer, is withdrawn, and the question may be
        asked again.
        """
        record = self.known(person)
        taken = record.told.pop()
        erred = believe_again(self.roster, record, self.setting)
        record.close_questions()
        record.reason = None
        self.roster.put(record, self.roster.beliefs.joint(record.place).likeliest, erred=erred)
        return taken.yes

    def take_back_action(self, person: str) -> str | None:
        """Take back a person's last action, as if it had not been observed, and return it.

        The suggestion before it, if they had seen it, is open again. The robot stays where it is.

        Returns
        -------
        str or None
            The action; None if it was one that perhaps was missed.
        """
        record = self.known(person)
        last = record.undo()
        record.told[:] = [told._replace(steps=min(told.steps, len(record.steps))) for told in record.told]
        erred = believe_again(self.roster, record, self.setting)
        record.close_questions()
        self.roster.put(record, record.problem.row(last.place), erred=erred, robot=last.robot)
        return last.action

    def erred(self, person: str) -> bool:
        """Return whether a person's last action was not an optimal choice."""
        return bool(self.roster.erred[self.known(person).place])

    # Advice.

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

    def follow(self, advice: Sequence[Advice], step: int) -> tuple[Advice, ...]:
        """Apply the advice of each robot, as decided or from a record, and return it.

        `step` is the team's step after it.
        """
        self._advice, self._step = tuple(advice), step
        places = self.roster.by_name
        self._places.stop_for_absent(self.roster.present)
        self._places.make_room([NOBODY if one.person is None else places[one.person].place for one in advice])
        for number, one in enumerate(advice):
            self.roster.ask(one.question)
            if one.person is not None:
                record = self.roster.by_name[one.person]  # who may have left while the robot was under way
                self._places.put(number, record.place, under_way=not one.arrived)
                if one.arrived:
                    self.roster.suggest(record, one.suggestion)
                if one.suggestion is not None:
                    record.reason = one.reason
        return self._advice

    def rearranged(self, distance: ArrayLike) -> None:
        """Use other distances from now on. A robot under way continues.

        Parameters
        ----------
        distance : array, shape (P + 1, P + 1)
            As in `Assistant`.

        Raises
        ------
        ValueError
            The matrix is invalid, or too small for the people who have joined.
        """
        self._places.rearrange(distance, len(self.roster.records))
        self.roster.resize(len(self._places.travel))
        self._decisions.renew()

    def other_travel(self, distance: ArrayLike) -> Travel:
        """Return the travel over other distances; arguments and errors as in `rearranged`."""
        return self._places.other_travel(distance, len(self.roster.records))

    @property
    def distance(self) -> list[list[float]] | None:
        """The given distances; None if all are 1."""
        return None if self._places.distance is None else self._places.distance.tolist()

    def has_arrived(self, person: str | None = None, *, robot: int = 1) -> None:
        """Record where the robot is: at a person, at the place of a person who has left, or at its base (None).

        Parameters
        ----------
        person : str, optional
        robot : int
            Number of the robot, from 1.
        """
        number, place = self._places.number(robot), BASE
        if person is not None:
            place = self.entry(person).place
        self._places.put(number, place)

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
        # The robot that attends to the person explains, or else one that attends to nobody, or else the first.
        numbers = range(len(self._places.at))
        mine = [number for number in numbers if self._places.at[number] == place]
        idle = [number for number in numbers if not self._attends(number)]
        number = next(iter([*mine, *idle]), 0)
        location = self._places.at[number] if number in mine or number not in idle else BASE
        return partial(
            self._decisions.point(number).explanation, place, None if location == BASE else location,
            arrived=not self._places.under_way[number], against=against,
        )  # fmt: skip

    def _attends(self, number: int) -> bool:
        """Return whether a robot, numbered from 0, is on its way, or at a person who has its suggestion."""
        location = self._places.at[number]
        return self._places.under_way[number] or (location != BASE and self.roster.robot[location] != 0)

    # Views.

    def person(self, person: str) -> PersonState:
        """Return the state of a person, present or not, and the belief about the person."""
        record = self.entry(person)
        k, row, problem = record.place, self.roster.row(record), record.problem
        choices, pomdp = problem.choices, problem.policy.pomdp
        names = () if self.roster.stopped(record) else tuple(
            choices.name(row, slot) for slot in range(int(choices.applicable[row].sum()))
        )  # fmt: skip
        return PersonState(
            person, bool(self.roster.present[k]), bool(self.roster.ended[k]), problem.state(row), names,
            self.roster.suggestion(record), self.cost_to_go(person), len(record.steps), pomdp.grid,
            pomdp.hidden, self.roster.belief[k].copy(), goals_of(self.roster, k),
            {} if record.joint is None else record.joint.states(choices), record.question,
            (record.told[-1].goal, record.told[-1].yes) if record.told else None,
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
    def robot(self) -> str | None:
        """The person at whom the robot is, or to whom it is under way; None at its base."""
        return self.robots[0]

    @property
    def robots(self) -> tuple[str | None, ...]:
        """For each robot, the person at whom it is, or to whom it is under way; None at its base."""
        return tuple(None if place == BASE else self.roster.records[place].name for place in self._places.at)

    def log(self) -> list[dict[str, Any]]:
        """Return all actions as `fit` reads them: one dictionary each, for each person in order."""
        return [row for record in self.roster.records for row in record.log()]
