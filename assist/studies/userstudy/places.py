"""Who takes part in a user study, at which stage, and which places are taken."""

from __future__ import annotations

from .groups import Groups
from .participants import DONE, HERE, Participant
from .plan import Stage, UserStudy


class Places:
    """The participants of a study and their places.

    Parameters
    ----------
    study : UserStudy

    Attributes
    ----------
    participants : dict of str to Participant
        By code, in the order of arrival.
    groups : Groups
    begun : int
        Number of conditions that were drawn.
    """

    def __init__(self, study: UserStudy) -> None:
        self.study, self.stages = study, study.stages
        self.participants: dict[str, Participant] = {}
        self.groups = Groups(study, self.participants)
        self.begun = 0

    def stage(self, person: Participant) -> Stage:
        """Return the stage of a participant."""
        return self.stages[person.at]

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
