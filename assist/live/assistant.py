"""Decisions for a team of real people and its robot, action by action: whom to help now, and with which suggestion.

`Assistant` stores the state of each person's task, the belief in them, the robot's place and open suggestions. It
receives people's actions by name (`observe`), and returns advice (`recommend`).

Timing. In the model's steps, the robot does one thing, then everybody acts once. An assistant that is asked once before
each round of actions makes exactly the model's decisions. Real people do not act in rounds, and no one waits for the
others:

- A request for advice is a decision. Its advice counts as carried out. A second request before anything has happened
  returns the same advice.
- A suggestion is open until the person acts, and that action is taken as the answer. Until then the person gets no
  other suggestion, and the robot is free for others. So a decision may follow every observation.
- Several robots decide together. Each has its place, and those under way continue.
- If travel takes time, the robot is under way until its arrival is reported (`arrived`). Meanwhile it makes no
  suggestion and is not redirected. If the person to whom it was sent leaves, it counts as being at that place, and the
  next decision may send it on. Otherwise it counts as being where it was sent.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike

from planner import CostToGo, known_costs

from ..declare.declared import plain
from ..explain.explanation import Explanation
from ..people.decision import NOTHING
from ..people.goals import Goals
from ..people.human import Population
from ..people.real_people import advice_takers
from ..person.joint_belief import same_suggestions
from ..person.policy import Policy
from ..team.robots import Robot
from ..team.settings import Setting
from ..team.state import BASE, NOBODY, TeamPolicy
from ..team.travel import Travel
from ..texts.refusals import InapplicableError, InvalidError
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
from .live_task import LiveTask, digest, population_of
from .robot_places import RobotPlaces
from .roster import Roster, Step, Told
from .saved_team import people_as_dicts, restore_people, restore_robots, robots_as_dict
from .uncertain_actions import seen_of

if TYPE_CHECKING:
    from planner import AnyTask

FORMAT = "kitassist team 2"
"""Format identifier of saved teams."""


def _costs(task: CostToGo | Goals | Policy | AnyTask) -> CostToGo | Goals | Policy:
    """Return goals and policies as they are, and the cost-to-go of any other task."""
    if isinstance(task, Goals) or hasattr(task, "pomdp"):
        return cast("Goals | Policy", task)
    return known_costs(task)


class Assistant:
    """A live team of one or more people, and robots that each attend to one of them at a time.

    Parameters
    ----------
    task : CostToGo, Goals or Policy, or whatever `planner.load` takes
        The cost-to-go of `planner.cost_to_go`, as a table or on demand; `Goals` if each person pursues one of several
        goals, which is inferred; or a solved policy for one person, for instance with a human model of one's own.
    people : iterable of str, or mapping of str to task
        Names of the people, or a task for each name. More people may `join`.
    policy : str or callable
        A team policy: one of `assist.team.POLICIES`, or a function as in `assist.team`.
    setting : Setting, optional
        Costs, discount, trust. Without a trust rule, theta is constant: data of real people do not support equation
        (7). `knowledge` and `max_steps` are not used, because only the task of real people is known.
    population : Population, optional
        Prior of the people; by default `advice_takers()`, in which theta varies as much as among real people.
        `fit(...).population()` is another.
    distance : array, shape (P + 1, P + 1), optional
        Distances between the places of P people, in the order in which they join, and the base, which is last; by
        default 1 between any two.
    robots : sequence of Robot, or int, optional
        The robots, or only their number; by default as in the setting, 1. They have numbers from 1.

    Raises
    ------
    ValueError
        A parameter is out of its range, or a goal cannot be reached.
    """

    def __init__(
        self,
        task: CostToGo | Goals | Policy | AnyTask | None = None,
        people: Iterable[str] | Mapping[str, CostToGo | Goals | Policy | AnyTask] = (),
        *,
        policy: str | TeamPolicy = "attention",
        setting: Setting | None = None,
        population: Population | None = None,
        distance: ArrayLike | None = None,
        robots: int | tuple[Robot, ...] | None = None,
    ) -> None:
        if isinstance(people, str):
            raise TypeError(f"people {people!r}: expected a list of names")
        self.setting, self.population = (setting or Setting()).for_real_people(), population or advice_takers()
        if robots is not None:
            self.setting = replace(self.setting, robots=robots)  # type: ignore[arg-type]  # or their number
        if self.setting.fleet.executes:
            raise ValueError("execute: expected a robot that suggests; one that acts itself can only be simulated")
        self.policy = policy
        if policy == "rollout":
            self.setting.require_all_seen("policy 'rollout'")
        self._task = None if task is None else _costs(task)
        self._advice: tuple[Advice, ...] | None = None
        self._step = 0
        names = list(people)
        self._places = RobotPlaces(self.setting, len(names), distance)
        self._team = Roster(len(self._places.travel))
        self._decisions = Decisions(self.setting, policy, self._team, self._places)
        for name in names:
            self.join(name, people[name] if isinstance(people, Mapping) else None)
        if names:
            self._decisions.team_policy()

    # Joining and leaving.

    @property
    def people(self) -> tuple[str, ...]:
        """The names of the people who are present."""
        return self._team.names

    @property
    def finished(self) -> bool:
        """Whether everybody who is present has reached their goal."""
        return not (self._team.present & ~self._team.ended).any()

    def join(
        self,
        person: str,
        task: CostToGo | Goals | Policy | None = None,
        *,
        population: Population | None = None,
        belief: ArrayLike | None = None,
    ) -> None:
        """Add a person, at the beginning of a task, or let one return to the task that they left.

        Parameters
        ----------
        person : str
        task : CostToGo, Goals or Policy, optional
            By default the team's.
        population : Population, optional
            Prior of this person; by default that of the team.
        belief : array, shape (B, T), optional
            Belief in a new person from which to begin, for instance that of an earlier team (`PersonState.belief`); by
            default the prior.
        """
        if not isinstance(person, str) or not person.strip():
            raise ValueError(f"person {person!r}: expected a name")
        team = self._team
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
            problem = self._problem(task, population)
            if place == len(team):
                self._places.grow(2 * place)
                team.resize(2 * place)
            team.add(person, problem, belief)
        self._advice = None

    def leave(self, person: str) -> None:
        """Remove a person from the team, finished or not."""
        record = self._team.known(person)
        self._team.present[record.place], record.question = False, None
        self._advice = None

    def begin(
        self,
        person: str,
        task: CostToGo | Goals | Policy | None = None,
        *,
        population: Population | None = None,
    ) -> None:
        """Let a person begin the next task, finished or not; the belief in them remains.

        Parameters
        ----------
        person : str
        task : CostToGo, Goals or Policy, optional
            By default the same task again.
        population : Population, optional
            Prior for the policy of this task; by default as before.
        """
        record = self._team.known(person)
        problem = record.problem
        if task is not None or population is not None:
            problem = self._problem(task or record.problem.task, population or record.problem.prior)
        row, (before, after) = problem.row(problem.initial), (one.policy.pomdp for one in (record.problem, problem))
        here, there, goals, next_goals = before.grid, after.grid, len(before.hidden.goals), len(after.hidden.goals)
        if not (np.array_equal(here.beta, there.beta) and np.array_equal(here.theta, there.theta)):
            raise ValueError(f"{person}: the next task distinguishes other values of beta and theta; expected the same")
        if goals != next_goals:
            raise ValueError(f"{person}: the next task has {next_goals} goals; expected {goals}")
        record.past.add(record.problem, record.steps, record.told)
        record.problem, record.steps, record.told = problem, [], []
        begin_task(self._team, record)
        record.close_questions()
        self._team.put(record, row)
        self._advice = None

    def __repr__(self) -> str:
        return f"<Assistant of {', '.join(self.people) or 'nobody'}, policy {self.policy!r}, step {self._step}>"

    def _problem(self, task: CostToGo | Goals | Policy | AnyTask | None, population: Population | None) -> LiveTask:
        known = self._task if task is None else _costs(task)
        if known is None:
            raise ValueError("there is no task; expected one for the team, or for each person")
        return self._decisions.problem(known, population or self.population)

    # Observations.

    def observe(
        self,
        person: str,
        action: str | None = None,
        *,
        heard: bool = True,
        likelihoods: Mapping[str, float] | None = None,
        missed: float | None = None,
    ) -> None:
        """Record a person's action: as it was seen, or what is known of it.

        With an observation model in the setting, `action` is what was seen, right or wrong, and earlier actions may
        have been missed. After uncertain actions, the belief is over task states, too (`assist.person.JointBelief`).

        Parameters
        ----------
        person : str
        action : str, optional
            In PDDL notation, `(name argument ...)`, in any case.
        heard : bool
            Whether they had seen the open suggestion, if there is one.
        likelihoods : mapping of str to float, optional
            In place of `action`, the likelihood of what a sensor has seen under each action; 0 for others. Only their
            ratios matter.
        missed : float, optional
            In place of `action`, the probability that the person has acted in this time step, and nothing was seen. The
            suggestion stays open if it is below 1/2.

        Raises
        ------
        ValueError
            Not one of these is given, or the numbers are no likelihoods.
        InvalidError
            There is no such person, or no such action in their task.
        InapplicableError
            It is not applicable now, or in no probable state; the message says which actions are.
        LimitError
            The successor could not be evaluated. Nothing has changed after any of these errors.
        """
        record = self._team.known(person)
        k, problem, row = record.place, record.problem, self._team.row(record)
        if self._team.stopped(record):
            raise InapplicableError("reached", person=person)
        robot = int(self._team.robot[k]) if heard else 0
        suggestion, still = problem.policy.pomdp.suggestion(row, robot), 0
        seen = seen_of(problem, self.setting, action, likelihoods, missed)
        if seen is None and not is_uncertain(record, self.setting.observation):
            slot = problem.slot(row, action or "")
            to = problem.after(row, slot)
            step = Step(problem.place(row), robot, slot, problem.choices.name(row, slot), suggestion)
            erred = believe(self._team, record, step, self.setting)
        else:
            if seen is not None and likelihoods is not None:
                action = max(seen["likelihoods"], key=seen["likelihoods"].get)
            elif action is not None:
                action = problem.named(action)
            step = Step(problem.place(row), robot, NOTHING, action, suggestion, seen)
            erred = believe(self._team, record, step, self.setting)
            to = self._team.row(record)
            if missed is not None and missed < 1 / 2:
                still = int(same_suggestions(problem.policy.pomdp, np.array([row]), np.array([to]))[0, robot])
        record.steps.append(step)
        record.close_questions()
        self._team.put(record, to, erred=erred, robot=still)
        self._advice = None

    def seen_of(
        self, person: str, action: str | None, likelihoods: Mapping[str, float] | None, missed: float | None
    ) -> dict[str, Any]:
        """Return what `observe` records of an uncertain action, after checking it; arguments and errors as there."""
        return seen_of(self._team.known(person).problem, self.setting, action, likelihoods, missed) or {}

    def worth_of_asking(self, person: str) -> float:
        """Return what it is worth to learn what a person's last action was, in cost units, if they answer truthfully.

        It is the expected increase of the QMDP value of the person's own problem. A question that costs less is worth
        asking; `answer` takes the answer. It is 0 if the last action is certain.
        """
        return worth_of_asking(self._team.known(person), self.setting)[0]

    @property
    def questions(self) -> tuple[Question, ...]:
        """The open questions, of people who have not answered them or acted since."""
        return tuple(question for _, question in sorted(self._team.questions.items()))

    def answer(self, person: str, answer: str | bool | None) -> None:
        """Record a person's answer, after which the open question is closed.

        Parameters
        ----------
        person : str
        answer : str, bool or None
            The action that they say was their last, which takes the place of what was seen, whether it was asked about
            or not; True or False to "is this your goal?"; None if they do not answer.

        Raises
        ------
        InvalidError, InapplicableError
            As in `observe`; the person has not acted, there is no such question, or the answer is impossible. Nothing
            has changed then.
        """
        record = self._team.known(person)
        if not isinstance(answer, str | bool | None):
            raise InvalidError("other", why=f"answer {answer!r}: expected an action, True, False or None")
        if isinstance(answer, str):
            if not record.steps:
                raise InapplicableError("nothing_to_ask", person=person)
            record.problem.policy.require_enumerated("an uncertain action")
            correct(self._team, record, record.problem.named(answer), self.setting)
        else:
            question = record.question
            if question is None or (answer is not None and question.goal is None):
                raise InapplicableError("no_question_about_goal" if question else "no_question", person=person)
            if answer is not None:
                hear(self._team, record, [Told(len(record.steps), str(question.goal), answer)], self.setting)
        record.question = None
        self._advice = None

    def retract(self, person: str) -> bool:
        """Take back a person's last answer about the goal of their task, as if it had not been given, and return it.

        Actions since then stay. An open suggestion, which may rest on the answer, is withdrawn, and the question may be
        asked again.

        Raises
        ------
        InapplicableError
            There is no answer about the goal of this task.
        """
        record = self._team.known(person)
        if not record.told:
            raise InapplicableError("no_answer", person=person)
        taken = record.told.pop()
        erred = believe_again(self._team, record, self.setting)
        record.close_questions()
        self._team.put(record, self._team.beliefs.joint(record.place).likeliest, erred=erred)
        self._advice = None
        return taken.yes

    def undo(self, person: str) -> str | None:
        """Take back a person's last action, as if it had not been observed, and return it.

        The suggestion before it, if they had seen it, is open again. The robot stays where it is.

        Returns
        -------
        str or None
            The action; None if it was one that perhaps was missed.

        Raises
        ------
        InapplicableError
            The person has not acted yet in this task.
        """
        record = self._team.known(person)
        if not record.steps:
            raise InapplicableError("nothing_done", person=person)
        last = record.steps.pop()
        record.told[:] = [told._replace(steps=min(told.steps, len(record.steps))) for told in record.told]
        erred = believe_again(self._team, record, self.setting)
        record.close_questions()
        self._team.put(record, record.problem.row(last.place), erred=erred, robot=last.robot)
        self._advice = None
        return last.action

    def erred(self, person: str) -> bool:
        """Return whether a person's last action was not an optimal choice."""
        return bool(self._team.erred[self._team.known(person).place])

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
        return self._advice or self.follow(self._decisions.decide(self._step), self._step + 1)

    def follow(self, advice: Sequence[Advice], step: int) -> tuple[Advice, ...]:
        """Apply the advice of each robot, as decided or from a record, and return it.

        `step` is the team's step after it.
        """
        self._advice, self._step = tuple(advice), step
        places = self._team.by_name
        self._places.stop_for_absent(self._team.present)
        self._places.make_room([NOBODY if one.person is None else places[one.person].place for one in advice])
        for number, one in enumerate(advice):
            self._team.ask(one.question)
            if one.person is not None:
                record = self._team.by_name[one.person]  # who may have left while the robot was under way
                self._places.put(number, record.place, under_way=not one.arrived)
                if one.arrived:
                    self._team.suggest(record, one.suggestion)
        return self._advice

    def elapse(self) -> None:
        """Record that time has passed without an action, so that `recommend` decides again."""
        self._advice = None

    def rearrange(self, distance: ArrayLike) -> None:
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
        self._places.rearrange(distance, len(self._team.records))
        self._team.resize(len(self._places.travel))
        self._decisions.renew()
        self._advice = None

    def other_travel(self, distance: ArrayLike) -> Travel:
        """Return the travel over other distances; arguments and errors as in `rearrange`."""
        return self._places.other_travel(distance, len(self._team.records))

    @property
    def distance(self) -> list[list[float]] | None:
        """The given distances; None if all are 1."""
        return None if self._places.distance is None else self._places.distance.tolist()

    def arrived(self, person: str | None = None, *, robot: int = 1) -> None:
        """Record where the robot is: at a person, at the place of a person who has left, or at its base (None).

        Parameters
        ----------
        person : str, optional
        robot : int
            Number of the robot, from 1.
        """
        number, place = self._places.number(robot), BASE
        if person is not None:
            place = (self._team.by_name.get(person) or self._team.known(person)).place
        self._places.put(number, place)
        self._advice = None

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
        InvalidError
            There is no such person, or no such action in their task.
        InapplicableError
            The action is not applicable now, or nothing is suggested to the person.
        """
        return self.explain_later(person, against=against)()

    def explain_later(self, person: str | None = None, *, against: str | None = None) -> Callable[[], Explanation]:
        """Return a function that explains what `explain` would, whatever happens in the meantime.

        This takes little time. The function may be called from another thread.
        """
        place = None if person is None else self._team.known(person).place
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
        return self._places.under_way[number] or (location != BASE and self._team.robot[location] != 0)

    # Views.

    def person(self, person: str) -> PersonState:
        """Return the state of a person, present or not, and the belief about the person."""
        record = self._team.by_name.get(person) or self._team.known(person)
        k, row, problem = record.place, self._team.row(record), record.problem
        choices, pomdp = problem.choices, problem.policy.pomdp
        names = () if self._team.stopped(record) else tuple(
            choices.name(row, slot) for slot in range(int(choices.applicable[row].sum()))
        )  # fmt: skip
        return PersonState(
            person, bool(self._team.present[k]), bool(self._team.ended[k]), problem.state(row), names,
            self._team.suggestion(record), self.cost_to_go(person), len(record.steps), pomdp.grid,
            pomdp.hidden, self._team.belief[k].copy(), goals_of(self._team, k),
            {} if record.joint is None else record.joint.states(choices), record.question,
            (record.told[-1].goal, record.told[-1].yes) if record.told else None,
        )  # fmt: skip

    def cost_to_go(self, person: str) -> float:
        """Return the cost-to-go of a person's present state, in cost units; the person may be absent.

        If they pursue one of several goals, it is that of the most probable one.
        """
        return likeliest_cost_to_go(self._team, self._team.by_name.get(person) or self._team.known(person))

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
        return tuple(None if place == BASE else self._team.records[place].name for place in self._places.at)

    def log(self, *, missed: bool = False) -> list[dict[str, Any]]:
        """Return all actions as `fit` reads them: one dictionary each, for each person in order.

        Parameters
        ----------
        missed : bool
            Whether time steps are included in which an action was perhaps missed; their action is None.
        """
        return self._team.log(missed=missed)

    # Saving and restoring.

    def to_json(self) -> str:
        """Return the team as a JSON document, with actions in PDDL notation and without the tasks.

        `from_json` computes the beliefs again from the observations.
        """
        return json.dumps(
            {
                "format": FORMAT,
                "policy": self.policy if isinstance(self.policy, str) else None,
                "setting": plain(self.setting),
                "population": plain(self.population),
                "distance": self.distance,
                "step": self._step,
                **robots_as_dict(self._team, self._places, self._advice),
                "people": people_as_dicts(self._team),
            }
        )

    @classmethod
    def from_json(cls, document: str, *tasks: CostToGo | Goals | Policy, policy: TeamPolicy | None = None) -> Assistant:
        """Return a saved team, with the same beliefs, bit for bit.

        Parameters
        ----------
        document : str
            The result of `to_json`.
        *tasks : CostToGo, Goals or Policy
            The tasks of the team, in any order; the first is the default for people who join.
        policy : callable, optional
            The team's policy, if it was a function.

        Raises
        ------
        ValueError
            It is no saved team, or a task is missing.
        """
        try:
            saved = json.loads(document)
            if saved["format"] != FORMAT:
                raise ValueError(f"format {saved['format']!r}; expected {FORMAT!r}")
            if policy is None and saved["policy"] is None:
                raise ValueError("the policy was a function; expected it as `policy`")
            team = cls(
                tasks[0] if tasks else None, policy=policy or saved["policy"],
                setting=Setting(**{"trust": "paper"} | saved["setting"]),
                population=population_of(saved["population"]), distance=saved["distance"],
            )  # fmt: skip
            restore_people(team, team._team, saved["people"], {digest(task): task for task in tasks})
            team._step, team._advice = saved["step"], restore_robots(team._team, team._places, saved)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise ValueError(f"this is no saved team that can be restored: {error}") from error
        return team
