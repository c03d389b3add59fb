"""Counts of what a service has answered, for metrics. Counting costs some microseconds per report."""

from __future__ import annotations

from collections.abc import Iterable

from prometheus_client import CollectorRegistry, Counter, Histogram

LIMITS = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
"""Upper limits of the histogram's buckets, in seconds: from a fast disk to a slow decision."""


class Measures:
    """Counts of what a service has answered.

    Attributes
    ----------
    registry : CollectorRegistry
        With the counts, and whatever else is registered.
    """

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self._reports = Counter(
            "kitassist_reports", "Answered reports.", ["kind", "outcome"], registry=self.registry
        )  # fmt: skip
        self._followed = Counter(
            "kitassist_suggestions_answered", "Answers to suggestions.", ["followed"], registry=self.registry
        )
        self._seconds = Histogram(
            "kitassist_report_seconds", "From the arrival of a report until it is saved.", buckets=LIMITS,
            registry=self.registry,
        )  # fmt: skip
        for answer in ("no", "yes"):
            self._followed.labels(answer)

    def add(self, kind: str, outcome: str, seconds: float) -> None:
        """Count an answered report: "recorded" (a repetition, too), "refused" or "failed"."""
        self._reports.labels(kind, outcome).inc()
        self._seconds.observe(seconds)

    def answered(self, followed: Iterable[bool]) -> None:
        """Count answers to suggestions, each by whether it was followed."""
        for one in followed:
            self._followed.labels("yes" if one else "no").inc()
