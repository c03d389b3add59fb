"""The dense ranking: mutexes, invariants and clusters hold in all reachable states, and tables equal plain search."""

from __future__ import annotations

import random
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from conftest import DOMAINS, costly, thinned
from hypothesis import given
from hypothesis import strategies as st
from plain import explore, task_of
from test_sweep import UNLISTED, check, module, random_task

from planner import Effect, Operator, Task, load
from planner.search.invariants import PRIME, Mutexes, determined, invariants
from planner.search.numbering import Digits, split_operators
from planner.search.variable_clusters import clusters

Draft = tuple[list[int], list[int], list[tuple[dict[int, int], dict[int, int]]]]
"""Domain sizes, an initial state, and operators: what must hold, and what then holds."""


def counters(rng: random.Random) -> Draft:
    """Return a task with items of one kind that move between places, each with a counter."""
    places, total = rng.randint(2, 4), rng.randint(1, 4)
    sizes, initial = [total + 1] * places, [total] + [0] * (places - 1)
    operators = []
    for a in range(places):
        for b in range(places):
            if a != b and rng.random() < 0.7:
                for m in range(1, total + 1):
                    operators += [({a: m, b: n}, {a: m - 1, b: n + 1}) for n in range(total)]
    return sizes, initial, operators


def stacks(rng: random.Random) -> Draft:
    """Return a task with stacked boxes: a variable for each box's support, and one for whether each support is
    clear.
    """
    boxes, places = rng.randint(1, 3), rng.randint(1, 2)
    supports = boxes + places  # boxes come first
    sizes, initial = [supports] * boxes + [2] * supports, [0] * boxes
    below = boxes
    for box in range(boxes):
        initial[box], below = below, box
    standing = set(initial)
    initial += [int(support not in standing) for support in range(supports)]
    operators = [
        ({box: a, boxes + box: 1, boxes + b: 1}, {box: b, boxes + a: 1, boxes + b: 0})
        for box in range(boxes)
        for a in range(supports)
        for b in range(supports)
        if len({a, b, box}) == 3
    ]
    return sizes, initial, operators


def grid(rng: random.Random) -> Draft:
    """Return a task with tokens that move over a row of cells, each with a variable for whether it is occupied."""
    cells, tokens = rng.randint(2, 5), rng.randint(1, 2)
    tokens = min(tokens, cells - 1)
    sizes = [cells] * tokens + [2] * cells
    initial = [*range(tokens), *(int(cell < tokens) for cell in range(cells))]
    operators = [
        ({t: a, tokens + b: 0}, {t: b, tokens + a: 0, tokens + b: 1})
        for t in range(tokens)
        for a in range(cells)
        for b in (a - 1, a + 1)
        if 0 <= b < cells
    ]
    return sizes, initial, operators


def composed(seed: int, *, costs: range) -> Task:
    """A task of some parts, side by side and shuffled, that operators of every other kind disturb."""
    rng = random.Random(seed)
    sizes: list[int] = []
    initial: list[int] = []
    drafts: list[tuple[dict[int, int], dict[int, int]]] = []
    for part in rng.sample([counters, stacks, grid], rng.randint(1, 2)):
        own, start, operators = part(rng)
        at = len(sizes)
        sizes, initial = sizes + own, initial + start
        drafts += [tuple({v + at: value for v, value in side.items()} for side in draft) for draft in operators]  # type: ignore[misc]
    order = rng.sample(range(len(sizes)), len(sizes))
    sizes, initial = ([values[v] for v in np.argsort(order)] for values in (sizes, initial))
    operators_of: list[Operator] = []

    def facts(most: int) -> dict[int, int]:
        chosen = rng.sample(range(len(sizes)), rng.randint(0, min(most, len(sizes))))
        return {v: rng.randrange(sizes[v]) for v in chosen}

    for needs, gains in drafts:
        condition = {order[v]: value for v, value in needs.items()}
        if rng.random() < 0.05:
            condition = {**facts(1), **condition}
        effects = [Effect((), order[v], value) for v, value in gains.items()]
        operators_of.append(Operator(len(operators_of), tuple(condition.items()), tuple(effects)))
    for _ in range(rng.choice([0, 0, 1, 3])):  # conditional effects, unknown values before, dead ends
        effects = [
            Effect(tuple(facts(1).items()) if rng.random() < 0.5 else (), v, value) for v, value in facts(2).items()
        ]
        operators_of.append(Operator(len(operators_of), tuple(facts(3).items()), tuple(effects)))
    prices = tuple(rng.choice(costs) for _ in operators_of)
    return task_of(sizes, operators_of, costs=prices, initial=tuple(initial), goal=tuple(facts(2).items()))


