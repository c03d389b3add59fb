"""The shipped trust rules with the ranges of their parameters, for estimates."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product

from ..people.neighbours import LARGEST_STEP, SEEN_RULES, WithSeen, parts_of
from ..people.trust_rules import EquationSeven, Reliability, TrustRule, constant, outcome, outcome_at_disagreement
from .intervals import Interval
from .likelihood import Method

STEP_SIZES = (0.1, 0.4)
"""Steps of logit(theta) that are tried for gain and for loss, in log-odds."""

RATES = (0.02, 0.05, 0.1, 0.2, 0.4)
"""Values of eta that are tried."""


@dataclass(frozen=True)
class RuleFamily:
    """A shipped trust rule whose parameters are to be estimated.

    Attributes
    ----------
    make : callable
        Returns the rule with the parameters.
    ranges : mapping of str to (float, float)
        Range of each value, by the parameter's name.
    tried : tuple of tuple of float
        Values that are tried before the best are refined.
    logarithms : frozenset of str
        Parameters whose values are their logarithms.
    beside : str
        What beside suggestions to oneself moves theta, for the name of the rule.
    """

    make: Callable[..., TrustRule]
    ranges: Mapping[str, Interval]
    tried: tuple[tuple[float, ...], ...]
    logarithms: frozenset[str] = frozenset()
    beside: str = ""

    def parameter(self, name: str, value: float) -> float:
        """Return the parameter that a value stands for."""
        return math.exp(value) if name in self.logarithms else value

    def rule(self, values: Sequence[float]) -> TrustRule:
        """Return the rule with these values, in the order of `ranges`."""
        pairs = zip(self.ranges, values, strict=True)
        return self.make(**{name: self.parameter(name, value) for name, value in pairs})

    @classmethod
    def of(cls, rule: TrustRule) -> RuleFamily:
        """Return the family of one rule, without parameters to estimate."""
        return cls(lambda: rule, {}, ((),))


def families(method: Method) -> dict[str, RuleFamily]:
    """Return the shipped rules by name; eta is the method's if it is known."""
    paper = partial(EquationSeven, utility_scale=method.utility_scale)
    steps, pairs = {"gain": (0.0, LARGEST_STEP), "loss": (0.0, LARGEST_STEP)}, tuple(product(STEP_SIZES, STEP_SIZES))
    return {
        "constant": RuleFamily.of(constant()),
        "paper": RuleFamily(paper, {"eta": (0.0, 1.0)}, tuple((rate,) for rate in RATES))
        if method.eta is None
        else RuleFamily.of(paper(eta=method.eta)),
        "outcome": RuleFamily(outcome, steps, pairs),
        "outcome-at-disagreement": RuleFamily(
            outcome_at_disagreement, {"agreement": (-1.0, 1.0), **steps},
            tuple((agreement, *pair) for agreement in (0.0, 0.1) for pair in pairs),
        ),
        "reliability": RuleFamily(
            Reliability, {"weight": (math.log(0.5), math.log(200.0)), "forgetting": (0.0, 0.9)},
            tuple(product((1.0, 2.3, 3.7), (0.05, 0.3))),  # weights of 3, 10 and 40
            # A weight is known up to a factor: its own likelihood has a long tail, that of its logarithm hardly any.
            frozenset({"weight"}),
        ),
    }  # fmt: skip


def parameters_of(rule: TrustRule) -> dict[str, float]:
    """Return the numbers that a rule has, by name; a theta that never moves has none."""
    parts = [part for part in parts_of(rule) if part != constant()]
    numbers = [(name, value) for part in parts for name, value in vars(part).items()]
    return {name: float(value) for name, value in numbers if type(value) in (int, float)}


def seen_families(own: TrustRule | RuleFamily) -> dict[str, RuleFamily]:
    """Return the rules by which theta moves by what is seen of neighbours, by name, beside a rule of one's own.

    "none" is the person's own rule alone.

    Parameters
    ----------
    own : TrustRule or RuleFamily
        How theta moves by suggestions to oneself: a rule, or a family whose parameters are estimated as well.
    """
    mine = own if isinstance(own, RuleFamily) else RuleFamily.of(own)
    return {
        name: RuleFamily(
            WithSeen.maker(mine.make, seen), {**mine.ranges, **seen.estimated},
            tuple((*one, *other) for one in mine.tried for other in seen.tried), mine.logarithms,
            f", neighbours {name}",
        )
        if seen.estimated else mine
        for name, seen in SEEN_RULES.items()
    }  # fmt: skip
