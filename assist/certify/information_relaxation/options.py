"""The numbers that trade the tightness of a sampled bound for time and memory."""

from __future__ import annotations

from dataclasses import dataclass

from ...people.arguments import whole


@dataclass(frozen=True)
class RelaxationOptions:
    """Options of the information relaxation. The bound is valid for all values that are accepted.

    The defaults were chosen by mean bounds for four people on `kitting/paper` (c_suggest 0.5, gamma 0.99) over the same
    24 sample paths. All numbers below are of this team, in cost units.

    Attributes
    ----------
    alphas : tuple of float
        Candidates for the share alpha of U in the penalty, from 0 to 1 in ascending order. The choice begins at the
        middle one.
    path_share : float
        Share of the time that is reserved for the sample paths of the bound; the choice of alpha uses the rest.
    free_steps : int
        Number of steps after the last price in which the robot is still in one place at a time.
    max_expansions : int
        Limit of A* expansions per sample path, times the number of people. With a smaller limit, large alphas give
        loose bounds.
    rows_per_check : int
        Number of rows of the demand for attention that are computed between two checks of the time. The default takes
        about a second on tasks of millions of states.
    congestion_steps : int
        Number of steps from the beginning whose conflicts count in U; the weights of later ones are close to 0.
    steps_ahead : int
        Number of steps ahead whose conflicts count. With 22 steps the bound gains 0.001, for almost twice the memory.
    fading : float
        Factor of the weight of a conflict for each step ahead. With a factor of 1 the bounds were -54.55 +- 0.05 at the
        best alpha, 0.6, and -54.42 +- 0.09 at 0.8. With 0.9 they were -54.55 +- 0.04 and -54.59 +- 0.05, in half of the
        time. On 16 paths, at the best alpha, 0.95 was worse than 0.9 by 0.04, 0.8 by the same, and 0.6 by 0.13.
    full_weight_steps : int
        Number of steps from the beginning whose conflicts have the full weight.
    decay_steps : float
        Number of steps in which the weight of later conflicts falls by a factor of e. With full weights, the search on
        a sample path exceeds its limit. Without these conflicts, the penalty does not cover people who are still at
        work late. At the best alpha, the bound was -54.71 +- 0.04 without conflicts after 12 steps, and -54.80 +- 0.04
        with falling weights over 22 steps. With full weights over 22 steps, an alpha of 0.8 and a `fading` of 0.7, it
        was -53.7 +- 0.2.
    """

    alphas: tuple[float, ...] = (0.0, 0.2, 0.3, 0.45, 0.6, 0.7, 0.8)
    path_share: float = 0.5
    free_steps: int = 10
    max_expansions: int = 1_600_000
    rows_per_check: int = 1_000
    congestion_steps: int = 22
    steps_ahead: int = 12
    fading: float = 0.9
    full_weight_steps: int = 10
    decay_steps: float = 5.0

    def __post_init__(self) -> None:
        """Check the numbers on which the proof depends."""
        if not self.alphas or not all(0 <= alpha <= 1 for alpha in self.alphas):
            raise ValueError(f"alphas {self.alphas}: expected numbers from 0 to 1")
        if not 0 <= self.fading <= 1:
            raise ValueError(f"fading {self.fading:g}: expected 0 to 1")
        if not self.decay_steps > 0:
            raise ValueError(f"decay_steps {self.decay_steps:g}: expected more than 0")
        for name in ("free_steps", "congestion_steps", "steps_ahead", "full_weight_steps"):
            whole(name, getattr(self, name), 0)
