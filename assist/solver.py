"""One person's problem solved between certified bounds.

Heuristic search value iteration (Smith and Simmons, "Point-based POMDP algorithms: improved analysis and
implementation", 2005) in a form made for this problem: x is observed, so that every state has bounds of its own,
over beliefs of B * T numbers.

- Below, each state has alpha vectors: what some plan gets for each (beta, theta). They begin with policies that
  look only at x (`mdp.evaluate`), and each backup adds the vector of a robot action followed by vectors that are
  there already. So the bound is the value of a policy that can be carried out.
- Above, each state has a `hull`: the values of the problem with beta and theta seen (`mdp.qmdp`), lowered at single
  beliefs by backups.

A trial walks from the initial state and the prior through the most promising robot action to the child that
contributes most to the gap, until the gap there is small, and backs both bounds up on the way home.

Both bounds hold in floating point too: whatever is stored is moved outwards by `mdp.ROUNDING`. They are bounds of
the problem on its grid of beta and theta, and to someone who acts in steps as `AssistPOMDP` has them.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from . import archive
from . import hull as hulls
from .human import Floats
from .mdp import QMDP, ROUNDING, Arrays, evaluate, qmdp
from .pomdp import AssistPOMDP
from .vectors import VectorPolicy

DEPTH = 500
TARGET = 0.6  # a trial ends where the gap, discounted, is below this share of the gap at the root
BACKUPS = 1000  # between two looks at the clock
SWEEPS = 20  # over a policy that suggests, which hardly ever needs more to be evaluated where it matters
FINEST = 1e-6  # a bound that gains less than this share of the gap aimed at is as good as it was
FEW = 32  # vectors of a state that are all looked at, whether or not they are of use
NONE = -1


class _Plans(NamedTuple):
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


class _Path(NamedTuple):
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


@dataclass(frozen=True)
class Solution:
    """A policy for one person's problem with proven bounds on its value.

    The policy is greedy in the alpha vectors, one exact step ahead; it gets at least their value.

    Attributes
    ----------
    policy : VectorPolicy
    corner : float array, shape (n, B, T)
        Upper bound where beta and theta are known.
    point : float array, shape (p, B, T)
        Beliefs at which the upper bound is known to be lower, sorted by state.
    drop : float array, shape (p,)
        By how much, against `corner`.
    first : int array, shape (n + 1,)
        The beliefs of state x are `point[first[x] : first[x + 1]]`.
    lower, upper : float
        What the policy gets at least, and what none exceeds, from the initial state and the prior on.
    value_qmdp : float
        The QMDP value there, an upper bound.
    value_never, value_always : float
        The value of doing nothing, and of always suggesting the optimal action that QMDP prefers at the prior.
    seconds : float
    backups : int
    stopped : str
        What ended the search: "gap", "time", "memory", or "stalled" where no trial can improve a bound any more,
        because what is left is the width of a frontier's bounds, or rounding.
    """

    policy: VectorPolicy
    corner: Floats
    point: Floats
    drop: Floats
    first: NDArray[np.int64]
    lower: float
    upper: float
    value_qmdp: float
    value_never: float
    value_always: float
    seconds: float
    backups: int
    stopped: str

    def __post_init__(self) -> None:
        for array in (self.corner, self.point, self.drop, self.first):
            array.flags.writeable = False

    def save(self, file: Path, **more: Any) -> None:
        """Save the solution and its problem, with further arrays by name; `docs/policies.md` describes the file."""
        archive.save(file, self, **more)

    @classmethod
    def load(cls, file: Path) -> Solution:
        """Load a solution.

        Raises
        ------
        ArchiveError
            Another kind of file.
        """
        return archive.load(file, cls)

    @property
    def pomdp(self) -> AssistPOMDP:
        """The problem."""
        return self.policy.pomdp

    @property
    def gap(self) -> float:
        """The distance of the bounds, relative to the lower one."""
        return relative_gap(self.lower, self.upper)

    def q_values(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Give the policy's value of each robot action, shape (N, R), at least; minus infinity in padding.

        Parameters
        ----------
        x : int array, shape (N,)
        belief : float array, shape (N, B, T)
        """
        return self.policy.q_values(x, belief)

    def value(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Give what the policy gets at least, shape (N,); arguments as in `q_values`."""
        return self.policy.value(x, belief)

    def choose(self, x: NDArray[np.int64], belief: Floats) -> NDArray[np.int64]:
        """Give the robot action for each person, shape (N,); 0 is nothing, also on ties."""
        return self.q_values(x, belief).argmax(axis=1)

    def upper_bound(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Give what no policy exceeds, shape (N,); arguments as in `q_values`."""
        value = np.empty(len(x))
        x = np.ascontiguousarray(x, dtype=np.int64)
        hulls.uppers(
            value, x, np.ascontiguousarray(belief, dtype=float).reshape(len(x), self.pomdp.prior.size), self._hull
        )
        return value

    @cached_property
    def _hull(self) -> hulls.Hull:
        states, size = len(self.corner), self.pomdp.prior.size
        hull = hulls.empty(self.corner.reshape(states, size).copy(), len(self.drop))
        hull.belief[:] = self.point.reshape(-1, size)
        hull.inverse[:] = np.divide(
            1.0, hull.belief, out=np.full_like(hull.belief, hulls.HUGE), where=hull.belief > 1e-200
        )
        hull.drop[:] = self.drop
        hull.state[:] = np.repeat(np.arange(states), np.diff(self.first))
        # Each belief leads to the next, the last of a state to none.
        hull.after[:-1] = np.where(hull.state[1:] == hull.state[:-1], np.arange(1, len(self.drop)), hulls.NONE)
        some = np.diff(self.first) > 0
        hull.head[some] = self.first[:-1][some]
        hull.space[0] = len(self.drop)
        return hull


def relative_gap(lower: float, upper: float) -> float:
    """Give (upper - lower) / |lower|, 0 where both are 0."""
    return 0.0 if upper <= lower else (upper - lower) / abs(lower)


def solve(
    pomdp: AssistPOMDP,
    *,
    gap: float = 1e-3,
    time_limit: float | None = None,
    memory_limit_mb: float | None = None,
    progress: Callable[[float, float, float], None] | None = None,
) -> Solution:
    """Solve one person's problem.

    Parameters
    ----------
    pomdp : AssistPOMDP
    gap : float
        Stop when (upper - lower) / |lower| at the initial state and the prior is at most this.
    time_limit : float, optional
        Stop the search after so many seconds. The first bounds are worked out in any case.
    memory_limit_mb : float, optional
        Stop before vectors and beliefs take more. The first bounds are worked out in any case.
    progress : callable, optional
        Called with seconds, lower and upper bound, about every tenth of a second.
    """
    if not gap >= 0:
        raise ValueError(f"gap {gap:g}: expected 0 or more")
    start = time.perf_counter()
    x0 = pomdp.model.choices.initial
    prior = pomdp.prior.reshape(-1)
    best = qmdp(pomdp)
    search = _Search(pomdp, best)
    never = np.zeros(len(pomdp.robots), dtype=np.int64)
    value_never = search.begin(never)
    value_always = search.begin(_informed(best, pomdp.prior, _optimal(pomdp)), SWEEPS)
    trusting = np.zeros_like(pomdp.prior)
    trusting[:, -1] = pomdp.prior.sum(axis=1)
    for belief in (pomdp.prior, trusting):
        search.begin(_informed(best, belief), SWEEPS)

    # A value of 0 is approached from below for ever, and the gap remains 1.
    smallest = ROUNDING * (pomdp.charge.max() + pomdp.model.choices.costs.max()) / (1 - pomdp.gamma)
    stopped, backups = "gap", 0
    while True:
        lower, upper = search.bounds(x0, prior)
        seconds = time.perf_counter() - start
        if progress is not None:
            progress(seconds, lower, upper)
        if relative_gap(lower, upper) <= gap:
            break
        if time_limit is not None and seconds >= time_limit:
            stopped = "time"
            break
        if not search.make_room(memory_limit_mb):
            stopped = "memory"
            break
        going_on = search.fineness[0] >= FINEST and upper - lower > smallest
        done = search.trials(x0, prior, gap * abs(lower)) if going_on else 0
        if not done:
            stopped = "stalled"
            break
        backups += done
    return search.solution(
        lower=lower, upper=upper, value_qmdp=float((best.value_mdp[x0] * pomdp.prior).sum()), value_never=value_never,
        value_always=value_always, seconds=time.perf_counter() - start, backups=backups, stopped=stopped,
    )  # fmt: skip


def _informed(best: QMDP, belief: Floats, among: NDArray[np.bool_] | None = None) -> NDArray[np.int64]:
    """Give QMDP's action in each state for one belief: of all, or `among` some, shape (n, R), if there are any."""
    q = np.einsum("nrbt,bt->nr", np.maximum(best.q_mdp, -1e300), belief)
    if among is not None:
        q = np.where(among, q, -np.inf)
    return q.argmax(axis=1)


def _optimal(pomdp: AssistPOMDP) -> NDArray[np.bool_]:
    """Tell which robot actions suggest an optimal action, shape (n, R)."""
    slot = np.maximum(pomdp.suggested, 0)
    return (pomdp.suggested >= 0) & np.take_along_axis(pomdp.model.choices.optimal, slot, axis=1)


class _Search:
    """The bounds of one problem while they are improved."""

    def __init__(self, pomdp: AssistPOMDP, best: QMDP) -> None:
        self.pomdp, self.arrays = pomdp, Arrays.of(pomdp)
        states, size = len(pomdp.robots), pomdp.prior.size
        margin = ROUNDING / (1 - pomdp.gamma)
        corner = (best.value_mdp + margin * np.abs(best.value_mdp)).reshape(states, size)
        self.q = best.q_mdp.reshape(states, -1, size) * (1 - margin)  # values are negative
        self.hull = hulls.empty(corner, 2 * DEPTH)
        capacity = 4 * states + 2 * DEPTH
        self.plans = _Plans(
            np.empty((capacity, size)), np.empty((capacity, size)), np.zeros(capacity, dtype=np.int32),
            np.full(capacity, NONE, dtype=np.int32), np.full(capacity, NONE, dtype=np.int32),
            np.full(states, NONE, dtype=np.int32), np.zeros(states, dtype=np.int64), np.full(states, FEW),
            np.array([0, NONE]),
        )  # fmt: skip
        robots, slots = pomdp.suggested.shape[1], pomdp.model.choices.targets.shape[1]
        self.path = _Path(
            np.empty(DEPTH, dtype=np.int64), np.empty((DEPTH, size)), np.empty(DEPTH),
            np.empty(DEPTH, dtype=np.int64), np.empty(DEPTH), np.empty((DEPTH, robots)),
            np.empty((DEPTH, robots), dtype=bool), np.empty((DEPTH, robots, slots)),
            np.empty((DEPTH, robots, slots, size)), np.empty((DEPTH, robots, slots)),
        )  # fmt: skip
        self.fineness = np.array([0.1])  # what a bound must gain to be stored, as a share of the gap aimed at

    def begin(self, robot: NDArray[np.int64], max_sweeps: int = 100_000) -> float:
        """Add the vectors of a policy that looks only at x; return its value at the root."""
        value = evaluate(self.pomdp, robot, max_sweeps=max_sweeps)
        flat = np.ascontiguousarray(value).reshape(len(value), -1)
        _begin(flat, robot, self.pomdp.prior.reshape(-1), self.plans)
        return float((value[self.pomdp.model.choices.initial] * self.pomdp.prior).sum())

    def bounds(self, x: int, belief: Floats) -> tuple[float, float]:
        """Give both bounds at a belief."""
        lower, _ = _lower(x, belief, self.plans)
        upper = hulls.upper(x, belief, self.hull, hulls.room(len(belief)))
        return lower - ROUNDING * abs(lower), upper + ROUNDING * abs(upper)

    def make_room(self, memory_limit_mb: float | None) -> bool:
        """Double what is nearly full, if the limit allows it."""
        limit = np.inf if memory_limit_mb is None else memory_limit_mb * 1e6
        if self.memory() > limit:
            return False
        for name in ("plans", "hull"):
            store = getattr(self, name)
            capacity = len(store.after)
            if capacity - store.space[0] > DEPTH:
                continue
            growing = [
                field for field in store._fields if len(getattr(store, field)) == capacity and field not in FIXED
            ]
            # While an array is copied, the old one and the new one are there.
            if self.memory() + sum(getattr(store, field).nbytes for field in growing) > limit:
                return False
            for field in growing:
                old = getattr(store, field)
                new = np.empty((2 * capacity, *old.shape[1:]), dtype=old.dtype)
                new[:capacity] = old
                store = store._replace(**{field: new})
            store.state[capacity:] = NONE
            setattr(self, name, store)
        return True

    def memory(self) -> int:
        """Give the bytes that vectors and beliefs take."""
        return sum(array.nbytes for store in (self.plans, self.hull) for array in store)

    def trials(self, x: int, belief: Floats, target: float) -> int:
        """Improve the bounds by some trials."""
        return _trials(x, belief, target, BACKUPS, self.fineness, self.path, self.plans, self.hull, self.q, self.arrays)

    def solution(self, **facts: object) -> Solution:
        """Collect the result, sorted by state."""
        pomdp, states = self.pomdp, len(self.pomdp.robots)
        shape = (-1, *pomdp.grid.shape)
        kept, first = _sorted(self.plans.state, states)
        policy = VectorPolicy(
            pomdp, self.plans.vector[kept].reshape(shape), self.plans.robot[kept].astype(np.int64), first
        )
        kept, first = _sorted(self.hull.state, states)
        return Solution(
            policy, self.hull.corner.reshape(shape), self.hull.belief[kept].reshape(shape), self.hull.drop[kept], first,
            **facts,  # type: ignore[arg-type]
        )  # fmt: skip


FIXED = ("corner", "head", "live", "limit", "space")


def _sorted(state: NDArray[np.int32], states: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Give the used places in the order of their states, and each state's first."""
    used = np.flatnonzero(state >= 0)
    used = used[np.argsort(state[used], kind="stable")]
    return used, np.searchsorted(state[used], np.arange(states + 1))


@numba.njit(cache=True)
def _lower(x, belief, plans):
    """Give the lower bound at an unnormalised belief, and the vector that it comes from."""
    best, at = -np.inf, NONE
    i = plans.head[x]
    while i >= 0:
        value = hulls.dot(plans.vector[i], belief)
        if value > best:
            best, at = value, i
        i = plans.after[i]
    return best, at


@numba.njit(cache=True)
def _add(x, robot, vector, belief, plans):
    """Add an alpha vector to a state, made for a belief, and remove those that are nowhere above it."""
    before, i = NONE, plans.head[x]
    while i >= 0:
        following = plans.after[i]
        if (plans.vector[i] <= vector).all():
            if before >= 0:
                plans.after[before] = following
            else:
                plans.head[x] = following
            plans.after[i], plans.state[i], plans.space[1] = plans.space[1], NONE, i
            plans.live[x] -= 1
        else:
            before = i
        i = following
    i = plans.space[1]
    if i >= 0:
        plans.space[1] = plans.after[i]
    else:
        i = plans.space[0]
        plans.space[0] += 1
    plans.vector[i], plans.witness[i], plans.robot[i], plans.state[i] = vector, belief, robot, x
    plans.after[i], plans.head[x] = plans.head[x], i
    plans.live[x] += 1
    if plans.live[x] > plans.limit[x]:
        _retire(x, plans)
        plans.limit[x] = max(FEW, 2 * plans.live[x])


@numba.njit(cache=True)
def _retire(x, plans):
    """Keep in a state's list only the vectors that are best at some belief for which one of them was made."""
    useful = np.zeros(plans.live[x], dtype=np.bool_)
    i = plans.head[x]
    while i >= 0:
        best, at = -np.inf, 0
        k, j = 0, plans.head[x]
        while j >= 0:
            value = hulls.dot(plans.vector[j], plans.witness[i])
            if value > best:
                best, at = value, k
            k, j = k + 1, plans.after[j]
        useful[at] = True
        i = plans.after[i]
    before, k, i = NONE, 0, plans.head[x]
    while i >= 0:
        following = plans.after[i]
        if useful[k]:
            before = i
        elif before >= 0:
            plans.after[before] = following
        else:
            plans.head[x] = following
        k, i = k + 1, following
    plans.live[x] = useful.sum()


@numba.njit(cache=True)
def _begin(value, robot, belief, plans):
    """Add a vector to every state."""
    for x in range(len(value)):
        _add(x, robot[x], value[x], belief, plans)


@numba.njit(cache=True)
def _split(x, r, belief, told, other, lapsed, m):
    """Split a belief by what the person will do.

    After slot a, which is chosen with p(beta), the unnormalised belief is

        p(beta) * (told where a is suggested, else other) + lapsed

    Return the state in which the person acts, and the suggested slot.
    """
    thetas = len(m.theta)
    place, slot = m.place[x, r], m.suggested[x, r]
    steady, uniform = 1.0 - m.lapse, m.lapse / max(m.counts[place], 1)
    if slot < 0:
        for h in range(len(belief)):
            told[h] = other[h] = steady * belief[h]
            lapsed[h] = uniform * belief[h]
        return place, slot
    told[:] = 0.0
    other[:] = 0.0
    lapsed[:] = 0.0
    for h in range(len(belief)):
        mass = belief[h]
        if mass == 0.0:
            continue
        b, t = h // thetas, h % thetas
        yes, no = _answer(m.theta[t], m.chosen[x, slot, b], m.rest[x, r, b])
        at, up = h - t + m.low[x, r, t], m.weight[x, r, t]
        told[at] += steady * yes * (1.0 - up) * mass
        told[at + 1] += steady * yes * up * mass
        other[at] += steady * no * (1.0 - up) * mass
        other[at + 1] += steady * no * up * mass
        lapsed[at] += uniform * (1.0 - up) * mass
        lapsed[at + 1] += uniform * up * mass
    return place, slot


@numba.njit(cache=True)
def _answer(theta, p, rest):
    """Give the factors by which a suggestion changes the chance p of the suggested slot, and that of the others."""
    total = theta * p + (1.0 - theta) * rest
    if total > 0.0:
        return theta / total, (1.0 - theta) / total
    return 1.0, 1.0


@numba.njit(cache=True, fastmath=hulls.FAST)
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


@numba.njit(cache=True)
def _follow(d, r, work, path, m):
    """Fill in the beliefs after a robot action and each slot; return the state in which the person acts."""
    x = path.state[d]
    place, slot = _split(x, r, path.belief[d], work[0], work[1], work[2], m)
    if not m.goal[place]:
        for a in range(m.counts[place]):
            path.mass[d, r, a] = _child(place, a, slot, work[0], work[1], work[2], path.after[d, r, a], m)
    return place


@numba.njit(cache=True)
def _look_up(d, r, work, room, path, hull, m):
    """Bound the return of a robot action from above by its children's bounds."""
    x = path.state[d]
    value = -m.charge[x, r]
    place = _follow(d, r, work, path, m)
    if not m.goal[place]:
        for a in range(m.counts[place]):
            path.child[d, r, a] = hulls.upper(m.targets[place, a], path.after[d, r, a], hull, room)
            value += m.gamma * path.child[d, r, a] - m.costs[place, a] * path.mass[d, r, a]
    path.q[d, r] = min(path.q[d, r], value)
    path.known[d, r] = True


@numba.njit(cache=True)
def _promising(d, work, room, path, hull, m):
    """Give the robot action with the largest upper bound, and look up no more of them than that needs."""
    robots = m.robots[path.state[d]]
    while True:
        r = 0
        for k in range(1, robots):
            if path.q[d, k] > path.q[d, r]:
                r = k
        if path.known[d, r]:
            return r
        _look_up(d, r, work, room, path, hull, m)


@numba.njit(cache=True)
def _look_down(d, r, work, path, picked, plans, m):
    """Bound the return of a robot action from below, and fill in the vector picked after each slot."""
    x = path.state[d]
    value = -m.charge[x, r]
    place = m.place[x, r] if path.known[d, r] else _follow(d, r, work, path, m)
    if not m.goal[place]:
        for a in range(m.counts[place]):
            v, picked[a] = _lower(m.targets[place, a], path.after[d, r, a], plans)
            value += m.gamma * v - m.costs[place, a] * path.mass[d, r, a]
    return value


@numba.njit(cache=True)
def _plan(x, r, picked, vector, plans, m):
    """Fill in the alpha vector of a robot action that is followed by the picked vectors."""
    thetas = len(m.theta)
    place, slot = m.place[x, r], m.suggested[x, r]
    if m.goal[place]:
        vector[:] = -m.charge[x, r]
        return
    count = m.counts[place]
    other, mean, told = np.empty(thetas), np.empty(thetas), np.empty(thetas)
    for b in range(len(vector) // thetas):
        other[:] = 0.0
        mean[:] = 0.0
        told[:] = 0.0
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
                yes, no = _answer(m.theta[t], m.chosen[x, slot, b], m.rest[x, r, b])
                v = (1.0 - m.lapse) * (
                    (1.0 - up) * (yes * told[at] + no * other[at]) + up * (yes * told[at + 1] + no * other[at + 1])
                ) + m.lapse * ((1.0 - up) * mean[at] + up * mean[at + 1])
            v -= m.charge[x, r]
            vector[b * thetas + t] = v - ROUNDING * abs(v)


@numba.njit(cache=True)
def _trials(x0, prior, enough, backups, fineness, path, plans, hull, q, m):
    """Run trials until the gap is closed, room is short, or so many backups have been done; return their number."""
    work, room = np.empty((3, len(prior))), hulls.room(len(prior))
    slots = m.targets.shape[1]
    picked, kept, vector = np.empty(slots, np.int64), np.empty(slots, np.int64), np.empty(len(prior))
    done = 0
    while done < backups:
        path.bound[0] = hulls.upper(x0, prior, hull, room)
        gap = path.bound[0] - _lower(x0, prior, plans)[0]
        short = min(len(plans.robot) - plans.space[0], len(hull.drop) - hull.space[0]) < len(path.state)
        if gap <= enough or short:
            break
        path.state[0], path.belief[0] = x0, prior
        depth, target = 0, TARGET * gap
        while True:
            x, belief = path.state[depth], path.belief[depth]
            for r in range(m.robots[x]):
                path.q[depth, r], path.known[depth, r] = hulls.dot(q[x, r], belief), False
            r = _promising(depth, work, room, path, hull, m)
            path.robot[depth] = r
            place = m.place[x, r]
            if m.goal[place] or depth + 1 == len(path.state):
                break
            most, chosen = 0.0, NONE
            target /= m.gamma
            for a in range(m.counts[place]):
                y = m.targets[place, a]
                if m.final[y]:
                    continue
                excess = path.child[depth, r, a] - _lower(y, path.after[depth, r, a], plans)[0]
                excess -= target * path.mass[depth, r, a]
                if excess > most:
                    most, chosen = excess, a
            if chosen == NONE:
                break
            chance = path.mass[depth, r, chosen]
            path.chance[depth] = chance
            depth += 1
            path.state[depth] = m.targets[place, chosen]
            path.bound[depth] = path.child[depth - 1, r, chosen] / chance
            for h in range(len(prior)):
                path.belief[depth, h] = path.after[depth - 1, r, chosen, h] / chance
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
                now = hulls.upper(x, belief, hull, room)
                if value < now - step - 4 * ROUNDING * abs(value):
                    hulls.add(x, belief, value, hull)
                    improved = True
                lowered = path.bound[d] - min(value, now)
            best, at = -np.inf, NONE
            for k in range(m.robots[x]):
                if path.q[d, k] > best:
                    v = _look_down(d, k, work, path, picked, plans, m)
                    if v > best:
                        best, at = v, k
                        kept[:] = picked
            if best > _lower(x, belief, plans)[0] + step + 4 * ROUNDING * abs(best):
                _plan(x, at, kept, vector, plans, m)
                _add(x, at, vector, belief, plans)
                improved = True
        if not improved:
            fineness[0] *= 0.1
        done += depth + 1
    return done
