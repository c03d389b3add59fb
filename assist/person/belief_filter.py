"""The Bayes update of a belief in expertise and influence, compiled."""

from __future__ import annotations

from planner.system.jit import njit

from ..people.decision import Floats
from .problem_arrays import ProblemArrays


# Sums may be reordered, so that they are computed several terms at a time.
@njit(fastmath={"reassoc", "contract", "arcp"})
def update(belief: Floats, after: Floats, x: int, robot: int, slot: int, m: ProblemArrays) -> None:
    """Update one belief, shape (B, T), in place: Bayes' rule for what a person did, then the move of theta.

    Parameters
    ----------
    belief : float array, shape (B, T)
    after : float array, shape (B, T)
        Room to work in.
    x, robot, slot : int
        The person's state, what the robot did to them (0: nothing), and the slot of what they did then.
    m : ProblemArrays
        Their problem.
    """
    betas, thetas = belief.shape
    place, suggestion = m.afterstate[x, robot], m.suggested[x, robot]
    uniform = m.lapse / m.counts[place]
    evidence = 0.0
    if suggestion < 0:
        for b in range(betas):
            likelihood = (1.0 - m.lapse) * m.chosen[place, slot, b] + uniform
            for t in range(thetas):
                belief[b, t] *= likelihood
                evidence += belief[b, t]
        for b in range(betas):
            for t in range(thetas):
                belief[b, t] *= 1.0 / evidence
        return
    for b in range(betas):
        for t in range(thetas):
            after[b, t] = 0.0
    for b in range(betas):
        p, followed, rest = m.chosen[x, slot, b], m.chosen[x, suggestion, b], m.unsuggested[x, robot, b]
        for t in range(thetas):
            theta = m.theta[t]
            total = theta * followed + (1.0 - theta) * rest
            heard = (theta if slot == suggestion else 1.0 - theta) / total if total > 0.0 else 1.0
            joint = belief[b, t] * ((1.0 - m.lapse) * p * heard + uniform)
            evidence += joint
            at, up = m.low[x, robot, t], m.weight[x, robot, t]
            after[b, at] += joint * (1.0 - up)
            after[b, at + 1] += joint * up
    for b in range(betas):
        for t in range(thetas):
            belief[b, t] = after[b, t] * (1.0 / evidence)
