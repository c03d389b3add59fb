"""States have the numbers of the rule in `planner.search.state_space`, here by a search in plain Python."""

from __future__ import annotations

import importlib
import random
from contextlib import suppress

import numpy as np
import pytest
from test_state_indices import with_more
from test_sweep import random_task
from test_symmetry import copies

from planner import LimitError, Packing, StateSpace, Table, Task, load
from planner.costtogo.orbit_table import orbits
from planner.grounding.semantics import derived, successors
from planner.search import compiled_search
from planner.system.arrays import Ints
from planner.system.limits import Budget

module = importlib.import_module("planner.costtogo.table")
numbering = importlib.import_module("planner.search.numbering")
State = tuple[int, ...]


def layers(task: Task) -> list[list[State]]:
    """Return the states of each layer, breadth first."""
    layer = [tuple(derived(task, task.initial))]
    found, seen = [], set(layer)
    while layer:
        found.append(layer)
        after = (tuple(values) for state in layer for values in successors(task, state).values())
        layer = [state for state in dict.fromkeys(after) if state not in seen]
        seen.update(layer)
    return found


def by_words(task: Task) -> Ints:
    """Return the states by layer, then by packed words."""
    packing = Packing.of(task)
    return np.array([s for own in layers(task) for s in sorted(own, key=lambda s: packing.pack(s).tolist())])


def by_rank(task: Task) -> Ints:
    """Return the states by ascending rank; the task has a ranking by single variables."""
    states = np.array([state for layer in layers(task) for state in layer])
    _, coding = compiled_search._plain(task, Budget(None, 1e12, None, None))
    return states[np.argsort(states @ coding.stride)]


def check(space: StateSpace, expected: Ints) -> None:
    numbers = np.arange(len(expected))
    np.testing.assert_array_equal(space.values(numbers), expected)
    np.testing.assert_array_equal(space.numbers(expected), numbers)
    assert expected[space.initial].tolist() == derived(space.task, space.task.initial)


def test_tasks_with_few_ranks_are_numbered_by_rank() -> None:
    rng = random.Random("ranks")
    for _ in range(20):
        task = random_task(rng)
        if (
            all(len(set(o.effects)) for o in task.operators)
            and compiled_search._plain(task, Budget(None, 1e12, None, None))[1]
        ):
            for options in (None, module.SweepOptions(small_states=0)):
                check(module.sweep(task, options=options).space, by_rank(task))
    check(module.sweep(load("domains/kitting/paper.pddl")).space, by_rank(load("domains/kitting/paper.pddl")))


@pytest.mark.parametrize("axioms", [False, True])
def test_others_are_numbered_by_layer_and_packed_words(axioms: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numbering, "split_operators", lambda *_: None)
    monkeypatch.setattr("planner.search.state_registry.STATES_AT_A_TIME", 3)
    rng = random.Random(f"words {axioms}")
    for _ in range(20):
        task = random_task(rng, axioms=axioms, costs=range(3))
        for options in (None, module.SweepOptions(small_states=0)):
            check(module.sweep(task, options=options).space, by_words(task))


def ascending(table: Table) -> bool:
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


def test_states_of_several_words_and_orbits_are_numbered_so_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numbering, "split_operators", lambda *_: None)
    rng = random.Random("several words")
    for _ in range(10):
        task = with_more(random_task(rng), rng, dead=70, tied=True)
        assert Packing.of(task).words > 1
        assert ascending(module.sweep(task))
        task = copies(rng, 3, range(1, 3))
        with suppress(LimitError):  # no symmetries
            assert ascending(orbits(task, max_orbits=10_000).table(task))
