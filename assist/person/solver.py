"""One person's problem solved between certified bounds.

Heuristic search value iteration (Smith and Simmons, "Point-based POMDP algorithms: improved analysis and
implementation", 2005) in a form made for this problem: x is observed, so that every state has bounds of its own,
over beliefs of B * T numbers.

- Below, each state has alpha vectors: what some plan gets for each (beta, theta). They begin with policies that
  look only at x (`qmdp.evaluate`), and each backup adds the vector of a robot action followed by vectors that are
  there already. So the bound is the value of a policy that can be carried out.
- Above, each state has a hull: the values of the problem with beta and theta seen (`qmdp.qmdp`), lowered at single
  beliefs by backups.

A trial walks from the initial state and the prior through the most promising robot action to a child, drawn by what
each contributes to the gap (as in bounded real-time dynamic programming: McMahan, Likhachev and Gordon, 2005), until
the gap there is small or hardly anybody gets there, and backs both bounds up on the way home. What is off the way of
later trials would stay as it was first found: so after as many backups as there are beliefs above, all of these and all
vectors below are backed up again, in the order in which the task ends (as point-based value iteration does: Pineau,
Gordon and Thrun, 2003).

Both bounds hold in floating point too: whatever is stored is moved outwards by `qmdp.ROUNDING`. They are bounds of
the problem on its grid of beta and theta, and to someone who acts in steps as `AssistPOMDP` has them.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner import LimitError
from planner.system.arrays import outline
from planner.system.progress import Wanted, shows_progress

from ..people.decision import Floats
from . import archive, hsvi, upper_hull
from .alpha_vectors import VectorPolicy
from .pomdp import AssistPOMDP
from .problem_arrays import ProblemArrays, read_only
from .qmdp import QMDP, ROUNDING, evaluate, load_compiled, qmdp, sweep_order

SOLVING = "solving a person's POMDP: backups"
BACKUPS = 1000  # between two looks at the clock
MEMORY_LIMIT_MB = 4000.0  # unless another is given
SEED = 0  # of what trials draw: with as many backups all comes out the same
FOR_MET = 1 / 3  # of the time, for beliefs that are given
MET_FINENESS = (0.01, 0.05)  # as `hsvi.trials` has it, there
MET_BACKUPS = 60  # at one of these, before it is another's turn
MET_GAIN = 0.05  # it has another turn if that made less of what is between its bounds by more than this share
FINEST = 1e-6  # a bound that gains less than this share of the gap aimed at is as good as it was


@dataclass(frozen=True, kw_only=True)
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
        The value of doing nothing, and of always suggesting the optimal action that QMDP prefers at the prior; up to
        1e-4 less, and the second less where a time limit has ended its evaluation.
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

    __repr__ = outline

    def __post_init__(self) -> None:
        for array in (self.corner, self.point, self.drop, self.first):
            array.flags.writeable = False

    def save(self, file: str | Path, **more: Any) -> None:
        """Save the solution and its problem, with further arrays by name; `docs/policies.md` describes the file."""
        archive.save(Path(file), self, **more)

    @classmethod
    def load(cls, file: str | Path) -> Solution:
        """Load a solution.

        Raises
        ------
        ArchiveError
            Another kind of file.
        """
        return archive.load(Path(file), cls)

    @property
    def pomdp(self) -> AssistPOMDP:
        """The problem."""
        return self.policy.pomdp

    @property
    def gap(self) -> float:
        """The distance of the bounds, relative to the lower one."""
        return relative_gap(self.lower, self.upper)

    def as_dict(self) -> dict[str, Any]:
        """Give as plain data how large the problem is, what is proven of it, and what that took."""
        return {
            "states": len(self.pomdp.robot_actions),
            "hidden": self.pomdp.prior.size,
            "lower": self.lower,
            "upper": self.upper,
            "gap": self.gap,
            "value_qmdp": self.value_qmdp,
            "value_never": self.value_never,
            "value_always": self.value_always,
            "seconds": self.seconds,
            "alpha_vectors": len(self.policy.robot),
            "stopped": self.stopped,
        }

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
        """Give what no policy exceeds, shape (N,), convex in the belief; arguments as in `q_values`."""
        value, size = np.empty(len(x)), self.pomdp.prior.size
        beliefs = read_only(belief, float).reshape(len(x), size)
        corner, point = (read_only(array).reshape(-1, size) for array in (self.corner, self.point))
        drop, first = read_only(self.drop), read_only(self.first)
        upper_hull.uppers(value, read_only(x, np.int64), beliefs, corner, point, drop, first, upper_hull.PIVOTS)
        return value


def relative_gap(lower: float, upper: float) -> float:
    """Give (upper - lower) / |lower|, 0 where both are 0."""
    return 0.0 if upper <= lower else (upper - lower) / abs(lower)


def first_bounds_bytes(pomdp: AssistPOMDP) -> int:
    """Give about how many bytes `solve` takes before its search begins."""
    (states, robots), slots, hidden = pomdp.suggested.shape, pomdp.model.choices.targets.shape[1], pomdp.prior.size
    # QMDP's values and a copy of them; the corners; vectors and witnesses of four policies; what one policy is worth.
    return 8 * hidden * (states * (2 * robots + 12) + hsvi.DEPTH * (8 + robots * slots))


@shows_progress
def solve(
    pomdp: AssistPOMDP,
    *,
    gap: float = 1e-3,
    time_limit: float | None = None,
    memory_limit_mb: float = MEMORY_LIMIT_MB,
    best: QMDP | None = None,
    met: tuple[NDArray[np.int64], Floats] | None = None,
    bounds: Callable[[float, float, float], None] | None = None,
    progress: Wanted = None,
) -> Solution:
    """Solve one person's problem.

    Parameters
    ----------
    pomdp : AssistPOMDP
    gap : float
        Stop when (upper - lower) / abs(lower) at the initial state and the prior is at most this.
    time_limit : float, optional
        Stop the search after so many seconds. The policy that does nothing is evaluated in any case; values of
        policies that suggest, and the first upper bound, are what they have come to by then. Compiling, which takes
        place once after an installation, does not count.
    memory_limit_mb : float
        Stop before vectors and beliefs take more.
    best : QMDP, optional
        The QMDP policy, if it is known already.
    met : int array, shape (m,), and float array, shape (m, B, T), optional
        States, none of them final, and beliefs at which the bounds are to be good as well, wherever the best policy
        goes; what comes last is best first. That ends where nothing is gained any more; a third of a time limit is for
        it, and what is left of the rest.
    bounds : callable, optional
        Called with seconds, lower and upper bound, about every tenth of a second.
    progress : callable or bool, optional
        Who is told how far it is, as in `planner.system.progress`: how many backups have been done.

    Raises
    ------
    LimitError
        The first bounds alone would take more memory than is allowed; nothing has been worked out.
    """
    assert callable(progress)
    for name, number in (("gap", gap), ("time_limit", time_limit), ("memory_limit_mb", memory_limit_mb)):
        if number is not None and not number >= 0:
            raise ValueError(f"{name} {number:g}: expected 0 or more")
    needed = first_bounds_bytes(pomdp) / 1e6
    if needed > memory_limit_mb:
        raise LimitError(
            f"the first bounds on {len(pomdp.robot_actions):,} states take about {needed:,.0f} MB of memory, and "
            f"{memory_limit_mb:,.0f} MB are allowed; expected fewer states, a coarser grid or more memory"
        )
    load_compiled(pomdp)
    progress(SOLVING, 0, None)
    start = time.perf_counter()
    x0 = pomdp.model.choices.initial
    prior = pomdp.prior.reshape(-1)
    until = math.inf if time_limit is None else start + time_limit
    best = best or qmdp(pomdp, deadline=until)
    work = _Search(pomdp, best)
    never = np.zeros(len(pomdp.robot_actions), dtype=np.int64)
    value_never = work.begin(never)
    value_always = work.begin(_informed(best, pomdp.prior, pomdp.suggests_optimal), until)
    trusting = np.zeros_like(pomdp.prior)
    trusting[:, -1] = pomdp.prior.sum(axis=1)
    for belief in (pomdp.prior, trusting):
        work.begin(_informed(best, belief), until)

    # A value of 0 is approached from below for ever, and the gap remains 1.
    smallest = ROUNDING * (pomdp.robot_costs.max() + pomdp.model.choices.costs.max()) / (1 - pomdp.gamma)
    searching = None if time_limit is None else time_limit * (1 - FOR_MET if met is not None else 1)
    stopped, backups = "gap", 0
    lower, upper = -np.inf, np.inf
    begun = time.perf_counter()
    work.trials(x0, prior, np.inf)  # no trial, but compiled code
    work.renew(0.0)
    start += time.perf_counter() - begun
    while True:
        # A bound that has been proven remains proven, should the search lose sight of it.
        below, above = work.bounds(x0, prior)
        lower, upper = max(lower, below), min(upper, above)
        seconds = time.perf_counter() - start
        progress(SOLVING, backups, None)
        if bounds is not None:
            bounds(seconds, lower, upper)
        if relative_gap(lower, upper) <= gap:
            break
        if searching is not None and seconds >= searching:
            stopped = "time"
            break
        if not work.make_room(memory_limit_mb):
            stopped = "memory"
            break
        going_on = work.fineness[0] >= FINEST and upper - lower > smallest
        done = work.improve(x0, prior, gap * abs(lower), upper - lower) if going_on else 0
        if not done:
            stopped = "stalled"
            break
        backups += done
    if met is not None and len(met[0]):
        work.widen(*met, gap, math.inf if time_limit is None else start + time_limit, memory_limit_mb)
        below, above = work.bounds(x0, prior)
        lower, upper = max(lower, below), min(upper, above)
    return work.solution(
        lower=lower, upper=upper, value_qmdp=float((best.value_mdp[x0] * pomdp.prior).sum()), value_never=value_never,
        value_always=value_always, seconds=time.perf_counter() - start, backups=backups, stopped=stopped,
    )  # fmt: skip


def _informed(best: QMDP, belief: Floats, among: NDArray[np.bool_] | None = None) -> NDArray[np.int64]:
    """Give QMDP's action in each state for one belief: of all, or `among` some, shape (n, R), if there are any."""
    q = np.einsum("nrbt,bt->nr", np.maximum(best.q_mdp, -1e300), belief)
    if among is not None:
        q = np.where(among, q, -np.inf)
    return q.argmax(axis=1)


