"""Exact solution of a team's joint POMDP between bounds, for tiny teams and tasks.

Nothing is relaxed or decomposed. Observed are the states of all tasks and the robot's location; hidden are beta and
theta of all people. The numbers of both are products over people, so that two people with a task of some dozen states
are about the limit. The solution is the reference for scalable methods: team policies, and the bound for large teams
(`assist.certify.team_bound`).

The problem is built from each person's `AssistPOMDP` (`joint_problem.py`). It is solved by heuristic search value
iteration (Smith and Simmons, "Heuristic search value iteration for POMDPs", 2004) in its basic form. The lower bound
consists of alpha vectors, the first of which is the policy that never helps. The upper bound consists of the MDP values
with everything observed, and of points with sawtooth interpolation. The code is independent of the solver of one
person's POMDP, so that each checks the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
from joint_problem import Ints, JointProblem, product_of, written_out

from assist.people.decision import Floats
from assist.team.pool import Pool
from assist.team.state import NOBODY

DEPTH = 500
"""Largest number of steps of a trial."""

SETTLED = 1e-9
"""Value iteration stops when a sweep changes no value by more, in cost units."""

MARGIN = 1e-10
"""The bounds are widened by this relative margin, which exceeds the accumulated rounding error."""

AIM = 0.5
"""A trial ends where the bounds are closer than this share of their distance at the root, discounted."""

FINEST, LEAST = 1e-2, 1e-6
"""An improvement is stored if it exceeds this share of a trial's target: at first, and at the end."""

NONE = -1


@dataclass(frozen=True)
class JointBounds:
    """Bounds on the optimal value of a team.

    Attributes
    ----------
    lower : float
        Expected discounted return of some policy from the beginning of an episode, in cost units.
    upper : float
        Upper bound on that of every policy.
    never : float
        That of never helping.
    states : int
        Number of observed states: the states of all tasks and the robot's location.
    hidden : int
        Number of hidden states: beta and theta of all people.
    """

    lower: float
    upper: float
    never: float
    states: int
    hidden: int

    @property
    def gap(self) -> float:
        """The distance of the bounds, relative to the lower one."""
        return (self.upper - self.lower) / abs(self.lower) if self.lower else 0.0


def joint_bounds(
    pool: Pool,
    team: tuple[int, ...] | None = None,
    *,
    gap: float = 1e-3,
) -> JointBounds:
    """Solve the POMDP of a team in which all people start together, in the robot's model.

    The robot moves to a person only to act there. Moving earlier has no advantage as long as the distances satisfy the
    triangle inequality.

    Parameters
    ----------
    pool : Pool
    team : tuple of int, optional
        Indices of the team's people; the whole pool unless given.
    gap : float
        Stop when (upper - lower) / |lower| is at most this.
    """
    team = tuple(range(len(pool.people))) if team is None else team
    travel = pool.setting.travel(len(team))
    people = [pool.policies[pool.model[person]].pomdp for person in team]
    m = written_out(people, travel)
    belief = product_of([pomdp.prior.ravel() for pomdp in people])
    tasks = np.ravel_multi_index([p.model.choices.initial for p in people], [len(p.robot_actions) for p in people])
    root = int(tasks) * len(m.way) + len(people)  # the base is the last location
    states, hidden = len(m.way) * (len(m.first) - 1), len(belief)
    # Costs are nonnegative. From 0, every iterate is an upper bound; from the largest cost in every step, a lower
    # bound.
    seen = np.zeros((states, hidden))
    never = np.full((states, hidden), m.reward.min() / (1 - m.gamma))
    for value, helping in ((seen, True), (never, False)):
        while _sweep(value, helping, m) > SETTLED:
            pass
    plans, points = _Store.of(never, np.arange(states)), _Store.of(np.empty((0, hidden)), np.full(states, NONE))
    path, beliefs = np.full(DEPTH, root), np.tile(belief, (DEPTH, 1))
    plans, points, finest = plans.with_room(), points.with_room(), FINEST
    _trial(path, beliefs, np.inf, finest, plans, points, seen, m)  # loads or compiles the code
    while True:
        lower, upper = _lower(root, belief, plans)[0], _upper(root, belief, seen, points)
        if upper - lower <= gap * abs(lower):
            break
        plans, points = plans.with_room(), points.with_room()
        aim = max(gap * abs(lower), AIM * (upper - lower))
        if not _trial(path, beliefs, aim, finest, plans, points, seen, m):
            finest /= 2
            if finest < LEAST:  # the rest is rounding error
                break
    return JointBounds(
        lower=lower - MARGIN * abs(lower), upper=upper + MARGIN * abs(upper), never=float(never[root] @ belief),
        states=states, hidden=hidden,
    )  # fmt: skip


