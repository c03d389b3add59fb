"""What has to match in a pool, and in pools that are joined."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from ..declare.declared import annotation_of, marks, names_of
from ..people.misconception import Misconception
from ..person.robots import OfOnePerson

P = TypeVar("P", bound=Any)
"""The type of a `Pool`."""


def _fields_of_the_team(kind: type) -> list[str]:
    """Return the names of the fields of a setting's class that do not concern people one by one."""
    return [
        name for name in names_of(kind)
        if not any(isinstance(mark, OfOnePerson) for mark in marks(annotation_of(kind, name)))
    ]  # fmt: skip


def require_matching(pool: Any) -> None:
    """Check that the parts of a pool belong together.

    Raises
    ------
    ValueError
        The parts do not match: numbers of people, names, grids, goals, discount factors, or numbers of states.
    """
    people, policies, model, gamma = pool.people, pool.policies, pool.model, pool.setting.gamma
    if not people or model.shape != (len(people),):
        raise ValueError(f"{len(people)} people, model {model.shape}: expected one entry for each person")
    twice = [name for name, count in Counter(pool.names).items() if count > 1]
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
        choices = pool.choices(number)
        perceived = len(human.expects(choices))
        if perceived != len(choices):
            raise ValueError(
                f"person {number}: perceived costs-to-go of {perceived} states, and the task has {len(choices)}"
            )


def union(pools: Sequence[P]) -> P:
    """Return the union of pools with different tasks, models or costs of suggestions.

    The setting is that of the first pool. Fields that concern people one by one have the mark `OfOnePerson`; they are
    part of the policies and may differ. All others must be the same, and so must be what actions of each robot cost
    more than those of the best one.

    Raises
    ------
    ValueError
        There is no pool, or these fields differ.
    """
    if not pools:
        raise ValueError("joined: expected one pool or more")
    for name in _fields_of_the_team(type(pools[0].setting)):
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
