"""Who takes part in a user study, at which stage, with whom, and which places are taken.

The participants of a running study and the tables of its data follow from the same records here, without the tasks.

In a study with groups, participants wait before the first task until their group is complete. In a within-participants
design the members wait for each other before each further condition, too, until all who still take part have come.
Members who come later join the team that has begun.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from .participant_team import ParticipantTeam
from .plan import WAITING, Stage, UserStudy

HERE, GONE, DECLINED, WITHDREW, FULL, DONE = "here", "gone", "declined", "withdrew", "full", "done"
UNMATCHED = "unmatched"
"""Status of participants for whom no group was found in time."""


@dataclass
class Participant:
    """A participant, also one who has left.

    Attributes
    ----------
    code : str
        The participant's pseudonym, the only identifier.
    simulated : bool
    status : str
    at : int
        Number of the present stage.
    seq : int
        Number of the last event that changed the participant's view.
    entered : float
        Time at which the present stage began, in seconds since the study began.
    acted : float
        Time of the last event in the participant's task.
    expired : bool
        Whether the task's time limit was reached.
    condition : str or None
        The assigned condition; in a within-participants design, the name of the order (`UserStudy.orders`).
    completion : str or None
        Completion code.
    arrived, consented : str or None
        Times of arrival and of consent, UTC.
    excluded : str or None
        Why the researchers exclude the participant from the analysis.
    erased : bool
        Whether the records were erased; `code` is then a label.
    removed : bool
        Whether the participant withdrew and the records were removed; `code`, `at` and `condition` remain.
    group : str or None
        Name of the participant's group, once it has begun.
    teams : dict of ParticipantTeam
        Teams, keyed by kind of stage and period: one for practice, and one for the tasks of each condition.
    """

    code: str
    simulated: bool = False
    status: str = HERE
    at: int = 0
    seq: int = 0
    entered: float = 0.0
    acted: float = 0.0
    expired: bool = False
    condition: str | None = None
    completion: str | None = None
    arrived: str | None = None
    consented: str | None = None
    excluded: str | None = None
    erased: bool = False
    removed: bool = False
    group: str | None = None
    teams: dict[tuple[str, int], ParticipantTeam] = field(default_factory=dict)

    def at_tasks(self) -> list[ParticipantTeam]:
        """Return the teams of the tasks that have begun, in the order of conditions."""
        return [team for (kind, _), team in self.teams.items() if kind == "task"]

    @property
    def period(self) -> int:
        """The period of the latest task; 0 before the first."""
        return max((period for kind, period in self.teams if kind == "task"), default=0)


@dataclass(frozen=True)
class Group:
    """Participants who share a robot.

    Attributes
    ----------
    members : tuple of str
        Codes of the participants, in order of arrival.
    condition : str
        The condition; in a within-participants design, the name of the order (`UserStudy.orders`).
    teams : dict of ParticipantTeam
        Teams by period: one for each condition that has begun.
    """

    members: tuple[str, ...]
    condition: str
    teams: dict[int, ParticipantTeam] = field(default_factory=dict)


class Roll:
    """The participants of a study and their places, as its records change them (`StudyRecord.note`).

    Parameters
    ----------
    study : UserStudy

    Attributes
    ----------
    participants : dict of str to Participant
        By code, in the order of arrival.
    groups : dict of str to Group
        By name, in the order in which they began.
    begun : int
        Number of conditions that were drawn.
    changed : set of str
        The participants whose views the last event has changed.
    entered : list of str
        The participants who have entered a stage by the last event.
    """

    def __init__(self, study: UserStudy) -> None:
        self.study, self.stages = study, study.stages
        self.participants: dict[str, Participant] = {}
        self.groups: dict[str, Group] = {}
        self.begun = 0
        self.changed, self.entered = set[str](), list[str]()

    def stage(self, person: Participant) -> Stage:
        """Return the stage of a participant."""
        return self.stages[person.at]

    def enter(self, person: Participant, at: int, time: float) -> None:
        """Let a participant be at a stage from now on."""
        person.at, person.entered, person.expired = at, time, False
        self.entered.append(person.code)

    # Places.

    @property
    def taken(self) -> int:
        """Number of places taken."""
        return sum(map(self._takes_place, self.participants.values()))

    def is_free_for(self, person: Participant | None = None) -> bool:
        """Whether there is a free place, or the returning participant still has one."""
        most = self.study.participants
        return most is None or (person is not None and self._takes_place(person)) or self.taken < most

    def by_condition(self) -> dict[str, int]:
        """Return, for each condition or order, the number of its participants, or groups, that take a place."""
        counts, groups = dict.fromkeys(self.study.orders, 0), set[str]()
        for person in self.participants.values():
            if person.condition is not None and person.group not in groups and self._takes_place(person):
                counts[person.condition] += 1
                groups |= set() if person.group is None else {person.group}
        return counts

    def _takes_place(self, person: Participant) -> bool:
        """Whether a participant is here or done; or has begun a task, unless the study replaces dropouts."""
        return person.status in (HERE, DONE) or (person.condition is not None and not self.study.replace)

    # Groups.

    def waiting(self) -> list[str]:
        """Return the codes of all participants who wait for their group, in order of arrival."""
        return [code for code, person in self.participants.items() if self._waits(person)] if self.study.group else []

    def _waits(self, person: Participant) -> bool:
        return person.status == HERE and self.stage(person).kind == WAITING

    def company(self, person: Participant) -> tuple[list[str], int]:
        """Return who waits together with a participant, who is included, and how many are expected.

        Before the first task these are the members of a complete group, and later all members who still take part.
        """
        assert self.study.group is not None
        others = self.participants if person.group is None else self.groups[person.group].members
        here = [
            code for code in others
            if code == person.code
            or (self.participants[code].status == HERE and self.participants[code].group == person.group)
        ]  # fmt: skip
        waiting = [code for code in here if code == person.code or self._waits(self.participants[code])]
        return waiting, self.study.group.size if person.group is None else len(here)

    def is_complete(self, person: Participant) -> bool:
        """Whether all participants for whom this one waits have come."""
        waiting, expected = self.company(person)
        return len(waiting) >= expected

    def ready(self, person: Participant, period: int, *, late: bool) -> list[str]:
        """Return who begins a condition now that a participant waits for it; empty if others have to come.

        Parameters
        ----------
        person : Participant
        period : int
            1 for the first condition.
        late : bool
            Whether the participant has waited too long.
        """
        assert self.study.group is not None
        if person.group is not None and period in self.groups[person.group].teams:
            return [person.code]
        if late and person.group is None and self.study.group.then == "alone":
            return [person.code]
        return self.company(person)[0] if late or self.is_complete(person) else []
