"""Mutexes: pairs of facts that never hold together, and their consequences for a task's moves.

`Mutexes.of` computes the pairs of facts that may hold together. This is the least set of pairs that contains those of
the initial state and is closed under all moves (h^2 of Haslum and Geffner 2000, run to its fixed point). All other
pairs are *mutex*. Theorem: no reachable state contains a mutex pair. Proof: by induction, as the initial state contains
none, and the successors of a state without mutex pairs contain none. Consequently, a move that needs two mutex facts is
never applicable. Where a move is applicable, no fact holds that is mutex with a fact that it needs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..grounding.task import Task
from ..system.arrays import Ints, padded
from ..system.jit import njit
from ..system.limits import Check, unchecked
from .transition_normal_form import TNFOperator

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


@njit(nogil=True)
def _beside(together, facts, fact):
    """Whether a fact may hold together with each of the given facts, which end at the first negative entry."""
    for other in facts:
        if other < 0:
            break
        if not together[other, fact]:
            return False
    return True


@njit(nogil=True)
def _add(together, facts, fact):
    """Record that a fact may hold together with each of the given facts."""
    for other in facts:
        if other < 0:
            break
        together[other, fact] = together[fact, other] = True


@njit(nogil=True)
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
