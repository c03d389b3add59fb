"""Calls that may take long end soon after their `time_limit`, with what is finished, or with an error that says so."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import KITTING
from fuzz import here

from assist import Pool, compare, fit, simulate
from assist.certify.coupled import Agents, bound, joint_optimum, sampled_bound
from assist.certify.coupled import certify as certify_coupled
from assist.certify.coupled import simulate as simulate_coupled
from assist.learning import Method, Observations, compare_models, compare_rules, fit_population, observed
from assist.people import TERMS
from assist.person import qmdp
from assist.studies import run_study
from planner import LimitError, load, sweep, sweep_goals
from planner.system.limits import Deadline

AT_ONCE = 1e-9
"""Seconds after which the time is up at the first look."""


@cache
def recorded() -> list[dict[str, Any]]:
    trace: list[dict[str, Any]] = []
    simulate(Pool.sample("kitting/tiny", 3, seed=1), "reactive", humans=3, episodes=1, seed=0, trace=trace)
    return trace


def seen(**options: Any) -> list[Observations]:
    return observed("kitting/tiny", recorded(), **options)


def agents(number: int = 3, states: int = 4) -> Agents:
    rng, shape = np.random.default_rng(0), (number, 2, states)
    return Agents(rng.dirichlet(np.ones(states), size=shape), rng.normal(size=shape), gamma=0.7)


RAISES: dict[str, tuple[Callable[[float], Any], str]] = {
    "sweep": (lambda limit: sweep(load("kitting/ladder-4x8"), time_limit=limit), "out of time after"),
    "sweep_goals": (lambda limit: sweep_goals([load("kitting/ladder-4x8")], time_limit=limit), "out of time after"),
    "Pool.sample": (
        lambda limit: Pool.sample("kitting/tiny", 3, seed=0, time_limit=limit),
        "out of time after setting up 0 of 3 people's POMDPs; expected fewer people, or more time",
    ),
    "Pool.of": (
        lambda limit: Pool.of("kitting/tiny", Pool.sample("kitting/tiny", 2, seed=0).people, time_limit=limit),
        "out of time after setting up 0 of 2 people's POMDPs",
    ),
    "fit_population": (
        lambda limit: fit_population(seen(), time_limit=limit), "out of time after 0 of 21 rates of trust"
    ),
    "fit_population, rate known": (
        lambda limit: fit_population(seen(), Method(eta=0.2), time_limit=limit), "out of time after 0 of 6 families"
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", RAISES)
def test_without_a_result_the_error_says_how_far_it_came(name: str) -> None:
    call, words = RAISES[name]
    begun = time.monotonic()
    with pytest.raises(LimitError, match=words):
        call(AT_ONCE)
    assert time.monotonic() - begun < 60  # a loaded machine; ladder-4x8 would take minutes
    with pytest.raises(ValueError, match="time_limit 0: expected a number of seconds above 0"):
        call(0)


FINISHED: dict[str, tuple[Callable[[float | None], Any], Callable[[Any], Any]]] = {
    "simulate": (
        lambda limit: simulate(
            Pool.sample("kitting/tiny", 2, seed=0), "none", humans=2, episodes=70, seed=0, time_limit=limit
        ), len,
    ),
    "fit": (
        lambda limit: fit("kitting/tiny", recorded(), model="misconceptions", time_limit=limit),
        lambda found: -sum(one["error"] == "not estimated within the time limit" for one in found.unknown.values()),
    ),
    "compare": (
        lambda limit: compare(Pool.sample("kitting/tiny", 2, seed=0), "none", humans=2, episodes=70, time_limit=limit),
        lambda found: found[0].summary.episodes,
    ),
    "compare_models": (
        lambda limit: compare_models(seen(terms=TERMS), folds=2, time_limit=limit), lambda found: len(found.scores)
    ),
    "compare_rules": (
        lambda limit: compare_rules(seen(), folds=2, time_limit=limit), lambda found: len(found.scores)
    ),
    "qmdp": (
        lambda limit: qmdp(Pool.sample("kitting/paper", 1, seed=0).policies[0].pomdp, time_limit=limit),
        lambda found: -float(found.value_mdp.sum()),
    ),
    "coupled.bound": (lambda limit: bound(agents(4, 2), 1, window=20, time_limit=limit), lambda found: -found.upper),
    "coupled.joint_optimum": (lambda limit: joint_optimum(agents(), 1, time_limit=limit), lambda found: -found.error),
    "coupled.sampled_bound": (lambda limit: sampled_bound(agents(2), 1, time_limit=limit), lambda found: found.paths),
    "coupled.simulate": (
        lambda limit: simulate_coupled(agents(), "benefit", 1, runs=1_000_000, seed=0, steps=1, time_limit=limit),
        lambda found: len(found.rewards),
    ),
    "coupled.certify": (
        lambda limit: certify_coupled(agents(4, 2), "prices", 1, runs=10, time_limit=limit),
        lambda found: -found.bound.upper,
    ),
}  # fmt: skip
"""A call under a limit, and how much of it is done: more, the longer it takes."""


LONG = {"coupled.simulate", "coupled.certify"}


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name in LONG)) for name in FINISHED])
def test_what_is_finished_is_returned(name: str) -> None:
    call, done = FINISHED[name]
    assert done(call(AT_ONCE)) < done(call(None))
    with pytest.raises(ValueError, match="time_limit 0"):
        call(0)


def test_models_without_time_are_named() -> None:
    found = compare_models(seen(terms=TERMS), folds=2, time_limit=AT_ONCE)
    assert [score.model for score in found.scores] == ["boltzmann"]
    assert found.left_out == ("goals", "arguments", "name", "back", "terms")
    assert "no time for goals, arguments" in repr(found)


def test_a_study_goes_on_where_its_time_was_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = tmp_path / "small.toml"
    task = KITTING / "tiny.pddl"
    plan.write_text(
        f'instances = ["{task}"]\nrepeats = 2\npool = 2\ndraws = 1\ntrials = 1\nhumans = [1, 2]\n'
        'policies = ["none", "reactive"]\nfocus = "reactive"\n'
    )
    monkeypatch.setattr("assist.studies.runner.outcomes", here)
    late = run_study(plan, tmp_path / "out", time_limit=AT_ONCE)
    assert late
    assert {str(error) for _, error in late} == {"out of time; `resume` continues with this cell"}
    assert not run_study(plan, tmp_path / "out", resume=True)
    run_study(plan, tmp_path / "whole")
    both = [(tmp_path / folder / "episodes.jsonl").read_bytes() for folder in ("out", "whole")]
    assert both[0] == both[1]


def test_a_deadline_without_a_limit_never_comes() -> None:
    assert not Deadline.after(None).passed
    assert not Deadline.after(3600).passed
    Deadline.after(3600).check("nothing")
    for wrong in (0, -1, float("nan"), True, "3"):
        with pytest.raises(ValueError, match="time_limit"):
            Deadline.after(wrong)  # type: ignore[arg-type]
