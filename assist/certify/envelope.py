"""How far theta can come by what people see of their neighbours, and values that hold for all of it.

With neighbours who see each other, theta of a person also moves when another one gets a suggestion. The bound of
`team_bound` then holds if these moves, too, are chosen as well as possible in the subproblem of each person:

Assumptions. Those of `team_bound`, except that theta of a person depends on other people's suggestions: each one that
they see is an event, whose rule says how far theta can come at least, l(theta), and at most, u(theta). Both rise with
theta. That is checked where they are used: on the grid, and at all bounds that follow from it.

Claim. Let l_0(theta) = theta, and l_{m+1}(theta) the least of l_m(theta) and l(l_m(theta)) of each kind of events; u_m
likewise, with the largest. So [l_m(theta), u_m(theta)] has all values of theta after at most m events of a step. Let
V_k(lambda) be the optimal value, with observed type and theta, of person k's subproblem in which theta, after each step
of theirs, may be moved to any value in this interval: with m = M robots if none attends to them in this step, else with
m = M - 1. Then J* <= M sum_t gamma^t lambda_t + sum_k V_k(lambda).

Proof. Prices are added as without neighbours. Each suggestion of a step is made by another robot, which attends to its
person. So at most M of them, or M - 1 if a robot attends to k, are events for k, and theta of k is in the interval.
Hence what happens to k under a team policy is a policy of this subproblem that also chooses these moves. It depends on
what is seen of the other people. Given the robots' actions and what they saw of k, that is independent of k's type and
theta, so that it acts like additional random numbers, as in `team_bound`. A policy that observes the type and theta is
not worse. So the mean of its return is at most V_k(lambda).

That the interval has all these values follows by induction over the events. After m of them theta is at least
l_m(theta). As l rises, one more leads to l(l_m(theta)) or more; if there is none, theta stays.

The values are those on the grid, with theta between grid points divided between them, as people of the model move:
linear between grid points, and largest at an end of the interval or at a grid point within.

Of a truncated task not all states are known, so that a gain may have any size. Values at its frontier are those of
people who never err, which no theta exceeds (`truncated_bound.bounded` with `outer` "none").
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..declare.declared import MOST
from ..people.decision import Floats
from ..people.neighbours import Range
from ..people.theta_reach import ThetaReach, range_of_gains
from ..person.attention_subproblem import AttentionSubproblem, backwards
from ..person.each_goal import Outer
from ..person.frontier_bounds import never_erring
from ..person.mdp_values import initial_upper_bounds, value_iteration
from ..person.pomdp import AssistPOMDP
from ..person.problem_rows import ProblemRows
from ..person.qmdp import QMDP, look_ahead
from ..person.rounding import rounding
from ..person.solver import Solution
from ..team.pool import Pool

Ints = NDArray[np.int64]

TOLERANCE = 1e-5
"""Largest change of a value in the last sweep, in cost units."""

SWEEPS = 10_000
"""Largest number of sweeps."""


class OwnTheta:
    """The bounds on the subproblem of a person who sees nobody: theta moves by suggestions to themselves only."""

    def outer(self, kept: bool) -> Outer:
        """Return what becomes of the relaxation on an outer truncated task, which perhaps is to be kept."""
        return "kept" if kept else "frontier"

    def tail(self, free: AttentionSubproblem, until: float) -> Floats:  # noqa: ARG002
        """Return the values with free attention, shape (P * n, H, T), of a subproblem without prices."""
        value = initial_upper_bounds(free.pomdp)
        value_iteration(free.pomdp, value, tolerance=TOLERANCE)
        return value

    def solved(self, visits: AttentionSubproblem, tail: Floats, until: float) -> QMDP:  # noqa: ARG002
        """Return the values of a subproblem with observed type and theta, with their policy."""
        return backwards(visits, tail)

    def bound(self, best: QMDP, search: Callable[[QMDP], Solution]) -> Solution | Lifted:
        """Return a bound with type and theta out of sight, which a search finds from these values."""
        return search(best)


@dataclass(frozen=True, eq=False)
class Envelope(OwnTheta):
    """The bounds on the subproblem of a person whose theta also moves by what they see of neighbours.

    Attributes
    ----------
    reach : ThetaReach
        How far theta comes in a step.
    """

    reach: ThetaReach

    @classmethod
    def of(cls, pool: Pool, team: tuple[int, ...], places: tuple[int, ...]) -> OwnTheta:
        """Return the bounds for people at some places of a team: `OwnTheta` if they see nothing that moves theta.

        Raises
        ------
        ValueError
            As in `ThetaReach.of`.
        """
        model, grid = pool.model[list(team)].tolist(), pool.policies[0].pomdp.grid
        seen, most = pool.setting.neighbourhood(len(team)), len(pool.setting.robots)
        reach = ThetaReach.at(seen, places, model, lambda number: _gains(pool.policies[number].problem), grid, most)
        return OwnTheta() if reach is None else cls(reach)

    def outer(self, kept: bool) -> Outer:  # noqa: ARG002
        """Return that it is not computed, as theta moves by a person's own suggestions only in it."""
        return "none"

    def tail(self, free: AttentionSubproblem, until: float) -> Floats:
        """Return the values with free attention, as in `OwnTheta`, after the sweeps that begin by a time."""
        return self.solved(free, initial_upper_bounds(free.pomdp), until).value_mdp

    def bound(self, best: QMDP, search: Callable[[QMDP], Solution]) -> Solution | Lifted:  # noqa: ARG002
        """Return these values at the beginning as the bound, moved up by what rounding may take."""
        value = mean_at_most(best.value_mdp[best.pomdp.model.choices.initial], best.value_mdp, best.pomdp)
        return Lifted(value, -math.inf, value)

    def solved(self, visits: AttentionSubproblem, tail: Floats, until: float) -> QMDP:
        """Return the values of a subproblem in which theta may be moved within the envelope, with their policy.

        They are upper bounds after any number of sweeps, at first those of people who never err.

        Parameters
        ----------
        visits : AttentionSubproblem
        tail : float array, shape (P * n, H, T)
            Upper bounds on the values with free attention, by position and task state.
        until : float
            Time on the clock of `time.perf_counter()` after which no sweep begins, but for the first of each step.
        """
        pomdp, layout = visits.pomdp, visits.layout
        value, last = _first_bounds(visits), layout.step == len(visits.price)
        value[last] = np.minimum(value[last], tail[layout.position[last] * layout.states + layout.x[last]])
        goes_on = ~pomdp.final[pomdp.hidden.goal_of].T
        for step in range(len(visits.price), -1, -1):
            states = np.flatnonzero((layout.step == step) & goes_on.any(axis=1))
            within, own = goes_on[states][:, :, None], value[states]
            for _ in range(SWEEPS if step == len(visits.price) else 1):
                new = np.where(within, self._q(visits, value, states)[states].max(axis=1), own)
                change, own = float((own - new).max(initial=0.0)), np.minimum(own, new)
                value[states] = own
                if change <= TOLERANCE or time.perf_counter() >= until:
                    break
        return QMDP(pomdp, value.copy(), self._q(visits, value, np.arange(len(value))))

    def _q(self, visits: AttentionSubproblem, value: Floats, states: Ints) -> Floats:
        """Return the Q-values of moves in some states, with the values after theta has been moved."""
        robots, attended = len(self.reach.low) - 1, visits.attended()[:, :, None, None]
        each = [look_ahead(visits.pomdp, self.reach.lifted(value, robots - less), states).q_mdp for less in (1, 0)]
        return np.where(attended, *each)


