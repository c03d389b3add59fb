"""A solver for one person's problem with certified bounds.

The algorithm is heuristic search value iteration (Smith and Simmons, "Point-based POMDP algorithms: improved analysis
and implementation", 2005), adapted to this problem: x is observed, so that every state has bounds of its own, over
beliefs of H * T numbers. A person who reaches their goal stops, which the robot sees.

- Lower bound: each state has alpha vectors. The first ones belong to policies that depend on x only
  (`mdp_values.evaluate`). Each backup adds the vector of a robot action that is followed by existing vectors. So the
  lower bound is the value of a policy that can be executed.
- Upper bound: each state has a hull. It starts at the values of the problem with observed type and theta (`qmdp.qmdp`).
  Backups lower it at single beliefs.

Claim. If a bound holds in all states and beliefs, it still holds after a Bellman backup at some belief. Proof. The
optimal value V is the fixed point of the Bellman operator, V = B V. B is monotone: its values are maxima, over robot
actions, of minus the expected cost plus gamma times values of posteriors, whose weights are 0 or more. So U >= V gives
B U >= B V = V, and the same with <=. The first bounds hold: a robot that observes type and theta can ignore them, and
the first alpha vectors are values of policies. How bounds at single beliefs bound all others is in `upper_hull`.

A trial starts at the initial state and the prior. It follows the robot action with the largest upper bound to a child,
sampled by its contribution to the gap, as in bounded real-time dynamic programming (McMahan, Likhachev and Gordon,
2005). It ends where the gap or the probability of the path is small, and backs up both bounds on the way back. Beliefs
off the paths of later trials would keep their first bounds. Therefore the solver also repeats all stored backups, each
time the trials have done as many backups as the hull has beliefs. It does so in the order of increasing cost-to-go (as
in point-based value iteration: Pineau, Gordon and Thrun, 2003).

Both bounds hold in floating-point arithmetic: every stored number is moved outwards by `rounding`. They are bounds
for the problem on its types and grid of theta, and for people as `AssistPOMDP` models them.
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

from planner.system.files import finite
from planner.system.progress import Wanted, shows_progress
from planner.system.results import Result

from ..people.decision import Floats, Ints
from . import archive, convex_bound
from .alpha_vectors import VectorPolicy
from .further_beliefs import widen
from .memory_needed import depth_within, first_bounds_bytes, require_room
from .policy import Policy
from .pomdp import AssistPOMDP
from .problem_arrays import read_only
from .qmdp import QMDP, load_compiled, qmdp
from .search import Search, SolverOptions, relative_gap

SOLVING = "solving a person's POMDP: backups"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Solution(Result, Policy):
    """A policy for one person's problem with certified bounds on its value.

    The policy is greedy with respect to the alpha vectors, by one exact Bellman backup. Its value is at least that of
    the vectors.

    Attributes
    ----------
    policy : VectorPolicy
    corner : float array, shape (n, H, T)
        Upper bound for known type and theta, in cost units.
    point : float array, shape (p, H, T)
        Beliefs with a lower upper bound, sorted by state.
    drop : float array, shape (p,)
        Upper bound at each of these beliefs minus the value of `corner` there; negative.
    first : int array, shape (n + 1,)
        The beliefs of state x are `point[first[x] : first[x + 1]]`.
    lower, upper : float
        Bounds on the optimal value at the initial state and the prior. The value of `policy` is at least `lower`.
    value_qmdp : float
        The QMDP value there, moved upwards by the margin for rounding: an upper bound, and at least `upper`.
    value_never, value_always : float
        Values of two policies there: do nothing, and always suggest the optimal action that QMDP prefers at the prior.
        They are at most 1e-4 cost units too low; the second may be lower still after a time limit. Both are at most
        `lower`. On a truncated task both are lower bounds, which take the worst case of the first at the frontier, and
        the frontier's lower bound for the second.
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
    first: Ints
    lower: float
    upper: float
    value_qmdp: float
    value_never: float
    value_always: float
    seconds: float
    backups: int
    stopped: str

    def records(self) -> list[dict[str, Any]]:
        """Return one row: the bounds, the values of simpler policies, all in cost units, and how the search ended."""
        names = ("lower", "upper", "value_qmdp", "value_never", "value_always", "stopped", "seconds")
        return [{name: getattr(self, name) for name in names}]

    def __post_init__(self) -> None:
        for array in (self.corner, self.point, self.drop, self.first):
            array.flags.writeable = False

    def save(self, file: str | Path, **more: Any) -> None:
        """Save the solution and its problem as arrays of one `.npz` file.

        For n states, m alpha vectors, H types and T values of theta: `policy.vectors` (m, H, T) are the alpha
        vectors, sorted by state; `policy.action` (m,) the robot action with which each plan begins; state x has the
        vectors `policy.first[x]` to `policy.first[x + 1] - 1`. `corner` (n, H, T) is the upper bound where type and
        theta are known; `point` (p, H, T) and `drop` (p,) are beliefs with a lower upper bound and the differences,
        and `first` (n + 1,) the first belief of each state. `policy.pomdp...` is the problem, as documented at
        `AssistPOMDP`, `HumanModel`, `Choices`, `HiddenType` and `Grid`. Robot action 0 is to do nothing; r
        suggests the action `names[actions[x, suggested[x, r]]]` of `policy.pomdp` and its `model.choices`.

        Parameters
        ----------
        file : path
        **more
            Further arrays by name.
        """
        archive.save(Path(file), self, **more)

    @classmethod
    def load(cls, file: str | Path) -> Solution:
        """Load a solution.

        Raises
        ------
        InputFileError
            The file is of another kind.
        """
        return archive.load(Path(file), cls)

    @property
    def pomdp(self) -> AssistPOMDP:
        """The problem."""
        return self.policy.pomdp

    @property
    def gap(self) -> float:
        """The relative gap (upper - lower) / abs(lower); infinity if only the lower bound is 0."""
        return relative_gap(self.lower, self.upper)

    @property
    def suggests(self) -> bool:
        """Whether a suggestion is worth its cost, or may be.

        The latter is where the search was stopped before this was known, and where the task is truncated.
        """
        alone = self.value_never + 1e-3  # more than rounding errors, in cost units
        unknown = self.stopped in ("time", "memory") or self.pomdp.frontier is not None
        return self.lower > alone or (unknown and self.upper > alone)

    def as_dict(self) -> dict[str, Any]:
        """Return the size of the problem, its bounds and the effort, as plain data."""
        return {
            "states": len(self.pomdp.robot_actions),
            "hidden": self.pomdp.prior.size,
            "lower": self.lower,
            "upper": self.upper,
            "gap": finite(self.gap),
            "value_qmdp": self.value_qmdp,
            "value_never": self.value_never,
            "value_always": self.value_always,
            "seconds": self.seconds,
            "alpha_vectors": len(self.policy.action),
            "stopped": self.stopped,
        }

    def q_values(self, x: Ints, belief: Floats) -> Floats:
        """Return lower bounds on the policy's Q-values, shape (N, R); minus infinity in padding.

        Parameters
        ----------
        x : int array, shape (N,)
        belief : float array, shape (N, H, T)
        """
        return self.policy.q_values(x, belief)

    def value(self, x: Ints, belief: Floats) -> Floats:
        """Return the lower bound on the policy's value, shape (N,); arguments as in `q_values`."""
        return self.policy.value(x, belief)

    def upper_bound(self, x: Ints, belief: Floats) -> Floats:
        """Return the upper bound on the value of any policy, shape (N,), convex in the belief.

        The arguments are as in `q_values`.
        """
        value, size = np.empty(len(x)), self.pomdp.prior.size
        beliefs = np.array(belief, dtype=float, order="C").reshape(len(x), size)  # writable, as in sampled bounds
        corner, point = (read_only(array).reshape(-1, size) for array in (self.corner, self.point))
        drop, first = read_only(self.drop), read_only(self.first)
        convex_bound.uppers(value, read_only(x, np.int64), beliefs, corner, point, drop, first, convex_bound.PIVOTS)
        return value


