"""A simulated person who takes a seat in a live session: sees what a person there sees, and acts as the model says."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import numpy as np

from planner import CostToGo, Table

from ..people.choices import Choices
from ..people.decision import NOTHING, Floats, choice, influence, perceived_cost_to_go, trust
from ..people.human import Human, Mixture, Population
from ..people.terms import NOTHING_YET, TERMS, Situation, Vocabulary, features, goals_met


class _Step(NamedTuple):
    """What somebody did last: in which state of which task, and where it led."""

    task: CostToGo
    state: int
    action: int
    after: int


class SimulatedPerson:
    """Somebody with an expertise, a trust in the robot and misconceptions of their own, in a task of any size.

    What they take for the cost-to-go of a state, h(x) = h*(x) + sigma eps(x), is drawn for each state when they first
    think of it, and always the same. Terms speak for their choices as the population's weights say. A choice model of
    one's own needs a task of which all states are known.

    Parameters
    ----------
    population : Population or Mixture
        Of whom they are drawn.
    eta, utility_scale : float
        Of the trust update (eq. 7).
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
        self.weights = {name: float(self.rng.uniform(*ends)) for name, ends in population.weights.items()}
        self._noise, self._chooses = population.noise, population.chooses
        self._last: _Step | None = None
        self._words: dict[int, tuple[CostToGo, Vocabulary]] = {}
        self._own: dict[int, tuple[CostToGo, Choices, Floats, Floats]] = {}

    def act(self, task: CostToGo, state: int, applicable: Sequence[str], suggestion: str | None) -> str:
        """Choose what to do (eqs. 5 and 6), and come to trust the robot more or less by what it suggested (eq. 7).

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
        slot = names.index(suggestion) if suggestion in names else NOTHING
        p = influence(self.chances(task, state), slot, self.theta)
        if slot != NOTHING:
            here, there = self._value(task, state), self._value(task, int(rows.targets[slot]))
            self.theta = float(trust(self.theta, here, there, self._eta, self._scale))
        done = int(self.rng.choice(len(names), p=p / p.sum()))
        self._last = _Step(task, state, int(rows.actions[done]), int(rows.targets[done]))
        return names[done]

    def chances(self, task: CostToGo, state: int) -> Floats:
        """Give the chance of each action that the task has there, where nothing is suggested.

        What they did last counts if it led here: nothing has been taken back, and no other task begun.
        """
        rows = task.choices([state])
        if self._chooses is not None:
            _, choices, p, _ = self._known(task)
            slots = [int(np.flatnonzero(choices.actions[state] == action)[0]) for action in rows.actions]
            return p[state, slots]
        q = self._perceived(task, state, rows)
        every = np.ones(len(q), dtype=bool)
        return choice(q, every, self.beta, self._bias(task, state, rows) if self.weights else None)

    def _bias(self, task: CostToGo, state: int, rows: Any) -> Floats:
        if id(task) not in self._words:
            self._words[id(task)] = task, Vocabulary.of(task.task.actions)
        last, came = self._last, False
        if last is not None:
            came = last.task is task and last.after == state
        situation = Situation(
            task.task.actions, self._words[id(task)][1], np.array([state]), np.ones((1, len(rows.actions)), dtype=bool),
            rows.actions.astype(np.int64)[None], rows.targets.astype(np.int64)[None], goals_met(task, [state]),
            goals_met(task, rows.targets)[None], np.array([last.action if last and came else NOTHING_YET]),
            np.array([last.state if last and came else NOTHING_YET]),
        )  # fmt: skip
        said = features(situation, {name: TERMS[name] for name in self.weights})
        bias: Floats = said[0] @ np.array(list(self.weights.values()))
        return bias

    def _known(self, task: CostToGo) -> tuple[CostToGo, Choices, Floats, Floats]:
        """Give all choices of a task, with the chances and values that a model of the user's own gives."""
        if id(task) not in self._own:
            choices = Choices.of(cast(Table, task))
            h = perceived_cost_to_go(choices, self.sigma, np.random.default_rng(self._seed), self._noise)
            assert self._chooses is not None
            human = Human(self.beta, self.theta, self.sigma, h, self._chooses)
            self._own[id(task)] = task, choices, human.chances(choices), human.value(choices)
        return self._own[id(task)]

    def _value(self, task: CostToGo, state: int) -> float:
        """What they take a state to be worth: minus what the best they could do there costs."""
        if self._chooses is not None:
            return float(self._known(task)[3][state])
        if task.is_goal([state])[0]:
            return 0.0
        return -float(self._perceived(task, state, task.choices([state])).min(initial=np.inf))

    def _perceived(self, task: CostToGo, state: int, rows: Any) -> Floats:
        """What they take each action to cost, with all that comes after it."""
        seeds = [[self._seed, int(to)] for to in rows.targets]
        if self._noise == "action":
            seeds = [[self._seed, state, int(action)] for action in rows.actions]
        eps = np.array([np.random.default_rng(seed).standard_normal() for seed in seeds])
        after = task.lookup(rows.targets) + self.sigma * eps
        costs: Floats = np.asarray(task.task.costs, dtype=float)[rows.actions]
        return costs + np.where(task.is_goal(rows.targets), 0.0, after)
