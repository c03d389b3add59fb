"""Whether people, their policies and a setting belong together in a pool."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..people.human import Human
from ..people.misconception import Misconception
from ..person.policy import Policy


def require_matching(
    people: Sequence[Human], names: Sequence[str], policies: Sequence[Policy], model: NDArray[np.int64], gamma: float
) -> None:
    """Check the parts of a pool; `gamma` is that of its setting.

    Raises
    ------
    ValueError
        The parts do not match: numbers of people, names, grids, goals, discount factors, or numbers of states.
    """
    if not people or model.shape != (len(people),):
        raise ValueError(f"{len(people)} people, model {model.shape}: expected one entry for each person")
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise ValueError(f"two people are called {twice[0]}; expected a name for each")
    if model.min() < 0 or model.max() >= len(policies):
        raise ValueError(f"model: expected numbers from 0 to {len(policies) - 1}")
    shapes = {policy.pomdp.grid.shape for policy in policies}
    if len(shapes) > 1:
        raise ValueError(f"grids of shapes {sorted(shapes)}: expected the same for everybody")
    goals = {len(policy.pomdp.hidden.goals) for policy in policies}
    if len(goals) > 1:
        raise ValueError(f"people with {' and '.join(map(str, sorted(goals)))} goals: expected as many for everybody")
    for policy in policies:
        if policy.pomdp.gamma != gamma:
            raise ValueError(f"gamma {policy.pomdp.gamma:g}: expected that of the setting, {gamma:g}")
    for number, human in enumerate(people):
        if isinstance(human.h, Misconception):
            continue
        choices = policies[model[number]].pomdp.model.choices
        perceived = human.expects(choices)
        if len(perceived) != len(choices):
            raise ValueError(
                f"person {number}: perceived costs-to-go of {len(perceived)} states, and the task has {len(choices)}"
            )
