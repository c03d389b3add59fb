"""One person's problem as part of a team's: the robot comes, stays and leaves, and its attention has a price.

A robot that serves K people is with one of them at a time. To give each of them a problem of their own, the price
`price[t]` is put on every step t in which the robot is with them or on its way (Lagrangian relaxation of a weakly
coupled problem: Hawkins, "A Lagrangian decomposition approach to weakly coupled dynamic optimization problems", 2003).
Coming costs what coming from the nearest other place does, and takes as long; leaving is free. From the end of
the prices on attention is free.

`AttentionSubproblem.of` writes that as an `AssistPOMDP` again, whose observed state is the task's, the step as long as
the price depends on it, and the robot's position (`TimeExpansion`). What the robot can do depends on its position alone
(`RobotMoves`). So every solver and bound there is serves here too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner import LimitError
from planner.system.machine import available_memory

from ..people.choices import Choices
from ..people.decision import NOTHING, Floats
from ..person.pomdp import AssistPOMDP, LeafBounds
from ..person.qmdp import QMDP, qmdp

AWAY, HERE = 0, 1
"""Positions of the robot. At HERE + s it is on its way, and here after s more steps."""

SMALL = 100e6
"""Bytes for which no machine is asked whether it has them."""


@dataclass(frozen=True)
class TimeExpansion:
    """The states of a problem of visits: by step, then by the robot's position, then by the task's state.

    Attributes
    ----------
    states : int
        How many states the task has.
    positions : int
        How many the robot has.
    layers : tuple of int arrays
        The task's states that are there at each step, ascending; the last for all later steps.
    kept : bool array, shape (len(layers), states), or None
        Where the problem goes on at each step, if it breaks off at other states. These are there, too, if they can be
        reached.
    """

    states: int
    positions: int
    layers: tuple[NDArray[np.int64], ...]
    kept: NDArray[np.bool_] | None = None

    @classmethod
    def of(cls, alone: AssistPOMDP, positions: int, steps: int, kept: NDArray[np.bool_] | None = None) -> TimeExpansion:
        """Keep what can be reached at each of so many steps; with none, every state of the task.

        Nothing follows a state in which the problem ends.
        """
        choices = alone.model.choices
        leads = choices.applicable & ~alone.final[:, None]  # in empty slots a state is its own target
        if not steps:
            return cls(len(choices), positions, (np.arange(len(choices)),))

        def and_executed(states: NDArray[np.int64]) -> NDArray[np.int64]:
            return np.union1d(states, alone.afterstate[states].ravel())

        def after(step: int, states: NDArray[np.int64]) -> NDArray[np.int64]:
            going = states if kept is None else states[kept[step, states]]
            return np.unique(choices.targets[going][leads[going]])

        layers = [and_executed(np.array([choices.initial]))]
        for step in range(steps):
            layers.append(and_executed(after(step, layers[-1])))
        known = 0
        while len(layers[-1]) > known:  # all later steps are in the last layer
            known = len(layers[-1])
            layers[-1] = and_executed(np.union1d(layers[-1], after(steps, layers[-1])))
        return cls(len(choices), positions, tuple(layers), kept)

    def __len__(self) -> int:
        return self.positions * sum(map(len, self.layers))

    @cached_property
    def step(self) -> NDArray[np.int64]:
        """The step of each state, shape (m,); the last is any later one, too."""
        return np.repeat(np.arange(len(self.layers)), [self.positions * len(layer) for layer in self.layers])

    @cached_property
    def position(self) -> NDArray[np.int64]:
        """The robot's position in each state, shape (m,)."""
        return np.concatenate([np.repeat(np.arange(self.positions), len(layer)) for layer in self.layers])

    @cached_property
    def x(self) -> NDArray[np.int64]:
        """The task's state in each state, shape (m,)."""
        return np.concatenate([np.tile(layer, self.positions) for layer in self.layers])

    @cached_property
    def cut(self) -> NDArray[np.bool_]:
        """Where the problem breaks off though the task's does not, shape (m,)."""
        return np.zeros(len(self), dtype=bool) if self.kept is None else ~self.kept[self.step, self.x]

    @cached_property
    def _first(self) -> NDArray[np.int64]:
        """The number of each task state at each step, with the robot away; -1 where it is not there."""
        first = np.full((len(self.layers), self.states), -1)
        before = 0
        for row, layer in zip(first, self.layers, strict=True):
            row[layer] = before + np.arange(len(layer))
            before += self.positions * len(layer)
        return first

    def number(self, step: ArrayLike, position: ArrayLike, x: ArrayLike) -> NDArray[np.int64]:
        """Number states of a step, a position and a state of the task, in arrays that fit; -1 where one is not there.

        Steps beyond the last are the last.
        """
        step = np.minimum(step, len(self.layers) - 1)
        sizes = np.array([len(layer) for layer in self.layers])
        first = self._first[step, np.asarray(x)]
        return np.where(first < 0, -1, first + np.multiply(position, sizes[step]))


