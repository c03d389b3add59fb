"""A live team as a JSON document: the people's observations, from which the beliefs are computed again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from numpy.typing import ArrayLike

from planner import CostToGo

from ..declare.declared import plain
from ..people.goals import Goals
from ..people.human import Population
from ..person.policy import Policy
from ..team.settings import Setting
from ..team.state import BASE
from .advice import Advice, Question
from .beliefs import hear
from .live_task import digest, population_of
from .robot_places import RobotPlaces
from .roster import Roster, RosterEntry, Told

Task = CostToGo | Goals | Policy


class Observer(Protocol):
    """Something that people can join, such as `Assistant`; arguments as there."""

    setting: Setting

    def join(self, person: str, task: Task, *, population: Population, belief: ArrayLike | None) -> None:
        """Add a person."""

    def begin(self, person: str, task: Task, *, population: Population) -> None:
        """Let a person begin the next task."""

    def observe(
        self, person: str, action: str | None, *, likelihoods: Mapping[str, float] | None, missed: float | None
    ) -> None:
        """Record a person's action, or what is known of it."""


def people_as_dicts(team: Roster) -> list[dict[str, Any]]:
    """Return what was observed of each person, with actions in PDDL notation and without the tasks."""
    return [_person_as_dict(team, record) for record in team.records]


def _person_as_dict(team: Roster, record: RosterEntry) -> dict[str, Any]:
    found = {
        "person": record.name,
        "present": bool(team.present[record.place]),
        "belief": None if record.carried is None else record.carried.tolist(),
        "episodes": [
            {"task": digest(p.task), "population": plain(p.prior), "steps": steps}
            | ({"told": [one._asdict() for one in told]} if told else {})
            for p, steps, told in record.episodes()
        ],
        "suggestion": team.suggestion(record),
    }
    if record.question is not None:
        found["question"] = record.question.as_dict()
    return found | ({"asked": sorted(record.asked)} if record.asked else {})


def robots_as_dict(team: Roster, places: RobotPlaces, advice: tuple[Advice, ...] | None) -> dict[str, Any]:
    """Return the places of the robots and their advice."""
    names = [None if place == BASE else team.records[place].name for place in places.at]
    given = None if advice is None else [each.as_dict() for each in advice]
    return {"robots": names, "under_way": list(places.under_way), "advice": given}


def restore_people(assistant: Observer, team: Roster, people: list[dict[str, Any]], tasks: Mapping[str, Task]) -> None:
    """Let the people of `people_as_dicts` join a team, and observe their actions again.

    Raises
    ------
    ValueError
        A task is missing.
    """
    for one in people:
        for number, episode in enumerate(one["episodes"]):
            task = tasks.get(episode["task"])
            if task is None:
                raise ValueError(f"the task of {one['person']} is not among the {len(tasks)} that were given")
            population = population_of(episode["population"])
            if number:
                assistant.begin(one["person"], task, population=population)
            else:
                assistant.join(one["person"], task, population=population, belief=one.get("belief"))
            _observe_again(assistant, team, team.by_name[one["person"]], episode)
        record = team.by_name[one["person"]]
        team.ask(Question.of(one["question"]) if "question" in one else None)
        record.asked |= set(one.get("asked", ()))
        team.suggest(record, one["suggestion"])
        team.present[record.place] = one["present"]


def _observe_again(assistant: Observer, team: Roster, record: RosterEntry, episode: Mapping[str, Any]) -> None:
    told = [Told(**one) for one in episode.get("told", ())]
    for count, step in enumerate(episode["steps"]):
        hear(team, record, [one for one in told if one.steps == count], assistant.setting)
        team.suggest(record, step["suggestion"])
        likelihoods, missed = step.get("likelihoods"), step.get("missed")
        action = step["action"] if likelihoods is missed is None else None
        assistant.observe(record.name, action, likelihoods=likelihoods, missed=missed)
    hear(team, record, [one for one in told if one.steps == len(episode["steps"])], assistant.setting)


def restore_robots(team: Roster, places: RobotPlaces, saved: Mapping[str, Any]) -> tuple[Advice, ...] | None:
    """Put the robots at the places of `robots_as_dict`, and return their advice."""
    for number, (name, moving) in enumerate(zip(saved["robots"], saved["under_way"], strict=True)):
        places.put(number, BASE if name is None else team.by_name[name].place, under_way=moving)
    return None if saved["advice"] is None else tuple(map(Advice.of, saved["advice"]))
