"""Numeric results of a user study: conditions, differences from the reference, questionnaires and dropouts.

The unit of analysis is the participant. In a study with groups it is the group, whose value is the mean over its
members, since members who share a robot are not independent.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from statistics import fmean
from typing import Any

import numpy as np

from planner.system.files import finite

from ...learning.repeated_measures import detectable_within, means_within, mixed_model, within_participants
from ...learning.statistics import (
    FEW,
    NONE,
    IntervalEstimate,
    RankTest,
    between_groups,
    cronbach_alpha,
    detectable,
    fisher_p,
    holm,
    mann_whitney,
    mean,
    newcombe,
    sign_test,
    signed_rank,
    wilson,
)
from ...team.policy_names import WEIGHING
from ..userstudy.outcomes import COMPLETION, COUNTED, Outcome, Row
from ..userstudy.plan import UserStudy
from ..userstudy.questionnaires import BEFORE, CHOICE, CHOICES, GRID, LIKERT, TEXT, TLX, Item, Questionnaire
from ..userstudy.tables import Tables

ALL = "all participants"
"""Stands for the condition where answers do not belong to one."""


Ends = tuple[float, float]
PERCENT = (0.0, 100.0)
NUMBERS = ("mean", "low", "high", "sd", "median", "min", "max")
"""The numbers of a measure in a condition."""


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
    values: dict[str, dict[str, float]]
    ends: Ends


def measures(study: UserStudy, tables: Tables) -> Iterator[Measure]:
    """Yield the measures: completion, those of participants who finished all tasks, and those of questionnaires."""
    phrase = study.catalogue.phrase
    attempts = [(*who, rows, _has_finished(study, rows)) for who, rows in _attempts(tables).items()]
    found: dict[str, list[tuple[str, str, float | None]]] = {
        one.name: [(who, where, one.of(rows) if done else None) for who, where, rows, done in attempts]
        for one in COUNTED
    }
    found[COMPLETION] = [(who, where, 100.0 * done) for who, where, _, done in attempts]
    for name, values in found.items():
        percent = name == COMPLETION or any(one.name == name and one.share_of is not None for one in COUNTED)
        ends = PERCENT if percent else (0.0, math.inf)
        yield Measure(name, phrase(f"report.measures.{name}"), _by_condition(_names(study), values, tables), ends)
    for one in study.questionnaires:
        if one.scale and study.is_by_condition(one):
            means = [(who, condition, one.mean(scores)) for who, condition, scores in scored(one, tables)]
            low, high, _ = one.scale[0].ends
            kind = "raw_mean" if one.form == TLX else "mean"
            label = phrase(f"report.{kind}", name=one.name, low=f"{low:g}", high=f"{high:g}")
            yield Measure(one.name, label, _by_condition(_names(study), means, tables), (low, high))


def _names(study: UserStudy) -> list[str]:
    return [one.name for one in study.conditions]


def _by_condition(
    where: list[str], values: Iterable[tuple[str, str, float | None]], tables: Tables
) -> dict[str, dict[str, float]]:
    """Return values by condition and unit of analysis: those of participants, or means over the members of groups.

    Parameters
    ----------
    where : list of str
        The conditions; `ALL` alone for what belongs to none.
    values : iterable of (participant, condition, value)
        None stands for a missing value.
    tables : Tables
    """
    groups = {row["participant"]: row["group"] or row["participant"] for row in tables.participants}
    units: dict[str, dict[str, list[float]]] = {name: {} for name in where}
    for participant, condition, value in values:
        if value is not None:
            unit = groups.get(participant, participant)
            units[condition if condition in units else ALL].setdefault(unit, []).append(value)
    return {
        name: {unit: fmean(each) if len(each) > 1 else each[0] for unit, each in own.items()}
        for name, own in units.items()
    }


def _attempts(tables: Tables) -> dict[tuple[str, str], list[Row]]:
    """Return the begun tasks of each participant in each condition."""
    found: dict[tuple[str, str], list[Row]] = {}
    for row in tables.tasks:
        found.setdefault((row["participant"], row["condition"]), []).append(row)
    return found


def _has_finished(study: UserStudy, rows: list[Row]) -> bool:
    """Whether a participant finished all tasks in a condition."""
    return len(rows) == len(study.tasks) and all(row["finished"] for row in rows)


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
    names = _names(study)
    found = list(measures(study, tables))
    smallest = [min(len(found[0].values[name]), len(found[0].values[study.reference])) for name in names]
    return {
        "title": study.title,
        "simulated": any(row["simulated"] for row in tables.participants),
        "design": study.design,
        "reference": study.reference,
        "setup": _setup(study, tables),
        "without_suggestions": _without_suggestions(study, tables),
        "participants": {"planned": study.participants, **_counts(tables)},
        "conditions": _conditions(study, tables), **_groups(study, tables),
        "flow": _flow(study, tables),
        "measures": _adjusted(study, [_measure(study, one, tables) for one in found]),
        "worst_rank": [row for one in COUNTED if one.more_is_worse for row in _worst_rank(study, one, tables)],
        "likert": [row for one in study.questionnaires for row in _likert(study, one, tables)],
        "questionnaires": [_questionnaire(study, one, tables) for one in study.questionnaires if one.scale],
        "answers": [
            answer for one in study.questionnaires for item in one.items for answer in _asked(study, one, item, tables)
        ],
        "detectable": finite(_detectable_within(study, found[0], tables) if study.is_within
                             else detectable(2 * min(smallest) - 2, math.sqrt(min(smallest) / 2))),
        "few": [
            name for name, count in zip(names, smallest, strict=True)
            if len(found[0].values[name]) < FEW
        ],
    }  # fmt: skip


def _setup(study: UserStudy, tables: Tables) -> dict[str, Any]:
    """Return the tasks with the costs of optimal plans as far as somebody began them, simulated people, and dates."""
    costs = {row["task"]: row["optimal_cost"] for row in tables.tasks}
    times = [row["arrived"] for row in tables.participants if row["arrived"] is not None]
    times += [row["utc"] for row in tables.events if row["utc"] is not None]
    return {
        "tasks": [{"task": name, "optimal_cost": costs.get(name)} for name, _ in study.tasks],
        "simulated_people": study.simulated, "first": min(times, default=None), "last": max(times, default=None),
    }  # fmt: skip


def _without_suggestions(study: UserStudy, tables: Tables) -> list[Row]:
    """Return the conditions in which a policy that weighs costs made no suggestion to anybody who acted."""
    found = []
    for one in study.conditions:
        own = [row for row in tables.tasks if row["condition"] == one.name and row["actions"]]
        if one.policy in WEIGHING and own and not any(row["suggestions"] for row in own):
            costs = {"c_suggest": one.setting.c_suggest, "c_move": one.setting.c_move}
            found.append({"condition": one.name, "policy": one.policy, **costs})
    return found


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


def _groups(study: UserStudy, tables: Tables) -> dict[str, Any]:
    """Return how many groups began, with all members or fewer, and how many participants found none."""
    if study.group is None:
        return {}
    sizes = Counter(row["group"] for row in tables.participants if row["group"] is not None)
    complete = sum(size == study.group.size for size in sizes.values())
    unmatched = sum(row["status"] == "unmatched" for row in tables.participants)
    size = study.group.size
    return {"groups": {"size": size, "began": len(sizes), "smaller": len(sizes) - complete, "unmatched": unmatched}}


def _conditions(study: UserStudy, tables: Tables) -> list[Row]:
    """Return the numbers of participants in each condition, or in each order of conditions."""
    found, policies = [], {one.name: one.policy for one in study.conditions}
    for name, order in study.orders.items():
        own = [row["status"] for row in tables.participants if row["condition"] == name]
        done, here, withdrew = own.count("done"), own.count("here"), own.count("withdrew")
        counts = {"begun": len(own), "done": done, "under_way": here, "withdrew": withdrew}
        counts["left"] = len(own) - done - here - withdrew
        found.append({"condition": name, "policy": " > ".join(policies[one] for one in order), **counts})
    return found


def _flow(study: UserStudy, tables: Tables) -> list[Row]:
    """Return the numbers of participants who reached each stage, who left there, and who withdrew there.

    Who withdrew, perhaps after the end, counts at no stage as somebody who reached it.
    """
    stages = [stage.name for stage in study.stages]
    at = [(stages.index(row["stage"]), row["status"]) for row in tables.participants]
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


def _measure(study: UserStudy, measure: Measure, tables: Tables) -> dict[str, Any]:
    orders = _orders(tables)
    periods = _periods(study, measure, orders)
    modelled, differences = {}, []
    if study.is_within and measure.name != "completion":
        modelled = mixed_model(measure.values, periods, orders, study.reference)
    for name in measure.values:
        if name != study.reference and (compared := _compared(study, measure, name, periods)):
            span = measure.ends[1] - measure.ends[0]
            models = {"mixed_model": modelled[name].within(-span, span).record()} if name in modelled else {}
            differences.append({"condition": name, "against": study.reference, **compared, **models})
    return {
        "measure": measure.name, "label": measure.label, "confirmatory": measure.name in study.confirmatory,
        "ends": [finite(end) for end in measure.ends], "shares": _are_shares(study, measure),
        "cells": _cells(study, measure.values, measure.ends, shares=_are_shares(study, measure)),
        "differences": differences,
    }  # fmt: skip


def _are_shares(study: UserStudy, measure: Measure) -> bool:
    """Whether a measure is yes or no for each unit of analysis."""
    return measure.name == COMPLETION and study.group is None


def _orders(tables: Tables) -> dict[str, str]:
    """Return the condition or the order of conditions of each unit of analysis."""
    return {row["group"] or row["participant"]: row["condition"] for row in tables.participants}


def _periods(study: UserStudy, measure: Measure, orders: dict[str, str]) -> dict[tuple[str, str], int]:
    """Return in which period each unit with a value had a condition; empty between participants."""
    return {
        (who, name): study.orders[orders[who]].index(name) + 1
        for name, own in measure.values.items() for who in own
    } if study.is_within else {}  # fmt: skip


def _detectable_within(study: UserStudy, measure: Measure, tables: Tables) -> float:
    """Return the largest of the differences that the comparisons of a measure detect; NaN if one is undetermined."""
    periods, reference = _periods(study, measure, _orders(tables)), measure.values[study.reference]
    each = [
        detectable_within([(periods[who, name], periods[who, study.reference]) for who in own if who in reference])
        for name, own in measure.values.items() if name != study.reference
    ]  # fmt: skip
    return max(each, default=math.nan) if not any(map(math.isnan, each)) else math.nan


def _adjusted(study: UserStudy, rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Add Holm's adjusted p-values to the comparisons of the confirmatory measures, which are one family."""
    family = [one for row in rows if row["confirmatory"] for one in row["differences"]]
    # Comparisons without data count in the size of the family, as planned.
    given = [math.nan if one["p"] is None else one["p"] for one in family]
    given += [math.nan] * (study.comparisons - len(family))
    for one, p in zip(family, holm(given), strict=False):
        one["p_holm"] = finite(p)
    return rows


