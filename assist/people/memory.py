"""Choices with memory: the person's last action is part of the state if terms depend on it.

`remembered` returns `Choices` whose rows are pairs of a task state and a memory. So filter, policies, solvers, bounds
and simulation need no change. Only reachable pairs are rows. Memories of a state with equal terms are merged into one
row, which is exact because successors do not depend on the memory. Terms that need no memory add no row.

An episode begins without memory. Actions that the robot executes itself are no choices of the person.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from planner import LimitError, Table

from .choices import Choices
from .decision import Floats
from .goals import Goals, first_of, require_possible_terms
from .hidden_type import Ints
from .terms import NOTHING_YET, TERMS, Situation, Term, Vocabulary, features, goals_met

BLOCK = 1 << 22
"""Number of values of terms that are computed at a time, which limits the memory to some tens of megabytes."""


def remembered(table: Table, terms: Mapping[str, Term] = TERMS, *, memory_limit_mb: float = 4000.0) -> Choices:
    """Return the choices of a task with memory and the values of terms; n rows, at least one for every state.

    Parameters
    ----------
    table : Table
    terms : mapping of str to callable
    memory_limit_mb : float
        Memory limit of the result, in MB.

    Raises
    ------
    ValueError
        A term does not return a finite number for each choice.
    LimitError
        The result would exceed the memory limit.
    """
    plain = Choices.of(table)
    if not terms:
        return plain
    states, slots = np.nonzero(plain.applicable & ~plain.goal[:, None])
    edges = _Edges(plain, goals_met(table, np.arange(len(plain))), terms, states, slots)
    every, reached = np.arange(len(plain)), plain.targets[states, slots]
    # The pairs: initial states and those without predecessors, then the successor of each choice.
    begins = np.union1d(plain.initial, np.setdiff1d(every, reached))
    to = np.concatenate([begins, reached])
    came = np.concatenate([np.full(len(begins), NOTHING_YET), np.arange(len(reached))])
    row, pair = _merged(edges, to, came)
    to, came = to[pair], came[pair]
    needed = len(to) * plain.applicable.shape[1] * (26 + 8 * len(terms)) / 1e6
    if needed > memory_limit_mb:
        raise LimitError(
            f"{len(to):,} pairs of a state and a last action take {needed:,.0f} MB of memory, and "
            f"{memory_limit_mb:,.0f} MB are allowed; expected a smaller task, fewer terms or a higher memory limit"
        )
    state = None if len(to) == len(plain) else to  # None: no term depends on the memory
    anywhere = np.zeros(len(plain), dtype=np.int64)  # a row of each state: successors of a goal's choices
    anywhere[to[::-1]] = np.arange(len(to))[::-1]
    follows = anywhere[plain.targets]
    follows[states, slots] = row[len(begins) :]
    own = np.arange(len(to))
    return plain.of_rows(
        to, targets=np.where(plain.applicable[to], follows[to], own[:, None]),
        initial=int(row[np.searchsorted(begins, plain.initial)]), state=state, terms=tuple(terms),
        features=edges.features(to, came),
    )  # fmt: skip


def choices_of(table: Table | Choices | Goals, names: Iterable[str] = ()) -> Choices:
    """Return a task's choices, with the values of some terms.

    Parameters
    ----------
    table : Table, Choices or Goals
        Cost-to-go, or choices that have these terms already. People who pursue one of several goals have no terms.
    names : iterable of str
        Names of terms; without any, the rows are the task's states.

    Raises
    ------
    ValueError
        There is no such term, or people with terms pursue one of several goals.
    LimitError
        The choices would exceed the memory limit.
    """
    names = tuple(dict.fromkeys(names))
    require_possible_terms(table, names)
    if isinstance(table, Goals):
        if not names:
            return table.choices()
        table = first_of(table)
    known = (table.terms or ()) if isinstance(table, Choices) else tuple(TERMS)
    for name in names:
        if name not in known:
            what = (
                f"expected one of {', '.join(known)}" if known else "the choices have none; expected a table of costs"
            )
            raise ValueError(f"no term '{name}'; {what}")
    if isinstance(table, Choices):
        return table
    return remembered(table, {name: TERMS[name] for name in names}) if names else Choices.of(table)


class _Edges:
    """The choices of a task, each of which gives a memory, and the terms with this memory."""

    def __init__(self, plain: Choices, goals: Ints, terms: Mapping[str, Term], states: Ints, slots: Ints) -> None:
        self.plain, self.goals, self.terms = plain, goals, terms
        self.previous = np.append(states, NOTHING_YET)
        self.last = np.append(plain.actions[states, slots], NOTHING_YET)
        self.words = Vocabulary.of(plain.names)

    def features(self, to: Ints, came: Ints) -> Floats:
        """Return the terms, shape (N, A, J), in states, shape (N,), after the choices that lead there, shape (N,)."""
        plain = self.plain
        step = max(1, BLOCK // (plain.applicable.shape[1] * max(1, len(self.terms))))
        blocks = []
        for begin in range(0, len(to), step):
            x, edge = to[begin : begin + step], came[begin : begin + step]
            blocks.append(
                features(
                    Situation(
                        plain.names, self.words, x, plain.applicable[x], plain.actions[x], plain.targets[x],
                        self.goals[x], self.goals[plain.targets[x]], self.last[edge], self.previous[edge],
                    ),
                    self.terms,
                )
            )  # fmt: skip
        return np.concatenate(blocks)


def _merged(edges: _Edges, to: Ints, came: Ints) -> tuple[Ints, Ints]:
    """Merge pairs of a state with equal terms; return the row of each pair, and one pair of each row.

    Rows are in the order of their states. Terms are compared by a hash of their bits, and then exactly.
    """
    plain = edges.plain
    width = plain.applicable.shape[1] * len(edges.terms)
    factors = np.random.default_rng(1).integers(1, 2**63, width, dtype=np.uint64) * np.uint64(2) + np.uint64(1)
    step = max(1, BLOCK // max(1, width))
    mark = np.zeros(len(to), dtype=np.uint64)
    for begin in range(0, len(to), step):
        block = slice(begin, begin + step)
        said = edges.features(to[block], came[block]) + 0.0  # no -0, whose bits differ
        bits = said.reshape(len(said), width).view(np.uint64)
        bits = bits ^ (bits >> np.uint64(29))
        mark[block] = (bits * factors).sum(axis=1, dtype=np.uint64)
    order = np.lexsort((mark, to))
    new = np.ones(len(to), dtype=bool)
    new[1:] = (np.diff(to[order]) != 0) | (mark[order][1:] != mark[order][:-1])
    row = np.empty(len(to), dtype=np.int64)
    row[order] = np.cumsum(new) - 1
    pair = order[new]
    for begin in range(0, len(to), step):
        block = slice(begin, begin + step)
        same = pair[row[block]]
        if (edges.features(to[block], came[block]) != edges.features(to[same], came[same])).any():
            raise RuntimeError("two pairs of a state have one hash, but terms tell them apart")
    return row, pair
