"""Policy iteration on a small problem, in numpy and scipy: the readable form of `policy_iteration`.

All Q-values are one sparse product, q = matrix @ value + reward. The rows of the best robot actions are the equations
of a policy. Two steps alternate: a Bellman backup of all states, which also gives the next policy, and the solution of
its equations. While the policy still changes much, its equations are solved roughly. The bounds and the stopping rule
are those of `policy_iteration`, whose theorem holds for any values before a backup.

A problem is small if it has few values, also together with those of the people it is solved for: compiling
`policy_iteration` would then take longer than it saves.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..people.decision import Bools, Floats, Ints
from . import krylov
from .belief_update import factors_of
from .pomdp import AssistPOMDP
from .problem_arrays import ProblemArrays
from .rounding import rounding

MOST_VALUES = 100_000
"""Values of a small problem, at most: these take 0.2 s here, and 0.06 s in compiled code (`qmdp.COMPILED_FOR`)."""

MOST_TOGETHER = 1_500_000
"""Values of the problems of all people, at most; from there on, compiling takes less time than it saves."""

PRECISE = 1e-6
"""Largest error of any value, in cost units. A smaller one takes few more steps."""

INEXACT = 0.05
"""Equations of a policy that will change are solved to this share of the last change."""

FEW_CHANGES = 1e-3
"""Share of a policy; one that changes by less is nearly the best, and is solved precisely."""

FEW_BACKUPS = 50  # after which equations are solved rarely; ten are enough almost everywhere


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


def is_small(pomdp: AssistPOMDP) -> bool:
    """Return whether a problem, with H * T values for each state, is solved in numpy. Its size alone decides."""
    values = pomdp.prior.size * len(pomdp.ends)
    return values <= MOST_VALUES and values * pomdp.alike <= MOST_TOGETHER


@dataclass(frozen=True)
class SparseBackup:
    """The Q-values of all pairs of a state and a robot action, for each type and theta, as one sparse product.

    Values of states have the shape (H, n, T) here, so that those of a type are together.

    Attributes
    ----------
    shape : tuple of int
        Shape of values (H, n, T).
    x, action : int array, shape (P,)
        State and robot action of each pair, in ascending order.
    first : int array, shape (n,)
        The first pair of each state.
    matrix : sparse array, shape (H * P * T, H * n * T)
        Discounted probabilities of the next state and theta.
    reward : float array, shape (H * P * T,)
    ended : tuple of int arrays
        Types and pairs where the task has ended before the robot acts.
    """

    shape: tuple[int, int, int]
    x: Ints
    action: Ints
    first: Ints
    matrix: Any
    reward: Floats
    ended: tuple[Ints, Ints]

    @classmethod
    def of(cls, m: ProblemArrays) -> SparseBackup:
        """Return the backup of a problem. Where theta moves, it is then between two of the grid: two entries."""
        from scipy.sparse import csr_array  # slow to import, and needed here only

        types, n, thetas = shape = len(m.goal_of), len(m.counts), len(m.theta)
        x, r = np.nonzero(np.arange(m.suggested.shape[1]) < m.robot_actions[:, None])
        acting, suggested = m.afterstate[x, r], m.suggested[x, r]
        over = m.final[m.goal_of[:, None], x]
        goes_on = ~(over | m.goal[m.goal_of[:, None], acting])
        # One entry for each choice of a pair; `pair` is its pair, `slot` its number.
        counts, advised = m.counts[acting], suggested >= 0
        pair = np.repeat(np.arange(len(x)), counts)
        slot = np.arange(len(pair)) - np.repeat(np.cumsum(counts) - counts, counts)
        state = acting[pair]
        target, cost = m.targets[state, slot], m.costs[state, slot]
        chosen = np.where(goes_on[:, pair], m.chosen[state, slot].T, 0.0)[:, :, None].repeat(thetas, axis=2)
        told = np.flatnonzero(advised[pair])
        own = slot[told] == suggested[pair[told]]
        which = (np.cumsum(advised) - 1)[pair[told]]
        suggestion = x[advised], r[advised]
        p, rest = m.chosen[acting[advised], suggested[advised]].T, m.unsuggested[suggestion].T
        followed, declined = factors_of(m.theta, p[:, :, None], rest[:, :, None])
        chosen[:, told] *= np.where(own[:, None], followed[:, which], declined[:, which])
        if m.lapse > 0.0:
            chosen *= 1.0 - m.lapse
            chosen += np.where(goes_on[:, pair], m.lapse / counts[pair], 0.0)[:, :, None]
        reward = np.zeros((types, len(x), thetas))
        if len(pair):
            some = np.flatnonzero(counts)
            reward[:, some] = np.add.reduceat(chosen * -cost[:, None], (np.cumsum(counts) - counts)[some], axis=1)
        reward -= np.where(over & (r == 0), 0.0, m.robot_costs[x, r])[:, :, None]
        chosen *= m.gamma

        # The row of pair p and theta t begins at entry `begin[h, p, t]`.
        moves = m.moves[x, r]
        width = np.where(moves, 2, 1) * counts
        size = int(width.sum()) * thetas
        begin = (np.cumsum(width) - width)[:, None] * thetas + width[:, None] * np.arange(thetas)
        begin = begin + size * np.arange(types)[:, None, None]
        data, column = np.empty(types * size), np.empty(types * size, dtype=np.int32)
        base = (np.arange(types)[:, None] * n + target)[:, :, None] * thetas
        quiet, moving = np.flatnonzero(~moves[pair]), np.flatnonzero(moves[pair])
        of, own = pair[moving], slot[moving] == suggested[pair[moving]]
        entry = begin[:, pair[quiet]] + slot[quiet, None]
        data[entry], column[entry] = chosen[:, quiet], base[:, quiet] + np.arange(thetas)
        low, up = (part[x[of], r[of]].swapaxes(0, 1)[m.goal_of] for part in (m.low, m.weight))
        if m.uses_answer:
            mine = x[of[own]], r[of[own]]
            low[:, own], up[:, own] = (
                part[mine].swapaxes(0, 1)[m.goal_of] for part in (m.followed_low, m.followed_weight)
            )
        entry, chosen, base = begin[:, of] + 2 * slot[moving, None], chosen[:, moving], base[:, moving]
        data[entry], column[entry] = chosen * (1.0 - up), base + low
        data[entry + 1], column[entry + 1] = chosen * up, base + np.minimum(low + 1, thetas - 1)
        h, pair = np.nonzero(over)
        rows = np.append(begin.ravel(), types * size)
        matrix = csr_array((data, column, rows), shape=(reward.size, types * n * thetas))
        return cls(shape, x, r, np.searchsorted(x, np.arange(n)), matrix, reward.ravel(), (h, pair))

    @classmethod
    def of_small(cls, pomdp: AssistPOMDP) -> SparseBackup | None:
        """Return the backup of a problem if it is small; None if it is large."""
        return cls.of(ProblemArrays.of(pomdp)) if is_small(pomdp) else None

    def q_values(self, value: Floats) -> Floats:
        """Return the Q-value of each pair, shape (H, P, T), from values of all states, shape (H, n, T)."""
        q = self.matrix @ value.ravel()
        q += self.reward
        q = q.reshape(self.shape[0], -1, self.shape[2])
        h, pair = self.ended
        q[h, pair] += value[h, self.x[pair]]
        return np.asarray(q)

    def best_actions(self, q: Floats, best: Floats, where: Bools) -> Ints:
        """Return the first robot action with the best Q-value in chosen states, types and thetas.

        `q` has the shape (H, P, T), `best` and `where` (H, n, T).
        """
        h, x, t = np.nonzero(where)
        found, wanted = np.full(len(x), -1), best[where]
        for r in range(int(self.action.max(initial=0)) + 1):
            pair = np.minimum(self.first[x] + r, len(self.x) - 1)
            found[(found < 0) & (self.x[pair] == x) & (q[h, pair, t] == wanted)] = r
        return found

    def rows(self, policy: Ints) -> Ints:
        """Return the rows of the robot actions of a policy, shape (H, n, T)."""
        types, _, thetas = self.shape
        pair = self.first[:, None] + policy + (len(self.x) * np.arange(types))[:, None, None]
        return np.asarray(pair * thetas + np.arange(thetas))


def q_table(value: Floats, states: Ints, backup: SparseBackup, actions: int) -> Floats:
    """Return the Q-values in some states, shape (n, R, H, T), from values, shape (n, H, T); minus infinity in padding.

    Those in other states are 0. `actions` is R, the largest number of robot actions.
    """
    q = np.zeros((len(value), actions, *value.shape[1:]))
    q[states] = -np.inf
    asked = np.isin(backup.x, states)
    q[backup.x[asked], backup.action[asked]] = backup.q_values(value.swapaxes(0, 1)).swapaxes(0, 1)[asked]
    return q


def improve_small(
    value: Floats,
    action: Ints,
    m: ProblemArrays,
    backup: SparseBackup,
    limits: Limits,
    stop: Callable[[], bool],
    count: Callable[[], None],
    *,
    below: bool,
) -> bool:
    """Replace values by those of the best policy or of a given one; arguments are as in `policy_iteration.improve`.

    Values are never less precise than `PRECISE`, so that they hardly depend on the tolerance.
    """
    least, tolerance = rounding(m.targets.shape[1]), min(limits.tolerance, PRECISE)
    active = ~m.final[m.goal_of][:, :, None]
    horizon = m.gamma / (1 - m.gamma)
    outwards, better = (-horizon, np.maximum) if below else (horizon, np.minimum)
    given = bool((action >= 0).all())
    allowed = (action[backup.x] < 0) | (action[backup.x] == backup.action)
    bounds = value.swapaxes(0, 1)
    found, solved, settled = bounds.copy(), False, False
    policy = np.where(active, np.maximum(action, 0)[:, None], np.zeros(found.shape, dtype=np.int64))
    for number in range(limits.sweeps):
        if stop():
            return False
        q = backup.q_values(found)
        if not allowed.all():
            q[:, ~allowed] = -np.inf
        best = np.maximum.reduceat(q, backup.first, axis=1)
        turns = active & (q.ravel()[backup.rows(policy)] < best - least * np.abs(best))
        policy[turns] = backup.best_actions(q, best, turns)
        np.copyto(best, found, where=~active)
        change, found = best - found, best
        count()
        rise, fall = np.maximum(0.0, change.max(axis=(1, 2))), np.maximum(0.0, -change.min(axis=(1, 2)))
        off, largest = (fall if below else rise) * solved, np.maximum(rise, fall)
        bound = np.where(active, found + (outwards * off)[:, None, None], bounds)
        better(bounds, bound, out=bounds)
        scale = np.abs(bound).max(axis=(1, 2))
        late = number >= FEW_BACKUPS
        near = horizon * (100 * off + largest) <= tolerance  # bounds that move outwards by little are good values
        error = np.maximum(tolerance, least * scale / (1 - m.gamma))
        if (near | ((settled or late) & (horizon * (off + largest) <= error))).all():
            bounds[:] = bound
            return True
        if not late or number.bit_count() == 1:
            precise = max(1e-4 * tolerance * (1 - m.gamma), 1e-14 * float(scale.max()))
            settled = int(turns.sum()) <= FEW_CHANGES * turns.size and (number > 0 or given)
            goal = precise if settled else max(INEXACT * float(largest.max()), precise)
            found, solved = _values(backup, policy, found, active, goal, stop), True
    return False


def _values(
    backup: SparseBackup, policy: Ints, start: Floats, active: Bools, goal: float, stop: Callable[[], bool]
) -> Floats:
    """Return the values of a policy up to a largest residual, from first values, shape (H, n, T).

    Values of states that are not `active` are given. Where the method fails, the first values are returned.
    """
    rows = backup.rows(policy)
    matrix, constant = backup.matrix[rows.ravel()], np.where(active, backup.reward[rows], start)

    def residual(value: Floats) -> Floats:
        return ((matrix @ value.ravel()).reshape(value.shape) + constant - value).reshape(len(value), -1)

    def operate(image: Floats, step: Floats) -> None:
        image[:] = (matrix @ step.ravel()).reshape(step.shape)

    r = residual(start)
    before = np.abs(r).max(axis=1)
    with np.errstate(over="ignore", invalid="ignore"):  # the method may fail
        tried = start + krylov.solution(r, operate, goal, stop).reshape(start.shape)
        better = np.abs(residual(tried)).max(axis=1) < before  # not so if there are no numbers
    return np.where(better[:, None, None], tried, start)