def _compared(
    study: UserStudy, measure: Measure, condition: str, periods: dict[tuple[str, str], int]
) -> dict[str, Any]:
    """Compare a condition with the reference, within participants if the design allows it; empty without data."""
    own, reference = measure.values[condition], measure.values[study.reference]
    both = [participant for participant in own if participant in reference]
    a, b = list(own.values()), list(reference.values())
    if not (both if study.is_within else a and b):
        return {}
    if study.is_within:
        pairs = [own[participant] - reference[participant] for participant in both]
        when = [(periods[participant, condition], periods[participant, study.reference]) for participant in both]
        compared = within_participants(pairs, when)
    else:
        compared = between_groups(a, b)
    found, effect, p, t, freedom = (
        compared.difference, compared.hedges_g, compared.p, compared.t, compared.freedom,
    )  # fmt: skip
    if _are_shares(study, measure):
        effect, t, freedom = NONE, math.nan, math.nan
        if study.is_within:
            p = sign_test(sum(pair > 0 for pair in pairs), sum(pair < 0 for pair in pairs)).p
        else:
            counts = sum(value > 0 for value in a), len(a), sum(value > 0 for value in b), len(b)
            share, p = newcombe(*counts), fisher_p(*counts)
            found = IntervalEstimate(100 * share.value, 100 * share.low, 100 * share.high)
    span = measure.ends[1] - measure.ends[0]
    return {
        **found.within(-span, span).record(), "hedges_g": finite(effect.value), "hedges_g_low": finite(effect.low),
        "hedges_g_high": finite(effect.high), "t": finite(t), "df": finite(freedom), "p": finite(p),
    }  # fmt: skip


