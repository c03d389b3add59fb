"""Small random STRIPS tasks, from PDDL text to the cost-to-go of every state, compared with Fast Downward's A*."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from conftest import write_instance
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from planner import astar, load, sweep, verify
from planner.grounding.task import plan_cost

ATOMS = [f"(p{i})" for i in range(5)]
some_atoms = st.lists(st.sampled_from(ATOMS), max_size=2, unique=True)
several_atoms = st.lists(st.sampled_from(ATOMS), min_size=1, max_size=3, unique=True)
# Preconditions, negative preconditions, add and delete effects, and the cost of each action.
actions = st.lists(
    st.tuples(some_atoms, some_atoms, several_atoms, some_atoms, st.integers(0, 3)), min_size=1, max_size=7
)


def conjunction(positive: list[str], negative: list[str]) -> str:
    return f"(and {' '.join(positive)} {' '.join(f'(not {atom})' for atom in negative)})"


@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(actions, some_atoms, several_atoms, st.booleans())
def test_every_state_equals_fast_downward(
    drawn: list[tuple[list[str], list[str], list[str], list[str], int]], init: list[str], goal: list[str], costs: bool
) -> None:
    text = ["(define (domain random) (:requirements :strips :negative-preconditions :action-costs)"]
    text += [f"(:predicates {' '.join(ATOMS)})", "(:functions (total-cost) - number)"]
    for number, (need, forbid, add, delete, cost) in enumerate(drawn):
        condition = conjunction(need, [atom for atom in forbid if atom not in need])
        effect = conjunction(add, [atom for atom in delete if atom not in add])[:-1]
        text.append(f"(:action a{number} :parameters () :precondition {condition}")
        text.append(f"  :effect {effect} (increase (total-cost) {cost})))")
    metric = "(:metric minimize (total-cost))" if costs else ""
    start = f"(define (problem p) (:domain random) (:init {' '.join(init)} (= (total-cost) 0))"
    problem = f"{start} (:goal {conjunction(goal, [])}) {metric})"
    with tempfile.TemporaryDirectory() as folder:
        task = load(write_instance(Path(folder), "\n".join([*text, ")"]), problem))
    if task.decided_by_translator:
        assert astar(task)[0] == (0 if set(goal) <= set(init) else float("inf"))
        return
    table = sweep(task)
    assert verify(table, 32, np.random.default_rng(0)) == len(table)
    plan = table.optimal_plan()
    assert (plan is None) == bool(table.dead_end[table.initial])
    if plan is not None:
        assert plan_cost(task, plan) == table[table.initial]
        assert table.is_goal([table.space.follow(plan)])[0]
        # Following optimal choices, whichever, ends at the goal: actions of cost zero lead to no circles.
        best, rng, state = table.optimal_choices(), np.random.default_rng(1), table.initial
        rows = table.space.transitions
        for _ in range(len(table) + 1):
            if table.space.goal[state]:
                break
            row = np.arange(rows.offsets[state], rows.offsets[state + 1])
            state = int(rows.targets[rng.choice(row[best[row]])])
        assert table.space.goal[state]
