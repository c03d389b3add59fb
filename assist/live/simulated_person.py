"""A simulated person in a live session, who sees what a real person sees and acts by the model.

Choice, influence, trust and misconceptions are the functions of the engine, on the choices around the person's state.
So the same person with the same states and uniform numbers acts as in `simulate`, in a task of any size.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from planner import CostToGo, Transitions

from ..people.choice_model import Weighted
from ..people.choices import Choices
from ..people.decision import NOTHING, Floats, perceived_cost
from ..people.goals import Goals, each_of, prior_of
from ..people.human import Human
from ..people.perceived_suggestions import PerceivedSuggestions, moved
from ..people.ranges import Population
from ..people.terms import NOTHING_YET, TERMS, Situation, Vocabulary, features, goals_met
from ..people.trust_rules import EquationSeven, Event, TrustRule
from ..person.dynamics import drawn_slots, influenced
from ..person.observation_model import ObservationModel
from ..person.state_cache import NONE, StateCache
from ..person.truncated_task import TruncatedTask
from .roster import News


class _Step(NamedTuple):
    """A person's last action: task, state, action and successor."""

    task: CostToGo
    state: int
    action: int
    after: int


class SimulatedPerson:
    """A person with their own expertise, trust and misconceptions, in a task of any size.

    Parameters
    ----------
    population : Population or Human
        The person, or the population from which they are drawn.
    trust : TrustRule, optional
        Rule by which theta changes; by default equation (7) with eta = 0.2.
    seed : int
        Random seed of the person and of all their choices.
    """

    def __init__(
        self, population: Population | Human, *, trust: TrustRule | None = None, seed: int = 0,
    ) -> None:  # fmt: skip
        self._seed = seed
        self.joins(EquationSeven() if trust is None else trust)
        self.rng = np.random.default_rng(seed)
        self.human = population if isinstance(population, Human) else population.sample(None, 1, self.rng)[0]
        self.theta = self.human.theta
        self._last: _Step | None = None
        # Where the person is if the robot does not see all actions as they are, and the last action of which it saw
        # something.
        self.state: int | None = None
        self.reported: str | None = None
        self._words: dict[int, tuple[CostToGo, Vocabulary]] = {}
        self._caches: dict[int, StateCache] = {}

    def joins(self, trust: TrustRule) -> None:
        """Be in a new team, where nothing has happened to the person yet; theta stays, and moves by this rule then."""
        self._trust, self._heard, self._count = trust, set[News](), np.zeros((), dtype=np.int64)

    def pursued(self, task: CostToGo | Goals) -> CostToGo:
        """Return the task with the goal that the person pursues; of several goals, it is drawn from their prior."""
        return each_of(task)[self._goal(task)]

    def _goal(self, task: CostToGo | Goals) -> int:
        """Return the number of the goal that the person pursues."""
        prior = list(prior_of(task).values())
        own = np.random.default_rng([self._seed, len(prior)])  # so that no other draw depends on the goals
        return int(own.choice(len(prior), p=prior))

    def hear(self, news: Iterable[News]) -> None:
        """Update theta by what has happened to the person; what was passed before counts once."""
        for one in news:
            if one not in self._heard:
                self._heard.add(one)
                self.theta = float(one.moved(np.array(self.theta), self._trust))

    def act(
        self, task: CostToGo, state: int, applicable: Sequence[str], suggestion: str | None, *,
        uniform: float | None = None,
    ) -> str:  # fmt: skip
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
        uniform : float, optional
            The number in [0, 1) that draws the choice; by default it is drawn here.
        """
        rows = task.choices([state])
        if not len(rows.actions):
            return applicable[0]
        names = [task.task.actions[action] for action in rows.actions]
        suggested = names.index(suggestion) if suggestion in names else NOTHING
        choices = self._around(task, state, rows, suggested)
        p = influenced(self.human.chances(choices)[:1], np.array([suggested]), np.array([self.theta]))
        counts = np.array([[choices.applicable[0].sum()]])
        number = self.rng.random() if uniform is None else uniform
        done = int(drawn_slots(p, counts, 0.0, np.array([number]))[0])
        self._trusts(choices, suggested, followed=done == suggested)
        self._last = _Step(task, state, int(rows.actions[done]), int(rows.targets[done]))
        return names[done]

    def _trusts(self, choices: Choices, slot: int, *, followed: bool) -> None:
        """Update theta after a step in the state of the first row; `slot` is the suggestion, or `NOTHING`."""
        event = Event.silent()
        if slot != NOTHING:
            q, value = perceived_cost(choices, self.human.expects(choices)), self.human.value(choices)
            perceived = PerceivedSuggestions.of(
                q[0, slot], q[0].min(), value[0], value[choices.targets[0, slot]], choices.optimal[0, slot]
            )
            event = perceived.event(np.array(followed), self._trust.feedback)
        theta, self._count = moved(self._trust, np.array(self.theta), self._count, event)
        self.theta = float(theta)

    def answer(self, task: CostToGo | Goals, goal: str | None) -> str | bool | None:
        """Return the true answer to "is this your goal?", or, if it is None, to "what did you do last?"."""
        if goal is None:
            return self.reported
        return list(prior_of(task))[self._goal(task)] == goal

    def act_unseen(self, task: CostToGo, suggestion: str | None, model: ObservationModel) -> str | None:
        """Act in the person's own state, `state`, and return what the robot sees; None if it misses the action.

        Parameters
        ----------
        task : CostToGo
        suggestion : str or None
            The suggested action, which has no effect if it is not applicable.
        model : ObservationModel
        """
        assert self.state is not None
        region = TruncatedTask.around(self._cache(task), np.array([self.state]))
        choices = region.choices
        done = self.act(task, self.state, [choices.name(0, 0)], suggestion)
        slot = next(n for n in range(choices.applicable[0].sum()) if choices.name(0, n) == done)
        self.state = int(region.states[choices.targets[0, slot]])
        seen = model.draw(choices, 0, slot, self.rng.random(2))
        if seen is None:
            return None
        self.reported = done
        return choices.action_name(seen)

    def chances(self, task: CostToGo, state: int) -> Floats:
        """Return the probability of each of the task's actions in a state, without a suggestion.

        Terms depend on the last action if it led to this state, that is, after no undo and no change of the task.
        """
        rows = task.choices([state])
        return self.human.chances(self._around(task, state, rows))[0, : len(rows.actions)]

    def _around(self, task: CostToGo, state: int, rows: Transitions, suggested: int = NOTHING) -> Choices:
        """Return the choices around a state, whose row is the first and whose slots are the task's actions there.

        Those after the suggested action are included, as trust depends on its value.
        """
        then = NONE if suggested == NOTHING else rows.targets[[suggested]]
        choices = TruncatedTask.around(self._cache(task), np.array([state]), then=then).choices
        return self._with_terms(task, state, rows, choices) if isinstance(self.human.chooses, Weighted) else choices

    def _cache(self, task: CostToGo) -> StateCache:
        """Return what is known of a task's states in which the person has been."""
        if id(task) not in self._caches:
            self._caches[id(task)] = StateCache(task)
        return self._caches[id(task)]

    def _with_terms(self, task: CostToGo, state: int, rows: Transitions, choices: Choices) -> Choices:
        """Return choices with the values of the person's terms in the first row, that of the state."""
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
        said = features(situation, {name: TERMS[name] for name in self.human.weights})
        every = np.zeros((*choices.applicable.shape, said.shape[2]))
        every[0, : said.shape[1]] = said[0]
        return replace(choices, terms=tuple(self.human.weights), features=every)
