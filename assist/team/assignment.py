"""Joint assignment of robots to people: each robot to at most one person, and no person to two robots.

The worth of an assignment is the sum of the worths of its pairs of robot and person. Where all places are equally far
from each other and robots are alike, the best assignment serves the people with the largest worths, and a robot that is
with one of them stays. Elsewhere it is a matching of maximum weight (`scipy.optimize.linear_sum_assignment`). Of equal
ones, one is taken that does not depend on rounding; the first robots rather go to the first people. A robot may come to
a person with whom another one stays without a task: that one makes room (`placed`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Floats
from ..person.ties import NEAR, first_best, ranked
from .state import BASE, NOBODY, TeamState

Ints = NDArray[np.int64]


def assigned(team: TeamState, worth: Floats) -> Ints:
    """Return the person to whom each robot goes, shape (N, M), in the assignment with the largest total worth.

    Robots under way, and those without a person at a positive worth, have `NOBODY`.

    Parameters
    ----------
    team : TeamState
        N teams of K people and M robots.
    worth : float array, shape (N, M, K)
        Value of sending each robot to each person, in cost units; minus infinity where nobody may be sent.
    """
    worth = np.where(team.reachable(), worth, -np.inf)
    if team.robots == 1:  # faster
        best = first_best(worth)
        enough = np.take_along_axis(worth, best[..., None], axis=2)[..., 0] > NEAR
        return np.where(enough, best, NOBODY)
    return (_best_served if team.interchangeable else _matched)(worth, team.location, team.ready)


def placed(location: Ints, person: Ints) -> Ints:
    """Return where robots are after they were sent, all of shape (N, M).

    A robot that is not sent leaves for its base, at no cost, if another one comes to the person it is with. The model
    assumes that it is there in the same step, however far the base is.
    """
    sent = person != NOBODY
    comes = sent & (person != location)
    leaves = ((person[:, None] == location[:, :, None]) & comes[:, None]).any(axis=2)
    return np.where(sent, person, np.where(leaves, BASE, location))


def _best_served(worth: Floats, location: Ints, ready: NDArray[np.bool_]) -> Ints:
    """Return the assignment if places are equally far and robots alike, so that only the people's worth matters."""
    teams, robots, people = worth.shape
    each = worth.max(axis=1)
    served = np.zeros((teams, people), dtype=bool)
    first = ranked(each)[:, :robots]
    enough = (np.take_along_axis(each, first, axis=1) > NEAR) & (np.arange(first.shape[1]) < ready.sum(axis=1)[:, None])
    np.put_along_axis(served, first, enough, axis=1)

    staying = ready & (location != BASE) & np.take_along_axis(served, location.clip(0), axis=1)
    n, m = np.nonzero(staying)
    owner = np.full((teams, people), NOBODY)
    owner[n[::-1], location[n, m][::-1]] = m[::-1]  # the first of several robots that are said to be with a person
    staying[n, m] = owner[n, location[n, m]] == m
    person = np.where(staying, location, NOBODY)

    waiting, idle = served & (owner == NOBODY), ready & ~staying
    # Those who are at the base go first, then those with whose person they would be worth least: they cost the same.
    there = np.take_along_axis(worth, location.clip(0)[:, :, None], axis=2)[:, :, 0].clip(np.finfo(float).min)
    order = ranked(np.where(idle, np.where(location == BASE, np.inf, -there), -np.inf))
    rank = np.empty_like(order)
    np.put_along_axis(rank, order, np.arange(robots)[None], axis=1)
    going = idle & (rank < waiting.sum(axis=1)[:, None])
    person[going] = np.nonzero(waiting)[1]  # robots and people are both in the order of the teams
    return person


def _matched(worth: Floats, location: Ints, ready: NDArray[np.bool_]) -> Ints:
    """Return the assignment by matching, for any distances."""
    from scipy.optimize import linear_sum_assignment  # slow to import, and rarely needed

    person = np.full(location.shape, NOBODY)
    # What decides between equal matchings: the first robots go to the first people, and the last robots to nobody. Sums
    # of products may be equal again; the sines of different numbers make them differ.
    robot, rank = np.arange(worth.shape[1])[:, None], np.arange(worth.shape[2])
    spread = np.sin(1.0 + robot * len(rank) + rank)
    first = NEAR * ((1 - robot / len(robot)) * (1 - rank / len(rank)) + 0.3 * spread / len(rank))
    for n in np.flatnonzero((worth > NEAR).any(axis=(1, 2))).tolist():
        gain = worth[n].clip(0)
        robots, people = linear_sum_assignment(gain + first, maximize=True)
        good = gain[robots, people] > NEAR
        person[n, robots[good]] = people[good]
        _stay_rather_than_swap(person[n], location[n], ready[n], gain)
    return person


def _stay_rather_than_swap(person: Ints, location: Ints, ready: NDArray[np.bool_], gain: Floats) -> None:
    """Assign a robot without a person to the one it is with, in place of another robot that would come.

    This is done where it is at least as good, as a matching does not prefer it. If robots are alike, it always is:
    staying costs nothing.
    """
    idle = np.flatnonzero((person == NOBODY) & ready & (location != BASE)).tolist()
    while idle:
        m = idle.pop()
        for other in np.flatnonzero((person == location[m]) & (location != location[m])).tolist():
            if gain[m, location[m]] < gain[other, location[m]] - NEAR:
                continue
            person[m], person[other] = location[m], NOBODY
            if location[other] != BASE:
                idle.append(other)
