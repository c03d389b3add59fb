"""The goals of people who pursue one of several, which the robot infers from actions, knows, or asks about."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Floats
from ..people.goals import drawn_goals, given_likeliest
from ..person.ties import NEAR, first_best
from ..team.questions import Questions, answered
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
            every = [policy.pomdp.model.choices for policy in pool.policies]
            goal = drawn_goals(every, model, random_numbers.draw(4, np.arange(len(model))))
        return cls(pool, model, goal, random_numbers, knowledge)

    def first_beliefs(self, belief: Floats) -> Floats:
        """Return the robot's first beliefs, shape (N, K, G * B, T): given the goals, if it knows them."""
        if self.knowledge != "known":
            return belief
        own = np.arange(self.pool.goals) == self.goal[:, :, None]
        given = belief * own.repeat(belief.shape[2] // self.pool.goals, axis=2)[..., None]
        return np.asarray(given / given.sum(axis=(2, 3), keepdims=True))

    def acted_on(self, belief: Floats | None) -> Floats | None:
        """Return the beliefs on which the robot acts."""
        if belief is None or self.knowledge != "likeliest":
            return belief
        return given_likeliest(belief, self.pool.goals)

    def ask(
        self, questions: Questions, active: NDArray[np.bool_], x: Ints, belief: Floats, told: Callable[..., None]
    ) -> tuple[Ints, Ints]:
        """Ask the person in each team for whom it is worth most about their goal, if it is worth its cost.

        Parameters
        ----------
        questions : Questions
        active : bool array, shape (N, K)
        x : int array, shape (N, K)
            Rows that the robot sees.
        belief : float array, shape (N, K, G * B, T)
            Replaced by the beliefs after the answers.
        told : callable
            Receives each question and its answer, as `Run.asked_about`.

        Returns
        -------
        teams, people : int arrays
            The people who were asked.
        """
        teams = np.flatnonzero(active.any(axis=1))
        attention = np.minimum(1, len(self.pool.setting.robots) / np.maximum(1, active.sum(axis=1)))
        about, worth = np.zeros(x.shape, dtype=np.int64), np.full(x.shape, -np.inf)
        for model, rows in by_model(self.model.reshape(-1), np.flatnonzero(active), len(self.pool.policies)):
            at = np.unravel_index(rows, x.shape)
            about[at], worth[at] = questions.best(self.pool.policies[model], x[at], belief[at], attention[at[0]])
        wrong = np.zeros(x.shape, dtype=bool)
        if questions.error:
            wrong[teams] = self.random_numbers.draw(7, teams)[..., :] < questions.error
        person = first_best(worth[teams])
        asks = worth[teams, person] > NEAR
        for team, k in zip(teams[asks].tolist(), person[asks].tolist(), strict=True):
            goal, yes = int(about[team, k]), bool((self.goal[team, k] == about[team, k]) != wrong[team, k])
            belief[team, k] = answered(belief[team, k], goal, self.pool.goals, yes, questions.error)
            told(team, k, goal, yes=yes, worth=float(worth[team, k]))
        return teams[asks], person[asks]
