"""People's choices with and without suggestions, and their likelihood under a trust rule, on a grid of beta and theta.

The likelihood is that of `likelihood`. Here theta moves by any trust rule, and may be carried from episode to episode.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.system.arrays import read_only
from planner.system.jit import njit
from planner.system.results import ByContent

from ..people.decision import Floats
from ..people.trust_rules import LEAST, Event, PerceivedSuggestions, TrustRule, moved
from .likelihood import Data, Method, alone, with_trust
from .log import LogError
from .maximum_likelihood import largest_beta
from .observations import Ints, Observations

THETAS = 41
"""Nodes of theta_0, evenly spaced on the logit scale from LEAST to 1 - LEAST: 0.23 log-odds apart.

A person's theta is known to 0.3 log-odds or less exactly after 60 suggestions, so that sums over nodes are integrals.
"""

BETAS = 31
"""Nodes of beta, evenly spaced in log(beta): a factor of 1.19 apart."""

BETA_RANGE = 200.0
"""Factor between the largest and the least beta; people with the least choose almost at random."""


@dataclass(frozen=True, eq=False, repr=False)
class TrustLog(ByContent):
    """What all people chose, arranged by person and suggestion; K people, up to H suggestions, B and T nodes.

    Attributes
    ----------
    people : tuple of str
    counts : int array, shape (K,)
        Number of choices of each person.
    silent : float array, shape (K, B)
        Log likelihood of the choices without a suggestion.
    heard : int array, shape (K,)
        Number of suggestions to each person; later entries fill up the arrays.
    anew : bool array, shape (K, H)
        Whether an episode begins between this suggestion and the one before.
    followed : bool array, shape (K, H)
    data : tuple of Data
        The choices of each person.
    chances : tuple of float arrays, each of shape (B, 3, heard)
        Probability, without the suggestion, of the choice made, of the suggested one, and of all but that one.
    suggestions : PerceivedSuggestions
        Arrays of shape (K, H).
    beta, theta : float arrays, shapes (B,), (T,)
        Nodes.
    """

    people: tuple[str, ...]
    counts: Ints
    silent: Floats
    heard: Ints
    anew: NDArray[np.bool_]
    followed: NDArray[np.bool_]
    data: tuple[Data, ...]
    chances: tuple[Floats, ...]
    suggestions: PerceivedSuggestions
    beta: Floats
    theta: Floats

    def __post_init__(self) -> None:
        read_only(self)

    @classmethod
    def of(cls, observations: Sequence[Observations], method: Method) -> TrustLog:
        """Return the log of observations, arranged by person and suggestion.

        Parameters
        ----------
        observations : sequence of Observations
            One for each person; episodes in order of time.
        method : Method
            Its lapse and its largest beta are used.

        Raises
        ------
        LogError
            Nothing was ever suggested.
        """
        every = [Data.of(o, method) for o in observations]
        heard = np.array([len(data.heard) for data in every], dtype=np.int64)
        if not heard.sum():
            raise LogError("no suggestion in the log; expected some, since influence shows in the answers to them")
        top = largest_beta(observations, method)
        beta = np.geomspace(top / BETA_RANGE, top, BETAS)
        end = math.log((1 - LEAST) / LEAST)
        shape = (len(every), int(heard.max()))
        anew, followed, agrees, optimal = (np.zeros(shape, dtype=bool) for _ in range(4))
        gain, chances = np.zeros(shape), [np.empty((BETAS, 3, len(data.heard))) for data in every]
        silent = np.zeros((len(every), BETAS))
        for k, (o, data) in enumerate(zip(observations, every, strict=True)):
            steps, to = data.heard, slice(0, len(data.heard))
            for b, value in enumerate(beta.tolist()):
                silent[k, b] = alone(data, value, *chances[k][b], np.empty_like(data.first))
            slot = o.suggested[steps]
            anew[k, to], followed[k, to], gain[k, to] = data.anew, o.chosen[steps] == slot, o.gain[steps]
            agrees[k, to], optimal[k, to] = o.excess[steps, slot] <= 0, o.optimal[steps, slot]
        return cls(
            tuple(o.person for o in observations),
            np.array([len(o) for o in observations]),
            silent,
            heard,
            anew,
            followed,
            tuple(every),
            tuple(chances),
            PerceivedSuggestions(gain, agrees, optimal),
            beta,
            1 / (1 + np.exp(-np.linspace(-end, end, THETAS))),
        )

    def only(self, people: NDArray[np.bool_]) -> TrustLog:
        """Return the log of some people, shape (K,)."""
        chosen: dict[str, Any] = {
            name: array[people]
            for name, array in vars(self).items()
            if isinstance(array, np.ndarray) and name not in ("beta", "theta")
        }
        suggestions = PerceivedSuggestions(*(array[people] for array in vars(self.suggestions).values()))
        for name in ("people", "data", "chances"):
            chosen[name] = tuple(compress(getattr(self, name), people.tolist()))
        return replace(self, suggestions=suggestions, **chosen)

    @property
    def accepted(self) -> Ints:
        """The number of suggestions that each person followed, shape (K,)."""
        return (self.followed & (np.arange(self.followed.shape[1]) < self.heard[:, None])).sum(axis=1)

    def thetas(self, rule: TrustRule, *, carry: bool = True) -> tuple[Floats, Floats]:
        """Return theta at each suggestion, shape (K, H, T), and after the last one, (K, T), from each theta_0.

        Parameters
        ----------
        rule : TrustRule
        carry : bool
            Whether theta is carried from episode to episode; otherwise each begins with theta_0.
        """
        seen = vars(self.suggestions.event(self.followed, rule.feedback))
        start = np.broadcast_to(self.theta, (len(self.people), len(self.theta)))
        theta, before = start, np.empty((*self.followed.shape, len(self.theta)))
        none = count = np.zeros((len(self.people), 1), dtype=np.int64)
        for h in range(self.followed.shape[1]):
            if not carry:
                theta = np.where(self.anew[:, h, None], start, theta)
                count = np.where(self.anew[:, h, None], none, count)
            before[:, h] = theta
            # What fills up the arrays comes after a person's last suggestion, so that it may move the count.
            after, count = moved(rule, theta, count, Event(**{name: array[:, h, None] for name, array in seen.items()}))
            theta = np.where(h < self.heard[:, None], after, theta)
        return before, theta

    def log_likelihood(self, rule: TrustRule, *, carry: bool = True) -> Floats:
        """Return the log likelihood of each person's choices, shape (K, B, T); parameters as for `thetas`.

        At the theta to which the rule has led.
        """
        before, _ = self.thetas(rule, carry=carry)
        found = np.empty((len(self.people), len(self.beta), len(self.theta)))
        for k, data in enumerate(self.data):
            _fill(found[k], data, self.silent[k], self.chances[k], before[k, : self.heard[k]])
        return found


@njit(nogil=True)
def _fill(found: Floats, data: Data, silent: Floats, chances: Floats, path: Floats) -> None:
    """Fill in the log likelihood for each beta and each path of theta, shape (B, T)."""
    for b in range(len(silent)):
        found[b] = silent[b] + with_trust(data, chances[b, 0], chances[b, 1], chances[b, 2], data.first, path)
