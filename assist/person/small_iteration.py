"""Policy iteration on a small problem, in numpy and scipy: the readable definition of `policy_iteration`.

Two steps alternate, as there: a Bellman backup of all states, which also gives the next policy, and the solution of
that policy's sparse equations. While the policy still changes much, its equations are solved roughly. Each type begins
at the values of the one before. Bounds and the stopping rule are those of `policy_iteration`, whose theorem holds for
backups in any order, and for any values before them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Floats
from .bellman_backup import BellmanBackup
from .problem_arrays import ProblemArrays

Ints = NDArray[np.int64]

PRECISE = 1e-6
"""Largest error of any value, in cost units. A smaller one takes few more steps."""

INEXACT = 0.05
"""Equations of a policy that will change are solved to this share of the last change."""

FEW_CHANGES = 1e-3
"""Share of a policy; one that changes by less is nearly the best, and is solved precisely."""

KRYLOV_STEPS = 300
"""Steps of BiCGSTAB at most; 20 to 100 converge in all tasks that were tried."""


@dataclass(frozen=True)
class SmallRegion:
    """The iteration on one region; `value`, shape (n, H, T), holds bounds and receives better ones.

    Attributes
    ----------
    value : float array, shape (n, H, T)
    order : int array, shape (k,)
        States of the region.
    robot : int array, shape (n,)
        Robot action in each state; negative for the best one.
    m : ProblemArrays
    rounding : float
        Relative error of one backup.
    below : bool
        Whether the bounds are lower ones.
    near : float array, shape (k, H, T), optional
        Values at which the iteration starts, such as those of another type; by default the bounds.
    """

    value: Floats
    order: Ints
    robot: Ints
    m: ProblemArrays
    rounding: float
    below: bool
    near: Floats | None = None

    def iterate(self, tolerance: float, sweeps: int, stop: Callable[[], bool], count: Callable[[], None]) -> bool:
        """Iterate until the largest error is within a tolerance; return whether this was reached in time.

        Values are never less precise than `PRECISE`, so that they hardly depend on the tolerance.
        """
        if not len(self.order):
            return True
        tolerance = min(tolerance, PRECISE)
        gamma, order = self.m.gamma, self.order
        horizon = gamma / (1 - gamma)
        outwards = -horizon if self.below else horizon
        found, solved, settled = self.value.copy(), self.near is not None, False
        policy = np.broadcast_to(np.maximum(self.robot[order], 0)[:, None, None], found[order].shape)
        if self.near is not None:
            found[order] = self.near
        for number in range(sweeps):
            if stop():
                return False
            backed, policy, changed = self._backup(found, policy)
            change = backed - found[order]
            found[order] = backed
            count()
            rise, fall = (np.maximum(0.0, one.max(axis=(0, 2), initial=0.0)) for one in (change, -change))
            off = (fall if self.below else rise) * solved
            bound = backed + (outwards * off)[:, None]
            self.value[order] = (np.maximum if self.below else np.minimum)(self.value[order], bound)
            scale = np.abs(bound).max(axis=(0, 2), initial=0.0)
            largest = np.maximum(rise, fall)
            error = np.maximum(tolerance, self.rounding * scale / (1 - gamma))
            # Bounds that are moved outwards by little are also good values.
            near = horizon * (100 * off + largest) <= tolerance
            if (near | ((settled or number > 50) & (horizon * (off + largest) <= error))).all():
                self.value[order] = bound
                return True
            precise = max(1e-4 * tolerance * (1 - gamma), 1e-14 * float(scale.max()))
            settled = changed <= FEW_CHANGES * backed.size
            goal = precise if settled else max(INEXACT * float(largest.max()), precise)
            if number <= 50 or number.bit_count() == 1:
                found[order] = self._solved(found, policy, goal)
                solved = True
        return False

    @cached_property
    def _backups(self) -> BellmanBackup:
        return BellmanBackup.of(self.order, self.robot, self.m)

    def _backup(self, found: Floats, policy: Ints) -> tuple[Floats, Ints, int]:
        """Return the backed-up values, shape (k, H, T), the best robot actions, and how many have changed.

        Actions that are equal up to rounding do not change the policy.
        """
        pairs = self._backups
        q = np.full((len(self.order), self.m.suggested.shape[1], *found.shape[1:]), -np.inf)
        q[np.cumsum(np.diff(pairs.x, prepend=-1) != 0) - 1, pairs.robot] = pairs.q_values(found)
        best = q.max(axis=1)
        now = np.take_along_axis(q, policy[:, None], axis=1)[:, 0]
        turns = now < best - self.rounding * np.abs(best)
        return best, np.where(turns, q.argmax(axis=1), policy), int(turns.sum())

    def _solved(self, found: Floats, policy: Ints, goal: float) -> Floats:
        """Return values of a policy, shape (k, H, T), whose equations are off by about `goal`."""
        matrix, constant = self._equations(found, policy)
        start = found[self.order].ravel()
        value = krylov(matrix, constant, start, goal)
        off = [np.abs(one - matrix @ one - constant).max() for one in (value, start)]
        return (value if off[0] < off[1] else start).reshape(policy.shape)  # the method may fail

    def _equations(self, found: Floats, policy: Ints) -> tuple[Any, Floats]:
        """Return the matrix and the constants of v = matrix v + constant, for the values v of a policy.

        A choice leads to a state, and after a suggestion to a theta between two of the grid: two entries of a row.
        """
        from scipy.sparse import csr_array  # slow to import, and needed here only

        m, thetas = self.m, found.shape[2]
        place = np.full(len(found), -1)
        place[self.order] = np.arange(len(self.order))
        k, b, t = (axis.ravel() for axis in np.indices(policy.shape))
        x, r = self.order[k], policy.ravel()
        acting, suggested = m.afterstate[x, r], m.suggested[x, r]
        advised = suggested >= 0
        p, theta = m.chosen[acting, suggested, b], m.theta[t]
        total = theta * p + (1.0 - theta) * m.unsuggested[x, r, b]
        influenced = advised & (total > 0.0)
        followed = np.divide(theta, total, out=np.ones_like(total), where=influenced)
        declined = np.divide(1.0 - theta, total, out=np.ones_like(total), where=influenced)
        counts = np.where(m.goal[0, acting], 0, m.counts[acting])
        # From here on, one entry for each choice: `row` is that of its equation, `slot` the choice.
        row = np.repeat(np.arange(len(x)), counts)
        slot = np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)
        acting, beta, own = acting[row], b[row], slot == suggested[row]
        chance = (1.0 - m.lapse) * m.chosen[acting, slot, beta] * np.where(own, followed[row], declined[row])
        chance += m.lapse / counts[row]
        low, up = np.where(advised, m.low[x, r, 0, t], t)[row], np.where(advised, m.weight[x, r, 0, t], 0.0)[row]
        low = np.where(own, m.followed_low[x, r, 0, t][row], low)
        up = np.where(own, m.followed_weight[x, r, 0, t][row], up)
        y, constant = m.targets[acting, slot], -m.robot_costs[x, r]
        constant -= np.bincount(row, chance * m.costs[acting, slot], minlength=len(x))
        inside, high = place[y] >= 0, np.minimum(low + 1, thetas - 1)
        shares = m.gamma * chance * (1.0 - up), m.gamma * chance * up
        beyond = ~inside
        values = sum(
            share[beyond] * found[y[beyond], beta[beyond], at[beyond]]
            for share, at in zip(shares, (low, high), strict=True)
        )
        constant += np.bincount(row[beyond], values, minlength=len(x))
        first = (place[y[inside]] * found.shape[1] + beta[inside]) * thetas
        columns = np.concatenate([first + low[inside], first + high[inside]])
        entries = np.concatenate([share[inside] for share in shares]), (np.tile(row[inside], 2), columns)
        return csr_array(entries, shape=(len(x), len(x))), constant


def krylov(matrix: Any, constant: Floats, value: Floats, goal: float) -> Floats:
    """Return the solution of v = matrix v + constant up to a largest residual, from a first one (van der Vorst, 1992).

    This is the method BiCGSTAB. scipy's needs BLAS, whose threads wait for each other on a busy machine.
    """

    def dot(one: Floats, other: Floats) -> float:
        return float((one * other).sum())

    value = value.copy()
    r = constant + matrix @ value - value
    shadow, p = r.copy(), r.copy()
    along = dot(shadow, r)
    for _ in range(KRYLOV_STEPS):
        if np.abs(r).max() <= goal:
            break
        v = p - matrix @ p
        bent = dot(shadow, v)
        if bent == 0.0 or along == 0.0:
            break
        alpha = along / bent
        r -= alpha * v
        t = r - matrix @ r
        square = dot(t, t)
        omega = dot(t, r) / square if square > 0.0 else 0.0
        value += alpha * p + omega * r
        r -= omega * t
        if omega == 0.0:
            break
        now = dot(shadow, r)
        p = r + now / along * alpha / omega * (p - omega * v)
        along = now
    return value
