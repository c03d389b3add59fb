"""Estimates from recorded actions: by hand, by brute force and on grids of all parameters, and through the command."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from math import exp, log
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import KITTING, costly, invoke, kit
from hypothesis import given
from hypothesis import strategies as st
from recorded import BACK, FETCH, RIGHT, WRONG, lines, people_at_work, write_log
from scipy.stats import kstest

from assist import Pool, fit, simulate
from assist.learning import FittedPeople, Log, misconception_fit, observed
from assist.learning.diagnostics import calibrate, check
from assist.learning.distribution import mixture
from assist.learning.likelihood import Method, largest_beta
from assist.learning.likelihood_table import log_likelihood
from assist.learning.maximum_likelihood import maximum_likelihood
from assist.learning.misconception_fit import MarginalLikelihood, Uncertain, fit_misconception
from assist.learning.observations import Observations
from assist.learning.person_estimate import PersonEstimate
from assist.learning.population import fit_population
from assist.people.belief import Grid
from assist.people.choices import Choices
from assist.people.human import HumanModel
from assist.people.ranges import Population
from assist.person.pomdp import AssistPOMDP
from assist.person.settings import Setting
from planner import LimitError, Table, Task
from planner.costtogo import on_demand
from planner.system.errors import InputFileError


@pytest.fixture(scope="module")
def paper() -> Table:
    return kit("paper")


@pytest.fixture(scope="module")
def paper_choices(paper: Table) -> Choices:
    return Choices.of(paper)


@pytest.fixture(scope="module")
def team(paper: Table, paper_choices: Choices) -> list[Observations]:
    rows = people_at_work(paper_choices, [0.3, 0.8, 1.5], np.random.default_rng(4), suggest=0.5)
    return observed(paper, rows)


@pytest.fixture(scope="module")
def fits(team: list[Observations]) -> list[PersonEstimate]:
    return maximum_likelihood(team)


def test_the_likelihood_by_hand(tiny: Table) -> None:
    """On the tiny kit, after fetching box-a, Q is 5 for the right slot, and 7 for the wrong slot and for going back.

    At the start both boxes are equivalent. With the hammer in slot-2, the only good action is to remove it.
    """
    rows = lines(FETCH, WRONG, "(remove hammer slot-2 box-a)", RIGHT, told={1: RIGHT, 3: RIGHT})
    (o,) = observed(tiny, rows)
    assert o.regret.tolist() == [0, 2, 0, 0]
    assert o.suboptimal == 1
    assert o.cost_to_go.tolist() == [6, 5, 6, 5]
    assert o.gain.tolist() == [0, 1, 0, 1]  # both suggestions lead one action nearer
    beta, theta, eta, lapse = 0.7, 0.3, 0.2, 1e-3
    e = exp(-2 * beta)
    good, bad = 1 / (1 + 2 * e), e / (1 + 2 * e)
    undone = 1 / (1 + e)  # of taking the hammer out and returning box-a
    refused = (1 - theta) * bad / (theta * good + (1 - theta) * 2 * bad)
    later = theta + eta / 2  # trust grows by the first suggestion, though it was refused
    taken = later * good / (later * good + (1 - later) * 2 * bad)
    expected = sum(log((1 - lapse) * p + lapse / n) for p, n in ((0.5, 2), (refused, 3), (undone, 2), (taken, 3)))
    method = Method(lapse=lapse, utility_scale=2.0)
    found = log_likelihood(o, np.array([beta]), np.array([theta]), np.array([eta]), method)
    assert found.shape == (1, 1, 1)
    assert found[0, 0, 0] == pytest.approx(expected, rel=1e-12)


def test_estimates_and_intervals_against_a_dense_grid(team: list[Observations], fits: list[PersonEstimate]) -> None:
    beta, theta, eta = np.linspace(0, 5, 126), np.linspace(0, 1, 41), np.linspace(0, 1, 41)
    for o, found in zip(team[1:2], fits[1:2], strict=True):
        values = log_likelihood(o, beta, theta, eta)
        best = values.max()
        assert found.log_likelihood >= best - 1e-9
        own = log_likelihood(o, *(np.array([e.value]) for e in found.estimates.values())).item()
        assert found.log_likelihood == pytest.approx(own, abs=2e-6)
        for axis, (grid, estimate) in enumerate(zip((beta, theta, eta), found.estimates.values(), strict=True)):
            profile = values.max(axis=tuple({0, 1, 2} - {axis}))
            inside = grid[profile >= found.log_likelihood - 1.9207]
            width = grid[1]
            assert estimate.interval[0] == pytest.approx(inside.min(), abs=1.6 * width)
            assert estimate.interval[1] == pytest.approx(inside.max(), abs=1.6 * width)
            assert estimate.interval[0] <= estimate.value <= estimate.interval[1]


@costly(4, 40)
@given(st.integers(0, 10_000), st.floats(0.1, 3.0))
def test_laws_of_estimates(seed: int, beta: float) -> None:
    rows = people_at_work(TINY_CHOICES, [beta], np.random.default_rng(seed), suggest=0.3, episodes=2)
    (found,) = maximum_likelihood(observed(TINY, rows), Method(eta=0.2))
    (wide,) = maximum_likelihood(observed(TINY, rows), Method(eta=0.2, level=0.99))
    assert ("theta" in found.estimates) == any(row["suggestion"] is not None for row in rows)
    for name, estimate in found.estimates.items():
        wider = wide.estimates[name]
        low, high = estimate.interval
        assert 0 <= low <= estimate.value <= high <= 5
        assert wider.interval[0] <= low + 2e-3
        assert wider.interval[1] >= high - 2e-3
    shuffled = [rows[i] for i in np.random.default_rng(seed).permutation(len(rows))]
    (again,) = maximum_likelihood(observed(TINY, shuffled), Method(eta=0.2))
    assert (again.estimates, again.log_likelihood) == (found.estimates, found.log_likelihood)
    np.testing.assert_allclose(found.probabilities().sum(axis=1), 1.0)


TINY = kit("tiny")
TINY_CHOICES = Choices.of(TINY)
PLAN = TINY.optimal_plan() or []


def test_who_never_errs_gets_a_stated_bound(tiny: Table) -> None:
    """Six actions without a mistake: beta's lower bound is where they have the probability exp(-1.92)."""
    (o,) = observed(tiny, lines(*PLAN))
    (found,) = maximum_likelihood([o])
    assert o.suboptimal == 0
    assert found.estimates["beta"].value == found.beta_interval[1] == pytest.approx(5.0)  # 10 for mistakes that cost 2
    assert found.estimates["beta"].open_above
    low = found.beta_interval[0]
    values = log_likelihood(o, np.array([low, 5.0]), np.array([0.5]), np.array([0.0])).ravel()
    assert values[1] - values[0] == pytest.approx(1.9207, abs=1e-3)
    (other,) = maximum_likelihood([o], Method(largest_beta=3.0))
    assert other.beta_interval[1] == other.estimates["beta"].value == pytest.approx(3.0)


