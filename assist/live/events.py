"""The kinds of events of a live team: the record of a team is the list of its events.

From these classes (`event_base`) follow records, saved teams, the HTTP interface with its description, the verbs of
`Reports`, and the operator's list. A new kind is a new class here. Nothing else lists the kinds.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import BeforeValidator, Field

from planner.system.errors import expected

from ..declare.declared import Expected, Number, Truth, Whole
from ..declare.refusals import InapplicableError, Refusal
from ..people.action_names import in_pddl
from .event_base import INTERNAL, Action, Event, Kept, Name, OfPerson, Seq, TeamEvent

if TYPE_CHECKING:
    from .desk import Desk


def _rows(value: Any) -> Any:
    """Return a matrix as tuples of rows."""
    listed = value.tolist() if hasattr(value, "tolist") else value
    return tuple(tuple(row) if isinstance(row, list) else row for row in listed) if isinstance(listed, list) else listed


Rows = Annotated[tuple[tuple[Number, ...], ...], BeforeValidator(_rows), Expected("rows of numbers")]


def kinds(base: type[Event]) -> dict[str, type[Any]]:
    """Return the classes of events below a base, by kind."""
    found = {}
    for one in base.__subclasses__():
        if isinstance(kind := one.__pydantic_fields__["kind"].default, str):
            found[kind] = one
        found |= kinds(one)
    return found


class Decided(TeamEvent):
    """Nothing has happened, and the robots decide: the first event of a team without people."""

    kind: Literal["decided"] = "decided"
    is_shown: ClassVar[bool] = False

    def change(self, desk: Desk, time: float) -> None:
        """Change nothing."""


class Joined(OfPerson):
    """A person who joins the team, or rejoins it."""

    kind: Literal["joined"] = "joined"
    person: Annotated[Name, Field(examples=["ann"])]
    """The person."""
    task: str | None = Field(default=None, max_length=200)
    """Their task; the first one unless named. Who returns is in the task that they left."""
    belief: tuple[float, ...] | None = Field(default=None, json_schema_extra=INTERNAL)
    """The belief about them from an earlier session, flattened; the prior unless given."""
    population: str | None = Field(default=None, json_schema_extra=INTERNAL)
    """The name of their prior, if it is not the team's."""

    path: ClassVar[str | None] = "/api/team/people"
    shows: ClassVar[Literal["person", "place", "robot"]] = "place"
    by_operator: ClassVar[bool] = True

    def recorded(self, desk: Desk) -> Self | None:
        """Name the task of a person who joins for the first time."""
        more = self.population is not None or self.belief is not None
        return self.model_copy(update={"task": desk.task_of_newcomer(self.person, self.task, more=more)})

    @property
    def begins(self) -> str | None:
        """The task of a person who comes for the first time."""
        return self.task

    def change(self, desk: Desk, time: float) -> None:  # noqa: ARG002
        """Add the person."""
        desk.joined(self.person, self.task, population=self.population, belief=self.belief)

    def remains(self, label: str) -> TeamEvent:
        """Keep the place of a person who came for the first time."""
        return super().remains(label) if self.task is None else Vacant(person=label, task=self.task)


class Left(OfPerson):
    """A person who leaves the team, and may rejoin later."""

    kind: Literal["left"] = "left"

    path: ClassVar[str | None] = "/api/people/{person}/leave"
    ends_task: ClassVar[bool] = True
    by_operator: ClassVar[bool] = True

    def change(self, desk: Desk, time: float) -> None:  # noqa: ARG002
        """Remove the person."""
        desk.left(self.person)


class Began(OfPerson):
    """A person who begins the next task, even if the present one is unfinished; without `task` the same one again."""

    kind: Literal["began"] = "began"
    task: str | None = Field(default=None, max_length=200)
    """The task; the same one again unless named."""
    population: str | None = Field(default=None, json_schema_extra=INTERNAL)
    """The name of the prior for this task, if it is another one."""

    path: ClassVar[str | None] = "/api/people/{person}/begin"
    ends_task: ClassVar[bool] = True

    def recorded(self, desk: Desk) -> Self | None:
        """Check that there is such a task."""
        if self.task is not None:
            desk.require_task(self.task)
        return super().recorded(desk)

    @property
    def begins(self) -> str | None:
        """The task, if it is another one."""
        return self.task

    def change(self, desk: Desk, time: float) -> None:  # noqa: ARG002
        """Put the person at the beginning of the task."""
        desk.began(self.person, self.task, population=self.population)


