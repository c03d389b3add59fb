"""The problem of a whole team solved between bounds, for teams and tasks that are tiny.

Nothing is relaxed or taken apart here: observed is where everybody's task and the robot are, hidden are everybody's
beta and theta. The numbers of both are products over people, so that two people with a task of some dozens of
states are about as much as there can be. For those it is the yardstick of whatever scales: of team policies, and of
the bound for large teams (`assist.certify.team_bound`).

The problem is written out from each person's `AssistPOMDP` (`joint_problem.py`) and solved by heuristic search value
iteration (Smith and Simmons, "Heuristic search value iteration for POMDPs", 2004) in its plain form: below, alpha
vectors, of which never helping is the first; above, the values with everything seen, lowered at single beliefs and by
the sawtooth rule between them. It shares no code with the solver of one person's problem, so that each is a check of
the other.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
from joint_problem import Ints, JointProblem, check, product_of, written_out

from assist.people.decision import Floats
from assist.simulation.pool import Pool
from assist.team.state import NOBODY
from assist.team.travel import Travel

DEPTH = 500
"""Steps that a trial looks ahead, at the most."""

SETTLED = 1e-9
"""Values are worked out until a sweep changes none by more, in cost units."""

MARGIN = 1e-10
"""The bounds are moved apart by this share, which is more than rounding adds up to."""

AIM = 0.5
"""A trial ends where the bounds are closer than this share of their distance at the root, discounted."""

FINEST, LEAST = 1e-2, 1e-6
"""What is stored must gain this share of what a trial aims at; first, and in the end."""

NONE = -1


@dataclass(frozen=True)
class JointBounds:
    """What the best policy for a team gets, between bounds.

    Attributes
    ----------
    lower : float
        Mean discounted return of some policy from the beginning of an episode on, in cost units.
    upper : float
        What no policy's exceeds.
    never : float
        That of never helping.
    states : int
        Observed states: where everybody's task and the robot are.
    hidden : int
        Hidden states: everybody's beta and theta.
    seconds : float
    """

    lower: float
    upper: float
    never: float
    states: int
    hidden: int
    seconds: float

    @property
    def gap(self) -> float:
        """The distance of the bounds, relative to the lower one."""
        return (self.upper - self.lower) / abs(self.lower) if self.lower else 0.0


def joint_bounds(
    pool: Pool,
    team: tuple[int, ...] | None = None,
    *,
    travel: Travel | None = None,
    gap: float = 1e-3,
    time_limit: float | None = None,
) -> JointBounds:
    """Solve the problem of a team in which all work from the beginning, in the robot's model.

    The robot goes to somebody only to say or do something there: nothing is gained by going earlier, as long as no
    way around is shorter than the direct one.

    Parameters
    ----------
    pool : Pool
    team : tuple of int, optional
        Who is at each place; the whole pool unless given.
    travel : Travel, optional
        The way between them, which takes no time; that of the setting unless given.
    gap : float
        Stop when (upper - lower) / |lower| is at most this.
    time_limit : float, optional
        Stop the search after so many seconds. The first bounds are worked out in any case. Compiling, which takes
        place once after an installation, does not count.

    Raises
    ------
    ValueError
        The problem is too large to be written out, or moving takes time or is cheaper by a way around.
    """
    start = time.perf_counter()
    team = tuple(range(len(pool.people))) if team is None else team
    travel = travel or pool.setting.travel(len(team))
    people = [pool.policies[pool.model[person]].pomdp for person in team]
    check(people, travel)
    m = written_out(people, travel)
    belief = product_of([pomdp.prior.ravel() for pomdp in people])
    tasks = np.ravel_multi_index([p.model.choices.initial for p in people], [len(p.robot_actions) for p in people])
    root = int(tasks) * len(m.way) + len(people)  # the base comes last
    states, hidden = len(m.way) * (len(m.first) - 1), len(belief)
    # Costs are 0 or more: every sweep leaves values that begin with 0 too high, and those that begin with the dearest
    # step for ever too low.
    seen = np.zeros((states, hidden))
    never = np.full((states, hidden), m.reward.min() / (1 - m.gamma))
    for value, helping in ((seen, True), (never, False)):
        while _sweep(value, helping, m) > SETTLED:
            pass
    plans, points = _Store.of(never, np.arange(states)), _Store.of(np.empty((0, hidden)), np.full(states, NONE))
    path, beliefs = np.full(DEPTH, root), np.tile(belief, (DEPTH, 1))
    plans, points, finest = plans.with_room(), points.with_room(), FINEST
    _trial(path, beliefs, np.inf, finest, plans, points, seen, m)  # nothing but compiled code, which takes its time
    begun = time.perf_counter()
    while True:
        lower, upper = _lower(root, belief, plans)[0], _upper(root, belief, seen, points)
        late = time_limit is not None and time.perf_counter() - begun > time_limit
        if late or upper - lower <= gap * abs(lower):
            break
        plans, points = plans.with_room(), points.with_room()
        aim = max(gap * abs(lower), AIM * (upper - lower))
        if not _trial(path, beliefs, aim, finest, plans, points, seen, m):
            finest /= 2
            if finest < LEAST:  # what is left is rounding
                break
    return JointBounds(
        lower=lower - MARGIN * abs(lower), upper=upper + MARGIN * abs(upper), never=float(never[root] @ belief),
        states=states, hidden=hidden, seconds=time.perf_counter() - start,
    )  # fmt: skip


class _Store(NamedTuple):
    """Vectors of observed states, each state's in a list of their own.

    Below these are alpha vectors. Above they are beliefs, at which the upper bound is lower by `drop` than the
    values with everything seen.

    Attributes
    ----------
    row : float array, shape (C, H)
    drop : float array, shape (C,)
    after : int array, shape (C,)
        The next one of the same state.
    head : int array, shape (S,)
        The first one of each state.
    used : int array, shape (1,)
        How many there are.
    """

    row: Floats
    drop: Floats
    after: Ints
    head: Ints
    used: Ints

    @classmethod
    def of(cls, row: Floats, head: Ints) -> _Store:
        """Begin with one vector for each state, or none."""
        return cls(row, np.zeros(len(row)), np.full(len(row), NONE), head, np.array([len(row)]))

    def with_room(self) -> _Store:
        """Make room for what a trial may store."""
        size, room = len(self.row), max(len(self.row), DEPTH)
        if size - self.used[0] >= DEPTH:
            return self
        row = np.concatenate([self.row, np.empty((room, self.row.shape[1]))])
        return self._replace(row=row, drop=np.resize(self.drop, size + room), after=np.resize(self.after, size + room))


# Loops, where a line on whole arrays would do: those take several times as long to compile.
@numba.njit(cache=True)
def _dot(a: Floats, b: Floats) -> float:
    """Give a . b."""
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
    """Tell whether a >= b."""
    for h in range(len(a)):  # noqa: SIM110  numba has no generators
        if not a[h] >= b[h]:
            return False
    return True


@numba.njit(cache=True)
def _put(s: int, row: Floats, drop: float, store: _Store) -> None:
    """Store a vector, and let go of those of its state that it makes superfluous."""
    before, i = NONE, store.head[s]
    while i != NONE:
        if drop > 0.0:  # the upper bound there without it
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
    """Give the robot's place after a deed, and what the way there costs."""
    place = s % len(m.way)
    to = place if m.person[d] == NOBODY else m.person[d]
    return to, m.way[place, to]


