"""Results in a notebook: a table or a line, a frame, comparison by value, and pickling."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from assist import Pool, compare, simulate
from assist.certify import certify
from assist.people import Choices, HumanModel
from assist.person import AssistPOMDP, solve
from planner import cost_to_go
from planner.system.results import MOST_ROWS, html_table, same


@pytest.fixture(scope="module")
def results() -> dict[str, Any]:
    table = cost_to_go("kitting/tiny")
    pool = Pool.sample(table, 3, seed=0)
    episodes = simulate(pool, "attention", humans=2, episodes=4, seed=0)
    bound, [certificate] = certify(pool, ["none"], team=(0, 1), episodes=10, seed=0)
    problem = AssistPOMDP.of(HumanModel.exact(Choices.of(table)), c_suggest=0.5)
    return {
        "table": table, "pool": pool, "episodes": episodes, "summary": episodes.summary(), "bound": bound,
        "comparison": compare(pool, ["none", "attention"], humans=2, episodes=4, seed=0),
        "certificate": certificate,
        "solution": solve(problem, gap=0.5),
    }  # fmt: skip


NAMES = ["table", "pool", "episodes", "summary", "bound", "comparison", "certificate", "solution"]


@pytest.mark.parametrize("name", NAMES)
def test_a_result_is_a_line_a_table_and_a_frame_and_survives_pickling(results: dict[str, Any], name: str) -> None:
    found = results[name]
    assert len(repr(found).splitlines()[0]) < 500
    shown = found._repr_html_()
    assert shown.startswith("<table>")
    assert "<td>" in shown
    assert len(found.to_frame()) >= 1
    again = pickle.loads(pickle.dumps(found))
    assert again == found


def test_results_that_differ_are_not_equal(results: dict[str, Any]) -> None:
    pool, episodes, table = results["pool"], results["episodes"], results["table"]
    assert pool != Pool.sample(table, 3, seed=1)
    assert pool == Pool.sample(table, 3, seed=0)
    assert episodes != simulate(pool, "attention", humans=2, episodes=4, seed=1)
    assert table != cost_to_go("kitting/paper")
    assert table != 3
    assert results["bound"] != replace(results["bound"], upper=0.0)
    with pytest.raises(TypeError, match="unhashable"):
        hash(pool)


def test_a_pool_is_shown_with_its_people(results: dict[str, Any]) -> None:
    frame = results["pool"].to_frame()
    assert frame["beta"].tolist() == [human.beta for human in results["pool"].people]
    assert f"{results['pool'].people[1].theta:.4g}" in results["pool"]._repr_html_()


def test_long_tables_are_cut_and_say_so() -> None:
    pool = Pool.sample("kitting/tiny", MOST_ROWS + 5, seed=0)
    shown = pool._repr_html_()
    assert shown.count("<tr>") == MOST_ROWS + 1
    assert shown.endswith("<p>25 rows</p>")
    assert len(pool.to_frame()) == MOST_ROWS + 5


def test_what_cells_hold_is_no_markup() -> None:
    assert "<b>" not in html_table([{"<b>": "<b>"}])


@given(st.lists(st.floats(), max_size=5), st.lists(st.floats(), max_size=5))
def test_arrays_are_equal_by_entries(one: list[float], other: list[float]) -> None:
    a, b = np.array(one), np.array(other)
    assert same([a], [b]) == (len(a) == len(b) and bool(((a == b) | (np.isnan(a) & np.isnan(b))).all()))
    assert same((a, "x"), (a.copy(), "x"))
    assert not same((a, "x"), [a, "x"])
