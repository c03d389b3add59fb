"""Policies compared on common random numbers: means, differences, intervals, conditions, and their table and figure."""

from __future__ import annotations

import gc
import html
import math
import pickle
import weakref
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from assist import Pool, compare, simulate
from assist.certify import certify
from assist.person import Setting
from assist.studies.reports import PolicyComparison, comparison_of
from assist.team import Episodes, TeamAction, TeamState
from planner import cost_to_go

POLICIES = ["none", "reactive", "attention"]
SETTING = Setting(c_suggest=0.5, max_steps=50)


@pytest.fixture(scope="module")
def pool() -> Pool:
    return Pool.sample(cost_to_go("kitting/tiny"), 3, seed=0, setting=SETTING)


@pytest.fixture(scope="module")
def found(pool: Pool) -> PolicyComparison:
    return compare(pool, POLICIES, humans=[2, 3], episodes=20, seed=1)


def test_means_and_differences_are_those_of_simulate(pool: Pool, found: PolicyComparison) -> None:
    runs = {name: simulate(pool, name, humans=3, episodes=20, seed=1) for name in POLICIES}
    rows = {row.policy: row for row in found if row.humans == 3}
    for name, run in runs.items():
        assert rows[name].means["discounted_return"].value == run.discounted_return.mean()
        error = stats.sem(run.actions.mean(axis=1))
        assert rows[name].summary.actions[1] == pytest.approx(error, rel=1e-12)
        assert rows[name].summary.cut_off == run.cut_off.sum()
    more = runs["attention"].discounted_return - runs["none"].discounted_return
    low, high = stats.ttest_1samp(more, 0).confidence_interval(0.95)
    assert rows["none"].differences is None
    assert rows["attention"].differences is not None
    difference = rows["attention"].differences["discounted_return"]
    assert (difference.value, difference.low, difference.high) == pytest.approx((more.mean(), low, high), rel=1e-9)


def test_portions_within_a_time_limit_are_the_same_episodes(pool: Pool, found: PolicyComparison) -> None:
    limited = compare(pool, POLICIES, humans=[2, 3], episodes=20, seed=1, time_limit=1e-9)
    assert limited == found  # the first portion has more episodes than were asked for
    fewer = compare(pool, ["none"], humans=2, episodes=100, seed=1, time_limit=1e-9)
    assert fewer[0].summary.episodes == 64


@pytest.mark.cases
def test_that_no_suggestion_was_worth_its_cost_is_said_after_several_portions(pool: Pool) -> None:
    options: dict[str, Any] = {"humans": 2, "episodes": 100, "seed": 1}
    dear = pool.under(replace(pool.setting, c_suggest=100.0))
    found = compare(dear, ["none", "attention"], **options)
    assert len(found.notes()) == 1
    assert compare(dear, ["none", "attention"], time_limit=3600.0, **options) == found
    mixed = [replace(simulate(pool, "none", **options), c_suggest_too_high=cost) for cost in (100.0, None)]
    assert Episodes.joined(mixed).c_suggest_too_high is None


@pytest.mark.cases
def test_what_simulate_takes_compare_takes(pool: Pool) -> None:
    far = Setting(c_move=1.0).travel(2, distance=[[0, 3, 3], [3, 0, 3], [3, 3, 0]])
    for options in ({"jobs": 2}, {"world": "model"}, {"goals": "known"}, {"travel": far}, {"presence": None}):
        run = simulate(pool, "attention", humans=2, episodes=20, seed=1, **options)
        found = compare(pool, ["attention"], humans=2, episodes=20, seed=1, **options)
        assert found[0].means["discounted_return"].value == run.discounted_return.mean(), options
    for name in ("name", "polcy"):
        with pytest.raises(TypeError, match=f"compare has no argument '{name}'"):
            compare(pool, ["none"], episodes=2, **{name: "x"})


@pytest.mark.cases
def test_a_bound_is_that_of_the_conditions_of_the_comparison_or_refused(pool: Pool) -> None:
    far = Setting(c_move=1.0).travel(2, distance=[[0, 3, 3], [3, 0, 3], [3, 3, 0]])
    near, gaps = pool.under(replace(pool.setting, gamma=0.8)), {}
    for travel in (None, far):
        more = {"humans": 2, "episodes": 20, "seed": 1, "travel": travel}
        (row,) = compare(near, ["none"], certified=0.1, **more)
        assert row.certificate is not None
        gaps[travel is None] = row.certificate.upper
    _, (own,) = certify(near, ["none"], team=range(2), episodes=20, seed=1, gap=0.1, travel=far)
    assert gaps[False] == own.upper
    assert gaps[False] < gaps[True]  # where moves cost more, policies can reach less
    with pytest.raises(ValueError, match="certified and goals 'known': expected goals 'inferred'"):
        compare(pool, ["none"], certified=True, goals="known")
    with pytest.raises(ValueError, match="certified and presence"):
        compare(pool, ["none"], certified=True, presence=object())


