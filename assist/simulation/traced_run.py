"""Episodes whose steps are written down, one record for each action of each person, episode by episode."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.system.files import finite

from ..people.decision import NOTHING
from ..team.state import BASE, TeamAction, TeamState
from .run import Run, StepTaken
from .trace import Reasons, Trace


class TracedRun(Run):
    """A chunk of episodes in progress, with the trace of each; further arguments as in `Run`."""

    def __init__(self, *args: Any, reasons: Reasons | None, **options: Any) -> None:
        self.keeps_beliefs = reasons is not None
        super().__init__(*args, **options)
        self.reasons, self.traces = reasons, [Trace() for _ in self.numbers]
        self.said: dict[tuple[int, int], dict[str, Any]] = {}

    def decided(self, team: TeamState, action: TeamAction, teams: NDArray[np.int64]) -> None:
        """Keep the reason of each suggestion for the record of the person who gets it."""
        if self.reasons is None:
            return
        for row, number in np.argwhere(action.robot > 0).tolist():
            k, robot, e = int(action.person[row, number]), int(action.robot[row, number]), int(teams[row])
            if team.policies[team.model[row, k]].pomdp.suggested[team.x[row, k], robot] != NOTHING:
                reason = self.reasons(
                    team, row, k, robot, number=number, names=[f"human-{one + 1}" for one in self.people[e].tolist()],
                    rule=self.name,
                )  # fmt: skip
                self.said.setdefault((e, k), {})["explanation"] = reason

    def asked_about(self, team: int, place: int, goal: int, *, yes: bool, worth: float) -> None:
        """Keep a question and its answer for the record of the person who was asked."""
        name = self.pool.choices(int(self.people[team, place])).goals.names[goal]
        self.said.setdefault((team, place), {})["question"] = {"goal": name, "answer": yes, "worth": worth}

    def watch(self, taken: StepTaken) -> None:
        """Append a record for each person who acted to the trace of their episode."""
        executes = self.pool.setting.fleet.executes
        for i in taken.flat:
            e, k = divmod(int(i), taken.x.shape[1])
            pomdp = self.policies[self.model[e, k]].pomdp
            choices, x, r = pomdp.model.choices, int(taken.before[e, k]), int(taken.robot[e, k])
            goal = int(self.task_view.goal[e, k])
            suggested = int(pomdp.suggested[x, r])
            place = int(pomdp.afterstate[x, r])
            there = [
                place if place != BASE and until <= taken.step else None
                for place, until in zip(self.location[e].tolist(), self.busy_until[e].tolist(), strict=True)
            ]
            row = {
                "person": f"human-{self.people[e, k] + 1}",
                "episode": f"{self.name}-{self.numbers[e]}",
                "step": taken.step,
                "action": choices.name(place, int(taken.slot[i])) if taken.slot[i] >= 0 else None,
                "suggestion": choices.name(x, suggested) if suggested != NOTHING else None,
                **({"executed": pomdp.executes(x, r)} if executes else {}),
                "policy": self.name,
                "place": k,
                **({"robot_place": there[0]} if len(there) == 1 else {"robot_places": there}),
                "cost": float(choices.costs[place, taken.slot[i]]) if taken.slot[i] >= 0 else 0.0,
                "cost_to_go": finite(choices.goals.h[goal, x]),
                "cost_to_go_after": finite(choices.goals.h[goal, taken.x[e, k]]),
                "theta": float(taken.theta[e, k]),
                "reward": float(taken.reward[e, k]),
                **({} if self.goals is None else {"goal": choices.goals.names[goal]}),
                **self.said.get((e, k), {}),
            }
            self.traces[e].append(row)
        self.said.clear()
