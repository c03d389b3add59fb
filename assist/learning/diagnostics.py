"""Checks of the model: calibration of predicted choices, and score tests for regularities that it does not have.

`calibrate` compares probabilities with frequencies. `check` tests whether a person's choices depend on a further term
in the exponent of the choice (score test, Rao 1948):

repetition        choosing again what they chose in this state before: habits, or misconceptions (sigma)
large_mistakes    avoiding costly mistakes more, or less, than beta implies: lapses, or another form of noise
learning          erring more at the beginning of the record, or at the end: beta is not constant

Each score is compared with the scores of actions drawn from the fitted model in the same states, after projecting out
the fitted beta and theta.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from planner.system.results import Result

from ..people.decision import Floats
from .intervals import wilson
from .person_estimate import CHECKED, UNCHECKED, Check, PersonEstimate, people_of


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(Result):
    """Choices in bins of their predicted probability.

    Attributes
    ----------
    predicted : float array, shape (n,)
        Mean predicted probability in each bin that is not empty.
    observed : float array, shape (n,)
        Share of these that were chosen.
    low, high : float arrays, shape (n,)
        95 % interval of the share (Wilson 1927).
    count : int array, shape (n,)
        Number of alternatives in each bin.
    """

    predicted: Floats
    observed: Floats
    low: Floats
    high: Floats
    count: Floats

    def records(self) -> list[dict[str, Any]]:
        """Return a row for each bin."""
        return [dict(zip(vars(self), row, strict=True)) for row in np.column_stack(list(vars(self).values())).tolist()]


def calibrate(people: Mapping[str, PersonEstimate] | Iterable[PersonEstimate], bins: int = 10) -> Calibration:
    """Return predicted probabilities and observed frequencies, over all people and alternatives.

    Parameters
    ----------
    people : FittedPeople, or iterable of PersonEstimate
    bins : int
        Number of bins of predicted probabilities.
    """
    fits = people_of(people)
    p = np.concatenate([f.probabilities()[f.observations.applicable] for f in fits])
    hit = np.concatenate(
        [
            (np.arange(f.observations.excess.shape[1]) == f.observations.chosen[:, None])[f.observations.applicable]
            for f in fits
        ]
    )
    number = np.minimum((p * bins).astype(int), bins - 1)
    count = np.bincount(number, minlength=bins).astype(float)
    kept = count > 0
    count = count[kept]
    predicted = np.bincount(number, p, bins)[kept] / count
    observed = np.bincount(number, hit, bins)[kept] / count
    intervals = [wilson(round(share * n), int(n)) for share, n in zip(observed, count, strict=True)]
    low, high = np.array([(interval.low, interval.high) for interval in intervals]).T
    return Calibration(predicted, observed, low, high, count)


def check(fitted: PersonEstimate, rng: np.random.Generator, draws: int = 999) -> Check:
    """Return the check of the model on one person's actions.

    Parameters
    ----------
    fitted : PersonEstimate
    rng : numpy.random.Generator
    draws : int
        Number of simulated people; p is at least 1 / (draws + 1).
    """
    o = fitted.observations
    p = fitted.probabilities()
    p = np.where(np.isfinite(o.excess), p, 0.0)  # into a dead end: a lapse, of which these terms say nothing
    kept = np.isfinite(o.regret) & (o.applicable.sum(axis=1) > 1)
    if not kept.any():
        return UNCHECKED
    p = p[kept] / p[kept].sum(axis=1, keepdims=True)
    gap = np.where(np.isfinite(o.excess), o.excess, 0.0)[kept]
    features = _features(fitted, gap, kept)
    told = (np.arange(gap.shape[1]) == o.suggested[kept][:, None]).astype(float)
    absorbed = np.stack([gap, told]) if told.any() else gap[None]
    f, g = (array - (array * p).sum(axis=2, keepdims=True) for array in (features, absorbed))
    cross, own = np.einsum("fna,gna,na->fg", f, g, p), np.einsum("fna,gna,na->fg", g, g, p)
    f = f - np.einsum("fg,gna->fna", cross @ np.linalg.pinv(own), g)
    spread = np.sqrt(np.einsum("fna,fna,na->f", f, f, p))
    total = np.sqrt(np.einsum("fna,fna,na->f", features, features, p))
    usable = spread > 1e-3 * np.maximum(total, 1e-9)
    mistakes = float(p[~o.optimal[kept]].sum())
    if not usable.any() or mistakes < 1:
        return UNCHECKED
    f = f[usable] / spread[usable][:, None, None]
    rows = np.arange(len(p))
    observed = f[:, rows, o.chosen[kept]].sum(axis=1)
    cumulated = p.cumsum(axis=1)
    drawn = np.empty((draws, len(f)))
    for i in range(draws):
        slots = (cumulated < rng.random((len(p), 1)) * cumulated[:, -1:]).sum(axis=1)
        drawn[i] = f[:, rows, slots].sum(axis=1)
    inverse = np.linalg.pinv(np.einsum("fna,gna,na->fg", f, f, p))
    distance = np.einsum("df,fg,dg->d", drawn, inverse, drawn)
    own_distance = float(observed @ inverse @ observed)
    scores: dict[str, float | None] = dict.fromkeys(CHECKED)
    scores.update(zip(np.array(CHECKED)[usable].tolist(), observed.tolist(), strict=True))
    return Check((1 + int((distance >= own_distance).sum())) / (draws + 1), scores)


def _features(fitted: PersonEstimate, gap: Floats, kept: np.ndarray) -> Floats:
    """Return what each term adds to the exponent, shape (terms, n, A)."""
    o = fitted.observations
    habit = np.zeros(o.excess.shape)
    before: dict[int, Floats] = {}
    for i, (state, slot) in enumerate(zip(o.state.tolist(), o.chosen.tolist(), strict=True)):
        counts = before.setdefault(state, np.zeros(o.excess.shape[1]))
        habit[i] = counts > 0
        counts[slot] += 1
    time = np.linspace(-0.5, 0.5, len(o))[kept]
    return np.stack([habit[kept], gap**2, -gap * time[:, None]])
