"""A team policy whose price of attention is determined anew at every decision: priority that re-prices itself.

`Priority` charges one price for a step of attention to all teams at all times. But attention is scarce while many
people work, and free when no more people than robots are left. Here the price follows the present states and beliefs.
Each person's problem with a robot that comes and goes (`assist.team.attention_subproblem`) is solved in advance at a
menu of prices, with observed beta and theta. At every decision, the price lambda minimises

    M lambda L  +  sum_k V_k(b_k; lambda),

the dual function of a constraint on the sum of all attention: that of M robots in the next L steps. L is the expected
number of steps in which more than M people are at work, as attention is only scarce in these. It is estimated from V_k
at price 0, since every action costs at least the cheapest one: it is the (M + 1)-th largest of the numbers of steps
that people still need. If no more people are at work than there are robots, the price is 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..people.arguments import number
from ..people.decision import Floats
from ..people.goals import acting_belief
from ..person.policy import Policy
from ..person.qmdp import QMDP, qmdp
from .attention_subproblem import AttentionSubproblem
from .by_policy import ByPolicy
from .memory_needed import require_room
from .priority import Priority, SolvedSubproblem, coming, to_the_best
from .state import BASE, Ask, TeamAction, TeamState
from .time_expansion import AWAY, HERE
from .travel import Travel


@dataclass(frozen=True)
class PriceMenu:
    """Options of the policy "prices": the prices from which it chooses, beside 0.

    Attributes
    ----------
    levels : tuple of float
        Prices of a step of attention, as multiples of the cost of the cheapest action. The times of preparation and of
        a decision are proportional to their number. The default covers the prices of bounds for teams of 2 to 100.
    """

    levels: tuple[float, ...] = (0.05, 0.1, 0.2, 0.4, 0.8)

    def __post_init__(self) -> None:
        if not self.levels or min(number("levels", level) for level in self.levels) <= 0:
            raise ValueError(f"levels {self.levels}: expected one or more multiples above 0")


@dataclass(frozen=True, eq=False)
class MenuValues:
    """One person's problem with a robot that comes and goes, solved at every price of a menu.

    Attributes
    ----------
    value : float array, shape (n, 2 * J, B * T)
        Values with the robot away at each of the J prices, followed by those with the robot here.
    solved : tuple of SolvedSubproblem
        The solution at each price.
    """

    value: Floats
    solved: tuple[SolvedSubproblem, ...]

    @classmethod
    def of(cls, free: AttentionSubproblem, prices: Sequence[float]) -> MenuValues:
        """Solve a subproblem at each price, in ascending order from 0."""
        require_room(free.alone, free.layout, len(prices))
        policies: list[QMDP] = []
        for price in prices:  # values fall with the price, so that those at the last one are upper bounds
            policies.append(qmdp(free.at_price(price), above=policies[-1].value_mdp if policies else None))
        numbers = [free.states(0, position) for position in (AWAY, HERE)]
        value = np.stack([one.value_mdp[own] for own in numbers for one in policies], axis=1)
        solved = tuple(SolvedSubproblem.of(free, one) for one in policies)
        return cls(value.reshape(*value.shape[:2], -1), solved)

    def expected(self, rows: NDArray[np.int64], belief: Floats, at_once: int = 2048) -> Floats:
        """Return the expected values, shape (N, 2 * J), in states, shape (G, N), of each goal."""
        found = np.zeros((rows.shape[1], self.value.shape[1]))
        weight = belief.reshape(rows.shape[1], len(rows), self.value.shape[2])
        for first in range(0, len(found), at_once):  # the values of all people at once may exceed the memory
            part = slice(first, first + at_once)
            for goal, states in enumerate(rows):
                found[part] += (self.value[states[part]] @ weight[part, goal, :, None])[:, :, 0]
        return found


@dataclass(frozen=True, eq=False)
class Repriced:
    """Priority at the price that minimises the dual function, determined at every decision.

    Attributes
    ----------
    menu : PriceMenu
    cheapest : float
        Cost of the cheapest action.
    prices : float array, shape (J,)
        The menu in ascending order, in cost units; the first is 0.
    at_prices : tuple of Priority
        The value of presence at each price.
    known : ByPolicy of MenuValues
    """

    menu: PriceMenu
    cheapest: float
    prices: Floats
    at_prices: tuple[Priority, ...]
    known: ByPolicy[MenuValues]
    uses_belief = True

    @classmethod
    def of(cls, policies: Sequence[Policy], travel: Travel, menu: PriceMenu | None = None) -> Repriced:
        """Return the policy for people with the given policies and travel.

        The data about each of them are computed on first use, or by `prepare`.

        Parameters
        ----------
        policies : sequence of Policy
        travel : Travel
        menu : PriceMenu, optional

        Raises
        ------
        ValueError
            A policy is one for a truncated task.
        """
        menu = menu or PriceMenu()
        for policy in policies:
            policy.require_enumerated("policy 'prices'")
        cheapest = min(policy.cheapest for policy in policies)
        prices = [0.0, *(level * cheapest for level in sorted(set(menu.levels)))]
        entry, entry_steps, longest = coming(travel)

        def solutions(policy: Policy) -> MenuValues:
            free = AttentionSubproblem.of(policy.pomdp, entry, entry_steps, longest=longest)
            return MenuValues.of(free, prices)

        known = ByPolicy(policies, solutions)

        def at(place: int, price: float) -> Priority:
            own = ByPolicy(policies, lambda policy: known[policy].solved[place])
            return Priority(entry, entry_steps, longest, np.array([price]), own)

        at_prices = tuple(at(place, price) for place, price in enumerate(prices))
        return cls(menu, cheapest, np.array(prices), at_prices, known)

    def with_policies(self, policies: Sequence[Policy], travel: Travel) -> Repriced:
        """Return the same team policy, with the same menu, with other policies for single people."""
        return Repriced.of(policies, travel, self.menu)

    def prepare(self, policy: Policy) -> None:
        """Compute now the data about the people of a policy."""
        self.known[policy]

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Return the action of going to the best person, or of staying, in every team, at its own price."""
        chosen = self.chosen(team)
        prices, first = np.unique(chosen), self.at_prices[chosen[0]].worth(team)
        for place in prices[prices != chosen[0]].tolist():
            for values, own in zip(first, self.at_prices[place].worth(team), strict=True):
                values[chosen == place] = own[chosen == place]
        return to_the_best(team, *first)

    def chosen(self, team: TeamState) -> NDArray[np.int64]:
        """Return the number of each team's price in the menu, shape (N,): 0 where attention is free."""
        scarce = team.active.sum(axis=1) > team.robots
        if not scarce.any():
            return np.zeros(len(team.x), dtype=np.int64)
        value = np.where(team.active[:, :, None], team.of_each(self._ask), 0.0)
        away, here = np.split(value[:, :, : 2 * len(self.prices)], 2, axis=2)
        steps = np.sort(-away[:, :, 0] / self.cheapest, axis=1)[:, -1 - team.robots]
        dual = away.sum(axis=1) + team.robots * steps[:, None] * self.prices
        location = team.location.reshape(len(team.x), team.robots)
        n, m = np.nonzero(location != BASE)
        k = location[n, m]
        np.add.at(dual, n, here[n, k] - away[n, k])
        # Values are exact within the tolerance of value iteration, and so is a tie.
        lowest = (dual <= dual.min(axis=1, keepdims=True) + 1e-5).argmax(axis=1)
        return np.where(scarce, lowest, 0)

    @cached_property
    def _ask(self) -> Ask:
        """The question about people; one object, as a live team caches answers by the question."""
        return self._values

    def _values(self, policy: Policy, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Return the values at each price, with zeros in the last columns, where a question has suggestions."""
        choices = policy.pomdp.model.choices
        values = self.known[policy].expected(choices.of_goals(x), acting_belief(choices, belief))
        return np.pad(values, ((0, 0), (0, policy.pomdp.suggested.shape[1] - 1)))
