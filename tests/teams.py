"""Team states and episodes for tests, and the arrays that a policy can access."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from assist.person.known_states import KnownStates
from assist.person.lazy_policy import LazyPolicy
from assist.person.travel import Travel
from assist.team import BASE, Episodes, Pool, TeamState, simulate


def state(
    pool: Pool, x: list[int], *, erred: list[bool] | None = None, location: int = BASE, travel: Travel | None = None,
    belief: np.ndarray | None = None,
) -> TeamState:  # fmt: skip
    """Return the state of one team of the pool's first people, with all robots at one place."""
    people = np.arange(len(x))[None]
    choices, model = pool.choices(0), pool.model[people]
    at = np.array([x])
    prior = np.array([policy.pomdp.prior for policy in pool.policies])[model[0]]
    belief, seen = prior if belief is None else belief, pool.setting.neighbourhood(len(x))
    known = KnownStates(at[0], belief, np.array(erred or [False] * len(x)), seen)
    return TeamState(
        np.zeros(1, np.int64), ~choices.goal[at], np.full((1, len(pool.setting.robots)), location), model, known,
        pool.policies, travel or pool.setting.travel(len(x)), fleet=pool.setting.fleet,
    )  # fmt: skip


def run(pool: Pool, name: str, humans: int, episodes: int, seed: int, **options: Any) -> Episodes:
    return simulate(pool, pool.policy(name), humans=humans, episodes=episodes, seed=seed, name=name, **options)


def equal(a: Episodes, b: Episodes) -> bool:
    return list(a) == list(b)


def reachable(thing: Any, path: str, found: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return all arrays that are reachable from an object through fields, cached values and items."""
    if isinstance(thing, np.ndarray):
        found.setdefault(path, thing)
    elif isinstance(thing, tuple | list):
        for number, item in enumerate(thing[:1]):  # one person stands for all
            reachable(item, f"{path}[{number}]", found)
    elif isinstance(thing, LazyPolicy):
        reachable(thing.prepare(), path, found)
    elif is_dataclass(thing):
        for name in {field.name for field in fields(thing)} | set(vars(thing)):
            if (held := getattr(thing, name)) is not thing:  # the empty neighbourhood is what is believed of it
                reachable(held, f"{path}.{name}", found)
    return found
