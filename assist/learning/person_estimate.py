"""What is estimated of one person: parameters with intervals, a check of the model, and misconceptions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from planner import CostToGo
from planner.system.arrays import read_only
from planner.system.results import Result

from ..people.decision import NOTHING, Floats, choice, influence, lapse, trust
from .intervals import Interval
from .likelihood import Data, Method
from .likelihood_arrays import goal_posteriors
from .observations import Ints, Observations

PARAMETERS = ("beta", "theta", "eta")
CHECKED = ("repetition", "large_mistakes", "learning")
"""Terms of the model check; see `diagnostics`."""


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

    @property
    def open(self) -> list[str]:
        """The sides on which it is open."""
        return ["below"] * self.open_below + ["above"] * self.open_above


@dataclass(frozen=True)
class Check:
    """The result of the model check for one person.

    Attributes
    ----------
    p : float or None
        p-value over all terms; None if the test has no power (almost no mistakes, or hardly any alternatives).
    scores : dict of str to (float or None)
        Score of each term, in standard deviations. Positive scores mean more repetition, more large mistakes, or fewer
        mistakes in later actions.
    """

    p: float | None
    scores: dict[str, float | None]

    @property
    def striking(self) -> str | None:
        """The term with the largest absolute score; None without scores."""
        known = {term: abs(score) for term, score in self.scores.items() if score is not None}
        return max(known, key=lambda term: known[term]) if known else None


UNCHECKED = Check(None, dict.fromkeys(CHECKED))
"""Check of a person to whom the test does not apply."""


@dataclass(frozen=True, eq=False, repr=False)
class MisconceptionFit(Result):
    """The estimated misconception of a person.

    Attributes
    ----------
    sigma : float
        Standard deviation, in cost units.
    interval : (float, float)
        Interval by the profile likelihood.
    open_above : bool
        Whether the interval ends at the end of the search, `Method.largest_sigma`.
    beta : float
        Expertise in the model with misconceptions; it is at least that of the plain model.
    log_likelihood, without : float
        Marginal log-likelihood at these values, and the largest one for sigma = 0.
    states : int array, shape (M,)
        States on whose perceived cost-to-go the person's choices depend, ascending.
    cost_to_go, perceived : float arrays, shape (M,)
        h* of these states, and the mode of h.
    seen : int array, shape (M,)
        Number of steps in which each state was an alternative.
    """

    sigma: float
    interval: tuple[float, float]
    open_above: bool
    beta: float
    log_likelihood: float
    without: float
    states: Ints
    cost_to_go: Floats
    perceived: Floats
    seen: Ints

    def __post_init__(self) -> None:
        read_only(self)

    def records(self) -> list[dict[str, Any]]:
        """Return a row for each state: h*, the perceived cost-to-go, and how often the state was an alternative."""
        return [
            {"state": state, "cost_to_go": h, "perceived": own, "seen": seen}
            for state, h, own, seen in zip(
                self.states.tolist(), self.cost_to_go.tolist(), self.perceived.tolist(), self.seen.tolist(), strict=True
            )
        ]

    def as_dict(self, costs: CostToGo | None = None) -> dict[str, Any]:
        """Return the estimates as plain data, with the facts that hold in each state if the task's costs are given."""
        states = [{name: row[name] for name in ("cost_to_go", "perceived", "seen")} for row in self.records()]
        if costs is not None:
            held = map(costs.task.facts, costs.values(self.states).tolist())
            states = [row | {"facts": facts} for row, facts in zip(states, held, strict=True)]
        return {
            "sigma": self.sigma, "sigma_interval": list(self.interval), "sigma_open": ["above"] * self.open_above,
            "beta": self.beta, "log_likelihood": self.log_likelihood, "log_likelihood_without": self.without,
            "states": states,
        }  # fmt: skip


