"""Values of a person's problem with observed beta and theta, by policy iteration on sparse matrices.

`improve` solves a problem region by region: first the dead ends, from which no goal can be reached, then all other
states. Two steps alternate in a region.

- A *sweep* replaces the value of every state by its Bellman backup, in place, and notes the best robot action of each
  state and theta (Gauss-Seidel value iteration, in the order of h*).
- The *values of this policy* solve sparse linear equations. They are found by Gauss-Seidel sweeps over the matrix, and
  where these are slow by a Krylov method (BiCGSTAB: van der Vorst, 1992) with such a sweep as its preconditioner.

In a dead end, nothing ends, and mostly no suggestion is worth its cost. So the region starts with the policy that does
nothing. Theta has no effect on it: its equations have one unknown for each state. A sweep then confirms that nothing is
better, or begins the iteration.

Bounds. For one beta, let T be the Bellman operator on a region, or that of one policy, where all other states have
fixed values. It is monotone, and T(v + d) <= T(v) + gamma d for every number d >= 0. Values never exceed 0.

Claim. Let v be any values, w the result of one sweep that starts at v, r = max(0, max(w - v)) its largest rise, and e
the largest rounding error of one backup. Then u = w + c is an upper bound on the fixed point of T, where
c = (gamma r + e) / (1 - gamma).

Proof. The sweep computes w(x), up to e, as the backup of values v' that are those of w where the sweep has been and
those of v elsewhere. Either way w <= v' + r. So T(u)(x) <= T(v')(x) + gamma (r + c) <= w(x) + e + gamma r + gamma c
= w(x) + (1 - gamma) c + gamma c = u(x). An operator that is monotone and a contraction lowers u, step by step, to its
fixed point, which is therefore at most u.

In the same way w - (gamma f + e) / (1 - gamma) is a lower bound, where f is the largest fall. The error of one backup
is at most `rounding` times its absolute value. So e = rounding(N) max(abs(w)), where N is the largest number of choices
(`rounding_error`); users of the bounds add this part. Nothing is assumed about v: it may come from an inexact solution
of the equations, or from a Krylov method that has failed. Before the first solution of equations, v are the bounds at
the start or sweeps from them. Then w are bounds without c, as T is monotone.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.sparse.linalg as sparse_linalg
from numpy.typing import NDArray

from planner.system.jit import njit
from planner.system.machine import processors
from planner.system.progress import Progress

from ..people.decision import Floats
from .action_values import action_values
from .problem_arrays import ProblemArrays, read_only
from .rounding import rounding

Ints = NDArray[np.int64]

SOLVING = "solving a person's POMDP: sweeps"

MOST_ENTRIES = 20_000_000
"""Largest number of entries of a policy's matrix, at 12 bytes each. Problems with more are swept only."""

FEW_SWEEPS = 20  # over a region, after which equations are solved rarely; a dozen are enough almost everywhere
PLAIN_SWEEPS = 12  # sweeps over a policy's matrix before a Krylov method takes over: they converge fast, or slowly
ONLY = np.int64(0)  # the place of the only beta; numba would compile again for a literal
KRYLOV_STEPS = 200  # of two products each; 20 to 60 converge in all tasks that were tried


@dataclass(frozen=True)
class Limits:
    """When value iteration ends.

    Attributes
    ----------
    tolerance : float
        Largest error of any value, in cost units. Where rounding makes larger errors, these count.
    sweeps : int
        Largest number of sweeps over each region.
    deadline : float
        Time on the clock of `time.perf_counter()` after which no sweep begins.
    """

    tolerance: float
    sweeps: int
    deadline: float = math.inf