class _Search:
    """The bounds of one problem while they are improved."""

    def __init__(self, pomdp: AssistPOMDP, best: QMDP) -> None:
        self.pomdp, self.arrays = pomdp, ProblemArrays.of(pomdp)
        states, size = len(pomdp.robot_actions), pomdp.prior.size
        margin = ROUNDING / (1 - pomdp.gamma)
        corner = (best.value_mdp + margin * np.abs(best.value_mdp)).reshape(states, size)
        self.q = best.q_mdp.reshape(states, -1, size) * (1 - margin)  # values are negative
        self.hull = hsvi.empty_hull(corner, 2 * hsvi.DEPTH)
        self.plans = hsvi.no_plans(states, size, 4 * states + 2 * hsvi.DEPTH)
        self.path = hsvi.new_path(size, pomdp.suggested.shape[1], pomdp.model.choices.targets.shape[1])
        self.order = read_only(sweep_order(pomdp))
        self.renewed = len(self.order)  # how far in this order the present renewal has come
        self.tried = 0  # backups of trials since it began
        self.fineness = np.array([0.001, 0.01])  # as `hsvi.trials` has it; refined where nothing more is found
        self.rng = np.random.default_rng(SEED)

    def begin(self, robot: NDArray[np.int64], deadline: float = math.inf) -> float:
        """Add the vectors of a policy that looks only at x; return its value at the root, below it after a deadline."""
        value = evaluate(self.pomdp, robot, deadline=deadline)
        flat = np.ascontiguousarray(value).reshape(len(value), -1)
        hsvi.add_plans(flat, robot, _own(self.pomdp.prior), self.plans)
        return float((value[self.pomdp.model.choices.initial] * self.pomdp.prior).sum())

    def bounds(self, x: int, belief: Floats) -> tuple[float, float]:
        """Give both bounds at a belief."""
        belief = _own(belief)
        lower, _ = hsvi.lower(x, belief, self.plans)
        upper = hsvi.upper(x, belief, self.hull, hsvi.new_room(len(belief)))
        return lower - ROUNDING * abs(lower), upper + ROUNDING * abs(upper)

    def make_room(self, memory_limit_mb: float) -> bool:
        """Double what is nearly full, if the limit allows it."""
        limit = memory_limit_mb * 1e6
        if self.memory() > limit:
            return False
        needed = max(hsvi.DEPTH, int(self.plans.live.max()))
        for name in ("plans", "hull"):
            store = getattr(self, name)
            capacity = len(store.after)
            if capacity - store.space[0] > needed:
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
            store.state[capacity:] = hsvi.NONE
            setattr(self, name, store)
        return True

    def memory(self) -> int:
        """Give the bytes that vectors and beliefs take."""
        return sum(array.nbytes for store in (self.plans, self.hull) for array in store)

    def improve(self, x: int, belief: Floats, target: float, gap: float) -> int:
        """Do some backups, and return how many: of trials, and of all there is once trials have done as many."""
        if self.renewed == len(self.order) and self.tried > self.hull.space[0]:
            self.renewed = self.tried = 0
        done = self.renew(self.fineness[0] * gap)
        if done:
            return done
        done = self.trials(x, belief, target)
        self.tried += done
        return done

    def renew(self, step: float) -> int:
        """Go on with backing everything up again; gains up to `step` are no reason for another vector."""
        self.renewed, done = hsvi.renew(
            self.renewed, self.order, step, BACKUPS, self.path, self.plans, self.hull, self.q, self.arrays
        )
        return done

    def trials(self, x: int, belief: Floats, target: float) -> int:
        """Improve the bounds by some trials."""
        return hsvi.trials(
            x, _own(belief), target, BACKUPS, self.fineness, self.rng, self.path, self.plans, self.hull, self.q,
            self.arrays,
        )  # fmt: skip

    def widen(
        self, states: NDArray[np.int64], beliefs: Floats, gap: float, until: float, memory_limit_mb: float
    ) -> None:
        """Improve the bounds at beliefs: each by one backup, then by trials from those where that goes on to gain."""
        flat = np.array(beliefs, dtype=float).reshape(len(states), -1)
        states, step = np.array(states, dtype=np.int64), FINEST * abs(self.bounds(int(states[0]), flat[0])[0])
        fineness = np.array(MET_FINENESS)

        def once() -> None:
            at = 0
            while at < len(states) and self.make_room(memory_limit_mb):
                at, _ = hsvi.lower_at(at, states, flat, step, self.path, self.hull, self.q, self.arrays)

        def gains(i: int) -> bool:
            below, above = self.bounds(int(states[i]), flat[i])
            if relative_gap(below, above) <= gap:
                return False
            fineness[:] = MET_FINENESS
            hsvi.trials(
                int(states[i]), flat[i], gap * abs(below), MET_BACKUPS, fineness, self.rng, self.path, self.plans,
                self.hull, self.q, self.arrays,
            )  # fmt: skip
            lower, upper = self.bounds(int(states[i]), flat[i])
            return upper - lower < (1 - MET_GAIN) * (above - below)

        once()
        left = list(range(len(states)))
        while left:
            kept: list[int] = []
            for i in self.rng.permutation(left).tolist():
                if time.perf_counter() >= until or not self.make_room(memory_limit_mb):
                    kept = []
                    break
                if gains(i):
                    kept.append(i)
            left = kept
        once()

    def solution(self, **facts: object) -> Solution:
        """Collect the result, sorted by state."""
        pomdp, states = self.pomdp, len(self.pomdp.robot_actions)
        shape = (-1, *pomdp.grid.shape)
        kept, first = _sorted(self.plans.state, states)
        policy = VectorPolicy(
            pomdp, self.plans.vector[kept].reshape(shape), self.plans.robot[kept].astype(np.int64), first
        )
        kept, first = _sorted(self.hull.state, states)
        return Solution(
            policy=policy, corner=self.hull.corner.reshape(shape), point=self.hull.belief[kept].reshape(shape),
            drop=self.hull.drop[kept], first=first, **facts,  # type: ignore[arg-type]
        )  # fmt: skip


def _own(belief: Floats) -> Floats:
    """Give a flat copy that is not read-only: what is compiled for one kind of array is not compiled for another."""
    return np.array(belief).reshape(-1)


FIXED = ("corner", "head", "live", "limit", "space")


def _sorted(state: NDArray[np.int32], states: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Give the used places in the order of their states, and each state's first."""
    used = np.flatnonzero(state >= 0)
    used = used[np.argsort(state[used], kind="stable")]
    return used, np.searchsorted(state[used], np.arange(states + 1))
