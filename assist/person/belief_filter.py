"""The belief filter, compiled: posteriors after a person's choice, with the influence and the trust update.

Compiled code that filters beliefs uses these functions: simulations and live sessions (`update_compiled`), beliefs over
task states and sampled bounds (`posterior`), and solvers, which need the posteriors after all choices (`split`, then
`child` for each choice). `belief_update` has the same sums in numpy. `AssistPOMDP.update` is another formula of the
same posterior; a test compares them on random problems.

Beliefs are flat, shape (H * T,): the cell of type h and theta t is h * T + t. An unnormalised posterior sums to the
probability of the choice.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planner.system.jit import njit

from ..people.belief import ImpossibleObservationError
from ..people.decision import Floats
from ..people.hidden_type import Bools, Ints
from ..people.influence_kernels import factors_after
from ..people.type_kernels import exclude_reached, is_mistake
from .problem_arrays import Acts, ProblemArrays

COMPILED_FOR = "updates of beliefs: about five seconds"

# Reassociation lets the compiler vectorise the sums of solvers, whose rounding need not be reproducible.
FAST = {"reassoc", "contract"}


# A session has the same beliefs after a restart, bit for bit, so sums have one order here. With reassociation, it would
# depend on where the arrays are in memory: compiled code adds otherwise if they might overlap.
@njit(forceinline=True)
def posterior(belief: Floats, after: Floats, x: int, action: int, slot: int, m: ProblemArrays) -> float:
    """Fill in the unnormalised posterior after one choice; return its mass, the probability of the choice.

    Parameters
    ----------
    belief, after : float arrays, shape (H * T,)
        The belief, and the array for its posterior.
    x, action, slot : int
        The person's state, the robot action towards them (0: nothing), and the slot of their choice.
    m : ProblemArrays
        Their problem.
    """
    thetas, mass = len(m.theta), 0.0
    acting, suggested = m.afterstate[x, action], m.suggested[x, action]
    steady, uniform = 1.0 - m.lapse, m.lapse / m.counts[acting]
    if not m.moves[x, action]:
        for h in range(len(belief) // thetas):
            likelihood = steady * m.chosen[acting, slot, h] + uniform
            part = 0.0  # sums of different types are computed at the same time
            for t in range(thetas):
                joint = likelihood * belief[h * thetas + t]
                after[h * thetas + t] = joint
                part += joint
            mass += part
        return mass
    for cell in range(len(belief)):
        after[cell] = 0.0
    for h in range(len(belief) // thetas):
        p, others, g, first = m.chosen[x, suggested, h], m.unsuggested[x, action, h], m.goal_of[h], h * thetas
        plain = steady * m.chosen[acting, slot, h]
        for t in range(thetas):
            joint = belief[first + t]
            if joint == 0.0:
                continue
            follow_factor, decline_factor = factors_after(suggested, m.theta[t], p, others)
            if slot == suggested:
                joint *= plain * follow_factor + uniform
                at, up = first + m.followed_low[x, action, g, t], m.followed_weight[x, action, g, t]
            else:
                joint *= plain * decline_factor + uniform
                at, up = first + m.low[x, action, g, t], m.weight[x, action, g, t]
            mass += joint
            after[at] += joint * (1.0 - up)
            after[at + 1] += joint * up
    return mass


@njit(forceinline=True)
def update(belief: Floats, after: Floats, x: int, action: int, slot: int, m: ProblemArrays) -> None:
    """Replace a belief by its posterior after one choice; arguments as in `posterior`.

    `after` is a work array. A choice of probability 0 raises an `ImpossibleObservationError`.
    """
    mass = posterior(belief, after, x, action, slot, m)
    if not mass > 0.0:
        raise ImpossibleObservationError(
            "an action has probability 0 under the belief; a lapse rate above 0 in the model rules this out"
        )
    scale = 1.0 / mass
    for cell in range(len(belief)):
        belief[cell] = after[cell] * scale


@njit(nogil=True)
def update_compiled(
    rows: Ints, acts: Acts, belief: Floats, erred: Bools, optimal: Bools, possible: Floats, m: ProblemArrays
) -> None:
    """Update the beliefs in people by what they did, and tell whether it was a mistake.

    Parameters
    ----------
    rows : int array, shape (m,)
        The people, by their numbers from 0 to P - 1.
    acts : Acts
        What they did.
    belief : float array, shape (P, H, T), or without rows
    erred : bool array, shape (P,)
        Receives whether the choice was a mistake: for no goal that is possible, an optimal plan begins with it.
    optimal, possible
        As in `beliefs.PersonModel`.
    m : ProblemArrays
    """
    flat = belief.reshape(len(belief), belief.shape[1] * belief.shape[2])
    after = np.empty(flat.shape[1])
    for n, i in enumerate(rows):
        x, action, slot = acts.x[n], acts.heard[n], acts.slot[n]
        erred[i] = False
        if slot < 0:
            continue
        acting = m.afterstate[x, action]
        known = belief[i] if len(belief) > 0 else possible
        erred[i] = is_mistake(optimal[acting, slot], known, acting, m.goal, m.goal_of)
        if len(belief) > 0:
            update(flat[i], after, x, action, slot, m)
            if acts.goes_on[n]:
                exclude_reached(belief[i], m.targets[acting, slot], m.goal, m.goal_of)


class Parts(NamedTuple):
    """A belief that is split by the person's answer to a robot action (`split`); each has the shape (H * T,)."""

    followed: Floats
    declined: Floats
    complied: Floats
    lapsed: Floats


