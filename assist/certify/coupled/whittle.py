"""The Whittle index: the price of the resource at which acting and not acting are equally good.

At a constant price the policy of one agent is optimal on an interval of prices, on which values are linear in the
price. Starting with the policy that is optimal at a very low price, which uses as much of the resource as it can, the
price is raised to the end of the interval, where one state changes its action. That price is the state's index if the
state stops acting. The agent is indexable if no state ever starts to act (Whittle, "Restless bandits: activity
allocation in a changing world", Journal of Applied Probability 25A, 1988).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.system.arrays import outline, read_only

from .agents import Agents, Floats

SAME = 1e-9
"""Rates of change, gains and differences of prices up to this size count as 0; others are far above rounding errors."""


@dataclass(frozen=True, eq=False)
class WhittleIndex:
    """The Whittle indices of all kinds of agents.

    Attributes
    ----------
    index : float array, shape (K, S)
        Price per unit of the resource from which on acting is not better; minus infinity where it is not allowed, or
        better at no price.
    indexable : bool array, shape (K,)
        Whether the states in which an agent acts only become fewer as the price rises. The index is defined for these.
    """

    index: Floats
    indexable: NDArray[np.bool_]

    __repr__ = outline

    def __post_init__(self) -> None:
        read_only(self)


def whittle_index(agents: Agents) -> WhittleIndex:
    """Return the Whittle index of each state, up to rounding errors.

    Parameters
    ----------
    agents : Agents

    Raises
    ------
    ValueError
        There are not two actions, of which the first uses nothing and the second the same amount in all states of
        an agent.
    """
    K, A, S = agents.shape
    unit = agents.uses[:, -1].max(axis=1)
    if A != 2 or agents.uses[:, 0].any() or (agents.uses[:, 1] != unit[:, None]).any() or not unit.all():
        raise ValueError(
            "Whittle index: expected two actions, of which the first uses nothing and the second the same in all states"
        )
    P = np.zeros((2, K, S, S))
    whole = agents.P.tocoo()
    entry = whole.row // (K * S), whole.row // S % K, whole.row % S, whole.col % S
    np.add.at(P, entry, whole.data)
    index, good = np.full((K, S), -np.inf), np.ones(K, dtype=bool)
    active = _at_a_low_price(agents, P, unit)
    price = np.full(K, -np.inf)
    # A flip after which a state acts again is a sign of an agent that is not indexable; the number of flips is bounded.
    for _ in range(4 * S):
        open_ = np.flatnonzero(active.any(axis=1) & good)
        if not len(open_):
            break
        step, start = _next_change(agents, P, active, price, unit, open_)
        for k, s, at, begins in zip(open_, *step, start, strict=True):
            if begins or not np.isfinite(at):
                good[k] = False
                continue
            price[k] = at
            index[k, s] = at
            active[k, s] = False
    good[active.any(axis=1)] = False
    return WhittleIndex(index, good)


def _at_a_low_price(agents: Agents, P: Floats, unit: Floats) -> NDArray[np.bool_]:
    """Return where each kind acts at a very low price, shape (K, S), by policy iteration.

    Policies are compared by the discounted units that they use. Of equally good ones, the one with more reward is best.
    """
    K, _, S = agents.shape
    may, tiny = agents.allowed[:, 1], SAME * float(abs(agents.R).max())
    active = may.copy()
    for _ in range(10 * S):  # it takes a few rounds; rounding errors may repeat a policy
        gain, rate = _advantage(agents, P, active, unit, np.arange(K))
        acts = np.where(abs(rate) > SAME, rate > 0, np.where(abs(gain) > tiny, gain > 0, active)) & may
        if (acts == active).all():
            break
        active = acts
    return active


def _advantage(
    agents: Agents, P: Floats, active: NDArray[np.bool_], unit: Floats, kinds: NDArray[np.int64]
) -> tuple[Floats, Floats]:
    """Return `gain` and `rate`, shape (kinds, S): the advantage of acting at a price is gain - price * rate.

    `active`, of the same shape, is the policy of later steps.
    """
    S = P.shape[-1]
    chosen = np.where(active[:, :, None], P[1, kinds], P[0, kinds])
    reward = np.where(active, agents.R[kinds, 1], agents.R[kinds, 0])
    use = np.where(active, unit[kinds, None], 0.0)
    found = np.linalg.solve(np.eye(S) - agents.gamma * chosen, np.stack([reward, use], axis=-1))
    ahead = agents.gamma * (P[1, kinds] - P[0, kinds]) @ found
    return agents.R[kinds, 1] - agents.R[kinds, 0] + ahead[..., 0], unit[kinds, None] + ahead[..., 1]


def _next_change(
    agents: Agents, P: Floats, active: NDArray[np.bool_], price: Floats, unit: Floats, kinds: NDArray[np.int64]
) -> tuple[tuple[NDArray[np.int64], Floats], NDArray[np.bool_]]:
    """Return for each kind the state that changes its action next, the price, and whether it begins to act."""
    acts = active[kinds]
    gain, rate = _advantage(agents, P, acts, unit, kinds)
    stops = acts & (rate > SAME)
    starts = ~acts & agents.allowed[kinds, 1] & (rate < -SAME)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = np.where(stops | starts, gain / rate, np.inf)
    # A state that has just stopped is at an advantage of 0; its rounding errors are no change.
    at = np.where(stops, np.maximum(at, price[kinds, None]), at)
    at[
        starts & (at <= price[kinds, None] + SAME * (1 + abs(np.where(np.isfinite(price), price, 0.0)[kinds, None])))
    ] = np.inf
    state = at.argmin(axis=1)
    rows = np.arange(len(kinds))
    return (state, at[rows, state]), starts[rows, state]
