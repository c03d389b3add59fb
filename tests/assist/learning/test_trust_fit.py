"""Influence fitted under trust rules: the likelihood against plain enumeration, recovery, comparison, and commands."""

from __future__ import annotations

import importlib
import json
import re
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import KITTING, ROOT, invoke, kit
from recorded import write_log

from assist.declare import plain
from assist.learning import Method, Observations, observed
from assist.learning.comparison import Comparison, ratio
from assist.learning.distribution import trust_of
from assist.learning.held_out import REFERENCE, compare_rules
from assist.learning.influence_population import InfluencePopulation, PosteriorSample, posterior_covariance
from assist.learning.intervals import equal_tailed, holm
from assist.learning.likelihood_table import LikelihoodTable
from assist.learning.rule_families import RuleFamily, families
from assist.learning.trust_fit import RuleSearch, fit_influence
from assist.people.choices import Choices
from assist.people.trust_rules import (
    LEAST,
    EquationSeven,
    Event,
    Reliability,
    TrustRule,
    constant,
    of_table,
    outcome,
    outcome_at_disagreement,
)
from assist.people.trust_rules import RULES as SHIPPED
from planner.system.errors import InputFileError

SIMULATED: Any = importlib.import_module("simulated_people")

RULES: dict[str, TrustRule] = {
    "constant": constant(),
    "paper": EquationSeven(0.13, 1.5),
    "outcome": outcome(0.3, 0.7),
    "outcome as it is": outcome(0.3, 0.7, "true"),
    "outcome-at-disagreement": outcome_at_disagreement(0.1, 0.5, 0.4),
    "reliability": Reliability(3.0, 0.2, 2),
}


@pytest.mark.cases
@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("paper", {}, ((),)), "make 'paper': expected the class of a rule, or a function that returns one"),
        ((EquationSeven, {"ta": (0, 1)}, ((0.1,),)), "ranges: ta: no parameter of the rule; did you mean 'eta'?"),
        ((EquationSeven, {"eta": (1, 0)}, ((0.1,),)), "ranges: eta (1, 0): expected two numbers, low < high"),
        ((EquationSeven, {"eta": 1}, ((0.1,),)), "ranges.eta 1: expected two numbers, [low, high]"),
        ((EquationSeven, {"eta": (0, 1)}, (0.1, 0.3)), "tried (0.1, 0.3): expected a tuple of tuples"),
        ((EquationSeven, {"eta": (0, 1)}, ()), "tried (): expected a tuple of tuples, each with a value for each"),
        ((EquationSeven, {"eta": (0, 1)}, ((0.1,), (0.1, 2))), "tried[2] (0.1, 2.0): expected values of eta, as many"),
        ((EquationSeven, {"eta": (0, 1)}, ((2,),)), "tried[1] (2.0,): eta is outside its range, 0 to 1"),
        ((EquationSeven, {"eta": (0, 1)}, ((0.1,),), frozenset({"et"})),
         "logarithms: et: has no range; did you mean 'eta'?"),
    ],
)  # fmt: skip
def test_a_family_of_rules_that_cannot_be_is_refused_where_it_is_made(given: tuple[Any, ...], said: str) -> None:
    with pytest.raises(ValueError, match=re.escape(said)):
        RuleFamily(*given)


@dataclass(frozen=True)
class Doubling:
    """A rule of one's own: an answer that follows doubles the odds."""

    uses_answer = True
    feedback = "never"

    def update(self, theta: np.ndarray, event: Event) -> np.ndarray:
        odds = np.where(event.followed, 2.0, 0.5) * theta / (1 - theta)
        return odds / (1 + odds)


def recorded(rule: TrustRule, people: int, suggestions: int, seed: int, *, good: float = 0.5) -> list[dict]:
    """Draw people, and write down what they do at a small kit; theta and beta are log-normal in odds and size."""
    rng = np.random.default_rng(seed)
    drawn = SIMULATED.People(np.exp(rng.normal(0, 0.4, people)), 1 / (1 + np.exp(-rng.normal(0.5, 1.2, people))))
    return SIMULATED.record_with_trust(kit("tiny"), drawn, rule, suggestions=suggestions, rng=rng, good=good)


