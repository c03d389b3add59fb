"""Linear invariants: weighted numbers of facts that never change, and the variables that they determine.

A weight for every fact is an *invariant* if no move changes the sum of the weights of the facts that hold: then the
sum is the same in all reachable states. Counters are the usual case (what lies in the box, on the tray and in the
kit is as much as there was), groups of which exactly one fact holds another. All of them together are the left null
space of the matrix of facts and moves. Sums are taken modulo a prime, in which all arithmetic is exact and small; an
invariant modulo a prime is a theorem as much as one of integers.

A variable whose values have different weights in an invariant follows from the other variables of that invariant.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...grounding.task import Task
from ...states.packing import Ints
from ...system.jit import njit
from ...system.limits import Check, unchecked
from ..kernels.unranking import PRIME
from .transition_normal_form import TNFOperator

MOST_WORK = 1 << 32
"""Steps of elimination (facts^2 times distinct changes), beyond which invariants are not looked for."""

AT_ONCE = 1 << 28
"""Products of two numbers between two checks of the limits."""

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


def determined(task: Task, moves: Sequence[TNFOperator], check: Check = unchecked) -> list[Determined]:
    """Choose variables that the others determine.

    Large variables that take few invariants are preferred. Each depends on variables that are not among those chosen
    or that come before it in the result. The bytes that are checked are those of the invariants.
    """
    sizes = np.array([len(variable.facts) for variable in task.variables])
    first = np.concatenate([[0], np.cumsum(sizes)])
    space = invariants(task, moves, check)
    in_use = 4 * space.nbytes  # the next space, and both of them in floating point
    rng = np.random.default_rng(0)
    found: list[Determined] = []
    waiting = sorted({v for move in moves for v in move.after})
    ranks = _ranks(space, first, waiting, lambda: check(in_use))
    while True:
        best = max(
            (v for v in waiting if ranks[v]),
            key=lambda v: (np.log(sizes[v]) / ranks[v], sizes[v], -v),
            default=None,
        )
        if best is None:
            break
        waiting.remove(best)
        weights = _telling(space, first, best, rng)
        if weights is None:
            continue
        initial = int(weights[first[:-1] + np.asarray(task.initial)].sum() % PRIME)
        found.append(Determined(best, weights, initial))
        # Those that are chosen later come before it, so that they may not depend on it.
        space = _without(space, first, best, lambda: check(in_use))
        if not len(space):
            break
        ranks = _ranks(space, first, waiting, lambda: check(in_use))
    return found[::-1]


def invariants(task: Task, moves: Sequence[TNFOperator], check: Check = unchecked) -> Ints:
    """Give a basis of the invariants modulo `PRIME`, shape (n, facts), each checked against every move.

    Variables that no move changes weigh nothing in them.
    """
    sizes = np.array([len(variable.facts) for variable in task.variables])
    first = np.concatenate([[0], np.cumsum(sizes)])
    varying = np.zeros(len(sizes), dtype=bool)
    varying[[v for move in moves for v in move.after]] = True
    columns = np.flatnonzero(np.repeat(varying, sizes))
    facts = len(columns)
    different = {tuple((v, move.facts[v], value) for v, value in sorted(move.after.items())) for move in moves}
    if len(different) * facts**2 > MOST_WORK:
        return np.zeros((0, int(first[-1])), dtype=np.int64)
    in_use = 8 * int(first[-1]) * (3 * len(different) + 4 * facts)  # the basis may have a row for each column
    check(in_use)
    changes = np.zeros((len(different), int(first[-1])), dtype=np.int64)
    for row, changed in zip(changes, different, strict=True):
        for v, before, after in changed:
            row[first[v] + before], row[first[v] + after] = -1, 1
    basis = _null_space(changes[:, columns], lambda: check(in_use))
    assert not _product(changes[:, columns], basis.T, lambda: check(in_use)).any()
    space = np.zeros((len(basis), int(first[-1])), dtype=np.int64)
    space[:, columns] = basis
    return space


def _ranks(space: Ints, first: Ints, variables: Sequence[int], check: Callable[[], None]) -> dict[int, int]:
    """Return how many invariants it takes to determine each of some variables: the rank of its facts' weights."""
    ranks = {}
    for v in variables:
        check()
        ranks[v] = int((_reduced(_relative(space, first, v), lambda: None) >= 0).sum())
    return ranks


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


def _without(space: Ints, first: Ints, variable: int, check: Callable[[], None]) -> Ints:
    """Combine invariants to those in which all values of a variable have the same weight."""
    return _product(_null_space(_relative(space, first, variable).T, check), space, check)


def _product(a: Ints, b: Ints, check: Callable[[], None]) -> Ints:
    """Return the product of two matrices modulo the prime.

    It is taken in floating point, where that is fast: exact, as sums stay below 2^53 for 10^8 invariants.
    """
    product, factor = np.empty((len(a), b.shape[1]), dtype=np.int64), b.astype(np.float64)
    step = AT_ONCE // (b.size + 1) + 1
    for begin in range(0, len(a), step):
        check()
        product[begin : begin + step] = a[begin : begin + step].astype(np.float64) @ factor % PRIME
    return product


def _null_space(matrix: Ints, check: Callable[[], None]) -> Ints:
    """Give a basis of all x with matrix @ x = 0 modulo the prime, shape (n, columns)."""
    reduced = np.ascontiguousarray(matrix % PRIME)
    pivots = _reduced(reduced, check)
    rows = np.flatnonzero(pivots >= 0)
    free = np.setdiff1d(np.arange(matrix.shape[1]), pivots[rows])
    basis = np.zeros((len(free), matrix.shape[1]), dtype=np.int64)
    basis[np.arange(len(free)), free] = 1
    basis[:, pivots[rows]] = -reduced[rows][:, free].T % PRIME
    return basis


def _reduced(matrix: Ints, check: Callable[[], None]) -> Ints:
    """Bring a matrix to reduced row echelon form modulo the prime, in place; give each row's pivot column or -1."""
    pivots = np.full(len(matrix), -1, dtype=np.int64)
    step, top = AT_ONCE // (8 * matrix.size + 1) + 1, 0
    for column in range(0, matrix.shape[1], step):
        check()
        top = _reduce(matrix, pivots, top, column, min(column + step, matrix.shape[1]))
        if top == len(matrix):
            break
    return pivots


@njit(nogil=True)
def _reduce(matrix, pivots, top, begin, stop):
    """Clear the columns `begin` to `stop` but for their pivots; `top` rows have one before, and so many after."""
    rows, columns = matrix.shape
    for column in range(begin, stop):
        if top == rows:
            break
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
    return top
