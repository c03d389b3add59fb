"""Numeric results of a user study: who took part, conditions, differences from the reference, and questionnaires."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from statistics import fmean
from typing import Any

from planner.system.files import finite

from ...team.policy_names import hardly_assists
from ..statistics import FEW, cronbach_alpha
from ..userstudy.forms import Item
from ..userstudy.outcomes import Row
from ..userstudy.plan import UserStudy
from ..userstudy.questionnaires import BEFORE, Questionnaire
from ..userstudy.tables import Tables
from .userstudy_comparisons import cells, compared, likert, smallest_shown, worst_ranks
from .userstudy_data import ALL, StudyData


def summarise(study: UserStudy, tables: Tables) -> dict[str, Any]:
    """Return all numbers of the report as JSON data."""
    data = StudyData(study, tables)
    first = data.measures[0]
    return {
        "title": study.title,
        "simulated": any(row["simulated"] for row in tables.participants),
        "design": study.design,
        "reference": study.reference,
        "setup": _setup(data),
        "faults": list(_faults(data)),
        "seldom_assisted": list(_seldom_assisted(data)),
        "participants": {"planned": study.participants, **_counts(data)},
        "conditions": _conditions(data), **_groups(data),
        "flow": _flow(data),
        "measures": compared(data, data.measures),
        "worst_rank": list(worst_ranks(data)),
        "likert": list(likert(data)),
        "questionnaires": [_questionnaire(data, one) for one in study.questionnaires if one.scale],
        "answers": [
            answer for one in study.questionnaires for item in one.items for answer in _asked(data, one, item)
        ],
        "detectable": smallest_shown(data, first),
        "few": [name for name in data.names if len(first.values[name]) < FEW],
    }  # fmt: skip


def _setup(data: StudyData) -> dict[str, Any]:
    """Return the tasks with the costs of optimal plans as far as somebody began them, simulated people, and dates."""
    study, tables = data.study, data.tables
    costs = {row["task"]: row["optimal_cost"] for row in tables.tasks}
    times = [row["arrived"] for row in tables.participants if row["arrived"] is not None]
    times += [row["utc"] for row in tables.events if row["utc"] is not None]
    return {
        "tasks": [{"task": name, "optimal_cost": costs.get(name)} for name, _ in study.tasks],
        "simulated_people": study.simulated, "first": min(times, default=None), "last": max(times, default=None),
    }  # fmt: skip


def _faults(data: StudyData) -> Iterator[Row]:
    """Yield the conditions whose policy failed: in how many of their tasks, and its first error."""
    for one in data.study.conditions:
        own = [row.get("fault") for row in data.tables.tasks if row["condition"] == one.name]
        failed = [fault for fault in own if fault is not None]
        if failed:
            yield {"condition": one.name, "failed": len(failed), "tasks": len(own), "fault": failed[0]}


def _seldom_assisted(data: StudyData) -> Iterator[Row]:
    """Yield the conditions in which a policy that weighs costs hardly assisted, with the percentage of tasks."""
    for one in data.study.conditions:
        own = [row for row in data.tables.tasks if row["condition"] == one.name and row["actions"]]
        assisted = 100 * fmean(bool(row["suggestions"]) for row in own) if own else 100.0
        if hardly_assists(one.policy, assisted):
            costs = {"c_suggest": one.setting.c_suggest, "c_move": one.setting.c_move}
            yield {"condition": one.name, "policy": one.policy, "assisted": assisted, **costs}


# Participants.


def _counts(data: StudyData) -> dict[str, Any]:
    """Return how many participants enrolled, were randomised, completed, left or were excluded, and why."""
    people = data.tables.participants
    statuses = Counter(row["status"] for row in people)
    excluded = Counter(row["excluded"] for row in people if row["excluded"] is not None)
    done = [row for row in people if row["status"] == "done"]
    return {
        "enrolled": len(people), "declined": statuses["declined"], "full": statuses["full"],
        "randomised": sum(row["condition"] is not None for row in people), "completed": len(done),
        "withdrew": statuses["withdrew"], "gone": statuses["gone"], "here": statuses["here"],
        "erased": sum(row["participant"].startswith("(erased") for row in people),
        "excluded": dict(sorted(excluded.items())),
        "analysed": sum(row["excluded"] is None for row in done),
    }  # fmt: skip


def _groups(data: StudyData) -> dict[str, Any]:
    """Return how many groups began, with all members or fewer, and how many participants found none."""
    if data.study.group is None:
        return {}
    size, people = data.study.group.size, data.tables.participants
    sizes = Counter(row["group"] for row in people if row["group"] is not None)
    smaller = sum(members != size for members in sizes.values())
    unmatched = sum(row["status"] == "unmatched" for row in people)
    return {"groups": {"size": size, "began": len(sizes), "smaller": smaller, "unmatched": unmatched}}


def _conditions(data: StudyData) -> list[Row]:
    """Return the numbers of participants in each condition, or in each order of conditions."""
    found, policies = [], {one.name: one.policy for one in data.study.conditions}
    for name, order in data.study.orders.items():
        own = [row["status"] for row in data.tables.participants if row["condition"] == name]
        done, here, withdrew = own.count("done"), own.count("here"), own.count("withdrew")
        counts = {"begun": len(own), "done": done, "under_way": here, "withdrew": withdrew}
        counts["left"] = len(own) - done - here - withdrew
        found.append({"condition": name, "policy": " > ".join(policies[one] for one in order), **counts})
    return found


def _flow(data: StudyData) -> list[Row]:
    """Return the numbers of participants who reached each stage, who left there, and who withdrew there.

    Who withdrew, perhaps after the end, counts at no stage as somebody who reached it.
    """
    stages = [stage.name for stage in data.study.stages]
    at = [(stages.index(row["stage"]), row["status"]) for row in data.tables.participants]
    kept = [(stage, status) for stage, status in at if status != "withdrew"]
    return [
        {
            "stage": name, "reached": sum(stage >= number for stage, _ in kept),
            "left": sum(stage == number and status not in ("done", "here") for stage, status in kept),
            "there": sum(stage == number and status == "here" for stage, status in kept),
            "withdrew": sum(stage == number and status == "withdrew" for stage, status in at),
        }
        for number, name in enumerate(stages)
    ]  # fmt: skip


# Questionnaires.


def _questionnaire(data: StudyData, one: Questionnaire) -> dict[str, Any]:
    rows, where = data.scored(one), data.asked_in(one)
    items = []
    for item in one.scale:
        given = ((who, condition, scores.get(item.name)) for who, condition, scores in rows)
        items += [{"item": item.name, **cell} for cell in cells(data, data.by_condition(given, where), item.ends[:2])]
    # Answers of one participant in several conditions are not independent, so that each condition has an alpha.
    alphas = {name: _alpha(one, [row for row in rows if name in (ALL, row[1])]) for name in where}
    repeated = data.study.is_within and len(where) > 1
    return {
        "questionnaire": one.name, "form": one.form, "n": len(rows), "alpha": None if repeated else _alpha(one, rows),
        "alphas": alphas if repeated else {}, "items": items,
    }  # fmt: skip


def _alpha(one: Questionnaire, rows: list[tuple[str, str, dict[str, float]]]) -> float | None:
    """Return Cronbach's alpha over those who answered all items."""
    names = [item.name for item in one.scale]
    return finite(cronbach_alpha([[own[name] for name in names] for *_, own in rows if {*names} <= {*own}]))


