"""What a study has recorded as tidy tables, one row for each observation, from its journal alone.

They are written as CSV, with a table that says what each column means, and read again by whoever analyses them.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from planner.system.errors import DamagedFileError

from .plan import Stage, UserStudy
from .session import FORMAT

Row = dict[str, Any]

COLUMNS: dict[str, dict[str, str]] = {
    "participants": {
        "participant": "code of a participant",
        "simulated": "true in a rehearsal: nobody real",
        "arrived": "when they came, UTC",
        "status": "done; here: under way; gone: not connected for long; withdrew; declined: no consent; full: no place "
        "when they came back",
        "stage": "the last stage that they reached",
        "condition": "drawn when their first task began; empty before; where everybody has all, their order",
        "completion_code": "what they were given at the end",
    },
    "tasks": {
        "participant": "code of a participant",
        "condition": "their condition",
        "period": "1 for their first condition",
        "task": "the task's file name without its ending",
        "position": "1 for the first task in this condition",
        "finished": "whether the goal was reached",
        "actions": "actions taken",
        "optimal_cost": "cost of a cheapest plan from the beginning; the number of actions where each costs 1",
        "suboptimal_actions": "actions that no cheapest plan begins with",
        "suggestions": "suggestions that were answered by an action",
        "followed": "of these, followed",
        "seconds": "from the beginning to the last action, without those in which the service did not run",
    },
    "actions": {
        "participant": "code of a participant",
        "condition": "their condition; empty in practice",
        "period": "1 for their first condition; 0 in practice",
        "task": "the task; practice",
        "step": "0 for the first action of the task",
        "time": "seconds since the study began, without those in which the service did not run",
        "action": "in PDDL",
        "suggestion": "what was suggested at that moment, if anything",
        "followed": "whether the action is the suggestion; empty without one",
        "cost_before": "cheapest way to the goal before the action; empty in a dead end",
        "cost_after": "the same after it",
        "optimal": "whether a cheapest plan begins with it",
    },
    "answers": {
        "participant": "code of a participant",
        "condition": "their condition",
        "period": "1 for their first condition",
        "questionnaire": "its name",
        "item": "the question's name",
        "answer": "as given",
        "score": "a number, reversed items turned round; empty for answers in words",
    },
    "events": {
        "participant": "code of a participant",
        "time": "seconds since the study began, without those in which the service did not run",
        "event": "visited; onward: a stage was left for the next; withdrew; left: gone; returned; expired: the task's "
        "time was up",
        "stage": "in which it happened",
    },
}
"""What there is in each table."""


EVENTS = {"visited", "onward", "withdrew", "left", "returned", "expired"}
"""Those that the table of events has; actions have their own."""


@dataclass
class Tables:
    """The tables of a study.

    Attributes
    ----------
    participants, tasks, actions, answers, events : list of dict
        A row each, with the keys of `COLUMNS`.
    """

    participants: list[Row] = field(default_factory=list)
    tasks: list[Row] = field(default_factory=list)
    actions: list[Row] = field(default_factory=list)
    answers: list[Row] = field(default_factory=list)
    events: list[Row] = field(default_factory=list)

    def csv(self, name: str) -> str:
        """Write a table."""
        return written(COLUMNS[name], getattr(self, name))

    def logs(self) -> Iterator[tuple[str, str]]:
        """Give for each task its name and everybody's actions at it, as JSON Lines that `fit` reads."""
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
    """Write rows as CSV: nothing for None, true and false in small letters."""
    content = io.StringIO()
    writer = csv.writer(content, lineterminator="\n")
    columns = list(columns)
    writer.writerow(columns)
    for row in rows:
        writer.writerow([_plain(name, row[name]) for name in columns])
    return content.getvalue()


def _plain(name: str, cell: Any) -> Any:
    if isinstance(cell, bool):
        return str(cell).lower()
    if name == "answer" and isinstance(cell, str) and cell[:1] in ("=", "+", "-", "@"):
        return f"'{cell}"  # which a spreadsheet would take for a formula
    return cell


def records(journal: Path) -> Iterator[dict[str, Any]]:
    """Give the records of a journal, which may be written to meanwhile; an unfinished last line is left out.

    Raises
    ------
    DamagedFileError
        It is not the journal of a user study.
    """
    with journal.open("rb") as stream:
        for number, line in enumerate(stream, start=1):
            if not line.endswith(b"\n"):
                return
            try:
                record = json.loads(line)
            except ValueError:
                record = None
            if not isinstance(record, dict) or (number == 1 and record.get("format") != FORMAT):
                raise DamagedFileError(journal, number, "is not of a user study; expected its journal")
            if number > 1:
                yield record


def tables(study: UserStudy, journal: Path) -> Tables:
    """Give what a journal says.

    Parameters
    ----------
    study : UserStudy
    journal : Path
    """
    found, stages = Tables(), study.stages
    at: dict[str, int] = {}
    people: dict[str, Row] = {}
    current: dict[str, Row] = {}
    began: dict[str, float] = {}
    steps: dict[str, int] = {}
    for record in records(journal):
        code, event = record["person"], record["event"]
        if event == "visited":
            people[code] = {
                "participant": code, "simulated": bool(record.get("simulated")), "arrived": record["at"],
                "status": "here", "stage": stages[0].name, "condition": None, "completion_code": None,
            }  # fmt: skip
            at[code] = 0
        person, stage = people[code], stages[at[code]]
        if event in EVENTS:
            found.events.append({"participant": code, "time": record["time"], "event": event, "stage": person["stage"]})
        person["status"] = "here" if record.get("returned") else record.get("status", person["status"])
        if event == "onward":
            for item, answer in record.get("answers", {}).items():
                found.answers.append(_where(study, person, stage) | _answer(study, stage, item, answer))
            person["condition"] = record.get("condition", person["condition"])
            at[code] += 1
            stage = stages[at[code]]
            person["stage"] = stage.name
            current.pop(code, None)
            steps[code], began[code] = 0, record["time"]
            if stage.kind == "task":
                current[code] = _where(study, person, stage) | {
                    "task": stage.what, "position": [name for name, _ in study.tasks].index(stage.what) + 1,
                    "finished": False, "actions": 0, "optimal_cost": None, "suboptimal_actions": 0, "suggestions": 0,
                    "followed": 0, "seconds": None,
                }  # fmt: skip
                found.tasks.append(current[code])
            if stage.kind == "thanks":
                person["status"], person["completion_code"] = "done", record["completion"]
        elif event == "acted":
            row = _where(study, person, stage) | _action(stage, record, steps[code])
            steps[code] += 1
            found.actions.append(row)
            if code in current:
                _count(current[code], row, record["seen"]["finished"], record["time"] - began[code])
    found.participants = list(people.values())
    return found


def _where(study: UserStudy, person: Row, stage: Stage) -> Row:
    """Say who somebody is, and in which condition at a stage."""
    condition = study.orders[person["condition"]][stage.period - 1] if stage.period else None
    return {"participant": person["participant"], "condition": condition, "period": stage.period}


def _answer(study: UserStudy, stage: Stage, name: str, answer: Any) -> Row:
    questionnaire = study.questionnaire(stage.what)
    item = next(item for item in questionnaire.items if item.name == name)
    score = None if isinstance(answer, str) else questionnaire.score(item, answer)
    return {"questionnaire": questionnaire.name, "item": name, "answer": answer, "score": score}


def _action(stage: Stage, record: Mapping[str, Any], step: int) -> Row:
    own, seen = record["team"][0], record["seen"]
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
