"""Estimates of people's expertise, influence and trust from a log, where each episode has one of several goals.

The goals are summed out of the likelihood (`likelihood`): each episode has a goal of its own, drawn from the prior.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from planner import CostToGo
from planner.system.progress import Wanted, adding, shows_progress

from ..people.decision import Floats
from ..people.goals import prior_over
from .diagnostics import UNCHECKED
from .fit import FittedPeople
from .goals import RecordedWithGoals, costs_of_goals, recorded
from .likelihood import Method
from .log import Log, in_order, log_of
from .maximum_likelihood import Fit, largest_beta, maximum_likelihood
from .observations import EvaluatedStates, Observations, UnknownGoals, observe
from .person_estimate import PersonEstimate, nothing_known

if TYPE_CHECKING:
    from planner import AnyTask


@shows_progress
def fit_with_goals(
    goals: Mapping[str, CostToGo | AnyTask],
    log: Log | str | PathLike[str] | Iterable[Mapping[str, Any]],
    *,
    prior: Mapping[str, float] | None = None,
    drop: Sequence[str] = (),
    rename: Mapping[str, str] | None = None,
    method: Method | None = None,
    strict: bool = False,
    jobs: int = 1,
    progress: Wanted = None,
) -> FittedPeople:
    """Return estimates of people who pursue one of several goals in each episode.

    `suboptimal_actions` counts mistakes with regard to the goal that is the most probable one at the estimates, and
    `Fit.goal_posteriors` has its probability. The model is not checked.

    Parameters
    ----------
    goals, log, prior, drop, rename, strict
        As in `infer_goals`; suggestions in the log are used.
    method, jobs
        As in `fit`.
    progress : callable or bool, optional
        Receives progress reports, as `planner.system.progress` describes: the number of people who are finished.

    Raises
    ------
    LogError
        No part of the log can be used or, with `strict`, some part cannot.
    ValueError
        The tasks differ in more than their goals, a goal cannot be reached, or the prior is no distribution.

    Warns
    -----
    UserWarning
        Some lines cannot be used (`FittedPeople.faults`), or some states were not evaluated.
    """
    assert callable(progress)
    log, goals = log_of(log), costs_of_goals(goals)
    shares = prior_over(goals, prior)
    found = recorded(goals, log, drop=drop, rename=rename, strict=strict)
    if found.faults:
        others = f" (and {len(found.faults) - 1} more; see `faults`)" if len(found.faults) > 1 else ""
        warnings.warn(f"{log.name}:{found.faults[0].line}: {found.faults[0]}{others}", stacklevel=3)
    for note in found.notes:
        warnings.warn(f"{note}; actions that depend on them are left out", stacklevel=3)
    advance = adding(progress, "fitting people", len(found.recording.people))
    return learn_with_goals(log, found, tuple(goals), shares, method=method, jobs=jobs, progress=advance)


def learn_with_goals(
    log: Log,
    found: RecordedWithGoals,
    names: tuple[str, ...],
    prior: Floats,
    *,
    method: Method | None = None,
    jobs: int = 1,
    progress: Callable[[int], None] | None = None,
) -> FittedPeople:
    """Return what `fit_with_goals` does, from a replayed log.

    Parameters
    ----------
    log : Log
    found : RecordedWithGoals
    names : tuple of str
        Names of the goals.
    prior : float array, shape (G,)
    method, jobs
        As in `fit`.
    progress : callable, optional
        Called with the number of people who have been finished since the last call.
    """
    method = method or Method()
    observations = _observations(found, names, prior)
    method = replace(method, largest_beta=largest_beta(observations, method))
    fits = map(_with_likeliest, maximum_likelihood(observations, method, jobs=jobs, progress=progress))
    records = [PersonEstimate(one, UNCHECKED, left_out=found.left_out.get(one.observations.person, 0)) for one in fits]
    named = log.people | {fault.person for fault in found.faults if fault.person is not None}
    unknown = {
        person: nothing_known(person, "no action can be used", found.left_out.get(person, 0))
        for person in sorted(named - {o.person for o in observations}, key=in_order)
    }

    return FittedPeople(tuple(records), unknown, found.faults, method)


def _observations(found: RecordedWithGoals, names: tuple[str, ...], prior: Floats) -> list[Observations]:
    """Return the observations of each person, with each goal."""
    states = np.arange(found.h.shape[1])
    every = [
        # Plan lengths are not needed: they only concern which of several cheapest plans a person should prefer.
        observe(found.recording, EvaluatedStates(h, None), np.zeros(len(states), dtype=bool))
        for h in found.h
    ]
    return [
        replace(each[0], goals=UnknownGoals(names, prior, each, found.reached[:, found.recording.person == number]))
        for number, each in enumerate(zip(*every, strict=True))
    ]


def _with_likeliest(fit: Fit) -> Fit:
    """Return a fit in which the most probable goal of each episode decides what counts as a mistake."""
    o, goals = fit.observations, fit.observations.goals
    assert goals is not None
    likeliest = np.array([list(shares.values()) for shares in fit.goal_posteriors().values()]).argmax(axis=1)
    of_step, rows = likeliest[o.begins.cumsum() - 1], np.arange(len(o))
    chosen = {
        name: np.stack([getattr(each, name) for each in goals.each])[of_step, rows]
        for name in ("excess", "optimal", "ahead", "gain", "cost_to_go", "goal")
    }
    return replace(fit, observations=replace(o, **chosen))
