"""The data of a user study as its report compares them: a value for each unit of analysis in each condition.

The unit of analysis is the participant. In a study with groups it is the group, whose value is the mean over its
members, since members who share a robot are not independent.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from statistics import fmean

from ..userstudy.forms import FORMS
from ..userstudy.outcomes import COMPLETION, COUNTED, Row
from ..userstudy.plan import UserStudy
from ..userstudy.questionnaires import Questionnaire
from ..userstudy.tables import Tables

ALL = "all participants"
"""Stands for the condition where answers do not belong to one."""

Ends = tuple[float, float]
PERCENT = (0.0, 100.0)

Values = dict[str, dict[str, float]]
"""Values by condition and unit of analysis."""


@dataclass(frozen=True)
class Measure:
    """A value for each participant, or for each group in a study with groups.

    Attributes
    ----------
    name : str
    label : str
        In the study's language.
    values : dict of dict
        Values by condition and participant, or group.
    ends : tuple of float
        The least and the largest value that is possible.
    """

    name: str
    label: str
    values: Values
    ends: Ends


class StudyData:
    """A study with its tables, without those who are excluded.

    Parameters
    ----------
    study : UserStudy
    tables : Tables
    """

    def __init__(self, study: UserStudy, tables: Tables) -> None:
        self.study, self.tables = study, tables.analysed()
        self.names = [one.name for one in study.conditions]

    @cached_property
    def orders(self) -> dict[str, str]:
        """The condition or the order of conditions of each unit of analysis."""
        return {row["group"] or row["participant"]: row["condition"] for row in self.tables.participants}

    @cached_property
    def attempts(self) -> dict[tuple[str, str], list[Row]]:
        """The begun tasks of each participant in each condition."""
        found: dict[tuple[str, str], list[Row]] = {}
        for row in self.tables.tasks:
            found.setdefault((row["participant"], row["condition"]), []).append(row)
        return found

    def has_finished(self, rows: Sequence[Row]) -> bool:
        """Whether a participant finished all tasks in a condition."""
        return len(rows) == len(self.study.tasks) and all(row["finished"] for row in rows)

    def by_condition(
        self, values: Iterable[tuple[str, str, float | None]], where: Sequence[str] | None = None
    ) -> Values:
        """Return values by condition and unit of analysis: those of participants, or means over the members of groups.

        Parameters
        ----------
        values : iterable of (participant, condition, value)
            None stands for a missing value.
        where : sequence of str, optional
            The conditions; `ALL` alone for what belongs to none. All conditions of the study unless given.
        """
        groups = {row["participant"]: row["group"] or row["participant"] for row in self.tables.participants}
        units: dict[str, dict[str, list[float]]] = {name: {} for name in where or self.names}
        for participant, condition, value in values:
            if value is not None:
                unit = groups.get(participant, participant)
                units[condition if condition in units else ALL].setdefault(unit, []).append(value)
        return {
            name: {unit: fmean(each) if len(each) > 1 else each[0] for unit, each in own.items()}
            for name, own in units.items()
        }

    def asked_in(self, questionnaire: Questionnaire) -> list[str]:
        """Return the conditions to which a questionnaire's answers belong; `ALL` alone if they belong to none."""
        return self.names if self.study.is_by_condition(questionnaire) else [ALL]

    def scored(self, questionnaire: Questionnaire) -> list[tuple[str, str, dict[str, float]]]:
        """Return each completed questionnaire: the participant, the condition, and the score of each scored answer."""
        given: dict[tuple[str, str], dict[str, float]] = {}
        for row in self.tables.answers:
            if row["questionnaire"] == questionnaire.name:
                own = given.setdefault((row["participant"], row["condition"]), {})
                if row["score"] is not None:
                    own[row["item"]] = row["score"]
        return [(participant, condition, scores) for (participant, condition), scores in given.items()]

    def periods(self, measure: Measure) -> dict[tuple[str, str], int]:
        """Return in which period each unit with a value had a condition; empty between participants."""
        if not self.study.is_within:
            return {}
        return {
            (who, name): self.study.orders[self.orders[who]].index(name) + 1
            for name, own in measure.values.items() for who in own
        }  # fmt: skip

    def are_shares(self, measure: Measure) -> bool:
        """Whether a measure is yes or no for each unit of analysis."""
        return measure.name == COMPLETION and self.study.group is None

    @cached_property
    def measures(self) -> list[Measure]:
        """Completion, the outcomes of those who finished all tasks, and the means of questionnaires' scales."""
        return [*self._of_tasks(), *self._of_scales()]

    def _of_tasks(self) -> Iterator[Measure]:
        attempts = [(*who, rows, self.has_finished(rows)) for who, rows in self.attempts.items()]
        found: dict[str, list[tuple[str, str, float | None]]] = {
            one.name: [(who, where, one.of(rows) if done else None) for who, where, rows, done in attempts]
            for one in COUNTED
        }
        found[COMPLETION] = [(who, where, 100.0 * done) for who, where, _, done in attempts]
        percent = {COMPLETION, *(one.name for one in COUNTED if one.share_of is not None)}
        for name, values in found.items():
            label, ends = self.study.catalogue.phrase(f"report.measures.{name}"), (0.0, math.inf)
            yield Measure(name, label, self.by_condition(values), PERCENT if name in percent else ends)

    def _of_scales(self) -> Iterator[Measure]:
        for one in self.study.questionnaires:
            if one.scale and self.study.is_by_condition(one):
                means = [(who, condition, one.mean(scores)) for who, condition, scores in self.scored(one)]
                low, high, _ = one.scale[0].ends
                key = f"report.{FORMS[one.form].mean}"
                label = self.study.catalogue.phrase(key, name=one.name, low=f"{low:g}", high=f"{high:g}")
                yield Measure(one.name, label, self.by_condition(means), (low, high))