def seen(rows: list[dict]) -> list[Observations]:
    return observed(kit("tiny"), rows)


def enumerated(
    rows: list[dict], rule: TrustRule, log: LikelihoodTable, population: InfluencePopulation, carry: bool
) -> float:
    """Return the log probability of one person's log by a filter over all nodes, in plain arithmetic."""
    choices = Choices.of(kit("tiny"))
    q = np.where(choices.applicable, choices.costs + choices.h[choices.targets], np.inf)
    v = np.where(choices.goal, 0.0, -q.min(axis=1))
    beta, theta = population.weights(log)
    belief, total = np.multiply.outer(beta, theta), 0.0
    start = np.tile(log.theta, (len(log.beta), 1))
    now, x, episode, outcomes = start, choices.initial, rows[0]["episode"], 0
    for row in rows:
        if row["episode"] != episode:
            x, episode = choices.initial, row["episode"]
            now, outcomes = (now, outcomes) if carry else (start, 0)
        names = [choices.name(x, a) if choices.applicable[x, a] else None for a in range(q.shape[1])]
        slot, told = names.index(row["action"]), None
        weights = np.array([np.where(choices.applicable[x], np.exp(-b * (q[x] - q[x].min())), 0.0) for b in log.beta])
        p = np.repeat((weights / weights.sum(axis=1, keepdims=True))[:, None], len(log.theta), axis=1)
        if row["suggestion"] is not None:
            told = names.index(row["suggestion"])
            for a in range(q.shape[1]):
                p[:, :, a] *= now if a == told else 1 - now
            p /= p.sum(axis=2, keepdims=True)
        likelihood = (1 - log.data[0].lapse) * p[:, :, slot] + log.data[0].lapse / choices.applicable[x].sum()
        belief = belief * likelihood
        total += np.log(belief.sum())
        belief = belief / belief.sum()
        if told is not None:
            gain = v[choices.targets[x, told]] - v[x]
            right = q[x, told] == q[x].min() if rule.feedback == "true" else gain > 0
            event = (gain, q[x, told] <= q[x].min(), slot == told, slot == told and rule.feedback != "never", right)
            if isinstance(rule, Reliability):
                if event[3]:
                    n = rule.weight
                    for _ in range(min(outcomes, rule.counts)):
                        n = (1 - rule.forgetting) * n + 1
                    n *= 1 - rule.forgetting
                    now, outcomes = np.clip((n * now + right) / (n + 1), LEAST, 1 - LEAST), outcomes + 1
                x = choices.targets[x, slot]
                continue
            now = rule.update(now, Event(*(np.asarray(part) for part in event)))
        x = choices.targets[x, slot]
    return total


@dataclass(frozen=True)
class Fading:
    """A rule of one's own: in silence theta falls by a tenth."""

    uses_answer, feedback, sees_silence = False, "never", True

    def update(self, theta: np.ndarray, event: Event) -> np.ndarray:
        return np.where(event.suggested, theta, 0.9 * theta)


def test_silence_in_later_episodes_does_not_move_theta_unless_it_is_carried() -> None:
    rows = [{**row, "suggestion": row["suggestion"] if n == 0 else None} for n, row in enumerate(
        recorded(constant(), 1, 12, 1))]  # fmt: skip
    first = sum(row["episode"] == rows[0]["episode"] for row in rows)
    assert rows[0]["suggestion"]
    assert 1 < first < len(rows)
    _, last = LikelihoodTable.of(seen(rows), Method(), theta=np.array([0.8])).thetas(Fading(), carry=False)
    assert last[0, 0] == pytest.approx(0.8 * 0.9 ** (first - 1))
    _, last = LikelihoodTable.of(seen(rows), Method(), theta=np.array([0.8])).thetas(Fading())
    assert last[0, 0] == pytest.approx(0.8 * 0.9 ** (len(rows) - 1))


