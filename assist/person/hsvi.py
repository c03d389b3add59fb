"""The search for bounds on one person's problem: compiled code and the arrays that it works on.

**Above**, each state has a `UpperHull`. The value is a convex and homogeneous function of the (unnormalised) belief, so
that weights w >= 0 with  sum_i w_i b_i <= b  give

    V(b) <= corner . b + sum_i w_i d_i,     d_i = v_i - corner . b_i <= 0,

where V(b_i) <= v_i is known and `corner` bounds the value at the corners of the simplex. The best weights solve a
linear program. The sawtooth of Hauskrecht ("Value-function approximations for partially observable Markov
decision processes", 2000) lets one belief at a time carry weight: that is the simplex method's first pivot. Here
some more pivots follow, which is cheap, since a basis has few beliefs and the costs of all slacks are zero, and
makes the bound much tighter between beliefs. Whatever pivots and rounding do, the weights are checked in
the end: any that keep the two conditions give a bound. So the bound that the search works with is not exactly convex;
`upper_hull` answers with one that is.

**Below**, each state has `AlphaVectors`, alpha vectors: what some plan gets for each (beta, theta).

`trials` adds to both, and `renew` works out anew what has been there for long. `solver` says in what order, and hands
the result on.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.system.jit import njit

from ..people.decision import Floats
from ..people.influence_kernels import answer
from .qmdp import ROUNDING

DEPTH = 500  # of a trial
TARGET = 0.2  # a trial ends where the gap, discounted, is below this share of the gap at the root
FINER = (0.98, 0.1)  # what a trial that improves nothing makes of `trials`' two measures of fineness
FEW = 32  # vectors of a state that are all looked at, whether or not they are of use
PIVOTS = 5
CANDIDATES = 256  # the latest beliefs of a state that a bound may rest on
RELEVANT = 0.5  # beliefs that could lower the bound by less than this share of what one can are left aside
NONE = -1
ZERO, ONE, NEITHER = map(np.int64, (0, 1, NONE))  # numba compiles what is called with a literal once more for it
TINY, HUGE = 1e-290, 1e300  # TINY * HUGE is large, so that an empty entry of both beliefs never binds
FAST = {"reassoc", "contract", "nsz", "nnan"}


class UpperHull(NamedTuple):
    """Beliefs with values, as linked lists, one for each state.

    Attributes
    ----------
    corner : float array, shape (n, H)
        Upper bounds where the hidden state is known, H = B * T.
    belief, inverse : float arrays, shape (capacity, H)
        Beliefs of mass 1, and one over each entry.
    drop : float array, shape (capacity,)
        The bound at each belief less what the corners give; below 0.
    state, after : int arrays, shape (capacity,)
        Whose belief it is (-1: free), and the next one of the same state (or the next free one).
    head : int array, shape (n,)
        The first belief of each state.
    space : int array, shape (2,)
        Places that have been used, and the first free one among them.
    """

    corner: Floats
    belief: Floats
    inverse: Floats
    drop: Floats
    state: NDArray[np.int32]
    after: NDArray[np.int32]
    head: NDArray[np.int32]
    space: NDArray[np.int64]


class Room(NamedTuple):
    """Room for a linear program: candidates, their possible worth, and a basis."""

    candidate: NDArray[np.int32]
    worth: Floats
    basis: NDArray[np.int32]
    row: NDArray[np.int64]
    weight: Floats
    dual: Floats
    direction: Floats
    matrix: Floats
    left: Floats
    change: Floats


class AlphaVectors(NamedTuple):
    """Alpha vectors as linked lists, one for each state.

    Vectors that are nowhere best any more leave the list, so that the search need not look at them, but stay
    stored (`state`): others rest on them.
    """

    vector: Floats
    witness: Floats  # the belief for which it was made
    robot: NDArray[np.int32]
    state: NDArray[np.int32]  # -1: free
    after: NDArray[np.int32]
    head: NDArray[np.int32]
    live: NDArray[np.int64]  # length of each state's list
    limit: NDArray[np.int64]  # length at which it is looked through
    space: NDArray[np.int64]  # places that have been used, and the first free one among them


class Trial(NamedTuple):
    """What a trial knows at each depth."""

    state: NDArray[np.int64]
    belief: Floats
    bound: Floats  # upper bound there
    robot: NDArray[np.int64]
    chance: Floats  # of the child that is gone on to
    q: Floats  # upper bound on the return of each robot action
    known: NDArray[np.bool_]  # whether that was worked out from the children
    child: Floats  # upper bound of each child, times its probability
    after: Floats  # unnormalised belief of each child
    mass: Floats  # its probability


def empty_hull(corner: Floats, capacity: int) -> UpperHull:
    """Make a hull of the corners only."""
    states, size = corner.shape
    return UpperHull(
        corner=corner,
        belief=np.empty((capacity, size)),
        inverse=np.empty((capacity, size)),
        drop=np.empty(capacity),
        state=np.full(capacity, NONE, dtype=np.int32),
        after=np.full(capacity, NONE, dtype=np.int32),
        head=np.full(states, NONE, dtype=np.int32),
        space=np.array([0, NONE]),
    )


def no_plans(states: int, size: int, capacity: int) -> AlphaVectors:
    """Make room for vectors of so many numbers."""
    return AlphaVectors(
        vector=np.empty((capacity, size)),
        witness=np.empty((capacity, size)),
        robot=np.zeros(capacity, dtype=np.int32),
        state=np.full(capacity, NONE, dtype=np.int32),
        after=np.full(capacity, NONE, dtype=np.int32),
        head=np.full(states, NONE, dtype=np.int32),
        live=np.zeros(states, dtype=np.int64),
        limit=np.full(states, FEW),
        space=np.array([0, NONE]),
    )


def new_path(size: int, robots: int, slots: int) -> Trial:
    """Make room for a trial, with beliefs of so many numbers, and so many choices of the robot and of the person."""
    return Trial(
        state=np.empty(DEPTH, dtype=np.int64),
        belief=np.empty((DEPTH, size)),
        bound=np.empty(DEPTH),
        robot=np.empty(DEPTH, dtype=np.int64),
        chance=np.empty(DEPTH),
        q=np.empty((DEPTH, robots)),
        known=np.empty((DEPTH, robots), dtype=bool),
        child=np.empty((DEPTH, robots, slots)),
        after=np.empty((DEPTH, robots, slots, size)),
        mass=np.empty((DEPTH, robots, slots)),
    )


@njit()
def new_room(size):
    """Make room for `upper` at beliefs of so many numbers."""
    k = PIVOTS + 1
    return Room(
        np.empty(CANDIDATES, np.int32), np.empty(CANDIDATES), np.empty(k, np.int32), np.empty(k, np.int64),
        np.empty(k), np.empty(k), np.empty(k), np.empty((k, k)), np.empty(size), np.empty(size),
    )  # fmt: skip


# Sums may be taken in any order: what that does to rounding is covered by the margin of each backup.
@njit(fastmath=FAST)
def dot(a, b):
    """Give a . b."""
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


# The same for whole arrays (a[:] = b, (a <= b).all(), a / b) takes several times as long to compile, since it brings
# broadcasting and the words of its errors along, once for each function from which it is called.
@njit()
def _fill(a, value):
    """Set every entry of a."""
    for i in range(len(a)):
        a[i] = value


@njit()
def _copy(a, b):
    """Set a to b."""
    for i in range(len(a)):
        a[i] = b[i]


@njit()
def _nowhere_above(a, b):
    """Tell whether a <= b."""
    for i in range(len(a)):  # noqa: SIM110  numba has no generators
        if not a[i] <= b[i]:
            return False
    return True


@njit(fastmath=FAST)
def _share(belief, inverse, enough):
    """Give the largest weight of a belief within another, or something below `enough` once it cannot reach that."""
    size, at, share = len(belief), 0, HUGE
    while at < size:
        end = min(at + 12, size)
        for h in range(at, end):
            share = min(share, (belief[h] + TINY) * inverse[h])
        if share < enough:
            return share
        at = end
    return share


@njit()
def upper(x, belief, hull, room):
    """Give the upper bound of a state at an unnormalised belief."""
    drop, inverse, after, candidate, worths = hull.drop, hull.inverse, hull.after, room.candidate, room.worth
    base = dot(hull.corner[x], belief)
    best, first, count = 0.0, NONE, 0
    i = hull.head[x]
    while i >= 0:
        worth = drop[i] * _share(belief, inverse[i], RELEVANT * best / drop[i])
        if worth < RELEVANT * best and count < CANDIDATES:
            candidate[count], worths[count] = i, worth
            count += 1
        if worth < best:
            best, first = worth, i
        i = after[i]
    if count < 2:
        return base + best
    return base + min(best, _pivot(belief, first, best, count, hull, room))


@njit()
def _pivot(belief, first, best, count, hull, room):
    """Improve on the weight of one belief by the simplex method; return what the weights found are worth.

    Basic columns are the beliefs `basis`, and all slacks but those of the entries `row`.
    """
    basis, row, weight, dual, direction, matrix = (
        room.basis, room.row, room.weight, room.dual, room.direction, room.matrix,
    )  # fmt: skip
    left, change, drop, points = room.left, room.change, hull.drop, hull.belief
    k = ONE
    basis[0], row[0], weight[0] = first, 0, best / drop[first]
    smallest = HUGE
    for h in range(len(belief)):
        share = (belief[h] + TINY) * hull.inverse[first, h]
        if share < smallest:
            smallest, row[0] = share, h
    for _ in range(PIVOTS):
        for j in range(k):
            dual[j] = drop[basis[j]]
            for r in range(k):
                matrix[j, r] = points[basis[j], row[r]]
        if not _eliminate(matrix, dual, k):
            break
        enter, slack = _price(belief, best, count, k, hull, room)
        if enter == NONE and slack == NONE:
            break
        for r in range(k):
            for j in range(k):
                matrix[r, j] = points[basis[j], row[r]]
            direction[r] = 1.0 if r == slack else 0.0
            if enter >= 0:
                direction[r] = points[enter, row[r]]
        if not _eliminate(matrix, direction, k):
            break
        step, leave = HUGE, NONE
        for j in range(k):
            if direction[j] > 1e-12 and weight[j] < step * direction[j]:
                step, leave = weight[j] / direction[j], j
        bound = NONE
        _copy(left, belief)
        if enter >= 0:
            _copy(change, points[enter])
        else:
            _fill(change, 0.0)
        for j in range(k):
            _subtract(left, weight[j], points[basis[j]])
            _subtract(change, direction[j], points[basis[j]])
        for r in range(k):  # the slacks of these are not in the basis
            change[row[r]] = 0.0
        for h in range(len(belief)):
            if change[h] > 1e-12 and left[h] < step * change[h]:
                step, bound = max(left[h], 0.0) / change[h], h
        if step >= HUGE:
            break
        for j in range(k):
            weight[j] -= step * direction[j]
        if bound >= 0 and enter >= 0:
            basis[k], row[k], weight[k] = enter, bound, step
            k += 1
        elif bound >= 0:
            row[slack] = bound
        elif enter >= 0:
            basis[leave], weight[leave] = enter, step
        elif k == 1:
            break
        else:
            k -= 1
            basis[leave], weight[leave], row[slack] = basis[k], weight[k], row[k]
    worth, scale = 0.0, 1.0
    _fill(left, 0.0)
    for j in range(k):
        weight[j] = max(weight[j], 0.0)
        worth += weight[j] * drop[basis[j]]
        _subtract(left, -weight[j], points[basis[j]])
    for h in range(len(belief)):
        if left[h] > belief[h]:
            scale = min(scale, belief[h] / left[h])
    return worth * scale


@njit(fastmath=FAST)
def _subtract(a, factor, b):
    """Take factor * b from a."""
    for i in range(len(a)):
        a[i] -= factor * b[i]


@njit()
def _price(belief, best, count, k, hull, room):
    """Give the candidate, or else the position in `row` of the slack, that promises most; `NONE` for neither."""
    drop, points, candidate, worth, dual, row = (
        hull.drop, hull.belief, room.candidate, room.worth, room.dual, room.row,
    )  # fmt: skip
    enter, slack, most = NONE, NONE, 1e-3 * best
    for c in range(count):
        i = candidate[c]
        reduced = drop[i]
        for r in range(k):
            reduced -= dual[r] * points[i, row[r]]
        gain = reduced * worth[c] / drop[i]
        if reduced < 0.0 and gain < most:
            enter, most = i, gain
    if enter == NONE:
        for r in range(k):
            gain = -dual[r] * belief[row[r]]
            if gain < most:
                slack, most = r, gain
    return enter, slack


@njit()
def _eliminate(a, y, k):
    """Solve a z = y in place by Gaussian elimination; return whether a is regular."""
    for c in range(k):
        p = c
        for r in range(c + 1, k):
            if abs(a[r, c]) > abs(a[p, c]):
                p = r
        if abs(a[p, c]) < 1e-14:
            return False
        if p != c:
            for j in range(k):
                a[p, j], a[c, j] = a[c, j], a[p, j]
            y[p], y[c] = y[c], y[p]
        for r in range(c + 1, k):
            factor = a[r, c] / a[c, c]
            for j in range(c, k):
                a[r, j] -= factor * a[c, j]
            y[r] -= factor * y[c]
    for c in range(k - 1, -1, -1):
        for j in range(c + 1, k):
            y[c] -= a[c, j] * y[j]
        y[c] /= a[c, c]
    return True


@njit()
def add_point(x, belief, value, hull):
    """Add the bound at a belief of mass 1, and remove beliefs that it makes superfluous."""
    after, head, space, drops, inverse, state = hull.after, hull.head, hull.space, hull.drop, hull.inverse, hull.state
    drop = value + ROUNDING * abs(value) - dot(hull.corner[x], belief)
    if drop >= 0.0:
        return
    new = space[1]
    if new >= 0:
        space[1] = after[new]
    else:
        new = space[0]
        space[0] += 1
    for h in range(len(belief)):
        hull.belief[new, h] = belief[h]
        inverse[new, h] = 1.0 / belief[h] if belief[h] > 1e-200 else HUGE
    drops[new], state[new] = drop, x
    before, i = NONE, head[x]
    while i >= 0:
        following = after[i]
        needed = drops[i] / drop
        if _share(hull.belief[i], inverse[new], needed) >= needed:
            if before >= 0:
                after[before] = following
            else:
                head[x] = following
            after[i], state[i], space[1] = space[1], NONE, i
        else:
            before = i
        i = following
    after[new], head[x] = head[x], new


@njit()
def lower(x, belief, plans):
    """Give the lower bound at an unnormalised belief, and the vector that it comes from."""
    best, at = -np.inf, NONE
    i = plans.head[x]
    while i >= 0:
        value = dot(plans.vector[i], belief)
        if value > best:
            best, at = value, i
        i = plans.after[i]
    return best, at


@njit()
def add_plan(x, robot, vector, belief, plans):
    """Add an alpha vector to a state, made for a belief, and remove those that are nowhere above it."""
    after, head, space, live = plans.after, plans.head, plans.space, plans.live
    before, i = NONE, head[x]
    while i >= 0:
        following = after[i]
        if _nowhere_above(plans.vector[i], vector):
            if before >= 0:
                after[before] = following
            else:
                head[x] = following
            after[i], plans.state[i], space[1] = space[1], NONE, i
            live[x] -= 1
        else:
            before = i
        i = following
    i = space[1]
    if i >= 0:
        space[1] = after[i]
    else:
        i = space[0]
        space[0] += 1
    _copy(plans.vector[i], vector)
    _copy(plans.witness[i], belief)
    plans.robot[i], plans.state[i] = robot, x
    after[i], head[x] = head[x], i
    live[x] += 1
    if live[x] > plans.limit[x]:
        _retire(x, plans)
        plans.limit[x] = max(FEW, 2 * live[x])


@njit()
def _retire(x, plans):
    """Keep in a state's list only the vectors that are best at some belief for which one of them was made."""
    after, head = plans.after, plans.head
    useful = np.zeros(plans.live[x], dtype=np.bool_)
    i = head[x]
    while i >= 0:
        best, at = -np.inf, 0
        k, j = 0, head[x]
        while j >= 0:
            value = dot(plans.vector[j], plans.witness[i])
            if value > best:
                best, at = value, k
            k, j = k + 1, after[j]
        useful[at] = True
        i = after[i]
    before, k, i, kept = NONE, 0, head[x], 0
    while i >= 0:
        following = after[i]
        if useful[k]:
            before = i
            kept += 1
        elif before >= 0:
            after[before] = following
        else:
            head[x] = following
        k, i = k + 1, following
    plans.live[x] = kept


