"""Counts of what a service has answered, for metrics. Counting costs some microseconds per report."""

from __future__ import annotations

import json
from bisect import bisect_left
from collections import Counter
from collections.abc import Mapping
from itertools import accumulate
from typing import Any


class Measures:
    """Counts of what a service has answered.

    Attributes
    ----------
    reports : Counter of (str, str)
        Answered reports by kind of event and outcome: "recorded" (a repetition, too), "refused" or "failed".
    followed : Counter of str
        Answers to suggestions, "yes" or "no".
    seconds : float
        Sum of the seconds from the arrival of each report until it was saved.
    """

    LIMITS = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
    """Upper limits of the histogram's buckets, in seconds: from a fast disk to a slow decision."""

    def __init__(self) -> None:
        self.reports, self.followed = Counter[tuple[str, str]](), Counter[str]()
        self.seconds = 0.0
        self._counts = [0] * (len(self.LIMITS) + 1)

    def add(self, kind: str, outcome: str, seconds: float) -> None:
        """Count an answered report."""
        self.reports[kind, outcome] += 1
        self.seconds += seconds
        self._counts[bisect_left(self.LIMITS, seconds)] += 1

    def acted(self, before: bytes | None, action: str | None, after: Mapping[str, Any]) -> None:
        """Count an action that may answer a suggestion, given the person's views before and after it."""
        if before is None:
            return
        view = json.loads(before)
        if view["suggestion"] is not None and after["seq"] > view["seq"]:  # otherwise it is a repetition
            self.followed["yes" if view["suggestion"] == (action or "").strip().lower() else "no"] += 1

    def buckets(self) -> list[tuple[str, float]]:
        """Return the cumulative histogram: limits and counts."""
        names = [*map(str, self.LIMITS), "+Inf"]
        return list(zip(names, accumulate(self._counts), strict=True))
