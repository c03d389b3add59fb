"""`fit`: what a log says of people, from the log and the task to everybody's estimates.

The front door of this room; what it does is in the other files, in the order in which they build on each other.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from planner import CostToGo, LimitError, Table
from planner.system.arrays import outline
from planner.system.progress import Wanted, adding, shows_progress

from ..people.choice_model import ChoiceModel
from ..people.human import Mixture
from ..people.terms import TERMS, Term, features
from .choosing import with_model
from .diagnostics import UNCHECKED, check
from .hierarchy import Hierarchy, fit_terms
from .likelihood import Method
from .log import Fault, Log, in_order
from .maximum_likelihood import largest_beta, maximum_likelihood
from .misconception_fit import fit_misconception, require_memory
from .observations import EvaluatedStates, Ints, Observations, observe
from .person_estimate import PersonEstimate, nothing_known
from .population import ETAS, PopulationFit, fit_population, population_of
from .replay import Recording, replay, situation

WHO_ASKED = 4
"""Calls from a warning of `replayed` up to whoever called a function that shows its progress."""
Terms = bool | Mapping[str, Term]


class LogError(ValueError):
    """A log of which nothing can be used, or not all of it where it should be."""


@dataclass(frozen=True, eq=False)
class FittedPeople(Mapping[str, PersonEstimate]):
    """What a log says of people: a `PersonEstimate` by the name of each.

    Attributes
    ----------
    records : tuple of PersonEstimate
        In the order of the names.
    unknown : dict of str to dict
        The people of whom nothing could be used, each with the record that says why.
    faults : tuple of Fault
        Lines of the log that could not be used.
    method : Method
        How estimates were made.
    facts : callable
        Gives what holds in states, shape (M,), of the task.
    hierarchy : Hierarchy or None
        The population that people were taken from, where terms were asked for.
    chooses : ChoiceModel or None
        How they were taken to choose, where that is not by cost-to-go.
    """

    records: tuple[PersonEstimate, ...]
    unknown: Mapping[str, Mapping[str, Any]]
    faults: tuple[Fault, ...]
    method: Method
    facts: Callable[[Ints], list[list[str]]]
    hierarchy: Hierarchy | None = None
    chooses: ChoiceModel | None = None

    __repr__ = outline

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
        """Estimate how beta and theta are distributed over people; `family` as for `fit_population`.

        Where terms were asked for it is the population that people were taken from: beta is log-normal, theta
        logit-normal, and weights are normal.
        """
        if self.hierarchy is not None:
            if family not in (None, "log-normal"):
                raise ValueError(f"family '{family}': expected log-normal, which beta is taken to be where terms are")
            return population_of(self.hierarchy)
        assert callable(progress)
        observations = [record.fit.observations for record in self.records]
        advance = adding(progress, "fitting the population", ETAS)
        return fit_population(observations, self.method, family=family, progress=advance)

    def population(self, *, family: str | None = None) -> Mixture:
        """Give a population like these people, to draw others from.

        Parameters
        ----------
        family : str, optional
            Of beta's distribution, as for `distribution`.
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
        """Give all of it as plain data, a record for everybody who is named in the log."""
        found = [record.as_dict(self.facts) for record in self.records] + [dict(one) for one in self.unknown.values()]
        return sorted(found, key=lambda record: in_order(record["person"]))