@pytest.mark.parametrize("rule", [*RULES.values(), Doubling()], ids=[*RULES, "one's own"])
@pytest.mark.parametrize("carry", [True, False])
def test_the_likelihood_is_that_of_a_filter_over_all_nodes(rule: TrustRule, carry: bool) -> None:
    rows = recorded(rule, 3, 12, 1)
    assert len({row["episode"] for row in rows}) > 1
    log = LikelihoodTable.of(seen(rows), Method(lapse=0.01))
    population = InfluencePopulation(-0.2, 0.6, 0.4, 1.3)
    found = population.marginal(log, log.log_likelihood(rule, carry=carry))
    for k, person in enumerate(log.people):
        own = [row for row in rows if row["person"] == person]
        assert found[k] == pytest.approx(enumerated(own, rule, log, population, carry), abs=1e-10)


def test_no_suggestion_makes_all_choices_impossible() -> None:
    """At theta 0 or 1 the suggestion of a choice that is certain or impossible is ignored, as in equation (6)."""
    log = LikelihoodTable.of(seen(recorded(constant(), 3, 10, 0)), Method(largest_beta=1e9))
    for theta in (0.0, 1.0):
        assert np.isfinite(log.log_likelihood(RuleFamily.of(Fixed(theta)).rule(()))).all()


@dataclass(frozen=True)
class Fixed:
    """A rule that leads to one theta at once."""

    theta: float
    uses_answer = False
    feedback = "never"

    def update(self, theta: np.ndarray, event: Event) -> np.ndarray:
        return np.full(np.broadcast_shapes(np.shape(theta), np.shape(event.gain)), self.theta)


def test_the_population_that_is_found_is_the_likeliest() -> None:
    log = LikelihoodTable.of(seen(recorded(constant(), 15, 15, 2)), Method())
    logs = log.log_likelihood(constant())
    found, value = InfluencePopulation.fit(log, logs)
    assert value == pytest.approx(found.marginal(log, logs).sum(), abs=1e-9)
    for name, best in vars(found).items():
        for factor in (0.97, 1.03):
            other = InfluencePopulation(**vars(found) | {name: best * factor})
            assert other.marginal(log, logs).sum() < value + 1e-6


@pytest.mark.slow
def test_parameters_of_simulated_people_are_found() -> None:
    rule = EquationSeven(0.04)
    found = fit_influence(seen(recorded(rule, 25, 30, 3)), "paper")
    ((parameter, (low, high)),) = found.intervals.items()
    assert low - (high - low) / 2 <= getattr(rule, parameter) <= high + (high - low) / 2
    assert low <= found.parameters[parameter] <= high < 2 * getattr(rule, parameter) + 0.1
    assert found.population.logit_theta == pytest.approx(0.5, abs=0.6)
    assert found.population.logit_theta_spread == pytest.approx(1.2, abs=0.5)


def test_people_are_estimated_with_intervals() -> None:
    rng = np.random.default_rng(4)
    theta = 1 / (1 + np.exp(-rng.normal(0.5, 1.2, 60)))
    people = SIMULATED.People(np.exp(rng.normal(0, 0.4, 60)), theta)
    rows = SIMULATED.record_with_trust(kit("tiny"), people, constant(), suggestions=30, rng=rng)
    found = fit_influence(seen(rows), "constant")
    inside = [one.theta_first_interval[0] <= own <= one.theta_first_interval[1]
              for one, own in zip(found.people, theta.tolist(), strict=True)]  # fmt: skip
    assert np.mean(inside) > 0.85
    for one in found.people:
        assert one.suggestions == 30
        assert one.theta == one.theta_first
        for value, (low, high) in ((one.theta, one.theta_interval), (one.beta, one.beta_interval)):
            assert low < value < high


