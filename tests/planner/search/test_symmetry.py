"""Symmetric states are swept once, and no others: compared with the sweep of all states, and by hand."""

from __future__ import annotations

import importlib
import math
import random
import threading
from collections.abc import Iterable
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from conftest import KITTING, table_of
from plain import task_of

from assist import Pool, simulate
from assist.person.shared_task import SharedTask
from planner import (
    Effect,
    LimitError,
    MismatchError,
    OnDemand,
    Operator,
    Packing,
    Table,
    Task,
    cost_to_go,
    instance,
    load,
    optimal_choices,
    sweep,
)
from planner.batch.results_folder import SolveOptions
from planner.batch.solve_instance import solve_instance
from planner.costtogo import on_demand
from planner.costtogo.astar import check_successors
from planner.costtogo.orbit_table import OrbitTable, orbits
from planner.grounding.task import plan_cost, replay
from planner.search.automorphisms import Forms, Symmetries, canonical, symmetries


def switches(costs: list[int], goal: Iterable[int], initial: list[int] | None = None) -> Task:
    """Switches that can be turned on, each at its cost, and off, which costs 10 more."""
    count = len(costs)
    moves = [({v: 1 - on}, {v: on}) for v in range(count) for on in (0, 1)]
    prices = tuple(cost + more for cost in costs for more in (10, 0))
    goal = tuple((v, 1) for v in goal)
    return task_of([2] * count, moves, costs=prices, initial=tuple(initial or [0] * count), goal=goal)


def copies(rng: random.Random, count: int, costs: range) -> Task:
    """Return a task with several equivalent objects and a shared variable, in which each acts on each other."""
    sizes = [rng.randint(2, 3) for _ in range(rng.randint(1, 2))]  # of each thing's variables
    shared = count * len(sizes)
    whole = [*sizes * count, rng.randint(2, 3)]

    def fact(roles: int) -> tuple[int, int, int]:
        """Return an object's role, its variable (or the shared one), and a value."""
        if rng.random() < 0.3:
            return -1, 0, rng.randrange(whole[-1])
        variable = rng.randrange(len(sizes))
        return rng.randrange(roles), variable, rng.randrange(sizes[variable])

    def bound(pattern: tuple[int, int, int], things: tuple[int, ...]) -> tuple[int, int]:
        role, variable, value = pattern
        return (shared, value) if role < 0 else (things[role] * len(sizes) + variable, value)

    operators, prices = [], []
    for _ in range(rng.randint(3, 6)):
        roles, cost = rng.randint(1, 2), rng.choice(costs)
        needed, made = [fact(roles) for _ in range(rng.randint(0, 2))], [fact(roles) for _ in range(rng.randint(1, 2))]
        for things in permutations(range(count), roles):
            conditions, effects = dict(bound(p, things) for p in needed), dict(bound(p, things) for p in made)
            changes = tuple(Effect((), v, value) for v, value in sorted(effects.items()))
            operators.append(Operator(len(prices), tuple(sorted(conditions.items())), changes))
            prices.append(cost)
    wanted = [fact(1) for _ in range(2)]
    return task_of(
        whole,
        operators,
        costs=tuple(prices),
        initial=tuple(rng.randrange(size) for size in whole),
        goal=tuple({bound(p, (thing,))[0]: bound(p, (thing,)) for p in wanted for thing in range(count)}.values()),
    )


def moved(group: Symmetries, symmetry: np.ndarray, state: tuple[int, ...]) -> tuple[int, ...]:
    """Return the image of a state under a symmetry."""
    facts = symmetry[group.first[:-1] + np.array(state)]
    variables = np.searchsorted(group.first, facts, side="right") - 1
    image = np.empty(len(state), dtype=np.int64)
    image[variables] = facts - group.first[variables]
    return tuple(image.tolist())


