"""The likelihood of a person's actions under the model of `people.decision`: the one definition of all estimates.

The person's perceived cost-to-go is assumed to be h*. `alone` has what depends on beta, `with_trust` what depends on
theta as well. The path of theta over the suggestions is computed before: by equation (7), where each episode begins
with the same theta (`by_equation_seven`), or by any trust rule (`trust_log`).

If a person pursues one of several goals in each episode, the likelihood of an episode is the sum over the goals of the
prior probability, times the likelihood with that goal. After a goal is reached, an action can only be a lapse, and a
suggestion does not move theta.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.system.arrays import frozen
from planner.system.jit import njit

from ..people.decision import NOTHING, Floats
from ..people.influence_kernels import update_trust
from .method import Method as Method
from .observations import Ints, Observations, UnknownGoals

SMALL = 1e-3
"""Share of the range of beta below which the scale of beta is linear; it is logarithmic above."""

SURE = 1e-300
"""Least weight of a choice in equation (6)."""


class Data(NamedTuple):
    """Observations in the form that compiled code reads; numba accepts named tuples and no dataclasses.

    `heard` are the steps with a suggestion. `anew` marks those at which a new episode has begun since the last one.

    If one of several goals is pursued, the steps are those of all pairs of an episode and a goal that is not reached
    yet, as if they were different episodes. `pair` is the number of each step's pair, episode by episode. `first` is
    the logarithm of the goal's probability and of all lapses after the goal, shape (episodes, goals); it is empty if
    the goal is known. `together` factors of a product do not underflow.
    """

    excess: Floats
    options: Ints
    chosen: Ints
    suggested: Ints
    gain: Floats
    begins: NDArray[np.bool_]
    lapse: float
    grid: Floats
    chances: Floats
    heard: Ints
    anew: NDArray[np.bool_]
    pair: Ints
    first: Floats
    together: int

    @classmethod
    def of(cls, o: Observations, method: Method) -> Data:
        """Return one person's observations in this form."""
        data = cls._with_one_goal(o, method) if o.goals is None else cls._with_goals(o, o.goals, method)
        least = method.lapse / max(data.options.max(initial=1), 1)
        data = data._replace(together=max(1, int(200.0 / -math.log10(least))))  # since logarithms are slow
        return cls._make(frozen(part) if isinstance(part, np.ndarray) else part for part in data)

    @classmethod
    def _with_one_goal(cls, o: Observations, method: Method) -> Data:
        gain = o.gain / method.utility_scale
        grid, chances = (np.zeros(0), np.zeros((0, 0, 0))) if o.own is None else (o.own.beta, o.own.chance)
        heard, anew = heard_steps(o.suggested, o.begins)
        return cls(
            excess=o.excess, options=o.applicable.sum(axis=1), chosen=o.chosen, suggested=o.suggested, gain=gain,
            begins=o.begins, lapse=method.lapse, grid=grid, chances=chances, heard=heard, anew=anew,
            pair=np.zeros(0, dtype=np.int64), first=np.zeros((0, 0)), together=1,
        )  # fmt: skip

    @classmethod
    def _with_goals(cls, o: Observations, goals: UnknownGoals, method: Method) -> Data:
        goal, step = np.nonzero(~goals.reached)
        options, episode = o.applicable.sum(axis=1), o.begins.cumsum() - 1
        with np.errstate(divide="ignore"):
            first = np.tile(np.log(goals.prior), (len(o.episodes), 1))
        lapsed = np.nonzero(goals.reached)
        np.add.at(first, (episode[lapsed[1]], lapsed[0]), np.log(method.lapse / options[lapsed[1]]))
        excess, gain = (np.stack([getattr(each, name) for each in goals.each]) for name in ("excess", "gain"))
        pair = episode[step] * len(goals.prior) + goal
        begins = np.diff(pair, prepend=-1) != 0
        heard, anew = heard_steps(o.suggested[step], begins)
        return cls(
            excess=excess[goal, step], options=options[step], chosen=o.chosen[step], suggested=o.suggested[step],
            gain=gain[goal, step] / method.utility_scale, begins=begins, lapse=method.lapse, grid=np.zeros(0),
            chances=np.zeros((0, 0, 0)), heard=heard, anew=anew, pair=pair, first=first, together=1,
        )  # fmt: skip


def heard_steps(suggested: Ints, begins: NDArray[np.bool_]) -> tuple[Ints, NDArray[np.bool_]]:
    """Return the steps with a suggestion, and whether a new episode has begun since the suggestion before each."""
    heard = np.flatnonzero(suggested != NOTHING)
    number = begins.cumsum()[heard]
    return heard, np.diff(number, prepend=-1) != 0


