"""Analysis of user studies: tests and intervals beside independent implementations, Holm's family, preregistration."""

from __future__ import annotations

import csv
import io
import json
import math
import re
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.metadata import version
from itertools import combinations, permutations
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
import pytest
from conftest import invoke
from hypothesis import example, given
from hypothesis import strategies as st
from scipy import special, stats
from userstudies import PLAN, SCORES, exported, foreseen, written

from assist.cli.user_study import _report
from assist.learning.intervals import holm
from assist.studies.repeated_measures import means_within, mixed_model, within_participants
from assist.studies.reports import userstudy_comparisons
from assist.studies.reports.preregistration import REGISTERED, changed
from assist.studies.reports.userstudy_data import Measure, StudyData
from assist.studies.reports.userstudy_report import of_folder, report_text, write_report
from assist.studies.reports.userstudy_summary import summarise
from assist.studies.statistics import (
    EXACT,
    between_groups,
    cronbach_alpha,
    fisher_p,
    mann_whitney,
    newcombe,
    sign_test,
    signed_rank,
)
from assist.studies.userstudy.forecast import Forecast
from assist.studies.userstudy.outcomes import OUTCOMES
from assist.studies.userstudy.plan import UserStudy
from assist.studies.userstudy.plan_file import read
from assist.studies.userstudy.session import JOURNAL
from assist.studies.userstudy.tables import COLUMNS, Tables
from assist.web.client import Client
from planner.system.errors import InputFileError

__all__ = ["foreseen"]

CONFIRMED = PLAN.replace("seed = 3", 'seed = 3\nconfirmatory = ["actions", "trust"]')
WITHIN = CONFIRMED.replace("seed = 3", 'seed = 3\ndesign = "within"')


