"""The rows of many people, each in the problem of their policy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Ints
from .policy import Policy
from .pomdp import AssistPOMDP


def by_model(model: Ints, people: Ints, models: int) -> list[tuple[int, Ints]]:
    """Return each model that occurs among some people, with the indices of its people.

    Parameters
    ----------
    model : int array, shape (N,)
        Model of each person.
    people : int array, shape (m,)
        Indices of those to consider.
    models : int
        Number of models.
    """
    if models == 1:  # no sorting is necessary
        return [(0, people)] if len(people) else []
    own = model[people]
    order = own.astype(np.uint16 if models <= 2**16 else np.int64).argsort(kind="stable")  # fast for small numbers
    ends, grouped = np.bincount(own, minlength=models).cumsum().tolist(), people[order]
    return [(number, grouped[at:end]) for number, (at, end) in enumerate(pairwise([0, *ends])) if at < end]


class RowsOfPeople:
    """The rows of people in the problems of their policies; it holds those that it was asked for last.

    Where all problems have all rows from the start, people are not grouped by their policies.

    Parameters
    ----------
    policies : sequence of Policy
    model : int array, shape (N, K)
        Index of each person's policy.
    """

    def __init__(self, policies: Sequence[Policy], model: Ints) -> None:
        self.policies, self.model = policies, model
        self._grows = np.array([not policy.problem.whole for policy in policies])
        self._in_all = dict[Callable[..., Any], NDArray[Any]]()

    def rows(self, situations: Ints, active: Ints) -> Ints:
        """Return the row of each person, shape (N, K); of people who are not active, any row.

        Parameters
        ----------
        situations : int array, shape (N, K)
        active : int array
            Active people, as indices of the flattened `situations`.
        """
        if not self._grows.any():
            return situations
        found, grows = situations.reshape(-1).copy(), self._grows[self.model].reshape(-1)
        found[grows] = 0
        for number, flat in by_model(self.model.reshape(-1), active[grows[active]], len(self.policies)):
            found[flat] = self.policies[number].rows(situations.reshape(-1)[flat], self)
        return found.reshape(situations.shape)

    def numbered(self, situations: Ints) -> Ints:
        """Return a number below `Extent.states` for each person's situation, shape (N, K)."""
        found = situations.copy()
        if self._grows.any():
            for number, flat in by_model(self.model.reshape(-1), np.arange(found.size), len(self.policies)):
                found.reshape(-1)[flat] = self.policies[number].problem.states(found.reshape(-1)[flat])
        return found

    @cached_property
    def _first_row(self) -> Ints:
        """The first row of each problem, if those of all are joined."""
        return np.cumsum([0, *(len(policy.pomdp.robot_actions) for policy in self.policies[:-1])])

    def data(self, what: Callable[[AssistPOMDP, Ints], NDArray[Any]], rows: Ints, active: Ints) -> NDArray[Any]:
        """Return what holds in the row of each person, shape (N, K, ...); of people who are not active, anything.

        Parameters
        ----------
        what : callable
            Returns it for some rows of a problem, always the same.
        rows : int array, shape (N, K)
            As from `rows`.
        active : int array
            As in `rows`.
        """
        if not self._grows.any():
            if what not in self._in_all:
                every = [policy.pomdp for policy in self.policies]
                self._in_all[what] = np.concatenate([what(one, np.arange(len(one.robot_actions))) for one in every])
            return self._in_all[what][self._first_row[self.model] + rows]
        found = what(self.policies[0].pomdp, np.zeros(1, dtype=np.int64))
        found = np.zeros((rows.size, *found.shape[1:]), dtype=found.dtype)
        for number, flat in by_model(self.model.reshape(-1), active, len(self.policies)):
            found[flat] = what(self.policies[number].pomdp, rows.reshape(-1)[flat])
        return found.reshape(*rows.shape, *found.shape[1:])
