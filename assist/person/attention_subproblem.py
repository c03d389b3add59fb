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

import numpy as np
from numpy.typing import ArrayLike

from planner.system.limits import available_memory

from ..people.choices import Choices
from ..people.decision import NOTHING, Bools, Floats, Ints
from .memory_needed import policy_bytes, require_room
from .pomdp import AssistPOMDP
from .qmdp import QMDP, qmdp
from .subproblem_frontier import frontier_of
from .time_expansion import AWAY, HERE, RobotMoves, TimeExpansion


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
    on_actions : float array, shape (2, W)
        Additional prices of a suggestion and of an execution at these steps, in cost units.
    """

    pomdp: AssistPOMDP
    alone: AssistPOMDP
    price: Floats
    entry: float
    entry_steps: int
    layout: TimeExpansion
    on_actions: Floats

    @classmethod
    def of(
        cls,
        alone: AssistPOMDP,
        entry: float,
        entry_steps: int = 0,
        price: ArrayLike = (),
        *,
        longest: int | None = None,
        kept: Bools | None = None,
    ) -> AttentionSubproblem:
        """Build the subproblem; it begins with the robot away, at step 0.

        If there are prices, only states that are reachable at each step exist.

        Parameters
        ----------
        alone : AssistPOMDP
        entry, entry_steps
            As in the attributes of the class.
        price : float array, shape (W,) or (3, W)
            Prices of attention, and the additional ones of a suggestion and of an execution, if there are any.
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
        price = with_actions(price)
        positions = 2 + max(entry_steps, longest or 0)
        layout = TimeExpansion.of(alone, positions, price.shape[1], kept)
        _require_memory(alone, layout)
        moves = RobotMoves.of(positions, alone.suggested.shape[1], entry_steps)

        x, position, own = layout.x, layout.position, np.arange(len(layout))
        ends = alone.ends[x] | layout.cut
        choices = _choices(alone.model.choices, layout, ends)
        count = np.where(ends, 1, moves.count(position, alone.robot_actions[x]))
        used = np.arange(moves.meant.shape[1]) < count[:, None]
        row, meant, there = x[:, None], moves.meant[position], moves.then[position] == HERE
        afterstate = layout.number(layout.step[:, None], moves.then[position], alone.afterstate[row, meant])
        pomdp = replace(
            alone,
            model=replace(alone.model, choices=choices, q=alone.model.q[x]),
            robot_actions=count,
            suggested=np.where(used, alone.suggested[row, meant], NOTHING),
            afterstate=np.where(used, afterstate, own[:, None]),
            robot_costs=np.where(used, there * alone.robot_costs[row, meant] + entry * moves.comes[position], 0.0),
            chosen=alone.chosen[x],
            unsuggested=alone.unsuggested[row, meant],
            moves=alone.moves[row, meant],
            low=alone.low[row, meant],
            weight=alone.weight[row, meant],
            followed_low=None if alone.followed_low is None else alone.followed_low[row, meant],
            followed_weight=None if alone.followed_weight is None else alone.followed_weight[row, meant],
            order=np.stack([np.lexsort((h, -layout.step)) for h in choices.goals.h]),
            frontier=frontier_of(alone, layout, price[0], entry),
        )
        nothing = np.zeros_like(price)
        free = cls(pomdp, alone, nothing[0], entry, entry_steps, layout, nothing[1:])
        return free.priced(price) if price.size else free

    def priced(self, price: Floats) -> AttentionSubproblem:
        """Return the same subproblem with other prices of the same steps; `price` is as in `of`."""
        price, costs = with_actions(price), self.pomdp.robot_costs
        more = np.pad(price - np.vstack([self.price, self.on_actions]), ((0, 0), (0, 1)))[:, self.layout.step]
        for change, done in zip(more, (self.attended(), *self.acted()), strict=True):
            costs = costs + np.where(done, change[:, None], 0.0)
        frontier = frontier_of(self.alone, self.layout, price[0], self.entry)
        return replace(
            self, pomdp=replace(self.pomdp, robot_costs=costs, frontier=frontier), price=price[0], on_actions=price[1:]
        )

    def at_price(self, price: float) -> AssistPOMDP:
        """Return the problem with an additional price that is the same at all steps."""
        return replace(self.pomdp, robot_costs=self.pomdp.robot_costs + price * self.attended())

    def attended(self) -> Bools:
        """Return which robot actions take the robot's attention, shape (m, R)."""
        number = np.arange(self.pomdp.robot_costs.shape[1])
        under_way = self.layout.position[:, None] > HERE
        attended = ((number > 0) | under_way) & (number < self.pomdp.robot_actions[:, None])
        return attended & ~self.pomdp.ends[:, None]

    def acted(self) -> tuple[Bools, Bools]:
        """Return which robot actions make a suggestion, and which execute an action, both of shape (m, R)."""
        moves = RobotMoves.of(self.layout.positions, self.alone.suggested.shape[1], self.entry_steps)
        acts = self.attended() & (moves.meant[self.layout.position] > 0)
        executes = acts & (self.pomdp.suggested == NOTHING)
        return acts & ~executes, executes

    def states(self, step: int, position: int) -> Ints:
        """Return the numbers of the states, shape (n,), of a step and a position; -1 where one does not exist."""
        return self.layout.number(step, position, np.arange(self.layout.states))


def with_actions(price: ArrayLike) -> Floats:
    """Return prices of attention and of actions, shape (3, W); those of actions are 0 unless given."""
    given = np.atleast_2d(np.array(price, dtype=float))
    return np.vstack([given, np.zeros((3 - len(given), given.shape[1]))])


def backwards(visits: AttentionSubproblem, tail: Floats) -> QMDP:
    """Solve a subproblem with observed type and theta, from the steps with free attention back to the first one.

    Parameters
    ----------
    visits : AttentionSubproblem
    tail : float array, shape (P * n, H, T)
        Upper bound on the value with free attention, by position and task state.
    """
    layout = visits.layout
    above = np.zeros((len(layout), *visits.pomdp.prior.shape))
    last = layout.step == len(visits.price)
    above[last] = tail[layout.position[last] * layout.states + layout.x[last]]
    return qmdp(visits.pomdp, above=above, tolerance=1e-5)


def _choices(choices: Choices, layout: TimeExpansion, ends: Bools) -> Choices:
    """Return the person's choices in the time expansion: each one advances the step, and a travelling robot by one."""
    x, own = layout.x, np.arange(len(layout))
    position = np.where(layout.position > HERE, layout.position - 1, layout.position)
    targets = layout.number(layout.step[:, None] + 1, position[:, None], choices.targets[x])
    applicable = choices.applicable[x] & ~ends[:, None]
    return choices.of_rows(
        x, applicable=applicable, targets=np.where(applicable, targets, own[:, None]),
        initial=int(layout.number(0, AWAY, choices.initial)), state=None, terms=None, features=None, offered=None,
    )  # fmt: skip


def _require_memory(alone: AssistPOMDP, layout: TimeExpansion) -> None:
    """Raise a `LimitError` if a problem exceeds the available memory."""
    types, thetas = alone.prior.shape
    slots, actions = alone.model.choices.applicable.shape[1], 1 + alone.suggested.shape[1]
    needed = policy_bytes(len(layout), slots=slots, actions=actions, betas=types, thetas=thetas)
    if needed > 100e6:  # below this, the available memory is not queried
        require_room(
            f"a person's problem with a robot that comes and goes has {len(layout):,} states, with ways of up to "
            f"{layout.positions - 2:,} steps, and takes", needed, available_memory() / 1e6,
            "shorter ways (travel_time, distance) or fewer prices",
        )  # fmt: skip
