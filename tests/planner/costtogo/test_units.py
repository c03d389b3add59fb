"""Costs are whole numbers inside searches and in the file's unit everywhere else."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from graphs import graph_task
from hypothesis import given, settings
from hypothesis import strategies as st
from teams import equal, run

from assist import fit, read_log
from assist.live.contrast import contrast
from assist.people.choices import Choices
from assist.person.closed_problem import closed_problem
from assist.person.truncated_task import TruncatedTask
from assist.team.pool import Pool
from planner import OnDemand, Table, Task, Transitions, astar, open_table, optimal_choices, save_table, sweep, verify
from planner.costtogo.astar import check_successors
from planner.costtogo.orbit_table import orbits

TENTHS = [(1, 2, 1), (2, 0, 2), (1, 0, 3), (1, 3, 1), (3, 0, 3)]
"""Two optimal ways from node 1, of cost 1 + 2 and 3, and a worse one."""


def scaled(task: Task, factor: int, unit: Fraction = Fraction(1)) -> Task:
    """The task with costs times `unit` in the file's unit, written as multiples of a unit that is `factor` smaller."""
    return replace(task, costs=tuple(cost * factor for cost in task.costs), unit=unit / factor)


def same(a: Choices, b: Choices) -> bool:
    return all(np.array_equal(getattr(a, one.name), getattr(b, one.name)) for one in fields(Choices))


@pytest.fixture(scope="module")
def tenths() -> Table:
    """Costs of tenths: in floating-point numbers, 0.1 + 0.2 is not 0.3."""
    return sweep(scaled(graph_task(TENTHS), 1, Fraction(1, 10)))


def test_the_cost_to_go_is_in_the_files_unit(tenths: Table) -> None:
    assert tenths[tenths.initial] == 0.3
    assert tenths.whole([tenths.initial])[0] == 3
    assert astar(tenths.task)[0] == 0.3
    assert OnDemand(tenths.task).lookup([0])[0] == 0.3
    assert verify(tenths, 10, np.random.default_rng(0)) == check_successors(tenths, 10, np.random.default_rng(0)) == 4


def test_equal_sums_of_decimals_are_equally_good(tenths: Table) -> None:
    start = tenths.initial
    names = [tenths.task.actions[one] for one in tenths.choices([start]).actions[tenths.optimal_choices()[:3]]]
    assert names == ["(go 000)", "(go 002)"]
    found = contrast(tenths, start, "(go 002)", "(go 000)")
    assert (found.difference, found.consequence) == (0.0, None)
    assert contrast(tenths, start, "(go 002)", "(go 003)").difference == pytest.approx(0.1)


def test_neither_of_two_equally_good_choices_is_a_mistake(tenths: Table, tmp_path: Path) -> None:
    (tmp_path / "log.jsonl").write_text(
        "".join(
            json.dumps({"person": "p", "episode": f"{n}", "step": 0, "action": f"(go 00{n})"}) + "\n" for n in (0, 2, 3)
        )
    )
    assert fit(tenths, read_log(tmp_path / "log.jsonl"))["p"].suboptimal_actions == 1


def test_a_saved_table_has_the_unit(tenths: Table, tmp_path: Path) -> None:
    save_table(tmp_path / "t.npz", tenths)
    saved = open_table(tmp_path / "t.npz")
    assert saved.unit == Fraction(1, 10)
    assert np.array_equal(saved.lookup(range(len(saved))), tenths.h)
    with np.load(tmp_path / "t.npz") as arrays:
        assert arrays["unit"].tolist() == [1, 10]


edges = st.lists(st.tuples(st.integers(0, 4), st.integers(0, 4), st.integers(0, 5)), min_size=1, max_size=12)


@settings(max_examples=40, deadline=None)
@given(edges, st.integers(2, 30), st.sampled_from([Fraction(1), Fraction(5, 2), Fraction(1, 10), Fraction(7, 30)]))
def test_a_smaller_unit_changes_nothing(drawn: list[tuple[int, int, int]], factor: int, unit: Fraction) -> None:
    task = graph_task(drawn)
    one, other = (sweep(scaled(task, k, unit), progress=False) for k in (1, factor))
    assert same(Choices.of(one), Choices.of(other))
    assert one.optimal_plan() == other.optimal_plan()
    assert np.array_equal(one.plan_lengths(range(len(one))), other.plan_lengths(range(len(one))))


def test_a_smaller_unit_changes_no_person_and_no_policy(tiny: Table) -> None:
    """A task whose file says 5 for all actions, in halves, is the task with costs 2.5."""
    tasks = [replace(tiny.task, costs=(cost,) * len(tiny.task.costs), unit=unit)
             for cost, unit in ((1, Fraction(5, 2)), (5, Fraction(1, 2)))]  # fmt: skip
    pools = [Pool.sample(sweep(task), 4, seed=1) for task in tasks]
    assert pools[0].choices(0).h[tiny.initial] == 2.5 * tiny[tiny.initial]
    for policy in ("none", "reactive", "attention", "priority"):
        assert equal(*(run(pool, policy, 3, 5, 1) for pool in pools))
    parts = [closed_problem(TruncatedTask.of(sweep(task), states=10)).frontier for task in tasks]
    assert len(parts[0].states) > 0
    assert all(np.array_equal(getattr(parts[0], name), getattr(parts[1], name)) for name in ("lower", "upper"))


def test_orbits_and_single_states_have_the_unit(tiny: Table) -> None:
    task = scaled(tiny.task, 3, Fraction(5, 2))
    swept = orbits(task, max_orbits=10_000)
    states = list(range(0, len(tiny), 7))
    for known in (OnDemand(task, orbits=swept), OnDemand(task)):
        numbers = known.numbers(tiny.values(states))
        assert np.array_equal(known.lookup(numbers), 2.5 * tiny.lookup(states))
        assert np.array_equal(known.known(numbers), 2.5 * tiny.lookup(states))
        rows: Transitions = known.choices(numbers)
        assert optimal_choices(known, numbers, rows).sum() == optimal_choices(tiny, states, tiny.choices(states)).sum()
