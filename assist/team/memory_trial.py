"""The trial of a user's policy that tells whether it chooses by the state that it receives alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..people.user_code import UserCodeError
from .episodes import Episodes
from .policies import UserPolicy
from .state import TeamAction, TeamPolicy, TeamState

PART = 8
"""Episodes that are simulated together in a part of a trial."""


class _Twice:
    """A policy that is called twice for each decision, and whether both choices ever differed."""

    def __init__(self, policy: TeamPolicy) -> None:
        self._policy, self.differs = policy, False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._policy, name)

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Return the first choice."""
        first, second = self._policy(team), self._policy(team)
        self.differs |= not _same(first, second)
        return first


def _same(one: Any, other: Any) -> bool:
    """Return whether robots go to the same people and do the same there; a simulation tells what is no choice."""
    if not (isinstance(one, TeamAction) and isinstance(other, TeamAction)):
        return True
    arrays: list[Any] = [one.person, one.action, other.person, other.action]
    if not all(isinstance(array, np.ndarray) and array.shape == np.shape(one.person) for array in arrays):
        return True
    goes = one.person >= 0
    return np.array_equal(one.person, other.person) and np.array_equal(one.action[goes], other.action[goes])


Again = Callable[[TeamPolicy, Sequence[int]], Episodes]
"""Simulates some episodes, given by their numbers, with a policy."""


def fault_of_memory(policy: TeamPolicy, again: Again, episodes: int) -> str | None:
    """Return what is wrong with a policy that remembers former calls, or draws random numbers; None if nothing is.

    Parameters
    ----------
    policy : callable
    again : callable
    episodes : int
        Number of episodes that are simulated, together and in parts.
    """
    every, twice = range(episodes), _Twice(policy)
    together = again(twice, every).discounted_return
    if twice.differs:
        return (
            "chooses otherwise when it is called again in the same state; expected the same choice, without memory of "
            "former calls and without random numbers"
        )
    parts = [again(policy, every[first : first + PART]).discounted_return for first in range(0, episodes, PART)]
    if not (together != np.concatenate(parts)).any():
        return None
    if (together != again(policy, every).discounted_return).any():
        return (
            "leads to other episodes when the same are simulated again; expected the same choice in the same state, "
            "without memory of former calls and without random numbers"
        )
    return (
        "chooses otherwise for a team when other teams are simulated with it; expected each row by itself, without "
        "memory of former calls, in which rows were other teams"
    )


def require_no_memory(policy: TeamPolicy, again: Again, places: int) -> None:
    """Refuse a function in a user's file that remembers former calls: its results depend on which teams are together.

    It is tried once in teams of a size. Other callables are taken as they are. What else is wrong with it is said by
    the simulation itself, of the teams that were asked for.

    Raises
    ------
    UserCodeError
    """
    if not isinstance(policy, UserPolicy) or places in policy.tried:
        return
    try:
        fault = fault_of_memory(replace(policy, tried={places}), again, 3 * PART)
    except UserCodeError:
        return
    if fault is not None:
        raise UserCodeError(f"{policy.source}: {policy.name} {fault}", code=policy)
    policy.tried.add(places)
