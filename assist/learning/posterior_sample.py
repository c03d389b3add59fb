"""A sample of the posterior of a few parameters, by importance sampling around the values of largest likelihood.

The prior is flat on the parameters' ranges.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri
from scipy.stats.qmc import Halton

from ..people.decision import Floats
from .intervals import Interval

Value = Callable[[Floats], float]
"""Returns the log likelihood of parameters, shape (P,), within their ranges."""


@dataclass(frozen=True)
class PosteriorSample:
    """N points of parameters, (N, P), their probabilities, (N,), and the log integral of the likelihood over them."""

    points: Floats
    shares: Floats
    log_integral: float

    @classmethod
    def around(
        cls, value: Value, best: Floats, ranges: Sequence[Interval], covariance: Floats, wider: float = 1.5,
        count: int = 32,
    ) -> PosteriorSample:  # fmt: skip
        """Return a sample of quasi-random points, `count` for each parameter, without those beyond a range.

        The proposal is normal. Its deviations are `wider` times those of `covariance`, shape (P, P), since the
        posterior may have heavier tails.
        """
        low, high = np.array(ranges).T
        quasi = Halton(len(best), scramble=False)
        quasi.fast_forward(1)  # the first point is 0, which is at minus infinity
        z, factor = ndtri(quasi.random(count * len(best))), wider * np.linalg.cholesky(covariance)
        points = best + z @ factor.T
        inside = ((points >= low) & (points <= high)).all(axis=1)
        logs = np.full(len(z), -np.inf)
        logs[inside] = np.array([value(point) for point in points[inside]]) + (z[inside] ** 2).sum(axis=1) / 2
        mass = np.exp(logs[inside] - logs.max())
        integral = logs.max() + np.log(mass.sum() / len(z)) + np.log(np.diag(factor)).sum()
        return cls(points[inside], mass / mass.sum(), float(integral + len(best) * np.log(2 * np.pi) / 2))


def posterior_covariance(value: Value, best: Floats, ranges: Sequence[Interval], noise: float = 0.1) -> Floats:
    """Return the covariance of the parameters, (P, P), from differences of the likelihood at about two deviations.

    A parameter on which the likelihood does not depend, as the differences are below `noise` nats, is taken to be
    independent of the others. So are all of them where the likelihood is not concave.
    """
    top, count = value(best), len(best)
    steps, unit = np.full(count, 0.05), np.eye(count)
    for j, (low, high) in enumerate(ranges):
        side = 1 if high - best[j] > best[j] - low else -1
        for _ in range(5):
            fall = max(top - value(best + side * steps[j] * unit[j]), 1e-3)
            if 0.5 < fall < 4:
                break
            steps[j] = min(steps[j] * np.clip(np.sqrt(2 / fall), 0.2, 5), (high - low) / 4)
    middle = np.array([np.clip(a, low + d, high - d) for a, d, (low, high) in zip(best, steps, ranges, strict=True)])
    moves = steps * unit
    center = value(middle)
    single = np.array([[value(middle + side * moves[j]) for side in (1, -1)] for j in range(count)])
    curvature = np.zeros((count, count))
    for i in range(count):
        curvature[i, i] = (single[i].sum() - 2 * center) / steps[i] ** 2
        for j in range(i):
            both = value(middle + moves[i] + moves[j]) + value(middle - moves[i] - moves[j])
            mixed = (both - single[i].sum() - single[j].sum() + 2 * center) / (2 * steps[i] * steps[j])
            curvature[i, j] = curvature[j, i] = mixed
    found = np.diag((steps / 2) ** 2)
    depends = -np.diag(curvature) * steps**2 > noise
    known = np.ix_(depends, depends)
    if (np.linalg.eigvalsh(curvature[known]) < 0).all():
        found[known] = np.linalg.inv(-curvature[known])
    return found
