"""How far theta can come by what somebody sees of neighbours, for rules with a method `envelope`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .belief import Grid
from .decision import Floats
from .neighbours import Range, SeenRule


@dataclass(frozen=True, eq=False)
class ThetaReach:
    """How far theta comes in a step, for each value of a grid.

    Attributes
    ----------
    grid : Grid
    low, high : float arrays, shape (M + 1, T)
        Least and largest theta after at most 0, 1, ... M events.
    """

    grid: Grid
    low: Floats
    high: Floats

    @classmethod
    def of(cls, rule: SeenRule, grid: Grid, events: Sequence[tuple[Range, float]], most: int) -> ThetaReach:
        """Return how far theta comes by at most `most` events of some kinds.

        The least and the largest theta after an event rise with theta, so that those after several are their iterates.

        Parameters
        ----------
        rule : SeenRule
        grid : Grid
        events : sequence of pairs
            Of each kind of events, the least and the largest gain, and the largest weight.
        most : int

        Raises
        ------
        ValueError
            The rule has no envelope.
        """
        within = getattr(rule, "envelope", None)
        if within is None:
            raise ValueError(
                f"neighbours: {type(rule).__name__} does not say how far theta can come; a bound expects a rule with "
                "a method envelope(theta, gain, weight)"
            )
        low, high = [grid.theta], [grid.theta]
        for _ in range(most):
            low.append(np.min([within(low[-1], *one)[0] for one in events], axis=0))
            high.append(np.max([within(high[-1], *one)[1] for one in events], axis=0))
        return cls(grid, np.array(low), np.array(high))

    def lifted(self, value: Floats, events: int) -> Floats:
        """Return the largest values, shape (n, H, T), after theta has moved by at most so many events."""
        low, high, count, found = self.low[events], self.high[events], self.grid.count, value.copy()
        if not events:
            return found
        for end in (low, high):
            at, weight = self.grid.shares(end, count)
            np.maximum(found, value[..., at] * (1 - weight) + value[..., at + 1] * weight, out=found)
        for t, theta in enumerate(self.grid.theta.tolist()):
            inside = (low <= theta) & (theta <= high) & (count == count[t])
            found[..., inside] = np.maximum(found[..., inside], value[..., t, None])
        return found
