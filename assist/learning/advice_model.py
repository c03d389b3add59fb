"""How likely people's answers to advice are: influence theta per person, moved by a rule, and integrated out.

Model. logit(theta_0) is normal over people, with mean `mu` and standard deviation `sigma`; theta_0 is the same for all
advisors of a person, and then moves for each advisor by a rule (`advice_rules`). The final choice is the advice with
probability LAPSE + (1 - 2 LAPSE) sigmoid(z). With c the confidence in the own choice and s = 1 where the advice is the
own choice, -1 elsewhere, z is one of

- base "A": logit(theta) + s (b0 + b1 c), which is equation (6) with a bonus b0 of the own choice;
- base "E": a0 + a1 c where the advice is the own choice, else logit(theta) - b1 c: agreement does not inform theta;
- base "EA": base "E" plus `advised` times the advisor's confidence, in all rows.

Under two rules b1 differs between people, too: it is normal with the standard deviation `slope`.

The initial theta, and b1 where it differs, are integrated out: by Gauss-Hermite quadrature, or on more nodes that are
evenly spaced where many judgements of a person tell theta closely. Their posterior is updated after each row, so that
every row is predicted from the rows before it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from planner.system.jit import njit

from ..people.decision import Floats
from ..people.trust_rules import LEAST
from .advice_log import AdviceLog
from .advice_rules import MOST_LOG_ODDS, RULES, Rule, moved_by

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

SLOPES, SLOPE_WEIGHTS = np.polynomial.hermite_e.hermegauss(11)
SLOPE_WEIGHTS = SLOPE_WEIGHTS / SLOPE_WEIGHTS.sum()


@cache
def quadrature(nodes: int) -> tuple[Floats, Floats]:
    """Return nodes of a standard normal distribution and their weights: Gauss-Hermite for `NODES`, else even."""
    if nodes == NODES:
        points, weights = np.polynomial.hermite_e.hermegauss(nodes)
    else:
        points = np.linspace(-WIDEST, WIDEST, nodes)
        weights = np.exp(-(points**2) / 2)
    return points, weights / weights.sum()


BASES = {
    "A": {"mu": 2.0, "sigma": 1.0, "b0": 1.5, "b1": 1.5},
    "E": {"mu": 0.5, "sigma": 1.5, "b1": 1.5, "a0": 3.3, "a1": 1.2},
    "EA": {"mu": 0.5, "sigma": 1.5, "b1": 1.5, "a0": 3.3, "a1": 1.2, "advised": 2.0},
}
"""Parameters of each base, with values at which fits begin."""


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
    def of(cls, base: str, rule: str, values: Sequence[float] | None = None) -> AdviceModel:
        """Return the model of these names; with the values at which fits begin, unless values are given."""
        known = RULES[rule]
        if values is None:
            values = (*(BASES[base] | {"sigma": 0.0} if known.shared else BASES[base]).values(), *known.start)
        return cls(base, known, tuple(values))

    @property
    def parameters(self) -> dict[str, float]:
        """The parameters by name."""
        return dict(zip((*BASES[self.base], *self.rule.parameters), self.values, strict=True))

    def likelihood(self, log: AdviceLog) -> tuple[Floats, Floats]:
        """Return the likelihood of each answer at each node, shape (N, K), and the log weights of the nodes, (K,).

        The nodes are those of theta_0; under rules whose b1 differs between people, these for each node of b1.
        """
        weights = self._nodes()[1]
        found = np.empty((len(log), len(weights)))
        self._likelihood(found, log)
        return found, np.log(weights)

    def _nodes(self) -> tuple[Floats, Floats]:
        """Return the nodes of b1, shape (M,), and the weights of all nodes, shape (M * `nodes`,)."""
        own, weights = self.parameters, quadrature(self.nodes)[1]
        if "slope" not in own:
            return np.array([own["b1"]]), weights
        return own["b1"] + own["slope"] * SLOPES, np.multiply.outer(SLOPE_WEIGHTS, weights).ravel()

    def _likelihood(self, found: Floats, log: AdviceLog) -> Floats:
        own = self.parameters
        start = np.clip(expit(own["mu"] + own["sigma"] * quadrature(self.nodes)[0]), LEAST, 1 - LEAST)
        slopes, weights = self._nodes()
        rule = np.array(self.rule.coefficients(*self.values[len(BASES[self.base]) :]), dtype=float)
        by_agreement = self.base != "A"
        agree = np.array([own["a0"], own["a1"]] if by_agreement else [0.0, 0.0])
        totals = np.empty(int(log.first.sum()))
        _likelihood(
            found, totals, log.first, log.sequence, log.agrees, log.follows, log.right, log.shown, log.confidence,
            log.advice_confidence * own.get("advised", 0.0), np.tile(start, len(slopes)), weights, self.rule.kind,
            self.rule.logit, rule, by_agreement, agree, own.get("b0", 0.0), slopes,
        )  # fmt: skip
        return totals

    def predictions(self, log: AdviceLog) -> Floats:
        """Return the log probability of each answer, given the person's answers before it, shape (N,)."""
        found, weights = self.likelihood(log)
        with np.errstate(divide="ignore"):
            logs = np.log(found)
        total = np.cumsum(logs, axis=0)
        begins = np.flatnonzero(log.first)
        before = np.zeros((len(begins), found.shape[1]))
        before[1:] = total[begins[1:] - 1]
        total -= np.repeat(before, np.diff(np.append(begins, len(log))), axis=0)
        joint = np.logaddexp.reduce(total + weights, axis=1)
        earlier = np.append(0.0, joint[:-1])
        earlier[begins] = 0.0
        return np.asarray(joint - earlier)

    def log_likelihoods(self, log: AdviceLog) -> Floats:
        """Return the log probability of each person's answers: the sums of `predictions`, in the order of the log."""
        return self._likelihood(np.empty((0, len(self._nodes()[1]))), log)

    def log_likelihood(self, log: AdviceLog) -> float:
        """Return the log probability of all answers."""
        return float(self.log_likelihoods(log).sum())

    def refined(self, log: AdviceLog) -> AdviceModel:
        """Return the model with as many nodes as the log needs: twice as many change little, by `ENOUGH`."""
        model, found = self, self.log_likelihood(log)
        while model.nodes < MOST_NODES:
            finer = replace(model, nodes=2 * model.nodes)
            before, found = found, finer.log_likelihood(log)
            if not abs(found - before) > ENOUGH * log.first.sum():
                break
            model = finer
        return model