def _asked(data: StudyData, one: Questionnaire, item: Item) -> Iterator[Row]:
    """Yield the answers to a question that belongs to no scale, by condition if it is asked in each."""
    if not item.kind.is_counted or item in one.scale:
        return
    own = [row for row in data.tables.answers if (row["questionnaire"], row["item"]) == (one.name, item.name)]
    answered = [row for row in own if row["answer"] is not None]
    yield from _answers(data, one, item, data.asked_in(one), answered)
    if one.when == BEFORE and not data.study.is_within and len(data.names) > 1:
        # What was asked before describes the sample of each condition, too.
        assigned = {row["participant"]: row["condition"] for row in data.tables.participants}
        begun = [row | {"condition": assigned[row["participant"]]} for row in answered]
        yield from _answers(data, one, item, data.names, [row for row in begun if row["condition"] is not None])


def _answers(data: StudyData, one: Questionnaire, item: Item, where: list[str], answered: list[Row]) -> Iterator[Row]:
    """Yield the numbers of answers to a question in each condition of `where`."""
    scores = ((row["participant"], row["condition"], row["score"]) for row in answered)
    of_scores = cells(data, data.by_condition(scores, where), item.ends[:2]) if item.is_scored else [{} for _ in where]
    for name, cell in zip(where, of_scores, strict=True):
        given = [row for row in answered if name in (ALL, row["condition"])]
        counts = Counter(dict.fromkeys(item.options, 0))
        counts.update(item.kind.counted(given))
        yield {
            "questionnaire": one.name, "item": item.name, "form": item.form, "condition": name,
            "n": len({row["participant"] for row in given}), "counts": dict(counts),
            **({"passed": sum(row["passed"] is True for row in given)} if item.correct is not None else {}), **cell,
        }  # fmt: skip
