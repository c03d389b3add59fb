"""How people take advice: influence theta per person, rules by which it moves, and how well both predict.

Model. logit(theta_0) is normal over people, with mean `mu` and standard deviation `sigma`; theta_0 is the same for all
advisors of a person, and then moves for each advisor by a `Rule`. The final choice is the advice with probability
LAPSE + (1 - 2 LAPSE) sigmoid(z). With c the confidence in the own choice and s = 1 where the advice is the own
choice, -1 elsewhere, z is one of

- base "A": logit(theta) + s (b0 + b1 c), which is equation (6) with a bonus b0 of the own choice;
- base "E": a0 + a1 c where the advice is the own choice, else logit(theta) - b1 c: agreement does not inform theta;
- base "EA": base "E" plus `advised` times the advisor's confidence, in all rows.

Under two rules b1 differs between people, too: it is normal with the standard deviation `slope`.

The initial theta, and b1 where it differs, are integrated out by Gauss-Hermite quadrature. Their posterior is updated
after each row, so that every row is predicted from the rows before it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from planner.system.jit import njit

from ..people.decision import Floats
from ..people.trust_rules import LEAST, Reliability
from .advice_log import AdviceLog
from .trust_scores import TrustComparison

LAPSE = 0.0005
"""Least probability of a final choice, so that no single answer decides a fit."""

NODES = 31
"""Nodes of the quadrature. Twice as many change no figure of two public data sets in the fifth digit."""

POINTS, WEIGHTS = np.polynomial.hermite_e.hermegauss(NODES)
WEIGHTS = WEIGHTS / WEIGHTS.sum()

SLOPES, SLOPE_WEIGHTS = np.polynomial.hermite_e.hermegauss(11)
SLOPE_WEIGHTS = SLOPE_WEIGHTS / SLOPE_WEIGHTS.sum()

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
            (20.0, 1.0, 2.0, 0.9), lambda n, s, f, gam: (n, s, f, gam, 0, 0, 0, 0),
        ),
        Rule(
            "beta counts at disagreement", COUNTS, False, ("n0", "w"), (20.0, 1.0),
            lambda n, w: (n, w, w, 1, 1, 0, 0, 0),
        ),
        Rule(
            "beta counts at disagreement, good/bad weights, forgetting", COUNTS, False, ("n0", "ws", "wf", "gam"),
            (20.0, 1.0, 2.0, 0.9), lambda n, s, f, gam: (n, s, f, gam, 1, 0, 0, 0),
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

BASES = {
    "A": {"mu": 2.0, "sigma": 1.0, "b0": 1.5, "b1": 1.5},
    "E": {"mu": 0.5, "sigma": 1.5, "b1": 1.5, "a0": 3.3, "a1": 1.2},
    "EA": {"mu": 0.5, "sigma": 1.5, "b1": 1.5, "a0": 3.3, "a1": 1.2, "advised": 2.0},
}
"""Parameters of each base, with values at which fits begin."""

POSITIVE = {"sigma", "slope", "n0", "w", "ws", "wf"}
UNIT = {"gam", "r0"}


@dataclass(frozen=True)
class AdviceModel:
    """A base and a rule with their parameters.

    Attributes
    ----------
    base : "A", "E" or "EA"
    rule : Rule
    values : tuple of float
        Parameters of the base in the order of `BASES`, then those of the rule.
    """

    base: str
    rule: Rule
    values: tuple[float, ...]

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
        """Return the nodes of b1, shape (M,), and the weights of all nodes, shape (M * NODES,)."""
        own = self.parameters
        if "slope" not in own:
            return np.array([own["b1"]]), WEIGHTS
        return own["b1"] + own["slope"] * SLOPES, np.multiply.outer(SLOPE_WEIGHTS, WEIGHTS).ravel()

    def _likelihood(self, found: Floats, log: AdviceLog) -> Floats:
        own = self.parameters
        start = np.clip(1 / (1 + np.exp(-(own["mu"] + own["sigma"] * POINTS))), LEAST, 1 - LEAST)
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

    def fit(self, log: AdviceLog) -> AdviceModel:
        """Return the model of largest marginal likelihood, found from this one's values.

        Where these are the values of `of`, smaller steps are a second start. Where theta moves by steps and is clipped,
        the likelihood has several local maxima, so that the fit has more starts.
        """
        names = (*BASES[self.base], *self.rule.parameters)
        free = [name != "sigma" or not self.rule.shared for name in names]

        def inner(values: Sequence[float]) -> Floats:
            return np.array([_to(name, value) for name, value in zip(names, values, strict=True)])[free]

        def model(point: Floats) -> AdviceModel:
            fitted = iter(point.tolist())
            return replace(
                self,
                values=tuple(
                    _from(name, next(fitted)) if one else value
                    for name, one, value in zip(names, free, self.values, strict=True)
                ),
            )

        def people(point: Floats) -> Floats:
            with np.errstate(over="ignore"):
                values = model(point).log_likelihoods(log)
            return values if np.isfinite(values).all() else np.full(len(values), -1e6)

        def loss(point: Floats) -> float:
            return -float(people(point).sum())

        initial = AdviceModel.of(self.base, self.rule.name).values
        common, rest = initial[: len(BASES[self.base])], initial[len(BASES[self.base]) :]
        cold, starts = self.values == initial, [inner(self.values)]
        kinks = self.rule.kind == STEPS and not self.rule.logit and any(self.rule.coefficients(*rest))  # of the clips
        if self.rule.kind == STEPS and rest and (cold or kinks):
            starts.append(inner((*common, *(0.3 * value for value in rest))))
        if kinks:
            starts += [inner(initial), inner((0.0, 2.0, *initial[2:]))]
        found = sorted((_scoring(people, start) for start in starts), key=loss)
        best = found[0]
        if kinks:  # derivatives mislead at the clips
            refined = [
                minimize(
                    loss, one, method="Nelder-Mead",
                    options={"maxiter": 200 * len(one), "xatol": 1e-3, "fatol": 1e-3, "adaptive": True},
                ).x
                for one in found[:3]
            ]  # fmt: skip
            best = min(refined, key=loss)
        return model(best)


def _scoring(people: Callable[[Floats], Floats], point: Floats, enough: float = 1e-3) -> Floats:
    """Return the point near a start at which the sum of people's log likelihoods is largest.

    The information is estimated by people's scores (the method of Berndt, Hall, Hall and Hausman), with damping, until
    a step is expected to gain less than `enough` nats. A start needs a few steps, and each the likelihood once for
    each parameter.
    """
    delta, damping, unit = 1e-4, 1e-3, np.eye(len(point))
    values = people(point)
    for _ in range(100):
        scores = np.array([(people(point + delta * one) - values) / delta for one in unit])
        gradient, information = scores.sum(axis=1), scores @ scores.T
        scale = np.diag(np.diag(information) + 1e-6)
        while True:
            step = np.linalg.solve(information + damping * scale, gradient)
            if gradient @ step < enough:
                return point
            moved = people(point + step)
            if moved.sum() > values.sum():
                break
            damping *= 10
        point, values, damping = point + step, moved, max(damping / 10, 1e-6)
    return point


def _to(name: str, value: float) -> float:
    if name in POSITIVE:
        return math.log(max(value, 1e-6))
    return math.log(value / (1 - value)) if name in UNIT else value


def _from(name: str, value: float) -> float:
    if name in POSITIVE:
        return math.exp(min(max(value, -15.0), 15.0))
    return 1 / (1 + math.exp(-min(max(value, -30.0), 30.0))) if name in UNIT else value


def fold_of(person: NDArray[np.str_], folds: int = 8) -> NDArray[np.int64]:
    """Return the fold of each row's person, shape (N,): the number in their name, modulo the number of folds.

    Where that leaves all people in one fold, as with names without numbers, it is the person's place in the log.
    """
    found = np.array([int("".join(filter(str.isdecimal, name)) or 0) % folds for name in person.tolist()])
    return found if (found != found[0]).any() else np.unique(person, return_inverse=True)[1].astype(np.int64) % folds


def held_out(log: AdviceLog, base: str, rule: str, folds: int = 8) -> Floats:
    """Return the log probability of each answer, shape (N,), with parameters fitted to the people of other folds."""
    fold, found = fold_of(log.person, folds), np.empty(len(log))
    start = AdviceModel.of(base, rule)
    for each in range(folds):
        inside = fold == each
        if inside.any():
            start = start.fit(log.of(~inside))  # the fit of the fold before is a good start
            found[inside] = start.predictions(log.of(inside))
    return found


def mean_and_error(log: AdviceLog, values: Floats) -> tuple[float, float]:
    """Return the mean of values per row, shape (N,), and its standard error over people (ratio estimator)."""
    begins = np.flatnonzero(log.first)
    sums, counts = np.add.reduceat(values, begins), np.diff(np.append(begins, len(log)))
    mean = sums.sum() / counts.sum()
    people = len(begins)
    return float(mean), float(math.sqrt(((sums - mean * counts) ** 2).sum() * people / (people - 1)) / counts.sum())


def compare_advice(log: AdviceLog, *, folds: int = 8, level: float = 0.95) -> TrustComparison:
    """Compare the trust rules of `OF_NAMES` on held-out people.

    Parameters
    ----------
    log : AdviceLog
    folds : int
        Groups of people that are left out in turn.
    level : float
        Level of the intervals.

    Raises
    ------
    ValueError
        There are fewer than two people.
    """
    begins = np.flatnonzero(log.first)
    if len(begins) < 2:
        raise ValueError("one person; a comparison needs two or more, to learn from some about others")
    base = base_of(log)
    scores = {name: np.add.reduceat(held_out(log, base, rule, folds), begins) for name, rule in OF_NAMES.items()}
    estimates = {name: AdviceModel.of(base, rule).fit(log).parameters for name, rule in OF_NAMES.items()}
    counts = np.diff(np.append(begins, len(log))).astype(float)
    return TrustComparison.of(scores, counts, estimates, level)


def fit_advice(log: AdviceLog, rule: str) -> dict[str, Any]:
    """Return the parameters of a trust rule that fit a log of advice best, as plain data.

    Parameters
    ----------
    log
        People's choices before and after advice.
    rule
        A name of `OF_NAMES`.

    Returns
    -------
    dict
        The rule, its base, its parameters, the log likelihood in nats, and the numbers of people and choices.
    """
    base = base_of(log)
    model = AdviceModel.of(base, OF_NAMES[rule]).fit(log)
    return {
        "rule": rule, "base": base, "parameters": model.parameters, "log_likelihood": model.log_likelihood(log),
        "people": int(log.first.sum()), "choices": len(log),
    }  # fmt: skip


def base_of(log: AdviceLog) -> str:
    """Return the base for a log: "EA" where the advisor's confidence differs between rows, else "E"."""
    return "EA" if np.ptp(log.advice_confidence) > 0 else "E"


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
    theta, product, p = np.empty((advisors, nodes)), weights.copy(), np.empty(nodes)
    good, bad = np.zeros(advisors), np.zeros(advisors)
    person, of_all = -1, 1.0
    for i in range(len(first)):
        if first[i]:
            person += 1
            product[:], theta[:], of_all = weights, start, 1.0
            good[:], bad[:] = 0.0, 0.0
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
            totals[person] = math.log(product.sum()) + math.log(of_all)
        of_start, top, top_one, bottom, bottom_one, good[a], bad[a] = _update(
            good[a], bad[a], kind, logit, rule, agrees[i], right[i], shown[i], c
        )
        if top != 1.0 or top_one != 0.0 or bottom != 0.0 or bottom_one != 1.0:
            source = start if of_start else theta[a]
            for k in range(nodes):
                moved = (top * source[k] + top_one) / (bottom * source[k] + bottom_one)
                theta[a, k] = min(max(moved, LEAST), 1.0 - LEAST)


@njit(error_model="numpy")
def _update(
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
