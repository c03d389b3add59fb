"""A team's joint POMDP, built from each person's `AssistPOMDP`: all actions, their outcomes and probabilities."""

from __future__ import annotations

import math
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from assist.people.decision import Floats
from assist.person.pomdp import AssistPOMDP
from assist.person.travel import Travel
from assist.team.state import NOBODY

Ints = NDArray[np.int64]


class JointProblem(NamedTuple):
    """A team's joint POMDP for compiled code.

    The states of all tasks form one number y. With the robot's location k (K: the base), the observed state is y * (K +
    1) + k. The robot's actions at y are the same for all locations, except for the cost of moving. They are numbered
    consecutively over all y, and the outcomes, which are people's actions, over all robot actions.

    Attributes
    ----------
    gamma : float
    way : float array, shape (K + 1, K + 1)
        Cost of moving.
    first : int array, shape (Y + 1,)
        The actions at y are `first[y]`, which is to do nothing, up to `first[y + 1]`.
    person : int array, shape (D,)
        The person whom each action concerns, or `NOBODY`.
    reward : float array, shape (D, H)
        Minus the expected costs of the robot's and people's actions, without moving.
    low, high : int arrays, shape (D, H); weight : float array, shape (D, H)
        The two hidden states between which each is divided after the action; `high` has `weight`.
    begin : int array, shape (D + 1,)
        The outcomes of action d are `begin[d]` up to `begin[d + 1]`.
    target : int array, shape (O,)
        The y after each outcome.
    chance : float array, shape (O, H)
        Probability of each outcome.
    """

    gamma: float
    way: Floats
    first: Ints
    person: Ints
    reward: Floats
    low: Ints
    high: Ints
    weight: Floats
    begin: Ints
    target: Ints
    chance: Floats


class _Act(NamedTuple):
    """The L outcomes of one person's next action.

    Attributes
    ----------
    target : int array, shape (L,)
    cost : float array, shape (L,)
    chance : float array, shape (L, B * T)
    """

    target: Ints
    cost: Floats
    chance: Floats


def _act(pomdp: AssistPOMDP, x: int, action: int) -> _Act:
    """Return the outcomes of a person in a state under an action of the robot."""
    choices, place = pomdp.model.choices, int(pomdp.afterstate[x, action])
    if choices.goal[place]:  # finished, or finished by the robot's execution
        return _Act(np.array([place]), np.zeros(1), np.ones((1, pomdp.prior.size)))
    slots = np.flatnonzero(choices.applicable[place])
    chance = pomdp.likelihood(np.full_like(slots, x), np.full_like(slots, action), slots)
    chance = np.broadcast_to(chance, (len(slots), *pomdp.grid.shape)).reshape(len(slots), -1)
    return _Act(choices.targets[place, slots], choices.costs[place, slots], chance)


def product_of(chances: list[Floats]) -> Floats:
    """Return the joint probabilities of all people; the last person's index varies fastest on every axis."""
    joint: Floats = np.ones((1,) * chances[0].ndim)
    for one in chances:
        joint = np.asarray(np.kron(joint, one), dtype=float)
    return joint


def written_out(people: list[AssistPOMDP], travel: Travel) -> JointProblem:
    """Return the joint problem of people whose tasks are whole, and of robots that are with a person at once."""
    assert travel.at_once
    assert not any(pomdp.frontier is not None or (len(people) > 1 and pomdp.moves[:, 0].any()) for pomdp in people)
    sizes, shape = [len(p.robot_actions) for p in people], [n for p in people for n in p.grid.shape]
    every = np.arange(math.prod(shape))
    grid = np.array(np.unravel_index(every, shape))  # each person's beta and theta, as rows
    acts = [[[_act(p, x, r) for r in range(p.robot_actions[x])] for x in range(len(p.robot_actions))] for p in people]
    first, person, begin = [0], [], [0]
    reward, low, high, weight, target, chance = [], [], [], [], [], []
    for tasks in product(*map(range, sizes)):
        deeds = [(k, r) for k, x in enumerate(tasks) for r in range(1, people[k].robot_actions[x])]
        if not all(p.model.choices.goal[x] for p, x in zip(people, tasks, strict=True)):
            deeds.insert(0, (NOBODY, 0))
        for k, action in deeds:
            each = [acts[j][x][action if j == k else 0] for j, x in enumerate(tasks)]
            chances = product_of([one.chance for one in each])
            cost = np.sum(np.meshgrid(*[one.cost for one in each], indexing="ij"), axis=0).ravel()
            to = np.meshgrid(*[one.target for one in each], indexing="ij")
            at, above, share, charge = grid.copy(), grid.copy(), np.zeros(len(every)), 0.0
            if k != NOBODY:
                charge = float(people[k].robot_costs[tasks[k], action])
            moves = 0 if people[0].moves[:, 0].any() else k  # then there is one person
            if moves != NOBODY:
                theta = grid[2 * moves + 1]
                at[2 * moves + 1] = people[moves].low[tasks[moves], action, 0][theta]
                above[2 * moves + 1] = at[2 * moves + 1] + 1
                share = people[moves].weight[tasks[moves], action, 0][theta]
            person.append(k)
            reward.append(-charge - cost @ chances)
            low.append(np.ravel_multi_index(tuple(at), shape))
            high.append(np.ravel_multi_index(tuple(above), shape))
            weight.append(share)
            target.append(np.ravel_multi_index([one.ravel() for one in to], sizes))
            chance.append(chances)
            begin.append(begin[-1] + len(chances))
        first.append(len(person))
    return JointProblem(
        people[0].gamma, travel.c_move[0] * travel.distance, np.array(first), np.array(person), np.array(reward),
        np.array(low), np.array(high), np.array(weight), np.array(begin), np.concatenate(target),
        np.concatenate(chance),
    )  # fmt: skip
