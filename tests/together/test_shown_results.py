"""Results in a notebook or a terminal: a line, a table, a frame, comparison by value, and pickling."""

from __future__ import annotations

import pickle
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import kit
from hypothesis import given
from hypothesis import strategies as st
from recorded import lines

from assist import Pool, compare, fit, simulate
from assist.certify import certify
from assist.learning import FittedAdvice, Log, calibrate, compare_models, fit_influence, infer_goals, replayed
from assist.learning.replay import replay
from assist.people import Choices, HumanModel
from assist.person import AssistPOMDP, OfRobots, PersonProblem, solve
from assist.person.qmdp import qmdp
from assist.studies import Study
from assist.studies.reports import Report
from assist.team.episodes import Episodes
from planner import OnDemand, Table, cost_to_go
from planner.system.arrays import outline
from planner.system.errors import MissingExtraError
from planner.system.results import MOST_ROWS, html_table, same


@pytest.fixture(scope="module")
def results() -> dict[str, Any]:
    table = cost_to_go("kitting/tiny")
    pool = Pool.sample(table, 3, seed=0)
    episodes = simulate(pool, "attention", humans=2, episodes=4, seed=0)
    bound, [certificate] = certify(pool, ["none"], team=(0, 1), episodes=10, seed=0, window=0, gap=0.5)
    problem = AssistPOMDP.of(HumanModel.exact(Choices.of(table)), robot=OfRobots(c_suggest=0.5))
    return {
        "table": table, "pool": pool, "episodes": episodes, "summary": episodes.summary(), "bound": bound,
        "comparison": compare(pool, ["none", "attention"], humans=2, episodes=4, seed=0),
        "certificate": certificate,
        "solution": solve(problem, gap=0.5),
    }  # fmt: skip


def test_a_result_is_a_line_a_table_and_a_frame_and_survives_pickling(
    results: dict[str, Any], learned: dict[str, Any]
) -> None:
    for name, found in {**results, **learned}.items():
        assert len(repr(found).splitlines()[0]) < 500, name
        shown = found._repr_html_()
        assert shown.startswith("<table>"), name
        assert "<td>" in shown, name
        assert len(found.to_frame()) >= 1, name
        assert pickle.loads(pickle.dumps(found)) == found, name


ACTIONS = ["(fetch box-a)", "(place hammer slot-2)", "(remove hammer slot-2)", "(place hammer slot-1)"]


def rows() -> list[dict[str, Any]]:
    """Return the records of two people, of whom each heard one suggestion."""
    told = {1: "(place hammer slot-1)"}
    return [row for person in ("ann", "bob") for row in lines(*ACTIONS, person=person, told=told)]


@pytest.fixture(scope="module")
def learned() -> dict[str, Any]:
    log = Log.of(rows())
    seen = replayed("kitting/tiny", log)
    people = fit(seen)
    goals = infer_goals({"kit": "kitting/tiny"}, log)
    models, influence = compare_models(seen.observations()), fit_influence(seen.observations(), "constant")
    erring = fit(seen, model="misconceptions")
    return {
        "log": log, "recording": seen.recording, "observations": seen.observations()[0], "people": people,
        "person": people["ann"], "erring": erring["ann"].misconception,
        "distribution": people.distribution(), "margin": people.distribution().beta, "goals": goals,
        "goals of an episode": goals.episodes[0], "models": models, "model": models.best, "influence": influence,
        "influence of a person": influence.people[0], "calibration": calibrate(people),
        "influence, advice": FittedAdvice("constant", "E", {"mu": 0.5}, -3.0, 2, 9),
    }  # fmt: skip


def test_a_bound_and_a_certificate_say_what_they_prove(results: dict[str, Any]) -> None:
    bound, none = results["bound"], results["certificate"]
    proves = f"upper bound {bound.upper:.3f} on the value of every policy"
    assert repr(bound) == f"<{proves} for 2 people drawn from the robot's prior, with free attention>"
    assert repr(none).startswith(
        f"<none: value {none.value:.3f} ± {none.value_stderr:.3f} over 10 episodes "
        "with people drawn from the robot's prior, gap at most "
    )


def test_frames_of_people_and_goals_have_their_names(learned: dict[str, Any]) -> None:
    frame = learned["people"].to_frame().set_index("person")
    assert frame.index.tolist() == ["ann", "bob"]
    assert frame.loc["ann", "theta_high"] == learned["person"].theta_interval[1]
    assert learned["goals"].to_frame()[["person", "goal", "kit"]].values.tolist() == [
        ["ann", "kit", 1.0], ["bob", "kit", 1.0],
    ]  # fmt: skip
    assert learned["log"].to_frame()["action"].tolist() == ACTIONS * 2
    assert learned["observations"].to_frame()["followed"].tolist() == [None, False, None, None]
    with pytest.raises(KeyError, match="did you mean 'bob'"):
        learned["people"]["bop"]


def test_people_who_acted_otherwise_are_another_result(learned: dict[str, Any]) -> None:
    others = [*rows(), *lines(*ACTIONS, person="cy")]
    assert fit("kitting/tiny", rows()) == learned["people"] != fit("kitting/tiny", others)
    assert learned["log"] != Log.of(others)
    assert replayed("kitting/tiny", rows()).observations()[0] == learned["observations"]


@pytest.mark.usefixtures("one_picture")
def test_a_report_of_a_study_is_a_result(small_study: tuple[Study, Path, dict[str, Any]]) -> None:
    study, folder, summary = small_study
    found = Report.of(study, folder)
    assert repr(study) == "<Study 'small': 13 pools, 248 episodes>"
    assert repr(found) == f"<Report of small: {len(summary['cells'])} cells, 248 episodes>"
    assert pickle.loads(pickle.dumps(found)) == found
    frame = found.to_frame()
    assert frame["interventions"].tolist() == [cell["interventions"]["mean"] for cell in summary["cells"]]
    assert "<td>attention</td>" in found._repr_html_()


