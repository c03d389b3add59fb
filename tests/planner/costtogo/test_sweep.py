"""The sweep compared, state by state, with a plain search that stores all transitions, on every kind of task."""

from __future__ import annotations

import importlib
import random
import threading
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from conftest import KITTING
from plain import distances, explore, task_of

from planner import Effect, InputFileError, LimitError, OnDemand, Operator, Table, Task, load, open_table, save_table
from planner.search.ranked_index import RankedIndex
from planner.search.state_registry import RegistryIndex
from planner.search.state_space import compact

module = importlib.import_module("planner.costtogo.table")
successor_generator = importlib.import_module("planner.search.successor_generator")
ranked_index = importlib.import_module("planner.search.ranked_index")
numbering = importlib.import_module("planner.search.numbering")
sweep, SweepOptions = module.sweep, module.SweepOptions
COMPILED = SweepOptions(small_states=0)
UNLISTED = SweepOptions(0, transitions_per_pair=-1)  # a denser ranking is sought before any state is listed


def with_blocks_of(ranks: int, patch: pytest.MonkeyPatch) -> None:
    """Let blocks of a frontier have `ranks` ranks."""
    patch.setattr(ranked_index, "RANKS_AT_A_TIME", ranks)


def check(task: Task, options: SweepOptions = COMPILED) -> Table:
    """Compare everything that a table says with the reference, and with the readable search; return the table."""
    table = sweep(task, options=options)
    if options.small_states == 0:
        same(check(task, replace(options, small_states=SweepOptions.small_states)), table)
    space = explore(task)
    rows = space.transitions
    h = Table(space, compact(distances(space)))
    assert len(table) == len(space)
    assert table.space.transition_count == len(rows.actions)
    values = space.values(np.arange(len(space)))
    numbers = table.numbers(values)  # of each state of the reference
    assert sorted(numbers) == list(range(len(space)))
    assert table.initial == numbers[space.initial]
    np.testing.assert_array_equal(table.values(numbers), values)
    np.testing.assert_array_equal(table.space.goal[numbers], space.goal)
    np.testing.assert_array_equal(table.is_goal(numbers), space.goal)
    np.testing.assert_array_equal(table.h[numbers], h.h)
    offsets, actions, targets = table.space.transitions
    assert offsets[0] == 0
    assert offsets[-1] == len(actions) == len(targets)
    np.testing.assert_array_equal(np.diff(offsets)[numbers], np.diff(rows.offsets))
    places = np.concatenate([np.arange(offsets[x], offsets[x + 1]) for x in numbers])
    np.testing.assert_array_equal(actions[places], rows.actions)
    np.testing.assert_array_equal(targets[places], numbers[rows.targets])
    few, own = table.choices(numbers[:50]), space.choices(np.arange(min(50, len(space))))
    np.testing.assert_array_equal(few.offsets, own.offsets)
    np.testing.assert_array_equal(few.actions, own.actions)
    np.testing.assert_array_equal(few.targets, numbers[own.targets])
    asked = OnDemand(task)
    few = asked.choices(asked.numbers(values[:50]))
    np.testing.assert_array_equal(few.actions, own.actions)
    np.testing.assert_array_equal(asked.values(few.targets), values[own.targets])
    reached = {tuple(row) for row in values.tolist()}
    rng = random.Random(len(space))
    for _ in range(20):
        guess = tuple(rng.randrange(-1, len(v.facts) + 1) for v in task.variables)
        if guess not in reached:
            with pytest.raises(KeyError):
                table.numbers([guess])
    return table


def same(one: Table, other: Table) -> None:
    """Two searches give the same numbers to states, and the same of all else."""
    states = np.arange(len(one))
    np.testing.assert_array_equal(one.values(states), other.values(np.arange(len(other))))
    np.testing.assert_array_equal(one.distance, other.distance)
    assert (one.initial, one.distance.dtype) == (other.initial, other.distance.dtype)
    for array, like in zip(one.space.transitions, other.space.transitions, strict=True):
        np.testing.assert_array_equal(array, like)
        assert array.dtype == like.dtype