@dataclass(frozen=True)
class RobotMoves:
    """What the robot can do, by its position and the number of the robot action: arrays of shape (P, R + 1).

    Away: to stay away (0), and to come, saying nothing (1, if the way takes time) or saying each thing there is to
    say (1 and up, if it takes none). Here: to leave (0), and to stay and say nothing (1) or anything there is to
    say (2 and up). On its way: to go on (0).

    Attributes
    ----------
    meant : int array
        The action of a robot that is always there for which each stands.
    then : int array
        Where the robot is when the person acts.
    comes : bool array
        Which are to come, and cost that.
    """

    meant: NDArray[np.int64]
    then: NDArray[np.int64]
    comes: NDArray[np.bool_]
    entry_steps: int

    @classmethod
    def of(cls, positions: int, actions: int, entry_steps: int) -> RobotMoves:
        """List them, where a robot that is always there has at most so many actions."""
        number = np.arange(actions + 1)
        meant = np.zeros((positions, actions + 1), dtype=np.int64)
        meant[AWAY] = 0 if entry_steps else number.clip(max=actions - 1)
        meant[HERE] = (number - 1).clip(min=0)
        then = np.empty_like(meant)
        then[:, 0] = np.arange(positions)
        then[HERE, 0] = AWAY
        then[:, 1:] = HERE
        then[AWAY, 1:] = HERE + entry_steps
        comes = np.zeros(meant.shape, dtype=bool)
        comes[AWAY, 1:] = True
        return cls(meant, then, comes, entry_steps)

    def count(self, position: NDArray[np.int64], alone: NDArray[np.int64]) -> NDArray[np.int64]:
        """Give how many there are, shape (m,), at positions and where a robot that is always there has so many."""
        away = np.full_like(alone, 2) if self.entry_steps else alone
        return np.select([position == AWAY, position == HERE], [away, alone + 1], 1)


