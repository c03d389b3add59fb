"""The likelihood of one person's choices on a grid, in numpy: the readable form of `likelihood`.

It gives first estimates where compiling would take longer than the work itself (`first_estimates`).
"""

from __future__ import annotations

import numpy as np

from ..people.decision import NOTHING, Floats
from .likelihood import SURE, Data
from .observations import Ints


def log_likelihoods(data: Data, beta: Floats, theta: Floats, eta: Floats) -> Floats:
    """Return the log-likelihood for each beta and each pair of theta at first and eta, shape (B, P)."""
    goals = _by_goal(data, beta, theta, eta)
    return np.asarray(np.logaddexp.reduce(goals, axis=2).sum(axis=1))


def goal_posteriors(data: Data, beta: float, theta: float, eta: float) -> Floats:
    """Return the probability of each goal in each episode, shape (episodes, goals), given all its actions."""
    every = _by_goal(data, *(np.array([value]) for value in (beta, theta, eta)))[0, :, :, 0]
    every = np.exp(every - every.max(axis=1, keepdims=True))
    return np.asarray(every / every.sum(axis=1, keepdims=True))


def _by_goal(data: Data, beta: Floats, theta: Floats, eta: Floats) -> Floats:
    """Return the log-likelihood with each goal, shape (B, episodes, goals, P); if it is known, that of all episodes."""
    own, told, rest, silent = alone(data, beta)
    path, heard = by_equation_seven(data, theta, eta), data.heard
    yes = (data.chosen[heard] == data.suggested[heard])[:, None]
    weighs = np.where(yes, np.maximum(path, SURE), np.maximum(1.0 - path, SURE))  # equation 6
    total = told[..., None] * np.maximum(path, SURE) + rest[..., None] * np.maximum(1.0 - path, SURE)
    chance = (1.0 - data.lapse) * own[..., None] * weighs / total + (data.lapse / data.options[heard])[:, None]
    found = silent[..., None] + _by_row(np.log(chance), data.row[heard], len(data.first))
    return found.reshape(len(beta), -1, data.goals, len(theta))


def alone(data: Data, beta: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return what `likelihood.alone` fills in for each beta: three arrays of shape (B, heard), and one of (B, rows)."""
    steps, slots = np.arange(len(data.chosen)), np.arange(data.excess.shape[1])
    weight = np.where(slots < data.options[:, None], _weights(data, beta), 0.0)
    advised = slots == data.suggested[:, None]
    picked, heard = weight[:, steps, data.chosen], (weight * advised).sum(axis=2)
    others = (weight * ~advised).sum(axis=2)
    quiet, told = np.flatnonzero(data.suggested == NOTHING), data.heard
    chance = (1.0 - data.lapse) * picked[:, quiet] / others[:, quiet] + data.lapse / data.options[quiet]
    silent = data.first + _by_row(np.log(chance), data.row[quiet], len(data.first))
    total = heard[:, told] + others[:, told]
    return picked[:, told] / total, heard[:, told] / total, others[:, told] / total, silent


def _weights(data: Data, beta: Floats) -> Floats:
    """Return the weight of each choice without a suggestion, shape (B, steps, choices)."""
    if len(data.grid):  # a user's choice model, between two values of its grid
        low = np.clip(np.searchsorted(data.grid, beta) - 1, 0, len(data.grid) - 2)
        share = np.clip((beta - data.grid[low]) / (data.grid[low + 1] - data.grid[low]), 0.0, 1.0)
        return np.moveaxis((1.0 - share) * data.chances[..., low] + share * data.chances[..., low + 1], -1, 0)
    each = beta[:, None, None]
    with np.errstate(invalid="ignore"):  # 0 times infinity
        return np.where(each == 0.0, 1.0, np.exp(-each * data.excess))


def by_equation_seven(data: Data, theta: Floats, eta: Floats) -> Floats:
    """Return theta at each suggestion, shape (heard, P), for initial values and rates of shape (P,)."""
    path, now = np.empty((len(data.heard), len(theta))), theta
    gain = data.gain[data.heard]
    for k in range(len(path)):
        if data.anew[k]:
            now = theta
        elif gain[k - 1] != 0.0:
            with np.errstate(invalid="ignore"):
                now = np.where(eta == 0.0, now, np.clip(now + eta * gain[k - 1], 0.0, 1.0))
        path[k] = now
    return path


def _by_row(values: Floats, row: Ints, rows: int) -> Floats:
    """Return the sums of values, shape (B, steps, ...), by the row of each step, shape (B, rows, ...)."""
    if rows == 1:
        return np.asarray(values.sum(axis=1, keepdims=True))
    total = np.zeros((len(values), rows, *values.shape[2:]))
    np.add.at(total.swapaxes(0, 1), row, values.swapaxes(0, 1))
    return total
