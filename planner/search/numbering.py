"""When states are numbered by rank, and when by layer; `state_space` states the rule. Ranks are by single variables.

Every operator is split by the old values of the variables that it changes, and by the conditions of its effects, into
*moves* (transition normal form). A move consists of facts that must hold, and the old and new value of each changed
variable. It can therefore be inverted, and the backward search needs no stored transitions. `exactly_one` proves for
groups of facts that exactly one of them holds in every reachable state.

`Digits` says which variables are digits of a rank, and in which order. Variables that such groups imply are left out.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from ..grounding.task import Fact, Operator, Task
from ..system.errors import UnsuitedError
from ..system.limits import Budget, Check, MemoryLimitError, unchecked
from .sorted_space import MOST_STATES


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


LOOKING = "a ranking was looked for"
"""Phase in messages about limits: the construction of a ranking."""

TOO_MUCH_MEMORY = "looking for a ranking took too much memory"
"""Why a task has no ranking."""

MANY = 1 << 33
"""Number of ranks above which the dense ranking is tried: a bitmap of this size takes 1 GB."""

Sum = tuple[int, dict[Fact, int]]
"""An affine sum over facts: a constant, and the coefficient of each fact (1 where it holds, else 0)."""


def _implied(sizes: Sequence[int], groups: Iterable[frozenset[Fact]], check: Check) -> dict[Fact, Sum]:
    """Choose variables to leave out, and express each of their facts by facts of the other variables.

    A fact has the value 1 where it holds and 0 elsewhere. A variable needs one group for all but one of its values, so
    that variables with few values are tried first.
    """
    sums: dict[Fact, Sum] = {}
    needed: set[int] = set()  # variables that occur in the sums of chosen ones
    by_fact: dict[Fact, list[frozenset[Fact]]] = {}
    for group in groups:
        variables = Counter(v for v, _ in group)
        for fact in group:
            if variables[fact[0]] == 1:
                by_fact.setdefault(fact, []).append(group)
    for variable in sorted(range(len(sizes)), key=lambda v: (sizes[v], v)):
        check(0)
        if variable in needed:
            continue
        own: dict[Fact, Sum] = {}
        price: dict[Fact, int] = {}  # number of additional variables that would be needed
        for fact in ((variable, value) for value in range(sizes[variable])):
            for group in by_fact.get(fact, ()):
                candidate = _one_minus([sums.get(f, (0, {f: 1})) for f in group - {fact}])
                more = len({v for v, _ in candidate[1]} - needed)
                if more < price.get(fact, len(sizes)):
                    own[fact], price[fact] = candidate, more
        if len(own) < sizes[variable] - 1:
            continue
        if len(own) == sizes[variable]:  # one sum is superfluous
            del own[max(price, key=lambda fact: (price[fact], fact))]
        rest = next(value for value in range(sizes[variable]) if (variable, value) not in own)
        own[variable, rest] = _one_minus(list(own.values()))
        sums.update(own)
        needed.update(v for _, terms in own.values() for v, _ in terms)
    return sums


def _one_minus(sums: Sequence[Sum]) -> Sum:
    """Return one minus the sum of the given sums."""
    terms: Counter[Fact] = Counter()
    for _, own in sums:
        terms.subtract(own)
    return 1 - sum(constant for constant, _ in sums), {fact: n for fact, n in terms.items() if n}


@dataclass(frozen=True)
class Digits:
    """The variables whose values are the digits of a rank, the lowest first."""

    implied: dict[Fact, Sum]
    """Facts of variables that are left out, as sums over facts of the digits."""
    variables: tuple[int, ...]
    size: int
    """Upper bound on all ranks, exclusive."""
    stride: tuple[int, ...]
    """Factor of each variable's value in the rank; 0 for those that are left out."""

    @classmethod
    def of(
        cls, task: Task, groups: Sequence[frozenset[Fact]], moves: Sequence[TNFOperator], check: Check = unchecked
    ) -> Digits:
        """Return the digits of the states of a task."""
        sizes = task.sizes
        implied = _implied(sizes, groups, check)
        # Blocks of states are sorted by rank. Variables that are tested often should change rarely, so they come last.
        uses = Counter(v for move in moves for v in move.facts)
        variables = sorted((v for v in range(len(sizes)) if (v, 0) not in implied), key=lambda v: (uses[v], v))
        stride, size = [0] * len(sizes), 1
        for v in variables:
            stride[v] = size if sizes[v] > 1 else 0
            size *= sizes[v]
        return cls(implied, tuple(variables), size, tuple(stride))


def moves_and_groups(task: Task, budget: Budget) -> tuple[list[TNFOperator], list[frozenset[Fact]]]:
    """Return the moves of a task, and groups of facts of which exactly one always holds; else an `UnsuitedError`."""
    if any(variable.axiom_layer >= 0 for variable in task.variables):
        raise UnsuitedError("it has derived variables")
    try:
        moves = split_operators(task, budget.during("operators were split"))
        if moves is None:
            raise UnsuitedError("its operators split into very many moves")
        groups, moves = exactly_one(task, moves, budget.during(LOOKING))
    except (MemoryLimitError, MemoryError):
        raise UnsuitedError(TOO_MUCH_MEMORY) from None
    return moves, groups


@dataclass(frozen=True)
class SweepOptions:
    """Options of how a sweep numbers the states. They affect its time and memory, but not the table.

    Attributes
    ----------
    small_states : int
        Number of states up to which the readable search is used; the compiled search gives the same numbers.
    small_bitmap : int
        Number of ranks up to which nothing else than the ranked search is tried. The bitmap of so many takes 64 MB.
    transitions_per_pair, most_transitions : int
        Transitions that are enumerated before a denser ranking is sought: so many per pair of a move and a fact, as the
        time for seeking it grows with their number, but at most `most_transitions`.
    ranks_per_transition : int
        If a bitmap would be larger, one transition for so many ranks is enumerated first, in case that the bitmap would
        be sparse.
    ranking_share : float
        Share of the remaining time for the search of a denser ranking. After that, the best ranking so far is used, if
        any.
    """

    small_states: int = MOST_STATES
    small_bitmap: int = 1 << 29
    transitions_per_pair: int = 4
    most_transitions: int = 1 << 22
    ranks_per_transition: int = 1 << 14
    ranking_share: float = 0.25

    def most_by_layer(self, task: Task, moves: int, ranks: float) -> float:
        """Return the number of transitions from which a task with so many moves and ranks is not numbered by layer."""
        if ranks <= self.small_bitmap:
            return 0
        if ranks > MANY:
            return min(self.transitions_per_pair * moves * sum(task.sizes), self.most_transitions)
        return ranks // self.ranks_per_transition


def strides(task: Task, transitions: int, budget: Budget, options: SweepOptions) -> Sequence[int] | None:
    """Return the factors of the variables in the ranks by which states are numbered; None if they are by layer.

    `transitions` is the number of all transitions. If only a dense ranking decides, this raises an `UnsuitedError`.
    """
    try:
        moves, groups = moves_and_groups(task, budget)
        digits = Digits.of(task, groups, moves, budget.during(LOOKING))
    except (UnsuitedError, MemoryLimitError, MemoryError):
        return None
    if transitions < options.most_by_layer(task, len(moves), digits.size):
        return None
    if digits.size > MANY:
        raise UnsuitedError
    return digits.stride
