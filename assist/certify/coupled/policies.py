"""The policies of weakly coupled problems by name."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from .agents import Agents, Floats, Ints, units
from .index_policy import IndexPolicy
from .price_bound import PriceBound, bound, free_values
from .rollout import RolloutOptions, RolloutPolicy
from .whittle import whittle_index

CoupledPolicy = Callable[[int, Ints], Ints]
"""Returns the actions of all agents, shape (runs, N), at a step in given states, shape (runs, N)."""


def policy(
    agents: Agents,
    name: str | CoupledPolicy,
    resources: float,
    *,
    solved: PriceBound | None = None,
    rollout: RolloutOptions | None = None,
) -> CoupledPolicy:
    """Return a policy by name.

    Parameters
    ----------
    agents, resources
        As in `bound`.
    name : str or callable
        "whittle": by Whittle index. "prices": by the gain at the bound's prices of later steps. "benefit": by the gain
        if the resource were free afterwards. "rollout": "prices", improved by simulation (`RolloutPolicy`). A
        callable is returned unchanged.
    solved : PriceBound, optional
        The bound whose prices are used. Default: `bound(agents, resources)`.
    rollout : RolloutOptions, optional
        Effort of "rollout".

    Raises
    ------
    ValueError
        The name is unknown, or there is no Whittle index.
    """
    if callable(name):
        return name
    limit = units(resources)
    if name == "whittle":
        whittle = whittle_index(agents)
        if not whittle.indexable.all():
            raise ValueError(f"whittle: agents of kind {int(np.argmin(whittle.indexable))} are not indexable")
        n = whittle.index.size
        gain = np.stack([np.zeros(n), (whittle.index * agents.uses[:, 1]).ravel()])[None]
        return IndexPolicy(agents, limit, gain, np.zeros((1, n), dtype=np.int64))
    if name == "benefit":
        values = [free_values(agents)]
    elif name in ("prices", "rollout"):
        given = bound(agents, limit) if solved is None else solved
        values = [given.at(t + 1) for t in range(max(1, len(given.prices)))]
    else:
        raise ValueError(f"policy {name!r}: expected 'whittle', 'prices', 'benefit', 'rollout' or a function")
    parts = [_gains(agents, one) for one in values]
    found = IndexPolicy(agents, limit, np.stack([gain for gain, _ in parts]), np.stack([rest for _, rest in parts]))
    return RolloutPolicy.on(found, given, rollout or RolloutOptions()) if name == "rollout" else found


def _gains(agents: Agents, values: Floats) -> tuple[Floats, Ints]:
    """Return the gains over the best action that uses nothing, and that action."""
    q = agents.look_ahead(values)
    without = np.where(agents.flat[1] == 0, q, -np.inf)
    gain: NDArray[np.float64] = q - without.max(axis=0)
    return gain, without.argmax(axis=0)
