"""The search for bounds on one person's problem: arrays that grow, trials, and repeated backups."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..people.arguments import whole
from ..people.decision import Bools, Floats, Ints
from . import belief_hulls, hsvi, vector_lists
from .mdp_values import evaluate, sweep_order
from .policy_iteration import rounding_error
from .pomdp import AssistPOMDP
from .problem_arrays import ProblemArrays, read_only
from .qmdp import QMDP
from .rounding import ROUNDING, rounding
from .upper_hull import new_program


@dataclass(frozen=True)
class SolverOptions:
    """Options of the search in `solve`. The bounds are valid for all values that are accepted.

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
    first_sweeps : int
        Number of sweeps that evaluate the two policies whose values only start the lower bound. More sweeps hardly
        raise it where people go next.
    further_beliefs : int array, shape (m,), and float array, shape (m, H, T), optional
        Further states, none of them final, and beliefs at which the bounds should be tight. The last has priority in
        the upper bound's linear program. A third of the time limit is reserved for them. The work on them ends when
        nothing improves.
    """

    depth: int = 500
    finest: float = 1e-6
    backups_per_check: int = 1000
    first_sweeps: int = 20
    further_beliefs: tuple[Ints, Floats] | None = None

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name in ("depth", "backups_per_check", "first_sweeps"):
            whole(name, getattr(self, name), 1)
        if not self.finest > 0:
            raise ValueError(f"finest {self.finest:g}: expected more than 0")


def relative_gap(lower: float, upper: float) -> float:
    """Return (upper - lower) / abs(lower); infinity if only the lower bound is 0."""
    if upper <= lower:
        return 0.0
    return (upper - lower) / abs(lower) if lower else math.inf


class Search:
    """The bounds of one problem during the search."""

    def __init__(self, pomdp: AssistPOMDP, best: QMDP, options: SolverOptions) -> None:
        self.pomdp, self.arrays, self.options = pomdp, ProblemArrays.of(pomdp), options
        states, size = len(pomdp.robot_actions), pomdp.prior.size
        known = pomdp.final[pomdp.hidden.goal_of].T[:, :, None]
        margin = np.where(known, 0.0, 2 * rounding_error(best.value_mdp, self.arrays))
        corner = (best.value_mdp + margin).reshape(states, size)
        self.q = (best.q_mdp + margin[:, None]).reshape(states, -1, size)
        self.hull = belief_hulls.empty_hull(corner, 2 * options.depth)
        self.vectors = vector_lists.empty_vectors(states, size, 4 * states + 2 * options.depth)
        actions, slots = pomdp.suggested.shape[1], pomdp.model.choices.targets.shape[1]
        self.trial = hsvi.new_trial(options.depth, size, actions, slots)
        order = np.concatenate([sweep_order(pomdp, goal) for goal in range(len(pomdp.final))])
        self.order = read_only(order[np.sort(np.unique(order, return_index=True)[1])])  # each state once
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
        nothing = np.zeros(len(pomdp.robot_actions), dtype=np.int64)
        never = self.begin(nothing)
        if pomdp.frontier is not None and pomdp.frontier.floor is not None:  # without any suggestion afterwards, too
            never = self.begin(nothing, leaves=pomdp.frontier.floor)
        always = self.begin(self.informed(best, pomdp.prior, np.asarray(pomdp.suggests_optimal.any(axis=2))), until)
        trusting = np.zeros_like(pomdp.prior)
        trusting[:, -1] = pomdp.prior.sum(axis=1)
        for belief in (pomdp.prior, trusting):
            self.begin(self.informed(best, belief), until, self.options.first_sweeps)
        return never, always

    def informed(self, best: QMDP, belief: Floats, among: Bools | None = None) -> Ints:
        """Return QMDP's action in each state for one belief, shape (n,).

        The choice is among all robot actions, or among those of the mask `among`, shape (n, R).
        """
        values = np.maximum(best.q_mdp, -1e300).reshape(*best.q_mdp.shape[:2], -1)
        q = np.einsum("nrh,h->nr", values, belief.reshape(-1))
        if among is not None:
            q = np.where(among, q, -np.inf)
        return q.argmax(axis=1)

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
            apart = self.upper - self.lower
            if relative_gap(self.lower, self.upper) <= gap or apart <= smallest:
                return "gap"
            if elapsed >= seconds:
                return "time"
            if not self.make_room(memory_limit_mb):
                return "memory"
            going_on = self.fineness[0] >= self.options.finest
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

    def begin(
        self, action: Ints, deadline: float = math.inf, max_sweeps: int | None = None, leaves: float | None = None
    ) -> float:
        """Add the vectors of a policy that depends on x only; return a lower bound on its value at the root."""
        limits: dict[str, Any] = {"deadline": deadline, "max_sweeps": max_sweeps, "leaves": leaves}
        value = evaluate(self.pomdp, action, **limits).reshape(len(action), -1)
        vector_lists.add_vectors(value, action, _own(self.pomdp.prior), self.vectors)
        there = float((value[self.root] * self.prior).sum())
        there -= rounding(2 * len(self.prior)) * abs(there)
        self.lower = max(self.lower, there)  # other sums of the same numbers may be lower by rounding
        return there

    def bounds(self, x: int, belief: Floats) -> tuple[float, float]:
        """Return the lower and upper bound at a belief."""
        belief = _own(belief)
        lower, _ = vector_lists.lower(x, belief, self.vectors)
        upper = belief_hulls.upper(x, belief, self.hull, new_program(len(belief)))
        margin = rounding(2 * len(belief))  # the upper bound sums over cells, and over as many stored beliefs
        return lower - margin * abs(lower), upper + margin * abs(upper)

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
            store.state[capacity:] = belief_hulls.NONE
            setattr(self, name, store)
        return True

    @property
    def tables(self) -> hsvi.Tables:
        """What the compiled search reads and writes."""
        return hsvi.Tables(self.arrays, self.q, self.hull, self.vectors, self.trial)

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
        self.renewed, done = hsvi.renew(self.renewed, self.order, step, self.options.backups_per_check, self.tables)
        return done

    def trials(self, x: int, belief: Floats, target: float) -> int:
        """Improve the bounds by some trials; return the number of backups."""
        return hsvi.trials(
            x, _own(belief), target, self.options.backups_per_check, self.fineness, self.rng, self.tables
        )


def _own(belief: Floats) -> Floats:
    """Return a flat, writable copy. Compiled code is compiled separately for read-only arrays."""
    return np.array(belief).reshape(-1)
