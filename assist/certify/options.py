"""Options of bounds on team policies."""

from __future__ import annotations

from dataclasses import dataclass, field

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