@njit()
def add_plans(value, robot, belief, plans):
    """Add a vector to every state."""
    for x in range(len(value)):
        add_plan(x, robot[x], value[x], belief, plans)


@njit()
def _split(x, r, belief, told, other, lapsed, m):
    """Split a belief by what the person will do.

    After slot a, which is chosen with p(beta), the unnormalised belief is

        p(beta) * (told where a is suggested, else other) + lapsed

    Return the state in which the person acts, and the suggested slot.
    """
    thetas = len(m.theta)
    place, slot = m.afterstate[x, r], m.suggested[x, r]
    steady, uniform = 1.0 - m.lapse, m.lapse / max(m.counts[place], 1)
    if slot < 0:
        for h in range(len(belief)):
            told[h] = other[h] = steady * belief[h]
            lapsed[h] = uniform * belief[h]
        return place, slot
    _fill(told, 0.0)
    _fill(other, 0.0)
    _fill(lapsed, 0.0)
    for h in range(len(belief)):
        mass = belief[h]
        if mass == 0.0:
            continue
        b, t = h // thetas, h % thetas
        yes, no = answer(m.theta[t], m.chosen[x, slot, b], m.unsuggested[x, r, b])
        at, up = h - t + m.low[x, r, t], m.weight[x, r, t]
        told[at] += steady * yes * (1.0 - up) * mass
        told[at + 1] += steady * yes * up * mass
        other[at] += steady * no * (1.0 - up) * mass
        other[at + 1] += steady * no * up * mass
        lapsed[at] += uniform * (1.0 - up) * mass
        lapsed[at + 1] += uniform * up * mass
    return place, slot


