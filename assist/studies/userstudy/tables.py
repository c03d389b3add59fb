"""Tidy tables of a study's data, one row for each observation, derived from the journal alone.

The tables are exported as CSV with a data dictionary. Reports read them too.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from planner.system.errors import InputFileError

from ...live.record import require_version
from ...live.store import stored
from .csv_tables import Column, rows, written
from .events import Onward
from .outcomes import COUNTED, Row
from .participant_team import own_action
from .plan import Stage, UserStudy
from .record import StudyRecord
from .roll import WITHDREW, Participant, Roll

COLUMNS: dict[str, dict[str, Column]] = {
    "participants": {
        "participant": Column("code of a participant; a number if the records were erased"),
        "simulated": Column("whether the participant is simulated (in a rehearsal)", bool),
        "arrived": Column("time of arrival, UTC"),
        "consented": Column("time of consent, UTC; empty before"),
        "status": Column(
            "done; here: taking part; gone: disconnected for too long; withdrew: no other table has their data; "
            "declined: no consent; unmatched: no group was found in time; full: the study was full on return"
        ),
        "stage": Column("the last stage that the participant reached"),
        "condition": Column(
            "assigned when the first task begins, empty before; in a within-participants design, the order"
        ),
        "completion_code": Column("code shown at the end"),
        "failed_checks": Column("attention checks that were answered wrongly", float, later=True),
        "excluded": Column("why the participant is excluded from the report; empty otherwise", later=True),
        "group": Column(
            "the group that shared a robot; empty before it began, and in studies without groups", later=True
        ),
    },
    "tasks": {
        "participant": Column("code of a participant"),
        "condition": Column("the condition"),
        "period": Column("1 for the participant's first condition", float),
        "task": Column("the task's file name without its ending"),
        "position": Column("1 for the first task in this condition", float),
        "finished": Column("whether the goal was reached", bool),
        "optimal_cost": Column(
            "cost of an optimal plan from the initial state; its length if every action costs 1", float
        ),
        **{one.name: Column(one.about, float, later=True) for one in COUNTED},
        "fault": Column("the first error of the condition's policy in the task; empty unless it failed", later=True),
    },
    "actions": {
        "participant": Column("code of a participant"),
        "condition": Column("the condition; empty in practice"),
        "period": Column("1 for the participant's first condition; 0 in practice", float),
        "task": Column("the task, or practice"),
        "step": Column("0 for the first action of the task", float),
        "time": Column("seconds since the study began, without interruptions of the service", float),
        "utc": Column("time of the action, UTC", later=True),
        "action": Column("the action in PDDL"),
        "suggestion": Column("the suggestion shown at that moment, if any"),
        "followed": Column("whether the action is the suggestion; empty without a suggestion", bool),
        "cost_before": Column("cost-to-go before the action; empty in a dead end", float),
        "cost_after": Column("cost-to-go after the action; empty in a dead end", float),
        "optimal": Column("whether an optimal plan begins with the action", bool),
    },
    "answers": {
        "participant": Column("code of a participant"),
        "condition": Column("the condition"),
        "period": Column("1 for the participant's first condition", float),
        "questionnaire": Column("name of the questionnaire"),
        "item": Column("name of the question"),
        "option": Column("for questions with several choices, the option; empty otherwise", later=True),
        "position": Column("1 for the first question on the page", float, later=True),
        "answer": Column(
            "the answer as given, behind an apostrophe if a spreadsheet may take it for a formula; for an option, "
            "whether it was chosen; empty without an answer"
        ),
        "score": Column("the score, with reversed items recoded; empty if the answer is not a number", float),
        "passed": Column(
            "whether an attention check was answered correctly; empty for other questions", bool, later=True
        ),
    },
    "events": {
        "participant": Column("code of a participant"),
        "time": Column("seconds since the study began, without interruptions of the service", float),
        "utc": Column("time of the event, UTC", later=True),
        "event": Column(
            "visited; onward: proceeded to the next stage; withdrew; left: disconnected; returned; expired: the "
            "time limit of the task or of waiting was reached"
        ),
        "stage": Column("the stage at the event"),
    },
}
"""Columns of each table."""


@dataclass
class Tables:
    """The tables of a study.

    Attributes
    ----------
    participants, tasks, actions, answers, events : list of dict
        One dictionary for each row, with the keys of `COLUMNS`.
    """

    participants: list[Row] = field(default_factory=list)
    tasks: list[Row] = field(default_factory=list)
    actions: list[Row] = field(default_factory=list)
    answers: list[Row] = field(default_factory=list)
    events: list[Row] = field(default_factory=list)

    def analysed(self) -> Tables:
        """Return the tables as the report uses them: of excluded participants, only the row in `participants`."""
        excluded = {row["participant"] for row in self.participants if row["excluded"] is not None}
        return Tables(self.participants).with_rows(self, excluded)

    def with_rows(self, other: Tables, without: Container[str]) -> Tables:
        """Return these participants with the rows of other tables, without those of some participants."""
        kept = {
            name: [row for row in getattr(other, name) if row["participant"] not in without]
            for name in COLUMNS if name != "participants"
        }  # fmt: skip
        return replace(self, **kept)

    def csv(self, name: str) -> str:
        """Return a table as CSV."""
        return written(COLUMNS[name], getattr(self, name))

    def logs(self) -> Iterator[tuple[str, str]]:
        """Yield a log for `kitassist fit` for each task: its name, and the actions in it as JSON Lines."""
        for task in dict.fromkeys(row["task"] for row in self.tasks):
            rows = (
                {
                    "person": row["participant"], "episode": str(row["period"]), "step": row["step"],
                    "action": row["action"], "suggestion": row["suggestion"], "time": row["time"],
                }
                for row in self.actions if row["task"] == task and row["condition"] is not None
            )  # fmt: skip
            yield task, "".join(json.dumps(row) + "\n" for row in rows)


def tables(study: UserStudy, journal: Path) -> Tables:
    """Return the tables of a study from its journal. Participants who withdrew are in `participants` only.

    Parameters
    ----------
    study : UserStudy
    journal : Path
        The study may be running.

    Raises
    ------
    InputFileError
        The file is not the journal of a user study.
    InputFileError
        It is that of another version.
    """
    header, records = stored(journal)
    require_version(journal, header, StudyRecord.format)
    if header.get("format") != StudyRecord.format:
        raise InputFileError.of(journal, None, "not the journal of a user study")
    roll, found = Roll(study), Tables()
    here: dict[str, Row] = {}  # of each participant what they did at their stage; at a task, its row
    for utc, plain in records:
        record = StudyRecord.of(json.dumps(plain))
        event, code = record.event, str(record.event.who)
        before = roll.participants.get(code)
        stage = study.stages[0 if before is None else before.at]
        where = {} if before is None else _where(study, before, stage)
        record.note(roll)
        if event.is_tabled:
            found.events.append(_event(code, record, utc, event.kind, stage))
        if isinstance(event, Onward):
            found.answers += [where | row for row in _answers(study, stage, event.answers or {})]
        elif event.is_action:
            row = where | _action(stage, record, here[code]["actions"]) | {"utc": utc}
            found.actions.append(row)
            _count(here[code], row, record, roll.participants[code])
        for entered in dict.fromkeys(roll.entered):
            person = roll.participants[entered]
            to = study.stages[person.at]
            here[entered] = _where(study, person, to) | _begun(study, to)
            if to.kind == "task":
                found.tasks.append(here[entered])
            if entered in record.members:  # others of the group have come
                found.events.append(_event(entered, record, utc, "onward", to))
        failed = next((one.fault for one in record.team if one.fault is not None), None)
        if failed is not None and code in here and here[code]["fault"] is None:  # erased events are nobody's
            here[code]["fault"] = failed
    withdrawn = {code for code, person in roll.participants.items() if person.status == WITHDREW}
    wrong = Counter(row["participant"] for row in found.answers if row["passed"] is False)
    people = [_participant(study, person, wrong[person.code]) for person in roll.participants.values()]
    return Tables(people).with_rows(found, withdrawn)


def exported(study: UserStudy, folder: Path) -> Tables:
    """Return the tables of an unpacked export.

    Raises
    ------
    InputFileError, OSError
        A file is damaged or missing, or has a row that does not fit the study or the other tables.
    """
    fitting = _Fitting(study)
    return Tables(**{
        name: list(rows(folder / f"{name}.csv", columns, partial(fitting.fault, name)))
        for name, columns in COLUMNS.items()
    })  # fmt: skip


class _Fitting:
    """Whether the rows of an export that reports use, table by table, fit the study and each other."""

    def __init__(self, study: UserStudy) -> None:
        names = [one.name for one in study.conditions]
        self.by_condition = {one.name: study.is_by_condition(one) for one in study.questionnaires}
        self.known: dict[str, dict[str, Container[Any]]] = {
            "participants": {"condition": [None, *study.orders], "stage": [one.name for one in study.stages]},
            "tasks": {"condition": names, "task": dict(study.tasks)},
            "answers": {"condition": [None, *names], "questionnaire": self.by_condition},
        }
        self.people, self.begun = set[str](), set[tuple[str, ...]]()

    def fault(self, table: str, row: Row) -> str | None:
        """Return what is wrong in a row; None if it fits."""
        if table not in self.known:
            return None
        for name, values in self.known[table].items():
            if row[name] not in values:
                return f"{name} '{row[name] or ''}'; expected one of the study"
        who = row["participant"]
        if (table == "participants") == (who in self.people):
            return f"participant '{who or ''}'; expected {'each once' if who in self.people else 'one of participants'}"
        self.people.add(who)
        if table == "answers" and (row["condition"] is not None) != self.by_condition[row["questionnaire"]]:
            asked = "a condition" if row["condition"] is None else "none, as it does not belong to one"
            return f"the condition of '{row['questionnaire']}'; expected {asked}"
        if table == "tasks":
            task = (who, row["condition"], row["task"])
            if task in self.begun:
                return f"task '{row['task']}' of '{who}' in '{row['condition']}'; expected it once"
            self.begun.add(task)
        return None


def _participant(study: UserStudy, person: Participant, failed: int) -> Row:
    row: Row = {
        "participant": person.code, "simulated": person.simulated, "arrived": None, "consented": None,
        "status": person.status, "stage": study.stages[person.at].name, "condition": person.condition,
        "group": person.group, "completion_code": None, "failed_checks": 0, "excluded": None,
    }  # fmt: skip
    if person.status == WITHDREW:
        return row
    most, excluded = study.exclude_failed_checks, person.excluded
    if most is not None and failed >= most and excluded is None:
        excluded = f"failed {most} or more attention checks"
    return row | {
        "arrived": person.arrived, "consented": person.consented, "completion_code": person.completion,
        "failed_checks": failed, "excluded": excluded,
    }  # fmt: skip


def _event(code: str, record: StudyRecord, utc: str | None, kind: str, stage: Stage) -> Row:
    return {"participant": code, "time": record.time, "utc": utc, "event": kind, "stage": stage.name}


def _begun(study: UserStudy, stage: Stage) -> Row:
    """Return the columns of a task that a participant begins; of another stage, those that count actions."""
    position = [*dict(study.tasks)].index(stage.what) + 1 if stage.kind == "task" else None
    return {
        "task": stage.what, "position": position, "finished": False, "optimal_cost": None,
        **{one.name: one.start for one in COUNTED}, "fault": None,
    }  # fmt: skip


def _where(study: UserStudy, person: Participant, stage: Stage) -> Row:
    """Return the first columns of a row: the participant's code, and the condition and period of a stage."""
    return {
        "participant": person.code, "condition": study.condition_at(stage, person.condition), "period": stage.period
    }  # fmt: skip


