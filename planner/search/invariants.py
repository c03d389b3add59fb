"""What never changes in a task: pairs of facts that never hold together, and weighted sums of facts.

**Mutexes.** `Mutexes.of` computes the pairs of facts that may hold together. This is the least set of pairs that
contains those of the initial state and is closed under all moves (h^2 of Haslum and Geffner 2000, run to its fixed
point). All other pairs are *mutex*. Theorem: no reachable state contains a mutex pair. Proof: by induction, as the
initial state contains none, and the successors of a state without mutex pairs contain none. Consequently, a move that
needs two mutex facts is never applicable. Where a move is applicable, no fact holds that is mutex with a fact that it
needs.

**Linear invariants.** Definition: weights of all facts are an *invariant* if every move preserves the sum of the
weights of the facts that hold. The sum is then the same in all reachable states, by induction over the moves. Counters
are the usual example: the numbers of items in the box, on the tray and in the kit have a constant sum. Groups of which
exactly one fact holds are another. All invariants together are the left null space of the matrix of facts and moves.
Sums are taken modulo a prime, where arithmetic is exact and numbers stay small. The induction holds modulo a prime as
well.

A variable whose values have distinct weights in an invariant is determined by the other variables of that invariant.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..grounding.task import Task
from ..system.arrays import Ints, padded
from ..system.jit import njit
from ..system.limits import Check, unchecked
from .kernels.ranked_successors import PRIME
from .numbering import TNFOperator

STEPS_PER_CHECK = 1 << 21
"""Moves times facts between two checks of the limits."""


@dataclass(frozen=True)
class Mutexes:
    """Pairs of facts that may hold together, and moves that may be applicable.

    Facts are numbered across all variables.
    """

    first: Ints
    """Number of each variable's fact 0, shape (variables + 1,)."""
    together: NDArray[np.bool_]
    """Whether a pair of facts may hold together; on the diagonal, whether the fact may hold."""
    moves: list[TNFOperator]
    barred: NDArray[np.bool_]
    """Facts that cannot hold where a move is applied, since they are mutex with a fact that it needs: a row each."""

    @classmethod
    def of(cls, task: Task, moves: Sequence[TNFOperator], check: Check = unchecked) -> Mutexes | None:
        """Return the mutexes of a task; None if there are too many moves and facts to compute them.

        `check` is called with the number of bytes that the computation needs, before they are allocated.
        """
        most_work = 1 << 26  # limit on moves times facts, above which mutexes are not computed
        first = np.concatenate([[0], np.cumsum(task.sizes)])
        facts = int(first[-1])
        if len(moves) * facts > most_work:
            return None
        in_use = facts**2 + 2 * len(moves) * facts
        check(in_use)
        needs, gains, keeps = (
            padded([[int(first[v]) + value for v, value in facts.items()] for facts in side], -1)
            for side in (
                [move.facts for move in moves],
                [move.after for move in moves],
                [{v: value for v, value in move.facts.items() if v not in move.after} for move in moves],
            )
        )
        variable = np.repeat(np.arange(len(task.variables)), np.diff(first))
        together = np.zeros((first[-1], first[-1]), dtype=bool)
        initial = first[:-1] + np.asarray(task.initial)
        together[np.ix_(initial, initial)] = True
        possible = np.zeros(len(moves), dtype=bool)
        barred = np.zeros((len(moves), first[-1]), dtype=bool)
        step = STEPS_PER_CHECK // max(1, facts) + 1
        change = True
        while change:
            change = False
            for begin in range(0, len(moves), step):
                check(in_use)
                stop = min(begin + step, len(moves))
                change |= _close(needs, gains, keeps, variable, together, possible, begin, stop)
        for begin in range(0, len(moves), step):
            check(in_use)
            _bar(needs[begin : begin + step], variable, together, barred[begin : begin + step])
        left = [move for move, can in zip(moves, possible, strict=True) if can]
        return cls(first, together, left, barred[possible])


