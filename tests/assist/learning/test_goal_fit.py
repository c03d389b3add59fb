"""Estimates of people whose goal is one of several in each episode: the goals are summed out of the likelihood."""

from __future__ import annotations

import json
import warnings
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import KITTING, ROOT, invoke
from simulated_people import People, record
from test_unknown_goals import PRIOR, three_goals

from assist import Pool, simulate
from assist.learning import (
    FittedPeople,
    Log,
    Method,
    fit,
    fit_influence,
    infer_goals,
    log_likelihood,
    mixture,
    replayed,
)
from assist.people import Goals, choice, influence, lapse
from assist.people.decision import NOTHING
from assist.person import Setting
from planner import Table, load, sweep_goals

BETA = np.array([0.4, 0.8, 1.2, 1.6, 2.0, 2.4])
METHOD = Method(eta=0.2)


@cache
def recorded() -> tuple[Goals, Log]:
    """Six people of different expertise, in twelve episodes each: six with goal a, two with b, four with c."""
    goals, rng, rows = three_goals("tiny"), np.random.default_rng(4), list[dict[str, Any]]()
    people = People(BETA, np.full(len(BETA), 0.7))
    for (name, table), episodes in zip(goals.tables.items(), (6, 2, 4), strict=True):
        own = record(table, people, episodes=episodes, rng=rng, suggest=0.3)
        rows += [row | {"episode": f"{name}-{row['episode']}"} for row in own]
    return goals, Log.of(rows)


@cache
def fitted() -> FittedPeople:
    goals, log = recorded()
    return fit(goals.tables, log, METHOD, prior=PRIOR)


def by_definition(goals: dict[str, Table], rows: list[dict[str, Any]], beta: float, theta: float, eta: float) -> float:
    """The log-likelihood of one person's actions."""
    total = 0.0
    for episode in sorted({row["episode"] for row in rows}):
        shares = []
        for name, table in goals.items():
            x, now, p = table.initial, theta, PRIOR[name]
            for row in (row for row in rows if row["episode"] == episode):
                found = table.choices([x])
                actions = [table.task.actions[a] for a in found.actions]
                q = np.array([table.task.costs[a] for a in found.actions]) + table.lookup(found.targets)
                told = -1 if row["suggestion"] is None else actions.index(row["suggestion"])
                slot, every = actions.index(row["action"]), np.ones((1, len(q)), dtype=bool)
                chances = choice(q[None], every, np.array([beta]))
                if table.is_goal([x])[0]:
                    chances[:] = 0.0
                else:
                    chances = influence(chances, np.array([told]), np.array([now]))
                    if told >= 0:
                        now = float(np.clip(now + eta * (q.min() - table.lookup(found.targets)[told]), 0, 1))
                p *= lapse(chances, every, METHOD.lapse)[0, slot]
                x = int(found.targets[slot])
            shares.append(p)
        total += float(np.log(sum(shares)))
    return total


@pytest.mark.parametrize(("beta", "theta", "eta"), [(0.5, 0.7, 0.2), (2.0, 0.1, 0.0), (1.0, 0.9, 0.9)])
def test_the_likelihood_is_that_of_the_definition(beta: float, theta: float, eta: float) -> None:
    goals, log = recorded()
    person = next(iter(fitted().values()))
    rows = [vars(entry) for entry in log.entries if entry.person == person.person]
    grid = [np.array([one]) for one in (beta, theta, eta)]
    found = log_likelihood(person.observations, *grid, METHOD).item()
    assert found == pytest.approx(by_definition(dict(goals.tables), rows, beta, theta, eta), abs=1e-9)


def test_influence_is_not_carried_where_goals_are_unknown() -> None:
    observations = [person.observations for person in fitted().values()]
    with pytest.raises(ValueError, match="carry: expected False, since each episode has one of several goals"):
        fit_influence(observations, "constant")
    found = fit_influence(observations, "constant", METHOD, carry=False)
    for o, one in zip(observations, found.people, strict=True):  # each suggestion counts once, not for each goal
        heard = o.suggested != NOTHING
        followed = (o.chosen == o.suggested)[heard]
        assert (one.suggestions, one.followed) == (int(heard.sum()), int(followed.sum()))
    own = [log_likelihood(o, np.array([one.beta]), np.array([one.theta_first]), np.array([0.0]), METHOD).item()
           for o, one in zip(observations, found.people, strict=True)]  # fmt: skip
    assert found.log_likelihood < sum(own) < found.log_likelihood + 5 * len(own)


def test_estimates_are_near_the_truth() -> None:
    """Where one goal is assumed, work on another looks like mistakes."""
    people = fitted()
    assert list(people) == People(BETA, BETA).names()
    ends = np.array([person.beta_interval for person in people.values()])
    assert ((ends[:, 0] <= BETA) & (ends[:, 1] >= BETA)).sum() >= 5
    goals, log = recorded()
    assumed = fit(goals.tables["a"], log, method=METHOD)
    found, wrong = (np.array([one.estimates["beta"].value for one in each.values()]) for each in (people, assumed))
    assert (wrong[1:] < found[1:]).all()
    errors = [np.abs(each - BETA)[1:-1].mean() for each in (found, wrong)]  # the best person made no mistake
    assert errors[0] < errors[1] / 2
    assert people.distribution().beta.mean == pytest.approx(BETA.mean(), abs=0.3)


