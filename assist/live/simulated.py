"""A simulated person who takes a seat in a live session: sees what a person there sees, and acts as the model says."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from planner import CostToGo

from ..people.decision import NOTHING, Floats, choice, influence, trust
from ..people.human import Mixture, Population


class SimulatedPerson:
    """Somebody with an expertise, a trust in the robot and misconceptions of their own, in a task of any size.

    What they take for the cost-to-go of a state, h(x) = h*(x) + sigma eps(x), is drawn for each state when they first
    think of it, and always the same.

    Parameters
    ----------
    population : Population or Mixture
        Of whom they are drawn.
    eta, utility_scale : float
        Of the trust update (eq. 6).
    seed : int
        From which they and all that they do are drawn.
    """

    def __init__(
        self, population: Population | Mixture, *, eta: float = 0.2, utility_scale: float = 1.0, seed: int = 0
    ) -> None:
        self._seed, self._eta, self._scale = seed, eta, utility_scale
        self.rng = np.random.default_rng(seed)
        if isinstance(population, Mixture):
            population = population.parts[int(self.rng.choice(len(population.parts), p=population.shares))]
        ranges = (population.beta, population.theta, population.sigma)
        self.beta, self.theta, self.sigma = (float(self.rng.uniform(*ends)) for ends in ranges)

    def act(self, task: CostToGo, state: int, applicable: Sequence[str], suggestion: str | None) -> str:
        """Choose what to do (eqs. 4 and 5), and come to trust the robot more or less by what it suggested (eq. 6).

        Parameters
        ----------
        task : CostToGo
        state : int
            Its state.
        applicable : sequence of str
            What can be done there; one can only stand still where that is all.
        suggestion : str or None
            One of them.
        """
        rows = task.choices([state])
        if not len(rows.actions):
            return applicable[0]
        names = [task.task.actions[action] for action in rows.actions]
        costs = np.asarray(task.task.costs, dtype=float)
        q = costs[rows.actions] + self._believed(task, rows.targets)
        slot = names.index(suggestion) if suggestion in names else NOTHING
        p = influence(choice(q, np.ones(len(q), dtype=bool), self.beta), slot, self.theta)
        if slot != NOTHING:
            there = int(rows.targets[slot])
            value = self._value(task, there, costs)
            self.theta = float(trust(self.theta, -q.min(), value, self._eta, self._scale))
        return names[int(self.rng.choice(len(names), p=p / p.sum()))]

    def _value(self, task: CostToGo, state: int, costs: Floats) -> float:
        """What they take a state to be worth: minus what the best they could do there costs."""
        if task.is_goal([state])[0]:
            return 0.0
        rows = task.choices([state])
        return -float((costs[rows.actions] + self._believed(task, rows.targets)).min(initial=np.inf))

    def _believed(self, task: CostToGo, states: Any) -> Floats:
        noise = [np.random.default_rng([self._seed, int(state)]).standard_normal() for state in states]
        believed: Floats = task.lookup(states) + self.sigma * np.array(noise)
        return np.where(task.is_goal(states), 0.0, believed)