def improve(
    value: Floats,
    regions: tuple[Ints, ...],
    robot: Ints,
    arrays: ProblemArrays,
    limits: Limits,
    progress: Progress | None = None,
    *,
    below: bool = False,
) -> bool:
    """Replace values, shape (n, B, T), by those of the best policy or of a given one; return whether they converged.

    They are upper bounds, or lower ones with `below`, if the values at the start were. That is so, too, if a limit ends
    the iteration.

    Parameters
    ----------
    value : float array, shape (n, B, T)
    regions : tuple of int arrays
        States in the order of a sweep: the dead ends, and all other states that are not final.
    robot : int array, shape (n,)
        Robot action in each state; `BEST` stands for the best one.
    arrays : ProblemArrays
    limits : Limits
    progress : callable, optional
        Receives the number of sweeps at most five times a second.
    below : bool
        Whether lower bounds are wanted, of the policy `robot`.
    """
    last, swept, stopped = time.perf_counter(), 0, False

    def stop() -> bool:
        return stopped or time.perf_counter() >= limits.deadline

    def count() -> None:
        nonlocal last, swept
        swept += 1
        if progress is not None and (now := time.perf_counter()) > last + 0.2:
            last = now
            progress(SOLVING, swept, None)

    def one(b: int) -> bool:
        # Contiguous copies of one beta's arrays keep more of a sweep in the processor's cache.
        own = value[:, b : b + 1].copy()
        chosen, unsuggested = read_only(arrays.chosen[:, :, b : b + 1]), read_only(arrays.unsuggested[:, :, b : b + 1])
        m = arrays._replace(chosen=chosen, unsuggested=unsuggested)
        dead, alive = regions
        done = True
        for order, begin in ((dead, True), (alive, False)):
            region = _Region(own, read_only(order, np.int64), read_only(robot, np.int64), m, limits, stop, count, below)
            done = region.iterate(begin) and done
        value[:, b] = own[:, 0]
        return done

    with ThreadPoolExecutor(processors()) as pool:
        try:
            # the list makes all threads finish: one failure cancels no other
            return all(list(pool.map(one, range(value.shape[1]))))
        except BaseException:  # after Ctrl-C no further sweep begins
            stopped = True
            raise


def load_compiled(arrays: ProblemArrays) -> None:
    """Load, or compile, the code that `improve` needs."""
    value, nothing = np.zeros((0, 1, len(arrays.theta))), read_only(np.zeros(0, dtype=np.int64))
    place, policy, entries = np.zeros(0, np.int32), np.zeros((0, len(arrays.theta)), np.int32), np.zeros(0)
    rows = _Rows(np.zeros(1, np.int64), place, entries, entries)
    _sweep(value, nothing, nothing, policy, arrays)
    _fill_rows(rows, nothing, place, policy, value, arrays)
    _matrix_sweep(entries, rows)


def rounding_error(value: Floats, arrays: ProblemArrays) -> Floats:
    """Return how far rounding may move the values of a fixed point, shape (n, B, T), for each beta: shape (B, 1).

    This is e / (1 - gamma) of the module's theorem.
    """
    largest = np.abs(value).max(axis=(0, 2), initial=0.0)[:, None]
    return np.asarray(rounding(arrays.targets.shape[1]) / (1 - arrays.gamma) * largest)


