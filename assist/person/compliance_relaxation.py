"""The compliance relaxation: upper bounds on one person's value in many states of a large table.

In the relaxation, the robot decides whether a person complies with a suggestion or avoids the suggested choice. Without
a suggestion the person chooses as usual. The robot is always present, and theta has no effect. So a state has one value
for each beta, and a million states fit into memory.

Notation: u_b is the return of choice b, that is, minus its cost plus gamma times the value of its successor. p_b is the
probability of b without a suggestion (equation 5), l the lapse rate, and m the mean of u over all choices. Let S be the
set of choices that may be suggested, and o_a = sum_{b != a} p_b u_b / (1 - p_a). The Bellman operator of the relaxation
is

    (C U)(x, beta) = max( (1 - l) sum_b p_b u_b + l m,
                          max_{a in S} (1 - l) max(u_a, o_a) + l m - c ).

Assumptions.

1. People choose by equation 5, with a perceived cost-to-go for each state.
2. A suggestion acts by equation 6 with some theta in [0, 1]; theta may change in any way.
3. A suggestion costs at least c >= 0, as `Robot.costs` says. Costs of waiting, of travel and of attention are at least
   0. The robot executes no action of the task.

Claim. Let W(x, beta, theta) be the optimal value with observed beta and theta. If U >= W, then C U >= W. So all values
that result from sweeps of C over any states, starting from an upper bound, are upper bounds.

Proof. Let the robot suggest a, and consider choices without a lapse. By equation 6, a has the weight theta p_a, and
every other b has the weight (1 - theta) p_b. So the other choices keep their proportions among each other. The expected
return is therefore a mixture of u_a and o_a, hence at most max(u_a, o_a). If equation 6 leaves the probabilities
unchanged, it is the mixture with the weights p_a and 1 - p_a. Lapses contribute l m. The robot pays at least c.
Without a suggestion, the return is the first term, or less by a cost of waiting. The returns u are increasing in U, so
that C is monotone, and the maximum over all robot actions is at least the Bellman backup of W, which is W itself.

The sweeps start at `frontier_bounds.never_erring`, an upper bound for every person. States outside the swept ones keep
this value.
"""

from __future__ import annotations

import math
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner import Table
from planner.system.jit import njit
from planner.system.limits import processors

from ..people.decision import Floats
from ..people.human import Human
from ..people.misconception import Misconception
from .assumptions import Assumptions
from .frontier_bounds import never_erring
from .likely_states import perceived_of_states
from .problem_arrays import read_only
from .robots import SUGGESTION
from .rounding import rounding

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class ComplianceBounds:
    """Upper bounds on the value of a person with known beta.

    Attributes
    ----------
    states : int array, shape (m,)
        Numbers of the states in the table, in ascending order.
    value : float array, shape (m, B)
        Upper bound for each beta, in cost units.
    """

    states: Ints
    value: Floats

    def at(self, states: Ints) -> Floats:
        """Return the bounds, shape (N, B), of some of these states."""
        return np.asarray(self.value[np.searchsorted(self.states, states)])


def breadth_first(known: Table, states: Ints, most: int) -> Ints:
    """Return the given states and their successors, layer by layer, up to about `most` states in ascending order."""
    layer = found = np.unique(states)
    while len(layer) and len(found) < most:
        layer = np.setdiff1d(known.choices(layer).targets, found)[: most - len(found)]
        found = np.union1d(found, layer)
    return found


