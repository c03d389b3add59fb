"""Symmetries of a task: permutations of its facts that preserve operators, costs and the goal.

A *symmetry* is a permutation of the facts of a grounded task. It maps the facts of each variable to those of one
variable, operators to operators of the same cost, and the goal to itself. It need not preserve the initial state.
States that it maps to each other have the same cost-to-go, since it maps plans to plans of equal cost. One state of
each *orbit* therefore suffices (Pochter, Zohar and Rosenschein, "Exploiting problem symmetries in state-based
planners", 2011; Domshlak, Katz and Shleyfman, "Enhanced symmetry breaking in cost-optimal planning as forward search",
2012).

Symmetries are found as automorphisms of a graph of facts, variables and operators. Vertex colours are refined by the
colours of the neighbours. Then a fact is individualised in one copy of the graph, and a candidate image in a second
copy, until a permutation remains. The result is a conjecture only, since colours are hashes. Each one is verified on
the task, operator by operator, before it is used.

The group is represented by a stabiliser chain (Sims 1970). Facts are fixed one after another. For each of them, the
chain contains a symmetry for every image that the fact has while the earlier ones are fixed.

The canonical state of an orbit (`canonical`) is computed along this chain, as in minimal images (Linton 2004; Jefferson
et al. 2019). Each level applies all of its symmetries to the current images. It keeps the images with the smallest key.
The key is a sum of weights of orbits that later levels preserve. Equal images, which occur for symmetric states, are
kept once. If more than 64 images remain, some are dropped. States of one orbit may then get different canonical states.
This increases the number of states, but it is still correct, since the result is always an image of the state.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import prod
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..grounding.task import Fact, Task
from ..system.arrays import Ints, Words, padded
from ..system.errors import UnsuitedError
from ..system.jit import njit
from .state_space import Packing

Colors = NDArray[np.uint64]


@dataclass(frozen=True)
class Level:
    """One level of the stabiliser chain: the symmetries that fix the facts of the earlier levels."""

    permutations: Ints
    """For each image of the level's fact, a symmetry that maps this image back to the fact: a row each."""
    orbits: Ints
    """Orbit of each fact under the symmetries that also fix this level's fact."""


@dataclass(frozen=True)
class Symmetries:
    """The symmetries of a task that were found: the whole group or a subgroup.

    Fact `(v, value)` of the task has number `first[v] + value`.
    """

    first: Ints
    levels: tuple[Level, ...]

    @property
    def order(self) -> int:
        """Order of the group, including the identity."""
        return prod(len(level.permutations) for level in self.levels)


def symmetries(
    task: Task,
    work: int = 200_000_000,
    check: Callable[[], None] = lambda: None,
    *,
    max_levels: int = 200,
    max_entries: int = 20_000_000,
) -> Symmetries | None:
    """Return symmetries of a task; None if only the identity is found.

    Derived variables and conditional effects are not supported: for tasks with these, the result is None. It is also
    None if an operator sets a variable twice, or if the search exceeds one of its limits: the edges of the task's
    graph that are visited (`work`), the levels of the chain, each of which fixes a fact, and the entries of its arrays.
    """
    plain = not task.axioms and all(not effect.conditions for operator in task.operators for effect in operator.effects)
    once = all(len({effect.variable for effect in o.effects}) == len(set(o.effects)) for o in task.operators)
    if not plain or not once or not task.operators:
        return None
    try:
        return _Search(task, work, check).chain(max_levels, max_entries)
    except UnsuitedError:
        return None


def _mix(words: Colors) -> Colors:
    """Return the mixed words, whose sums distinguish multisets with high probability (Steele, Lea and Flood 2014)."""
    words = (words ^ words >> np.uint64(30)) * np.uint64(0xBF58476D1CE4E5B9)
    words = (words ^ words >> np.uint64(27)) * np.uint64(0x94D049BB133111EB)
    return words ^ words >> np.uint64(31)