def test_the_frame_is_tidy(found: PolicyComparison) -> None:
    frame = found.to_frame()
    assert list(zip(frame.humans, frame.policy, strict=True)) == [(k, name) for k in (2, 3) for name in POLICIES]
    none = frame[frame.policy == "none"]
    assert none.actions_difference.isna().all()
    assert (frame.actions_low < frame.actions).all()
    assert not {"upper", "varied"} & set(frame)
    assert frame.moves.tolist() == [row.summary.moves[0] for row in found]
    assert frame.costs_error.tolist() == [row.summary.costs[1] for row in found]


def test_pools_are_conditions_and_have_a_column(pool: Pool) -> None:
    cheap = Pool.sample(cost_to_go("kitting/tiny"), 3, seed=0, setting=replace(SETTING, c_suggest=0.05))
    found = compare({0.05: cheap, 0.5: pool}, POLICIES, humans=2, episodes=30, varied="c_suggest")
    assert compare(pool, POLICIES, humans=2, episodes=30, c_suggest=[0.05, 0.5]) == found  # in one call
    frame = found.to_frame()
    assert frame.c_suggest.tolist() == [0.05] * 3 + [0.5] * 3
    assert frame[frame.policy == "attention"].interventions.is_monotonic_decreasing
    assert str(found).splitlines()[0].split()[:2] == ["c_suggest", "policy"]
    assert [axis.get_xlabel() for axis in found.figure().axes] == ["c_suggest"] * 3


def test_a_field_whose_values_are_tables_is_varied(pool: Pool) -> None:
    rules: list[Any] = ["constant", {"rule": "outcome", "gain": 0.1}]
    found = compare(pool, ["none", "attention"], humans=2, episodes=20, trust=rules)
    assert [row.varied for row in found] == ["constant"] * 2 + ["rule outcome, gain 0.1"] * 2
    alone = compare(pool, ["none", "attention"], humans=2, episodes=20, trust=rules[1])
    assert found[3].summary == alone[1].summary
    seen = compare(pool, "none", humans=2, episodes=2, neighbours=[None, {"rule": "followed", "sees": "everybody"}])
    assert [row.varied for row in seen] == [None, "rule followed, sees everybody"]
    assert found.figure().axes


def test_it_says_where_no_suggestion_was_worth_its_cost(pool: Pool) -> None:
    found = compare(pool, ["none", "attention"], humans=2, episodes=5, c_suggest=[0.05, 40.0])
    assert found.notes() == ["attention, 40.0: no suggestion was worth its cost (c_suggest 40)"]
    assert found.notes()[0] in str(found)
    assert found.notes()[0] in found._repr_html_()


def test_a_setting_is_changed_for_the_same_people(pool: Pool) -> None:
    found = compare(pool, ["none", "attention"], humans=2, episodes=20, c_move=3.0)
    other = Pool.sample(cost_to_go("kitting/tiny"), 3, seed=0, setting=replace(SETTING, c_move=3.0))
    assert found == compare(other, ["none", "attention"], humans=2, episodes=20)
    assert pool.under(other.setting) == other != pool
    with pytest.raises(ValueError, match="which know the task"):
        Pool.joined([pool, pool]).under(other.setting)


@pytest.mark.slow
def test_one_condition_after_another_takes_memory(pool: Pool) -> None:
    made: list[weakref.ref[Pool]] = []

    def again(setting: Setting) -> Pool:
        gc.collect()
        assert all(one() is None for one in made)
        assert pool.again is not None
        made.append(weakref.ref(one := pool.again(setting)))
        return one

    found = compare(
        replace(pool, again=again), ["none", "attention"], humans=[1, 2], episodes=2, c_suggest=[0.1, 0.5, 2.0]
    )
    assert len(found) == 12
    assert len(made) == 2  # the pool itself has the cost of the other condition


def test_under_one_condition_the_figure_has_the_differences(pool: Pool) -> None:
    found = compare(pool, POLICIES, humans=2, episodes=5)
    labels = [axis.get_ylabel() for axis in found.figure().axes]
    assert labels[3:] == [
        f"{label},\nminus none" for label in ("actions per person", "interventions per episode", "return")
    ]


