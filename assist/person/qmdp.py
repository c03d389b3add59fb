"""Values of one person's problem with observed beta and theta.

`qmdp` computes the optimal values by Gauss-Seidel value iteration in the order of h*. It returns the QMDP policy
(Littman, Cassandra and Kaelbling, "Learning policies for partially observable environments", 1995), which acts as if
the hidden pair were observed from the next step on. The person's choices are a free source of information, so that
little is lost. The values are an upper bound on the value of any policy.

`evaluate` computes the values of a policy that depends on x only. Their mean under a belief is the return of that
policy, hence a lower bound on the optimal value.

If the goal is hidden (`people.goals`), it counts as observed from the next step on, too.

Rounding: every sum here has fewer than a thousand terms, all of one sign. So the relative error of one step is below
1000 times the unit roundoff, about 1e-13, and that of a value below 1e-13 / (1 - gamma).
"""

from __future__ import annotations

import math
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sparse
import scipy.sparse.linalg as sparse_linalg
from numpy.typing import NDArray

from planner.system.arrays import outline
from planner.system.jit import njit
from planner.system.machine import processors
from planner.system.progress import Progress, Wanted, shows_progress

from ..people.decision import Floats
from ..people.goals import acting_belief
from .policy import Policy
from .pomdp import AssistPOMDP
from .problem_arrays import ProblemArrays, read_only

ROUNDING = 1e-12
"""Relative margin by which a bound is moved outwards in each step: ten times the largest rounding error of a step."""

BEST = np.int64(-1)  # in the place of a robot action: the best one; numba would compile again for a literal
MOST_SWEEPS = 100_000  # default limit of sweeps over all states; at gamma = 0.99 convergence takes a few thousand
SOLVING = "solving a person's POMDP: sweeps"


