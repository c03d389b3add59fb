"""Compiled numeric and durative tasks have the costs and the states of their original meaning."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
import random_numeric
from direct_search import Answer, Direct, UnsupportedError

from planner import PDDLError, astar, instance, load, sweep
from planner.pddl.compilation import compiled
from planner.pddl.reader import read


def compared(seed: int, folder: Path) -> bool:
    """Compare a random task with the direct search; return whether it was worth a comparison."""
    texts = random_numeric.draw(seed)
    direct = Direct(texts.domain, texts.problem)
    try:
        answer: Answer = direct.search(400)
    except UnsupportedError:
        return False
    if not answer.known or (answer.states is not None and answer.states < 4):
        return False
    (folder / "domain.pddl").write_text(texts.domain, encoding="utf-8")
    (folder / "p.pddl").write_text(texts.problem, encoding="utf-8")
    try:
        made = compiled(read(instance(folder / "p.pddl")))
        task = load(folder / "p.pddl")
    except PDDLError as error:
        if not re.search(r"without a limit|no proven limit|more than \d+ values", error.message):
            raise
        return False  # no bound is proven, which is no wrong answer
    if task.decided_by_translator:
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
    return True


@pytest.mark.parametrize("first", range(0, 60, 10))
def test_random_tasks_have_the_cost_and_the_states_of_their_meaning(first: int, tmp_path: Path) -> None:
    assert sum(compared(seed, tmp_path) for seed in range(first, first + 10)) >= 1


@pytest.mark.slow
@pytest.mark.parametrize("first", range(1_000, 2_400, 100))
def test_more_random_tasks_have_the_cost_and_the_states_of_their_meaning(first: int, tmp_path: Path) -> None:
    assert sum(compared(seed, tmp_path) for seed in range(first, first + 100)) >= 30


def test_functions_that_nothing_reads_or_changes_leave_a_classical_task(tmp_path: Path) -> None:
    """The domain requires numeric fluents, which Fast Downward's translator does not know."""
    assert compared(1266, tmp_path)
