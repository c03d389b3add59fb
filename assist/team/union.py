"""The union of pools of people with different tasks, models or costs of suggestions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

P = TypeVar("P", bound=Any)
"""The type of a `Pool`."""


def union(pools: Sequence[P]) -> P:
    """Return the union of pools with different tasks, models or costs of suggestions.

    The setting is that of the first pool. Fields that concern one person only are part of the policies and may
    differ. Fields of the whole team must be the same: `gamma`, `c_move`, `travel_time`, `max_steps`, `robots`, people's
    trust rule, what the robot observes, what questions cost, and what actions of each robot cost more than of the best.

    Raises
    ------
    ValueError
        There is no pool, or these fields differ.
    """
    if not pools:
        raise ValueError("joined: expected one pool or more")
    shared = ("gamma", "c_move", "travel_time", "max_steps", "robots", "observation", "c_ask", "ask_error")
    for name in ("trust", *shared):
        values = [getattr(pool.setting, name) for pool in pools]
        if name == "trust":  # the paper's rule has its rate and unit from each person's model
            values = ["paper" if value is None else value for value in values]
        if any(value != values[0] for value in values):
            raise ValueError(f"joined: {name} is {values} in these pools; expected the same in all")
    extra = [pool.setting.fleet.extra for pool in pools]
    if any((one != extra[0]).any() for one in extra):
        raise ValueError(
            f"joined: actions of each robot cost more than of the best one by {[one.tolist() for one in extra]} in "
            "these pools; expected the same in all"
        )
    offsets = np.cumsum([0, *(len(pool.policies) for pool in pools[:-1])])
    return replace(
        pools[0],
        people=tuple(human for pool in pools for human in pool.people),
        policies=tuple(policy for pool in pools for policy in pool.policies),
        model=np.concatenate([pool.model + offset for pool, offset in zip(pools, offsets, strict=True)]),
        again=None,
        known=None,
    )
