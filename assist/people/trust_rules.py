"""Trust rules: how a person's influence theta moves after a suggestion, on arrays.

The paper's rule is `EquationSeven`: theta moves by what the person thinks of the suggestion, whether they follow it or
not. Real advice data support other rules better (docs/people.md): a theta of one's own that stays (`constant`), or that
moves on the logit scale by the outcome of the advice (`outcome`, `outcome_at_disagreement`). All of these are
`LogitSteps`. With `Reliability` theta is the mean of a beta distribution that counts outcomes. A rule of one's own is
any frozen object with the attributes and the method of `TrustRule`.

A rule is shipped by its name once it is in `RULES`. All else follows from its class: its description is the first
sentence of its docstring, and a field with the mark `Fitted` is estimated from logs.

A rule is a deterministic map of theta and an `Event`. The robot's problem of one person evaluates it at its grid of
theta, and a simulation at the people's own values, so that there is one definition of each rule. Only equation (7), the
default, is also written in `decision.trust`, and in `person.dynamics` and `influence_kernels` for speed; tests compare
them. Where a rule has an attribute `counts`, the number of outcomes that a person has seen is part of the map, up to
that number. `perceived_suggestions.moved` applies a rule: simulations, live people and estimates call it at people's
own theta, and `person.trust_shares` at the grid's, for the filter, the solvers and the bounds.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Protocol, TypeVar, overload

from pydantic import Field

from planner.system.errors import expected

from ..declare.declared import (
    MOST,
    DeclarationError,
    Number,
    Truth,
    Whole,
    annotation_of,
    declared,
    is_declared,
    marks,
    plain,
)

if TYPE_CHECKING:
    from .decision import Bools, Floats

Feedback = Literal["perceived", "true", "never"]
OF_FEEDBACK = "What people who follow a suggestion see of the outcome: by their own costs, by exact ones, or nothing."

LEAST = 0.01
"""Least theta that logit steps lead to, and one minus the largest: a step from 0 or 1 on the logit scale leads nowhere.

At .01 a suggestion divides the odds of an action by 99. Fits to two public data sets of advice use the same limits.
"""

LARGEST_STEP = 3.0
"""Largest step that is estimated, in log-odds: from theta = .18 to .82 at once."""


@dataclass(frozen=True)
class Fitted:
    """Marks a field of a rule that is estimated from logs.

    Attributes
    ----------
    low, high : float
        The range of estimates.
    tried : tuple of float
        Values from which the best one is refined, with each combination of those of the other fields.
    logarithm : bool
        Whether the logarithm is estimated: the likelihood of some parameters has a long tail, and that of their
        logarithm hardly any.
    """

    low: float
    high: float
    tried: tuple[float, ...]
    logarithm: bool = False


STEP = Fitted(0.0, LARGEST_STEP, (0.1, 0.4))


@dataclass(frozen=True)
class Event:
    """A step in which people act, with a suggestion and their answer, or without; arrays that broadcast with theta.

    Without a suggestion, `gain` is 0 and the others are False.

    Attributes
    ----------
    gain : float array
        V(x_r) - V(x): the gain of the suggested action as the person perceives it, in cost units.
    agrees : bool array
        Whether the suggested action is the person's own choice: no action has a lower perceived cost.
    followed : bool array
        Whether the person did what was suggested.
    shown : bool array
        Whether the person sees if the suggestion was right.
    right : bool array
        Whether the suggestion was right, by the outcome that the person sees.
    suggested : bool array
        Whether there was a suggestion; always, for rules without `sees_silence`.
    """

    gain: Floats
    agrees: Bools
    followed: Bools
    shown: Bools
    right: Bools
    suggested: Bools | bool = True

    @classmethod
    def silent(cls) -> Event:
        """Return the event of a step without a suggestion."""
        import numpy as np

        return cls(np.zeros(()), *(np.zeros((), dtype=bool) for _ in range(5)))


class TrustRule(Protocol):
    """A map of theta and an event to the theta after it.

    Further attributes are optional. With `counts` (`counts_of`), `update` has a third argument, the count of outcomes
    or, with a method `counted(count, event)`, of what this counts. With `sees_silence` (`may_move`), the rule is also
    applied in steps without a suggestion.

    Attributes
    ----------
    uses_answer : bool
        Whether the map depends on the person's answer, that is, on `followed` or `shown`.
    feedback : "perceived", "true" or "never"
        Whether people who follow a suggestion see that it was right: by the cost-to-go that they perceive (the
        suggested action raises V), by the exact one (it is an optimal choice), or not at all.
    """

    @property
    def uses_answer(self) -> bool:
        """Whether the map depends on the answer."""
        ...

    @property
    def feedback(self) -> Feedback:
        """What people see of the outcome."""
        ...

    def update(self, theta: Floats, event: Event) -> Floats:
        """Return theta after the event; the arrays of both broadcast."""
        ...


@declared
class EquationSeven:
    """Equation (7) of the paper: theta' = clip(theta + eta (V(x_r) - V(x)) / utility_scale, 0, 1)."""

    eta: Annotated[
        Number,
        Fitted(0.0, 1.0, (0.02, 0.05, 0.1, 0.2, 0.4)),
        Field(ge=0, le=MOST, description="Rate of the trust update; 0.2 in the paper's study."),
    ] = 0.2
    utility_scale: Annotated[Number, Field(ge=1 / MOST, le=MOST, description="Unit of V, in cost units.")] = 1.0
    feedback: Annotated[Literal["never"], Field(description="The outcome does not matter.")] = "never"
    uses_answer: ClassVar[bool] = False
    tag: ClassVar[Mapping[str, str]] = {"rule": "paper"}

    def update(self, theta: Floats, event: Event) -> Floats:
        """Return theta after the event; equation (7)."""
        from .decision import trust

        return trust(theta, 0.0, event.gain, self.eta, self.utility_scale)


