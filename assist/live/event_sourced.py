"""State that follows from a sequence of events, and its views: what a `Session` saves."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from planner import CostToGo

from ..explain.explanation import Explanation
from ..people.goals import Goals
from .advice import Advice
from .events import Event
from .store import Change


class EventSourced(Protocol):
    """State that follows from a sequence of events, and its views; `Course` implements it for one team."""

    count: int
    paused: bool
    fault: str | None
    recent: deque[dict[str, Any]]

    def happen(self, event: Event, time: float) -> dict[str, Any] | None:
        """Apply an event, and return its record.

        After an InvalidError, InapplicableError or InvalidError nothing has changed.
        """

    def again(self, record: Mapping[str, Any]) -> None:
        """Apply a recorded event."""

    def farewell(self, person: str) -> Event | None:
        """Return the event by which a person leaves for good; None if they have left.

        Raises
        ------
        AbsentError
            Nothing is recorded of this person.
        """

    def without(self, person: str, label: str) -> Change:
        """Return a function that removes what is recorded of a person; called for all records in order.

        The records without it lead to the same states of the others. The label stands for the person.
        """

    def touched(self, record: Mapping[str, Any]) -> set[str]:
        """Return the people whose view an event has changed."""

    def require(self, person: str) -> None:
        """Check that a person is present."""

    @property
    def people(self) -> tuple[str, ...]:
        """The people who are present."""

    @property
    def advices(self) -> tuple[Advice, ...]:
        """The decision after the last event, of each robot."""

    def person(self, person: str) -> dict[str, Any]:
        """Return a person's view."""

    def entry(self, person: str) -> dict[str, Any]:
        """Return the operator's view of a person."""

    def place(self, person: str) -> tuple[CostToGo | Goals, int]:
        """Return a person's task, and the number of its present state."""

    def robot(self, number: int = 1) -> dict[str, Any]:
        """Return where a robot should be, and its suggestion there; robots are numbered from 1."""

    def beliefs(self) -> dict[str, bytes]:
        """Return the belief about each person, as the bytes of its array."""

    def log(self, task: str | None = None) -> list[dict[str, Any]]:
        """Return all actions as `fit` reads them."""


class Explains(Protocol):
    """The state of a session (`EventSourced`) that can also explain its suggestions."""

    def explain_later(self, person: str, against: str | None = None) -> Callable[[], Explanation]:
        """Return a function that explains a person's suggestion, or why there is none."""


@dataclass(frozen=True)
class Outlook:
    """The team's part of the operator's view; `EventSourced.entry` has that of each person.

    Attributes
    ----------
    events : int
        Number of events.
    paused : bool
        Whether the robot makes no suggestions.
    recent : list of dict
        The latest events, the oldest first.
    fault : str or None
        Error of the policy after the last event, if there was one; the robot then does nothing.
    robots : tuple of dict
        Where each robot is to be, and its suggestion there.
    """

    events: int
    paused: bool
    recent: list[dict[str, Any]]
    fault: str | None
    robots: tuple[dict[str, Any], ...]
