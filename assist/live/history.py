"""State that follows from a list of events, and its views: what a `Session` saves, serves and restores."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Generic, TypeVar

from planner import CostToGo

from ..people.goals import Goals
from .advice import Advice
from .event_base import Event
from .explanation import Explanation
from .record import Record
from .roster import News
from .views import Outlook, PersonView, RobotView

R = TypeVar("R", bound=Record)

Change = Callable[[Any, Any], tuple[Any, Any]]
"""Returns a record and its answer as they are to be stored, without what is to be erased."""


class History(ABC, Generic[R]):
    """State that follows from a list of events: of a team, or of a study.

    Attributes
    ----------
    count : int
        Number of events.
    fault : str or None
        Error of the policy after the last event; the robots then do nothing, and people continue to act.
    recent : deque of dict
        The latest events, as the operator's page lists them.
    """

    def __init__(self) -> None:
        self.count = 0
        self.fault: str | None = None
        self.recent: deque[dict[str, Any]] = deque(maxlen=50)

    @abstractmethod
    def happen(self, event: Event, time: float) -> R | None:
        """Apply an event at a time in seconds, and return its record; None if nothing has changed.

        Raises
        ------
        Refusal
            The event is not possible. Nothing has changed.
        """

    def due(self) -> Iterator[tuple[float, Event]]:
        """Yield the events that time alone will cause from the present state, each with when it does, in seconds."""
        yield from ()

    @abstractmethod
    def again(self, record: R) -> None:
        """Apply a recorded event.

        Raises
        ------
        ValueError
            The record is not possible here.
        """

    @abstractmethod
    def farewell(self, person: str) -> Event | None:
        """Return the event by which a person leaves for good; None if they have left.

        Raises
        ------
        AbsentError
            Nothing is recorded of this person.
        """

    @abstractmethod
    def without(self, person: str, label: str) -> Change:
        """Return a function that removes what is recorded of a person; called for all records in order.

        The records without it lead to the same states of the others. The label stands for the person.
        """

    @abstractmethod
    def touched(self, record: R) -> set[str]:
        """Return the people whose view the last event has changed."""

    @abstractmethod
    def followed(self, record: R) -> bool | None:
        """Return whether the last event, which this is, followed a suggestion; None if it answers none."""

    @property
    def paused(self) -> bool:
        """Whether the robots make no suggestions."""
        return False

    # Views.

    @abstractmethod
    def require(self, person: str) -> None:
        """Check that a person is present.

        Raises
        ------
        AbsentError
            The person is not present.
        """

    @property
    @abstractmethod
    def people(self) -> tuple[str, ...]:
        """The people who are present, in the order of their first arrival."""

    @property
    @abstractmethod
    def advices(self) -> tuple[Advice, ...]:
        """The decision after the last event, of each robot."""

    @abstractmethod
    def person(self, person: str) -> PersonView:
        """Return a person's view."""

    @abstractmethod
    def entry(self, person: str) -> PersonView:
        """Return the operator's view of a person."""

    @abstractmethod
    def task_and_state(self, person: str) -> tuple[CostToGo | Goals, int]:
        """Return a person's task, and the number of its present state."""

    def news(self, person: str) -> Sequence[News]:  # noqa: ARG002
        """Return what has become known of a person, or moved them, between actions in their task."""
        return ()

    @abstractmethod
    def robot(self, number: int = 1) -> RobotView:
        """Return where a robot should be, and its suggestion there; robots are numbered from 1."""

    @abstractmethod
    def beliefs(self) -> dict[str, bytes]:
        """Return the belief about each present person, as the bytes of its array."""

    @abstractmethod
    def log(self, task: str | None = None) -> list[dict[str, Any]]:
        """Return all actions as `fit` reads them, with their times in seconds; or only those in one task.

        Raises
        ------
        Refusal
            There is no such task.
        """

    @abstractmethod
    def explain_later(self, person: str, against: str | None = None) -> Callable[[], Explanation]:
        """Return a function that explains a person's suggestion, or why there is none, by the present beliefs.

        The function may be called from another thread.
        """

    def outlook(self) -> Outlook:
        """Return the team's part of the operator's view."""
        robots = tuple(self.robot(number) for number in range(1, 1 + len(self.advices)))
        return Outlook(seq=self.count, paused=self.paused, fault=self.fault, robots=robots, log=tuple(self.recent))
