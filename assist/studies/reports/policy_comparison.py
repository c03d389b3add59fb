"""Policies compared on the same people and the same random numbers, under one condition or several.

`compare` simulates every policy in the same episodes: same teams, same people, same uniform numbers. The difference of
two policies in an episode is therefore due to the policies, and its mean varies far less than the two means do. A
condition is a team size, a pool (people at another task, or a robot with other costs), or both.

Intervals are those of Student's t distribution for the mean of independent episodes. They hold for the people of the
pool: other people would give other means. `run_study` draws several pools, and generalises to people.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np

from planner.system.errors import expected
from planner.system.progress import Progress, Wanted, shows_progress

from ...declare.tables import label
from ...people.arguments import Seed, entropy, positive, whole
from ...person.robots import Robot
from ...person.settings import Setting
from ...team.episodes import Episodes
from ...team.policies import by_name
from ...team.pool import Pool, require_pool
from ...team.requested import Conditions
from ...team.simulate import simulate
from ...team.state import TeamPolicy
from .compared_policies import ComparedPolicy, PolicyComparison, baseline_of

if TYPE_CHECKING:
    from ...certify.certificate import Certificate

SETTINGS = tuple(each.name for each in fields(Setting))
"""What may be varied by its name."""

CONDITIONS = ("trace", *sorted(Conditions.__optional_keys__ - {"name", "time_limit"}))
"""Further arguments of `simulate`; the names of policies and the time limit are those of the comparison."""


class Comparing(TypedDict, total=False):
    """How policies are compared. Each entry has a default.

    Attributes
    ----------
    baseline : str or None
        The policy that differences refer to; by default "none" if it is compared, else the first.
    varied : str
        What the keys of several pools are, such as "population": the name of a column and of an axis; "pool" by
        default.
    level : float
        Confidence level of intervals; 0.95 by default.
    certified : bool or float
        Also compute an upper bound on the value of all policies, and each policy's gap to it, which takes longer. A
        number is the relative gap to which each person's problem is solved for the bound, as in `upper_bound`.
    time_limit : float or None
        Seconds after which no further portion of episodes begins. All policies have the same episodes.
    """

    baseline: str | None
    varied: str
    level: float
    certified: bool | float
    time_limit: float | None


FIRST_PORTION = 64
"""Episodes of each policy in the first portion; later ones are twice as large as the one before."""

GAP = 1e-3
"""Relative gap to which each person's problem is solved for a bound, unless another is given."""


