"""The teams of a study's participants: what the events of a study need of those who take part."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from planner import CostToGo

from ...declare.refusals import AbsentError, InapplicableError
from ...live.simulated_person import SimulatedPerson
from ...live.team import Team
from .assignment import assign
from .codes import drawn
from .forms import Item
from .participant_team import ParticipantTeam, Subs
from .plan import Stage, UserStudy
from .roll import Participant, Roll

Facts = dict[str, Any]
"""Fields of the record of an event, beside its number and time."""


class Teams(Roll):
    """The participants of a study, with their teams.

    Parameters
    ----------
    study : UserStudy
    tasks : mapping of str to CostToGo
        Tasks by name, including the practice task.
    team : callable
        Returns a team without events, of a condition (None: practice).
    """

    def __init__(self, study: UserStudy, tasks: Mapping[str, CostToGo], team: Callable[[str | None], Team]) -> None:
        super().__init__(study)
        self._tasks, self._team = tasks, team

    def known(self, person: str | None) -> Participant:
        """Return the participant with this code.

        Raises
        ------
        AbsentError
        """
        if person not in self.participants or self.participants[person].erased:
            raise AbsentError("unknown_participant", person=repr((person or "")[:80]))
        return self.participants[person]

    def is_at_task(self, person: Participant) -> bool:
        """Whether a participant is at a task, or at practice."""
        return self.stage(person).kind in ("practice", "task")

    def team_of(self, person: Participant) -> ParticipantTeam:
        """Return the team of a participant who is at a task.

        Raises
        ------
        InapplicableError
            They are not at a task.
        """
        stage = self.stages[person.at]
        if not self.is_at_task(person) or person.removed:
            raise InapplicableError("action", person=person.code, here=stage.name)
        return person.teams[stage.kind, stage.period]

    def is_over(self, person: Participant) -> bool:
        """Whether the participant's task is over: finished, unsolvable, or beyond the time limit."""
        seen = self.team_of(person).seen(person.code)
        return seen.finished or seen.remaining is None or person.expired

    def enters_next(self, person: Participant, n: int, time: float) -> Facts:
        """Return what follows when a participant enters the next stage: a condition, a task, a completion code."""
        facts: Facts = {}
        to = self.stages[self.study.next_stage(person.at, person.condition)]
        condition = None
        if to.kind == "task" and person.condition is None:
            condition = facts["condition"] = assign(self.by_condition(), self.study.seed, self.begun)
        if to.kind in ("practice", "task"):
            new = (to.kind, to.period) not in person.teams
            try:
                facts["team"] = self._group(person, to, condition).begin(person.code, to.what, n, time)
            except Exception:
                if new:
                    person.teams.pop((to.kind, to.period), None)
                raise
        if to.kind == "thanks":
            facts["completion"] = self.completion()
        return facts

    def completion(self) -> str:
        """Return a completion code."""
        return self.study.code or drawn(8)

    def rejoin(self, person: Participant, n: int, time: float) -> Subs:
        """Let a participant return to their group's team; return the records, none outside of a task."""
        at_work = person.group is not None and self.stage(person).kind == "task" and not person.expired
        return person.at_tasks()[-1].rejoin(person.code, n, time) if at_work else ()

    def part(self, person: Participant, n: int, time: float) -> Subs:
        """Remove a participant from their group's team, so that the robot attends to the others only."""
        return () if person.group is None else person.at_tasks()[-1].leave(person.code, n, time)

    def _group(self, person: Participant, stage: Stage, condition: str | None) -> ParticipantTeam:
        key = stage.kind, stage.period
        if key not in person.teams:
            number = list(self.participants).index(person.code)
            practice = stage.kind == "practice"
            own = None if practice else self.study.orders[condition or person.condition or ""][stage.period - 1]
            count = 0 if practice else self.study.simulated
            setting = self.study.setting if own is None else self.study.condition(own).setting

            def mates() -> list[SimulatedPerson]:
                seeds = np.random.SeedSequence([self.study.seed, number]).generate_state(count, np.uint64).tolist()
                one = partial(SimulatedPerson, self.study.population, trust=setting.rule_of_people())
                return [one(seed=seed) for seed in seeds]

            person.teams[key] = ParticipantTeam(
                person.code, self._tasks, lambda: self._team(own), mates, again=self.study.again
            )
        return person.teams[key]

    def items(self, person: Participant) -> tuple[Item, ...]:
        """Return the questions at the participant's stage, in the order in which the participant sees them."""
        number = list(self.participants).index(person.code)
        return self.study.items_at(person.at, person.condition, number)
