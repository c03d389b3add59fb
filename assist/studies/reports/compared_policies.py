"""Policies that were compared on the same people and the same random numbers: means, differences, and their tables."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from planner.system.errors import expected
from planner.system.results import Result, html_table

from ...learning.intervals import IntervalEstimate
from ...people.decision import Floats
from ...person.policy import not_worth_its_cost
from ...team.episodes import SHOWN, Episodes, Summary, with_error
from .. import statistics

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ...certify.certificate import Certificate

Cells: TypeAlias = tuple[list[str], list[list[str]]]
"""The head and the lines of a table that people see."""

MEASURES = {"actions": "actions per person", "interventions": "interventions", "discounted_return": "return"}
"""What is compared, a mean of `Summary`, with its name in tables."""

SAME = ("episode", "people", "beta", "theta", "sigma")
"""What the episodes of all policies share, besides the seed of their random numbers."""

DIFFERENCES = ("actions", "discounted_return")
"""The measures whose differences tables show; the frame has all."""


@dataclass(frozen=True)
class ComparedPolicy:
    """One policy under one condition.

    Attributes
    ----------
    varied : number or str
        The pool's key in `compare`; "" if there is one pool.
    humans : int
        Number of people in a team.
    summary : Summary
        Means over episodes with their standard errors. Where episodes were cut off, those of actions and of the return
        are too small in size.
    finished : float
        Share of people who reached their goal.
    means : dict of IntervalEstimate
        Mean of each of `MEASURES` with its interval.
    differences : dict of IntervalEstimate, or None
        This policy minus the baseline in the same episodes, for each of `MEASURES`; None for the baseline itself.
    certificate : Certificate or None
        Distance to the best policy for the team of the first `humans` people of the pool in the robot's model; None
        unless asked for.
    """

    varied: Any
    humans: int
    summary: Summary
    finished: float
    means: Mapping[str, IntervalEstimate]
    differences: Mapping[str, IntervalEstimate] | None
    certificate: Certificate | None = None

    @property
    def policy(self) -> str:
        """The policy's name."""
        return self.summary.policy

    @classmethod
    def of(
        cls, run: Episodes, baseline: Episodes | None, level: float, varied: Any = "",
        certificate: Certificate | None = None,
    ) -> ComparedPolicy:  # fmt: skip
        """Return the means of a policy's episodes, and the differences to a baseline's in the same episodes."""
        own = {name: _each(run, name) for name in MEASURES}
        differences = None
        if baseline is not None:
            differences = {name: statistics.mean(own[name] - _each(baseline, name), level) for name in MEASURES}
        return cls(
            varied=varied, humans=run.people.shape[1], summary=run.summary(), finished=float(run.finished.mean()),
            means={name: statistics.mean(values, level) for name, values in own.items()}, differences=differences,
            certificate=certificate,
        )  # fmt: skip


IN_MODEL = "value in the robot's model"
"""Head of the column with the value that a gap is about."""

OF_MODEL = f"{IN_MODEL}, and gap: with people drawn from the robot's prior, not with those of the other columns"
"""The note on that column."""


def _certified(certificate: Certificate | None) -> list[str]:
    """Return the value that a certificate compares with its bound, and the gap."""
    c = certificate
    return ["", ""] if c is None else [with_error(c.value, c.value_stderr), c.gap]


