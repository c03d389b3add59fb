"""Values of one person's problem with an observed type and theta: of the best policy, and of a given one.

`value_iteration` improves upper bounds to the optimal values by policy iteration (`policy_iteration`). `evaluate`
computes the values of a policy that depends on x only. Their mean under a belief is the return of that policy, hence a
lower bound on the optimal value.
"""

from __future__ import annotations

import math
import time

import numpy as np

from planner.system.progress import Progress

from ..people.decision import Floats, Ints
from .action_values import BEST
from .policy_iteration import improve, rounding_error
from .pomdp import AssistPOMDP
from .problem_arrays import ProblemArrays
from .sparse_iteration import Limits, SparseBackup

ROUGH = 1e-4  # tolerance of values, in cost units, from which sweeps alone may be enough: those of leaves
MOST_SWEEPS = 10_000  # default limit of sweeps over all states; a dozen are enough in all tasks that were tried


def initial_upper_bounds(pomdp: AssistPOMDP) -> Floats:
    """Return upper bounds from which value iteration starts, shape (n, H, T); those of final states are their values.

    Costs are positive, so that 0 is an upper bound. In a dead end, each step costs at least the cheapest choice of any
    dead end, unless the frontier bounds there are higher.
    """
    choices, types = pomdp.model.choices, pomdp.hidden.goal_of
    value = np.zeros((len(choices), *pomdp.prior.shape))
    hopeless = np.isinf(choices.goals.h[types].T)  # the goal cannot be reached
    dead = hopeless & ~pomdp.final[types].T
    if dead.any():
        some = dead.any(axis=1)
        value[dead] = -choices.costs[some][choices.applicable[some]].min() / (1 - pomdp.gamma)
    if pomdp.frontier is not None:
        upper = np.broadcast_to(pomdp.frontier.upper, (len(pomdp.frontier.states), *pomdp.prior.shape))
        beyond = hopeless[pomdp.frontier.states]
        value[dead] = np.maximum(value[dead], upper[beyond].max(initial=-np.inf))
        value[pomdp.frontier.states] = upper
    return value


def value_iteration(
    pomdp: AssistPOMDP,
    value: Floats,
    *,
    tolerance: float,
    max_sweeps: int = MOST_SWEEPS,
    deadline: float = math.inf,
    progress: Progress | None = None,
    backup: SparseBackup | None = None,
) -> bool:
    """Improve values, shape (n, H, T), in place, as `policy_iteration.improve` says; return whether they converged.

    The values of final states do not change. The other arguments are as in `qmdp`; `backup` is that of the problem, if
    it is known.
    """
    action, limits = np.full(len(value), BEST), Limits(tolerance, max_sweeps, deadline)
    if backup is None and tolerance <= ROUGH:
        backup = SparseBackup.of_small(pomdp)
    return improve(value, regions(pomdp), action, ProblemArrays.of(pomdp), limits, progress, backup=backup)


def evaluate(
    pomdp: AssistPOMDP,
    action: Ints,
    *,
    tolerance: float = 1e-4,
    deadline: float = math.inf,
    max_sweeps: int | None = None,
    leaves: float | None = None,
) -> Floats:
    """Return the values of a policy that depends on x only, shape (n, H, T): exact or slightly too low.

    Parameters
    ----------
    pomdp : AssistPOMDP
    action : int array, shape (n,)
        Robot action in each state.
    tolerance : float
        Largest error of any value, in cost units, as in `qmdp`.
    deadline : float
        Time on the clock of `time.perf_counter()` after which no sweep begins. Values that have not converged by then
        are lower bounds.
    max_sweeps : int, optional
        Number of sweeps after which values that have not converged are returned; they are lower bounds.
    leaves : float, optional
        Value at the frontier; by default `frontier.lower`.

    Raises
    ------
    RuntimeError
        The values did not converge within `MOST_SWEEPS`, and no other limit ended the computation.
    """
    arrays, active = ProblemArrays.of(pomdp), ~pomdp.final[pomdp.hidden.goal_of].T
    # This is a lower bound: the largest cost in every step.
    worst = -(pomdp.robot_costs.max(initial=0.0) + pomdp.model.choices.costs.max(initial=0.0)) / (1 - pomdp.gamma)
    value = np.zeros((len(active), *pomdp.prior.shape))
    if pomdp.frontier is not None:
        there = pomdp.frontier.lower if leaves is None else np.asarray(leaves)
        worst = min(worst, there.min(initial=0.0))
    value[active] = worst
    if pomdp.frontier is not None:
        value[pomdp.frontier.states] = there
    limits = Limits(tolerance, max_sweeps or MOST_SWEEPS, deadline)
    backup = SparseBackup.of_small(pomdp)
    converged = improve(value, regions(pomdp), action, arrays, limits, below=True, backup=backup)
    if not converged and max_sweeps is None and time.perf_counter() < deadline:
        raise RuntimeError(f"a policy's values have not converged after {MOST_SWEEPS} sweeps")
    return value - np.where(active[:, :, None], rounding_error(value, arrays), 0.0)


def regions(pomdp: AssistPOMDP) -> list[tuple[Ints, Ints]]:
    """Return the dead ends of each goal and all other states that are not final, both in the order of a sweep."""
    found = []
    for goal, h in enumerate(pomdp.model.choices.goals.h):
        order = sweep_order(pomdp, goal)
        dead = np.isinf(h[order])
        found.append((order[dead], order[~dead]))
    return found


def sweep_order(pomdp: AssistPOMDP, goal: int) -> Ints:
    """Return the states in which the problem goes on for a goal; successors mostly precede their predecessors."""
    h = pomdp.model.choices.goals.h[goal]
    order = np.argsort(h, kind="stable") if pomdp.order is None else pomdp.order[goal]
    return order[~pomdp.final[goal, order]]
