r"""An upper bound that holds the resource to its limit in every step, from sample paths: an information relaxation.

The bound of `price_bound` enforces the limit M in expectation. Here it holds in every step, but all random outcomes are
known in advance. A penalty with mean 0 for every policy without this knowledge makes up for it (Brown, Smith and Sun,
"Information relaxations and duality in stochastic dynamic programs", 2010).

Assumptions. Those of `price_bound`. Prices lambda >= 0 are 0 from step W on, and V_k,t are the values of single
agents at these prices. Let V_t(s) = M sum_{i >= t} gamma^(i - t) lambda_i + sum_k V_k,t(s_k), and

    D_t(s, a) = V_t(s) - sum_k r_k(s_k, a_k) - gamma E[V_{t+1}(s') | s, a]
              = lambda_t (M - sum_k u_k(s_k, a_k)) + sum_k d_k,t(s_k, a_k),

where d_k,t >= 0 is agent k's loss by the action, at the prices, against the best one.

Claim. The expected discounted reward of every policy is at most

    E[V_0(s_0)] - E[ min over a_0, ..., a_{W-1} with sum_k u_k(s_k, a_k) <= M of sum_{t < W} gamma^t D_t(s_t, a_t) ],

where the minimum is over all actions on a sample path, which fixes each agent's next state by step, state and action.

Proof. For a policy without knowledge of the future, the sum over t < W of gamma^(t+1) (V_{t+1}(s_{t+1}) -
E[V_{t+1} | s_t, a_t]) has mean 0. Its expected reward is at most that of the first W steps plus gamma^W V_W(s_W), since
V_W is an upper bound from step W on. After subtraction of that sum, by the definition of D, this is E[V_0(s_0)] -
E[sum_{t < W} gamma^t D_t]. On every sample path the last sum is at least its minimum.

**The minimum** is computed over joint states if they are few. Otherwise prices of the sample path bound it from below:
for all mu_t >= 0, adding mu_t (sum_k u_k - M) <= 0 to D_t separates the agents. The result is a bound in both cases.
(Ye, Zhu and Zhou, "Weakly coupled dynamic program: information and Lagrangian relaxations", arXiv 1405.3363, 2014.)

**Time limits.** The number of paths may depend on the time that they take, as that tells nothing of their values: the
minimum takes the same operations on each path, in all states and for all actions, whatever comes of them. To draw a
next state takes longer the later it stands in its row; that is a small part of the time, and is neglected. (In
`information_relaxation` a path's time does depend on its value. There the number is decided beforehand.)
"""

from __future__ import annotations

import numpy as np

from planner.system.jit import njit
from planner.system.limits import Deadline

from ...people.arguments import Seed, entropy, whole
from ..information_relaxation.confidence import SampledBound
from .agents import Agents, Floats, Ints, units
from .price_bound import PriceBound, bound_for


def sampled_bound(
    agents: Agents, resources: float, *, paths: int = 100, seed: Seed = 0, solved: PriceBound | None = None,
    largest: int = 5_000, time_limit: float | None = None,
) -> SampledBound:  # fmt: skip
    """Return an upper bound on the value of every policy from sample paths; it holds with 95 % confidence.

    Parameters
    ----------
    agents, resources
        As in `bound`.
    paths : int
        Number of sample paths; at least 30 for a bound.
    seed : int or numpy.random.Generator
    solved : PriceBound, optional
        The bound with its prices. Default: `bound(agents, resources)`.
    largest : int
        Largest number of joint states up to which the best actions on a sample path are computed exactly. Three agents
        of 14 states, with two actions, take about 40 ms a path.
    time_limit : float, optional
        Seconds, half of which the prices may take. Then no further path begins, once there are two; with fewer than 30,
        `enough` is false, and `upper` is no bound.

    Raises
    ------
    ValueError
        An argument is invalid, or the bound is for other units of the resource.
    """
    limit = units(resources)
    count, joint = whole("paths", paths, 2), whole("largest", largest, 1)
    ends = Deadline.after(time_limit)
    solved = bound_for(agents, limit, solved, time_limit=None if time_limit is None else time_limit / 2)
    W, (_, A, S) = len(solved.prices), agents.shape
    reward, use, may = agents.flat
    loss = np.empty((W, *reward.shape))
    for t, price in enumerate(solved.prices):
        ahead = agents.gamma * (agents.P @ solved.at(t + 1)).reshape(reward.shape)
        loss[t] = np.where(may, np.maximum(solved.at(t) - reward + price * use - ahead, 0.0), np.inf)
    chance, successor = agents.successors(solved.at(W))
    of = agents.kind[:, None] * S + np.arange(S)  # the rows of each agent
    use, loss = np.ascontiguousarray(use[:, of]), np.ascontiguousarray(loss[:, :, of])
    row = np.arange(A)[:, None, None] * reward.shape[1] + of
    begin = np.cumsum(agents.initial, axis=1)
    begin[:, -1] = np.inf
    found, exact = list[float](), S ** len(agents) <= joint
    for rng in np.random.default_rng(entropy(seed)).spawn(count):
        if len(found) >= 2 and ends.passed:
            break
        start = (begin <= rng.random((len(agents), 1))).sum(axis=1)
        to = _successors(rng.random((W, len(agents))), row, chance, successor)
        if exact:
            least = _least(start, to, loss, use, solved.prices, limit, agents.room(limit), agents.gamma)
        else:
            least = _least_at_prices(start, to, loss, use, solved.prices, limit, agents.gamma)
        found.append(solved.upper - least)
    return SampledBound.of(found, len(found), 0.0)