def test_theta_stays_where_its_rate_is_known_to_be_zero(tiny: Table) -> None:
    (found,) = maximum_likelihood(observed(tiny, lines(FETCH, WRONG, told={0: FETCH, 1: RIGHT})), Method(eta=0.0))
    assert (found.rate, set(found.thetas())) == (0.0, {found.estimates["theta"].value})


def test_random_actions_and_no_choices(tiny: Table) -> None:
    (back_and_forth,) = maximum_likelihood(observed(tiny, lines(*[FETCH, BACK] * 10)))
    assert back_and_forth.estimates["beta"].value == 0
    assert back_and_forth.estimates["beta"].open_below
    assert back_and_forth.beta_interval[0] == 0
    assert back_and_forth.beta_interval[1] < 1
    (silent,) = maximum_likelihood(observed(tiny, lines(FETCH)))
    assert not silent.estimates["beta"].identified
    assert list(silent.estimates) == ["beta"]


def test_dead_ends_do_no_harm(sealed: Table) -> None:
    choices = Choices.of(sealed)
    rng = np.random.default_rng(0)
    x, rows = choices.initial, []
    for step in range(40):
        slots = np.flatnonzero(choices.applicable[x])
        slot, told = (int(rng.choice(slots)) for _ in range(2))
        rows.append(
            {"person": "a", "episode": "1", "step": step, "action": choices.name(x, slot),
             "suggestion": choices.name(x, told)}
        )  # fmt: skip
        x = int(choices.targets[x, slot])
    (o,) = observed(sealed, rows)
    assert np.isinf(o.cost_to_go).any()
    (found,) = maximum_likelihood([o])
    assert np.isfinite(found.log_likelihood)
    assert o.suboptimal > 1
    assert check(found, rng).p is not None
    assert np.isfinite(fit_misconception(found).log_likelihood)


