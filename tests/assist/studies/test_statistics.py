"""Statistics over pools: intervals compared with scipy's, and their coverage."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from assist.studies import statistics
from assist.studies.reports.wording import beside, sign


def test_a_mean_has_students_interval() -> None:
    x = np.array([1.0, 2.0, 4.0, 9.0])
    estimate = statistics.mean(x)
    assert (estimate.low, estimate.high) == pytest.approx(stats.t.interval(0.95, 3, x.mean(), stats.sem(x)))
    assert statistics.mean([5.0]).record() == {"mean": 5.0, "low": None, "high": None}


def test_the_bootstrap_of_a_saving_is_scipys_and_is_paired() -> None:
    rng = np.random.default_rng(0)
    without = rng.gamma(2.0, 5.0, 30)
    with_it = without * 0.7 + rng.normal(0, 0.2, 30)
    estimate = statistics.saving(with_it, without, np.random.default_rng(1))
    assert estimate.value == pytest.approx(100 * (1 - with_it.mean() / without.mean()))
    theirs = stats.bootstrap(
        (with_it, without), lambda a, b, axis=-1: 100 * (1 - a.mean(axis) / b.mean(axis)), paired=True,
        vectorized=True, method="BCa", n_resamples=20_000, rng=np.random.default_rng(2),
    ).confidence_interval  # fmt: skip
    alike = statistics.saving(np.full(30, 3.0), np.full(30, 4.0), np.random.default_rng(1))
    assert (alike.low, alike.value, alike.high) == (25.0, 25.0, 25.0)
    width = theirs.high - theirs.low
    assert estimate.low == pytest.approx(theirs.low, abs=0.08 * width)
    assert estimate.high == pytest.approx(theirs.high, abs=0.08 * width)
    shuffled = statistics.saving(rng.permutation(with_it), without, np.random.default_rng(1))
    assert shuffled.high - shuffled.low > 5 * width


def test_intervals_of_savings_cover_as_often_as_they_say(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(statistics, "RESAMPLES", 1500)
    rng = np.random.default_rng(5)
    covered = 0
    for _ in range(150):
        without = rng.gamma(1.5, 4.0, 40)
        with_it = 0.6 * without + rng.gamma(1.0, 1.0, 40)
        estimate = statistics.saving(with_it, without, rng)
        covered += estimate.low <= 100 * (1 - (0.6 * 6 + 1) / 6) <= estimate.high
    assert 0.88 <= covered / 150 <= 0.99


@pytest.mark.parametrize("pools", [2, 3, 5, 9])
def test_intervals_of_few_pools_are_as_wide_as_so_little_deserves(pools: int) -> None:
    rng = np.random.default_rng(pools)
    covered = 0
    for _ in range(400):
        without = rng.gamma(1.5, 4.0, pools)
        estimate = statistics.saving(0.6 * without + rng.gamma(1.0, 1.0, pools), without, rng)
        covered += estimate.low <= 100 * (1 - (0.6 * 6 + 1) / 6) <= estimate.high
    assert 0.84 <= covered / 400 <= 0.99  # resampling gives 0.52, 0.71, 0.82 and 0.89


def test_changes_ratios_and_effects() -> None:
    rng = np.random.default_rng(0)
    a, b, c, d = rng.uniform(1, 2, (4, 20))
    change = statistics.change((a, b), (c, d), np.random.default_rng(0))
    assert change.value == pytest.approx(100 * (c.mean() / d.mean() - a.mean() / b.mean()))
    assert statistics.quotient(a, b, rng).value == pytest.approx(a.mean() / b.mean())
    assert statistics.effect(a - b) == pytest.approx((a - b).mean() / (a - b).std(ddof=1))
    alike = statistics.saving(np.full(5, 3.0), np.full(5, 4.0), rng)
    assert (alike.low, alike.value, alike.high) == (25, 25, 25)
    assert statistics.saving([0.0, 0.0], [0.0, 0.0], rng).record() == {"mean": None, "low": None, "high": None}


def test_an_interval_is_put_into_words() -> None:
    """A conclusion needs the whole interval on one side; without an interval there is none."""

    def between(low: float | None, high: float | None) -> dict[str, float | None]:
        return {"mean": 5.0, "low": low, "high": high}

    assert [sign(between(*ends)) for ends in ((1, 9), (-1, 9), (None, None))] == ["yes", "not shown", "not shown"]
    assert [sign(between(1, 9), at) for at in (0.5, 5.0, 10.0)] == ["yes", "not shown", "no, the opposite"]
    assert sign({"mean": None}) == "yes"  # of nothing there is no smallest number
    assert [beside(between(1, 9), other) for other in (0.5, 4.0, 6.0, 10.0)] == [
        "better, the whole interval", "better, not the whole interval", "worse, not the whole interval",
        "worse, the whole interval",
    ]  # fmt: skip
    assert [beside(between(None, None), other) for other in (4.0, 6.0)] == [
        "better, in a single pool", "worse, in a single pool",
    ]  # fmt: skip
