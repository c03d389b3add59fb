"""`fit`: estimates of people's parameters from a log and a task.

This is the entry point of the package. It calls the other modules in order: replay, observations, estimation, checks.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from planner import CostToGo, LimitError, Table, TransitionSystem, known_costs
from planner.system.progress import Wanted, adding, shows_progress

from ..people.choice_model import ChoiceModel
from ..people.mixture import Mixture
from ..people.terms import TERMS, Term, features
from .choosing import with_model
from .diagnostics import UNCHECKED, check
from .hierarchy import Hierarchy, fit_terms
from .likelihood import Method
from .log import Fault, Log, in_order, log_of
from .maximum_likelihood import largest_beta, maximum_likelihood
from .misconception_fit import fit_misconception, require_memory
from .observations import EvaluatedStates, Ints, Observations, observe
from .person_estimate import PersonEstimate, nothing_known
from .population import ETAS, PopulationFit, fit_population, population_of
from .replay import Recording, replay, situation

if TYPE_CHECKING:
    from planner import AnyTask

Terms = bool | Mapping[str, Term]


class LogError(ValueError):
    """No part of the log can be used, or, with `strict`, not all of it."""


@dataclass(frozen=True)
class FactsOf:
    """Returns the facts that hold in states, shape (M,), of a task."""

    costs: CostToGo

    def __call__(self, states: Ints) -> list[list[str]]:
        """Return the facts of each state."""
        return [self.costs.task.facts(values) for values in self.costs.values(states).tolist()]


@dataclass(frozen=True, eq=False)
class FittedPeople(Mapping[str, PersonEstimate]):
    """The estimates of people: a `PersonEstimate` by the name of each.

    Attributes
    ----------
    records : tuple of PersonEstimate
        Estimates in the order of the names.
    unknown : dict of str to dict
        A record with the reason for each person without usable actions.
    faults : tuple of Fault
        Unusable lines of the log.
    method : Method
        Options of the estimation.
    facts : FactsOf, optional
        Returns the facts that hold in states, shape (M,), of the task; None if no misconceptions were estimated.
    hierarchy : Hierarchy or None
        The estimated population, if terms were requested.
    chooses : ChoiceModel or None
        The user's choice model, if one was given.
    """

    records: tuple[PersonEstimate, ...]
    unknown: Mapping[str, Mapping[str, Any]]
    faults: tuple[Fault, ...]
    method: Method
    facts: FactsOf | None = None
    hierarchy: Hierarchy | None = None
    chooses: ChoiceModel | None = None

    def __repr__(self) -> str:
        shown = ", ".join(map(str, self.records[:3]))
        more = ", ..." if len(self.records) > 3 else ""
        without = f"; {len(self.unknown)} without an estimate" if self.unknown else ""
        return f"<{len(self)} fitted people: {shown}{more}{without}; {len(self.faults)} faults of the log>"

    def __getitem__(self, person: str) -> PersonEstimate:
        for record in self.records:
            if record.person == person:
                return record
        raise KeyError(person)

    def __iter__(self) -> Iterator[str]:
        return (record.person for record in self.records)

    def __len__(self) -> int:
        return len(self.records)

    @property
    def complete(self) -> bool:
        """Whether every line and every action of the log was used."""
        return not self.faults and not self.unknown and not any(record.left_out for record in self.records)

    @shows_progress
    def distribution(self, *, family: str | None = None, progress: Wanted = None) -> PopulationFit:
        """Return the estimated distribution of beta and theta over people; `family` as in `fit_population`.

        With terms, it is the population of the hierarchical model: beta is log-normal, theta logit-normal, and weights
        are normal.
        """
        if self.hierarchy is not None:
            if family not in (None, "log-normal"):
                raise ValueError(f"family '{family}': expected log-normal, which beta is taken to be where terms are")
            return replace(population_of(self.hierarchy), utility_scale=self.method.utility_scale)
        assert callable(progress)
        observations = [record.fit.observations for record in self.records]
        advance = adding(progress, "fitting the population", ETAS)
        return fit_population(observations, self.method, family=family, progress=advance)

    def population(self, *, family: str | None = None) -> Mixture:
        """Return a population like these people, from which others can be drawn.

        Parameters
        ----------
        family : str, optional
            Family of beta's distribution, as in `distribution`.
        """
        found = self.distribution(family=family).population(self.sigma)
        if self.chooses is None:
            return found
        return Mixture(tuple(replace(part, chooses=self.chooses) for part in found.parts), found.shares)

    @property
    def sigma(self) -> tuple[float, float]:
        """The range of people's misconceptions, without the largest and smallest tenth; (0, 0) if not estimated."""
        sizes = [record.misconception.sigma for record in self.records if record.misconception is not None]
        low, high = np.quantile(sizes, (0.1, 0.9)).tolist() if sizes else (0.0, 0.0)
        return low, high

    def as_dicts(self) -> list[dict[str, Any]]:
        """Return the results as plain data: a record for each person who is named in the log."""
        found = [record.as_dict(self.facts) for record in self.records] + [dict(one) for one in self.unknown.values()]
        return sorted(found, key=lambda record: in_order(record["person"]))