@pytest.mark.slow
def test_people_are_found_again(paper: Table, paper_choices: Choices) -> None:
    """Forty people: intervals cover at least 90 %, and the order of beta is recovered."""
    rng = np.random.default_rng(7)
    beta = np.geomspace(0.1, 3.0, 40)
    found = maximum_likelihood(
        observed(paper, people_at_work(paper_choices, beta.tolist(), rng, suggest=0.4)), Method(eta=0.2)
    )
    found = sorted(found, key=lambda f: int(f.observations.person[1:]))
    covered = [f.beta_interval[0] <= b <= f.beta_interval[1] for f, b in zip(found, beta, strict=True)]
    assert sum(covered) >= 36
    ranks = np.argsort(np.argsort([f.estimates["beta"].value for f in found]))
    assert np.corrcoef(ranks, np.arange(40))[0, 1] > 0.9
    told = [f.estimates["theta"] for f in found if "theta" in f.estimates]
    assert sum(one.interval[0] <= 0.6 <= one.interval[1] for one in told) >= 0.88 * len(told)

    found_population = fit_population([f.observations for f in found], Method(eta=0.2))
    assert found_population.beta.recorded[0] == pytest.approx(beta.mean(), rel=0.1)
    assert found_population.theta is not None
    assert found_population.theta.mean == pytest.approx(0.6, abs=0.06)
    population = found_population.population()
    assert mixture(json.loads(json.dumps(found_population.as_dict()))) == population
    drawn = population.sample(TINY_CHOICES, 3000, rng)
    assert np.mean([human.beta for human in drawn]) == pytest.approx(found_population.beta.mean, rel=0.08)
    assert np.mean([human.theta for human in drawn]) == pytest.approx(found_population.theta.mean, rel=0.03)

    # These people include more novices than a uniform distribution, and the data show it.
    even = fit_population([f.observations for f in found], Method(eta=0.2), family="uniform").beta
    assert even.mean > 1.2 * beta.mean()
    assert even.recorded[0] == pytest.approx(beta.mean(), rel=0.1)

    free = fit_population([f.observations for f in found], Method(eta=0.2), family="histogram")
    assert free.log_likelihood >= found_population.log_likelihood - 0.5
    assert sum(free.population().shares) == pytest.approx(1)
    # The most likely shares equal the mean posterior of the people.
    assert free.beta.recorded == pytest.approx((free.beta.mean, free.beta.spread), rel=1e-3)
    with pytest.raises(ValueError, match="unknown family"):
        fit_population([f.observations for f in found], family="cauchy")


def test_a_mixture_is_the_sum_of_its_parts() -> None:
    low, high = Population((0.1, 0.5), (0.5, 0.55)), Population((2.0, 2.5), (0.8, 0.9))
    both = Population.mixed((low, high), (0.25, 0.75))
    assert (both.beta, both.theta) == ((0.1, 2.5), (0.5, 0.9))
    grid = Grid.regular(both)
    np.testing.assert_allclose(grid.prior(both), 0.25 * grid.prior(low) + 0.75 * grid.prior(high))
    people = both.sample(TINY_CHOICES, 400, np.random.default_rng(0))
    assert np.mean([human.beta > 1 for human in people]) == pytest.approx(0.75, abs=0.07)
    with pytest.raises(ValueError, match="add up to"):
        Population.mixed((low, high), (0.5, 0.6))


