"""Tasks, states and plans of the planner draw themselves in a notebook, through whatever draws."""

from __future__ import annotations

import pickle
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from conftest import KITTING

import planner
from assist.drawing import draw, notebook
from planner import OnDemand, astar, cost_to_go, load
from planner.system import results

PYPROJECT = Path(planner.__file__).parents[1] / "pyproject.toml"


@pytest.fixture(autouse=True)
def installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let what `pyproject.toml` declares be installed, also where it was added after the installation."""
    declared = tomllib.loads(PYPROJECT.read_text())["project"]["entry-points"][results.GROUP]
    points = tuple(EntryPoint(name, value, results.GROUP) for name, value in declared.items())
    monkeypatch.setattr(results, "_drawers", lambda: points)


def texts(svg: str | None) -> str:
    assert svg is not None
    return " ".join("".join(ElementTree.fromstring(svg).itertext()).split())


def test_a_task_a_state_and_a_plan_are_pictures() -> None:
    table = cost_to_go("kitting/tiny")
    assert "in storage" in texts(table.task._repr_svg_())
    goal = int(table.h.argmin())
    assert "Goal: 4 of 4" in texts(table.state(goal)._repr_svg_())
    plan = table.optimal_plan()
    assert f"Step 1 of {len(plan)}" in texts(plan._repr_svg_())
    assert draw(plan).svg == plan._repr_svg_()
    later = table.optimal_plan(goal)
    assert later == []
    assert "End" in texts(later._repr_svg_())


@pytest.mark.parametrize("how", [lambda task: OnDemand(task).optimal_plan(), lambda task: astar(task)[1]])
def test_every_plan_is_a_list_that_knows_its_task(how: Any) -> None:
    task = load("kitting/tiny")
    plan = how(task)
    assert isinstance(plan, list)
    assert len(plan) == 6
    again = pickle.loads(pickle.dumps(plan))
    assert (again, again.task, again.start) == (plan, task, task.initial)
    assert again._repr_svg_() == plan._repr_svg_() is not None


def test_a_dead_end_says_so() -> None:
    sealed = cost_to_go("kitting/sealed")
    lost, open_ = sealed.state(int(sealed.h.argmax())), sealed.state()
    assert "It can no longer be reached." in texts(lost._repr_svg_())
    assert "It can no longer be reached." not in texts(open_._repr_svg_())


def test_a_state_says_its_facts_and_cost() -> None:
    table = cost_to_go("kitting/tiny")
    state = table.state()
    assert repr(state).startswith(f"<State {table.initial} of tiny, h* 6: ")
    assert (state.h, state.values) == (6.0, table.task.initial)
    assert state.facts == table.task.facts(table.task.initial)
    assert OnDemand(table.task).state() == state.__class__(table.task, 0, state.values, 6.0)
    with pytest.raises(IndexError):
        table.state(len(table))


def test_what_would_be_endless_or_cannot_be_drawn_is_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    table = cost_to_go("kitting/tiny")
    plan = table.optimal_plan()
    monkeypatch.setattr(notebook, "MOST_FRAMES", len(plan))
    assert plan._repr_svg_() is None
    monkeypatch.setattr(notebook, "MOST_OBJECTS", 2)
    assert table.task._repr_svg_() is None
    monkeypatch.undo()
    for name in ("domain", "tiny"):
        (tmp_path / f"{name}.pddl").write_text((KITTING / f"{name}.pddl").read_text())
    (tmp_path / "drawing.toml").write_text("[")
    monkeypatch.setattr(results, "_drawers", lambda: (EntryPoint("a", "assist.drawing.notebook:svg_of", "b"),))
    assert load(tmp_path / "tiny.pddl")._repr_svg_() is None
    monkeypatch.setattr(results, "_drawers", tuple)
    assert table.task._repr_svg_() is None
