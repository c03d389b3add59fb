"""Values of a person's problem with an observed type and theta, by policy iteration on sparse matrices.

`improve` solves a problem for each type, region by region: first the dead ends, from which the goal cannot be reached,
then all other states. In a region, two steps alternate.

- The *values of a policy* solve sparse linear equations. They are found by Gauss-Seidel sweeps over the equations, and
  where these are slow by a Krylov method (BiCGSTAB: van der Vorst, 1992) with such a sweep as its preconditioner.
- A *sweep* replaces the value of every state by its Bellman backup, in place, in the order of h*. It notes the best
  robot action of each state and theta: the next policy.

The first policy is the given one, or else to do nothing. Theta has no effect on the latter, so that its equations have
one unknown for each state. In a dead end, mostly no suggestion is worth its cost; then the first sweep is the last.
A few sweeps are enough elsewhere. Later equations leave out the smallest and largest thetas at which the policy still
does nothing. Their values are known, as theta does not move there. Equations that would take too much memory are left
out; then sweeps alone go on.

**Bounds and the stopping rule.** For one type, let T be the Bellman operator on a region, or that of one policy, where
all other states have fixed values.

Assumptions.

1. T is monotone, and T(v + d) <= T(v) + gamma d for every number d >= 0. Both hold since the values of next states have
   weights of at least 0 that sum up to gamma or less.
2. v are any values, and w is the computed result of one sweep that starts at v.
3. The computed backup of one state is off by at most e.

Claim. Let r = max(0, max(w - v)) be the largest rise. Then u = w + c is an upper bound on the fixed point of T, where
c = (gamma r + e) / (1 - gamma).

Proof. The sweep computes w(x), up to e, as the backup of values v' that are those of w where the sweep has been and
those of v elsewhere. Either way w <= v' + r. So T(u)(x) <= T(v')(x) + gamma (r + c) <= w(x) + e + gamma r + gamma c
= w(x) + (1 - gamma) c + gamma c = u(x). An operator that is monotone and a contraction lowers u, step by step, to its
fixed point, which is therefore at most u.

In the same way w - (gamma f + e) / (1 - gamma) is a lower bound, where f is the largest fall. So the values w + c are
too high by at most gamma (r + f) / (1 - gamma), up to rounding. The iteration stops when this is within the tolerance.

Nothing is assumed about v: it may come from an inexact solution of the equations, or from a Krylov method that has
failed. If v are upper bounds, T(v) are, too; so c is left out as long as no equations were solved. The error of one
backup is at most `rounding` times its absolute value. So e = rounding(N) max(abs(w)), where N is the largest number of
choices (`rounding_error`); users of the bounds add this part.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.system.jit import njit
from planner.system.limits import processors
from planner.system.progress import Progress

from ..people.decision import Floats
from . import krylov
from .action_values import action_values, new_work
from .problem_arrays import ProblemArrays, read_only
from .rounding import compiled as compiled_rounding
from .rounding import rounding
from .sparse_iteration import Limits, SparseBackup, improve_small

COMPILED_FOR = "values of a large problem: about four seconds"

Ints = NDArray[np.int64]

SOLVING = "solving a person's POMDP: sweeps"

MOST_ENTRIES = 12_000_000
"""Largest number of entries of a policy's equations, at 20 bytes each. Problems with more are swept only."""

FEW_SWEEPS = 20  # over a region, after which equations are solved rarely; a dozen are enough almost everywhere
PLAIN_SWEEPS = 12  # sweeps over equations before a Krylov method takes over: they converge fast, or slowly
ONLY = np.int64(0)  # the place of the only type; numba would compile again for a literal
NOWHERE = np.empty((0, 0, 0, 0))  # in the place of Q-values that are not wanted
AT_ONCE = 20_000_000  # entries that are read before the clock is; they take about 0.02 s
INEXACT = 0.05  # equations of a policy that will change are solved to this share of the last change
FEW_CHANGES = 1e-3  # share of a policy; one that changes by less is nearly the best, and is solved precisely
UNSIGNED, NEXT = np.uint64, np.uint64(1)  # compiled code asks of signed indices whether they count from the end
SMALL = 20_000  # values; the sweeps over fewer take less time than to start threads


