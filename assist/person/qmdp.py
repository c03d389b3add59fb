"""Values of one person's problem where beta and theta are seen.

`qmdp` computes the best values by Gauss-Seidel value iteration in the order of h*, and returns the QMDP policy
(Littman, Cassandra and Kaelbling, "Learning policies for partially observable environments", 1995): act as
if the hidden pair were seen from the next step on. The person's own choices are a free stream of
information, so little is lost by this. Its values are an upper bound on what any policy can reach.

`evaluate` computes the values of a policy that looks only at x. Averaged over a belief they are what that
policy gets, hence a lower bound on the best.

Rounding: every sum here has fewer than a thousand terms of one sign, so that one step's relative error is
below 1000 times the unit roundoff, about 1e-13, and that of a value below 1e-13 / (1 - gamma).
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
from .pomdp import AssistPOMDP
from .problem_arrays import ProblemArrays, read_only

ROUNDING = 1e-12
"""Relative margin by which a bound is moved outwards in each step, ten times what rounding can do."""

EACH = np.int64(-1)  # a number, not a literal, for which numba would compile once more
DIRECT = 5_000  # states up to which linear equations are solved directly; beyond, a factorisation may fill the memory
MOST_SWEEPS = 100_000  # over all states, unless another number is given
SOLVING = "solving a person's POMDP: sweeps"
SECONDS_BETWEEN = 0.2  # two calls of `progress`, at least


@dataclass(frozen=True)
class QMDP:
    """The QMDP policy of one person's problem.

    Attributes
    ----------
    pomdp : AssistPOMDP
    value_mdp : float array, shape (n, B, T)
        Expected discounted return where beta and theta are seen, exact or slightly above.
    q_mdp : float array, shape (n, R, B, T)
        The same for each robot action in the first step; minus infinity in padding.
    """

    pomdp: AssistPOMDP
    value_mdp: Floats
    q_mdp: Floats

    __repr__ = outline

    def __post_init__(self) -> None:
        self.value_mdp.flags.writeable = False
        self.q_mdp.flags.writeable = False

    def q_values(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Give the expected return of each robot action, shape (N, R).

        Parameters
        ----------
        x : int array, shape (N,)
        belief : float array, shape (N, B, T)
        """
        q = np.full((len(x), self.q_mdp.shape[1]), -np.inf)
        x, flat = read_only(x, np.int64), read_only(belief, float).reshape(len(x), self.q_mdp[0, 0].size)
        _expected(q, x, flat, read_only(self._flat), read_only(self.pomdp.robot_actions))
        return q

    @cached_property
    def _flat(self) -> Floats:
        return self.q_mdp.reshape(*self.q_mdp.shape[:2], self.q_mdp[0, 0].size)

    def value(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Give the QMDP value, shape (N,): an upper bound on the return of any policy."""
        return np.einsum("nbt,nbt->n", self.value_mdp[x], belief)

    def choose(self, x: NDArray[np.int64], belief: Floats) -> NDArray[np.int64]:
        """Give the best robot action for each person, shape (N,); 0 is nothing, also on ties."""
        return self.q_values(x, belief).argmax(axis=1)


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
    """Compute the QMDP policy.

    Parameters
    ----------
    pomdp : AssistPOMDP
    above : float array, shape (n, B, T), optional
        Upper bounds from which to start.
    tolerance : float
        Largest error of any value, in cost units.
    max_sweeps : int
        Sweeps over all states at the most.
    deadline : float
        A time on `time.perf_counter()`'s clock after which no sweep begins. Every sweep leaves upper bounds, so that
        those that there are by then hold.
    progress : callable or bool, optional
        Who is told how far it is, as in `planner.system.progress`: how many sweeps have been done.

    Raises
    ------
    RuntimeError
        The values had not converged after `max_sweeps`.
    """
    assert callable(progress)
    progress(SOLVING, 0, None)
    value = highest(pomdp)
    if above is not None:
        value = np.minimum(value, above)
    converged = improve(pomdp, value, tolerance=tolerance, max_sweeps=max_sweeps, deadline=deadline, progress=progress)
    if not converged and time.perf_counter() < deadline:
        raise RuntimeError(f"value iteration has not converged after {max_sweeps} sweeps")
    return ahead(pomdp, value)


def load_compiled(pomdp: AssistPOMDP) -> None:
    """Have the code that `qmdp` needs loaded, or compiled, which takes seconds once after an installation."""
    arrays, nothing = ProblemArrays.of(pomdp), read_only(np.zeros(0, dtype=np.int64))
    value = np.zeros((0, 0, 0))
    _sweep(value, nothing, nothing, 0, arrays)
    _q_values(value[None], value, nothing, arrays)
    _backward(value, value, nothing, 0, arrays)


def highest(pomdp: AssistPOMDP) -> Floats:
    """Give upper bounds from which values are worked out, shape (n, B, T): those of final states are their values.

    Costs are positive, so that 0 is an upper bound, and remains one in every sweep; in a dead end each step to come
    costs at least what the cheapest choice in any of them does.
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


def improve(
    pomdp: AssistPOMDP,
    value: Floats,
    *,
    tolerance: float,
    max_sweeps: int = MOST_SWEEPS,
    deadline: float = math.inf,
    progress: Progress | None = None,
) -> bool:
    """Sweep over values, shape (n, B, T), in place, and tell whether they have converged; arguments as in `qmdp`.

    Those of final states stay as they are.
    """
    robot, arrays = np.full(len(value), -1), ProblemArrays.of(pomdp)
    return _converge(value, sweep_order(pomdp), robot, arrays, tolerance, max_sweeps, deadline, progress)


def ahead(pomdp: AssistPOMDP, value: Floats, states: NDArray[np.int64] | None = None) -> QMDP:
    """Look one step ahead: give the policy that takes values, shape (n, B, T), for what follows.

    Parameters
    ----------
    pomdp : AssistPOMDP
    value : float array, shape (n, B, T)
    states : int array, optional
        Where it will be asked; everywhere unless given.
    """
    order = sweep_order(pomdp) if states is None else states[~pomdp.final[states]]
    ends = np.flatnonzero(pomdp.final) if states is None else states[pomdp.final[states]]
    # Rows that are not asked about are never written to, and so take neither time nor memory.
    q = np.zeros((len(value), pomdp.suggested.shape[1], *value.shape[1:]))
    q[ends] = -np.inf
    q[ends, 0] = value[ends]
    _q_values(q, value, read_only(order), ProblemArrays.of(pomdp))
    return QMDP(pomdp, value, q)


def backward(pomdp: AssistPOMDP, value: Floats) -> Floats:
    """Give the values one step earlier, shape (n, B, T), of those that there are from the next step on.

    Those of final states stay as they are.
    """
    arrays, order, found = ProblemArrays.of(pomdp), read_only(sweep_order(pomdp)), value.copy()
    with ThreadPoolExecutor(processors()) as pool:
        list(pool.map(lambda b: _backward(found, value, order, b, arrays), range(value.shape[1])))
    return found


def evaluate(
    pomdp: AssistPOMDP, robot: NDArray[np.int64], *, tolerance: float = 1e-4, deadline: float = math.inf
) -> Floats:
    """Return the values of a policy that looks only at x, shape (n, B, T): exact or slightly below.

    Parameters
    ----------
    pomdp : AssistPOMDP
    robot : int array, shape (n,)
        What the robot does in each state.
    tolerance : float
        Largest error of any value, in cost units: gamma / (1 - gamma) times the last sweep's largest change.
    deadline : float
        A time on `time.perf_counter()`'s clock after which no sweep begins; what has not converged by then is below.
    """
    arrays = ProblemArrays.of(pomdp)
    active = ~pomdp.final
    silent = pomdp.frontier is None and not robot[active].any()
    if silent:  # then theta does not matter, and one value of it stands for all
        arrays = arrays._replace(theta=arrays.theta[:1])
    # Nothing costs more per step than the dearest choice after the dearest robot action: each sweep raises this.
    worst = -(pomdp.robot_costs.max(initial=0.0) + pomdp.model.choices.costs.max(initial=0.0)) / (1 - pomdp.gamma)
    if pomdp.frontier is not None:
        worst = min(worst, pomdp.frontier.lower.min(initial=0.0))
    value = np.zeros((len(active), len(pomdp.grid.beta), len(arrays.theta)))
    value[active] = worst
    if pomdp.frontier is not None:
        lower = pomdp.frontier.lower
        value[pomdp.frontier.states] = lower if lower.ndim == 3 else lower[:, None]
    if silent and active.sum() <= DIRECT:
        value[active] = _alone_for_ever(arrays, active)[:, :, None]
    converged = _converge(value, sweep_order(pomdp), robot, arrays, tolerance, MOST_SWEEPS, deadline)
    if not converged and time.perf_counter() < deadline:
        raise RuntimeError(f"a policy's values have not converged after {MOST_SWEEPS} sweeps")
    value[active] -= ROUNDING / (1 - pomdp.gamma) * np.abs(value[active])
    return np.repeat(value, pomdp.grid.shape[1], axis=2) if silent else value


def _alone_for_ever(m: ProblemArrays, active: NDArray[np.bool_]) -> Floats:
    """Give a start from below for `evaluate` where nothing is ever suggested, shape (active states, B).

    Linear equations, solved directly; sweeps take long where people go round in circles. What the solution v leaves
    over in one sweep, at most r, makes v - r / (1 - gamma) a start from which sweeps only rise.
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
    """Give the states of a problem in an order in which most of what can follow a state comes before it."""
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
    """Sweep until no value's error exceeds the tolerance, and tell whether that was reached.

    Each beta by itself, since some take much longer, and several at a time.
    """
    order, robot = read_only(order), read_only(robot)
    errors = np.full(value.shape[1], math.inf)
    last, done, stopped = time.perf_counter(), 0, False

    def one(b: int) -> bool:
        nonlocal last, done
        # What is swept over lies together, so that more of it stays in the processor's cache.
        left, own = sweeps, value[:, b : b + 1].copy()
        chosen, unsuggested = read_only(arrays.chosen[:, :, b : b + 1]), read_only(arrays.unsuggested[:, :, b : b + 1])
        m = arrays._replace(chosen=chosen, unsuggested=unsuggested)
        while errors[b] > tolerance and left and not stopped and (now := time.perf_counter()) < deadline:
            errors[b] = _sweep(own, order, robot, 0, m) * arrays.gamma / (1 - arrays.gamma)
            left, done = left - 1, done + 1
            if progress is not None and now > last + SECONDS_BETWEEN:
                last = now
                progress(SOLVING, done, None)
        value[:, b] = own[:, 0]
        return bool(errors[b] <= tolerance)

    with ThreadPoolExecutor(processors()) as pool:
        try:
            return all(list(pool.map(one, range(value.shape[1]))))  # all of them: one that fails cancels none
        except BaseException:  # after Ctrl-C no further sweep begins
            stopped = True
            raise


@njit()
def _alone(expected: Floats, mean: Floats, value: Floats, x: int, b: int, m: ProblemArrays) -> None:
    """Fill in, shape (T,), the person's mean return without a suggestion, and that of a uniform choice."""
    expected[:] = 0.0
    mean[:] = 0.0
    for a in range(m.counts[x]):
        y, c, p = m.targets[x, a], m.costs[x, a], m.chosen[x, a, b]
        for t in range(len(m.theta)):
            u = m.gamma * value[y, b, t] - c
            expected[t] += p * u
            mean[t] += u / m.counts[x]


@njit()
def _row(
    q: Floats, expected: Floats, mean: Floats, other: Floats, value: Floats, x: int, b: int, only: int, m: ProblemArrays
) -> None:
    """Fill `q`, shape (R, T), with the return of every robot action (or of `only` one) in state x for one beta.

    A suggestion moves theta alike whatever the person does, so that its returns are interpolated in the sums
    that `_alone` fills in, not action by action; where hardly anything but the suggestion is left of a sum, the
    others are summed anew, because a difference would lose its digits. `expected`, `mean` and `other`, shape
    (T,), are room for the sums.
    """
    at_hand = -1
    for r in range(m.robot_actions[x]):
        if only >= 0 and r != only:
            continue
        slot, place = m.suggested[x, r], m.afterstate[x, r]
        if m.goal[place]:
            q[r] = -m.robot_costs[x, r]
            continue
        if place != at_hand:
            _alone(expected, mean, value, place, b, m)
            at_hand = place
        if slot >= 0:
            y, c, p, rest = (
                m.targets[place, slot],
                m.costs[place, slot],
                m.chosen[place, slot, b],
                m.unsuggested[x, r, b],
            )
            if p > 0.9:
                other[:] = 0.0
                for a in range(m.counts[place]):
                    if a != slot:
                        for t in range(len(m.theta)):
                            u = m.gamma * value[m.targets[place, a], b, t] - m.costs[place, a]
                            other[t] += m.chosen[place, a, b] * u
            else:
                for t in range(len(m.theta)):
                    other[t] = expected[t] - p * (m.gamma * value[y, b, t] - c)
            for t in range(len(m.theta)):
                at, up, theta = m.low[x, r, t], m.weight[x, r, t], m.theta[t]
                followed = p * (m.gamma * ((1.0 - up) * value[y, b, at] + up * value[y, b, at + 1]) - c)
                others = (1.0 - up) * other[at] + up * other[at + 1]
                total = theta * p + (1.0 - theta) * rest
                e = (theta * followed + (1.0 - theta) * others) / total if total > 0.0 else followed + others
                lapsed = (1.0 - up) * mean[at] + up * mean[at + 1]
                q[r, t] = (1.0 - m.lapse) * e + m.lapse * lapsed - m.robot_costs[x, r]
        else:
            for t in range(len(m.theta)):
                q[r, t] = (1.0 - m.lapse) * expected[t] + m.lapse * mean[t] - m.robot_costs[x, r]


@njit(nogil=True)
def _sweep(value: Floats, order: NDArray[np.int64], robot: NDArray[np.int64], b: int, m: ProblemArrays) -> float:
    """Update every state once, in place; return the largest change. A negative `robot` stands for the best."""
    thetas = len(m.theta)
    q = np.empty((m.suggested.shape[1], thetas))
    expected, mean, other = np.empty(thetas), np.empty(thetas), np.empty(thetas)
    residual = 0.0
    for x in order:
        _row(q, expected, mean, other, value, x, b, robot[x], m)
        first, end = (robot[x], robot[x] + 1) if robot[x] >= 0 else (0, m.robot_actions[x])
        for t in range(thetas):
            best = q[first, t]
            for r in range(first + 1, end):
                best = max(best, q[r, t])
            residual = max(residual, abs(best - value[x, b, t]))
            value[x, b, t] = best
    return residual


@njit(nogil=True)
def _backward(found: Floats, value: Floats, order: NDArray[np.int64], b: int, m: ProblemArrays) -> None:
    """Fill in the best values of states, for one beta, given those of what follows."""
    thetas = len(m.theta)
    q = np.empty((m.suggested.shape[1], thetas))
    expected, mean, other = np.empty(thetas), np.empty(thetas), np.empty(thetas)
    for x in order:
        _row(q, expected, mean, other, value, x, b, EACH, m)
        for t in range(thetas):
            found[x, b, t] = q[0, t]
            for r in range(1, m.robot_actions[x]):
                found[x, b, t] = max(found[x, b, t], q[r, t])


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
    """Fill `q`, shape (n, R, B, T), with the return of every robot action; minus infinity in padding."""
    robots, thetas = q.shape[1], len(m.theta)
    row, expected, mean, other = np.empty((robots, thetas)), np.empty(thetas), np.empty(thetas), np.empty(thetas)
    for x in order:
        for b in range(value.shape[1]):
            _row(row, expected, mean, other, value, x, b, EACH, m)
            for r in range(robots):
                for t in range(thetas):
                    q[x, r, b, t] = row[r, t] if r < m.robot_actions[x] else -np.inf
