"""A user study as a live session: events are saved before they are acknowledged, and a session can be resumed.

The folder contains the journal, a copy of the study's file, and the secret of the links.
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
from ..live.header import files_of
from ..live.live_task import LiveTask, digest
from ..live.session import Session
from ..people.goals import first_of
from ..people.user_code import parse
from ..person.policy import Policy
from ..team.policies import UserPolicy
from ..team.settings import Setting
from ..team.state import TeamPolicy
from .cohort import Cohort
from .plan import UserStudy

FORMAT = "kitassist user study 1"
"""Format of journals."""

JOURNAL, PLAN = "journal.sqlite", "study.toml"


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
    ResultsExistError
        The folder belongs to a running study, to another study, or to this one before its file changed.
    DamagedFileError, OSError
        As in `Session`.
    """

    def __init__(self, study: UserStudy, tasks: Mapping[str, CostToGo], folder: str | Path) -> None:
        self.study = study
        self._policies = {one.name: _policy(study, one.policy) for one in study.conditions}
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

    def _once(self, task: CostToGo, setting: Setting) -> Policy:
        return LiveTask(task, setting, self.study.population).policy

    def _header(self) -> dict[str, Any]:
        return {
            "format": FORMAT, "study": self.study.digest,
            "tasks": {name: digest(task) for name, task in self._tasks.items()},
            "files": files_of(self._tasks),
        }  # fmt: skip

    def _check(self, found: Mapping[str, Any], expected: Mapping[str, Any]) -> None:
        if found.get("format") == FORMAT and found.get("study") != self.study.digest:
            raise ResultsExistError(
                f"{self._plan}: the folder belongs to another study than {self.study.file}; expected another folder"
            )
        super()._check(found, expected)

    def _course_anew(self) -> Cohort:
        return Cohort(self.study, {name: first_of(task) for name, task in self._tasks.items()}, self._course_of)

    def _course_of(self, condition: str | None) -> Course:
        policy: str | TeamPolicy = "none" if condition is None else self._policies[condition]
        setting = self.study.setting if condition is None else self.study.condition(condition).setting
        solved = next(tasks for other, tasks in self._solved if other == setting)
        return Course(solved, policy=policy, setting=setting, population=self.study.population)

    @property
    def cohort(self) -> Cohort:
        """The participants. Callers must hold the lock."""
        assert isinstance(self._course, Cohort)
        return self._course

    def see(self, look: Callable[[Cohort], Any]) -> Any:
        """Return the result of a function of the participants, called under the lock."""
        with self.lock:
            return look(self.cohort)


def _policy(study: UserStudy, policy: str) -> str | TeamPolicy:
    place = parse(policy, study.file.parent)
    return policy if place is None else UserPolicy.load(*place)
