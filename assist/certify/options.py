"""Options of bounds on team policies: what a bound may take, and what trades its tightness for time and memory."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypedDict

from .information_relaxation.options import RelaxationOptions


@dataclass(frozen=True)
class BoundOptions:
    """Options of `upper_bound` that trade the tightness of the bound for time and memory. It is valid for all values.

    Attributes
    ----------
    price_rounds : int
        Number of subgradient steps in the optimisation of prices. The result is the mean over the last half of them,
        which averages the noise out.
    price_episodes : int
        Number of simulated episodes of each person's problem per round. More give less noise and take longer.
    priced_steps : int
        Default limit of the number of steps with prices on truncated tasks, as the number of states grows with it.
    price_memory_mb : float
        Memory for each person's problem below which prices on truncated tasks are not optimised, in MB. Prices need the
        outer relaxation, which is kept in memory as well.
    belief_episodes : int
        Episodes of the priority policy whose beliefs are recorded for the sample-path bound. With 1,000, the beliefs
        about people without attention for long are still divided too finely, which loosens the bound.
    relaxation : RelaxationOptions
        Options of the bound from sample paths.
    """

    price_rounds: int = 40
    price_episodes: int = 2048
    priced_steps: int = 20
    price_memory_mb: float = 500.0
    belief_episodes: int = 10_000
    relaxation: RelaxationOptions = field(default_factory=RelaxationOptions)


class Effort(TypedDict, total=False):
    """How tight `upper_bound` is to be, and what it may take. Each entry has a default; it is valid for all values.

    Attributes
    ----------
    window : int or None
        Number of steps with prices; by default that of `priced_steps.window_of`. On truncated tasks the default is at
        most `options.priced_steps`, and less if the memory is short.
    gap : float
        Relative gap to which each subproblem is solved; 0.001 by default.
    paths : int
        Number of sample paths that tighten the bound; with 0, the default, the bound holds with certainty. They are
        useful for teams of up to about six people. A time limit reduces the number before the first one is drawn. If
        the time is not enough after all, or if everybody has a robot, there is no bound from them.
    time_limit : float or None
        Seconds in total; none by default. At most 40 % of the time is for prices; each subproblem then gets an equal
        share of the rest. On truncated tasks, 30 % are for the outer relaxations and 25 % for prices. With sample
        paths, half of the time is for these. Work on the first bounds is not interrupted, and the bound is valid after
        any time.
    memory_limit_mb : float
        Memory of all subproblems in MB, which is estimated before they are built; the solutions of those that are
        solved at a time may take as much again each.
    jobs : int or None
        Number of subproblems and of sample paths that are processed at a time; by default the number of processors.
    options : BoundOptions or None
    """

    window: int | None
    gap: float
    paths: int
    time_limit: float | None
    memory_limit_mb: float
    jobs: int | None
    options: BoundOptions | None
