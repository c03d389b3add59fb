"""Trust rules that see steps without a suggestion, and people's problems under any rule by brute force.

The brute force has no grid, no arrays and no interpolation: a belief is a mapping of (beta, theta, count) to its
probability, and equations (5) to (7) and the rule are applied to single numbers. It takes no code from the packages but
the task's choices and the rule. It has one person, two people and a robot that is with one of them (`TwoPeople`), and
one person whose actions are not all seen as they are (`HalfSeen`).
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from assist.people.choices import Choices
from assist.people.decision import Floats
from assist.people.trust_rules import Event, TrustRule

Belief = dict[tuple[float, float, int], float]
Joint = dict[tuple[int, float, float, int], float]
"""Probability of each state with each (beta, theta, count)."""

Known = tuple[int, tuple[tuple[tuple[float, float, int], float], ...]]
"""A person in a known state, with the items of a belief."""


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
            gain, shown = after + min(cost), a == said and self.rule.feedback != "never"
            right = self.choices.optimal[x, said] if self.rule.feedback == "true" else gain > 0
            event = Event(*map(np.asarray, (gain, cost[said] <= min(cost), a == said, shown, right, True)))
        rule: Any = self.rule
        if said is None and not getattr(rule, "sees_silence", False):
            return theta, count
        if not getattr(rule, "counts", 0):
            return float(rule.update(np.asarray(theta), event)), 0
        counted = rule.counted(np.asarray(count), event) if hasattr(rule, "counted") else count + event.shown
        return float(rule.update(np.asarray(theta), event, np.asarray(count))), min(int(counted), rule.counts)

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


@dataclass(frozen=True)
class TwoPeople:
    """Two people, each like `alone` at a task of their own, and a robot that is with one of them after its first move.

    A decision is a person, 0 or 1, and the slot of a suggestion, or None. It costs `c_move` to move to the person.
    """

    alone: OnePerson
    c_move: float
    found: dict[Any, Any] = field(default_factory=dict, compare=False)

    def ends(self, person: Known, said: int | None) -> list[tuple[float, float, Known]]:
        """Return the probability and the cost of each choice of a person, and the person after it."""
        x, c = person[0], self.alone.choices
        if c.goal[x]:
            return [(1.0, 0.0, person)]
        if (key := (person, said)) not in self.found:
            each = []
            for a in (int(a) for a in np.flatnonzero(c.applicable[x])):
                mass, then = self.alone.after(dict(person[1]), x, said, a)
                if mass > 0:
                    each.append((mass, float(c.costs[x, a]), (int(c.targets[x, a]), tuple(then.items()))))
            self.found[key] = each
        return list(self.found[key])

    def value(
        self, people: tuple[Known, Known], depth: int,
        says: Callable[[int], int | None] | None = None, step: int = 0, at: int | None = None,
    ) -> float:  # fmt: skip
        """Return the largest expected return over `depth` steps, or that of decisions by the step.

        Such a decision is a person to whom the first optimal action is suggested, if they are still at work.
        """
        c = self.alone.choices
        works = [k for k in (0, 1) if not c.goal[people[k][0]]]
        if not depth or not works:
            return 0.0
        offered = [None, *((k, int(a)) for k in works for a in np.flatnonzero(c.optimal[people[k][0]]))]
        if says is not None:
            told = says(step)
            offered = [next((one for one in offered if one and one[0] == told), None)]
        best = -math.inf
        for decision in offered:
            to, slot = (at, None) if decision is None else decision
            value = -(self.c_move * (to != at) + self.alone.c_suggest * (slot is not None))
            heard = [slot if k == to else None for k in (0, 1)]
            for p, cost, one in self.ends(people[0], heard[0]):
                for q, more, other in self.ends(people[1], heard[1]):
                    later = self.value((one, other), depth - 1, says, step + 1, to)
                    value += p * q * (self.alone.gamma * later - cost - more)
            best = max(best, value)
        return best


@dataclass(frozen=True)
class HalfSeen(OnePerson):
    """A person whose actions the robot misses or takes for others; suggestions are ground actions."""

    miss: float = 0.0
    confusion: float = 0.0

    def sights(self, x: int, a: int) -> dict[int | None, float]:
        """Return the probability of each ground action that is seen after a choice; None stands for nothing."""
        actions = [int(action) for action in self.choices.actions[x][self.choices.applicable[x]]]
        wrong = self.confusion / (len(actions) - 1) if len(actions) > 1 else 0.0
        right = 1 - wrong * (len(actions) - 1)
        seen = {action: right if n == a else wrong for n, action in enumerate(actions)}
        return {None: self.miss} | {action: (1 - self.miss) * p for action, p in seen.items()}

    def step(self, joint: Joint, said: int | None) -> tuple[float, dict[int | None, Joint]]:
        """Return the mean cost of a step, and for each sight the probability of each state of who goes on."""
        c, cost = self.choices, self.c_suggest * (said is not None)
        found: dict[int | None, Joint] = defaultdict(lambda: defaultdict(float))
        for (x, beta, theta, count), mass in joint.items():
            actions = [int(action) for action in c.actions[x][c.applicable[x]]]
            slot = actions.index(said) if said in actions else None  # nobody hears what is not applicable
            for a, p in enumerate(self.chances(x, slot, beta, theta)):
                cost += mass * p * float(c.costs[x, a])
                y = int(c.targets[x, a])
                if not c.goal[y]:
                    moved = self.moved(x, slot, a, theta, count)
                    for seen, chance in self.sights(x, a).items():
                        found[seen][y, beta, *moved] += mass * p * chance
        return cost, found

    def policy_value(self, joint: Joint, depth: int, says: Callable[[int, int], int | None], step: int = 0) -> float:
        """Return the expected return over `depth` steps, if the step and the likeliest state decide what is said."""
        if not depth:
            return 0.0
        likely: dict[int, float] = defaultdict(float)
        for (x, *_), p in joint.items():
            likely[x] += p
        cost, found = self.step(joint, says(step, max(likely, key=likely.__getitem__)))
        value = -cost
        for after in found.values():
            if (mass := sum(after.values())) > 0:
                then = {key: p / mass for key, p in after.items() if p > 0}
                value += mass * self.gamma * self.policy_value(then, depth - 1, says, step + 1)
        return value
