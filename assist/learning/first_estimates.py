"""First estimates of people, in numpy, while the search for intervals would still have to be compiled.

The likelihood is computed on a grid, and its maximum is refined by a pattern search. What is not rejected on the grid
is a rough interval: its ends are interpolated between two points.

Theta is clipped, so that the likelihood has narrow ridges (`maximum_likelihood`), on which the search may stop. Of 120
simulated people, 114 had a log-likelihood that was less than 0.03 below the precise one, and all less than 0.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..people.decision import NOTHING, Floats
from .intervals import Interval, largest_fall
from .likelihood import Data, Method, largest_beta
from .likelihood_arrays import log_likelihoods
from .observations import Observations

POINTS = (40, 31, 17)  # of beta, theta and eta
HALVINGS = 12
SMALLEST = 1e-3  # least beta of the grid besides 0, as a share of the largest


@dataclass(frozen=True)
class FirstEstimate:
    """The estimates of one person before precise intervals are known, and the log-likelihood there.

    `values` are of beta, theta and eta, those of which the actions say anything; `intervals` are rough ones of these.
    """

    person: str
    values: dict[str, float]
    intervals: dict[str, Interval]
    log_likelihood: float

    def __str__(self) -> str:
        """Return the person with the estimates and their intervals."""
        shown = [
            f"{name} {value:.2f} ({low:.2f} to {high:.2f})"
            for (name, value), (low, high) in zip(self.values.items(), self.intervals.values(), strict=True)
        ]
        return f"{self.person}: {', '.join(shown) or 'the actions say nothing yet'}"


def first_estimates(observations: Sequence[Observations], method: Method) -> list[FirstEstimate]:
    """Return first estimates of each person, in some hundredths of a second for each."""
    largest = largest_beta(observations, method)
    return [_of_one(one, method, largest) for one in observations]


def _of_one(observations: Observations, method: Method, largest: float) -> FirstEstimate:
    data, told = Data.of(observations, method), bool((observations.suggested != NOTHING).any())
    rate = np.linspace(0.0, 1.0, POINTS[2]) if told and method.eta is None else np.array([method.eta or 0.0])
    axes = {
        "beta": np.append(0.0, np.geomspace(SMALLEST * largest, largest, POINTS[0])),
        "theta": np.linspace(0.0, 1.0, POINTS[1]) if told else np.array([0.5]), "eta": rate,
    }  # fmt: skip
    values = _on_grid(data, *axes.values())
    cell = np.unravel_index(values.argmax(), values.shape)
    start = [float(axis[at]) for axis, at in zip(axes.values(), cell, strict=True)]
    best, found = _climbed(data, start, list(axes.values()), float(values.max()))
    drop, known, intervals = largest_fall(method.level), dict[str, float](), dict[str, Interval]()
    for number, (name, axis) in enumerate(axes.items()):
        own = _interval(axis, best - values.max(axis=tuple({0, 1, 2} - {number})), found[number], drop)
        if own != (axis[0], axis[-1]):  # otherwise nothing is rejected, or it is known
            known[name], intervals[name] = found[number], own
    return FirstEstimate(observations.person, known, intervals, best)


def _on_grid(data: Data, beta: Floats, theta: Floats, eta: Floats) -> Floats:
    """Return the log-likelihood on a grid, shape (betas, thetas, etas)."""
    both = np.meshgrid(theta, eta, indexing="ij")
    found = log_likelihoods(data, beta, *(one.ravel() for one in both))
    return found.reshape(len(beta), len(theta), len(eta))


def _climbed(data: Data, start: list[float], axes: list[Floats], best: float) -> tuple[float, list[float]]:
    """Return the largest log-likelihood that a pattern search reaches from a point of the grid, and its place.

    Steps of beta are factors, those of theta and eta are differences.
    """
    at, factor = list(start), 2.0 if start[0] else 1.0
    steps = [float(axis[1] - axis[0]) if len(axis) > 1 else 0.0 for axis in axes[1:]]
    for _ in range(HALVINGS):
        while True:
            beta = np.unique(np.clip(at[0] * factor ** np.array([-1.0, 0.0, 1.0]), axes[0][0], axes[0][-1]))
            near = [
                np.unique(np.clip(middle + step * np.array([-1.0, 0.0, 1.0]), axis[0], axis[-1]))
                for middle, step, axis in zip(at[1:], steps, axes[1:], strict=True)
            ]
            values = _on_grid(data, beta, *near)
            if values.max() <= best + 1e-9:
                break
            best = float(values.max())
            cell = np.unravel_index(values.argmax(), values.shape)
            at = [float(axis[number]) for axis, number in zip((beta, *near), cell, strict=True)]
        factor, steps = factor**0.5, [step / 2 for step in steps]
    return best, at


def _interval(axis: Floats, fall: Floats, middle: float, most: float) -> Interval:
    """Return the ends of what is not rejected: where the profile's fall below its maximum at `middle` exceeds `most`.

    The root of the fall, which is known on the axis, is almost linear between two of its points.
    """
    ends = []
    root = np.sqrt(np.maximum(fall, 0.0))
    for beyond in (np.flatnonzero(axis < middle)[::-1], np.flatnonzero(axis > middle)):
        points, values = np.append(middle, axis[beyond]), np.append(0.0, root[beyond])
        last = int(np.flatnonzero(values <= most**0.5)[-1])
        end = float(points[last])
        if last + 1 < len(points):
            share = (most**0.5 - values[last]) / (values[last + 1] - values[last])
            end += float(share * (points[last + 1] - points[last]))
        ends.append(end)
    return ends[0], ends[1]
