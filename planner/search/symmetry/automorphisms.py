"""Symmetries of a task: what can be interchanged in it without changing what anything costs.

A *symmetry* is a permutation of the facts of a grounded task that takes the facts of a variable to those of a variable,
operators to operators of the same cost, and the goal to itself. States that it takes to each other have the same
cost-to-go, so that one of each *orbit* does for all (Pochter, Zohar and Rosenschein, "Exploiting problem symmetries in
state-based planners", 2011; Domshlak, Katz and Shleyfman, "Enhanced symmetry breaking in cost-optimal planning as
forward search", 2012). The initial state need not stay where it is.

They are found as automorphisms of a graph of facts, variables and operators: colours that tell vertices apart by what
they are joined to are refined, some fact is told apart in one copy of the graph and another one in its place in a
second copy, and so on until a permutation is left. What is found so is a guess, as colours are hashes. Each guess is
proven on the task, operator by operator, before it counts.

The group is kept as a chain (Sims 1970): some facts are held fixed one after the other, and for each of them there is
a symmetry for all places to which it can be taken while those before it stay.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import prod

import numpy as np
from numpy.typing import NDArray

from ...grounding.task import Fact, Task
from ...states.packing import Ints

WORK = 200_000_000
"""So many edges are looked at, each once in every round of refinement, before the search for symmetries is given up."""

DEEP = 200
"""Facts that are held fixed, at most."""

LARGE = 20_000_000
"""Numbers that the chain may consist of."""

TRIES = 20
"""Places that are tried for facts before it is taken that no symmetry takes the first to where it was to go."""

Colors = NDArray[np.uint64]


@dataclass(frozen=True)
class Level:
    """The symmetries that hold the facts of the levels before fixed: how they move one fact more.

    Attributes
    ----------
    moves : int64 array, shape (k, facts)
        For each place to which the fact can be taken, a symmetry that takes what is there to the fact's own place.
    orbits : int64 array, shape (facts,)
        The orbit of each fact under the symmetries that hold this level's fixed, too.
    """

    moves: Ints
    orbits: Ints


@dataclass(frozen=True)
class Symmetries:
    """The symmetries of a task that have been found: a group, or a part of one.

    Fact `(v, value)` of the task has number `first[v] + value`.

    Attributes
    ----------
    first : int64 array, shape (variables + 1,)
    levels : tuple of Level
    generators : tuple of int64 array, shape (facts,)
        Each gives the fact to which every fact is taken.
    """

    first: Ints
    levels: tuple[Level, ...]
    generators: tuple[Ints, ...]

    @property
    def order(self) -> int:
        """How many there are, the identity among them."""
        return prod(len(level.moves) for level in self.levels)

    def apply(self, symmetry: Ints, values: Ints) -> Ints:
        """Give the states, shape (n, variables), to which a symmetry takes states."""
        facts = symmetry[self.first[:-1] + values]
        variable = np.searchsorted(self.first, facts, side="right") - 1
        images = np.empty_like(values)
        np.put_along_axis(images, variable, facts - self.first[variable], axis=1)
        return images


def symmetries(task: Task, work: int = WORK, check: Callable[[], None] = lambda: None) -> Symmetries | None:
    """Find symmetries of a task; None if there are none but the identity.

    `check` is called now and then, and may raise `LimitError`.

    Derived variables and effects under conditions are not looked at: of a task that has any, nothing is found. Nor is
    it where that takes more than so much work, or where an operator sets a variable twice.
    """
    plain = not task.axioms and all(not effect.conditions for operator in task.operators for effect in operator.effects)
    once = all(len({effect.variable for effect in o.effects}) == len(set(o.effects)) for o in task.operators)
    if not plain or not once or not task.operators:
        return None
    try:
        return _Search(task, work, check).chain()
    except _TooMuchWork:
        return None


class _TooMuchWork(Exception):  # noqa: N818  it is no fault
    pass


def _mix(words: Colors) -> Colors:
    """Mix words, so that sums of them tell multisets apart (Steele, Lea and Flood 2014)."""
    words = (words ^ words >> np.uint64(30)) * np.uint64(0xBF58476D1CE4E5B9)
    words = (words ^ words >> np.uint64(27)) * np.uint64(0x94D049BB133111EB)
    return words ^ words >> np.uint64(31)


class _Search:
    """A task as a graph, and as rows of numbers on which permutations are proven."""

    def __init__(self, task: Task, work: int, check: Callable[[], None]) -> None:
        self.work, self.check = work, check
        self.first = np.cumsum([0, *(len(variable.facts) for variable in task.variables)])
        self.facts = facts = int(self.first[-1])

        def number(fact: Fact) -> int:
            return int(self.first[fact[0]]) + fact[1]

        needed = [[number(pair) for pair in set(o.preconditions)] for o in task.operators]
        made = [[number((e.variable, e.value)) for e in set(o.effects)] for o in task.operators]
        self.costs = np.array([task.costs[operator.action] for operator in task.operators], dtype=np.int64)
        self.goal = np.zeros(facts, dtype=bool)
        self.goal[[number(pair) for pair in task.goal]] = True
        self.variable = np.repeat(np.arange(len(task.variables)), np.diff(self.first))
        self.needed, self.made = _rows(needed, facts), _rows(made, facts)
        self.proof = self._sorted(np.arange(facts))
        operators = facts + len(task.variables) + np.arange(len(task.operators))
        joined = [  # from one vertex to another, and as what
            (np.arange(facts), facts + self.variable, 1),
            (*_edges(operators, self.needed, facts), 2),
            (*_edges(operators, self.made, facts), 3),
        ]
        source = np.concatenate([np.concatenate([a, b]) for a, b, _ in joined])
        self.target = np.concatenate([np.concatenate([b, a]) for a, b, _ in joined])
        salt = np.concatenate([np.repeat([2 * kind, 2 * kind + 1], len(a)) for a, _, kind in joined])
        vertices = int(operators[-1]) + 1
        lone = np.setdiff1d(np.arange(vertices), source)  # every vertex has an edge, for the sums
        source, self.target = np.concatenate([source, lone]), np.concatenate([self.target, lone])
        self.salt = _mix(np.concatenate([salt, np.zeros(len(lone), dtype=np.int64)]).astype(np.uint64))
        order = np.argsort(source, kind="stable")
        self.target, self.salt = self.target[order], self.salt[order]
        self.begin = np.searchsorted(source[order], np.arange(vertices))
        kinds = np.zeros(vertices, dtype=np.int64)
        kinds[:facts] = 1 + self.goal
        kinds[facts : operators[0]] = 3
        kinds[operators] = 4 + np.unique(self.costs, return_inverse=True)[1]
        self.colors = self._refined(_mix(kinds.astype(np.uint64)))

    def _refined(self, colors: Colors) -> Colors:
        """Tell vertices apart by what they are joined to, until that tells no more of them apart."""
        classes = len(np.unique(colors))
        while True:
            self.work -= len(self.target)
            if self.work < 0:
                raise _TooMuchWork
            self.check()
            colors = _mix(colors * np.uint64(3) + np.add.reduceat(_mix(colors[self.target] ^ self.salt), self.begin))
            before, classes = classes, len(np.unique(colors))
            if classes == before:
                return colors

    def _marked(self, colors: Colors, fact: int) -> Colors:
        """Tell one fact apart from all others."""
        marked = colors.copy()
        marked[fact] = _mix(marked[fact : fact + 1] + np.uint64(1))[0]
        return self._refined(marked)

    def _open(self, colors: Colors) -> Ints:
        """Give the smallest set of facts of one colour, the first of these; empty if all colours are different."""
        _, cell, sizes = np.unique(colors[: self.facts], return_inverse=True, return_counts=True)
        own = sizes[cell]
        if own.max() == 1:
            return np.empty(0, dtype=np.int64)
        at = int(np.flatnonzero(own == own[own > 1].min())[0])
        return np.flatnonzero(cell == cell[at])

    def _sorted(self, symmetry: Ints) -> Ints:
        """Give the operators after a permutation of the facts, as rows in order; two sets of operators compare so."""
        taken = np.append(symmetry, self.facts)  # where a row has ended nothing follows
        needed, made = np.sort(taken[self.needed], axis=1), np.sort(taken[self.made], axis=1)
        rows = np.concatenate([self.costs[:, None], needed, made], axis=1)
        return rows[np.lexsort(rows.T)]

    def proven(self, symmetry: Ints) -> bool:
        """Whether a map of facts to facts is a symmetry."""
        if not np.array_equal(np.sort(symmetry), np.arange(self.facts)):
            return False
        variable = self.variable[symmetry]
        if (variable != variable[self.first[:-1]][self.variable]).any():  # facts of one variable have come apart
            return False
        sizes = np.diff(self.first)
        if (sizes[variable] != sizes[self.variable]).any() or (self.goal[symmetry] != self.goal).any():
            return False
        return np.array_equal(self._sorted(symmetry), self.proof)

    def _match(self, colors: Colors, others: Colors, tries: list[int]) -> Ints | None:
        """Find a symmetry that takes each fact to one of its colour in another copy of the graph."""
        if not np.array_equal(np.sort(colors), np.sort(others)):
            return None
        cell = self._open(colors)
        if not len(cell):
            symmetry = np.empty(self.facts, dtype=np.int64)
            symmetry[np.argsort(colors[: self.facts])] = np.argsort(others[: self.facts])
            return symmetry if self.proven(symmetry) else None
        at = int(cell[0])
        places = np.flatnonzero(others[: self.facts] == colors[at])
        marked = self._marked(colors, at)
        for place in sorted(places.tolist(), key=lambda place: place != at):  # better nothing moves
            if tries[0] == 0:
                break
            tries[0] -= 1
            found = self._match(marked, self._marked(others, place), tries)
            if found is not None:
                return found
            tries[0] -= 1
        return None

    def chain(self) -> Symmetries | None:
        """Find the group: from the level on which all but one fact are fixed up to that on which none is."""
        colors = [self.colors]
        cells: list[Ints] = []
        while len(cell := self._open(colors[-1])):
            if len(cells) == DEEP:
                raise _TooMuchWork
            cells.append(cell)
            colors.append(self._marked(colors[-1], int(cell[0])))
        generators: list[Ints] = []
        levels: list[Level] = []
        for depth in reversed(range(len(cells))):
            cell, orbits = cells[depth], _orbits(generators, self.facts)
            fact, tried = int(cell[0]), set()
            own = list(generators)
            for place in cell[1:].tolist():
                together = _orbits(own, self.facts)
                if together[place] == together[fact] or together[place] in tried:
                    continue
                tries = [TRIES + 2 * (len(cells) - depth)]
                found = self._match(colors[depth + 1], self._marked(colors[depth], place), tries)
                if found is None:
                    tried.add(int(together[place]))
                else:
                    own.append(found)
                    tried.clear()  # orbits have other names
            if len(own) > len(generators):
                generators = own
                levels.append(Level(_moves(generators, fact, self.facts), orbits))
                if sum(level.moves.size for level in levels) > LARGE:
                    raise _TooMuchWork
        if not levels:
            return None
        return Symmetries(self.first, tuple(reversed(levels)), tuple(generators))


def _rows(lists: Sequence[Sequence[int]], filler: int) -> Ints:
    """Put lists into rows of one length."""
    rows = np.full((len(lists), max(map(len, lists), default=0)), filler, dtype=np.int64)
    for row, entries in zip(rows, lists, strict=True):
        row[: len(entries)] = entries
    return rows


def _edges(vertices: Ints, rows: Ints, filler: int) -> tuple[Ints, Ints]:
    """Give the edges from vertices to the entries of their rows."""
    at, place = np.nonzero(rows != filler)
    return vertices[at], rows[at, place]


def _orbits(generators: Sequence[Ints], facts: int) -> Ints:
    """Give the orbit of each fact, named by its least one."""
    orbits = np.arange(facts)
    while True:
        before = orbits
        for generator in generators:
            least = np.minimum(orbits, orbits[generator])
            orbits = least.copy()
            np.minimum.at(orbits, generator, least)
        orbits = orbits[orbits]
        if np.array_equal(orbits, before):
            return orbits


def _moves(generators: Sequence[Ints], fact: int, facts: int) -> Ints:
    """Give symmetries that take everything in a fact's orbit to it, itself first (by the identity)."""
    to = {fact: np.arange(facts)}
    waiting = [fact]
    for at in waiting:
        for generator in generators:
            place = int(generator[at])
            if place not in to:
                back = np.empty(facts, dtype=np.int64)
                back[generator] = np.arange(facts)
                to[place] = to[at][back]  # first back to where it came from, then on from there
                waiting.append(place)
    return np.array([to[place] for place in waiting])