def random_task(rng: random.Random, *, axioms: bool = False, costs: range = range(1, 2)) -> Task:
    """Return a task with exactly-one groups among its variables, and operators of every kind."""
    sizes = [rng.randint(2, 4) for _ in range(rng.randint(1, 6))]
    initial = [rng.randrange(size) for size in sizes]
    groups = []
    for _ in range(rng.randint(0, 4)):  # variable = 0 exactly if none of some facts of others holds
        free = [v for v in range(len(sizes)) if rng.random() < 0.7]
        facts = [(v, rng.randrange(sizes[v])) for v in free if v < len(sizes)]
        holding = [fact for fact in facts if initial[fact[0]] == fact[1]]
        facts = [fact for fact in facts if fact not in holding[1:]]
        sizes.append(2)
        initial.append(1 if holding else 0)
        groups.append([*facts, (len(sizes) - 1, 0)])
    primary = len(sizes)
    if axioms:
        sizes += [2] * rng.randint(1, 3)
        initial += [1] * (len(sizes) - primary)

    def facts(variables: int, most: int) -> tuple:
        chosen = rng.sample(range(variables), min(variables, rng.randint(0, most)))
        return tuple((v, rng.randrange(sizes[v])) for v in chosen)

    operators, names = [], 0
    tidy = rng.random() < 0.6  # keep all groups
    for _ in range(rng.choice([0, 5, 20, 40])):
        conditions = facts(len(sizes), 2)
        changed = dict(facts(primary, 2)) or {0: 0}
        if tidy or rng.random() < 0.8:  # repair the groups, so that many are preserved
            known = dict(conditions)
            for group in groups:
                for v, _ in group:
                    if v in changed:
                        known.setdefault(v, rng.randrange(sizes[v]))
                before = sum(known.get(v) == value for v, value in group if v in changed)
                after = sum(changed.get(v) == value for v, value in group)
                v, _ = group[-1]
                if v not in changed and before != after:
                    known[v], changed[v] = (1, 0) if before > after else (0, 1)
            conditions = tuple(known.items())
        effects = tuple(
            Effect(facts(len(sizes), 2) if not tidy and rng.random() < 0.2 else (), v, value)
            for v, value in changed.items()
        )
        operators.append(Operator(names, conditions, effects))
        if rng.random() < 0.2:  # a disjunctive precondition
            operators.append(Operator(names, facts(len(sizes), 3), effects))
        names += 1
    rng.shuffle(operators)
    rules = []
    for v in range(primary, len(sizes)):
        rules += [Effect(facts(v, 2), v, 0) for _ in range(rng.randint(1, 2))]
    task = task_of(
        sizes,
        operators,
        costs=tuple(rng.choice(costs) for _ in range(names)),
        axioms=tuple(rules),
        initial=tuple(initial),
        goal=facts(len(sizes), 2),
        mutexes=tuple(map(tuple, groups)),
    )
    layers = [replace(v, axiom_layer=max(-1, number - primary)) for number, v in enumerate(task.variables)]
    return replace(task, variables=tuple(layers))


def test_the_plain_sweep_can_be_stopped():
    task, stop = random_task(random.Random(0), axioms=True), threading.Event()
    stop.set()
    with pytest.raises(LimitError, match="stopped"):
        sweep(task, stop=stop)


@pytest.fixture
def listed(monkeypatch):
    """Disable rankings, so that the sweep stores them."""
    monkeypatch.setattr(numbering, "split_operators", lambda *_: None)


@pytest.mark.usefixtures("listed")
@pytest.mark.slow
def test_a_list_of_states_grows():
    table = sweep(counter(15))
    numbers = np.arange(len(table))
    np.testing.assert_array_equal(table.h, len(table) - 1.0 - table.values(numbers) @ (1 << np.arange(15)))
    np.testing.assert_array_equal(table.numbers(table.values(numbers)), numbers)


def test_tasks_of_few_states_take_no_large_bitmap():
    sparse = SweepOptions(0, small_bitmap=0, ranks_per_transition=2)
    rng, kinds = random.Random(1), set()
    for _ in range(12):
        kinds.add(type(check(random_task(rng, costs=range(1, 3)), sparse).space.numbering))
    assert kinds == {RankedIndex, RegistryIndex}


