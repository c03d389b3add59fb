"""The episodes of `simulate` over a matrix of policies and features."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields, replace
from functools import cache, partial
from hashlib import sha256
from itertools import combinations
from typing import Any

import numpy as np
from gates_records import first_difference, hashed, weights
from silence import ThreeInARow

from assist.people import Goals, Neighbours, Population, advice_takers
from assist.person import ObservationModel, Robot, Setting
from assist.team import POLICIES, Episodes, Pool, Schedule, simulate
from assist.team.trace import Trace
from planner import CostToGo, LimitError, OnDemand, load, sweep, sweep_goals

HUMANS, EPISODES, SEED, PEOPLE = 3, 16, 5, 4


@dataclass(frozen=True)
class Feature:
    """A value of an axis: what it changes of the setting, the pool, the simulation or the task."""

    setting: dict[str, Any] = field(default_factory=dict)
    pool: dict[str, Any] = field(default_factory=dict)
    run: dict[str, Any] = field(default_factory=dict)
    task: str | None = None


PLAIN: dict[str, Any] = {"c_suggest": 0.1, "c_move": 0.05, "max_steps": 40}
TERMS = Population(weights={"goals": (0.2, 0.6), "arguments": (0.5, 1.5), "name": (0.1, 0.4), "back": (-1.0, -0.5)})
AXES: dict[str, dict[str, Feature]] = {
    "knowledge": {"exact": Feature({"knowledge": "exact"})},
    "robots": {
        "2 robots": Feature({"robots": 2}),
        "2 different robots": Feature(
            {"robots": (Robot(c_suggest=0.02, c_move=0.3), Robot(c_move=0.0, travel_time=1.0))}
        ),
        "1 of 2 executes": Feature({"robots": (Robot(execute=True, c_execute=0.4), Robot(c_suggest=0.05))}),
    },
    "goals": {
        "3 goals": Feature(task="goals"),
        "3 goals, likeliest": Feature(task="goals", run={"goals": "likeliest"}),
        "3 goals, known": Feature(task="goals", run={"goals": "known"}),
    },
    "observation": {"unreliable": Feature({"observation": ObservationModel(0.1, 0.1)})},
    "questions": {
        "asks": Feature({"c_ask": 0.02, "ask_error": 0.1}, task="goals"),
        "asks about 1 goal": Feature({"c_ask": 0.02}),
    },
    "size": {"truncated": Feature(pool={"states": 1, "region": 12}), "on demand": Feature(task="on demand")},
    "terms": {
        "terms": Feature(pool={"population": TERMS}),
        "terms of people": Feature(pool={"population": TERMS, "prior": Population()}),
    },
    "trust": {
        "constant": Feature({"trust": "constant"}),
        "outcome": Feature({"trust": "outcome"}),
        "disagreement": Feature({"trust": "outcome-at-disagreement"}),
        "reliability": Feature({"trust": "reliability"}),
        "believed constant": Feature({"believed_trust": "constant"}),
        "three in a row": Feature({"trust": ThreeInARow(0.2, 0.05)}),
    },
    "people": {
        "noise of actions": Feature(pool={"population": Population(noise="action")}),
        "mixture": Feature(pool={"population": advice_takers()}),
    },
    "suggestions": {"all": Feature({"suggestions": "all"})},
    "execute": {"executes": Feature({"execute": True, "c_execute": 0.4})},
    "travel": {"slow": Feature({"travel_time": 1.0})},
    "world": {"model": Feature(run={"world": "model"})},
    "presence": {"comes and goes": Feature(run={"presence": Schedule.of(HUMANS, [0, 2, 1], [6, 12, 40])})},
    "task": {"dead ends": Feature(task="stations/one-way"), "costs": Feature(task="delivery/one-parcel")},
    "neighbours": {
        "all see it followed": Feature({"neighbours": Neighbours(rule="followed")}),
        "next see the outcome": Feature({"neighbours": Neighbours(rule="outcome", sees="next"), "robots": 2}),
    },
}
"""The features of each axis, besides the plain case. Policies are an axis as well."""


ALONE = {
    "3 goals, likeliest", "asks about 1 goal", "on demand", "terms of people", "outcome", "disagreement",
    "believed constant", "noise of actions", "mixture", "costs", "all see it followed", "next see the outcome",
}  # fmt: skip
"""Features that are not combined with others."""
PAIRS = [
    (one, other)
    for one, other in combinations([(axis, name) for axis, named in AXES.items() for name in named], 2)
    if one[0] != other[0] and not {one[1], other[1]} & ALONE
]
SLOTS = {"b": ((5, 1), (6, 0)), "c": ((5, 2), (6, 0))}
"""Goals besides the one of `kitting/tiny`: the items the other way round, and only one of them in its place."""


@cache
def task(name: str) -> CostToGo | Goals:
    """Return the task of a feature."""
    if name == "on demand":
        return OnDemand(load("kitting/tiny"), jobs=1)
    if name == "goals":
        own = load("kitting/tiny")
        goals = {"a": own.goal, **SLOTS}
        tables = sweep_goals([replace(own, goal=goal) for goal in goals.values()])
        return Goals(dict(zip(goals, tables, strict=True)), {"a": 0.5, "b": 0.2, "c": 0.3}, sharpness=1)
    return sweep(load(name))


def episodes(policy: str, *features: Feature, traced: bool) -> tuple[Episodes, Trace]:
    """Simulate a policy with some features."""
    setting, pool, run = PLAIN, dict[str, Any](), dict[str, Any]()
    named = [one.task for one in features if one.task is not None]
    if len(named) > 1:
        raise ValueError("several tasks: expected one")
    for one in features:
        setting, pool, run = setting | one.setting, pool | one.pool, run | one.run
    people = Pool.sample(
        task(named[0] if named else "kitting/tiny"), PEOPLE, seed=SEED, setting=Setting(**setting), **pool
    )
    trace: Trace = []
    run = run | ({"trace": trace} if traced else {})
    return simulate(people, policy, humans=HUMANS, episodes=EPISODES, seed=SEED, **run), trace


def found(policy: str, *features: Feature, traced: bool = False) -> dict[str, Any]:
    """Return the record of a case: hashes of its arrays, and its returns as numbers; or why it is refused."""
    try:
        done, trace = episodes(policy, *features, traced=traced)
    except (ValueError, LimitError) as error:
        return {"refused": f"{type(error).__name__}: {error}"}
    arrays = {one.name: getattr(done, one.name) for one in fields(done) if one.name != "policy"}
    arrays = {name: array for name, array in arrays.items() if isinstance(array, np.ndarray)}
    returns = arrays["discounted_return"]
    case: dict[str, Any] = {
        "decisions": hashed(pair for pair in arrays.items() if pair[1].dtype.kind != "f"),
        "return": float(returns.mean()),
        "returns": float(returns @ weights(len(returns))),
    }
    if not any(one.task == "goals" for one in features):
        case["bits"] = hashed(pair for pair in arrays.items() if pair[1].dtype.kind == "f")
    if traced:
        case["trace"] = sha256(json.dumps([_shown(row) for row in trace]).encode()).hexdigest()[:16]
    return case


def _shown(row: dict[str, Any]) -> dict[str, Any]:
    """Return what a record of a trace says, without its floats."""
    question = {"question": {**row["question"], "worth": None}} if "question" in row else {}
    return {name: value for name, value in row.items() if not isinstance(value, float)} | question


def cases() -> Iterator[tuple[str, set[str], bool, Callable[[], dict[str, Any]]]]:
    """Yield the name of each case, its axes, whether it is quick, and what computes it.

    These are each policy with each feature, and two policies with each two features. The quick ones are each policy
    without a feature, and one policy with each feature.
    """
    for policy in POLICIES:
        yield policy, {"policies"}, policy != "rollout", partial(found, policy, traced=True)
    for policy in POLICIES:
        for axis, named in AXES.items():
            if policy == "attention-outlook" and axis != "neighbours":  # there it is attention
                continue
            for name, feature in named.items():
                quick = policy == "attention" and name != "on demand"
                yield f"{policy}, {name}", {axis}, quick, partial(found, policy, feature, traced=policy == "attention")
    for policy in ("attention", "priority"):
        for (axis, name), (other, more) in PAIRS:
            both = AXES[axis][name], AXES[other][more]
            if all(one.task is not None for one in both):
                continue
            yield f"{policy}, {name}, {more}", {axis, other}, False, partial(found, policy, *both)


difference = first_difference
