"""The compiled search for bounds on one person's problem, and the arrays that it works on.

**Upper bound.** Each state has a `UpperHull`: beliefs with known bounds, from which `upper_hull` derives the bound at
any other. The search uses a few pivots of its linear program, so that the bound is not exactly convex.

**Lower bound.** Each state has `AlphaVectors`: the returns of plans, for each type and theta.

`trials` improves both bounds along sampled paths, and `renew` repeats old backups. `solver` calls them in turn and
returns the result.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.system.jit import njit

from ..people.decision import Floats
from ..people.influence_kernels import influence_factors
from ..people.type_kernels import leave_out_reached
from .belief_filter import child, split
from .rounding import compiled as rounding
from .upper_hull import new_program, solve

COMPILED_FOR = "bounds on a person's problem: half a minute"

FEW_VECTORS = 32  # length up to which the vector list of a state is not pruned; pruning takes time, long lists too
NONE = -1
ZERO, NEITHER = map(np.int64, (0, NONE))  # numba would compile a function again for a literal argument
# TINY * HUGE is large, so that an entry that is 0 in both beliefs never limits a weight.
TINY, HUGE = 1e-290, 1e300
FAST = {"reassoc", "contract", "nsz", "nnan"}


class UpperHull(NamedTuple):
    """Beliefs with upper bounds, as one linked list per state.

    Attributes
    ----------
    corner : float array, shape (n, cells)
        Upper bounds for a known type and theta, a cell: there are H * T of them.
    belief, inverse : float arrays, shape (capacity, cells)
        Beliefs of mass 1, and the reciprocal of each entry.
    drop : float array, shape (capacity,)
        d_i in `upper_hull`, below 0: the bound at each belief minus corner . belief.
    state, after : int arrays, shape (capacity,)
        State of each belief (-1: unused entry), and the next belief of the same state (or the next unused entry).
    head : int array, shape (n,)
        First belief of each state.
    space : int array, shape (2,)
        Number of entries that have ever been used, and the first unused one among them.
    """

    corner: Floats
    belief: Floats
    inverse: Floats
    drop: Floats
    state: NDArray[np.int32]
    after: NDArray[np.int32]
    head: NDArray[np.int32]
    space: NDArray[np.int64]


class AlphaVectors(NamedTuple):
    """Alpha vectors, as one linked list per state.

    A vector that no longer is best anywhere leaves its list, so that the search does not evaluate it. It stays stored
    (`state`), because the plans of other vectors refer to it.
    """

    vector: Floats
    witness: Floats  # belief for which the vector was computed
    robot: NDArray[np.int32]
    state: NDArray[np.int32]  # -1: unused entry
    after: NDArray[np.int32]
    head: NDArray[np.int32]
    live: NDArray[np.int64]  # length of each state's list
    limit: NDArray[np.int64]  # length at which the list is pruned
    space: NDArray[np.int64]  # number of entries that have ever been used, and the first unused one among them


class Trial(NamedTuple):
    """The data of a trial at each depth."""

    state: NDArray[np.int64]
    belief: Floats
    bound: Floats  # upper bound at the belief
    robot: NDArray[np.int64]
    chance: Floats  # probability of the child that the trial enters, and that the person goes on there
    q: Floats  # upper bound on the Q-value of each robot action
    known: NDArray[np.bool_]  # whether `q` was computed from the children
    child: Floats  # upper bound of each child, times its probability
    after: Floats  # unnormalised belief of each child
    mass: Floats  # probability of each child


def empty_hull(corner: Floats, capacity: int) -> UpperHull:
    """Return a hull that contains the corners only."""
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


def empty_vectors(states: int, size: int, capacity: int) -> AlphaVectors:
    """Return empty vector lists; each vector has `size` entries."""
    return AlphaVectors(
        vector=np.empty((capacity, size)),
        witness=np.empty((capacity, size)),
        robot=np.zeros(capacity, dtype=np.int32),
        state=np.full(capacity, NONE, dtype=np.int32),
        after=np.full(capacity, NONE, dtype=np.int32),
        head=np.full(states, NONE, dtype=np.int32),
        live=np.zeros(states, dtype=np.int64),
        limit=np.full(states, FEW_VECTORS),
        space=np.array([0, NONE]),
    )


def new_trial(depth: int, size: int, robots: int, slots: int) -> Trial:
    """Return an empty trial of up to `depth` steps.

    Beliefs have `size` entries, and there are `robots` robot actions and `slots` choices of the person.
    """
    return Trial(
        state=np.empty(depth, dtype=np.int64),
        belief=np.empty((depth, size)),
        bound=np.empty(depth),
        robot=np.empty(depth, dtype=np.int64),
        chance=np.empty(depth),
        q=np.empty((depth, robots)),
        known=np.empty((depth, robots), dtype=bool),
        child=np.empty((depth, robots, slots)),
        after=np.empty((depth, robots, slots, size)),
        mass=np.empty((depth, robots, slots)),
    )


# Reassociation lets the compiler vectorise the sums. The margin of each backup covers its effect on rounding.
@njit(fastmath=FAST)
def dot(a, b):
    """Return a . b."""
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


# Whole-array forms (a[:] = b, (a <= b).all(), a / b) take several times as long to compile. Each calling function would
# include numba's code for broadcasting and its error messages.
@njit()
def _fill(a, value):
    """Set all entries of a to one value."""
    for i in range(len(a)):
        a[i] = value


@njit()
def _copy(a, b):
    """Copy b into a."""
    for i in range(len(a)):
        a[i] = b[i]


@njit()
def _dominated(a, b):
    """Return whether a <= b in all entries."""
    for i in range(len(a)):  # noqa: SIM110  numba has no generator expressions
        if not a[i] <= b[i]:
            return False
    return True


@njit(fastmath=FAST)
def _largest_weight(belief, inverse, enough):
    """Return the largest w with w * stored <= belief, where `inverse` holds 1 / stored.

    The result is some number below `enough` as soon as the weight is known to be smaller than that.
    """
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
    """Return the upper bound of a state at an unnormalised belief.

    A belief is a candidate for further pivots if its own weight could lower the bound by at least half as much as the
    best belief does. Smaller contributions cost more time than they improve the bound.
    """
    drop, inverse, after = hull.drop, hull.inverse, hull.after
    base = dot(hull.corner[x], belief)
    best, count = 0.0, 0
    i = hull.head[x]
    while i >= 0:
        share = _largest_weight(belief, inverse[i], 0.5 * best / drop[i])
        worth = drop[i] * share
        if worth < 0.5 * best and count < len(room.share):
            room.column[count], room.share[count] = i, share
            count += 1
        best = min(best, worth)
        i = after[i]
    if count < 2:
        return base + best
    worth = 0.0
    # More pivots would tighten the bound, but the search does more backups with cheap bounds.
    for j in range(solve(belief, hull.belief, drop, count, 1e-3 * best, np.int64(5), room)):
        worth += room.weight[j] * drop[room.used[j]]
    return base + min(best, worth)


@njit()
def add_point(x, belief, value, hull):
    """Add a bound at a belief of mass 1 to the hull, and remove the beliefs that it makes redundant.

    A stored belief is redundant if the new one alone gives at least as low a bound there.
    """
    after, head, space, drops, inverse, state = hull.after, hull.head, hull.space, hull.drop, hull.inverse, hull.state
    drop = value + rounding(len(belief)) * abs(value) - dot(hull.corner[x], belief)
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
        if _largest_weight(hull.belief[i], inverse[new], needed) >= needed:
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
def lower(x, belief, vectors):
    """Return the lower bound at an unnormalised belief, and the vector that attains it."""
    best, at = -np.inf, NONE
    i = vectors.head[x]
    while i >= 0:
        value = dot(vectors.vector[i], belief)
        if value > best:
            best, at = value, i
        i = vectors.after[i]
    return best, at


@njit()
def add_vector(x, robot, vector, belief, vectors):
    """Add an alpha vector, computed for a belief, to a state, and remove the vectors that it dominates pointwise."""
    after, head, space, live = vectors.after, vectors.head, vectors.space, vectors.live
    before, i = NONE, head[x]
    while i >= 0:
        following = after[i]
        if _dominated(vectors.vector[i], vector):
            if before >= 0:
                after[before] = following
            else:
                head[x] = following
            after[i], vectors.state[i], space[1] = space[1], NONE, i
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
    _copy(vectors.vector[i], vector)
    _copy(vectors.witness[i], belief)
    vectors.robot[i], vectors.state[i] = robot, x
    after[i], head[x] = head[x], i
    live[x] += 1
    if live[x] > vectors.limit[x]:
        _prune(x, vectors)
        vectors.limit[x] = max(FEW_VECTORS, 2 * live[x])


@njit()
def _prune(x, vectors):
    """Keep only those vectors of a state's list that are best at a witness belief of one of them."""
    after, head = vectors.after, vectors.head
    useful = np.zeros(vectors.live[x], dtype=np.bool_)
    i = head[x]
    while i >= 0:
        best, at = -np.inf, 0
        k, j = 0, head[x]
        while j >= 0:
            value = dot(vectors.vector[j], vectors.witness[i])
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
    vectors.live[x] = kept