def check(task: Task) -> tuple[Table, OrbitTable]:
    """Compare the cost-to-go of orbits with that of all states, and states of one orbit with each other."""
    table, found = sweep(task), orbits(task, max_orbits=10**6)
    values, packing = table.values(np.arange(len(table))), Packing.of(task)
    np.testing.assert_array_equal(found.whole(packing.pack(values)), table.h)
    np.testing.assert_array_equal(
        found.plan_lengths(task, packing.pack(values)), table.plan_lengths(np.arange(len(table)))
    )
    asked = OnDemand(task, orbits=found)
    np.testing.assert_array_equal(asked.plan_lengths(asked.numbers(values)), table.plan_lengths(np.arange(len(table))))
    numbers = found.index.rows(packing.pack(values))
    assert sorted(set(numbers.tolist())) == list(range(len(found)))
    group = symmetries(task)
    assert group is not None
    # States that a symmetry maps to each other are in one orbit; the number of orbits follows from such pairs alone.
    root = {tuple(row): tuple(row) for row in values.tolist()}

    def top(state: tuple[int, ...]) -> tuple[int, ...]:
        while root[state] != state:
            state = root[state]
        return state

    waiting = list(root)
    for state in waiting:  # which grows meanwhile
        for symmetry in (each for level in group.levels for each in level.permutations):
            image = moved(group, symmetry, state)
            if image not in root:
                root[image] = image
                waiting.append(image)
            root[top(state)] = top(image)
    assert len({top(tuple(row)) for row in values.tolist()}) == len(found)
    return table, found


@pytest.mark.parametrize("name", ["tiny", "paper", "sealed"])
def test_a_kit_is_swept_by_orbits(name):
    table, found = check(load(instance(KITTING / f"{name}.pddl")))
    assert 1.5 < len(table) / len(found) < found.order


@pytest.mark.parametrize(
    ("name", "order"), [("paper", 2 * 2), ("ladder-3x5", 2**2 * 2), ("ladder-4x8", 2**4 * math.factorial(4))]
)
def test_items_of_a_box_are_alike_and_so_are_boxes_with_as_many_of_them(name, order):
    group = symmetries(load(instance(KITTING / f"{name}.pddl")))
    assert group is not None
    assert group.order == order


@pytest.mark.parametrize("costs", [range(1, 2), range(3), range(5, 100_000, 7)], ids=str)
@pytest.mark.parametrize("seed", [0, 1, 2, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(3, 30))])
def test_copies(seed, costs):
    rng = random.Random(f"{seed} {costs}")
    count = rng.randint(2, 4)
    _, found = check(copies(rng, count, costs))
    assert found.order % math.factorial(count) == 0


def test_what_is_alike_is_one():
    table, found = check(switches([1, 1, 1, 1], [0, 1, 2, 3]))
    assert (len(table), len(found), found.order) == (16, 5, 24)
    assert sorted(found.distance.tolist()) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    ("costs", "goal", "left"),
    [([1, 2, 1], [0, 1, 2], 2), ([1, 2, 3], [0, 1, 2], 1), ([1, 1, 1], [0, 1], 2), ([1, 1, 1], [0], 2)],
)
def test_what_costs_or_is_wanted_otherwise_is_not_alike(costs, goal, left):
    task = switches(costs, goal)
    group = symmetries(task)
    assert (1 if group is None else group.order) == left
    if group is None:
        with pytest.raises(LimitError, match="no symmetries"):
            orbits(task, max_orbits=100)
    else:
        check(task)


def test_what_can_be_done_to_one_alone_makes_it_unlike():
    task = switches([1, 1, 1], [0, 1, 2])
    for more in (Operator(0, ((0, 0), (1, 1)), (Effect((), 0, 1),)), Operator(0, (), (Effect((), 0, 0),))):
        group = symmetries(replace(task, operators=(*task.operators, more)))
        assert (1 if group is None else group.order) == (1 if more.preconditions else 2)


def test_where_things_begin_need_not_be_alike():
    """Symmetric states have equal cost-to-go, whether or not both are reachable."""
    task = switches([1, 1, 1], [0, 1, 2], [1, 0, 0])
    table, found = check(replace(task, operators=task.operators[1::2]))  # never off again
    assert (len(table), len(found), found.order) == (4, 3, 6)


