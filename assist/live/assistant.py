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
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike

from planner import CostToGo

from ..declare.declared import plain
from ..people.goals import Goals, known_task
from ..people.ranges import Population, require_populations
from ..person.policy import Policy
from ..person.robots import Robot
from ..person.settings import Setting, require_setting
from ..team.state import TeamPolicy
from .advice import Advice
from .desk import Desk, Task
from .event_base import TeamEvent
from .events import Began, Decided, Joined
from .live_task import digest, population_of, setting_of
from .record import TeamRecord
from .reports import Reports

if TYPE_CHECKING:
    from planner import AnyTask

FORMAT = "kitassist team 3"
"""Format identifier of saved teams."""


def _costs(task: CostToGo | Goals | Policy | AnyTask) -> Task:
    """Return goals and policies as they are, and the cost-to-go of any other task."""
    return cast(Policy, task) if hasattr(task, "pomdp") else known_task(task)


class Assistant(Reports, Desk):
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

    Attributes
    ----------
    records : list of TeamRecord
        What has happened, with the advice that was asked for after it.

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
        require_setting(setting)
        if robots is not None:
            setting = replace(setting or Setting(), robots=robots)  # type: ignore[arg-type]  # or their number
        names, self._given_distance = list(people), distance
        self._named: dict[str, Task] = {}
        super().__init__(
            self._named, policy=policy, setting=setting, population=population, distance=distance, people=len(names)
        )  # fmt: skip
        self.records: list[TeamRecord] = []
        self._default = self._name_of(task)
        for name in names:
            self.join(name, people[name] if isinstance(people, Mapping) else None)
        if names:
            self._decisions.team_policy()

    def __repr__(self) -> str:
        return f"<Assistant of {', '.join(self.people) or 'nobody'}, policy {self.policy!r}, step {self._step}>"

    # What happens.

    def report(self, event: TeamEvent) -> Any:
        """Apply an event, unless it changes nothing.

        Returns
        -------
        object
            What was taken back by `undo`: the action, None if it was one that perhaps was missed, or the answer.
        """
        count = len(self.records)
        recorded = event.accepted(self, count)
        if recorded is None:
            return None
        caused = recorded.causes(self)
        found = recorded.happen(self, number=count + 1, caused=caused)
        self.records.append(TeamRecord(n=count + 1, event=recorded, caused=caused, step=self._step))
        return found

    def require(self, person: str) -> None:
        """Check that a person is present; the error says who is."""
        self.known(person)

    def recommend_all(self) -> tuple[Advice, ...]:
        """Return what each robot does next."""
        decided = self._advice is None and not self.paused
        advice = super().recommend_all()
        if decided:
            if not self.records:
                self.report(Decided())
                self._advice = advice
            # Without the source of its explanation, which holds the whole team at that time.
            given = tuple(replace(one) for one in advice)
            self.records[-1] = self.records[-1].model_copy(update={"advices": given, "step": self._step})
        return advice

    def join(
        self,
        person: str,
        task: str | CostToGo | Goals | Policy | AnyTask | None = None,
        *,
        population: Population | None = None,
        belief: ArrayLike | None = None,
        id: str | None = None,
    ) -> Any:
        """Add a person, as `Reports.join` does.

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
        id : str, optional
            Not used by an assistant in memory.
        """
        if task is None and not self.has_met(person):
            if self._default is None:
                raise ValueError("there is no task; expected one for the team, or for each person")
            task = self._default
        flat = None if belief is None else tuple(np.asarray(belief, dtype=float).ravel().tolist())
        prior = None if population is None else self._prior_of(population)
        return self.report(Joined(person=person, task=self._name_of(task), population=prior, belief=flat, id=id))

    def begin(
        self,
        person: str,
        task: str | CostToGo | Goals | Policy | AnyTask | None = None,
        *,
        population: Population | None = None,
        id: str | None = None,
    ) -> Any:
        """Let a person begin the next task, as `Reports.begin` does.

        Parameters
        ----------
        person : str
        task : CostToGo, Goals or Policy, optional
            By default the same task again.
        population : Population, optional
            Prior for the policy of this task; by default as before.
        id : str, optional
            Not used by an assistant in memory.
        """
        prior = None if population is None else self._prior_of(population)
        return self.report(Began(person=person, task=self._name_of(task), population=prior, id=id))

    def _name_of(self, task: Any) -> str | None:
        """Return the name of a task, which is a new one if the task is; None for None."""
        if task is None or (isinstance(task, str) and task in self._named):
            return task
        known = _costs(task)
        name = next((name for name, other in self._named.items() if other is known), f"task {len(self._named) + 1}")
        self._named.setdefault(name, known)
        return name

    def _prior_of(self, population: Population) -> str:
        """Return the name of a prior, which is a new one if the prior is."""
        require_populations(population)
        every = self.populations
        name = next((name for name, other in every.items() if other == population), f"population {len(every) + 1}")
        every.setdefault(name, population)
        return name

    # Saving and restoring.

    def to_json(self) -> str:
        """Return the team as a JSON document: its settings and the list of its events, without the tasks.

        `from_json` applies the events again.
        """
        return json.dumps(
            {
                "format": FORMAT,
                "policy": self.policy if isinstance(self.policy, str) else None,
                "setting": plain(Setting.of(self.setting)),
                "population": plain(self.population),
                "populations": {name: plain(prior) for name, prior in self.populations.items()},
                "distance": None if self._given_distance is None else np.asarray(self._given_distance).tolist(),
                "tasks": {name: digest(task) for name, task in self._named.items()},
                "records": [json.loads(record.text()) for record in self.records],
            }
        )

    @classmethod
    def from_json(
        cls, document: str, *tasks: CostToGo | Goals | Policy, policy: TeamPolicy | None = None,
        setting: Setting | None = None,
    ) -> Assistant:  # fmt: skip
        """Return a saved team, with the same beliefs, bit for bit.

        Parameters
        ----------
        document : str
            The result of `to_json`.
        *tasks : CostToGo, Goals or Policy
            The tasks of the team, in any order; the first is the default for people who join.
        policy : callable, optional
            The team's policy, if it was a function.
        setting : Setting, optional
            The team's setting, if it has a rule of your own.

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
                policy=policy or saved["policy"], setting=setting_of(saved["setting"], setting),
                population=population_of(saved["population"]), distance=saved["distance"],
            )  # fmt: skip
            found = {digest(task): task for task in tasks}
            for name, known in saved["tasks"].items():
                if known not in found:
                    raise ValueError(f"the task {name!r} is not among the {len(tasks)} that were given")
                team._named[name] = found[known]
            first = digest(tasks[0]) if tasks else None
            team._default = next((name for name, known in saved["tasks"].items() if known == first), None)
            if team._default is None and tasks:
                team._default = team._name_of(tasks[0])
            team.populations |= {name: population_of(known) for name, known in saved["populations"].items()}
            for record in saved["records"]:
                team._again(TeamRecord.of(json.dumps(record)))
        except json.JSONDecodeError as error:
            raise ValueError(
                f"this is no saved team: line {error.lineno} is no JSON; expected a text of to_json"
            ) from None
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise ValueError(f"this is no saved team that can be restored: {error}") from error
        return team

    def _again(self, record: TeamRecord) -> None:
        """Apply a recorded event, and the advice after it."""
        record.event.happen(self, number=record.n, caused=record.caused)
        if record.advices:
            self.follow(record.advices, record.step)
        self.records.append(record)
