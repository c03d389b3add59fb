"""One person's problem where the robot's attention has a price that changes over time.

A robot that serves K people is at one place at a time. Relaxing this couples the people no longer: each of
them has a robot of their own, which pays `price[t]` for every step t in which it is with them or on its way
(Lagrangian relaxation of a weakly coupled problem: Hawkins, "A Lagrangian decomposition approach to weakly coupled
dynamic optimization problems", 2003). Beside the task's state a person's problem then knows the step, and where
the robot is: away, on its way, or here. Coming costs what coming from the nearest other place does, and takes as
long. From the end of the prices on attention is free.

`Priced` holds the values where beta and theta are seen, an upper bound on what any policy gets in that problem.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from .human import Floats
from .mdp import Arrays, _order, _row
from .pomdp import AssistPOMDP

AWAY, HERE = 0, 1
"""Positions of the robot; those after these are on its way, with as many more steps to go as they are after."""


@dataclass(frozen=True)
class Priced:
    """Values of one person's problem with a price on attention, where beta and theta are seen.

    Attributes
    ----------
    pomdp : AssistPOMDP
    price : float array, shape (W,)
        What a step of the robot's attention costs, in cost units, for the steps from 0 on; then nothing.
    entry : float
        Cost of coming, in cost units.
    entry_steps : int
        How many steps that takes.
    value : float array, shape (W + 1, P, n, B, T)
        For each step (the last one: for all from W on), position of the robot and state.
    """

    pomdp: AssistPOMDP
    price: Floats
    entry: float
    entry_steps: int
    value: Floats