@njit(fastmath=FAST)
def _child(place, a, slot, told, other, lapsed, child, m):
    """Fill in the unnormalised belief after slot `a`; return its mass."""
    thetas = len(m.theta)
    heard = told if a == slot else other
    mass = 0.0
    for b in range(len(child) // thetas):
        p = m.chosen[place, a, b]
        for h in range(b * thetas, (b + 1) * thetas):
            child[h] = p * heard[h] + lapsed[h]
            mass += child[h]
    return mass


@njit()
def _follow(d, r, work, path, m):
    """Fill in the beliefs after a robot action and each slot; return the state in which the person acts."""
    x = path.state[d]
    place, slot = _split(x, r, path.belief[d], work[0], work[1], work[2], m)
    if not m.goal[place]:
        for a in range(m.counts[place]):
            path.mass[d, r, a] = _child(place, a, slot, work[0], work[1], work[2], path.after[d, r, a], m)
    return place


@njit()
def _look_up(d, r, work, room, path, hull, m):
    """Bound the return of a robot action from above by its children's bounds."""
    x = path.state[d]
    value = -m.robot_costs[x, r]
    place = _follow(d, r, work, path, m)
    if not m.goal[place]:
        for a in range(m.counts[place]):
            path.child[d, r, a] = upper(m.targets[place, a], path.after[d, r, a], hull, room)
            value += m.gamma * path.child[d, r, a] - m.costs[place, a] * path.mass[d, r, a]
    path.q[d, r] = min(path.q[d, r], value)
    path.known[d, r] = True


@njit()
def _promising(d, work, room, path, hull, m):
    """Give the robot action with the largest upper bound, and look up no more of them than that needs."""
    robots = m.robot_actions[path.state[d]]
    while True:
        r = ZERO
        for k in range(1, robots):
            if path.q[d, k] > path.q[d, r]:
                r = k
        if path.known[d, r]:
            return r
        _look_up(d, r, work, room, path, hull, m)


@njit()
def _look_down(d, r, work, path, picked, plans, m):
    """Bound the return of a robot action from below, and fill in the vector picked after each slot."""
    x = path.state[d]
    value = -m.robot_costs[x, r]
    place = m.afterstate[x, r] if path.known[d, r] else _follow(d, r, work, path, m)
    if not m.goal[place]:
        for a in range(m.counts[place]):
            v, picked[a] = lower(m.targets[place, a], path.after[d, r, a], plans)
            value += m.gamma * v - m.costs[place, a] * path.mass[d, r, a]
    return value


@njit()
def _plan(x, r, picked, vector, plans, m):
    """Fill in the alpha vector of a robot action that is followed by the picked vectors."""
    thetas = len(m.theta)
    place, slot = m.afterstate[x, r], m.suggested[x, r]
    if m.goal[place]:
        _fill(vector, -m.robot_costs[x, r])
        return
    count = m.counts[place]
    other, mean, told = np.empty(thetas), np.empty(thetas), np.empty(thetas)
    for b in range(len(vector) // thetas):
        _fill(other, 0.0)
        _fill(mean, 0.0)
        _fill(told, 0.0)
        for a in range(count):
            p, c, i = m.chosen[place, a, b], m.costs[place, a], picked[a]
            for t in range(thetas):
                u = m.gamma * plans.vector[i, b * thetas + t] - c
                if a == slot:
                    told[t] = p * u
                else:
                    other[t] += p * u
                mean[t] += u / count
        for t in range(thetas):
            if slot < 0:
                v = (1.0 - m.lapse) * other[t] + m.lapse * mean[t]
            else:
                at, up = m.low[x, r, t], m.weight[x, r, t]
                yes, no = answer(m.theta[t], m.chosen[x, slot, b], m.unsuggested[x, r, b])
                v = (1.0 - m.lapse) * (
                    (1.0 - up) * (yes * told[at] + no * other[at]) + up * (yes * told[at + 1] + no * other[at + 1])
                ) + m.lapse * ((1.0 - up) * mean[at] + up * mean[at + 1])
            v -= m.robot_costs[x, r]
            vector[b * thetas + t] = v - ROUNDING * abs(v)


@njit()
def new_plan(size, slots):
    """Make room for a plan: the vectors picked after each slot, those of the best robot action, and its own vector."""
    return np.empty(slots, np.int64), np.empty(slots, np.int64), np.empty(size)


@njit()
def _raise(d, step, work, path, plan, plans, m):
    """Back the lower bound up at a depth of the path; return whether it gained more than `step`."""
    x, belief = path.state[d], path.belief[d]
    picked, kept, vector = plan
    best, robot = -np.inf, NEITHER
    for r in range(m.robot_actions[x]):
        if path.q[d, r] > best:
            value = _look_down(d, r, work, path, picked, plans, m)
            if value > best:
                best, robot = value, r
                _copy(kept, picked)
    if not best > lower(x, belief, plans)[0] + step + 4 * ROUNDING * abs(best):
        return False
    _plan(x, robot, kept, vector, plans, m)
    add_plan(x, robot, vector, belief, plans)
    return True


@njit()
def _begin(d, belief, mass, q, path, m):
    """Put belief / mass on the path, with what is known of each robot action before its children are looked at."""
    x, own = path.state[d], path.belief[d]
    for h in range(len(belief)):
        own[h] = belief[h] / mass
    for r in range(m.robot_actions[x]):
        path.q[d, r], path.known[d, r] = dot(q[x, r], own), False


@njit(nogil=True)
def trials(x0, prior, enough, backups, fineness, rng, path, plans, hull, q, m):
    """Run trials until the gap is closed, room is short, or so many backups have been done; return their number.

    A trial goes on to a child with a chance in proportion to what that adds to the gap beyond the target. Where it
    always went to the one that adds most, it would meet people who err, and go back and forth, again and again.

    `fineness` says what is too little to be of use: [0] of a bound's gain, as a share of the gap aimed at, and [1] of
    what a child adds to the gap at the root, as a share of that. A trial that improves nothing makes one of them finer.
    """
    work, room = np.empty((3, len(prior))), new_room(len(prior))
    plan, done = new_plan(len(prior), m.targets.shape[1]), 0
    while done < backups:
        path.bound[0] = upper(x0, prior, hull, room)
        gap = path.bound[0] - lower(x0, prior, plans)[0]
        short = min(len(plans.robot) - plans.space[0], len(hull.drop) - hull.space[0]) < len(path.state)
        if gap <= enough or short:
            break
        path.state[0] = x0
        _begin(ZERO, prior, 1.0, q, path, m)
        depth, target, reach, cut = ZERO, TARGET * gap, 1.0, False
        while True:
            x = path.state[depth]
            r = _promising(depth, work, room, path, hull, m)
            path.robot[depth] = r
            place = m.afterstate[x, r]
            if m.goal[place] or depth + 1 == len(path.state):
                break
            beyond, chosen = 0.0, NONE
            target /= m.gamma
            reach *= m.gamma
            for a in range(m.counts[place]):
                y = m.targets[place, a]
                if m.final[y]:
                    continue
                apart = path.child[depth, r, a] - lower(y, path.after[depth, r, a], plans)[0]
                excess = apart - target * path.mass[depth, r, a]
                if excess > 0.0 and reach * apart < fineness[1] * gap:
                    cut = True
                elif excess > 0.0:
                    beyond += excess
                    if rng.random() * beyond < excess:  # so each is chosen with a chance of excess / beyond in the end
                        chosen = a
            if chosen == NONE:
                break
            chance = path.mass[depth, r, chosen]
            path.chance[depth] = chance
            reach *= chance
            depth += 1
            path.state[depth] = m.targets[place, chosen]
            path.bound[depth] = path.child[depth - 1, r, chosen] / chance
            _begin(depth, path.after[depth - 1, r, chosen], chance, q, path, m)
        improved, lowered = False, 0.0
        for d in range(depth, -1, -1):
            x, belief = path.state[d], path.belief[d]
            path.q[d, path.robot[d]] -= m.gamma * path.chance[d] * lowered if d < depth else 0.0
            value = path.q[d, _promising(d, work, room, path, hull, m)]
            value += ROUNDING * abs(value)
            step = fineness[0] * target
            target *= m.gamma
            lowered = 0.0
            if value < path.bound[d] - step - 4 * ROUNDING * abs(value):
                # Pivots that stop early may find a little less or more where a belief has another mass.
                now = upper(x, belief, hull, room)
                if value < now - step - 4 * ROUNDING * abs(value):
                    add_point(x, belief, value, hull)
                    improved = True
                lowered = path.bound[d] - min(value, now)
            improved |= _raise(d, step, work, path, plan, plans, m)
        if not improved:
            finer = 1 if cut else 0
            fineness[finer] *= FINER[finer]
        done += depth + 1
    return done


@njit(nogil=True)
def renew(start, order, step, backups, path, plans, hull, q, m):
    """Back up every belief of the hull and every vector in use again, from `order[start]` on.

    What a trial found rests on what was known then, and most of it is not on the way of any later trial. Return where
    to go on, after so many backups or when room is short, and how many there were.
    """
    size = hull.corner.shape[1]
    work, room = np.empty((3, size)), new_room(size)
    plan, done = new_plan(size, m.targets.shape[1]), 0
    for at in range(start, len(order)):
        x = order[at]
        if hull.head[x] == NONE:  # no trial has been there
            continue
        short = len(plans.robot) - plans.space[0] < plans.live[x]
        if done >= backups or short:
            return at, done
        path.state[0] = x
        i = hull.head[x]
        while i >= 0:
            belief = hull.belief[i]
            _begin(ZERO, belief, 1.0, q, path, m)
            value = path.q[0, _promising(ZERO, work, room, path, hull, m)]
            value += 2 * ROUNDING * abs(value)
            hull.drop[i] = min(hull.drop[i], value - dot(hull.corner[x], belief))
            i = hull.after[i]
            done += 1
        used, i = np.empty(plans.live[x], np.int64), plans.head[x]
        for k in range(len(used)):
            used[k], i = i, plans.after[i]
        for i in used:
            if plans.state[i] != x:  # one of those before has shown it to be superfluous
                continue
            _begin(ZERO, plans.witness[i], 1.0, q, path, m)
            _raise(ZERO, step, work, path, plan, plans, m)
            done += 1
    return len(order), done


@njit(nogil=True)
def lower_at(start, states, beliefs, step, path, hull, q, m):
    """Back the upper bound up at beliefs, shape (N, H), of some states, from one on; gains up to `step` are none.

    Return where to go on when room is short, and how many of them are of use.
    """
    work, room, gained = np.empty((3, beliefs.shape[1])), new_room(beliefs.shape[1]), 0
    for i in range(start, len(states)):
        if len(hull.drop) == hull.space[0]:
            return i, gained
        x, belief = states[i], beliefs[i]
        path.state[0] = x
        _begin(ZERO, belief, 1.0, q, path, m)
        value = path.q[0, _promising(ZERO, work, room, path, hull, m)]
        value += 2 * ROUNDING * abs(value)
        if value < upper(x, belief, hull, room) - step - 4 * ROUNDING * abs(value):
            add_point(x, belief, value, hull)
            gained += 1
    return len(states), gained
