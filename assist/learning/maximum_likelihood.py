"""Expertise, influence and trust of a person, from what they did.

Maximum likelihood under the model of `people.decision`, with h* for the person's cost-to-go: beta, and where there were
suggestions the theta that each episode began with and the rate eta of the trust update. Intervals are those of the
profile likelihood: all values that a likelihood-ratio test at the level does not reject, the other parameters at
their best (Wilks 1938). Nothing ends at infinity: who never errs gets `largest_beta` as an estimate and as the end
of an interval, and `Estimate.open_above` says so.

How a likelihood is maximised stands in `profiles`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import brentq
from scipy.special import chdtri

from ..people.decision import Floats, choice, influence, lapse
from .likelihood import Method, thetas
from .observations import Observations
from .profiles import BETA, ETA, THETA, Profiles

NEAR = 0.5
"""What the grid's values may fall short of the profile."""

NOTHING_LESS = 1e-6
"""A likelihood that falls short of the largest by so little is taken for it."""


@dataclass(frozen=True)
class Estimate:
    """A parameter's maximum-likelihood value, and its interval.

    Attributes
    ----------
    value : float
    interval : (float, float)
        All values that are not rejected lie in it. It may end where the parameter's range does.
    open_below, open_above : bool
        Whether it does: what is recorded does not bound the parameter on that side.
    """

    value: float
    interval: tuple[float, float]
    open_below: bool
    open_above: bool

    @property
    def identified(self) -> bool:
        """Whether the interval is less than the parameter's whole range."""
        return not (self.open_below and self.open_above)


@dataclass(frozen=True)
class Fit:
    """What was learned about a person.

    Attributes
    ----------
    observations : Observations
    beta : Estimate
        Per cost unit.
    theta, eta : Estimate or None
        Influence at the beginning of an episode, and rate of the trust update; None without suggestions, eta also
        where it was given.
    log_likelihood : float
        At the estimates, lapses included.
    known_eta : float or None
        The rate that was given.
    method : Method
        How it was learned.
    weights : mapping of str to Estimate
        Of the terms that speak for choices besides cost; empty where none were asked for.
    """

    observations: Observations
    beta: Estimate
    theta: Estimate | None
    eta: Estimate | None
    log_likelihood: float
    known_eta: float | None
    method: Method
    weights: Mapping[str, Estimate] = field(default_factory=dict)

    def probabilities(self) -> Floats:
        """Give the probability of each choice at the estimates, shape (N, A), lapses included."""
        o = self.observations
        bias = o.features @ np.array([weight.value for weight in self.weights.values()]) if self.weights else None
        if o.own is not None:
            p = o.own.at(self.beta.value)
        else:
            p = choice(o.excess, o.applicable, np.full(len(o), self.beta.value), bias)
        return lapse(influence(p, o.suggested, self.thetas()), o.applicable, self.method.lapse)

    def thetas(self) -> Floats:
        """Give theta before each step at the estimates, shape (N,); 0.5 throughout without suggestions."""
        if self.theta is None:
            return np.full(len(self.observations), 0.5)
        eta = self.eta.value if self.eta is not None else self.known_eta
        gain = self.observations.gain / self.method.utility_scale
        return thetas(gain, self.observations.begins, self.theta.value, 0.0 if eta is None else eta)


def largest_beta(observations: Sequence[Observations], method: Method) -> float:
    """Give the end of the range of beta: `Method.largest_beta`, or what it stands for where that is None."""
    if method.largest_beta is not None:
        return method.largest_beta
    sizes = [o.excess[(o.excess > 0) & np.isfinite(o.excess)] for o in observations]
    return 10.0 / min((float(size.min()) for size in sizes if len(size)), default=1.0)


def maximum_likelihood(
    observations: Sequence[Observations],
    method: Method | None = None,
    *,
    jobs: int = 1,
    progress: Callable[[int], None] | None = None,
) -> list[Fit]:
    """Estimate the parameters of each person.

    Parameters
    ----------
    observations : sequence of Observations
        One for each person.
    method : Method, optional
    jobs : int
        Threads.
    progress : callable, optional
        Called with how many people have been finished since the last call.
    """
    method = method or Method()
    largest = largest_beta(observations, method)

    def one(person: Observations) -> Fit:
        result = _fit(person, method, largest)
        if progress is not None:
            progress(1)
        return result

    if jobs == 1:
        return [one(person) for person in observations]
    with ThreadPoolExecutor(jobs) as pool:
        return list(pool.map(one, observations))


def _fit(observations: Observations, method: Method, largest: float) -> Fit:
    """Estimate one person's parameters."""
    profiles = Profiles(observations, method, largest)
    best, at = profiles.maximum()
    at = _to_the_end(profiles, best, at)
    drop = float(chdtri(1, 1 - method.level)) / 2
    free = [axis for axis in (BETA, THETA, ETA) if profiles.free(axis)]
    found = {axis: _estimate(profiles, axis, at, best, drop) for axis in free}
    return Fit(observations, found[BETA], found.get(THETA), found.get(ETA), best, method.eta, method)


def _to_the_end(profiles: Profiles, best: float, at: Floats) -> Floats:
    """Take the end of a coordinate's range for a maximum that the end does not fall short of.

    Where nobody errs, the likelihood rises for ever but soon by less than numbers can tell.
    """
    for axis in (BETA, THETA, ETA):
        if not profiles.free(axis):
            continue
        for end in (float(profiles.axes[axis][-1]), float(profiles.axes[axis][0])):
            moved = at.copy()
            moved[axis] = end
            value = profiles.at(moved)
            if axis == BETA and value < best - NOTHING_LESS:
                value, moved = profiles.largest(BETA, end, at)
            if value >= best - NOTHING_LESS:
                at = moved
                break
    return at


def _estimate(profiles: Profiles, axis: int, at: Floats, best: float, drop: float) -> Estimate:
    """Give a coordinate's estimate with the interval of all that is not rejected."""
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
        kept = 0  # of these so many are not rejected
        for count in range(len(outwards), 0, -1):
            short = best - drop - values[count - 1]
            if short <= 0 or (short <= NEAR and margin(outwards[count - 1]) >= 0):
                kept = count
                break
        inside = outwards[kept - 1] if kept else middle
        end = inside
        for outside in outwards[kept:]:
            if margin(outside) < 0:
                end = brentq(margin, inside, outside, xtol=1e-4) if margin(inside) > 0 else inside
                break
            kept, inside, end = kept + 1, outside, outside
        ends.append(end)
        is_open.append(kept == len(outwards))
    value, low, high = (float(profiles.beta(np.array(x))) if axis == BETA else x for x in (middle, *ends))
    return Estimate(value, (min(low, value), max(high, value)), is_open[0], is_open[1])