@njit(error_model="numpy")
def _likelihood(
    found: Floats, totals: Floats, first: NDArray[np.bool_], sequence: NDArray[np.int64], agrees: NDArray[np.bool_],
    follows: NDArray[np.bool_], right: NDArray[np.bool_], shown: NDArray[np.bool_], confidence: Floats, advised: Floats,
    start: Floats, weights: Floats, kind: int, logit: bool, rule: Floats, by_agreement: bool, agree: Floats,
    bonus: float, slopes: Floats,
) -> None:  # fmt: skip
    """Fill in people's log likelihoods, and in `found` that of each answer at each node, shape (N, K), if it has rows.

    A person's is the log of the mean, over nodes, of the product of the likelihoods of their answers. The nodes are
    those of theta_0 with each node of b1, `slopes`, shape (M,): `start` and `weights` have shape (K,), K a multiple of
    M. `bonus` is b0, and `agree` has a0 and a1.

    What differs between nodes is rational in theta: exponentials are taken once for each row, and loops over nodes are
    vectorised.
    """
    nodes, advisors, block = len(start), sequence.max() + 1, len(start) // len(slopes)
    theta, product, p, logs = np.empty((advisors, nodes)), weights.copy(), np.empty(nodes), np.zeros(nodes)
    good, bad = np.zeros(advisors), np.zeros(advisors)
    person, of_all, log_of_all, answers = -1, 1.0, 0.0, 0
    for i in range(len(first)):
        if first[i]:
            person += 1
            product[:], theta[:], of_all, log_of_all, answers = weights, start, 1.0, 0.0, 0
            good[:], bad[:], logs[:] = 0.0, 0.0, 0.0
        a, c = sequence[i], confidence[i]
        if agrees[i] and by_agreement:
            z = agree[0] + agree[1] * c + advised[i]
            same = LAPSE + (1.0 - 2.0 * LAPSE) / (1.0 + math.exp(min(max(-z, -MOST_LOG_ODDS), MOST_LOG_ODDS)))
            p[:] = same if follows[i] else 1.0 - same
            of_all *= p[0]
        else:
            low, slope = (LAPSE, 1.0 - 2.0 * LAPSE) if follows[i] else (1.0 - LAPSE, 2.0 * LAPSE - 1.0)
            for j in range(len(slopes)):
                z = bonus + slopes[j] * c
                z = (z if agrees[i] else -z) + advised[i]
                odds = math.exp(min(max(-z, -MOST_LOG_ODDS), MOST_LOG_ODDS))
                for k in range(j * block, (j + 1) * block):
                    p[k] = low + slope * theta[a, k] / (theta[a, k] + (1.0 - theta[a, k]) * odds)
                    product[k] *= p[k]
        if len(found):
            found[i] = p
        if i + 1 == len(first) or first[i + 1]:
            highest = logs.max()
            if answers >= TOGETHER:
                product *= np.exp(logs - highest)
            totals[person] = math.log(product.sum()) + highest + math.log(of_all) + log_of_all
        answers += 1
        if answers % TOGETHER == 0:
            logs += np.log(product)
            log_of_all += math.log(of_all)
            product[:], of_all = 1.0, 1.0
        of_start, top, top_one, bottom, bottom_one, good[a], bad[a] = moved_by(
            good[a], bad[a], kind, logit, rule, agrees[i], right[i], shown[i], c
        )
        if top != 1.0 or top_one != 0.0 or bottom != 0.0 or bottom_one != 1.0:
            source = start if of_start else theta[a]
            for k in range(nodes):
                moved = (top * source[k] + top_one) / (bottom * source[k] + bottom_one)
                theta[a, k] = min(max(moved, LEAST), 1.0 - LEAST)