def _first_bounds(visits: AttentionSubproblem) -> Floats:
    """Return upper bounds from which sweeps start, shape (m, H, T): of people who never err, if no robot executes."""
    pomdp, value = visits.pomdp, initial_upper_bounds(visits.pomdp)
    choices, (_, executes) = pomdp.model.choices, visits.acted()
    if not executes.any() and choices.applicable.any():
        best = never_erring(choices.goals.h, choices.costs[choices.applicable], pomdp.gamma)
        np.minimum(value, best[pomdp.hidden.goal_of].T[:, :, None], out=value)
    return value


def mean_at_most(value: Floats, every: Floats, pomdp: AssistPOMDP) -> float:
    """Return the mean under the prior of computed bounds, shape (H, T), moved up by what rounding may take.

    That is what it takes in each backup, in every later step (`policy_iteration`), and in the mean. The terms of both
    are counted together.

    Parameters
    ----------
    value : float array, shape (H, T)
    every : float array
        All values from which the backups were computed.
    pomdp : AssistPOMDP
    """
    terms = pomdp.model.choices.applicable.shape[1] * len(pomdp.grid.theta) + pomdp.prior.size
    margin = rounding(terms) / (1 - pomdp.gamma) * float(abs(every).max())
    return float((value * pomdp.prior).sum()) + margin


def _gains(problem: ProblemRows) -> Range:
    """Return the least and the largest gain of a step of a person who may have got a suggestion."""
    first = problem.first
    return range_of_gains(first.model, first.robot_actions > 1) if problem.whole else (-MOST, MOST)


class Lifted(NamedTuple):
    """The bound on a subproblem with an envelope, as `computation.Relaxation` reads it; no lower one is known."""

    value_qmdp: float
    lower: float
    upper: float
    stopped: str = "gap"


def require_envelope(pool: Pool, members: Iterable[int], paths: int) -> None:
    """Raise an error if a bound on some people of a pool cannot have what they see of each other.

    Raises
    ------
    ValueError
        Sample paths are asked for.
    """
    if paths and pool.setting.neighbourhood(len(list(members))).watched.any():
        raise ValueError(f"paths {paths}: expected 0, as sample paths do not have what people see of neighbours")
