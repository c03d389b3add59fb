"""Judgements with advice: reading logs, the likelihood against plain integration, and fits of simulated people."""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from advice_rules import RULES as COMPARED_BEFORE
from advice_rules import model_of
from conftest import invoke
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded import predictions, simulated

from assist.learning import AdviceLog, Method, compare_rules, fit_advice, held_out, read_advice
from assist.learning.advice_fit import _Likelihood, _local_maximum, fit_model
from assist.learning.advice_log import COLUMNS
from assist.learning.advice_model import BASES, LAPSE, NODES, AdviceModel
from assist.learning.advice_rules import DEFAULT_STEPS, RULES, Rule
from assist.learning.held_out import COMPARED, fold_of
from assist.people.trust_rules import LEAST, EquationSeven, Event, LogitSteps
from planner.system.errors import InputFileError

CONSTANT = AdviceModel.of("E", RULES["constant"])


def after(
    theta: float, rule: Rule, *parameters: float, agrees: bool, right: bool, shown: bool, times: int = 1
) -> float:
    """Return theta after equal judgements."""
    log = simulated(1, times, 0)
    flags = {"agrees": agrees, "right": right, "shown": shown}
    log = AdviceLog(**vars(log) | {name: np.full(times, flag) for name, flag in flags.items()})
    start = theta
    for a, b, c, d in rule.moves(log, *(parameters or rule.parameters.values())):
        source = start if rule.from_start else theta
        theta = min(max((a * source + b) / (c * source + d), LEAST), 1 - LEAST)
    return theta


@pytest.mark.parametrize("rule", ["shipped", pytest.param("with a slope", marks=pytest.mark.slow)])
def test_the_likelihood_is_that_of_the_model(rule: str) -> None:
    """One person at a time, in plain arithmetic, for a rule of the logit scale and each base."""
    log = simulated(2, 10, 0)
    log = AdviceLog(**vars(log) | {"advice_confidence": np.linspace(-0.5, 0.5, len(log))})
    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES)
    # b1 differs between people under one of the rules: the mean over a second normal distribution.
    others, shares = np.polynomial.hermite_e.hermegauss(11) if "slope" in rule else (np.zeros(1), np.ones(1))
    for base in BASES:
        model = AdviceModel.of(base, RULES["outcome-at-disagreement"])
        names = ("agreement", "gain", "loss")
        if "slope" in rule:
            model = model_of(base, COMPARED_BEFORE["random confidence slope + L agreement + outcome at disagreement"])
            names = ("o", "g", "l")
        own, total = model.parameters, 0.0
        agreed, gained, lost = (own[name] for name in names)
        for name in np.unique(log.person):
            rows = np.flatnonzero(log.person == name)
            mass = 0.0
            for (node, weight), (other, share) in product(
                zip(nodes, weights / weights.sum(), strict=True), zip(others, shares / shares.sum(), strict=True)
            ):
                theta, chance = 1 / (1 + math.exp(-(own["mu"] + own["sigma"] * node))), 1.0
                b1 = own["b1"] + own.get("slope", 0.0) * other
                theta = min(max(theta, LEAST), 1 - LEAST)
                for i in rows:
                    c, s = log.confidence[i], 1 if log.agrees[i] else -1
                    z = math.log(theta / (1 - theta))
                    if base == "A":
                        z += s * (own["b0"] + b1 * c)
                    elif log.agrees[i]:
                        z = own["a0"] + own["a1"] * c
                    else:
                        z -= b1 * c
                    z += own.get("advised", 0.0) * log.advice_confidence[i]
                    p = LAPSE + (1 - 2 * LAPSE) / (1 + math.exp(-z))
                    chance *= p if log.follows[i] else 1 - p
                    step = agreed if log.agrees[i] else gained if log.right[i] else -lost
                    theta = 1 / (1 + math.exp(-(math.log(theta / (1 - theta)) + step)))
                    theta = min(max(theta, LEAST), 1 - LEAST)
                mass += weight * share * chance
            total += math.log(mass)
        assert predictions(model, log).sum() == pytest.approx(total, rel=1e-10)
        assert model.log_likelihood(log) == pytest.approx(total, rel=1e-10)