@pytest.fixture
def few_people(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a forecast simulate one round of few people."""
    monkeypatch.setattr("assist.studies.userstudy.forecast.PEOPLE", 40)
    monkeypatch.setattr("assist.studies.userstudy.forecast.EFFORT", 0)


@pytest.fixture
def one_round(monkeypatch: pytest.MonkeyPatch, foreseen: Forecast) -> None:
    """Let a forecast have the people of another one, whatever its study."""
    monkeypatch.setattr(Forecast, "rounds", lambda study, *_, **__: iter([replace(foreseen, study=study)]))


def rows_of(outcomes: list[tuple[str, str, int, float | None, int]], **more: Any) -> Tables:
    """Return tables in which participants have (order or condition, condition, period, actions, trust)."""
    found = Tables()
    for number, (assigned, condition, period, actions, trust) in enumerate(outcomes):
        who = more.get("who", lambda n: f"P{n}")(number)
        blank: dict[str, Any] = dict.fromkeys(COLUMNS["participants"])
        if not found.participants or found.participants[-1]["participant"] != who:
            found.participants.append(blank | {
                "participant": who, "simulated": False, "status": "done", "stage": "thanks", "condition": assigned,
                "arrived": "2026-11-27T12:00:00+00:00", "failed_checks": 0,
            })  # fmt: skip
        where = {"participant": who, "condition": condition, "period": period}
        found.tasks.append(where | {
            "task": "tiny", "position": 1, "finished": actions is not None, "actions": actions or 1,
            "optimal_cost": 6.0, "suboptimal_actions": 0, "suggestions": 0, "followed": 0, "seconds": 10.0,
        })  # fmt: skip
        for item in SCORES["trust"]:
            found.answers.append(dict.fromkeys(COLUMNS["answers"]) | where | {
                "questionnaire": "trust", "item": item, "answer": trust, "score": trust,
            })  # fmt: skip
    return found


def crossed(people: int, value: Callable[[int, str, int], tuple[float | None, int]]) -> Tables:
    """Return tables of people who have both conditions, every other one `none` first; actions and trust are given."""
    rows, names = [], []
    for number in range(people):
        order = ("none", "attention") if number % 2 else ("attention", "none")
        for period, name in enumerate(order, start=1):
            actions, trust = value(number, name, period)
            rows.append((" > ".join(order), name, period, actions, trust))
            names.append(f"P{number}")
    return rows_of(rows, who=names.__getitem__)


def study_with(folder: Path, text: str = CONFIRMED) -> Any:
    return read(written(folder / "study.toml", text))


@pytest.mark.parametrize("seed", range(3))
def test_estimates_intervals_and_p_values_are_those_of_other_implementations(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.normal(10, 3, 14 + seed), rng.normal(12, 5, 11)
    near = {"rel": 1e-6, "abs": 1e-9}
    peer = stats.ttest_ind(a, b, equal_var=False)
    found = between_groups(a, b)
    assert found.p == pytest.approx(peer.pvalue, **near)
    assert (found.difference.low, found.difference.high) == pytest.approx(tuple(peer.confidence_interval()), **near)
    pairs = a[:11] - b
    # Two orders of two conditions: the difference is the mean over the orders of their mean differences.
    first = np.arange(11) % 2 == seed % 2
    within = within_participants(pairs, np.where(first[:, None], [1, 2], [2, 1]))
    crossed = stats.ttest_ind(pairs[first], -pairs[~first])
    assert within.p == pytest.approx(crossed.pvalue, **near)
    ends = crossed.confidence_interval()
    assert (within.difference.low, within.difference.high) == pytest.approx((ends.low / 2, ends.high / 2), **near)

    # Ranks: every pair of people is compared, and the normal approximation computed by hand.
    x, y = rng.integers(1, 8, 20).astype(float), rng.integers(2, 8, 15).astype(float)
    u = sum((one > other) + 0.5 * (one == other) for one in x for other in y)
    _, ties = np.unique(np.concatenate([x, y]), return_counts=True)
    n, m, total = len(x), len(y), len(x) + len(y)
    spread = math.sqrt(n * m / 12 * (total + 1 - (ties**3 - ties).sum() / (total * (total - 1))))
    z = (max(u, n * m - u) - n * m / 2 - 0.5) / spread
    ranked = mann_whitney(x, y)
    assert ranked.p == pytest.approx(special.erfc(z / math.sqrt(2)), **near)
    assert ranked.effect == pytest.approx(2 * u / (n * m) - 1, **near)

    # Exact tests of completion, by all tables with these margins.
    k, other = int(rng.integers(0, 13)), int(rng.integers(0, 10))
    weights = {i: math.comb(12, i) * math.comb(9, k + other - i) for i in range(13) if 0 <= k + other - i <= 9}
    extreme = sum(w for w in weights.values() if w <= weights[k]) / sum(weights.values()) if k in weights else 1.0
    assert fisher_p(k, 12, other, 9) == pytest.approx(extreme, **near)
    larger, smaller = 7 + seed, 2
    tail = sum(math.comb(9 + seed, i) for i in range(smaller + 1)) / 2 ** (9 + seed)
    assert sign_test(larger, smaller).p == pytest.approx(2 * tail, **near)


@given(st.lists(st.sampled_from([-3, -2, -1, 0, 1, 2, 2.5]), min_size=1, max_size=15).filter(any))
@example([1] * 11 + [-1] * 3)
@example([1] * 12 + [-1] * 4)
def test_the_signed_rank_test_is_exact_with_ties(differences: list[float]) -> None:
    """The p-value is the share of all assignments of signs whose sum of ranks is as far from zero."""
    x = np.array([value for value in differences if value])
    ranks = stats.rankdata(np.abs(x))
    signs = 1 - 2 * (np.arange(2 ** len(x))[:, None] >> np.arange(len(x)) & 1)
    seen = abs(ranks @ np.sign(x))
    found = signed_rank(differences)
    assert found.p == pytest.approx(float((np.abs(signs @ ranks) >= seen - 1e-9).mean()), rel=1e-9)
    assert found.effect == pytest.approx((ranks * np.sign(x)).sum() / ranks.sum(), rel=1e-9)
    rounded = [value / 3 + 7 / 3 - 7 / 3 for value in differences]  # as differences of means over three tasks are
    assert signed_rank(rounded) == found


def test_the_signed_rank_test_of_many_differences_is_an_approximation_close_to_the_exact_one() -> None:
    rng = np.random.default_rng(1)
    for count in (EXACT, EXACT + 1):
        x = np.rint(rng.normal(0.3, 2, 2 * count))
        x = x[x != 0][:count]
        assert len(x) == count
        approximate = stats.wilcoxon(x, correction=True, method="approx").pvalue
        found = signed_rank(x).p
        assert found == pytest.approx(approximate, rel=0.02)
        assert (found == approximate) == (count > EXACT)


def test_the_interval_of_two_shares_is_the_published_one() -> None:
    """Newcombe (1998), method 10: 56/70 and 48/80, and the extremes 9/10 and 3/10."""
    for counts, ends in (((56, 70, 48, 80), (0.0524, 0.3339)), ((9, 10, 3, 10), (0.1705, 0.8090)),
                         ((10, 10, 0, 10), (0.6075, 1.0000))):  # fmt: skip
        found = newcombe(*counts)
        assert (found.low, found.high) == pytest.approx(ends, abs=5e-5)


@given(st.lists(st.floats(0, 1), min_size=1, max_size=7))
def test_holm_is_the_closed_test_of_all_subfamilies(p_values: list[float]) -> None:
    """The closed test rejects what every subfamily with it rejects, each by Bonferroni."""
    n = len(p_values)
    closed = [
        max(
            min(1.0, size * min(p_values[i] for i in family))
            for size in range(1, n + 1)
            for family in combinations(range(n), size)
            if one in family
        )
        for one in range(n)
    ]
    assert holm(p_values) == pytest.approx(closed)
    assert holm([*p_values, math.nan])[:n] == pytest.approx(holm([*p_values, 1.0])[:n])


def test_least_squares_removes_what_people_learn_from_one_condition_to_the_next() -> None:
    rng = np.random.default_rng(5)
    names = ("none", "a", "b")
    rows = []
    for number in range(12):
        own = rng.normal(20, 5)
        for period, name in enumerate(rng.permutation(names), start=1):
            value = own + {"none": 0, "a": -2, "b": 1}[str(name)] - 3 * period + rng.normal(0, 1)
            rows.append((f"P{number}", str(name), period, value))
    rows = [row for number, row in enumerate(rows) if number % 11]  # some left earlier
    values = {(who, name): (value, period) for who, name, period, value in rows}
    for name, truth in (("a", -2), ("b", 1)):
        both = [who for who in dict.fromkeys(row[0] for row in rows) if {(who, name), (who, "none")} <= values.keys()]
        found = within_participants(
            [values[who, name][0] - values[who, "none"][0] for who in both],
            [(values[who, name][1], values[who, "none"][1]) for who in both],
        )
        # The same by a regression with a column for each participant and each later period.
        own = [row for row in rows if row[0] in both and row[1] in (name, "none")]
        columns = [[one == name, *(who == each for each in both), t == 2, t == 3] for who, one, t, _ in own]
        x, y = np.array(columns, dtype=float), np.array([row[3] for row in own])
        (slope, *_), (rest,), *_ = np.linalg.lstsq(x, y)
        freedom = len(own) - len(both) - 3
        half = stats.t.ppf(0.975, freedom) * math.sqrt(rest / freedom * np.linalg.inv(x.T @ x)[0, 0])
        given = found.difference
        assert (given.value, given.low, given.high) == pytest.approx((slope, slope - half, slope + half), rel=1e-6)
        assert given.value == pytest.approx(truth, abs=1.5)


def test_intervals_of_conditions_leave_out_what_participants_differ_in() -> None:
    rng = np.random.default_rng(4)
    own = rng.normal(50, 20, 8)
    x = np.array([own + shift + rng.normal(0, 1, 8) for shift in (0, 2, 3)])
    values = {name: {f"P{n}": float(one) for n, one in enumerate(row)} for name, row in zip("abc", x, strict=True)}
    # Two conditions: as wide as the paired interval, divided by the root of 2.
    paired = stats.ttest_rel(x[0], x[1]).confidence_interval()
    for one in means_within({name: values[name] for name in "ab"}).values():
        assert one.high - one.low == pytest.approx((paired.high - paired.low) / math.sqrt(2))
    # Three: values are normalised by participant, and Morey's factor is 3 / 2. P8 counts in the mean only.
    normalised = x - x.mean(axis=0) + x.mean()
    half = stats.t.ppf(0.975, 7) * math.sqrt(normalised[2].var(ddof=1) * 3 / 2 / 8)
    found = means_within({**values, "c": values["c"] | {"P8": 90.0}})["c"]
    assert found.value == pytest.approx((x[2].sum() + 90) / 9)
    assert found.high - found.value == pytest.approx(half)
    assert half < 3
    never = means_within({**values, "none": dict.fromkeys(values["a"], 0.0)})["none"]
    assert never.value == 0
    assert math.isnan(never.low)


def test_within_participants_the_report_has_those_intervals(tmp_path: Path) -> None:
    """People differ by far more than conditions do."""
    tables = crossed(8, lambda n, name, period: (20.0 + 30 * n + 2 * (name == "none") + n % 3 * period, 4))
    summary = summarise(study_with(tmp_path, WITHIN), tables)
    (actions,) = (one for one in summary["measures"] if one["measure"] == "actions")
    (difference,) = actions["differences"]
    for one in (*actions["cells"], difference):
        assert 0 < one["high"] - one["low"] < 6
    assert all(cell["sd"] > 60 for cell in actions["cells"])


def test_the_order_and_the_period_of_one_order_cannot_be_told_apart() -> None:
    found = within_participants([1.0, 2.0, 4.0], [(2, 1)] * 3)
    assert found.difference.value == pytest.approx(7 / 3)
    assert math.isnan(found.difference.low)
    assert math.isnan(found.p)


MIXED = {
    0: {"a": (-1.589271428571, -3.063686449933, -0.114856407209)},
    1: {
        "a": (-2.326780935933, -3.888329810461, -0.765232061406),
        "b": (1.057297594752, -0.895480767502, 3.010075957007),
    },
    2: {
        "a": (-0.110909861834, -1.483339560429, 1.261519836761),
        "b": (0.657150397184, -0.662530733665, 1.976831528034),
    },
}
"""Estimates and intervals by R 4.2.2: for each data set, whose rows have who, condition, period, order and value,

    m <- lme4::lmer(value ~ condition + period + order + (1 | who), d, control = lme4::lmerControl("nloptwrap",
        optCtrl = list(xtol_abs = 1e-14, xtol_rel = 1e-14, ftol_abs = 1e-16, ftol_rel = 1e-16)))
    t <- summary(nlme::lme(value ~ condition + period + order, d, ~ 1 | who))$tTable
    s <- coef(summary(m)); s[, 1] + outer(s[, 2] * qt(.975, t[, "DF"]), c(0, -1, 1))

with factors in all columns but the last, and the level "none" first. The second has gaps; in the third people do not
differ.
"""


def with_orders(seed: int) -> tuple[dict[str, dict[str, float]], dict[tuple[str, str], int], dict[str, str]]:
    """Return values by condition and participant, periods and orders."""
    rng = np.random.default_rng(seed)
    names = ["none", "a", "b"][: 2 if seed == 0 else 3]
    possible = list(permutations(names))
    values: dict[str, dict[str, float]] = {name: {} for name in names}
    periods, orders = {}, {}
    for number in range((12, 18, 15)[seed]):
        who, own = f"P{number:02}", rng.normal(20, (4, 3, 0)[seed])
        order = possible[rng.integers(len(possible))]
        orders[who] = " > ".join(order)
        for period, name in enumerate(order, start=1):
            value = round(own + {"none": 0, "a": -2, "b": 1}[name] - 1.5 * period + rng.normal(0, 2), 3)
            if seed == 0 or rng.random() < 0.75:
                values[name][who], periods[who, name] = value, period
    return values, periods, orders


@pytest.mark.parametrize("seed", MIXED)
def test_a_mixed_model_has_the_estimates_and_intervals_of_lme4(seed: int) -> None:
    values, periods, orders = with_orders(seed)
    found = mixed_model(values, periods, orders, "none")
    assert {name: (one.value, one.low, one.high) for name, one in found.items()} == {
        name: pytest.approx(peer, rel=1e-6) for name, peer in MIXED[seed].items()
    }
    if seed == 0:  # all data, two conditions: participants' own levels cancel
        pairs = [values["a"][who] - values["none"][who] for who in orders]
        compared = within_participants(pairs, [(periods[who, "a"], periods[who, "none"]) for who in orders])
        assert found["a"].record() == pytest.approx(compared.difference.record())


def test_a_mixed_model_that_the_data_do_not_determine_is_none() -> None:
    values, periods, orders = with_orders(0)
    once = {who: min(values, key=lambda name: periods[who, name]) for who in orders}
    first = {name: {who: own[who] for who in own if once[who] == name} for name, own in values.items()}
    assert mixed_model(first, periods, orders, "none") == {}  # nobody had two conditions
    one = {who: order for who, order in orders.items() if order == "none > a"}
    same = {name: {who: own[who] for who in one} for name, own in values.items()}
    assert mixed_model(same, periods, one, "none") == {}  # condition and period are the same
    equal = {name: dict.fromkeys(own, 3.0) for name, own in values.items()}
    assert mixed_model(equal, periods, orders, "none") == {}
    assert mixed_model({"none": {}, "a": {}}, {}, {}, "none") == {}


def test_who_does_not_finish_counts_in_completion_and_has_the_worst_rank(tmp_path: Path) -> None:
    """One action and a timeout beat no optimum of six."""
    with_it = [("attention", "attention", 1, value, 6) for value in (6, 7, 6, None, None)]
    without = [("none", "none", 1, value, 4) for value in (9, 8, 10, 9, 8)]
    summary = summarise(study_with(tmp_path), rows_of([*with_it, *without]))
    measured = {one["measure"]: one for one in summary["measures"]}
    assert {cell["condition"]: (cell["n"], cell["mean"]) for cell in measured["actions"]["cells"]} == {
        "none": (5, 8.8), "attention": (3, pytest.approx(19 / 3)),
    }  # fmt: skip
    (completed,) = measured["completion"]["differences"]
    assert completed["mean"] == pytest.approx(-40)
    assert completed["p"] == pytest.approx(stats.fisher_exact([[3, 2], [5, 0]]).pvalue)
    worst = {one["measure"]: one for one in summary["worst_rank"]}["actions"]
    assert worst["n"] == 5
    assert worst["effect"] == pytest.approx((2 * 5 - 3 * 5) / 25)  # two pairs won by the unfinished, three lost
    (likert, _) = summary["likert"]
    assert (likert["item"], likert["effect"], likert["n"]) == ("rely", 1.0, 5)


def test_tests_within_participants_say_how_many_pairs_they_compare(tmp_path: Path) -> None:
    """Six people have both conditions, and two left after the first one."""
    tables = crossed(8, lambda number, _, period: (9.0 + number * period, 2 + number % 3 + period))
    for table in (tables.tasks, tables.answers):
        table[:] = [row for row in table if row["period"] == 1 or row["participant"] < "P6"]
    summary = summarise(study_with(tmp_path, WITHIN), tables)
    cells = {cell["condition"]: cell["n"] for cell in summary["measures"][0]["cells"]}
    assert cells == {"none": 7, "attention": 7}
    assert {one["n"] for one in [*summary["worst_rank"], *summary["likert"]]} == {6}


def test_alpha_is_that_of_each_condition_where_participants_answer_in_several(tmp_path: Path) -> None:
    """Answers of one participant are not independent."""
    rng = np.random.default_rng(6)
    tables = crossed(6, lambda *_: (9.0, 4))
    for row in tables.answers:
        row["score"] = int(rng.integers(1, 8))
    found = {one["questionnaire"]: one for one in summarise(study_with(tmp_path, WITHIN), tables)["questionnaires"]}
    scores: dict[str, list[list[int]]] = {"none": [], "attention": []}
    for first, second in zip(tables.answers[::2], tables.answers[1::2], strict=True):
        scores[first["condition"]].append([first["score"], second["score"]])
    assert found["trust"]["alpha"] is None
    assert found["trust"]["alphas"] == {name: pytest.approx(cronbach_alpha(own)) for name, own in scores.items()}


@pytest.mark.parametrize("text", [CONFIRMED, WITHIN], ids=["between", "within"])
def test_the_unit_of_analysis_is_the_group(tmp_path: Path, text: str) -> None:
    """The means of the two members of each of eight groups are compared."""
    study = study_with(tmp_path, text.replace("simulated = 2", "simulated = 0") + "[group]\nsize = 2\n")
    rng = np.random.default_rng(3)
    tables = crossed(16, lambda *_: (int(rng.integers(6, 20)), 4))
    if not study.is_within:
        tables = rows_of([(row["condition"], row["condition"], 1, row["actions"], 4) for row in tables.tasks[::2]])
    for number, row in enumerate(tables.participants):
        group = f"G{number % 8}"  # whose members have the same order, or condition
        row |= {"group": group}
    groups = {row["participant"]: row["group"] for row in tables.participants}
    own: dict[str, dict[str, list[float]]] = {"none": {}, "attention": {}}
    for row in tables.tasks:
        own[row["condition"]].setdefault(groups[row["participant"]], []).append(row["actions"])
    means = {name: {group: fmean(both) for group, both in each.items()} for name, each in own.items()}
    (measure,) = (one for one in StudyData(study, tables).measures if one.name == "actions")
    assert measure.values == means
    summary = summarise(study, tables) | {"preregistration": None}
    (difference,) = summary["measures"][0]["differences"]
    none, attention = means["none"], means["attention"]
    assert difference["mean"] == pytest.approx(fmean(attention.values()) - fmean(none.values()))
    samples = [[*attention.values()], [*none.values()]]
    if study.is_within:  # differences, second minus first, of the two orders
        samples = [[sign * (attention[f"G{n}"] - none[f"G{n}"]) for n in range(first, 8, 2)]
                   for first, sign in ((0, -1), (1, 1))]  # fmt: skip
    assert difference["p"] == pytest.approx(stats.ttest_ind(*samples, equal_var=study.is_within).pvalue)
    assert "**The unit of analysis is the group**" in report_text(study, summary, {})
    assert study.is_within or "Groups: none 4, attention 4." in report_text(study, summary, {})


def test_only_the_named_outcomes_are_confirmatory_and_their_family_is_adjusted(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    rows = [(name, name, 1, int(rng.integers(6, 20)), int(rng.integers(1, 8))) for name in ("none", "attention") * 8]
    summary = summarise(study_with(tmp_path), rows_of(rows))
    confirmed = {one["measure"]: one["differences"][0] for one in summary["measures"] if one["confirmatory"]}
    assert set(confirmed) == {"actions", "trust"}
    smaller, larger = sorted(one["p"] for one in confirmed.values())
    assert sorted(one["p_holm"] for one in confirmed.values()) == [
        pytest.approx(min(1, 2 * smaller)), pytest.approx(max(larger, min(1, 2 * smaller))),
    ]  # fmt: skip
    others = [one for row in summary["measures"] if not row["confirmatory"] for one in row["differences"]]
    assert others
    assert all("p_holm" not in one for one in others)


def test_what_cannot_be_confirmatory_is_refused(tmp_path: Path) -> None:
    only = CONFIRMED.replace('name = "trust"', 'name = "trust"\nconditions = ["attention"]')
    for text, wrong, said in (
        (CONFIRMED, '["action"]', r"confirmatory\[1\]: 'action'; did you mean 'actions'"),
        (CONFIRMED, '["actions", "actions"]', r"confirmatory\[2\]: 'actions'; expected different names"),
        (CONFIRMED, '["remarks"]', r"confirmatory\[1\]: 'remarks'; expected one of completion, actions"),
        (only, '["actions", "trust"]', r"\[2\]: 'trust' is asked in condition attention only, so it"),
        (
            CONFIRMED,
            '["actions", "followed"]',
            r"\[2\]: 'followed' has values in condition attention only, so it cannot",
        ),
    ):
        with pytest.raises(InputFileError, match=said):
            study_with(tmp_path, text.replace('["actions", "trust"]', wrong))
    for name in {*OUTCOMES} - {"followed"}:
        assert study_with(tmp_path, CONFIRMED.replace('["actions", "trust"]', f'["{name}"]')).confirmatory == (name,)
    # The family has the comparisons that are possible, here two of `actions` and one of `trust`.
    third = '\n[[conditions]]\nname = "third"\npolicy = "reactive"\n'
    study = study_with(tmp_path, only.replace('["attention"]', '["none", "attention"]') + third)
    assert (study.comparisons, study.compared_in("trust")) == (3, ("attention",))


def test_no_interval_leaves_the_range_of_what_is_measured(tmp_path: Path) -> None:
    rows = [("attention", "attention", 1, value, trust) for value, trust in ((40, 7), (2, 7), (None, 4))]
    rows += [("none", "none", 1, value, 1) for value in (9, None)]
    tables = rows_of(rows)
    for task in tables.tasks:
        task |= {"suggestions": 3, "followed": 3 if task["actions"] == 40 else 1}
    measured = {one["measure"]: one for one in summarise(study_with(tmp_path), tables)["measures"]}
    cells = {(name, cell["condition"]): cell for name, one in measured.items() for cell in one["cells"]}
    peer = stats.binomtest(2, 3).proportion_ci(method="wilson")
    share = cells["completion", "attention"]
    assert (share["low"], share["high"]) == pytest.approx((100 * peer.low, 100 * peer.high))
    assert cells["actions", "attention"]["low"] == 0  # Student's is below 0
    assert (cells["followed", "attention"]["low"], cells["followed", "attention"]["high"]) == (0, 100)
    assert cells["trust", "attention"]["high"] == 7
    assert (cells["trust", "none"]["mean"], cells["trust", "none"]["low"]) == (1, None)  # equal values
    for one in measured.values():
        least, most = (math.inf if end is None else end for end in one["ends"])
        for cell in one["cells"]:
            assert cell["low"] is None or least <= cell["low"] <= cell["mean"] <= cell["high"] <= most
        for found in one["differences"]:
            assert found["low"] is None or least - most <= found["low"] <= found["high"] <= most - least


def test_differences_have_their_statistic_and_the_interval_of_the_effect(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    rows = [(name, name, 1, int(rng.integers(6, 20)), 4) for name in ("none", "attention") * 7]
    summary = summarise(study_with(tmp_path), rows_of(rows))
    (found,) = summary["measures"][0]["differences"]
    a, b = ([row[3] for row in rows if row[0] == name] for name in ("attention", "none"))
    peer = stats.ttest_ind(a, b, equal_var=False)
    assert (found["t"], found["df"]) == pytest.approx((peer.statistic, peer.df))
    power = 1 - stats.nct.cdf(stats.t.ppf(0.975, peer.df), peer.df, found["detectable"] * found["t"] / found["mean"])
    assert power == pytest.approx(0.8)  # of a t-test, if the true difference is the detectable one
    pooled = stats.ttest_ind(a, b).statistic
    for end, p in (("hedges_g_low", 0.975), ("hedges_g_high", 0.025)):
        size = found[end] / (1 - 3 / 47) * math.sqrt(7 / 2)
        assert stats.nct.cdf(pooled, 12, size) == pytest.approx(p, abs=1e-4)
    (completed,) = next(one for one in summary["measures"] if one["measure"] == "completion")["differences"]
    assert [completed[name] for name in ("t", "df", "hedges_g_low", "detectable")] == [None] * 4


def report_of(folder: Path, tables: Tables, text: str = CONFIRMED) -> str:
    write_report(exported(folder / "data", text, vars(tables)), folder / "report")
    return (folder / "report" / "report.md").read_text()


@pytest.mark.usefixtures("no_figures")
def test_the_report_says_at_its_top_that_a_policy_suggested_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    tables = rows_of([(name, name, 1, 8, 5) for name in ("none", "attention") * 5])
    said = "**attention made suggestions in 0 % of the tasks**: hardly any was worth its cost (c_suggest 0.02, "
    assert said in report_of(tmp_path, tables).partition("## Participants")[0]
    assert said.replace("**", "") in invoke("study-report", tmp_path / "data").stdout
    monkeypatch.setattr("assist.studies.userstudy.export.archive", lambda _: b"")
    _report(tmp_path / "data")  # as a rehearsal does at its end
    assert said.replace("**", "") in capsys.readouterr().err
    tables.tasks[1]["suggestions"] = 1
    assert "**attention made suggestions in 20 % of the tasks**" in report_of(tmp_path, tables)
    tables.tasks[3]["suggestions"] = 1
    assert "made suggestions" not in report_of(tmp_path, tables)
    reactive = CONFIRMED.replace('policy = "attention"', 'policy = "reactive"')  # which weighs no costs
    assert "made suggestions" not in report_of(tmp_path, rows_of([("attention", "attention", 1, 8, 5)]), reactive)


@pytest.mark.usefixtures("no_figures")
def test_the_report_has_what_a_methods_section_needs(tmp_path: Path) -> None:
    report = report_of(tmp_path, rows_of([(name, name, 1, 8, 5) for name in ("none", "attention") * 2]))
    assert "Each participant shared the robot with 2 simulated people, who acted once after each action" in report
    one = report_of(tmp_path, rows_of([("none", "none", 1, 8, 5)]), CONFIRMED.replace("simulated = 2", "simulated = 1"))
    assert "Each participant shared the robot with 1 simulated person, who acted" in one
    plan = report.partition("## Plan")[2]
    for said in (
        "Participants arrived from 2026-11-27 12:00; ", f"with kitassist {version('kitassist')}.",
        "| tasks | tiny (cost of an optimal plan: 6) |", '| setting | {"c_suggest": 0.02, "c_move": 0.01, ',
        '| conditions: attention | {"policy": "attention", "reasons": false} |', "| simulated | 2 |",
        '| population | {"beta": [0.1, 3.0], "theta": "as varied as in real people, from 0 to 1", ',
        '| questionnaires: trust | {"form": "likert", "when": "after", "items": "rely, wary"} |',
    ):  # fmt: skip
        assert said in plan, said


@pytest.mark.usefixtures("no_figures")
def test_the_sample_is_described_as_a_whole_and_in_each_condition(tmp_path: Path) -> None:
    asked = """
[[questionnaires]]
form = "number"
name = "background"
when = "before"
items = [{ name = "age", text = "How old are you?", min = 18, max = 99 }]
"""
    tables = rows_of([(name, name, 1, 8, 5) for name in ("none", "attention") * 2])
    for who, age in zip(tables.participants, (20, 30, 40, 31), strict=True):
        tables.answers.append(dict.fromkeys(COLUMNS["answers"]) | {
            "participant": who["participant"], "questionnaire": "background", "item": "age", "answer": age,
            "score": float(age),
        })  # fmt: skip
    report = report_of(tmp_path, tables, CONFIRMED + asked)
    for row in ("all participants | 4 | M = 30.25, SD = 8.18, 20 to 40", "none | 2 | M = 30.00, SD = 14.14, 20 to 40",
                "attention | 2 | M = 30.50, SD = 0.71, 30 to 31"):  # fmt: skip
        assert f"| How old are you? | {row} |" in report


@pytest.mark.usefixtures("no_figures")
def test_conditions_are_compared_with_another_one_than_the_reference(tmp_path: Path) -> None:
    tables = rows_of([(name, name, 1, 8 + number, 5) for number in range(4) for name in ("none", "attention")])
    folder = exported(tmp_path / "data", CONFIRMED, vars(tables))
    usual, other = (
        json.loads(invoke("study-report", folder, *more, "--json").stdout) for more in ((), ("--baseline", "attention"))
    )
    assert (usual["reference"], other["reference"]) == ("none", "attention")
    (before,), (after,) = (one["measures"][0]["differences"] for one in (usual, other))
    assert (after["condition"], after["against"], after["mean"]) == ("none", "attention", -before["mean"])
    assert any(one["confirmatory"] for one in usual["measures"])
    assert not any(one["confirmatory"] for one in other["measures"])  # the plan names no such comparison
    refused = invoke("study-report", folder, "--baseline", "atention")
    assert (refused.exit_code, "baseline: 'atention'; did you mean 'attention'?" in refused.stderr) == (1, True)


@pytest.mark.usefixtures("no_figures")
def test_what_is_shown_is_said_in_the_same_words_by_all_tests(tmp_path: Path) -> None:
    rows = [(name, name, 1, (9 if name == "none" else 20) + number % 3, 3 + number % 2)
            for number in range(12) for name in ("none", "attention")]  # fmt: skip
    confirmatory, _, exploratory = report_of(tmp_path, rows_of(rows)).partition("### Exploratory")
    (actions,) = [
        line for line in confirmatory.splitlines() if line.startswith("| actions per task | attention | 11.0 (")
    ]
    assert actions.endswith("| < .001 | more | 1.02 |")
    (trust,) = [
        line for line in confirmatory.splitlines() if line.startswith("| trust: mean, 1 to 7 | attention | 0.0 (")
    ]
    assert "| 1.000 | not shown |" in trust
    assert "| 1.000 | not shown |" in exploratory


@pytest.mark.usefixtures("no_figures")
def test_an_interim_report_and_a_scale_of_one_item_say_what_they_are(tmp_path: Path) -> None:
    rows = rows_of([(name, name, 1, 8, 5) for name in ("none", "attention")])
    more = CONFIRMED.replace("seed = 3", "seed = 3\nparticipants = 12")
    more += '[[questionnaires]]\nform = "likert"\nname = "hard"\nitems = [{ name = "h", text = "It was hard." }]\n'
    report = report_of(tmp_path, rows, more)
    assert "**In progress**: 2 of 12 planned participants have completed the study." in report
    assert "It has one item, for which there is no Cronbach's alpha." in report
    assert "In progress" not in report_of(tmp_path, rows, more.replace("participants = 12", "participants = 2"))


@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize("text", [CONFIRMED, WITHIN], ids=["between", "within"])
def test_the_report_separates_confirmatory_from_exploratory(tmp_path: Path, text: str) -> None:
    rng = np.random.default_rng(2)

    def value(number: int, *_: object) -> tuple[int | None, int]:
        return None if number == 3 else int(rng.integers(6, 12)), 5

    once = [(name, name, 1, *value(number)) for number in range(12) for name in ("none", "attention")]
    folder = exported(tmp_path / "data", text, vars(crossed(12, value) if text == WITHIN else rows_of(once)))
    summary = write_report(folder, tmp_path / "report")
    report = (tmp_path / "report" / "report.md").read_text()
    page = (tmp_path / "report" / "report.html").read_text()
    assert page.count("<table>") == report.count("\n| --- |") > 5
    assert "<title>A small study</title>" in page
    confirmatory, _, exploratory = report.partition("### Exploratory")
    assert "| actions per task | attention |" in confirmatory.partition("### Confirmatory")[2]
    assert "p (Holm)" in confirmatory
    assert "p (Holm)" not in exploratory
    assert "| all tasks finished, % | attention |" in exploratory
    assert "### Sensitivity: the unfinished as the worst" in exploratory
    assert "| trust: rely | attention | 12 |" in exploratory
    assert ("### Sensitivity: a mixed model" in report) == (text == WITHIN)
    assert "The study was not preregistered." in report
    assert json.loads((tmp_path / "report" / "summary.json").read_text()) == summary


@pytest.mark.usefixtures("no_figures")
def test_a_registration_comes_first_and_the_report_says_what_has_changed_since(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, data = written(tmp_path / "study.toml", CONFIRMED), tmp_path / "data"
    there = list[bool]()

    def rounds(study: UserStudy, _: object, **__: object) -> Iterator[Forecast]:  # true ones take seconds
        there.append((data / REGISTERED).exists())
        time.sleep(0.05)
        yield Forecast(study, {}, {})

    monkeypatch.setattr(Forecast, "rounds", rounds)
    with monkeypatch.context() as patched:
        patched.setattr("planner.system.progress.BETWEEN_LINES", 0.01)
        said = invoke("study-prepare", file, "--data", data)
    assert there == [True]  # a study that begins meanwhile finds it
    assert "simulating participants, 0 s" in said.stderr
    assert json.loads(said.stdout) | {"text": CONFIRMED} == json.loads((data / REGISTERED).read_text())
    assert f"serve --study {file} --data {data}` begins the study" in said.stderr
    again = invoke("study-prepare", file, "--data", data)
    assert (again.exit_code, again.stderr.count("\n")) == (2, 1)
    assert f"already registered at {json.loads(said.stdout)['registered']}; to register another plan" in again.stderr
    rows = rows_of([(name, name, 1, 7, 5) for name in ("none", "attention") * 3])
    for row in rows.participants:
        row["arrived"] = "2999-01-01T00:00:00+00:00"
    exported(data, CONFIRMED, vars(rows))

    def first_lines() -> str:
        write_report(data, tmp_path / "report")
        return (tmp_path / "report" / "report.md").read_text().split("\n\n")[1]

    assert first_lines().endswith("the study's file and the analysis have not changed.")
    assert changed(read(file), data) is None
    written(data / "study.toml", CONFIRMED.replace("actions", "seconds"))
    (line,) = [number for number, one in enumerate(CONFIRMED.splitlines(), start=1) if one.startswith("confirmatory")]
    assert (
        "but** the study's file has changed (line {}: `{}` became `{}`)".format(
            line, *(f'confirmatory = ["{name}", "trust"]' for name in ("actions", "seconds"))
        )
        in first_lines()
    )
    other = written(tmp_path / "other.toml", CONFIRMED.replace("actions", "seconds"))
    monkeypatch.setattr("assist.cli.user_study._tasks", lambda _: sys.exit(3))  # the notes precede it
    served = invoke("serve", "--study", other, "--data", data)
    assert "since the registration, the study's file has changed (line" in served.stderr
    assert served.exit_code == 3
    record = json.loads((data / REGISTERED).read_text())
    # Who withdrew, the orders and the words "more" and "less" are parts of the results, too.
    for name in ("userstudy/roll.py", "userstudy/record.py", "userstudy/assignment.py", "reports/wording.py"):
        assert f"studies/{name}" in record["analysis"]
    record["analysis"]["studies/statistics.py"] = "0"
    (data / REGISTERED).write_text(json.dumps(record | {"registered": "3000-01-01T00:00:00+00:00"}))
    for part in ("registered after the first participant had arrived", "has changed (studies/statistics.py)"):
        assert part in first_lines()
    (data / REGISTERED).write_text("{}")
    refused = invoke("study-report", data)
    assert (refused.exit_code, refused.stderr.count("\n")) == (1, 1)
    assert "not a preregistration" in refused.stderr
    (data / REGISTERED).unlink()
    (data / "journal.sqlite").touch()
    assert "the study has begun" in invoke("study-prepare", file, "--data", data).stderr


@pytest.mark.usefixtures("few_people")
def test_a_plan_is_checked_without_registering_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, foreseen: Forecast
) -> None:
    text = CONFIRMED.replace("seed = 3", "seed = 3\nparticipants = 13")
    file = written(tmp_path / "study.toml", text)
    with monkeypatch.context() as patched:
        patched.setattr(Forecast, "rounds", lambda study, *_, **__: iter([replace(foreseen, study=study)]))
        said = invoke("study-prepare", file, "--check")
    printed = json.loads(said.stdout)
    (shown,) = printed.pop("sensitivity")
    assert printed == {"study": str(file), "places": 13, "comparisons": 2}
    assert (shown["condition"], shown["units"]) == ("attention", 6)
    first, second, last = said.stderr.splitlines()
    assert first == "participants 13: 2 conditions get unequal numbers; expected a multiple of 2 for equal ones"
    assert second.startswith("attention minus none: with 6 in each, four of five studies show ")
    assert last == f"{file} can be carried out; nothing is registered yet"
    assert [one.name for one in tmp_path.iterdir()] == ["study.toml"]
    dear = written(file, text.replace("c_suggest = 0.02", "c_suggest = 50.0"))
    said = invoke("study-prepare", dear, "--data", tmp_path / "data")
    assert "attention suggests something to 0 % of simulated people: hardly any suggestion is worth" in said.stderr
    assert (tmp_path / "data" / REGISTERED).exists()
    monkeypatch.setattr("assist.web.user_study.server.serve", lambda *_, **__: None)
    begins = ("serve", "--study", dear, "--data", tmp_path / "data", "--port", 0)
    assert "attention suggests something to 0 % of simulated people" in invoke(*begins).stderr
    (tmp_path / "data" / JOURNAL).touch()
    assert "suggests" not in invoke(*begins).stderr  # when it goes on
    for options, wrong in (((), "expected --data DIR"), (("--check", "--links", file), "cannot be combined")):
        refused = invoke("study-prepare", file, *options)
        assert (refused.exit_code, wrong in refused.stderr) == (2, True)


OWN_CODE = """
import numpy as np


def fails(team):
    return team.act(team.foo, 1)


class Last:
    def __init__(self):
        self.odd = False

    def __call__(self, team):
        self.odd = not self.odd
        to = team.active.argmax(axis=1) if self.odd else np.full(len(team.active), -1)
        return team.act(to[:, None], team.first_optimal())


remembers = Last()


def first(team):
    return team.act(team.active.argmax(axis=1), team.first_optimal())


class fickle:
    feedback, uses_answer = "actions", False

    def update(self, theta, event):
        return theta.foo
"""


@pytest.mark.cases
@pytest.mark.parametrize(
    ("policy", "said"),
    [("none", "own.py: has no function 'none'"), ("fails", "own.py:6: AttributeError"), ("remembers", "choose")],
)
@pytest.mark.usefixtures("few_people")
def test_a_fault_of_an_own_policy_is_said_in_one_line_before_anything_is_registered(
    tmp_path: Path, policy: str, said: str
) -> None:
    (tmp_path / "own.py").write_text(OWN_CODE)
    text = CONFIRMED.replace('policy = "attention"', f'policy = "own.py:{policy}"')
    file = written(tmp_path / "study.toml", text)
    (line,) = [number for number, one in enumerate(text.splitlines(), start=1) if "own.py" in one]
    refused = invoke("study-prepare", file, "--data", tmp_path / "data")
    assert (refused.exit_code, refused.stderr.count("own.py")) == (2, 1), refused.output
    assert f"{file}:{line}: conditions[2].policy: {tmp_path / 'own.py'}" in refused.stderr
    assert f"no longer registered in {tmp_path / 'data'}" in refused.stderr
    assert said in refused.stderr
    assert not (tmp_path / "data").exists()


@pytest.mark.parametrize("after", [0, 1])
def test_an_interrupt_ends_the_simulation_and_keeps_the_registration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, foreseen: Forecast, after: int
) -> None:
    """What is known by then is said: nothing before the first round has ended."""
    file, data = written(tmp_path / "study.toml", CONFIRMED), tmp_path / "data"

    def interrupted(study: UserStudy, *_: object, **__: object) -> Iterator[Forecast]:
        yield from [replace(foreseen, study=study)] * after
        raise KeyboardInterrupt

    monkeypatch.setattr(Forecast, "rounds", interrupted)
    said = invoke("study-prepare", file, "--data", data)
    assert said.exit_code == 130, said.output
    assert json.loads(said.stdout)["registered"] == json.loads((data / REGISTERED).read_text())["registered"]
    assert said.stderr.count("attention minus none") == after
    assert "interrupted; what was finished by then is shown" in said.stderr
    checked = invoke("study-prepare", file, "--check")
    assert (checked.exit_code, checked.stdout.count("sensitivity")) == (130, after), checked.output


@pytest.mark.cases
@pytest.mark.usefixtures("few_people")
def test_a_fault_of_an_own_trust_rule_is_not_said_of_a_policy_in_its_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own.py").write_text(OWN_CODE)
    monkeypatch.chdir(tmp_path)
    text = CONFIRMED.replace("[setting]", '[setting]\ntrust = "own.py:fickle"')
    file = written(tmp_path / "study.toml", text.replace('policy = "attention"', 'policy = "own.py:first"'))
    refused = invoke("study-prepare", file, "--check")
    assert (refused.exit_code, refused.stderr.count("\n")) == (2, 1), refused.output
    assert "policy" not in refused.stderr
    assert "own.py:" in refused.stderr


@pytest.mark.cases
@pytest.mark.usefixtures("one_round")
def test_participants_who_show_a_difference_are_counted(tmp_path: Path) -> None:
    for text in (CONFIRMED, WITHIN):
        file = written(tmp_path / "study.toml", text.replace("seed = 3", "seed = 3\nparticipants = 24"))
        (shown,) = json.loads(invoke("study-prepare", file, "--check").stdout)["sensitivity"]

        def counted(difference: float, file: Path = file) -> int:
            said = invoke("study-prepare", file, "--check", "--difference", difference).stderr
            (found,) = re.findall(r"attention minus none: \S+ actions per task take ([\d,]+) \(.*\) participants", said)
            return int(found.replace(",", ""))

        assert counted(1.001 * shown["actions"]) == 24
        assert counted(abs(shown["expected"])) == shown["needed"]
        assert 3 * 24 < counted(shown["actions"] / 2) < 5 * 24
    refused = invoke("study-prepare", file, "--data", tmp_path, "--links", file, "--difference", 2)
    assert "--difference has no effect with --links" in refused.stderr


def test_links_of_participants_are_signed_by_a_command(tmp_path: Path) -> None:
    file, ids = written(tmp_path / "study.toml"), tmp_path / "ids.txt"
    ids.write_text("7\n\na&b\n=1\n")
    options = ("study-prepare", file, "--data", tmp_path / "data", "--links", ids)
    assert "expected --public-url URL as well" in invoke(*options).stderr
    signed = invoke(*options, "--public-url", "https://host.example/kits/")
    said = signed.stdout
    assert "from now on nobody joins without such a link" in signed.stderr
    links = {row["participant"]: row["link"] for row in csv.DictReader(io.StringIO(said))}
    signature = links["a&b"].partition("signature=")[2].partition("#")[0]
    assert Client(links["a&b"]).visit == {"id": "participant a&b", "signature": signature}
    assert list(links) == ["7", "a&b", "=1"]
    assert links["a&b"].startswith("https://host.example/kits/study?participant=a%26b&signature=")
    assert invoke(*options, "--public-url", "https://host.example/kits/").stdout == said
    for content, wrong in (("7\n8\n7\n", "ids.txt:3: the ID of line 1"), ("\n", "expected an ID on each line"),
                           ("x" * 101, "ids.txt:1: expected an ID of at most 100 characters")):  # fmt: skip
        ids.write_text(content)
        refused = invoke(*options, "--public-url", "https://host.example")
        assert (refused.exit_code, wrong in refused.stderr) == (2, True)


def test_an_export_of_an_earlier_version_is_read(tmp_path: Path) -> None:
    rows = rows_of([("none", "none", 1, 7, 5)])
    folder = exported(tmp_path / "data", CONFIRMED, vars(rows))
    (folder / "answers.csv").write_text(
        "participant,condition,period,questionnaire,item,answer,score\nP0,none,1,trust,rely,5,5\n"
    )
    _, found = of_folder(folder)
    assert found.answers[0] == dict.fromkeys(COLUMNS["answers"]) | {
        "participant": "P0", "condition": "none", "period": 1, "questionnaire": "trust", "item": "rely",
        "answer": "5", "score": 5,
    }  # fmt: skip


MORE = "".join(f'[[conditions]]\nname = "{name}"\npolicy = "none"\n' for name in ("c", "d"))


@pytest.mark.slow
@pytest.mark.parametrize("design", ["between", "within"])
def test_intervals_cover_the_truth_and_the_family_errs_rarely(
    tmp_path: Path, design: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A thousand studies in which no condition has an effect, though people, periods and variances differ."""
    monkeypatch.setattr(userstudy_comparisons, "mixed_model", lambda *_: {})  # which is beside the family
    text = (WITHIN if design == "within" else CONFIRMED) + MORE
    rng, study = np.random.default_rng(11), study_with(tmp_path, text)
    data = StudyData(study, Tables())
    names, covered, compared, erring, studies = data.names, 0, 0, 0, 1000
    orders = list(study.orders) * (24 // len(study.orders)) if study.is_within else names * 12
    data.orders = {f"P{n}": order for n, order in enumerate(orders)}
    for _ in range(studies):
        values: dict[str, Any] = {name: {one: {} for one in names} for name in study.confirmatory}
        for who, order in data.orders.items():
            own = rng.normal(0, 3)
            for period, name in enumerate(study.orders[order], start=1):
                answer = float(np.clip(rng.normal(4 + own / 4, 1.5), 1, 7))
                values["actions"][name][who] = float(rng.normal(20 + own - 2 * period, 2 + names.index(name)))
                values["trust"][name][who] = answer
        measured = [Measure(name, name, found, (-math.inf, math.inf)) for name, found in values.items()]
        family = [one for measure in userstudy_comparisons.compared(data, measured) for one in measure["differences"]]
        assert len(family) == 6
        covered += sum(one["low"] <= 0 <= one["high"] for one in family)
        compared += len(family)
        erring += any(one["p_holm"] < 0.05 for one in family)
    assert 0.93 <= covered / compared <= 0.97
    assert erring / studies <= 0.055