@dataclass(frozen=True)
class QMDP(Policy):
    """The QMDP policy of one person's problem.

    Attributes
    ----------
    pomdp : AssistPOMDP
    value_mdp : float array, shape (n, B, T)
        Optimal expected discounted return with observed beta and theta, exact or slightly too high, in cost units.
    q_mdp : float array, shape (n, R, B, T)
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
        belief : float array, shape (N, G * B, T)
        """
        choices = self.pomdp.model.choices
        return self.expected(choices.of_goals(x), acting_belief(choices, belief))

    def expected(self, rows: NDArray[np.int64], belief: Floats) -> Floats:
        """Return what `q_values` does, where `rows`, shape (G, N), are the rows of each goal."""
        q = np.full((rows.shape[1], self.q_mdp.shape[1]), -np.inf)
        flat = read_only(belief, float).reshape(rows.shape[1], len(rows), self.q_mdp[0, 0].size)
        for goal, x in enumerate(rows):
            own = q if goal == 0 else np.full_like(q, -np.inf)
            _expected(
                own, read_only(x, np.int64), read_only(flat[:, goal]), read_only(self._flat),
                read_only(self.pomdp.robot_actions),
            )  # fmt: skip
            if goal:
                q += own
        return q

    @cached_property
    def _flat(self) -> Floats:
        return self.q_mdp.reshape(*self.q_mdp.shape[:2], self.q_mdp[0, 0].size)

    def value(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Return the QMDP value, shape (N,): an upper bound on the value of any policy."""
        choices = self.pomdp.model.choices
        value = self.value_mdp[choices.of_goals(x).T]
        return np.einsum("nbt,nbt->n", value.reshape(belief.shape), belief)


@shows_progress
def qmdp(
    pomdp: AssistPOMDP,
    *,
    above: Floats | None = None,
    tolerance: float = 1e-6,
    max_sweeps: int = MOST_SWEEPS,
    deadline: float = math.inf,
    progress: Wanted = None,
) -> QMDP:
    """Compute the QMDP policy by value iteration.

    Parameters
    ----------
    pomdp : AssistPOMDP
    above : float array, shape (n, B, T), optional
        Upper bounds at which value iteration starts.
    tolerance : float
        Largest error of any value, in cost units.
    max_sweeps : int
        Largest number of sweeps over all states.
    deadline : float
        Time on the clock of `time.perf_counter()` after which no sweep begins. Every sweep maintains upper bounds, so
        that the values at the deadline are valid bounds.
    progress : callable or bool, optional
        Receives progress reports, as `planner.system.progress` describes: the number of sweeps.

    Raises
    ------
    RuntimeError
        The values did not converge within `max_sweeps`.
    """
    assert callable(progress)
    progress(SOLVING, 0, None)
    value = initial_upper_bounds(pomdp)
    if above is not None:
        value = np.minimum(value, above)
    converged = value_iteration(
        pomdp, value, tolerance=tolerance, max_sweeps=max_sweeps, deadline=deadline, progress=progress
    )
    if not converged and time.perf_counter() < deadline:
        raise RuntimeError(f"value iteration has not converged after {max_sweeps} sweeps")
    return look_ahead(pomdp, value)


def load_compiled(pomdp: AssistPOMDP) -> None:
    """Load, or compile, the code that `qmdp` needs. Compilation takes seconds, once after an installation."""
    arrays, nothing = ProblemArrays.of(pomdp), read_only(np.zeros(0, dtype=np.int64))
    value = np.zeros((0, 0, 0))
    _sweep(value, nothing, nothing, 0, arrays)
    _q_values(value[None], value, nothing, arrays)


def initial_upper_bounds(pomdp: AssistPOMDP) -> Floats:
    """Return upper bounds from which value iteration starts, shape (n, B, T); those of final states are their values.

    Costs are positive, so that 0 is an upper bound. It remains an upper bound in every sweep, since the Bellman
    operator is monotone. In a dead end, each step costs at least the cheapest choice of any dead end, unless the
    frontier bounds there are higher.
    """
    choices = pomdp.model.choices
    value = np.zeros((len(choices), *pomdp.grid.shape))
    dead = np.isinf(choices.h) & ~pomdp.final
    if dead.any():
        value[dead] = -choices.costs[dead][choices.applicable[dead]].min() / (1 - pomdp.gamma)
    if pomdp.frontier is not None:
        beyond = np.isinf(choices.h[pomdp.frontier.states])
        value[dead] = np.maximum(value[dead], pomdp.frontier.upper[beyond].max(initial=-np.inf))
        upper = pomdp.frontier.upper
        value[pomdp.frontier.states] = upper if upper.ndim == 3 else upper[:, None, None]
    return value


def value_iteration(
    pomdp: AssistPOMDP,
    value: Floats,
    *,
    tolerance: float,
    max_sweeps: int = MOST_SWEEPS,
    deadline: float = math.inf,
    progress: Progress | None = None,
) -> bool:
    """Run value iteration on values, shape (n, B, T), in place; return whether they converged. Arguments as in `qmdp`.

    The values of final states do not change.
    """
    robot, arrays = np.full(len(value), -1), ProblemArrays.of(pomdp)
    return _converge(value, sweep_order(pomdp), robot, arrays, tolerance, max_sweeps, deadline, progress)


def look_ahead(pomdp: AssistPOMDP, value: Floats, states: NDArray[np.int64] | None = None) -> QMDP:
    """Return the policy that is greedy with respect to values, shape (n, B, T), by one exact Bellman backup.

    Parameters
    ----------
    pomdp : AssistPOMDP
    value : float array, shape (n, B, T)
    states : int array, optional
        States in which the policy will be used; all by default.
    """
    order = sweep_order(pomdp) if states is None else states[~pomdp.final[states]]
    ends = np.flatnonzero(pomdp.final) if states is None else states[pomdp.final[states]]
    # Rows of other states are never written to, so that they take neither time nor physical memory.
    q = np.zeros((len(value), pomdp.suggested.shape[1], *value.shape[1:]))
    q[ends] = -np.inf
    q[ends, 0] = value[ends]
    if pomdp.model.choices.goal_count > 1:  # a suggestion after the goal costs, and does no more
        useless = np.arange(1, q.shape[1]) < pomdp.robot_actions[ends, None]
        q[ends, 1:] = np.where(useless, -pomdp.robot_costs[ends, 1:], -np.inf)[:, :, None, None]
        q[ends, 1:] += value[ends, None]
    _q_values(q, value, read_only(order), ProblemArrays.of(pomdp))
    return QMDP(pomdp, value, q)


def evaluate(
    pomdp: AssistPOMDP,
    robot: NDArray[np.int64],
    *,
    tolerance: float = 1e-4,
    deadline: float = math.inf,
    max_sweeps: int | None = None,
    max_equations: int = 5_000,
) -> Floats:
    """Return the values of a policy that depends on x only, shape (n, B, T): exact or slightly too low.

    Parameters
    ----------
    pomdp : AssistPOMDP
    robot : int array, shape (n,)
        Robot action in each state.
    tolerance : float
        Largest error of any value, in cost units. It is estimated as gamma / (1 - gamma) times the largest change in
        the last sweep.
    deadline : float
        Time on the clock of `time.perf_counter()` after which no sweep begins. Values that have not converged by then
        are lower bounds.
    max_sweeps : int, optional
        Number of sweeps after which values that have not converged are returned; they are lower bounds.
    max_equations : int
        Largest number of states for which the values without suggestions are the solution of linear equations. The
        factors of more may exhaust the memory.

    Raises
    ------
    RuntimeError
        The values did not converge within `MOST_SWEEPS`, and no other limit ended the computation.
    """
    arrays = ProblemArrays.of(pomdp)
    active = ~pomdp.final
    silent = pomdp.frontier is None and not robot[active].any()
    if silent:  # theta has no effect then, so that one value of theta stands for all
        arrays = arrays._replace(theta=arrays.theta[:1])
    # This is a lower bound: the largest cost in every step. So each sweep can only raise the values.
    worst = -(pomdp.robot_costs.max(initial=0.0) + pomdp.model.choices.costs.max(initial=0.0)) / (1 - pomdp.gamma)
    if pomdp.frontier is not None:
        worst = min(worst, pomdp.frontier.lower.min(initial=0.0))
    value = np.zeros((len(active), len(pomdp.grid.beta), len(arrays.theta)))
    value[active] = worst
    if pomdp.frontier is not None:
        lower = pomdp.frontier.lower
        value[pomdp.frontier.states] = lower if lower.ndim == 3 else lower[:, None]
    if silent and active.sum() <= max_equations:
        value[active] = _never_helped_values(arrays, active)[:, :, None]
    converged = _converge(value, sweep_order(pomdp), robot, arrays, tolerance, max_sweeps or MOST_SWEEPS, deadline)
    if not converged and max_sweeps is None and time.perf_counter() < deadline:
        raise RuntimeError(f"a policy's values have not converged after {MOST_SWEEPS} sweeps")
    value[active] -= ROUNDING / (1 - pomdp.gamma) * np.abs(value[active])
    return np.repeat(value, pomdp.grid.shape[1], axis=2) if silent else value


def _never_helped_values(m: ProblemArrays, active: NDArray[np.bool_]) -> Floats:
    """Return lower bounds for `evaluate` without any suggestion, shape (active states, B).

    The values solve linear equations. A direct solution is faster than sweeps where people move in circles for long.
    Let v be the computed solution, r its largest residual abs(T v - v), and d = r / (1 - gamma), where T is one sweep.
    Then T(v - d) >= T v - gamma d >= v - r - gamma d = v - d. So sweeps from v - d only rise. Twice d is subtracted, to
    cover the rounding of r.
    """
    states = np.flatnonzero(active)
    number = np.full(len(active), -1)
    number[states] = np.arange(len(states))
    row, slot = np.nonzero(np.arange(m.chosen.shape[1]) < m.counts[states][:, None])
    origin = states[row]
    to = number[m.targets[origin, slot]]
    value = np.empty((len(states), m.chosen.shape[2]))
    for b in range(value.shape[1]):
        p = (1.0 - m.lapse) * m.chosen[origin, slot, b] + m.lapse / m.counts[origin]
        cost = np.bincount(row, p * m.costs[origin, slot], len(states))
        goes_on = to >= 0
        chain = sparse.csc_array((p[goes_on], (row[goes_on], to[goes_on])), shape=(len(states), len(states)))
        exact = sparse_linalg.spsolve(sparse.eye_array(len(states), format="csc") - m.gamma * chain, -cost)
        left = np.abs(m.gamma * (chain @ exact) - cost - exact).max(initial=0.0)
        value[:, b] = exact - 2 * left / (1 - m.gamma)
    return value


def sweep_order(pomdp: AssistPOMDP) -> NDArray[np.int64]:
    """Return the states of a problem in an order in which successors mostly precede their predecessors."""
    if pomdp.order is not None:
        return pomdp.order
    states = np.flatnonzero(~pomdp.final)
    return states[np.argsort(pomdp.model.choices.h[states], kind="stable")]


def _converge(
    value: Floats,
    order: NDArray[np.int64],
    robot: NDArray[np.int64],
    arrays: ProblemArrays,
    tolerance: float,
    sweeps: int,
    deadline: float = math.inf,
    progress: Progress | None = None,
) -> bool:
    """Sweep until the error of every value is at most the tolerance; return whether this was reached.

    Each beta is swept separately, since the numbers of sweeps differ, and several threads work at once.
    """
    order, robot = read_only(order), read_only(robot)
    errors = np.full(value.shape[1], math.inf)
    last, done, stopped = time.perf_counter(), 0, False

    def one(b: int) -> bool:
        nonlocal last, done
        # Contiguous copies of one beta's arrays keep more of a sweep in the processor's cache.
        left, own = sweeps, value[:, b : b + 1].copy()
        chosen, unsuggested = read_only(arrays.chosen[:, :, b : b + 1]), read_only(arrays.unsuggested[:, :, b : b + 1])
        m = arrays._replace(chosen=chosen, unsuggested=unsuggested)
        while errors[b] > tolerance and left and not stopped and (now := time.perf_counter()) < deadline:
            errors[b] = _sweep(own, order, robot, 0, m) * arrays.gamma / (1 - arrays.gamma)
            left, done = left - 1, done + 1
            if progress is not None and now > last + 0.2:  # at most five reports per second
                last = now
                progress(SOLVING, done, None)
        value[:, b] = own[:, 0]
        return bool(errors[b] <= tolerance)

    with ThreadPoolExecutor(processors()) as pool:
        try:
            # the list makes all threads finish: one failure cancels no other
            return all(list(pool.map(one, range(value.shape[1]))))
        except BaseException:  # after Ctrl-C no further sweep begins
            stopped = True
            raise


@njit()
def _without_suggestion(expected: Floats, mean: Floats, value: Floats, x: int, b: int, m: ProblemArrays) -> None:
    """Fill in the expected return without a suggestion, and that of a uniform choice (a lapse), both of shape (T,)."""
    expected[:] = 0.0
    mean[:] = 0.0
    for a in range(m.counts[x]):
        y, c, p = m.targets[x, a], m.costs[x, a], m.chosen[x, a, b]
        for t in range(len(m.theta)):
            u = m.gamma * value[y, b, t] - c
            expected[t] += p * u
            mean[t] += u / m.counts[x]


# One function, since value iteration took 1.5 to 2 times as long with its inner loops in a function of their own.
@njit()
def action_values(
    q: Floats,
    expected: Floats,
    mean: Floats,
    declined: Floats,
    value: Floats,
    x: int,
    b: int,
    only: int,
    m: ProblemArrays,
) -> None:
    """Fill `q`, shape (R, T), with the Q-values of all robot actions (or of `only` one) in state x for one beta.

    The trust update after a suggestion is the same for all choices, or for all but the suggested one if the trust rule
    uses the answer. So the returns are interpolated in the sums that `_without_suggestion` fills in, and not for each
    choice. If the suggested choice is almost certain, the sum over the other choices is recomputed, because a
    difference would lose precision. `expected`, `mean` and `declined`, shape (T,), are work arrays.
    """
    computed = -1
    for r in range(m.robot_actions[x]):
        if only >= 0 and r != only:
            continue
        slot, acting = m.suggested[x, r], m.afterstate[x, r]
        if m.goal[acting]:
            q[r] = -m.robot_costs[x, r]
            continue
        if acting != computed:
            _without_suggestion(expected, mean, value, acting, b, m)
            computed = acting
        if slot >= 0:
            y, c, p, rest = (
                m.targets[acting, slot],
                m.costs[acting, slot],
                m.chosen[acting, slot, b],
                m.unsuggested[x, r, b],
            )
            small = p > 0.9  # whether the difference would lose precision
            if not small:
                for t in range(len(m.theta)):
                    declined[t] = expected[t] - p * (m.gamma * value[y, b, t] - c)
                    small |= abs(declined[t]) < 0.1 * abs(expected[t])
            if small:
                declined[:] = 0.0
                for a in range(m.counts[acting]):
                    if a != slot:
                        for t in range(len(m.theta)):
                            u = m.gamma * value[m.targets[acting, a], b, t] - m.costs[acting, a]
                            declined[t] += m.chosen[acting, a, b] * u
            for t in range(len(m.theta)):
                at, up, theta = m.low[x, r, t], m.weight[x, r, t], m.theta[t]
                followed = p * (m.gamma * ((1.0 - up) * value[y, b, at] + up * value[y, b, at + 1]) - c)
                expect_declined = (1.0 - up) * declined[at] + up * declined[at + 1]
                lapsed = (1.0 - up) * mean[at] + up * mean[at + 1]
                if m.uses_answer:  # the suggested slot has a trust update of its own
                    as_declined = m.gamma * ((1.0 - up) * value[y, b, at] + up * value[y, b, at + 1]) - c
                    at, up = m.followed_low[x, r, t], m.followed_weight[x, r, t]
                    as_followed = m.gamma * ((1.0 - up) * value[y, b, at] + up * value[y, b, at + 1]) - c
                    followed, lapsed = p * as_followed, lapsed + (as_followed - as_declined) / m.counts[acting]
                total = theta * p + (1.0 - theta) * rest
                e = (
                    (theta * followed + (1.0 - theta) * expect_declined) / total
                    if total > 0.0
                    else followed + expect_declined
                )
                q[r, t] = (1.0 - m.lapse) * e + m.lapse * lapsed - m.robot_costs[x, r]
        else:
            for t in range(len(m.theta)):
                q[r, t] = (1.0 - m.lapse) * expected[t] + m.lapse * mean[t] - m.robot_costs[x, r]


@njit(nogil=True)
def _sweep(value: Floats, order: NDArray[np.int64], robot: NDArray[np.int64], b: int, m: ProblemArrays) -> float:
    """Do a Bellman backup of every state, in place; return the largest change.

    A negative entry of `robot` stands for the best action.
    """
    thetas = len(m.theta)
    q = np.empty((m.suggested.shape[1], thetas))
    expected, mean, declined = np.empty(thetas), np.empty(thetas), np.empty(thetas)
    residual = 0.0
    for x in order:
        action_values(q, expected, mean, declined, value, x, b, robot[x], m)
        first, end = (robot[x], robot[x] + 1) if robot[x] >= 0 else (0, m.robot_actions[x])
        for t in range(thetas):
            best = q[first, t]
            for r in range(first + 1, end):
                best = max(best, q[r, t])
            residual = max(residual, abs(best - value[x, b, t]))
            value[x, b, t] = best
    return residual


@njit(nogil=True, fastmath={"reassoc", "contract"})
def _expected(q: Floats, x: NDArray[np.int64], belief: Floats, table: Floats, robots: NDArray[np.int64]) -> None:
    """Fill `q`, shape (N, R), with the expected entries of a table of shape (n, R, B * T)."""
    for i in range(len(x)):
        b = belief[i]
        for r in range(robots[x[i]]):
            row = table[x[i], r]
            total = 0.0
            for cell in range(len(b)):
                total += b[cell] * row[cell]
            q[i, r] = total


@njit()
def _q_values(q: Floats, value: Floats, order: NDArray[np.int64], m: ProblemArrays) -> None:
    """Fill `q`, shape (n, R, B, T), with the Q-values of all robot actions; minus infinity in padding."""
    robots, thetas = q.shape[1], len(m.theta)
    row, expected, mean, declined = np.empty((robots, thetas)), np.empty(thetas), np.empty(thetas), np.empty(thetas)
    for x in order:
        for b in range(value.shape[1]):
            action_values(row, expected, mean, declined, value, x, b, BEST, m)
            for r in range(robots):
                for t in range(thetas):
                    q[x, r, b, t] = row[r, t] if r < m.robot_actions[x] else -np.inf
