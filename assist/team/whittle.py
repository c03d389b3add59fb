"""A team policy by Whittle indices: go where the robot's presence would be worth the highest price.

The Whittle index of a person is the constant price of a step of attention at which the robot's presence is no longer
worth it in this step (Whittle, "Restless bandits: activity allocation in a changing world", 1988). Here a person's
state is not fully observed. As in QMDP, the advantage of presence is averaged over the belief before the price is
determined. `assist.certify.coupled.whittle` computes exact indices of problems that are given as arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..people.arguments import number
from ..people.decision import Floats
from ..person.policy import Policy
from ..person.ties import NEAR
from ..person.travel import Travel
from .priority import Priority, to_the_best
from .state import TeamAction, TeamState


@dataclass(frozen=True, eq=False)
class Whittle:
    """Go to the person with the largest Whittle index; stay if that of staying is larger.

    The advantage of presence is computed at a few prices, and interpolated linearly between them. The cost of moving is
    subtracted before the index is determined. People whose index is negative are not attended to. Robots go where the
    sum of indices is largest, each to another person.

    Attributes
    ----------
    at_prices : tuple of Priority
        The value of presence at each price, in ascending order.
    """

    at_prices: tuple[Priority, ...]
    uses_belief, weighs_costs = True, True

    @classmethod
    def of(cls, policies: Sequence[Policy], travel: Travel, prices: Sequence[float] | None = None) -> Whittle:
        """Return the policy for people with the given policies and travel.

        The data about each of them are computed on first use, or by `prepare`, in a time that is proportional to the
        number of prices.

        Parameters
        ----------
        policies : sequence of Policy
        travel : Travel
        prices : sequence of float, optional
            Prices of a step of attention in ascending order, in cost units. The default is 0 and seven doublings of
            0.05 times the cost of the cheapest action, up to 3.2 times that cost.

        Raises
        ------
        ValueError
            The prices are negative or not in ascending order.
        """
        if prices is None:
            cheapest = min(policy.problem.cheapest for policy in policies)
            prices = [0.0, *(0.05 * cheapest * 2**doublings for doublings in range(7))]
        each = [number("prices", price) for price in prices]
        if not each or min(each) < 0 or (np.diff(each) <= 0).any():
            raise ValueError(f"prices {each}: expected at least one, none below 0, in ascending order")
        return cls(tuple(Priority.of(policies, travel, price) for price in each))

    def prepare(self, policy: Policy) -> None:
        """Compute now the data about the people of a policy."""
        for one in self.at_prices:
            one.prepare(policy)

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Return the action of going to the person with the largest index, or of staying, in every team."""
        return to_the_best(team, *self.worth(team))

    @property
    def base(self) -> Priority:
        """The value of presence at the lowest price."""
        return self.at_prices[0]

    def worth(self, team: TeamState) -> tuple[NDArray[np.int64], Floats, Floats]:
        """Return each robot's action towards each person and the index of going there, both (N, M, K), and of staying.

        The action is the best one at the highest price, among those computed, that is not above the index. The index of
        staying has the shape (N, M).
        """
        found = [one.worth(team) for one in self.at_prices]
        prices = np.array([one.price[0] for one in self.at_prices])
        actions = np.stack([action for action, _, _ in found], axis=-1)
        # The worth counts the price from the next step on; a robot that is present also pays for this step.
        going, below = _zero(prices, np.stack([going for _, going, _ in found], axis=-1) - prices)
        staying, _ = _zero(prices, np.stack([holding for _, _, holding in found], axis=-1) - prices)
        return np.take_along_axis(actions, below[..., None], axis=-1)[..., 0], going, staying


def _zero(prices: Floats, advantage: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Return the price at which an advantage, shape (..., J), falls to 0, and the number of the price below.

    Beyond the prices at both ends, the advantage is assumed to fall by as much as the price rises.
    """
    worth = advantage > NEAR
    last = len(prices) - 1 - worth[..., ::-1].argmax(axis=-1)
    last = np.where(worth.any(axis=-1), last, 0)
    after = np.minimum(last + 1, len(prices) - 1)
    here, there = (np.take_along_axis(advantage, at[..., None], axis=-1)[..., 0] for at in (last, after))
    inside = (here > NEAR) & (after > last)
    share = np.zeros_like(here)
    share[inside] = here[inside] / (here[inside] - there[inside])
    return np.where(inside, prices[last] + share * (prices[after] - prices[last]), prices[last] + here), last