def test_a_parameter_that_the_log_does_not_depend_on_has_the_whole_range() -> None:
    """Where all suggestions are optimal choices, nobody sees one that is wrong."""
    found = fit_influence(seen(recorded(outcome(0.3, 0.5), 6, 8, 5, good=1.0)), "outcome")
    assert found.intervals["loss"] == families(Method())["outcome"].ranges["loss"]
    assert (found.unidentified, found.as_dict()["unidentified"]) == (("loss",), ("loss",))
    assert repr(found).endswith("loss ?>")
    assert "loss" in found.open_above
    assert {name for name, (_, high) in found.intervals.items() if high == 3.0} == set(found.open_above)


def test_it_is_said_where_theta_is_carried_of_people_who_begin_anew(log_file: Path, tmp_path: Path) -> None:
    """Simulated people forget what moved theta in the last episode; those of the other log do not."""
    log, said = tmp_path / "log.jsonl", "if theta begins anew in each episode, the log likelihood is"
    given = ("--humans", 2, "--pool", 6, "--policy", "reactive", "--episodes", 40, "--seed", 1, "--trace", log)
    people = ("--set", "population.sigma=[0, 0]", "--set", "population.theta=[0.2, 0.6]")
    assert invoke("simulate", TINY, *given, *people).exit_code == 0
    carried = ("--influence", "paper", "--set", "theta_per_episode=false")
    done = invoke("fit", TINY, log, *carried)
    assert said in done.stdout, done.output
    document = json.loads(invoke("fit", TINY, log, *carried, "--json").stdout)
    anew = json.loads(invoke("fit", TINY, log, "--influence", "paper", "--json").stdout)
    assert document["log_likelihood_anew"] == pytest.approx(anew["log_likelihood"], abs=1e-3)
    assert anew["log_likelihood_anew"] is None
    assert said not in invoke("fit", TINY, log_file, "--influence", "outcome").stdout


@pytest.mark.slow
def test_the_right_rule_is_chosen() -> None:
    rules = {name: families(Method())[name] for name in ("constant", "outcome")}
    for name, rule, seed in (("outcome", outcome(0.6, 0.9), 7), ("constant", constant(), 8)):
        compared = compare_rules(seen(recorded(rule, 20, 25, seed)), Method(), rules=rules, folds=2)
        assert compared.best.model == name


def test_held_out_people_are_predicted_from_the_others() -> None:
    observations = seen(recorded(constant(), 6, 10, 9))
    rules = {"constant": RuleFamily.of(constant()), "own": RuleFamily.of(Doubling())}
    stages = list[tuple[str, int, int | None]]()
    compared = compare_rules(observations, Method(), rules=rules, folds=3, progress=lambda *stage: stages.append(stage))
    assert stages == [("comparing trust rules", done, 2) for done in range(3)]
    log, total = LikelihoodTable.of(observations, Method()), 0.0
    logs = log.log_likelihood(constant())
    for fold in range(3):
        inside = np.arange(6) % 3 == fold
        population, _ = InfluencePopulation.fit(log, logs[~inside])
        total -= population.marginal(log, logs[inside]).sum()
    assert compared.scores[0].nats_per_choice * compared.choices.sum() == pytest.approx(total, rel=1e-5)


def test_what_cannot_be_compared_is_refused() -> None:
    observations = seen(recorded(constant(), 2, 5, 0))
    with pytest.raises(InputFileError, match="one person"):
        compare_rules(observations[:1])
    with pytest.raises(ValueError, match="folds 1: expected 2 or more"):
        compare_rules(observations, folds=1)
    with pytest.raises(ValueError, match="rules: expected at least one"):
        compare_rules(observations, rules=())
    with pytest.raises(ValueError, match="trust 'vanity'; expected one of paper, constant"):
        fit_influence(observations, "vanity")


