"""The distribution of beta and theta over people, estimated from their actions by empirical Bayes.

Each person's likelihood L_k is evaluated in the cells of a grid over (beta, theta). A distribution is a share of each
cell. The estimate maximises the likelihood of all records:

    sum over people k of log( sum over cells g of share(g) L_k(g) ).

It is restricted to families, truncated at the ends of the grid: beta is uniform or log-uniform on a range, or
log-normal; theta is uniform on a range, or normal. Or it is unrestricted ("histogram", Laird 1978). The result is a
`Population`, from which people can be drawn.

The recorded people are a sample that differs from the distribution by chance. `Margin.mean` and `spread` are those of
the distribution; `Margin.recorded` are those of the sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import compress
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.special import logit, ndtr

from planner.system.limits import Deadline
from planner.system.progress import Wanted, adding, shows_progress

from ..people.decision import NOTHING, Floats
from ..people.trust_rules import EquationSeven
from .distribution import Margin, PopulationFit
from .evidence import Evidence, observations_of
from .hierarchy import Hierarchy
from .intervals import largest_fall
from .likelihood import Method, largest_beta
from .likelihood_table import LikelihoodTable
from .logit_likelihood import BETA, FIRST_TERM, THETA
from .observations import Observations

BETA_FAMILIES = ("uniform", "log-uniform", "log-normal")
CELLS = (48, 25)  # of beta and theta
ETAS = 21  # values of eta that are tried from 0 to 1


@shows_progress
def fit_population(
    observations: Evidence | Sequence[Observations],
    method: Method | None = None,
    *,
    family: str | None = None,
    time_limit: float | None = None,
    progress: Wanted = None,
) -> PopulationFit:
    """Return the estimated distribution of beta and theta over people.

    Parameters
    ----------
    observations : Evidence, or sequence of Observations
        A log that was replayed; or one for each person.
    method : Method, optional
        If its eta is None, one rate for all people is estimated.
    family : str, optional
        "histogram", or one of beta's families; by default the family with the largest likelihood.
    time_limit : float, optional
        Seconds after which no further rate or family is tried, and a `LimitError` says how far the search came.
    progress : callable or bool, optional
        Receives progress reports, as `planner.system.progress` describes: the number of rates tried.
    """
    assert callable(progress)
    method, observations, ends = method or Method(), observations_of(observations), Deadline.after(time_limit)
    if not observations:
        raise ValueError("a population needs people; there are no observations")
    if family not in (None, "histogram", *BETA_FAMILIES):
        raise ValueError(f"unknown family '{family}'; expected histogram or one of {', '.join(BETA_FAMILIES)}")
    largest = largest_beta(observations, method)
    told = any((o.suggested != NOTHING).any() for o in observations)
    edges_beta = largest * np.expm1(np.linspace(0, np.log1p(100.0), CELLS[0] + 1)) / 100.0
    edges_theta = np.linspace(0.0, 1.0, CELLS[1] + 1)
    beta = (edges_beta[1:] + edges_beta[:-1]) / 2
    theta = (edges_theta[1:] + edges_theta[:-1]) / 2 if told else np.array([0.5])

    every = LikelihoodTable.of(observations, method, beta, theta)

    def likelihoods(eta: float) -> tuple[Floats, float]:
        """Return the likelihood of each person in each cell up to a factor, and the factors' logarithms."""
        values = every.log_likelihood(EquationSeven(eta, method.utility_scale), carry=False)
        top = values.max(axis=(1, 2), keepdims=True)
        return np.exp(values - top), float(top.sum())

    eta = method.eta if told else 0.0
    known = told
    if eta is None:
        rates = np.linspace(0.0, 1.0, ETAS)
        advance = adding(progress, "fitting the population", ETAS)
        scores = list[float]()
        for rate in rates:
            ends.check(f"{len(scores)} of {ETAS} rates of trust")
            table, top = likelihoods(float(rate))
            scores.append(_free(table, 30)[1] + top)
            advance(1)
        eta = _summit(rates, np.array(scores))
        known = max(scores) - min(scores) > largest_fall(method.level)
    table, top = likelihoods(eta)
    if family == "histogram":
        shares, score = _free(table, 2000)
        names, values = ("histogram", "histogram"), np.empty(0)
    else:
        pairs = [
            (one, other)
            for one in (BETA_FAMILIES if family is None else (family,))
            for other in (("uniform", "normal") if told else ("none",))
        ]
        found = list[Any]()
        for pair in pairs:
            ends.check(f"{len(found)} of {len(pairs)} families of distributions")
            found.append(_families(table, pair, (edges_beta, edges_theta)))
        score, names, values = max(found, key=lambda result: result[0])
        parts = [_cells(names[0], values[:2], edges_beta), _cells(names[1], values[2:], edges_theta)]
        shares = np.outer(parts[0], parts[1] if told else [1.0])
    own = table * shares  # of each person
    own /= own.sum(axis=(1, 2), keepdims=True)
    recorded = own.mean(axis=0)
    margins = [
        Margin.of(
            names[k], tuple(values[2 * k : 2 * k + 2].tolist()), (edges_beta, edges_theta)[k],
            shares.sum(axis=1 - k), recorded.sum(axis=1 - k),
        )
        for k in range(1 + told)
    ]  # fmt: skip
    return PopulationFit(
        len(observations), margins[0], margins[1] if told else None, eta if known else None, score + top, shares,
        utility_scale=method.utility_scale,
    )  # fmt: skip


