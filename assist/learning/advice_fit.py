"""Fits of trust rules to logs of advice, by the largest marginal likelihood (`advice_model`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any

import numpy as np
from scipy.optimize import minimize

from planner.system.errors import expected
from planner.system.results import Result

from ..people.decision import Floats
from .advice_log import AdviceLog, read_advice
from .advice_model import BASES, AdviceModel
from .advice_rules import RULES

POINTS, LOCAL = 30, 3
"""Random points, and searches from the most likely ones, where a likelihood has many local maxima."""

WIDTHS = {"mu": 1.0, "sigma": 0.5}
"""Standard deviations of the random points; of other parameters, half of the value at which fits begin."""


def fit_model(start: AdviceModel, log: AdviceLog) -> AdviceModel:
    """Return the model of largest marginal likelihood, found from the values of `start`.

    Where these are the values of `of`, smaller steps are a second start. Where theta moves by steps and is clipped,
    the likelihood has many local maxima (`advice_model.NODES`). The fit is then the best of several local maxima, found
    from the most likely of some random points. It has as many nodes as the log needs at the start, and at its end.

    Raises
    ------
    ValueError
        The likelihood of the fit is not finite, so that nothing was estimated.
    """
    found = _best(start.refined(log), log)
    while (finer := found.refined(log)) is not found:
        surface = _Likelihood(finer, log)
        at = surface.point(finer.values)
        found = surface.finite(_local_maximum(surface, at) if surface.kinks else _scoring(surface.people, at))
    return found


def _best(start: AdviceModel, log: AdviceLog) -> AdviceModel:
    """Return the model of largest marginal likelihood with the nodes of `start`."""
    surface = _Likelihood(start, log)
    initial = type(start).of(start.base, start.rule).values
    common, rest = initial[: len(BASES[start.base])], initial[len(BASES[start.base]) :]
    starts = [surface.point(start.values)]
    if rest and start.rule.by_steps and (start.values == initial or surface.kinks):
        starts.append(surface.point((*common, *(0.3 * value for value in rest))))
    if surface.kinks:
        starts.append(surface.point(initial))
    found = sorted((_scoring(surface.people, one) for one in starts), key=surface.loss)
    if not surface.kinks:
        return surface.finite(found[0])
    width = np.array([WIDTHS.get(name, 0.5 * abs(value)) for name, value in zip(surface.names, initial, strict=True)])
    drawn = found[0] + np.random.default_rng(0).normal(size=(POINTS, len(found[0]))) * width[surface.free]
    best = [found[0], *sorted([*found[1:], *drawn], key=surface.loss)[: LOCAL - 1]]
    return surface.finite(min((_local_maximum(surface, one) for one in best), key=surface.loss))


@dataclass(frozen=True)
class _Likelihood:
    """The marginal likelihood of a log as a function of a model's free parameters, on a scale without limits."""

    start: AdviceModel
    log: AdviceLog

    @property
    def names(self) -> tuple[str, ...]:
        return (*BASES[self.start.base], *self.start.rule.parameters)

    @property
    def free(self) -> list[bool]:
        return [name != "sigma" or not self.start.rule.shared for name in self.names]

    @property
    def kinks(self) -> bool:
        """Whether derivatives mislead."""
        return self.start.rule.clipped

    def point(self, values: Sequence[float]) -> Floats:
        return np.array([self._to(name, value) for name, value in zip(self.names, values, strict=True)])[self.free]

    def model(self, point: Floats) -> AdviceModel:
        moved = iter(point.tolist())
        return replace(
            self.start,
            values=tuple(
                self._from(name, next(moved)) if one else value
                for name, one, value in zip(self.names, self.free, self.start.values, strict=True)
            ),
        )

    def _to(self, name: str, value: float) -> float:
        if name == "sigma" or name in self.start.rule.positive:
            return math.log(max(value, 1e-6))
        return math.log(value / (1 - value)) if name in self.start.rule.unit else value

    def _from(self, name: str, value: float) -> float:
        if name == "sigma" or name in self.start.rule.positive:
            return math.exp(min(max(value, -15.0), 15.0))
        return 1 / (1 + math.exp(-min(max(value, -30.0), 30.0))) if name in self.start.rule.unit else value

    def finite(self, point: Floats) -> AdviceModel:
        """Return the model at a point, with an error if its likelihood is not finite."""
        model = self.model(point)
        if not math.isfinite(found := model.log_likelihood(self.log)):
            raise ValueError(f"the log likelihood is {found:g}, so nothing can be estimated")
        return model

    def people(self, point: Floats) -> Floats:
        with np.errstate(over="ignore"):
            values = self.model(point).log_likelihoods(self.log)
        return values if np.isfinite(values).all() else np.full(len(values), -1e6)

    def loss(self, point: Floats) -> float:
        return -float(self.people(point).sum())