def test_a_sample_of_a_posterior_has_its_mean_covariance_and_integral() -> None:
    mean, cov = np.array([0.3, -1.0]), np.array([[0.5, 0.3], [0.3, 0.4]])

    def value(point: np.ndarray) -> float:
        return float(-0.5 * (point - mean) @ np.linalg.solve(cov, point - mean))

    ranges = ((-10.0, 10.0), (-10.0, 10.0))
    near = posterior_covariance(value, mean, ranges)
    assert near == pytest.approx(cov, rel=1e-6)
    sample = PosteriorSample.around(value, mean, ranges, near, count=2000)
    found = sample.shares @ sample.points
    assert found == pytest.approx(mean, abs=0.01)
    off = sample.points - found
    assert (sample.shares[:, None] * off).T @ off == pytest.approx(cov, abs=0.01)
    assert sample.log_integral == pytest.approx(np.log(2 * np.pi) + np.log(np.linalg.det(cov)) / 2, abs=0.01)
    half = PosteriorSample.around(value, mean, ((0.3, 10.0), (-10.0, 10.0)), near, count=2000)
    assert half.points[:, 0].min() >= 0.3
    assert half.log_integral == pytest.approx(sample.log_integral - np.log(2), abs=0.01)


def test_beliefs_are_averaged_over_what_the_population_may_be() -> None:
    """Against sums over a grid of mean and spread of logit(theta_0)."""
    log = LikelihoodTable.of(seen(recorded(constant(), 20, 12, 3)), Method())
    logs = log.log_likelihood(constant())
    best, _ = InfluencePopulation.fit(log, logs)
    found, average = best.posteriors(log, logs)
    assert found.sum(axis=(1, 2)) == pytest.approx(np.ones(20), abs=1e-9)
    total, belief = 0.0, np.zeros_like(found)
    means, spreads = np.linspace(-4, 4, 60), np.linspace(0.24, 3.99, 40)
    likelihood, value = np.exp(logs - logs.max(axis=(1, 2), keepdims=True)), best.marginal(log, logs).sum()
    for mean, spread in product(means, spreads):
        one = InfluencePopulation(best.log_beta, best.log_beta_spread, mean, spread)
        joint = np.multiply.outer(*one.weights(log)) * likelihood
        share = float(np.exp(one.marginal(log, logs).sum() - value))
        total += share
        belief += share * joint / joint.sum(axis=(1, 2), keepdims=True)
    assert found.sum(axis=1) == pytest.approx(belief.sum(axis=1) / total, abs=0.005)
    cell = (means[1] - means[0]) * (spreads[1] - spreads[0])
    assert average == pytest.approx(value + np.log(total * cell), abs=0.1)


def test_an_interval_of_a_normal_distribution() -> None:
    nodes = np.linspace(-6, 6, 41)
    mass = np.exp(-(nodes**2) / 2)
    low, high = equal_tailed(nodes, mass / mass.sum(), 0.95)
    assert (low, high) == (pytest.approx(-1.96, abs=0.05), pytest.approx(1.96, abs=0.05))


def test_scores_are_paired_and_corrected() -> None:
    assert holm([0.01, 0.5, 0.02]) == pytest.approx([0.03, 0.5, 0.04])
    assert holm([0.6, 0.6]) == [1.0, 1.0]
    mean, error = ratio(np.array([2.0, 4.0, 9.0]), np.array([1.0, 2.0, 3.0]))
    assert (mean, error) == (2.5, pytest.approx(np.sqrt((0.25 + 1 + 2.25) * 3 / 2) / 6))
    rng = np.random.default_rng(0)
    counts, reference, people = np.full(50, 20), rng.normal(-12, 2, 50), [f"p{k}" for k in range(50)]
    logs = {"better": reference + rng.normal(0.5, 0.5, 50), "constant": reference, "alike": reference + 1e-9}
    compared = Comparison.of(people, counts, logs, {name: {} for name in logs}, "constant")
    better = compared["better"]
    assert (compared.scores[0].model, compared.best) == ("constant", better)
    assert better.better_for == (logs["better"] > reference).sum()
    assert better.difference == pytest.approx(-0.025, abs=0.01)
    assert better.interval is not None
    assert better.interval[0] < better.difference < better.interval[1] < 0
    more = logs | {"best": reference + rng.normal(1.0, 0.5, 50)}
    assert Comparison.of(people, counts, more, {name: {} for name in more}, "constant").best.model == "best"
    few = {name: logs[name] for name in ("constant", "alike")}
    alike = Comparison.of(people, counts, few, {name: {} for name in few}, "constant")
    assert alike.as_dict()["best"] == "constant"