@njit()
def new_parts(size: int, uses_answer: bool) -> Parts:
    """Return empty parts. `complied` is the array `lapsed` itself unless the trust rule uses the answer."""
    lapsed = np.empty(size)
    return Parts(np.empty(size), np.empty(size), np.empty(size) if uses_answer else lapsed, lapsed)


@njit()
def split(parts: Parts, belief: Floats, x: int, action: int, m: ProblemArrays) -> tuple[int, int]:
    """Split a belief by the person's answer to a robot action, for the posteriors after all choices.

    Let p be the probability of slot a without a suggestion, which depends on the type. After this choice, the
    unnormalised posterior (`child`) is

        p * followed + complied if a is suggested, else p * declined + lapsed.

    The trust update is the same for all slots that were not suggested, and the influence is one of two factors
    (equation 6). So four weighted beliefs are enough, whatever the number of slots.

    The belief is 0 for types whose goal is reached in state x.

    Parameters
    ----------
    parts : Parts
        They are filled in.
    belief : float array, shape (H * T,)
    x, action : int
        The person's state and the robot action.
    m : ProblemArrays

    Returns
    -------
    tuple of int
        The state in which the person acts, and the suggested slot.
    """
    thetas = len(m.theta)
    followed, declined, complied, lapsed = parts
    acting, suggested = m.afterstate[x, action], m.suggested[x, action]
    steady, uniform = 1.0 - m.lapse, m.lapse / max(m.counts[acting], 1)
    if not m.moves[x, action]:
        for cell in range(len(belief)):
            followed[cell] = declined[cell] = steady * belief[cell]
            complied[cell] = lapsed[cell] = uniform * belief[cell]
        return acting, suggested
    for part in parts:
        for cell in range(len(part)):
            part[cell] = 0.0
    for cell in range(len(belief)):
        mass = belief[cell]
        if mass == 0.0:
            continue
        h, t = cell // thetas, cell % thetas
        g = m.goal_of[h]
        follow_factor, decline_factor = factors_after(
            suggested, m.theta[t], m.chosen[x, suggested, h], m.unsuggested[x, action, h]
        )
        at, up = cell - t + m.followed_low[x, action, g, t], m.followed_weight[x, action, g, t]
        followed[at] += steady * follow_factor * (1.0 - up) * mass
        followed[at + 1] += steady * follow_factor * up * mass
        if m.uses_answer:
            complied[at] += uniform * (1.0 - up) * mass
            complied[at + 1] += uniform * up * mass
            at, up = cell - t + m.low[x, action, g, t], m.weight[x, action, g, t]
        declined[at] += steady * decline_factor * (1.0 - up) * mass
        declined[at + 1] += steady * decline_factor * up * mass
        lapsed[at] += uniform * (1.0 - up) * mass
        lapsed[at + 1] += uniform * up * mass
    return acting, suggested


@njit(fastmath=FAST)
def child(after: Floats, acting: int, slot: int, suggested: int, parts: Parts, m: ProblemArrays) -> float:
    """Fill in the unnormalised posterior after a choice, shape (H * T,), from a belief's parts; return its mass.

    `acting` and `suggested` are what `split` returned.
    """
    thetas, mass = len(m.theta), 0.0
    influenced, uniform = (parts.followed, parts.complied) if slot == suggested else (parts.declined, parts.lapsed)
    for h in range(len(after) // thetas):
        p = m.chosen[acting, slot, h]
        for cell in range(h * thetas, (h + 1) * thetas):
            after[cell] = p * influenced[cell] + uniform[cell]
    for cell in range(len(after)):  # apart, as a sum beside the writing depends on where the arrays are in memory
        mass += after[cell]
    return mass