class _Store(NamedTuple):
    """Vectors of observed states, in a linked list for each state.

    In the lower bound they are alpha vectors. In the upper bound they are beliefs, at which the bound is lower by
    `drop` than the MDP value.

    Attributes
    ----------
    row : float array, shape (C, H)
    drop : float array, shape (C,)
    after : int array, shape (C,)
        Index of the next vector of the same state.
    head : int array, shape (S,)
        Index of the first vector of each state.
    used : int array, shape (1,)
        Number of vectors.
    """

    row: Floats
    drop: Floats
    after: Ints
    head: Ints
    used: Ints

    @classmethod
    def of(cls, row: Floats, head: Ints) -> _Store:
        """Return a store with one vector for each state, or none."""
        return cls(row, np.zeros(len(row)), np.full(len(row), NONE), head, np.array([len(row)]))

    def with_room(self) -> _Store:
        """Return a store with room for the vectors of a trial."""
        size, room = len(self.row), max(len(self.row), DEPTH)
        if size - self.used[0] >= DEPTH:
            return self
        row = np.concatenate([self.row, np.empty((room, self.row.shape[1]))])
        return self._replace(row=row, drop=np.resize(self.drop, size + room), after=np.resize(self.after, size + room))


# Loops, since array expressions take several times as long to compile.
@numba.njit(cache=True)
def _dot(a: Floats, b: Floats) -> float:
    """Return a . b."""
    total = 0.0
    for h in range(len(a)):
        total += a[h] * b[h]
    return total


@numba.njit(cache=True)
def _fill(a: Floats, value: float) -> None:
    """Set every entry of a."""
    for h in range(len(a)):
        a[h] = value


@numba.njit(cache=True)
def _copy(a: Floats, b: Floats, mass: float) -> None:
    """Set a to b / mass."""
    for h in range(len(a)):
        a[h] = b[h] / mass


@numba.njit(cache=True)
def _nowhere_below(a: Floats, b: Floats) -> bool:
    """Return whether a >= b in every entry."""
    for h in range(len(a)):  # noqa: SIM110  numba has no generators
        if not a[h] >= b[h]:
            return False
    return True


@numba.njit(cache=True)
def _put(s: int, row: Floats, drop: float, store: _Store) -> None:
    """Store a vector, and remove the vectors of its state that it dominates."""
    before, i = NONE, store.head[s]
    while i != NONE:
        if drop > 0.0:  # in the upper bound
            share = np.inf
            for h in range(len(row)):
                if row[h] > 0.0 and store.row[i, h] < share * row[h]:
                    share = store.row[i, h] / row[h]
            superfluous = share * drop >= store.drop[i]
        else:
            superfluous = _nowhere_below(row, store.row[i])
        if not superfluous:
            before = i
        elif before == NONE:
            store.head[s] = store.after[i]
        else:
            store.after[before] = store.after[i]
        i = store.after[i]
    i = store.used[0]
    _copy(store.row[i], row, 1.0)
    store.drop[i], store.after[i] = drop, store.head[s]
    store.head[s], store.used[0] = i, i + 1


@numba.njit(cache=True)
def _ends(d: int, s: int, m: JointProblem) -> tuple[int, float]:
    """Return the robot's location after an action, and the cost of moving there."""
    place = s % len(m.way)
    to = place if m.person[d] == NOBODY else m.person[d]
    return to, m.way[place, to]


@numba.njit(cache=True)
def _back(d: int, o: int, value: Floats, m: JointProblem, total: Floats) -> None:
    """Add the discounted value of an outcome to `total`, shape (H,), where `value`, shape (H,), is that of its
    target.
    """
    for h in range(len(total)):
        moved = (1.0 - m.weight[d, h]) * value[m.low[d, h]] + m.weight[d, h] * value[m.high[d, h]]
        total[h] += m.gamma * m.chance[o, h] * moved


@numba.njit(cache=True)
def _sweep(value: Floats, helping: bool, m: JointProblem) -> float:
    """Update all values with everything observed, shape (S, H), of the optimal policy or of never helping, once.

    Returns the largest change.
    """
    places, hidden = len(m.way), value.shape[1]
    best, total, change = np.empty(hidden), np.empty(hidden), 0.0
    for s in range(len(value)):
        y = s // places
        _fill(best, 0.0 if m.first[y] == m.first[y + 1] else -np.inf)
        for d in range(m.first[y], m.first[y + 1] if helping else min(m.first[y] + 1, m.first[y + 1])):
            to, way = _ends(d, s, m)
            for h in range(hidden):
                total[h] = m.reward[d, h] - way
            for o in range(m.begin[d], m.begin[d + 1]):
                _back(d, o, value[m.target[o] * places + to], m, total)
            for h in range(hidden):
                best[h] = max(best[h], total[h])
        for h in range(hidden):
            change = max(change, abs(best[h] - value[s, h]))
            value[s, h] = best[h]
    return change


@numba.njit(cache=True)
def _lower(s: int, belief: Floats, plans: _Store) -> tuple[float, int]:
    """Return the largest product of an alpha vector and a belief, which may be unnormalised, and the vector's index."""
    best, which, i = -np.inf, NONE, plans.head[s]
    while i != NONE:
        product = 0.0
        for h in range(len(belief)):
            product += plans.row[i, h] * belief[h]
        if product > best:
            best, which = product, i
        i = plans.after[i]
    return best, which


