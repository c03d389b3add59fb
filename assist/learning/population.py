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

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.special import logit, ndtr

from planner.system.limits import Deadline
from planner.system.progress import Wanted, adding, shows_progress
from planner.system.results import Result

from ..declare.declared import DeclarationError, plain, spelt
from ..people.arguments import number
from ..people.decision import NOTHING, Floats
from ..people.ranges import Population, Range
from ..people.trust_rules import EquationSeven, Shipped, rule_of
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


@dataclass(frozen=True, eq=False, repr=False)
class Margin(Result):
    """The distribution of one parameter over people.

    Attributes
    ----------
    family : str
    parameters : tuple of float
        Parameters of the family: ends of the range, or location and scale (of the logarithm if log-normal).
    edges : tuple of float
        Edges of the cells.
    shares : tuple of float
        The probability of each cell.
    mean, spread : float
        Mean and standard deviation of the distribution.
    recorded : (float, float)
        Mean and standard deviation among the recorded people, from each person's posterior over the cells.
    """

    family: str
    parameters: tuple[float, ...]
    edges: tuple[float, ...]
    shares: tuple[float, ...]
    mean: float
    spread: float
    recorded: tuple[float, float]

    @classmethod
    def of(cls, family: str, parameters: tuple[float, ...], edges: Floats, shares: Floats, recorded: Floats) -> Margin:
        """Return the margin with means and spreads from the shares of cells, which are uniform within each cell."""
        low, high = edges[:-1], edges[1:]
        if family.endswith("uniform"):  # the ends of the range lie within cells
            ends = np.exp(parameters) if family == "log-uniform" else parameters
            low, high = np.clip(low, *ends), np.clip(high, *ends)

        def moments(weights: Floats) -> tuple[float, float]:
            mean = float(weights @ (low + high) / 2)
            square = float(weights @ (low * low + low * high + high * high) / 3)
            return mean, float(np.sqrt(max(square - mean**2, 0.0)))

        return cls(
            family, parameters, tuple(edges.tolist()), tuple(shares.tolist()), *moments(shares), moments(recorded)
        )

    def records(self) -> list[dict[str, Any]]:
        """Return a row for each cell: its ends, and its share of people."""
        return [
            {"low": low, "high": high, "share": share}
            for low, high, share in zip(self.edges, self.edges[1:], self.shares, strict=False)
        ]

    def pieces(self) -> list[tuple[float, Range]]:
        """Return the non-empty cells with their shares, without rare ones that sum to a thousandth."""
        if self.family == "uniform":
            return [(1.0, (self.parameters[0], self.parameters[1]))]
        order = np.argsort(self.shares)
        rare = set(order[np.cumsum(np.asarray(self.shares)[order]) < 1e-3].tolist())
        cells = zip(self.shares, self.edges, self.edges[1:], strict=False)
        kept = [(share, (low, high)) for i, (share, low, high) in enumerate(cells) if i not in rare]
        total = sum(share for share, _ in kept)
        return [(share / total, piece) for share, piece in kept]