@pytest.mark.parametrize("base", BASES)
def test_the_likelihood_of_thousands_of_answers_is_the_sum_of_their_predictions(base: str) -> None:
    """The product of the answers of one person is far smaller than the smallest floating-point number."""
    log = simulated(1, 3_000, 0)
    model = AdviceModel.of(base, RULES["outcome"])
    total = model.log_likelihood(log)
    assert total < -800
    assert total == pytest.approx(predictions(model, log).sum(), rel=1e-9)


def test_parameters_of_people_with_thousands_of_answers_are_found() -> None:
    log = simulated(3, 1_500, 1)
    found = fit_advice(log, "constant")
    assert replace(CONSTANT, values=(0.5, 1.5, 1.5, 3.3, 1.2)).log_likelihood(log) < found.log_likelihood < 0
    assert found.parameters["b1"] == pytest.approx(1.5, abs=0.3)


@pytest.mark.parametrize(("people", "trials"), [(3, 600), pytest.param(10, 200, marks=pytest.mark.slow)])
def test_few_people_with_many_judgements_have_enough_nodes(people: int, trials: int) -> None:
    """Thousands of judgements tell theta more closely than the nodes of the quadrature are apart."""
    log, start = simulated(people, trials, 1), CONSTANT
    found = fit_model(start, log)
    for model in (found, start.refined(log)):
        assert model.log_likelihood(log) == pytest.approx(on_a_fine_grid(model, log), abs=0.02 * people)
    assert abs(start.log_likelihood(log) - on_a_fine_grid(start, log)) > 0.1 * people
    assert start.refined(simulated(40, 25, 1)).nodes == NODES  # these are enough for few judgements


def on_a_fine_grid(model: AdviceModel, log: AdviceLog) -> float:
    """Return the log likelihood of base E with a theta that stays, as a sum over 4,001 values of theta."""
    own, total = model.parameters, 0.0
    logits = np.linspace(own["mu"] - 8 * own["sigma"], own["mu"] + 8 * own["sigma"], 4_001)
    density = np.exp(-(((logits - own["mu"]) / own["sigma"]) ** 2) / 2)
    theta = np.clip(1 / (1 + np.exp(-logits)), LEAST, 1 - LEAST)
    for name in np.unique(log.person):
        logs = np.zeros(len(theta))
        for i in np.flatnonzero(log.person == name):
            c = log.confidence[i]
            z = own["a0"] + own["a1"] * c if log.agrees[i] else np.log(theta / (1 - theta)) - own["b1"] * c
            p = LAPSE + (1 - 2 * LAPSE) / (1 + np.exp(-z))
            logs += np.log(p if log.follows[i] else 1 - p)
        total += math.log((np.exp(logs - logs.max()) * density).sum() / density.sum()) + logs.max()
    return total


def test_rules_are_compared_with_base_rates_and_fixed_steps() -> None:
    """Base rates are those of the people of other folds."""
    log = simulated(24, 12, 0)
    rules = {"constant": RULES["constant"], "rates": None, "fixed": DEFAULT_STEPS}
    found = compare_rules(log, rules=rules, folds=2)
    fold, total, constant = fold_of(log.people, 2), 0.0, 0.0
    for each in (0, 1):
        others, inside = log.of(fold != each), log.of(fold == each)
        for agrees in (False, True):
            rate = (others.follows[others.agrees == agrees].sum() + 0.5) / ((others.agrees == agrees).sum() + 1)
            total -= np.log(np.where(inside.follows, rate, 1 - rate))[inside.agrees == agrees].sum()
        constant -= predictions(fit_model(CONSTANT, others), inside).sum()
    assert found["rates"].nats_per_choice * len(log) == pytest.approx(total)
    assert found["constant"].nats_per_choice * len(log) == pytest.approx(constant, abs=0.01)
    assert found["rates"].difference == pytest.approx((total - constant) / len(log), abs=1e-4)
    assert set(found["rates"].parameters) == {"agreement", "disagreement"}
    assert found["fixed"].parameters.keys() == found["constant"].parameters.keys()
    never = AdviceLog(**vars(log) | {"follows": np.zeros(len(log), dtype=bool)})
    assert np.isfinite(compare_rules(never, rules=rules).scores[1].nats_per_choice)