@numba.njit(cache=True)
def _upper(s: int, belief: Floats, seen: Floats, points: _Store) -> float:
    """Return the sawtooth bound at a belief, which may be unnormalised.

    The belief contains a multiple of each stored belief, and the bound that multiple of its drop.
    """
    corner, most, i = 0.0, 0.0, points.head[s]
    for h in range(len(belief)):
        corner += seen[s, h] * belief[h]
    while i != NONE:
        # The share decreases from one hidden state to the next, until its drop does not exceed the largest one so far.
        share = np.inf
        for h in range(len(belief)):
            if points.row[i, h] > 0.0 and belief[h] < share * points.row[i, h]:
                share = belief[h] / points.row[i, h]
                if share * points.drop[i] <= most:
                    break
        most = max(most, share * points.drop[i])
        i = points.after[i]
    return corner - most


@numba.njit(cache=True)
def _reach(d: int, o: int, belief: Floats, m: JointProblem, after: Floats) -> float:
    """Fill `after` with the belief after an outcome, times the outcome's probability, which is returned."""
    _fill(after, 0.0)
    total = 0.0
    for h in range(len(belief)):
        joint = belief[h] * m.chance[o, h]
        after[m.low[d, h]] += joint * (1.0 - m.weight[d, h])
        after[m.high[d, h]] += joint * m.weight[d, h]
        total += joint
    return total


@numba.njit(cache=True)
def _trial(
    path: Ints, beliefs: Floats, gap: float, finest: float, plans: _Store, points: _Store, seen: Floats, m: JointProblem
) -> int:
    """Follow a path from its first state and belief to where the bounds are close, then back up along it.

    Returns the number of stored vectors.
    """
    places, after, depth = len(m.way), np.empty(beliefs.shape[1]), 0
    deeds = 0
    for y in range(len(m.first) - 1):
        deeds = max(deeds, m.first[y + 1] - m.first[y])
    q = np.empty((len(path), deeds))
    while True:
        s, belief = path[depth], beliefs[depth]
        y = s // places
        best, deed = -np.inf, NONE
        for d in range(m.first[y], m.first[y + 1]):
            to, way = _ends(d, s, m)
            value = _dot(m.reward[d], belief) - way
            for o in range(m.begin[d], m.begin[d + 1]):
                if _reach(d, o, belief, m, after) > 0.0:
                    value += m.gamma * _upper(m.target[o] * places + to, after, seen, points)
            q[depth, d - m.first[y]] = value
            if value > best:
                best, deed = value, d
        to, _ = _ends(deed, s, m)
        most = 0.0
        for o in range(m.begin[deed], m.begin[deed + 1]):
            chance = _reach(deed, o, belief, m, after)
            if chance > 0.0:
                target = m.target[o] * places + to
                excess = _upper(target, after, seen, points) - _lower(target, after, plans)[0] - gap / m.gamma * chance
                if excess > most:
                    most, path[depth + 1] = excess, target
                    _copy(beliefs[depth + 1], after, chance)
        if most == 0.0 or depth == len(path) - 2:
            break
        depth += 1
        gap /= m.gamma
    stored = 0
    for i in range(depth, -1, -1):
        stored += _backup(path[i], beliefs[i], q[i], finest * gap, plans, points, seen, m)
        gap *= m.gamma
    return stored


@numba.njit(cache=True)
def _backup(
    s: int, belief: Floats, q: Floats, finest: float, plans: _Store, points: _Store, seen: Floats, m: JointProblem
) -> int:
    """Improve both bounds at a belief by a Bellman backup; return the number of improved bounds.

    Actions whose upper bound `q` is below the lower bound are skipped.
    """
    stored = 0
    places, y = len(m.way), s // len(m.way)
    after, alpha = np.empty(len(belief)), np.empty(len(belief))
    below, above, deed = -np.inf, -np.inf, NONE
    known, bound = _lower(s, belief, plans)[0], _upper(s, belief, seen, points)
    for d in range(m.first[y], m.first[y + 1]):
        if q[d - m.first[y]] < known:
            continue
        to, way = _ends(d, s, m)
        low = high = _dot(m.reward[d], belief) - way
        for o in range(m.begin[d], m.begin[d + 1]):
            if _reach(d, o, belief, m, after) > 0.0:
                target = m.target[o] * places + to
                low += m.gamma * _lower(target, after, plans)[0]
                high += m.gamma * _upper(target, after, seen, points)
        above = max(above, high)
        if low > below:
            below, deed = low, d
    if below > known + finest:
        to, way = _ends(deed, s, m)
        for h in range(len(alpha)):
            alpha[h] = m.reward[deed, h] - way
        for o in range(m.begin[deed], m.begin[deed + 1]):
            _reach(deed, o, belief, m, after)
            target = m.target[o] * places + to
            _back(deed, o, plans.row[_lower(target, after, plans)[1]], m, alpha)
        _put(s, alpha, 0.0, plans)
        stored += 1
    if deed != NONE and above < bound - finest:
        _put(s, belief, _dot(seen[s], belief) - above, points)
        stored += 1
    return stored