def test_a_trace_of_several_goals_that_is_read_as_one_goal_is_told(tmp_path: Path) -> None:
    goals, trace = three_goals("tiny"), list[dict[str, Any]]()
    setting = Setting(max_steps=5, knowledge="exact")
    simulate(Pool.sample(goals, 2, seed=1, setting=setting), "none", humans=2, episodes=6, seed=1, trace=trace)
    rows = [{"theta": 0.5, **row} for row in trace]
    assert len({row["goal"] for row in rows}) > 1
    with pytest.warns(UserWarning, match="all episodes are read as if they had one goal, and a simulation wrote "):
        replayed(goals.tables["a"], rows)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        replayed(dict(goals.tables), rows)
        replayed(goals.tables["a"], [row | {"goal": "a"} for row in rows])
    file = tmp_path / "trace.jsonl"
    file.write_text("".join(json.dumps(row) + "\n" for row in rows))
    assert "expected --goals" in invoke("fit", KITTING / "tiny.pddl", file).stderr


def test_the_posterior_over_goals_is_that_of_infer_goals() -> None:
    """Without suggestions, at a known beta; a goal that is certain changes nothing but that the model is unchecked."""
    goals, log = recorded()
    plain = Log.of(
        [vars(entry) | {"suggestion": None} for entry in log.entries if entry.person in {"person-3", "person-4"}]
    )
    found = fit(goals.tables, plain, prior=PRIOR)["person-3"]
    beta = [found.estimates["beta"].value]
    inferred = infer_goals(goals.tables, plain, prior=PRIOR, beta=beta)
    known = {one.episode: one.posterior[-1] for one in inferred.episodes if one.person == "person-3"}
    shown = found.as_dict()["goals"]
    assert set(shown) == set(known)
    for episode, shares in shown.items():
        np.testing.assert_allclose(list(shares.values()), known[episode], atol=1e-12)
    only = Log.of([vars(entry) for entry in log.entries if entry.episode.startswith("a-")])
    certain = fit({"a": goals.tables["a"]}, only, METHOD)["person-2"]
    one = fit(goals.tables["a"], only, method=METHOD)["person-2"]
    assert certain.log_likelihood == pytest.approx(one.log_likelihood)
    assert certain.beta == pytest.approx(one.beta, rel=1e-3)
    assert certain.beta_interval == pytest.approx(one.beta_interval, rel=1e-3)


@pytest.mark.cases
def test_mistakes_are_counted_with_each_goal_by_its_probability() -> None:
    """A first action that leads to two goals alike is no mistake that depends on which of them is named first."""
    for one in fitted().values():
        o, shares = one.observations, one.goal_posteriors()
        names = [episode for episode, begins in zip(np.array(o.episodes)[o.begins.cumsum() - 1], o.begins, strict=True)]
        over = zip(o.goals.names, o.goals.each, o.goals.reached, strict=True)
        wrong = {name: each.mistake | reached for name, each, reached in over}
        mean = sum(shares[episode][name] * wrong[name][i] for i, episode in enumerate(names) for name in wrong)
        assert one.suboptimal_actions == pytest.approx(mean)
        assert one.as_dict()["suboptimal_actions"] == one.suboptimal_actions
    tables = recorded()[0].tables
    step = {"person": "p", "episode": "1", "step": 0, "suggestion": None}
    first = next(row["action"] for row in Log.of([step | {"action": "(fetch box-a)"}]).records())
    in_either_order = [
        fit({name: tables[name] for name in order}, Log.of([step | {"action": first}]), METHOD)["p"].suboptimal_actions
        for order in (sorted(tables), sorted(tables, reverse=True))
    ]
    assert in_either_order[0] == pytest.approx(in_either_order[1])


def test_the_command(tmp_path: Path) -> None:
    kits, log, people = ROOT / "docs" / "examples" / "kits", tmp_path / "log.jsonl", tmp_path / "people.json"
    given = [kits / "travel.pddl", "--goals", kits, "--humans", "2", "--pool", "3", "--episodes", "2"]
    invoke("simulate", *given, "--policy", "none", "--trace", log)
    asked = ["fit", kits / "travel.pddl", log, "--goals", kits, "--set", "goal_prior=travel=.4,mend=.4,mount=.2"]
    result = invoke(*asked, "--json", "--write-population", people)
    assert result.exit_code == 0, result.stderr
    for record_ in json.loads(result.stdout):
        assert record_["beta_interval"][0] <= (record_["beta"] or 1e9)
        assert all(sum(shares.values()) == pytest.approx(1) for shares in record_["goals"].values())
    assert mixture(json.loads(people.read_text())).parts
    for more, message in (
        (["--terms"], "--goals and --terms: expected one of them"),
        (["--figures", tmp_path / "figures"], "--goals and --figures: expected one of them"),
    ):
        result = invoke(*asked, *more)
        assert (result.exit_code, message in result.stderr) == (2, True)
    advised = tmp_path / "advised.jsonl"
    costs = ("--set", "c_suggest=0.02", "--set", "c_move=0.02")
    invoke("simulate", *given, *costs, "--policy", "attention", "--trace", advised)
    found = invoke("fit", asked[1], advised, *asked[3:], "--influence", "constant", "--json")
    prior = {"travel": 0.4, "mend": 0.4, "mount": 0.2}
    tables = dict(zip(prior, sweep_goals([load(kits / f"{name}.pddl") for name in prior]), strict=True))
    same = fit_influence(replayed(tables, advised, prior=prior), "constant", carry=False)
    assert found.exit_code == 0, found.stderr
    assert json.loads(found.stdout)["log_likelihood"] == pytest.approx(same.log_likelihood, abs=1e-6)
    result = invoke(*asked[:3], "--set", "goal_prior=travel=1")
    assert (result.exit_code, "--set goal_prior has no effect without --goals" in result.stderr) == (2, True)
