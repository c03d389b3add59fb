"""One person's problem as part of a team's: the robot comes, stays and leaves, and its attention has a price.

A robot that serves K people is with one of them at a time. To give each of them a problem of their own, the price
`price[t]` is put on every step t in which the robot is with them or on its way (Lagrangian relaxation of a weakly
coupled problem: Hawkins, "A Lagrangian decomposition approach to weakly coupled dynamic optimization problems", 2003).
Coming costs what coming from the nearest other place does, and takes as long; leaving is free. From the end of
the prices on attention is free.

`Visits.of` writes that as an `AssistPOMDP` again, whose observed state is the task's, the step as long as the
price depends on it, and the robot's position. So every solver and bound there is serves here too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..people.choices import Choices
from ..people.human import NOTHING, Floats, HumanModel
from ..person.pomdp import AssistPOMDP

AWAY, HERE = 0, 1
"""Positions of the robot. At HERE + s it is on its way, and here after s more steps."""

Index = Callable[[ArrayLike, ArrayLike, ArrayLike], NDArray[np.int64]]


@dataclass(frozen=True)
class Visits:
    """One person's problem with a robot that comes and goes.

    Its robot actions are, where the robot is away: to stay away (0), and to come, saying nothing (1, if the way takes
    time) or saying each thing there is to say (1 and up, if it takes none). Where it is here: to leave (0), and to
    stay and say nothing (1) or anything there is to say (2 and up). On its way: to go on (0).

    Attributes
    ----------
    pomdp : AssistPOMDP
        Over m states.
    alone : AssistPOMDP
        The same person's problem with a robot that is always there.
    price : float array, shape (W,)
        What a step of attention costs, in cost units, for the steps from 0 on; then nothing.
    entry : float
        What coming costs, in cost units.
    entry_steps : int
        How many steps it takes.
    longest : int
        The most steps that the robot can be on its way.
    step, position, x : int arrays, shape (m,)
        What each state stands for: the step (W: W or any later one), the robot's position, the task's state.
    """

    pomdp: AssistPOMDP
    alone: AssistPOMDP
    price: Floats
    entry: float
    entry_steps: int
    longest: int
    step: NDArray[np.int64]
    position: NDArray[np.int64]
    x: NDArray[np.int64]

    @classmethod
    def of(
        cls,
        alone: AssistPOMDP,
        entry: float,
        entry_steps: int = 0,
        price: ArrayLike = (),
        *,
        longest: int | None = None,
    ) -> Visits:
        """Set the problem up; it begins with the robot away, at step 0.

        Where there is a price, only states that can be reached at each step are there.

        Parameters
        ----------
        longest : int, optional
            So many steps away there are states, though nothing leads to them if that is more than `entry_steps`.
        """
        if alone.frontier is not None:
            raise ValueError("visits: expected a problem of all states, and this one breaks off at a frontier")
        price = np.array(price, dtype=float)
        choices, steps = alone.model.choices, len(price)
        longest = entry_steps if longest is None else max(longest, entry_steps)
        positions = 2 + longest
        layers = _layers(alone, steps)
        offsets = np.cumsum([0, *(positions * len(layer) for layer in layers)])
        step = np.repeat(np.arange(steps + 1), np.diff(offsets))
        position = np.concatenate([np.repeat(np.arange(positions), len(layer)) for layer in layers])
        x = np.concatenate([np.tile(layer, positions) for layer in layers])

        index = _index(layers, offsets, len(choices))
        after = np.where(position > HERE, position - 1, position)
        targets = index(np.minimum(step + 1, steps)[:, None], after[:, None], choices.targets[x])
        by_h = np.argsort(choices.h[x], kind="stable")
        order = by_h[np.argsort(-step[by_h], kind="stable")]  # what comes later is worked out first
        own = np.arange(len(x))
        targets = np.where(choices.applicable[x], targets, own[:, None])
        product = Choices(
            choices.h[x], choices.goal[x], choices.applicable[x], choices.actions[x], targets, choices.costs[x],
            choices.optimal[x], choices.names, int(index(0, AWAY, choices.initial)),
        )  # fmt: skip

        # Which robot action of the problem alone each action stands for, and whether it is to be here or on the way.
        most = alone.suggested.shape[1]
        number = np.arange(most + 1)
        meant = np.where(position[:, None] == AWAY, number, number - 1)
        if entry_steps:  # to come is to say nothing yet
            meant = np.where(position[:, None] == AWAY, 0, meant)
        meant = np.clip(meant, 0, most - 1)
        count = np.where(position == HERE, alone.robot_actions[x] + 1, 1)
        count = np.where(position == AWAY, 2 if entry_steps else alone.robot_actions[x], count)
        count = np.where(choices.goal[x], 1, count)
        comes = (number > 0) & (position[:, None] == AWAY)
        used = number < count[:, None]
        then = np.where(number == 0, np.where(position > HERE, position, AWAY)[:, None], HERE)
        then = np.where(comes, HERE + entry_steps, then)
        charge = np.where(comes, entry, 0.0)
        row = x[:, None]
        pomdp = replace(
            alone,
            model=HumanModel(product, alone.model.q[x], alone.model.eta, alone.model.lapse, alone.model.utility_scale),
            robot_actions=count,
            suggested=np.where(used, alone.suggested[row, meant], NOTHING),
            afterstate=np.where(used, index(step[:, None], then, alone.afterstate[row, meant]), own[:, None]),
            robot_costs=np.where(used, alone.robot_costs[row, meant] + charge, 0.0),
            chosen=alone.chosen[x],
            unsuggested=alone.unsuggested[row, meant],
            low=alone.low[row, meant],
            weight=alone.weight[row, meant],
            order=order[~choices.goal[x][order]],
        )
        free = cls(pomdp, alone, np.zeros(steps), entry, entry_steps, longest, step, position, x)
        return free.priced(price) if steps else free

    def priced(self, price: Floats) -> Visits:
        """Give the same problem with other prices, of the same steps."""
        more = np.append(price - self.price, 0.0)[self.step]
        charge = self.pomdp.robot_costs + np.where(self.attended(), more[:, None], 0.0)
        return replace(self, pomdp=replace(self.pomdp, robot_costs=charge), price=price)

    def attended(self) -> NDArray[np.bool_]:
        """Tell which robot actions take its attention, shape (m, R)."""
        number = np.arange(self.pomdp.robot_costs.shape[1])
        attended = ((number > 0) | (self.position[:, None] > HERE)) & (number < self.pomdp.robot_actions[:, None])
        return attended & ~self.pomdp.final[:, None]

    def states(self, step: int, position: int) -> NDArray[np.int64]:
        """Number the states, shape (n,), of a step and a position; -1 where one is not there."""
        mine = np.flatnonzero((self.step == min(step, len(self.price))) & (self.position == position))
        number = np.full(len(self.alone.robot_actions), -1)
        number[self.x[mine]] = mine
        return number


def _index(layers: list[NDArray[np.int64]], offsets: NDArray[np.int64], states: int) -> Index:
    """Number states by step, position and the task's state; -1 where one is not there."""
    within = np.full((len(layers), states), -1)
    for t, layer in enumerate(layers):
        within[t, layer] = np.arange(len(layer))
    sizes = np.array([len(layer) for layer in layers])

    def index(step: ArrayLike, position: ArrayLike, x: ArrayLike) -> NDArray[np.int64]:
        step, position, x = np.asarray(step), np.asarray(position), np.asarray(x)
        at = within[step, x]
        return np.where(at >= 0, offsets[step] + position * sizes[step] + at, -1)

    return index


def _layers(alone: AssistPOMDP, steps: int) -> list[NDArray[np.int64]]:
    """Give the task's states that can be reached at each step, the last for all later ones."""
    choices = alone.model.choices
    if not steps:
        return [np.arange(len(choices))]

    def and_executed(states: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.union1d(states, alone.afterstate[states].ravel())

    layers = [and_executed(np.array([choices.initial]))]
    for _ in range(steps):
        layers.append(and_executed(np.unique(choices.targets[layers[-1]])))
    known = 0
    while len(layers[-1]) > known:
        known = len(layers[-1])
        layers[-1] = and_executed(np.union1d(layers[-1], choices.targets[layers[-1]].ravel()))
    return layers
