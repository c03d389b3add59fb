"""What a user study would show, and whom its policies would assist: by simulation, before the first participant."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from itertools import cycle, islice
from statistics import fmean
from typing import Annotated

import numpy as np
from pydantic import Field

from planner import CostToGo, Table

from ...declare.declared import Count, Number, Text, declared
from ...declare.tables import fault, located
from ...people.decision import Floats
from ...people.user_code import UserCodeError
from ...person.settings import Setting
from ...team.episodes import Episodes
from ...team.policies import UserPolicy
from ...team.policy_names import WEIGHING, hardly_assists
from ...team.pool import Pool
from ...team.simulate import simulate
from ...team.state import TeamPolicy
from ..repeated_measures import detectable_within
from ..statistics import detectable
from .plan import UserStudy
from .session import policy_of

PEOPLE, EPISODES = 24, 200
"""Numbers of simulated people, and of episodes of each task with teams of them."""

BRIEF = 40
"""Episodes that tell whether a policy hardly assists: the standard error of the share is 4 % of 120 people."""

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
    actions: Annotated[Number | None, Field(description="The same in actions per task, as simulated people vary.")] = (
        None
    )
    expected: Annotated[Number | None, Field(description="Difference of simulated people in actions per task.")] = None
    needed: Annotated[Count | None, Field(description="Participants who would show this difference.")] = None

    def __str__(self) -> str:
        said = []
        if self.hedges_g is not None:
            actions = "" if self.actions is None else f"{self.actions:.1f} actions per task, "
            said += [f"with {self.units} in each, four of five studies show {actions}g = {self.hedges_g:.2f}, or more"]
        if self.expected is not None:
            enough = f"more than {MOST:,}" if self.needed is None else f"{self.needed:,}"
            said += [f"simulated people differ by {self.expected:.1f}, which takes {enough} participants in all"]
        return f"{self.condition} minus {self.against}: {'; '.join(said) or 'cannot be tested'}"


@dataclass(frozen=True)
class Forecast:
    """Simulated participants of a user study.

    Attributes
    ----------
    study : UserStudy
    actions : dict of arrays, shape (EPISODES,)
        By condition, the actions per task of each unit of analysis, a participant or a group; NaN of those who do not
        finish. Rows are the same units, each time with random numbers of their own. Empty if no task can be simulated.
    assisted : dict of float
        By condition, the percentage of people to whom the robot makes a suggestion in a task.
    """

    study: UserStudy
    actions: Mapping[str, Floats]
    assisted: Mapping[str, float]

    @classmethod
    def of(cls, study: UserStudy, tasks: Mapping[str, CostToGo], *, briefly: bool = False) -> Forecast:
        """Simulate the conditions of a study.

        Parameters
        ----------
        study : UserStudy
        tasks : mapping of str to CostToGo
            Tasks by name. Those that are solved on demand are too large to be simulated here.
        briefly : bool
            Whether only what `seldom_assisted` needs is simulated, in fewer episodes; `actions` is then empty.

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
            return cls(study, {}, {})
        actions, assisted = {}, {}

        @cache  # conditions with the same setting have the same people
        def pool_of(setting: Setting, place: int) -> Pool:
            return Pool.sample(known[place], PEOPLE, seed=study.seed, setting=setting, population=study.population)

        for number, one in enumerate(study.conditions):
            if briefly and one.policy not in WEIGHING:
                continue
            policy, episodes = policies[number], BRIEF if briefly else EPISODES
            with _own_code(study, number + 1, policy):
                found = [
                    _simulated(study, policy, pool_of(one.setting, place), (number, place), episodes)
                    for place in range(len(known))
                ]
            members = 1 if study.group is None else study.group.size
            each = [np.where(run.finished, run.actions, np.nan)[:, :members].mean(axis=1) for run in found]
            actions[one.name] = np.mean(each, axis=0)
            assisted[one.name] = 100 * fmean(float((run.helped > 0).mean()) for run in found)
        return cls(study, {} if briefly else actions, assisted)

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
        study = self.study
        each = self._each
        units = None if study.participants is None else study.participants // each
        for one in (one.name for one in study.conditions if one.name != study.reference):
            spread, expected = self._difference(one)
            g = math.nan if units is None else self._detectable(one, units)
            yield Sensitivity(
                condition=one, against=study.reference, units=units or None, hedges_g=_known(g),
                actions=_known(g * spread), expected=_known(expected),
                needed=self._needed(one, expected / spread, each),
            )  # fmt: skip

    def participants(self, difference: float) -> Iterator[tuple[str, int | None]]:
        """Yield how many participants show a difference from the reference in actions per task, for each condition.

        It is None where more than `MOST` are needed, or where no task can be simulated.

        Parameters
        ----------
        difference : float
        """
        for one in (one.name for one in self.study.conditions if one.name != self.study.reference):
            yield one, self._needed(one, difference / self._difference(one)[0], self._each)

    @property
    def _each(self) -> int:
        """The number of participants that a unit in each of two compared conditions takes."""
        size = 1 if self.study.group is None else self.study.group.size
        return size if self.study.is_within else size * len(self.study.conditions)

    def _needed(self, condition: str, size: float, each: int) -> int | None:
        """Return the number of participants who show a standardised difference, where a unit takes `each` of them."""
        every = range(MOST // each + 1)
        found = bisect_left(every, True, lo=2, key=lambda units: self._detectable(condition, units) <= abs(size))
        return found * each if found in every else None

    def _detectable(self, condition: str, units: int) -> float:
        """Return the standardised difference from the reference that some units show with 80 % power."""
        if not self.study.is_within:
            return detectable(2 * units - 2, math.sqrt(units / 2))
        orders = islice(cycle(self.study.orders.values()), units)
        return detectable_within([(order.index(condition), order.index(self.study.reference)) for order in orders])

    def _difference(self, condition: str) -> tuple[float, float]:
        """Return the standard deviation that the test of a condition meets, and the mean difference."""
        if not self.actions:
            return math.nan, math.nan
        own, other = self.actions[condition], self.actions[self.study.reference]
        if self.study.is_within:
            spread = float(np.nanstd(own - other, ddof=1))
        else:
            spread = math.sqrt((np.nanvar(own, ddof=1) + np.nanvar(other, ddof=1)) / 2)
        return spread, float(np.nanmean(own) - np.nanmean(other))


@contextmanager
def _own_code(study: UserStudy, number: int, policy: str | TeamPolicy | None = None) -> Iterator[None]:
    """Give faults of the user's own code their place in the study's file: the number of the condition, from 1.

    They are the policy's while it is loaded, and where its file is named; others are of people or of their rules.
    """
    try:
        yield
    except UserCodeError as error:
        of_policy = policy is None or (isinstance(policy, UserPolicy) and str(error).startswith(f"{policy.file}:"))
        with located(study.file):
            place = f"conditions[{number}]{'.policy' if of_policy else ''}"
            raise fault(study.file, place, str(error)) from None


def _simulated(
    study: UserStudy, policy: str | TeamPolicy, pool: Pool, number: tuple[int, ...], episodes: int
) -> Episodes:  # fmt: skip
    """Simulate the same teams of the same people; their random numbers are those of the condition alone."""
    team = 1 + study.simulated if study.group is None else study.group.size
    teams = np.random.default_rng([study.seed, 4]).permuted(np.tile(np.arange(PEOPLE), (EPISODES, 1)), axis=1)[:, :team]
    seed = int(np.random.default_rng([study.seed, 5, *number]).integers(2**63))
    return simulate(pool, policy, humans=teams[:episodes], episodes=episodes, seed=seed)


def _known(number: float) -> float | None:
    return number if math.isfinite(number) else None