def improve(
    value: Floats,
    regions: Sequence[tuple[Ints, Ints]],
    action: Ints,
    arrays: ProblemArrays,
    limits: Limits,
    progress: Progress | None = None,
    *,
    below: bool = False,
    backup: SparseBackup | None = None,
) -> bool:
    """Replace values, shape (n, H, T), by those of the best policy or of a given one; return whether they converged.

    They are upper bounds, or lower ones with `below`, if the values at the start were. That is so, too, if a limit ends
    the iteration.

    Parameters
    ----------
    value : float array, shape (n, H, T)
    regions : sequence of pairs of int arrays
        States in the order of a sweep for each goal: the dead ends, and all other states that are not final.
    action : int array, shape (n,)
        Robot action in each state; `BEST` stands for the best one.
    arrays : ProblemArrays
    limits : Limits
    progress : callable, optional
        Receives the number of sweeps at most five times a second.
    below : bool
        Whether lower bounds are wanted, of the policy `action`.
    backup : SparseBackup, optional
        That of the arrays, by which a small problem is solved in numpy.
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

    if backup is not None:
        return improve_small(value, action, arrays, backup, limits, stop, count, below=below)
    of_goals = [_of_goal(arrays, goal) for goal in range(len(regions))]

    def one(h: int) -> bool:
        # Contiguous copies of one type's arrays keep more of a sweep in the processor's cache.
        own, goal = value[:, h : h + 1].copy(), int(arrays.goal_of[h])
        chosen, unsuggested = read_only(arrays.chosen[:, :, h : h + 1]), read_only(arrays.unsuggested[:, :, h : h + 1])
        m = of_goals[goal]._replace(chosen=chosen, unsuggested=unsuggested)
        dead, alive = regions[goal]
        done = True
        for order in (dead, alive):
            region = _Region(
                own, read_only(order, np.int64), read_only(action, np.int64), m, limits, stop, count, below
            )
            done = region.iterate(order is dead) and done
        value[:, h] = own[:, 0]
        return done

    types = range(value.shape[1])
    if value.size <= SMALL:
        return all(list(map(one, types)))
    with ThreadPoolExecutor(processors()) as pool:
        try:
            # the list makes all threads finish: one failure cancels no other
            return all(list(pool.map(one, types)))
        except BaseException:  # after Ctrl-C no further sweep begins
            stopped = True
            raise


def _of_goal(arrays: ProblemArrays, goal: int) -> ProblemArrays:
    """Return the arrays of a problem in which one goal is known, but those of its types."""
    own, of = slice(goal, goal + 1), (slice(None), slice(None), slice(goal, goal + 1))
    return arrays._replace(
        goal=read_only(arrays.goal[own]), final=read_only(arrays.final[own]), goal_of=read_only(np.zeros(1, np.int64)),
        low=read_only(arrays.low[of]), weight=read_only(arrays.weight[of]),
        followed_low=read_only(arrays.followed_low[of]), followed_weight=read_only(arrays.followed_weight[of]),
    )  # fmt: skip


def load_compiled(arrays: ProblemArrays) -> None:
    """Load, or compile, the code that `improve` needs."""
    value, nothing = np.zeros((0, 1, len(arrays.theta))), read_only(np.zeros(0, dtype=np.int64))
    policy = np.zeros((0, len(arrays.theta)), np.int32)
    sweep(value, nothing, ONLY, nothing, policy, NOWHERE, arrays)
    _tighten(value, value, nothing, 0.0, below=False)
    equations = _Equations.of(nothing, 0, arrays, nothing, 0, len(arrays.theta))
    equations.solve(value, policy, 1.0, lambda: False)


def rounding_error(value: Floats, arrays: ProblemArrays) -> Floats:
    """Return how far rounding may move the values of a fixed point, shape (n, H, T), for each type: shape (H, 1).

    This is e / (1 - gamma) of the module's claim.
    """
    largest = np.abs(value).max(axis=(0, 2), initial=0.0)[:, None]
    return np.asarray(rounding(arrays.targets.shape[1]) / (1 - arrays.gamma) * largest)


@dataclass(frozen=True)
class _Region:
    """The iteration on one region for one type; `value`, shape (n, 1, T), holds bounds and receives better ones."""

    value: Floats
    order: Ints
    action: Ints
    m: ProblemArrays
    limits: Limits
    stop: Callable[[], bool]
    count: Callable[[], None]
    below: bool

    def iterate(self, dead: bool) -> bool:
        """Iterate and return whether the values converged; `dead` tells whether the goal cannot be reached."""
        m, order, tolerance = self.m, self.order, self.limits.tolerance
        if not len(order):
            return True
        horizon, exact = m.gamma / (1 - m.gamma), rounding(m.targets.shape[1]) / (1 - m.gamma)
        outwards = -horizon if self.below else horizon
        first = np.maximum(self.action, 0).astype(np.int32)
        found, policy = self.value.copy(), first.repeat(len(m.theta)).reshape(-1, len(m.theta))
        equations, room = None, _room(order, m)
        few = int(room.sum()) * len(m.theta) <= MOST_ENTRIES
        silent, solved = self._start(found, policy, room, dead, few)
        settled = not few
        for number in range(self.limits.sweeps):
            if self.stop():
                return False
            rise, fall, changed = sweep(found, order, ONLY, self.action, policy, NOWHERE, m)
            self.count()
            off = 0.0 if not solved else fall if self.below else rise
            change = max(rise, fall)
            scale = _tighten(self.value, found, order, outwards * off, self.below)
            # Where rounding makes the equations less precise than a sweep, sweeps alone go on, for longer each time.
            late = number >= FEW_SWEEPS
            # Bounds that are moved outwards by little are also good values; equations are solved that precisely.
            near = horizon * (100 * off + change) <= tolerance
            if near or ((settled or late) and horizon * (off + change) <= max(tolerance, exact * scale)):
                self.value[order] = found[order] + outwards * off
                return True
            if few and (not late or number.bit_count() == 1):
                # At other thetas the policy is that of the start.
                suggested = np.flatnonzero(policy[order].any(axis=0)).tolist() if silent else []
                least, last = (suggested[0], suggested[-1]) if suggested else (0, len(m.theta) - 1)
                if equations is None or not equations.least <= least <= last < equations.end:
                    equations = _Equations.of(order, len(found), m, room, least, last + 1 - least)
                precise = self._precise(scale)
                early = changed > FEW_CHANGES * len(order) * len(m.theta)
                goal = max(INEXACT * change, precise) if early else precise
                equations.solve(found, policy, goal, self.stop)
                solved, settled = True, goal == precise
        return False

    def _start(self, found: Floats, policy: NDArray[np.int32], room: Ints, dead: bool, few: bool) -> tuple[bool, bool]:
        """Replace the region's values by those of a first policy, unless its equations would be too many.

        Return whether the policy is to do nothing and theta has no effect on its values, and whether they were solved.
        """
        m, order, asked = self.m, self.order, self.action[self.order]
        outside = np.ones(len(found), dtype=bool)
        outside[order] = False
        silent = not policy[order].any() and not np.ptp(found[outside], axis=2).any()
        if not few and not (silent and (dead or (asked >= 0).all())):
            return False, False
        equations = _Equations.of(order, len(found), m, room, 0, 1 if silent else len(m.theta))
        dearest = float(m.costs[order].max() + m.robot_costs[order].max())
        equations.solve(found, policy, self._precise(dearest / (1 - m.gamma)), self.stop)
        if silent:
            found[order] = found[order, :, :1]
        return silent, True

    def _precise(self, scale: float) -> float:
        """Return the largest change of a sweep over values that have converged, given the largest absolute value."""
        return max(1e-4 * self.limits.tolerance * (1 - self.m.gamma), 1e-14 * scale)


class _Rows(NamedTuple):
    """The equations of a policy, one row for each state of a region and theta, in sparse rows.

    Row i is v(i) = constant(i) + the sum over k of share(k) v(column(k)) + further(k) v(column(k) + 1), where k runs
    from `first[i]` to `end[i]`. The second share is that of the next theta, as the new trust lies between two. Shares
    include gamma. Rows have room for the choices of any robot action. Vectors have one more entry than rows, which is
    zero.
    """

    first: Ints
    end: Ints
    column: NDArray[np.int32]
    share: Floats
    further: Floats
    constant: Floats


def _room(order: Ints, m: ProblemArrays) -> Ints:
    """Return the largest number of choices after any robot action in each state of an order, for one theta."""
    actions = np.arange(m.suggested.shape[1]) < m.robot_actions[order, None]
    return np.asarray(np.where(actions, m.counts[m.afterstate[order]], 0).max(axis=1, initial=0))


@dataclass(frozen=True)
class _Equations:
    """The equations of policies of one region and type, for neighbouring values of theta from index `least` on.

    `filled`, shape (states, thetas), is the policy of the rows.
    """

    order: Ints
    index: NDArray[np.int32]
    least: int
    filled: NDArray[np.int32]
    rows: _Rows
    m: ProblemArrays

    @classmethod
    def of(cls, order: Ints, states: int, m: ProblemArrays, room: Ints, least: int, thetas: int) -> _Equations:
        """Return equations for some values of theta, from index `least` on, which are to be filled in.

        The values of others are fixed.
        """
        first = np.concatenate([[0], np.cumsum(room.repeat(thetas))])
        index = np.full(states, -1, dtype=np.int32)
        index[order] = np.arange(len(order))
        entries = int(first[-1])
        rows = _Rows(
            first, first[:-1].copy(), np.empty(entries, np.int32), np.empty(entries), np.empty(entries),
            np.empty(len(first) - 1),
        )  # fmt: skip
        filled = np.full((len(order), thetas), -1, dtype=np.int32)
        return cls(order, index, least, filled, rows, m)

    @property
    def end(self) -> int:
        """The index after the last theta."""
        return self.least + self.filled.shape[1]

    def solve(self, found: Floats, policy: NDArray[np.int32], goal: float, stop: Callable[[], bool]) -> None:
        """Replace the region's values by those of a policy, shape (n, T): a sweep changes them by `goal` at most.

        The change is larger if time is over, or if no method converges.
        """
        thetas = slice(self.least, self.end)
        _fill_rows(self.rows, self.filled, self.order, self.index, policy, found, self.least, self.m)
        value = np.append(found[self.order, 0, thetas], 0.0)
        value = _solved(value, self.rows, goal, stop)
        found[self.order, 0, thetas] = value[:-1].reshape(self.filled.shape)


def _solved(value: Floats, rows: _Rows, goal: float, stop: Callable[[], bool]) -> Floats:
    """Return an approximate solution of equations from a first one, as `_Equations.solve` describes."""
    together = max(1, AT_ONCE // (1 + len(rows.column)))  # sweeps without a look at the clock
    without = rows._replace(constant=np.zeros_like(rows.constant))

    def operate(image: Floats, step: Floats) -> None:
        image[:] = step
        _sweep_rows(image[0], without, 0.0, 1)

    for _ in range(3):
        for done in range(0, PLAIN_SWEEPS, together):
            if _sweep_rows(value, rows, goal, min(together, PLAIN_SWEEPS - done)) <= goal or stop():
                return value
        residual = value.copy()
        _sweep_rows(residual, rows, 0.0, 1)
        residual -= value
        before = np.abs(residual).max()
        with np.errstate(over="ignore", invalid="ignore"):  # the method may fail
            tried = value + krylov.solution(residual[None], operate, 0.5 * goal, stop)[0]
        if np.isfinite(tried).all() and _sweep_rows(tried, rows, goal, 1) < before:
            value = tried
    return value


@njit(nogil=True, error_model="numpy")
def sweep(
    value: Floats, order: Ints, h: int, action: Ints, policy: NDArray[np.int32], q: Floats, m: ProblemArrays
) -> tuple[float, float, int]:
    """Do a Bellman backup of every state of an order for one type; `policy`, shape (n, T), receives the robot actions.

    The values, shape (n, H, T), are replaced one after the other. If `q` is not empty, they stay, and `q`, shape
    (n, R, H, T), receives the Q-values of all robot actions; minus infinity in padding. Where the problem has ended for
    the type, a suggestion costs, and does no more.

    Return the largest rise and the largest fall of a value, and the number of changes of the policy. A negative entry
    of `action` stands for the best action. Actions that are equal up to rounding do not change the policy.
    """
    actions, thetas, least = m.suggested.shape[1], len(m.theta), compiled_rounding(m.targets.shape[1])
    work = new_work(actions, thetas)
    row = work.q
    rise, fall, changed = 0.0, 0.0, 0
    for x in order:
        if m.final[m.goal_of[h], x]:
            for r in range(m.robot_actions[x]):
                for t in range(thetas):
                    row[r, t] = value[x, h, t] - (m.robot_costs[x, r] if r > 0 else 0.0)
        else:
            action_values(work, value, x, h, action[x], m)
        if len(q) > 0:
            for r in range(actions):
                for t in range(thetas):
                    q[x, r, h, t] = row[r, t] if r < m.robot_actions[x] else -np.inf
            continue
        first, end = (action[x], action[x] + 1) if action[x] >= 0 else (0, m.robot_actions[x])
        for t in range(thetas):
            best, which = row[first, t], first
            for r in range(first + 1, end):
                if row[r, t] > best:
                    best, which = row[r, t], r
            now = policy[x, t]
            if which != now and not (first <= now < end and row[now, t] >= best - least * abs(best)):
                policy[x, t] = which
                changed += 1
            change = best - value[x, h, t]
            if change > rise:
                rise = change
            if -change > fall:
                fall = -change
            value[x, h, t] = best
    return rise, fall, changed


@njit(nogil=True)
def _tighten(value: Floats, found: Floats, order: Ints, shift: float, below: bool) -> float:
    """Replace bounds by `found` + shift where these are better; return the largest absolute value of the latter."""
    scale = 0.0
    for x in order:
        for t in range(value.shape[2]):
            bound = found[x, 0, t] + shift
            if abs(bound) > scale:
                scale = abs(bound)
            if (bound > value[x, 0, t]) == below:
                value[x, 0, t] = bound
    return scale


@njit(nogil=True, error_model="numpy")
def _sweep_rows(value: Floats, rows: _Rows, goal: float, sweeps: int) -> float:
    """Do Gauss-Seidel sweeps over equations, in place, until the largest change is at most `goal`; return the last."""
    first, end, column, share, further, constant = rows
    change = 0.0
    for _ in range(sweeps):
        change = 0.0
        for i in range(len(end)):
            total = constant[i]
            for k in range(UNSIGNED(first[i]), UNSIGNED(end[i])):
                at = UNSIGNED(column[k])
                total += share[k] * value[at] + further[k] * value[at + NEXT]
            if abs(total - value[i]) > change:
                change = abs(total - value[i])
            value[i] = total
        if change <= goal:
            break
    return change


@njit(nogil=True, error_model="numpy")
def _fill_rows(
    rows: _Rows,
    filled: NDArray[np.int32],
    order: Ints,
    index: NDArray[np.int32],
    policy: NDArray[np.int32],
    value: Floats,
    least: int,
    m: ProblemArrays,
) -> None:
    """Fill in the equations of a policy, shape (n, T), where it is not the one that is `filled` in.

    The first theta has the index `least`. `index` has the index of each state in the order; -1 stands for states with
    fixed values, which become constants, as do those of other thetas.
    """
    thetas, end = filled.shape[1], least + filled.shape[1]
    targets, costs, chosen = m.targets, m.costs, m.chosen
    first, last, column, shares, furthers = rows.first, rows.end, rows.column, rows.share, rows.further
    for i in range(len(order)):
        x = order[i]
        for t in range(least, end):
            r, row = policy[x, t], i * thetas + t - least
            if filled[i, t - least] == r:
                continue
            filled[i, t - least] = r
            acting, slot = m.afterstate[x, r], m.suggested[x, r]
            constant, k = -m.robot_costs[x, r], first[row]
            count = 0 if m.goal[0, acting] else m.counts[acting]
            followed, declined = 1.0, 1.0  # factors of the choice probabilities (equation 6)
            low, up, followed_low, followed_up = t, 0.0, t, 0.0
            if slot >= 0:
                total = m.theta[t] * chosen[acting, slot, 0] + (1.0 - m.theta[t]) * m.unsuggested[x, r, 0]
                if total > 0.0:
                    followed, declined = m.theta[t] / total, (1.0 - m.theta[t]) / total
            if m.moves[x, r]:
                low, up = m.low[x, r, 0, t], m.weight[x, r, 0, t]
                followed_low, followed_up = m.followed_low[x, r, 0, t], m.followed_weight[x, r, 0, t]
            lapse = m.lapse / count if count > 0 else 0.0
            for a in range(count):
                p = (1.0 - m.lapse) * chosen[acting, a, 0] * (followed if a == slot else declined) + lapse
                constant -= p * costs[acting, a]
                at, part = (followed_low, followed_up) if a == slot else (low, up)
                y, p = targets[acting, a], m.gamma * p
                before = index[y] >= 0 and least <= at < end
                after = index[y] >= 0 and least <= at + 1 < end
                share, further = p * (1.0 - part), p * part
                if not before:
                    constant += share * value[y, 0, at]
                if not after and part > 0.0:
                    constant += further * value[y, 0, at + 1]
                if before or after:
                    column[k] = index[y] * thetas + at - least if before else index[y] * thetas
                    shares[k] = share if before else further
                    furthers[k] = further if before and after else 0.0
                    k += 1
            rows.constant[row], last[row] = constant, k
