"""Policies of people on tasks that are too large to enumerate, as team policies see them.

Such a policy covers a part of a task and is solved when it is first needed. Team policies ask it to prepare itself, and
do not know how.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar, Protocol, TypeGuard

from planner import CostToGo

from ..person.pomdp import Policy
from ..person.qmdp import QMDP
from .attention_subproblem import AttentionSubproblem


class PolicyOnPart(Policy, Protocol):
    """A person's policy on a part of a task, which is solved when it is first needed.

    The class attribute `on_part` marks such a policy: reading its `pomdp` would already solve the person's problem.

    Attributes
    ----------
    on_part : bool
        True.
    """

    on_part: ClassVar[bool]

    @property
    def known(self) -> CostToGo:
        """The cost-to-go of the whole task."""
        ...

    def prepare(self) -> Any:
        """Solve the person's problem with a robot that is always there; once."""
        ...

    def prepare_visits(self, entry: float, entry_steps: int, longest: int, price: float, /) -> Any:
        """Solve the problem with a robot that comes and goes, once; arguments as in `AttentionSubproblem.of`."""
        ...


class LocalPolicy(Policy, Protocol):
    """What a `PolicyOnPart` gives for one step: a policy on the states in which people are and those that come next.

    Attributes
    ----------
    for_one_step : bool
        True.
    """

    for_one_step: ClassVar[bool]

    def visits(self, entry: float, entry_steps: int, longest: int, price: float, /) -> tuple[AttentionSubproblem, QMDP]:
        """Return the problem with a robot that comes and goes, and its policy (see `AttentionSubproblem.of`)."""
        ...


def is_on_part(policy: Policy) -> TypeGuard[PolicyOnPart]:
    """Return whether a policy is on a part of a task."""
    return getattr(type(policy), "on_part", False)


def is_for_one_step(policy: Policy) -> TypeGuard[LocalPolicy]:
    """Return whether a policy holds for one step only."""
    return getattr(type(policy), "for_one_step", False)


def on_parts(policies: Iterable[Policy]) -> list[PolicyOnPart]:
    """Return those of some policies that are on a part of a task."""
    return [policy for policy in policies if is_on_part(policy)]
