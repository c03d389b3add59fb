"""What can be reported of a live team: the same verbs for a team in memory, a saved session and a client over HTTP."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from .event_base import TeamEvent
from .events import Acted, Answered, Arrived, Began, Elapsed, Joined, Left, Paused, Rearranged, Undone

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


class Reports:
    """Somebody to whom events are reported; each verb makes one, and `report` takes any.

    Of a person who repeats a report under the same `id`, only the first counts; but an `Assistant` keeps no ids. What a
    report returns is for the classes to say: `Session` and `Client` return the view of the person, or of the robot.
    """

    @abstractmethod
    def report(self, event: TeamEvent) -> Any:
        """Report an event; return what its reporter is to know."""

    def join(self, person: str, task: str | None = None, *, id: str | None = None) -> Any:
        """Add a person, at the beginning of a task, or let one return to the task that they left.

        Parameters
        ----------
        person : str
        task : str, optional
            Name of the task; by default the first.
        id : str, optional
            Chosen by the reporter.
        """
        return self.report(Joined(person=person, task=task, id=id))

    def leave(self, person: str, *, id: str | None = None) -> Any:
        """Remove a person from the team, finished or not."""
        return self.report(Left(person=person, id=id))

    def begin(self, person: str, task: str | None = None, *, id: str | None = None) -> Any:
        """Let a person begin the next task, finished or not; the belief in them remains.

        Parameters
        ----------
        person : str
        task : str, optional
            Name of the task; by default the same again.
        id : str, optional
            Chosen by the reporter.
        """
        return self.report(Began(person=person, task=task, id=id))

    def observe(
        self,
        person: str,
        action: str | None = None,
        *,
        likelihoods: Mapping[str, float] | None = None,
        missed: float | None = None,
        heard: bool = True,
        followed: bool | None = None,
        seq: int | None = None,
        id: str | None = None,
    ) -> Any:
        """Record a person's action: as it was seen, or what is known of it.

        Parameters
        ----------
        person : str
        action : str, optional
            In PDDL notation, `(name argument ...)`, in any case.
        likelihoods : mapping of str to float, optional
            In place of `action`, the likelihood of what a sensor has seen under each action; 0 for others. Only their
            ratios matter.
        missed : float, optional
            In place of `action`, the probability that the person has acted in this time step, and nothing was seen. The
            suggestion stays open if it is below 1/2.
        heard : bool
            Whether the person had seen the open suggestion, if there is one; `seq` may tell that they had not.
        followed : bool, optional
            Whether the suggestion was followed, if that is known.
        seq : int, optional
            `seq` of the view on which the person acted: they have not seen a later suggestion.
        id : str, optional
            Chosen by the reporter.

        Raises
        ------
        ValueError
            Not one of these is given, or the numbers are no likelihoods.
        Refusal
            There is no such person, or no such action in their task.
        InapplicableError
            It is not applicable now, or in no probable state; the message says which actions are.
        LimitError
            The successor could not be evaluated. Nothing has changed after any of these errors.
        """
        known = None if likelihoods is None else dict(likelihoods)
        what: dict[str, Any] = {"action": action, "likelihoods": known, "missed": missed, "heard": heard}
        return self.report(Acted(person=person, followed=followed, seq=seq, id=id, **what))

    def answer(self, person: str, answer: str | bool | None, *, seq: int | None = None, id: str | None = None) -> Any:
        """Record a person's answer, after which the open question is closed.

        Parameters
        ----------
        person : str
        answer : str, bool or None
            The action that they say was their last, which takes the place of what was seen, whether it was asked about
            or not; True or False to "is this your goal?"; None if they do not answer.
        seq : int, optional
            `seq` of the view with the question.
        id : str, optional
            Chosen by the reporter.

        Raises
        ------
        Refusal
            As in `observe`; the person has not acted, there is no such question, or the answer is impossible. Nothing
            has changed then.
        """
        return self.report(Answered(person=person, answer=answer, seq=seq, id=id))

    def undo(self, person: str, *, of: str = "acted", id: str | None = None) -> Any:
        """Take back a person's last action, or another event, as if it had not been observed.

        Parameters
        ----------
        person : str
        of : str
            The kind of event, of which the last in the present task is taken back: "acted" or "answered".
        id : str, optional
            Chosen by the reporter.

        Raises
        ------
        InapplicableError
            There is none in this task.
        """
        return self.report(Undone(person=person, of=of, id=id))

    def arrived(self, person: str | None = None, *, robot: int = 1, id: str | None = None) -> Any:
        """Record where a robot is: at a person, or at its base (None).

        Parameters
        ----------
        person : str, optional
        robot : int
            Number of the robot, from 1.
        id : str, optional
            Chosen by the reporter.
        """
        return self.report(Arrived(person=person, robot=robot, id=id))

    def elapse(self) -> Any:
        """Record that time has passed without an action, so that the robots decide again."""
        return self.report(Elapsed())

    def pause(self, paused: bool = True) -> Any:
        """Stop the robots' suggestions, or resume them; people can still act."""
        return self.report(Paused(paused=paused))

    def rearrange(self, distance: ArrayLike) -> Any:
        """Use other distances from now on. A robot under way continues.

        Parameters
        ----------
        distance : array, shape (P + 1, P + 1)
            Distances between the places of P people and the base, which is last.

        Raises
        ------
        ValueError
            The matrix is invalid, or too small for the people who have joined.
        """
        return self.report(Rearranged(distance=distance))  # type: ignore[arg-type]  # rows of any kind are converted
