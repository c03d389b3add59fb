"""The bound from sample paths: an information relaxation that uses the subproblems and the beliefs that teams visit."""

from __future__ import annotations

import math
import time
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Floats
from ..person.attention_subproblem import AttentionSubproblem
from ..person.solver import Solution
from ..person.time_expansion import AWAY, HERE
from ..team.priority import Priority
from ..team.state import BASE, TeamAction, TeamPolicy, TeamState
from .certificate import returns
from .computation import Computation, Relaxation, Visited
from .information_relaxation.belief_nodes import BeliefNodes
from .information_relaxation.confidence import SampledBound
from .information_relaxation.sampled_bound import InformationRelaxation
from .prices import SubproblemGroup


class BeliefRecorder:
    """A team policy that acts like another one and records the states and beliefs of people at each place.

    Attributes
    ----------
    visited : list of lists of (int, int array, int array, float array)
        For each place: a step, and for all teams with an active person there the task state, the position of a robot
        (`person.time_expansion`), and the belief, shape (n, B, T). A robot under way counts as away.
    """

    uses_belief = True

    def __init__(self, policy: TeamPolicy, places: int, steps: int) -> None:
        self.policy, self.steps = policy, steps
        self.visited: list[list[tuple[int, NDArray[np.int64], NDArray[np.int64], Floats]]] = [[] for _ in range(places)]

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Record the states and beliefs of the teams, and return the other policy's action."""
        if team.step < self.steps:
            assert team.belief is not None
            location = np.where(team.ready, team.location, BASE)
            for k, visited in enumerate(self.visited):
                at = np.flatnonzero(team.active[:, k])
                here = np.where((location[at] == k).any(axis=1), HERE, AWAY)
                visited.append((team.step, team.x[at, k], here, team.belief[at, k]))
        return self.policy(team)

    def of(self, places: tuple[int, ...], visits: AttentionSubproblem) -> tuple[NDArray[np.int64], Floats]:
        """Return the subproblem's states and visited beliefs of the people at some places, the latest steps first.

        Beliefs that differ by less than 1/200 in each entry count as equal.
        """
        found = [one for place in places for one in self.visited[place] if len(one[1])]
        if not found:
            return np.empty(0, dtype=np.int64), np.empty((0, *visits.pomdp.prior.shape))
        states = np.concatenate([visits.layout.number(step, here, x) for step, x, here, _ in found])
        steps = np.concatenate([np.full(len(x), step) for step, x, _, _ in found])
        beliefs = np.concatenate([belief for *_, belief in found])
        rounded = np.column_stack([states, np.rint(beliefs.reshape(len(states), -1) / (1 / 200))])
        first = np.unique(rounded.astype(np.int32), axis=0, return_index=True)[1]
        first = first[(states[first] >= 0) & ~visits.pomdp.ends[states[first]]]
        first = first[np.argsort(-steps[first], kind="stable")]
        return states[first], beliefs[first]


def visited(run: Computation, groups: list[SubproblemGroup], price: Floats, together: int) -> Visited:
    """Simulate the priority policy at these prices, and return what tells which beliefs people visit.

    A robot with one person rarely leaves them alone for long, so that the solver rarely visits beliefs that arise then.
    In a team such beliefs are frequent. Where bounds are loose, the information relaxation divides them among known
    types, which tells the robot too much.
    """
    priority = Priority.of(run.policies, run.travel, price[0] if price.size else None)
    meeting = BeliefRecorder(priority, len(run.team), together + run.options.relaxation.free_steps)
    each = math.ceil(run.options.belief_episodes / max(len(group.places) for group in groups))
    returns(run.pool, meeting, run.team, run.travel, episodes=each, seed=run.seed)
    return meeting.of


def without_prices(run: Computation, relaxed: Relaxation, visited: Visited | None) -> Relaxation:
    """Return the relaxation without prices if its bound is lower, as it may be if the time was short.

    Without prices, states need no step, so that the subproblems are much smaller.
    """
    if relaxed.done or not relaxed.price.size:
        return relaxed
    groups, begun = run.groups(0, True), time.perf_counter()
    until = begun + 0.3 * (run.start + run.limit - begun)
    free = run.relaxed(groups, relaxed.price[:, :0], until, visited)
    return min(relaxed, free, key=lambda one: one.upper)


def sampled(run: Computation, relaxed: Relaxation, together: int) -> SampledBound | None:
    """Return the bound from sample paths; None if there was too little time for it."""
    begun = time.perf_counter()

    def left(done: int) -> float:
        run.tell("drawing sample paths", done, run.paths)
        return 1.0 - (time.perf_counter() - begun) / max(1e-9, run.start + run.limit - begun)

    with suppress(TimeoutError):
        team = InformationRelaxation(
            _belief_nodes(relaxed), relaxed.price[0], together, left, run.workers, run.options.relaxation,
            len(run.pool.setting.robots),
        )  # fmt: skip
        return team.sampled(run.paths, run.seed)
    return None


def _belief_nodes(relaxed: Relaxation) -> list[BeliefNodes]:
    """Return the belief nodes of each person; people of one group share them."""
    # The outer relaxation neglects travel time, so that it does not apply if travel takes time.
    free = not relaxed.price.size
    outers = [group.problem.outer if free and not group.visits.entry_steps else None for group in relaxed.groups]
    parts = [(visits, solution) for visits, solution in relaxed.parts if isinstance(solution, Solution)]
    belief_nodes = [BeliefNodes(*part, outer) for part, outer in zip(parts, outers, strict=True)]
    return [one for group, one in zip(relaxed.groups, belief_nodes, strict=True) for _ in range(len(group.places))]
