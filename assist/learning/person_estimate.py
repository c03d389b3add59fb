"""The results for one person: estimates, a check of the model, and misconceptions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from planner.system.results import Result

from ..people.decision import NOTHING
from .diagnostics import Check
from .intervals import Interval
from .maximum_likelihood import Estimate, Fit
from .misconception_fit import MisconceptionFit
from .observations import Ints


@dataclass(frozen=True, eq=False, repr=False)
class PersonEstimate(Result):
    """The results for one person.

    A parameter that the data do not identify is None, and its interval is the whole range. Without suggestions, theta
    and eta have no interval; eta has none if it was given. With terms, the model is hierarchical, so that every person
    has estimates.

    Attributes
    ----------
    fit : Fit
    check : Check
    misconception : MisconceptionFit or None
    left_out : int
        Number of excluded actions, for which the cost-to-go after some choice is unknown.
    """

    fit: Fit
    check: Check
    misconception: MisconceptionFit | None = None
    left_out: int = 0

    def __str__(self) -> str:
        """Return the person and the estimates of beta and theta, if the actions say something about them."""
        known = {"beta": self.beta, "theta": self.theta}
        found = [f"{name} {value:.2f}" for name, value in known.items() if value is not None]
        return f"{self.person} ({', '.join([*found, f'{self.actions} actions'])})"

    def __repr__(self) -> str:
        return f"<estimates of {self}>"

    def records(self) -> list[dict[str, Any]]:
        """Return one row: estimates with the ends of their intervals, numbers of actions, and the model check."""
        whole = self.as_dict()
        row: dict[str, Any] = {"person": self.person}
        for name in ("beta", "theta", "eta"):
            row |= _columns(name, whole[name], whole[f"{name}_interval"])
        for name, value in self.weights.items():
            row |= _columns(name, value, list(self.weights_interval[name]))
        if self.misconception is not None:
            row |= _columns("sigma", self.misconception.sigma, list(self.misconception.interval))
        counts = ("episodes", "actions", "suboptimal_actions", "suggestions", "followed")
        return [row | {name: whole[name] for name in counts} | {"p": self.check.p, "notes": "; ".join(self.notes)}]

    @property
    def person(self) -> str:
        """The name of the person."""
        return self.fit.observations.person

    @property
    def beta(self) -> float | None:
        """Expertise, per cost unit."""
        return _value(self.fit.beta, self.fit)

    @property
    def beta_interval(self) -> Interval:
        """All values of beta that are not rejected."""
        return self.fit.beta.interval

    @property
    def theta(self) -> float | None:
        """Influence of the robot at the beginning of an episode."""
        return _value(self.fit.theta, self.fit)

    @property
    def theta_interval(self) -> Interval | None:
        """All values of theta that are not rejected."""
        return None if self.fit.theta is None else self.fit.theta.interval

    @property
    def eta(self) -> float | None:
        """Learning rate of the trust update."""
        return _value(self.fit.eta, self.fit)

    @property
    def eta_interval(self) -> Interval | None:
        """All values of eta that are not rejected."""
        return None if self.fit.eta is None else self.fit.eta.interval

    @property
    def weights(self) -> dict[str, float]:
        """Weights of the terms, by name."""
        return {name: estimate.value for name, estimate in self.fit.weights.items()}

    @property
    def weights_interval(self) -> dict[str, Interval]:
        """All values of each weight that are not rejected."""
        return {name: estimate.interval for name, estimate in self.fit.weights.items()}

    @property
    def actions(self) -> int:
        """The number of actions that were used."""
        return len(self.fit.observations)

    @property
    def suboptimal_actions(self) -> int:
        """The number of actions that were not optimal choices."""
        return self.fit.observations.suboptimal

    @property
    def notes(self) -> list[str]:
        """Remarks on the reliability of the estimates."""
        o, beta = self.fit.observations, self.fit.beta
        notes = []
        if self.left_out:
            notes.append(f"{self.left_out} actions are left out, since states were not evaluated in time")
        if not beta.identified:
            notes.append("these actions say nothing about beta")
        elif beta.open_above:
            told = "made no mistake" if o.suboptimal == 0 else "made hardly any mistake"
            notes.append(
                f"{told}: beta is at least {beta.interval[0]:.2g}, and {beta.interval[1]:.3g} is where the search ends"
            )
        elif beta.open_below:
            notes.append("the actions may be random: the interval of beta includes 0")
        others = [("theta", self.fit.theta), ("eta", self.fit.eta)]
        others += [(f"the weight of {name}", estimate) for name, estimate in self.fit.weights.items()]
        for name, estimate in others:
            if estimate is not None and not estimate.identified:
                notes.append(f"these actions say nothing about {name}")
        if self.check.p is not None and self.check.p < 0.01:
            notes.append(f"the model does not fit (p = {self.check.p:.3f}): {_words(self.check)}")
        return notes

    def as_dict(self, facts: Callable[[Ints], list[list[str]]] | None = None) -> dict[str, Any]:
        """Return the results as plain data.

        Parameters
        ----------
        facts : callable, optional
            Returns the facts that hold in states, shape (M,), for the states of a misconception.
        """
        o = self.fit.observations
        told = o.suggested != NOTHING
        record: dict[str, Any] = {"person": o.person}
        for name, estimate in (("beta", self.fit.beta), ("theta", self.fit.theta), ("eta", self.fit.eta)):
            record |= _estimate(name, estimate, self.fit)
        if self.fit.weights:
            record |= {
                "weights": self.weights,
                "weights_interval": {name: list(ends) for name, ends in self.weights_interval.items()},
                "weights_open": {name: _open(estimate) for name, estimate in self.fit.weights.items()},
            }
        record |= {
            "episodes": len(o.episodes),
            "actions": len(o),
            "suboptimal_actions": o.suboptimal,
            "suggestions": int(told.sum()),
            "followed": int((o.chosen[told] == o.suggested[told]).sum()),
            "log_likelihood": self.fit.log_likelihood,
            "check": {"p": self.check.p, **self.check.scores},
        }
        if self.misconception is not None:
            record["misconception"] = _misconception(self.misconception, facts)
        if o.goals is not None:
            record["goals"] = self.fit.goal_posteriors()
        return record | {"left_out": self.left_out, "notes": self.notes, "error": None}


def nothing_known(person: str, error: str, left_out: int = 0) -> dict[str, Any]:
    """Return the record, as plain data, of a person without usable actions, with the reason."""
    record: dict[str, Any] = {"person": person}
    for name in ("beta", "theta", "eta"):
        record |= _estimate(name, None)
    return record | {
        "episodes": 0, "actions": 0, "suboptimal_actions": None, "suggestions": 0, "followed": 0,
        "log_likelihood": None, "check": None, "left_out": left_out, "notes": [], "error": error,
    }  # fmt: skip


def _columns(name: str, value: float | None, interval: list[float] | None) -> dict[str, float | None]:
    low, high = interval or (None, None)
    return {name: value, f"{name}_low": low, f"{name}_high": high}


def _value(estimate: Estimate | None, fit: Fit) -> float | None:
    return None if estimate is None or not (estimate.identified or fit.weights) else estimate.value


def _open(estimate: Estimate) -> list[str]:
    return [side for side, is_open in (("below", estimate.open_below), ("above", estimate.open_above)) if is_open]


def _estimate(name: str, estimate: Estimate | None, fit: Fit | None = None) -> dict[str, Any]:
    if estimate is None or fit is None:
        return {name: None, f"{name}_interval": None, f"{name}_open": None}
    return {name: _value(estimate, fit), f"{name}_interval": list(estimate.interval), f"{name}_open": _open(estimate)}


def _misconception(m: MisconceptionFit, facts: Callable[[Ints], list[list[str]]] | None) -> dict[str, Any]:
    shown = [{}] * len(m.states) if facts is None else [{"facts": held} for held in facts(m.states)]
    return {
        "sigma": m.sigma,
        "sigma_interval": list(m.interval),
        "sigma_open": ["above"] * m.open_above,
        "beta": m.beta,
        "log_likelihood": m.log_likelihood,
        "log_likelihood_without": m.without,
        "states": [
            {"cost_to_go": float(h), "perceived": float(own), "seen": int(seen), **held}
            for h, own, seen, held in zip(m.cost_to_go, m.perceived, m.seen, shown, strict=True)
        ],
    }


def _words(found: Check) -> str:
    term = found.striking
    score = found.scores[term] or 0.0 if term is not None else 0.0
    return {
        "repetition": "choices are repeated more often than chance has it, as by habit or misconception"
        if score > 0
        else "choices in a state are changed more often than chance has it",
        "large_mistakes": "there are more large mistakes than the small ones suggest"
        if score > 0
        else "there are fewer large mistakes than the small ones suggest",
        "learning": "there are fewer mistakes in later actions"
        if score > 0
        else "there are more mistakes in later actions",
    }.get(term or "", "choices are not those of one beta")
