"""`fit`: estimates of people's parameters from a log and a task."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, TypeAlias, Unpack

import numpy as np

from planner import CostToGo
from planner.system.errors import expected
from planner.system.limits import Deadline
from planner.system.progress import Wanted, adding, shows_progress
from planner.system.results import Result

from ..people.choice_model import ChoiceModel, Weighted, boltzmann, chances, value
from ..people.decision import NOTHING, perceived_cost
from ..people.human import Human
from ..people.misconception import Misconception
from ..people.ranges import Population
from ..people.terms import TERMS, Term
from ..person.settings import Setting
from ..person.state_cache import StateCache
from ..person.truncated_task import TruncatedTask
from .diagnostics import check
from .distribution import Margin, PopulationFit
from .evidence import Evidence, Reading, Records, Tasks, evidence
from .hierarchy import Hierarchy, fit_terms
from .likelihood import SMALL, Method, largest_beta
from .log import Fault, in_order
from .maximum_likelihood import maximum_likelihood
from .misconception_fit import fit_misconception, require_memory
from .observations import Chances, Observations
from .person_estimate import UNCHECKED, PersonEstimate, nothing_known
from .population import fit_population, population_of

Model: TypeAlias = Literal["misconceptions", "terms"] | Mapping[str, Term] | ChoiceModel
"""What people's choices depend on besides cost-to-go: see `fit`."""


@dataclass(frozen=True, eq=False, repr=False)
class FittedPeople(Result, Mapping[str, PersonEstimate]):
    """The estimates of people: a `PersonEstimate` by the name of each.

    Attributes
    ----------
    people : tuple of PersonEstimate
        Estimates in the order of the names.
    unknown : dict of str to dict
        A record with the reason for each person without usable actions.
    faults : tuple of Fault
        Unusable lines of the log.
    method : Method
        Options of the estimation.
    costs : CostToGo, optional
        Of the task in whose states misconceptions were estimated; None without these.
    hierarchy : Hierarchy or None
        The estimated population, if terms were requested.
    chooses : ChoiceModel or None
        The user's choice model, if one was given.
    """

    people: tuple[PersonEstimate, ...]
    unknown: Mapping[str, Mapping[str, Any]]
    faults: tuple[Fault, ...]
    method: Method
    costs: CostToGo | None = None
    hierarchy: Hierarchy | None = None
    chooses: ChoiceModel | None = None

    def __repr__(self) -> str:
        shown = ", ".join(map(str, self.people[:3]))
        more = ", ..." if len(self.people) > 3 else ""
        without = f"; {len(self.unknown)} without an estimate" if self.unknown else ""
        return f"<{len(self)} fitted people: {shown}{more}{without}; {len(self.faults)} faults of the log>"

    def __getitem__(self, person: str) -> PersonEstimate:
        for one in self.people:
            if one.person == person:
                return one
        raise KeyError(f"person {person!r}; {expected(person, [one.person for one in self.people])}")

    def __iter__(self) -> Iterator[str]:
        return (one.person for one in self.people)

    def __len__(self) -> int:
        return len(self.people)

    def records(self) -> list[dict[str, Any]]:
        """Return a row for each person, as `PersonEstimate.records` does; of others, the reason in `notes`."""
        rows = [row for one in self.people for row in one.records()]
        rows += [{"person": person, "actions": 0, "notes": one["error"]} for person, one in self.unknown.items()]
        return sorted(rows, key=lambda row: in_order(row["person"]))

    @property
    def complete(self) -> bool:
        """Whether every line and every action of the log was used."""
        return not self.faults and not self.unknown and not any(one.left_out for one in self.people)

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
        observations = [one.observations for one in self.people]
        return fit_population(observations, self.method, family=family, progress=progress)

    def population(self, *, family: str | None = None) -> Population:
        """Return a population like these people, from which others can be drawn.

        Parameters
        ----------
        family : str, optional
            Family of beta's distribution, as in `distribution`.
        """
        found = (self._usual if family is None else self.distribution(family=family)).population(self.sigma)
        if self.chooses is None:
            return found
        return Population.mixed(tuple(replace(part, chooses=self.chooses) for part in found.parts), found.shares)

    @cached_property
    def _usual(self) -> PopulationFit:
        return self.distribution(progress=False)

    def humans(self, *, theta: float | None = None) -> list[Human]:
        """Return people whose true parameters are these estimates, for `Pool.of`.

        A parameter that somebody's actions do not identify is the mean of the population. Misconceptions have the
        estimated size, and are about states drawn at random.

        Parameters
        ----------
        theta : float, optional
            The theta of people whose actions do not identify it, in place of the population's mean.

        Raises
        ------
        ValueError
            Nobody's actions identify a parameter.
        """

        def known(name: str, own: float | None) -> float:
            if own is not None:
                return own
            margin: Margin | None = getattr(self._usual, name)
            if margin is None:
                raise ValueError(
                    "no suggestion in the log says anything about theta; expected a log with suggestions (the column "
                    "may have another name: columns={'suggestion': 'hint'}), or humans(theta=0.8)"
                )
            return margin.mean

        found = []
        for seed, one in enumerate(self.people):
            mistaken = one.misconception
            sigma = 0.0 if mistaken is None else mistaken.sigma
            chooses = Weighted(one.weights) if one.weights else self.chooses or boltzmann
            beta = one.beta if mistaken is None else mistaken.beta
            mistaken_about = Misconception(sigma, seed)
            its = known("beta", beta), known("theta", theta if one.theta is None else one.theta)
            found.append(Human(*its, sigma, mistaken_about, chooses, one.person))
        return found

    def simulated(self, setting: Setting) -> tuple[list[Human], Population, Setting]:
        """Return what a simulation of these people needs, as `Pool.of` does: they, others like them, and a setting.

        The setting has the estimated rate of trust, eta, and its unit, unless it has a trust rule, also "paper", or a
        rate other than the default.
        """
        usual, eta = Setting(), self._usual.eta
        own = (setting.eta, setting.utility_scale) != (usual.eta, usual.utility_scale)
        if eta is not None and not own and setting.trust is None:
            setting = replace(setting, eta=eta, utility_scale=self.method.utility_scale)
        return self.humans(), self.population(), setting

    @property
    def sigma(self) -> tuple[float, float]:
        """The range of people's misconceptions, without the largest and smallest tenth; (0, 0) if not estimated."""
        sizes = [one.misconception.sigma for one in self.people if one.misconception is not None]
        low, high = np.quantile(sizes, (0.1, 0.9)).tolist() if sizes else (0.0, 0.0)
        return low, high

    def as_dicts(self) -> list[dict[str, Any]]:
        """Return the results as plain data: a record for each person who is named in the log."""
        found = [one.as_dict(self.costs) for one in self.people] + [dict(one) for one in self.unknown.values()]
        return sorted(found, key=lambda record: in_order(record["person"]))


