"""People's choices with and without suggestions, and their likelihood under a trust rule, on a grid of beta and theta.

Unlike `likelihood`, which is compiled for equation (7), this module takes any trust rule, and theta may be carried from
episode to episode. As there, the person's cost-to-go is taken for h*.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.system.arrays import outline, read_only
from planner.system.jit import njit

from ..people.decision import Floats
from ..people.trust_rules import LEAST, Event, PerceivedSuggestions, TrustRule, moved
from .likelihood import Data, Method, alone
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

SMALL = 1e-300
"""Least weight of a choice in equation (6)."""


@dataclass(frozen=True)
class TrustLog:
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
    chosen, told, rest : float arrays, shape (K, H, B)
        Probability, without the suggestion, of the choice made, of the suggested one, and of all but that one.
    options : float array, shape (K, H)
        Number of choices.
    suggestions : PerceivedSuggestions
        Arrays of shape (K, H).
    beta, theta : float arrays, shapes (B,), (T,)
        Nodes.
    lapse : float
    """

    people: tuple[str, ...]
    counts: Ints
    silent: Floats
    heard: Ints
    anew: NDArray[np.bool_]
    followed: NDArray[np.bool_]
    chosen: Floats
    told: Floats
    rest: Floats
    options: Floats
    suggestions: PerceivedSuggestions
    beta: Floats
    theta: Floats
    lapse: float

    __repr__ = outline

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
        gain, options = np.zeros(shape), np.ones(shape)
        chosen, told, rest = (np.full((*shape, BETAS), 0.5) for _ in range(3))
        silent = np.zeros((len(every), BETAS))
        for k, (o, data) in enumerate(zip(observations, every, strict=True)):
            steps, to = data.heard, slice(0, len(data.heard))
            own = np.empty((3, len(steps)))
            for b, value in enumerate(beta.tolist()):
                silent[k, b] = alone(data, value, *own, np.empty_like(data.first))
                chosen[k, to, b], told[k, to, b], rest[k, to, b] = own
            slot = o.suggested[steps]
            anew[k, to], followed[k, to] = data.anew, o.chosen[steps] == slot
            gain[k, to], options[k, to] = o.gain[steps], data.options[steps]
            agrees[k, to], optimal[k, to] = o.excess[steps, slot] <= 0, o.optimal[steps, slot]
        return cls(
            tuple(o.person for o in observations), np.array([len(o) for o in observations]), silent, heard, anew,
            followed, chosen, told, rest, options, PerceivedSuggestions(gain, agrees, optimal), beta,
            1 / (1 + np.exp(-np.linspace(-end, end, THETAS))), method.lapse,
        )  # fmt: skip

    def only(self, people: NDArray[np.bool_]) -> TrustLog:
        """Return the log of some people, shape (K,)."""
        chosen: dict[str, Any] = {
            name: array[people]
            for name, array in vars(self).items()
            if isinstance(array, np.ndarray) and name not in ("beta", "theta")
        }
        suggestions = PerceivedSuggestions(*(array[people] for array in vars(self.suggestions).values()))
        names = tuple(name for name, kept in zip(self.people, people.tolist(), strict=True) if kept)
        return replace(self, people=names, suggestions=suggestions, **chosen)

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

        Equation (6) with a lapse, at the theta to which the rule has led.
        """
        before, _ = self.thetas(rule, carry=carry)
        found = np.repeat(self.silent[:, :, None], len(self.theta), axis=2)
        _add_answers(
            found, before, self.heard, self.followed, self.chosen, self.told, self.rest, self.options, self.lapse
        )
        return found


@njit()
def _add_answers(
    found: Floats, theta: Floats, heard: Ints, followed: NDArray[np.bool_], chosen: Floats, told: Floats, rest: Floats,
    options: Floats, lapse: float,
) -> None:  # fmt: skip
    """Add the log likelihood of the choices with a suggestion, in place, shape (K, B, T).

    Equation (6) as in `influence_kernels.influence_factors`, without branches in the loop over theta, so that it is
    compiled into vector instructions. `SMALL` in place of 0 makes a suggestion have no effect that would leave no
    choice possible.
    """
    people, betas, thetas = found.shape
    least = lapse / options.max()
    together = max(1, int(200.0 / -math.log10(least)))  # factors of a product, since logarithms are slow
    product = np.empty(thetas)
    for k in range(people):
        for b in range(betas):
            product[:] = 1.0
            for h in range(heard[k]):
                share, heed, others = lapse / options[k, h], told[k, h, b], rest[k, h, b]
                own, yes = (1.0 - lapse) * chosen[k, h, b], followed[k, h]
                for t in range(thetas):
                    sure, other = max(theta[k, h, t], SMALL), max(1.0 - theta[k, h, t], SMALL)
                    answer = sure if yes else other
                    product[t] *= own * answer / (sure * heed + other * others) + share
                if (h + 1) % together == 0:
                    for t in range(thetas):
                        found[k, b, t] += math.log(product[t])
                        product[t] = 1.0
            for t in range(thetas):
                found[k, b, t] += math.log(product[t])
