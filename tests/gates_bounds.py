"""Bounds and certificates of small problems."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

from gates_episodes import AXES, PLAIN, Feature, task
from gates_records import near

from assist.certify import BoundOptions, upper_bound
from assist.person import Setting, solve
from assist.team import Pool
from planner import LimitError

FEW = BoundOptions(price_rounds=6, price_episodes=100, belief_episodes=200)
BOUNDS: dict[str, tuple[str, str, dict[str, Any]]] = {
    "team": ("bounds", "", {"window": 4}),
    "team without prices": ("bounds", "", {"window": 0}),
    "sample paths": ("bounds", "", {"window": 3, "paths": 8}),
    **{
        f"team, {name}": (axis, name, {"window": 3})
        for axis, names in {
            "robots": ["2 robots", "2 different robots"], "goals": ["3 goals"], "size": ["truncated"],
            "terms": ["terms"], "trust": ["constant", "reliability", "three in a row"], "travel": ["slow"],
            "execute": ["executes"], "suggestions": ["all"], "task": ["dead ends"], "observation": ["unreliable"],
        }.items() for name in names
    },
    "team, truncated, executes": ("execute", "executes", {"window": 0, "truncated": True}),
    "team, truncated, three in a row": ("trust", "three in a row", {"window": 0, "truncated": True}),
    "team, truncated, neighbours": ("neighbours", "all see it followed", {"window": 0, "truncated": True}),
}  # fmt: skip


def pool(feature: Feature, *, truncated: bool = False) -> Pool:
    """Return two people whom the robot does not know, with a feature."""
    if truncated:
        feature = replace(feature, pool=feature.pool | AXES["size"]["truncated"].pool)
    setting = Setting(**PLAIN | {"gamma": 0.9, "knowledge": "exact"} | feature.setting)
    return Pool.sample(task(feature.task or "kitting/tiny"), 2, seed=1, setting=setting, **feature.pool)


def team(axis: str, name: str, options: dict[str, Any]) -> dict[str, Any]:
    """Return a bound on all policies of a team, and how far three of them are from it."""
    options = dict(options)
    try:
        people = pool(AXES[axis][name] if name else Feature(), truncated=options.pop("truncated", False))
        found = upper_bound(people, gap=1e-3, jobs=1, options=FEW, **options)
        policies = {policy: found.certify(policy, episodes=64, seed=1) for policy in ("none", "attention", "priority")}
    except (ValueError, LimitError) as error:
        return {"refused": f"{type(error).__name__}: {error}"}
    return {
        "upper": found.upper, "slack": found.slack, "upper_seen": found.upper_seen, "proven": found.proven,
        "price": found.price.tolist(),
        "value": {policy: one.value for policy, one in policies.items()},
        "gap": {policy: one.gap_percent for policy, one in policies.items()},
    }  # fmt: skip


def person(axis: str, name: str) -> dict[str, Any]:
    """Return the bounds on the value of one person's problem."""
    problem = pool(AXES[axis][name] if name else Feature()).policies[0].pomdp
    solution = solve(problem, gap=1e-3)
    return {"lower": float(solution.lower), "upper": float(solution.upper)}


def cases() -> Iterator[tuple[str, set[str], bool, Callable[[], dict[str, Any]]]]:
    """Yield the name of each case, its axes, whether it is quick, and what computes it."""
    for name, (axis, feature, options) in BOUNDS.items():
        yield f"{name}, bound", {axis}, name == "team", partial(team, axis, feature, options)
    for axis, name in (("bounds", ""), ("goals", "3 goals"), ("terms", "terms"), ("trust", "reliability")):
        yield f"person, {name or 'plain'}, bounds", {axis}, not name, partial(person, axis, name)


def difference(expected: dict[str, Any], found: dict[str, Any], *, same_machine: bool) -> str | None:  # noqa: ARG001
    """Return the first number in which two cases differ; None if there is none."""
    for name in expected.keys() | found.keys():
        if not near(expected.get(name), found.get(name), 1e-9):
            return f"{name} was {expected.get(name)}, is {found.get(name)}"
    return None