@dataclass(frozen=True, eq=False, repr=False)
class PolicyComparison(Result):
    """Policies that were compared on common random numbers; a sequence of `ComparedPolicy`.

    Attributes
    ----------
    rows : tuple of ComparedPolicy
        By pool, then team size, then policy in the order given.
    baseline : str
        The policy that differences refer to.
    varied : str
        What the keys of the pools are; "" if there is one pool.
    level : float
        Confidence level of intervals.
    """

    rows: tuple[ComparedPolicy, ...]
    baseline: str
    varied: str
    level: float

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[ComparedPolicy]:
        return iter(self.rows)

    def __getitem__(self, row: int) -> ComparedPolicy:
        return self.rows[row]

    def records(self) -> list[dict[str, Any]]:
        """Return a row for each condition and policy; `to_frame` has the same.

        Columns are the name that `compare` was given for the pools' keys, `humans`, `policy`, `episodes`,
        `finished`, `cut_off`; for each of `MEASURES` the mean by its name, and the name with `_error` (standard error),
        `_low` and `_high`; the same for the name with `_difference`, without an error; `costs` and `moves` with their
        `_error`; and of certificates `model_value`, the value in the robot's model, `upper` and `gap_percent`, about
        people who are drawn from the robot's prior, and not about those of the other columns.
        """
        return [self._columns(row) for row in self.rows]

    def _columns(self, row: ComparedPolicy) -> dict[str, Any]:
        """Return a row of the frame."""
        found: dict[str, Any] = {self.varied: row.varied} if self.varied else {}
        found |= {"humans": row.humans, "policy": row.policy, "episodes": row.summary.episodes}
        found |= {"finished": row.finished, "cut_off": row.summary.cut_off}
        for name in MEASURES:
            found |= {**_parts(name, row.means[name]), f"{name}_error": getattr(row.summary, name)[1]}
            found |= _parts(f"{name}_difference", None if row.differences is None else row.differences[name])
        for name in (name for name in SHOWN if name not in MEASURES):
            found |= dict(zip((name, f"{name}_error"), getattr(row.summary, name), strict=True))
        if row.certificate is not None:
            found |= {"model_value": row.certificate.value, "upper": row.certificate.upper}
            found |= {"gap_percent": row.certificate.gap_percent}
        return found

    def figure(self) -> Figure:
        """Return a figure of the means, and under one condition of the differences; with the extra `plots`.

        Raises
        ------
        MissingExtraError
            matplotlib is not installed.
        """
        from ...drawing.plots.policies import comparison_figure

        return comparison_figure(self)

    def means(self) -> Cells:
        """Return the head and the lines of the table of means, each with its standard error."""
        shown = dict(SHOWN)
        if all(row.summary.costs[0] == row.summary.actions[0] for row in self.rows):  # each action costs 1
            del shown["costs"]
        if any(row.summary.executions[0] for row in self.rows):  # otherwise all interventions are suggestions
            shown |= {"suggestions": "suggestions", "executions": "executions"}
        with_gap = any(row.certificate is not None for row in self.rows)
        head = [*self._condition_head(), *(name.replace("_", " ") for name in shown.values()), "cut off"]
        lines = [
            [
                *self._condition(row), *(with_error(*getattr(row.summary, name)) for name in shown),
                f"{row.summary.cut_off}", *(_certified(row.certificate) if with_gap else []),
            ]
            for row in self.rows
        ]  # fmt: skip
        return [*head, *([IN_MODEL, "gap at most"] if with_gap else [])], lines

    def differences(self) -> Cells:
        """Return the head and the lines of the table of differences to the baseline, with their intervals."""
        interval = f"({100 * self.level:g} % interval)"
        head = [*self._condition_head()[:-1], f"difference to {self.baseline}"]
        head += [f"{MEASURES[name]} {interval}" for name in DIFFERENCES]
        lines = [
            [*self._condition(row), *(shown_interval(row.differences[name]) for name in DIFFERENCES)]
            for row in self.rows if row.differences is not None
        ]  # fmt: skip
        return head, lines

    def notes(self) -> list[str]:
        """Return a sentence on certificates, and one for each policy of which no suggestion was worth its cost."""
        of_model = [OF_MODEL] if any(row.certificate is not None for row in self.rows) else []
        return of_model + [
            f"{', '.join(self._condition(row)[::-1])}: {not_worth_its_cost(row.summary.c_suggest_too_high)}"
            for row in self.rows if row.summary.c_suggest_too_high is not None
        ]  # fmt: skip

    def note(self) -> str:
        """Return the sentence below the table of means, which says what its numbers are."""
        count = {row.summary.episodes for row in self.rows}
        if count == {1}:
            return "of one episode"
        cut = "; those cut off count until the step limit" if any(row.summary.cut_off for row in self.rows) else ""
        return f"mean ± standard error over {_range(count)} episodes{cut}"

    def _condition_head(self) -> list[str]:
        several = len({row.humans for row in self.rows}) > 1
        return [*([self.varied] if self.varied else []), *(["humans"] if several else []), "policy"]

    def _condition(self, row: ComparedPolicy) -> list[str]:
        named = {self.varied: f"{row.varied}", "humans": f"{row.humans}", "policy": row.policy}
        return [named[name] for name in self._condition_head()]

    def __str__(self) -> str:
        means, differences = (_lines(*cells) for cells in (self.means(), self.differences()))
        below = [self.note(), *self.notes()]
        return "\n".join([*means, *below, *(["", *differences] if len(differences) > 1 else [])])

    __repr__ = __str__

    def _repr_html_(self) -> str:
        means, differences = (
            html_table([dict(enumerate(line)) for line in lines], head)
            for head, lines in (self.means(), self.differences())
        )
        several = any(row.differences is not None for row in self.rows)
        below = "".join(f"<p>{html.escape(line)}</p>" for line in [self.note(), *self.notes()])
        return f"{means}{below}{differences * several}"