@dataclass(frozen=True, eq=False, repr=False)
class PersonEstimate(Result):
    """The estimates of one person.

    A parameter that the data do not identify is None, and its interval is the whole range. Without suggestions, theta
    and eta have no interval; eta has none if it was given. With terms, the model is hierarchical, so that every person
    has estimates.

    Attributes
    ----------
    observations : Observations
    estimates : mapping of str to Estimate
        Of expertise beta, per cost unit; with suggestions also of influence theta at the beginning of an episode and,
        unless it was given, of the rate eta of the trust update; and of the weight of each term.
    log_likelihood : float
        Value at the estimates, including lapses.
    known_eta : float or None
        The given rate.
    method : Method
        Options of the estimation.
    check : Check
        The check of the model.
    misconception : MisconceptionFit or None
    left_out : int
        Number of excluded actions, for which the cost-to-go after some choice is unknown.
    """

    observations: Observations
    estimates: Mapping[str, Estimate]
    log_likelihood: float
    known_eta: float | None
    method: Method
    check: Check = UNCHECKED
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
        found = {name: (whole[name], whole[f"{name}_interval"]) for name in PARAMETERS}
        found |= {name: (value, self.weights_interval[name]) for name, value in self.weights.items()}
        if self.misconception is not None:
            found["sigma"] = (self.misconception.sigma, self.misconception.interval)
        row: dict[str, Any] = {"person": self.person}
        for name, (value, interval) in found.items():
            low, high = interval or (None, None)
            row |= {name: value, f"{name}_low": low, f"{name}_high": high}
        counts = ("episodes", "actions", "suboptimal_actions", "suggestions", "followed")
        return [row | {name: whole[name] for name in counts} | {"p": self.check.p, "notes": "; ".join(self.notes)}]

    def _value(self, name: str) -> float | None:
        found = self.estimates.get(name)
        return found.value if found is not None and (found.identified or self.observations.terms) else None

    def _interval(self, name: str) -> Interval | None:
        return self.estimates[name].interval if name in self.estimates else None

    @property
    def _of_terms(self) -> dict[str, Estimate]:
        return {name: self.estimates[name] for name in self.observations.terms if name in self.estimates}

    @property
    def person(self) -> str:
        """The name of the person."""
        return self.observations.person

    @property
    def beta(self) -> float | None:
        """Expertise, per cost unit."""
        return self._value("beta")

    @property
    def beta_interval(self) -> Interval:
        """All values of beta that are not rejected."""
        return self.estimates["beta"].interval

    @property
    def theta(self) -> float | None:
        """Influence of the robot at the beginning of an episode."""
        return self._value("theta")

    @property
    def theta_interval(self) -> Interval | None:
        """All values of theta that are not rejected."""
        return self._interval("theta")

    @property
    def eta(self) -> float | None:
        """Learning rate of the trust update."""
        return self._value("eta")

    @property
    def eta_interval(self) -> Interval | None:
        """All values of eta that are not rejected."""
        return self._interval("eta")

    @property
    def rate(self) -> float:
        """The learning rate that was estimated or given; 0 if there is none."""
        return self.estimates["eta"].value if "eta" in self.estimates else self.known_eta or 0.0

    @property
    def weights(self) -> dict[str, float]:
        """Weights of the terms, by name."""
        return {name: estimate.value for name, estimate in self._of_terms.items()}

    @property
    def weights_interval(self) -> dict[str, Interval]:
        """All values of each weight that are not rejected."""
        return {name: estimate.interval for name, estimate in self._of_terms.items()}

    @property
    def actions(self) -> int:
        """The number of actions that were used."""
        return len(self.observations)

    @property
    def suboptimal_actions(self) -> float:
        """The number of actions that were not optimal choices; with several goals, its mean over their posterior."""
        o = self.observations
        if not o.goals.distinguished:
            return o.suboptimal
        shares = np.array([list(each.values()) for each in self.goal_posteriors().values()])  # (episodes, G)
        return float((shares[o.begins.cumsum() - 1].T * o.mistakes_by_goal).sum())

    def probabilities(self) -> Floats:
        """Return the probability of each choice at the estimates, shape (N, A), including lapses."""
        o = self.observations
        bias = o.features @ np.array([weight.value for weight in self._of_terms.values()]) if o.terms else None
        if o.own is not None:
            p = o.own.at(self.estimates["beta"].value)
        else:
            p = choice(o.excess, o.applicable, np.full(len(o), self.estimates["beta"].value), bias)
        return lapse(influence(p, o.suggested, self.thetas()), o.applicable, self.method.lapse)

    def goal_posteriors(self) -> dict[str, dict[str, float]]:
        """Return the probability of each goal in each episode at the estimates; empty if the goal is known."""
        o, goals = self.observations, self.observations.goals
        if not goals.distinguished:
            return {}
        theta = self.estimates["theta"].value if "theta" in self.estimates else 0.5
        found = goal_posteriors(Data.of(o, self.method), self.estimates["beta"].value, theta, self.rate).tolist()
        return {
            name: dict(zip(goals.names, shares, strict=True)) for name, shares in zip(o.episodes, found, strict=True)
        }

    def thetas(self) -> Floats:
        """Return theta before each step at the estimates, shape (N,); 0.5 everywhere without suggestions."""
        o, found = self.observations, np.full(len(self.observations), 0.5)
        if "theta" not in self.estimates:
            return found
        first = theta = self.estimates["theta"].value
        for i, (begins, gain) in enumerate(zip(o.begins.tolist(), o.gain.tolist(), strict=True)):
            found[i] = theta = first if begins else theta
            theta = float(trust(theta, 0.0, gain, self.rate, self.method.utility_scale)) if gain else theta
        return found

    @property
    def notes(self) -> list[str]:
        """Remarks on the reliability of the estimates."""
        o, beta = self.observations, self.estimates["beta"]
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
        for name, estimate in self.estimates.items():
            if name != "beta" and not estimate.identified:
                of_what = f"the weight of {name}" if name in o.terms else name
                notes.append(f"these actions say nothing about {of_what}")
        if self.check.p is not None and self.check.p < 0.01:
            notes.append(f"the model does not fit (p = {self.check.p:.3f}): {_words(self.check)}")
        return notes

    def as_dict(self, costs: CostToGo | None = None) -> dict[str, Any]:
        """Return the results as plain data; with the task's costs, states of a misconception have their facts."""
        o = self.observations
        told = o.suggested != NOTHING
        record: dict[str, Any] = {"person": o.person}
        for name in PARAMETERS:
            one = self.estimates.get(name)
            ends, sides = (None, None) if one is None else (list(one.interval), one.open)
            record |= {name: self._value(name), f"{name}_interval": ends, f"{name}_open": sides}
        if o.terms:
            record |= {
                "weights": self.weights,
                "weights_interval": {name: list(ends) for name, ends in self.weights_interval.items()},
                "weights_open": {name: estimate.open for name, estimate in self._of_terms.items()},
            }
        record |= {
            "episodes": len(o.episodes), "actions": len(o), "suboptimal_actions": self.suboptimal_actions,
            "suggestions": int(told.sum()), "followed": int((o.chosen[told] == o.suggested[told]).sum()),
            "log_likelihood": self.log_likelihood, "check": {"p": self.check.p, **self.check.scores},
        }  # fmt: skip
        if self.misconception is not None:
            record["misconception"] = self.misconception.as_dict(costs)
        if o.goals.distinguished:
            record["goals"] = self.goal_posteriors()
        return record | {"left_out": self.left_out, "notes": self.notes, "error": None}


