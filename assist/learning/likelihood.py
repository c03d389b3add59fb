"""The likelihood of people's choices under the model of `people.decision`, from which people and rules are estimated.

It depends on the episode, the type and theta_0. A type is what is hidden about a person: beta and, if one of several
goals is pursued in each episode, the goal. theta_0 is the influence with which a person, or an episode, begins. The
perceived cost-to-go is h*. A choice model says how likely a choice is without a suggestion (`alone`), a
trust rule what theta is at each suggestion, and equation (6) joins the two. Goals are summed within an episode, with
their prior probabilities, and the logarithms of episodes are added (`with_trust`). After a goal is reached, an action
can only be a lapse, and a suggestion does not move theta.

`LikelihoodTable` has it by person, beta and theta_0. What is estimated is a function of it:

- one person, whose episodes each begin with theta_0 and whose theta moves by equation (7): the maximum over beta,
  theta_0 and the rule's eta, and likelihood-ratio intervals (`maximum_likelihood`);
- a population, and the parameters of a trust rule: the maximum of the marginal likelihood, that is, of the table's
  mean over nodes of beta and theta_0 (`likelihood_table`, `population`, `influence_population`, `trust_fit`);
- goals: the table of an episode, normalised over goals (`goal_posteriors`);
- comparisons: the same with people whom the fit has not seen (`held_out`).

The search for one person asks the same kernels for single points, since the maximum lies on narrow ridges between
nodes. `likelihood_arrays` has the readable form in numpy, for work that takes less time than compiling. Terms
(`logit_likelihood`), misconceptions (`misconception_fit`) and judgements with advice (`advice_model`) are other models,
with likelihoods of their own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.system.arrays import frozen
from planner.system.jit import njit

from ..people.decision import NOTHING, Floats
from ..people.influence_kernels import update_trust
from .method import Method as Method
from .observations import Ints, Observations

COMPILED_FOR = "estimates of people: some seconds"

SMALL = 1e-3
"""Share of the range of beta below which the scale of beta is linear; it is logarithmic above."""

SURE = 1e-300
"""Least weight of a choice in equation (6)."""


class Data(NamedTuple):
    """Observations in the form that compiled code reads; numba accepts named tuples and no dataclasses.

    The steps are those of all pairs of an episode and a goal that is not reached yet. A known goal is the only one.

    `heard` are the steps with a suggestion. `anew` marks those at which a new pair has begun since the last one. `row`
    is the number of each step's pair, episode by episode; if the goal is known, it is 0, since all episodes are added.
    `first` is the logarithm of the goal's probability and of all lapses after the goal, by row. `together` factors of a
    product do not underflow.
    """

    excess: Floats
    options: Ints
    chosen: Ints
    suggested: Ints
    gain: Floats
    lapse: float
    grid: Floats
    chances: Floats
    heard: Ints
    anew: NDArray[np.bool_]
    row: Ints
    first: Floats
    goals: int
    together: int

    @classmethod
    def of(cls, o: Observations, method: Method) -> Data:
        """Return one person's observations in this form."""
        goals, options = o.goals, o.applicable.sum(axis=1)
        goal, step = np.nonzero(~goals.reached)
        pair = (o.begins.cumsum() - 1)[step] * len(goals.prior) + goal
        with np.errstate(divide="ignore"):
            first = np.tile(np.log(goals.prior), len(o.episodes))
        lapsed = np.nonzero(goals.reached)
        after = (o.begins.cumsum() - 1)[lapsed[1]] * len(goals.prior) + lapsed[0]
        np.add.at(first, after, np.log(method.lapse / options[lapsed[1]]))
        # With one goal, all episodes are added at once.
        row, first = (pair, first) if goals.distinguished else (np.zeros_like(pair), first.sum(keepdims=True))
        grid, chances = (np.zeros(0), np.zeros((0, 0, 0))) if o.own is None else (o.own.beta, o.own.chance)
        heard, anew = heard_steps(o.suggested[step], np.diff(pair, prepend=-1) != 0)
        least = method.lapse / max(options.max(initial=1), 1)
        together = max(1, int(200.0 / -math.log10(least)))  # since logarithms are slow
        parts = (
            o.by_goal("excess")[goal, step], options[step], o.chosen[step], o.suggested[step],
            o.by_goal("gain")[goal, step] / method.utility_scale, method.lapse, grid, chances, heard, anew, row, first,
            len(goals.prior), together,
        )  # fmt: skip
        return cls._make(frozen(part) if isinstance(part, np.ndarray) else part for part in parts)


def heard_steps(suggested: Ints, begins: NDArray[np.bool_]) -> tuple[Ints, NDArray[np.bool_]]:
    """Return the steps with a suggestion, and whether a new episode has begun since the suggestion before each."""
    heard = np.flatnonzero(suggested != NOTHING)
    number = begins.cumsum()[heard]
    return heard, np.diff(number, prepend=-1) != 0