class Acted(OfPerson):
    """An action of a person, or what is known of it: one of `action`, `likelihoods` and `missed`."""

    kind: Literal["acted"] = "acted"
    action: Action | None = None
    """The action, in PDDL notation."""
    likelihoods: dict[Action, Number] | None = None
    """Likelihood of what a sensor has seen under each action, 0 for others; only ratios matter."""
    missed: Number | None = None
    """Probability that an action was missed in this time step."""
    followed: Truth | None = None
    """Whether the suggestion was followed; null if unknown."""
    seq: Seq | None = None
    """`seq` of the view on which the person acted; later suggestions are taken as unseen."""
    heard: Truth = True
    """Whether the person had seen the open suggestion, if there is one."""

    path: ClassVar[str | None] = "/api/people/{person}/actions"
    nothing: ClassVar[str | None] = "nothing_done"
    in_place_of_action: ClassVar[tuple[str, ...]] = ("likelihoods", "missed")
    reversible: ClassVar[bool] = True
    is_action: ClassVar[bool] = True

    def recorded(self, desk: Desk) -> Self | None:
        """Return the action in PDDL notation, with whether the suggestion was heard."""
        super().recorded(desk)
        heard = desk.has_heard(self.person, self.action, heard=self.heard, followed=self.followed, seq=self.seq)
        seen = desk.seen_of(self.person, self.action, self.likelihoods, self.missed)
        found = {"seq": None, "heard": heard, "action": self.action and in_pddl(self.action), **seen}
        return self.model_copy(update=found)

    def causes(self, desk: Desk) -> tuple[TeamEvent, ...]:
        """Return what others see of the answer to a suggestion."""
        shown = desk.seen.shown_by(desk.known(self.person), self.action, heard=self.heard)
        return () if shown is None else (Witnessed(person=self.person, followed=shown[0], gain=shown[1]),)

    def change(self, desk: Desk, time: float) -> None:
        """Update the state of the person's task and the belief in the person."""
        desk.acted(
            self.person, self.action, heard=self.heard, likelihoods=self.likelihoods, missed=self.missed, time=time
        )

    def take_back(self, desk: Desk) -> str | None:
        """Return to the state and belief before the action. The suggestion before it is open again."""
        return desk.take_back_action(self.person)

    def entry(self) -> dict[str, Any]:
        """Return the action, the likeliest of several."""
        likely = self.likelihoods or {}
        return {"action": max(likely, key=likely.__getitem__) if likely else self.action, "followed": self.followed}


class Undone(OfPerson):
    """A person takes back what they did last, as if it had not been observed."""

    kind: Literal["undone"] = "undone"
    of: str = Field(default="acted", max_length=40)
    """The kind of event that is taken back, the last of this kind in their task."""

    path: ClassVar[str | None] = "/api/people/{person}/undo"

    def causes(self, desk: Desk) -> tuple[TeamEvent, ...]:
        """Return that others have not seen an action, if they had."""
        number = desk.seen.shown_last(desk.known(self.person)) if self.of == "acted" else None
        return () if number is None else (Unwitnessed(person=self.person, number=number),)

    def change(self, desk: Desk, time: float) -> Any:  # noqa: ARG002
        """Take back the last event of this kind."""
        done = desk.known(self.person).done
        place = next((place for place in reversed(range(len(done))) if done[place].kind == self.of), None)
        if place is None:
            kind = kinds(OfPerson).get(self.of)
            if kind is not None and kind.nothing is not None:
                raise InapplicableError(kind.nothing, person=self.person)
            known = [name for name, one in kinds(OfPerson).items() if one.nothing is not None]
            raise Refusal("other", why=f"of {self.of!r}: {expected(self.of, known)}")
        taken = done[place].take_back(desk)
        del done[place]
        return taken

    def entry(self) -> dict[str, Any]:
        """Return what was taken back."""
        return {"of": self.of}


class Answered(OfPerson):
    """An answer to the robot's question."""

    kind: Literal["answered"] = "answered"
    answer: Annotated[Truth | Action | None, Expected("an action, true, false or null")]
    """Whether the goal is theirs; the last action; null for no answer."""
    seq: Seq | None = None
    """`seq` of the view with the question; answers to earlier questions are refused."""

    path: ClassVar[str | None] = "/api/people/{person}/answer"
    nothing: ClassVar[str | None] = "no_answer"
    never_left_out: ClassVar[tuple[str, ...]] = ("answer",)

    def recorded(self, desk: Desk) -> Self | None:
        """Check that the question is open, unless the answer is an action."""
        super().recorded(desk)
        if not isinstance(self.answer, str):
            desk.require_asked(self.person, self.seq)
        return self.model_copy(update={"seq": None})

    def change(self, desk: Desk, time: float) -> None:  # noqa: ARG002
        """Update the belief in the person, or correct the last action."""
        desk.answered(self.person, self.answer)

    @property
    def instead(self) -> Self:
        """No answer."""
        return type(self)(person=self.person, answer=None)

    @property
    def can_be_taken_back(self) -> bool:
        """Whether it is about the goal."""
        return isinstance(self.answer, bool)

    def take_back(self, desk: Desk) -> bool:
        """Return to the belief without the answer. An open suggestion, which may rest on it, is withdrawn."""
        return desk.take_back_answer(self.person)

    def entry(self) -> dict[str, Any]:
        """Return the answer."""
        return {"answer": self.answer}