def test_misconceptions_are_told_from_carelessness(paper: Table, paper_choices: Choices) -> None:
    """Repeated equal mistakes indicate sigma; varying mistakes indicate a smaller beta."""
    rng = np.random.default_rng(2)
    noise = rng.standard_normal(len(paper))
    mistaken = observed(paper, people_at_work(paper_choices, [2.0], rng, episodes=12, noise=noise))
    uncertain = Uncertain.of(mistaken[0])
    assert uncertain.band < len(uncertain.states) / 2  # people pass from state to state
    careless = observed(paper, people_at_work(paper_choices, [0.7], rng, episodes=12))
    first, second = (maximum_likelihood(o)[0] for o in (mistaken, careless))
    assert first.estimates["beta"].value < 1.2  # the plain model takes misconceptions for a lack of expertise
    found = fit_misconception(first)
    assert found.interval[0] > 0.3
    assert found.interval[0] <= 1.0 <= found.interval[1]
    assert found.beta > first.estimates["beta"].value
    assert found.log_likelihood > found.without + 5
    assert np.corrcoef(found.perceived - found.cost_to_go, noise[found.states])[0, 1] > 0.35
    none = fit_misconception(second)
    assert none.interval[0] < 0.05
    assert none.log_likelihood < none.without + 1.92
    p = check(first, rng).p
    assert p is not None
    assert p < 0.01
    assert check(first, rng).striking == "repetition"
    p = check(second, rng).p
    assert p is not None
    assert p > 0.05


def test_the_marginal_likelihood_of_one_choice_against_quadrature(tiny: Table) -> None:
    """Two alternatives with one uncertain cost each: a Gaussian integral of a logistic function."""
    rows = lines(FETCH, WRONG, "(remove hammer slot-2 box-a)")
    (found,) = maximum_likelihood(observed(tiny, rows[:3]))
    model = MarginalLikelihood(found)
    beta, sigma = 0.8, 0.5
    value, z = model.marginal(beta, sigma)
    draws = beta * sigma * np.random.default_rng(0).standard_normal((5_000, len(z)))
    chance = np.mean([np.exp(model._terms(beta, np.append(row, 0.0))[0]) for row in draws])
    assert value == pytest.approx(np.log(chance), abs=0.03)


@costly(2, 20)
@given(st.integers(0, 10_000))
def test_the_marginal_likelihood_is_laplaces_with_the_whole_matrix(seed: int) -> None:
    """The mode is where the gradient is 0, and the determinant that of the matrix of second derivatives."""
    rng = np.random.default_rng(seed)
    (found,) = maximum_likelihood(observed(TINY, people_at_work(TINY_CHOICES, [0.3], rng, suggest=0.3, episodes=3)))
    model, beta, sigma = MarginalLikelihood(found), 1.0, 2.0
    value, z = model.marginal(beta, sigma)
    m, precision = len(z), (beta * sigma) ** -2

    def log_posterior(point: np.ndarray) -> float:
        return model._terms(beta, np.append(point, 0.0))[0] - float(point @ point) * precision / 2

    p, matrix = model._terms(beta, np.append(z, 0.0))[1], np.eye(m + 1) * precision
    for own, index in zip(p, model.index, strict=True):
        np.add.at(matrix, (index, index), own)
        np.subtract.at(matrix, (index[:, None], index), own[:, None] * own)
    _, determinant = np.linalg.slogdet(matrix[:m, :m])
    assert value == pytest.approx(log_posterior(z) - determinant / 2 + m * np.log(precision) / 2, abs=1e-6)
    for _ in range(3):
        assert log_posterior(z + rng.normal(0, 0.05, m)) <= log_posterior(z) + 1e-7


