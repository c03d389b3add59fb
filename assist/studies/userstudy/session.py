"""A user study as a live session: events are saved before they are acknowledged, and a session can be resumed.

The folder contains the journal, a copy of the study's file, and the secret of the links.

What a participant withdraws is removed before the withdrawal is acknowledged, by the function that erases records. If
the removal fails, it is tried again with later events, and when the session is opened again.
"""

from __future__ import annotations

import logging
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import Field

from planner import CostToGo
from planner.system.errors import InputFileError
from planner.system.files import atomic, remove_unfinished

from ...declare.declared import AnyText, declared
from ...declare.refusals import Refusal
from ...live.event_base import Event
from ...live.header import Header
from ...live.live_task import LiveTask
from ...live.record import Record
from ...live.session import Outcome, Session
from ...live.store import Tombstone
from ...live.team import Team
from ...people.goals import first_of
from ...people.user_code import parse
from ...person.policy import Policy
from ...person.settings import Setting
from ...team.policies import UserPolicy
from ...team.state import TeamPolicy
from .cohort import Cohort
from .events import Withdrew
from .plan import UserStudy
from .plan_file import first_difference
from .record import StudyRecord

JOURNAL, PLAN, EXPORT, REPORT = "journal.sqlite", "study.toml", "user-study.zip", "report"
"""Names in a study's folder; the last two are made from the journal, and can be made again."""
REHEARSED = "rehearsed"
"""Name of an empty file in the folder of a rehearsal, in which no real study begins."""

WITHDRAWN = "withdrew"
"""The reason that remains of a withdrawal."""

LONG = 3.0
"""Seconds of removals, each of which concerns the whole journal, after which other participants have their turn."""

RETRY = 10.0
"""Seconds between two attempts to remove what was withdrawn, each of which may take as long as opening the study."""


@declared(kw_only=True)
class StudyHeader(Header):
    """The header of a user study."""

    study: Annotated[AnyText, Field(description="A hash of the study's file.")]