@pytest.fixture(scope="module")
def kitting() -> Task:
    """An instance with half a million states: several blocks to a layer."""
    return load(KITTING / "ladder-4x7.pddl")


@pytest.fixture(scope="module")
def smaller() -> Task:
    return load(KITTING / "ladder-4x6.pddl")


def test_the_number_of_threads_does_not_matter(smaller, monkeypatch):
    with_blocks_of(256, monkeypatch)
    tables = [sweep(smaller, threads=threads, options=COMPILED) for threads in (1, 2, 5)]
    for table in tables:
        assert table.distance.dtype == np.uint8
        np.testing.assert_array_equal(table.distance, tables[0].distance)


@pytest.mark.slow
def test_a_task_of_many_blocks(smaller, monkeypatch):
    with_blocks_of(256, monkeypatch)
    check(smaller)


def counter(bits: int, **fields: Any) -> Task:
    """Return a binary counter, which passes through all its states in turn."""
    moves = [(dict.fromkeys(range(v), 1) | {v: 0}, dict.fromkeys(range(v), 0) | {v: 1}) for v in range(bits)]
    return task_of([2] * bits, moves, goal=tuple((v, 1) for v in range(bits)), **fields)


def test_costs_beyond_32_bits():
    task = counter(4, costs=(1 << 39, 3, 0, 1 << 33))
    check(task)
    table = sweep(task)
    assert table.distance[table.initial] == (8 << 39) + 4 * 3 + (1 << 33)


def test_costs_whose_sums_no_array_holds():
    with pytest.raises(LimitError, match="a cost of 1000000000001 is too large; expected at most 1000000000000"):
        sweep(counter(2, costs=(1, 10**12 + 1)))


def test_sums_of_costs_that_no_float_holds():
    """A plan of 16,383 actions costs 16,382,999,999,983,617, which a float would round to another number."""
    with pytest.raises(LimitError, match="sums of costs are too large; expected less than 9007199254740992"):
        sweep(counter(14, costs=(10**12 - 1,) * 14), options=COMPILED)


def wide(bits: int) -> Task:
    """Two states' worth of change among many variables, or a hundred."""
    moves = [({v: 0, **dict.fromkeys(range(v), 1)}, {v: 1}) for v in range(bits)]
    return task_of([2] * bits, moves, goal=((bits - 1, 1),))


@pytest.mark.parametrize("bits", [1, 40, 61, 63, 64, 65, pytest.param(130, marks=pytest.mark.slow)])
def test_few_states_of_many_bits(bits):
    assert len(check(wide(bits))) == bits + 1


def test_two_words_with_implied_variables():
    """A token moves through 50 places, each with a variable of its own and its negation."""
    places = 50
    groups = [[(0, p), (1 + p, 0)] for p in range(places)]
    groups += [[(1 + p, 1), (1 + places + p, 1)] for p in range(places)]
    moves = []
    for p in range(places):
        q, other = (p + 7) % places, 1 + places
        facts = {0: p, 1 + p: 1, 1 + q: 0, other + p: 0, other + q: 1}
        moves.append((facts, {0: q, 1 + p: 0, 1 + q: 1, other + p: 1, other + q: 0}))
    initial = [0] + [0] * places + [1] * places
    initial[1], initial[1 + places] = 1, 0
    mutexes = tuple(map(tuple, groups))
    table = check(task_of([places] + [2] * 2 * places, moves, initial=tuple(initial), goal=((0, 3),), mutexes=mutexes))
    assert len(table) == places
    assert table.space.numbering.coding.size == places
    assert table.space.numbering.coding.packing.words == 2


def test_a_task_without_operators():
    assert check(task_of([2] * 3, [])).distance.tolist() == [0]
    assert check(task_of([2] * 3, [], goal=((0, 1),))).dead_end.all()


