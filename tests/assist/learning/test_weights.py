"""Weights of terms: estimated from people's actions, and compared by held-out prediction."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from conftest import KITTING, invoke, kit
from recordings import board_of, make_up, moves_of, problem_text, read_all
from scipy.optimize import minimize, minimize_scalar
from scipy.special import expit, logsumexp
from simulated_people import People, record, record_with_terms

from assist.learning import Log, Method, Observations, compare_models, fit, fit_population, hierarchy, mixture, observed
from assist.learning.comparison import folds_of
from assist.learning.hierarchy import fit_hierarchy, fit_terms, intervals, pooled
from assist.learning.likelihood_table import LikelihoodTable
from assist.learning.logit_likelihood import BETA, THETA, Likelihood, Prior, maximise
from assist.people import NOTHING, TERMS, Choices, Weighted, choice, influence, lapse, remembered
from assist.people.trust_rules import EquationSeven
from planner import Instance, Table, sweep
from planner import load as load_task

WEIGHTS = np.array([0.6, -1.0, 0.5, -0.8])
COUNT = 16


def paper() -> Table:
    return kit("paper-fixed")


@cache
def rows() -> tuple[dict, ...]:
    """Return the log of people with these weights and a beta of 1."""
    rng = np.random.default_rng(1)
    return tuple(record_with_terms(paper(), np.ones(COUNT), np.tile(WEIGHTS, (COUNT, 1)), 60, rng))


@cache
def alone() -> Likelihood:
    return Likelihood.of(observed(paper(), list(rows()), terms=TERMS), Method())


@cache
def advised() -> tuple[Likelihood, Observations]:
    """Return the data of a person who receives suggestions, and whose trust changes."""
    people = People(np.array([0.8]), np.array([0.6]), 0.1)
    told = record(paper(), people, episodes=4, rng=np.random.default_rng(2), suggest=0.5)
    (o,) = observed(paper(), told, terms=TERMS)
    return Likelihood.of([o], Method(eta=0.1)), o


def test_derivatives_are_those_of_differences() -> None:
    for likelihood in (alone(), advised()[0]):
        people = len(likelihood.people)
        at = np.tile([4.0, 0.2, *WEIGHTS], (people, 1)) + np.random.default_rng(0).normal(0, 0.1, (people, 6))
        value, gradient, curvature = likelihood.derivatives(at)
        assert value.shape == (people,)
        for axis in range(6):
            step = np.zeros(6)
            step[axis] = 1e-5
            change = likelihood.derivatives(at + step)[0] - likelihood.derivatives(at - step)[0]
            assert gradient[:, axis] == pytest.approx(change / 2e-5, rel=1e-5, abs=1e-6)
        assert np.linalg.eigvalsh(curvature).min() > -1e-9


def test_probabilities_are_those_of_the_model() -> None:
    likelihood, o = advised()
    at = np.array([[4.0, 0.4, *WEIGHTS]])
    beta, theta = float(likelihood.ranges.beta(at[0, BETA])), float(likelihood.ranges.theta(at[0, THETA]))
    found = []
    for i in range(len(o)):
        if o.begins[i]:
            now = theta
        p = choice(o.excess[i], o.applicable[i], beta, o.features[i] @ WEIGHTS)
        p = lapse(influence(p, o.suggested[i], now), o.applicable[i], 1e-3)
        found.append(np.log(p[o.chosen[i]]))
        if o.suggested[i] != NOTHING:
            now = min(max(now + 0.1 * o.gain[i], 0.0), 1.0)
    assert (o.suggested != NOTHING).any()
    # Theta is kept away from 0 and 1 by 1e-9.
    assert likelihood.log_probability(at) == pytest.approx(np.array(found), abs=1e-8)


def test_weights_mean_what_a_choice_model_makes_of_them(tiny: Table) -> None:
    """A log's likelihood is that of `Weighted` on the states with memory in which the log was."""
    told = record_with_terms(tiny, np.ones(1), WEIGHTS[None], 12, np.random.default_rng(3))
    likelihood = Likelihood.of(observed(tiny, told, terms=TERMS), Method())
    at = np.array([[np.log1p(1.0 / likelihood.ranges.small), 0.0, *WEIGHTS]])
    choices = remembered(tiny, TERMS)
    assert isinstance(choices, Choices)
    q = np.where(choices.applicable, choices.costs + choices.h[choices.targets], np.inf)
    p = lapse(Weighted(dict(zip(TERMS, WEIGHTS, strict=True)))(choices, q, np.ones(1))[0], choices.applicable, 1e-3)
    state, found = choices.initial, []
    for entry in told:
        state = choices.initial if entry["step"] == 0 else state
        names = [choices.name(state, slot) for slot in np.flatnonzero(choices.applicable[state])]
        slot = names.index(entry["action"])
        found.append(np.log(p[state, slot]))
        state = int(choices.targets[state, slot])
    assert likelihood.log_probability(at) == pytest.approx(np.array(found), abs=1e-9)


