"""Maximum-likelihood estimates of a person's expertise, influence and trust.

The model is that of `people.decision`, with h* as the person's cost-to-go. The parameters are beta and, if there were
suggestions, the initial theta of each episode and the learning rate eta. Intervals are those of the profile likelihood:
all values that a likelihood-ratio test does not reject, with the other parameters at their maximum (Wilks 1938).
Estimates are finite: for a person who never errs, `largest_beta` is the estimate and the end of the interval, and
`Estimate.open_above` is true.

`profiles` maximises the likelihood.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from planner.system.results import Result

from ..people.decision import Floats, choice, influence, lapse, trust
from .evidence import Evidence, observations_of
from .intervals import end_of, largest_fall
from .likelihood import Method, goal_posteriors, largest_beta
from .observations import Observations
from .profiles import BETA, ETA, THETA, Profiles


@dataclass(frozen=True)
class Estimate:
    """A parameter's maximum-likelihood estimate, and its interval.

    Attributes
    ----------
    value : float
    interval : (float, float)
        It contains all values that are not rejected. It may end at the end of the parameter's range.
    open_below, open_above : bool
        Whether it ends there, that is, the data do not bound the parameter on that side.
    """

    value: float
    interval: tuple[float, float]
    open_below: bool
    open_above: bool

    @property
    def identified(self) -> bool:
        """Whether the interval is smaller than the parameter's range."""
        return not (self.open_below and self.open_above)


@dataclass(frozen=True, eq=False, repr=False)
class Fit(Result):
    """The estimates of one person.

    Attributes
    ----------
    observations : Observations
    beta : Estimate
        Expertise, per cost unit.
    theta, eta : Estimate or None
        Influence at the beginning of an episode, and learning rate of the trust update. None without suggestions; eta
        is None also if it was given.
    log_likelihood : float
        Value at the estimates, including lapses.
    known_eta : float or None
        The given learning rate.
    method : Method
        Options of the estimation.
    weights : mapping of str to Estimate
        Estimate of each term's weight; empty without terms.
    """

    observations: Observations
    beta: Estimate
    theta: Estimate | None
    eta: Estimate | None
    log_likelihood: float
    known_eta: float | None
    method: Method
    weights: Mapping[str, Estimate] = field(default_factory=dict)

    def __repr__(self) -> str:
        known = [f"{row['parameter']} {row['estimate']:.2f}" for row in self.records()]
        return f"<fit to {self.observations.person}: {', '.join(known)}, {len(self.observations)} actions>"

    def records(self) -> list[dict[str, Any]]:
        """Return a row for each parameter: its estimate, and the ends of its interval."""
        found = {"beta": self.beta, "theta": self.theta, "eta": self.eta, **self.weights}
        return [
            {
                "parameter": name, "estimate": one.value, "low": one.interval[0], "high": one.interval[1],
                "identified": one.identified,
            }
            for name, one in found.items() if one is not None
        ]  # fmt: skip

    def probabilities(self) -> Floats:
        """Return the probability of each choice at the estimates, shape (N, A), including lapses."""
        o = self.observations
        bias = o.features @ np.array([weight.value for weight in self.weights.values()]) if self.weights else None
        if o.own is not None:
            p = o.own.at(self.beta.value)
        else:
            p = choice(o.excess, o.applicable, np.full(len(o), self.beta.value), bias)
        return lapse(influence(p, o.suggested, self.thetas()), o.applicable, self.method.lapse)

    def goal_posteriors(self) -> dict[str, dict[str, float]]:
        """Return the probability of each goal in each episode at the estimates; empty if the goal is known."""
        o, goals = self.observations, self.observations.goals
        if goals is None:
            return {}
        theta, eta = (0.5 if one is None else one.value for one in (self.theta, self.eta))
        eta = eta if self.eta is not None else self.known_eta or 0.0
        found = goal_posteriors(o, self.beta.value, theta, eta, self.method).tolist()
        return {
            name: dict(zip(goals.names, shares, strict=True)) for name, shares in zip(o.episodes, found, strict=True)
        }

    def thetas(self) -> Floats:
        """Return theta before each step at the estimates, shape (N,); 0.5 everywhere without suggestions."""
        o, found, eta = self.observations, np.full(len(self.observations), 0.5), self.eta
        if self.theta is None:
            return found
        rate, theta = self.known_eta or 0.0 if eta is None else eta.value, self.theta.value
        for i, (begins, gain) in enumerate(zip(o.begins.tolist(), o.gain.tolist(), strict=True)):
            found[i] = theta = self.theta.value if begins else theta
            theta = float(trust(theta, 0.0, gain, rate, self.method.utility_scale)) if gain else theta
        return found


def fits_of(people: Mapping[str, Any] | Iterable[Any]) -> list[Fit]:
    """Return the fits of people: of the result of `fit`, of estimates of persons, or fits themselves.

    Raises
    ------
    TypeError
        They are something else.
    """
    each = list(people.values() if isinstance(people, Mapping) else people)
    found = [getattr(one, "fit", one) for one in each]
    wrong = next((one for one in found if not isinstance(one, Fit)), None)
    if wrong is not None:
        raise TypeError(f"a {type(wrong).__name__} where a person's fit was expected; `fit(task, log)` returns them")
    return found


def maximum_likelihood(
    observations: Evidence | Sequence[Observations],
    method: Method | None = None,
    *,
    jobs: int = 1,
    progress: Callable[[int], None] | None = None,
) -> list[Fit]:
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
    """Return one person's estimates."""
    profiles = Profiles(observations, method, largest)
    best, at = profiles.maximum()
    at = _to_the_end(profiles, best, at)
    drop = largest_fall(method.level)
    free = [axis for axis in (BETA, THETA, ETA) if profiles.free(axis)]
    found = {axis: _estimate(profiles, axis, at, best, drop) for axis in free}
    return Fit(observations, found[BETA], found.get(THETA), found.get(ETA), best, method.eta, method)


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