@dataclass(frozen=True)
class AttentionSubproblem:
    """One person's problem with a robot that comes and goes; its robot actions are `RobotMoves`.

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
    layout : TimeExpansion
        What each state stands for.
    """

    pomdp: AssistPOMDP
    alone: AssistPOMDP
    price: Floats
    entry: float
    entry_steps: int
    layout: TimeExpansion

    @classmethod
    def of(
        cls,
        alone: AssistPOMDP,
        entry: float,
        entry_steps: int = 0,
        price: ArrayLike = (),
        *,
        longest: int | None = None,
        kept: NDArray[np.bool_] | None = None,
    ) -> AttentionSubproblem:
        """Set the problem up; it begins with the robot away, at step 0.

        Where there is a price, only states that can be reached at each step are there.

        Parameters
        ----------
        longest : int, optional
            So many steps away there are states, though nothing leads to them if that is more than `entry_steps`.
        kept : bool array, shape (W + 1, n), optional
            Where the problem goes on at each step; elsewhere it breaks off, with an upper bound of 0. Only where that
            of the person alone breaks off as well, and it is known what a robot gets there that is away.

        Raises
        ------
        LimitError
            There are so many states that the machine has no memory for them: on a way of many steps.
        """
        price = np.array(price, dtype=float)
        positions = 2 + max(entry_steps, longest or 0)
        layout = TimeExpansion.of(alone, positions, len(price), kept)
        _require_room(alone, layout)
        moves = RobotMoves.of(positions, alone.suggested.shape[1], entry_steps)

        x, position, own = layout.x, layout.position, np.arange(len(layout))
        final = alone.final[x] | layout.cut
        choices = _choices(alone.model.choices, layout, final)
        count = np.where(final, 1, moves.count(position, alone.robot_actions[x]))
        used = np.arange(moves.meant.shape[1]) < count[:, None]
        row, meant = x[:, None], moves.meant[position]
        afterstate = layout.number(layout.step[:, None], moves.then[position], alone.afterstate[row, meant])
        pomdp = replace(
            alone,
            model=replace(alone.model, choices=choices, q=alone.model.q[x]),
            robot_actions=count,
            suggested=np.where(used, alone.suggested[row, meant], NOTHING),
            afterstate=np.where(used, afterstate, own[:, None]),
            robot_costs=np.where(used, alone.robot_costs[row, meant] + entry * moves.comes[position], 0.0),
            chosen=alone.chosen[x],
            unsuggested=alone.unsuggested[row, meant],
            low=alone.low[row, meant],
            weight=alone.weight[row, meant],
            order=_order(choices, layout, final),
            frontier=_frontier(alone, layout, price, entry),
        )
        free = cls(pomdp, alone, np.zeros(len(price)), entry, entry_steps, layout)
        return free.priced(price) if len(price) else free

    def priced(self, price: Floats) -> AttentionSubproblem:
        """Give the same problem with other prices, of the same steps."""
        more = np.append(price - self.price, 0.0)[self.layout.step]
        costs = self.pomdp.robot_costs + np.where(self.attended(), more[:, None], 0.0)
        frontier = _frontier(self.alone, self.layout, price, self.entry)
        return replace(self, pomdp=replace(self.pomdp, robot_costs=costs, frontier=frontier), price=price)

    def at_price(self, price: float) -> AssistPOMDP:
        """Give the problem with a price that is the same at all steps, on top of others."""
        return replace(self.pomdp, robot_costs=self.pomdp.robot_costs + price * self.attended())

    def attended(self) -> NDArray[np.bool_]:
        """Tell which robot actions take its attention, shape (m, R)."""
        number = np.arange(self.pomdp.robot_costs.shape[1])
        under_way = self.layout.position[:, None] > HERE
        attended = ((number > 0) | under_way) & (number < self.pomdp.robot_actions[:, None])
        return attended & ~self.pomdp.final[:, None]

    def states(self, step: int, position: int) -> NDArray[np.int64]:
        """Number the states, shape (n,), of a step and a position; -1 where one is not there."""
        return self.layout.number(step, position, np.arange(self.layout.states))


def policy_bytes(states: int, *, slots: int = 1, robots: int = 2, betas: int = 6, thetas: int = 10) -> int:
    """Return how many bytes a person's problem and its QMDP policy take; at least, where only its states are known.

    Parameters
    ----------
    slots, robots : int
        The most choices of a person, and of the robot, in any state.
    betas, thetas : int
        The grid's, as `Grid.regular` has it unless given.
    """
    hidden, of_a_robot = betas * thetas, 3 + betas + 2 * thetas  # cost, afterstate, slot; unsuggested; theta's moves
    return 8 * states * (1 + slots * (1 + betas) + robots * of_a_robot + (1 + robots) * hidden)


def _require_room(alone: AssistPOMDP, layout: TimeExpansion) -> None:
    """Refuse a problem for which the machine has no memory left."""
    betas, thetas = alone.grid.shape
    slots, robots = alone.model.choices.applicable.shape[1], 1 + alone.suggested.shape[1]
    needed = policy_bytes(len(layout), slots=slots, robots=robots, betas=betas, thetas=thetas)
    if needed > SMALL and needed > (free := available_memory()):
        raise LimitError(
            f"a person's problem with a robot that comes and goes has {len(layout):,} states, with ways of up to "
            f"{layout.positions - 2:,} steps, and takes about {needed / 1e6:,.0f} MB of memory; {free / 1e6:,.0f} MB "
            "are left; expected shorter ways (travel_time, distance) or fewer prices"
        )