class Arrived(TeamEvent):
    """The location of a robot."""

    kind: Literal["arrived"] = "arrived"
    person: Name | None = None
    """The person at whom it is; null at its base."""
    robot: Whole = 1
    """Number of the robot."""

    path: ClassVar[str | None] = "/api/robots/{robot}/arrived"
    shows: ClassVar[Literal["person", "place", "robot"]] = "robot"

    @property
    def reporter(self) -> str:
        """The robot; no name of a person has brackets."""
        return f"(robot {self.robot})"

    def recorded(self, desk: Desk) -> Self | None:
        """Check that there is such a robot, and a place of this person, who may have left."""
        if self.person is not None and not desk.has_met(self.person):
            desk.require(self.person)
        desk.require_robot(self.robot)
        return self

    def change(self, desk: Desk, time: float) -> None:  # noqa: ARG002
        """Put the robot there."""
        desk.has_arrived(self.person, robot=self.robot)


class Elapsed(TeamEvent):
    """Time that passes without an action; it is recorded only if the robots then do something new."""

    kind: Literal["elapsed"] = "elapsed"
    shows: ClassVar[Literal["person", "place", "robot"]] = "robot"
    is_shown: ClassVar[bool] = False

    @classmethod
    def due(cls, desk: Desk) -> Iterator[tuple[float, Self]]:
        """Yield one after some time without an event."""
        yield desk.roster.time + desk.setting.tick, cls()

    def change(self, desk: Desk, time: float) -> None:
        """Let the robots decide again."""


class Paused(TeamEvent):
    """The robots stop making suggestions, or resume them. People can act in the meantime."""

    kind: Literal["paused"] = "paused"
    paused: Truth = True
    """Whether suggestions are paused."""

    path: ClassVar[str | None] = "/api/team/pause"
    concerns_all: ClassVar[bool] = True
    shows: ClassVar[Literal["person", "place", "robot"]] = "robot"

    def recorded(self, desk: Desk) -> Self | None:
        """Return nothing if it is so already."""
        return None if desk.paused == self.paused else self

    def change(self, desk: Desk, time: float) -> None:  # noqa: ARG002
        """Pause or resume."""
        desk.roster.paused = self.paused

    def entry(self) -> dict[str, Any]:
        """Return whether suggestions were paused or resumed."""
        return {} if self.paused else {"event": "resumed"}


class Rearranged(TeamEvent):
    """People's places are at other distances."""

    kind: Literal["rearranged"] = "rearranged"
    distance: Rows
    """The distances between the places and the base, which is last."""

    shows: ClassVar[Literal["person", "place", "robot"]] = "robot"

    def recorded(self, desk: Desk) -> Self | None:
        """Check the distances."""
        try:
            desk.other_travel(self.distance)
        except (TypeError, ValueError) as error:
            raise Refusal("other", why=str(error)) from None
        return self

    def change(self, desk: Desk, time: float) -> None:  # noqa: ARG002
        """Use the distances from now on."""
        desk.rearranged(self.distance)


class Vacant(Kept):
    """The place of a person whose records were erased: a label has it, so that the others keep theirs."""

    kind: Literal["vacant"] = "vacant"
    person: str
    """The label."""
    task: str
    """The task of the person."""

    def change(self, desk: Desk, time: float) -> None:  # noqa: ARG002
        """Keep the place."""
        desk.joined(self.person, self.task)
        desk.left(self.person)


class Witnessed(Kept):
    """What those who see a person saw of their answer to a suggestion."""

    kind: Literal["witnessed"] = "witnessed"
    person: str
    """The person, or their label."""
    followed: bool
    """Whether they followed it."""
    gain: float
    """What came of their action, in cost units."""

    def change(self, desk: Desk, time: float) -> None:  # noqa: ARG002
        """Move what is believed of those who see the person."""
        desk.seen.let_see(desk.entry(self.person), self.followed, self.gain)


class Unwitnessed(Kept):
    """An answer to a suggestion that nobody has seen after all, as it was taken back."""

    kind: Literal["unwitnessed"] = "unwitnessed"
    person: str
    """The person, or their label."""
    number: Whole
    """Number of the event that was seen."""

    def change(self, desk: Desk, time: float) -> None:  # noqa: ARG002
        """Believe of those who saw it what would be believed without it."""
        desk.seen.take_back(self.number)
