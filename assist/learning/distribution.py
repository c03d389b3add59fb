"""The distribution of beta and theta over people: its margins, and the population that is drawn or read from a file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from planner.system.results import Result

from ..declare.declared import DeclarationError, plain, spelt
from ..people.arguments import number
from ..people.decision import Floats
from ..people.ranges import Population, Range
from ..people.trust_rules import RULES, TrustRule, of_table


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

    @property
    def ends(self) -> Range | None:
        """The ends of the range of a uniform or log-uniform distribution; None for another family."""
        return _ends(self.family, self.parameters)

    @classmethod
    def of(cls, family: str, parameters: tuple[float, ...], edges: Floats, shares: Floats, recorded: Floats) -> Margin:
        """Return the margin with means and spreads from the shares of cells, which are uniform within each cell."""
        low, high = edges[:-1], edges[1:]
        if (ends := _ends(family, parameters)) is not None:  # which lie within cells
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


def _ends(family: str, parameters: tuple[float, ...]) -> Range | None:
    if not family.endswith("uniform"):
        return None
    low, high = np.exp(parameters) if family == "log-uniform" else parameters
    return float(low), float(high)


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
        Mean and standard deviation of each term's weight; empty without terms. A term in which no choices of the log
        differ has none.
    trust : dict, optional
        The trust rule, as `people.trust_rules.plain_rule` writes it, if it was fitted.
    utility_scale : float
        Unit of value in the trust update of which `eta` is the rate, in cost units.
    unidentified : tuple of str
        Parameters of the trust rule that the data say nothing about, so that their values are any that were tried.
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
    unidentified: tuple[str, ...] = ()

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
            **({"unidentified": list(self.unidentified)} if self.unidentified else {}),
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
        parts = [dict(part) for part in record["parts"]]
        shares = tuple(part.pop("share") for part in parts)
        written = ({**part, **{name: part[name] for name in ("beta", "theta", "sigma")}} for part in parts)
        return Population.mixed(tuple(Population(**part) for part in written), shares)
    except (KeyError, TypeError, ValueError) as error:
        what = f"{error} is missing" if isinstance(error, KeyError) else f"{error}"
        raise ValueError(f"expected a population as `kitassist fit --write-population` writes it ({what})") from None


def trust_of(record: dict[str, Any]) -> TrustRule | None:
    """Return the trust rule of a `PopulationFit.as_dict`; None if none was fitted."""
    plain = record.get("trust")
    if plain is None:
        return None
    if not isinstance(plain, dict):
        raise ValueError(f"trust {plain!r}; expected an object as `fit --write-population` writes it")  # noqa: TRY004
    try:
        return of_table(RULES, plain)
    except DeclarationError as error:
        raise ValueError(f"{spelt(('trust', *error.place))}: {error.told}") from None


def unidentified_of(record: dict[str, Any]) -> dict[str, float]:
    """Return the parameters of the trust rule of a `PopulationFit.as_dict` that are not known, with their values."""
    names, trust = record.get("unidentified") or [], record.get("trust")
    if not isinstance(names, list) or (names and not isinstance(trust, dict)):
        raise ValueError(f"unidentified {names!r}; expected names of numbers in trust")
    return {str(name): number(f"trust: {name}", trust.get(name)) for name in names}  # type: ignore[union-attr]


def rate_of(record: dict[str, Any]) -> dict[str, float]:
    """Return the rate of the trust update of a `PopulationFit.as_dict`, with its unit; empty if none was estimated."""
    if record.get("eta") is None:
        return {}
    found = {"eta": record["eta"], "utility_scale": record.get("utility_scale", 1.0)}
    return {name: number(name, value) for name, value in found.items()}
