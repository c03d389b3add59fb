"""Numeric results of a user study: conditions, differences from the reference, questionnaires and dropouts."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from statistics import fmean
from typing import Any

import numpy as np

from planner.system.files import finite

from ..userstudy.plan import UserStudy
from ..userstudy.questionnaires import CHOICE, CHOICES, TEXT, TLX, Item, Questionnaire
from ..userstudy.tables import Row, Tables
from .effects import (
    cronbach_alpha,
    detectable,
    detectable_within,
    difference,
    difference_within,
    hedges_g,
    hedges_g_within,
)
from .statistics import FEW, mean

ALL = "all participants"
"""Stands for the condition where answers do not belong to one."""

TASK_MEASURES = {
    "actions": "actions per task",
    "suboptimal_actions": "suboptimal actions per task",
    "seconds": "seconds per task",
    "suggestions": "suggestions per task",
    "followed": "suggestions followed, %",
}


@dataclass(frozen=True)
class Measure:
    """A value for each participant.

    Attributes
    ----------
    name, label : str
    values : dict of dict
        Values by condition and participant.
    """

    name: str
    label: str
    values: dict[str, dict[str, float]]


def measures(study: UserStudy, tables: Tables) -> Iterator[Measure]:
    """Yield the measures: of participants who completed all tasks, and of those who answered a questionnaire."""
    stages = [stage.name for stage in study.stages]
    last = max(number for number, stage in enumerate(study.stages) if stage.kind == "task")
    through = {row["participant"] for row in tables.participants if stages.index(row["stage"]) > last}
    own: dict[tuple[str, str], list[Row]] = {}
    for row in tables.tasks:
        if row["participant"] in through:
            own.setdefault((row["participant"], row["condition"]), []).append(row)
    for name, label in TASK_MEASURES.items():
        found: dict[str, dict[str, float]] = {one.name: {} for one in study.conditions}
        for (participant, condition), rows in own.items():
            value = _of_tasks(name, rows)
            if value is not None:
                found[condition][participant] = value
        yield Measure(name, label, found)
    for one in study.questionnaires:
        if one.scale and study.is_by_condition(one):
            found = {condition.name: {} for condition in study.conditions}
            for participant, condition, scores in scored(one, tables):
                if (score := one.mean(scores)) is not None:
                    found[condition][participant] = score
            low, high, _ = one.scale[0].ends
            raw = "raw " if one.form == TLX else ""
            yield Measure(one.name, f"{one.name}: {raw}mean, {low:g} to {high:g}", found)


def _of_tasks(name: str, rows: list[Row]) -> float | None:
    if name == "followed":
        told = sum(row["suggestions"] for row in rows)
        return 100 * sum(row["followed"] for row in rows) / told if told else None
    values = [row[name] for row in rows if row[name] is not None]
    return fmean(values) if values else None


def scored(questionnaire: Questionnaire, tables: Tables) -> Iterator[tuple[str, str, dict[str, float]]]:
    """Yield each completed questionnaire: the participant, the condition, and the score of each scored answer."""
    given: dict[tuple[str, str], dict[str, float]] = {}
    for row in tables.answers:
        if row["questionnaire"] == questionnaire.name:
            own = given.setdefault((row["participant"], row["condition"]), {})
            if row["score"] is not None:
                own[row["item"]] = row["score"]
    for (participant, condition), scores in given.items():
        yield participant, condition, scores


def summarise(study: UserStudy, tables: Tables) -> dict[str, Any]:
    """Return all numbers of the report as JSON data."""
    tables = tables.analysed()
    names = [one.name for one in study.conditions]
    found = list(measures(study, tables))
    smallest = [min(len(found[0].values[name]), len(found[0].values[study.reference])) for name in names]
    return {
        "title": study.title,
        "simulated": any(row["simulated"] for row in tables.participants),
        "design": study.design,
        "reference": study.reference,
        "participants": _counts(tables),
        "conditions": _conditions(study, tables),
        "flow": _flow(study, tables),
        "measures": [_measure(study, one) for one in found],
        "questionnaires": [_questionnaire(study, one, tables) for one in study.questionnaires if one.scale],
        "answers": [
            answer for one in study.questionnaires for item in one.items for answer in _asked(study, one, item, tables)
        ],
        "detectable": finite(
            detectable_within(min(smallest)) if study.is_within else detectable(min(smallest), min(smallest))
        ),
        "few": [
            name for name, count in zip(names, smallest, strict=True)
            if len(found[0].values[name]) < FEW
        ],
    }  # fmt: skip


def _counts(tables: Tables) -> dict[str, Any]:
    """Return how many participants enrolled, were randomised, completed, left or were excluded, and why."""
    people = tables.participants
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


def _conditions(study: UserStudy, tables: Tables) -> list[Row]:
    """Return the numbers of participants in each condition, or in each order of conditions."""
    found, policies = [], {one.name: one.policy for one in study.conditions}
    for name, order in study.orders.items():
        own = [row["status"] for row in tables.participants if row["condition"] == name]
        done, here = own.count("done"), own.count("here")
        counts = {"begun": len(own), "done": done, "under_way": here, "left": len(own) - done - here}
        found.append({"condition": name, "policy": " > ".join(policies[one] for one in order), **counts})
    return found


def _flow(study: UserStudy, tables: Tables) -> list[Row]:
    """Return the numbers of participants who reached each stage, and who left there."""
    stages = [stage.name for stage in study.stages]
    at = [(stages.index(row["stage"]), row["status"]) for row in tables.participants]
    return [
        {
            "stage": name, "reached": sum(stage >= number for stage, _ in at),
            "left": sum(stage == number and status not in ("done", "here") for stage, status in at),
            "there": sum(stage == number and status == "here" for stage, status in at),
        }
        for number, name in enumerate(stages)
    ]  # fmt: skip


def _measure(study: UserStudy, measure: Measure) -> dict[str, Any]:
    reference, differences = measure.values[study.reference], []
    for name, own in measure.values.items():
        if name != study.reference and (compared := _compared(study, own, reference)):
            differences.append({"condition": name, "against": study.reference, **compared})
    cells = [{"condition": name, **_cell(list(own.values()))} for name, own in measure.values.items()]
    return {"measure": measure.name, "label": measure.label, "cells": cells, "differences": differences}


def _compared(study: UserStudy, own: dict[str, float], reference: dict[str, float]) -> dict[str, Any]:
    """Compare a condition with the reference, within participants if the design allows it; empty without data."""
    if study.is_within:
        pairs = [value - reference[participant] for participant, value in own.items() if participant in reference]
        return {**difference_within(pairs).record(), "hedges_g": finite(hedges_g_within(pairs))} if pairs else {}
    a, b = list(own.values()), list(reference.values())
    return {**difference(a, b).record(), "hedges_g": finite(hedges_g(a, b))} if a and b else {}


def _cell(values: list[float]) -> dict[str, Any]:
    if not values:
        return {"n": 0, "mean": None, "low": None, "high": None, "sd": None, "median": None}
    sd = float(np.std(values, ddof=1)) if len(values) > 1 else math.nan
    return {"n": len(values), **mean(values).record(), "sd": finite(sd), "median": float(np.median(values))}


def _questionnaire(study: UserStudy, one: Questionnaire, tables: Tables) -> dict[str, Any]:
    rows = list(scored(one, tables))
    where = [condition.name for condition in study.conditions] if study.is_by_condition(one) else [ALL]
    items = [
        {
            "item": item.name, "condition": name,
            **_cell([scores[item.name] for _, own, scores in rows if name in (ALL, own) and item.name in scores]),
        }
        for item in one.scale
        for name in where
    ]  # fmt: skip
    # Answers of one participant in several conditions are not independent, so that each condition has an alpha.
    alphas = {name: _alpha(one, [row for row in rows if name in (ALL, row[1])]) for name in where}
    repeated = study.is_within and len(where) > 1
    return {
        "questionnaire": one.name, "form": one.form, "n": len(rows), "alpha": None if repeated else _alpha(one, rows),
        "alphas": alphas if repeated else {}, "items": items,
    }  # fmt: skip


def _alpha(one: Questionnaire, rows: list[tuple[str, str, dict[str, float]]]) -> float | None:
    """Return Cronbach's alpha over those who answered all items."""
    names = [item.name for item in one.scale]
    return finite(cronbach_alpha([[own[name] for name in names] for *_, own in rows if {*names} <= {*own}]))


def _asked(study: UserStudy, one: Questionnaire, item: Item, tables: Tables) -> Iterator[Row]:
    """Yield the answers to a question that belongs to no scale, by condition if it is asked in each."""
    if item.form == TEXT or (item in one.scale):
        return
    own = [row for row in tables.answers if (row["questionnaire"], row["item"]) == (one.name, item.name)]
    for name in [condition.name for condition in study.conditions] if study.is_by_condition(one) else [ALL]:
        rows = [row for row in own if name in (ALL, row["condition"]) and row["answer"] is not None]
        counts = Counter(dict.fromkeys(item.options, 0))
        counts.update(row["option"] for row in rows if item.form == CHOICES and row["answer"] in (True, "true"))
        counts.update(row["answer"] for row in rows if item.form == CHOICE)
        yield {
            "questionnaire": one.name, "item": item.name, "form": item.form, "condition": name,
            "n": len({row["participant"] for row in rows}), "counts": dict(counts),
            **({"passed": sum(row["passed"] is True for row in rows)} if item.correct is not None else {}),
            **(_cell([row["score"] for row in rows]) if item.is_scored else {}),
        }  # fmt: skip
