"""A team of real people and its robot, action by action: whom to help now, and with what.

`Assistant` keeps what there is to know while people work: the state of each person's task, the belief in them, where
the robot is, what has been suggested. People's actions come in by name (`observe`), advice goes out (`recommend`).

Timing. The model has steps: the robot does one thing, then everybody acts once. Asked once before everybody has acted
once, the assistant is that model, choice by choice. Real people are not in step, and nothing here waits for them:

- Asking decides. What has been advised is said and done; asking again before anything else has happened gives the
  same advice.
- A suggestion stands until the person to whom it was made acts, and that action is taken for their answer to it.
  Until then they are asked nothing more, and the robot is free for others. So a decision may follow every observation.
- Where the way takes time the robot is under way until its arrival is reported (`arrived`), says nothing meanwhile, and
  is not called back, unless the person whom it was sent to leaves: then it counts as being at that place, and the next
  decision may send it on. Elsewhere it counts as being where it was sent.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner import CostToGo

from ..people.decision import Floats
from ..people.human import Mixture, Population
from ..person.belief_filter import update
from ..person.pomdp import Policy
from ..team.policies import POLICIES, named, prepare
from ..team.settings import Setting
from ..team.state import BASE, NOBODY, Ask, TeamPolicy, TeamState
from .advice import Advice, PersonState, Reason
from .live_task import InapplicableError, LiveTask, digest, population_of
from .roster import Roster, RosterEntry, Step

FORMAT = "kitassist team 1"
"""Of saved teams."""


@dataclass(frozen=True)
class _LiveTeam(TeamState):
    """A team of whom one at a time acts: what is asked about the others is known already."""

    roster: Roster

    def of_each(self, ask: Ask) -> Floats:
        """As `TeamState.of_each`."""
        return np.where(self.active[:, :, None], self.roster.of_each(ask, self.active[0])[None], -np.inf)


class Assistant:
    """A live team: one or many people at work, and a robot that can be with one of them at a time.

    Parameters
    ----------
    task : CostToGo or Policy
        What `planner.cost_to_go` gives, a table or on demand; or a policy for one person that has been worked out
        already, for a human model of one's own say.
    people : iterable of str, or mapping of str to task
        Who is there, and each one's task where they have different ones. More may `join`.
    policy : str or callable
        A team policy: "none", "reactive", "attention", "attention-never", "priority", or a function as in
        `assist.team`.
    setting : Setting, optional
        Costs, discount, trust. Not looked at are `knowledge`, since all that is known of real people is their task,
        and `max_steps`.
    population : Population or Mixture, optional
        Of whom people are taken to be: the paper's, unless given. `fit(...).population()` is one.
    distance : array, shape (P + 1, P + 1), optional
        Between the places of P people, in the order in which they come, and the base, which is last; 1 between any
        two unless given.

    Raises
    ------
    ValueError
        What cannot be, such as a goal that cannot be reached.
    """

    def __init__(
        self,
        task: CostToGo | Policy | None = None,
        people: Iterable[str] | Mapping[str, CostToGo | Policy] = (),
        *,
        policy: str | TeamPolicy = "attention",
        setting: Setting | None = None,
        population: Population | Mixture | None = None,
        distance: ArrayLike | None = None,
    ) -> None:
        if isinstance(people, str):
            raise TypeError(f"people {people!r}: expected a list of names")
        self.setting, self.population = setting or Setting(), population or Population()
        if self.setting.execute:
            raise ValueError("execute: expected a robot that suggests; one that acts itself can only be simulated")
        self.policy = policy
        self._task = task
        self._distance = None if distance is None else np.array(distance, dtype=float)
        self._problems: dict[tuple[int, Population | Mixture], LiveTask] = {}
        self._made: TeamPolicy | None = None if isinstance(policy, str) else policy
        if isinstance(policy, str) and policy not in POLICIES:
            named(policy, (), self.setting.travel(1))  # says what there is
        self._advice: Advice | None = None
        self._step = 0
        self._location, self._under_way = BASE, False
        names = list(people)
        places = len(names) if self._distance is None else len(self._distance) - 1
        self._travel = self.setting.travel(max(1, places), self._distance)
        self._team = Roster(len(self._travel))
        for name in names:
            self.join(name, people[name] if isinstance(people, Mapping) else None)
        if names:
            self._policy()

    # People come and go.

    @property
    def people(self) -> tuple[str, ...]:
        """Who is there."""
        return self._team.names

    @property
    def finished(self) -> bool:
        """Whether everybody who is there has reached their goal."""
        return not (self._team.present & ~self._team.ended).any()

    def join(
        self, person: str, task: CostToGo | Policy | None = None, *, population: Population | Mixture | None = None
    ) -> None:
        """Let somebody come: at the beginning of a task, or back to what they left.

        Parameters
        ----------
        person : str
        task : CostToGo or Policy, optional
            The team's unless given.
        population : Population or Mixture, optional
            Of whom they are taken to be; that of the team unless given.
        """
        if not isinstance(person, str) or not person.strip():
            raise ValueError(f"person {person!r}: expected a name")
        team = self._team
        if person in team.by_name:
            place = team.by_name[person].place
            if team.present[place]:
                raise ValueError(f"{person} is there already")
            if task is not None or population is not None:
                raise ValueError(f"{person} comes back to the task that they left; `begin` gives them another")
            team.present[place] = True
        else:
            place = len(team.records)
            if place == len(team) and self._distance is not None:
                raise ValueError(
                    f"{person}: there is a place for {place} people; expected a larger matrix of distances"
                )
            problem = self._problem(task, population)
            if place == len(team):
                self._travel = self.setting.travel(2 * place)
                team.grow(2 * place)
            team.add(person, problem)
        self._advice = None

    def leave(self, person: str) -> None:
        """Let somebody go, finished or not."""
        self._team.present[self._team.known(person).place] = False
        self._advice = None

    def begin(
        self, person: str, task: CostToGo | Policy | None = None, *, population: Population | Mixture | None = None
    ) -> None:
        """Let somebody begin the next task, finished or not; what is believed of them remains.

        Parameters
        ----------
        person : str
        task : CostToGo or Policy, optional
            The same again unless given.
        population : Population or Mixture, optional
            Of whom those are taken to be whose policy it will be; as before unless given.
        """
        record = self._team.known(person)
        problem = record.problem
        if task is not None or population is not None:
            problem = self._problem(task or record.problem.task, population or record.problem.prior)
        part, row = problem.at(problem.initial)
        here, there = self._team.part(record)[0].policy.pomdp.grid, part.policy.pomdp.grid
        if not (np.array_equal(here.beta, there.beta) and np.array_equal(here.theta, there.theta)):
            raise ValueError(f"{person}: the next task distinguishes other values of beta and theta; expected the same")
        record.past.add(record.problem, record.steps)
        record.problem, record.before, record.steps = problem, self._team.belief[record.place].copy(), []
        self._team.put(record, part, row)
        self._advice = None

    def _problem(self, task: CostToGo | Policy | None, population: Population | Mixture | None) -> LiveTask:
        task, population = task or self._task, population or self.population
        if task is None:
            raise ValueError("there is no task; expected one for the team, or for each person")
        key = (id(task), population)
        if key not in self._problems:
            self._problems[key] = LiveTask(task, self.setting, population)
            if isinstance(self.policy, str):  # it is made anew
                self._made = None
        return self._problems[key]

    # Observations come in.

    def observe(self, person: str, action: str, *, heard: bool = True) -> None:
        """Take note of what somebody did.

        Parameters
        ----------
        person : str
        action : str
            In PDDL, `(name argument ...)`; without regard to case.
        heard : bool
            Whether they knew what had been suggested to them, if anything was.

        Raises
        ------
        UnknownError
            There is no such person, or no such action in their task.
        InapplicableError
            It cannot be done now; says what can.
        LimitError
            The state that it leads to could not be evaluated. Nothing has changed, in this case as in the others.
        """
        record = self._team.known(person)
        k, problem = record.place, record.problem
        part, row = self._team.part(record)
        if self._team.ended[k]:
            raise InapplicableError(f"{person} has reached the goal; expected `begin` before another action")
        slot = problem.slot(part, row, action)
        to = problem.after(part, row, slot)
        robot = int(self._team.robot[k]) if heard else 0
        named = part.choices.name(row, slot), part.policy.pomdp.suggestion(row, robot)
        step = Step(problem.place(part, row), robot, slot, *named)
        erred = self._believe(record, step)
        record.steps.append(step)
        self._team.put(record, *to, erred=erred)
        self._advice = None

    def undo(self, person: str) -> str:
        """Take somebody's last action back, as if it had not been observed.

        What had been suggested to them before it, and been heard, stands again. The robot stays where it is.

        Returns
        -------
        str
            The action.

        Raises
        ------
        InapplicableError
            They have done nothing yet in this task.
        """
        record = self._team.known(person)
        if not record.steps:
            raise InapplicableError(f"{person} has done nothing yet that could be taken back")
        last = record.steps.pop()
        self._team.belief[record.place] = record.before
        erred = False
        for step in record.steps:
            erred = self._believe(record, step)
        self._team.put(record, *record.problem.at(last.place), erred=erred, robot=last.robot)
        self._advice = None
        return last.action

    def erred(self, person: str) -> bool:
        """Return whether a person's last action was not an optimal choice."""
        return bool(self._team.erred[self._team.known(person).place])

    def _believe(self, record: RosterEntry, step: Step) -> bool:
        """Update the belief in a person by a step, and return whether it was not an optimal choice."""
        part, row = record.problem.at(step.place)
        belief, choices = self._team.belief[record.place], part.choices
        update(belief, np.empty_like(belief), row, step.robot, step.slot, part.arrays)
        return not choices.optimal[row, step.slot]

    # Advice goes out.

    def recommend(self) -> Advice:
        """Decide what the robot does next: to whom it goes, and what it suggests.

        The same as before if nothing has happened since.
        """
        if self._advice is None:
            self._advice = self._decide()
            self._step += 1
        return self._advice

    def follow(self, advice: Advice, step: int) -> None:
        """Take note of advice that has been given already, in place of asking for it; with it the team's `step`."""
        self._advice, self._step = advice, step
        if advice.person is not None:
            record = self._team.by_name[advice.person]  # who may have left while the robot was under way
            self._location, self._under_way = record.place, not advice.arrived
            if advice.arrived:
                self._suggest(record, advice.suggestion)

    def elapse(self) -> None:
        """Take note that time has passed in which nobody acted, so that `recommend` decides once more."""
        self._advice = None

    def arrived(self, person: str | None = None) -> None:
        """Take note of where the robot is: with a person, at the place of a person who has left, or at its base."""
        if person is None:
            self._location = BASE
        else:
            self._location = (self._team.by_name.get(person) or self._team.known(person)).place
        self._under_way = False
        self._advice = None

    def _decide(self) -> Advice:
        if self._under_way and not self._team.present[self._location]:
            self._under_way = False  # it counts as being at that place: where it is on the way there, is not known
        if self._under_way:
            going_to = self._team.records[self._location]
            return Advice(going_to.name, None, self._reason(going_to.place, 0, 0.0), arrived=False)
        active = self._team.present & ~self._team.ended & (self._team.robot == 0)
        if not active.any():
            return Advice(None, None, None, arrived=True)
        team = self._as_policies_see_it(active)
        action = self._policy()(team)
        team.check(action)
        k, robot = int(action.person[0]), int(action.robot[0])
        if k == NOBODY:
            return Advice(None, None, None, arrived=True)
        moving = self._travel.c_move * float(self._travel.distance[self._location, k])
        self._under_way = bool(self._travel.steps[self._location, k] > 0)
        self._location, self._team.robot[k] = k, robot
        reason, record = self._reason(k, robot, moving), self._team.records[k]
        return Advice(record.name, self._suggestion(record), reason, arrived=not self._under_way)

    def _as_policies_see_it(self, active: NDArray[np.bool_]) -> TeamState:
        t = self._team
        return _LiveTeam(
            self._step, t.x[None], active[None], t.erred[None], np.array([self._location]), t.model[None],
            t.belief[None], [part.policy for part in t.parts], self._travel, t,
        )  # fmt: skip

    def _policy(self) -> TeamPolicy:
        if self._made is None:
            assert isinstance(self.policy, str)
            # As all places are equally far unless distances are given, two stand for any number.
            travel = self._travel if self._distance is not None else self.setting.travel(2)
            policies = [problem.policy for problem in self._problems.values()]
            prepare(made := named(self.policy, policies, travel), policies)
            self._made = made
        return self._made

    def _suggestion(self, record: RosterEntry) -> str | None:
        part, row = self._team.part(record)
        return part.policy.pomdp.suggestion(row, int(self._team.robot[record.place]))

    def _reason(self, k: int, robot: int, moving: float) -> Reason:
        policy, belief = self._team.parts[self._team.model[k]].policy, self._team.belief[k]
        q = policy.q_values(self._team.x[k : k + 1], belief[None])[0]
        saving = float((q[robot] if robot else q[1:].max(initial=q[0])) - q[0])
        beta, theta = policy.pomdp.grid.spreads(belief)
        return Reason(
            saving, moving, saving - moving, beta.mean, (beta.low, beta.high), theta.mean, (theta.low, theta.high)
        )

    # What is known.

    def person(self, person: str) -> PersonState:
        """Give what is known of somebody, there or not."""
        record = self._team.by_name.get(person) or self._team.known(person)
        k, (part, row) = record.place, self._team.part(record)
        choices = part.choices
        names = () if self._team.ended[k] else tuple(
            choices.name(row, slot) for slot in range(int(choices.applicable[row].sum()))
        )  # fmt: skip
        return PersonState(
            person, bool(self._team.present[k]), bool(self._team.ended[k]), part.state(row), names,
            self._suggestion(record), float(choices.h[row]), len(record.steps), part.policy.pomdp.grid,
            self._team.belief[k].copy(),
        )  # fmt: skip

    def cost_to_go(self, person: str) -> float:
        """Give what somebody's task costs from where they are, in cost units: there or not."""
        part, row = self._team.part(self._team.by_name.get(person) or self._team.known(person))
        return float(part.choices.h[row])

    @property
    def step(self) -> int:
        """How many decisions there have been."""
        return self._step

    @property
    def robot(self) -> str | None:
        """With whom the robot is, or to whom it is under way; None at its base."""
        return None if self._location == BASE else self._team.records[self._location].name

    def log(self) -> list[dict[str, Any]]:
        """Give everybody's actions as `fit` reads them: one dictionary each, a person's in their order."""
        rows = []
        for record in self._team.records:
            for number, (_, steps) in enumerate(record.episodes(), start=1):
                for count, step in enumerate(steps):
                    rows.append({"person": record.name, "episode": str(number), "step": count, **step})
        return rows

    # Saved and restored.

    def to_json(self) -> str:
        """Save the team: one JSON document, in PDDL's names, without the tasks themselves.

        What is believed follows from what has been observed, and is worked out again by `from_json`.
        """
        people = [
            {
                "person": record.name,
                "present": bool(self._team.present[record.place]),
                "episodes": [
                    {"task": digest(p.task), "population": p.prior.as_dict(), "steps": steps}
                    for p, steps in record.episodes()
                ],
                "suggestion": self._suggestion(record),
            }
            for record in self._team.records
        ]
        return json.dumps(
            {
                "format": FORMAT,
                "policy": self.policy if isinstance(self.policy, str) else None,
                "setting": asdict(self.setting),
                "population": self.population.as_dict(),
                "distance": None if self._distance is None else self._distance.tolist(),
                "step": self._step,
                "robot": self.robot,
                "under_way": self._under_way,
                "advice": None if self._advice is None else asdict(self._advice),
                "people": people,
            }
        )

    @classmethod
    def from_json(cls, document: str, *tasks: CostToGo | Policy, policy: TeamPolicy | None = None) -> Assistant:
        """Restore a team that was saved, to the same beliefs, bit for bit.

        Parameters
        ----------
        document : str
            What `to_json` gave.
        *tasks : CostToGo or Policy
            The tasks of the team, in any order; who joins without a task gets the first.
        policy : callable, optional
            The team's policy, if that was a function.

        Raises
        ------
        ValueError
            No such document, or a task is missing.
        """
        try:
            saved = json.loads(document)
            if saved["format"] != FORMAT:
                raise ValueError(f"format {saved['format']!r}; expected {FORMAT!r}")
            if policy is None and saved["policy"] is None:
                raise ValueError("the policy was a function; expected it as `policy`")
            team = cls(
                tasks[0] if tasks else None, policy=policy or saved["policy"], setting=Setting(**saved["setting"]),
                population=population_of(saved["population"]), distance=saved["distance"],
            )  # fmt: skip
            team._restore(saved, {digest(task): task for task in tasks})
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise ValueError(f"this is no saved team that can be restored: {error}") from error
        return team

    def _restore(self, saved: dict[str, Any], tasks: Mapping[str, CostToGo | Policy]) -> None:
        for one in saved["people"]:
            for number, episode in enumerate(one["episodes"]):
                task = tasks.get(episode["task"])
                if task is None:
                    raise ValueError(f"the task of {one['person']} is not among the {len(tasks)} that were given")
                enter = self.begin if number else self.join
                enter(one["person"], task, population=population_of(episode["population"]))
                record = self._team.by_name[one["person"]]
                for step in episode["steps"]:
                    self._suggest(record, step["suggestion"])
                    self.observe(record.name, step["action"])
            self._suggest(record, one["suggestion"])
            self._team.present[record.place] = one["present"]
        self._step, self._under_way = saved["step"], saved["under_way"]
        self._location = BASE if saved["robot"] is None else self._team.by_name[saved["robot"]].place
        advice = saved["advice"]
        if advice is not None:
            self._advice = Advice.of(advice)

    def _suggest(self, record: RosterEntry, suggestion: str | None) -> None:
        self._team.robot[record.place] = record.problem.robot(*self._team.part(record), suggestion)