TINY = KITTING / "tiny.pddl"


@pytest.fixture(scope="module")
def log_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_log(tmp_path_factory.mktemp("log") / "log.jsonl", recorded(outcome(0.5, 0.8), 5, 10, 0))


def test_influence_is_fitted_by_command(log_file: Path, tmp_path: Path) -> None:
    out, people = tmp_path / "people.jsonl", tmp_path / "people.json"
    done = invoke("fit", TINY, log_file, "--influence", "paper", "--out", out, "--write-population", people)
    assert done.exit_code == 0, done.output
    assert "of 10" in done.stdout
    assert f"trust rule paper, eta {json.loads(people.read_text())['trust']['eta']:.3f}" in done.stdout
    simulated_by_its_rule(people, "paper")
    assert {json.loads(line)["suggestions"] for line in out.read_text().splitlines()} == {10}
    known = ("--influence", "paper", "--set", "theta_per_episode=true", "--set", "eta=0.1", "--json")
    document = json.loads(invoke("fit", TINY, log_file, *known).stdout)
    assert (document["carried"], document["parameters"]["eta"], document["intervals"]) == (False, 0.1, {})


def test_rules_are_compared_by_command(tmp_path: Path) -> None:
    few = write_log(tmp_path / "few.jsonl", recorded(outcome(0.5, 0.8), 3, 5, 0))
    compared = ("compare", "rules", TINY, few, "--folds", 2, "--set", "eta=0.2")
    done = invoke(*compared, "--out", tmp_path / "people.jsonl", "--json")
    assert done.exit_code == 0, done.output
    rows = [json.loads(line) for line in (tmp_path / "people.jsonl").read_text().splitlines()]
    names = [REFERENCE, *(name for name in families(Method()) if name != REFERENCE)]
    assert list(rows[0]["nats_per_choice"]) == names
    document = json.loads(done.stdout)
    assert (document["people"], [row["model"] for row in document["models"]]) == (rows, names)


def test_a_population_file_has_the_rule(log_file: Path, tmp_path: Path) -> None:
    people = tmp_path / "people.json"
    done = invoke("fit", TINY, log_file, "--influence", "constant", "--write-population", people, "--json")
    assert (done.exit_code, json.loads(done.stdout)["parameters"]) == (0, {}), done.output
    simulated_by_its_rule(people, "constant")


def test_a_parameter_of_which_the_log_says_nothing_is_named_in_the_population_and_where_it_is_taken(
    tmp_path: Path,
) -> None:
    log = write_log(tmp_path / "log.jsonl", recorded(outcome(0.3, 0.5), 6, 8, 5, good=1.0))
    people = tmp_path / "people.json"
    done = invoke("fit", TINY, log, "--influence", "outcome", "--write-population", people)
    record = json.loads(people.read_text())
    assert (done.exit_code, record["unidentified"]) == (0, ["loss"]), done.output
    done = invoke("simulate", TINY, *["--humans", "1", "--pool", "1", "--episodes", "1"], "--population", people)
    assert (done.exit_code, "its log says nothing about loss of the trust rule" in done.stderr) == (0, True)
    people.write_text(json.dumps(record | {"unidentified": ["los"]}))
    done = invoke("simulate", TINY, *["--humans", "1"], "--population", people)
    assert (done.exit_code, "trust: los" in done.stderr) == (2, True), done.stderr