@njit()
def add_vectors(value, robot, belief, vectors):
    """Add one vector to each state."""
    for x in range(len(value)):
        add_vector(x, robot[x], value[x], belief, vectors)


@njit()
def _expand_children(d, r, work, trial, m):
    """Fill in the posteriors after a robot action and each slot; return the state in which the person acts."""
    x = trial.state[d]
    complied = work[3] if m.uses_answer else work[2]
    acting, slot = split(trial.belief[d], work[0], work[1], complied, work[2], x, r, m)
    if not m.ends[acting]:
        for a in range(m.counts[acting]):
            trial.mass[d, r, a] = child(trial.after[d, r, a], acting, a, slot, work[0], work[1], complied, work[2], m)
    return acting


@njit()
def _bound_above(d, r, work, room, trial, hull, m):
    """Compute an upper bound on the Q-value of a robot action from the bounds of its children."""
    x = trial.state[d]
    value = -m.robot_costs[x, r]
    acting = _expand_children(d, r, work, trial, m)
    if not m.ends[acting]:
        for a in range(m.counts[acting]):
            trial.child[d, r, a] = upper(m.targets[acting, a], trial.after[d, r, a], hull, room)
            value += m.gamma * trial.child[d, r, a] - m.costs[acting, a] * trial.mass[d, r, a]
    trial.q[d, r] = min(trial.q[d, r], value)
    trial.known[d, r] = True


