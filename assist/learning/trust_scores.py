"""How well trust rules predict held-out people: log scores, paired differences, and a correction for their number."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from scipy import stats

from ..people.decision import Floats

REFERENCE = "constant"


@dataclass(frozen=True)
class TrustScore:
    """How well a trust rule predicts people to whom it was not fitted.

    Attributes
    ----------
    rule : str
    parameters : dict of str to float
        Those that fit all people best: of the rule and of the population.
    nats_per_choice : float
        Minus the mean held-out log probability of what was chosen.
    stderr : float
        Its standard error over people.
    difference : float or None
        Nats per choice minus those of the reference rule, paired by person; None for the reference itself.
    interval : tuple of float, or None
        Interval of the difference over people, by Student's t.
    p, p_corrected : float or None
        Two-sided p-value of no difference, and the same corrected for the number of rules (Holm's method).
    """

    rule: str
    parameters: dict[str, float]
    nats_per_choice: float
    stderr: float
    difference: float | None = None
    interval: tuple[float, float] | None = None
    p: float | None = None
    p_corrected: float | None = None


@dataclass(frozen=True)
class TrustComparison:
    """Trust rules compared on the same people.

    Attributes
    ----------
    people, choices : int
    level : float
        Level of the intervals.
    scores : tuple of TrustScore
        The first is that of the reference rule.
    """

    people: int
    choices: int
    level: float
    scores: tuple[TrustScore, ...]

    @classmethod
    def of(
        cls, logs: Mapping[str, Floats], counts: Floats, parameters: Mapping[str, dict[str, float]], level: float = 0.95
    ) -> TrustComparison:
        """Compare held-out log probabilities.

        Parameters
        ----------
        logs : mapping of str to float array, shape (K,)
            By rule, the log probability of all that each person chose; `REFERENCE` is among them.
        counts : float array, shape (K,)
            Number of choices of each person.
        parameters : mapping of str to dict
            Estimates of each rule, for the result.
        level : float
            Level of the intervals.
        """
        reference, names = logs[REFERENCE], [REFERENCE, *(name for name in logs if name != REFERENCE)]
        people, rows = len(counts), []
        width = float(stats.t.ppf((1 + level) / 2, people - 1))
        for name in names:
            nats, stderr = ratio(-logs[name], counts)
            if name == REFERENCE:
                rows.append(TrustScore(name, parameters[name], nats, stderr))
                continue
            mean, error = ratio(reference - logs[name], counts)
            p = float(2 * stats.t.sf(abs(mean) / error, people - 1)) if error > 0 else 1.0
            interval = (mean - width * error, mean + width * error)
            rows.append(TrustScore(name, parameters[name], nats, stderr, mean, interval, p))
        corrected = iter(holm([row.p for row in rows if row.p is not None]))
        scores = [row if row.p is None else TrustScore(**vars(row) | {"p_corrected": next(corrected)}) for row in rows]
        return cls(people, int(counts.sum()), level, tuple(scores))

    @property
    def best(self) -> TrustScore:
        """The rule that predicts best among those that predict better than the reference, by corrected p-values.

        The reference if there is none: a rule whose steps are estimated as 0 predicts as well.
        """
        better = [row for row in self.scores[1:] if row.difference is not None and row.difference < 0]
        sure = [row for row in better if row.p_corrected is not None and row.p_corrected <= 1 - self.level]
        return min(sure, key=lambda row: row.nats_per_choice, default=self.scores[0])

    def as_dict(self) -> dict[str, Any]:
        """Return the comparison as plain data."""
        return {
            "people": self.people, "choices": self.choices, "level": self.level, "best": self.best.rule,
            "rules": [asdict(row) for row in self.scores],
        }  # fmt: skip


def ratio(sums: Floats, counts: Floats) -> tuple[float, float]:
    """Return the mean per choice and its standard error over people (ratio estimator).

    Parameters
    ----------
    sums, counts : float arrays, shape (K,)
        Total of each person, and the number of their choices.
    """
    mean, people = sums.sum() / counts.sum(), len(counts)
    spread = ((sums - mean * counts) ** 2).sum() * people / (people - 1)
    return float(mean), float(math.sqrt(spread) / counts.sum())


def holm(p: Sequence[float]) -> list[float]:
    """Return p-values corrected for their number by Holm's method: the k-th least of n times n - k + 1, ascending."""
    found, least = [0.0] * len(p), 0.0
    for place, k in enumerate(sorted(range(len(p)), key=p.__getitem__)):
        least = max(least, min(1.0, (len(p) - place) * p[k]))
        found[k] = least
    return found