def test_newton_finds_what_scipy_finds() -> None:
    whole = alone().together()
    fixed = np.array([[False, True, False, False, False, False]])
    at, value, _ = maximise(whole, np.zeros((1, 6)), fixed)
    best = minimize(
        lambda x: -whole.derivatives(np.array([[x[0], 0.0, *x[1:]]]))[0][0], np.r_[3.0, WEIGHTS], method="Nelder-Mead",
        options={"maxiter": 4000, "maxfev": 4000, "xatol": 1e-5, "fatol": 1e-7},
    )  # fmt: skip
    assert value[0] == pytest.approx(-best.fun, abs=1e-4)
    assert at[0, 2:] == pytest.approx(best.x[1:], abs=0.01)


def test_intervals_end_where_the_profile_likelihood_has_fallen() -> None:
    start, without_theta = np.tile([4.0, 0.0, *WEIGHTS], (COUNT, 1)), np.arange(6) == THETA
    at, top, _ = maximise(alone(), start, np.tile(without_theta, (COUNT, 1)))
    *ends, best = intervals(alone(), start, 0.95)
    assert best == pytest.approx(top, abs=1e-6)
    near = 0
    for axis in (BETA, *range(2, 6)):
        for each, end in zip(ends, (alone().ranges.low, alone().ranges.high), strict=True):
            begin = at.copy()
            begin[:, axis] = each[:, axis]
            reached = maximise(alone(), begin, np.tile(without_theta | (np.arange(6) == axis), (COUNT, 1)))[1]
            ratio = 2 * (top - reached)[each[:, axis] != end[axis]]
            assert (ratio > 3.841 - 0.05).all()
            near += (ratio < 3.841 + 0.05).sum()
    assert near > 4 * COUNT


def test_people_are_recovered_and_lean_on_each_other() -> None:
    found = fit_hierarchy(alone())
    whole, at = alone().together(), pooled(alone())[1]
    deviation = np.sqrt(np.diag(np.linalg.inv(np.delete(np.delete(whole.derivatives(at)[2][0], 1, 0), 1, 1))))[1:]
    assert (np.abs(found.mean[2:] - WEIGHTS) < 3 * deviation).all()
    own, _, _ = maximise(alone(), found.at, np.tile([False, True, False, False, False, False], (COUNT, 1)))
    error, without = (np.abs(at[:, 2:] - WEIGHTS).mean() for at in (found.at, own))
    assert error < without / 2  # these people are all alike
    people = fit(paper(), Log.of(rows()), model="terms")
    assert all(ends[0] <= person.weights[name] <= ends[1] for person in people.values()
               for name, ends in person.weights_interval.items())  # fmt: skip
    first = people["person-01"]
    assert list(first.as_dict()["weights"]) == list(TERMS)
    assert first.probabilities().sum(axis=1) == pytest.approx(1.0)
    population = people.population()
    assert mixture(json.loads(json.dumps(people.distribution().as_dict()))) == population
    for name, weight in zip(TERMS, WEIGHTS, strict=True):
        low, high = population.weights[name]
        assert low - 1 < weight < high + 1
        assert (low + high) / 2 == pytest.approx(people.hierarchy.mean[2 + list(TERMS).index(name)])


def test_a_term_in_which_no_choices_differ_has_no_weight_in_the_population(tiny: Table, tmp_path: Path) -> None:
    """On this task, this is so for `name`."""
    told = record_with_terms(tiny, np.ones(4), np.tile(WEIGHTS, (4, 1)), 12, np.random.default_rng(3))
    people = fit(tiny, Log.of(told), model="terms")
    assert set(people.distribution().weights) == set(people.population().weights) == set(TERMS) - {"name"}
    first = people["person-1"]
    assert first.weights["name"] == 0.0
    assert "these actions say nothing about the weight of name" in first.notes
    log = tmp_path / "log.jsonl"
    log.write_text("".join(json.dumps(row) + "\n" for row in told))
    shown = invoke("fit", KITTING / "tiny.pddl", log, "--terms").stdout
    assert "population of 4: the weight of name is not known, as no choices in the log differ in it\n" in shown