@njit(nogil=True)
def alone(data: Data, beta: float, chances: Floats, silent: Floats) -> None:
    """Fill in the log-likelihood of steps without a suggestion, (rows,), and probabilities at the others, (3, heard).

    These are, without the suggestion, the probabilities of the chosen action, of the suggested one, and of all actions
    but the suggested one. The last is a sum, because its complement would lose precision near 1. The probabilities of a
    user's choice model are interpolated between two values of beta.
    """
    own_model = len(data.grid) > 0
    low, share = 0, 0.0
    if own_model:
        while low < len(data.grid) - 2 and data.grid[low + 1] < beta:
            low += 1
        share = min(max((beta - data.grid[low]) / (data.grid[low + 1] - data.grid[low]), 0.0), 1.0)
    for row in range(len(silent)):  # in the place of an array form, for which numba compiles much more
        silent[row] = data.first[row]
    product = 1.0  # of several probabilities, since logarithms are slow
    k = 0
    for i in range(len(data.chosen)):
        if i and data.row[i] != data.row[i - 1]:
            silent[data.row[i - 1]] += math.log(product)
            product = 1.0
        picked = heard = others = 0.0
        for a in range(data.options[i]):
            if own_model:
                weight = (1.0 - share) * data.chances[i, a, low] + share * data.chances[i, a, low + 1]
            else:
                weight = 1.0 if beta == 0.0 else math.exp(-beta * data.excess[i, a])
            if a == data.chosen[i]:
                picked = weight
            if a == data.suggested[i]:
                heard = weight
            else:
                others += weight
        if data.suggested[i] >= 0:
            total = heard + others
            chances[0, k], chances[1, k], chances[2, k] = picked / total, heard / total, others / total
            k += 1
            continue
        product *= (1.0 - data.lapse) * picked / others + data.lapse / data.options[i]
        if product < 1e-100:
            silent[data.row[i]] += math.log(product)
            product = 1.0
    if len(data.row):
        silent[data.row[-1]] += math.log(product)


@njit(nogil=True)
def by_equation_seven(data: Data, theta: Floats, eta: Floats) -> Floats:
    """Return theta at each suggestion, shape (heard, P), for P initial values and learning rates, each shape (P,)."""
    path = np.empty((len(data.heard), len(theta)))
    for k in range(len(data.heard)):
        gain = data.gain[data.heard[k - 1]]
        for p in range(len(theta)):
            path[k, p] = theta[p] if data.anew[k] else update_trust(path[k - 1, p], eta[p], gain)
    return path


@njit(nogil=True)
def with_trust(data: Data, chances: Floats, silent: Floats, path: Floats) -> Floats:
    """Return the log-likelihood of all steps for each beta and path, shape (B, P), given what `alone` fills in.

    `chances`, shape (B, 3, heard), and `silent`, shape (B, rows), are of B values of beta. `path` is theta at each
    suggestion, shape (heard, P), for P values of what theta depends on. Goals are summed within an episode, then
    episodes are added.

    Equation (6) as in `influence_kernels.influence_factors`, without branches in the loop over theta, so that it is
    compiled into vector instructions. `SURE` in place of 0 makes a suggestion have no effect that would leave no choice
    possible.
    """
    rows, count = silent.shape[1], path.shape[1]
    total, found, product = np.empty((len(silent), count)), np.empty((rows, count)), np.empty(count)
    for b in range(len(silent)):
        for p in range(count):
            product[p], total[b, p] = 1.0, 0.0
            for r in range(rows):
                found[r, p] = silent[b, r]
        row, since = 0, 0
        for k in range(len(data.heard) + 1):
            i = data.heard[k] if k < len(data.heard) else -1
            if i < 0 or since == data.together or (data.row[i] != row and since):
                for p in range(count):
                    found[row, p] += math.log(product[p])
                    product[p] = 1.0
                since = 0
            if i < 0:
                break
            row = data.row[i]
            yes, share = data.chosen[i] == data.suggested[i], data.lapse / data.options[i]
            picked, heed, others = (1.0 - data.lapse) * chances[b, 0, k], chances[b, 1, k], chances[b, 2, k]
            for p in range(count):
                sure, other = max(path[k, p], SURE), max(1.0 - path[k, p], SURE)
                product[p] *= picked * (sure if yes else other) / (sure * heed + other * others) + share
            since += 1
        for first in range(0, rows, data.goals):
            for p in range(count):
                most, chance = found[first, p], 0.0
                for r in range(first + 1, first + data.goals):
                    most = max(most, found[r, p])
                for r in range(first, first + data.goals):
                    chance += math.exp(found[r, p] - most)
                total[b, p] += most + math.log(chance)
    return total


def without_trust(data: Data, beta: Floats) -> tuple[Floats, Floats]:
    """Return what `alone` fills in for each beta, shapes (B, 3, heard) and (B, rows)."""
    chances, silent = np.empty((len(beta), 3, len(data.heard))), np.empty((len(beta), len(data.first)))
    for b, value in enumerate(beta.tolist()):
        alone(data, value, chances[b], silent[b])
    return chances, silent


def largest_beta(observations: Sequence[Observations], method: Method) -> float:
    """Return the end of the range of beta: `Method.largest_beta`, or its default for these observations."""
    if method.largest_beta is not None:
        return method.largest_beta
    every = [o.by_goal("excess") for o in observations]
    sizes = [excess[(excess > 0) & np.isfinite(excess)] for excess in every]
    return 10.0 / min((float(size.min()) for size in sizes if len(size)), default=1.0)