def test_a_fit_without_a_finite_likelihood_is_an_error() -> None:
    log = simulated(2, 10, 0)
    log = AdviceLog(**vars(log) | {"confidence": np.full(len(log), np.nan)})
    with pytest.raises(ValueError, match="the log likelihood is nan"):
        fit_advice(log, "constant")


@given(
    st.floats(0.01, 0.99), st.booleans(), st.booleans(), st.booleans(),
    st.floats(-1, 1), st.floats(0, 2), st.floats(0, 2),
)  # fmt: skip
@settings(max_examples=50, deadline=None)
def test_a_rule_of_logs_is_the_rule_of_planning_tasks(
    theta: float, agrees: bool, right: bool, shown: bool, agreement: float, gain: float, loss: float
) -> None:
    """The matching rule of `people.trust_rules` updates theta in the same way."""
    rule = LogitSteps(agreement, gain, loss)
    event = Event(*(np.asarray(each) for each in (0.0, agrees, True, shown, right)))
    own = RULES["outcome-at-disagreement"], agreement, gain, loss
    moved = after(theta, *own, agrees=agrees, right=right, shown=shown)
    assert moved == pytest.approx(float(rule.update(np.array(theta), event)), abs=1e-12)


OF_BENCHMARKS = [pytest.param(rule, marks=pytest.mark.slow) for rule in COMPARED_BEFORE.values() if not rule.by_steps]


@pytest.mark.parametrize("rule", [RULES["reliability"], *OF_BENCHMARKS], ids=lambda rule: rule.name)
def test_theta_goes_the_way_of_the_outcomes(rule: Rule) -> None:
    for right in (True, False):
        thetas = [0.5, *(after(0.5, rule, agrees=right, right=right, shown=True, times=n) for n in range(1, 6))]
        assert all((b >= a if right else b <= a) for a, b in pairwise(thetas))
        assert all(LEAST <= theta <= 1 - LEAST for theta in thetas)


def test_parameters_of_simulated_people_are_found() -> None:
    fitted = fit_model(CONSTANT, simulated(150, 25, 1)).parameters
    for name, true, most in (("mu", 0.5, 0.4), ("sigma", 1.5, 0.375), ("b1", 1.5, 0.5)):
        assert fitted[name] == pytest.approx(true, abs=most)


@pytest.mark.slow
def test_a_fit_of_clipped_steps_is_the_best_of_local_maxima() -> None:
    """With too few nodes there are many maxima, which tell nothing about people."""
    log, rng = simulated(20, 20, 3), np.random.default_rng(1)
    model = AdviceModel.of("E", COMPARED_BEFORE["eq7 eta=.2, unit steps"])
    found = fit_model(model, log)
    coarse, fine = [], []
    for _ in range(6):
        values = (rng.normal(0.5, 1.5), rng.uniform(0.5, 4), *model.values[2:])
        for start, others in ((model, coarse), (found, fine)):
            surface = _Likelihood(start, log)
            others.append(-surface.loss(_local_maximum(surface, surface.point(values))))
    assert max(coarse) - min(coarse) > 1 > 2 * (max(fine) - min(fine))
    assert found.log_likelihood(log) > max(fine) - 0.01


@pytest.mark.parametrize(("rule", "of"), [("outcome", LogitSteps), ("paper", EquationSeven)])
def test_a_fit_to_people_who_move_the_other_way_is_a_rule_that_settings_take(rule: str, of: Callable[..., Any]) -> None:
    log = simulated(20, 15, 2, steps=-0.8)
    found = fit_advice(log, rule)
    steps = {name: value for name, value in found.parameters.items() if name in RULES[rule].parameters}
    assert of(**steps)
    assert min(steps.values()) < 0.01  # at the limit
    assert found.log_likelihood >= fit_advice(log, "constant").log_likelihood - 0.01