@shows_progress
def fit(
    costs: CostToGo | AnyTask,
    log: Log | str | PathLike[str] | Iterable[Mapping[str, Any]],
    *,
    drop: Sequence[str] = (),
    rename: Mapping[str, str] | None = None,
    method: Method | None = None,
    misconceptions: bool = False,
    terms: Terms = False,
    chooses: ChoiceModel | None = None,
    strict: bool = False,
    seed: int | np.random.Generator = 0,
    jobs: int = 1,
    progress: Wanted = None,
) -> FittedPeople:
    """Return estimates of people's expertise, influence and trust from a log of their actions.

    Parameters
    ----------
    costs : CostToGo, or whatever `planner.load` takes
        Cost-to-go of their task, as a table or on demand; only visited states and their successors are queried.
    log : Log, path, list of dict, or data frame
        A log, as from `read_log`, or what `read_log` and `Log.of` take.
    drop, rename
        As in `replay`.
    method : Method, optional
        Options of the estimation: level of the intervals, lapses, known parameters.
    misconceptions : bool
        Whether to estimate sigma and the perceived cost-to-go, too; this takes a second or more for each person.
    terms : bool, or mapping of str to callable
        Whether to estimate the weights of terms, too: those of `TERMS`, or the given ones. The model is then
        hierarchical (`hierarchy`).
    chooses : ChoiceModel, optional
        Choice model in place of cost-to-go; beta is then its parameter. `costs` must be a table.
    strict : bool
        Whether a log that cannot be used completely is an error.
    seed : int or numpy.random.Generator
        Random seed of the model check.
    jobs : int
        Number of threads.
    progress : callable or bool, optional
        Receives progress reports, as `planner.system.progress` describes: states are evaluated, then people are fitted.

    Raises
    ------
    LogError
        No part of the log can be used or, with `strict`, some part cannot.
    TypeError
        `costs` is no task, or `log` is no log.
    ValueError
        A name in `drop` or `rename` does not exist.
    MemoryError
        A person's misconceptions would take too much memory.

    Warns
    -----
    UserWarning
        Some lines cannot be used (`FittedPeople.faults`), or some states were not evaluated.
    """
    assert callable(progress)
    progress("evaluating states", 0, None)
    costs, log = known_costs(costs), log_of(log)
    recording, known, faults = replayed(costs, log, drop=drop, rename=rename, strict=strict)
    advance = adding(progress, "fitting people", len(recording.people))
    return learn(
        log, costs, recording, known, faults=faults, method=method, misconceptions=misconceptions, terms=terms,
        chooses=chooses, table=costs if isinstance(costs, Table) else None, seed=seed, jobs=jobs, progress=advance,
    )  # fmt: skip


def replayed(
    costs: CostToGo,
    log: Log,
    *,
    drop: Sequence[str] = (),
    rename: Mapping[str, str] | None = None,
    strict: bool = False,
) -> tuple[Recording, EvaluatedStates, tuple[Fault, ...]]:
    """Return a log's replay, the cost-to-go of its states, and its faults; parameters as in `fit`."""
    caller_of_fit = 4  # stack level of warnings
    recording, found = replay(log, costs, drop=drop, rename=rename)
    faults = tuple(sorted([*log.faults, *found], key=lambda fault: fault.line))
    if faults:
        message = f"{log.name}:{faults[0].line}: {faults[0]}"
        if strict:
            raise LogError(message)
        others = f" (and {len(faults) - 1} more; see `faults`)" if len(faults) > 1 else ""
        warnings.warn(message + others, stacklevel=caller_of_fit)
    require_actions(log, recording, costs)
    wanted = recording.wanted()
    try:
        h = costs.lookup(wanted)
    except LimitError as error:
        known = getattr(costs, "known", None)
        if strict or known is None:
            raise
        warnings.warn(f"{error}; actions that depend on them are left out", stacklevel=caller_of_fit)
        h = known(wanted)
    return recording, EvaluatedStates.of(costs, wanted, h, wanted, len(costs)), faults