def test_misconceptions_that_take_too_much_memory_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The memory is checked before it is allocated, and the error is one line."""
    monkeypatch.setattr(Uncertain, "megabytes", 1e9)
    monkeypatch.setattr(misconception_fit.MarginalLikelihood, "__init__", lambda *_: pytest.fail("it was taken"))
    file = write_log(tmp_path / "log.jsonl", lines(*PLAN))
    result = invoke("fit", "kitting/tiny", file, "--misconception")
    assert (result.exit_code, result.stdout) == (1, "")
    assert result.stderr.splitlines()[-1].startswith("out of memory: person 'ann': misconceptions about 8 states take")


def test_calibration_counts_every_choice(team: list[Observations], fits: list[PersonEstimate]) -> None:
    c = calibrate(fits)
    assert c.count.sum() == sum(o.applicable.sum() for o in team)
    assert (c.observed * c.count).sum() == pytest.approx(sum(map(len, team)))
    assert ((c.low <= c.observed + 1e-12) & (c.observed <= c.high + 1e-12)).all()
    # By hand, of five bins: those of the predicted probability.
    p = np.concatenate([f.probabilities()[f.observations.applicable] for f in fits])
    of_bins = [p[(p >= k / 5) & (p < (k + 1) / 5 + (k == 4))] for k in range(5)]
    few = calibrate(fits, bins=5)
    assert few.count.tolist() == [len(part) for part in of_bins if len(part)]
    assert few.predicted == pytest.approx([part.mean() for part in of_bins if len(part)])


def test_people_for_whom_the_model_holds_are_predicted(paper: Table, paper_choices: Choices) -> None:
    """For people of the model, frequencies differ from predictions only by chance, and check p is uniform.

    For other people neither holds.
    """
    rng = np.random.default_rng(3)
    betas = np.linspace(0.3, 1.2, 40).tolist()
    found = maximum_likelihood(observed(paper, people_at_work(paper_choices, betas, rng, episodes=2)))

    def off(fits: list[PersonEstimate]) -> float:
        """The largest difference in ten bins, in standard errors."""
        c = calibrate(fits)
        return float(np.abs((c.observed - c.predicted) / np.sqrt(c.predicted * (1 - c.predicted) / c.count)).max())

    assert off(found) < 2.8  # exceeded by chance in 5 of 100
    for factor in (0.5, 2.0):
        beta = [replace(f.estimates["beta"], value=factor * f.estimates["beta"].value) for f in found]
        others = [replace(f, estimates={**f.estimates, "beta": b}) for f, b in zip(found, beta, strict=True)]
        assert off(others) > 4.0
    p = [check(f, rng, 199).p for f in found]
    assert None not in p
    assert kstest(p, "uniform").pvalue > 0.05


def test_the_online_belief_is_the_offline_likelihood(tiny: Table, tiny_choices: Choices) -> None:
    """Without suggestions the belief over beta is the normalised likelihood, and closes in on the estimate."""
    grid = Grid(np.linspace(0.05, 3.0, 60), np.array([0.0, 0.5, 1.0]))
    pomdp = AssistPOMDP.of(HumanModel.exact(tiny_choices), grid=grid)
    rows = people_at_work(tiny_choices, [1.2], np.random.default_rng(5), episodes=60)
    (o,) = observed(tiny, rows)
    belief = pomdp.prior[None]
    for x, slot in zip(o.state, o.chosen, strict=True):
        belief = pomdp.update(belief, np.array([x]), np.array([0]), np.array([slot]))
    online = belief[0].sum(axis=1)
    likelihood = log_likelihood(o, grid.beta, np.array([0.5]), np.array([0.0])).ravel()
    offline = pomdp.prior.sum(axis=1) * np.exp(likelihood - likelihood.max())
    np.testing.assert_allclose(online, offline / offline.sum(), rtol=1e-6, atol=1e-12)
    (found,) = maximum_likelihood([o])
    assert grid.beta[online.argmax()] == pytest.approx(found.estimates["beta"].value, abs=0.05)
    assert found.beta_interval[0] < grid.beta @ online < found.beta_interval[1]


def test_the_online_belief_with_suggestions(tiny: Table, tiny_choices: Choices) -> None:
    """Within an episode, on a fine grid, the belief is the likelihood averaged over theta's prior."""
    grid = Grid(np.linspace(0.05, 3.0, 30), np.linspace(0.0, 1.0, 201))
    pomdp = AssistPOMDP.of(HumanModel.exact(tiny_choices, eta=0.1), grid=grid, suggestions="all")
    rows = people_at_work(tiny_choices, [0.4], np.random.default_rng(11), suggest=0.7, eta=0.1, episodes=1)
    (o,) = observed(tiny, rows)
    assert (o.suggested >= 0).sum() >= 4
    belief = pomdp.prior[None]
    for x, told, slot in zip(o.state, o.suggested, o.chosen, strict=True):
        robot = 0 if told < 0 else int(np.flatnonzero(pomdp.suggested[x] == told)[-1])
        belief = pomdp.update(belief, np.array([x]), np.array([robot]), np.array([slot]))
    likelihood = np.exp(log_likelihood(o, grid.beta, grid.theta, np.array([0.1]))[:, :, 0])
    offline = (pomdp.prior * likelihood).sum(axis=1)
    np.testing.assert_allclose(belief[0].sum(axis=1), offline / offline.sum(), rtol=0.02)


