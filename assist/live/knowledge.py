"""What the robots know of a live team, and what each event changes of it.

That is the state of each person's task and the belief in them, where the robots are, open suggestions and questions.
The classes of `events` call the methods that change it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from planner import CostToGo

from ..declare.refusals import InapplicableError, Refusal
from ..people.decision import NOTHING
from ..people.goals import Goals
from ..people.ranges import Population, advice_takers, require_populations
from ..person.policy import Policy
from ..person.settings import Setting
from ..team.state import BASE, NOBODY, TeamPolicy
from .advice import Advice
from .beliefs import (
    Told,
    answers,
    begin_task,
    believe,
    believe_again,
    correct,
    hear,
    is_uncertain,
    likeliest_cost_to_go,
)  # fmt: skip
from .decisions import Decisions
from .live_setting import LiveSetting
from .live_task import LiveTask
from .robot_places import RobotPlaces
from .roster import Roster, RosterEntry, Step
from .seen_suggestions import SeenSuggestions
from .uncertain_actions import seen_of

Task = CostToGo | Goals | Policy


class Knowledge:
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
    populations : dict of str to Population
        Priors of people who have others than the team's, by name.
    seen : SeenSuggestions
        What people see of each other.
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
        require_populations(population)
        self.setting = LiveSetting.of(LiveSetting() if setting is None else setting).for_real_people()
        self.population = population or advice_takers()
        if self.setting.fleet.executes:
            raise ValueError("execute: expected a robot that suggests; one that acts itself can only be simulated")
        self.policy = policy
        if policy == "rollout":
            self.setting.require_all_seen("policy 'rollout'")
        self.tasks, self.populations = tasks, dict[str, Population]()
        self._advice: tuple[Advice, ...] | None = None
        self._step = 0
        self._places = RobotPlaces(self.setting, people, distance)
        self.roster = Roster(len(self._places.travel))
        self.seen = SeenSuggestions(self.roster, self.setting)
        self._decisions = Decisions(self.setting, policy, self.roster, self._places)

    def share(self, other: Knowledge) -> None:
        """Use the tasks that another one with the same arguments has solved."""
        self._decisions.solved = other._decisions.solved

    def begins(self, number: int, time: float) -> None:
        """Note that an event with a number happens now."""
        self.roster.event, self.roster.time = number, time
        self.roster.touched.clear()

    def happened(self, time: float, person: str | None, undoable: Any = None) -> None:
        """Note that it has, what it may have changed of a person, and itself if it can be undone."""
        self._advice = None
        if person is not None:
            entry = self.entry(person)
            entry.history.append((time, likeliest_cost_to_go(self.roster, entry)))
            entry.done += [] if undoable is None else [undoable]

    def known(self, person: str) -> RosterEntry:
        """Return what is known of a person who is present.

        Raises
        ------
        AbsentError
            The person is not present.
        """
        return self.roster.known(person)

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
    def paused(self) -> bool:
        """Whether the robots make no suggestions."""
        return self.roster.paused

    @property
    def size(self) -> int:
        """The number of people who have been in the team."""
        return len(self.roster.records)

    @property
    def people(self) -> tuple[str, ...]:
        """The names of the people who are present, in the order of their first arrival."""
        return self.roster.names

    def joined(
        self, person: str, task: str | None = None, *, population: str | None = None, belief: ArrayLike | None = None
    ) -> None:
        """Add a person; `population` is the name of their prior, and the rest is as in `Assistant.join`."""
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
                why = f"{person}: there is a place for {place} people; expected a larger matrix of distances"
                raise InapplicableError("other", why=why)
            name = next(iter(self.tasks)) if task is None else task
            problem = self._problem(name, population)
            self.seen.make_room(place + 1)
            if place == len(team):
                self._places.grow(2 * place)
                team.resize(2 * place)
            team.add(person, problem, name, belief)
        self._came_or_went(team.records[place])

    def left(self, person: str) -> None:
        """Remove a person from the team, finished or not."""
        record = self.known(person)
        self.roster.present[record.place], record.question = False, None
        self._came_or_went(record)

    def _came_or_went(self, record: RosterEntry) -> None:
        """Note that a person is there, or is not any more."""
        record.came = self.roster.event
        self.seen.came_or_went(record)

    def began(self, person: str, task: str | None = None, *, population: str | None = None) -> None:
        """Put a person at the beginning of a task, as `Reports.begin`; `population` is the name of a prior."""
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
        problem, row, offer = record.problem, self.roster.row(record), record.offer if heard else None
        if self.roster.stopped(record):
            raise InapplicableError("reached", person=person)
        seen = seen_of(problem, self.setting, action, likelihoods, missed)
        if seen is None and not is_uncertain(record, self.setting.observation):
            slot = problem.slot(row, action or "")
            to = problem.after(row, slot)
            step = Step(problem.situation(row), offer, slot, problem.choices.name(row, slot))
            erred = believe(self.roster, record, step, self.setting)
        else:
            if seen is not None and likelihoods is not None:
                action = max(seen["likelihoods"], key=seen["likelihoods"].get)
            elif action is not None:
                action = problem.named(action)
            doubtful = seen is not None or self.setting.observation is not None
            step = Step(problem.situation(row), offer, NOTHING, action, seen, doubtful)
            erred = believe(self.roster, record, step, self.setting)
            to = self.roster.row(record)
        record.did(step, time)
        record.close_questions()
        stays = missed is not None and missed < 1 / 2
        self.roster.put(record, to, erred=erred, offer=offer if stays else None)

    def answered(self, person: str, answer: str | bool | None) -> None:
        """Record a person's answer, after which the open question is closed; errors as in `Reports.answer`."""
        record = self.known(person)
        if isinstance(answer, str):
            if record.question is not None and record.question.goal is not None and not answer.strip().startswith("("):
                why = (
                    f"answer: the question is whether the goal is {record.question.goal}; expected true, false or null"
                )
                raise Refusal("other", why=why)
            if not record.steps:
                raise InapplicableError("nothing_to_ask", person=person)
            self.seen.require_all_seen()
            correct(self.roster, record, record.problem.named(answer), self.setting)
        else:
            question = record.question
            if question is None or (answer is not None and question.goal is None):
                raise InapplicableError("no_question_about_goal" if question else "no_question", person=person)
            if answer is not None:
                hear(self.roster, record, Told(len(record.steps), str(question.goal), answer), self.setting)
        record.question = None

    def take_back_answer(self, person: str) -> bool:
        """Take back a person's last answer about the goal of their task, as if it had not been given, and return it.

        Actions since then stay. An open suggestion, which may rest on the answer, is withdrawn, and the question may be
        asked again.
        """
        record = self.known(person)
        taken = answers(record)[-1]
        record.news[:] = [one for one in record.news if one is not taken]
        record.close_questions()
        believe_again(self.roster, record, self.setting)
        return taken.yes

    def take_back_action(self, person: str) -> str | None:
        """Take back a person's last action, as if it had not been observed, and return it.

        The suggestion before it, if they had seen it, is open again, for the reason that there is now. The robot stays
        where it is.

        Returns
        -------
        str or None
            The action; None if it was one that perhaps was missed.
        """
        record = self.known(person)
        last, roster = record.undo(), self.roster
        again = None if last.offer is None else last.offer._replace(number=roster.event, time=roster.time)
        record.news[:] = [replace(one, steps=min(one.steps, len(record.steps))) for one in record.news]
        record.close_questions()
        believe_again(roster, record, self.setting, situation=last.situation, offer=again)
        if record.offer is not None and record.offer.reason is not None:
            said = record.offer.said
            roster.give_reason(record, self._decisions.reason(self._explaining(record.place), record.place, said))
        return last.action

    def _explaining(self, place: int | None) -> int:
        """Return the number of the robot that attends to the person at a place, or to nobody, or else of the first."""
        places = self._places
        mine = (number for number, at in enumerate(places.at) if at == place)
        idle = (number for number in range(len(places.at)) if not self._attends(number))
        return next(chain(mine, idle), 0)

    def _attends(self, number: int) -> bool:
        """Return whether a robot, numbered from 0, is on its way, or at a person who has its suggestion."""
        location = self._places.at[number]
        return self._places.under_way[number] or (location != BASE and self.roster.said[location] != 0)

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
                    self.roster.suggest(record, one.suggestion, one.reason)
        return self._advice

    def rearranged(self, distance: ArrayLike) -> None:
        """Use other distances from now on; arguments and errors as in `Reports.rearrange`."""
        self._places.rearrange(distance, len(self.roster.records))
        self.roster.resize(len(self._places.travel))
        self._decisions.renew()

    def has_arrived(self, person: str | None = None, *, robot: int = 1) -> None:
        """Put a robot at a person's place, also of one who has left, or at its base (None)."""
        number, place = self._places.number(robot), BASE
        if person is not None:
            place = self.entry(person).place
        self._places.put(number, place)
