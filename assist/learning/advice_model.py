"""How likely people's answers to advice are: influence theta per person, moved by a rule, and integrated out.

Model. logit(theta_0) is normal over people, with mean `mu` and standard deviation `sigma`; theta_0 is the same for all
advisors of a person, and then moves for each advisor by a rule (`advice_rules`). The final choice is the advice with
probability LAPSE + (1 - 2 LAPSE) sigmoid(z). With c the confidence in the own choice and s = 1 where the advice is the
own choice, -1 elsewhere, z is one of

- base "A": logit(theta) + s (b0 + b1 c), which is equation (6) with a bonus b0 of the own choice;
- base "E": a0 + a1 c where the advice is the own choice, else logit(theta) - b1 c: agreement does not inform theta;
- base "EA": base "E" plus `advised` times the advisor's confidence, in all rows.

The initial theta is integrated out: by Gauss-Hermite quadrature, or on more nodes that are evenly spaced where many
judgements of a person tell theta closely.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from planner.system.jit import njit

from ..people.decision import Floats
from ..people.trust_rules import LEAST
from .advice_log import AdviceLog
from .advice_rules import MOST_LOG_ODDS, Rule

LAPSE = 0.0005
"""Least probability of a final choice, so that no single answer decides a fit."""

NODES = 31
"""Nodes of the Gauss-Hermite quadrature, with which fits begin.

They are half a standard deviation apart. A posterior that is narrower, and kinks where steps of theta are clipped, need
more nodes (`AdviceModel.refined`). Clipped steps also leave the likelihood with many local maxima.
"""

MOST_NODES = 32 * NODES
"""A hundredth of a standard deviation apart: enough for some ten thousand judgements of a person."""

WIDEST = 6.0
"""Evenly spaced nodes reach so many standard deviations to each side; 2e-9 of all people are beyond."""

ENOUGH = 0.01
"""Largest change of the log likelihood by twice as many nodes, in nats per person, at which nodes are enough."""

TOGETHER = 64
"""Answers whose likelihoods are multiplied before the logarithm is taken; `LAPSE` to this power does not underflow."""

BASES = {
    "A": {"mu": 2.0, "sigma": 1.0, "b0": 1.5, "b1": 1.5},
    "E": {"mu": 0.5, "sigma": 1.5, "b1": 1.5, "a0": 3.3, "a1": 1.2},
    "EA": {"mu": 0.5, "sigma": 1.5, "b1": 1.5, "a0": 3.3, "a1": 1.2, "advised": 2.0},
}
"""Parameters of each base, with values at which fits begin."""


@cache
def quadrature(nodes: int) -> tuple[Floats, Floats]:
    """Return nodes of a standard normal distribution and their weights: Gauss-Hermite for `NODES`, else even."""
    if nodes == NODES:
        points, weights = np.polynomial.hermite_e.hermegauss(nodes)
    else:
        points = np.linspace(-WIDEST, WIDEST, nodes)
        weights = np.exp(-(points**2) / 2)
    return points, weights / weights.sum()


@dataclass(frozen=True)
class AdviceModel:
    """A base and a rule with their parameters.

    Attributes
    ----------
    base : "A", "E" or "EA"
    rule : Rule
    values : tuple of float
        Parameters of the base in the order of `BASES`, then those of the rule.
    nodes : int
        Number of nodes of theta_0.
    """

    base: str
    rule: Rule
    values: tuple[float, ...]
    nodes: int = NODES

    @classmethod
    def of(cls, base: str, rule: Rule) -> Self:
        """Return the model with the values at which fits begin."""
        of_base = BASES[base] | {"sigma": 0.0} if rule.shared else BASES[base]
        return cls(base, rule, (*of_base.values(), *rule.parameters.values()))

    @property
    def parameters(self) -> dict[str, float]:
        """The parameters by name."""
        return dict(zip((*BASES[self.base], *self.rule.parameters), self.values, strict=True))

    def likelihood(self, log: AdviceLog) -> tuple[Floats, Floats]:
        """Return the likelihood of each answer at each node, shape (N, K), and the log weights of the nodes, (K,)."""
        found = np.empty((len(log), self.nodes))
        self._filled(log, found)
        return found, np.log(quadrature(self.nodes)[1])

    def _filled(self, log: AdviceLog, found: Floats) -> Floats:
        """Return people's log likelihoods, and fill in those of their answers at each node."""
        own, c = self.parameters, log.confidence
        if self.base == "A":
            shift, depends = (
                np.where(log.agrees, 1.0, -1.0) * (own["b0"] + own["b1"] * c),
                np.ones(len(log), dtype=bool),
            )
        else:
            shift, depends = np.where(log.agrees, own["a0"] + own["a1"] * c, -own["b1"] * c), ~log.agrees
        shift = shift + log.advice_confidence * own.get("advised", 0.0)
        points, weights = quadrature(self.nodes)
        start = np.clip(expit(own["mu"] + own["sigma"] * points), LEAST, 1 - LEAST)
        moves = self.rule.moves(log, *self.values[len(BASES[self.base]) :])
        answers = Answers(log.first, log.sequence, log.follows, depends, shift)
        return _likelihood(found, answers, moves, self.rule.from_start, start, weights)

    def log_likelihoods(self, log: AdviceLog) -> Floats:
        """Return the log probability of each person's answers, in the order of the log."""
        return self._filled(log, np.empty((0, self.nodes)))

    def log_likelihood(self, log: AdviceLog) -> float:
        """Return the log probability of all answers."""
        return float(self.log_likelihoods(log).sum())

    def refined(self, log: AdviceLog) -> Self:
        """Return the model with as many nodes as the log needs: twice as many change little, by `ENOUGH`."""
        model, found = self, self.log_likelihood(log)
        while model.nodes < MOST_NODES:
            finer = replace(model, nodes=2 * model.nodes)
            before, found = found, finer.log_likelihood(log)
            if not abs(found - before) > ENOUGH * log.first.sum():
                break
            model = finer
        return model