@njit()
def most_promising(d, work, room, trial, hull, m):
    """Return the robot action with the largest upper bound, and evaluate the children of as few as possible."""
    robots = m.robot_actions[trial.state[d]]
    while True:
        r = ZERO
        for k in range(1, robots):
            if trial.q[d, k] > trial.q[d, r]:
                r = k
        if trial.known[d, r]:
            return r
        _bound_above(d, r, work, room, trial, hull, m)


@njit()
def _bound_below(d, r, work, trial, picked, vectors, m):
    """Compute a lower bound on the Q-value of a robot action, and fill in the best vector after each slot."""
    x = trial.state[d]
    value = -m.robot_costs[x, r]
    acting = m.afterstate[x, r] if trial.known[d, r] else _expand_children(d, r, work, trial, m)
    if not m.ends[acting]:
        for a in range(m.counts[acting]):
            v, picked[a] = lower(m.targets[acting, a], trial.after[d, r, a], vectors)
            value += m.gamma * v - m.costs[acting, a] * trial.mass[d, r, a]
    return value


@njit()
def _backup_vector(x, r, picked, vector, vectors, m):
    """Fill in the alpha vector of a robot action that is followed by the picked vectors.

    The margin `rounding` moves each entry downwards, so that the vector is a lower bound in floating-point arithmetic
    too.
    """
    thetas = len(m.theta)
    acting, slot = m.afterstate[x, r], m.suggested[x, r]
    if m.ends[acting]:
        _fill(vector, -m.robot_costs[x, r])
        return
    count, margin = m.counts[acting], rounding(m.targets.shape[1])
    declined, mean, followed, complied = np.empty(thetas), np.empty(thetas), np.empty(thetas), np.empty(thetas)
    for h in range(len(vector) // thetas):
        part = vector[h * thetas : (h + 1) * thetas]
        if m.goal[m.goal_of[h], acting]:
            _fill(part, 0.0)
            continue
        _fill(declined, 0.0)
        _fill(mean, 0.0)
        _fill(followed, 0.0)
        _fill(complied, 0.0)
        for a in range(count):
            p, c, i = m.chosen[acting, a, h], m.costs[acting, a], picked[a]
            for t in range(thetas):
                u = m.gamma * vectors.vector[i, h * thetas + t] - c
                if a == slot:
                    followed[t] = p * u
                else:
                    declined[t] += p * u
                if a == slot and m.uses_answer:
                    complied[t] = u / count
                else:
                    mean[t] += u / count
        for t in range(thetas):
            v = (1.0 - m.lapse) * declined[t] + m.lapse * mean[t]
            if slot >= 0:
                v = _entry_after_suggestion(followed, declined, complied, mean, x, r, h, t, m)
            v -= m.robot_costs[x, r]
            part[t] = v - margin * abs(v)


@njit()
def _entry_after_suggestion(followed, declined, complied, mean, x, r, h, t, m):
    """Return the entry of an alpha vector at type h and theta t after a suggestion, which influences and moves theta.

    This is the transpose of `belief_filter.split`.
    """
    g = m.goal_of[h]
    slot, at, up = m.suggested[x, r], m.low[x, r, g, t], m.weight[x, r, g, t]
    follow_factor, decline_factor = influence_factors(m.theta[t], m.chosen[x, slot, h], m.unsuggested[x, r, h])
    if not m.uses_answer:
        return (1.0 - m.lapse) * (
            (1.0 - up) * (follow_factor * followed[at] + decline_factor * declined[at])
            + up * (follow_factor * followed[at + 1] + decline_factor * declined[at + 1])
        ) + m.lapse * ((1.0 - up) * mean[at] + up * mean[at + 1])
    v = (1.0 - m.lapse) * decline_factor * ((1.0 - up) * declined[at] + up * declined[at + 1])
    v += m.lapse * ((1.0 - up) * mean[at] + up * mean[at + 1])
    at, up = m.followed_low[x, r, g, t], m.followed_weight[x, r, g, t]
    v += (1.0 - m.lapse) * follow_factor * ((1.0 - up) * followed[at] + up * followed[at + 1])
    v += m.lapse * ((1.0 - up) * complied[at] + up * complied[at + 1])
    return v


@njit()
def _backup_lower(d, step, work, trial, backup, vectors, m):
    """Back up the lower bound at one depth of the trial; return whether it improved by more than `step`."""
    x, belief = trial.state[d], trial.belief[d]
    picked, kept, vector = backup
    best, robot = -np.inf, NEITHER
    for r in range(m.robot_actions[x]):
        if trial.q[d, r] > best:
            value = _bound_below(d, r, work, trial, picked, vectors, m)
            if value > best:
                best, robot = value, r
                _copy(kept, picked)
    if not best > lower(x, belief, vectors)[0] + step + 4 * rounding(len(belief) + m.targets.shape[1]) * abs(best):
        return False
    _backup_vector(x, robot, kept, vector, vectors, m)
    add_vector(x, robot, vector, belief, vectors)
    return True


@njit()
def start_node(d, belief, mass, q, trial, m):
    """Put belief / mass on the trial, with upper bounds on the Q-values that do not need the children.

    The belief is conditioned on the fact that the person goes on. Return the mass of the rest.
    """
    x, own = trial.state[d], trial.belief[d]
    _copy(own, belief)
    mass = leave_out_reached(own, mass, x, m.goal, m.goal_of)
    for h in range(len(own)):
        own[h] = own[h] / mass if mass > 0.0 else 0.0
    for r in range(m.robot_actions[x]):
        trial.q[d, r], trial.known[d, r] = dot(q[x, r], own), False
    return mass


@njit(nogil=True)
def trials(x0, prior, enough, backups, fineness, rng, trial, vectors, hull, q, m):
    """Run trials to tighten both bounds at the initial belief; return the number of backups.

    The search stops when the gap is at most `enough`, when memory is short, or after `backups` backups.

    A trial starts at the initial state and the prior. In each step it takes the robot action with the largest upper
    bound. It enters a child with a probability in proportion to the excess of the child's gap over the target. Always
    entering the child with the largest excess would repeat the same sample paths of people who err and return. The
    trial ends where no child exceeds the target, at a goal, or where its arrays are full. It then backs up both bounds
    on the way back.

    The target of a trial is 0.2 times the root gap, and grows by 1 / gamma per step. A smaller share gives longer
    trials, which visit less probable beliefs.

    `fineness`, shape (2,), says which gains are ignored. Entry 0 is the smallest improvement of a bound that is stored,
    as a share of the target. Entry 1 is the smallest discounted contribution of a child to the root gap, as a share of
    that gap. A trial without an improvement multiplies one of them by a factor: entry 1 by 0.1 if it has cut off
    children, otherwise entry 0 by 0.98.
    """
    work, room = np.empty((4, len(prior))), new_program(len(prior))
    # the vectors picked after each slot, those picked for the best robot action, and the new vector
    slots, done = m.targets.shape[1], 0
    backup = np.empty(slots, np.int64), np.empty(slots, np.int64), np.empty(len(prior))
    while done < backups:
        trial.bound[0] = upper(x0, prior, hull, room)
        gap = trial.bound[0] - lower(x0, prior, vectors)[0]
        short = min(len(vectors.robot) - vectors.space[0], len(hull.drop) - hull.space[0]) < len(trial.state)
        if gap <= enough or short:
            break
        trial.state[0] = x0
        start_node(ZERO, prior, 1.0, q, trial, m)
        depth, target, cut = _descend(gap, fineness, rng, work, room, trial, vectors, hull, q, m)
        if not _ascend(depth, target, fineness, work, room, backup, trial, vectors, hull, m):
            if cut:
                fineness[1] *= 0.1
            else:
                fineness[0] *= 0.98
        done += depth + 1
    return done


@njit()
def _descend(gap, fineness, rng, work, room, trial, vectors, hull, q, m):
    """Follow a trial from its first node on; return its depth, its target there, and whether it has cut off children.

    The arguments are those of `trials`.
    """
    depth, target, reach, cut = ZERO, 0.2 * gap, 1.0, False
    while True:
        x = trial.state[depth]
        r = most_promising(depth, work, room, trial, hull, m)
        trial.robot[depth] = r
        acting = m.afterstate[x, r]
        if m.ends[acting] or depth + 1 == len(trial.state):
            break
        beyond, chosen = 0.0, NONE
        target /= m.gamma
        reach *= m.gamma
        for a in range(m.counts[acting]):
            y = m.targets[acting, a]
            if m.ends[y]:
                continue
            apart = trial.child[depth, r, a] - lower(y, trial.after[depth, r, a], vectors)[0]
            excess = apart - target * trial.mass[depth, r, a]
            if excess > 0.0 and reach * apart < fineness[1] * gap:
                cut = True
            elif excess > 0.0:
                beyond += excess
                # reservoir sampling: each child is selected with probability excess / (total excess)
                if rng.random() * beyond < excess:
                    chosen = a
        if chosen == NONE:
            break
        depth += 1
        trial.state[depth] = m.targets[acting, chosen]
        chance = start_node(depth, trial.after[depth - 1, r, chosen], trial.mass[depth - 1, r, chosen], q, trial, m)
        trial.chance[depth - 1] = chance
        trial.bound[depth] = trial.child[depth - 1, r, chosen] / chance
        reach *= chance
    return depth, target, cut


@njit()
def _ascend(depth, target, fineness, work, room, backup, trial, vectors, hull, m):
    """Back up both bounds from the last node of a trial to its first; return whether one has improved."""
    improved, lowered = False, 0.0
    margin = rounding(hull.corner.shape[1] + m.targets.shape[1])
    for d in range(depth, -1, -1):
        x, belief = trial.state[d], trial.belief[d]
        trial.q[d, trial.robot[d]] -= m.gamma * trial.chance[d] * lowered if d < depth else 0.0
        value = trial.q[d, most_promising(d, work, room, trial, hull, m)]
        value += margin * abs(value)
        step = fineness[0] * target
        target *= m.gamma
        lowered = 0.0
        if value < trial.bound[d] - step - 4 * margin * abs(value):
            # Pivots stop early, so that the bound of the belief with another mass may differ a little.
            now = upper(x, belief, hull, room)
            if value < now - step - 4 * margin * abs(value):
                add_point(x, belief, value, hull)
                improved = True
            lowered = trial.bound[d] - min(value, now)
        improved |= _backup_lower(d, step, work, trial, backup, vectors, m)
    return improved


@njit(nogil=True)
def renew(start, order, step, backups, trial, vectors, hull, q, m):
    """Repeat the backup of every belief of the hull and of every listed vector, from the state `order[start]` on.

    The result of a trial depends on the bounds of that time, and later trials pass few of the same beliefs. The
    function stops after `backups` backups, or if memory is short. Return where to continue, and the number of backups.
    """
    size = hull.corner.shape[1]
    work, room = np.empty((4, size)), new_program(size)
    slots, done = m.targets.shape[1], 0
    margin = 2 * rounding(size + slots)
    backup = np.empty(slots, np.int64), np.empty(slots, np.int64), np.empty(size)
    for at in range(start, len(order)):
        x = order[at]
        if hull.head[x] == NONE:  # no trial has visited the state
            continue
        short = len(vectors.robot) - vectors.space[0] < vectors.live[x]
        if done >= backups or short:
            return at, done
        trial.state[0] = x
        i = hull.head[x]
        while i >= 0:
            belief = hull.belief[i]
            start_node(ZERO, belief, 1.0, q, trial, m)
            value = trial.q[0, most_promising(ZERO, work, room, trial, hull, m)]
            value += margin * abs(value)
            hull.drop[i] = min(hull.drop[i], value - dot(hull.corner[x], belief))
            i = hull.after[i]
            done += 1
        used, i = np.empty(vectors.live[x], np.int64), vectors.head[x]
        for k in range(len(used)):
            used[k], i = i, vectors.after[i]
        for i in used:
            if vectors.state[i] != x:  # an earlier backup in this loop has removed the vector
                continue
            start_node(ZERO, vectors.witness[i], 1.0, q, trial, m)
            _backup_lower(ZERO, step, work, trial, backup, vectors, m)
            done += 1
    return len(order), done