@njit(nogil=True)
def alone(data: Data, beta: float, own: Floats, told: Floats, rest: Floats, silent: Floats) -> float:
    """Return the log-likelihood of the steps without a suggestion, and fill in probabilities at the others, (heard,).

    If the goal is unknown, the log-likelihood of each episode and goal is filled into `silent`, (episodes, goals).

    `own`, `told` and `rest` are the probabilities, without the suggestion, of the chosen action, of the suggested one,
    and of all actions but the suggested one. The last is a sum, because 1 - told would lose precision near 1. The
    probabilities of a user's choice model are interpolated between two values of beta.
    """
    own_model = len(data.grid) > 0
    low, share = 0, 0.0
    if own_model:
        place = int(np.searchsorted(data.grid, beta))
        low = min(max(place - 1, 0), len(data.grid) - 2)
        share = min(max((beta - data.grid[low]) / (data.grid[low + 1] - data.grid[low]), 0.0), 1.0)
    total = 0.0
    product = 1.0  # of several probabilities, since logarithms are slow
    k = 0
    goals = data.first.shape[1]  # 0 if the goal is known
    if goals:
        silent[:] = data.first
    for i in range(len(data.chosen)):
        if goals and data.begins[i] and i:
            silent[data.pair[i - 1] // goals, data.pair[i - 1] % goals] += total + math.log(product)
            total, product = 0.0, 1.0
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
            own[k] = picked / (heard + others)
            told[k] = heard / (heard + others)
            rest[k] = others / (heard + others)
            k += 1
            continue
        product *= (1.0 - data.lapse) * picked / others + data.lapse / data.options[i]
        if product < 1e-100:
            total += math.log(product)
            product = 1.0
    total += math.log(product)
    if goals and len(data.pair):
        silent[data.pair[-1] // goals, data.pair[-1] % goals] += total
        return 0.0
    return total


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
def _add_logs(total: Floats, product: Floats) -> None:
    """Add the logarithms of products to a total, and set the products to 1."""
    for p in range(len(product)):
        total[p] += math.log(product[p])
        product[p] = 1.0


@njit(nogil=True)
def joint(data: Data, own: Floats, told: Floats, rest: Floats, silent: Floats, path: Floats) -> Floats:
    """Return the log-likelihood of the steps with a suggestion, given the probabilities from `alone`, shape (1, P).

    `path` is theta at each suggestion, shape (heard, P), for P values of what theta depends on. If the goal is unknown,
    `silent` is added, and there is a row for each pair of an episode and a goal: the logarithm of the joint probability
    of the goal and of the episode's actions, shape (pairs, P).

    Equation (6) as in `influence_kernels.influence_factors`, without branches in the loop over theta, so that it is
    compiled into vector instructions. `SURE` in place of 0 makes a suggestion have no effect that would leave no choice
    possible.
    """
    count, goals = path.shape[1], data.first.shape[1]
    found, row = np.zeros((max(1, data.first.size), count)), 0
    if goals:
        for pair in range(data.first.size):
            found[pair] = silent[pair // goals, pair % goals]
    product, since = np.ones(count), 0
    for k in range(len(data.heard)):
        i = data.heard[k]
        if since == data.together or (goals and data.anew[k] and since):
            _add_logs(found[row], product)
            since = 0
        if goals:
            row = data.pair[i]
        yes, share = data.chosen[i] == data.suggested[i], data.lapse / data.options[i]
        picked, heed, others = (1.0 - data.lapse) * own[k], told[k], rest[k]
        for p in range(count):
            sure, other = max(path[k, p], SURE), max(1.0 - path[k, p], SURE)
            product[p] *= picked * (sure if yes else other) / (sure * heed + other * others) + share
        since += 1
    _add_logs(found[row], product)
    return found


@njit(nogil=True)
def with_trust(data: Data, own: Floats, told: Floats, rest: Floats, silent: Floats, path: Floats) -> Floats:
    """Return the log-likelihood of the steps with a suggestion, or of all steps if the goal is unknown, shape (P,)."""
    found, goals = joint(data, own, told, rest, silent, path), data.first.shape[1]
    if not goals:
        return found[0]
    total = np.zeros(path.shape[1])
    for p in range(len(total)):
        for first in range(0, len(found), goals):
            episode = found[first : first + goals, p]
            most = episode.max()
            total[p] += most + math.log(np.exp(episode - most).sum())
    return total


@njit(nogil=True)
def on_path(data: Data, beta: Floats, path: Floats) -> Floats:
    """Return the log-likelihood of all steps for each beta, shape (B,), and each path of theta, shape (B, P)."""
    result, n = np.empty((len(beta), path.shape[1])), len(data.heard)
    own, told, rest = np.empty(n), np.empty(n), np.empty(n)
    parts = np.empty_like(data.first)
    for b in range(len(beta)):
        silent = alone(data, beta[b], own, told, rest, parts)
        result[b] = silent + with_trust(data, own, told, rest, parts, path)
    return result


def log_likelihood(
    observations: Observations, beta: Floats, theta: Floats, eta: Floats, method: Method | None = None
) -> Floats:
    """Return the log-likelihood of one person's actions on a grid, shape (B, T, E), under equation (7).

    Parameters
    ----------
    observations : Observations
    beta, theta, eta : float arrays, shapes (B,), (T,), (E,)
        Values of the parameters; theta is the one at the beginning of each episode.
    method : Method, optional
        Options of the estimation.
    """
    betas, thetas, etas = (np.array(axis, dtype=np.float64, ndmin=1) for axis in (beta, theta, eta))
    data = Data.of(observations, method or Method())
    path = by_equation_seven(data, np.repeat(thetas, len(etas)), np.tile(etas, len(thetas)))
    return np.asarray(on_path(data, betas, path).reshape(len(betas), len(thetas), len(etas)))


def goal_posteriors(observations: Observations, beta: float, theta: float, eta: float, method: Method) -> Floats:
    """Return the probability of each goal in each episode, shape (episodes, goals), given all its actions."""
    data = Data.of(observations, method)
    own, told, rest = np.empty((3, len(data.heard)))
    silent = np.empty_like(data.first)
    alone(data, beta, own, told, rest, silent)
    path = by_equation_seven(data, np.array([theta]), np.array([eta]))
    every = joint(data, own, told, rest, silent, path).reshape(silent.shape)
    every = np.exp(every - every.max(axis=1, keepdims=True))
    return every / every.sum(axis=1, keepdims=True)


@njit(nogil=True)
def thetas(gain: Floats, begins: NDArray[np.bool_], first: float, eta: float) -> Floats:
    """Return theta before each step, shape (N,)."""
    result = np.empty(len(gain))
    theta = first
    for i in range(len(gain)):
        if begins[i]:
            theta = first
        result[i] = theta
        theta = update_trust(theta, eta, gain[i])
    return result