def nothing_known(person: str, error: str, left_out: int = 0) -> dict[str, Any]:
    """Return the record, as plain data, of a person without usable actions, with the reason."""
    unknown = {f"{name}{what}": None for name in PARAMETERS for what in ("", "_interval", "_open")}
    return {
        "person": person, **unknown, "episodes": 0, "actions": 0, "suboptimal_actions": None, "suggestions": 0,
        "followed": 0, "log_likelihood": None, "check": None, "left_out": left_out, "notes": [], "error": error,
    }  # fmt: skip


def people_of(people: Mapping[str, PersonEstimate] | Iterable[PersonEstimate]) -> list[PersonEstimate]:
    """Return the estimates of people, also those in the result of `fit`."""
    found = list(people.values() if isinstance(people, Mapping) else people)
    wrong = next((one for one in found if not isinstance(one, PersonEstimate)), None)
    if wrong is not None:
        raise TypeError(f"a {type(wrong).__name__} where a person's estimates were expected; `fit(task, log)` has them")
    return found


def _words(found: Check) -> str:
    term = found.striking
    if term is None:
        return "choices are not those of one beta"
    more, fewer = {
        "repetition": (
            "choices are repeated more often than chance has it, as by habit or misconception",
            "choices in a state are changed more often than chance has it",
        ),
        "large_mistakes": (
            "there are more large mistakes than the small ones suggest",
            "there are fewer large mistakes than the small ones suggest",
        ),
        "learning": ("there are fewer mistakes in later actions", "there are more mistakes in later actions"),
    }[term]
    return more if (found.scores[term] or 0.0) > 0 else fewer
