"""Trust rules of logs of advice that were compared on public data, besides those that `assist.learning` has.

`RULES` has all of them under the names that the reference figures use, also those of `assist.learning.advice_rules`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.special import logsumexp

from assist.learning import advice_rules as shipped
from assist.learning.advice_log import AdviceLog
from assist.learning.advice_model import BASES, AdviceModel
from assist.learning.advice_rules import Rule, at_disagreement, at_once, by_outcome, logit_steps, plain_steps
from planner.system.jit import njit

SLOPES, SLOPE_WEIGHTS = np.polynomial.hermite_e.hermegauss(11)
SLOPE_WEIGHTS = SLOPE_WEIGHTS / SLOPE_WEIGHTS.sum()

Step = Callable[..., np.ndarray]
"""Maps a log and parameters to the step of each judgement, shape (N,)."""


def drift(log: AdviceLog, e: float) -> np.ndarray:
    return np.full(len(log), e)


def own_belief(log: AdviceLog, gain: float, loss: float) -> np.ndarray:
    return at_once(gain * log.confidence, -loss * log.confidence, log)


def unit_belief(log: AdviceLog, gain: float, loss: float) -> np.ndarray:
    return at_once(gain, -loss, log)


def outcome(log: AdviceLog, gain: float, loss: float) -> np.ndarray:
    return by_outcome(gain, -loss, log)


def disagreed(log: AdviceLog, gain: float, loss: float) -> np.ndarray:
    return at_once(0.0, by_outcome(gain, -loss, log), log)


def belief_and_outcome(log: AdviceLog, o: float, gain: float, loss: float) -> np.ndarray:
    return own_belief(log, o, o) + disagreed(log, gain, loss)


def agreement_and_outcome(log: AdviceLog, o: float, gain: float, loss: float) -> np.ndarray:
    return at_once(o, 0.0, log) + disagreed(log, gain, loss)


def drift_and_outcome(log: AdviceLog, d: float, e: float) -> np.ndarray:
    return drift(log, d) + disagreed(log, e, e)


def four_cells(log: AdviceLog, ar: float, aw: float, dr: float, dw: float) -> np.ndarray:
    return at_once(by_outcome(ar, aw, log), by_outcome(dr, dw, log), log)


def alike(step: Step, log: AdviceLog, e: float) -> np.ndarray:
    """Return steps whose gain and loss are the same."""
    return step(log, e, e)


def moves(step: Step, logit: bool, log: AdviceLog, *parameters: float) -> np.ndarray:
    return (logit_steps if logit else plain_steps)(step(log, *parameters))


def delta(log: AdviceLog, e: float) -> np.ndarray:
    """Move theta by a share towards the outcome."""
    moved = np.stack([np.full(len(log), 1 - e), e * log.right, *np.array([[0.0], [1.0]]).repeat(len(log), 1)], axis=1)
    return np.where(log.shown[:, None], moved, (1.0, 0.0, 0.0, 1.0))


def counted(log: AdviceLog, what: str, good: float = 1.0, bad: float = 1.0, kept: float = 1.0) -> np.ndarray:
    """Return the counts of good and bad advice after each judgement, shape (2, N).

    `what` is counted: all outcomes, those at disagreement, or own agreement, weighed by the confidence.
    """
    if what == "agreement":
        weights = log.confidence * np.where(log.agrees, good, bad)
        return _counts(log.first, log.sequence, np.ones(len(log), bool), log.agrees, weights, 1.0)
    counts = log.shown & (~log.agrees if what == "disagreement" else True)
    return _counts(log.first, log.sequence, counts, log.right, np.where(log.right, good, bad), kept)


@njit()
def _counts(
    first: np.ndarray, advisor: np.ndarray, counts: np.ndarray, right: np.ndarray, weights: np.ndarray, kept: float
) -> np.ndarray:
    now, found = np.zeros((2, advisor.max() + 1)), np.zeros((2, len(first)))
    for i in range(len(first)):
        if first[i]:
            now[:] = 0.0
        a = advisor[i]
        if counts[i]:
            now[:, a] *= kept
            now[0 if right[i] else 1, a] += weights[i]
        found[:, i] = now[:, a]
    return found


def beta_counts(what: str, log: AdviceLog, n0: float, *parameters: float) -> np.ndarray:
    """Move theta to the mean of a beta distribution of counts; parameters are as of `counted`."""
    if what != "agreement" and len(parameters) == 1:
        parameters = (*parameters, *parameters)
    good, bad = counted(log, what, *parameters)
    return np.stack([np.full(len(log), n0), good, np.zeros(len(log)), n0 + good + bad], axis=1)


def perceived_reliability(what: str, log: AdviceLog, n0: float, rk: float, r0: float) -> np.ndarray:
    """Move logit theta with the logit of the perceived share of right advice."""
    good, bad = counted(log, what)
    odds = (n0 * r0 + good) * (1.0 - r0) / ((n0 * (1.0 - r0) + bad) * r0)
    return logit_steps(rk * np.log(odds))


def random_slope(step: Step | None, log: AdviceLog, slope: float, *parameters: float) -> np.ndarray:  # noqa: ARG001
    return logit_steps(np.zeros(len(log)) if step is None else step(log, *parameters))


def _rules() -> dict[str, Rule]:
    every = [
        replace(shipped.RULES["constant"], name="none"),
        replace(shipped.ONE_THETA, name="shared"),
        replace(shipped.OF_THE_PAPER, name="eq7 eta=.2, confidence units"),
        Rule("eq7 eta=.2, unit steps", {}, lambda log: plain_steps(unit_belief(log, 0.2, 0.2)), clipped=True),
    ]
    for logit, prefix, small in ((False, "", 0.01), (True, "L ", 0.08)):
        for name, step, start in (
            ("drift", drift, {"e": small / 5}),
            ("eq7 fitted", partial(alike, own_belief), {"e": small}),
            ("eq7 gain/loss", own_belief, {"g": small, "l": small}),
            ("eq7 gain/loss, unit steps", unit_belief, {"g": small / 2, "l": small / 2}),
            ("outcome", partial(alike, outcome), {"e": small}),
            ("outcome gain/loss", outcome, {"g": small, "l": 2 * small}),
            ("outcome at disagreement", partial(alike, disagreed), {"e": small}),
            ("outcome at disagreement gain/loss", disagreed, {"g": small, "l": 2 * small}),
            (
                "own belief + outcome at disagreement", belief_and_outcome,
                {"o": small / 2, "g": small, "l": 2 * small},
            ),
            (
                "agreement + outcome at disagreement", agreement_and_outcome,
                {"o": small / 2, "g": small, "l": 2 * small},
            ),
        ):  # fmt: skip
            every.append(Rule(f"{prefix}{name}", start, partial(moves, step, logit), clipped=not logit))
    weights, shares = ("n0", "w", "ws", "wf"), ("gam",)
    counts, forgetting = {"n0": 20.0, "w": 1.0}, {"n0": 20.0, "ws": 1.0, "wf": 1.0, "gam": 0.9}
    every += [
        Rule(
            "drift + outcome at disagreement", {"d": 0.002, "e": 0.01}, partial(moves, drift_and_outcome, False),
            clipped=True,
        ),
        Rule(
            "L agreement + outcome at disagreement (symmetric)", {"o": 0.04, "e": 0.12},
            lambda log, o, e: at_disagreement(log, o, e, e),
        ),
        Rule("L four cells", {"ar": 0.04, "aw": 0.0, "dr": 0.12, "dw": -0.15}, partial(moves, four_cells, True)),
        Rule(
            "L agreement + outcome at disagreement, fixed .03/.10/.20", {},
            lambda log: at_disagreement(log, 0.03, 0.10, 0.20),
        ),
        Rule(
            "L agreement + outcome at disagreement, fixed .05/.15/.25", {},
            lambda log: at_disagreement(log, 0.05, 0.15, 0.25),
        ),
        Rule("delta rule", {"e": 0.05}, delta, by_steps=False),
        Rule("beta counts", counts, partial(beta_counts, "all"), weights, by_steps=False, from_start=True),
        Rule(
            "beta counts, good/bad weights, forgetting", forgetting, partial(beta_counts, "all"), weights, shares,
            by_steps=False, from_start=True,
        ),
        Rule(
            "beta counts at disagreement", counts, partial(beta_counts, "disagreement"), weights, by_steps=False,
            from_start=True,
        ),
        Rule(
            "beta counts at disagreement, good/bad weights, forgetting", forgetting,
            partial(beta_counts, "disagreement"), weights, shares, by_steps=False, from_start=True,
        ),
        Rule(
            "beta counts of own agreement", {"n0": 20.0, "ws": 1.0, "wf": 0.5}, partial(beta_counts, "agreement"),
            weights, by_steps=False, from_start=True,
        ),
        Rule(
            "perceived reliability", {"n0": 2.0, "rk": 0.5, "r0": 0.65}, partial(perceived_reliability, "all"),
            ("n0",), ("r0",), by_steps=False, from_start=True,
        ),
        Rule(
            "perceived reliability at disagreement", {"n0": 5.0, "rk": 1.0, "r0": 0.4},
            partial(perceived_reliability, "disagreement"), ("n0",), ("r0",), by_steps=False, from_start=True,
        ),
        Rule("random confidence slope", {"slope": 1.0}, partial(random_slope, None), ("slope",)),
        Rule(
            "random confidence slope + L agreement + outcome at disagreement",
            {"slope": 1.0, "o": 0.04, "g": 0.08, "l": 0.16}, partial(random_slope, agreement_and_outcome), ("slope",),
        ),
        replace(
            shipped.RULES["reliability"], name="beta counts, all forgotten", parameters={"n0": 20.0, "gam": 0.95},
            positive=("n0",), unit=("gam",),
        ),
    ]  # fmt: skip
    return {rule.name: rule for rule in every}


RULES = _rules()


class Sloped(AdviceModel):
    """A model whose b1 is normal over people, with the standard deviation `slope`: integrated out by quadrature."""

    def _each(self) -> list[AdviceModel]:
        place, (own, slope) = list(BASES[self.base]).index("b1"), (self.parameters[name] for name in ("b1", "slope"))
        values = [(*self.values[:place], own + slope * node, *self.values[place + 1 :]) for node in SLOPES]
        return [AdviceModel(self.base, self.rule, one, self.nodes) for one in values]

    def likelihood(self, log: AdviceLog) -> tuple[np.ndarray, np.ndarray]:
        found = [one.likelihood(log) for one in self._each()]
        return (
            np.concatenate([part for part, _ in found], axis=1),
            np.concatenate([w + np.log(share) for (_, w), share in zip(found, SLOPE_WEIGHTS, strict=True)]),
        )

    def log_likelihoods(self, log: AdviceLog) -> np.ndarray:
        found = np.array([one.log_likelihoods(log) for one in self._each()])
        return logsumexp(found + np.log(SLOPE_WEIGHTS)[:, None], axis=0)


def model_of(base: str, rule: Rule, values: tuple[float, ...] | None = None) -> AdviceModel:
    """Return the model with the values at which fits begin, or with these."""
    found = (Sloped if "slope" in rule.parameters else AdviceModel).of(base, rule)
    return found if values is None else replace(found, values=tuple(values))
