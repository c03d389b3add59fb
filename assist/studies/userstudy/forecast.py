"""What a user study would show, and whom its policies would assist: by simulation, before the first participant.

Simulated people act as the model says, with parameters that are drawn from the study's population. Each of them is a
participant once, in every condition. They are drawn in rounds until the standardised differences are known well, or
`EFFORT` is spent, so that what is said depends little on the study's seed; intervals say how much it still does.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count, cycle, islice
from statistics import fmean
from typing import Annotated

import numpy as np
from pydantic import Field

from planner import CostToGo, Table
from planner.system.progress import Progress

from ...declare.declared import Count, Number, Text, Whole, declared
from ...declare.tables import fault
from ...people.decision import Floats
from ...people.user_code import UserCodeError
from ...person.settings import Setting
from ...team.episodes import Episodes
from ...team.policy_names import WEIGHING, hardly_assists
from ...team.pool import Pool
from ...team.simulate import simulate
from ...team.state import TeamPolicy
from ..repeated_measures import detectable_within
from ..statistics import detectable
from .plan import UserStudy
from .session import policy_of

PEOPLE = 200
"""Simulated people of a round."""

EFFORT = 80_000
"""Actions of simulated people after which no further round begins."""

PRECISE = 0.1
"""Half the width of the interval of a standardised difference, as a share of it, at which no further round begins."""

BRIEF = 40
"""People who tell whether a policy hardly assists: with two mates each, the share's standard error is 4 %."""

NORMAL = 1.96
"""Standard errors from an estimate to an end of its 95 % interval."""

MOST = 10_000
"""Number of participants beyond which no study is planned."""


@declared(kw_only=True)
class Sensitivity:
    """Which difference from the reference a study can show, before it begins."""

    condition: Annotated[Text, Field(description="The condition.")]
    against: Annotated[Text, Field(description="The reference.")]
    units: Annotated[
        Count | None, Field(description="Participants, or groups, in each of the two conditions; null without a limit.")
    ] = None
    hedges_g: Annotated[
        Number | None, Field(description="Least difference that four of five studies show, in standard deviations.")
    ] = None
    actions: Annotated[
        Number | None, Field(description="The same in actions per task, as simulated people vary, with its interval.")
    ] = None
    actions_low: Annotated[Number | None, Field(description="Low end of its 95 % interval.")] = None
    actions_high: Annotated[Number | None, Field(description="High end.")] = None
    expected: Annotated[
        Number | None, Field(description="Difference of simulated people in actions per task, with its interval.")
    ] = None
    expected_low: Annotated[Number | None, Field(description="Low end of its 95 % interval.")] = None
    expected_high: Annotated[Number | None, Field(description="High end.")] = None
    needed: Annotated[
        Count | None,
        Field(
            description="Participants who would show this difference, with an interval; null if that of the difference "
            f"includes 0, or for more than {MOST:,}."
        ),
    ] = None
    needed_low: Annotated[Count | None, Field(description="Low end of its 95 % interval.")] = None
    needed_high: Annotated[Count | None, Field(description="High end.")] = None
    simulated: Annotated[Whole, Field(ge=0, description="Units, participants or groups, that were simulated.")] = 0

    def __str__(self) -> str:
        said = []
        if self.hedges_g is not None:
            actions = "" if self.actions is None else f"{_spanned(self.actions, self.actions_low, self.actions_high)} "
            actions += "actions per task, " if actions else ""
            said += [f"with {self.units} in each, four of five studies show {actions}g = {self.hedges_g:.2f}, or more"]
        if self.expected is not None:
            difference = _spanned(self.expected, self.expected_low, self.expected_high)
            found = f"simulated people differ by {difference}"
            if _is_known(self.expected_low, self.expected_high):
                enough = Needed(self.needed, self.needed_low, self.needed_high)
                said += [f"{found}, which takes {enough} participants in all"]
            else:
                said += [f"{found}, so that {self.simulated:,} of them do not tell how many participants it takes"]
        return f"{self.condition} minus {self.against}: {'; '.join(said) or 'cannot be tested'}"


@dataclass(frozen=True)
class Needed:
    """A number of participants with an interval; None stands for more than `MOST`."""

    value: int | None
    low: int | None
    high: int | None

    def __str__(self) -> str:
        value, low, high = (f"more than {MOST:,}" if n is None else f"{n:,}" for n in (self.value, self.low, self.high))
        return value if low == high else f"{value} ({low} to {high})"