class _Search:
    """A task as a coloured graph, and as sorted rows for the verification of permutations."""

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
        self.needed, self.made = padded(needed, facts), padded(made, facts)
        self.operator_rows = self._sorted(np.arange(facts))
        operators = facts + len(task.variables) + np.arange(len(task.operators))
        joined = [  # source, target, kind of edge
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
        """Return the colours after refinement by the neighbours' colours, until the number of colours is stable."""
        classes = len(np.unique(colors))
        while True:
            self.work -= len(self.target)
            if self.work < 0:
                raise UnsuitedError
            self.check()
            colors = _mix(colors * np.uint64(3) + np.add.reduceat(_mix(colors[self.target] ^ self.salt), self.begin))
            before, classes = classes, len(np.unique(colors))
            if classes == before:
                return colors

    def _marked(self, colors: Colors, fact: int) -> Colors:
        """Return the refined colours after individualising a fact."""
        marked = colors.copy()
        marked[fact] = _mix(marked[fact : fact + 1] + np.uint64(1))[0]
        return self._refined(marked)

    def _open(self, colors: Colors) -> Ints:
        """Return the facts of the smallest colour class with several facts; empty if all colours differ."""
        _, cell, sizes = np.unique(colors[: self.facts], return_inverse=True, return_counts=True)
        own = sizes[cell]
        if own.max() == 1:
            return np.empty(0, dtype=np.int64)
        at = int(np.flatnonzero(own == own[own > 1].min())[0])
        return np.flatnonzero(cell == cell[at])

    def _sorted(self, symmetry: Ints) -> Ints:
        """Return the operators under a permutation of the facts, as sorted rows that can be compared."""
        taken = np.append(symmetry, self.facts)  # the filler is mapped to itself
        needed, made = np.sort(taken[self.needed], axis=1), np.sort(taken[self.made], axis=1)
        rows = np.concatenate([self.costs[:, None], needed, made], axis=1)
        return rows[np.lexsort(rows.T)]

    def proven(self, symmetry: Ints) -> bool:
        """Return whether a map of facts is a symmetry."""
        if not np.array_equal(np.sort(symmetry), np.arange(self.facts)):
            return False
        variable = self.variable[symmetry]
        if (variable != variable[self.first[:-1]][self.variable]).any():  # the map separates facts of one variable
            return False
        sizes = np.diff(self.first)
        if (sizes[variable] != sizes[self.variable]).any() or (self.goal[symmetry] != self.goal).any():
            return False
        return np.array_equal(self._sorted(symmetry), self.operator_rows)

    def _match(self, colors: Colors, others: Colors, tries: list[int]) -> Ints | None:
        """Return a symmetry that maps each fact to a fact of its colour in the other copy; None if none was found."""
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
        for place in sorted(places.tolist(), key=lambda place: place != at):  # prefer to fix the fact
            if tries[0] == 0:
                break
            tries[0] -= 1
            found = self._match(marked, self._marked(others, place), tries)
            if found is not None:
                return found
            tries[0] -= 1
        return None

    def chain(self, max_levels: int, max_entries: int) -> Symmetries | None:
        """Return the group, built from the deepest level of the chain upwards; None if it is trivial."""
        colors = [self.colors]
        cells: list[Ints] = []
        while len(cell := self._open(colors[-1])):
            if len(cells) == max_levels:
                raise UnsuitedError
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
                # Images tried before it is assumed that no symmetry maps the fact to the wanted image.
                tries = [20 + 2 * (len(cells) - depth)]
                found = self._match(colors[depth + 1], self._marked(colors[depth], place), tries)
                if found is None:
                    tried.add(int(together[place]))
                else:
                    own.append(found)
                    tried.clear()  # the representatives of orbits have changed
            if len(own) > len(generators):
                generators = own
                levels.append(Level(_permutations(generators, fact, self.facts), orbits))
                if sum(level.permutations.size for level in levels) > max_entries:
                    raise UnsuitedError
        return Symmetries(self.first, tuple(reversed(levels))) if levels else None


def _edges(vertices: Ints, rows: Ints, filler: int) -> tuple[Ints, Ints]:
    """Return the edges from vertices to the entries of their rows."""
    at, place = np.nonzero(rows != filler)
    return vertices[at], rows[at, place]


def _orbits(generators: Sequence[Ints], facts: int) -> Ints:
    """Return the orbit of each fact, represented by its least fact."""
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


def _permutations(generators: Sequence[Ints], fact: int, facts: int) -> Ints:
    """Return symmetries that map each fact of a fact's orbit to the fact, the identity first."""
    to = {fact: np.arange(facts)}
    waiting = [fact]
    for at in waiting:
        for generator in generators:
            place = int(generator[at])
            if place not in to:
                back = np.empty(facts, dtype=np.int64)
                back[generator] = np.arange(facts)
                to[place] = to[at][back]  # first to the previous fact, then from there
                waiting.append(place)
    return np.array([to[place] for place in waiting])


class Forms(NamedTuple):
    """Symmetries in the layout of the compiled code. Facts are numbered across the variables."""

    word: Ints
    """Word of each variable in a packed state."""
    first: Ints
    """First fact of each variable."""
    shift: Words
    field: Words
    at: Ints
    """Word in which each fact is stored."""
    bits: Words
    """Bits that represent each fact in its word."""
    begin: Ints
    """The symmetries of level `l` are the rows `begin[l]:begin[l + 1]` of `permutations`."""
    permutations: NDArray[np.int32]
    """Image of every fact under each symmetry."""
    weight: Words
    """From `facts * begin[l]` on, the contribution of each fact to the key of its image, one entry for each symmetry of
    level `l`.
    """
    own: Words
    """Contribution of each fact to the hash that distinguishes images."""

    @classmethod
    def of(cls, symmetries: Symmetries, packing: Packing) -> Forms:
        """Return the layout of the symmetries of a task with packed states."""
        facts = int(symmetries.first[-1])
        variable = np.repeat(np.arange(len(packing.word)), np.diff(symmetries.first))
        value = np.arange(facts) - symmetries.first[variable]
        rng = np.random.default_rng(0)
        weights = [np.empty(0, dtype=np.uint64)]
        for level in symmetries.levels:
            of_orbit = rng.integers(1 << 63, size=facts, dtype=np.uint64)
            weights.append(of_orbit[level.orbits][level.permutations].T.reshape(-1))
        return cls(
            packing.word,
            symmetries.first[:-1],
            packing.shift.astype(np.uint64),
            (np.uint64(1) << packing.bits.astype(np.uint64)) - np.uint64(1),
            packing.word[variable],
            value.astype(np.uint64) << packing.shift[variable].astype(np.uint64),
            np.cumsum([0, *(len(level.permutations) for level in symmetries.levels)]),
            np.concatenate([level.permutations for level in symmetries.levels]).astype(np.int32),
            np.concatenate(weights),
            rng.integers(1 << 63, size=facts, dtype=np.uint64),
        )


@njit(nogil=True, error_model="numpy")
def canonical(forms, states):
    """Replace each state by its canonical state, in place; states have shape (n, words)."""
    variables, levels = len(forms.word), len(forms.begin) - 1
    facts = len(forms.at)
    wide = 64  # images kept per level; more find more equal orbits, and take longer
    images = np.empty((2, wide, variables), dtype=np.int64)
    marks = np.empty(wide, dtype=np.uint64)
    keys = np.empty(len(forms.permutations), dtype=np.uint64)
    best, packed = np.empty(states.shape[1], dtype=np.uint64), np.empty(states.shape[1], dtype=np.uint64)
    for i in range(len(states)):
        side, held = 0, 1
        for v in range(variables):
            images[0, 0, v] = forms.first[v] + np.int64(states[i, forms.word[v]] >> forms.shift[v] & forms.field[v])
        for level in range(levels):
            begin = forms.begin[level]
            count = forms.begin[level + 1] - begin
            least, more = np.uint64(0), 0
            for image in range(held):
                for j in range(count):
                    keys[j] = 0
                for v in range(variables):
                    row = begin * facts + images[side, image, v] * count
                    for j in range(count):
                        keys[j] += forms.weight[row + j]
                for j in range(count):
                    if more > 0 and keys[j] > least:
                        continue
                    if more == 0 or keys[j] < least:
                        least, more = keys[j], 0
                    if more == wide:
                        continue
                    mark = np.uint64(0)
                    for v in range(variables):
                        fact = forms.permutations[begin + j, images[side, image, v]]
                        images[1 - side, more, v] = fact
                        mark += forms.own[fact]
                    known = False
                    for other in range(more):
                        known |= marks[other] == mark
                    if not known:
                        marks[more] = mark
                        more += 1
            side, held = 1 - side, more
        for image in range(held):
            for w in range(len(packed)):
                packed[w] = 0
            for v in range(variables):
                fact = images[side, image, v]
                packed[forms.at[fact]] |= forms.bits[fact]
            smaller = image == 0
            for w in range(len(packed)):
                if packed[w] != best[w]:
                    smaller |= packed[w] < best[w]
                    break
            if smaller:
                for w in range(len(packed)):
                    best[w] = packed[w]
        for w in range(len(packed)):
            states[i, w] = best[w]
