"""Cases met in the use of `simulate`, `bound`, `study` and `export`, and of the environments."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from conftest import KITTING, invoke
from fuzz import here
from studies import write

from assist import Pool, simulate
from assist.people.choices import Choices
from assist.people.human import HumanModel, Population
from assist.person import AssistPOMDP, solve
from assist.person.qmdp import QMDP, qmdp
from assist.reports import study_report
from assist.reports.study_report import write_report
from assist.simulation.episode import plain_summary
from assist.study.protocol import read
from assist.study.runner import run_study
from assist.team import Robot
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


@pytest.mark.parametrize("policy", ["attention", "attention-never", "priority", "whittle", "rollout"])
def test_a_policy_that_weighs_costs_says_that_none_was_worth_it(policy: str, tiny: Table) -> None:
    """Nothing else is solved to say it."""
    solved: list[AssistPOMDP] = []

    def solver(pomdp: AssistPOMDP) -> QMDP:
        solved.append(pomdp)
        return qmdp(pomdp)

    pool = pool_at(tiny, 40.0, solver=solver)
    found = simulate(pool, policy, humans=2, episodes=20, seed=3)
    assert not found.interventions.any()
    assert len(solved) <= len(pool.people)
    summary = found.summary()
    assert str(summary).endswith("; no suggestion was worth its cost (c_suggest 40)")
    assert plain_summary(summary)["c_suggest_too_high"] == 40.0
    speaks = simulate(pool_at(tiny, 0.05), policy, humans=2, episodes=20, seed=3)
    assert speaks.c_suggest_too_high is None
    assert "worth" not in str(speaks.summary())


def test_only_policies_that_weigh_a_cost_say_so(tiny: Table) -> None:
    pool = pool_at(tiny, 40.0)
    for policy in ("none", lambda team: pool.policy("attention")(team)):
        assert simulate(pool, policy, humans=2, episodes=5, seed=3).c_suggest_too_high is None
    differ = Setting(robots=(Robot(c_suggest=40.0), Robot(c_suggest=50.0)))
    two = Pool.sample(tiny, 2, seed=1, setting=differ)
    assert simulate(two, "attention", humans=2, episodes=5, seed=3).c_suggest_too_high is None  # which of the two?


def test_a_person_who_is_best_left_alone(tiny: Table) -> None:
    for c_suggest, suggests in ((40.0, False), (0.2, True)):
        problem = AssistPOMDP.of(HumanModel.exact(Choices.of(tiny)), c_suggest=c_suggest)
        assert solve(problem, gap=0.01).suggests is suggests
    assert solve(problem, gap=0.0, time_limit=0.0).suggests  # it may


def test_commands_say_that_no_suggestion_was_worth_its_cost() -> None:
    options = (TINY, "--c-suggest", 40)
    line = "no suggestion was worth its cost (c_suggest 40) (--c-suggest)"
    assert json.loads(invoke("policy", *options, "--json").stdout)["c_suggest_too_high"] == 40.0
    assert json.loads(invoke("policy", TINY, "--c-suggest", 0.2, "--json").stdout)["c_suggest_too_high"] is None
    assert invoke("policy", *options).stdout.splitlines()[-1] == line
    team = (*options, "--humans", 2, "--episodes", 5, "--policy", "none", "--policy", "attention")
    none, attention = json.loads(invoke("simulate", *team, "--json").stdout)["policies"]
    assert (none["c_suggest_too_high"], attention["c_suggest_too_high"]) == (None, 40.0)
    assert invoke("simulate", *team).stdout.splitlines()[-1] == f"attention: {line}"


def test_a_study_says_where_a_policy_is_no_assistance(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study_report, "_draw_all", lambda *_: None)
    monkeypatch.setattr("assist.study.runner.outcomes", here)
    study = read(write(tmp_path, STUDY))
    out = tmp_path / "out"
    assert run_study(study, out) == []
    summary = write_report(study, out)
    (row,) = summary["without_suggestions"]
    assert (row["policy"], row["setting"], row["c_suggest"]) == ("attention", "c_suggest 40", 40.0)
    note = (
        "attention makes no suggestion (first, c_suggest 40, everybody, tiny): "
        "no suggestion was worth its cost (c_suggest 40)"
    )
    assert list(study_report.cost_notes(summary)) == [note]
    assert f"\n\n**Note.** {note}.\n\n" in (out / "report.md").read_text()
