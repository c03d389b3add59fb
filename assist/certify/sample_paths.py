"""The bound from sample paths: an information relaxation that uses the subproblems and the beliefs that teams visit."""

from __future__ import annotations

import math
import time
from contextlib import suppress

from ..people.decision import Floats
from ..person.solver import Solution
from ..team.priority import Priority
from .certificate import returns
from .computation import Computation, Relaxation
from .information_relaxation.belief_nodes import BeliefNodes
from .information_relaxation.confidence import SampledBound
from .information_relaxation.sampled_bound import InformationRelaxation
from .prices import SubproblemGroup
from .visited_beliefs import BeliefRecorder


def recorder(run: Computation, groups: list[SubproblemGroup], price: Floats, together: int) -> BeliefRecorder:
    """Simulate the priority policy at these prices, and return the recorder of visited beliefs.

    A robot with one person rarely leaves them alone for long, so that the solver rarely visits beliefs that arise then.
    In a team such beliefs are frequent. Where bounds are loose, the information relaxation divides them among known
    types, which tells the robot too much.
    """
    priority = Priority.of(run.policies, run.travel, price[0] if price.size else None)
    meeting = BeliefRecorder(priority, len(run.team), together + run.options.relaxation.free_steps)
    each = math.ceil(run.options.belief_episodes / max(len(group.places) for group in groups))
    returns(run.pool, meeting, run.team, run.travel, episodes=each, seed=run.seed)
    return meeting


def without_prices(run: Computation, relaxed: Relaxation, recorder: BeliefRecorder | None) -> Relaxation:
    """Return the relaxation without prices if its bound is lower, as it may be if the time was short.

    Without prices, states need no step, so that the subproblems are much smaller.
    """
    if relaxed.done or not relaxed.price.size:
        return relaxed
    groups, begun = run.groups(0, True), time.perf_counter()
    until = begun + 0.3 * (run.start + run.limit - begun)
    free = run.relaxed(groups, relaxed.price[:, :0], until, recorder)
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
