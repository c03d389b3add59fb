"""Policies for people on truncated tasks, as team policies see them.

Such a policy covers a truncated task and is solved on first use. A team policy asks it to prepare itself and does not
depend on how it does so.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar, Protocol, TypeGuard

from planner import CostToGo

from ..person.pomdp import Policy
from ..person.qmdp import QMDP
from .attention_subproblem import AttentionSubproblem


class PolicyOnPart(Policy, Protocol):
    """A person's policy on a truncated task, which is solved on first use.

    The class attribute `on_part` marks such a policy, because reading its `pomdp` would already solve the problem.

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
        """Solve the person's problem with a robot that is always present; the result is cached."""
        ...

    def prepare_visits(self, entry: float, entry_steps: int, longest: int, price: float, /) -> Any:
        """Solve the problem with a robot that comes and goes, once; arguments as in `AttentionSubproblem.of`."""
        ...


class LocalPolicy(Policy, Protocol):
    """The policy of a `PolicyOnPart` for one step: on the people's states and their successors.

    Attributes
    ----------
    for_one_step : bool
        True.
    """

    for_one_step: ClassVar[bool]

    def visits(self, entry: float, entry_steps: int, longest: int, price: float, /) -> tuple[AttentionSubproblem, QMDP]:
        """Return the person's attention subproblem and its policy; arguments as in `AttentionSubproblem.of`."""
        ...


def is_on_part(policy: Policy) -> TypeGuard[PolicyOnPart]:
    """Return whether a policy is one for a truncated task."""
    return getattr(type(policy), "on_part", False)


def is_for_one_step(policy: Policy) -> TypeGuard[LocalPolicy]:
    """Return whether a policy is valid for one step only."""
    return getattr(type(policy), "for_one_step", False)


def on_parts(policies: Iterable[Policy]) -> list[PolicyOnPart]:
    """Return those of the policies that are for truncated tasks."""
    return [policy for policy in policies if is_on_part(policy)]