@declared
class LogitSteps:
    """A rule that adds a step to logit(theta), which depends on agreement and on the outcome as the person sees it."""

    agreement: Annotated[
        Number,
        Fitted(-1.0, 1.0, (0.0, 0.1)),
        Field(
            ge=-MOST,
            le=MOST,
            description="Step where the person would have chosen the suggested action anyway, in log-odds.",
        ),
    ] = 0.0
    gain: Annotated[
        Number,
        STEP,
        Field(
            ge=0,
            le=MOST,
            description="Step up after a suggestion that the person followed and saw to be right, in log-odds.",
        ),
    ] = 0.0
    loss: Annotated[
        Number,
        STEP,
        Field(
            ge=0,
            le=MOST,
            description="Step down after a suggestion that the person followed and saw to be wrong, in log-odds.",
        ),
    ] = 0.0
    at_agreement: Annotated[
        Truth, Field(description="Whether these two steps are also taken at agreement, in place of `agreement`.")
    ] = False
    feedback: Annotated[Feedback, Field(description=OF_FEEDBACK)] = "perceived"

    @property
    def tag(self) -> Mapping[str, str]:
        """The name of the rule of which it is one."""
        if self.at_agreement:
            return {"rule": "outcome"}
        return {"rule": "outcome-at-disagreement" if self.agreement or self.gain or self.loss else "constant"}

    @property
    def uses_answer(self) -> bool:
        """Whether a step depends on the outcome."""
        return self.feedback != "never" and (self.gain > 0 or self.loss > 0)

    def update(self, theta: Floats, event: Event) -> Floats:
        """Return theta after the event, between `LEAST` and 1 - `LEAST` where it moves."""
        import numpy as np

        seen = np.where(event.shown, np.where(event.right, self.gain, -self.loss), 0.0)
        step = seen if self.at_agreement else np.where(event.agrees, self.agreement, seen)
        start = np.clip(np.asarray(theta, dtype=float), LEAST, 1 - LEAST)
        moved = np.clip(1 / (1 + np.exp(-step) * (1 - start) / start), LEAST, 1 - LEAST)
        return np.where(step == 0, theta, moved)


@declared
class Reliability:
    """A rule by which theta is the mean of a beta distribution whose counts are the outcomes that the person has seen.

    With n the sum of the two counts, an outcome that is right or wrong leads to

        n' = (1 - forgetting) n + 1,  theta' = ((1 - forgetting) n theta + [right]) / n'.

    A robot's problem has a grid of theta for each number of outcomes from 0 to `counts`.
    """

    weight: Annotated[
        Number,
        Fitted(0.5, 200.0, tuple(map(math.exp, (1.0, 2.3, 3.7))), logarithm=True),  # about 3, 10 and 40
        Field(gt=0, le=MOST, description="Value of n at first: how many outcomes the initial theta is worth."),
    ] = 20.0
    forgetting: Annotated[
        Number,
        Fitted(0.0, 0.9, (0.05, 0.3)),
        Field(ge=0, lt=1, description="Share of the counts that is forgotten at each outcome."),
    ] = 0.05
    counts: Annotated[
        Whole,
        Field(
            ge=0, description="Number of outcomes by which n moves; then it stays, and outcomes have the same weight."
        ),
    ] = 5
    feedback: Annotated[Feedback, Field(description=OF_FEEDBACK)] = "perceived"

    tag: ClassVar[Mapping[str, str]] = {"rule": "reliability"}

    @property
    def uses_answer(self) -> bool:
        """Whether outcomes are seen at all."""
        return self.feedback != "never"

    def update(self, theta: Floats, event: Event, count: Floats | int = 0) -> Floats:
        """Return theta after the event, between `LEAST` and 1 - `LEAST` where it moves.

        Parameters
        ----------
        theta : float array
        event : Event
        count : int array
            Number of outcomes before, at most `counts`.
        """
        import numpy as np

        kept, before = 1 - self.forgetting, [self.weight]
        for _ in range(self.counts):
            before.append(kept * before[-1] + 1)
        n = kept * np.array(before)[np.asarray(count, dtype=np.int64)]
        start = np.clip(np.asarray(theta, dtype=float), LEAST, 1 - LEAST)
        moved = np.clip((n * start + event.right) / (n + 1), LEAST, 1 - LEAST)
        return np.where(event.shown, moved, theta)


