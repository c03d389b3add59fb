"""Conditions that the same participants have had one after the other: intervals, comparisons, and a mixed model."""

from __future__ import annotations

import math
from collections.abc import Mapping
from statistics import fmean
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize

from ..learning.intervals import IntervalEstimate
from .statistics import LEVEL, Comparison, detectable, standardised

Floats = NDArray[np.floating[Any]]
Values = Mapping[str, Mapping[str, float]]
"""Values by condition and participant."""
Periods = Mapping[tuple[str, str], int]
"""The period in which a participant had a condition, by participant and condition."""


def within_participants(differences: ArrayLike, periods: ArrayLike) -> Comparison:
    """Compare two conditions of the same participants, adjusted for the periods in which they had them.

    Least squares explain each participant's difference by the conditions and the periods. So learning from one period
    to the next is no part of the difference, also if orders are not balanced, and does not widen its interval. Other
    conditions do not matter, so that variances of conditions may differ.

    Parameters
    ----------
    differences : float array, shape (n,)
        For each participant, the value in the condition minus that in the other one.
    periods : int array, shape (n, 2)
        The period of the condition and of the other one. If all participants had the same order, the effects of
        condition and period are the same, and there is no interval.
    """
    y = np.asarray(differences, dtype=float)
    design, inverse, determined = _of_periods(periods)
    found = inverse @ design.T @ y
    freedom, left = len(y) - int(np.linalg.matrix_rank(design)), float(((y - design @ found) ** 2).sum())
    if not determined or freedom < 1 or left <= 1e-20 * float((y**2).sum()):
        return Comparison(IntervalEstimate(float(found[0] if determined else y.mean())))
    deviation = math.sqrt(left / freedom)
    error = math.sqrt(inverse[0, 0])
    effect = standardised(float(found[0]) / deviation, freedom, 1 / error)
    return Comparison.of(float(found[0]), deviation * error, freedom, effect)


def _of_periods(periods: ArrayLike) -> tuple[Floats, Floats, bool]:
    """Return the design matrix of a comparison, its inverse information, and whether the difference is determined."""
    when = np.asarray(periods, dtype=np.int64).reshape(-1, 2)
    later = np.unique(when)[1:]
    design = np.column_stack([np.ones(len(when)), *[(when == period) @ [1.0, -1.0] for period in later]])
    inverse = np.linalg.pinv(design.T @ design)
    return design, inverse, math.isclose(float(inverse[0] @ (design.T @ design)[:, 0]), 1.0, abs_tol=1e-9)


def detectable_within(periods: ArrayLike) -> float:
    """Return the smallest standardised difference that `within_participants` detects, as `detectable` does.

    Parameters
    ----------
    periods : int array, shape (n, 2)
        As in `within_participants`. The effects of periods take degrees of freedom from the test. The result is NaN
        where there is no test.
    """
    design, inverse, determined = _of_periods(periods)
    freedom = len(design) - int(np.linalg.matrix_rank(design))
    return detectable(freedom, 1 / math.sqrt(inverse[0, 0])) if determined else math.nan


def means_within(values: Values) -> dict[str, IntervalEstimate]:
    """Return each condition's mean with an interval without the differences between participants.

    The intervals show how well means can be compared with each other (D. Cousineau, "Confidence intervals in
    within-subject designs", 2005; R. D. Morey, "Confidence intervals from normalized data", 2008). They are those of
    participants with a value in every condition. A condition with equal values has none, and one without values is left
    out.

    Parameters
    ----------
    values : mapping of mapping of float
        Values by condition and participant.
    """
    shown = {name: own for name, own in values.items() if own}
    everywhere = [who for who in next(iter(shown.values()), {}) if all(who in own for own in shown.values())]
    n, conditions = len(everywhere), len(shown)
    errors = np.full(conditions, np.nan)
    if n > 1 and conditions > 1:
        x = np.array([[own[who] for who in everywhere] for own in shown.values()])
        deviation = (x - x.mean(axis=0)).std(axis=1, ddof=1) * np.sqrt(conditions / (conditions - 1))
        errors = np.where(np.ptp(x, axis=1) > 0, deviation / np.sqrt(n), np.nan)
    return {
        name: IntervalEstimate.of(fmean(own.values()), error, n - 1, LEVEL)
        for (name, own), error in zip(shown.items(), errors.tolist(), strict=True)
    }