def test_limits(kitting):
    with pytest.raises(LimitError, match="more than 1000 states"):
        sweep(kitting, max_states=1000)
    for memory in (0.1, 1.0, 2.0):
        with pytest.raises(LimitError, match="MB"):
            sweep(kitting, memory_limit_mb=memory)
    with pytest.raises(LimitError, match="out of time"):
        sweep(kitting, deadline=time.monotonic())
    with pytest.raises(LimitError, match="MB"):
        sweep(kitting, memory_limit_mb=20).space.transitions  # noqa: B018


@pytest.mark.usefixtures("listed")
def test_limits_of_a_list(kitting):
    with pytest.raises(LimitError, match="MB"):
        sweep(kitting, memory_limit_mb=1)
    assert len(sweep(counter(4), max_states=16)) == 16
    with pytest.raises(LimitError, match="more than 15 states"):
        sweep(counter(4), max_states=15)


def test_a_saved_table_is_opened_without_being_read(tmp_path):
    task = counter(9, costs=(3, 1, 0, 2, 1, 1, 5, 1, 1))
    table = sweep(task)
    file = tmp_path / "table.npz"
    save_table(file, table)
    saved = open_table(file)
    assert isinstance(saved.states, np.memmap)
    assert isinstance(saved.distance, np.memmap)
    everything = np.arange(len(table))
    np.testing.assert_array_equal(saved.lookup(everything), table.h)
    np.testing.assert_array_equal(saved.values(everything), table.values(everything))
    assert (len(saved), saved.initial, saved.facts[2, 1]) == (len(table), table.initial, "(v2 1)")
    with np.load(file) as arrays:
        assert list(arrays) == ["states", "cost_to_go", "initial", "unit", "word", "shift", "bits", "facts"]
        np.testing.assert_array_equal(arrays["states"], saved.states)
        np.testing.assert_array_equal(arrays["cost_to_go"], saved.distance)
    file.write_bytes(file.read_bytes()[:3000])
    with pytest.raises(InputFileError, match=r"table\.npz.*no table"):
        open_table(file)


@pytest.mark.parametrize("damage", ["bytes are missing", "another zip", "an open bracket"])
def test_a_damaged_table_is_said_to_be_one(tmp_path, damage):
    file = tmp_path / "table.npz"
    save_table(file, sweep(counter(9)))
    content = bytearray(file.read_bytes())
    match damage:
        case "bytes are missing":
            del content[100:140]
        case "another zip":  # of a later version: the field of the first entry of the central directory
            content[content.index(b"PK\x01\x02") + 6] = 75
        case "an open bracket":
            content[content.index(b"}")] = ord("(")
    file.write_bytes(content)
    with pytest.raises(InputFileError, match=r"table\.npz.*no table"):
        open_table(file)


def test_a_table_whose_arrays_do_not_belong_together_is_refused(tmp_path):
    """A file as another version might write it: without an array, or with another shape, type or field."""
    file = tmp_path / "table.npz"
    save_table(file, sweep(counter(3)))
    with np.load(file) as arrays:
        found = {name: arrays[name] for name in arrays.files}
    np.savez(file, **found)
    assert len(open_table(file)) == len(found["cost_to_go"])
    wrong = {
        "states": [found["states"][:-1], found["states"][:, :0], found["states"][:, 0], found["states"].astype(float)],
        "cost_to_go": [found["cost_to_go"][:-1], found["cost_to_go"].astype(float), found["cost_to_go"][:, None]],
        "initial": [np.array(-1), np.array(len(found["states"])), np.array(0.0), np.array([0])],
        "facts": [found["facts"][0], found["facts"][:-1], np.zeros((3, 2))],
        "word": [found["word"] + 1, np.array(["text"])],
        "shift": [found["shift"] + 1, found["shift"][:-1]],
        "bits": [found["bits"] + 1, found["bits"] * 1j],
    }
    for name, values in wrong.items():
        for value in [*values, None]:
            np.savez(file, **{**found, name: value} if value is not None else without(found, name))
            with pytest.raises(InputFileError, match=r"table\.npz: no table of costs-to-go"):
                open_table(file)


def without(arrays, name):
    return {other: array for other, array in arrays.items() if other != name}
