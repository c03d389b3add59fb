"""What people think of suggestions, and how their theta and the count of their rule move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .decision import Bools, Floats, Ints
from .trust_rules import Event, Feedback, TrustRule, counts_of, may_move


def moved(rule: TrustRule, theta: Floats, count: Ints, event: Event) -> tuple[Floats, Ints]:
    """Return theta and the count of a rule after an event; the count stays 0 for rules without `counts`.

    Both stay where the rule may not move them (`may_move`). The count is the number of outcomes that the
    person has seen, unless the rule has a method `counted(count, event)`.

    Parameters
    ----------
    rule : TrustRule
    theta : float array
    count : int array
        From 0 to the rule's `counts`.
    event : Event
    """
    most = counts_of(rule)
    if not most:
        found, number = rule.update(theta, event), count
    else:
        counting: Any = rule
        counted = getattr(rule, "counted", lambda count, event: np.minimum(count + event.shown, most))
        found, number = counting.update(theta, event, count), counted(count, event)
    moves = may_move(rule, np.asarray(event.suggested))
    if moves.all():
        return found, number
    return np.where(moves, found, theta), np.where(moves, number, count)


@dataclass(frozen=True)
class PerceivedSuggestions:
    """What people think of suggestions, and whether these are optimal; arrays that broadcast.

    Attributes
    ----------
    gain : float array
        V(x_r) - V(x), in cost units.
    agrees : bool array
        No action has a lower perceived cost.
    optimal : bool array
        The suggested action is an optimal choice.
    """

    gain: Floats
    agrees: Bools
    optimal: Bools

    @classmethod
    def of(cls, cost: Floats, least: Floats, before: Floats, after: Floats, optimal: Bools) -> PerceivedSuggestions:
        """Evaluate suggestions; all arrays broadcast.

        Parameters
        ----------
        cost, least : float arrays
            Perceived cost of the suggested action, and the least one of all actions.
        before, after : float arrays
            V of the present state, and of the state in which the suggested action would end.
        optimal : bool array
            The suggested action is an optimal choice.
        """
        with np.errstate(invalid="ignore"):  # from one dead end to another nothing is gained
            gain = np.where(before == after, 0.0, np.subtract(after, before))
        return cls(gain, np.asarray(cost <= least), np.asarray(optimal))

    def event(self, followed: Bools | bool, feedback: Feedback, suggested: Bools | bool = True) -> Event:
        """Return the event of these suggestions, followed or not, with what people see of the outcome.

        Where `suggested` is False there was none, whatever the other values are.
        """
        suggested = np.asarray(suggested)
        followed = followed & suggested
        right = (self.optimal if feedback == "true" else self.gain > 0) & suggested
        gain = np.where(suggested, self.gain, 0.0)
        return Event(gain, self.agrees & suggested, followed, followed & (feedback != "never"), right, suggested)
