"""The shipped trust rules with the ranges of their parameters, for estimates."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from inspect import Parameter, signature
from itertools import product
from types import MappingProxyType
from typing import Annotated, Any

from pydantic import Field

from planner.system.errors import expected

from ..declare.declared import AnyText, Expected, Number, Range, declared
from ..people.given_rules import rule_given
from ..people.trust_rules import LEAST, RULES, TrustRule, constant, fields_of, fitted_of
from ..people.user_code import UserCodeError
from .likelihood import Method

KNOWN = ("eta", "utility_scale")
"""Parameters of rules that a `Method` may know."""


@declared
class RuleFamily:
    """A shipped trust rule whose parameters are to be estimated."""

    make: Annotated[
        Callable[..., Any], Field(description="Returns the rule with the parameters."),
        Expected("the class of a rule, or a function that returns one"),
    ]  # fmt: skip
    ranges: Annotated[dict[str, Range], Field(description="Range of each value, by the parameter's name.")]
    tried: Annotated[
        tuple[tuple[Number, ...], ...], Expected("a tuple of tuples, each with a value for each range"),
        Field(min_length=1, description="Values that are tried before the best are refined."),
    ]  # fmt: skip
    logarithms: Annotated[
        frozenset[str], Expected("a set of names of ranges"),
        Field(description="Parameters whose values are their logarithms."),
    ] = frozenset()  # fmt: skip
    beside: Annotated[
        AnyText, Field(description="What beside suggestions to oneself moves theta, for the name of the rule.")
    ] = ""

    def __post_init__(self) -> None:
        for name, (low, high) in self.ranges.items():
            if not low < high:
                raise ValueError(f"ranges: {name} ({low:g}, {high:g}): expected two numbers, low < high")
        _require_parameters(self.make, list(self.ranges))
        for name in self.logarithms:
            if name not in self.ranges:
                right = expected(name, self.ranges) if self.ranges else "expected none"
                raise ValueError(f"logarithms: {name}: has no range; {right}")
        for number, given in enumerate(self.tried):
            if len(given) != len(self.ranges):
                names = ", ".join(self.ranges) or "nothing"
                raise ValueError(f"tried[{number + 1}] {given!r}: expected values of {names}, as many as ranges")
            for (name, (low, high)), value in zip(self.ranges.items(), given, strict=True):
                if not low <= value <= high:
                    raise ValueError(f"tried[{number + 1}] {given!r}: {name} is outside its range, {low:g} to {high:g}")

    def parameter(self, name: str, value: float) -> float:
        """Return the parameter that a value stands for."""
        return math.exp(value) if name in self.logarithms else value

    def rule(self, values: Sequence[float]) -> TrustRule:
        """Return the rule with these values, in the order of `ranges`."""
        pairs = zip(self.ranges, values, strict=True)
        return self.make(**{name: self.parameter(name, value) for name, value in pairs})

    @classmethod
    def made_by(cls, make: Callable[..., Any], known: Mapping[str, float] = MappingProxyType({})) -> RuleFamily:
        """Return the family of a shipped rule: what is marked as `Fitted` is estimated, unless it is known.

        Parameters
        ----------
        make : callable
            The class of the rule, or a function that makes it.
        known : mapping of str to float
            Parameters that are known.
        """
        fitted = {one: mark for one, mark in fitted_of(make).items() if one not in known}
        scale = {one: math.log if mark.logarithm else float for one, mark in fitted.items()}
        return cls(
            partial(make, **known),
            {one: (scale[one](mark.low), scale[one](mark.high)) for one, mark in fitted.items()},
            tuple(product(*(map(scale[one], mark.tried) for one, mark in fitted.items()))),
            frozenset(one for one, mark in fitted.items() if mark.logarithm),
        )

    def joined(self, other: RuleFamily, join: Callable[[Any, Any], TrustRule], beside: str) -> RuleFamily:
        """Return the family of rules that `join` makes of one of this family and one of another.

        Parameters
        ----------
        other : RuleFamily
            Its parameters have other names.
        join : callable
        beside : str
            What the other one says of the name of the rule.
        """

        def made(**numbers: float) -> TrustRule:
            return join(*(one.make(**{name: numbers[name] for name in one.ranges}) for one in (self, other)))

        return RuleFamily(
            made, {**self.ranges, **other.ranges}, tuple((*a, *b) for a, b in product(self.tried, other.tried)),
            self.logarithms | other.logarithms, beside,
        )  # fmt: skip

    @classmethod
    def of(cls, rule: Any) -> RuleFamily:
        """Return the family of one rule, without parameters to estimate."""
        return cls(lambda: rule, {}, ((),))


def _require_parameters(make: Callable[..., Any], names: Sequence[str]) -> None:
    """Check that a rule takes these parameters."""
    try:
        taken = signature(make).parameters
    except (TypeError, ValueError):  # some callables do not say
        return
    some = any(one.kind is Parameter.VAR_KEYWORD for one in taken.values())
    for name in () if some else names:
        if name not in taken:
            right = expected(name, taken) if taken else "the rule has no parameters"
            raise ValueError(f"ranges: {name}: no parameter of the rule; {right}")


def families(method: Method) -> dict[str, RuleFamily]:
    """Return the shipped rules by name, without what the method knows of their parameters.

    Parameters
    ----------
    method : Method
        Its `eta` and `utility_scale` are not estimated where they are known.
    """
    found = {}
    for name, make in RULES.items():
        known = {one: getattr(method, one) for one in KNOWN if one in fields_of(make)}
        found[name] = RuleFamily.made_by(make, {one: value for one, value in known.items() if value is not None})
    return found


def name_of(rule: Any) -> str:
    """Return the name of a rule: that of a shipped one, FILE.py:RULE, or the name of its class."""
    if isinstance(rule, RuleFamily):
        rule = _own(rule)
    return rule if isinstance(rule, str) else str(getattr(rule, "__name__", type(rule).__name__))


def _own(family: RuleFamily) -> TrustRule:
    """Return the first rule of a family that is tried, without what moves theta beside it."""
    first = family.rule(family.tried[0])
    found: TrustRule = getattr(first, "own", first)
    return found


def family_of(rule: str | TrustRule | RuleFamily, method: Method) -> RuleFamily:
    """Return the family of a rule: that of a shipped one by its name, or one without parameters to estimate."""
    try:
        if isinstance(rule, RuleFamily):
            rule_given(_own(rule), LEAST)
            return rule
        given = rule_given(rule, LEAST)
    except UserCodeError:
        raise
    except ValueError as error:
        raise ValueError(f"trust {error}") from None
    if given is None:
        raise ValueError(f"trust None: expected one of {', '.join(RULES)}, or a rule")
    return families(method)[given] if isinstance(given, str) else RuleFamily.of(given)


def parameters_of(rule: TrustRule) -> dict[str, float]:
    """Return the numbers that a rule and its parts have, by name; a theta that never moves has none."""
    own = {} if rule == constant() else vars(rule)
    parts = [parameters_of(part) for part in own.values() if hasattr(part, "update") and hasattr(part, "__dict__")]
    numbers = {name: float(value) for name, value in own.items() if type(value) in (int, float)}
    return {name: value for part in (*reversed(parts), numbers) for name, value in part.items()}