@shows_progress
def fit(
    task: Tasks | Evidence, log: Records | None = None, method: Method | None = None, *, model: Model | None = None,
    jobs: int = 1, time_limit: float | None = None, progress: Wanted = None, **reading: Unpack[Reading],
) -> FittedPeople:  # fmt: skip
    """Return estimates of people's expertise, influence and trust from a log of their actions.

    Parameters
    ----------
    task, log, **reading
        As for `replayed`; or `task` is a log that was replayed.
    method : Method, optional
        Options of the estimation: level of the intervals, lapses, known parameters.
    model : "misconceptions", "terms", mapping of str to callable, or callable, optional
        What is estimated besides. "misconceptions": sigma and the perceived cost-to-go, too, which takes a second or
        more for each person. "terms", or terms by name: the weights of `TERMS`, or of these; the model is then
        hierarchical (`hierarchy`). A function is a choice model in place of cost-to-go; beta is then its parameter.
    jobs : int
        Number of threads.
    time_limit : float, optional
        Seconds after which no further person's misconceptions are estimated; these people are in `unknown`.
    progress : callable or bool, optional
        Receives progress reports, as `planner.system.progress` describes: states are evaluated, then people are fitted.

    Raises
    ------
    InputFileError, TypeError
        As of `replayed`.
    ValueError
        As of `replayed`; or a model is given for one of several goals.
    MemoryError
        A person's misconceptions would take too much memory.

    Warns
    -----
    UserWarning
        Some lines cannot be used (`FittedPeople.faults`), or some states were not evaluated.

    Notes
    -----
    Where each episode has one of several goals, these are summed out of the likelihood (`likelihood`).
    `suboptimal_actions` then counts mistakes with regard to the goal that is the most probable one at the estimates,
    and `PersonEstimate.goal_posteriors` has its probability. The model is checked where the goal is known and people
    choose by cost-to-go.
    """
    assert callable(progress)
    if not isinstance(task, Evidence):
        progress("evaluating states", 0, None)
    if not isinstance(method := method or Method(), Method):
        raise TypeError(f"a {type(method).__name__} where a Method was expected, such as Method(level=0.9)")
    ends, seen = Deadline.after(time_limit), evidence(task, log, reading)
    if seen.goals and model is not None:
        raise ValueError("several goals, and misconceptions, terms or a choice model: expected one of them")
    terms = TERMS if model == "terms" else model if isinstance(model, Mapping) else None
    chooses = model if callable(model) else None
    misconceptions = model == "misconceptions"
    observations = seen.observations(terms)
    if seen.goals or chooses is not None:
        method = replace(method, largest_beta=largest_beta(observations, method))
    if chooses is not None:
        observations = with_model(observations, chooses, seen.costs, method.largest_beta or 1.0)
    if misconceptions:
        require_memory(observations, method.misconception_memory_mb)
    advance = adding(progress, "fitting people", len(seen.recording.people))
    hierarchy, slow = None, misconceptions or terms is not None
    if terms is not None:
        fits, hierarchy = fit_terms(observations, method)
    else:
        fits = maximum_likelihood(observations, method, jobs=jobs, progress=None if slow else advance)
    rng, records, unknown = np.random.default_rng(method.seed), list[PersonEstimate](), _unknown(seen)
    for one in map(_with_likeliest, fits) if seen.goals else fits:
        person = one.observations.person
        if misconceptions and ends.passed:
            unknown[person] = nothing_known(person, "not estimated within the time limit", len(one.observations))
            continue
        misconception = fit_misconception(one) if misconceptions else None
        checked = UNCHECKED if seen.goals or chooses is not None else check(one, rng)
        left_out = seen.left_out.get(person, 0)
        records.append(replace(one, check=checked, misconception=misconception, left_out=left_out))
        if slow:
            advance(1)
    costs = seen.costs if misconceptions else None
    return FittedPeople(tuple(records), unknown, seen.faults, method, costs, hierarchy, chooses)