def population_of(found: Hierarchy) -> PopulationFit:
    """Return the population of the hierarchical model."""
    likelihood, told = found.likelihood, found.likelihood.steps.told
    ranges = likelihood.ranges
    edges = (
        np.linspace(0.0, ranges.high[BETA], CELLS[0] + 1),
        np.clip(logit(np.linspace(0.0, 1.0, CELLS[1] + 1)), ranges.low[THETA], ranges.high[THETA]),
    )
    margins, cells = [], []
    for axis, family, value in ((BETA, "log-normal", ranges.beta), (THETA, "logit-normal", ranges.theta)):
        mean, spread = float(found.mean[axis]), float(found.spread[axis])
        cells.append(_within(edges[axis], mean, spread))
        recorded = _within(edges[axis], found.at[:, axis, None], found.deviation[:, axis, None]).mean(axis=0)
        margins.append(Margin.of(family, (mean, spread), value(edges[axis]), cells[axis], recorded))
    known = told and (found.rate is None or found.rate.identified)
    both = zip(found.mean[FIRST_TERM:].tolist(), found.spread[FIRST_TERM:].tolist(), strict=True)
    weights = dict(compress(zip(likelihood.terms, both, strict=True), ranges.told_apart[FIRST_TERM:].tolist()))
    return PopulationFit(
        len(likelihood.people), margins[0], margins[1] if told else None, likelihood.eta if known else None,
        found.evidence, np.outer(cells[0], cells[1] if told else [1.0]), weights,
    )  # fmt: skip


def _within(edges: Floats, mean: Floats | float, spread: Floats | float) -> Floats:
    """Return the share of each cell under a normal distribution, truncated at the ends of the cells."""
    shares = np.diff(ndtr((edges - mean) / spread), axis=-1)
    return np.asarray(shares / np.maximum(shares.sum(axis=-1, keepdims=True), 1e-300), dtype=np.float64)


def _summit(x: Floats, y: Floats) -> float:
    """Return the maximum of the parabola through the largest value and its neighbours."""
    k = int(y.argmax())
    if k in (0, len(x) - 1):
        return float(x[k])
    a, b, c = y[k - 1 : k + 2]
    bend = a - 2 * b + c
    return float(x[k] + (0.0 if bend == 0 else (a - c) / (2 * bend) * (x[1] - x[0])))


def _free(table: Floats, rounds: int) -> tuple[Floats, float]:
    """Return the shares, shape (B, T), of largest likelihood by the EM algorithm from equal shares, and the score."""
    flat = table.reshape(len(table), -1)
    shares = np.full(flat.shape[1], 1 / flat.shape[1])
    for _ in range(rounds):
        mixed = flat @ shares
        shares = shares * ((1 / mixed) @ flat) / len(flat)
    return shares.reshape(table.shape[1:]), float(np.log(flat @ shares).sum())


def _cells(family: str, parameters: Floats, edges: Floats) -> Floats:
    """Return the probability of each cell under a family, truncated at the ends of the cells."""
    if family == "none":
        return np.ones(1)
    first, second = parameters
    with np.errstate(divide="ignore"):
        at = np.log(edges) if family.startswith("log-") else edges
    if family.endswith("uniform"):
        cumulated = np.clip((at - first) / max(second - first, 1e-9), 0.0, 1.0)
    else:
        cumulated = ndtr((at - first) / second)
    shares = np.diff(cumulated)
    return shares / max(shares.sum(), 1e-300)


def _families(
    table: Floats, families: tuple[str, str], edges: tuple[Floats, Floats]
) -> tuple[float, tuple[str, str], Floats]:
    """Return the best score, families and parameters over the parameters of a pair of families."""
    free, _ = _free(table, 30)  # where to begin

    def parameters(x: Floats) -> Floats:
        result = np.zeros(4)
        for k, family in enumerate(families):
            first, second = x[2 * k : 2 * k + 2]
            if family.endswith("uniform"):
                span = np.log(edges[k][1:]) if family == "log-uniform" else edges[k]
                ends = np.sort(np.clip([first, second], span[0], span[-1]))
                result[2 * k : 2 * k + 2] = ends
            else:
                span = np.log(edges[k][1:]) if family == "log-normal" else edges[k]
                result[2 * k : 2 * k + 2] = np.clip(first, span[0], span[-1]), np.clip(np.exp(second), 1e-3, 3.0)
        return result

    def cost(x: Floats) -> float:
        values = parameters(x)
        mixed = table @ _cells(families[1], values[2:], edges[1]) @ _cells(families[0], values[:2], edges[0])
        return -float(np.log(np.maximum(mixed, 1e-300)).sum())

    start = np.zeros(4)
    for k, family in enumerate(families):
        if family == "none":
            continue
        middle = (edges[k][1:] + edges[k][:-1]) / 2
        at = np.log(middle) if family.startswith("log-") else middle
        shares = free.sum(axis=1 - k)
        mean = shares @ at
        spread = max(np.sqrt(shares @ (at - mean) ** 2), 1e-2)
        flat = family.endswith("uniform")
        start[2 * k : 2 * k + 2] = (mean - 1.7 * spread, mean + 1.7 * spread) if flat else (mean, np.log(spread))
    moves = np.vstack([np.zeros(4), np.diag([0.2 * max(abs(s), 0.3) for s in start])])
    best = minimize(
        cost, start, method="Nelder-Mead",
        options={"initial_simplex": start + moves, "maxiter": 2000, "xatol": 1e-4, "fatol": 1e-4},
    )  # fmt: skip
    again = minimize(cost, best.x, method="Nelder-Mead", options={"maxiter": 2000, "xatol": 1e-4, "fatol": 1e-5})
    return -float(again.fun), families, parameters(again.x)
