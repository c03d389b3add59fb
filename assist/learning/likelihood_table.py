"""The table of people's log-likelihoods at nodes of beta and theta_0, under a trust rule."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.system.arrays import read_only
from planner.system.errors import InputFileError
from planner.system.results import ByContent

from ..people.decision import NOTHING, Floats
from ..people.neighbours import parts_of
from ..people.perceived_suggestions import PerceivedSuggestions, moved
from ..people.sights import SightTable
from ..people.trust_rules import LEAST, EquationSeven, Event, TrustRule, may_move
from .evidence import Evidence
from .likelihood import Data, Method, largest_beta, with_trust, without_trust
from .neighbours_in_logs import with_neighbours
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
class LikelihoodTable(ByContent):
    """What all K people chose, arranged by person and suggestion, at B nodes of beta and T of theta.

    If the goal is unknown, suggestions are those of all pairs of an episode and a goal (`Data`). `heard` counts these,
    H at most; later entries fill up arrays of shape (K, H). `told` and `accepted` count suggestions once, whatever the
    number of goals. `anew` is whether an episode begins between a suggestion and the one before.

    `silent` and `chances` are of each person as `without_trust` returns them. `silences`, shape (K, H + 1, 2), counts
    steps without a suggestion before each suggestion, in earlier episodes and in its own; at last those after the last
    suggestion, in later episodes and in its own.
    """

    people: tuple[str, ...]
    counts: Ints
    heard: Ints
    told: Ints
    accepted: Ints
    anew: NDArray[np.bool_]
    followed: NDArray[np.bool_]
    data: tuple[Data, ...]
    silent: tuple[Floats, ...]
    chances: tuple[Floats, ...]
    suggestions: PerceivedSuggestions
    beta: Floats
    theta: Floats
    seen: SightTable
    silences: Ints

    def __post_init__(self) -> None:
        read_only(self)

    @classmethod
    def of(
        cls, observations: Sequence[Observations], method: Method, beta: Floats | None = None,
        theta: Floats | None = None,
    ) -> LikelihoodTable:  # fmt: skip
        """Return the table of each person's observations, with episodes in order of time, at these nodes."""
        if beta is None:
            top = largest_beta(observations, method)
            beta = np.geomspace(top / BETA_RANGE, top, BETAS)
        if theta is None:
            end = math.log((1 - LEAST) / LEAST)
            theta = 1 / (1 + np.exp(-np.linspace(-end, end, THETAS)))
        every = [Data.of(o, method) for o in observations]
        heard = np.array([len(data.heard) for data in every], dtype=np.int64)
        told, accepted = np.zeros((2, len(every)), dtype=np.int64)
        shape = (len(every), int(heard.max(initial=0)))
        anew, followed, agrees, optimal = (np.zeros(shape, dtype=bool) for _ in range(4))
        gain, silences = np.zeros(shape), np.zeros((shape[0], shape[1] + 1, 2), dtype=np.int64)
        alone = [without_trust(data, beta) for data in every]
        for k, (o, data) in enumerate(zip(observations, every, strict=True)):
            goal, step = np.nonzero(~o.goals.reached)
            _count_silences(silences[k], data, o.begins.cumsum()[step] * len(o.goals.prior) + goal)
            goal, step = goal[data.heard], step[data.heard]
            slot, to = o.suggested[step], slice(0, len(data.heard))
            once = np.unique(step)
            told[k], accepted[k] = len(once), (o.chosen[once] == o.suggested[once]).sum()
            anew[k, to], followed[k, to], gain[k, to] = data.anew, o.chosen[step] == slot, o.by_goal("gain")[goal, step]
            agrees[k, to], optimal[k, to] = (
                o.by_goal("excess")[goal, step, slot] <= 0,
                o.by_goal("optimal")[goal, step, slot],
            )
        return cls(
            tuple(o.person for o in observations), np.array([len(o) for o in observations]), heard, told, accepted,
            anew, followed,
            tuple(every), tuple(silent for _, silent in alone), tuple(chances for chances, _ in alone),
            PerceivedSuggestions(gain, agrees, optimal), beta, theta,
            SightTable.of([o.seen for o in observations], heard.tolist(), shape[1]), silences,
        )  # fmt: skip

    @classmethod
    def of_advised(cls, people: Evidence | Sequence[Observations], method: Method, *, carry: bool) -> LikelihoodTable:
        """Return the table of a log, or of observations, for an estimate of influence, with the usual nodes."""
        observations = with_neighbours(people, method.neighbours)
        table = cls.of(observations, method)
        if not table.heard.any():
            raise InputFileError(
                "no suggestion in the episodes that are used; expected some, as influence shows in the answers to them"
            )
        if carry and any(o.goals.distinguished for o in observations):
            raise ValueError(
                "carry: expected False, since each episode has one of several goals, on which trust depends"
            )
        return table

    def only(self, people: NDArray[np.bool_]) -> LikelihoodTable:
        """Return the table of some people, shape (K,)."""
        chosen: dict[str, Any] = {
            name: array[people]
            for name, array in vars(self).items()
            if isinstance(array, np.ndarray) and name not in ("beta", "theta")
        }
        suggestions = PerceivedSuggestions(*(array[people] for array in vars(self.suggestions).values()))
        for name in ("people", "data", "silent", "chances"):
            chosen[name] = tuple(compress(getattr(self, name), people.tolist()))
        return replace(self, suggestions=suggestions, seen=self.seen.only(people), **chosen)

    def thetas(self, rule: TrustRule, *, carry: bool = True) -> tuple[Floats, Floats]:
        """Return theta at each suggestion, shape (K, H, T), and after the last one, (K, T), from each theta_0.

        Unless theta is carried, each episode begins with theta_0, and the last theta is that at the end of the last
        suggestion's episode.
        """
        own, steps = parts_of(rule)[0], np.zeros_like(self.silences)
        if may_move(own, False):
            steps = self.silences
            if self.seen.events.size:
                raise ValueError(
                    f"trust {type(own).__name__}: expected a rule that does not see steps without a suggestion, as "
                    "people saw neighbours in between"
                )
        seen = vars(self.suggestions.event(self.followed, rule.feedback, np.ones_like(self.followed)))
        start = np.broadcast_to(self.theta, (len(self.people), len(self.theta)))
        theta, before = start, np.empty((*self.followed.shape, len(self.theta)))
        none = count = np.zeros((len(self.people), 1), dtype=np.int64)
        see = self.seen.moves(rule)
        for h in range(self.followed.shape[1]):
            theta, count = _after_silences(own, see(theta, h, False), count, steps[:, h, 0])
            if not carry:
                theta = np.where(self.anew[:, h, None], start, theta)
                count = np.where(self.anew[:, h, None], none, count)
            theta, count = _after_silences(own, see(theta, h, True), count, steps[:, h, 1])
            before[:, h] = theta
            # What fills up the arrays comes after a person's last suggestion, so that it may move the count.
            after, count = moved(own, theta, count, Event(**{name: array[:, h, None] for name, array in seen.items()}))
            theta = np.where(h < self.heard[:, None], after, theta)
        theta, count = _after_silences(own, theta, count, steps[:, -1, 1])
        theta = see(theta, -1, True)
        if carry:
            theta, _ = _after_silences(own, theta, count, steps[:, -1, 0])
            theta = see(theta, -1, False)
        return before, theta

    def log_likelihood(self, rule: TrustRule, *, carry: bool = True) -> Floats:
        """Return the log likelihood of each person's choices, shape (K, B, T); parameters as for `thetas`."""
        before, _ = self.thetas(rule, carry=carry)
        found = [
            with_trust(data, self.chances[k], self.silent[k], before[k, : self.heard[k]])
            for k, data in enumerate(self.data)
        ]
        return np.array(found).reshape(len(found), len(self.beta), len(self.theta))