def test_one_person_alone_is_fitted_by_their_own_actions() -> None:
    some = Log.of(row for row in rows() if row["person"] == "person-03")
    (person,) = fit(paper(), some, model="terms").values()
    (observations,) = observed(paper(), [row for row in rows() if row["person"] == "person-03"], terms=TERMS)
    own = Likelihood.of([observations], Method())
    _, best, _ = maximise(own, np.array([[4.0, 0.0, *WEIGHTS]]), np.array([[False, True] + [False] * 4]))
    assert best[0] - 1 < person.log_likelihood <= best[0]


@cache
def trusting() -> tuple[Observations, ...]:
    """Return what people did who differ in theta, and whose theta moves so fast that it reaches 1."""
    rng = np.random.default_rng(5)
    people = People(np.exp(rng.normal(-0.3, 0.3, 20)), rng.uniform(0.3, 0.8, 20), 0.25)
    return tuple(observed(kit("tiny"), record(kit("tiny"), people, episodes=10, rng=rng, suggest=0.5, good=0.0)))


def test_the_likelihood_on_nodes_of_theta_is_that_of_the_model() -> None:
    likelihood, _ = advised()
    nodes, rates = np.array([-3.0, 0.4, 6.0]), np.array([0.0, 0.1, 0.7])
    values = likelihood.by_trust(np.array([[4.0, 99.0, *WEIGHTS]]), nodes, rates)
    assert values.shape == (1, 3, 3)
    for e, rate in enumerate(rates.tolist()):
        for t, node in enumerate(nodes.tolist()):
            at = np.array([[4.0, node, *WEIGHTS]])
            assert values[0, e, t] == pytest.approx(replace(likelihood, eta=rate).log_probability(at).sum(), abs=1e-9)


def test_the_rate_of_trust_and_the_evidence_are_those_of_an_exact_sum() -> None:
    """The marginal likelihood is compared with sums over nodes of both beta and theta."""
    likelihood = Likelihood.of(trusting(), Method())
    b = np.linspace(0.5, likelihood.ranges.high[BETA], 60)
    t = np.linspace(likelihood.ranges.low[THETA], likelihood.ranges.high[THETA], 161)
    table = LikelihoodTable.of(trusting(), Method(), likelihood.ranges.beta(b), expit(t))

    def exact(found: hierarchy.Hierarchy) -> float:
        logs = table.log_likelihood(EquationSeven(found.likelihood.eta), carry=False)
        shares = []
        for nodes, mean, spread in zip((b, t), found.mean, found.spread, strict=True):
            density = -(((nodes - mean) / spread) ** 2) / 2
            shares.append(density - logsumexp(density))
        return float(logsumexp(logs + shares[0][:, None] + shares[1], axis=(1, 2)).sum())

    found = fit_hierarchy(likelihood, known=False)
    assert found.evidence == pytest.approx(exact(found), abs=1.0)
    best = fit_population(trusting()).eta
    assert best is not None
    assert found.likelihood.eta == pytest.approx(best, abs=0.02)
    for rate in (best - 0.05, best + 0.05):
        other = fit_hierarchy(replace(likelihood, eta=rate))
        assert other.evidence == pytest.approx(exact(other), abs=1.5)
        assert other.evidence < found.evidence - 3


def test_the_rate_of_trust_has_an_interval_also_beside_terms() -> None:
    people, found = fit_terms(trusting(), Method())
    assert found.rate is not None
    low, high = found.rate.interval
    assert low < found.likelihood.eta < high < low + 0.1
    for end in (low, high):
        at_end = fit_hierarchy(replace(found.likelihood, eta=end), 5, near=found).evidence
        assert 2 * (found.evidence - at_end) == pytest.approx(3.841, abs=0.3)
    assert [(one.eta, one.eta_interval) for one in people] == [(found.rate.value, (low, high))] * len(people)
    people, found = fit_terms(trusting(), Method(eta=0.25))
    assert (found.rate, people[0].eta, people[0].rate) == (None, None, 0.25)


