"""A simulated person in a live session, who sees what a real person sees and acts by the model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import numpy as np

from planner import CostToGo, Table, optimal_choices

from ..people.choices import Choices
from ..people.decision import NOTHING, Floats, choice, influence
from ..people.goals import Goals
from ..people.human import Human, Population
from ..people.misconception import perceived_cost_to_go
from ..people.terms import NOTHING_YET, TERMS, Situation, Vocabulary, features, goals_met
from ..people.trust_rules import EquationSeven, PerceivedSuggestions, TrustRule, moved
from ..person.observation_model import ObservationModel


class _Step(NamedTuple):
    """A person's last action: task, state, action and successor."""

    task: CostToGo
    state: int
    action: int
    after: int


class SimulatedPerson:
    """A person with their own expertise, trust and misconceptions, in a task of any size.

    The perceived cost-to-go of a state, h(x) = h*(x) + sigma eps(x), is drawn from a random generator seeded by the
    state, so that it is always the same. Terms of the choice have the population's weights. A user's own choice model
    needs an enumerated task.

    Parameters
    ----------
    population : Population
        Population from which the person is drawn.
    trust : TrustRule, optional
        Rule by which theta changes; by default equation (7) with eta = 0.2.
    seed : int
        Random seed of the person and of all their choices.
    """

    def __init__(self, population: Population, *, trust: TrustRule | None = None, seed: int = 0) -> None:
        self._seed, self._trust = seed, EquationSeven() if trust is None else trust
        self._count = np.zeros((), dtype=np.int64)
        self.rng = np.random.default_rng(seed)
        if population.parts:
            population = population.parts[int(self.rng.choice(len(population.parts), p=population.shares))]
        ranges = (population.beta, population.theta, population.sigma)
        self.beta, self.theta, self.sigma = (float(self.rng.uniform(*ends)) for ends in ranges)
        self.weights = {name: float(self.rng.uniform(*ends)) for name, ends in population.weights.items()}
        self._noise, self._chooses = population.noise, population.chooses
        self._last: _Step | None = None
        # Where the person is if the robot does not see all actions as they are, and the last action of which it saw
        # something.
        self.state: int | None = None
        self.reported: str | None = None
        self._words: dict[int, tuple[CostToGo, Vocabulary]] = {}
        self._own: dict[int, tuple[CostToGo, Choices, Floats, Floats]] = {}
        self._arranged: dict[int, tuple[CostToGo, Choices]] = {}

    def pursued(self, task: CostToGo | Goals) -> CostToGo:
        """Return the task with the goal that the person pursues; of several goals, it is drawn from their prior."""
        if not isinstance(task, Goals):
            return task
        own = np.random.default_rng([self._seed, len(task.tables)])  # so that no other draw depends on the goals
        return list(task.tables.values())[int(own.choice(len(task.tables), p=list(task.prior.values())))]

    def act(self, task: CostToGo, state: int, applicable: Sequence[str], suggestion: str | None) -> str:
        """Return the chosen action (equations 5 and 6), and update theta after a suggestion (equation 7, or the rule).

        Parameters
        ----------
        task : CostToGo
        state : int
            State of the task.
        applicable : sequence of str
            Applicable actions; in a dead end it holds waiting only.
        suggestion : str or None
            The suggested action, one of these.
        """
        rows = task.choices([state])
        if not len(rows.actions):
            return applicable[0]
        names = [task.task.actions[action] for action in rows.actions]
        slot = names.index(suggestion) if suggestion in names else NOTHING
        p = influence(self.chances(task, state), slot, self.theta)
        done = int(self.rng.choice(len(names), p=p / p.sum()))
        if slot != NOTHING:
            cost = self._perceived(task, state, rows)
            perceived = PerceivedSuggestions.of(
                cost[slot], cost.min(), np.array(self._value(task, state)),
                np.array(self._value(task, int(rows.targets[slot]))),
                optimal_choices(task, [state], rows)[slot],
            )  # fmt: skip
            event = perceived.event(done == slot, self._trust.feedback)
            theta, self._count = moved(self._trust, np.array(self.theta), self._count, event)
            self.theta = float(theta)
        self._last = _Step(task, state, int(rows.actions[done]), int(rows.targets[done]))
        return names[done]

    def answer(self, task: CostToGo | Goals, goal: str | None) -> str | bool | None:
        """Return the true answer to "is this your goal?", or, if it is None, to "what did you do last?"."""
        if goal is None:
            return self.reported
        return isinstance(task, Goals) and task.tables[goal] is self.pursued(task)

    def act_unseen(self, task: CostToGo, suggestion: str | None, model: ObservationModel) -> str | None:
        """Act in the person's own state, `state`, and return what the robot sees; None if it misses the action.

        Parameters
        ----------
        task : CostToGo
            An enumerated task.
        suggestion : str or None
            The suggested action, which has no effect if it is not applicable.
        model : ObservationModel
        """
        assert self.state is not None
        before, choices = self.state, self._choices(task)
        done = self.act(task, before, [choices.name(before, 0)], suggestion)
        slot = next(n for n in range(choices.applicable[before].sum()) if choices.name(before, n) == done)
        self.state = int(choices.targets[before, slot])
        seen = model.draw(choices, before, slot, self.rng.random(2))
        if seen is None:
            return None
        self.reported = done
        return choices.action_name(seen)

    def chances(self, task: CostToGo, state: int) -> Floats:
        """Return the probability of each of the task's actions in a state, without a suggestion.

        Terms depend on the last action if it led to this state, that is, after no undo and no change of the task.
        """
        rows = task.choices([state])
        if self._chooses is not None:
            _, choices, p, _ = self._known(task)
            actions = task.task.first_of_name[rows.actions]
            slots = [int(np.flatnonzero(choices.actions[state] == action)[0]) for action in actions]
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

    def _choices(self, task: CostToGo) -> Choices:
        """Return the choices of an enumerated task."""
        if id(task) not in self._arranged:
            self._arranged[id(task)] = task, Choices.of(cast(Table, task))
        return self._arranged[id(task)][1]

    def _known(self, task: CostToGo) -> tuple[CostToGo, Choices, Floats, Floats]:
        """Return a task's choices, with the probabilities and values of the user's own choice model."""
        if id(task) not in self._own:
            choices = self._choices(task)
            h = perceived_cost_to_go(choices, self.sigma, np.random.default_rng(self._seed), self._noise)
            assert self._chooses is not None
            human = Human(self.beta, self.theta, self.sigma, h, self._chooses)
            self._own[id(task)] = task, choices, human.chances(choices), human.value(choices)
        return self._own[id(task)]

    def _value(self, task: CostToGo, state: int) -> float:
        """Return the perceived value of a state: minus the smallest perceived cost of its actions."""
        if self._chooses is not None:
            return float(self._known(task)[3][state])
        if task.is_goal([state])[0]:
            return 0.0
        return -float(self._perceived(task, state, task.choices([state])).min(initial=np.inf))

    def _perceived(self, task: CostToGo, state: int, rows: Any) -> Floats:
        """Return the perceived cost of each action: its own cost plus the perceived cost-to-go of its successor."""
        seeds = [[self._seed, int(to)] for to in rows.targets]
        if self._noise == "action":
            seeds = [[self._seed, state, int(action)] for action in rows.actions]
        eps = np.array([np.random.default_rng(seed).standard_normal() for seed in seeds])
        after = task.lookup(rows.targets) + self.sigma * eps
        costs: Floats = task.task.action_costs[rows.actions]
        return costs + np.where(task.is_goal(rows.targets), 0.0, after)
