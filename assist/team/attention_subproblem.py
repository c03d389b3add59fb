"""One person's problem within a team: the robot comes, stays and leaves, and its attention has a price.

A robot that serves K people is with one of them at a time. The Lagrangian relaxation of this constraint gives each
person a problem of their own (Hawkins, "A Lagrangian decomposition approach to weakly coupled dynamic optimization
problems", 2003). The price `price[t]`, a dual variable, is charged in every step t in which the robot is with the
person or on its way to them. Coming costs as much, and takes as long, as from the nearest other place. Leaving is free.
After the last price attention is free.

`AttentionSubproblem.of` builds this problem as an `AssistPOMDP`. Its observed state consists of the task state, the
step as long as the price depends on it, and the robot's position (`TimeExpansion`). The robot's possible moves depend
on its position only (`RobotMoves`). So every solver and bound for an `AssistPOMDP` applies.
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
from ..person.leaf_bounds import LeafBounds
from ..person.pomdp import AssistPOMDP
from ..person.qmdp import QMDP, qmdp

AWAY, HERE = 0, 1
"""Positions of the robot. At HERE + s it is on its way and arrives after s more steps."""


@dataclass(frozen=True)
class TimeExpansion:
    """The states of an attention subproblem, ordered by step, then by robot position, then by task state.

    Attributes
    ----------
    states : int
        Number of task states.
    positions : int
        Number of robot positions.
    layers : tuple of int arrays
        Task states that exist at each step, in ascending order; the last layer is for all later steps.
    kept : bool array, shape (len(layers), states), or None
        States in which the problem continues at each step, if it is truncated at the others. Those exist as well if
        they are reachable.
    """

    states: int
    positions: int
    layers: tuple[NDArray[np.int64], ...]
    kept: NDArray[np.bool_] | None = None

    @classmethod
    def of(cls, alone: AssistPOMDP, positions: int, steps: int, kept: NDArray[np.bool_] | None = None) -> TimeExpansion:
        """Return the expansion with the states that are reachable at each step.

        With 0 steps it has all task states. A state in which the problem ends has no successors.
        """
        choices = alone.model.choices
        leads = choices.applicable & ~alone.final[:, None]  # in unused slots a state is its own target
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
        while len(layers[-1]) > known:  # the last layer collects the states of all later steps
            known = len(layers[-1])
            layers[-1] = and_executed(np.union1d(layers[-1], after(steps, layers[-1])))
        return cls(len(choices), positions, tuple(layers), kept)

    def __len__(self) -> int:
        return self.positions * sum(map(len, self.layers))

    @cached_property
    def step(self) -> NDArray[np.int64]:
        """The step of each state, shape (m,); the last value stands for all later steps."""
        return np.repeat(np.arange(len(self.layers)), [self.positions * len(layer) for layer in self.layers])

    @cached_property
    def position(self) -> NDArray[np.int64]:
        """The robot's position in each state, shape (m,)."""
        return np.concatenate([np.repeat(np.arange(self.positions), len(layer)) for layer in self.layers])

    @cached_property
    def x(self) -> NDArray[np.int64]:
        """The task state of each state, shape (m,)."""
        return np.concatenate([np.tile(layer, self.positions) for layer in self.layers])

    @cached_property
    def cut(self) -> NDArray[np.bool_]:
        """Whether the problem is truncated at each state by `kept`, shape (m,)."""
        return np.zeros(len(self), dtype=bool) if self.kept is None else ~self.kept[self.step, self.x]

    @cached_property
    def _first(self) -> NDArray[np.int64]:
        """The number of each task state at each step with the robot away; -1 where it does not exist."""
        first = np.full((len(self.layers), self.states), -1)
        before = 0
        for row, layer in zip(first, self.layers, strict=True):
            row[layer] = before + np.arange(len(layer))
            before += self.positions * len(layer)
        return first

    def number(self, step: ArrayLike, position: ArrayLike, x: ArrayLike) -> NDArray[np.int64]:
        """Return the numbers of states, given by their step, position and task state; -1 where one does not exist.

        The arguments are broadcast against each other. Steps beyond the last one count as the last.
        """
        step = np.minimum(step, len(self.layers) - 1)
        sizes = np.array([len(layer) for layer in self.layers])
        first = self._first[step, np.asarray(x)]
        return np.where(first < 0, -1, first + np.multiply(position, sizes[step]))


