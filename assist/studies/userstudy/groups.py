"""Groups of participants who share a robot, and who waits for whom.

Participants wait before the first task until their group is complete. In a within-participants design the members wait
for each other before each further condition, too, until all who still take part have come. Members who come later join
the team that has begun.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from .participant_team import ParticipantTeam
from .participants import HERE, Participant
from .plan import WAITING, UserStudy


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


class Groups:
    """The groups of a study.

    Parameters
    ----------
    study : UserStudy
    participants : mapping of str to Participant
        The participants by code. It is not copied.

    Attributes
    ----------
    begun : dict of Group
        Groups by name, in the order in which they began.
    """

    def __init__(self, study: UserStudy, participants: Mapping[str, Participant]) -> None:
        self._study, self._participants = study, participants
        self.begun: dict[str, Group] = {}

    def waiting(self) -> list[str]:
        """Return the codes of all participants who wait, in order of arrival."""
        if self._study.group is None:
            return []
        return [code for code, person in self._participants.items() if self._waits(person)]

    def _waits(self, person: Participant) -> bool:
        return person.status == HERE and self._study.stages[person.at].kind == WAITING

    def company(self, person: Participant) -> tuple[list[str], int]:
        """Return who waits together with a participant, who is included, and how many are expected.

        Before the first task these are the members of a complete group, and later all members who still take part.
        """
        assert self._study.group is not None
        others = self._participants if person.group is None else self.begun[person.group].members
        here = [
            code for code in others
            if code == person.code
            or (self._participants[code].status == HERE and self._participants[code].group == person.group)
        ]  # fmt: skip
        waiting = [code for code in here if code == person.code or self._waits(self._participants[code])]
        return waiting, self._study.group.size if person.group is None else len(here)

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
        assert self._study.group is not None
        if person.group is not None and period in self.begun[person.group].teams:
            return [person.code]
        if late and person.group is None and self._study.group.then == "alone":
            return [person.code]
        return self.company(person)[0] if late or self.is_complete(person) else []

    def drop(self, name: str, period: int) -> None:
        """Forget a team that could not begin, and with the first one the group."""
        del self.begun[name].teams[period]
        if not self.begun[name].teams:
            del self.begun[name]
