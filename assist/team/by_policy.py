"""Data about the people of each policy that are computed on first use."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from typing import Generic, TypeVar

from ..person.policy import Policy

T = TypeVar("T")


class ByPolicy(Generic[T]):
    """Data for each of some policies for single people, computed on first use. Access is thread-safe.

    Parameters
    ----------
    policies : iterable of Policy
    work_out : callable
        Returns the data for a policy.
    """

    def __init__(self, policies: Iterable[Policy], work_out: Callable[[Policy], T]) -> None:
        # Policies are distinguished by identity. Keeping the object guarantees that its id is not reused.
        self._policies = {id(policy): (policy, threading.Lock()) for policy in policies}
        self._known: dict[int, T] = {}
        self._work_out = work_out

    def __getitem__(self, policy: Policy) -> T:
        number = id(policy)
        if number not in self._policies:
            raise ValueError("a policy for people whom this team policy was not made for; expected one of those given")
        if number not in self._known:
            with self._policies[number][1]:
                if number not in self._known:
                    self._known[number] = self._work_out(policy)
        return self._known[number]
