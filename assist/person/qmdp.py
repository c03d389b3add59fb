"""Values of one person's problem with an observed type and theta.

`qmdp` computes the optimal values by policy iteration (`policy_iteration`). It returns the QMDP policy (Littman,
Cassandra and Kaelbling, "Learning policies for partially observable environments", 1995), which acts as if what is
hidden, the type and theta, were observed from the next step on. The person's choices are a free source of information,
so that little is lost. The values are an upper bound on the value of any policy, up to rounding
(`policy_iteration.rounding_error`).

`evaluate` computes the values of a policy that depends on x only. Their mean under a belief is the return of that
policy, hence a lower bound on the optimal value.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.system.arrays import outline
from planner.system.jit import njit
from planner.system.limits import Deadline
from planner.system.progress import Progress, Wanted, shows_progress

from ..people.decision import Floats
from .action_values import BEST
from .policy import Policy
from .policy_iteration import SOLVING, Limits, improve, rounding_error, sweep
from .policy_iteration import load_compiled as load_iteration
from .pomdp import AssistPOMDP
from .problem_arrays import ProblemArrays, read_only
from .sparse_iteration import SparseBackup, is_small, q_table

COMPILED_FOR = "values of a large problem: about four seconds"

ROUGH = 1e-4  # tolerance of values, in cost units, from which sweeps alone may be enough: those of leaves
MOST_SWEEPS = 10_000  # default limit of sweeps over all states; a dozen are enough in all tasks that were tried


@dataclass(frozen=True)
class QMDP(Policy):
    """The QMDP policy of one person's problem.

    Attributes
    ----------
    pomdp : AssistPOMDP
    value_mdp : float array, shape (n, H, T)
        Optimal expected discounted return with observed type and theta, exact or slightly too high, in cost units.
    q_mdp : float array, shape (n, R, H, T)
        Q-values of the same problem; minus infinity in padding.
    """

    pomdp: AssistPOMDP
    value_mdp: Floats
    q_mdp: Floats

    __repr__ = outline

    def __post_init__(self) -> None:
        self.value_mdp.flags.writeable = False
        self.q_mdp.flags.writeable = False

    def q_values(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Return the expected Q-value of each robot action, shape (N, R).

        Parameters
        ----------
        x : int array, shape (N,)
        belief : float array, shape (N, H, T)
        """
        acting = self.pomdp.hidden.acting(belief)
        if is_small(self.pomdp):
            return _expected_of_few(self.q_mdp, self.pomdp.robot_actions, x, acting)
        return expected(self.q_mdp, self.pomdp.robot_actions, x, acting)

    def value(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Return the QMDP value, shape (N,): an upper bound on the value of any policy."""
        return np.einsum("nht,nht->n", self.value_mdp[x], belief)


def expected(table: Floats, robot_actions: NDArray[np.int64], x: NDArray[np.int64], belief: Floats) -> Floats:
    """Return the expected Q-value of each robot action, shape (N, R); minus infinity in padding.

    Parameters
    ----------
    table : float array, shape (n, R, H, T)
        Q-values with observed type and theta.
    robot_actions : int array, shape (n,)
        Number of robot actions in each state.
    x : int array, shape (N,)
    belief : float array, shape (N, H, T)
    """
    q, flat = np.full((len(x), table.shape[1]), -np.inf), table.reshape(*table.shape[:2], -1)
    _expected(
        q, read_only(x, np.int64), read_only(belief, float).reshape(len(x), -1), read_only(flat),
        read_only(robot_actions),
    )  # fmt: skip
    return q


def _expected_of_few(table: Floats, robot_actions: NDArray[np.int64], x: NDArray[np.int64], belief: Floats) -> Floats:
    """Return what `expected` does, in numpy, for small problems."""
    found, count = np.full((len(x), table.shape[1]), -np.inf), robot_actions[x]
    rows, cells = table.reshape(*table.shape[:2], -1), belief.reshape(len(x), -1)
    for r in range(table.shape[1]):
        own = np.flatnonzero(count > r)
        terms = rows[x[own], r]
        terms *= cells if len(own) == len(x) else cells[own]  # large copies take longer than the sums
        found[own, r] = terms.sum(axis=1)
    return found


@shows_progress
def qmdp(
    pomdp: AssistPOMDP,
    *,
    above: Floats | None = None,
    tolerance: float = 1e-6,
    max_sweeps: int = MOST_SWEEPS,
    time_limit: float | None = None,
    progress: Wanted = None,
) -> QMDP:
    """Compute the QMDP policy by policy iteration.

    Parameters
    ----------
    pomdp : AssistPOMDP
    above : float array, shape (n, H, T), optional
        Upper bounds at which the iteration starts.
    tolerance : float
        Largest error of any value, in cost units. Where values are so large that rounding makes larger errors, these
        count.
    max_sweeps : int
        Largest number of sweeps over all states.
    time_limit : float, optional
        Seconds after which no sweep begins. The policy is then that of the values so far, which are upper bounds, too.
    progress : callable or bool, optional
        Receives progress reports, as `planner.system.progress` describes: the number of sweeps.

    Raises
    ------
    RuntimeError
        The values did not converge within `max_sweeps`.
    """
    assert callable(progress)
    progress(SOLVING, 0, None)
    ends = Deadline.after(time_limit)
    deadline = time.perf_counter() + ends.at - time.monotonic()
    value = initial_upper_bounds(pomdp)
    if above is not None:
        value = np.minimum(value, above)
    backup = SparseBackup.of_small(pomdp)
    converged = value_iteration(
        pomdp, value, tolerance=tolerance, max_sweeps=max_sweeps, deadline=deadline, progress=progress, backup=backup
    )
    if not converged and time.perf_counter() < deadline:
        raise RuntimeError(f"policy iteration has not converged after {max_sweeps} sweeps")
    return look_ahead(pomdp, value, backup=backup)


def load_compiled(pomdp: AssistPOMDP) -> None:
    """Load, or compile, the code that `qmdp` needs. Compilation takes seconds, once after an installation."""
    if not is_small(pomdp):
        load_iteration(ProblemArrays.of(pomdp))


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
    robot, limits = np.full(len(value), BEST), Limits(tolerance, max_sweeps, deadline)
    if backup is None and tolerance <= ROUGH:
        backup = SparseBackup.of_small(pomdp)
    return improve(value, regions(pomdp), robot, ProblemArrays.of(pomdp), limits, progress, backup=backup)


def look_ahead(
    pomdp: AssistPOMDP, value: Floats, states: NDArray[np.int64] | None = None, backup: SparseBackup | None = None
) -> QMDP:
    """Return the policy that is greedy with respect to values, shape (n, H, T), by one exact Bellman backup.

    Parameters
    ----------
    pomdp : AssistPOMDP
    value : float array, shape (n, H, T)
    states : int array, optional
        States in which the policy will be used; all by default.
    backup : SparseBackup, optional
        That of the problem, if it is known; a small problem needs it.
    """
    asked = read_only(np.arange(len(value)) if states is None else states, np.int64)
    best, policy = read_only(np.full(len(value), BEST)), np.zeros((len(value), value.shape[2]), dtype=np.int32)
    backup, arrays = backup or SparseBackup.of_small(pomdp), ProblemArrays.of(pomdp)
    if backup is not None:
        return QMDP(pomdp, value, q_table(value, asked, backup, arrays.suggested.shape[1]))
    # Rows of other states are never written to, so that they take neither time nor physical memory.
    q = np.zeros((len(value), pomdp.suggested.shape[1], *value.shape[1:]))
    own = value if value.flags.writeable else value.copy()  # the same compiled code may also replace values
    for h in range(value.shape[1]):
        sweep(own, asked, np.int64(h), best, policy, q, arrays)
    return QMDP(pomdp, value, q)


def evaluate(
    pomdp: AssistPOMDP,
    robot: NDArray[np.int64],
    *,
    tolerance: float = 1e-4,
    deadline: float = math.inf,
    max_sweeps: int | None = None,
) -> Floats:
    """Return the values of a policy that depends on x only, shape (n, H, T): exact or slightly too low.

    Parameters
    ----------
    pomdp : AssistPOMDP
    robot : int array, shape (n,)
        Robot action in each state.
    tolerance : float
        Largest error of any value, in cost units, as in `qmdp`.
    deadline : float
        Time on the clock of `time.perf_counter()` after which no sweep begins. Values that have not converged by then
        are lower bounds.
    max_sweeps : int, optional
        Number of sweeps after which values that have not converged are returned; they are lower bounds.

    Raises
    ------
    RuntimeError
        The values did not converge within `MOST_SWEEPS`, and no other limit ended the computation.
    """
    arrays, active = ProblemArrays.of(pomdp), ~pomdp.final[pomdp.hidden.goal_of].T
    # This is a lower bound: the largest cost in every step.
    worst = -(pomdp.robot_costs.max(initial=0.0) + pomdp.model.choices.costs.max(initial=0.0)) / (1 - pomdp.gamma)
    if pomdp.frontier is not None:
        worst = min(worst, pomdp.frontier.lower.min(initial=0.0))
    value = np.zeros((len(active), *pomdp.prior.shape))
    value[active] = worst
    if pomdp.frontier is not None:
        value[pomdp.frontier.states] = pomdp.frontier.lower
    limits = Limits(tolerance, max_sweeps or MOST_SWEEPS, deadline)
    backup = SparseBackup.of_small(pomdp)
    converged = improve(value, regions(pomdp), robot, arrays, limits, below=True, backup=backup)
    if not converged and max_sweeps is None and time.perf_counter() < deadline:
        raise RuntimeError(f"a policy's values have not converged after {MOST_SWEEPS} sweeps")
    return value - np.where(active[:, :, None], rounding_error(value, arrays), 0.0)


def regions(pomdp: AssistPOMDP) -> list[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Return the dead ends of each goal and all other states that are not final, both in the order of a sweep."""
    found = []
    for goal, h in enumerate(pomdp.model.choices.goals.h):
        order = sweep_order(pomdp, goal)
        dead = np.isinf(h[order])
        found.append((order[dead], order[~dead]))
    return found


def sweep_order(pomdp: AssistPOMDP, goal: int) -> NDArray[np.int64]:
    """Return the states in which the problem goes on for a goal; successors mostly precede their predecessors."""
    h = pomdp.model.choices.goals.h[goal]
    order = np.argsort(h, kind="stable") if pomdp.order is None else pomdp.order[goal]
    return order[~pomdp.final[goal, order]]


@njit(nogil=True, fastmath={"reassoc", "contract"})
def _expected(q: Floats, x: NDArray[np.int64], belief: Floats, table: Floats, robots: NDArray[np.int64]) -> None:
    """Fill `q`, shape (N, R), with the expected entries of a table of shape (n, R, H * T)."""
    for i in range(len(x)):
        b = belief[i]
        for r in range(robots[x[i]]):
            row = table[x[i], r]
            total = 0.0
            for cell in range(len(b)):
                total += b[cell] * row[cell]
            q[i, r] = total