def simulated_by_its_rule(people: Path, rule: str) -> None:
    """`simulate` draws people from a file whose theta moves by its rule, which the robot knows."""
    record = json.loads(people.read_text())
    assert record["trust"]["rule"] == rule
    assert record["theta"]["family"] == "logit-normal"
    assert sum(part["share"] for part in record["parts"]) == pytest.approx(1)
    simulated = ("simulate", TINY, *["--humans", "1", "--pool", "2", "--episodes", "2", "--policy", "attention"])
    done = invoke(*simulated, "--population", people, "--json")
    assert done.exit_code == 0, done.output
    setting, own = json.loads(done.stdout)["setting"], of_table(SHIPPED, record["trust"])
    if isinstance(own, EquationSeven):
        assert (setting["trust"], setting["eta"]) == ("paper", own.eta)
    else:
        assert setting["trust"] == plain(own)
    twice = invoke(*simulated, "--population", people, "--trust", "constant")
    assert (twice.exit_code, f"--population {people} also sets trust" in twice.stderr) == (2, True)


def test_a_population_drawn_from_a_file_is_like_the_one_that_was_fitted() -> None:
    found = fit_influence(seen(recorded(constant(), 5, 10, 0)), "constant")
    general = found.distribution()
    assert general.theta is not None
    people = general.population().sample(None, 4000, np.random.default_rng(0))
    assert np.mean([one.theta for one in people]) == pytest.approx(general.theta.mean, abs=0.02)
    assert np.mean([one.beta for one in people]) == pytest.approx(general.beta.mean, rel=0.1)
    assert trust_of(general.as_dict()) == found.trust
    own = fit_influence(seen(recorded(constant(), 2, 5, 0)), Doubling())
    assert (own.rule, own.parameters) == ("Doubling", {})
    with pytest.raises(ValueError, match="a rule that is not saved"):
        own.distribution()


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ("outcome", "trust 'outcome'; expected an object"),
        ({"rule": "vanity"}, "trust.rule: 'vanity'; expected one of paper"),
        ({"rule": "paper", "gain": 1}, "trust.gain: unknown; expected one of eta, utility_scale"),
        ({"rule": "outcome", "gain": -1}, "trust.gain: -1; expected a number from 0"),
    ],
)
def test_a_population_file_with_no_such_rule_is_refused(bad: object, words: str, tmp_path: Path) -> None:
    file = tmp_path / "people.json"
    part = {"share": 1, "beta": [0.1, 1], "theta": [0.2, 0.4], "sigma": [0, 0]}
    file.write_text(json.dumps({"parts": [part], "trust": bad}))
    for command in (("simulate", TINY, "--humans", 1), ("policy", TINY)):
        done = invoke(*command, "--population", file)
        assert done.exit_code == 2
        assert f"--population {file}: {words}" in " ".join(done.stderr.split())


def test_a_log_without_suggestions_is_refused(tmp_path: Path) -> None:
    rows = [row | {"suggestion": None} for row in recorded(constant(), 2, 4, 0)]
    file = write_log(tmp_path / "log.jsonl", rows)
    for command in (("fit", "--influence", "constant"), ("compare", "rules")):
        done = invoke(*command, TINY, file)
        assert done.exit_code == 1
        assert f"{file}: no suggestion in the episodes that are used" in done.stderr
        assert len(done.stderr.strip().splitlines()) == 1