@pytest.mark.slow
def test_a_simulations_trace_is_a_log_and_a_fit_is_a_population(tmp_path: Path) -> None:
    trace = tmp_path / "trace.jsonl"
    tiny = KITTING / "tiny.pddl"
    team = ("simulate", tiny, "--humans", 3, "--episodes", 10, "--pool", 4, "--policy", "reactive")
    assert invoke(*team, "--trace", trace).exit_code == 0
    files = {name: tmp_path / name for name in ("people.jsonl", "population.json", "figures")}
    result = invoke(
        "fit", tiny, trace, "--out", files["people.jsonl"], "--write-population", files["population.json"],
        "--figures", files["figures"], "--misconception",
    )  # fmt: skip
    assert (result.exit_code, "trace.jsonl" in result.stderr) == (0, False)
    records = [json.loads(line) for line in files["people.jsonl"].read_text().splitlines()]
    assert [r["person"] for r in records] == [f"human-{k}" for k in range(1, 5)]
    rows = [json.loads(line) for line in trace.read_text().splitlines()]
    for r in records:
        own = [row for row in rows if row["person"] == r["person"]]
        assert r["actions"] == len(own)
        assert r["suggestions"] == sum(row["suggestion"] is not None for row in own)
        assert r["suboptimal_actions"] == sum(row["cost_to_go_after"] >= row["cost_to_go"] for row in own)
        assert r["misconception"]["sigma_interval"][0] <= r["misconception"]["sigma"]
        assert "in-storage(box-a)" in " ".join(r["misconception"]["states"][0]["facts"])
    assert sorted(f.name for f in files["figures"].iterdir()) == [
        "calibration.png", "episodes.png", "errors.png", "expertise.png",
    ]  # fmt: skip
    (family,) = re.findall(r"population of 4: beta is (.+), mean", result.stdout)
    assert re.fullmatch(r"(log-)?uniform from [\d.]+ to [\d.]+|log-normal", family)
    again = invoke(*team, "--population", files["population.json"], "--json")
    assert again.exit_code == 0
    assert json.loads(again.stdout)["population"]["parts"]
    other = invoke(*team, "--population", trace)
    assert other.exit_code == 2
    assert f"{trace}" in other.stderr


def test_a_search_out_of_time_costs_the_actions_that_need_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = write_log(tmp_path / "log.jsonl", [*lines(*PLAN), *lines(FETCH, person="bob")])
    command = ("fit", "kitting/tiny", file, "--json", "--set", "max_states=1", "--jobs", 1)
    astar = on_demand.astar

    def slow(task: Task, values: tuple[int, ...], **rest: Any) -> Any:
        if any("hammer" in fact and "slot-2" in fact for fact in task.facts(list(values))):
            raise LimitError("out of time")
        return astar(task, values, **rest)

    monkeypatch.setattr(on_demand, "astar", slow)
    result = invoke(*command, "--set", f"cache={tmp_path / 'first'}")
    assert result.exit_code == 1
    assert "out of time; actions that depend on them are left out" in result.stderr
    ann, bob = json.loads(result.stdout)
    assert ann["left_out"] > 0
    assert ann["actions"] + ann["left_out"] == len(PLAN)
    assert ann["notes"][0] == f"{ann['left_out']} actions are left out, since states were not evaluated in time"
    assert (bob["actions"], bob["left_out"]) == (1, 0)
    strict = invoke(*command, "--set", f"cache={tmp_path / 'second'}", "--strict")
    assert (strict.exit_code, strict.stdout) == (1, "")
    assert "out of time" in strict.stderr


def test_a_task_without_a_way_to_the_goal(tmp_path: Path) -> None:
    file = write_log(tmp_path / "log.jsonl", lines(*PLAN))
    result = invoke("fit", "kitting/unsolvable", file)
    assert (result.exit_code, result.stdout) == (1, "")
    assert "unsolvable.pddl: the goal is unreachable or holds in the initial state" in result.stderr


@pytest.mark.parametrize("bad", [{}, {"parts": [1]}, {"parts": []}, {"parts": [{"share": 1, "beta": [1, 2]}]}, []])
def test_what_is_no_population_is_refused(bad: object) -> None:
    with pytest.raises(ValueError, match="expected"):
        mixture(bad)  # type: ignore[arg-type]