def _count_silences(counted: Ints, data: Data, episode: Ints) -> None:
    """Count one person's steps without a suggestion, shape (H + 1, 2); `episode` is that of each step of the data."""
    steps = np.flatnonzero(data.suggested == NOTHING)
    place = np.searchsorted(data.heard, steps)
    last, now = place == len(data.heard), np.zeros(len(steps), dtype=bool)
    if len(data.heard):
        now = episode[steps] == episode[data.heard[np.minimum(place, len(data.heard) - 1)]]
    np.add.at(counted, (np.where(last, len(counted) - 1, place), now.astype(np.int64)), 1)


def _after_silences(rule: TrustRule, theta: Floats, count: Ints, steps: Ints) -> tuple[Floats, Ints]:
    """Return theta, shape (K, T), and the counts of a rule, (K, 1), after a number of steps of each person, (K,)."""
    for n in range(int(steps.max(initial=0))):
        found, number = moved(rule, theta, count, Event.silent())
        theta, count = np.where(n < steps[:, None], found, theta), np.where(n < steps[:, None], number, count)
    return theta, count


def log_likelihood(
    observations: Observations, beta: Floats, theta: Floats, eta: Floats, method: Method | None = None
) -> Floats:
    """Return the log-likelihood of one person's actions on a grid, shape (B, T, E), under equation (7).

    Parameters
    ----------
    observations : Observations
    beta, theta, eta : float arrays, shapes (B,), (T,), (E,)
        Values of the parameters; theta is the one at the beginning of each episode.
    method : Method, optional
        Options of the estimation.
    """
    betas, thetas, etas = (np.array(axis, dtype=np.float64, ndmin=1) for axis in (beta, theta, eta))
    method = method or Method()
    table = LikelihoodTable.of([observations], method, betas, thetas)
    rules = [EquationSeven(float(rate), method.utility_scale) for rate in etas]
    return np.stack([table.log_likelihood(rule, carry=False)[0] for rule in rules], axis=-1)