@numba.njit(cache=True)
def _back(d: int, o: int, value: Floats, m: JointProblem, total: Floats) -> None:
    """Add to `total`, shape (H,), what an outcome of a deed is worth, if `value`, shape (H,), is what is reached."""
    for h in range(len(total)):
        moved = (1.0 - m.weight[d, h]) * value[m.low[d, h]] + m.weight[d, h] * value[m.high[d, h]]
        total[h] += m.gamma * m.chance[o, h] * moved


@numba.njit(cache=True)
def _sweep(value: Floats, helping: bool, m: JointProblem) -> float:
    """Improve all values with everything seen, shape (S, H), of the best policy or of never helping, once.

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
    """Give the largest product of an alpha vector and a belief, which need not add up to 1, and whose it is."""
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
    """Give the sawtooth bound at a belief, which need not add up to 1.

    A belief holds a share of each stored one, and with it that share of its drop.
    """
    corner, most, i = 0.0, 0.0, points.head[s]
    for h in range(len(belief)):
        corner += seen[s, h] * belief[h]
    while i != NONE:
        # The share shrinks from one hidden state to the next, until it is all that it was or the drop is no larger
        # than another one.
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
    """Fill `after` with the belief after an outcome of a deed, times the outcome's chance, which is returned."""
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
    """Walk from the state and belief at the beginning of the path to where the bounds are close, and improve them.

    Returns how many vectors have been stored.
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
    """Improve both bounds at a belief by looking one step ahead; returns how many of them.

    Deeds that by `q` get less than what some plan is known to get need not be looked at.
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