def _answers(study: UserStudy, stage: Stage, answers: Mapping[str, Any]) -> Iterator[Row]:
    """Yield a row for each answer, in the order of the questions on the page; for several choices, one per option."""
    items = {item.name: item for item in study.questionnaire(stage.what).items} if answers else {}
    for position, (name, answer) in enumerate(answers.items(), start=1):
        item = items[name]
        where = {"questionnaire": stage.what, "item": name, "position": position}
        yield from (where | row for row in item.kind.rows(item, answer))


def _action(stage: Stage, record: StudyRecord, step: int) -> Row:
    own, seen = own_action(record.team, str(record.event.who)), record.seen
    assert seen is not None
    action = own.action or ""
    followed = None if seen.suggestion is None else action.strip().lower() == seen.suggestion.lower()
    return {
        "task": stage.what, "step": step, "time": record.time, "action": action, "suggestion": seen.suggestion,
        "followed": followed, "cost_before": seen.cost_before, "cost_after": seen.cost_after, "optimal": seen.optimal,
    }  # fmt: skip


def _count(task: Row, action: Row, record: StudyRecord, person: Participant) -> None:
    if action["step"] == 0:
        task["optimal_cost"] = action["cost_before"]
    task["finished"] = record.seen is not None and record.seen.finished
    seconds = round(record.time - person.entered, 3)
    task |= {one.name: one.after(task, action, seconds) for one in COUNTED}
