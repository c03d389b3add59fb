"""Episodes whose steps are written down, one record for each action of each person, episode by episode."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.system.files import finite

from ..people.decision import NOTHING
from .engine import Engine, StepTaken
from .pool import Pool
from .questions import Asked
from .state import BASE, TeamAction, TeamPolicy, TeamState
from .trace import Reasons, Trace


class Tracer:
    """Sees the steps of a chunk of episodes, and writes them down.

    Parameters
    ----------
    pool : Pool
    name : str
        Name of the policy.
    policy : TeamPolicy
    numbers : int array, shape (N,)
        Numbers of the episodes.
    reasons : Reasons or None

    Attributes
    ----------
    traces : list of Trace
        The trace of each episode.
    """

    def __init__(
        self, pool: Pool, name: str, policy: TeamPolicy, numbers: NDArray[np.int64], reasons: Reasons | None
    ) -> None:
        self.pool, self.name, self.policy, self.numbers, self.reasons = pool, name, policy, numbers, reasons
        self.names = pool.names
        self.traces, self.said = [Trace() for _ in numbers], dict[tuple[int, int], dict[str, Any]]()

    def decided(self, engine: Engine, team: TeamState, action: TeamAction, teams: NDArray[np.int64]) -> None:
        """Keep the reason of each suggestion for the record of the person who gets it, before the step is taken."""
        if self.reasons is None:
            return
        for row, robot in np.argwhere(action.action > 0).tolist():
            k, said, e = int(action.person[row, robot]), int(action.action[row, robot]), int(teams[row])
            if team.policies[team.model[row, k]].pomdp.suggested[team.x[row, k], said] != NOTHING:
                names = [self.names[one] for one in engine.people.number[e].tolist()]
                reason = self.reasons(team, row, k, said, robot=robot, names=names, rule=self.name, policy=self.policy)
                self.said.setdefault((e, k), {})["explanation"] = reason

    def asked(self, engine: Engine, asked: Sequence[tuple[Asked, bool]]) -> None:
        """Keep questions and their answers for the records of the people who were asked."""
        del engine
        for one, yes in asked:
            name = list(one.question.hidden.goals)[one.question.goal]
            question = {"goal": name, "answer": yes, "worth": one.worth}
            self.said.setdefault((one.team, one.person), {})["question"] = question

    def took(self, engine: Engine, taken: StepTaken) -> None:
        """Append a record for each person who acted to the trace of their episode."""
        tasks, people, executes = engine.tasks, engine.people, self.pool.setting.fleet.executes
        location, busy_until = engine.robots.location, engine.robots.busy_until
        for e, k in np.argwhere(taken.now.active).tolist():
            pomdp = tasks.policies[tasks.model[e, k]].pomdp
            choices, x, r = pomdp.model.choices, int(taken.before[e, k]), int(taken.heard[e, k])
            goal, slot, step = int(people.goal[e, k]), int(taken.slot[e, k]), int(taken.clock[e])
            suggested = int(pomdp.suggested[x, r])
            acting = int(pomdp.afterstate[x, r])
            there = [
                where if where != BASE and until <= step else None
                for where, until in zip(location[e].tolist(), busy_until[e].tolist(), strict=True)
            ]
            row = {
                "person": self.names[people.number[e, k]],
                "episode": f"{self.name}-{self.numbers[e]}",
                "step": step,
                "action": choices.name(acting, slot) if slot >= 0 else None,
                "suggestion": choices.name(x, suggested) if suggested != NOTHING else None,
                **({"executed": pomdp.executes(x, r)} if executes else {}),
                "policy": self.name,
                "place": k,
                "robot_places": there,
                "cost": float(choices.costs[acting, slot]) if slot >= 0 else 0.0,
                "cost_to_go": finite(choices.goals.h[goal, x]),
                "cost_to_go_after": finite(choices.goals.h[goal, people.row[e, k]]),
                "theta": float(taken.theta[e, k]),
                "reward": float(taken.reward[e, k]),
                **({} if (name := choices.goals.shown(goal)) is None else {"goal": name}),
                **self.said.get((e, k), {}),
            }
            self.traces[e].append(row)
        self.said.clear()
