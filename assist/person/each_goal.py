"""People whose goals are unknown: their problem for each goal, as if it were known.

Assumptions. Those of `certify.team_bound`, but for the goals, which may depend on each other. Person k pursues goal g
with probability p_k(g).

Claim. The claim of `certify.team_bound` holds with sum_g p_k(g) V_kg(lambda) in place of V_k(lambda), where V_kg is the
optimal value of their subproblem if the goal is known to be g.

Proof. A robot that knows all goals from the beginning can ignore them, so that no policy is better than its optimum.
Questions about goals tell it nothing and cost 0 or more, so that it asks none. For each vector of goals the claim
bounds this optimum. Its mean over the goals is as stated, since prices do not depend on goals and the sum over people
is linear. The robot actions of V_kg are those with the unknown goal: steps that are optimal for any goal may be
suggested. V_kg ends when the goal is reached, where a robot that does not see this could only pay for more.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from ..people.decision import NOTHING
from ..people.hidden_type import KNOWN
from .pomdp import AssistPOMDP


@dataclass(frozen=True)
class TruncatedProblem:
    """One person's problem whose upper bounds hold for the whole task.

    Attributes
    ----------
    problem : AssistPOMDP
        Problem with a robot that is always present, on the inner truncated task with hidden beta and theta.
    outer : OuterRelaxation or None
        The outer relaxation (`person.truncated_bound`), if it was requested and exists.
    between : OuterRelaxation or None
        The same on a smaller truncated task, on which prices are optimised.
    pairs : int
        Number of pairs of state and step that are enumerated if attention has a price at each step.
    """

    problem: AssistPOMDP
    outer: Any = None
    between: Any = None
    pairs: int = 0


@dataclass(frozen=True)
class BoundLimits:
    """What the computation of a person's problem for an upper bound may take.

    Attributes
    ----------
    until : float
        Time on the clock of `time.perf_counter()` after which no state is expanded and no sweep begins.
    memory_mb : float
        Memory during the computation, in MB.
    kept_mb : float
        Memory of the result, in MB.
    """

    until: float = math.inf
    memory_mb: float = math.inf
    kept_mb: float = math.inf

    @property
    def left(self) -> float:
        """The seconds that are left."""
        return self.until - time.perf_counter()

    def shared(self, number: int) -> BoundLimits:
        """Return the limits of the next one of so many computations that are still to be done."""
        return replace(self, until=time.perf_counter() + self.left / number)


NO_LIMITS = BoundLimits()

Outer = Literal["none", "frontier", "kept"]
"""What becomes of the relaxation on an outer truncated task (`truncated_bound`).

It is not computed, or bounds values at the frontier of the inner task, or is kept as well.
"""


def given_goals(pomdp: AssistPOMDP) -> list[tuple[float, AssistPOMDP]]:
    """Return each possible goal's prior probability, and the problem of a person of whom that goal is known.

    The robot actions are those of this problem, so that some suggestions may be useless to that person.
    """
    goals, found = pomdp.model.choices.goals, list[tuple[float, AssistPOMDP]]()
    for g, ((choices, q), share) in enumerate(zip(pomdp.model.of_each_goal, goals.prior.values(), strict=True)):
        if share == 0:
            continue
        own, of, followed, by = pomdp.hidden.goal_of == g, slice(g, g + 1), pomdp.followed_low, pomdp.followed_weight
        found.append((share, replace(
            pomdp, model=replace(pomdp.model, choices=choices, q=q),
            hidden=replace(pomdp.hidden, goals={KNOWN: 1.0}, assume_likeliest=False, sharpness=1.0),
            prior=pomdp.prior[own] / share, chosen=pomdp.chosen[:, :, own], unsuggested=pomdp.unsuggested[:, :, own],
            low=pomdp.low[:, :, of], weight=pomdp.weight[:, :, of],
            robot_actions=np.where(choices.goal, 1, pomdp.robot_actions),
            suggested=np.where(choices.goal[:, None], NOTHING, pomdp.suggested),
            followed_low=None if followed is None else followed[:, :, of],
            followed_weight=None if by is None else by[:, :, of],
            order=None if pomdp.order is None else pomdp.order[of],
        )))  # fmt: skip
    return found
