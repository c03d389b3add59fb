"""Means of a user study's conditions, and differences from the reference, with intervals and tests.

Conditions are compared between participants, or within them if everybody had all.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from planner.system.files import finite

from ...learning.intervals import NONE, IntervalEstimate, holm, wilson
from ..repeated_measures import detectable_within, means_within, mixed_model, within_participants
from ..statistics import (
    Comparison,
    RankTest,
    between_groups,
    detectable,
    fisher_p,
    mann_whitney,
    mean,
    newcombe,
    sign_test,
    signed_rank,
)
from ..userstudy.forms import FORMS
from ..userstudy.outcomes import COMPLETION, COUNTED, Row
from .userstudy_data import Ends, Measure, StudyData, Values

NUMBERS = ("mean", "low", "high", "sd", "median", "min", "max")
"""The numbers of a measure in a condition."""


def compared(data: StudyData, measures: list[Measure]) -> list[dict[str, Any]]:
    """Return the means of measures and their differences from the reference.

    Holm's adjusted p-values are those of the comparisons of the confirmatory measures, which are one family.
    """
    rows = [_measure(data, one) for one in measures]
    family = [one for row in rows if row["confirmatory"] for one in row["differences"]]
    # Comparisons without data count in the size of the family, as planned.
    given = [math.nan if one["p"] is None else one["p"] for one in family]
    given += [math.nan] * (data.study.comparisons - len(family))
    for one, p in zip(family, holm(given), strict=False):
        one["p_holm"] = finite(p)
    return rows


def _measure(data: StudyData, measure: Measure) -> dict[str, Any]:
    study, shares = data.study, data.are_shares(measure)
    periods = data.periods(measure)
    modelled, differences = {}, []
    if study.is_within and measure.name != COMPLETION:
        modelled = mixed_model(measure.values, periods, data.orders, study.reference)
    span = measure.ends[1] - measure.ends[0]
    for name in measure.values:
        if name != study.reference and (found := _compared(data, measure, name, periods)):
            models = {"mixed_model": modelled[name].within(-span, span).record()} if name in modelled else {}
            differences.append({"condition": name, "against": study.reference, **found, **models})
    return {
        "measure": measure.name, "label": measure.label, "confirmatory": measure.name in study.confirmatory,
        "ends": [finite(end) for end in measure.ends], "shares": shares,
        "cells": cells(data, measure.values, measure.ends, shares=shares), "differences": differences,
    }  # fmt: skip


def _compared(data: StudyData, measure: Measure, condition: str, periods: dict[tuple[str, str], int]) -> dict[str, Any]:
    """Compare a condition with the reference, within participants if the design allows it; empty without data."""
    study, own, reference = data.study, measure.values[condition], measure.values[data.study.reference]
    both = [who for who in own if who in reference]
    a, b = list(own.values()), list(reference.values())
    if not (both if study.is_within else a and b):
        return {}
    pairs = [own[who] - reference[who] for who in both] if study.is_within else []
    if study.is_within:
        when = [(periods[who, condition], periods[who, study.reference]) for who in both]
        found = within_participants(pairs, when)
    else:
        found = between_groups(a, b)
    difference, effect, p = found.difference, found.hedges_g, found.p
    if data.are_shares(measure):
        found, effect = Comparison(difference), NONE
        if study.is_within:
            p = sign_test(sum(pair > 0 for pair in pairs), sum(pair < 0 for pair in pairs)).p
        else:
            counts = sum(value > 0 for value in a), len(a), sum(value > 0 for value in b), len(b)
            difference, p = _percent(newcombe(*counts)), fisher_p(*counts)
    span = measure.ends[1] - measure.ends[0]
    return {
        **difference.within(-span, span).record(), "hedges_g": finite(effect.value),
        "hedges_g_low": finite(effect.low), "hedges_g_high": finite(effect.high), "t": finite(found.t),
        "df": finite(found.freedom), "p": finite(p), "detectable": finite(found.detectable),
    }  # fmt: skip


def _percent(share: IntervalEstimate) -> IntervalEstimate:
    return IntervalEstimate(100 * share.value, 100 * share.low, 100 * share.high)


def cells(data: StudyData, values: Values, ends: Ends, *, shares: bool = False) -> list[Row]:
    """Return the numbers of each condition, from the values of units of analysis by condition.

    Intervals are cut at the ends of the measure's range; those of `shares`, which are 0 or 100, are Wilson's.
    """
    within = means_within(values) if data.study.is_within and len(values) > 1 else {}
    found: list[Row] = []
    for name, own in values.items():
        cell: Row = {"condition": name, "n": len(own), **dict.fromkeys(NUMBERS)}
        if own:
            each = list(own.values())
            sd = float(np.std(each, ddof=1)) if len(each) > 1 else math.nan
            if shares:
                estimate = _percent(wilson(sum(value > 0 for value in each), len(each)))
            else:
                estimate = (within[name] if within else mean(each)).within(*ends)
            cell |= estimate.record()
            cell |= {"sd": finite(sd), "median": float(np.median(each)), "min": min(each), "max": max(each)}
        found.append(cell)
    return found


def smallest_shown(data: StudyData, measure: Measure) -> float | None:
    """Return the standardised difference that comparisons of a measure show with 80 % power; None without a test."""
    reference = data.study.reference
    if not data.study.is_within:
        fewest = min(min(len(own), len(measure.values[reference])) for own in measure.values.values())
        return finite(detectable(2 * fewest - 2, math.sqrt(fewest / 2)))
    periods = data.periods(measure)
    each = [
        detectable_within(
            [(periods[who, name], periods[who, reference]) for who in own if who in measure.values[reference]]
        )
        for name, own in measure.values.items() if name != reference
    ]  # fmt: skip
    return finite(max(each, default=math.nan) if not any(map(math.isnan, each)) else math.nan)


# Comparisons by ranks.


def worst_ranks(data: StudyData) -> Iterator[Row]:
    """Yield comparisons of outcomes in which participants who did not finish have the worst rank."""
    for outcome in (one for one in COUNTED if one.more_is_worse):
        found = []
        for (participant, condition), rows in data.attempts.items():
            value = outcome.of(rows) if data.has_finished(rows) else None
            found.append((participant, condition, math.inf if value is None else value))
        yield from _ranked_rows(data, {"measure": outcome.name}, data.by_condition(found))


def likert(data: StudyData) -> Iterator[Row]:
    """Yield comparisons of the single items of Likert scales by ranks, as their answers are ordinal."""
    for one in data.study.questionnaires:
        if FORMS[one.form].is_ordinal and data.study.is_by_condition(one):
            rows = data.scored(one)
            for item in one.scale:
                given = ((who, condition, scores.get(item.name)) for who, condition, scores in rows)
                what = {"questionnaire": one.name, "item": item.name}
                yield from _ranked_rows(data, what, data.by_condition(given))


def _ranked_rows(data: StudyData, what: Row, values: Values) -> Iterator[Row]:
    """Yield the comparison of each condition with the reference by ranks, as far as there are data."""
    reference = values[data.study.reference]
    for condition, own in values.items():
        if condition != data.study.reference and (found := _ranked(data, own, reference)):
            n = len(own.keys() & reference.keys()) if data.study.is_within else len(own)  # those who are compared
            yield what | {"condition": condition, "n": n, "p": finite(found.p), "effect": finite(found.effect)}


def _ranked(data: StudyData, own: dict[str, float], reference: dict[str, float]) -> RankTest | None:
    """Compare a condition with the reference by ranks; None without data."""
    if not data.study.is_within:
        return mann_whitney(list(own.values()), list(reference.values())) if own and reference else None
    values = [(own[who], reference[who]) for who in own if who in reference]
    if any(math.isinf(value) for pair in values for value in pair):
        # An infinite difference has no size, but a sign.
        return sign_test(sum(x > y for x, y in values), sum(x < y for x, y in values))
    return signed_rank([x - y for x, y in values]) if values else None
