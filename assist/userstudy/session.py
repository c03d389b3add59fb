"""A user study as a live session: every event on the disk before it is acknowledged, and where it was when it goes on.

The folder has the journal, a copy of the study's file, and the secret from which the links follow.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from planner import CostToGo
from planner.system.errors import ResultsExistError
from planner.system.files import atomic

from ..live.course import Course
from ..live.live_task import LiveTask, digest
from ..live.session import Session
from ..people.user_code import parse
from ..person.pomdp import Policy
from ..team.policies import UserPolicy
from ..team.state import TeamPolicy
from .cohort import Cohort
from .plan import UserStudy

FORMAT = "kitassist user study 1"
"""Of journals."""

JOURNAL, PLAN = "journal.jsonl", "study.toml"


class StudySession(Session):
    """A study that is carried out.

    Parameters
    ----------
    study : UserStudy
    tasks : mapping of str to CostToGo
        By name; that of the practice is "practice".
    folder : Path

    Raises
    ------
    ResultsExistError
        The folder is of a study that runs, or of another one, or of this one before its file was changed.
    DamagedFileError, OSError
        As `Session`.
    """

    def __init__(self, study: UserStudy, tasks: Mapping[str, CostToGo], folder: str | Path) -> None:
        self.study = study
        self._policies = {one.name: _policy(study, one.policy) for one in study.conditions}
        # Worked out once, for all teams.
        self._worked_out: dict[str, Any] = {name: self._once(task) for name, task in tasks.items()}
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self._plan = folder, folder / PLAN
        super().__init__(tasks, folder / JOURNAL, setting=study.setting, population=study.population)
        if not self._plan.exists():
            with atomic(self._plan) as path:
                shutil.copyfile(study.file, path)

    def _once(self, task: CostToGo) -> Policy:
        return LiveTask(task, self.study.setting, self.study.population).policy

    def _header(self) -> dict[str, Any]:
        return {
            "format": FORMAT, "study": self.study.digest,
            "tasks": {name: digest(task) for name, task in self._tasks.items()},
            "files": self._files(),
        }  # fmt: skip

    def _check(self, header: dict[str, Any]) -> None:
        if header.get("format") == FORMAT and header.get("study") != self.study.digest:
            raise ResultsExistError(
                f"{self._plan}: the study there is not that of {self.study.file}; expected the same, or another folder"
            )
        super()._check(header)

    def _course_anew(self) -> Cohort:
        return Cohort(self.study, self._tasks, self._course_of)

    def _course_of(self, condition: str | None) -> Course:
        policy: str | TeamPolicy = "none" if condition is None else self._policies[condition]
        return Course(self._worked_out, policy=policy, setting=self.study.setting, population=self.study.population)

    @property
    def cohort(self) -> Cohort:
        """The participants; to be looked at under the lock."""
        assert isinstance(self._course, Cohort)
        return self._course

    def see(self, look: Callable[[Cohort], Any]) -> Any:
        """Give what a function finds out about the participants as they are."""
        with self.lock:
            return look(self.cohort)


def _policy(study: UserStudy, policy: str) -> str | TeamPolicy:
    place = parse(policy, study.file.parent)
    return policy if place is None else UserPolicy.load(*place)
