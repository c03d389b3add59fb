"""The people of each policy, and data about them that are computed on first use."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from itertools import pairwise
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..person.policy import Policy

T = TypeVar("T")


def by_model(model: NDArray[np.int64], rows: NDArray[np.int64], models: int) -> list[tuple[int, NDArray[np.int64]]]:
    """Return each model that occurs among some people, with the indices of its people.

    Parameters
    ----------
    model : int array, shape (N,)
        Model of each person.
    rows : int array, shape (m,)
        Indices of the people to consider.
    models : int
        Number of models.
    """
    if models == 1:  # no sorting is necessary
        return [(0, rows)] if len(rows) else []
    own = model[rows]
    order = own.astype(np.uint16 if models <= 2**16 else np.int64).argsort(kind="stable")  # fast for small numbers
    ends, grouped = np.bincount(own, minlength=models).cumsum().tolist(), rows[order]
    return [(number, grouped[at:end]) for number, (at, end) in enumerate(pairwise([0, *ends])) if at < end]


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