def test_the_right_rule_predicts_people_better_whom_it_has_not_seen() -> None:
    log = simulated(40, 25, 2, steps=0.8)
    rules = {"constant": RULES["constant"], "moving": COMPARED_BEFORE["L outcome at disagreement gain/loss"]}
    found = compare_rules(log, Method(level=0.997), rules=rules, folds=2)["moving"]
    assert found.interval is not None
    assert found.interval[1] < 0


def test_folds_go_by_the_numbers_in_names() -> None:
    assert fold_of([f"p{k:03}" for k in range(20)]).tolist() == [k % 8 for k in range(20)]
    assert fold_of(["ann", "bob", "cyd"], 2).tolist() == [0, 1, 0]


def write(file: Path, *rows: dict[str, object], columns: tuple[str, ...] = (), left_out: tuple[str, ...] = ()) -> Path:
    names = [name for name in (*COLUMNS, *columns) if name not in left_out]
    with file.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, names, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
    return file


ROW: dict[str, object] = {
    "person": "p1", "sequence": "p1-a", "trial": 2, "own_choice": 0, "own_confidence": 20, "advice": 1,
    "final_choice": 1, "outcome": 1, "feedback_shown": 0,
}  # fmt: skip
LATER, OTHER = ROW | {"trial": 3}, ROW | {"sequence": "p1-b"}