@dataclass(frozen=True)
class RobotMoves:
    """The robot's moves, by its position and the number of the robot action: arrays of shape (P, R + 1).

    - Away: stay away (0). If coming takes time, come without a suggestion (1); otherwise come and make any of the
      suggestions, or none (1 and up).
    - Here: leave (0), stay without a suggestion (1), or make any of the suggestions (2 and up).
    - On its way: continue (0).

    Attributes
    ----------
    meant : int array
        The corresponding action of a robot that is always present.
    then : int array
        Position of the robot when the person acts.
    comes : bool array
        Whether the move is to come, which has a cost.
    entry_steps : int
        Number of steps of coming.
    """

    meant: NDArray[np.int64]
    then: NDArray[np.int64]
    comes: NDArray[np.bool_]
    entry_steps: int

    @classmethod
    def of(cls, positions: int, actions: int, entry_steps: int) -> RobotMoves:
        """Return the moves, where a robot that is always present has at most `actions` actions."""
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
        """Return the number of moves, shape (m,), where a robot that is always present has `alone` actions."""
        away = np.full_like(alone, 2) if self.entry_steps else alone
        return np.select([position == AWAY, position == HERE], [away, alone + 1], 1)


@dataclass(frozen=True)
class AttentionSubproblem:
    """One person's problem with a robot that comes and goes; its robot actions are `RobotMoves`.

    Attributes
    ----------
    pomdp : AssistPOMDP
        The problem over m states.
    alone : AssistPOMDP
        The same person's problem with a robot that is always present.
    price : float array, shape (W,)
        Price of attention at the steps from 0 on, in cost units; later attention is free.
    entry : float
        Cost of coming, in cost units.
    entry_steps : int
        Number of steps of coming.
    layout : TimeExpansion
        Meaning of each state.
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
        """Build the subproblem; it begins with the robot away, at step 0.

        If there are prices, only states that are reachable at each step exist.

        Parameters
        ----------
        alone : AssistPOMDP
        entry, entry_steps, price
            As in the attributes of the class.
        longest : int, optional
            Number of positions on the way, if more than `entry_steps`; the additional ones are not reachable within the
            subproblem.
        kept : bool array, shape (W + 1, n), optional
            States in which the problem continues at each step. It is truncated at all others, with an upper bound of 0.
            This requires a truncated problem `alone` with bounds for a robot that is away.

        Raises
        ------
        LimitError
            The states of a long way would exceed the available memory.
        """
        price, one_goal = np.array(price, dtype=float), alone.model.choices.goal_count == 1
        if len(price):  # whose states are those that are reachable from one initial state
            alone.model.choices.require_one_goal(f"prices of {len(price)} steps")
        positions = 2 + max(entry_steps, longest or 0)
        layout = TimeExpansion.of(alone, positions, len(price), kept)
        _require_room(alone, layout)
        moves = RobotMoves.of(positions, alone.suggested.shape[1], entry_steps)

        x, position, own = layout.x, layout.position, np.arange(len(layout))
        final = alone.final[x] | layout.cut
        choices = _choices(alone.model.choices, layout, final)
        # With several goals, the robot does not see which rows are final.
        count = np.where(final & one_goal, 1, moves.count(position, alone.robot_actions[x]))
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
            followed_low=None if alone.followed_low is None else alone.followed_low[row, meant],
            followed_weight=None if alone.followed_weight is None else alone.followed_weight[row, meant],
            order=_order(choices, layout, final),
            frontier=_frontier(alone, layout, price, entry),
        )
        free = cls(pomdp, alone, np.zeros(len(price)), entry, entry_steps, layout)
        return free.priced(price) if len(price) else free

    def priced(self, price: Floats) -> AttentionSubproblem:
        """Return the same subproblem with other prices of the same steps."""
        more = np.append(price - self.price, 0.0)[self.layout.step]
        costs = self.pomdp.robot_costs + np.where(self.attended(), more[:, None], 0.0)
        frontier = _frontier(self.alone, self.layout, price, self.entry)
        return replace(self, pomdp=replace(self.pomdp, robot_costs=costs, frontier=frontier), price=price)

    def at_price(self, price: float) -> AssistPOMDP:
        """Return the problem with an additional price that is the same at all steps."""
        return replace(self.pomdp, robot_costs=self.pomdp.robot_costs + price * self.attended())

    def attended(self) -> NDArray[np.bool_]:
        """Return which robot actions take the robot's attention, shape (m, R)."""
        number = np.arange(self.pomdp.robot_costs.shape[1])
        under_way = self.layout.position[:, None] > HERE
        attended = ((number > 0) | under_way) & (number < self.pomdp.robot_actions[:, None])
        return attended & ~(self.pomdp.final & (self.pomdp.model.choices.goal_count == 1))[:, None]

    def states(self, step: int, position: int) -> NDArray[np.int64]:
        """Return the numbers of the states, shape (n,), of a step and a position; -1 where one does not exist."""
        return self.layout.number(step, position, np.arange(self.layout.states))