class Answers(NamedTuple):
    """People's answers as compiled code reads them: arrays of shape (N,).

    `depends` marks those that depend on theta, whose log-odds are logit(theta) + `shift`; those of others are `shift`.
    """

    first: NDArray[np.bool_]
    sequence: NDArray[np.int64]
    follows: NDArray[np.bool_]
    depends: NDArray[np.bool_]
    shift: Floats


@njit(error_model="numpy")
def _likelihood(
    found: Floats, answers: Answers, moves: Floats, from_start: bool, start: Floats, weights: Floats
) -> Floats:
    """Return people's log likelihoods, and fill in that of each answer at each node, shape (N, K), if `found` has rows.

    A person's is the log of the mean, over nodes of theta_0, of the product of the likelihoods of their answers.

    What differs between nodes is rational in theta, so that loops over nodes are vectorised.
    """
    nodes, count = len(start), len(answers.first)
    theta, product = np.empty((answers.sequence.max() + 1, nodes)), weights.copy()
    p, logs, totals = np.empty(nodes), np.zeros(nodes), np.empty(answers.first.sum())
    person, heard, of_all, log_of_all = -1, 0, 1.0, 0.0
    for i in range(count):
        if answers.first[i]:
            person += 1
            for k in range(nodes):  # `product[:] = weights` would take longer to compile, as in `person.hsvi`
                product[k], logs[k] = weights[k], 0.0
                for each in range(len(theta)):
                    theta[each, k] = start[k]
            heard, of_all, log_of_all = 0, 1.0, 0.0
        a = answers.sequence[i]
        odds = math.exp(min(max(-answers.shift[i], -MOST_LOG_ODDS), MOST_LOG_ODDS))
        low, slope = (LAPSE, 1.0 - 2.0 * LAPSE) if answers.follows[i] else (1.0 - LAPSE, 2.0 * LAPSE - 1.0)
        if answers.depends[i]:
            for k in range(nodes):
                p[k] = low + slope * theta[a, k] / (theta[a, k] + (1.0 - theta[a, k]) * odds)
                product[k] *= p[k]
        else:
            same = LAPSE + (1.0 - 2.0 * LAPSE) / (1.0 + odds)
            p[:] = same if answers.follows[i] else 1.0 - same
            of_all *= p[0]
        if len(found):
            for k in range(nodes):
                found[i, k] = p[k]
        if i + 1 == count or answers.first[i + 1]:
            highest = logs.max()
            if heard >= TOGETHER:
                product *= np.exp(logs - highest)
            totals[person] = math.log(product.sum()) + highest + math.log(of_all) + log_of_all
        heard += 1
        if heard % TOGETHER == 0:
            logs += np.log(product)
            log_of_all += math.log(of_all)
            product[:], of_all = 1.0, 1.0
        top, top_one, bottom, bottom_one = moves[i]
        if top != 1.0 or top_one != 0.0 or bottom != 0.0 or bottom_one != 1.0:
            source = start if from_start else theta[a]
            for k in range(nodes):
                moved = (top * source[k] + top_one) / (bottom * source[k] + bottom_one)
                theta[a, k] = min(max(moved, LEAST), 1.0 - LEAST)
    return totals
