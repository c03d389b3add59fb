"""Policies compared on the same people and the same random numbers, under one condition or several.

`compare` simulates every policy in the same episodes: same teams, same people, same uniform numbers. The difference of
two policies in an episode is therefore due to the policies, and its mean varies far less than the two means do. A
condition is a team size, a pool (people at another task, or a robot with other costs), or both.

Intervals are those of Student's t distribution for the mean of independent episodes. They hold for the people of the
pool: other people would give other means. `run_study` draws several pools, and generalises to people.
"""

from __future__ import annotations

import html
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from inspect import signature
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from planner.system.errors import expected
from planner.system.progress import Progress, Wanted, shows_progress
from planner.system.results import Result, html_table

from ...learning import statistics
from ...learning.statistics import IntervalEstimate
from ...people.arguments import Seed, entropy, positive, whole
from ...people.decision import Floats
from ...person.policy import not_worth_its_cost
from ...person.robots import Robot
from ...person.settings import Setting
from ...team.episode import SHOWN
from ...team.episodes import Episodes, Summary
from ...team.policies import by_name
from ...team.pool import Pool, require_pool
from ...team.simulate import simulate
from ...team.state import TeamPolicy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ...certify.certificate import Certificate

SETTINGS = tuple(each.name for each in fields(Setting))
"""What may be varied by its name."""

FIRST_PORTION = 64
"""Episodes of each policy in the first portion; later ones are twice as large as the one before."""

Cells: TypeAlias = tuple[list[str], list[list[str]]]
"""The head and the lines of a table that people see."""

