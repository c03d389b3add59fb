"""Suggestion thresholds of policies that weigh costs and make no suggestion."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import KITTING, invoke
from fuzz import here
from studies import write

from assist import Pool, simulate
from assist.people.choices import Choices
from assist.people.human import HumanModel, Population
from assist.person import AssistPOMDP, Solution, solve, threshold_of
from assist.person.suggestion_threshold import SuggestionThreshold, priced, search_threshold
from assist.reports import study_report
from assist.reports.study_report import write_report
from assist.simulation.episode import plain_summary
from assist.study.protocol import read
from assist.study.runner import run_study
from assist.team.attention import AttentionSwitching
from assist.team.settings import Setting
from planner import Table

TINY = str(KITTING / "tiny.pddl")
STUDY = f"""
title = "dear"
seed = 5
repeats = 2
instances = ["{TINY}"]
humans = [1, 2]
pool = 4
draws = 2
trials = 2

[populations.everybody]

[[conditions]]
name = "first"
settings = [{{ c_suggest = 0.2 }}, {{ c_suggest = 40.0 }}]
"""


def pool_at(table: Table, c_suggest: float, **options: Any) -> Pool:
    setting = Setting(c_suggest=c_suggest, c_move=0.1)
    return Pool.sample(table, 4, seed=1, setting=setting, population=Population(beta=(0.5, 2.0)), **options)


@pytest.mark.parametrize("threshold", [0.9, 0.25, 0.2, 0.07, 0.004])
def test_the_largest_cost_is_found(threshold: float) -> None:
    tried: list[float] = []

    def suggests(cost: float) -> bool:
        tried.append(cost)
        return cost <= threshold

    found = search_threshold(1.0, suggests)
    assert found.worth_at is not None
    assert threshold / 1.3 < found.worth_at <= threshold
    assert found == SuggestionThreshold(1.0, max(cost for cost in tried if cost <= threshold), searched=True)
    assert len(tried) <= 8


def test_a_threshold_in_words() -> None:
    worth = "no suggestion was worth its cost (c_suggest 2)"
    for found, text in (
        (search_threshold(2.0, lambda cost: cost < 0.5), f"{worth}; from 0.4 downwards some are"),
        (search_threshold(2.0, lambda _: False), f"{worth}; none would be if they were free"),
        (search_threshold(2.0, lambda cost: cost == 0), f"{worth}; some would be if they were free"),
        (search_threshold(2.0, None), worth),
    ):
        assert str(found).replace("0.44", "0.4").replace("0.42", "0.4") == text
    assert search_threshold(0.0, lambda _: True) == SuggestionThreshold(0.0, None, searched=True)


@pytest.mark.parametrize(
    "policy", ["attention", *(pytest.param(name, marks=pytest.mark.slow) for name in ("attention-never", "priority"))]
)
def test_a_policy_without_suggestions_has_a_threshold(policy: str, tiny: Table) -> None:
    """With the same people and random numbers, suggestions are made at that cost, but not at the next one that was
    tried.
    """

    def run(c_suggest: float, **options: Any) -> Any:
        return simulate(pool_at(tiny, c_suggest), policy, humans=2, episodes=20, seed=3, **options)

    dear = run(40.0)
    found = dear.suggestion_threshold
    assert found is not None
    assert found.worth_at is not None
    assert not dear.interventions.any()
    assert run(found.worth_at).interventions.any()
    assert not run(found.worth_at * 1.5).interventions.any()
    summary = dear.summary()
    assert str(summary).endswith(f"; {found}")
    assert plain_summary(summary)["suggestion_threshold"] == {
        "c_suggest": 40.0,
        "worth_at": found.worth_at,
        "searched": True,
    }
    assert run(40.0, explain=False).suggestion_threshold is None
    assert run(40.0, jobs=2).suggestion_threshold == found
    speaks = run(found.worth_at)
    assert speaks.suggestion_threshold is None
    assert "worth" not in str(speaks.summary())


def test_only_policies_that_weigh_costs_are_asked(tiny: Table) -> None:
    pool = pool_at(tiny, 40.0)

    def own(team: Any) -> Any:
        return AttentionSwitching()(team)

    for policy in ("none", own):
        assert simulate(pool, policy, humans=2, episodes=5, seed=3).suggestion_threshold is None
    same = [simulate(pool, one, humans=2, episodes=5, seed=3) for one in ("attention", AttentionSwitching())]
    assert same[0].suggestion_threshold == same[1].suggestion_threshold is not None


def test_nobody_listens_and_nobody_is_looked_at(tiny: Table) -> None:
    deaf = Population(theta=(0.5, 0.5))  # whatever is suggested changes nothing
    setting = Setting(c_suggest=1.0, c_move=0.5, eta=0.0)
    pool = Pool.sample(tiny, 2, seed=1, setting=setting, population=deaf)
    assert simulate(pool, "attention", humans=2, episodes=5, seed=3).suggestion_threshold == SuggestionThreshold(
        1.0, None, searched=True
    )
    large = pool_at(tiny, 40.0, states=5, region=9)
    assert simulate(large, "attention", humans=2, episodes=5, seed=3).suggestion_threshold == SuggestionThreshold(
        40.0, None, searched=False
    )


def person(tiny: Table, c_suggest: float) -> Solution:
    return solve(AssistPOMDP.of(HumanModel.exact(Choices.of(tiny)), c_suggest=c_suggest), gap=0.01)


def test_a_person_who_is_best_left_alone(tiny: Table) -> None:
    found = threshold_of(person(tiny, 40.0))
    assert found is not None
    assert found.worth_at is not None
    assert threshold_of(person(tiny, found.worth_at)) is None
    solution = priced(person(tiny, 40.0).pomdp, 2.0)
    assert set(np.unique(solution.robot_costs)) == {0.0, 2.0}


def test_commands_say_it() -> None:
    options = (TINY, "--c-suggest", 40, "--json")
    result = invoke("policy", *options)
    found = json.loads(result.stdout)["suggestion_threshold"]
    assert found["c_suggest"] == 40.0
    assert found["worth_at"] > 0
    assert json.loads(invoke("policy", TINY, "--c-suggest", 0.2, "--json").stdout)["suggestion_threshold"] is None
    line = f"{SuggestionThreshold(40.0, found['worth_at'], searched=True)} (--c-suggest)"
    assert invoke("policy", *options[:-1]).stdout.splitlines()[-1] == line
    team = (*options, "--humans", 2, "--episodes", 5, "--policy", "none", "--policy", "attention")
    none, attention = json.loads(invoke("simulate", *team).stdout)["policies"]
    assert none["suggestion_threshold"] is None
    assert attention["suggestion_threshold"]["worth_at"] > 0
    lines = invoke("simulate", *(word for word in team if word != "--json")).stdout.splitlines()
    assert lines[-1].startswith("attention: no suggestion was worth its cost (c_suggest 40); from ")


def test_a_study_says_where_a_policy_is_no_assistance(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:

    monkeypatch.setattr(study_report, "_draw_all", lambda *_: None)
    monkeypatch.setattr("assist.study.runner.outcomes", here)
    study = read(write(tmp_path, STUDY))
    out = tmp_path / "out"
    assert run_study(study, out) == []
    summary = write_report(study, out)
    (row,) = summary["without_suggestions"]
    assert (row["policy"], row["setting"], row["c_suggest"], row["searched"]) == (
        "attention",
        "c_suggest 40",
        40.0,
        True,
    )
    threshold = SuggestionThreshold(40.0, row["worth_at"], searched=True)
    note = f"attention makes no suggestion (first, c_suggest 40, everybody, tiny): {threshold}"
    assert list(study_report.threshold_notes(summary)) == [note]
    assert f"\n\n**Note.** {note}.\n\n" in (out / "report.md").read_text()
    assert run_study(study, out, resume=True) == []
    assert write_report(study, out) == summary
