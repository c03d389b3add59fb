"""Tidy tables of a study's data, one row for each observation, derived from the journal alone.

The tables are exported as CSV with a data dictionary. Reports read them too.
"""

from __future__ import annotations

import csv
import io
import json
import re
import unicodedata
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from planner.system.errors import DamagedFileError

from ..live.events import ERASED, VACANT
from ..live.store import stored
from .participant_team import own_action
from .plan import Stage, UserStudy
from .questionnaires import CHOICES
from .session import FORMAT

Row = dict[str, Any]

COLUMNS: dict[str, dict[str, str]] = {
    "participants": {
        "participant": "code of a participant; a number if the records were erased",
        "simulated": "whether the participant is simulated (in a rehearsal)",
        "arrived": "time of arrival, UTC",
        "consented": "time of consent, UTC; empty before",
        "status": "done; here: taking part; gone: disconnected for too long; withdrew: no other table has their data; "
        "declined: no consent; unmatched: no group was found in time; full: the study was full on return",
        "stage": "the last stage that the participant reached",
        "condition": "assigned when the first task begins, empty before; in a within-participants design, the order",
        "completion_code": "code shown at the end",
        "failed_checks": "attention checks that were answered wrongly",
        "excluded": "why the participant is excluded from the report; empty otherwise",
        "group": "the group that shared a robot; empty before it began, and in studies without groups",
    },
    "tasks": {
        "participant": "code of a participant",
        "condition": "the condition",
        "period": "1 for the participant's first condition",
        "task": "the task's file name without its ending",
        "position": "1 for the first task in this condition",
        "finished": "whether the goal was reached",
        "actions": "actions taken",
        "optimal_cost": "cost of an optimal plan from the initial state; its length if every action costs 1",
        "suboptimal_actions": "actions that begin no optimal plan",
        "suggestions": "suggestions shown when an action was taken",
        "followed": "number of these suggestions that were followed",
        "seconds": "seconds from the beginning to the last action, without interruptions of the service",
    },
    "actions": {
        "participant": "code of a participant",
        "condition": "the condition; empty in practice",
        "period": "1 for the participant's first condition; 0 in practice",
        "task": "the task, or practice",
        "step": "0 for the first action of the task",
        "time": "seconds since the study began, without interruptions of the service",
        "utc": "time of the action, UTC",
        "action": "the action in PDDL",
        "suggestion": "the suggestion shown at that moment, if any",
        "followed": "whether the action is the suggestion; empty without a suggestion",
        "cost_before": "cost-to-go before the action; empty in a dead end",
        "cost_after": "cost-to-go after the action; empty in a dead end",
        "optimal": "whether an optimal plan begins with the action",
    },
    "answers": {
        "participant": "code of a participant",
        "condition": "the condition",
        "period": "1 for the participant's first condition",
        "questionnaire": "name of the questionnaire",
        "item": "name of the question",
        "option": "for questions with several choices, the option; empty otherwise",
        "position": "1 for the first question on the page",
        "answer": "the answer as given; for an option, whether it was chosen; empty without an answer",
        "score": "the score, with reversed items recoded; empty if the answer is not a number",
        "passed": "whether an attention check was answered correctly; empty for other questions",
    },
    "events": {
        "participant": "code of a participant",
        "time": "seconds since the study began, without interruptions of the service",
        "utc": "time of the event, UTC",
        "event": "visited; onward: proceeded to the next stage; withdrew; left: disconnected; returned; expired: the "
        "time limit of the task or of waiting was reached",
        "stage": "the stage at the event",
    },
}
"""Columns of each table, with their meanings."""


EVENTS = {"visited", "onward", "withdrew", "left", "returned", "expired"}
"""Events of the table `events`. Actions have a table of their own."""

CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\ud800-\udfff]")
"""Signs that are no text; some readers end a file at them. U+FFFD stands for them in CSV."""


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
        kept = {
            name: [row for row in getattr(self, name) if row["participant"] not in excluded]
            for name in ("tasks", "actions", "answers", "events")
        }
        return Tables(self.participants, **kept)

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