MEASURES = {"actions": "actions per person", "interventions": "interventions", "discounted_return": "return"}
"""What is compared, a mean of `Summary`, with its name in tables."""

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
        `_error`; and `upper` and `gap_percent` of certificates.
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
            found |= {"upper": row.certificate.upper, "gap_percent": row.certificate.gap_percent}
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
                *self._condition(row), *(_mean(*getattr(row.summary, name)) for name in shown),
                f"{row.summary.cut_off}", *([_gap(row.certificate)] if with_gap else []),
            ]
            for row in self.rows
        ]  # fmt: skip
        return [*head, *(["gap to the optimum"] if with_gap else [])], lines

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
        """Return a sentence for each policy and condition without suggestions, as none was worth its cost."""
        return [
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


@shows_progress
def compare(
    pool: Pool | Mapping[Any, Pool],
    policies: Iterable[str | TeamPolicy] | Mapping[str, str | TeamPolicy] | str | TeamPolicy, *,
    humans: int | Iterable[int] | Iterable[str] = 3, episodes: int = 500, seed: Seed = 0, baseline: str | None = None,
    varied: str = "pool", level: float = 0.95, certified: bool = False, gap: float = 1e-3,
    time_limit: float | None = None, jobs: int = 1, progress: Wanted = None, **options: Any,
) -> PolicyComparison:  # fmt: skip
    """Simulate policies with the same people and random numbers, and compare their means.

    Parameters
    ----------
    pool : Pool, or mapping to pools
        People and robot. With several pools, such as one for each population, a key is a condition.
    policies : one or more policies, or a mapping of names to policies
        Names of `assist.team.policies.POLICIES`, or callables; the latter have their own names unless given.
    humans : int, iterable of int, or of str
        Number of people in a team, one or several. Teams are drawn from the pool. Names are those of one team.
    episodes : int
        Number of episodes of each policy under each condition.
    seed : int or Generator
    baseline : str, optional
        The policy that differences refer to; by default "none" if it is compared, else the first.
    varied : str
        What the keys of several pools are, such as "population": the name of a column and of an axis.
    level : float
        Confidence level of intervals.
    certified : bool
        Also compute an upper bound on the value of all policies, and each policy's gap to it, which takes longer.
    gap : float
        Relative gap to which each person's problem is solved for the bound, as in `upper_bound`.
    time_limit : float, optional
        Seconds after which no further portion of episodes begins. All policies have the same episodes.
    jobs : int
        Number of threads, as in `simulate`.
    progress : callable or bool, optional
        Receives progress reports, as `planner.system.progress` describes.
    **options
        Fields of `Setting` in place of the pool's: a value, or for one of them a list of values, each of which is a
        condition with the same people, such as `c_suggest=[0.1, 1.0]`. And further arguments of `simulate`, such as
        `goals` or `world`.

    Returns
    -------
    PolicyComparison

    Raises
    ------
    TypeError
        `pool` is no pool.
    ValueError
        A parameter is out of its range, a policy is unknown, or two have one name.
    """
    assert callable(progress)
    known = [*SETTINGS, *signature(simulate).parameters]
    unknown = next((name for name in options if name not in known), None)
    if unknown is not None:
        raise TypeError(f"compare has no argument {unknown!r}; {expected(unknown, known)}")
    settings = {name: options.pop(name) for name in list(options) if name in SETTINGS}
    pools, varied = _pools(pool, varied, settings)
    named = by_name(policies)
    if not named:
        raise ValueError("policies: expected at least one")
    teams = _teams(humans)
    base = baseline or ("none" if "none" in named else next(iter(named)))
    if base not in named:
        raise ValueError(f"baseline {base!r}; {expected(base, list(named))}")
    if not 0 < level < 1:
        raise ValueError(f"level {level}: expected a number between 0 and 1")
    count, seed_number = whole("episodes", episodes, 1), entropy(seed)
    limit = None if time_limit is None else positive("time_limit", time_limit)
    conditions, own = len(pools) * len(teams), {name for name, policy in named.items() if not isinstance(policy, str)}
    share = None if limit is None else limit / conditions / (1 + certified)
    rows: list[ComparedPolicy] = []

    def add(key: Any, one: Pool) -> None:
        # What a policy computes about a person serves teams of any size.
        made = {
            name: policy if name in own else one.policy(policy, options.get("travel"))  # type: ignore[arg-type]
            for name, policy in named.items()
        }
        for team in teams:
            number = len(rows) // len(named) + 1
            tell = partial(_told, progress, f" ({number} of {conditions} conditions)" * (conditions > 1))
            run = partial(simulate, one, humans=team, seed=seed_number, progress=tell, **options)
            # A user's policy need not be ready for threads.
            each = {
                name: partial(run, policy=policy, name=name, jobs=1 if name in own else jobs)
                for name, policy in made.items()
            }
            runs = _runs(each, count, share)
            gaps: dict[str, Certificate] = {}
            if certified:
                from ...certify.comparison import certify  # which a comparison without bounds need not compile

                them = range(team) if isinstance(team, int) else team
                _, found = certify(
                    one, made, team=them, episodes=max(count, 2), seed=seed_number, gap=gap, time_limit=share,
                    progress=tell,
                )  # fmt: skip
                gaps = {certificate.policy: certificate for certificate in found}
            rows.extend(
                ComparedPolicy.of(run, None if name == base else runs[base], level, key, gaps.get(name))
                for name, run in runs.items()
            )

    for key, pool_of in pools.items():
        add(key, pool_of())  # whose memory is free before the next one is made
    return PolicyComparison(tuple(rows), base, varied, level)


def _teams(humans: int | Iterable[int] | Iterable[str]) -> list[int | list[str]]:
    """Return the number of people of each team, or the names of those of the only one."""
    if isinstance(humans, str):
        raise TypeError(f"humans {humans!r}: expected a number, numbers, or a list of names")
    given = [humans] if np.ndim(humans) == 0 else list(humans)  # type: ignore[arg-type]
    if any(isinstance(one, str) for one in given):
        return [given]  # type: ignore[list-item]
    return [whole("humans", one, 1) for one in given]


def _pools(
    pool: Pool | Mapping[Any, Pool], varied: str, settings: Mapping[str, Any]
) -> tuple[dict[Any, Callable[[], Pool]], str]:
    """Return what makes the pool of each condition, and the name of what varies; "" if nothing does.

    Pools are made one after another, since each may take much memory.
    """
    pools = dict(pool) if isinstance(pool, Mapping) else {"": pool}
    if not pools:
        raise ValueError("pool: expected at least one")
    for one in pools.values():
        require_pool(one)
    several = [name for name, value in settings.items() if _is_several(value)]
    if several and (len(several) > 1 or isinstance(pool, Mapping)):
        others = [*several[1:], *["pool"] * isinstance(pool, Mapping)]
        raise ValueError(f"{several[0]} and {others[0]}: expected several values of one of them")
    fixed = {name: value for name, value in settings.items() if name not in several}
    if not several:
        found = {key: _under(one, fixed) for key, one in pools.items()}
        return found, varied if isinstance(pool, Mapping) else ""
    (name,), (one,) = several, pools.values()
    values = list(settings[name])
    if not values:
        raise ValueError(f"{name}: expected at least one value")
    return {value: _under(one, {**fixed, name: value}) for value in values}, name


def _under(pool: Pool, fields: Mapping[str, Any]) -> Callable[[], Pool]:
    """Return what makes a pool's people with other fields of the setting, which are checked now."""
    return partial(pool.under, replace(pool.setting, **fields))


def _is_several(value: Any) -> bool:
    """Return whether a field of a setting was given several values. Robots are the value of one field together."""
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return isinstance(value, list | tuple | range) and not any(isinstance(one, Robot) for one in value)


def comparison_of(runs: Iterable[Episodes], *, baseline: str | None = None, level: float = 0.95) -> PolicyComparison:
    """Compare policies whose episodes were simulated already, with the same people and random numbers.

    Parameters
    ----------
    runs : iterable of Episodes
        One for each policy.
    baseline, level
        As in `compare`.

    Raises
    ------
    ValueError
        There is none, the baseline is not among them, or they are not the same episodes of the same people.
    """
    every = {run.policy: run for run in runs}
    if not every:
        raise ValueError("runs: expected at least one")
    base = baseline or ("none" if "none" in every else next(iter(every)))
    if base not in every:
        raise ValueError(f"baseline {base!r}; {expected(base, list(every))}")
    for run in every.values():
        same = np.array_equal(run.episode, every[base].episode) and np.array_equal(run.people, every[base].people)
        if not same:
            raise ValueError(f"{run.policy}: expected the same episodes and people as those of {base}")
    rows = [ComparedPolicy.of(run, None if name == base else every[base], level) for name, run in every.items()]
    return PolicyComparison(tuple(rows), base, "", level)


def _runs(runs: Mapping[str, Callable[..., Episodes]], count: int, seconds: float | None) -> dict[str, Episodes]:
    """Return the same episodes of all policies, in growing portions if there is a time limit."""
    begun, done, size = time.perf_counter(), 0, count if seconds is None else FIRST_PORTION
    parts: dict[str, list[Episodes]] = {name: [] for name in runs}
    while done < count and (not done or seconds is None or time.perf_counter() - begun < seconds):
        numbers = range(done, min(count, done + size))
        for name, run in runs.items():
            parts[name].append(run(episodes=numbers))
        done, size = numbers.stop, 2 * size
    return {name: Episodes.joined(own) if len(own) > 1 else own[0] for name, own in parts.items()}


def _told(progress: Progress, where: str, what: str, done: int, total: int | None) -> None:
    progress(what + where, done, total)


def _each(run: Episodes, name: str) -> Floats:
    """Return a measure of each episode, shape (N,); the mean over people where it has one for each."""
    values = np.asarray(getattr(run, name), dtype=float)
    return values.mean(axis=1) if values.ndim == 2 else values


def _parts(name: str, estimate: IntervalEstimate | None) -> dict[str, float]:
    """Return the columns of an estimate; NaN where there is none."""
    found = estimate or IntervalEstimate(math.nan)
    return {name: found.value, f"{name}_low": found.low, f"{name}_high": found.high}


def _mean(mean: float, error: float) -> str:
    """Return a mean with its standard error, as tables show it; a single episode has no standard error."""
    return f"{mean:.2f}" if math.isnan(error) else f"{mean:.2f} ± {error:.2f}"


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


def _gap(certificate: Certificate | None) -> str:
    """Return the distance to the best policy, as tables show it."""
    if certificate is None:
        return ""
    return f"at most {certificate.gap_percent:.1f} %" if certificate.gap_percent >= 0 else "0 %, within the error"
