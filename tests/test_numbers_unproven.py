"""Numbers that no condition bounds: values are tried until they are all, or a plan within them is optimal."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner import LimitError, Limits, PDDLError, Task, astar, cost_to_go, instance, load, sweep
from planner.pddl.reader import read

FREE = """(:functions (n)) (:action up :parameters () :effect (increase (n) 2))
  (:action down :parameters () :effect (decrease (n) 3))"""
SWING = """(:predicates (left) (right)) (:functions (n) (k))
  (:action up :parameters () :precondition (and (left) (< (k) 9))
    :effect (and (increase (n) (k)) (increase (k) 1) (not (left)) (right)))
  (:action down :parameters () :precondition (right) :effect (and (decrease (n) (k)) (not (right)) (left)))"""


def written(folder: Path, domain: str, problem: str) -> Path:
    (folder / "domain.pddl").write_text(f"(define (domain d) (:requirements :adl :fluents) {domain})")
    (folder / "p.pddl").write_text(f"(define (problem p) (:domain d) {problem})")
    return folder / "p.pddl"


def loaded(folder: Path, domain: str, problem: str, most_values: int = 1_000) -> Task:
    return load(written(folder, domain, problem), most_values=most_values)


def test_a_swing_is_swept_once_all_its_states_are_known(tmp_path: Path) -> None:
    task = loaded(tmp_path, SWING, "(:init (left) (= (n) 0) (= (k) 0)) (:goal (= (n) -4))")
    table = sweep(task)
    assert not task.beyond
    assert (len(table), table[table.initial]) == (19, 8)  # up and down in turn, k from 0 to 9: n falls by one each time
    assert not any("beyond" in fact for variable in task.variables for fact in variable.facts)


def test_too_little_time_is_no_refusal_of_the_file(tmp_path: Path) -> None:
    file = written(tmp_path, FREE, "(:init (= (n) 0)) (:goal (= (n) 1))")
    with pytest.raises(LimitError, match="out of time while the values of numbers"):
        load(file, limits=Limits(seconds=1e-9))


def test_states_of_a_number_without_an_end_are_solved_on_demand(tmp_path: Path) -> None:
    task = loaded(tmp_path, FREE, "(:init (= (n) 0)) (:goal (= (n) 1))")
    assert "no bound is proven, so that states are solved on demand" in str(task.note)
    assert sorted(astar(task)[1] or []) == ["(down)", "(up)", "(up)"]
    with pytest.raises(LimitError, match="a number has no proven bound"):
        sweep(task)
    answers = cost_to_go(task)
    rows = answers.choices([answers.initial])
    after = dict(zip((task.actions[each] for each in rows.actions), answers.lookup(rows.targets), strict=True))
    assert answers.method == "on-demand"
    assert after == {"(up)": 2, "(down)": 2}


def test_nothing_is_said_of_a_state_that_is_beyond(tmp_path: Path) -> None:
    task = loaded(tmp_path, FREE, "(:init (= (n) 0)) (:goal (= (n) 1))")
    ((variable, value),) = task.beyond
    state = [value if number == variable else first for number, first in enumerate(task.initial)]
    with pytest.raises(LimitError, match="may need more values of n than were tried"):
        astar(task, state)


def test_a_plan_that_needs_more_values_is_refused_by_name(tmp_path: Path) -> None:
    problem = "(:init (= (n) 0)) (:goal (= (n) 40))"
    with pytest.raises(PDDLError, match=r"\(n\) grows without a limit \(up\) and falls without a limit \(down\)"):
        loaded(tmp_path, FREE, problem, most_values=16)
    assert astar(loaded(tmp_path, FREE, problem, most_values=256))[0] == 20


def test_a_plan_that_leaves_the_values_is_never_taken_for_one(tmp_path: Path) -> None:
    """The cheapest plan goes through a value that is far away; within few values there is a dear one."""
    domain = """(:functions (n)) (:action double :parameters () :effect (scale-up (n) 2))
      (:action less :parameters () :effect (decrease (n) 1))
      (:action leap :parameters () :precondition (>= (n) 64) :effect (assign (n) -9))"""
    task = loaded(tmp_path, domain, "(:init (= (n) 2)) (:goal (= (n) -9))")
    assert astar(task)[0] == 6  # five times double, then leap


@pytest.mark.parametrize(
    "unused", [":timed-initial-literals", ":continuous-effects", ":preferences", ":constraints", ":object-fluents"]
)
def test_a_requirement_that_is_not_used_is_accepted(unused: str, tmp_path: Path) -> None:
    file = written(tmp_path, FREE.replace("(n)", "(m)"), "(:init (= (m) 0)) (:goal (= (m) 1))")
    domain = file.with_name("domain.pddl")
    domain.write_text(domain.read_text().replace(":fluents", f":fluents {unused}"))
    assert read(instance(file)).numeric
