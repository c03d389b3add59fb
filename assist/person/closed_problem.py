"""One person's problem on a truncated task, with bounds at its frontier that hold for the whole task."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..people.arguments import check_costs
from ..people.choice_model import boltzmann, value
from ..people.choices import WAIT
from ..people.decision import Floats, Ints
from .assumptions import Assumptions
from .pomdp import AssistPOMDP
from .state_cache import StateCache
from .truncated_task import TruncatedTask


def closed_problem(region: TruncatedTask, assumed: Assumptions | None = None) -> AssistPOMDP:
    """Return a person's problem on a truncated task, with proven bounds at the frontier.

    The lower bounds are those of `TruncatedTask.bounds` for people who choose by equation 5, if their misconceptions
    are unknown. For others they are those of the worst case (`TruncatedTask.bounds_of_anybody`).

    Parameters
    ----------
    region : TruncatedTask
    assumed : Assumptions, optional
        Of the person; by default those of the paper. A choice model has to be local: it may depend on the choices in a
        state and on their successors, but not on states further away.

    Raises
    ------
    ValueError
        A number is out of its range.
    """
    assumed = assumed or Assumptions()
    check_costs(assumed.gamma)
    region = region.for_robot(assumed.robot)
    if assumed.human is None and assumed.chooses is boltzmann:
        beyond = region.bounds(assumed)
    else:
        beyond = region.bounds_of_anybody(assumed)
    return assumed.problem(region.choices, replace(beyond, value=value_beyond(region, assumed)))


def value_beyond(region: TruncatedTask, assumed: Assumptions) -> Floats | None:
    """Return V(x) of equation 7 at the frontier for each goal, shape (m, G); None if it is minus the cost-to-go.

    It is computed from the choices in the whole task, where a suggestion may lead there.
    """
    if assumed.human is None and not hasattr(assumed.chooses, "value"):
        return None
    choices = region.choices
    best = choices.optimal if choices.offered is None else choices.offered
    advised = best if assumed.suggestions == "optimal" else choices.applicable & (choices.actions != WAIT)
    at = np.flatnonzero(np.isin(region.frontier, choices.targets[advised]))
    found = -choices.goals.h[:, region.frontier].T
    if len(at):
        found[at] = _expected(region, region.states[region.frontier[at]], assumed)
    return found


def _expected(region: TruncatedTask, states: Ints, assumed: Assumptions) -> Floats:
    """Return V(x) in some states of the whole task for each goal, shape (N, G)."""
    model = assumed.model(TruncatedTask.around(StateCache(region.known), states).choices)
    each = [value(assumed.chooses, choices, q) for choices, q in model.of_each_goal]
    return np.stack(each, axis=1)[: len(states)]