@shows_progress
def solve(
    pomdp: AssistPOMDP,
    *,
    gap: float = 1e-3,
    time_limit: float | None = None,
    memory_limit_mb: float = 4000.0,
    best: QMDP | None = None,
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
        A number is negative.
    """
    assert callable(progress)
    for name, number in (("gap", gap), ("time_limit", time_limit), ("memory_limit_mb", memory_limit_mb)):
        if number is not None and not number >= 0:
            raise ValueError(f"{name} {number:g}: expected 0 or more")
    options = options or SolverOptions(depth=depth_within(pomdp, memory_limit_mb))
    require_room(
        f"the first bounds on {len(pomdp.robot_actions):,} states take", first_bounds_bytes(pomdp, options.depth),
        memory_limit_mb, "fewer states, a coarser grid or more memory",
    )  # fmt: skip
    load_compiled(pomdp)
    progress(SOLVING, 0, None)
    start = time.perf_counter()
    until = math.inf if time_limit is None else start + time_limit
    left = None if time_limit is None else max(1e-9, until - time.perf_counter())
    best = best or qmdp(pomdp, time_limit=left)
    work = Search(pomdp, best, options)
    never, always = work.first_policies(best, until)
    start += work.load()
    work.tighten()
    observed = work.upper  # of the corners, which are all that the hull contains before the first trial
    # A third of the time is kept for the further beliefs.
    further = options.further_beliefs
    searching = math.inf if time_limit is None else time_limit * (2 / 3 if further is not None else 1)

    def tell(lower: float, upper: float) -> float:
        seconds = time.perf_counter() - start
        progress(SOLVING, work.backups, None)
        if bounds is not None:
            bounds(seconds, lower, upper)
        return seconds

    stopped = work.run(gap, searching, memory_limit_mb, tell)
    if further is not None and len(further[0]):
        widen(work, *further, gap, math.inf if time_limit is None else start + time_limit, memory_limit_mb)
        work.tighten()
    return result_of(
        work, value_qmdp=observed, value_never=never, value_always=always,
        seconds=time.perf_counter() - start, stopped=stopped,
    )  # fmt: skip


def result_of(search: Search, **facts: object) -> Solution:
    """Return the result of a search, sorted by state."""
    pomdp, states = search.pomdp, len(search.pomdp.robot_actions)
    shape = (-1, *pomdp.prior.shape)
    kept, first = _sorted(search.vectors.state, states)
    policy = VectorPolicy(
        pomdp, search.vectors.vector[kept].reshape(shape), search.vectors.action[kept].astype(np.int64), first
    )
    kept, first = _sorted(search.hull.state, states)
    return Solution(
        policy=policy, corner=search.hull.corner.reshape(shape), point=search.hull.belief[kept].reshape(shape),
        drop=search.hull.drop[kept], first=first, lower=search.lower, upper=search.upper, backups=search.backups,
        **facts,  # type: ignore[arg-type]
    )  # fmt: skip


def _sorted(state: NDArray[np.int32], states: int) -> tuple[Ints, Ints]:
    """Return the used entries in the order of their states, and the offset of each state."""
    used = np.flatnonzero(state >= 0)
    used = used[np.argsort(state[used], kind="stable")]
    return used, np.searchsorted(state[used], np.arange(states + 1))
