"""The exact optimum of a few agents, by value iteration over their joint states.

It serves to see how far policies and bounds are from the best possible value. The number of joint states grows
exponentially with the number of agents, so this is for small problems.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.system.arrays import outline, read_only
from planner.system.limits import Deadline, LimitError

from ...people.arguments import whole
from .agents import Agents, Floats, Ints, units


@dataclass(frozen=True, eq=False)
class JointOptimum:
    """The best policy of all agents together, and its value.

    Attributes
    ----------
    value : float
        Expected discounted reward from the initial distribution, within `error`.
    error : float
        Largest distance of `values` from the exact ones.
    values : float array, shape (S,) * N
        Value of each joint state.
    actions : int array, shape (N,) + (S,) * N
        Best action of each agent in each joint state.
    """

    value: float
    error: float
    values: Floats
    actions: Ints

    __repr__ = outline

    def __post_init__(self) -> None:
        read_only(self)

    def __call__(self, step: int, states: Ints, /) -> Ints:  # noqa: ARG002
        """Return the actions of all agents, shape (runs, N); this is a policy for `simulate`."""
        return np.ascontiguousarray(np.moveaxis(self.actions[(slice(None), *states.T)], 0, -1))


def joint_optimum(
    agents: Agents,
    resources: float,
    *,
    tolerance: float = 1e-9,
    largest: int = 1_000_000,
    time_limit: float | None = None,
) -> JointOptimum:
    """Return the optimal value and policy of a few agents.

    Parameters
    ----------
    agents, resources
        As in `bound`.
    tolerance : float
        Largest distance from the exact values, as a share of the largest possible value.
    largest : int
        Largest number of joint states.
    time_limit : float, optional
        Seconds after which no further iteration begins. The values are then those so far, and `error` is larger.

    Raises
    ------
    LimitError
        There are more joint states.
    ValueError
        An argument is invalid.
    """
    limit = agents.room(units(resources))
    N, (_, A, S) = len(agents), agents.shape
    if whole("largest", largest, 1) < S**N:
        raise LimitError(f"{N} agents of {S} states have {S**N:,} joint states; expected at most {largest:,} (largest)")
    dense = agents.P.toarray().reshape(A, agents.shape[0], S, agents.shape[0], S)
    P = np.array([[dense[a, k, :, k] for a in range(A)] for k in agents.kind])
    R, use, may = agents.R[agents.kind], agents.uses[agents.kind], agents.allowed[agents.kind]
    values, gamma = np.zeros((S,) * N), agents.gamma
    allowed = tolerance * max(1e-300, float(abs(agents.R).max()) * N)
    ends = Deadline.after(time_limit)
    while True:
        best, chosen = np.full(values.shape, -np.inf), np.zeros(values.shape, dtype=np.int64)
        for number, reward, used, ahead in _joint(P, R, use, may, values, limit):
            found = np.where(used <= limit, reward + gamma * ahead, -np.inf)
            better = found > best
            best[better], chosen[better] = found[better], number
        change = float(abs(best - values).max())
        values = best
        # The distance from the fixed point is at most gamma / (1 - gamma) times the last change.
        if change * gamma <= allowed or ends.passed:
            break
    digits = A ** np.arange(N - 1, -1, -1).reshape(-1, *[1] * N)
    weight = np.ones(())
    for k in range(N):
        weight = np.multiply.outer(weight, agents.initial[k])
    return JointOptimum(
        float((weight * values).sum()), change * gamma / (1 - gamma), values, (chosen[None] // digits) % A
    )


def _joint(
    P: Floats, R: Floats, use: Floats, may: NDArray[np.bool_], values: Floats, limit: float
) -> Iterator[tuple[int, Floats, Floats, Floats]]:
    """Yield each joint action that is possible in some state: number, reward, used units, and expected next value."""
    N, A, S = R.shape

    def along(k: int, entries: Floats) -> Floats:
        return entries.reshape([S if j == k else 1 for j in range(N)])

    def extended(
        k: int, number: int, reward: Floats, used: Floats, ahead: Floats
    ) -> Iterator[tuple[int, Floats, Floats, Floats]]:
        if k == N:
            yield number, reward, used, ahead
            return
        for a in range(A):
            with_a = used + along(k, use[k, a])
            if with_a.min() > limit:
                continue
            gain = reward + along(k, np.where(may[k, a], R[k, a], -np.inf))
            then = np.moveaxis(np.tensordot(P[k, a], ahead, axes=(1, k)), 0, k)
            yield from extended(k + 1, number * A + a, gain, with_a, then)

    yield from extended(0, 0, np.zeros([1] * N), np.zeros([1] * N), values)