@pytest.mark.parametrize("kind", ["axioms", "conditions", "twice", "nothing"])
def test_what_is_not_looked_at(kind):
    """Both switches are symmetric, but for the change."""
    task, both = switches([1, 1], [0, 1]), ((0, 1), (1, 0))
    under = [Operator(2 * v, ((v, 0),), (Effect(((other, 1),), v, 1),)) for v, other in both]
    twice = [Operator(2 * v, ((v, 0),), (Effect((), v, 1), Effect((), v, 0))) for v, _ in both]
    changed = {
        "axioms": {"axioms": tuple(Effect(((v, 0),), v, 1) for v, _ in both)},
        "conditions": {"operators": (*task.operators, *under)},
        "twice": {"operators": (*task.operators, *twice)},
        "nothing": {"operators": ()},
    }
    assert symmetries(task) is not None
    assert symmetries(replace(task, **changed[kind])) is None


def test_who_stops_a_search_does_not_wait_for_the_forms_of_many_states(monkeypatch):
    module, stop, formed = importlib.import_module("planner.costtogo.orbit_table"), threading.Event(), list[int]()

    def stopped(forms: Forms, states: np.ndarray) -> None:
        formed.append(len(states))
        stop.set()
        canonical(forms, states)

    monkeypatch.setattr(module, "AT_ONCE", 1)
    monkeypatch.setattr(module, "canonical", stopped)
    with pytest.raises(LimitError, match="stopped"):
        orbits(load(instance(KITTING / "paper.pddl")), max_orbits=10**6, stop=stop, threads=1)
    assert formed == [1]


@pytest.mark.parametrize(
    ("costs", "goal", "symmetry", "proven"),
    [
        ([1, 1], [0, 1], [2, 3, 0, 1], True),
        ([1, 2], [0, 1], [2, 3, 0, 1], False),  # what turns them on costs otherwise
        ([1, 1], [0], [2, 3, 0, 1], False),  # one of them is in the goal
        ([1, 1], [], [3, 2, 0, 1], False),  # on is off
        ([1, 1], [0, 1], [2, 1, 0, 3], False),  # variables come apart
        ([1, 1], [0, 1], [2, 3, 2, 3], False),  # no permutation
    ],
)
def test_symmetries_are_proven(costs, goal, symmetry, proven):
    search = importlib.import_module("planner.search.automorphisms")._Search(switches(costs, goal), 1000, lambda: None)
    assert search.proven(np.array(symmetry)) == proven


def test_a_guess_that_is_none_does_not_count(monkeypatch):
    """If colours distinguish nothing, the guesses are wrong, and none is accepted."""
    search = importlib.import_module("planner.search.automorphisms")._Search
    task = switches([1, 2, 3], [0, 1, 2])
    monkeypatch.setattr(search, "_refined", lambda _self, colors: colors * np.uint64(0) + np.uint64(1))
    marked = lambda _self, colors, fact: np.where(np.arange(len(colors)) == fact, colors.max() + 1, colors)  # noqa: E731
    monkeypatch.setattr(search, "_marked", marked)
    assert symmetries(task) is None


def test_too_many_orbits_are_none(monkeypatch):
    task, alike = load(instance(KITTING / "paper.pddl")), switches([1] * 4, range(4))
    with pytest.raises(LimitError, match="more than 100 states"):
        orbits(task, max_orbits=100)
    with pytest.raises(LimitError, match="1 transitions or more between orbits of 24 symmetries"):
        orbits(alike, max_orbits=100, effort=4 * 9)  # facts of a state, symmetries
    for most in ({"work": 1}, {"max_levels": 2}, {"max_entries": 2}):
        assert symmetries(alike, **most) is None
    # 4 symmetries: 836 states are 209 orbits at least, which is known before they are listed.
    module = importlib.import_module("planner.costtogo.orbit_table")
    monkeypatch.setattr(module, "RegistrySpace", None)
    with pytest.raises(LimitError, match="more than 208 orbits of 4 symmetries"):
        orbits(task, max_orbits=208, states=836)