def test_the_gap_to_the_optimum_is_that_of_certify(pool: Pool) -> None:
    found = compare(pool, ["none", "attention"], humans=1, episodes=30, seed=2, certified=0.1)
    bound, certificates = certify(pool, ["none", "attention"], team=[0], episodes=30, seed=2, gap=0.1)
    assert found.to_frame().upper.tolist() == [bound.upper] * 2
    assert [row.certificate for row in found] == certificates
    frame = found.to_frame()
    assert frame.model_value.tolist() == [one.value for one in certificates]
    assert (100 * (frame.upper - frame.model_value) / frame.model_value.abs()).tolist() == frame.gap_percent.tolist()
    for shown in (str(found), html.unescape(found._repr_html_())):
        assert "value in the robot's model" in shown
        assert "gap at most" in shown
        assert "with people drawn from the robot's prior, not with those of the other columns" in shown
    assert "drawn from the robot's prior" in repr(bound)
    assert "drawn from the robot's prior" in repr(certificates[0])


def test_it_is_shown_in_notebooks_drawn_and_pickled(found: PolicyComparison) -> None:
    page = found._repr_html_()
    assert page.count("<tr>") == 1 + len(found) + 1 + 2 * 2  # means, and differences of two policies for each size
    assert "attention" in page
    assert "difference to none" in page
    figure = found.figure()
    assert [axis.get_ylabel() for axis in figure.axes] == [
        "actions per person", "interventions per episode", "return (cost units)",
    ]  # fmt: skip
    assert figure.axes[0].get_xlabel() == "people in a team"
    again: Any = pickle.loads(pickle.dumps(found))
    assert again == found


def test_a_users_policy_and_one_episode(pool: Pool) -> None:
    def stays(state: TeamState) -> TeamAction:
        return TeamAction(np.zeros(state.location.shape, dtype=np.int64), np.full(state.location.shape, -1))

    with pytest.raises(ValueError, match="two policies are called 'stays'"):
        compare(pool, [stays, stays], humans=2)
    found = compare(pool, {"none": "none"}, humans=2, episodes=1)
    assert math.isnan(found[0].means["actions"].low)
    assert "±" not in str(found).splitlines()[1]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"policies": []}, "policies: expected at least one"),
        ({"policies": ["atention"]}, "attention"),
        ({"baseline": "priority"}, "baseline 'priority'"),
        ({"level": 1.0}, "between 0 and 1"),
        ({"humans": 0}, "humans"),
        ({"c_sugest": 1.0}, "no argument 'c_sugest'; did you mean 'c_suggest'"),
        ({"c_suggest": []}, "c_suggest: expected at least one value"),
        ({"c_suggest": [0.1, 1.0], "c_move": [0.1, 1.0]}, "c_suggest and c_move: expected several values of one"),
        ({"c_suggest": [-1.0]}, "c_suggest"),
        ({"c_suggest": [0.1, 1.0, 0.1]}, "c_suggest: 0.1 is there twice; expected different values"),
        ({"trust": [{"rule": "outcome"}, {"rule": "outcome"}]}, r"trust: rule outcome is there twice"),
        ({"humans": [2, 2]}, "humans: 2 is there twice; expected different values"),
        ({"pool": {}}, "pool: expected at least one"),
        ({"pool": "kitting/tiny"}, "Pool.sample"),
    ],
)
def test_a_wrong_argument_is_answered_in_one_sentence(pool: Pool, change: dict[str, Any], message: str) -> None:
    arguments: dict[str, Any] = {"pool": pool, "policies": POLICIES, "humans": 2, "episodes": 2, **change}
    with pytest.raises((ValueError, TypeError), match=message):
        compare(arguments.pop("pool"), arguments.pop("policies"), **arguments)


@pytest.mark.parametrize("humans", [2, ["human-1", "human-2"]])
def test_only_the_same_episodes_are_compared(pool: Pool, humans: Any) -> None:
    none = simulate(pool, "none", humans=humans, episodes=5, seed=0)
    other = Pool.sample(cost_to_go("kitting/tiny"), 3, seed=99, setting=SETTING)
    runs = [
        simulate(pool, "reactive", humans=humans, episodes=5, seed=1),
        simulate(pool, "reactive", humans=humans, episodes=6, seed=0),
        simulate(other, "reactive", humans=humans, episodes=5, seed=0),
    ]
    for run in runs:
        with pytest.raises(ValueError, match="reactive: expected the same seed, episodes and people as those of none"):
            comparison_of([none, run])


def test_runs_that_are_compared_have_different_names(pool: Pool) -> None:
    dear = pool.under(replace(pool.setting, c_suggest=1.0))
    runs = [simulate(one, "attention", humans=2, episodes=5, seed=0) for one in (pool, dear)]
    with pytest.raises(ValueError, match="two are called 'attention'; expected different names"):
        comparison_of(runs)
    named = [runs[0], simulate(dear, "attention", humans=2, episodes=5, seed=0, name="attention, dear")]
    assert [row.policy for row in comparison_of(named)] == ["attention", "attention, dear"]