@njit(nogil=True, inner=True)
def _beside(together, facts, fact):
    """Whether a fact may hold together with each of the given facts, which end at the first negative entry."""
    for other in facts:
        if other < 0:
            break
        if not together[other, fact]:
            return False
    return True


@njit(nogil=True, inner=True)
def _add(together, facts, fact):
    """Record that a fact may hold together with each of the given facts."""
    for other in facts:
        if other < 0:
            break
        together[other, fact] = together[fact, other] = True


@njit(nogil=True, inner=True)
def _mark(marks, variable, facts, value):
    """Set the marks of the variables of the given facts."""
    for fact in facts:
        if fact < 0:
            break
        marks[variable[fact]] = value


@njit(nogil=True)
def _close(needs, gains, keeps, variable, together, possible, begin, stop):
    """Add the pairs that the moves `begin` to `stop` make possible; return whether anything was added."""
    facts = len(variable)
    fixed = np.zeros(variable.max() + 1 if facts else 0, dtype=np.bool_)
    change = False
    for m in range(begin, stop):
        if not possible[m]:
            can = True
            for fact in needs[m]:
                can = can and (fact < 0 or _beside(together, needs[m], fact))
            if not can:
                continue
            possible[m] = change = True
            for fact in gains[m]:
                if fact >= 0:
                    _add(together, gains[m], fact)
                    _add(together, keeps[m], fact)
        _mark(fixed, variable, needs[m], True)
        for fact in range(facts):
            may = not fixed[variable[fact]] and together[fact, fact]
            if may and not _beside(together, gains[m], fact) and _beside(together, needs[m], fact):
                change = True
                _add(together, gains[m], fact)
        _mark(fixed, variable, needs[m], False)
    return change


@njit(nogil=True)
def _bar(needs, variable, together, barred):
    """Mark the facts that are mutex with a fact that a move needs."""
    for m in range(len(needs)):
        for i in range(needs.shape[1]):
            if needs[m, i] < 0:
                break
            for f in range(len(variable)):
                if f != needs[m, i] and not together[needs[m, i], f]:
                    barred[m, f] = True


PRODUCTS_PER_CHECK = 1 << 28
"""Multiplications between two checks of the limits."""


@dataclass(frozen=True)
class Determined:
    """A variable that the others determine."""

    variable: int
    weights: Ints
    """Weights of the invariant, 0 to `PRIME` - 1, by fact; they are distinct for all values of the variable."""
    total: int
    """Sum of the weights of the facts that hold, modulo `PRIME`."""


def determined(task: Task, moves: Sequence[TNFOperator], check: Check = unchecked) -> list[Determined]:
    """Return variables that the others determine.

    Variables with many values that use up few invariants are preferred. Each one depends only on variables that are not
    in the result, or that precede it. `check` is called with the bytes of the invariants.
    """
    sizes = np.array(task.sizes)
    first = np.concatenate([[0], np.cumsum(sizes)])
    space = invariants(task, moves, check)
    in_use = 4 * space.nbytes  # the next space, and both in floating point
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
        # Variables that are chosen later precede it in the result, so they must not depend on it.
        space = _without(space, first, best, lambda: check(in_use))
        if not len(space):
            break
        ranks = _ranks(space, first, waiting, lambda: check(in_use))
    return found[::-1]


def invariants(task: Task, moves: Sequence[TNFOperator], check: Check = unchecked) -> Ints:
    """Return a basis of the invariants modulo `PRIME`, shape (n, facts), verified on every move.

    Variables that no move changes have weight zero.
    """
    # Limit on the steps of elimination (facts^2 times distinct changes), above which invariants are not computed.
    most_work = 1 << 32
    sizes = np.array(task.sizes)
    first = np.concatenate([[0], np.cumsum(sizes)])
    varying = np.zeros(len(sizes), dtype=bool)
    varying[[v for move in moves for v in move.after]] = True
    columns = np.flatnonzero(np.repeat(varying, sizes))
    facts = len(columns)
    different = {tuple((v, move.facts[v], value) for v, value in sorted(move.after.items())) for move in moves}
    if len(different) * facts**2 > most_work:
        return np.zeros((0, int(first[-1])), dtype=np.int64)
    in_use = 8 * int(first[-1]) * (3 * len(different) + 4 * facts)  # the basis has at most one row per column
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
    """Return how many invariants each variable would use up: the rank of its facts' relative weights."""
    ranks = {}
    for v in variables:
        check()
        ranks[v] = int((_reduced(_relative(space, first, v), lambda: None) >= 0).sum())
    return ranks