@shows_progress
def compare(
    pool: Pool | Mapping[Any, Pool],
    policies: Iterable[str | TeamPolicy] | Mapping[str, str | TeamPolicy] | str | TeamPolicy, *,
    humans: int | Iterable[int] | Iterable[str] = 3, episodes: int = 500, seed: Seed = 0, progress: Wanted = None,
    **options: Any,
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
    progress : callable or bool, optional
        Receives progress reports, as `planner.system.progress` describes.
    **options
        The `baseline`, whether gaps are `certified`, and others: see `Comparing`. Fields of `Setting` in place of the
        pool's: a value, or for one of them a list of values, each of which is a condition with the same people, such as
        `c_suggest=[0.1, 1.0]`. And further arguments of `simulate`, such as `jobs`, `goals` or `world`. A bound is for
        people who are present from the beginning and whose goals are inferred; it is that of the robot's model, in
        which policies are simulated again for their gaps.

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
    known = [*Comparing.__annotations__, *SETTINGS, *CONDITIONS]
    unknown = next((name for name in options if name not in known), None)
    if unknown is not None:
        raise TypeError(f"compare has no argument {unknown!r}; {expected(unknown, known)}")
    settings = {name: options.pop(name) for name in list(options) if name in SETTINGS}
    own = Comparing(**{name: options.pop(name) for name in list(options) if name in Comparing.__annotations__})  # type: ignore[typeddict-item]
    pools, varied = _pools(pool, own.get("varied", "pool"), settings)
    named = by_name(policies)
    if not named:
        raise ValueError("policies: expected at least one")
    teams = _teams(humans)
    base, level = baseline_of(named, own.get("baseline")), own.get("level", 0.95)
    if not 0 < level < 1:
        raise ValueError(f"level {level}: expected a number between 0 and 1")
    options["seed"] = entropy(seed)
    certified, limit = own.get("certified", False), own.get("time_limit")
    if certified is not False:
        _require_bound(options)
    gap = None if certified is False else positive("certified", GAP if certified is True else certified)
    count, limit = whole("episodes", episodes, 1), None if limit is None else positive("time_limit", limit)
    conditions = len(pools) * len(teams)
    share = None if limit is None else limit / conditions / (1 if gap is None else 2)
    comparing = _Comparing(named, base, level, count, gap, share, options)
    rows: list[ComparedPolicy] = []
    for key, pool_of in pools.items():
        one = pool_of()  # whose memory is free before the next one is made
        made = comparing.policies_for(one)  # what a policy computes about a person serves teams of any size
        for team in teams:
            number = len(rows) // len(named) + 1
            tell = partial(_told, progress, f" ({number} of {conditions} conditions)" * (conditions > 1))
            rows.extend(comparing.rows(key, one, made, team, tell))
        del one, made
    return PolicyComparison(tuple(rows), base, varied, level)


@dataclass(frozen=True)
class _Comparing:
    """What all conditions of a comparison share.

    Attributes
    ----------
    named : dict of policies
        By their names in tables.
    baseline : str
    level : float
    episodes : int
        Of each policy in each condition.
    gap : float or None
        That of bounds; None without any.
    seconds : float or None
        After which a condition begins no further portion of episodes.
    options : dict
        Further arguments of `simulate`.
    """

    named: Mapping[str, str | TeamPolicy]
    baseline: str
    level: float
    episodes: int
    gap: float | None
    seconds: float | None
    options: Mapping[str, Any]

    def policies_for(self, pool: Pool) -> dict[str, TeamPolicy]:
        """Return the policies for the people of a pool."""
        travel = self.options.get("travel")
        return {
            name: pool.policy(policy, travel) if isinstance(policy, str) else policy
            for name, policy in self.named.items()
        }

    def rows(
        self, key: Any, pool: Pool, policies: Mapping[str, TeamPolicy], team: int | list[str], tell: Progress
    ) -> Iterator[ComparedPolicy]:
        """Yield the rows of a condition: of a pool, whose key is given, and a team."""
        runs = {}
        for name, policy in policies.items():
            run = partial(simulate, pool, policy=policy, name=name, humans=team, progress=tell, **self.options)
            # A user's policy need not be ready for threads.
            runs[name] = run if isinstance(self.named[name], str) else partial(run, jobs=1)
        found = _runs(runs, self.episodes, self.seconds)
        gaps = {} if self.gap is None else self._certified(pool, policies, team, tell)
        for name, own in found.items():
            baseline = None if name == self.baseline else found[self.baseline]
            yield ComparedPolicy.of(own, baseline, self.level, key, gaps.get(name))

    def _certified(
        self, pool: Pool, policies: Mapping[str, TeamPolicy], team: int | list[str], tell: Progress
    ) -> dict[str, Certificate]:
        from ...certify.comparison import certify  # which a comparison without bounds need not compile

        also = {name: self.options[name] for name in ("travel", "jobs") if name in self.options}
        _, found = certify(
            pool, policies, team=range(team) if isinstance(team, int) else team, episodes=max(self.episodes, 2),
            seed=self.options["seed"], gap=self.gap, time_limit=self.seconds, progress=tell, **also,
        )  # fmt: skip
        return {certificate.policy: certificate for certificate in found}


def _require_bound(options: Mapping[str, Any]) -> None:
    """Check that the conditions of a simulation are among those for which there are bounds."""
    if options.get("presence") is not None:
        raise ValueError("certified and presence: expected one of them, as a bound is for people who are all present")
    if (goals := options.get("goals", "inferred")) != "inferred":
        raise ValueError(f"certified and goals {goals!r}: expected goals 'inferred', for which there is a bound")


def _teams(humans: int | Iterable[int] | Iterable[str]) -> list[int | list[str]]:
    """Return the number of people of each team, or the names of those of the only one."""
    if isinstance(humans, str):
        raise TypeError(f"humans {humans!r}: expected a number, numbers, or a list of names")
    given = [humans] if np.ndim(humans) == 0 else list(humans)  # type: ignore[arg-type]
    if any(isinstance(one, str) for one in given):
        return [given]  # type: ignore[list-item]
    sizes = [whole("humans", one, 1) for one in given]
    _require_different("humans", sizes)
    return sizes  # type: ignore[return-value]


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
    keys = [_key(value) for value in values]
    _require_different(name, keys)
    return {key: _under(one, {**fixed, name: value}) for key, value in zip(keys, values, strict=True)}, name


def _key(value: Any) -> Any:
    """Return what stands for a value of a field in tables: itself if it is a number or a name."""
    if isinstance(value, Mapping):
        return label(value)
    return value if isinstance(value, Hashable) else str(value)


def _require_different(name: str, keys: Sequence[Any]) -> None:
    """Check that no condition is there twice."""
    for at, key in enumerate(keys):
        if key in keys[:at]:
            raise ValueError(f"{name}: {key} is there twice; expected different values")


def _under(pool: Pool, fields: Mapping[str, Any]) -> Callable[[], Pool]:
    """Return what makes a pool's people with other fields of the setting, which are checked now."""
    return partial(pool.under, replace(pool.setting, **fields))


def _is_several(value: Any) -> bool:
    """Return whether a field of a setting was given several values. Robots are the value of one field together."""
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return isinstance(value, list | tuple | range) and not any(isinstance(one, Robot) for one in value)


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