@dataclass(frozen=True)
class _Region:
    """The iteration on one region for one beta; `value`, shape (n, 1, T), holds bounds and receives better ones."""

    value: Floats
    order: Ints
    robot: Ints
    m: ProblemArrays
    limits: Limits
    stop: Callable[[], bool]
    count: Callable[[], None]
    below: bool

    def iterate(self, silent_first: bool) -> bool:
        """Iterate and return whether the values converged; begin with doing nothing if `silent_first`."""
        m, order, tolerance = self.m, self.order, self.limits.tolerance
        if not len(order):
            return True
        horizon, least = m.gamma / (1 - m.gamma), rounding(m.targets.shape[1]) / (1 - m.gamma)
        found, policy = self.value.copy(), np.zeros((len(self.value), len(m.theta)), dtype=np.int32)
        asked, solved = self.robot[order], False
        if not asked.any() or (silent_first and bool((asked < 0).all())):
            dearest = float(m.costs[order].max() + m.robot_costs[order, 0].max())
            solved = self._follow(found, policy, self._precise(dearest / (1 - m.gamma)))
        before, settled = math.inf, False
        for number in range(self.limits.sweeps):
            if self.stop():
                return False
            # Where rounding makes the equations less precise than a sweep, sweeps alone go on, for longer each time.
            late = number >= FEW_SWEEPS
            rise, fall, changed = _sweep(found, order, self.robot, policy, m)
            self.count()
            off = 0.0 if not solved else fall if self.below else rise
            change = max(rise, fall)
            bound = found[order] + (-horizon if self.below else horizon) * off
            scale = float(np.abs(bound).max())
            error = horizon * (off + change)
            # Bounds that are moved outwards by little are also good values; equations are solved that precisely.
            near = horizon * (100 * off + change) <= tolerance
            if near or ((settled or late) and error <= max(tolerance, least * scale)):
                self.value[order] = bound
                return True
            self.value[order] = (np.maximum if self.below else np.minimum)(self.value[order], bound)
            slow = change > 0.1 * before and (not late or number.bit_count() == 1)
            if slow:  # otherwise sweeps alone are fast
                precise = self._precise(scale)
                goal = max(0.05 * change, precise) if changed else precise
                followed = self._follow(found, policy, goal)
                solved, settled = solved or followed, not followed or goal == precise
            before = change
        return False

    def _precise(self, scale: float) -> float:
        """Return the largest change of a sweep over values that have converged, given the largest absolute value."""
        return max(1e-4 * self.limits.tolerance * (1 - self.m.gamma), 1e-14 * scale)

    def _follow(self, found: Floats, policy: NDArray[np.int32], goal: float) -> bool:
        """Replace the region's values by those of a policy, up to a change of `goal` in a sweep over its matrix.

        Return False, and do nothing, if the matrix would be too large.
        """
        order, m, chosen = self.order, self.m, policy[self.order]
        outside = np.ones(len(found), dtype=bool)
        outside[order] = False
        if not chosen.any() and not np.ptp(found[outside], axis=2).any():
            m, chosen = m._replace(theta=m.theta[:1]), chosen[:, :1]  # theta has no effect
        entries = m.counts[m.afterstate[order[:, None], chosen]].sum() * (2 if chosen.any() else 1)
        if entries > MOST_ENTRIES:
            return False
        place = np.full(len(found), -1, dtype=np.int32)
        place[order] = np.arange(len(order))
        size = chosen.size
        rows = _Rows(np.empty(size + 1, np.int64), np.empty(entries, np.int32), np.empty(entries), np.empty(size))
        _fill_rows(rows, order, place, np.ascontiguousarray(chosen), found, m)
        value = np.ascontiguousarray(found[order, 0, : chosen.shape[1]]).reshape(-1)
        found[order, 0] = _solved(value, rows, goal, self.stop).reshape(chosen.shape)
        return True


class _Rows(NamedTuple):
    """The equations v = P v + constant of a policy in compressed sparse rows; P includes gamma.

    The entries of row i are `share[first[i] : first[i + 1]]`, in the columns `column[first[i] : first[i + 1]]`.
    """

    first: Ints
    column: NDArray[np.int32]
    share: Floats
    constant: Floats


class _StoppedError(Exception):
    """A limit has ended the solution of equations."""


def _solved(value: Floats, rows: _Rows, goal: float, stop: Callable[[], bool]) -> Floats:
    """Return an approximate solution of the equations from a first one: a sweep changes it by `goal` at most.

    The change is larger if time is over, or if no method converges.
    """
    homogeneous = rows._replace(constant=np.zeros(len(value)))

    def product(step: Floats) -> Floats:
        if stop():
            raise _StoppedError
        swept = step.copy()
        _matrix_sweep(swept, homogeneous)
        return step - swept

    operator = sparse_linalg.LinearOperator((len(value), len(value)), matvec=product, dtype=float)
    for _ in range(3):
        for _ in range(PLAIN_SWEEPS):
            change = _matrix_sweep(value, rows)
            if change <= goal or stop():
                return value
        swept = value.copy()
        change = _matrix_sweep(swept, rows)
        try:
            step, _ = sparse_linalg.bicgstab(
                operator, swept - value, rtol=0.0, atol=0.1 * goal * math.sqrt(len(value)), maxiter=KRYLOV_STEPS
            )
        except _StoppedError:
            return swept
        tried = value + step
        value = tried if _matrix_sweep(tried, rows) < change else swept
    return value


