"""States have the numbers of the rule in `planner.search.state_space`."""

from __future__ import annotations

import importlib
import random
from contextlib import suppress

import numpy as np
import pytest
from test_state_indices import with_more
from test_sweep import random_task
from test_symmetry import copies

from planner import LimitError, Packing, Table, load
from planner.costtogo.orbit_table import orbits
from planner.search import ranked_index
from planner.system.limits import Budget

module = importlib.import_module("planner.costtogo.table")
numbering = importlib.import_module("planner.search.numbering")
COMPILED = module.SweepOptions(small_states=0)


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
            assert all(by_rank(module.sweep(task, options=options)) for options in (None, COMPILED))


@pytest.mark.parametrize("axioms", [False, True])
def test_others_are_numbered_by_layer_and_packed_words(axioms: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where they have several words, and orbits."""
    monkeypatch.setattr(numbering, "split_operators", lambda *_: None)
    monkeypatch.setattr("planner.search.state_registry.STATES_AT_A_TIME", 3)
    rng = random.Random(f"words {axioms}")
    for _ in range(8):
        task = random_task(rng, axioms=axioms, costs=range(3))
        assert all(by_words(module.sweep(task, options=options)) for options in (None, COMPILED))
        task = with_more(task, rng, dead=70, tied=True)
        assert Packing.of(task).words > 1
        assert by_words(module.sweep(task))
        with suppress(LimitError):  # no symmetries
            task = copies(rng, 3, range(1, 3))
            assert by_words(orbits(task, max_orbits=10_000).table(task))
