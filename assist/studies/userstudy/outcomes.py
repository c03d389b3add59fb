"""Outcomes of tasks in user studies: what each counts, and what it is of several tasks.

An outcome is a column of the table `tasks`, a measure of the report and a name for `confirmatory`. The text
`report.measures.NAME` of each language is its label.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Any

Row = dict[str, Any]


@dataclass(frozen=True)
class Outcome:
    """An outcome of a task.

    Attributes
    ----------
    name : str
    about : str
        What it is, in the description of the table's columns.
    after : callable
        Returns its value after an action: of the task's row before, of the action's row, and of the seconds since the
        task began.
    start : int or None
        Its value before the first action.
    more_is_worse : bool
        Whether participants who did not finish are compared as those who have the most.
    share_of : str or None
        Of several tasks it is the percentage of this outcome; their mean unless given.
    """

    name: str
    about: str
    after: Callable[[Row, Row, float], float | None]
    start: int | None = 0
    more_is_worse: bool = False
    share_of: str | None = None

    def of(self, tasks: Sequence[Row]) -> float | None:
        """Return what it is of several tasks; None if they have no value."""
        known = [task for task in tasks if task[self.name] is not None]
        if self.share_of is not None:
            every = sum(task[self.share_of] for task in known)
            return 100 * sum(task[self.name] for task in known) / every if every else None
        return fmean(task[self.name] for task in known) if known else None


COUNTED = (
    Outcome("actions", "actions taken", lambda task, *_: task["actions"] + 1, more_is_worse=True),
    Outcome(
        "suboptimal_actions", "actions that begin no optimal plan",
        lambda task, action, _: task["suboptimal_actions"] + (not action["optimal"]), more_is_worse=True,
    ),
    Outcome(
        "seconds", "seconds from the beginning to the last action, without interruptions of the service",
        lambda _task, _action, seconds: seconds, start=None, more_is_worse=True,
    ),
    Outcome(
        "suggestions", "suggestions shown when an action was taken",
        lambda task, action, _: task["suggestions"] + (action["suggestion"] is not None),
    ),
    Outcome(
        "followed", "number of these suggestions that were followed",
        lambda task, action, _: task["followed"] + bool(action["followed"]), share_of="suggestions",
    ),
)  # fmt: skip
"""The outcomes that are counted in each task, in the order of the report."""

COMPLETION = "completion"
"""Whether all tasks were finished, the outcome of all participants."""

OUTCOMES = (COMPLETION, *(one.name for one in COUNTED))
"""Names of all outcomes of tasks."""