def written(columns: Iterable[str], rows: Iterable[Mapping[str, Any]]) -> str:
    """Return rows as CSV with the given columns. None is an empty cell; truth values are `true` and `false`."""
    content = io.StringIO()
    writer = csv.writer(content, lineterminator="\n")
    columns = list(columns)
    writer.writerow(columns)
    for row in rows:
        writer.writerow([_plain(row[name]) for name in columns])
    return content.getvalue()


def _plain(cell: Any) -> Any:
    if isinstance(cell, bool):
        return str(cell).lower()
    if isinstance(cell, str):
        # Some readers take a carriage return for the end of a row.
        text = CONTROL.sub("\ufffd", cell.replace("\r\n", "\n").replace("\r", "\n"))
        return f"'{text}" if is_formula(text) else text
    return cell


def is_formula(text: str) -> bool:
    """Whether a spreadsheet may evaluate a text, unless an apostrophe precedes it; or the same behind apostrophes.

    Spreadsheets skip blanks and invisible signs, and take full-width signs for the usual ones.
    """
    for place, sign in enumerate(text):
        if sign in "\t\n" and not text[:place].strip("'"):
            return True
        if sign != "'" and not sign.isspace() and unicodedata.category(sign) != "Cf":
            return unicodedata.normalize("NFKC", sign) in ("=", "+", "-", "@", "\u2212")
    return False


def text_of(cell: str) -> str:
    """Return the text of a cell that `written` wrote: without the apostrophe before what looks like a formula."""
    return cell[1:] if cell.startswith("'") and is_formula(cell) else cell


def tables(study: UserStudy, journal: Path) -> Tables:
    """Return the tables of a study from its journal. Participants who withdrew are in `participants` only.

    Parameters
    ----------
    study : UserStudy
    journal : Path
        The study may be running.

    Raises
    ------
    DamagedFileError
        The file is not the journal of a user study.
    """
    header, records = stored(journal)
    if header.get("format") != FORMAT:
        raise DamagedFileError(journal, None, "not the journal of a user study")
    found, stages = Tables(), study.stages
    at: dict[str, int] = {}
    people: dict[str, Row] = {}
    current: dict[str, Row] = {}
    began: dict[str, float] = {}
    removed: dict[str, str] = {}
    steps: dict[str, int] = {}

    def enters(code: str, stage: Stage, time: float) -> None:
        current.pop(code, None)
        steps[code], began[code], people[code]["stage"] = 0, time, stage.name
        if stage.kind == "task":
            current[code] = _where(study, people[code], stage) | {
                "task": stage.what, "position": [name for name, _ in study.tasks].index(stage.what) + 1,
                "finished": False, "actions": 0, "optimal_cost": None, "suboptimal_actions": 0, "suggestions": 0,
                "followed": 0, "seconds": None,
            }  # fmt: skip
            found.tasks.append(current[code])

    def begins(record: Mapping[str, Any], utc: str | None) -> None:
        for code in record["members"]:
            people[code] |= {name: record[name] for name in ("condition", "group") if name in record}
            at[code] = study.begins_at(record.get("period", 1))
            enters(code, stages[at[code]], record["time"])
            found.events.append({
                "participant": code, "time": record["time"], "utc": utc, "event": "onward",
                "stage": people[code]["stage"],
            })  # fmt: skip

    for utc, record in records:
        code, event = record.get("person"), record["event"]
        if "members" in record and code is None:
            begins(record, utc)
        if code is None:  # the records were erased
            continue
        if event in ("visited", VACANT):
            people[code] = {
                "participant": code, "simulated": bool(record.get("simulated")), "arrived": record.get("at"),
                "consented": None, "status": "here", "stage": stages[0].name,
                "condition": None, "group": None, "completion_code": None, "failed_checks": 0, "excluded": None,
            }  # fmt: skip
            at[code] = 0
        person, stage = people[code], stages[at[code]]
        if "reached" in record:  # the records of a withdrawal were removed
            removed[code] = stages[record["reached"]].name
        if event in EVENTS:
            found.events.append({
                "participant": code, "time": record["time"], "utc": utc, "event": event, "stage": person["stage"],
            })  # fmt: skip
        person["status"] = "here" if record.get("returned") else record.get("status", person["status"])
        if event == "excluded":
            person["excluded"] = record["reason"]
        if event == ERASED:
            person["condition"] = record["condition"]
            person["stage"] = next(one.name for one in stages if one.kind == "task")
        if event == "onward":
            where = _where(study, person, stage)
            rows = list(_answers(study, stage, record.get("answers", {})))
            found.answers += [where | row for row in rows]
            person["failed_checks"] += sum(row["passed"] is False for row in rows)
            if "members" not in record:
                person["condition"] = record.get("condition", person["condition"])
            person["consented"] = record["at"] if stage.kind == "consent" and "at" in record else person["consented"]
            at[code] = study.next_stage(at[code], person["condition"])
            stage = stages[at[code]]
            enters(code, stage, record["time"])
            if stage.kind == "thanks":
                person["status"], person["completion_code"] = "done", record["completion"]
        elif event == "acted":
            row = _where(study, person, stage) | _action(stage, record, steps[code]) | {"utc": utc}
            steps[code] += 1
            found.actions.append(row)
            if code in current:
                _count(current[code], row, record["seen"]["finished"], record["time"] - began[code])
        elif event == "expired" and "completion" in record:  # no group in time
            person["completion_code"] = record["completion"]
        if "members" in record:
            begins(record, utc)
    withdrawn = {code for code, person in people.items() if person["status"] == "withdrew"}
    most = study.exclude_failed_checks
    for person in people.values():
        if person["status"] == "withdrew":
            person |= {
                "arrived": None,
                "consented": None,
                "completion_code": None,
                "excluded": None,
                "failed_checks": 0,
            }
            person["stage"] = removed.get(person["participant"], person["stage"])
        elif most is not None and person["failed_checks"] >= most and person["excluded"] is None:
            person["excluded"] = f"failed {most} or more attention checks"
    for name in ("tasks", "actions", "answers", "events"):
        setattr(found, name, [row for row in getattr(found, name) if row["participant"] not in withdrawn])
    found.participants = list(people.values())
    return found


