"""The goals of people who pursue one of several, which the robot infers from actions, knows, or asks about."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Floats
from ..people.hidden_type import HiddenType, drawn_goals
from ..person.beliefs import Beliefs, Seen
from ..person.ties import NEAR, first_best
from ..team.questions import Questions, likelihood_of
from ..team.state import by_model
from .common_random_numbers import CommonRandomNumbers
from .pool import Pool

GoalKnowledge = Literal["inferred", "likeliest", "known"]

Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class HiddenGoals:
    """The goals of N teams of K people, and what the robot knows of them.

    Attributes
    ----------
    pool : Pool
    model : int array, shape (N, K)
        Model of each person.
    goal : int array, shape (N, K)
        Number of each person's goal.
    random_numbers : CommonRandomNumbers
    knowledge : GoalKnowledge
        As in `simulate`.
    """

    pool: Pool
    model: Ints
    goal: Ints
    random_numbers: CommonRandomNumbers
    knowledge: GoalKnowledge

    @classmethod
    def of(
        cls, pool: Pool, model: Ints, goal: Ints | None, random_numbers: CommonRandomNumbers, knowledge: GoalKnowledge
    ) -> HiddenGoals:
        """Return people's goals: those given, or ones that are drawn from the prior of each model."""
        if goal is None:
            priors = [policy.pomdp.hidden.goals for policy in pool.policies]
            goal = drawn_goals(priors, model, random_numbers.draw(4, np.arange(len(model))))
        return cls(pool, model, goal, random_numbers, knowledge)

    @property
    def hidden(self) -> HiddenType:
        """The types of the people; all have as many goals."""
        return self.pool.policies[0].pomdp.hidden

    def first_beliefs(self, belief: Floats) -> Floats:
        """Return the robot's first beliefs, shape (N, K, H, T): given the goals, if it knows them."""
        if self.knowledge != "known":
            return belief
        given = self.hidden.given_goal(belief, np.arange(len(self.hidden.goals)) == self.goal[:, :, None])
        return np.asarray(given / given.sum(axis=(2, 3), keepdims=True))

    def acted_on(self, known: Beliefs) -> Beliefs:
        """Return the beliefs on which the robot acts."""
        if self.knowledge != "likeliest" or not len(known.belief):
            return known
        return Seen(known.x, self.hidden.given_likeliest(known.belief), known.erred)

    def ask(
        self, questions: Questions, active: NDArray[np.bool_], beliefs: Beliefs, told: Callable[..., None]
    ) -> tuple[Ints, Ints]:
        """Ask the person in each team for whom it is worth most about their goal, if it is worth its cost.

        Parameters
        ----------
        questions : Questions
        active : bool array, shape (N, K)
        beliefs : Beliefs
            Replaced by those after the answers.
        told : callable
            Receives each question and its answer, as `Run.asked_about`.

        Returns
        -------
        teams, people : int arrays
            The people who were asked.
        """
        teams = np.flatnonzero(active.any(axis=1))
        attention = np.minimum(1, len(self.pool.setting.robots) / np.maximum(1, active.sum(axis=1)))
        about, worth = np.zeros(active.shape, dtype=np.int64), np.full(active.shape, -np.inf)
        for model, rows in by_model(self.model.reshape(-1), np.flatnonzero(active), len(self.pool.policies)):
            at = np.unravel_index(rows, active.shape)
            about[at], worth[at] = questions.best(
                self.pool.policies[model], beliefs.x[rows], beliefs.belief[rows], attention[at[0]]
            )
        wrong = np.zeros(active.shape, dtype=bool)
        if questions.error:
            wrong[teams] = self.random_numbers.draw(7, teams)[..., :] < questions.error
        person = first_best(worth[teams])
        asks = worth[teams, person] > NEAR
        for team, k in zip(teams[asks].tolist(), person[asks].tolist(), strict=True):
            goal, yes = int(about[team, k]), bool((self.goal[team, k] == about[team, k]) != wrong[team, k])
            beliefs.told(team * active.shape[1] + k, likelihood_of(goal, self.hidden, yes, questions.error))
            told(team, k, goal, yes=yes, worth=float(worth[team, k]))
        return teams[asks], person[asks]
