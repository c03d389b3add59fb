"""A solver for one person's problem with certified bounds.

The algorithm is heuristic search value iteration (Smith and Simmons, "Point-based POMDP algorithms: improved analysis
and implementation", 2005), adapted to this problem: x is observed, so that every state has bounds of its own, over
beliefs of B * T numbers.

- Lower bound: each state has alpha vectors. The first ones belong to policies that depend on x only (`qmdp.evaluate`).
  Each backup adds the vector of a robot action that is followed by existing vectors. So the lower bound is the value of
  a policy that can be executed.
- Upper bound: each state has a hull. It starts at the values of the problem with observed beta and theta (`qmdp.qmdp`).
  Backups lower it at single beliefs.

A trial starts at the initial state and the prior. It follows the robot action with the largest upper bound to a child,
sampled by its contribution to the gap, as in bounded real-time dynamic programming (McMahan, Likhachev and Gordon,
2005). It ends where the gap or the probability of the path is small, and backs up both bounds on the way back. Beliefs
off the paths of later trials would keep their first bounds. Therefore the solver also repeats all stored backups, each
time the trials have done as many backups as the hull has beliefs. It does so in the order of increasing cost-to-go (as
in point-based value iteration: Pineau, Gordon and Thrun, 2003).

Both bounds hold in floating-point arithmetic: every stored number is moved outwards by `qmdp.ROUNDING`. They are bounds
for the problem on its grid of beta and theta, and for people as `AssistPOMDP` models them.
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
from .policy import Policy
from .pomdp import AssistPOMDP
from .problem_arrays import ProblemArrays, read_only
from .qmdp import QMDP, ROUNDING, evaluate, load_compiled, qmdp, sweep_order

SOLVING = "solving a person's POMDP: backups"


@dataclass(frozen=True)
class SolverOptions:
    """Options of the search in `solve`. The bounds are valid for all values.

    Attributes
    ----------
    depth : int
        Largest number of steps of a trial. At the default gamma of 0.99, later steps have a weight below 1 %. The
        memory of a trial is proportional to it.
    finest : float
        Smallest relevant improvement of a bound, as a share of the target gap. A search without larger improvements has
        stalled.
    backups_per_check : int
        Number of backups between two checks of time and memory; the default takes about 0.1 s.
    """

    depth: int = 500
    finest: float = 1e-6
    backups_per_check: int = 1000


@dataclass(frozen=True, kw_only=True)
class Solution(Policy):
    """A policy for one person's problem with certified bounds on its value.

    The policy is greedy with respect to the alpha vectors, by one exact Bellman backup. Its value is at least that of
    the vectors.

    Attributes
    ----------
    policy : VectorPolicy
    corner : float array, shape (n, B, T)
        Upper bound for known beta and theta, in cost units.
    point : float array, shape (p, B, T)
        Beliefs with a lower upper bound, sorted by state.
    drop : float array, shape (p,)
        Upper bound at each of these beliefs minus the value of `corner` there; negative.
    first : int array, shape (n + 1,)
        The beliefs of state x are `point[first[x] : first[x + 1]]`.
    lower, upper : float
        Bounds on the optimal value at the initial state and the prior. The value of `policy` is at least `lower`.
    value_qmdp : float
        The QMDP value there, an upper bound.
    value_never, value_always : float
        Values of two policies there: do nothing, and always suggest the optimal action that QMDP prefers at the prior.
        They are at most 1e-4 cost units too low; the second may be lower still after a time limit.
    seconds : float
    backups : int
    stopped : str
        Why the search ended: "gap", "time", "memory" or "stalled". A search has stalled if no trial improves a bound:
        the rest of the gap is due to the leaf bounds of a frontier, or to rounding.
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
        """Save the solution and its problem, with further named arrays; `docs/policies.md` describes the file."""
        archive.save(Path(file), self, **more)

    @classmethod
    def load(cls, file: str | Path) -> Solution:
        """Load a solution.

        Raises
        ------
        ArchiveError
            The file is of another kind.
        """
        return archive.load(Path(file), cls)

    @property
    def pomdp(self) -> AssistPOMDP:
        """The problem."""
        return self.policy.pomdp

    @property
    def gap(self) -> float:
        """The relative gap (upper - lower) / abs(lower)."""
        return relative_gap(self.lower, self.upper)

    def as_dict(self) -> dict[str, Any]:
        """Return the size of the problem, its bounds and the effort, as plain data."""
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
        """Return lower bounds on the policy's Q-values, shape (N, R); minus infinity in padding.

        Parameters
        ----------
        x : int array, shape (N,)
        belief : float array, shape (N, B, T)
        """
        return self.policy.q_values(x, belief)

    def value(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Return the lower bound on the policy's value, shape (N,); arguments as in `q_values`."""
        return self.policy.value(x, belief)

    def upper_bound(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Return the upper bound on the value of any policy, shape (N,), convex in the belief.

        The arguments are as in `q_values`.
        """
        value, size = np.empty(len(x)), self.pomdp.prior.size
        beliefs = read_only(belief, float).reshape(len(x), size)
        corner, point = (read_only(array).reshape(-1, size) for array in (self.corner, self.point))
        drop, first = read_only(self.drop), read_only(self.first)
        upper_hull.uppers(value, read_only(x, np.int64), beliefs, corner, point, drop, first, upper_hull.PIVOTS)
        return value


def relative_gap(lower: float, upper: float) -> float:
    """Return (upper - lower) / abs(lower), or 0 if both are 0."""
    return 0.0 if upper <= lower else (upper - lower) / abs(lower)


def first_bounds_bytes(pomdp: AssistPOMDP, depth: int = SolverOptions.depth) -> int:
    """Return the approximate memory, in bytes, that `solve` needs before its search begins."""
    (states, robots), slots, hidden = pomdp.suggested.shape, pomdp.model.choices.targets.shape[1], pomdp.prior.size
    # QMDP's values and a copy; the corners; vectors and witnesses of four policies; the values of one policy.
    return 8 * hidden * (states * (2 * robots + 12) + depth * (8 + robots * slots))


@shows_progress
def solve(
    pomdp: AssistPOMDP,
    *,
    gap: float = 1e-3,
    time_limit: float | None = None,
    memory_limit_mb: float = 4000.0,
    best: QMDP | None = None,
    further_beliefs: tuple[NDArray[np.int64], Floats] | None = None,
    options: SolverOptions | None = None,
    bounds: Callable[[float, float, float], None] | None = None,
    progress: Wanted = None,
) -> Solution:
    """Solve one person's problem to a given gap.

    Parameters
    ----------
    pomdp : AssistPOMDP
    gap : float
        Stop when (upper - lower) / abs(lower) at the initial state and the prior is at most this.
    time_limit : float, optional
        Stop the search after so many seconds. The policy that does nothing is evaluated in any case. The evaluation of
        other policies and the first upper bound stop at the limit as well. Compilation, once after an installation,
        does not count.
    memory_limit_mb : float
        Stop before vectors and beliefs take more memory, in MB.
    best : QMDP, optional
        The QMDP policy, if it is already known.
    further_beliefs : int array, shape (m,), and float array, shape (m, B, T), optional
        Further states, none of them final, and beliefs at which the bounds should be tight. The last has priority in
        the upper bound's linear program. A third of the time limit is reserved for them. The work on them ends when
        nothing improves.
    options : SolverOptions, optional
    bounds : callable, optional
        Called with the elapsed seconds and both bounds, about every tenth of a second.
    progress : callable or bool, optional
        Receives progress reports, as `planner.system.progress` describes: the number of backups.

    Raises
    ------
    LimitError
        The first bounds alone would exceed the memory limit. Nothing has been computed then.
    ValueError
        A number is negative, or the goal is one of several.
    """
    assert callable(progress)
    for name, number in (("gap", gap), ("time_limit", time_limit), ("memory_limit_mb", memory_limit_mb)):
        if number is not None and not number >= 0:
            raise ValueError(f"{name} {number:g}: expected 0 or more")
    pomdp.model.choices.require_one_goal("the certified solver")
    options = options or SolverOptions()
    needed = first_bounds_bytes(pomdp, options.depth) / 1e6
    if needed > memory_limit_mb:
        raise LimitError(
            f"the first bounds on {len(pomdp.robot_actions):,} states take about {needed:,.0f} MB of memory, and "
            f"{memory_limit_mb:,.0f} MB are allowed; expected fewer states, a coarser grid or more memory"
        )
    load_compiled(pomdp)
    progress(SOLVING, 0, None)
    start = time.perf_counter()
    until = math.inf if time_limit is None else start + time_limit
    best = best or qmdp(pomdp, deadline=until)
    work = _Search(pomdp, best, options)
    never, always = work.first_policies(best, until)
    start += work.load()
    # A third of the time is kept for the further beliefs.
    searching = math.inf if time_limit is None else time_limit * (2 / 3 if further_beliefs is not None else 1)

    def tell(lower: float, upper: float) -> float:
        seconds = time.perf_counter() - start
        progress(SOLVING, work.backups, None)
        if bounds is not None:
            bounds(seconds, lower, upper)
        return seconds

    stopped = work.run(gap, searching, memory_limit_mb, tell)
    if further_beliefs is not None and len(further_beliefs[0]):
        work.widen(*further_beliefs, gap, math.inf if time_limit is None else start + time_limit, memory_limit_mb)
        work.tighten()
    x0 = pomdp.model.choices.initial
    return work.solution(
        value_qmdp=float((best.value_mdp[x0] * pomdp.prior).sum()), value_never=never, value_always=always,
        seconds=time.perf_counter() - start, stopped=stopped,
    )  # fmt: skip


def _informed(best: QMDP, belief: Floats, among: NDArray[np.bool_] | None = None) -> NDArray[np.int64]:
    """Return QMDP's action in each state for one belief, shape (n,).

    The choice is among all robot actions, or among those of the mask `among`, shape (n, R).
    """
    q = np.einsum("nrbt,bt->nr", np.maximum(best.q_mdp, -1e300), belief)
    if among is not None:
        q = np.where(among, q, -np.inf)
    return q.argmax(axis=1)


class _Search:
    """The bounds of one problem during the search."""

    def __init__(self, pomdp: AssistPOMDP, best: QMDP, options: SolverOptions) -> None:
        self.pomdp, self.arrays, self.options = pomdp, ProblemArrays.of(pomdp), options
        states, size = len(pomdp.robot_actions), pomdp.prior.size
        margin = ROUNDING / (1 - pomdp.gamma)
        corner = (best.value_mdp + margin * np.abs(best.value_mdp)).reshape(states, size)
        self.q = best.q_mdp.reshape(states, -1, size) * (1 - margin)  # values are negative
        self.hull = hsvi.empty_hull(corner, 2 * options.depth)
        self.vectors = hsvi.empty_vectors(states, size, 4 * states + 2 * options.depth)
        robots, slots = pomdp.suggested.shape[1], pomdp.model.choices.targets.shape[1]
        self.trial = hsvi.new_trial(options.depth, size, robots, slots)
        self.order = read_only(sweep_order(pomdp))
        self.renewed = len(self.order)  # position of the current renewal in this order
        self.tried = 0  # backups of trials since the last renewal began
        self.fineness = np.array([0.001, 0.01])  # as in `hsvi.trials`, which refines it
        self.rng = np.random.default_rng(0)  # fixed: the same number of backups gives the same result
        self.root, self.prior = pomdp.model.choices.initial, pomdp.prior.reshape(-1)
        self.lower, self.upper = -np.inf, np.inf  # certified bounds at the root
        self.backups = 0

    def first_policies(self, best: QMDP, until: float) -> tuple[float, float]:
        """Add the vectors of policies that depend on x only; return the values of never and of always suggesting."""
        pomdp = self.pomdp
        never = self.begin(np.zeros(len(pomdp.robot_actions), dtype=np.int64))
        always = self.begin(_informed(best, pomdp.prior, pomdp.suggests_optimal), until)
        trusting = np.zeros_like(pomdp.prior)
        trusting[:, -1] = pomdp.prior.sum(axis=1)
        for belief in (pomdp.prior, trusting):
            self.begin(_informed(best, belief), until)
        return never, always

    def load(self) -> float:
        """Compile the search, without a trial or a backup; return the seconds that it took."""
        begun = time.perf_counter()
        self.trials(self.root, self.prior, np.inf)
        self.renew(0.0)
        return time.perf_counter() - begun

    def run(self, gap: float, seconds: float, memory_limit_mb: float, tell: Callable[[float, float], float]) -> str:
        """Search until a gap, a time or a memory limit is reached; return why it ended, as in `Solution.stopped`.

        `tell` receives both bounds at each check, and returns the elapsed seconds.
        """
        pomdp = self.pomdp
        # A value of 0 is only approached from below, and the relative gap stays 1; so an absolute limit applies too.
        smallest = ROUNDING * (pomdp.robot_costs.max() + pomdp.model.choices.costs.max()) / (1 - pomdp.gamma)
        while True:
            self.tighten()
            elapsed = tell(self.lower, self.upper)
            if relative_gap(self.lower, self.upper) <= gap:
                return "gap"
            if elapsed >= seconds:
                return "time"
            if not self.make_room(memory_limit_mb):
                return "memory"
            apart = self.upper - self.lower
            going_on = self.fineness[0] >= self.options.finest and apart > smallest
            done = self.improve(self.root, self.prior, gap * abs(self.lower), apart) if going_on else 0
            if not done:
                return "stalled"
            self.backups += done

    def tighten(self) -> None:
        """Update the bounds at the root.

        A certified bound remains valid, even if a later evaluation of the search is looser.
        """
        below, above = self.bounds(self.root, self.prior)
        self.lower, self.upper = max(self.lower, below), min(self.upper, above)

    def begin(self, robot: NDArray[np.int64], deadline: float = math.inf) -> float:
        """Add the vectors of a policy that depends on x only; return its value at the root, or a lower bound on it."""
        value = evaluate(self.pomdp, robot, deadline=deadline)
        flat = np.ascontiguousarray(value).reshape(len(value), -1)
        hsvi.add_vectors(flat, robot, _own(self.pomdp.prior), self.vectors)
        return float((value[self.pomdp.model.choices.initial] * self.pomdp.prior).sum())

    def bounds(self, x: int, belief: Floats) -> tuple[float, float]:
        """Return the lower and upper bound at a belief."""
        belief = _own(belief)
        lower, _ = hsvi.lower(x, belief, self.vectors)
        upper = hsvi.upper(x, belief, self.hull, hsvi.new_room(len(belief)))
        return lower - ROUNDING * abs(lower), upper + ROUNDING * abs(upper)

    def make_room(self, memory_limit_mb: float) -> bool:
        """Double the capacity of arrays that are nearly full; return False if the memory limit forbids it."""
        limit = memory_limit_mb * 1e6
        if self.memory() > limit:
            return False
        needed = max(self.options.depth, int(self.vectors.live.max()))
        per_state = ("corner", "head", "live", "limit", "space")  # these arrays do not grow
        for name in ("vectors", "hull"):
            store = getattr(self, name)
            capacity = len(store.after)
            if capacity - store.space[0] > needed:
                continue
            growing = [
                field for field in store._fields if len(getattr(store, field)) == capacity and field not in per_state
            ]
            # While an array is copied, both copies are in memory.
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
        """Return the memory of vectors and beliefs in bytes."""
        return sum(array.nbytes for store in (self.vectors, self.hull) for array in store)

    def improve(self, x: int, belief: Floats, target: float, gap: float) -> int:
        """Do some backups, and return their number.

        They repeat all stored backups once the trials have done as many as the hull has beliefs; otherwise they are
        trials.
        """
        if self.renewed == len(self.order) and self.tried > self.hull.space[0]:
            self.renewed = self.tried = 0
        done = self.renew(self.fineness[0] * gap)
        if done:
            return done
        done = self.trials(x, belief, target)
        self.tried += done
        return done

    def renew(self, step: float) -> int:
        """Continue the repetition of stored backups; return the number of backups.

        Improvements up to `step` add no vector.
        """
        self.renewed, done = hsvi.renew(
            self.renewed, self.order, step, self.options.backups_per_check, self.trial, self.vectors, self.hull,
            self.q, self.arrays,
        )  # fmt: skip
        return done

    def trials(self, x: int, belief: Floats, target: float) -> int:
        """Improve the bounds by some trials; return the number of backups."""
        return hsvi.trials(
            x, _own(belief), target, self.options.backups_per_check, self.fineness, self.rng, self.trial, self.vectors,
            self.hull, self.q, self.arrays,
        )  # fmt: skip

    def widen(
        self, states: NDArray[np.int64], beliefs: Floats, gap: float, until: float, memory_limit_mb: float
    ) -> None:
        """Improve the bounds at further beliefs.

        Each belief gets one upper backup, then rounds of trials. A belief stays in the rounds while 60 backups of
        trials reduce its gap by more than 5 %. The numbers balance the effort between the beliefs.
        """
        flat = np.array(beliefs, dtype=float).reshape(len(states), -1)
        states = np.array(states, dtype=np.int64)
        step = self.options.finest * abs(self.bounds(int(states[0]), flat[0])[0])
        finest = (0.01, 0.05)  # coarser than at the root, since there are many beliefs
        fineness = np.array(finest)

        def once() -> None:
            at = 0
            while at < len(states) and self.make_room(memory_limit_mb):
                at, _ = hsvi.lower_at(at, states, flat, step, self.trial, self.hull, self.q, self.arrays)

        def gains(i: int) -> bool:
            below, above = self.bounds(int(states[i]), flat[i])
            if relative_gap(below, above) <= gap:
                return False
            fineness[:] = finest
            hsvi.trials(
                int(states[i]), flat[i], gap * abs(below), 60, fineness, self.rng, self.trial, self.vectors,
                self.hull, self.q, self.arrays,
            )  # fmt: skip
            lower, upper = self.bounds(int(states[i]), flat[i])
            return upper - lower < 0.95 * (above - below)

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
        """Return the result, sorted by state."""
        pomdp, states = self.pomdp, len(self.pomdp.robot_actions)
        shape = (-1, *pomdp.grid.shape)
        kept, first = _sorted(self.vectors.state, states)
        policy = VectorPolicy(
            pomdp, self.vectors.vector[kept].reshape(shape), self.vectors.robot[kept].astype(np.int64), first
        )
        kept, first = _sorted(self.hull.state, states)
        return Solution(
            policy=policy, corner=self.hull.corner.reshape(shape), point=self.hull.belief[kept].reshape(shape),
            drop=self.hull.drop[kept], first=first, lower=self.lower, upper=self.upper, backups=self.backups,
            **facts,  # type: ignore[arg-type]
        )  # fmt: skip


def _own(belief: Floats) -> Floats:
    """Return a flat, writable copy. Compiled code is compiled separately for read-only arrays."""
    return np.array(belief).reshape(-1)


def _sorted(state: NDArray[np.int32], states: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the used entries in the order of their states, and the offset of each state."""
    used = np.flatnonzero(state >= 0)
    used = used[np.argsort(state[used], kind="stable")]
    return used, np.searchsorted(state[used], np.arange(states + 1))