def test_results_that_differ_are_not_equal(results: dict[str, Any]) -> None:
    pool, episodes, table = results["pool"], results["episodes"], results["table"]
    assert pool != Pool.sample(table, 3, seed=1)
    assert pool == Pool.sample(table, 3, seed=0)
    assert episodes != simulate(pool, "attention", humans=2, episodes=4, seed=1)
    assert table != cost_to_go("kitting/paper")
    assert table != 3
    assert results["bound"] != replace(results["bound"], upper=0.0)
    with pytest.raises(TypeError, match="unhashable"):
        hash(pool)


def test_a_pool_is_shown_with_its_people(results: dict[str, Any]) -> None:
    frame = results["pool"].to_frame()
    assert frame["beta"].tolist() == [human.beta for human in results["pool"].people]
    assert f"{results['pool'].people[1].theta:.4g}" in results["pool"]._repr_html_()


def test_long_tables_are_cut_and_say_so() -> None:
    pool = Pool.sample("kitting/tiny", MOST_ROWS + 5, seed=0)
    shown = pool._repr_html_()
    assert shown.count("<tr>") == MOST_ROWS + 1
    assert shown.endswith("<p>25 rows</p>")
    assert len(pool.to_frame()) == MOST_ROWS + 5


def test_what_cells_hold_is_no_markup() -> None:
    assert "<b>" not in html_table([{"<b>": "<b>"}])


@given(st.lists(st.floats(), max_size=5), st.lists(st.floats(), max_size=5))
def test_arrays_are_equal_by_entries(one: list[float], other: list[float]) -> None:
    a, b = np.array(one), np.array(other)
    assert same([a], [b]) == (len(a) == len(b) and bool(((a == b) | (np.isnan(a) & np.isnan(b))).all()))
    assert same((a, "x"), (a.copy(), "x"))
    assert not same((a, "x"), [a, "x"])


PAPER = kit("paper")


@pytest.fixture(scope="module")
def episodes() -> Episodes:
    return simulate(Pool.sample(kit("tiny"), 3, seed=1), "reactive", humans=2, episodes=5, seed=1)


def test_a_table_is_shown_by_states_cost_and_dead_ends(sealed: Table) -> None:
    assert repr(PAPER) == str(PAPER) == "<Table of paper: 836 states, cost 10 from the initial one, 0 dead ends>"
    dead = int(sealed.dead_end.sum())
    assert dead
    assert repr(sealed).endswith(
        f"{len(sealed):,} states, cost {sealed[sealed.initial]:g} from the initial one, {dead:,} dead ends>"
    )
    unsolvable = kit("unsolvable")
    assert "no way to the goal from the initial one" in repr(unsolvable)


def test_no_object_fills_the_screen(episodes: Episodes) -> None:
    plan = PAPER.optimal_plan() or []
    log = Log.of({"person": "ann", "episode": 1, "step": n, "action": a} for n, a in enumerate(plan))
    choices = Choices.of(PAPER)
    pomdp = AssistPOMDP.of(HumanModel.exact(choices))
    people = fit(PAPER, log)
    objects = [
        PAPER, PAPER.task, PAPER.space, PAPER.space.transitions, OnDemand(PAPER.task), choices, pomdp, pomdp.model,
        PersonProblem.of(PAPER), qmdp(pomdp), log, replay(log, PAPER)[0], people, people["ann"],
        Pool.sample(kit("tiny"), 12, seed=1), episodes, episodes[0], fit({"kit": "kitting/tiny"}, rows()).population(),
    ]  # fmt: skip
    for one in objects:
        assert len(repr(one)) < 800, type(one)
        assert " object at 0x" not in repr(one)
        assert repr(pickle.loads(pickle.dumps(one))) == repr(one)
    assert repr(choices).startswith("Choices(h=<float64 (836,)>, goal=<bool (836,)>, applicable=<bool (836, ")
    assert outline(episodes).startswith("Episodes(policy='reactive', episode=<int64 (5,)>, people=<int64 (5, 2)>, ")


def test_episodes_as_a_data_frame(episodes: Episodes) -> None:
    frame = episodes.to_frame()
    assert list(frame.columns) == [
        "policy", "episode", "person", "beta", "theta", "sigma", "actions", "cost", "finished", "helped",
        "executed", "interventions", "moves", "steps", "discounted_return",
    ]  # fmt: skip
    assert len(frame) == 10
    for row in frame.to_dict("records"):
        episode = episodes[int(row["episode"])]
        k = episode.people.index(row["person"])
        assert [row[name] for name in ("beta", "theta", "sigma", "actions", "finished", "helped")] == [
            getattr(episode, name)[k] for name in ("beta", "theta", "sigma", "actions", "finished", "helped")
        ]
        assert (row["cost"], row["policy"]) == (episode.costs[k], "reactive")
        assert row["discounted_return"] == episode.discounted_return
    mean = frame.groupby("episode")["actions"].mean().mean()
    assert mean == pytest.approx(episodes.summary().actions[0])
    assert [frame[name].dtype.kind for name in ("episode", "beta", "actions", "finished", "steps")] == list("ifibi")
    assert np.isfinite(frame["theta"]).all()


def test_without_pandas_the_extra_is_named(episodes: Episodes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingExtraError, match=r"a data frame needs pandas: .*\[study\]"):
        episodes.to_frame()
