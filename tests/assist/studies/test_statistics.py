"""Statistics over pools: intervals compared with scipy's, and their coverage."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from assist.studies import statistics
from assist.studies.reports.wording import beside, interval, sign


def test_a_mean_has_students_interval() -> None:
    x = np.array([1.0, 2.0, 4.0, 9.0])
    estimate = statistics.mean(x)
    assert (estimate.low, estimate.high) == pytest.approx(stats.t.interval(0.95, 3, x.mean(), stats.sem(x)))
    assert statistics.mean([5.0]).record() == {"mean": 5.0, "low": None, "high": None}


def test_the_standard_error_of_a_saving_is_the_bootstraps_and_is_paired() -> None:
    rng = np.random.default_rng(0)
    without = rng.gamma(2.0, 5.0, 30)
    with_it = without * 0.7 + rng.normal(0, 0.2, 30)
    estimate = statistics.saving(with_it, without)
    assert estimate.value == pytest.approx(100 * (1 - with_it.mean() / without.mean()))
    resampled = stats.bootstrap(
        (with_it, without), lambda a, b, axis=-1: 100 * (1 - a.mean(axis) / b.mean(axis)), paired=True,
        vectorized=True, n_resamples=20_000, rng=np.random.default_rng(2),
    )  # fmt: skip
    width = estimate.high - estimate.low
    assert width / 2 / stats.t.ppf(0.975, 29) == pytest.approx(resampled.standard_error, rel=0.1)
    assert estimate.high - estimate.value == pytest.approx(width / 2)
    shuffled = statistics.saving(rng.permutation(with_it), without)
    assert shuffled.high - shuffled.low > 5 * width


@pytest.mark.parametrize(
    ("pools", "spread", "least"),
    [*((n, 0.5, 0.84) for n in (2, 3, 5, 9)), (10, 0.5, 0.91), (20, 0.5, 0.92), (50, 1, 0.92)],
)
def test_intervals_of_savings_cover_as_often_as_they_say(pools: int, spread: float, least: float) -> None:
    """Also for skewed pools, with a lognormal distribution; those of few pools as often as so little deserves."""
    rng, covered = np.random.default_rng(pools), 0
    true = 100 * (1 - 0.6 - 1 / np.exp(spread**2 / 2))
    for _ in range(1000):
        without = np.exp(rng.normal(0, spread, pools))
        estimate = statistics.saving(0.6 * without + rng.gamma(1.0, 1.0, pools), without)
        covered += estimate.low <= true <= estimate.high
    assert least <= covered / 1000 <= 0.99


def test_changes_ratios_and_effects() -> None:
    rng = np.random.default_rng(0)
    a, b, c, d = rng.uniform(1, 2, (4, 20))
    change = statistics.change((a, b), (c, d))
    assert change.value == pytest.approx(100 * (c.mean() / d.mean() - a.mean() / b.mean()))
    assert statistics.quotient(a, b).value == pytest.approx(a.mean() / b.mean())
    assert statistics.effect(a - b) == pytest.approx((a - b).mean() / (a - b).std(ddof=1))
    assert statistics.saving([0.0, 0.0], [0.0, 0.0]).record() == {"mean": None, "low": None, "high": None}


def test_equal_pools_have_no_interval_as_participants_have_none() -> None:
    """That all values seen are equal does not show that the next one is."""
    none = {"low": None, "high": None}
    tenths = np.full(30, 0.1)  # whose standard deviation is not 0, but a rounding error
    assert statistics.mean(tenths).record() == {"mean": pytest.approx(0.1), **none}
    assert statistics.saving(np.full(5, 3.0), np.full(5, 4.0)).record() == {"mean": 25.0, **none}
    assert statistics.saving([0.1, 0.3, 0.7], [0.2, 0.6, 1.4]).record() == {"mean": pytest.approx(50), **none}
    assert statistics.saving([3.0, 1.0, 2.0], [3.0, 1.0, 2.0]).record() == {"mean": 0.0, **none}  # nothing happened
    assert statistics.quotient([2.0, 2.0], [1.0, 1.0]).record() == {"mean": 2.0, **none}
    assert sign({"mean": 25.0, **none}) == "not shown"
    assert interval({"mean": 100.0, **none}) == "100.0"


def test_few_large_pools_weigh_as_few() -> None:
    assert statistics.alike([2.0] * 7) == pytest.approx(7) == statistics.alike([0.0] * 7)
    assert statistics.alike([1.0] * 9 + [91.0]) == pytest.approx(100**2 / (9 + 91**2))


def test_ranks_of_unknown_values_are_refused() -> None:
    for ranked in (lambda x: statistics.signed_rank(x), lambda x: statistics.mann_whitney(x, [1.0, 2.0])):
        with pytest.raises(ValueError, match="NaN among values to be ranked: expected a number for each participant"):
            ranked([1.0, np.nan, 2.0])


def test_an_interval_has_no_values_that_are_impossible() -> None:
    """It is as wide as Student's t says, but nobody does less than nothing."""
    few, much = [0.0, 0.2, 3.0], [2.0, 9.0, 4.0]
    saving, opposite = statistics.saving(few, much), statistics.saving(much, few)
    assert (saving.value, saving.high) == (pytest.approx(100 * (1 - 3.2 / 15)), 100)
    assert saving.low < 0
    assert opposite.low < opposite.value < -100  # more than twice as much
    assert (opposite.high, statistics.quotient(few, much).low) == (100, 0)


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
        "better, without an interval", "worse, without an interval",
    ]  # fmt: skip