class StudySession(Session):
    """A running user study.

    Parameters
    ----------
    study : UserStudy
    tasks : mapping of str to CostToGo
        Tasks by name; the practice task is "practice".
    folder : Path

    Raises
    ------
    InputFileError
        The folder belongs to a running study, to another study, or to this one before its file changed.
    InputFileError, OSError
        As in `Session`.
    """

    kind: ClassVar[type[Record]] = StudyRecord

    def __init__(self, study: UserStudy, tasks: Mapping[str, CostToGo], folder: str | Path) -> None:
        self.study = study
        # Whether something withdrawn could not be removed, and when that was last tried.
        self._remains, self._tried = False, 0.0
        self._rests = 0.0  # until when others have their turn after long removals
        self._policies = {one.name: policy_of(study, one.policy) for one in study.conditions}
        # Solved once for all teams with the same setting.
        self._solved: list[tuple[Setting, dict[str, Any]]] = []
        for setting in (study.setting, *(one.setting for one in study.conditions)):
            if all(setting != other for other, _ in self._solved):
                self._solved.append((setting, {name: self._once(task, setting) for name, task in tasks.items()}))
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self._plan = folder, folder / PLAN
        super().__init__(tasks, folder / JOURNAL, setting=study.setting, population=study.population)
        if not self._plan.exists():
            with atomic(self._plan) as path:
                shutil.copyfile(study.file, path)
        try:
            while self._remove_withdrawn():
                self._rests = 0.0  # nobody waits yet
        except Exception:
            logging.getLogger(__name__).exception("what was withdrawn could not be removed; it will be tried again")

    def _once(self, task: CostToGo, setting: Setting) -> Policy:
        return LiveTask(task, setting, self.study.population).policy

    def _header(self) -> StudyHeader:
        return StudyHeader.of_tasks(StudyRecord.format, self._tasks, study=self.study.digest)

    def _check(self, found: Mapping[str, Any], expected: Mapping[str, Any]) -> None:
        if found.get("format") == StudyRecord.format and found.get("study") != self.study.digest:
            said = f"{self._plan}: the folder belongs to another study than {self.study.file}"
            if self._plan.exists():
                text = self.study.file.read_text(encoding="utf-8")
                differs = first_difference(self._plan.read_text(encoding="utf-8"), text)
                said += ", line {line} of which is '{after}', not '{before}'".format(**differs)
            raise InputFileError(f"{said}; expected another folder")
        super()._check(found, expected)

    def _anew(self, like: Any = None) -> Cohort:  # noqa: ARG002  policies are solved once anyway
        return Cohort(self.study, {name: first_of(task) for name, task in self._tasks.items()}, self._team_of)

    def _team_of(self, condition: str | None) -> Team:
        policy: str | TeamPolicy = "none" if condition is None else self._policies[condition]
        setting = self.study.setting if condition is None else self.study.condition(condition).setting
        solved = next(tasks for other, tasks in self._solved if other == setting)
        return Team(solved, policy=policy, setting=setting, population=self.study.population)

    # Withdrawals.

    def report_all(self, events: Sequence[Event]) -> list[Outcome]:
        """Apply events as `Session.report_all` does; a withdrawal succeeds when the participant's records are removed.

        A withdrawal whose records cannot be removed now is recorded, but its outcome is the error; it is `Refusal` if
        removals for others have taken long, so that these do not stop the study.
        """
        with self.lock:
            outcomes = super().report_all(events)
            withdrawals = [place for place, event in enumerate(events) if isinstance(event, Withdrew)]
            if not withdrawals and not (self._remains and self._clock() >= self._tried + RETRY):
                return outcomes
            try:
                left = self._remove_withdrawn()
                late = Refusal("busy", n=len(left))
                errors: list[Exception | None] = [late if event.who in left else None for event in events]
            except Exception as fault:
                logging.getLogger(__name__).exception("what was withdrawn could not be removed; it will be tried again")
                errors = [fault] * len(events)
            for place in withdrawals:
                error = errors[place]
                if error is not None and not isinstance(outcomes[place], Exception):
                    outcomes[place] = error
            return outcomes

    def _remove_withdrawn(self) -> list[str]:
        """Remove the records of those who withdrew, and what was made from them; return whose are left for later.

        After `LONG` seconds of removals, the study goes on for as long as they have taken.
        """
        again, self._remains, self._tried = self._remains, True, self._clock()
        left = list(self.cohort.withdrawn())
        if self._tried < self._rests:
            return left
        for code in tuple(left):
            self._remove(code, code, WITHDRAWN)
            left.remove(code)
            if self._clock() > self._tried + LONG:
                break
        if again:
            self._remove_derived()
        self._store.purge()
        self._remains = bool(left)
        spent = self._clock() - self._tried
        self._rests = self._clock() + spent if spent > LONG else 0.0
        return left

    def _remove(self, person: str, label: str, reason: str) -> Tombstone:
        self._remove_derived()  # first: if it fails, nothing is removed, and all of it is tried again
        stone = super()._remove(person, label, reason)
        self._remove_derived()  # what was made meanwhile of what is removed now
        return stone

    def _remove_derived(self) -> None:
        """Remove the export and the report in the folder, which have the data of everybody at that time."""
        report = self.folder / REPORT
        (self.folder / EXPORT).unlink(missing_ok=True)
        for name in ("report.md", "report.html", "summary.json"):
            (report / name).unlink(missing_ok=True)
        for ending in ("png", "svg"):
            for figure in (report / "figures").glob(f"*.{ending}"):
                figure.unlink(missing_ok=True)
        remove_unfinished([self.folder, report, report / "figures"])

    def fault(self) -> str | None:
        """Return why events cannot be saved, or what was withdrawn not be removed; None if all is well."""
        remains = "what a participant withdrew could not be removed yet" if self._remains else None
        return super().fault() or remains

    @property
    def cohort(self) -> Cohort:
        """The participants. Callers must hold the lock."""
        found = self.history
        assert isinstance(found, Cohort)
        return found


def policy_of(study: UserStudy, policy: str) -> str | TeamPolicy:
    """Return the policy of a condition: its name, or the user's function."""
    place = parse(policy, study.file.parent)
    return policy if place is None else UserPolicy.load(*place)
