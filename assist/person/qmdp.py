"""The QMDP policy of one person's problem: it acts on the values with an observed type and theta.

`qmdp` computes the optimal values by policy iteration (`mdp_values`). It returns the QMDP policy (Littman,
Cassandra and Kaelbling, "Learning policies for partially observable environments", 1995), which acts as if what is
hidden, the type and theta, were observed from the next step on. The person's choices are a free source of information,
so that little is lost. The values are an upper bound on the value of any policy, up to rounding
(`policy_iteration.rounding_error`).
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from planner.system.arrays import outline
from planner.system.limits import Deadline
from planner.system.progress import Wanted, shows_progress

from ..people.decision import Floats, Ints
from .action_values import BEST
from .expected_values import expected, expected_of_few
from .mdp_values import MOST_SWEEPS, initial_upper_bounds, value_iteration
from .policy import Policy
from .policy_iteration import SOLVING, sweep
from .policy_iteration import load_compiled as load_iteration
from .pomdp import AssistPOMDP
from .problem_arrays import ProblemArrays, read_only
from .sparse_iteration import SparseBackup, is_small, q_table

COMPILED_FOR = "values of a large problem: about four seconds"


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

    def q_values(self, x: Ints, belief: Floats) -> Floats:
        """Return the expected Q-value of each robot action, shape (N, R).

        Parameters
        ----------
        x : int array, shape (N,)
        belief : float array, shape (N, H, T)
        """
        weighed = self.pomdp.hidden.acted_on(belief)
        if is_small(self.pomdp):
            return expected_of_few(self.q_mdp, self.pomdp.robot_actions, x, weighed)
        return expected(self.q_mdp, self.pomdp.robot_actions, x, weighed)

    def value(self, x: Ints, belief: Floats) -> Floats:
        """Return the QMDP value, shape (N,): an upper bound on the value of any policy."""
        return np.einsum("nht,nht->n", self.value_mdp[x], belief)


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


def look_ahead(
    pomdp: AssistPOMDP, value: Floats, states: Ints | None = None, backup: SparseBackup | None = None
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