def comparison_of(runs: Iterable[Episodes], *, baseline: str | None = None, level: float = 0.95) -> PolicyComparison:
    """Compare policies whose episodes were simulated already, with the same people and random numbers.

    Parameters
    ----------
    runs : iterable of Episodes
        One for each policy. Those of one policy under two settings need two names (`simulate(..., name=)`).
    baseline, level
        As in `compare`.

    Raises
    ------
    ValueError
        There is none, two have one name, the baseline is not among them, or they are not the same episodes of the same
        people with the same random numbers.
    """
    every: dict[str, Episodes] = {}
    for run in runs:
        if every.setdefault(run.policy, run) is not run:
            raise ValueError(f"runs: two are called {run.policy!r}; expected different names")
    if not every:
        raise ValueError("runs: expected at least one")
    base = baseline_of(every, baseline)
    for run in every.values():
        if run.seed != every[base].seed or not all(
            np.array_equal(getattr(run, name), getattr(every[base], name)) for name in SAME
        ):
            raise ValueError(f"{run.policy}: expected the same seed, episodes and people as those of {base}")
    rows = [ComparedPolicy.of(run, None if name == base else every[base], level) for name, run in every.items()]
    return PolicyComparison(tuple(rows), base, "", level)


def baseline_of(policies: Iterable[str], given: str | None) -> str:
    """Return the policy that differences refer to: the given one, or "none" if it is compared, else the first."""
    names = list(policies)
    base = given or ("none" if "none" in names else names[0])
    if base not in names:
        raise ValueError(f"baseline {base!r}; {expected(base, names)}")
    return base


def _each(run: Episodes, name: str) -> Floats:
    """Return a measure of each episode, shape (N,); the mean over people where it has one for each."""
    values = np.asarray(getattr(run, name), dtype=float)
    return values.mean(axis=1) if values.ndim == 2 else values


def _parts(name: str, estimate: IntervalEstimate | None) -> dict[str, float]:
    """Return the columns of an estimate; NaN where there is none."""
    found = estimate or IntervalEstimate(math.nan)
    return {name: found.value, f"{name}_low": found.low, f"{name}_high": found.high}


def _range(counts: set[int]) -> str:
    return " to ".join(f"{count:,}" for count in sorted({min(counts), max(counts)}))


def _lines(head: list[str], lines: list[list[str]]) -> list[str]:
    """Return a table as lines of text; columns are aligned right after that of the policy."""
    left = next(n for n, name in enumerate(head) if name == "policy" or name.startswith("difference to "))
    width = [max(len(line[n]) for line in [head, *lines]) for n in range(len(head))]
    return [
        "  ".join(
            cell.ljust(w) if n <= left else cell.rjust(w) for n, (cell, w) in enumerate(zip(line, width, strict=True))
        ).rstrip()
        for line in [head, *lines]
    ]


def shown_interval(estimate: IntervalEstimate) -> str:
    """Return an estimate with its interval, as tables show it."""
    if math.isnan(estimate.low):
        return f"{estimate.value:.2f}"
    return f"{estimate.value:.2f} ({estimate.low:.2f} to {estimate.high:.2f})"
