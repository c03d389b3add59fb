"""The table of a task is the same by ranks, in a registry and by orbits: that of Dijkstra on `semantics`."""

from __future__ import annotations

import heapq
import math
import random
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_dense import composed, only_dense
from test_sweep import COMPILED, UNLISTED, numbering, random_task, sweep
from test_symmetry import copies

from planner import CostToGo, Effect, LimitError, OnDemand, Operator, Packing, Table, Task, Variable
from planner.costtogo.orbit_table import orbits
from planner.grounding import semantics
from planner.search.automorphisms import symmetries
from planner.search.ranked_index import RankedIndex
from planner.search.state_registry import RegistryIndex

State = tuple[int, ...]


def reference(task: Task) -> dict[State, float]:
    """Return h* of every reachable state, from `semantics` alone."""
    initial = tuple(semantics.derived(task, task.initial))
    into: dict[State, list[tuple[int, State]]] = {initial: []}
    waiting = [initial]
    for state in waiting:  # which grows meanwhile
        for action, after in semantics.successors(task, state).items():
            target = tuple(after)
            if target not in into:
                into[target] = []
                waiting.append(target)
            into[target].append((task.costs[action], state))
    h = dict.fromkeys(into, math.inf)
    queue = [(0, state) for state in into if all(state[v] == value for v, value in task.goal)]
    while queue:
        d, state = heapq.heappop(queue)
        if d < h[state]:
            h[state] = d
            for cost, source in into[state]:
                heapq.heappush(queue, (d + cost, source))
    return h


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


def equal(table: Table, expected: dict[State, float]) -> None:
    values = table.values(np.arange(len(table)))
    assert dict(zip(map(tuple, values.tolist()), table.h.tolist(), strict=True)) == expected
    assert values[table.initial].tolist() == semantics.derived(table.task, table.task.initial)
    steps(table, random.Random(len(table)).sample(range(len(table)), min(len(table), 9)))


def steps(known: CostToGo, states: list[int]) -> None:
    """Compare the transitions of some states with the reference."""
    offsets, actions, targets = known.choices(states)
    for at, values in enumerate(known.values(states).tolist()):
        own = slice(offsets[at], offsets[at + 1])
        found = dict(zip(actions[own].tolist(), known.values(targets[own]).tolist(), strict=True))
        assert found == semantics.successors(known.task, values)
        assert list(found) == sorted(found)


def check(task: Task, *, symmetric: bool = True) -> set[str]:
    """Compare all indices that are possible with the reference; return which these are."""
    expected, found = reference(task), {"registry"}
    equal(sweep(task), expected)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(numbering, "split_operators", lambda *_: None)
        table = sweep(task, options=COMPILED)
        assert isinstance(table.space.numbering, RegistryIndex) or not task.operators
        equal(table, expected)
    for dense in (False, True):
        with pytest.MonkeyPatch.context() as patch:
            if dense:
                only_dense(patch)
            table = sweep(task, options=UNLISTED)
            equal(table, expected)
            if isinstance(table.space.numbering, RankedIndex):
                found.add("dense" if dense else "plain")
    asked = OnDemand(task)
    steps(asked, asked.numbers(list(expected)[:9]).tolist())
    if not symmetric:
        return found
    try:
        by_orbits = orbits(task, max_orbits=10**6)
    except LimitError:
        assert symmetries(task) is None
        return found
    states = list(expected)
    h = by_orbits.whole(Packing.of(task).pack(np.array(states)))
    assert dict(zip(states, h.tolist(), strict=True)) == expected
    return found | {"orbits"}


COSTS = st.sampled_from([range(1, 2), range(3), range(1), range(3, 90_000, 11), range(0, 10**12, 10**11 + 1)])


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.integers(0, 10**6),
    COSTS,
    st.sampled_from(["random", "axioms", "composed", "copies"]),
    st.sampled_from([0, 1, 3, 70]),  # the last ones take a second word
    st.booleans(),
)
def test_all_indices_agree_with_the_definition(seed: int, costs: range, kind: str, dead: int, tied: bool) -> None:
    rng = random.Random(seed)
    if kind == "copies":
        task = copies(rng, rng.randint(2, 3), costs)
    elif kind == "composed":
        task = composed(seed, costs=costs)
    else:
        task = random_task(rng, axioms=kind == "axioms", costs=costs)
    check(with_more(task, rng, dead, tied), symmetric=dead < 70)  # so many equal variables have too many symmetries


def test_each_index_is_compared() -> None:
    rng = random.Random(0)
    assert check(copies(rng, 3, range(1, 2))) == {"registry", "plain", "dense", "orbits"}
    assert check(with_more(random_task(rng, axioms=True), rng, 300, True)) >= {"registry"}
