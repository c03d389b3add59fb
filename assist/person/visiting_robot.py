"""A robot that comes to a person and goes away again, as a policy for that person meets it."""

from __future__ import annotations

from typing import Any, Protocol

from ..people.decision import Floats


class VisitingRobot(Protocol):
    """The robot of a team from one person's view: it comes to the person and leaves. Team policies provide it.

    Attributes
    ----------
    entry : float
        Cost of coming, in cost units.
    entry_steps, longest : int
        Mean and largest number of steps of coming, for decisions; bounds take the smallest (`Travel.entry_steps`).
    """

    @property
    def entry(self) -> float: ...  # noqa: D102
    @property
    def entry_steps(self) -> int: ...  # noqa: D102
    @property
    def longest(self) -> int: ...  # noqa: D102

    @property
    def price(self) -> Floats:
        """The price of each step of attention, in cost units; the last applies to all later steps."""
        ...

    def solved(self, policy: Any, /) -> Any:
        """Return the solved problem of a person with this robot, given the person's policy on an enumerated task."""
        ...
