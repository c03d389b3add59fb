"""Compiled numeric and durative tasks have the costs and the states of their original meaning."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
import random_numeric
from conftest import thinned
from direct_search import Answer, Direct, UnsupportedError

from planner import PDDLError, astar, instance, sweep
from planner.costtogo.number_values import grounded
from planner.pddl.reader import read
from planner.pddl.value_ranges import UnprovenError


def compared(seed: int, folder: Path, *, free: bool = False, edges: bool = False, costs: bool = False) -> str:
    """Compare a random task with the direct search; return how it was solved, or an empty text if it was not."""
    texts = random_numeric.draw(seed, free=free, edges=edges, costs=costs)
    direct = Direct(texts.domain, texts.problem)
    (folder / "domain.pddl").write_text(texts.domain, encoding="utf-8")
    (folder / "p.pddl").write_text(texts.problem, encoding="utf-8")
    try:
        answer: Answer = direct.search(400)
    except UnsupportedError as error:
        if costs and str(error) == "a metric that falls":
            with pytest.raises(PDDLError, match=r"may cost -|has a cost of -"):
                grounded(read(instance(folder / "p.pddl")))
        return ""
    if not answer.known or (answer.states is not None and answer.states < 4):
        return ""
    try:
        made, task = grounded(read(instance(folder / "p.pddl")))
    except UnprovenError:
        assert answer.states is None, "a task with few states is not refused"
        return ""  # its states have no end
    except PDDLError as error:
        if costs and re.search("may cost -|has a cost of -", error.message):
            return ""  # in a state that was not met, or that cannot be reached
        raise
    if task.beyond:
        cost, plan = astar(task)
        assert answer.states is None, "a task with few states is swept"
    elif task.decided_by_translator:
        cost, plan = astar(task)
    else:
        table = sweep(task)
        cost, plan = table[table.initial], table.optimal_plan()
        merged = any(not re.fullmatch(r"-?[\d./]+|undefined", shown) for _, values in made.numbers.values()
                     for shown in values.values())  # fmt: skip
        if answer.states is not None and not merged and direct.changing <= direct.live:
            assert len(table) == answer.states
    assert cost == pytest.approx(math.inf if answer.cost is None else float(answer.cost), abs=1e-9)
    if plan is not None:
        assert direct.replay(plan) == answer.cost
    return "on demand" if task.beyond else "swept"


@pytest.mark.parametrize("first", thinned(range(0, 60, 10), 6))
def test_random_tasks_have_the_cost_and_the_states_of_their_meaning(first: int, tmp_path: Path) -> None:
    assert sum(bool(compared(seed, tmp_path)) for seed in range(first, first + 10)) >= 1


@pytest.mark.slow
@pytest.mark.parametrize("first", range(1_000, 2_400, 100))
def test_more_random_tasks_have_the_cost_and_the_states_of_their_meaning(first: int, tmp_path: Path) -> None:
    assert sum(bool(compared(seed, tmp_path)) for seed in range(first, first + 100)) >= 36


def test_functions_that_nothing_reads_or_changes_leave_a_classical_task(tmp_path: Path) -> None:
    """The domain requires numeric fluents, which Fast Downward's translator does not know."""
    assert compared(1266, tmp_path)


@pytest.mark.parametrize(("free", "seed"), [
    (False, 1002), (True, 1140), pytest.param(False, 1976, marks=pytest.mark.slow),
    pytest.param(True, 1073, marks=pytest.mark.slow),
])  # fmt: skip
def test_a_task_without_a_plan_is_swept_although_nothing_bounds_its_numbers(
    seed: int, free: bool, tmp_path: Path
) -> None:
    """The translator alone decides that there is no plan within the values that are tried, and drops all states."""
    assert compared(seed, tmp_path, free=free) == "swept"


@pytest.mark.parametrize("first", thinned(range(0, 24, 8), 3))
def test_random_tasks_whose_numbers_nothing_bounds(first: int, tmp_path: Path) -> None:
    assert any(compared(seed, tmp_path, free=True) for seed in range(first, first + 8))


@pytest.mark.slow
@pytest.mark.parametrize("first", range(1_000, 1_500, 100))
def test_more_random_tasks_whose_numbers_nothing_bounds(first: int, tmp_path: Path) -> None:
    assert sum(compared(seed, tmp_path, free=True) == "swept" for seed in range(first, first + 100)) >= 10


@pytest.mark.parametrize("first", thinned(range(10, 70, 10), 3))
def test_random_tasks_with_what_is_seldom_written(first: int, tmp_path: Path) -> None:
    """Numbers beyond all thresholds, assignments that read what they change, conditions on all objects or on none."""
    assert sum(bool(compared(seed, tmp_path, edges=True)) for seed in range(first, first + 10)) >= 1


@pytest.mark.slow
@pytest.mark.parametrize("first", range(1_000, 2_000, 100))
def test_more_random_tasks_with_what_is_seldom_written(first: int, tmp_path: Path) -> None:
    assert sum(bool(compared(seed, tmp_path, edges=True)) for seed in range(first, first + 100)) >= 20


@pytest.mark.parametrize("first", thinned(range(0, 60, 10), 3))
def test_random_tasks_whose_costs_read_numbers(first: int, tmp_path: Path) -> None:
    """What costs less than nothing is refused, unless a condition excludes it."""
    assert sum(bool(compared(seed, tmp_path, costs=True)) for seed in range(first, first + 10)) >= 1


@pytest.mark.slow
@pytest.mark.parametrize("first", range(1_000, 1_500, 100))
def test_more_random_tasks_whose_costs_read_numbers(first: int, tmp_path: Path) -> None:
    assert sum(bool(compared(seed, tmp_path, costs=True)) for seed in range(first, first + 100)) >= 20