def backwards(visits: AttentionSubproblem, tail: Floats) -> QMDP:
    """Solve a problem with beta and theta seen, from the steps on at which attention is free back to the first.

    Parameters
    ----------
    tail : float array, shape (P * n, B, T)
        What it is worth from then on, by position and the task's state; at least that.
    """
    layout = visits.layout
    above = np.zeros((len(layout), *visits.pomdp.grid.shape))
    last = layout.step == len(visits.price)
    above[last] = tail[layout.position[last] * layout.states + layout.x[last]]
    return qmdp(visits.pomdp, above=above, tolerance=1e-5)


def _choices(choices: Choices, layout: TimeExpansion, final: NDArray[np.bool_]) -> Choices:
    """Return the person's choices: the same, while the step passes and the robot that is on its way comes nearer."""
    x, own = layout.x, np.arange(len(layout))
    position = np.where(layout.position > HERE, layout.position - 1, layout.position)
    targets = layout.number(layout.step[:, None] + 1, position[:, None], choices.targets[x])
    applicable = choices.applicable[x] & ~final[:, None]
    return replace(
        choices,
        state=None,
        terms=None,
        features=None,
        key=None if choices.key is None else choices.key[x],
        h=choices.h[x],
        goal=choices.goal[x],
        applicable=applicable,
        actions=choices.actions[x],
        targets=np.where(applicable, targets, own[:, None]),
        costs=choices.costs[x],
        optimal=choices.optimal[x],
        initial=int(layout.number(0, AWAY, choices.initial)),
    )


def _order(choices: Choices, layout: TimeExpansion, final: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Order the states that are not final: what comes later is worked out first, then what is nearer to the goal."""
    order = np.lexsort((choices.h, -layout.step))
    return order[~final[order]]


def _frontier(alone: AssistPOMDP, layout: TimeExpansion, price: Floats, entry: float) -> LeafBounds | None:
    """Give the frontier of a problem of visits where that of the person alone has one: at every step and position.

    Above: no policy gets more than with a robot that is always there, whose presence costs nothing. Where it is known
    what a robot that is away gets, the problem ends with that, and with the other's value wherever it has set out.

    Else, below: a robot that is here can stay and do as the one that is always there does, at no more than what all
    prices to come add up to; one that is away can come first, if that takes no time. Otherwise it can leave when it is
    there, and stay away, and the worst happens.
    """
    if alone.frontier is None:
        return None
    place = np.full(layout.states, -1)
    place[alone.frontier.states] = np.arange(len(alone.frontier.states))
    if alone.frontier.away is not None:
        ends = place[layout.x] >= 0
        states = np.flatnonzero(ends | (layout.cut & ~alone.model.choices.goal[layout.x]))
        known = np.stack([alone.frontier.away, alone.frontier.upper])
        upper = np.zeros((len(states), *known.shape[2:]))  # no more than that, as costs are positive
        upper[ends[states]] = known[np.minimum(layout.position[states], HERE), place[layout.x[states]]][ends[states]]
        return LeafBounds(states, upper, upper)
    assert layout.kept is None
    states = np.flatnonzero(place[layout.x] >= 0)
    at = place[layout.x[states]]
    position = layout.position[states]
    upper = alone.frontier.upper[at]
    paid = np.append(np.cumsum((price * alone.gamma ** np.arange(len(price)))[::-1])[::-1], 0.0)
    paid = (paid / alone.gamma ** np.arange(len(paid)))[layout.step[states]]
    lower = alone.frontier.lower[at] - (paid + entry * (position == AWAY))[:, None]
    if layout.positions > 2:
        floor = -np.inf if alone.frontier.floor is None else alone.frontier.floor
        lower[position != HERE] = floor - paid[position != HERE, None]
    return LeafBounds(states, np.minimum(lower, 0.0), upper)