@dataclass(frozen=True)
class Forecast:
    """Simulated participants of a user study.

    Attributes
    ----------
    study : UserStudy
    actions : dict of arrays, shape (units,)
        By condition, the actions per task of each unit of analysis: a participant who finishes all tasks, or the
        members of a group who do; NaN without any. Rows are the same units, each time with random numbers of their
        own. Empty if no task can be simulated.
    assisted : dict of float
        By condition, the percentage of people to whom the robot makes a suggestion in a task.
    """

    study: UserStudy
    actions: Mapping[str, Floats]
    assisted: Mapping[str, float]

    @classmethod
    def of(cls, study: UserStudy, tasks: Mapping[str, CostToGo], *, briefly: bool = False) -> Forecast:
        """Return the last of the `rounds`."""
        return list(cls.rounds(study, tasks, briefly=briefly))[-1]

    @classmethod
    def rounds(
        cls, study: UserStudy, tasks: Mapping[str, CostToGo], *, briefly: bool = False, progress: Progress | None = None
    ) -> Iterator[Forecast]:  # fmt: skip
        """Simulate the conditions of a study, and yield what is known after each round.

        Parameters
        ----------
        study : UserStudy
        tasks : mapping of str to CostToGo
            Tasks by name. Those that are solved on demand are too large to be simulated here.
        briefly : bool
            Whether only what `seldom_assisted` needs is simulated, with fewer people; `actions` is then empty.
        progress : callable, optional
            Receives the number of actions of simulated people, and `EFFORT`.

        Raises
        ------
        InputFileError
            Code of the user's own is missing or fails; the message has the condition's place in the study's file.
        """
        policies = []
        for number, one in enumerate(study.conditions, start=1):
            with _own_code(study, number):
                policies.append(policy_of(study, one.policy))
        known = [table for name, _ in study.tasks if isinstance(table := tasks[name], Table)]
        if not known:
            yield cls(study, {}, {})
            return
        spent = 0
        names = [one.name for one in study.conditions if not briefly or one.policy in WEIGHING]
        actions: dict[str, list[Floats]] = {name: [] for name in names}
        assisted: dict[str, list[float]] = {name: [] for name in names}
        for number in count():
            people = _Round(study, known, number, BRIEF if briefly else PEOPLE)
            for name in names:
                place = [one.name for one in study.conditions].index(name)
                with _own_code(study, place + 1, policies[place]):
                    runs = people.simulated(place, policies[place])
                each = [np.where(run.finished, run.actions, np.nan)[:, : people.members] for run in runs]
                actions[name].append(_known_mean(np.mean(each, axis=0)))
                assisted[name].append(100 * fmean(float((run.helped > 0).mean()) for run in runs))
                spent += sum(int(run.actions.sum()) for run in runs)
                if progress is not None:
                    progress(f"simulating participants, at most {EFFORT:,} actions", min(spent, EFFORT), EFFORT)
            joined = {} if briefly else {name: np.concatenate(own) for name, own in actions.items()}
            found = cls(study, joined, {name: fmean(own) for name, own in assisted.items()})
            yield found
            if briefly or spent >= EFFORT or all(found._difference(name).is_precise for name in found._compared):
                return

    def seldom_assisted(self) -> Iterator[str]:
        """Yield a sentence on each condition whose policy weighs costs and hardly assists anybody."""
        for one in self.study.conditions:
            assisted = self.assisted.get(one.name, 100.0)
            if hardly_assists(one.policy, assisted):
                costs = f"c_suggest {one.setting.c_suggest:g}, c_move {one.setting.c_move:g}"
                said = f"{one.name} suggests something to {assisted:.0f} % of simulated people: hardly any suggestion"
                yield f"{said} is worth its cost ({costs}); set lower costs in the table `setting`"

    def remarks(self) -> Iterator[str]:
        """Yield what the study can show, and what is hardly meant: unequal groups, and policies that hardly assist."""
        study = self.study
        orders, size = len(study.orders), 1 if study.group is None else study.group.size
        if study.participants is not None and study.participants % (orders * size):
            what, equal = "orders of conditions" if study.is_within else "conditions", orders * size
            said = f"{orders} {what} get unequal numbers; expected a multiple of {equal} for equal ones"
            yield f"participants {study.participants}: {said}"
        yield from map(str, self.sensitivity())
        yield from self.seldom_assisted()

    def sensitivity(self) -> Iterator[Sensitivity]:
        """Yield which difference from the reference each other condition can show.

        The test is that of the report, without Holm's adjustment: Student's t at 5 %, within participants adjusted for
        the period.
        """
        study, each = self.study, self._each
        units = None if study.participants is None else study.participants // each
        for one in self._compared:
            found = self._difference(one)
            low, high = found.expected_interval
            known = _is_known(low, high)
            needed = self._needed(one, found.size, found.size_interval) if known else Needed(None, None, None)
            g = math.nan if units is None else self._detectable(one, units)
            actions_low, actions_high = (_known(g * end) for end in found.spread_interval)
            yield Sensitivity(
                condition=one, against=study.reference, units=units or None, hedges_g=_known(g),
                actions=_known(g * found.spread if found.spread else math.nan),
                actions_low=actions_low if found.spread else None, actions_high=actions_high if found.spread else None,
                expected=_known(found.expected), expected_low=_known(low), expected_high=_known(high),
                needed=needed.value, needed_low=needed.low, needed_high=needed.high, simulated=found.units,
            )  # fmt: skip

    def participants(self, difference: float) -> Iterator[tuple[str, Needed | None]]:
        """Yield how many participants show a difference from the reference in actions per task, for each condition.

        It is None where nothing is known: no task can be simulated, or hardly anybody finishes.

        Parameters
        ----------
        difference : float
        """
        for one in self._compared:
            found = self._difference(one)
            size, *ends = (_standardised(difference, spread) for spread in (found.spread, *found.spread_interval))
            yield one, self._needed(one, size, (ends[1], ends[0])) if found.units > 1 else None

    @property
    def _compared(self) -> list[str]:
        """The conditions that are compared with the reference."""
        return [one.name for one in self.study.conditions if one.name != self.study.reference]

    @property
    def _each(self) -> int:
        """The number of participants that a unit in each of two compared conditions takes."""
        size = 1 if self.study.group is None else self.study.group.size
        return size if self.study.is_within else size * len(self.study.conditions)

    def _needed(self, condition: str, size: float, interval: tuple[float, float]) -> Needed:
        """Return the participants who show a standardised difference, which is in an interval on one side of 0."""
        nearer, farther = sorted(map(abs, interval))
        return Needed(*(self._enough(condition, one) for one in (abs(size), farther, nearer)))

    def _enough(self, condition: str, size: float) -> int | None:
        """Return the number of participants who show a standardised difference of this size."""
        every = range(MOST // self._each + 1)
        found = bisect_left(every, True, lo=2, key=lambda units: self._detectable(condition, units) <= size)
        return found * self._each if found in every else None

    def _detectable(self, condition: str, units: int) -> float:
        """Return the standardised difference from the reference that some units show with 80 % power."""
        if not self.study.is_within:
            return detectable(2 * units - 2, math.sqrt(units / 2))
        orders = islice(cycle(self.study.orders.values()), units)
        return detectable_within([(order.index(condition), order.index(self.study.reference)) for order in orders])

    def _difference(self, condition: str) -> _Difference:
        """Return the difference of a condition from the reference."""
        if not self.actions:
            return _Difference.of(np.empty(0), np.empty(0), paired=True)
        own, other = self.actions[condition], self.actions[self.study.reference]
        counted = (np.logical_and if self.study.is_within else np.logical_or)(np.isfinite(own), np.isfinite(other))
        return _Difference.of(own[counted], other[counted], paired=self.study.is_within)


@dataclass(frozen=True)
class _Difference:
    """The difference of simulated units between two conditions, with 95 % intervals.

    Attributes
    ----------
    units : int
        Units that finish in both conditions; between participants, in one or both.
    expected : float
        The mean difference.
    spread : float
        The standard deviation that the test meets.
    errors : tuple of float
        Standard errors of `expected`, of the logarithm of `spread`, and of `size`.
    """

    units: int
    expected: float
    spread: float
    errors: tuple[float, float, float]

    @classmethod
    def of(cls, own: Floats, other: Floats, *, paired: bool) -> _Difference:
        """Return the difference of two conditions of the same units; `paired` if participants have both.

        Values are NaN where a unit does not finish. Standard errors are those of means of linear approximations, which
        take numbers of actions as skewed as they are.
        """
        n = len(own)
        if min(np.isfinite(own).sum(), np.isfinite(other).sum()) < 2:
            return cls(n, math.nan, math.nan, (math.nan,) * 3)
        (mine, of_mine), (theirs, of_theirs) = _mean_and_parts(own), _mean_and_parts(other)
        expected, off = mine - theirs, of_mine - of_theirs
        squares = [off**2] if paired else [(own - mine) ** 2, (other - theirs) ** 2]
        means, parts = zip(*map(_mean_and_parts, squares), strict=True)
        variance = fmean(means) * n / (n - 1)
        if variance == 0:
            return cls(n, expected, 0.0, (0.0, 0.0, 0.0))
        spread = math.sqrt(variance)
        of_spread = np.mean(parts, axis=0) / (2 * variance)
        each = (off, of_spread, off / spread - expected / spread * of_spread)
        found = [float(one.std(ddof=1)) / math.sqrt(n) for one in each]
        return cls(n, expected, spread, (found[0], found[1], found[2]))

    @property
    def size(self) -> float:
        """The standardised difference."""
        return _standardised(self.expected, self.spread)

    @property
    def expected_interval(self) -> tuple[float, float]:
        """The interval of the mean difference."""
        return self.expected - NORMAL * self.errors[0], self.expected + NORMAL * self.errors[0]

    @property
    def spread_interval(self) -> tuple[float, float]:
        """The interval of the standard deviation."""
        factor = math.exp(NORMAL * self.errors[1])
        return self.spread / factor, self.spread * factor

    @property
    def size_interval(self) -> tuple[float, float]:
        """The interval of the standardised difference; one end is 0 where it would include 0."""
        ends = self.size - NORMAL * self.errors[2], self.size + NORMAL * self.errors[2]
        return (max(ends[0], 0.0), ends[1]) if self.size > 0 else (ends[0], min(ends[1], 0.0))

    @property
    def is_precise(self) -> bool:
        """Whether the standardised difference is known as well as `PRECISE` says."""
        return NORMAL * self.errors[2] <= PRECISE * abs(self.size)


class _Round:
    """People who take part in all conditions of a study, each of them once as a participant.

    Parameters
    ----------
    study : UserStudy
    tasks : sequence of Table
    number : int
        Number of the round, from 0.
    people : int
    """

    def __init__(self, study: UserStudy, tasks: Sequence[Table], number: int, people: int) -> None:
        self._study, self._tasks, self._number = study, tasks, number
        self.members = 1 if study.group is None else study.group.size
        rng = np.random.default_rng([study.seed, 4, number])
        own = rng.permutation(people)[: people // self.members * self.members].reshape(-1, self.members)
        others = np.tile(np.arange(1, people), (len(own), 1))
        mates = (own[:, :1] + rng.permuted(others, axis=1)[:, : study.simulated]) % people
        self._teams, self._people = np.hstack([own, mates]), people
        self._pools: dict[tuple[Setting, int], Pool] = {}

    def simulated(self, place: int, policy: str | TeamPolicy) -> list[Episodes]:
        """Return the episodes of a condition, one run for each task; their random numbers are the condition's own."""
        study, setting = self._study, self._study.conditions[place].setting
        found = []
        for number in range(len(self._tasks)):
            seed = _drawn([study.seed, 5, self._number, place, number])
            pool = self._pool(setting, number)
            found.append(simulate(pool, policy, humans=self._teams, episodes=len(self._teams), seed=seed))
        return found

    def _pool(self, setting: Setting, task: int) -> Pool:
        """Return the people at a task; conditions with the same setting have the same ones."""
        if (setting, task) not in self._pools:
            self._pools[setting, task] = Pool.sample(
                self._tasks[task], self._people, seed=_drawn([self._study.seed, 3, self._number]), setting=setting,
                population=self._study.population,
            )  # fmt: skip
        return self._pools[setting, task]


def _drawn(words: list[int]) -> int:
    return int(np.random.default_rng(words).integers(2**63))


@contextmanager
def _own_code(study: UserStudy, number: int, policy: str | TeamPolicy | None = None) -> Iterator[None]:
    """Give faults of the user's own code their place in the study's file: the number of the condition, from 1.

    They are the policy's while it is loaded, and where it is at fault; others are of people or of their rules.
    """
    try:
        yield
    except UserCodeError as error:
        place = f"conditions[{number}]{'.policy' if policy is None or error.code is policy else ''}"
        raise fault(study.file, place, str(error)) from None


def _known_mean(values: Floats) -> Floats:
    """Return the mean of each row without its NaN; NaN for a row of nothing else."""
    known = np.isfinite(values)
    with np.errstate(invalid="ignore"):
        return np.where(known, values, 0.0).sum(axis=1) / known.sum(axis=1)


def _mean_and_parts(values: Floats) -> tuple[float, Floats]:
    """Return the mean of values without NaN, and by how much each moves it, times their number; 0 for NaN."""
    known = np.isfinite(values)
    mean = float(values[known].mean())
    return mean, np.where(known, values - mean, 0.0) * (len(values) / known.sum())


def _standardised(difference: float, spread: float) -> float:
    """Return a difference in standard deviations."""
    return difference / spread if spread else math.copysign(math.inf, difference)


def _known(number: float) -> float | None:
    return number if math.isfinite(number) else None


def _is_known(low: float | None, high: float | None) -> bool:
    """Whether an interval has ends on one side of 0."""
    return low is not None and high is not None and (low > 0 or high < 0)


def _spanned(value: float, low: float | None, high: float | None) -> str:
    return f"{value:.1f}" if low is None or high is None else f"{value:.1f} ({low:.1f} to {high:.1f})"