def test_suggestions_of_an_episode_that_is_left_out_are_not_said_to_be_missing_in_the_log(tmp_path: Path) -> None:
    rows = [row | {"episode": "used", "suggestion": None} for row in recorded(constant(), 1, 1, 0)]
    spoilt = {**rows[0], "episode": "left out", "step": 3, "suggestion": rows[0]["action"]}
    done = invoke("fit", "--influence", "constant", TINY, write_log(tmp_path / "log.jsonl", [*rows, spoilt]))
    assert done.exit_code == 1
    assert "no suggestion in the episodes that are used; expected some" in done.stderr


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--influence constant --terms", "--terms and --influence: expected one of them"),
        ("--influence constant --family uniform", "--family and --influence: expected one of them"),
        ("--set theta_per_episode=true", "--set theta_per_episode has no effect without --influence"),
        ("--set confidence=one", "--set confidence has no effect without --advice"),
        ("--rows a=b", "--rows: expected --advice as well"),
        ("--advice LOG --influence paper --rows a", "--rows a: expected COLUMN=VALUE, such as"),
        ("--advice LOG --influence paper --rows a=1 --rows a=2", "--rows: column a is there twice; expected one value"),
        ("--advice LOG", "--advice: expected --influence as well"),
        ("--advice LOG --influence paper", "INSTANCE has no effect with --advice"),
        ("--folds 3", "No such option '--folds'; compare has it"),
        ("--influence constant --set seed=1", "--set seed has no effect with --influence"),
        ("--influence constant --set eta=0.1", "--set eta has no effect with --influence constant"),
        ("--influence outcome --set utility_scale=2", "--set utility_scale has no effect with --influence outcome"),
        (f"--goals {TINY} --set seed=1", "--set seed has no effect with --goals"),
        (
            f"--set chooses={ROOT}/docs/examples/short_sighted.py:short_sighted --set seed=1",
            "--set seed has no effect with chooses",
        ),
        ("--advice LOG --influence constant --set level=0.9", "--set level has no effect with --advice"),
        ("--family uniform", "--family: expected a log of 3 people or more, or --write-population"),
        ("INSTANCE ALONE", "expected INSTANCE and LOG, or --advice"),
        ("ADVICE ALONE --drop return", "--drop has no effect with --advice"),
    ],
)
def test_options_that_exclude_each_other(options: str, words: str, log_file: Path, tmp_path: Path) -> None:
    rows = [json.loads(line) for line in log_file.read_text().splitlines()]
    one = write_log(tmp_path / "one.jsonl", [row for row in rows if row["person"] == rows[0]["person"]])
    given = [log_file if option == "LOG" else option for option in options.split()]
    begin: list[object] = [TINY, one if "--family" in given else log_file]
    if given[1:2] == ["ALONE"]:
        begin, given = ([TINY], []) if given[0] == "INSTANCE" else (["--advice", log_file], given[2:])
        begin += ["--influence", "paper"] if given else []
    done = invoke("fit", *begin, *given)
    assert (done.exit_code, done.stdout) == (2, "")
    assert words in done.stderr
    if options == "--family uniform":
        done = invoke("fit", *begin, *given, "--write-population", tmp_path / "people.json")
        assert (done.exit_code, done.stderr) == (0, "")


@pytest.mark.slow
def test_intervals_follow_the_ridge_where_one_parameter_has_no_effect() -> None:
    """With unit costs the gain has no effect. At the ends of the interval of the loss, the best agreement is as likely.

    Otherwise intervals are those of a loss with a known agreement, and too short.
    """
    log = LikelihoodTable.of(seen(recorded(outcome_at_disagreement(0.2, 0.1, 0.8), 24, 40, 5)), Method())
    search = RuleSearch(log, families(Method())["outcome-at-disagreement"], carry=True)
    best = search.best()
    found = search.intervals(best, search.covariance(best), 0.95)
    assert found[1] == (0.0, 3.0)
    for end in found[2]:
        near = [search.fitted((agreement, best[1], end))[1] for agreement in np.linspace(*found[0], 13)]
        assert search.fitted(best)[1] - max(near) == pytest.approx(1.92, abs=0.3)


def test_models_that_predict_alike_differ_by_nothing_without_an_interval() -> None:
    logs = {"one": np.array([-2.0, -3.0]), "other": np.array([-2.0, -3.0])}
    found = Comparison.of(["ann", "ben"], np.array([2, 3]), logs, {"one": {}, "other": {}}, "one")["other"]
    assert (found.difference, found.interval, found.p) == (0.0, None, 1.0)
