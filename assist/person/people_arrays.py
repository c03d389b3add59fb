"""People as arrays: where they are, and how they choose, in the form that compiled code reads."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..people.decision import NOTHING, Floats, Ints
from .pomdp import AssistPOMDP
from .problem_arrays import read_only


# numba accepts and caches compiled code for named tuples of arrays, but not for dataclasses.
class PeopleArrays(NamedTuple):
    """The state of N people; every array has one entry per person and is changed in place.

    Attributes
    ----------
    x : int array, shape (N,)
        Row.
    heard : int array, shape (N,)
        The robot action that the person heard; 0 is nothing.
    who : int array, shape (N,)
        Number of the person in `Minds`, which has their choices; it tells their goal, too.
    theta : float array, shape (N,)
    outcomes : int array, shape (N,)
        Number of outcomes of suggestions that the person has seen, if the trust rule counts them.
    uniform : float array, shape (N, 2)
        Uniform numbers in [0, 1): for the choice, and for the grid point of theta.
    slot : int array, shape (N,)
        Slot of the person's choice; -1 if the robot's execution has reached the goal.
    cost : float array, shape (N,)
        Cost of the choice.
    """

    x: Ints
    heard: Ints
    who: Ints
    theta: Floats
    outcomes: Ints
    uniform: Floats
    slot: Ints
    cost: Floats

    @classmethod
    def of_teams(
        cls, x: Ints, heard: Ints, who: Ints, theta: Floats,
        outcomes: Ints, uniform: Floats,
    ) -> PeopleArrays:  # fmt: skip
        """Return flat views of teams' arrays, of shape (N, K, ...) in C order, with one person after the other."""
        return cls(
            x.reshape(-1), heard.reshape(-1), who.reshape(-1), theta.reshape(-1), outcomes.reshape(-1),
            uniform.reshape(-1, 2), np.full(x.size, NOTHING), np.zeros(x.size),
        )  # fmt: skip


class Minds(NamedTuple):
    """The choices of people, each of whom pursues a goal, and the values that their trust depends on.

    Attributes
    ----------
    goal : int array, shape (m,)
        Number of the goal.
    p : float array, shape (m, n, A)
        Probability of each choice without a suggestion.
    value : float array, shape (m, n)
        Perceived values V(x) of equation 7.
    eta : float
        Rate of the trust update, divided by the unit of value.
    lapse : float
        Probability of a uniform choice.
    on_grid : bool
        Whether theta moves between grid points at random, as in the robot's model.
    """

    goal: Ints
    p: Floats
    value: Floats
    eta: float
    lapse: float
    on_grid: bool

    @classmethod
    def of_model(cls, pomdp: AssistPOMDP) -> Minds:
        """Return the people of the robot's model of one, by their type."""
        return cls(
            read_only(pomdp.hidden.goal_of), np.ascontiguousarray(np.moveaxis(pomdp.chosen, 2, 0)), np.empty((0, 0)),
            eta=0.0, lapse=float(pomdp.model.lapse), on_grid=True,
        )  # fmt: skip