def require_actions(log: Log, recording: Recording, costs: TransitionSystem) -> None:
    """Check that some episode of a log can be used."""
    if len(recording):
        return
    if not log.people:
        raise LogError(f"{log.name}: no recorded actions")
    if not log.entries:
        raise LogError(f"{log.name}: no episode can be used")
    place = costs.task.instance
    raise LogError(f"{log.name}: no episode can be followed through {place}; is it the log of another instance?")


def learn(
    log: Log,
    costs: CostToGo,
    recording: Recording,
    known: EvaluatedStates,
    *,
    faults: tuple[Fault, ...] = (),
    method: Method | None = None,
    misconceptions: bool = False,
    terms: Terms = False,
    chooses: ChoiceModel | None = None,
    table: Table | None = None,
    seed: int | np.random.Generator = 0,
    jobs: int = 1,
    progress: Callable[[int], None] | None = None,
) -> FittedPeople:
    """Return estimates of people from a replayed log, if the cost-to-go of its states is known already.

    Parameters
    ----------
    costs : CostToGo
        Cost-to-go of the replayed task; it is not queried for costs.
    known : EvaluatedStates
        Data of the states that `recording.wanted()` returns.
    faults, method, misconceptions, terms, chooses, seed, jobs
        As in `fit`; `faults` are those of the log and of the replay.
    progress : callable, optional
        Called with the number of people who have been finished since the last call.
    table : Table, optional
        Table of the same task, for a user's choice model.
    """
    method = method or Method()
    if chooses is not None and (misconceptions or terms):
        raise ValueError("a choice model, and misconceptions or terms: expected one of them")
    if misconceptions and terms:
        raise ValueError("misconceptions and terms: expected one of them; they cannot be estimated together")
    observations, left_out = observed(log, costs, recording, known, terms)
    if chooses is not None:
        if table is None:
            raise ValueError("a choice model: expected a table of the whole task")
        method = replace(method, largest_beta=largest_beta(observations, method))
        observations = with_model(observations, chooses, costs, table, largest_beta(observations, method))
    rng = np.random.default_rng(seed)
    if misconceptions:
        require_memory(observations, method.misconception_memory_mb)
    population = None
    if terms:
        fits, population = fit_terms(observations, method)
    else:
        fits = maximum_likelihood(observations, method, jobs=jobs, progress=None if misconceptions else progress)
    records = []
    for fitted in fits:
        misconception = fit_misconception(fitted) if misconceptions else None
        person = fitted.observations.person
        fits_model = UNCHECKED if chooses is not None else check(fitted, rng)  # the check concerns the paper's model
        records.append(PersonEstimate(fitted, fits_model, misconception, left_out.get(person, 0)))
        if (misconceptions or terms) and progress is not None:
            progress(1)

    named = log.people | {fault.person for fault in faults if fault.person is not None}
    unknown = {
        person: nothing_known(
            person,
            "no action can be used" if left_out.get(person) else "no episode can be used",
            left_out.get(person, 0),
        )
        for person in sorted(named - {o.person for o in observations}, key=in_order)
    }
    return FittedPeople(
        tuple(records), unknown, faults, method, FactsOf(costs) if misconceptions else None, population, chooses
    )


def observed(
    log: Log, costs: CostToGo, recording: Recording, known: EvaluatedStates, terms: Terms = False
) -> tuple[list[Observations], dict[str, int]]:
    """Return each person's observations, and the number of excluded actions of each.

    Parameters
    ----------
    log, costs, recording, known, terms
        As in `learn`.

    Raises
    ------
    LogError
        No cost-to-go is known, or no person can reach the goal.
    """
    recording, left_out = recording.evaluated(known.h)
    if not len(recording):
        raise LogError(f"{log.name}: the states after every action took too long")
    if not math.isfinite(known.h[recording.wanted()].min()):
        raise LogError(f"{log.name}: no state that was visited has a way to the goal, so that all actions are alike")
    wanted, goal = recording.wanted(), np.zeros(len(known.h), dtype=bool)
    goal[wanted] = costs.is_goal(wanted)
    if not terms:
        return observe(recording, known, goal), left_out
    own = TERMS if terms is True else terms
    return observe(recording, known, goal, tuple(own), features(situation(recording, costs), own)), left_out
