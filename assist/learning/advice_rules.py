"""Rules by which influence theta moves after a judgement with advice, as numbers that compiled code reads.

Rules of `people.trust_rules` are for planning tasks. Those here are for logs of judgements (`advice_log`), where the
value of advice is the person's confidence, for or against it. There are more of them than planning tasks have, since
they were compared on data of real people. `OF_NAMES` has the few that both have.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from planner.system.jit import njit

from ..people.decision import Floats
from ..people.trust_rules import Reliability

MOST_LOG_ODDS = 200.0
"""Limit of log-odds in compiled code, so that no exponential overflows."""

STEPS, DELTA, COUNTS, RELIABILITY, FORGOTTEN = range(5)
"""Kinds of rules, as compiled code tells them apart."""


@dataclass(frozen=True)
class Rule:
    """A rule by which theta moves after each judgement.

    Attributes
    ----------
    name : str
        Name in tables of results.
    kind : int
        `STEPS`: a step is added to theta, or to its logit; it depends on agreement, confidence and outcome. `DELTA`:
        theta moves by a share towards the outcome.
        `COUNTS`: theta is the mean of a beta distribution that counts good and bad advice. `RELIABILITY`: logit theta
        moves with the logit of the perceived share of right advice. `FORGOTTEN`: theta is the mean of a beta
        distribution all of whose counts are forgotten (`people.trust_rules.Reliability`).
    logit : bool
        Whether steps are on the logit scale.
    parameters : tuple of str
        Names of the fitted parameters.
    start : tuple of float
        Values of the parameters at which a fit begins.
    coefficients : callable
        Maps the parameters to the eight numbers that compiled code reads; see `_moved`.
    shared : bool
        Whether theta_0 is the same for all people (`sigma` is 0).
    """

    name: str
    kind: int
    logit: bool
    parameters: tuple[str, ...]
    start: tuple[float, ...]
    coefficients: Callable[..., Sequence[float]]
    shared: bool = False


def _steps(
    name: str, parameters: str, start: Sequence[float], coefficients: Callable[..., Sequence[float]],
) -> Rule:  # fmt: skip
    return Rule(name, STEPS, name.startswith("L "), tuple(parameters.split()), tuple(start), coefficients)


def _rules() -> dict[str, Rule]:
    """Return the rules by name; coefficients of steps are explained in `_moved`."""
    every = [
        _steps("none", "", (), lambda: (0,) * 8),
        Rule("shared", STEPS, False, (), (), lambda: (0,) * 8, shared=True),
        _steps("eq7 eta=.2, confidence units", "", (), lambda: (0, 0.2, 0, -0.2, 0, 0, 0, 0)),
        _steps("eq7 eta=.2, unit steps", "", (), lambda: (0.2, 0, -0.2, 0, 0, 0, 0, 0)),
    ]
    for prefix, small in (("", 0.01), ("L ", 0.08)):
        every += [
            _steps(f"{prefix}drift", "e", (small / 5,), lambda e: (e, 0, e, 0, 0, 0, 0, 0)),
            _steps(f"{prefix}eq7 fitted", "e", (small,), lambda e: (0, e, 0, -e, 0, 0, 0, 0)),
            _steps(f"{prefix}eq7 gain/loss", "g l", (small, small), lambda g, down: (0, g, 0, -down, 0, 0, 0, 0)),
            _steps(
                f"{prefix}eq7 gain/loss, unit steps", "g l", (small / 2, small / 2),
                lambda g, down: (g, 0, -down, 0, 0, 0, 0, 0),
            ),
            _steps(f"{prefix}outcome", "e", (small,), lambda e: (0, 0, 0, 0, e, -e, e, -e)),
            _steps(
                f"{prefix}outcome gain/loss", "g l", (small, 2 * small),
                lambda g, down: (0, 0, 0, 0, g, -down, g, -down),
            ),
            _steps(f"{prefix}outcome at disagreement", "e", (small,), lambda e: (0, 0, 0, 0, 0, 0, e, -e)),
            _steps(
                f"{prefix}outcome at disagreement gain/loss", "g l", (small, 2 * small),
                lambda g, down: (0, 0, 0, 0, 0, 0, g, -down),
            ),
            _steps(
                f"{prefix}own belief + outcome at disagreement", "o g l", (small / 2, small, 2 * small),
                lambda o, g, down: (0, o, 0, -o, 0, 0, g, -down),
            ),
            _steps(
                f"{prefix}agreement + outcome at disagreement", "o g l", (small / 2, small, 2 * small),
                lambda o, g, down: (o, 0, 0, 0, 0, 0, g, -down),
            ),
        ]  # fmt: skip
    every += [
        _steps(
            "drift + outcome at disagreement", "d e", (0.002, 0.01), lambda d, e: (d, 0, d, 0, 0, 0, e, -e)
        ),
        _steps(
            "L agreement + outcome at disagreement (symmetric)", "o e", (0.04, 0.12),
            lambda o, e: (o, 0, 0, 0, 0, 0, e, -e),
        ),
        _steps(
            "L four cells", "ar aw dr dw", (0.04, 0.0, 0.12, -0.15), lambda ar, aw, dr, dw: (0, 0, 0, 0, ar, aw, dr, dw)
        ),
        *(
            _steps(
                f"L agreement + outcome at disagreement, fixed {name}", "", (),
                lambda o=o, g=g, down=down: (o, 0, 0, 0, 0, 0, g, -down),
            )
            for name, o, g, down in ((".03/.10/.20", 0.03, 0.10, 0.20), (".05/.15/.25", 0.05, 0.15, 0.25))
        ),
        Rule("delta rule", DELTA, False, ("e",), (0.05,), lambda e: (e, 0, 0, 0, 0, 0, 0, 0)),
        Rule("beta counts", COUNTS, False, ("n0", "w"), (20.0, 1.0), lambda n, w: (n, w, w, 1, 0, 0, 0, 0)),
        Rule(
            "beta counts, good/bad weights, forgetting", COUNTS, False, ("n0", "ws", "wf", "gam"),
            (20.0, 1.0, 1.0, 0.9), lambda n, s, f, gam: (n, s, f, gam, 0, 0, 0, 0),
        ),
        Rule(
            "beta counts at disagreement", COUNTS, False, ("n0", "w"), (20.0, 1.0),
            lambda n, w: (n, w, w, 1, 1, 0, 0, 0),
        ),
        Rule(
            "beta counts at disagreement, good/bad weights, forgetting", COUNTS, False, ("n0", "ws", "wf", "gam"),
            (20.0, 1.0, 1.0, 0.9), lambda n, s, f, gam: (n, s, f, gam, 1, 0, 0, 0),
        ),
        Rule(
            "beta counts of own agreement", COUNTS, False, ("n0", "ws", "wf"), (20.0, 1.0, 0.5),
            lambda n, s, f: (n, s, f, 1, 2, 0, 0, 0),
        ),
        Rule(
            "perceived reliability", RELIABILITY, False, ("n0", "rk", "r0"), (2.0, 0.5, 0.65),
            lambda n, k, r: (n, k, r, 0, 0, 0, 0, 0),
        ),
        Rule(
            "perceived reliability at disagreement", RELIABILITY, False, ("n0", "rk", "r0"), (5.0, 1.0, 0.4),
            lambda n, k, r: (n, k, r, 1, 0, 0, 0, 0),
        ),
        Rule("random confidence slope", STEPS, True, ("slope",), (1.0,), lambda slope: (0,) * 8),  # noqa: ARG005
        Rule(
            "random confidence slope + L agreement + outcome at disagreement", STEPS, True, ("slope", "o", "g", "l"),
            (1.0, 0.04, 0.08, 0.16), lambda slope, o, g, down: (o, 0, 0, 0, 0, 0, g, -down),  # noqa: ARG005
        ),
        Rule(
            "beta counts, all forgotten", FORGOTTEN, False, ("n0", "gam"), (20.0, 0.95),
            lambda n, f: (n, f, Reliability().counts, 0, 0, 0, 0, 0),
        ),
    ]  # fmt: skip
    return {rule.name: rule for rule in every}


RULES = _rules()
"""The rules that are compared, by name."""

OF_NAMES = {
    "constant": "none",
    "paper": "eq7 fitted",
    "outcome": "L outcome gain/loss",
    "outcome-at-disagreement": "L agreement + outcome at disagreement",
    "reliability": "beta counts, all forgotten",
}
"""Rules of logs by the names of `people.trust_rules.RULES`; V of advice is the confidence, for or against."""


@njit(error_model="numpy")
def moved_by(
    good: float, bad: float, kind: int, logit: bool, rule: Floats, agrees: bool, right: bool, shown: bool, c: float
) -> tuple[bool, float, float, float, float, float, float]:
    """Return the map of theta by a judgement, and the counts of good and bad advice after it.

    The map is theta' = (a t + b) / (c t + d), within `LEAST` and 1 - `LEAST`. Returned are whether t is the initial
    theta, not the last one, then a, b, c, d. Both steps of theta and steps of its logit have this form.

    The eight numbers of a rule of `STEPS`: a constant and a factor of the confidence at agreement, the same at
    disagreement, the steps after right and after wrong advice at agreement, and the same at disagreement. Of `DELTA`:
    the share. Of `COUNTS`: prior weight, weights of good and bad advice, what is kept of the counts each time, and
    what is counted (0: all outcomes, 1: outcomes at disagreement, 2: agreement). Of `RELIABILITY`: prior weight,
    slope, prior reliability, and whether only disagreement counts. Of `FORGOTTEN`: prior weight, what is kept of all
    counts each time, and the number of outcomes by which their sum moves; `good` is the number of outcomes.
    """
    hit = 1.0 if right else 0.0
    if kind == STEPS:
        at = 0 if agrees else 2
        step = rule[at] + rule[at + 1] * c
        if shown:
            step += rule[(4 if agrees else 6) + (0 if right else 1)]
        if not logit:
            return False, 1.0, step, 0.0, 1.0, good, bad
        odds = math.exp(min(max(-step, -MOST_LOG_ODDS), MOST_LOG_ODDS))
        return False, 1.0, 0.0, 1.0 - odds, odds, good, bad
    if kind == COUNTS:
        if rule[4] == 2.0:
            good += rule[1] * c if agrees else 0.0
            bad += 0.0 if agrees else rule[2] * c
        elif shown and (rule[4] == 0.0 or not agrees):
            good = rule[3] * good + rule[1] * hit
            bad = rule[3] * bad + rule[2] * (1.0 - hit)
        return True, rule[0], good, 0.0, rule[0] + good + bad, good, bad
    if kind == RELIABILITY:
        if shown and (rule[3] == 0.0 or not agrees):
            good, bad = good + hit, bad + 1.0 - hit
        # the odds of the perceived share of right advice, over those before any
        odds = (rule[0] * rule[2] + good) * (1.0 - rule[2]) / ((rule[0] * (1.0 - rule[2]) + bad) * rule[2])
        odds = math.exp(min(max(-rule[1] * math.log(odds), -MOST_LOG_ODDS), MOST_LOG_ODDS))
        return True, 1.0, 0.0, 1.0 - odds, odds, good, bad
    if not shown:
        return False, 1.0, 0.0, 0.0, 1.0, good, bad
    if kind == DELTA:
        return False, 1.0 - rule[0], rule[0] * hit, 0.0, 1.0, good, bad
    total = rule[0]
    for _ in range(int(good)):
        total = rule[1] * total + 1.0
    return False, rule[1] * total, hit, 0.0, rule[1] * total + 1.0, min(good + 1.0, rule[2]), bad