def counts_of(rule: TrustRule) -> int:
    """Return how many outcomes a rule counts at most; 0 if theta is all that it depends on."""
    return int(getattr(rule, "counts", 0))


@overload
def may_move(rule: TrustRule, suggested: Bools) -> Bools: ...


@overload
def may_move(rule: TrustRule, suggested: bool) -> bool: ...


def may_move(rule: TrustRule, suggested: Bools | bool) -> Bools | bool:
    """Return in which steps a rule may move theta and its count, from whether there was a suggestion in each.

    A rule with an attribute `sees_silence = True` is applied in all steps in which people act. Under other rules, theta
    and the count stay in steps without a suggestion.
    """
    return suggested | bool(getattr(rule, "sees_silence", False))


def constant() -> LogitSteps:
    """Return the rule of a theta that never moves."""
    return LogitSteps(feedback="never")


def outcome(gain: float = 0.1, loss: float = 0.2, feedback: Feedback = "perceived") -> LogitSteps:
    """Return the rule of a theta that moves by the outcome of what was followed, whatever the person thought of it.

    Parameters
    ----------
    gain, loss, feedback
        As in `LogitSteps`.
    """
    return LogitSteps(gain=gain, loss=loss, at_agreement=True, feedback=feedback)


def outcome_at_disagreement(
    agreement: float = 0.03, gain: float = 0.1, loss: float = 0.2, feedback: Feedback = "perceived"
) -> LogitSteps:
    """Return the rule of a theta that moves by agreement, and at disagreement by the outcome of what was followed.

    The steps were chosen on the data of 813 people who judged cards and dates with advice, who seem to include all
    people of docs/results/trust.md; figures on these are no independent evidence for them. There the outcome was shown
    after advice that was declined, too; here people see the outcome of what they did.

    Parameters
    ----------
    agreement, gain, loss, feedback
        As in `LogitSteps`.
    """
    return LogitSteps(agreement, gain, loss, feedback=feedback)


R = TypeVar("R")


def by_name(*makers: Callable[..., R]) -> dict[str, Callable[..., R]]:
    """Return classes of rules by their tags, and functions that make rules by their own names."""
    named: Any = makers
    return {getattr(one, "tag", {"rule": one.__name__.replace("_", "-")})["rule"]: one for one in named}


RULES: dict[str, Callable[..., TrustRule]] = by_name(
    EquationSeven, constant, outcome, outcome_at_disagreement, Reliability
)
"""Classes of the shipped rules, or functions that make them, by name."""


def described(make: Callable[..., Any]) -> str:
    """Return the sentence that describes a shipped rule, of which this is the class or function that makes it."""
    return str(make.__doc__).split("\n", 1)[0].removeprefix("Return the rule of ").rstrip(".")


def fields_of(make: Callable[..., Any]) -> dict[str, Any]:
    """Return the annotations of the fields that a shipped rule is made with."""
    return {field: annotation_of(type(make()), field) for field in inspect.signature(make).parameters}


def fitted_of(make: Callable[..., Any]) -> dict[str, Fitted]:
    """Return the marks of those fields of a shipped rule that are estimated from logs."""
    found = ((field, one) for field, kind in fields_of(make).items() for one in marks(kind) if isinstance(one, Fitted))
    return dict(found)


def plain_rule(rule: TrustRule) -> dict[str, Any]:
    """Return a shipped rule as plain data, from which `of_table` makes an equal one.

    Raises
    ------
    ValueError
        The rule is the user's own.
    """
    if not is_declared(type(rule)) or getattr(rule, "tag", {}).get("rule") not in RULES:
        raise ValueError(f"trust {rule!r}: a rule that is not saved; expected one of those shipped")
    found: dict[str, Any] = plain(rule)
    return found


def of_table(rules: Mapping[str, Callable[..., R]], given: Mapping[str, Any]) -> R:
    """Return the one of some rules that a table has, whose field `rule` is its name; other fields are the rule's.

    Parameters
    ----------
    rules : mapping of str to callable
        What makes each rule, as from `by_name`.
    given : mapping of str to object
        The table; fields that it lacks have their defaults.

    Raises
    ------
    ValueError
        There is no such rule, or it has no such field.
    """
    name, numbers = given.get("rule"), {key: value for key, value in given.items() if key != "rule"}
    if name not in rules:
        said = "is missing" if name is None else f"'{name}'"
        right = expected(str(name), rules) if name else f"expected one of {', '.join(rules)}"
        raise DeclarationError(("rule",), None, f"{said}; {right}", f"rule {said}; {right}")
    made: Any = rules[str(name)]()
    found: R = replace(made, **numbers)
    return found


def trust_rule(rule: str | TrustRule | None, eta: float, utility_scale: float) -> TrustRule:
    """Return a rule; by its name the paper's, also for None, with this rate and unit, others with default steps."""
    if not isinstance(rule, str | None):
        return rule
    return EquationSeven(eta, utility_scale) if rule in (None, "paper") else RULES[rule]()
