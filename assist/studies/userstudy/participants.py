"""The participants of a user study."""

from __future__ import annotations

from dataclasses import dataclass, field

from .participant_team import ParticipantTeam

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
    groups : dict of ParticipantTeam
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
    groups: dict[tuple[str, int], ParticipantTeam] = field(default_factory=dict)

    def at_tasks(self) -> list[ParticipantTeam]:
        """Return the teams of the tasks that have begun, in the order of conditions."""
        return [group for (kind, _), group in self.groups.items() if kind == "task"]

    @property
    def period(self) -> int:
        """The period of the latest task; 0 before the first."""
        return max((period for kind, period in self.groups if kind == "task"), default=0)