def two_people(told: str | None) -> Log:
    """Return a log of two people who do the same; one of them hears a suggestion, or nobody."""
    actions = (FETCH, WRONG, "(remove hammer slot-2 box-a)", RIGHT, BACK)
    return Log.of([*lines(*actions, told={1: told}), *lines(*actions, person="ben")])


@pytest.fixture(scope="module")
def of_two(tiny: Table) -> FittedPeople:
    return fit(tiny, two_people(RIGHT), method=Method(eta=0.05, utility_scale=2.0))


def test_fitted_people_are_at_work_in_a_simulation(tiny: Table, of_two: FittedPeople) -> None:
    """Under their names, with their own estimates; what somebody's actions do not say is the population's mean."""
    alone = fit(tiny, two_people(None))
    with pytest.raises(ValueError, match=re.escape("or humans(theta=0.8)")):
        alone.humans()
    assert [one.theta for one in alone.humans(theta=0.6)] == [0.6, 0.6]
    pool = Pool.of(tiny, of_two)
    assert pool.names == ("ann", "ben")
    ann, ben = pool.people
    assert (ann.beta, ann.theta) == (of_two["ann"].beta, of_two["ann"].theta)
    assert ben.theta == of_two.distribution().theta.mean  # type: ignore[union-attr]
    assert simulate(pool, "attention", humans=["ben", "ann"], episodes=2, seed=0)[0].people == ("ben", "ann")


def test_fitted_people_are_simulated_with_their_rate_of_trust(tiny: Table, of_two: FittedPeople) -> None:
    """Unless the setting has a rule or a rate of its own."""
    setting = Pool.of(tiny, of_two, setting=Setting(c_suggest=0.3)).setting
    assert (setting.c_suggest, setting.eta, setting.utility_scale) == (0.3, 0.05, 2.0)
    for own in (Setting(eta=0.4), Setting(trust="constant"), Setting(trust="paper")):
        assert Pool.of(tiny, of_two, setting=own).setting == own


def test_what_a_log_may_be_asked_is_checked(tiny: Table) -> None:
    """Nothing is ignored: no misspelt option, and no column that seems to have the suggestions."""
    row = {"person": "ann", "episode": "1", "step": 0, "action": "fetch box-a"}
    for options, words in (
        ({"level": 0.9}, "level: expected method=Method(level=...)"),
        ({"gap": True}, "gap: a log has no such option; did you mean 'gaps'"),
        ({"method": {"level": 0.9}}, "a dict where a Method was expected"),
        ({"columns": {"participant": "person"}}, "did you mean person=participant?"),
    ):
        with pytest.raises((TypeError, ValueError), match=re.escape(words)):
            fit(tiny, [row], **options)  # type: ignore[arg-type]
    with pytest.warns(UserWarning, match=re.escape("'hint' is not read; --columns suggestion=hint (in Python")):
        fit(tiny, [{**row, "hint": "fetch box-b"}])
    needed = "no episode can be used; line 1: .*expected a whole number, or --set gaps=true .in Python gaps=True."
    with pytest.raises(InputFileError, match=needed), pytest.warns(UserWarning, match="expected a whole number"):
        fit(tiny, [{**row, "step": 6.5}])


DROP = 1.9207


def ten_actions(instance: str, people: int, suggest: float, seed: int) -> list[Observations]:
    """Return observations of ten actions of each person, with suggestions in a share of the steps."""
    table = kit(instance)
    choices, rng = Choices.of(table), np.random.default_rng(seed)
    rows = []
    for k in range(people):
        own = people_at_work(choices, [rng.uniform(0.1, 5)], rng, suggest=suggest, theta=rng.uniform(0.3, 0.95))
        rows += [{**row, "person": f"p{k:03}"} for row in own[:10]]
    return observed(table, rows)


