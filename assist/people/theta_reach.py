"""How far theta can come by what somebody sees of neighbours, for rules with a method `envelope`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from .belief import Grid
from .decision import Bools, Floats
from .human import HumanModel
from .neighbourhood import Neighbourhood, seen_gain
from .neighbours import Range, SeenRule


def range_of_gains(model: HumanModel, heard: Bools) -> Range:
    """Return the least and the largest gain of a step of a person who may have got a suggestion.

    Parameters
    ----------
    model : HumanModel
    heard : bool array, shape (n,)
        In which states something can be suggested.
    """
    choices = model.choices
    row, slot = np.nonzero(choices.applicable & heard[:, None])
    gain = seen_gain(model, row, choices.targets[row, slot])
    return float(gain.min(initial=0.0)), float(gain.max(initial=0.0))


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
    def of(cls, rule: SeenRule, grid: Grid, events: Sequence[tuple[Range, float]], most: int) -> Self:
        """Return how far theta comes by at most `most` events of some kinds.

        The least and the largest theta after an event have to rise with theta: those after several follow from them,
        also if fewer events happen. This is checked at all thetas to which the rule is applied here.

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
            The rule has no envelope, or one that falls somewhere as theta rises.
        """
        within = getattr(rule, "envelope", None)
        if within is None:
            raise ValueError(
                f"neighbours: {type(rule).__name__} does not say how far theta can come; a bound expects a rule with "
                "a method envelope(theta, gain, weight)"
            )
        low, high = [grid.theta], [grid.theta]
        for _ in range(most):
            reached = np.unique([grid.theta, low[-1], high[-1]])
            for one in events:
                if any((np.diff(end) < -1e-12).any() for end in within(reached, *one)):
                    raise ValueError(
                        f"neighbours: the envelope of {type(rule).__name__} falls somewhere as theta rises; a bound "
                        "expects a least and a largest theta after an event that rise with theta"
                    )
            low.append(np.min([low[-1], *(within(low[-1], *one)[0] for one in events)], axis=0))
            high.append(np.max([high[-1], *(within(high[-1], *one)[1] for one in events)], axis=0))
        return cls(grid, np.array(low), np.array(high))

    @classmethod
    def at(
        cls, seen: Neighbourhood, places: Iterable[int], model: Sequence[int], gains: Callable[[int], Range],
        grid: Grid, most: int,
    ) -> Self | None:  # fmt: skip
        """Return how far theta of people at some places comes; None if they see nobody.

        Parameters
        ----------
        seen : Neighbourhood
        places : iterable of int
        model : sequence of int
            The model of the person at each place of the team.
        gains : callable
            Returns the range of gains of people of a model, who may get a suggestion (`range_of_gains`).
        grid, most
            As in `of`.

        Raises
        ------
        ValueError
            The rule has no envelope.
        """
        weights: dict[int, float] = {}
        for k in places:
            for j, weight in seen.seen_from(k).items():
                weights[model[j]] = max(weights.get(model[j], 0.0), weight)
        events = [(gains(one), weight) for one, weight in sorted(weights.items())]
        return cls.of(seen.rule, grid, events, most) if events else None

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
