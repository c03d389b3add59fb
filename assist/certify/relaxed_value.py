"""The value of policies in the relaxed problem of a team, in which each person has a robot that has to be paid."""

from __future__ import annotations

import math

import numpy as np

from ..people.arguments import Seed, entropy, whole
from .action_prices import paid
from .certificate import horizon
from .prices import groups_of
from .team_bound import TeamBound


def relaxed_value(bound: TeamBound, *, episodes: int = 20_000, seed: Seed = 0) -> tuple[float, float]:
    """Simulate QMDP's policies in the relaxed problem of a bound; return the mean and its standard error.

    Optimal policies of the relaxed problem have at least this value, and the bound is at least theirs. So the part of a
    certificate's gap below this mean is due to the relaxation and the team policy, not to the solver. Costs after the
    horizon, at most a millionth of the dearest step for each person, are left out.

    Raises
    ------
    ValueError
        A task is truncated. Its relaxed problem ends at a frontier, where the only value that is known to be reached is
        that of paying the dearest action in every later step; the mean would be too low to say anything.
    """
    if not all(policy.problem.whole for policy in bound.pool.policies):
        raise ValueError("relaxed_value: expected an enumerated task, as bounds of a truncated one end at its frontier")
    episodes, seed_number = whole("episodes", episodes, 2), entropy(seed)
    gamma = bound.pool.setting.gamma
    price = np.vstack([bound.price, bound.on_actions])
    total, variance = paid(price, bound.pool.setting), 0.0
    groups = groups_of(bound.pool, bound.team, bound.travel, len(bound.price))
    for number, group in enumerate(groups):  # independent random numbers, so that variances add up
        value = group.simulated(price, horizon(gamma), episodes, seed_number + number)[1]
        total += group.count * float(value.mean())
        variance += group.count**2 * float(value.var(ddof=1)) / episodes
    return total, math.sqrt(variance)
