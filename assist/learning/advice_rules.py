"""Rules by which influence theta moves after a judgement with advice, as maps of theta.

Rules of `people.trust_rules` are for planning tasks. Those here are for logs of judgements (`advice_log`), where the
value of advice is the person's confidence, for or against it. Each judgement maps theta to

    theta' = (a theta + b) / (c theta + d),  within LEAST and 1 - LEAST.

Both steps of theta and steps of its logit have this form. A rule returns a, b, c and d for every judgement of a log.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.system.jit import njit

from ..people.decision import Floats
from ..people.trust_rules import Reliability
from .advice_log import AdviceLog

MOST_LOG_ODDS = 200.0
"""Limit of log-odds, so that no exponential overflows."""


@dataclass(frozen=True)
class Rule:
    """A rule by which theta moves after each judgement.

    Attributes
    ----------
    name : str
        Name in tables of results.
    parameters : dict of str to float
        Names of the fitted parameters, and their values at which a fit begins.
    moves : callable
        Maps a log and the parameters to the maps of its N judgements, shape (N, 4): a, b, c and d.
    positive, unit : tuple of str
        Parameters above 0, and those between 0 and 1.
    by_steps : bool
        Whether the parameters are steps.
    clipped : bool
        Whether theta moves by steps of its own and is clipped, so that derivatives by parameters mislead.
    from_start : bool
        Whether maps are those of the initial theta, and not of the last one.
    shared : bool
        Whether theta_0 is the same for all people (`sigma` is 0).
    """

    name: str
    parameters: dict[str, float]
    moves: Callable[..., Floats]
    positive: tuple[str, ...] = ()
    unit: tuple[str, ...] = ()
    by_steps: bool = True
    clipped: bool = False
    from_start: bool = False
    shared: bool = False


def at_once(agreement: Floats | float, disagreement: Floats | float, log: AdviceLog) -> Floats:
    """Return the steps of all judgements, shape (N,), by whether the advice is the person's own choice."""
    return np.where(log.agrees, agreement, disagreement).astype(float)


def by_outcome(right: float, wrong: float, log: AdviceLog) -> Floats:
    """Return a step for right and for wrong advice, shape (N,); 0 where the outcome was not shown."""
    return np.where(log.shown, np.where(log.right, right, wrong), 0.0)


def plain_steps(step: Floats) -> Floats:
    """Return the maps that add steps, shape (N,), to theta."""
    one = np.ones_like(step)
    return np.stack([one, step, 0 * one, one], axis=1)


def logit_steps(step: Floats) -> Floats:
    """Return the maps that add steps, shape (N,), to the logit of theta."""
    odds = np.exp(np.clip(-step, -MOST_LOG_ODDS, MOST_LOG_ODDS))
    return np.stack([np.ones_like(step), np.zeros_like(step), 1 - odds, odds], axis=1)


def _unmoved(log: AdviceLog) -> Floats:
    return plain_steps(np.zeros(len(log)))


def _equation_seven(log: AdviceLog, eta: float) -> Floats:
    return plain_steps(at_once(eta * log.confidence, -eta * log.confidence, log))


def _outcome(log: AdviceLog, gain: float, loss: float) -> Floats:
    return logit_steps(by_outcome(gain, -loss, log))


def at_disagreement(log: AdviceLog, agreement: float, gain: float, loss: float) -> Floats:
    """Return the maps of steps of the logit: at agreement, and by the outcome at disagreement."""
    return logit_steps(at_once(agreement, by_outcome(gain, -loss, log), log))


def _reliability(log: AdviceLog, weight: float, kept: float) -> Floats:
    """Return the maps to the mean of a beta distribution all of whose counts are forgotten (`Reliability`)."""
    totals = [weight]
    for _ in range(Reliability().counts):
        totals.append(kept * totals[-1] + 1)
    before = kept * np.array(totals)[_outcomes_before(log.first, log.sequence, log.shown, len(totals) - 1)]
    moved = np.stack([before, log.right * 1.0, np.zeros(len(log)), before + 1], axis=1)
    return np.where(log.shown[:, None], moved, (1.0, 0.0, 0.0, 1.0))


@njit()
def _outcomes_before(
    first: NDArray[np.bool_], advisor: NDArray[np.int64], shown: NDArray[np.bool_], most: int
) -> NDArray[np.int64]:
    """Return how many outcomes of the same advisor each judgement's person has seen before, up to a number, (N,)."""
    seen = np.zeros(advisor.max() + 1, dtype=np.int64)
    found = np.empty(len(first), dtype=np.int64)
    for i in range(len(first)):
        if first[i]:
            seen[:] = 0
        found[i] = min(seen[advisor[i]], most)
        seen[advisor[i]] += shown[i]
    return found


STEPS = ("gain", "loss")
"""Parameters that are not negative in the rules of planning tasks either."""

RULES = {
    rule.name: rule
    for rule in (
        Rule("constant", {}, _unmoved),
        Rule("paper", {"eta": 0.01}, _equation_seven, ("eta",), clipped=True),
        Rule("outcome", {"gain": 0.08, "loss": 0.16}, _outcome, STEPS),
        Rule("outcome-at-disagreement", {"agreement": 0.04, "gain": 0.08, "loss": 0.16}, at_disagreement, STEPS),
        Rule(
            "reliability",
            {"weight": 20.0, "kept": 0.95},
            _reliability,
            ("weight",),
            ("kept",),
            by_steps=False,
        ),
    )
}
"""The rules that are estimated, by their names in `people.trust_rules.RULES`."""

ONE_THETA = Rule("one theta", {}, _unmoved, shared=True)
OF_THE_PAPER = Rule("paper, eta 0.2", {}, lambda log: _equation_seven(log, 0.2), clipped=True)
DEFAULT_STEPS = Rule(
    "outcome-at-disagreement, default steps", {}, lambda log: at_disagreement(log, 0.03, 0.1, 0.2)
)  # fmt: skip
"""What estimated rules are compared with: a theta that all people share, and rules of given steps."""