def _ranked(study: UserStudy, own: dict[str, float], reference: dict[str, float]) -> RankTest | None:
    """Compare a condition with the reference by ranks; None without data."""
    if not study.is_within:
        return mann_whitney(list(own.values()), list(reference.values())) if own and reference else None
    both = [participant for participant in own if participant in reference]
    values = [(own[participant], reference[participant]) for participant in both]
    if any(math.isinf(value) for pair in values for value in pair):
        # An infinite difference has no size, but a sign.
        return sign_test(sum(x > y for x, y in values), sum(x < y for x, y in values))
    return signed_rank([x - y for x, y in values]) if values else None


def _compared_by_ranks(study: UserStudy, own: dict[str, float], reference: dict[str, float]) -> int:
    """Return how many units of a condition `_ranked` compares: within participants, those with both values."""
    return len(own.keys() & reference.keys()) if study.is_within else len(own)


def _worst_rank(study: UserStudy, outcome: Outcome, tables: Tables) -> Iterator[Row]:
    """Yield comparisons of a measure in which participants who did not finish have the worst rank."""
    found = []
    for (participant, condition), rows in _attempts(tables).items():
        value = outcome.of(rows) if _has_finished(study, rows) else None
        found.append((participant, condition, math.inf if value is None else value))
    yield from _ranked_rows(study, {"measure": outcome.name}, _by_condition(_names(study), found, tables))


