"""Maximum-likelihood estimates of a person's expertise, influence and trust.

The model is that of `people.decision`, with h* as the person's cost-to-go. The parameters are beta and, if there were
suggestions, the initial theta of each episode and the learning rate eta. Intervals are those of the profile likelihood:
all values that a likelihood-ratio test does not reject, with the other parameters at their maximum (Wilks 1938).
Estimates are finite: for a person who never errs, `largest_beta` is the estimate and the end of the interval, and
`Estimate.open_above` is true.

`profiles` maximises the likelihood.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ..people.decision import Floats
from .evidence import Evidence, observations_of
from .intervals import end_of, largest_fall
from .likelihood import Method, largest_beta
from .observations import Observations
from .person_estimate import PARAMETERS, Estimate, PersonEstimate
from .profiles import BETA, ETA, THETA, Profiles


def maximum_likelihood(
    observations: Evidence | Sequence[Observations],
    method: Method | None = None,
    *,
    jobs: int = 1,
    progress: Callable[[int], None] | None = None,
) -> list[PersonEstimate]:
    """Return the estimates of each person.

    Parameters
    ----------
    observations : Evidence, or sequence of Observations
        A log that was replayed; or one for each person.
    method : Method, optional
    jobs : int
        Number of threads.
    progress : callable, optional
        Called with the number of people who have been finished since the last call.
    """
    method, observations = method or Method(), observations_of(observations)
    largest = largest_beta(observations, method)

    def one(person: Observations) -> PersonEstimate:
        result = _fit(person, method, largest)
        if progress is not None:
            progress(1)
        return result

    if jobs == 1:
        return [one(person) for person in observations]
    with ThreadPoolExecutor(jobs) as pool:
        return list(pool.map(one, observations))


def _fit(observations: Observations, method: Method, largest: float) -> PersonEstimate:
    """Return one person's estimates."""
    profiles = Profiles(observations, method, largest)
    best, at = profiles.maximum()
    at = _to_the_end(profiles, best, at)
    drop = largest_fall(method.level)
    free = [axis for axis in (BETA, THETA, ETA) if profiles.free(axis)]
    found = {PARAMETERS[axis]: _estimate(profiles, axis, at, best, drop) for axis in free}
    return PersonEstimate(observations, found, best, method.eta, method)


def _to_the_end(profiles: Profiles, best: float, at: Floats) -> Floats:
    """Return the maximum, moved to the end of a coordinate's range if the likelihood there is as large.

    For a person without errors, the likelihood increases in beta without end, but soon by less than rounding errors.
    """
    as_large = best - 1e-6  # values of the log-likelihood that differ by less count as equal
    for axis in (BETA, THETA, ETA):
        if not profiles.free(axis):
            continue
        for end in (float(profiles.axes[axis][-1]), float(profiles.axes[axis][0])):
            moved = at.copy()
            moved[axis] = end
            value = profiles.at(moved)
            if axis == BETA and value < as_large:
                value, moved = profiles.largest(BETA, end, at)
            if value >= as_large:
                at = moved
                break
    return at


def _estimate(profiles: Profiles, axis: int, at: Floats, best: float, drop: float) -> Estimate:
    """Return a coordinate's estimate with the interval of all values that are not rejected."""
    grid, middle = profiles.axes[axis], float(at[axis])
    coarse = profiles.coarse(axis)
    ends = []
    is_open = []

    def margin(value: float) -> float:
        return profiles.largest(axis, value, at)[0] - best + drop

    for side in (-1, 1):
        order = slice(None, None, side)
        beyond = (grid[order] - middle) * side > 0
        outwards, values = grid[order][beyond].tolist(), coarse[order][beyond]
        kept = 0  # number of these that are not rejected
        for count in range(len(outwards), 0, -1):
            short = best - drop - values[count - 1]
            # The profile likelihood is assumed to exceed the grid's values by at most 0.5.
            if short <= 0 or (short <= 0.5 and margin(outwards[count - 1]) >= 0):
                kept = count
                break
        end, open_ = end_of(margin, outwards[kept - 1] if kept else middle, outwards[kept:], 1e-4)
        ends.append(end)
        is_open.append(open_)
    value, low, high = (float(profiles.beta(np.array(x))) if axis == BETA else x for x in (middle, *ends))
    return Estimate(value, (min(low, value), max(high, value)), is_open[0], is_open[1])
