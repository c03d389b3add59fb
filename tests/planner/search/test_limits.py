"""Limits hold before the search: while operators are split, states are laid out, and a ranking is computed."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from conftest import thinned
from plain import explore, task_of
from test_dense import composed, only_dense, tied
from test_sweep import COMPILED, UNLISTED, module
from test_sweep import check as compared

from planner import Effect, LimitError, Operator, Packing, SweepOptions, Task
from planner.costtogo.orbit_table import orbits
from planner.search import ranked_index
from planner.search.invariants import Mutexes, determined, invariants
from planner.search.numbering import TNFOperator, exactly_one, split_operators
from planner.search.state_ranking import StateRanking
from planner.search.state_registry import RegistrySpace
from planner.search.successor_generator import packed_operators, ranked_operators
from planner.search.variable_clusters import clusters
from planner.system.limits import Budget, Check, MemoryLimitError

FREE = Budget(None, math.inf, None)
LATE = Budget(None, math.inf, 0.0)
NARROW = Budget(None, 1.0, None)


def turning(needs: list[dict[int, int]], variables: int) -> Task:
    """Return a task of binary variables, all 0 first: the i-th action turns variable `i % variables` to 1."""
    moves = [({**own, a % variables: 0}, {a % variables: 1}) for a, own in enumerate(needs)]
    return task_of([2] * variables, moves, goal=((0, 1),))


def chains(count: int, length: int) -> Task:
    """Return a task in which each variable changes after the previous one: few states, but very many indices."""
    return turning([{v - 1: 1} if v % length else {} for v in range(count * length)], count * length)


def moves_of(task: Task) -> list[TNFOperator]:
    moves = split_operators(task)
    assert moves is not None
    return moves


def mutexes_of(task: Task) -> Mutexes:
    mutexes = Mutexes.of(task, moves_of(task))
    assert mutexes is not None
    return mutexes


def dense(task: Task) -> StateRanking:
    coding = StateRanking.dense(task, mutexes_of(task))
    assert coding is not None
    return coding


SEARCHED = (
    "invariants.STEPS_PER_CHECK", "invariants.PRODUCTS_PER_CHECK", "variable_clusters.STEPS_PER_CHECK",
)  # fmt: skip
"""Numbers of steps after which limits are checked."""

SEARCHES: dict[str, Callable[[Task, Check], Any]] = {
    "split": split_operators,
    "proven": lambda task, check: exactly_one(task, moves_of(task), check),
    "plain": lambda task, check: StateRanking.of(task, [], moves_of(task), check),
    "mutexes": lambda task, check: Mutexes.of(task, moves_of(task), check),
    "invariants": lambda task, check: invariants(task, moves_of(task), check),
    "determined": lambda task, check: determined(task, moves_of(task), check),
    "clusters": lambda task, check: clusters(mutexes_of(task), task.initial, range(len(task.variables)), check=check),
    "dense": lambda task, check: StateRanking.dense(task, mutexes_of(task), check),
    "tests": lambda task, check: ranked_operators(moves_of(task), dense(task), task.costs, check),
    "packed operators": lambda task, check: packed_operators(task, Packing.of(task), check),
}


@pytest.fixture
def often(monkeypatch: pytest.MonkeyPatch) -> None:
    """Check the limits after every step."""
    for name in SEARCHED:
        monkeypatch.setattr(f"planner.search.{name}", 0)


@pytest.mark.usefixtures("often")
@pytest.mark.parametrize("name", SEARCHES)
def test_what_takes_long_asks_again_and_again(name: str) -> None:
    """Each phase checks its limits at least once per variable."""
    task, asked = tied(4, 3, 6), 0

    def counting(_needed: float) -> None:
        nonlocal asked
        asked += 1

    SEARCHES[name](task, counting)
    assert asked >= len(task.variables)

    def ending(_needed: float) -> None:
        nonlocal asked
        asked -= 1
        if asked == 0:
            raise LimitError("the last time that it asked")

    with pytest.raises(LimitError, match="the last time"):
        SEARCHES[name](task, ending)


@pytest.mark.usefixtures("often")
@pytest.mark.parametrize("seed", range(4))
def test_what_is_found_does_not_depend_on_how_often_is_asked(seed: int) -> None:
    task = composed(seed, costs=range(1, 2))
    piecewise = found(task)
    with pytest.MonkeyPatch.context() as patch:
        for name in SEARCHED:
            patch.setattr(f"planner.search.{name}", 1 << 30)
        at_once = found(task)
    for one, other in zip(piecewise, at_once, strict=True):
        np.testing.assert_array_equal(one, other)


def found(task: Task) -> list[Any]:
    mutexes = mutexes_of(task)
    own = clusters(mutexes, task.initial, range(len(task.variables)))
    return [
        mutexes.together, mutexes.barred, invariants(task, mutexes.moves),
        *(determined.weights for determined in determined(task, mutexes.moves)),
        *(np.array(cluster.variables) for cluster in own), *(cluster.values for cluster in own),
    ]  # fmt: skip


def test_messages_say_in_which_phase_time_ended() -> None:
    task = chains(1, 5)
    for budget, how in ((LATE, "out of time"), (Budget(None, math.inf, None, stop := threading.Event()), "stopped")):
        stop.set()
        for phase, search in (
            ("operators were split", lambda b: ranked_index.explored(task, b, 1, lambda *_: None, COMPILED)),
            ("a ranking was looked for", lambda b: ranked_index._denser(task, None, moves_of(task), b, 0.25)),
            ("operators were laid out", lambda b: RegistrySpace(task, b)),
        ):
            with pytest.raises(LimitError, match=f"^{how} while {phase}$"):
                search(budget)
        with pytest.raises(LimitError, match=f"^{how} after 1 state$"):
            budget.check_time(1)
        with pytest.raises(LimitError, match=f"^{how} after 2 states$"):
            budget.check_time(2)
    with pytest.raises(LimitError, match=r"^out of time while symmetries were looked for$"):
        orbits(tied(2, 2, 4), max_orbits=100, deadline=0.0)


@pytest.mark.parametrize("name", sorted(SEARCHES.keys() - {"proven", "plain"}))
def test_memory_is_checked(name: str) -> None:
    """The limit is one byte."""
    with pytest.raises(MemoryLimitError, match=r"^\d+ MB of memory needed, 0 MB allowed$"):
        SEARCHES[name](tied(4, 3, 6), NARROW.during("it was looked for"))


def test_what_is_in_use_all_the_time_counts() -> None:
    budget = Budget(None, 10e6, None).beside(3e6).beside(4e6)
    budget.check_memory(3e6)
    assert budget.room == 3e6
    with pytest.raises(MemoryLimitError, match=r"^11 MB of memory needed, 10 MB allowed$"):
        budget.during("it was looked for")(4e6)


@pytest.mark.parametrize(
    ("task", "options", "limit", "why"),
    [
        # Matrices of 160 facts need more memory than 1,681 states do.
        (chains(2, 40), UNLISTED, 1, "looking for a ranking took too much memory"),
        # Sets of 400 moves for each of 4,096 rows need more memory than two states do.
        (
            turning([{}, *({3: 1} if a % 22 == 2 else {2: 1} for a in range(1, 400))], 22), COMPILED, 2,
            "its ranking takes too much memory",
        ),
    ],
    ids=["looking", "ranking"],
)  # fmt: skip
def test_where_a_ranking_takes_too_much_memory_states_are_listed(
    task: Task, options: SweepOptions, limit: float, why: str
) -> None:
    plenty, little = (module.sweep(task, memory_limit_mb=most, options=options) for most in (None, limit))
    assert plenty.note is None
    assert str(little.note).endswith(why)
    assert len(little) == len(plenty)
    np.testing.assert_array_equal(little.h[little.numbers(plenty.values(np.arange(len(plenty))))], plenty.h)


@pytest.mark.parametrize("listed", thinned([False, True]))
def test_facts_that_never_change_take_nothing_of_a_ranking(listed: bool) -> None:
    """The table is the same as without 300 constant facts, next to 48 states."""
    task, alive = tied(3, 3, 4, 300), module.sweep(tied(3, 3, 4))
    table = compared(task, COMPILED if listed else UNLISTED)
    assert table.note is None
    assert len(table) == len(alive) == 48
    values = table.values(np.arange(len(table)))
    assert not values[:, 7:].any()
    np.testing.assert_array_equal(alive.h[alive.numbers(values[:, :7])], table.h)
    mutexes = mutexes_of(task)
    assert not invariants(task, mutexes.moves)[:, mutexes.first[7] :].any()
    assert max(own.variable for own in determined(task, mutexes.moves)) < 7
    coding = dense(task)
    assert len(coding.field) == 1
    assert coding.decoder.rows.shape[1] == coding.packing.words + 1


def test_facts_that_others_rule_out_never_change_either() -> None:
    """The switch of variable 3 needs two values that exclude each other."""
    task = tied(2, 3, 5, 1)
    dead = Operator(len(task.operators), ((0, 0), (1, 1), (7, 0)), (Effect((), 7, 1),))
    task = task_of([len(each.facts) for each in task.variables], (*task.operators, dead), goal=task.goal)
    with pytest.MonkeyPatch.context() as patch:
        only_dense(patch)
        table = compared(task, UNLISTED)
    assert len(table) == len(explore(task)) == 96
    assert not table.values(np.arange(96))[:, 7].any()