@pytest.mark.parametrize(
    ("instance", "suggest", "seed", "eta"),
    [
        ("tiny", 1.0, 0, None),
        ("paper", 1.0, 3, 0.2),
        *(pytest.param(*case, None, marks=pytest.mark.slow) for case in (("tiny", 0.5, 5), ("paper", 0.5, 0))),
    ],
)
def test_nothing_on_a_grid_is_likelier_or_left_out(instance: str, suggest: float, seed: int, eta: float | None) -> None:
    team, method = ten_actions(instance, 3, suggest, seed), Method(eta=eta)
    largest = largest_beta(team, method)
    beta = 1e-3 * largest * np.expm1(np.linspace(0, np.log1p(1e3), 49))
    shares = np.unique([*np.linspace(0, 1, 51), 0.002, 0.998, *np.linspace(0, 1, 31), *np.linspace(0, 1, 17)])
    for o, found in zip(team, maximum_likelihood(team, method), strict=True):
        rates = np.array([0.0 if eta is None else eta]) if "eta" not in found.estimates else shares
        values = log_likelihood(o, beta, np.array([0.5]) if "theta" not in found.estimates else shares, rates)
        assert found.log_likelihood >= values.max() - 1e-6
        for axis, (name, estimate) in enumerate(found.estimates.items()):
            grid = beta if name == "beta" else shares
            kept = values.max(axis=tuple({0, 1, 2} - {axis})) > found.log_likelihood - DROP + 1e-3
            assert not kept.any() or estimate.interval[0] - 1e-3 * grid[-1] <= grid[kept].min()
            assert not kept.any() or grid[kept].max() <= estimate.interval[1] + 1e-3 * grid[-1]
            assert estimate.open_below or not kept[0]
            assert estimate.open_above or not kept[-1]


def test_an_interval_is_open_where_the_profile_is_flat_up_to_the_bound() -> None:
    """One fetch gives no information; a good choice after it bounds beta from below only, for all theta and eta."""
    plan = ["(fetch box-a)", "(place hammer slot-1 box-a)"]
    for told in ({}, {1: plan[1]}):
        for actions in (plan[:1], plan):
            (o,) = observed(kit("tiny"), lines(*actions, told=told))
            (found,) = maximum_likelihood([o])
            assert found.estimates["beta"].open_above
            assert found.beta_interval[1] == pytest.approx(largest_beta([o], Method()))
            for estimate in list(found.estimates.values())[1:]:
                assert (estimate.open_above, estimate.interval[1]) == (True, 1.0)


def test_theta_may_have_to_lie_in_a_narrow_range() -> None:
    """With a rate near 1 trust survives a bad suggestion only if it was about as large: theta is eta or more."""
    bad, good = "(return box-a)", "(place hammer slot-1 box-a)"
    told = {1: bad, 2: "(fetch box-a)", 3: good}
    (o,) = observed(kit("tiny"), lines("(fetch box-a)", "(return box-a)", "(fetch box-a)", good, told=told))
    (found,) = maximum_likelihood([o])
    theta = np.linspace(0, 1, 2001)
    for eta in (0.47, 0.49, 0.9, 0.99):
        profile = log_likelihood(o, np.geomspace(0.01, 5, 60), theta, np.array([eta])).max()
        if profile > found.log_likelihood - DROP + 1e-3:
            assert found.estimates["eta"].interval[0] <= eta <= found.estimates["eta"].interval[1]


def test_the_likelihood_is_that_of_the_estimates_also_at_the_end_of_a_range(paper: Table) -> None:
    """This person made no mistake, so that beta is the end of its range."""
    plan = "return box-b", "fetch box-b", "place pliers slot-2 box-a", "fetch box-a", "remove hammer slot-1 box-a"
    told = dict(zip((2, 3, 5, 7, 8, 9, 10), (*plan, "fetch box-c", "place tape slot-4 box-c"), strict=True))
    actions = (
        "fetch box-b", "place wrench slot-3 box-b", "return box-b", "fetch box-a", "place hammer slot-1 box-a",
        "place pliers slot-2 box-a", "return box-a", "fetch box-a", "return box-a", "fetch box-c",
        "place tape slot-4 box-c", "return box-c",
    )  # fmt: skip
    said = {step: f"({one})" for step, one in told.items()}
    (o,) = observed(paper, lines(*(f"({one})" for one in actions), told=said))
    (found,) = maximum_likelihood([o], Method(largest_beta=5.0))
    own = log_likelihood(o, *(np.array([e.value]) for e in found.estimates.values())).item()
    assert found.log_likelihood == pytest.approx(own, abs=1e-6)
