"""Printed representations of objects, and episodes as a data frame."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from conftest import kit

from assist import Pool, fit, simulate
from assist.learning.log import Log
from assist.learning.replay import replay
from assist.people.choices import Choices
from assist.people.human import HumanModel
from assist.person.person_problem import PersonProblem
from assist.person.pomdp import AssistPOMDP
from assist.person.qmdp import qmdp
from assist.team.episodes import Episodes
from planner import OnDemand, Table
from planner.system.arrays import outline
from planner.system.errors import MissingExtraError

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
        Pool.sample(kit("tiny"), 12, seed=1), episodes,
    ]  # fmt: skip
    assert {type(one).__name__: len(repr(one)) for one in objects if len(repr(one)) > 800} == {}
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