def test_nobody_is_left_on_a_lower_maximum() -> None:
    likelihood = replace(Likelihood.of(trusting(), Method()), eta=0.3)
    prior = Prior(np.array([4.0, 0.0]), np.array([10.0, 0.05]))
    start = np.tile([2.0, -4.0], (len(trusting()), 1))
    at, value, _ = maximise(likelihood, start, np.zeros_like(start, dtype=bool), prior)
    points = likelihood.ranges.thetas()
    off = 5.0 * (at[:, BETA] - 4.0) ** 2 + 0.025 * points[:, None] ** 2
    assert ((likelihood.by_trust(at, points, np.array([0.3]))[:, 0] - off.T).max(axis=1) < value + 1e-5).all()
    best = intervals(likelihood, np.tile([4.0, 0.0], (len(trusting()), 1)), 0.95)[2]
    b = np.linspace(0.5, likelihood.ranges.high[BETA], 40)
    t = np.linspace(likelihood.ranges.low[THETA], likelihood.ranges.high[THETA], 101)
    table = LikelihoodTable.of(trusting(), Method(), likelihood.ranges.beta(b), expit(t))
    nodes = table.log_likelihood(EquationSeven(0.3), carry=False).max(axis=(1, 2))
    assert (best > nodes - 0.01).all()


@pytest.mark.parametrize(
    "some",
    [slice(0, 4), *(pytest.param(slice(*ends), marks=pytest.mark.slow) for ends in ((4, 12), (12, 20), (0, 20)))],
)
def test_people_together_have_the_largest_likelihood(some: slice) -> None:
    likelihood = Likelihood.of(trusting()[some], Method())
    found, at = pooled(likelihood, known=False)
    reached = found.together().log_probability(at).sum()
    b, t = np.linspace(3.0, likelihood.ranges.high[BETA], 40), np.linspace(-3.0, 3.0, 121)
    table = LikelihoodTable.of(trusting()[some], Method(), likelihood.ranges.beta(b), expit(t))
    for rate in np.linspace(0.0, 1.0, 51).tolist():
        assert reached > table.log_likelihood(EquationSeven(rate), carry=False).sum(axis=0).max() - 0.01


def test_whoever_is_predicted_was_not_seen() -> None:
    found = compare_models(observed(paper(), list(rows()), terms=TERMS), folds=5)["boltzmann"]
    boltzmann, first = alone().with_terms([]), folds_of(COUNT, 5) == 0
    predicted = first[boltzmann.steps.person]
    learned, counts = ~predicted, np.bincount(boltzmann.steps.person)

    def minus(coordinate: float, which: np.ndarray) -> float:
        some = boltzmann.together(which)
        return -float(some.derivatives(np.array([[coordinate, 0.0]]))[0][0])

    best = minimize_scalar(lambda x: minus(x, learned), bounds=(0.0, boltzmann.ranges.high[BETA]), method="bounded")
    assert (found.of_people * counts)[first].sum() == pytest.approx(minus(best.x, predicted), abs=1e-3)


def test_terms_predict_people_better_whose_choices_follow_them() -> None:
    stages = list[tuple[str, int, int | None]]()
    people = observed(paper(), list(rows()), terms=TERMS)
    found = compare_models(people, folds=4, progress=lambda *stage: stages.append(stage))
    assert stages == [("comparing models", done, len(TERMS) + 2) for done in range(len(TERMS) + 3)]
    document = found.as_dict()
    assert [row["model"] for row in document["models"]] == ["boltzmann", *TERMS, "terms"]
    for row in document["models"]:
        assert {"model", "parameters", "nats_per_choice", "stderr", "better_for"} <= set(row)
    assert [len(row["parameters"]) for row in document["models"]] == [1, 2, 2, 2, 2, 5]
    assert found["terms"].nats_per_choice < found["boltzmann"].nats_per_choice - 2 * found["terms"].stderr / COUNT
    assert found["terms"].better_for > COUNT / 2
    total = sum(person["choices"] * person["nats_per_choice"]["terms"] for person in document["people"])
    assert total / sum(person["choices"] for person in document["people"]) == pytest.approx(
        found["terms"].nats_per_choice
    )
    assert found["terms"].difference < 0
    at = pooled(alone())[1]
    assert list(found["terms"].parameters.values())[1:] == pytest.approx(at[0, 2:], abs=1e-3)


