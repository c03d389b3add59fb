"""Trust rules that see steps without a suggestion, and one person's problem under any rule by brute force.

The brute force has no grid, no arrays and no interpolation: a belief is a mapping of (beta, theta, count) to its
probability, and equations (5) to (7) and the rule are applied to single numbers. It takes no code from the packages but
the task's choices and the rule.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from assist.people.choices import Choices
from assist.people.decision import Floats
from assist.people.trust_rules import Event, TrustRule

Belief = dict[tuple[float, float, int], float]


@dataclass(frozen=True)
class ThreeInARow:
    """Theta falls after three suggestions in a row; a step without one ends the row, and theta rises in it."""

    fall: float = 0.3
    rise: float = 0.0
    counts = 2
    uses_answer, feedback, sees_silence = False, "never", True

    def update(self, theta: Floats, event: Event, count: Any = 0) -> Floats:
        spoken = np.where(np.asarray(count) == 2, np.maximum(theta - self.fall, 0.0), theta)
        return np.where(event.suggested, spoken, np.minimum(theta + self.rise, 1.0))

    def counted(self, count: Any, event: Event) -> Any:
        return np.where(event.suggested, (count + 1) % 3, 0)


@dataclass(frozen=True)
class Rested:
    """Theta rises in steps without a suggestion, and falls with each that is not followed."""

    share: float = 0.2
    uses_answer, feedback, sees_silence = True, "never", True

    def update(self, theta: Floats, event: Event) -> Floats:
        declined = np.where(event.followed, theta, (1 - self.share) * theta)
        return np.where(event.suggested, declined, (1 - self.share) * theta + self.share)


@dataclass(frozen=True)
class OnePerson:
    """One person's task under a trust rule; a robot action is the slot of a suggestion, or None."""

    choices: Choices
    rule: TrustRule
    gamma: float
    c_suggest: float
    lapse: float = 0.0

    def chances(self, x: int, said: int | None, beta: float, theta: float) -> list[float]:
        """Return the probability of each choice."""
        cost = self._costs(x)
        weights = [math.exp(-beta * (one - min(cost))) for one in cost]
        if said is not None:
            influenced = [w * (theta if a == said else 1 - theta) for a, w in enumerate(weights)]
            weights = influenced if sum(influenced) > 0 else weights
        return [(1 - self.lapse) * w / sum(weights) + self.lapse / len(weights) for w in weights]

    def _costs(self, x: int) -> list[float]:
        c = self.choices
        count = int(c.applicable[x].sum())
        return [float(c.costs[x, a] + c.h[c.targets[x, a]]) for a in range(count)]

    def moved(self, x: int, said: int | None, a: int, theta: float, count: int) -> tuple[float, int]:
        """Return theta and the count of the rule after a choice."""
        event = Event.silent()
        if said is not None:
            cost, y = self._costs(x), int(self.choices.targets[x, said])
            after = 0.0 if self.choices.goal[y] else -min(self._costs(y))
            told = (after + min(cost), cost[said] <= min(cost), a == said, False, False, True)
            event = Event(*map(np.asarray, told))
        rule: Any = self.rule
        if said is None and not getattr(rule, "sees_silence", False):
            return theta, count
        if not getattr(rule, "counts", 0):
            return float(rule.update(np.asarray(theta), event)), 0
        return float(rule.update(np.asarray(theta), event, np.asarray(count))), int(
            rule.counted(np.asarray(count), event)
        )

    def after(self, belief: Belief, x: int, said: int | None, a: int) -> tuple[float, Belief]:
        """Return the probability of a choice, and the belief after it."""
        found: Belief = defaultdict(float)
        for (beta, theta, count), p in belief.items():
            then = self.moved(x, said, a, theta, count)
            found[beta, *then] += p * self.chances(x, said, beta, theta)[a]
        mass = sum(found.values())
        return mass, {key: p / mass for key, p in found.items()} if mass > 0 else {}

    def value(
        self, belief: Belief, x: int, depth: int, says: Callable[[int, int], int | None] | None = None, step: int = 0
    ) -> float:  # fmt: skip
        """Return the largest expected return over `depth` steps, or that of a policy of the step and the state."""
        if not depth or self.choices.goal[x]:
            return 0.0
        slots = [int(a) for a in np.flatnonzero(self.choices.applicable[x])]
        offered = [None, *(int(a) for a in np.flatnonzero(self.choices.optimal[x]))]
        best = -math.inf
        for said in offered if says is None else [says(step, x)]:
            total = -self.c_suggest * (said is not None)
            for a in slots:
                mass, then = self.after(belief, x, said, a)
                if mass > 0:
                    later = self.value(then, int(self.choices.targets[x, a]), depth - 1, says, step + 1)
                    total += mass * (self.gamma * later - float(self.choices.costs[x, a]))
            best = max(best, total)
        return best
