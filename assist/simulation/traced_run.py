"""Episodes whose steps are written down, one record for each action of each person."""

from __future__ import annotations

from typing import Any

from planner.system.files import finite

from ..people.decision import NOTHING
from ..team.state import BASE
from .run import Run, StepTaken
from .trace import Trace


class TracedRun(Run):
    """A chunk of episodes in progress that appends to a trace; further arguments as in `Run`."""

    def __init__(self, *args: Any, trace: Trace, **options: Any) -> None:
        super().__init__(*args, **options)
        self.trace = trace

    def watch(self, taken: StepTaken) -> None:
        """Append a record for each person who acted."""
        view = taken.view
        for i in taken.flat:
            e, k = divmod(int(i), self.x.shape[1])
            pomdp = view.policies[view.model[e, k]].pomdp
            choices, x, r = pomdp.model.choices, int(taken.before[e, k]), int(taken.robot[e, k])
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
                **({"executed": pomdp.executes(x, r)} if self.pool.setting.execute else {}),
                "policy": self.name,
                "place": k,
                **({"robot_place": there[0]} if self.robots == 1 else {"robot_places": there}),
                "cost": float(choices.costs[place, taken.slot[i]]) if taken.slot[i] >= 0 else 0.0,
                "cost_to_go": finite(choices.h[x]),
                "cost_to_go_after": finite(choices.h[view.x[e, k]]),
                "theta": float(taken.theta[e, k]),
                "reward": float(taken.reward[e, k]),
                **({"goal": list(choices.goals or ())[self.goal[e, k]]} if self.pool.goals > 1 else {}),
            }
            self.trace.append(row)