def test_a_term_of_ones_own_is_compared_like_the_others() -> None:
    own = {"first": lambda s: (np.arange(s.applicable.shape[1]) == 0) & (s.last >= 0)[:, None]}
    found = compare_models(observed(paper(), list(rows()), terms=own), folds=2)
    assert [row.model for row in found.scores] == ["boltzmann", "first"]


@pytest.mark.slow
def test_the_command_line_fits_and_compares(tmp_path: Path) -> None:
    log, people = tmp_path / "log.jsonl", tmp_path / "people.json"
    log.write_text("".join(json.dumps(row) + "\n" for row in rows() if row["person"] < "person-07"))
    done = invoke("compare", "models", KITTING / "paper-fixed.pddl", log, "--folds", 3, "--json")
    assert done.exit_code == 0
    assert len(json.loads(done.stdout)["people"]) == 6
    scores = {one["model"]: one for one in json.loads(done.stdout)["models"]}
    options = ("compare", "models", KITTING / "paper-fixed.pddl", log, "--folds", 3, "--json", "--baseline", "back")
    back, boltzmann, *_ = json.loads(invoke(*options).stdout)["models"]
    assert (back["model"], back["difference"], boltzmann["model"]) == ("back", None, "boltzmann")
    assert boltzmann["difference"] == pytest.approx(-scores["back"]["difference"])
    assert boltzmann["nats_per_choice"] == pytest.approx(scores["boltzmann"]["nats_per_choice"])
    shown = invoke("compare", "models", KITTING / "paper-fixed.pddl", log, "--figures", tmp_path)
    assert "boltzmann" in shown.stdout
    assert (tmp_path / "comparison.png").stat().st_size > 5000
    done = invoke("fit", KITTING / "paper-fixed.pddl", log, "--terms", "--write-population", people, "--json")
    assert set(json.loads(done.stdout)[0]["weights_interval"]) == set(TERMS)
    assert set(json.loads(people.read_text())["parts"][0]["weights"]) == set(TERMS)
    done = invoke("simulate", KITTING / "tiny.pddl", "--humans", 1, "--policy", "none", "--episodes", 2,
                     "--population", people)  # fmt: skip
    assert done.exit_code == 0
    log.write_text("".join(json.dumps(row) + "\n" for row in rows() if row["person"] == "person-01"))
    done = invoke("compare", "models", KITTING / "paper-fixed.pddl", log)
    assert (done.exit_code, "one person; a comparison needs two or more" in done.stderr) == (1, True)


@pytest.mark.slow
def test_recordings_become_logs_of_the_tower(tmp_path: Path) -> None:
    make_up(tmp_path / "made", 3, 2, np.random.default_rng(0))
    every = read_all(tmp_path / "made")
    assert [(one.person, one.problem, one.order) for one in every] == [
        (k, j, j + 1) for k in range(3) for j in range(2)
    ]
    file = tmp_path / "one.pddl"
    file.write_text(problem_text("one", every[0].initial, every[0].target))
    table = sweep(load_task(Instance(file, KITTING.parent / "tower" / "domain.pddl")))
    assert len(table) == 36
    assert table.space.goal[table.space.follow(moves_of(every[0]))]
    # A ball that is put back is no move, and a problem that ends elsewhere was given up.
    source = tmp_path / "made" / "000.csv"
    with source.open(newline="") as lines:
        columns, *clicks = list(csv.reader(lines))
    place = columns.index("current_position")
    taken = next(i for i, row in enumerate(clicks) if row[0] == "tol_tohand")
    before = json.dumps([[*peg, *[0] * (3 - len(peg))] for peg in every[0].initial])
    assert board_of(before) == every[0].initial
    back = [row.copy() for row in clicks[taken : taken + 2]]
    back[1][place] = before
    given_up = clicks[:-3] + clicks[-1:]
    source.with_name("000.csv").write_text(_table(columns, clicks[:taken] + back + clicks[taken:]))
    source.with_name("001.csv").write_text(_table(columns, given_up))
    source.with_name("003.csv").write_text(_table(columns, [row for row in clicks if row[0] == "tol_practice"]))
    again = read_all(tmp_path / "made")
    assert again[0].boards == every[0].boards
    assert [(one.person, one.problem) for one in again] == [(0, 0), (0, 1), (1, 0), (2, 0), (2, 1)]


def _table(columns: list[str], rows: list[list[str]]) -> str:
    return "".join(",".join(f'"{cell}"' for cell in row) + "\n" for row in [columns, *rows])