def test_a_file_is_read(tmp_path: Path) -> None:
    file = write(tmp_path / "log.csv", ROW, OTHER | {"trial": 1, "advice": 0})
    own, one = read_advice(file), read_advice(file, confidence="one")
    assert own.agrees.tolist() == [True, False]  # in the order of trials
    assert own.follows.tolist() == [False, True]
    assert (own.sequence.tolist(), own.first.tolist()) == ([0, 1], [True, False])
    assert own.confidence.tolist() == [0.2, 0.2]
    assert [row["follows"] for row in own.records()] == [False, True]
    assert one.confidence == pytest.approx(0.6)  # 20 % for choice 1 is 80 % for choice 0
    assert len(read_advice(write(file, ROW, LATER, OTHER))) == 3  # trials may be counted for each advisor
    file.write_text(write(file, ROW).read_text().replace(",", ";"))
    assert read_advice(file).right.tolist() == [True]
    # An advisor may be missing, and feedback have another name.
    given = write(file, ROW | {"feedback": 1}, LATER | {"feedback": 0}, columns=("feedback",), left_out=COLUMNS[1::7])
    assert (read_advice(given).shown.tolist(), read_advice(given).sequence.tolist()) == ([True, False], [0, 0])
    advised = write(file, ROW | {"advice_confidence": 70}, columns=("advice_confidence",))
    assert read_advice(advised, confidence="one").advice_confidence == pytest.approx(-0.1)
    assert len(read_advice(write(file, ROW, columns=("advice_confidence",)))) == 1  # nothing stands in it
    rows = [ROW | {"person": f"p{n}", "failed": n % 2, "group": "AB"[n // 2]} for n in range(4)]
    write(file, *rows, columns=("failed", "group"))
    assert read_advice(file, rows={"failed": "0"}).person.tolist() == ["p0", "p2"]
    assert read_advice(file, rows={"failed": "0", "group": "B"}).person.tolist() == ["p2"]


TWICE = ("advice", "advice_confidence", "advice_confidence")


@pytest.mark.parametrize(
    ("rows", "more", "words"),
    [
        ([ROW | {"own_confidence": "high"}], {}, ":2: own_confidence 'high': expected a number from 0 to 100"),
        ([ROW | {"advice": 2}], {}, ":2: advice 2: expected 0 or 1"),
        ([ROW | {"advice": 0.5}], {}, ":2: advice 0.5: expected 0 or 1"),
        ([ROW | {"trial": ""}], {}, ":2: trial '': expected a number"),
        ([ROW | {"person": ""}], {}, ":2: person '': expected a name"),
        ([ROW | {"own_confidence": 0.65}], {}, "own_confidence is at most 0.65 in all lines; expected 0 to 100"),
        ([ROW], {"left_out": COLUMNS[-2:]}, "no column 'outcome'"),
        ([ROW], {"rows": {"person": "nobody"}}, "no judgement has person nobody; there are p1"),
        ([ROW], {"rows": {"condition": "a"}}, ":1: no column 'condition' to choose rows by; there are person, seq"),
        ([ROW, LATER | {"person": "p2"}], {"rows": {"person": "p1", "trial": "3"}},
         "no judgement has all of the chosen values"),
        ([], {}, "no judgement is there"),
        ([ROW, LATER, ROW], {}, ":4: trial 2 of p1 is on line 2 already"),
        ([ROW], {"columns": TWICE[:1]}, ":1: 2 columns are called advice; expected one"),
        ([ROW], {"columns": TWICE[1:]}, ":1: 2 columns are called advice_confidence; expected one"),
        ([ROW | {"advice_confidence": 70}, LATER], {"columns": TWICE[1:2]},
         "advice_confidence is not used with confidences about the own choice"),
    ],
)  # fmt: skip
def test_a_fault_is_told_with_its_line(tmp_path: Path, rows: list[Any], more: dict[str, Any], words: str) -> None:
    chosen = more.get("rows")
    more = {name: value for name, value in more.items() if name != "rows"}
    with pytest.raises(InputFileError, match=re.escape(words)):
        read_advice(write(tmp_path / "log.csv", *rows, **more), rows=chosen)
    with pytest.raises(InputFileError, match="no such file"):
        read_advice(tmp_path / "none.csv")


@pytest.fixture
def judgements(tmp_path: Path) -> Path:
    """Six people, half of whom follow advice, with a few judgements each."""
    rng = np.random.default_rng(0)
    file = tmp_path / "advice.csv"
    with file.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(COLUMNS)
        for k in range(6):
            for trial in range(6):
                own, advice, outcome = (int(flag) for flag in rng.random(3) < 0.5)
                final = advice if rng.random() < (0.9 if k % 2 else 0.2) else own
                writer.writerow([f"p{k}", "a", trial, own, int(rng.integers(0, 101)), advice, final, outcome, 1])
    return file


def test_advice_is_fitted_by_command(judgements: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    few = {name: COMPARED[name] for name in ("base rates", "one theta", "constant", "outcome")}
    monkeypatch.setattr(held_out, "COMPARED", few)
    done = invoke("fit", "--advice", judgements, "--influence", "constant", "--out", tmp_path / "one.jsonl")
    assert done.exit_code == 0, done.output
    assert "6 people, 36 choices" in done.stdout
    assert json.loads((tmp_path / "one.jsonl").read_text())["rule"] == "constant"
    compared = json.loads(invoke("compare", "rules", "--advice", judgements, "--folds", 2, "--json").stdout)
    assert (len(compared["people"]), compared["choices"]) == (6, 36)
    parameters = {row["model"]: set(row["parameters"]) for row in compared["models"]}
    assert parameters["outcome"] - parameters["constant"] == {"gain", "loss"}
    assert parameters["base rates"] == {"agreement", "disagreement"}
    assert parameters["one theta"] == parameters["constant"]
    rows = ("--rows", "sequence=a", "--rows", "person=p1")
    chosen = json.loads(invoke("fit", "--advice", judgements, "--influence", "constant", *rows, "--json").stdout)
    assert (chosen["people"], chosen["choices"]) == (1, 6)


def test_a_line_of_advice_that_is_wrong_is_named(judgements: Path) -> None:
    rows = judgements.read_text().splitlines()
    judgements.write_text("\n".join([*rows[:3], rows[3].replace(",a,2,", ",a,two,"), *rows[4:]]))
    done = invoke("fit", "--advice", judgements, "--influence", "constant")
    assert done.exit_code == 1
    assert f"{judgements}:4: trial 'two': expected a number" in done.stderr
    judgements.write_text("\n".join(rows[:5]))
    one = invoke("compare", "rules", "--advice", judgements)
    assert (one.exit_code, "one person; a comparison needs two or more" in one.stderr) == (1, True)
