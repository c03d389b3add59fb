r"""An upper bound on the value of every policy, by a Lagrangian relaxation with one price per step.

Assumptions. N agents are Markov decision processes with discount factor 0 <= gamma < 1 and bounded rewards. Given
their states and actions, agents move independently. A policy chooses all actions from all that has been observed, and
uses at most M units of the resource at each step: sum_k u_k(s_k, a_k) <= M.

Claim. For all prices lambda_t >= 0, the expected discounted reward J of every such policy satisfies

    J <= M sum_t gamma^t lambda_t + sum_k V_k(lambda),

where V_k(lambda) is the optimal value of agent k alone with reward r_k - lambda_t u_k at step t. The right side is
convex in the prices. Its smallest value over all price vectors is that of the linear program in which the resource
constraint holds in expectation at each step.

Proof. As lambda_t >= 0 and the policy keeps to M, adding lambda_t (M - sum_k u_k) >= 0 to the reward of each step
does not lower the expected value. The new value is M sum_t gamma^t lambda_t plus the sum over agents of their
expected discounted r_k - lambda_t u_k. In the joint process, agent k follows a policy that depends on the others'
histories too. Those are independent of the moves of agent k given its state and action, so they serve only to
randomise its actions. A randomised policy of one agent is at most as good as the best one, hence each term is at most
V_k(lambda). Each V_k is a maximum of functions that are linear in the prices, so the bound is convex. The minimum over
the prices is the Lagrangian dual of the linear program over the agents' discounted occupancy measures with one
constraint per step. That program is feasible, as every state has an action that uses nothing, and bounded, so
strong duality holds.

Prices are 0 after a window of W steps. The claim holds for these prices like for any other. (Hawkins, "A Langrangian
decomposition approach to weakly coupled dynamic optimization problems and its applications", 2003; Adelman and
Mersereau, "Relaxations of weakly coupled stochastic dynamic programs", 2008.)
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits

from planner.system.arrays import outline, read_only
from planner.system.limits import Deadline

from ...people.arguments import positive, whole
from ...person.rounding import rounding
from .agents import Agents, Floats, units


@dataclass(frozen=True)
class PriceOptions:
    """Effort of the search for prices.

    Attributes
    ----------
    first_window : int
        Number of steps with prices at first; it is doubled while the last prices are positive.
    temperatures : tuple of float
        Temperatures of the smoothed maximum, in this order, as shares of the largest difference of rewards.
    updates : float
        Largest number of updates of a state at all temperatures. The default takes about half a minute.

    Raises
    ------
    ValueError
        A field is not positive, or there is no temperature.
    """

    first_window: int = 64
    temperatures: tuple[float, ...] = (0.1, 0.01, 0.001, 0.0001)
    updates: float = 8e9

    def __post_init__(self) -> None:
        whole("first_window", self.first_window, 1)
        positive("updates", self.updates)
        if not self.temperatures:
            raise ValueError("temperatures: expected at least one")
        for temperature in self.temperatures:
            positive("temperatures", temperature)


@dataclass(frozen=True, eq=False)
class PriceBound:
    """An upper bound, with its prices and values.

    Attributes
    ----------
    upper : float
        Upper bound on the expected discounted reward of every policy.
    prices : float array, shape (W,)
        Price of a unit of the resource at each step; 0 afterwards.
    values : float array, shape (W + 1, K, S)
        Optimal values of single agents at these prices. The last are those without prices, from step W on.
    resources : float
        Units of the resource at each step.
    used : float array, shape (W,)
        Expected units used at each step when every agent follows its own optimal policy at the prices.
    """

    upper: float
    prices: Floats
    values: Floats
    resources: float
    used: Floats = field(repr=False)

    __repr__ = outline

    def __post_init__(self) -> None:
        read_only(self)

    def at(self, step: int) -> Floats:
        """Return the values from a step on, shape (K * S,)."""
        return self.values[min(step, len(self.prices))].reshape(-1)


def horizon(gamma: float, remainder: float = 1e-6) -> int:
    """Return the number of steps after which at most the share `remainder` of the largest possible reward is left."""
    return 1 if gamma == 0 else max(1, math.ceil(math.log(remainder) / math.log(gamma)))


def free_values(agents: Agents) -> Floats:
    """Return an upper bound on single agents' values without prices, shape (K * S,), by value iteration.

    The distance from the optimum is at most about 1e-9 of the largest value.
    """
    largest = max(1e-300, float(abs(agents.R).max()))
    values = np.zeros(agents.weight.shape)
    while True:
        new = agents.look_ahead(values).max(axis=0)
        change = float(abs(new - values).max())
        values = new
        if change * agents.gamma <= 1e-9 * largest:
            return values + change * agents.gamma / (1 - agents.gamma)


def bound(
    agents: Agents, resources: float, *, window: int | None = None, prices: Floats | None = None,
    options: PriceOptions = PriceOptions(), time_limit: float | None = None,
) -> PriceBound:  # fmt: skip
    """Return the Lagrangian bound at optimised prices, one per step.

    Prices minimise a smoothed bound at decreasing temperatures by L-BFGS-B. The result is the bound without
    smoothing at these prices, so that it is valid however good they are.

    Parameters
    ----------
    agents : Agents
    resources : float
        Units of the resource at each step, 0 or more.
    window : int, optional
        Number of steps with prices. Default: `options.first_window`, doubled while the last prices are positive.
    prices : float array, shape (W,), optional
        Prices to use as they are, 0 or more.
    options : PriceOptions
    time_limit : float, optional
        Seconds after which prices are not improved any more. The bound is that at the best ones so far.

    Raises
    ------
    ValueError
        An argument is invalid.
    """
    limit = units(resources)
    ends, tail = Deadline.after(time_limit), free_values(agents)
    if prices is not None:
        given = np.asarray(prices, dtype=float)
        if given.ndim != 1 or not np.isfinite(given).all() or (given < 0).any():
            raise ValueError("prices: expected a vector of finite numbers of 0 or more")
        return _bound_at(agents, limit, given, tail)
    longest = horizon(agents.gamma)
    steps = min(options.first_window, longest) if window is None else whole("window", window, 1)
    scale, heats = float(np.ptp(agents.R)) or 1.0, options.temperatures
    found = np.zeros(steps)
    while window is None:
        found = _optimised(agents, limit, found, tail, options, heats[:1], scale, ends)
        if ends.passed or found[-max(1, len(found) // 8) :].max() <= 1e-3 * scale or len(found) >= longest:
            break
        found = np.pad(found, (0, min(len(found), longest - len(found))))
    found = _optimised(agents, limit, found, tail, options, heats if window else heats[1:], scale, ends)
    return _bound_at(agents, limit, found, tail)


def bound_for(
    agents: Agents, resources: float, given: PriceBound | None, *, time_limit: float | None = None
) -> PriceBound:
    """Return a given bound, or compute one.

    Raises
    ------
    ValueError
        The given one is for other units of the resource, for which its value and its prices may be too low.
    """
    if given is None:
        return bound(agents, resources, time_limit=time_limit)
    if given.resources != resources:
        raise ValueError(f"resources {resources:g}: expected {given.resources:g}, as the given bound is for")
    return given


def backwards(
    agents: Agents, may: NDArray[np.bool_], price: Floats, tail: Floats, heat: float = 0.0
) -> tuple[Floats, Floats]:
    """Solve all agents' problems backwards from values `tail` after the last price.

    With `heat` > 0 the maximum over actions is heat log sum exp(Q / heat), and choices are its derivatives. `may` are
    the actions to consider, shape (A, n).

    Returns
    -------
    values : float array, shape (W + 1, n)
    chosen : float array, shape (W, A, n)
        Probability of each action.
    """
    reward, use, _ = agents.flat
    reward, actions = np.where(may, reward, -np.inf), np.arange(len(reward))[:, None]
    values, chosen = np.empty((len(price) + 1, len(tail))), np.empty((len(price), *reward.shape))
    values[-1] = tail
    for t in range(len(price) - 1, -1, -1):
        q = reward - price[t] * use + agents.gamma * (agents.P @ values[t + 1]).reshape(reward.shape)
        values[t] = best = q.max(axis=0)
        if heat:
            share = np.exp((q - best) / heat)
            total = share.sum(axis=0)
            chosen[t] = share / total
            values[t] += heat * np.log(total)
        else:
            chosen[t] = actions == q.argmax(axis=0)
    return values, chosen


def expected_uses(agents: Agents, chosen: Floats) -> Floats:
    """Return the expected units used at each step, shape (W,), if all agents choose with these probabilities."""
    use, now, found = agents.flat[1], agents.weight, np.empty(len(chosen))
    for t, choice in enumerate(chosen):
        share = now * choice
        found[t] = (share * use).sum()
        now = share.reshape(-1) @ agents.P
    return found


def _bound_at(agents: Agents, limit: float, prices: Floats, tail: Floats) -> PriceBound:
    """Return the bound at given prices."""
    values, chosen = backwards(agents, agents.flat[2], prices, tail)
    reward, use, _ = agents.flat
    K, _, S = agents.shape
    paid = limit * float(agents.gamma ** np.arange(len(prices)) @ prices)
    # Each backup and each sum is rounded; what an agent gets or pays in a step is at most `largest`.
    largest = float(abs(reward).max() + abs(values).max() + use.max() * prices.max(initial=0.0))
    margin = rounding(S) * len(agents) * largest / (1 - agents.gamma) + rounding(len(prices)) * paid
    upper = float(agents.weight @ values[0]) + paid + margin
    used = expected_uses(agents, chosen)
    return PriceBound(upper, prices, values.reshape(-1, K, S), float(limit), used)


def _optimised(
    agents: Agents, limit: float, prices: Floats, tail: Floats, options: PriceOptions, heats: tuple[float, ...],
    scale: float, ends: Deadline,
) -> Floats:  # fmt: skip
    """Return prices that minimise the smoothed bound, at each temperature from the result of the one before.

    In a state that nothing leaves and that has no rewards, all actions without the resource are optimal at any prices.
    There the others are forbidden, since the smoothed maximum would use the resource for nothing.
    """
    reward, use, may = agents.flat
    may = may & ~(agents.finished() & (use > 0))
    discount = agents.gamma ** np.arange(len(prices))
    # The bound is divided by the scale of rewards, so that the stopping rule does not depend on their unit.
    updates = max(10, int(options.updates / (len(heats) * len(prices) * 10 * reward.size)))

    def smoothed(x: Floats, heat: float) -> tuple[float, Floats]:
        price = x * scale
        values, chosen = backwards(agents, may, price, tail, heat * scale)
        uses = expected_uses(agents, chosen)
        value = agents.weight @ values[0] + limit * (discount @ price)
        return float(value / scale), discount * (limit - uses)

    def stop(_: Floats) -> None:
        if ends.passed:
            raise StopIteration  # which ends the search with the prices so far

    x = prices / scale
    # L-BFGS-B factorises matrices of at most 40 rows, on which several threads of the library take ten times as long.
    with threadpool_limits(1, user_api="blas"):
        for heat in heats:
            if ends.passed:
                break
            x = minimize(
                smoothed, x, args=(heat,), jac=True, method="L-BFGS-B", bounds=[(0, None)] * len(x),
                callback=cast(Any, stop),
                options={"maxfun": min(400, updates), "maxcor": 20, "ftol": 1e-8, "gtol": 1e-5},
            ).x  # fmt: skip
    found: Floats = x * scale
    return found