def _where(study: UserStudy, person: Row, stage: Stage) -> Row:
    """Return the first columns of a row: the participant's code, and the condition and period of a stage."""
    condition = study.condition_at(stage, person["condition"])
    return {"participant": person["participant"], "condition": condition, "period": stage.period}


def _answers(study: UserStudy, stage: Stage, answers: Mapping[str, Any]) -> Iterator[Row]:
    """Yield a row for each answer, in the order of the questions on the page; for several choices, one per option."""
    items = {item.name: item for item in study.questionnaire(stage.what).items} if answers else {}
    for position, (name, answer) in enumerate(answers.items(), start=1):
        item = items[name]
        row = {"questionnaire": stage.what, "item": name, "option": None, "position": position}
        if item.form == CHOICES:
            for option in item.options:
                yield row | {"option": option, "answer": option in answer, "score": None, "passed": None}
        else:
            yield row | {"answer": answer, "score": item.score(answer), "passed": item.passed(answer)}


def _action(stage: Stage, record: Mapping[str, Any], step: int) -> Row:
    own, seen = own_action(record["team"], record["person"]), record["seen"]
    followed = None if seen["suggestion"] is None else own["action"].strip().lower() == seen["suggestion"].lower()
    return {
        "task": stage.what, "step": step, "time": record["time"], "action": own["action"],
        "suggestion": seen["suggestion"], "followed": followed, "cost_before": seen["cost_before"],
        "cost_after": seen["cost_after"], "optimal": seen["optimal"],
    }  # fmt: skip


def _count(task: Row, action: Row, finished: bool, seconds: float) -> None:
    if action["step"] == 0:
        task["optimal_cost"] = action["cost_before"]
    task["finished"], task["seconds"] = finished, round(seconds, 3)
    task["actions"] += 1
    task["suboptimal_actions"] += not action["optimal"]
    task["suggestions"] += action["suggestion"] is not None
    task["followed"] += bool(action["followed"])
