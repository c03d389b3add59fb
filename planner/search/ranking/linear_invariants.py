"""Linear invariants: weighted numbers of facts that never change, and the variables that they determine.

A weight for every fact is an *invariant* if no move changes the sum of the weights of the facts that hold: then the
sum is the same in all reachable states. Counters are the usual case (what lies in the box, on the tray and in the
kit is as much as there was), groups of which exactly one fact holds another. All of them together are the left null
space of the matrix of facts and moves. Sums are taken modulo a prime, in which all arithmetic is exact and small; an
invariant modulo a prime is a theorem as much as one of integers.

A variable whose values have different weights in an invariant follows from the other variables of that invariant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...grounding.task import Task
from ...states.packing import Ints
from ...system.jit import njit
from ..kernels.unranking import PRIME
from .transition_normal_form import TNFOperator

MOST_WORK = 1 << 32
"""Steps of elimination (facts^2 times distinct changes), beyond which invariants are not looked for."""

TRIES = 20
"""Combinations of invariants that are tried before a variable is taken as not determined."""


@dataclass(frozen=True)
class Determined:
    """A variable that follows from the others.

    Attributes
    ----------
    variable : int
    weights : int64 array, shape (facts,)
        The invariant's weights, 0 to `PRIME` - 1; all values of the variable have different ones.
    total : int
        The sum of the weights of the facts that hold, modulo `PRIME`.
    """

    variable: int
    weights: Ints
    total: int


def determined(task: Task, moves: Sequence[TNFOperator]) -> list[Determined]:
    """Choose variables that the others determine.

    Large variables that take few invariants are preferred. Each depends on variables that are not among those chosen
    or that come before it in the result.
    """
    sizes = np.array([len(variable.facts) for variable in task.variables])
    first = np.concatenate([[0], np.cumsum(sizes)])
    space = invariants(task, moves)
    rng = np.random.default_rng(0)
    found: list[Determined] = []
    # What it takes to determine a variable: the rank of its facts' weights, relative to its first fact.
    waiting = {v: _relative(space, first, v) for v in range(len(sizes)) if sizes[v] > 1}
    ranks = {v: _rank(own) for v, own in waiting.items()}
    while True:
        best = max(
            (v for v in waiting if ranks[v]),
            key=lambda v: (np.log(sizes[v]) / ranks[v], sizes[v], -v),
            default=None,
        )
        if best is None:
            break
        weights = _telling(space, first, best, rng)
        del waiting[best]
        if weights is None:
            continue
        initial = int(weights[first[:-1] + np.asarray(task.initial)].sum() % PRIME)
        found.append(Determined(best, weights, initial))
        # Those that are chosen later come before it, so that they may not depend on it.
        space = _without(space, first, best)
        if not len(space):
            break
        waiting = {v: _relative(space, first, v) for v in waiting}
        ranks = {v: _rank(own) for v, own in waiting.items()}
    return found[::-1]


def invariants(task: Task, moves: Sequence[TNFOperator]) -> Ints:
    """Give a basis of all invariants modulo `PRIME`, shape (n, facts), each checked against every move."""
    first = np.concatenate([[0], np.cumsum([len(variable.facts) for variable in task.variables])])
    changes = np.zeros((len(moves), int(first[-1])), dtype=np.int64)
    for row, move in zip(changes, moves, strict=True):
        for v, value in move.after.items():
            row[first[v] + value] += 1
            row[first[v] + move.facts[v]] -= 1
    changes = np.unique(changes, axis=0)
    if len(changes) * int(first[-1]) ** 2 > MOST_WORK:
        return np.zeros((0, int(first[-1])), dtype=np.int64)
    basis = _null_space(changes % PRIME)
    assert not (changes @ basis.T % PRIME).any()
    return basis


def _relative(space: Ints, first: Ints, variable: int) -> Ints:
    """Weights of a variable's facts but the first, less the first's, shape (invariants, values - 1)."""
    own = space[:, first[variable] : first[variable + 1]]
    return (own[:, 1:] - own[:, :1]) % PRIME


def _telling(space: Ints, first: Ints, variable: int, rng: np.random.Generator) -> Ints | None:
    """Find an invariant in which all values of a variable have different weights; None if none was found.

    Of single invariants that do, the one with the fewest variables is taken; otherwise combinations are tried.
    """
    own = np.sort(space[:, first[variable] : first[variable + 1]], axis=1)
    telling = space[(np.diff(own, axis=1) > 0).all(axis=1)]
    if len(telling):
        uneven = np.diff(telling, axis=1) != 0
        uneven[:, first[1:-1] - 1] = False  # between variables
        involved = np.add.reduceat(np.pad(uneven, ((0, 0), (0, 1))), first[:-1], axis=1) > 0
        return telling[involved.sum(axis=1).argmin()]
    for _ in range(TRIES):
        weights = rng.integers(PRIME, size=len(space)) @ space % PRIME
        own = weights[first[variable] : first[variable + 1]]
        if len(np.unique(own)) == len(own):
            return weights
    return None


def _without(space: Ints, first: Ints, variable: int) -> Ints:
    """Combine invariants to those in which all values of a variable have the same weight."""
    left = _null_space(_relative(space, first, variable).T)
    # In floating point, where products of matrices are fast: exact, as sums stay below 2^53 for 10^8 invariants.
    product = left.astype(np.float64) @ space.astype(np.float64)
    return np.asarray((product % PRIME).astype(np.int64))


def _rank(matrix: Ints) -> int:
    return int((_reduce(matrix.copy()) >= 0).sum())


def _null_space(matrix: Ints) -> Ints:
    """Give a basis of all x with matrix @ x = 0 modulo the prime, shape (n, columns)."""
    reduced = np.ascontiguousarray(matrix % PRIME)
    pivots = _reduce(reduced)
    rows = np.flatnonzero(pivots >= 0)
    free = np.setdiff1d(np.arange(matrix.shape[1]), pivots[rows])
    basis = np.zeros((len(free), matrix.shape[1]), dtype=np.int64)
    basis[np.arange(len(free)), free] = 1
    basis[:, pivots[rows]] = -reduced[rows][:, free].T % PRIME
    return basis


@njit()
def _reduce(matrix):
    """Bring a matrix to reduced row echelon form modulo the prime, in place; give each row's pivot column or -1."""
    rows, columns = matrix.shape
    pivots = np.full(rows, -1, dtype=np.int64)
    top = 0
    for column in range(columns):
        at = top
        while at < rows and matrix[at, column] == 0:
            at += 1
        if at == rows:
            continue
        if at != top:
            for c in range(columns):
                matrix[at, c], matrix[top, c] = matrix[top, c], matrix[at, c]
        inverse, power, exponent = 1, matrix[top, column], PRIME - 2  # Fermat
        while exponent:
            if exponent & 1:
                inverse = inverse * power % PRIME
            power = power * power % PRIME
            exponent >>= 1
        for c in range(columns):
            matrix[top, c] = matrix[top, c] * inverse % PRIME
        for r in range(rows):
            factor = matrix[r, column]
            if r != top and factor:
                for c in range(column, columns):
                    matrix[r, c] = (matrix[r, c] - factor * matrix[top, c]) % PRIME
        pivots[top] = column
        top += 1
        if top == rows:
            break
    return pivots
