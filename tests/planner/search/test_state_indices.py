"""All searches give one task the same table: that of a plain search by the reference semantics, state by state.

States have the numbers of the rule in `planner.search.state_space`.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from conftest import costly
from hypothesis import given
from hypothesis import strategies as st
from test_dense import composed, only_dense
from test_sweep import COMPILED, UNLISTED, check, numbering, random_task, sweep, with_blocks_of
from test_symmetry import copies

from planner import Effect, LimitError, Operator, Packing, SweepOptions, Table, Task, Variable, load
from planner.costtogo.orbit_table import orbits
from planner.search import ranked_index, state_registry, successor_generator
from planner.search.ranked_index import RankedIndex
from planner.search.state_registry import RegistryIndex
from planner.system.limits import Budget


def with_more(task: Task, rng: random.Random, dead: int, tied: bool) -> Task:
    """Return the task with variables that never change, and one that always equals the first variable."""
    primary = [v for v, variable in enumerate(task.variables) if variable.axiom_layer < 0]
    first, twin = primary[0], len(task.variables)
    size = len(task.variables[first].facts)
    variables = list(task.variables)
    initial, operators = list(task.initial), list(task.operators)
    if tied:
        variables.append(Variable("twin", tuple(f"Atom twin({a})" for a in range(size)), -1))
        initial.append(task.initial[first])
        operators = [
            replace(o, effects=(*o.effects, *(replace(e, variable=twin) for e in o.effects if e.variable == first)))
            for o in operators
        ]
    for number in range(dead):
        v = len(variables)
        variables.append(Variable(f"dead{number}", (f"Atom dead({number})", f"NegatedAtom dead({number})"), -1))
        initial.append(rng.randrange(2))
        if task.actions and rng.random() < 0.3:  # what needs the other value never applies
            operators.append(Operator(rng.randrange(len(task.actions)), ((v, 1 - initial[v]),), (Effect((), v, 0),)))
    return replace(task, variables=tuple(variables), initial=tuple(initial), operators=tuple(operators))


def drawn(seed: int, costs: range, kind: str) -> Task:
    """Return a random task of a kind."""
    rng = random.Random(seed)
    if kind == "copies":
        return copies(rng, rng.randint(2, 3), costs)
    if kind == "composed":
        return composed(seed, costs=costs)
    task = random_task(rng, axioms=kind in ("axioms", "circles"), costs=costs)
    if kind != "circles":
        return task
    derived = [v for v, variable in enumerate(task.variables) if variable.axiom_layer >= 0]
    facts = [(v, value) for v, variable in enumerate(task.variables) for value in range(len(variable.facts))]
    facts = [(v, value) for v, value in facts if v not in derived or value == 0]  # derived facts are not negated
    axioms = tuple(Effect(tuple(rng.sample(facts, 2)), v, 0) for v in derived for _ in range(3))
    layers = tuple(replace(v, axiom_layer=min(v.axiom_layer, 0)) for v in task.variables)
    return replace(task, variables=layers, axioms=axioms)


def listed(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(numbering, "split_operators", lambda *_: None)
    patch.setattr(state_registry, "STATES_AT_A_TIME", 3)


def many_moves(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(successor_generator, "candidates", partial(successor_generator.candidates, max_bytes=0))


def many_ranks(patch: pytest.MonkeyPatch) -> None:
    """Let the dense ranking have so many ranks that states are listed first."""
    only_dense(patch)
    patch.setattr(ranked_index, "MANY", 0)


WAYS: dict[str, tuple[Callable[[pytest.MonkeyPatch], object], SweepOptions]] = {
    "in blocks": (partial(with_blocks_of, 64), COMPILED),  # smaller blocks are left to one thread
    "sets of moves that do not fit the cache": (many_moves, COMPILED),
    "short of memory": (lambda patch: patch.setattr(ranked_index, "CLOSED_BITMAP_SHARE", 0), COMPILED),
    "listed": (listed, COMPILED),
    "without a list": (lambda _: None, UNLISTED),
    "dense": (only_dense, UNLISTED),
    "dense after a list": (only_dense, COMPILED),
    "listed before a dense one": (many_ranks, UNLISTED),
}
"""What is changed for a search, and its options."""

COSTS = [range(1, 2), range(3), range(1), range(3, 90_000, 11), range(0, 10**12, 10**11 + 1)]


@pytest.mark.parametrize("way", WAYS)
@costly(4, 100)
@given(
    st.integers(0, 10**6),
    st.sampled_from(COSTS),
    st.sampled_from(["random", "axioms", "circles", "composed", "copies"]),
    st.sampled_from([0, 1, 3, 70]),  # the last ones take a second word
    st.booleans(),
)
def test_all_searches_find_what_the_plain_one_finds(
    way: str, seed: int, costs: range, kind: str, dead: int, tied: bool
) -> None:
    change, options = WAYS[way]
    task = with_more(drawn(seed, costs, kind), random.Random(seed), dead, tied)
    with pytest.MonkeyPatch.context() as patch:
        change(patch)
        table = check(task, options)
    assert way != "listed" or isinstance(table.space.numbering, RegistryIndex) or not task.operators
    assert not task.axioms or "derived variables" in str(table.note)
    if way == "in blocks" and dead < 70:  # so many equal variables have too many symmetries
        states = table.values(np.arange(len(table)))
        with suppress(LimitError):  # no symmetries
            np.testing.assert_array_equal(orbits(task, max_orbits=10**6).whole(Packing.of(task).pack(states)), table.h)


@pytest.mark.parametrize("way", ["in blocks", "without a list", "dense"])
def test_states_are_ranked(way: str) -> None:
    change, options = WAYS[way]
    with pytest.MonkeyPatch.context() as patch:
        change(patch)
        table = check(copies(random.Random(0), 3, range(1, 2)), options)
    assert isinstance(table.space.numbering, RankedIndex)


def by_rank(table: Table) -> bool:
    """Whether states are numbered by ascending rank; the task has a ranking by single variables."""
    _, coding = ranked_index._plain(table.task, Budget(None, 1e12, None, None))
    return bool((np.diff(table.values(np.arange(len(table))) @ coding.stride) > 0).all())


def by_words(table: Table) -> bool:
    """Whether states are numbered by layer, then by packed words, where the layers are those of the transitions."""
    offsets, _, targets = table.space.transitions
    layer, frontier, depth = np.full(len(table), -1), np.array([table.initial]), 0
    while len(frontier):
        layer[frontier] = depth
        after = np.concatenate([targets[offsets[x] : offsets[x + 1]] for x in frontier])
        frontier, depth = np.unique(after[layer[after] < 0]), depth + 1
    words = Packing.of(table.task).pack(table.values(np.arange(len(table))))
    order = sorted(range(len(table)), key=lambda x: (layer[x], words[x].tolist()))
    return order == list(range(len(table)))


def test_tasks_with_few_ranks_are_numbered_by_rank() -> None:
    rng = random.Random("ranks")
    for task in [load("domains/kitting/paper.pddl"), *(random_task(rng) for _ in range(10))]:
        if (
            all(len(set(o.effects)) for o in task.operators)
            and ranked_index._plain(task, Budget(None, 1e12, None, None))[1]
        ):
            assert all(by_rank(sweep(task, options=options)) for options in (None, COMPILED))


@pytest.mark.parametrize("axioms", [False, True])
def test_others_are_numbered_by_layer_and_packed_words(axioms: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where they have several words, and orbits."""
    monkeypatch.setattr(numbering, "split_operators", lambda *_: None)
    monkeypatch.setattr("planner.search.state_registry.STATES_AT_A_TIME", 3)
    rng = random.Random(f"words {axioms}")
    for _ in range(8):
        task = random_task(rng, axioms=axioms, costs=range(3))
        assert all(by_words(sweep(task, options=options)) for options in (None, COMPILED))
        task = with_more(task, rng, dead=70, tied=True)
        assert Packing.of(task).words > 1
        assert by_words(sweep(task))
        with suppress(LimitError):  # no symmetries
            task = copies(rng, 3, range(1, 3))
            assert by_words(orbits(task, max_orbits=10_000).table(task))
