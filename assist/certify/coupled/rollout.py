r"""Rollout: one step of policy improvement by simulation, on a policy that goes by gains per unit of the resource.

At a joint state the base policy's actions are compared with some alternatives. Each alternative takes one pair of agent
and action first that the base policy leaves out, or leaves out one that it takes; the rest of the resource goes by
gains. The base policy acts from the next step on.

An alternative's value is measured by advantages rather than by rewards. With the values V_t and the action values Q_t
of single agents at the prices of a bound,

    sum_{h<H} gamma^h r(x_h, a_h) + gamma^H V_H(x_H) = V_0(x_0) + sum_{h<H} gamma^h (Q_h(x_h, a_h) - V_h(x_h)) + D,

summed over agents, where D is a discounted sum of differences V_{h+1}(x_{h+1}) - E[V_{h+1}(x_{h+1}) | x_h, a_h], whose
mean is 0. The sum of advantages Q - V therefore has the same mean as the rewards with V after the last step, and the
part of the variance that V explains is gone. All alternatives meet the same random numbers. One replaces the base
policy's actions only if its mean is higher by a number of standard errors. (Bertsekas, Tsitsiklis and Wu, "Rollout
algorithms for combinatorial optimization", Journal of Heuristics 3, 1997.)
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.system.arrays import outline, read_only
from planner.system.jit import njit

from .agents import Floats, Ints
from .index_policy import IndexPolicy
from .price_bound import PriceBound


@dataclass(frozen=True)
class RolloutOptions:
    """Effort of a rollout policy at one joint state.

    On fleets of three to five robots, more sample paths, longer ones or a stricter comparison brought less or nothing.

    Attributes
    ----------
    samples : int
        Sample paths of each alternative.
    horizon : int
        Steps of a sample path. The bound's values stand for later steps.
    alternatives : int
        Alternatives at most to the base policy's actions.
    errors : float
        Standard errors by which an alternative has to be better.
    seed : int
        Seed of the sample paths. At the same step and joint state, the policy always takes the same actions.
    """

    samples: int = 100
    horizon: int = 10
    alternatives: int = 4
    errors: float = 1.0
    seed: int = 0


@dataclass(frozen=True, eq=False)
class RolloutPolicy:
    """A policy that improves on a base policy by simulation.

    Attributes
    ----------
    base : IndexPolicy
    solved : PriceBound
        The bound whose values measure advantages.
    advantage : float array, shape (W + 1, A, K * S)
        Q - V of single agents at the bound's prices, at each step; the last holds from then on.
    options : RolloutOptions
    """

    base: IndexPolicy
    solved: PriceBound
    advantage: Floats
    options: RolloutOptions

    __repr__ = outline

    def __post_init__(self) -> None:
        read_only(self)

    @classmethod
    def on(cls, base: IndexPolicy, solved: PriceBound, options: RolloutOptions) -> RolloutPolicy:
        """Return the rollout policy on a base policy."""
        steps = len(solved.prices) + 1
        gain = np.stack([base.agents.look_ahead(solved.at(t + 1)) - solved.at(t) for t in range(steps)])
        return cls(base, solved, gain, options)

    def __call__(self, step: int, states: Ints, /) -> Ints:
        """Return the actions of all agents, shape (runs, N)."""
        agents, options = self.base.agents, self.options
        joint, at = np.unique(states, axis=0, return_inverse=True)
        column = joint + agents.kind * agents.shape[2]
        keys = [zlib.crc32(row.tobytes(), options.seed) + (step << 32) for row in joint]
        P = agents.P
        arrays = PolicyArrays(
            self.base.gain, self.base.rest, agents.flat[1], agents.room(self.base.resources), self.advantage,
            P.indptr.astype(np.int64), P.indices.astype(np.int64), P.data, agents.gamma,
        )  # fmt: skip
        effort = options.samples, options.horizon, options.alternatives, float(options.errors)
        found = improved(column, np.array(keys, dtype=np.uint64), step, arrays, effort)
        return found[at.reshape(-1)]


class PolicyArrays(NamedTuple):
    """The agents with their base policy and the bound's values, as compiled code reads them.

    Attributes
    ----------
    gain, rest : float and int arrays, shapes (W + 1, A, K * S) and (W + 1, K * S)
        Gains of actions, and the action without the resource, of the base policy at each step.
    use : float array, shape (A, K * S)
        Units of the resource.
    resources : float
        Units that there are.
    advantage : float array
        As in `RolloutPolicy`.
    indptr, target, prob : arrays
        Transition probabilities in compressed rows, one for each pair of an action and a state.
    gamma : float
    """

    gain: Floats
    rest: Ints
    use: Floats
    resources: float
    advantage: Floats
    indptr: Ints
    target: Ints
    prob: Floats
    gamma: float


@njit()
def serve(
    gain: Floats, use: Floats, rest: Ints, column: Ints, left: float, taken: NDArray[np.bool_], out: Ints
) -> None:
    """Assign the resource in descending order of gain per unit to agents that are not `taken`; write `out`, shape (N,).

    Agents that are taken keep their actions in `out`. Of equal gains, the first agent's first action is taken.
    """
    A, N = len(gain), len(column)
    for k in range(N):
        if not taken[k]:
            out[k] = rest[column[k]]
    open_ = ~taken
    while True:
        best, who, what = 0.0, -1, -1
        for k in range(N):
            if open_[k]:
                for a in range(A):
                    units = use[a, column[k]]
                    if units > 0 and units <= left and gain[a, column[k]] > best * units:
                        best, who, what = gain[a, column[k]] / units, k, a
        if who < 0:
            return
        out[who], open_[who] = what, False
        left -= use[what, column[who]]


@njit(inner=True)
def uniform(key: np.uint64, number: int) -> float:
    """Return a number from 0 to 1 that depends on a key and a counter (the generator SplitMix64)."""
    x = key * np.uint64(0xD1342543DE82EF95) + np.uint64(number) * np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return float((x ^ (x >> np.uint64(31))) >> np.uint64(11)) / 9007199254740992.0


@njit(inner=True)
def propose(
    gain: Floats, use: Floats, rest: Ints, column: Ints, resources: float, most: int
) -> tuple[Ints, int]:  # fmt: skip
    """Return the base policy's actions and alternatives, shape (most + 1, N), and how many rows are used."""
    A, N = len(gain), len(column)
    found, count = np.empty((most + 1, N), dtype=np.int64), 1
    none, taken = np.zeros(N, dtype=np.bool_), np.zeros(N, dtype=np.bool_)
    serve(gain, use, rest, column, resources, none, found[0])
    score = np.full(N * A, np.inf)
    for k in range(N):
        for a in range(A):
            units = use[a, column[k]]
            if 0 < units <= resources and gain[a, column[k]] > 0:
                score[k * A + a] = -gain[a, column[k]] / units
    for pair in np.argsort(score, kind="mergesort"):
        if count > most or score[pair] == np.inf:
            break
        k, a = pair // A, pair % A
        if found[0, k] != a:  # take this pair first
            taken[:] = False
            taken[k], found[count, k] = True, a
            serve(gain, use, rest, column, resources - use[a, column[k]], taken, found[count])
            count += _is_new(found, count)
    contested = count > 1
    for pair in np.argsort(-score, kind="mergesort"):
        k, a = pair // A, pair % A
        if count > most or not contested:
            break
        if score[pair] < np.inf and found[0, k] == a:  # leave this pair out
            taken[:] = False
            taken[k], found[count, k] = True, rest[column[k]]
            serve(gain, use, rest, column, resources, taken, found[count])
            count += _is_new(found, count)
    return found, count


