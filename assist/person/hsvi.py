"""Heuristic search value iteration (HSVI), compiled: the search for bounds on one person's problem.

The upper bound of a state follows from beliefs with known bounds (`belief_hulls`), the lower one from returns of plans
(`vector_lists`). `trials` improves both along sampled paths, and `renew` repeats old backups. `solver` calls them in
turn and returns the result; it says what is proven.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.system.jit import njit

from ..people.decision import Floats
from ..people.influence_kernels import factors_after
from ..people.type_kernels import leave_out_reached
from .belief_filter import Parts, child, new_parts, split
from .belief_hulls import NONE, UpperHull, add_point, dot, upper
from .problem_arrays import ProblemArrays
from .rounding import compiled as rounding
from .upper_hull import Program, new_program
from .vector_lists import AlphaVectors, add_vector, copied, lower

COMPILED_FOR = "bounds on a person's problem: half a minute"

ZERO, NEITHER = map(np.int64, (0, NONE))  # numba would compile a function again for a literal argument


class Trial(NamedTuple):
    """The data of a trial at each depth."""

    state: NDArray[np.int64]
    belief: Floats
    bound: Floats  # upper bound at the belief
    action: NDArray[np.int64]
    chance: Floats  # probability of the child that the trial enters, and that the person goes on there
    q: Floats  # upper bound on the Q-value of each robot action
    known: NDArray[np.bool_]  # whether `q` was computed from the children
    child: Floats  # upper bound of each child, times its probability
    after: Floats  # unnormalised belief of each child
    mass: Floats  # probability of each child


class Tables(NamedTuple):
    """What the search reads and writes.

    Attributes
    ----------
    m : ProblemArrays
    q : float array, shape (n, R, cells)
        Upper bounds on the Q-values for a known type and theta.
    hull : UpperHull
    vectors : AlphaVectors
    trial : Trial
    """

    m: ProblemArrays
    q: Floats
    hull: UpperHull
    vectors: AlphaVectors
    trial: Trial


class Room(NamedTuple):
    """Work arrays of a search.

    Attributes
    ----------
    parts : Parts
        Those of the belief that is looked at.
    program : Program
        Room of the linear program of an upper bound.
    picked, kept : int arrays, shape (A,)
        The best vector after each slot, for a robot action and for the best one so far.
    vector : float array, shape (cells,)
        The new vector.
    """

    parts: Parts
    program: Program
    picked: NDArray[np.int64]
    kept: NDArray[np.int64]
    vector: Floats


def new_trial(depth: int, size: int, actions: int, slots: int) -> Trial:
    """Return an empty trial of up to `depth` steps.

    Beliefs have `size` entries, and there are `actions` robot actions and `slots` choices of the person.
    """
    return Trial(
        state=np.empty(depth, dtype=np.int64),
        belief=np.empty((depth, size)),
        bound=np.empty(depth),
        action=np.empty(depth, dtype=np.int64),
        chance=np.empty(depth),
        q=np.empty((depth, actions)),
        known=np.empty((depth, actions), dtype=bool),
        child=np.empty((depth, actions, slots)),
        after=np.empty((depth, actions, slots, size)),
        mass=np.empty((depth, actions, slots)),
    )


@njit(inner=True)
def new_room(s):
    """Return the work arrays of a search."""
    size, slots = s.hull.corner.shape[1], s.m.targets.shape[1]
    picked, kept = np.empty(slots, np.int64), np.empty(slots, np.int64)
    return Room(new_parts(size, s.m.uses_answer), new_program(size), picked, kept, np.empty(size))


# Whole-array forms (a[:] = b, (a <= b).all(), a / b) take several times as long to compile. Each calling function would
# include numba's code for broadcasting and its error messages.
@njit(inner=True)
def _fill(a, value):
    """Set all entries of a to one value."""
    for i in range(len(a)):
        a[i] = value


@njit(inner=True)
def _expand_children(d, r, parts, trial, m):
    """Fill in the posteriors after a robot action and each slot; return the state in which the person acts."""
    acting, slot = split(parts, trial.belief[d], trial.state[d], r, m)
    if not m.ends[acting]:
        for a in range(m.counts[acting]):
            trial.mass[d, r, a] = child(trial.after[d, r, a], acting, a, slot, parts, m)
    return acting


@njit(inner=True)
def _bound_above(d, r, room, trial, hull, m):
    """Compute an upper bound on the Q-value of a robot action from the bounds of its children."""
    value = -m.robot_costs[trial.state[d], r]
    acting = _expand_children(d, r, room.parts, trial, m)
    if not m.ends[acting]:
        for a in range(m.counts[acting]):
            trial.child[d, r, a] = upper(m.targets[acting, a], trial.after[d, r, a], hull, room.program)
            value += m.gamma * trial.child[d, r, a] - m.costs[acting, a] * trial.mass[d, r, a]
    trial.q[d, r] = min(trial.q[d, r], value)
    trial.known[d, r] = True


@njit(inner=True)
def most_promising(d, room, trial, hull, m):
    """Return the robot action with the largest upper bound, and evaluate the children of as few as possible."""
    actions = m.robot_actions[trial.state[d]]
    while True:
        r = ZERO
        for k in range(1, actions):
            if trial.q[d, k] > trial.q[d, r]:
                r = k
        if trial.known[d, r]:
            return r
        _bound_above(d, r, room, trial, hull, m)


@njit(inner=True)
def _bound_below(d, r, room, trial, vectors, m):
    """Compute a lower bound on the Q-value of a robot action, and fill in the best vector after each slot."""
    x = trial.state[d]
    value = -m.robot_costs[x, r]
    acting = m.afterstate[x, r] if trial.known[d, r] else _expand_children(d, r, room.parts, trial, m)
    if not m.ends[acting]:
        for a in range(m.counts[acting]):
            v, room.picked[a] = lower(m.targets[acting, a], trial.after[d, r, a], vectors)
            value += m.gamma * v - m.costs[acting, a] * trial.mass[d, r, a]
    return value


@njit(inner=True)
def _backup_vector(x, r, room, vectors, m):
    """Fill in the alpha vector of a robot action that is followed by the vectors that were kept.

    The margin `rounding` moves each entry downwards, so that the vector is a lower bound in floating-point arithmetic
    too.
    """
    vector, thetas = room.vector, len(m.theta)
    acting, slot = m.afterstate[x, r], m.suggested[x, r]
    if m.ends[acting]:
        _fill(vector, -m.robot_costs[x, r])
        return
    count, margin = m.counts[acting], rounding(m.targets.shape[1])
    declined, mean, followed, complied = np.empty(thetas), np.empty(thetas), np.empty(thetas), np.empty(thetas)
    parts = Parts(followed, declined, complied, mean)
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
            p, c, i = m.chosen[acting, a, h], m.costs[acting, a], room.kept[a]
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
            if m.moves[x, r]:
                v = _entry_where_theta_moves(parts, x, r, h, t, m)
            v -= m.robot_costs[x, r]
            part[t] = v - margin * abs(v)


@njit(inner=True)
def _entry_where_theta_moves(parts, x, r, h, t, m):
    """Return the entry of an alpha vector at type h and theta t, where a suggestion or its absence moves theta.

    This is the transpose of `belief_filter.split`.
    """
    followed, declined, complied, mean = parts
    g = m.goal_of[h]
    slot, at, up = m.suggested[x, r], m.low[x, r, g, t], m.weight[x, r, g, t]
    follow_factor, decline_factor = factors_after(slot, m.theta[t], m.chosen[x, slot, h], m.unsuggested[x, r, h])
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


@njit(inner=True)
def _backup_lower(d, step, room, trial, vectors, m):
    """Back up the lower bound at one depth of the trial; return whether it improved by more than `step`."""
    x, belief = trial.state[d], trial.belief[d]
    best, action = -np.inf, NEITHER
    for r in range(m.robot_actions[x]):
        if trial.q[d, r] > best:
            value = _bound_below(d, r, room, trial, vectors, m)
            if value > best:
                best, action = value, r
                copied(room.kept, room.picked)
    if not best > lower(x, belief, vectors)[0] + step + 4 * rounding(len(belief) + m.targets.shape[1]) * abs(best):
        return False
    _backup_vector(x, action, room, vectors, m)
    add_vector(x, action, room.vector, belief, vectors)
    return True


@njit(inner=True)
def start_node(d, belief, mass, q, trial, m):
    """Put belief / mass on the trial, with upper bounds on the Q-values that do not need the children.

    The belief is conditioned on the fact that the person goes on. Return the mass of the rest.
    """
    x, own = trial.state[d], trial.belief[d]
    copied(own, belief)
    mass = leave_out_reached(own, mass, x, m.goal, m.goal_of)
    for h in range(len(own)):
        own[h] = own[h] / mass if mass > 0.0 else 0.0
    for r in range(m.robot_actions[x]):
        trial.q[d, r], trial.known[d, r] = dot(q[x, r], own), False
    return mass


@njit(nogil=True)
def trials(x0, prior, enough, backups, fineness, rng, s):
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
    trial, vectors, hull = s.trial, s.vectors, s.hull
    room, done = new_room(s), 0
    while done < backups:
        trial.bound[0] = upper(x0, prior, hull, room.program)
        gap = trial.bound[0] - lower(x0, prior, vectors)[0]
        short = min(len(vectors.action) - vectors.space[0], len(hull.drop) - hull.space[0]) < len(trial.state)
        if gap <= enough or short:
            break
        trial.state[0] = x0
        start_node(ZERO, prior, 1.0, s.q, trial, s.m)
        depth, target, cut = _descend(gap, fineness, rng, room, s)
        if not _ascend(depth, target, fineness, room, s):
            if cut:
                fineness[1] *= 0.1
            else:
                fineness[0] *= 0.98
        done += depth + 1
    return done


@njit(inner=True)
def _descend(gap, fineness, rng, room, s):
    """Follow a trial from its first node on; return its depth, its target there, and whether it has cut off children.

    The arguments are those of `trials`.
    """
    trial, m = s.trial, s.m
    depth, target, reach, cut = ZERO, 0.2 * gap, 1.0, False
    while True:
        x = trial.state[depth]
        r = most_promising(depth, room, trial, s.hull, m)
        trial.action[depth] = r
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
            apart = trial.child[depth, r, a] - lower(y, trial.after[depth, r, a], s.vectors)[0]
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
        chance = start_node(depth, trial.after[depth - 1, r, chosen], trial.mass[depth - 1, r, chosen], s.q, trial, m)
        trial.chance[depth - 1] = chance
        trial.bound[depth] = trial.child[depth - 1, r, chosen] / chance
        reach *= chance
    return depth, target, cut


@njit(inner=True)
def _ascend(depth, target, fineness, room, s):
    """Back up both bounds from the last node of a trial to its first; return whether one has improved."""
    trial, hull, m = s.trial, s.hull, s.m
    improved, lowered = False, 0.0
    margin = rounding(hull.corner.shape[1] + m.targets.shape[1])
    for d in range(depth, -1, -1):
        x, belief = trial.state[d], trial.belief[d]
        trial.q[d, trial.action[d]] -= m.gamma * trial.chance[d] * lowered if d < depth else 0.0
        value = trial.q[d, most_promising(d, room, trial, hull, m)]
        value += margin * abs(value)
        step = fineness[0] * target
        target *= m.gamma
        lowered = 0.0
        if value < trial.bound[d] - step - 4 * margin * abs(value):
            # Pivots stop early, so that the bound of the belief with another mass may differ a little.
            now = upper(x, belief, hull, room.program)
            if value < now - step - 4 * margin * abs(value):
                add_point(x, belief, value, hull)
                improved = True
            lowered = trial.bound[d] - min(value, now)
        improved |= _backup_lower(d, step, room, trial, s.vectors, m)
    return improved


@njit(nogil=True)
def renew(start, order, step, backups, s):
    """Repeat the backup of every belief of the hull and of every listed vector, from the state `order[start]` on.

    The result of a trial depends on the bounds of that time, and later trials pass few of the same beliefs. The
    function stops after `backups` backups, or if memory is short. Return where to continue, and the number of backups.
    """
    trial, vectors, hull, q, m = s.trial, s.vectors, s.hull, s.q, s.m
    room, done = new_room(s), 0
    margin = 2 * rounding(hull.corner.shape[1] + s.m.targets.shape[1])
    for at in range(start, len(order)):
        x = order[at]
        if hull.head[x] == NONE:  # no trial has visited the state
            continue
        short = len(vectors.action) - vectors.space[0] < vectors.live[x]
        if done >= backups or short:
            return at, done
        trial.state[0] = x
        i = hull.head[x]
        while i >= 0:
            belief = hull.belief[i]
            start_node(ZERO, belief, 1.0, q, trial, m)
            value = trial.q[0, most_promising(ZERO, room, trial, hull, m)]
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
            _backup_lower(ZERO, step, room, trial, vectors, m)
            done += 1
    return len(order), done
