"""Choices with memory: what a person did last is a part of the state, where terms look at it.

`remembered` gives `Choices` again, whose rows are pairs of a state and what the person did before they came there. So
filter, policies, search, bounds and simulation stay as they are. Only pairs that can be reached are rows, and those
of a state that no term tells apart are one row: all that terms say of their choices is the same, and what a choice
leads to does not depend on what came before. Terms that need no memory cost no row.

An episode begins without memory, and what the robot executes itself is nobody's choice.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planner import LimitError, Table

from .choices import Choices
from .terms import NOTHING_YET, TERMS, Ints, Situation, Term, Vocabulary, features, goals_met

BLOCK = 1 << 22
"""Numbers that terms give at a time."""

LIMIT_MB = 4000.0


def remembered(table: Table, terms: Mapping[str, Term] = TERMS, *, memory_limit_mb: float = LIMIT_MB) -> Choices:
    """Arrange the choices of a task with what terms say of each; n rows, at least one for every state.

    Parameters
    ----------
    table : Table
    terms : mapping of str to callable
    memory_limit_mb : float
        What the result may take, in megabytes.

    Raises
    ------
    ValueError
        A term that gives no finite number for each choice.
    LimitError
        The result would take more memory than is allowed.
    """
    plain = Choices.of(table)
    if not terms:
        return plain
    states, slots = np.nonzero(plain.applicable & ~plain.goal[:, None])
    edges = _Edges(plain, goals_met(table, np.arange(len(plain))), terms, states, slots)
    every, reached = np.arange(len(plain)), plain.targets[states, slots]
    # The pairs: states that an episode may begin in, or that nothing leads to, then where each choice leads.
    begins = np.union1d(plain.initial, np.setdiff1d(every, reached))
    to = np.concatenate([begins, reached])
    came = np.concatenate([np.full(len(begins), NOTHING_YET), np.arange(len(reached))])
    row, pair = _merged(edges, to, came)
    to, came = to[pair], came[pair]
    needed = len(to) * plain.applicable.shape[1] * (26 + 8 * len(terms)) / 1e6
    if needed > memory_limit_mb:
        raise LimitError(
            f"{len(to):,} pairs of a state and what was done before take {needed:,.0f} MB of memory, and "
            f"{memory_limit_mb:,.0f} MB are allowed; expected a smaller task, fewer terms or a higher memory limit"
        )
    state = None if len(to) == len(plain) else to  # None: nobody remembers anything
    anywhere = np.zeros(len(plain), dtype=np.int64)  # a row of each state: where a goal's choices would lead
    anywhere[to[::-1]] = np.arange(len(to))[::-1]
    follows = anywhere[plain.targets]
    follows[states, slots] = row[len(begins) :]
    own = np.arange(len(to))
    return replace(
        plain,
        h=plain.h[to], goal=plain.goal[to], applicable=plain.applicable[to], actions=plain.actions[to],
        targets=np.where(plain.applicable[to], follows[to], own[:, None]), costs=plain.costs[to],
        optimal=plain.optimal[to], initial=int(row[np.searchsorted(begins, plain.initial)]),
        state=state, terms=tuple(terms), features=edges.features(to, came),
        key=None if plain.key is None else plain.key[to],
    )  # fmt: skip


def choices_of(table: Table | Choices, names: Iterable[str] = ()) -> Choices:
    """Give a task's choices, with what the terms of some names say of each.

    Parameters
    ----------
    table : Table or Choices
        Of choices that have been arranged already the terms are known, or none.
    names : iterable of str
        Without any, choices are those of the task's states.

    Raises
    ------
    ValueError
        There is no such term.
    LimitError
        They would take more memory than is allowed.
    """
    names = tuple(dict.fromkeys(names))
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
    """The choices of a task, from each of which a memory comes, and what terms say after it."""

    def __init__(self, plain: Choices, goals: Ints, terms: Mapping[str, Term], states: Ints, slots: Ints) -> None:
        self.plain, self.goals, self.terms = plain, goals, terms
        self.previous = np.append(states, NOTHING_YET)
        self.last = np.append(plain.actions[states, slots], NOTHING_YET)
        self.words = Vocabulary.of(plain.names)

    def features(self, to: Ints, came: Ints) -> NDArray[np.float64]:
        """Give what terms say in states, shape (N,), that edges lead to, shape (N,): shape (N, A, J)."""
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
    """Merge pairs of a state of which terms say the same: the row of each pair, and a pair of each row.

    Rows are in the order of their states. Numbers are compared by a hash of their bits, and then themselves.
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