def theorems(task: Task) -> Iterator[str]:
    """Compare claims about reachable states with the enumerated states; yield the claims."""
    moves = split_operators(task)
    assert moves is not None
    mutexes = Mutexes.of(task, moves)
    assert mutexes is not None
    space = explore(task)
    values = space.values(np.arange(len(space)))
    facts = values + mutexes.first[:-1]
    for row in facts:
        assert mutexes.together[np.ix_(row, row)].all()
    basis = invariants(task, mutexes.moves)
    sums = basis[:, facts].sum(axis=2) % PRIME
    assert (sums == sums[:, :1]).all()
    left_out = determined(task, mutexes.moves)
    for place, own in enumerate(left_out):
        yield "determined"
        assert (own.weights[facts].sum(axis=1) % PRIME == own.total).all()
        weight = own.weights[mutexes.first[own.variable] : mutexes.first[own.variable + 1]]
        assert len(set(weight.tolist())) == len(weight)
        for later in left_out[place + 1 :]:
            assert (
                len(set(own.weights[mutexes.first[later.variable] : mutexes.first[later.variable + 1]].tolist())) == 1
            )
    free = [v for v in range(len(task.variables)) if v not in {own.variable for own in left_out}]
    for cluster in clusters(mutexes, task.initial, free):
        if len(cluster.variables) > 1:
            yield "cluster"
        allowed = set(map(tuple, cluster.values.tolist()))
        assert set(map(tuple, values[:, list(cluster.variables)].tolist())) <= allowed


@costly(15, 50)
@given(st.integers(0, 10**6))
def test_all_that_is_said_of_reachable_states_is_true(seed: int) -> None:
    list(theorems(composed(seed, costs=range(1, 2))))
    list(theorems(random_task(random.Random(seed))))


def test_the_tasks_have_what_is_looked_for() -> None:
    said = [what for seed in range(30) for what in theorems(composed(seed, costs=range(1, 2)))]
    assert said.count("determined") > 30
    assert said.count("cluster") > 15


def test_a_counted_task_has_a_dense_ranking() -> None:
    """41 thousand states of a product of 4e9: the ranking leaves little out."""
    task = load(DOMAINS / "depot" / "five-items.pddl")
    with pytest.MonkeyPatch.context() as patch:
        for name in ("numbering", "ranked_index"):
            patch.setattr(f"planner.search.{name}.MANY", 1 << 20)
        table = module.sweep(task, options=UNLISTED)
    assert len(table) == 41_472
    assert table.space.numbering.coding.size < 64 * len(table)


def only_dense(patch: pytest.MonkeyPatch) -> None:
    """Let a ranking by single variables have too many ranks, so that only the dense one is left."""
    patch.setattr(Digits, "of", classmethod(lambda *_: Digits({}, (), 1 << 62, ())))


def tied(count: int, size: int, toggles: int, dead: int = 0) -> Task:
    """Return a task in which some variables change together, others are switched singly, and some never change."""
    sizes = [size] * count + [2] * (toggles + dead)
    moves = [(dict.fromkeys(range(count), a), dict.fromkeys(range(count), (a + 1) % size)) for a in range(size)]
    moves += [({count + t: a}, {count + t: 1 - a}) for t in range(toggles) for a in range(2)]
    moves += [({count + toggles + d: 1}, {count + toggles + d: 0}) for d in range(dead)]
    return task_of(sizes, moves, goal=((0, size - 1),))


@pytest.mark.parametrize(
    "given", thinned([(13, 40, 2, 0), (39, 3, 4, 0), (70, 2, 4, 0), (2, 2, 4, 256), (40, 3, 3, 0), (61, 2, 3, 0)], 3)
)
def test_many_variables_that_determine_each_other_fit_no_word(given: tuple[int, int, int, int]) -> None:
    """Their values together are more than 64 bits, and more variables are constant than a field counts."""
    _, size, toggles, _ = given
    with pytest.MonkeyPatch.context() as patch:
        only_dense(patch)
        table = check(tied(*given), UNLISTED)
    assert len(table) == size * 2**toggles
    assert table.h[table.initial] == size - 1


def test_a_ranking_is_not_looked_for_all_the_time() -> None:
    task = composed(0, costs=range(1, 2))
    plain = module.sweep(task)
    with pytest.MonkeyPatch.context() as patch:
        only_dense(patch)
        options = replace(UNLISTED, ranking_share=-1)  # its share is over before it begins
        assert module.sweep(task, options=options).note is None
        table = module.sweep(task, deadline=time.monotonic() + 60, options=options)
    assert table.note is not None
    assert table.note.endswith("looking for a ranking took too long")
    assert len(table) == len(plain)
    np.testing.assert_array_equal(table.h[table.numbers(plain.values(np.arange(len(plain))))], plain.h)
