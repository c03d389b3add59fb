"""Tables of costs-to-go of graphs that are worked out by hand, and what they are made of."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import graph_task

from planner import LimitError, Table, sweep
from planner.costtogo import UNREACHED, backward, compact, optimal_choices, random_states, smallest_type

# From 1 to the goal 0: directly for 5, over 2 for 1 + 3, over 3 and 4 for 0 + 0 + 4; 5 and 6 are dead ends.
EDGES = [(1, 0, 5), (1, 2, 1), (2, 0, 3), (1, 3, 0), (3, 4, 0), (4, 0, 4), (4, 3, 0), (3, 1, 0), (2, 5, 1), (5, 6, 0)]
H = {0: 0, 1: 4, 2: 3, 3: 4, 4: 4, 5: np.inf, 6: np.inf}
LENGTHS = {0: 0, 1: 2, 2: 1, 3: 2, 4: 1, 5: UNREACHED, 6: UNREACHED}


@pytest.fixture(scope="module")
def table() -> Table:
    return sweep(graph_task(EDGES))


@pytest.fixture(scope="module")
def node(table: Table) -> dict[int, int]:
    """Which node each state is."""
    return dict(enumerate(table.values(np.arange(len(table)))[:, 0].tolist()))


@pytest.mark.parametrize("start", H)
def test_a_table_by_hand(table: Table, node: dict[int, int], start: int) -> None:
    state = next(state for state, number in node.items() if number == start)
    assert table[state] == table.lookup([state])[0] == table.h[state] == H[start]
    assert table.plan_lengths([state]).tolist() == [LENGTHS[start]]
    assert table.is_goal([state]).tolist() == [start == 0]
    assert table.dead_end[state] == (start in (5, 6))
    plan = table.optimal_plan(state)
    if start in (5, 6):
        assert plan is None
        return
    assert plan is not None
    at, paid = start, 0
    for action in plan:
        origin, at_next, cost = EDGES[int(action.strip("()").split()[1])]
        assert origin == at
        at, paid = at_next, paid + cost
    assert (at, paid, len(plan)) == (0, H[start], LENGTHS[start])


def test_a_plan_begins_in_the_initial_state_unless_told_otherwise(table: Table) -> None:
    assert table.optimal_plan() == table.optimal_plan(table.initial) == ["(go 001)", "(go 002)"]
    assert sweep(graph_task(EDGES, start=4)).optimal_plan() == ["(go 005)"]


def test_optimal_choices_by_hand(table: Table, node: dict[int, int]) -> None:
    """Free actions count only on the shortest of the cheapest ways: from 1 that leads over 2, not over 3."""
    rows = table.choices(np.arange(len(table)))
    best = optimal_choices(table, np.arange(len(table)), rows)
    np.testing.assert_array_equal(best, table.optimal_choices())
    assert {table.task.actions[action] for action in rows.actions[best]} == {
        f"(go {number:03})" for number in (1, 2, 4, 5)
    }
    some = np.array([state for state, number in node.items() if number in (4, 5)])
    rows = table.choices(some)
    best = optimal_choices(table, some, rows)
    assert [table.task.actions[action] for action in rows.actions[best]] == ["(go 005)"]
    dead = [state for state, number in node.items() if number in (5, 6)]
    assert not optimal_choices(table, dead, table.choices(dead)).any()


def test_plan_lengths_of_several_states_and_of_none(table: Table, node: dict[int, int]) -> None:
    states = list(node) * 2
    assert table.plan_lengths(states).tolist() == [LENGTHS[node[state]] for state in states]
    assert table.plan_lengths([]).tolist() == []


def test_distances_are_kept_in_the_smallest_type_with_room_for_dead_ends() -> None:
    for largest, kind in (
        (0, np.uint8), (254, np.uint8), (255, np.uint16), (65534, np.uint16), (65535, np.uint32), (2**32 - 1, np.uint64)
    ):  # fmt: skip
        assert smallest_type(largest) is kind
        kept = compact(np.array([0, UNREACHED, largest]))
        assert kept.dtype == kind
        assert kept.tolist() == [0, np.iinfo(kind).max, largest]


def test_a_table_without_any_finite_cost() -> None:
    assert compact(np.full(3, UNREACHED)).tolist() == [255, 255, 255]
    assert compact(np.empty(0, dtype=np.int64)).dtype == np.uint8


def test_distances_backwards_by_hand() -> None:
    """Edges to the goal 0 from 1 (7), from 2 (1); from 1 to 2 (3), twice (4); 3 has none; 4 leads to 3."""
    targets, sources = np.array([0, 0, 2, 2, 3]), np.array([1, 2, 1, 1, 4])
    costs, goal = np.array([7, 1, 4, 3, 1]), np.array([True, False, False, False, False])
    assert backward(targets, sources, costs, goal).tolist() == [0, 4, 1, UNREACHED, UNREACHED]
    assert backward(targets, sources, costs, np.zeros(5, dtype=bool)).tolist() == [UNREACHED] * 5
    assert backward(targets, sources, costs, goal, deadline=float("inf")).tolist()[:3] == [0, 4, 1]
    with pytest.raises(LimitError, match="out of time in the backward search"):
        backward(targets, sources, costs, goal, deadline=0.0)


def test_some_states_at_random(table: Table) -> None:
    for count in (0, 1, 3):
        drawn = random_states(table.space, count, np.random.default_rng(0))
        assert len(set(drawn)) == count
        assert table.initial not in drawn
        assert set(drawn) <= set(range(len(table)))
    assert sorted([table.initial, *random_states(table.space, 99, np.random.default_rng(0))]) == list(range(len(table)))