def test_answers_on_demand_are_looked_up_where_orbits_fit(monkeypatch):
    at = instance(KITTING / "ladder-3x5.pddl")
    table, task = table_of(at), load(at)
    monkeypatch.setattr(on_demand, "astar", None)
    known = cost_to_go(task, max_states=len(table) - 1)
    assert isinstance(known, OnDemand)
    assert (known.method, known.searches, known.reason) == ("on-demand", False, "more than 6183 states")
    numbers = known.numbers(table.values(np.arange(len(table))))
    told: list[int] = []
    np.testing.assert_array_equal(known.lookup(numbers, told.append), table.h)
    assert told == [len(table)]
    np.testing.assert_array_equal(known.known(numbers), table.h)
    assert len(known) == len(table)
    rows, own = known.choices(numbers[:100]), table.choices(np.arange(100))
    np.testing.assert_array_equal(rows.offsets, own.offsets)
    np.testing.assert_array_equal(rows.actions, own.actions)
    np.testing.assert_array_equal(rows.targets, numbers[own.targets])
    np.testing.assert_array_equal(optimal_choices(known, numbers[:100], rows), optimal_choices(table, range(100), own))
    plan = known.optimal_plan()
    assert plan is not None
    assert plan_cost(known.task, plan) == table[table.initial]
    assert table.is_goal([table.space.follow(plan)])[0]
    assert cost_to_go(task, max_states=4 * 913).searches  # there are 914


def test_where_few_states_are_wanted_orbits_may_be_first(monkeypatch):
    at = instance(KITTING / "ladder-3x5.pddl")
    table = table_of(at)
    monkeypatch.setattr(importlib.import_module("planner.costtogo.portfolio"), "FIRST", 60)
    known = cost_to_go(load(at), table.values(np.arange(50)), max_states=len(table) - 1)
    assert not known.searches
    np.testing.assert_array_equal(known.lookup(known.numbers(table.values(np.arange(50)))), table.h[:50])


def test_a_record_tells_of_orbits():
    at = instance(KITTING / "ladder-3x5.pddl")
    table = table_of(at)
    record = solve_instance(at, SolveOptions(max_states=6000, verify=5))
    assert record["status"] == "solved"
    assert record["note"] == "solved on demand: more than 6000 states; swept are 914 orbits of 8 symmetries"
    assert (record["method"], record["states"], record["max_cost_to_go"]) == ("on-demand", None, int(table.h.max()))
    assert (record["cost"], record["verified"], record["consistent"]) == (table[table.initial], 5, 5)
    assert replay(load(at), record["plan"]) == record["cost"]


def test_wrong_values_are_found():
    """The table that is compared with A* and with successors is that of the orbits."""
    task = load(instance(KITTING / "paper.pddl"))
    found = orbits(task, max_orbits=10**6)
    table, count = found.table(task), len(found)
    assert check_successors(table, count, np.random.default_rng(0)) == count
    for distance in (found.distance + 1, found.distance * 2):
        wrong = replace(found, distance=distance.astype(np.uint8)).table(task)
        with pytest.raises(MismatchError, match="but its successors say"):
            check_successors(wrong, count, np.random.default_rng(0))
    assert len(table.space.transitions.targets) == found.transition_count
    plan = table.optimal_plan()
    assert plan is not None
    assert plan_cost(task, plan) == table[table.initial]


def test_policies_are_worked_out_on_more_states_where_none_takes_a_search(tiny):
    looked_up = OnDemand(tiny.task, orbits=orbits(tiny.task, max_orbits=20))
    sizes = [SharedTask(known).size for known in (tiny, looked_up, OnDemand(tiny.task))]
    assert sizes == [20_000, 3_000, 200]


def test_a_team_at_a_task_of_which_orbits_were_swept_does_as_at_its_table(monkeypatch):
    """People and policies are functions of the state, independent of how its cost-to-go was computed and of its
    number.
    """
    monkeypatch.setattr(on_demand, "astar", None)
    table = table_of(instance(KITTING / "tiny.pddl"))
    known = OnDemand(table.task, orbits=orbits(table.task, max_orbits=1000))
    runs = []
    for costs in (table, known):
        team = Pool.sample(costs, 2, seed=0, states=5, region=2000)
        runs.append(simulate(team, "attention", humans=2, episodes=10, seed=0))
    np.testing.assert_array_equal(runs[0].actions, runs[1].actions)
    np.testing.assert_allclose(runs[0].discounted_return, runs[1].discounted_return)