def compliance_bounds(
    known: Table,
    states: Ints,
    betas: Floats,
    assumed: Assumptions,
    *,
    optimal: bool = True,
    deadline: float = math.inf,
    tolerance: float = 0.02,
    max_sweeps: int = 15,
) -> ComplianceBounds:
    """Return upper bounds on a person's value in some states, by the compliance relaxation.

    The module's assumptions must hold.

    Parameters
    ----------
    known : Table
    states : int array, shape (m,)
        States that are swept, in ascending order. All others keep the value of people who never err.
    betas : float array, shape (B,)
    assumed : Assumptions
        Of the person.
    optimal : bool
        Whether only optimal actions are suggested, or all.
    deadline : float
        Time on the clock of `time.perf_counter()` after which no sweep begins.
    tolerance : float
        Sweeps end when no value changes by more than this, in cost units. The values are upper bounds after any sweep.
    max_sweeps : int
        Largest number of sweeps. The values of people who move in circles converge slowly.

    Raises
    ------
    ValueError
        The person has misconceptions about actions, not states.
    """
    human, gamma = assumed.human, assumed.gamma
    if human is not None and not mistaken_about_states(human):
        raise ValueError("expected a person who is mistaken about states, not about actions")
    rows = known.choices(states)
    index = np.minimum(np.searchsorted(states, rows.targets), len(states) - 1)
    inside = states[index] == rows.targets
    rest = np.unique(rows.targets[~inside])
    number = np.where(inside, index, len(states) + np.searchsorted(rest, rows.targets)).astype(np.int32)
    every = np.concatenate([states, rest])
    h = known.lookup(every)
    perceived = h if human is None else perceived_of_states(human, known, every, h)
    costs = known.task.action_costs
    start = never_erring(h, costs, gamma)
    order = np.argsort(h[: len(states)], kind="stable")
    order = order[np.isfinite(h[order]) & ~known.is_goal(states)[order]]
    whole = np.array(known.task.costs, dtype=np.float64), known.whole(every)
    arrays = (order, rows.offsets, rows.actions, number, costs, perceived, *whole)
    graph = _Graph(*(read_only(array) for array in arrays))
    rates = _Rates(gamma, assumed.robot.costs[SUGGESTION], assumed.lapse, optimal)

    def one(beta: float) -> Floats:
        value, stamp = start.copy(), np.zeros(len(start), dtype=np.uint16)
        for sweep in range(1, max_sweeps + 1):
            if time.perf_counter() > deadline:
                break
            if _sweep(value, stamp, sweep, graph, beta, rates) <= tolerance:
                break
        # values only fall, so that rounding is all that the theorem of `policy_iteration` adds
        margin = rounding(int(np.diff(rows.offsets).max(initial=0))) / (1 - gamma) * np.abs(value).max(initial=0.0)
        return np.minimum(value[: len(states)] + margin, 0.0)

    with ThreadPoolExecutor(processors()) as threads:
        return ComplianceBounds(states, np.stack(list(threads.map(one, betas.tolist())), axis=1))


def mistaken_about_states(human: Human) -> bool:
    """Return whether a person's misconception is a perceived cost-to-go of each state."""
    return isinstance(human.h, Misconception) and human.h.noise == "state"


class _Graph(NamedTuple):
    """The states that are swept, `order`, and the transitions from them, for compiled code.

    `costs` are those of actions, and `perceived` is the cost-to-go that people perceive. `whole` and `h` are the
    costs of actions and h* as whole numbers, whose sums are exact.
    """

    order: Ints
    offsets: Ints
    actions: NDArray[np.integer]
    targets: NDArray[np.int32]
    costs: Floats
    perceived: Floats
    whole: Floats
    h: Floats


class _Rates(NamedTuple):
    """The parameters of `compliance_bounds` that a sweep needs."""

    gamma: float
    suggestion: float
    lapse: float
    optimal: bool


@njit(nogil=True)
def _sweep(value: Floats, stamp: NDArray[np.uint16], sweep: int, graph: _Graph, beta: float, rates: _Rates) -> float:
    """Lower the values of states once, in place, and return the largest change.

    A state is skipped if no successor has changed by more than `slight` since its last backup; its bound remains valid.
    """
    order, offsets, actions, targets, costs, perceived, whole, h = graph
    gamma, suggestion, lapse, optimal = rates
    slight = 1e-3  # cost units; a smaller change causes no backup of predecessors, to save time
    most = 0
    for x in order:
        most = max(most, offsets[x + 1] - offsets[x])
    p, u = np.empty(most), np.empty(most)
    largest = 0.0
    for x in order:
        first, choices = offsets[x], offsets[x + 1] - offsets[x]
        latest, least = 0, np.inf
        for a in range(choices):
            y = targets[first + a]
            latest = max(latest, stamp[y])
            p[a] = costs[actions[first + a]] + perceived[y]
            least = min(least, p[a])
        if latest + 1 < sweep or choices == 0:
            continue
        total = 0.0
        for a in range(choices):
            # As in `decision.choice`, by the same operations (`rounding`); with beta 0, costs have no effect.
            p[a] = np.exp(-beta * (p[a] - least)) if beta > 0.0 and least < np.inf else 1.0
            total += p[a]
        alone, mean, highest = 0.0, 0.0, -np.inf
        for a in range(choices):
            p[a] /= total
            u[a] = gamma * value[targets[first + a]] - costs[actions[first + a]]
            alone += p[a] * u[a]
            mean += u[a] / choices
            highest = max(highest, u[a])
        best = (1.0 - lapse) * alone + lapse * mean
        for a in range(choices):
            if optimal and whole[actions[first + a]] + h[targets[first + a]] != h[x]:
                continue
            influenced = highest  # an upper bound on o_a, where the difference below would lose precision
            others = alone - p[a] * u[a]
            if p[a] < 0.9 and abs(others) > 0.1 * abs(alone):
                influenced = max(u[a], others / (1.0 - p[a]))
            best = max(best, (1.0 - lapse) * influenced + lapse * mean - suggestion)
        change = value[x] - best
        if change > 0.0:
            value[x] = best
            if change > slight:
                stamp[x] = sweep
            largest = max(largest, change)
    return largest
