"""The shipped trust rules with the ranges of their parameters, for estimates."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product

from ..people.neighbours import SEEN_RULES, WithSeen, parts_of
from ..people.trust_rules import RULES, TrustRule, constant, fields_of, fitted_of
from .intervals import Interval
from .likelihood import Method

KNOWN = ("eta", "utility_scale")
"""Parameters of rules that a `Method` may know."""


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
    """Return the shipped rules by name, without what the method knows of their parameters."""
    found = {}
    for name, make in RULES.items():
        known = {one: getattr(method, one) for one in KNOWN if one in fields_of(name)}
        known = {one: value for one, value in known.items() if value is not None}
        fitted = {one: mark for one, mark in fitted_of(name).items() if one not in known}
        scale = {one: math.log if mark.logarithm else float for one, mark in fitted.items()}
        found[name] = RuleFamily(
            partial(make, **known),
            {one: (scale[one](mark.low), scale[one](mark.high)) for one, mark in fitted.items()},
            tuple(product(*(map(scale[one], mark.tried) for one, mark in fitted.items()))),
            frozenset(one for one, mark in fitted.items() if mark.logarithm),
        )
    return found


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