def _ranked_rows(study: UserStudy, what: Row, values: dict[str, dict[str, float]]) -> Iterator[Row]:
    """Yield the comparison of each condition with the reference by ranks, as far as there are data."""
    for condition, own in values.items():
        if condition != study.reference and (found := _ranked(study, own, values[study.reference])):
            yield what | {
                "condition": condition, "n": _compared_by_ranks(study, own, values[study.reference]),
                "p": finite(found.p), "effect": finite(found.effect),
            }  # fmt: skip


def _likert(study: UserStudy, one: Questionnaire, tables: Tables) -> Iterator[Row]:
    """Yield comparisons of the single items of a Likert scale by ranks, as their answers are ordinal."""
    if one.form not in (LIKERT, GRID) or not study.is_by_condition(one):
        return
    rows = list(scored(one, tables))
    for item in one.scale:
        given = ((who, condition, scores.get(item.name)) for who, condition, scores in rows)
        what = {"questionnaire": one.name, "item": item.name}
        yield from _ranked_rows(study, what, _by_condition(_names(study), given, tables))


def _cells(study: UserStudy, values: dict[str, dict[str, float]], ends: Ends, *, shares: bool = False) -> list[Row]:
    """Return the numbers of each condition, from the values of units of analysis by condition.

    Intervals are cut at the ends of the measure's range; those of `shares`, which are 0 or 100, are Wilson's.
    """
    compared = means_within(values) if study.is_within and len(values) > 1 else {}
    found: list[Row] = []
    for name, own in values.items():
        cell: Row = {"condition": name, "n": len(own), **dict.fromkeys(NUMBERS)}
        if own:
            each = list(own.values())
            sd = float(np.std(each, ddof=1)) if len(each) > 1 else math.nan
            if shares:
                share = wilson(sum(value > 0 for value in each), len(each))
                estimate = IntervalEstimate(100 * share.value, 100 * share.low, 100 * share.high)
            else:
                estimate = (compared[name] if compared else mean(each)).within(*ends)
            cell |= estimate.record()
            cell |= {"sd": finite(sd), "median": float(np.median(each)), "min": min(each), "max": max(each)}
        found.append(cell)
    return found


def _questionnaire(study: UserStudy, one: Questionnaire, tables: Tables) -> dict[str, Any]:
    rows = list(scored(one, tables))
    where = _names(study) if study.is_by_condition(one) else [ALL]
    items = []
    for item in one.scale:
        given = ((who, condition, scores.get(item.name)) for who, condition, scores in rows)
        items += [
            {"item": item.name, **cell} for cell in _cells(study, _by_condition(where, given, tables), item.ends[:2])
        ]
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
    where = _names(study) if study.is_by_condition(one) else [ALL]
    answered = [row for row in own if row["answer"] is not None]
    yield from _answers(study, one, item, tables, where, answered)
    if one.when == BEFORE and not study.is_within and len(study.conditions) > 1:
        # What was asked before describes the sample of each condition, too.
        assigned = {row["participant"]: row["condition"] for row in tables.participants}
        begun = [row | {"condition": assigned[row["participant"]]} for row in answered]
        begun = [row for row in begun if row["condition"] is not None]
        yield from _answers(study, one, item, tables, _names(study), begun)


def _answers(
    study: UserStudy, one: Questionnaire, item: Item, tables: Tables, where: list[str], answered: list[Row]
) -> Iterator[Row]:
    """Yield the numbers of answers to a question in each condition of `where`."""
    rows = {name: [row for row in answered if name in (ALL, row["condition"])] for name in where}
    scores = ((row["participant"], row["condition"], row["score"]) for row in answered)
    cells = (
        _cells(study, _by_condition(where, scores, tables), item.ends[:2]) if item.is_scored else [{} for _ in where]
    )
    for (name, given), cell in zip(rows.items(), cells, strict=True):
        counts = Counter(dict.fromkeys(item.options, 0))
        counts.update(row["option"] for row in given if item.form == CHOICES and row["answer"] in (True, "true"))
        counts.update(row["answer"] for row in given if item.form == CHOICE)
        yield {
            "questionnaire": one.name, "item": item.name, "form": item.form, "condition": name,
            "n": len({row["participant"] for row in given}), "counts": dict(counts),
            **({"passed": sum(row["passed"] is True for row in given)} if item.correct is not None else {}), **cell,
        }  # fmt: skip
