"""Steps of a log: whole numbers in any notation and, where steps may have gaps, times in whose order people acted."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from datetime import UTC, date, datetime, time, timedelta
from decimal import Decimal
from typing import Any

from .log_rows import Record

DAY = 24  # units of the larger part of a clock time, hours, in a day

CLOCK = re.compile(r"(?:(\d{1,3}):)?(\d{1,2}):(\d{2}(?:[.,]\d+)?)")
AMBIGUOUS = re.compile(r"[+-]?\d{1,3},\d{3}")
"""A comma that may separate decimals or thousands."""

DAY_OR_MONTH_FIRST = re.compile(r"(?<!\d)(\d{1,2})([./-])(\d{1,2})\2(\d{4}|\d\d)(?!\d)")
"""A date of which a reader does not know whether the day or the month comes first."""

DECIMAL = re.compile(r"[+-]?(\d{1,20})[.,](\d{1,20})")


def is_plain(value: object) -> bool:
    """Return whether a step is an integer, or its digits."""
    return type(value) is int or (isinstance(value, str) and re.fullmatch(r"[+-]?\d+", value.strip()) is not None)


def whole(value: object) -> int | None:
    """Return a step as an integer; None if it is none, or ambiguous, such as 1,000."""
    if isinstance(value, float):
        return int(value) if value.is_integer() else None
    if not isinstance(value, str):
        return None
    text = value.strip()
    if re.fullmatch(r"[+-]?\d{1,20}", text):
        return int(text)
    if found := re.fullmatch(r"([+-]?\d{1,20})[.,](0*)", text):
        return None if AMBIGUOUS.fullmatch(text) else int(found[1])
    if re.fullmatch(r"\d([.,]\d{1,14})?[eE]\+?\d\d?", text):  # as R writes 100000
        number = float(text.replace(",", "."))
        return int(number) if number.is_integer() else None
    return None


def expected_date(value: object) -> str:
    """Return what is said of a step that is a date in another form than is read; an empty text if it is none."""
    found = isinstance(value, str) and (DAY_OR_MONTH_FIRST.match(value.strip()) or re.match(r"\d{4}[-/.]\d", value))
    return ", or a date with a time such as 2026-03-01T09:00:00" if found else ""


def days_in_disorder(names: Sequence[str]) -> str | None:
    """Return the first of some names, in their order, with dates that may be out of order; None if they are not.

    Dates such as 01.03.2026 are ordered as numbers are: by their first, second and third part. That is no order of
    days where the day or the month, whichever comes first, does not fall when the year or the other one rises.
    """
    found = [one for one in map(DAY_OR_MONTH_FIRST.search, names) if one is not None]
    parts = [(int(one[1]), int(one[3]), int(one[4])) for one in found]
    for day, month in ((0, 1), (1, 0)):
        if all(part[month] <= 12 for part in parts):
            days = [(part[2], part[month], part[day]) for part in parts]
            if days != sorted(days):
                return found[0][0]
    return None


def moment(value: object) -> tuple[str, Any] | None:
    """Return the kind of a time and a value that orders times of this kind; None if it is no time.

    Times are numbers, such as seconds; dates with times, as ISO 8601 has them; or times of the clock.
    """
    if isinstance(value, bool):
        return None
    if isinstance(value, int | float):
        return ("number", Decimal(repr(value))) if value == value and abs(value) != float("inf") else None
    if isinstance(value, timedelta):
        return "number", Decimal(repr(value.total_seconds()))
    if isinstance(value, datetime | date):
        return _dated(value)
    if isinstance(value, time):
        value = value.isoformat()
    if not isinstance(value, str):
        return None
    text = value.strip()
    if DECIMAL.fullmatch(text):
        return None if AMBIGUOUS.fullmatch(text) else ("number", Decimal(text.replace(",", ".")))
    if found := CLOCK.fullmatch(text):
        hours, minutes, seconds = found[1], int(found[2]), Decimal(found[3].replace(",", "."))
        if hours is None:
            return "time of two parts", Decimal(minutes) + seconds / 60
        return "time of three parts", Decimal(hours) + Decimal(minutes) / 60 + seconds / 3600
    if re.match(r"\d{4}[-/]?\d\d[-/]?\d\d", text):
        try:
            return _dated(datetime.fromisoformat(text.replace("/", "-")))
        except ValueError:
            return None
    return None


def _dated(value: date) -> tuple[str, Any] | None:
    if not isinstance(value, datetime):
        value = datetime(value.year, value.month, value.day)
    if value != value:  # a missing time of pandas
        return None
    return ("date", value) if value.tzinfo is None else ("date with its zone", value.astimezone(UTC))


def number_times(rows: Sequence[Record]) -> tuple[str | None, list[Record]]:
    """Number the actions of each episode in the order of their times, if steps are times of one kind.

    Records whose step is no time of the usual kind stay as they are.

    Returns
    -------
    example : str or None
        One of the times; None if all steps are whole numbers.
    unclear : list of Record
        Records of episodes that seem to go on after midnight by clock times without dates.
    """
    times = [(row, moment(row[1].get("step"))) for row in rows]
    if all(found is None or type(record["step"]) is int for (_, record), found in times):
        return None, []
    kinds = Counter(found[0] for _, found in times if found is not None)
    usual = kinds.most_common(1)[0][0] if kinds else ""
    example, unclear = None, []
    episodes: dict[tuple[str, str], list[tuple[Record, Any]]] = {}
    for row, found in times:
        if found is not None and found[0] == usual:
            record = row[1]
            names = str(record.get("person")), str(record.get("episode"))
            episodes.setdefault(names, []).append((row, found[1]))
            example = example or (None if is_plain(record["step"]) else str(record["step"]))
    for episode in episodes.values():
        values = [value for _, value in episode]
        if usual.startswith("time") and values != sorted(values) and max(values) - min(values) >= DAY / 2:
            unclear += [row for row, _ in episode]
        place = {value: number for number, value in enumerate(sorted(set(values)))}
        for (_, record), value in episode:
            record["step"] = place[value]
    return example, unclear