@njit()
def _successors(uniform: Floats, row: Ints, chance: Floats, successor: Ints) -> Ints:
    """Return the next state of each agent after each action in each state, shape (W, A, N, S)."""
    A, N, S = row.shape
    to = np.empty((len(uniform), A, N, S), np.int64)
    for t in range(len(uniform)):
        for a in range(A):
            for k in range(N):
                for s in range(S):
                    which = 0
                    while chance[row[a, k, s], which] <= uniform[t, k]:
                        which += 1
                    to[t, a, k, s] = successor[row[a, k, s], which]
    return to


@njit()
def _least(
    start: Ints, to: Ints, loss: Floats, use: Floats, price: Floats, limit: float, room: float, gamma: float
) -> float:  # fmt: skip
    """Return the least discounted sum of D on a sample path, by all joint actions in all joint states."""
    W, A, N, S = to.shape
    ahead, here = np.zeros(S**N), np.empty(S**N)
    state = np.empty(N, np.int64)
    for t in range(W - 1, -1, -1):
        for joint in range(S**N):
            rest = joint
            for k in range(N):
                state[k] = rest % S
                rest //= S
            here[joint] = np.inf
            for action in range(A**N):
                rest, used, total, then, digit = action, 0.0, 0.0, 0, 1
                for k in range(N):
                    a = rest % A
                    rest //= A
                    used += use[a, k, state[k]]
                    total += loss[t, a, k, state[k]]
                    if used > room:
                        total = np.inf
                    if total == np.inf:
                        break
                    then += digit * to[t, a, k, state[k]]
                    digit *= S
                if total < np.inf:
                    here[joint] = min(here[joint], total + price[t] * (limit - used) + gamma * ahead[then])
        ahead, here = here, ahead
    joint, digit = 0, 1
    for k in range(N):
        joint += digit * start[k]
        digit *= S
    return ahead[joint]


@njit()
def _least_at_prices(
    start: Ints, to: Ints, loss: Floats, use: Floats, price: Floats, limit: float, gamma: float
) -> float:  # fmt: skip
    """Return a lower bound on that sum at the best prices of the sample path that a subgradient method finds.

    With mu_t = lambda_t + x_t >= 0, agent k pays x_t for each unit, and -M x_t is paid in each step.
    """
    W, A, N, S = to.shape
    x, past, best = np.zeros(W), np.full(W, 1e-12), -np.inf
    chosen, ahead, here = np.empty((W, S), np.int64), np.empty(S), np.empty(S)
    scale = max(1e-12, price.max())
    for _ in range(60):  # rounds; any prices give a bound
        total, used, discount = 0.0, np.zeros(W), 1.0
        for t in range(W):
            total -= discount * limit * x[t]
            discount *= gamma
        for k in range(N):
            ahead[:] = 0.0
            for t in range(W - 1, -1, -1):
                for s in range(S):
                    here[s] = np.inf
                    for a in range(A):
                        cost = loss[t, a, k, s] + x[t] * use[a, k, s] + gamma * ahead[to[t, a, k, s]]
                        if cost < here[s]:
                            here[s], chosen[t, s] = cost, a
                ahead, here = here, ahead
            total += ahead[start[k]]
            s = start[k]
            for t in range(W):
                used[t] += use[chosen[t, s], k, s]
                s = to[t, chosen[t, s], k, s]
        best = max(best, total)
        for t in range(W):
            slope = used[t] - limit
            past[t] += slope**2
            x[t] = max(-price[t], x[t] + 0.3 * scale * slope / np.sqrt(past[t]))
    return best
