"""Sequences of reports of a live team: recorded calls of `Assistant`, with what it answers and believes after each."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from typing import Any

from gates_episodes import task
from gates_records import NEAR, NEAR_ELSEWHERE, near, weights

from assist.live import Assistant
from assist.person import ObservationModel, Robot, Setting
from planner import LimitError

CALLS = 40
"""Number of calls of a sequence."""

PLAIN: dict[str, Any] = {"c_suggest": 0.05, "c_move": 0.02}
TEAMS: dict[str, tuple[set[str], bool, str, str, dict[str, Any]]] = {
    "1 robot": ({"robots"}, True, "kitting/tiny", "attention", {}),
    "priority": ({"policies"}, True, "kitting/tiny", "priority", {}),
    "reactive": ({"policies"}, False, "kitting/tiny", "reactive", {}),
    "whittle": ({"policies"}, False, "kitting/tiny", "whittle", {}),
    "2 robots": ({"robots"}, True, "kitting/tiny", "attention", {"robots": 2}),
    "2 different robots": (
        {"robots"}, False, "kitting/tiny", "attention",
        {"robots": (Robot(c_suggest=0.02), Robot(c_move=0.0, travel_time=1.0))},
    ),
    "slow": ({"travel"}, True, "kitting/tiny", "attention", {"travel_time": 1.0}),
    "dead ends": ({"task"}, False, "stations/one-way", "attention", {}),
    "3 goals": ({"goals"}, True, "goals", "attention", {}),
    "3 goals, 2 robots": ({"goals", "robots"}, False, "goals", "priority", {"robots": 2}),
    "3 goals, asks": ({"goals", "questions"}, True, "goals", "attention", {"c_ask": 0.02, "ask_error": 0.1}),
    "unreliable": ({"observation"}, True, "kitting/tiny", "attention", {"observation": ObservationModel(0.1, 0.1)}),
    "unreliable, asks": (
        {"observation", "questions"}, False, "kitting/tiny", "attention",
        {"observation": ObservationModel(0.1, 0.1), "c_ask": 0.02},
    ),
    "unreliable, 3 goals, asks": (
        {"observation", "questions", "goals"}, False, "goals", "attention",
        {"observation": ObservationModel(0.1, 0.1), "c_ask": 0.02},
    ),
    "on demand": ({"size"}, False, "on demand", "attention", {}),
    "equation 7": ({"trust"}, True, "kitting/tiny", "attention", {"trust": "paper"}),
    "outcome": ({"trust"}, False, "kitting/tiny", "attention", {"trust": "outcome"}),
    "reliability": ({"trust"}, False, "kitting/tiny", "attention", {"trust": "reliability"}),
}  # fmt: skip
"""For each team: its axes, whether it is quick, the task, the policy, and what differs in the setting."""


@cache
def sequences() -> Mapping[str, list[Any]]:
    """Return the recorded calls of each team."""
    from gates import recorded

    return {name: case["calls"] for name, case in recorded("reports")["cases"].items()}


def desk(name: str) -> Assistant:
    """Return a team of two."""
    _, _, of, policy, setting = TEAMS[name]
    return Assistant(task(of), ["ann", "bob"], policy=policy, setting=Setting(**PLAIN | setting))


def call(team: Assistant, method: str, *arguments: Any, **options: Any) -> list[Any]:
    """Call a method of the team; return what it says, and what the team then says and believes of the person."""
    try:
        said = getattr(team, method)(*arguments, **options)
    except (ValueError, LookupError, LimitError) as error:
        return [f"{type(error).__name__}: {error}"]
    if method == "recommend_all":
        shown = [[one.person, one.suggestion, one.arrived, one.question and one.question.goal] for one in said]
        return [shown, [None if one.reason is None else one.reason.score for one in said]]
    if not arguments or arguments[0] not in team.people:
        return [said]
    person = team.person(arguments[0])
    belief = person.belief.reshape(-1, *person.grid.shape)  # the first axis is goals
    beliefs = [
        float(belief.sum(axis=(0, 2)) @ person.grid.beta), float(belief.sum(axis=(0, 1)) @ person.grid.theta),
        float(belief.ravel() @ weights(belief.size)), *map(float, person.goals.values()),
    ]  # fmt: skip
    return [said, person.suggestion, len(person.applicable), float(person.cost_to_go), beliefs]


def replayed(name: str) -> dict[str, Any]:
    """Return the record of a team after its recorded calls, or of new ones if none are recorded."""
    team, calls, said = desk(name), sequences().get(name), list[Any]()
    if calls is None:
        calls, rng = [], random.Random(name)
        while len(calls) < CALLS:
            calls.append(report(team, rng))
            said.append(call(team, calls[-1][0], *calls[-1][1], **calls[-1][2]))
        return {"calls": calls, "said": said}
    return {"calls": calls, "said": [call(team, method, *arguments, **options) for method, arguments, options in calls]}


def report(team: Assistant, rng: random.Random) -> list[Any]:
    """Return a call that may come next: its method, arguments and named arguments."""
    names = ["ann", "bob", *(["cleo"] if "cleo" in team.people else [])]
    present = [name for name in names if name in team.people]
    if not present or rng.random() < 0.35:
        return ["recommend_all", [], {}]
    name = rng.choice(present)
    person = team.person(name)
    if person.question is not None and rng.random() < 0.7:
        answers = person.question.options or (True, False, False, None)
        return ["answer", [name, rng.choice([*answers])], {}]
    if person.finished:
        return rng.choice([["begin", [name], {}], ["begin", [name], {}], ["undo", [name], {}], ["leave", [name], {}]])
    actions = person.applicable
    action = rng.choice(actions) if person.suggestion is None or rng.random() < 0.4 else person.suggestion
    uncertain = team.setting.observation is not None
    calls: list[tuple[float, list[Any]]] = [
        (45, ["observe", [name, action], {}]),
        (8, ["observe", [name, action], {"heard": False}]),
        (12 if uncertain else 1, ["observe", [name], {"likelihoods": {action: 0.8, rng.choice(actions): 0.3}}]),
        (8 if uncertain else 1, ["observe", [name], {"missed": rng.choice([0.2, 0.7])}]),
        (2, ["answer", [name, rng.choice([True, None, action])], {}]),
        (6 if team.setting.c_ask is not None else 1, ["undo", [name], {"of": "answered"}]),
        (8, ["undo", [name], {}]),
        (3, ["begin", [name], {}]),
        (5, ["leave", [name], {}]),
        (5, ["join", [rng.choice(["cleo", *sorted({"ann", "bob"} - set(present))])], {}]),
        (3, ["arrived", [name], {}]),
        (3, ["elapse", [], {}]),
    ]
    weight, each = zip(*calls, strict=True)
    return list(rng.choices(each, weight)[0])


def cases() -> Iterator[tuple[str, set[str], bool, Callable[[], dict[str, Any]]]]:
    """Yield the name of each case, its axes, whether it is quick, and what computes it."""
    for name, (axes, quick, *_) in TEAMS.items():
        yield f"{name}", axes, quick, partial(replayed, name)


def difference(expected: dict[str, Any], found: dict[str, Any], *, same_machine: bool) -> str | None:
    """Return the first call after which something differs; None if there is none."""
    tolerance = NEAR if same_machine else NEAR_ELSEWHERE
    for number, (one, before, now) in enumerate(zip(expected["calls"], expected["said"], found["said"], strict=True)):
        if not near(before, now, tolerance):
            return f"call {number}, {one}: was {before}, is {now}"
    return None