def _relative(space: Ints, first: Ints, variable: int) -> Ints:
    """Return the weights of a variable's other facts minus that of its first, shape (invariants, values - 1)."""
    own = space[:, first[variable] : first[variable + 1]]
    return (own[:, 1:] - own[:, :1]) % PRIME


def _telling(space: Ints, first: Ints, variable: int, rng: np.random.Generator) -> Ints | None:
    """Return an invariant with distinct weights for all values of a variable; None if none was found.

    Among suitable basis vectors, the one with the fewest variables is chosen. Otherwise random combinations are tried.
    """
    tries = 20  # random combinations of invariants that are tried before a variable counts as not determined
    own = np.sort(space[:, first[variable] : first[variable + 1]], axis=1)
    telling = space[(np.diff(own, axis=1) > 0).all(axis=1)]
    if len(telling):
        uneven = np.diff(telling, axis=1) != 0
        uneven[:, first[1:-1] - 1] = False  # between variables
        involved = np.add.reduceat(np.pad(uneven, ((0, 0), (0, 1))), first[:-1], axis=1) > 0
        return telling[involved.sum(axis=1).argmin()]
    for _ in range(tries):
        weights = rng.integers(PRIME, size=len(space)) @ space % PRIME
        own = weights[first[variable] : first[variable + 1]]
        if len(np.unique(own)) == len(own):
            return weights
    return None


def _without(space: Ints, first: Ints, variable: int, check: Callable[[], None]) -> Ints:
    """Return a basis of the invariants in which all values of a variable have the same weight."""
    return _product(_null_space(_relative(space, first, variable).T, check), space, check)


def _product(a: Ints, b: Ints, check: Callable[[], None]) -> Ints:
    """Return the product of two matrices modulo the prime.

    It is computed in floating point, which is fast. The result is exact, as sums stay below 2^53 for up to 10^8
    invariants.
    """
    product, factor = np.empty((len(a), b.shape[1]), dtype=np.int64), b.astype(np.float64)
    step = PRODUCTS_PER_CHECK // (b.size + 1) + 1
    for begin in range(0, len(a), step):
        check()
        product[begin : begin + step] = a[begin : begin + step].astype(np.float64) @ factor % PRIME
    return product


def _null_space(matrix: Ints, check: Callable[[], None]) -> Ints:
    """Return a basis of all x with matrix @ x = 0 modulo the prime, shape (n, columns)."""
    reduced = np.ascontiguousarray(matrix % PRIME)
    pivots = _reduced(reduced, check)
    rows = np.flatnonzero(pivots >= 0)
    free = np.setdiff1d(np.arange(matrix.shape[1]), pivots[rows])
    basis = np.zeros((len(free), matrix.shape[1]), dtype=np.int64)
    basis[np.arange(len(free)), free] = 1
    basis[:, pivots[rows]] = -reduced[rows][:, free].T % PRIME
    return basis


def _reduced(matrix: Ints, check: Callable[[], None]) -> Ints:
    """Reduce a matrix to row echelon form modulo the prime, in place; return each row's pivot column or -1."""
    pivots = np.full(len(matrix), -1, dtype=np.int64)
    step, top = PRODUCTS_PER_CHECK // (8 * matrix.size + 1) + 1, 0
    for column in range(0, matrix.shape[1], step):
        check()
        top = _reduce(matrix, pivots, top, column, min(column + step, matrix.shape[1]))
        if top == len(matrix):
            break
    return pivots


@njit(nogil=True)
def _reduce(matrix, pivots, top, begin, stop):
    """Eliminate the columns `begin` to `stop`. `top` is the number of rows with a pivot before; return it after."""
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