@shows_progress
def fit(
    costs: CostToGo,
    log: Log,
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
    """Learn expertise, influence and trust of people from a log of their actions.

    Parameters
    ----------
    costs : CostToGo
        Of the task that they worked on: a table, or on demand, where only states that were visited and their
        successors are asked for.
    log : Log
        As `read_log` gives it.
    drop, rename
        As for `replay`.
    method : Method, optional
        How estimates are made: level of the intervals, lapses, what is known beforehand.
    misconceptions : bool
        Whether to estimate sigma and what people take for the cost-to-go, too; a second or more for each person.
    terms : bool, or mapping of str to callable
        Whether to estimate the weights of terms as well, those that are given (`TERMS`) or one's own by their names.
        Everybody is then taken for one of a population (`hierarchy`).
    chooses : ChoiceModel, optional
        How people choose, in place of by cost-to-go: beta is then that of this model. `costs` has to be a table.
    strict : bool
        Whether to refuse a log that cannot be used completely.
    seed : int or numpy.random.Generator
        Of the check of the model.
    jobs : int
        Threads.
    progress : callable or bool, optional
        Who is told how far it is, as in `planner.system.progress`: states are evaluated, then people are fitted.

    Raises
    ------
    LogError
        Nothing in the log can be used; with `strict`, something cannot.
    ValueError
        A name in `drop` or `rename` that stands for nothing.
    MemoryError
        Somebody's misconceptions would take too much memory.

    Warns
    -----
    UserWarning
        Some lines cannot be used, or some states were not evaluated; `FittedPeople.faults` has the lines.
    """
    assert callable(progress)
    progress("evaluating states", 0, None)
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
    """Follow a log through its task, and look up the cost-to-go of what was met; parameters as of `fit`."""
    recording, found = replay(log, costs, drop=drop, rename=rename)
    faults = tuple(sorted([*log.faults, *found], key=lambda fault: fault.line))
    if faults:
        message = f"{log.name}:{faults[0].line}: {faults[0]}"
        if strict:
            raise LogError(message)
        others = f" (and {len(faults) - 1} more; see `faults`)" if len(faults) > 1 else ""
        warnings.warn(message + others, stacklevel=WHO_ASKED)
    require_actions(log, recording, costs)
    wanted = recording.wanted()
    try:
        h = costs.lookup(wanted)
    except LimitError as error:
        known = getattr(costs, "known", None)
        if strict or known is None:
            raise
        warnings.warn(f"{error}; actions that depend on them are left out", stacklevel=WHO_ASKED)
        h = known(wanted)
    return recording, EvaluatedStates.of(costs, wanted, h, wanted, len(costs)), faults


def require_actions(log: Log, recording: Recording, costs: CostToGo) -> None:
    """Refuse a log of which no episode can be used."""
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
    """Learn about people from what was replayed; for who has the cost-to-go of its states in another way.

    Parameters
    ----------
    costs : CostToGo
        Of the task, as it was replayed on; it is not asked for costs.
    known : EvaluatedStates
        Of the states that `recording.wanted()` names.
    faults, method, misconceptions, terms, chooses, seed, jobs
        As for `fit`; faults are all that was found.
    progress : callable, optional
        Called with how many people have been finished since the last call.
    table : Table, optional
        Of the same task; where people choose by a model of one's own.
    """
    method = method or Method()
    if chooses is not None and (misconceptions or terms):
        raise ValueError("a choice model, and misconceptions or terms: expected one of them")
    if misconceptions and terms:
        raise ValueError("misconceptions and terms: expected one of them, since nobody has estimated both at once")
    observations, left_out = observed(log, costs, recording, known, terms)
    if chooses is not None:
        if table is None:
            raise ValueError("people who choose by a model of their own: expected a table of the whole task")
        method = replace(method, largest_beta=largest_beta(observations, method))
        observations = with_model(observations, chooses, costs, table, largest_beta(observations, method))
    rng = np.random.default_rng(seed)
    if misconceptions:
        require_memory(observations)
    population = None
    if terms:
        fits, population = fit_terms(observations, method)
    else:
        fits = maximum_likelihood(observations, method, jobs=jobs, progress=None if misconceptions else progress)
    records = []
    for fitted in fits:
        misconception = fit_misconception(fitted) if misconceptions else None
        person = fitted.observations.person
        fits_model = UNCHECKED if chooses is not None else check(fitted, rng)  # it is one of the paper's model
        records.append(PersonEstimate(fitted, fits_model, misconception, left_out.get(person, 0)))
        if (misconceptions or terms) and progress is not None:
            progress(1)

    def facts(states: Ints) -> list[list[str]]:
        return [costs.task.facts(values) for values in costs.values(states).tolist()]

    named = log.people | {fault.person for fault in faults if fault.person is not None}
    unknown = {
        person: nothing_known(
            person,
            "no action can be used" if left_out.get(person) else "no episode can be used",
            left_out.get(person, 0),
        )
        for person in sorted(named - {o.person for o in observations}, key=in_order)
    }
    return FittedPeople(tuple(records), unknown, faults, method, facts, population, chooses)


def observed(
    log: Log, costs: CostToGo, recording: Recording, known: EvaluatedStates, terms: Terms = False
) -> tuple[list[Observations], dict[str, int]]:
    """Give what each person could choose from and what they chose, and how many actions of whom are left out.

    Parameters
    ----------
    log, costs, recording, known, terms
        As for `learn`.

    Raises
    ------
    LogError
        Of nothing the cost-to-go is known, or nobody can reach the goal.
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
