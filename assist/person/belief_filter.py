"""The belief filter, compiled: posteriors after a person's choice, with the influence and the trust update.

Compiled code that filters beliefs uses these functions: simulations and live sessions (`update`), sampled bounds
(`posterior`), and solvers, which need the posteriors after all choices (`split`, then `child` for each choice). The
equations in numpy are those of `AssistPOMDP.update`; a test compares them on random problems.

Beliefs are flat, shape (H,) with H = B * T: the cell of beta b and theta t is b * T + t. An unnormalised posterior sums
to the probability of the choice.
"""

from __future__ import annotations

from planner.system.jit import njit

from ..people.belief import ImpossibleObservationError
from ..people.decision import Floats
from ..people.influence_kernels import influence_factors
from .problem_arrays import ProblemArrays

# Reassociation lets the compiler vectorise the sums of solvers, whose rounding need not be reproducible.
FAST = {"reassoc", "contract"}


# A session has the same beliefs after a restart, bit for bit, so sums have one order here. With reassociation, it would
# depend on where the arrays are in memory: compiled code adds otherwise if they might overlap.
@njit()
def posterior(belief: Floats, after: Floats, x: int, robot: int, slot: int, m: ProblemArrays) -> float:
    """Fill in the unnormalised posterior after one choice; return its mass, the probability of the choice.

    Parameters
    ----------
    belief, after : float arrays, shape (H,)
        The belief, and the array for its posterior.
    x, robot, slot : int
        The person's state, the robot action towards them (0: nothing), and the slot of their choice.
    m : ProblemArrays
        Their problem.
    """
    thetas, mass = len(m.theta), 0.0
    acting, suggested = m.afterstate[x, robot], m.suggested[x, robot]
    steady, uniform = 1.0 - m.lapse, m.lapse / m.counts[acting]
    if suggested < 0:
        for b in range(len(belief) // thetas):
            likelihood = steady * m.chosen[acting, slot, b] + uniform
            part = 0.0  # sums of different b are computed at the same time
            for h in range(b * thetas, (b + 1) * thetas):
                after[h] = likelihood * belief[h]
                part += after[h]
            mass += part
        return mass
    for h in range(len(belief)):
        after[h] = 0.0
    for b in range(len(belief) // thetas):
        p, others = m.chosen[x, suggested, b], m.unsuggested[x, robot, b]
        plain = steady * m.chosen[x, slot, b]
        for t in range(thetas):
            joint = belief[b * thetas + t]
            if joint == 0.0:
                continue
            follow_factor, decline_factor = influence_factors(m.theta[t], p, others)
            if slot == suggested:
                joint *= plain * follow_factor + uniform
                at, up = b * thetas + m.followed_low[x, robot, t], m.followed_weight[x, robot, t]
            else:
                joint *= plain * decline_factor + uniform
                at, up = b * thetas + m.low[x, robot, t], m.weight[x, robot, t]
            mass += joint
            after[at] += joint * (1.0 - up)
            after[at + 1] += joint * up
    return mass


@njit()
def update(belief: Floats, after: Floats, x: int, robot: int, slot: int, m: ProblemArrays) -> None:
    """Replace a belief, shape (G * B, T), by its posterior after one choice; other arguments as in `posterior`.

    `after` is a work array of the same shape. The row `x` may be that of any goal (`people.goals`). A choice of
    probability 0 raises an `ImpossibleObservationError`.
    """
    old, new = belief.reshape(belief.size), after.reshape(after.size)
    size = m.chosen.shape[2] * len(m.theta)
    goals = len(old) // size
    states, mass = len(m.counts) // goals, 0.0
    for goal in range(goals):
        part = slice(goal * size, (goal + 1) * size)
        mass += posterior(old[part], new[part], goal * states + x % states, robot, slot, m)
    if not mass > 0.0:
        raise ImpossibleObservationError(
            "an action has probability 0 under the belief; a lapse rate above 0 in the model rules this out"
        )
    scale = 1.0 / mass
    for h in range(len(old)):
        old[h] = new[h] * scale


@njit()
def split(
    belief: Floats, followed: Floats, declined: Floats, complied: Floats, lapsed: Floats, x: int, robot: int,
    m: ProblemArrays,
) -> tuple[int, int]:  # fmt: skip
    """Split a belief by the person's answer to a robot action, for the posteriors after all choices.

    After a choice of slot a, whose probability without a suggestion is p(beta), the unnormalised posterior (`child`) is

        p(beta) * followed + complied if a is suggested, else p(beta) * declined + lapsed.

    The trust update is the same for all slots that were not suggested, and the influence is one of two factors
    (equation 6). So four weighted beliefs are enough, whatever the number of slots.

    With G goals, H = G * B * T. The belief is 0 in the cells of goals that are reached in state x.

    Parameters
    ----------
    belief : float array, shape (H,)
    followed, declined, complied, lapsed : float arrays, shape (H,)
        Arrays for the parts. `complied` may be the array `lapsed` itself unless the trust rule uses the answer.
    x, robot : int
        The person's state, a row of the first goal, and the robot action.
    m : ProblemArrays

    Returns
    -------
    tuple of int
        The state in which the person acts, and the suggested slot.
    """
    thetas, betas = len(m.theta), m.chosen.shape[2]
    states = len(m.counts) * betas * thetas // len(belief)
    acting, suggested = m.afterstate[x, robot], m.suggested[x, robot]
    steady, uniform = 1.0 - m.lapse, m.lapse / max(m.counts[acting], 1)
    if suggested < 0:
        for h in range(len(belief)):
            followed[h] = declined[h] = steady * belief[h]
            complied[h] = lapsed[h] = uniform * belief[h]
        return acting, suggested
    for part in (followed, declined, complied, lapsed):
        for h in range(len(part)):
            part[h] = 0.0
    for h in range(len(belief)):
        mass = belief[h]
        if mass == 0.0:
            continue
        hidden, t = h // thetas, h % thetas
        row, b = x + hidden // betas * states, hidden % betas
        follow_factor, decline_factor = influence_factors(
            m.theta[t], m.chosen[row, suggested, b], m.unsuggested[row, robot, b]
        )
        at, up = h - t + m.followed_low[row, robot, t], m.followed_weight[row, robot, t]
        followed[at] += steady * follow_factor * (1.0 - up) * mass
        followed[at + 1] += steady * follow_factor * up * mass
        if m.uses_answer:
            complied[at] += uniform * (1.0 - up) * mass
            complied[at + 1] += uniform * up * mass
            at, up = h - t + m.low[row, robot, t], m.weight[row, robot, t]
        declined[at] += steady * decline_factor * (1.0 - up) * mass
        declined[at + 1] += steady * decline_factor * up * mass
        lapsed[at] += uniform * (1.0 - up) * mass
        lapsed[at + 1] += uniform * up * mass
    return acting, suggested


@njit(fastmath=FAST)
def child(
    after: Floats, acting: int, slot: int, suggested: int, followed: Floats, declined: Floats, complied: Floats,
    lapsed: Floats, m: ProblemArrays,
) -> float:  # fmt: skip
    """Fill in the unnormalised posterior after a choice, shape (H,), from a belief's parts; return its mass.

    `acting` and `suggested` are what `split` returned.
    """
    thetas, betas, mass = len(m.theta), m.chosen.shape[2], 0.0
    states = len(m.counts) * betas * thetas // len(after)
    influenced, uniform = (followed, complied) if slot == suggested else (declined, lapsed)
    for hidden in range(len(after) // thetas):
        p = m.chosen[acting + hidden // betas * states, slot, hidden % betas]
        for h in range(hidden * thetas, (hidden + 1) * thetas):
            after[h] = p * influenced[h] + uniform[h]
            mass += after[h]
    return mass