def policy_bytes(states: int, *, slots: int = 1, robots: int = 2, betas: int = 6, thetas: int = 10) -> int:
    """Return the memory of a person's problem and its QMDP policy in bytes; a lower bound if only `states` is given.

    Parameters
    ----------
    states : int
    slots, robots : int
        Largest numbers of choices of the person, and of the robot, in a state.
    betas, thetas : int
        Size of the grid; by default that of `Grid.regular`.
    """
    # cost, afterstate and slot; `unsuggested`; the trust update
    hidden, of_a_robot = betas * thetas, 3 + betas + 2 * thetas
    return 8 * states * (1 + slots * (1 + betas) + robots * of_a_robot + (1 + robots) * hidden)


def _require_room(alone: AssistPOMDP, layout: TimeExpansion) -> None:
    """Raise a `LimitError` if a problem exceeds the available memory."""
    betas, thetas = alone.grid.shape
    slots, robots = alone.model.choices.applicable.shape[1], 1 + alone.suggested.shape[1]
    needed = policy_bytes(len(layout), slots=slots, robots=robots, betas=betas, thetas=thetas)
    small = 100e6  # bytes; below this, the available memory is not queried
    if needed > small and needed > (free := available_memory()):
        raise LimitError(
            f"a person's problem with a robot that comes and goes has {len(layout):,} states, with ways of up to "
            f"{layout.positions - 2:,} steps, and takes about {needed / 1e6:,.0f} MB of memory; {free / 1e6:,.0f} MB "
            "are left; expected shorter ways (travel_time, distance) or fewer prices"
        )


def backwards(visits: AttentionSubproblem, tail: Floats) -> QMDP:
    """Solve a subproblem with observed beta and theta, from the steps with free attention back to the first one.

    Parameters
    ----------
    visits : AttentionSubproblem
    tail : float array, shape (P * n, B, T)
        Upper bound on the value with free attention, by position and task state.
    """
    layout = visits.layout
    above = np.zeros((len(layout), *visits.pomdp.grid.shape))
    last = layout.step == len(visits.price)
    above[last] = tail[layout.position[last] * layout.states + layout.x[last]]
    return qmdp(visits.pomdp, above=above, tolerance=1e-5)


def _choices(choices: Choices, layout: TimeExpansion, final: NDArray[np.bool_]) -> Choices:
    """Return the person's choices in the time expansion: each one advances the step, and a travelling robot by one."""
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
    """Return the states that are not final, ordered from the last step to the first, then by the cost-to-go."""
    order = np.lexsort((choices.h, -layout.step))
    return order[~final[order]]


def _frontier(alone: AssistPOMDP, layout: TimeExpansion, price: Floats, entry: float) -> LeafBounds | None:
    """Return the frontier bounds of a subproblem whose person alone has a frontier: at every step and position.

    Upper bound: no policy exceeds the value of a robot that is always present without a price. If the value of a robot
    that is away is known, the subproblem ends with it. A robot on its way then counts as present.

    Lower bound (otherwise): a robot that is here can stay, and act like one that is always present, for at most the sum
    of all later prices. A robot that is away can come first, if that takes no time. A robot on a longer way can leave
    on arrival and stay away; then the worst case is assumed.
    """
    if alone.frontier is None:
        return None
    place = np.full(layout.states, -1)
    place[alone.frontier.states] = np.arange(len(alone.frontier.states))
    if alone.frontier.away is not None:
        ends = place[layout.x] >= 0
        states = np.flatnonzero(ends | (layout.cut & ~alone.model.choices.goal[layout.x]))
        known = np.stack([alone.frontier.away, alone.frontier.upper])
        upper = np.zeros((len(states), *known.shape[2:]))  # 0 is an upper bound, as costs are positive
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