def _unknown(seen: Evidence) -> dict[str, dict[str, Any]]:
    """Return a record with the reason for each person in a log of whom no action can be used."""
    named = seen.log.people | {fault.person for fault in seen.faults if fault.person is not None}
    missing = {person: seen.left_out.get(person, 0) for person in named - set(seen.recording.people)}
    return {
        person: nothing_known(person, f"no {'action' if missing[person] else 'episode'} can be used", missing[person])
        for person in sorted(missing, key=in_order)
    }


def _with_likeliest(fit: PersonEstimate) -> PersonEstimate:
    """Return estimates in which the most probable goal of each episode decides what counts as a mistake."""
    o = fit.observations
    likeliest = np.array([list(shares.values()) for shares in fit.goal_posteriors().values()]).argmax(axis=1)
    of_step, rows = likeliest[o.begins.cumsum() - 1], np.arange(len(o))
    chosen: dict[str, Any] = {
        name: o.by_goal(name)[of_step, rows] for name in ("excess", "optimal", "ahead", "gain", "cost_to_go", "goal")
    }
    return replace(fit, observations=replace(o, **chosen))


def with_model(
    observations: Sequence[Observations], chooses: ChoiceModel, known: CostToGo, largest: float
) -> list[Observations]:
    """Return observations with the probabilities of a choice model, and with gains in its own V.

    The model is evaluated once, in the visited states and in those to which suggestions lead, on a grid of beta.
    Between two grid points, probabilities are interpolated.

    `known` is the cost-to-go of the task, and `largest` the upper end of the range of beta.
    """
    numbers = [o.state for o in observations]
    after = [o.targets[np.arange(len(o)), np.maximum(o.suggested, 0)] for o in observations]
    states = np.unique(np.concatenate([*numbers, *after]))
    choices = TruncatedTask.around(StateCache(known), states).choices  # successors have no choices
    q = perceived_cost(choices, choices.h)
    v = value(chooses, choices, q)
    beta = SMALL * largest * np.expm1(np.linspace(0.0, math.log1p(1 / SMALL), 257))
    beta[-1] = largest
    chance = np.empty((len(states), choices.applicable.shape[1], len(beta)))
    for begin in range(0, len(beta), 8):  # a model returns all rows, successors included, for each beta
        block = slice(begin, begin + 8)
        chance[:, :, block] = np.moveaxis(chances(chooses, choices, q, beta[block])[:, : len(states)], 0, 2)
    found = []
    for o, number, suggested in zip(observations, numbers, after, strict=True):
        x, then = np.searchsorted(states, number), np.searchsorted(states, suggested)
        width = min(o.excess.shape[1], chance.shape[1])
        own = np.zeros((len(o), o.excess.shape[1], len(beta)))
        own[:, :width] = chance[x, :width]
        with np.errstate(invalid="ignore"):
            gain = np.where((o.suggested != NOTHING) & (v[then] != v[x]), v[then] - v[x], 0.0)
        found.append(replace(o, gain=gain, own=Chances(beta, own)))
    return found
