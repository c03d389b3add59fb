"""Memory of problems and solutions, estimated before anything is allocated."""

from __future__ import annotations

from collections.abc import Sized

from planner import LimitError

from ..people.arguments import positive
from ..people.hidden_type import several
from .pomdp import AssistPOMDP
from .search import SolverOptions

MEMORY_LIMIT_MB = 4000.0
"""Default limit of the memory of all people's policies, and of all records of a simulation, in MB."""

ONE_FOR_ALL = "a smaller pool, one policy for all (knowledge 'exact'), or "


def require_room(what: str, needed: float, limit_mb: float, expected: str) -> None:
    """Raise a `LimitError` if something exceeds the memory limit.

    Parameters
    ----------
    what : str
        What takes the memory, with the verb, such as "8 people take".
    needed : float
        Bytes.
    limit_mb : float
        The limit in MB.
    expected : str
        What would take less.
    """
    if needed > positive("memory_limit_mb", limit_mb) * 1e6:
        raise LimitError(
            f"{what} about {needed / 1e6:,.0f} MB of memory, and {limit_mb:,.0f} MB are allowed; expected {expected}"
        )


def policy_bytes(states: int, *, slots: int = 1, actions: int = 2, betas: int = 6, thetas: int = 10) -> int:
    """Return the memory of a person's problem and its QMDP policy in bytes; a lower bound if only `states` is given.

    Parameters
    ----------
    states : int
    slots, actions : int
        Largest numbers of choices of the person, and of the robot, in a state.
    betas, thetas : int
        Size of the grid; by default that of `Grid.regular`.
    """
    # cost, afterstate and slot; `unsuggested`; the trust update
    hidden, of_a_robot = betas * thetas, 3 + betas + 2 * thetas
    return 8 * states * (1 + slots * (1 + betas) + actions * of_a_robot + (1 + actions) * hidden)


def states_within(limit_mb: float, goals: Sized, models: int) -> int:
    """Return the number of states of a truncated task for each goal, so that all policies are within the limit.

    Raises
    ------
    LimitError
        There would be fewer than 20 states for each goal.
    """
    of_a_state, least = 6_000, 20  # bytes: values with and without a robot that comes and goes, and choices
    of_all = of_a_state * len(goals) * (models + 1)
    them = f"{models:,} people{f' with {len(goals)} goals' * several(goals)}"
    what = f"policies for {them}, on as few as {least} states, take"
    require_room(what, of_all * least, limit_mb, f"{ONE_FOR_ALL}a higher memory limit")
    return int(limit_mb * 1e6 / of_all)


def first_bounds_bytes(pomdp: AssistPOMDP, depth: int = SolverOptions.depth) -> int:
    """Return the approximate memory, in bytes, that `solve` needs before its search begins."""
    slots, hidden = pomdp.model.choices.targets.shape[1], pomdp.prior.size
    states, actions = pomdp.suggested.shape
    # QMDP's values and a copy; the corners; vectors and witnesses of four policies; the values of one policy.
    return 8 * hidden * (states * (2 * actions + 12) + depth * (8 + actions * slots))


def depth_within(pomdp: AssistPOMDP, limit_mb: float) -> int:
    """Return the largest length of a trial, of 500, 250 and 125 steps, that leaves a fifth of the memory limit free."""
    depth = SolverOptions.depth
    while depth > 125 and first_bounds_bytes(pomdp, depth) > 0.8e6 * limit_mb:
        depth //= 2
    return depth
