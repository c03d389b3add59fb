"""The places of a study, and how many participants each condition has.

A place is taken by participants who are taking part or have completed the study. It is also taken by those whose task
has begun, unless the study replaces dropouts. The place of a participant who leaves before is free again.
"""

from __future__ import annotations

from collections.abc import Mapping

from .participants import DONE, HERE, Participant
from .plan import UserStudy


class Places:
    """The places of a study.

    Parameters
    ----------
    study : UserStudy
    participants : mapping of str to Participant
        The participants by code. It is not copied.
    """

    def __init__(self, study: UserStudy, participants: Mapping[str, Participant]) -> None:
        self._study, self._participants = study, participants

    @property
    def taken(self) -> int:
        """Number of places taken."""
        return sum(map(self._takes_one, self._participants.values()))

    def is_free_for(self, person: Participant | None = None) -> bool:
        """Whether there is a free place, or the returning participant still has one."""
        most = self._study.participants
        return most is None or (person is not None and self._takes_one(person)) or self.taken < most

    def by_condition(self) -> dict[str, int]:
        """Return, for each condition or order, the number of its participants, or groups, that take a place."""
        counts, groups = dict.fromkeys(self._study.orders, 0), set[str]()
        for person in self._participants.values():
            if person.condition is not None and person.group not in groups and self._takes_one(person):
                counts[person.condition] += 1
                groups |= set() if person.group is None else {person.group}
        return counts

    def _takes_one(self, person: Participant) -> bool:
        if person.status in (HERE, DONE):
            return True
        return person.condition is not None and not self._study.replace
