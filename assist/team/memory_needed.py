"""Memory of people's problems and policies, estimated before anything is allocated."""

from __future__ import annotations

from planner import LimitError
from planner.system.machine import available_memory

from ..person.pomdp import AssistPOMDP
from .time_expansion import TimeExpansion


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


def require_room(alone: AssistPOMDP, layout: TimeExpansion) -> None:
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