@dataclass(frozen=True, eq=False, repr=False)
class PopulationFit(Result):
    """The estimated distribution of people.

    Attributes
    ----------
    people : int
        Number of people in the data.
    beta : Margin
    theta : Margin or None
        None without suggestions.
    eta : float or None
        Learning rate of the trust update, the same for all people; None if the data do not depend on it.
    log_likelihood : float
        Log-likelihood of all records.
    shares : float array, shape (B, T)
        The probability of each cell of (beta, theta).
    weights : mapping of str to (float, float)
        Mean and standard deviation of each term's weight; empty without terms.
    trust : dict, optional
        The trust rule, as `people.trust_rules.plain_rule` writes it, if it was fitted.
    utility_scale : float
        Unit of value in the trust update of which `eta` is the rate, in cost units.
    """

    people: int
    beta: Margin
    theta: Margin | None
    eta: float | None
    log_likelihood: float
    shares: Floats
    weights: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    trust: Mapping[str, Any] | None = None
    utility_scale: float = 1.0

    def __post_init__(self) -> None:
        self.shares.flags.writeable = False

    def __repr__(self) -> str:
        shown = [f"{row['parameter']} {row['mean']:.2f}" for row in self.records()]
        return f"<distribution of {self.people} people: mean {', '.join(shown)}>"

    def records(self) -> list[dict[str, Any]]:
        """Return a row for each parameter: its family, and mean and standard deviation over people."""
        rows: list[dict[str, Any]] = [
            {
                "parameter": name, "family": one.family, "mean": one.mean, "spread": one.spread,
                "recorded_mean": one.recorded[0], "recorded_spread": one.recorded[1],
            }
            for name, one in (("beta", self.beta), ("theta", self.theta)) if one is not None
        ]  # fmt: skip
        rows += [] if self.eta is None else [{"parameter": "eta", "mean": self.eta, "spread": 0.0}]
        return rows + [{"parameter": name, "mean": a, "spread": b} for name, (a, b) in self.weights.items()]

    def population(self, sigma: Range = (0.0, 0.0), theta: Range = (0.5, 0.95)) -> Population:
        """Return the population from which people can be drawn.

        Parameters
        ----------
        sigma : (float, float)
            Range of people's misconceptions.
        theta : (float, float)
            Range of influence if the data have no suggestions; by default the paper's.
        """
        heard = [(1.0, theta)] if self.theta is None else self.theta.pieces()
        if self.beta.family == "histogram" and self.theta is not None:  # beta and theta may depend on each other
            pieces = [
                (float(self.shares[b, t]), beta, (self.theta.edges[t], self.theta.edges[t + 1]))
                for b, beta in enumerate(zip(self.beta.edges, self.beta.edges[1:], strict=False))
                for t in range(self.shares.shape[1])
                if self.shares[b, t] > 1e-6
            ]
        else:
            pieces = [(a * b, beta, span) for a, beta in self.beta.pieces() for b, span in heard]
        total = sum(share for share, _, _ in pieces)
        # Uniform, with the mean and the standard deviation that weights have.
        ranges = {
            name: (mean - math.sqrt(3) * spread, mean + math.sqrt(3) * spread)
            for name, (mean, spread) in self.weights.items()
        }
        parts = tuple(Population(beta, span, sigma, weights=ranges) for _, beta, span in pieces)
        return Population.mixed(parts, tuple(share / total for share, _, _ in pieces))

    def as_dict(self, sigma: Range = (0.0, 0.0)) -> dict[str, Any]:
        """Return the results as plain data, including the population."""
        mixture = self.population(sigma)
        return {
            "people": self.people,
            "beta": asdict(self.beta),
            "theta": None if self.theta is None else asdict(self.theta),
            "eta": self.eta,
            **({} if self.eta is None or self.utility_scale == 1 else {"utility_scale": self.utility_scale}),
            "log_likelihood": self.log_likelihood,
            **({"weights": {name: list(one) for name, one in self.weights.items()}} if self.weights else {}),
            **({} if self.trust is None else {"trust": dict(self.trust)}),
            "parts": [
                {"share": share, **plain(part)} for share, part in zip(mixture.shares, mixture.parts, strict=True)
            ],
        }


def mixture(record: dict[str, Any]) -> Population:
    """Return the population of a `PopulationFit.as_dict`.

    Parameters
    ----------
    record : dict
        A record, as `fit --write-population` writes it.

    Raises
    ------
    ValueError
        It is no such record.
    """
    try:
        parts, shares = [], []
        for part in record["parts"]:
            (b, c), (t, u), (v, w) = (part[name] for name in ("beta", "theta", "sigma"))
            weights = {name: (float(low), float(high)) for name, (low, high) in part.get("weights", {}).items()}
            parts.append(Population((float(b), float(c)), (float(t), float(u)), (float(v), float(w)), weights=weights))
            shares.append(float(part["share"]))
        return Population.mixed(tuple(parts), tuple(shares))
    except (KeyError, TypeError, AttributeError) as error:
        what = f"{error} is missing" if isinstance(error, KeyError) else f"{error}"
        raise ValueError(f"expected a population as `kitassist fit --write-population` writes it ({what})") from None


def trust_of(record: dict[str, Any]) -> Shipped | None:
    """Return the trust rule of a `PopulationFit.as_dict`; None if none was fitted.

    Raises
    ------
    ValueError
        The entry is no trust rule.
    """
    plain = record.get("trust")
    if plain is None:
        return None
    if not isinstance(plain, dict):
        raise ValueError(f"trust {plain!r}; expected an object as `fit --write-population` writes it")  # noqa: TRY004
    try:
        return rule_of(plain)
    except DeclarationError as error:
        raise ValueError(f"{spelt(('trust', *error.place))}: {error.told}") from None


def rate_of(record: dict[str, Any]) -> dict[str, float]:
    """Return the rate of the trust update of a `PopulationFit.as_dict`, with its unit; empty if none was estimated.

    Raises
    ------
    ValueError
        An entry is no number.
    """
    if record.get("eta") is None:
        return {}
    found = {"eta": record["eta"], "utility_scale": record.get("utility_scale", 1.0)}
    return {name: number(name, value) for name, value in found.items()}


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
    """Return the population of the hierarchical model.

    Parameters
    ----------
    found : Hierarchy
    """
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
    both = zip(found.mean[FIRST_TERM:].tolist(), found.spread[FIRST_TERM:].tolist(), strict=True)
    weights = dict(zip(likelihood.terms, both, strict=True))
    return PopulationFit(
        len(likelihood.people), margins[0], margins[1] if told else None, likelihood.eta if told else None,
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
