"""One person's assistance problem as a mixed-observability POMDP.

The task's state x is observed; (beta, theta) is hidden on a `Grid`. In each step the robot says nothing
or suggests an action, the person acts, and x moves. An `AssistPOMDP` holds the arrays from which a
solver works and gives the two functions that a filter needs: the likelihood of what a person did, and
the belief after it.

The robot's actions in a state are numbered from 0: nothing, then the suggestions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from . import belief as beliefs
from .belief import Grid
from .human import NOTHING, Floats, HumanModel, Mixture, Population, choice, perceived_value, trust

Suggestions = Literal["optimal", "all"]


@dataclass(frozen=True)
class AssistPOMDP:
    """The problem of assisting one person.

    Attributes
    ----------
    model : HumanModel
    grid : Grid
        The hidden values, B of beta and T of theta.
    gamma : float
        Discount factor per step, in (0, 1).
    c_suggest : float
        Cost of a suggestion, in the task's cost units.
    prior : float array, shape (B, T)
    suggested : int array, shape (n, 1 + S)
        Slot that each robot action suggests; column 0, and padding, is `NOTHING`.
    chosen : float array, shape (n, A, B)
        The person's choice without a suggestion and without lapses.
    low, weight : int and float arrays, shape (n, 1 + S, T)
        Where a robot action moves theta to, as `Grid.shares` gives it.
    """

    model: HumanModel
    grid: Grid
    gamma: float
    c_suggest: float
    prior: Floats
    suggested: NDArray[np.int64]
    chosen: Floats
    low: NDArray[np.int64]
    weight: Floats

    def __post_init__(self) -> None:
        for array in (self.prior, self.suggested, self.chosen, self.low, self.weight):
            array.flags.writeable = False

    @classmethod
    def of(
        cls,
        model: HumanModel,
        *,
        grid: Grid | None = None,
        population: Population | Mixture | None = None,
        gamma: float = 0.99,
        c_suggest: float = 0.5,
        suggestions: Suggestions = "optimal",
    ) -> AssistPOMDP:
        """Set up the problem for a person drawn from a population (the paper's, unless given).

        Parameters
        ----------
        suggestions : "optimal" or "all"
            Suggest only actions that begin a cheapest way to the goal, or any applicable action.
        """
        if not 0 < gamma < 1:
            raise ValueError(f"gamma {gamma:g}: expected 0 < gamma < 1")
        if not 0 <= c_suggest < np.inf:
            raise ValueError(f"c_suggest {c_suggest:g}: expected 0 or more")
        population = population or Population()
        grid = grid or Grid.regular(population)
        choices = model.choices
        offered = choices.optimal if suggestions == "optimal" else choices.applicable & (choices.actions >= 0)
        offered = offered & ~choices.goal[:, None]
        suggested = np.full((len(choices), 1 + int(offered.sum(axis=1).max(initial=0))), NOTHING, dtype=np.int64)
        state, slot = np.nonzero(offered)
        suggested[state, 1 + (np.cumsum(offered, axis=1) - 1)[state, slot]] = slot

        chosen = np.stack([choice(model.q, choices.applicable, beta) for beta in grid.beta], axis=-1)
        value = perceived_value(choices, model.q)
        # Without a suggestion the person expects to stay where they are, so that theta does not move.
        after = np.where(
            suggested == NOTHING,
            np.arange(len(choices))[:, None],
            np.take_along_axis(choices.targets, np.maximum(suggested, 0), axis=1),
        )
        theta = trust(grid.theta, value[:, None, None], value[after][:, :, None], model.eta, model.utility_scale)
        low, weight = grid.shares(theta)
        return cls(model, grid, gamma, c_suggest, grid.prior(population), suggested, chosen, low, weight)

    def likelihood(self, x: NDArray[np.int64], robot: NDArray[np.int64], action: NDArray[np.int64]) -> Floats:
        """Give P(action | x, robot, beta, theta), shape (N, B, T).

        Parameters
        ----------
        x, robot, action : int arrays, shape (N,)
            State, the robot's action (0: nothing), and the slot of what the person did.
        """
        suggestion = self.suggested[x, robot]
        p = self.chosen[x, action][:, :, None]
        followed = self.chosen[x, np.maximum(suggestion, 0)][:, :, None]
        theta = self.grid.theta
        total = theta * followed + (1 - theta) * (1 - followed)
        weight = np.where((action == suggestion)[:, None, None], theta, 1 - theta)
        heard = (suggestion != NOTHING)[:, None, None] & (total > 0)
        influenced = np.divide(
            weight * p, total, out=np.zeros(np.broadcast_shapes(p.shape, total.shape)), where=total > 0
        )
        likelihood = np.where(heard, influenced, p)
        count = self.model.choices.applicable[x].sum(axis=1)[:, None, None]
        return (1 - self.model.lapse) * likelihood + self.model.lapse / count

    def update(
        self, belief: Floats, x: NDArray[np.int64], robot: NDArray[np.int64], action: NDArray[np.int64]
    ) -> Floats:
        """Give the beliefs, shape (N, B, T), after people's actions; arguments as in `likelihood`."""
        return beliefs.update(belief, self.likelihood(x, robot, action), self.low[x, robot], self.weight[x, robot])

    @cached_property
    def first_optimal(self) -> NDArray[np.int64]:
        """The first robot action of each state that suggests an optimal action, shape (n,); 0: there is none."""
        slot = np.maximum(self.suggested, 0)
        good = (self.suggested != NOTHING) & np.take_along_axis(self.model.choices.optimal, slot, axis=1)
        return good.argmax(axis=1)

    def suggestion(self, x: int, robot: int) -> str | None:
        """Name in PDDL what a robot action suggests; None for nothing."""
        slot = int(self.suggested[x, robot])
        return None if slot == NOTHING else self.model.choices.name(x, slot)