def mixed_model(
    values: Values, periods: Periods, orders: Mapping[str, str], reference: str
) -> dict[str, IntervalEstimate]:
    """Return each condition's difference from the reference by a linear mixed model.

    Periods and orders of conditions are fixed effects, participants random ones, so that those who had one condition
    only count as well. Estimates maximise the restricted likelihood. Intervals are Student's, with the degrees of
    freedom of comparisons within participants (J. C. Pinheiro and D. M. Bates, "Mixed-Effects Models in S and S-PLUS",
    2000), and are too narrow or wide if variances of conditions differ. The result is empty where the data do not
    determine the model.

    Parameters
    ----------
    values : mapping of mapping of float
        Values by condition and participant.
    periods : mapping of (participant, condition) to int
        The period in which the participant had the condition.
    orders : mapping of str to str
        The order of conditions of each participant.
    reference : str
    """
    rows = [(who, name, value) for name, own in values.items() for who, value in own.items()]
    others = [name for name in values if name != reference and values[name]]
    times = sorted({periods[who, name] for who, name, _ in rows})[1:]
    within = np.array([
        [name == other for other in others] + [periods[who, name] == time for time in times] for who, name, _ in rows
    ], dtype=float).reshape(len(rows), len(others) + len(times))  # fmt: skip
    people, outcome = [who for who, _, _ in rows], np.array([value for _, _, value in rows], dtype=float)
    who = sorted(set(people))
    given = [orders[one] for one in people]
    between = np.equal.outer(given, sorted(set(given))).astype(float)  # with the intercept among them
    design = np.hstack([within, between])
    freedom, columns = len(outcome) - len(who) - within.shape[1], design.shape[1]
    if not others or freedom < 1 or np.linalg.matrix_rank(design) < columns:
        return {}
    member = np.equal.outer(people, who).astype(float)
    each = member.sum(axis=0)
    data = np.column_stack([design, outcome])
    means = member @ ((member.T @ data) / each[:, None])

    def fitted(share: float) -> tuple[float, Floats, float]:
        """Return -2 log restricted likelihood, the triangle of the design, and the residual sum of squares.

        `share` is the variance between participants as a part of all variance. Rows are transformed so that their
        errors are independent, with equal variances.
        """
        ratio = share / (1 - share)
        shrunk = data - (member @ (1 - 1 / np.sqrt(1 + ratio * each)))[:, None] * means
        triangle = np.asarray(np.linalg.qr(shrunk, mode="r"), dtype=np.float64)
        left = float(triangle[columns, columns]) ** 2
        spread = np.log1p(ratio * each).sum() + 2 * np.log(np.abs(np.diag(triangle)[:columns])).sum()
        return float(spread + (len(outcome) - columns) * np.log(max(left, 1e-300))), triangle, left

    if fitted(0.0)[2] <= 1e-20 * float((outcome**2).sum()):
        return {}  # all values are explained, so that there is no variance to estimate
    best = optimize.minimize_scalar(
        lambda share: fitted(share)[0], bounds=(0.0, 1 - 1e-9), method="bounded", options={"xatol": 1e-12}
    ).x
    _, triangle, left = min((fitted(share) for share in (0.0, float(best))), key=lambda one: one[0])
    found = np.linalg.solve(triangle[:columns, :columns], triangle[:columns, columns])
    inverse = np.linalg.inv(triangle[:columns, :columns])
    errors = np.sqrt(left / (len(outcome) - columns) * (inverse**2).sum(axis=1))
    estimates = zip(others, found.tolist(), errors.tolist(), strict=False)
    return {name: IntervalEstimate.of(value, error, freedom, LEVEL) for name, value, error in estimates}
