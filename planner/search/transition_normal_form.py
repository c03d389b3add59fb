"""Operators split into invertible moves (transition normal form), and groups of facts that they preserve.

Every operator is split by the old values of the variables that it changes, and by the conditions of its effects, into
*moves*. A move consists of facts that must hold, and the old and new value of each changed variable. It can therefore
be inverted, and the backward search needs no stored transitions. `exactly_one` proves for groups of facts that exactly
one of them holds in every reachable state.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ..grounding.task import Fact, Operator, Task
from ..system.limits import Check, unchecked


@dataclass(frozen=True)
class TNFOperator:
    """A ground action, restricted to the states in which `facts` hold."""

    action: int
    facts: dict[int, int]
    """Required values of variables, including every changed variable."""
    after: dict[int, int]
    """New values of the changed variables."""

    def inverse(self) -> TNFOperator:
        """Return the move in the opposite direction."""
        return TNFOperator(self.action, {**self.facts, **self.after}, {v: self.facts[v] for v in self.after})


def split_operators(task: Task, check: Check = unchecked) -> list[TNFOperator] | None:
    """Return the operators of a task, split into moves; None if there are too many moves.

    The moves of an action are mutually exclusive: if several of its operators are applicable, the first one counts.
    """
    sizes = task.sizes
    most = max(1 << 12, 4 * len(task.operators))  # a task with more moves is not ranked
    earlier: dict[int, list[Sequence[Fact]]] = {}
    moves: list[TNFOperator] = []
    in_use = 0  # bytes: an estimate of 200 for each move, and its facts
    for operator in task.operators:
        others = earlier.setdefault(operator.action, [])
        for move in _split(operator, others, sizes, check):
            moves.append(move)
            in_use += 200 + sys.getsizeof(move.facts) + sys.getsizeof(move.after)
            check(in_use)
            if len(moves) > most:
                return None
        others.append(operator.preconditions)
    return moves


def _split(
    operator: Operator, excluded: Sequence[Sequence[Fact]], sizes: Sequence[int], check: Check
) -> Iterator[TNFOperator]:
    """Yield the moves of an operator, except for states in which one of the excluded conditions holds."""
    facts = dict(operator.preconditions)
    if any(facts[variable] != value for variable, value in operator.preconditions):
        return  # contradictory
    waiting = [facts]
    while waiting:
        check(0)
        known = waiting.pop()
        undecided = _undecided(operator, excluded, known)
        if undecided is None:
            continue
        if undecided >= 0:
            waiting += [{**known, undecided: value} for value in range(sizes[undecided])]
            continue
        after: dict[int, int] = {}
        for effect in operator.effects:
            if all(known.get(variable) == value for variable, value in effect.conditions):
                after[effect.variable] = effect.value
        changes = {variable: value for variable, value in after.items() if known[variable] != value}
        yield TNFOperator(operator.action, known, changes)


def _undecided(operator: Operator, excluded: Sequence[Sequence[Fact]], known: dict[int, int]) -> int | None:
    """Return the next variable to split by; -1 if all is decided, None if an excluded condition holds."""
    for conditions in excluded:
        if all(known.get(variable, value) == value for variable, value in conditions):
            return next((variable for variable, _ in conditions if variable not in known), None)
    for effect in operator.effects:
        if all(known.get(variable, value) == value for variable, value in effect.conditions):
            for variable in (*(v for v, _ in effect.conditions), effect.variable):
                if variable not in known:
                    return variable
    return -1


def exactly_one(
    task: Task, moves: list[TNFOperator], check: Check = unchecked
) -> tuple[list[frozenset[Fact]], list[TNFOperator]]:
    """Return groups of facts of which exactly one holds in every reachable state, and the remaining moves.

    The candidates are the translator's mutex groups. A group is kept if exactly one of its facts holds initially, and
    no applicable move changes the number of its facts that hold. A move that needs two facts of a kept group is never
    applicable. Both conditions together prove the claim by induction over the moves.
    """
    groups = list(dict.fromkeys(map(frozenset, task.mutexes)))
    initial = set(enumerate(task.initial))
    groups = [group for group in groups if len(group & initial) == 1]
    while True:
        of_fact: dict[Fact, list[frozenset[Fact]]] = {}
        for group in groups:
            for fact in group:
                of_fact.setdefault(fact, []).append(group)
        possible: list[TNFOperator] = []
        broken: set[frozenset[Fact]] = set()
        for move in moves:
            check(0)
            needed = Counter(group for fact in move.facts.items() for group in of_fact.get(fact, ()))
            if any(count > 1 for count in needed.values()):
                continue
            possible.append(move)
            change: Counter[frozenset[Fact]] = Counter()
            for variable, value in move.after.items():
                change.update(of_fact.get((variable, value), ()))
                change.subtract(of_fact.get((variable, move.facts[variable]), ()))
            broken.update(group for group, number in change.items() if number)
        if not broken:
            return groups, possible
        groups = [group for group in groups if group not in broken]
