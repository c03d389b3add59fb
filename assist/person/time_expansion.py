"""The states of an attention subproblem and the moves of its robot."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ..people.decision import Bools, Ints
from .pomdp import AssistPOMDP

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
    layers: tuple[Ints, ...]
    kept: Bools | None = None

    @classmethod
    def of(cls, alone: AssistPOMDP, positions: int, steps: int, kept: Bools | None = None) -> TimeExpansion:
        """Return the expansion with the states that are reachable at each step.

        With 0 steps it has all task states. A state in which the problem ends has no successors.
        """
        choices = alone.model.choices
        leads = choices.applicable & ~alone.ends[:, None]  # in unused slots a state is its own target
        if not steps:
            return cls(len(choices), positions, (np.arange(len(choices)),))

        def and_executed(states: Ints) -> Ints:
            return np.union1d(states, alone.afterstate[states].ravel())

        def after(step: int, states: Ints) -> Ints:
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
    def step(self) -> Ints:
        """The step of each state, shape (m,); the last value stands for all later steps."""
        return np.repeat(np.arange(len(self.layers)), [self.positions * len(layer) for layer in self.layers])

    @cached_property
    def position(self) -> Ints:
        """The robot's position in each state, shape (m,)."""
        return np.concatenate([np.repeat(np.arange(self.positions), len(layer)) for layer in self.layers])

    @cached_property
    def x(self) -> Ints:
        """The task state of each state, shape (m,)."""
        return np.concatenate([np.tile(layer, self.positions) for layer in self.layers])

    @cached_property
    def cut(self) -> Bools:
        """Whether the problem is truncated at each state by `kept`, shape (m,)."""
        return np.zeros(len(self), dtype=bool) if self.kept is None else ~self.kept[self.step, self.x]

    @cached_property
    def _first(self) -> Ints:
        """The number of each task state at each step with the robot away; -1 where it does not exist."""
        first = np.full((len(self.layers), self.states), -1)
        before = 0
        for row, layer in zip(first, self.layers, strict=True):
            row[layer] = before + np.arange(len(layer))
            before += self.positions * len(layer)
        return first

    def number(self, step: ArrayLike, position: ArrayLike, x: ArrayLike) -> Ints:
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
      suggestions (1 and up). Where it takes no time, to come and say nothing is left out, as it is never better than to
      come with the first suggestion.
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

    meant: Ints
    then: Ints
    comes: Bools
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

    def count(self, position: Ints, alone: Ints) -> Ints:
        """Return the number of moves, shape (m,), where a robot that is always present has `alone` actions."""
        away = np.full_like(alone, 2) if self.entry_steps else alone
        return np.select([position == AWAY, position == HERE], [away, alone + 1], 1)