def _local_maximum(surface: _Likelihood, point: Floats) -> Floats:
    found = minimize(
        surface.loss, point, method="Nelder-Mead",
        options={"maxiter": 200 * len(point), "xatol": 1e-3, "fatol": 1e-3, "adaptive": True},
    )  # fmt: skip
    return np.asarray(found.x)


def _scoring(people: Callable[[Floats], Floats], point: Floats, enough: float = 1e-3) -> Floats:
    """Return the point near a start at which the sum of people's log likelihoods is largest.

    The information is estimated by people's scores (the method of Berndt, Hall, Hall and Hausman), with damping, until
    a step is expected to gain less than `enough` nats. A start needs a few steps, and each the likelihood once for
    each parameter.
    """
    delta, damping, unit = 1e-4, 1e-3, np.eye(len(point))
    values = people(point)

    def loss(at: Floats) -> float:
        return -float(people(at).sum())

    if len(values) <= len(point):  # too few scores for the information
        return np.asarray(minimize(loss, point, method="BFGS", options={"eps": delta, "gtol": 1e-2}).x)
    for _ in range(100):
        scores = np.array([(people(point + delta * one) - values) / delta for one in unit])
        gradient, information = scores.sum(axis=1), scores @ scores.T
        scale = np.diag(np.diag(information) + 1e-6)
        while True:
            step = np.linalg.solve(information + damping * scale, gradient)
            if gradient @ step < enough:
                return point
            moved = people(point + step)
            if moved.sum() > values.sum():
                break
            damping *= 10
        point, values, damping = point + step, moved, max(damping / 10, 1e-6)
    return point


@dataclass(frozen=True, eq=False, repr=False)
class FittedAdvice(Result):
    """A trust rule that was fitted to judgements with advice.

    Attributes
    ----------
    rule : str
    base : str
        What answers depend on besides theta: "E", the own confidence, or "EA", also that of the advisor.
    parameters : dict of str to float
    log_likelihood : float
        In nats.
    people, choices : int
        Their numbers.
    """

    rule: str
    base: str
    parameters: Mapping[str, float]
    log_likelihood: float
    people: int
    choices: int

    def __repr__(self) -> str:
        values = ", ".join(f"{name} {value:.3g}" for name, value in self.parameters.items())
        return f"<trust rule {self.rule} of {self.people:,} people: {values}>"

    def records(self) -> list[dict[str, Any]]:
        """Return a row for each parameter."""
        return [{"rule": self.rule, "parameter": name, "estimate": value} for name, value in self.parameters.items()]

    def as_dict(self) -> dict[str, Any]:
        """Return the fit as plain data."""
        return dict(vars(self))


def fit_advice(log: AdviceLog | str | PathLike[str], rule: str = "outcome-at-disagreement") -> FittedAdvice:
    """Return the parameters of a trust rule that fit a log of advice best.

    Parameters
    ----------
    log : AdviceLog, or path
        People's choices before and after advice; a file is read as `read_advice` does.
    rule : str
        A name of `RULES`.

    Raises
    ------
    ValueError
        There is no such rule, or the likelihood is not finite.
    """
    log = log if isinstance(log, AdviceLog) else read_advice(log)
    if rule not in RULES:
        raise ValueError(f"trust rule {rule!r}; {expected(rule, RULES)}")
    base = base_of(log)
    model = fit_model(AdviceModel.of(base, RULES[rule]), log)
    return FittedAdvice(rule, base, model.parameters, model.log_likelihood(log), len(log.people), len(log))


def base_of(log: AdviceLog) -> str:
    """Return the base for a log: "EA" where the advisor's confidence differs between rows, else "E"."""
    return "EA" if np.ptp(log.advice_confidence) > 0 else "E"