@njit(inner=True)
def _is_new(found: Ints, count: int) -> bool:
    """Return whether row `count` differs from all rows before it."""
    new = True
    for other in range(count):
        new = new and not (found[other] == found[count]).all()
    return new


@njit()
def improved(
    columns: Ints, keys: NDArray[np.uint64], step: int, arrays: PolicyArrays, effort: tuple[int, int, int, float]
) -> Ints:  # fmt: skip
    """Return the improved actions at joint states `columns`, both of shape (U, N).

    `effort` has the samples, horizon, alternatives and errors of `RolloutOptions`.
    """
    U, N = columns.shape
    gain, rest, use, advantage, n = arrays.gain, arrays.rest, arrays.use, arrays.advantage, arrays.advantage.shape[2]
    samples, horizon, alternatives, errors = effort
    out = np.empty((U, N), dtype=np.int64)
    nobody, now, action = np.zeros(N, dtype=np.bool_), np.empty(N, dtype=np.int64), np.empty(N, dtype=np.int64)
    total = np.empty((alternatives + 1, samples))
    for u in range(U):
        at = min(step, len(gain) - 1)
        options, count = propose(gain[at], use, rest[at], columns[u], arrays.resources, alternatives)
        for k in range(N):  # `out[u] = options[0]` would take longer to compile, as in `person.hsvi`
            out[u, k] = options[0, k]
        if count == 1:
            continue
        for c in range(count):
            for r in range(samples):
                for k in range(N):
                    now[k], action[k] = columns[u, k], options[c, k]
                discount, value = 1.0, 0.0
                for h in range(horizon):
                    worth = advantage[min(step + h, len(advantage) - 1)]
                    for k in range(N):
                        value += discount * worth[action[k], now[k]]
                    if h + 1 == horizon:
                        break
                    for k in range(N):
                        row = action[k] * n + now[k]
                        begin, end = arrays.indptr[row], arrays.indptr[row + 1]
                        if end - begin > 1:
                            x, j = uniform(keys[u], (r * horizon + h) * N + k), begin
                            while j < end - 1 and x >= arrays.prob[j]:
                                x -= arrays.prob[j]
                                j += 1
                            now[k] = arrays.target[j]
                        else:
                            now[k] = arrays.target[begin]
                    discount *= arrays.gamma
                    after = min(step + h + 1, len(gain) - 1)
                    serve(gain[after], use, rest[after], now, arrays.resources, nobody, action)
                total[c, r] = value
        best = 0.0
        for c in range(1, count):
            more = total[c] - total[0]
            if more.mean() > max(best, errors * more.std() / np.sqrt(samples)):
                best = more.mean()
                for k in range(N):
                    out[u, k] = options[c, k]
    return out
