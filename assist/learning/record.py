"""All that a log says of each person, in one record: estimates, a check of the model, misconceptions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..people.human import NOTHING
from .diagnostics import Check, check
from .fit import Estimate, Fit, Ints, Method, Observations, fit
from .misconception import Misconception, fit_misconception

STRIKING = 0.01  # below this probability of the check the model is said not to fit


@dataclass(frozen=True)
class Profile:
    """What was learned about one person."""

    fit: Fit
    check: Check
    misconception: Misconception | None

    @property
    def notes(self) -> list[str]:
        """What a reader of the estimates has to know."""
        o, beta = self.fit.observations, self.fit.beta
        notes = []
        if not beta.identified:
            notes.append("these actions say nothing about beta")
        elif beta.open_above:
            told = "made no mistake" if o.suboptimal == 0 else "made hardly any mistake"
            notes.append(
                f"{told}: beta is at least {beta.interval[0]:.2g}, and {beta.interval[1]:.3g} is where the search ends"
            )
        elif beta.open_below:
            notes.append("the actions may be random: the interval of beta includes 0")
        for name, estimate in (("theta", self.fit.theta), ("eta", self.fit.eta)):
            if estimate is not None and not estimate.identified:
                notes.append(f"these actions say nothing about {name}")
        if self.check.p is not None and self.check.p < STRIKING:
            notes.append(f"the model does not fit (p = {self.check.p:.3f}): {_words(self.check)}")
        return notes

    def record(self, facts: Callable[[Ints], list[list[str]]] | None = None, *, left_out: int = 0) -> dict[str, Any]:
        """Give all of it as plain data.

        Parameters
        ----------
        facts : callable, optional
            Gives what holds in states, shape (M,), for the record of a misconception.
        left_out : int
            How many of the person's actions `Recording.evaluated` left out.
        """
        o = self.fit.observations
        told = o.suggested != NOTHING
        record: dict[str, Any] = {"person": o.person}
        for name, estimate in (("beta", self.fit.beta), ("theta", self.fit.theta), ("eta", self.fit.eta)):
            record |= _estimate(name, estimate)
        record |= {
            "episodes": len(o.episodes),
            "actions": len(o),
            "suboptimal_actions": o.suboptimal,
            "suggestions": int(told.sum()),
            "followed": int((o.chosen[told] == o.suggested[told]).sum()),
            "log_likelihood": self.fit.log_likelihood,
            "check": {"p": self.check.p, **self.check.scores},
        }
        m = self.misconception
        if m is not None:
            shown = [{}] * len(m.states) if facts is None else [{"facts": held} for held in facts(m.states)]
            record["misconception"] = {
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
        notes = [f"{left_out} actions are left out, since states were not evaluated in time"] if left_out else []
        return record | {"left_out": left_out, "notes": notes + self.notes, "error": None}


def _estimate(name: str, estimate: Estimate | None) -> dict[str, Any]:
    if estimate is None:
        return {name: None, f"{name}_interval": None, f"{name}_open": None}
    sides = [side for side, is_open in (("below", estimate.open_below), ("above", estimate.open_above)) if is_open]
    return {name: estimate.value, f"{name}_interval": list(estimate.interval), f"{name}_open": sides}


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


def failed(person: str, error: str, *, left_out: int = 0) -> dict[str, Any]:
    """Give the record of a person of whom nothing could be used."""
    record: dict[str, Any] = {"person": person}
    for name in ("beta", "theta", "eta"):
        record |= _estimate(name, None)
    return record | {
        "episodes": 0, "actions": 0, "suboptimal_actions": None, "suggestions": 0, "followed": 0,
        "log_likelihood": None, "check": None, "left_out": left_out, "notes": [], "error": error,
    }  # fmt: skip


def profiles(
    observations: Sequence[Observations],
    method: Method,
    rng: np.random.Generator,
    *,
    misconceptions: bool = False,
    jobs: int = 1,
    progress: Callable[[int], None] | None = None,
) -> list[Profile]:
    """Learn about each person.

    Parameters
    ----------
    observations : sequence of Observations
        One for each person.
    method : Method
    rng : numpy.random.Generator
        For the check.
    misconceptions : bool
        Whether to estimate them too, which takes a second or more for each person.
    jobs : int
        Threads.
    progress : callable, optional
        Called with how many people have been finished since the last call.
    """
    result = []
    for fitted in fit(observations, method, jobs=jobs, progress=None if misconceptions else progress):
        result.append(Profile(fitted, check(fitted, rng), fit_misconception(fitted) if misconceptions else None))
        if misconceptions and progress is not None:
            progress(1)
    return result