@njit(nogil=True)
def _sweep(
    value: Floats, order: Ints, robot: Ints, policy: NDArray[np.int32], m: ProblemArrays
) -> tuple[float, float, int]:
    """Do a Bellman backup of every state, in place; `policy`, shape (n, T), receives the robot actions.

    Return the largest rise and the largest fall of a value, and the number of changes of the policy. A negative entry
    of `robot` stands for the best action. Actions that are equal up to rounding do not change the policy.
    """
    thetas, least = len(m.theta), rounding(m.targets.shape[1])
    q = np.empty((m.suggested.shape[1], thetas))
    expected, mean, declined = np.empty(thetas), np.empty(thetas), np.empty(thetas)
    rise, fall, changed = 0.0, 0.0, 0
    for x in order:
        action_values(q, expected, mean, declined, value, x, ONLY, robot[x], m)
        first, end = (robot[x], robot[x] + 1) if robot[x] >= 0 else (0, m.robot_actions[x])
        for t in range(thetas):
            best, which = q[first, t], first
            for r in range(first + 1, end):
                if q[r, t] > best:
                    best, which = q[r, t], r
            now = policy[x, t]
            if which != now and not (first <= now < end and q[now, t] >= best - least * abs(best)):
                policy[x, t] = which
                changed += 1
            rise, fall = max(rise, best - value[x, 0, t]), max(fall, value[x, 0, t] - best)
            value[x, 0, t] = best
    return rise, fall, changed


@njit(nogil=True)
def _matrix_sweep(value: Floats, rows: _Rows) -> float:
    """Do a Gauss-Seidel sweep over the equations of a policy, in place; return the largest change."""
    change = 0.0
    for i in range(len(value)):
        total = rows.constant[i]
        for k in range(rows.first[i], rows.first[i + 1]):
            total += rows.share[k] * value[rows.column[k]]
        change = max(change, abs(total - value[i]))
        value[i] = total
    return change


@njit(nogil=True)
def _fill_rows(
    rows: _Rows, order: Ints, place: NDArray[np.int32], policy: NDArray[np.int32], value: Floats, m: ProblemArrays
) -> None:
    """Fill in the equations of a policy, shape (len(order), T): one for each state of the order and theta.

    `place` is the index of each state in the order; -1 stands for states with fixed values, which become constants.
    """
    thetas, k = policy.shape[1], 0
    for i in range(len(order)):
        x = order[i]
        for t in range(thetas):
            r, row = policy[i, t], i * thetas + t
            acting, slot = m.afterstate[x, r], m.suggested[x, r]
            rows.first[row] = k
            constant = -m.robot_costs[x, r]
            count = 0 if m.goal[acting] else m.counts[acting]
            followed, declined = 1.0, 1.0  # factors of the choice probabilities (equation 6)
            if slot >= 0:
                total = m.theta[t] * m.chosen[acting, slot, 0] + (1.0 - m.theta[t]) * m.unsuggested[x, r, 0]
                if total > 0.0:
                    followed, declined = m.theta[t] / total, (1.0 - m.theta[t]) / total
            for a in range(count):
                p = (1.0 - m.lapse) * m.chosen[acting, a, 0] * (followed if a == slot else declined) + m.lapse / count
                constant -= p * m.costs[acting, a]
                at, up = t, 0.0
                if slot >= 0 and a == slot:
                    at, up = m.followed_low[x, r, t], m.followed_weight[x, r, t]
                elif slot >= 0:
                    at, up = m.low[x, r, t], m.weight[x, r, t]
                y, p = m.targets[acting, a], m.gamma * p
                if place[y] < 0:
                    constant += p * (1.0 - up) * value[y, 0, at]
                    if up > 0.0:
                        constant += p * up * value[y, 0, at + 1]
                    continue
                rows.column[k], rows.share[k] = place[y] * thetas + at, p * (1.0 - up)
                k += 1
                if up > 0.0:
                    rows.column[k], rows.share[k] = place[y] * thetas + at + 1, p * up
                    k += 1
            rows.constant[row] = constant
    rows.first[len(order) * thetas] = k
