"""The translator's grounded task is compared with the parsed files; a difference is an error with its place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from conftest import write_instance
from test_reading import DOMAIN, PROBLEM, RULE

from planner import PDDLError, Task, instance, load, sweep
from planner.grounding import translation
from planner.grounding.fast_downward import translate
from planner.pddl.expressions import listed
from planner.pddl.reader import Reading, read


def both(folder: Path, domain: str = DOMAIN, problem: str = PROBLEM) -> tuple[Reading, Task]:
    instance = write_instance(folder, domain, problem)
    return read(instance), load(instance)


def check(reading: Reading, task: Task, changed: dict[str, str]) -> None:
    """Compare a task whose actions and facts have other names."""

    def name(text: str) -> str:
        return changed.get(text, text)

    variables = tuple(replace(each, facts=tuple(map(name, each.facts))) for each in task.variables)
    translation.check(reading, replace(task, variables=variables, actions=tuple(map(name, task.actions))))


@pytest.mark.parametrize(
    ("old", "new", "place", "words"),
    [
        ("(go red blue)", "(go red red)", ("domain.pddl", 7), r"\(go red red\) costs 0, and 4 for Fast Downward"),
        ("(go red blue)", "(go red nut)", ("domain.pddl", 7), r"has \(go red nut\), with other arguments"),
        ("(go red blue)", "(go red)", ("domain.pddl", 7), "with other arguments than declared"),
        ("(take nut red)", "(take red nut)", ("domain.pddl", 13), "with other arguments than declared"),
        ("(take nut red)", "(steal nut red)", ("domain.pddl", None), "an action .*, which is not in the files"),
        ("Atom at(red)", "Atom at(blue)", ("problem.pddl", 4), r"\(at blue\) holds initially"),
        ("Atom held(nut)", "Atom on(nut, red)", ("problem.pddl", 4), r"\(on nut red\) does not hold initially"),
        ("Atom held(nut)", "Atom held(nut, red)", ("problem.pddl", None), "a fact .*, which is not in the files"),
        ("Atom held(nut)", "Atom held(nuts)", ("problem.pddl", None), "which is not in the files"),
    ],
)  # fmt: skip
def test_a_difference_is_told(tmp_path: Path, old: str, new: str, place: tuple[str, int | None], words: str) -> None:
    reading, task = both(tmp_path)
    check(reading, task, {})
    assert any(old in (*variable.facts, *task.actions) for variable in task.variables)
    with pytest.raises(PDDLError, match=words) as error:
        check(reading, task, {old: new})
    assert (error.value.file.name, error.value.line) == place


def test_without_a_metric_all_actions_cost_one(tmp_path: Path) -> None:
    reading, task = both(tmp_path, problem=PROBLEM.replace("(:metric minimize (total-cost))", ""))
    assert set(task.costs) == {1}
    check(reading, task, {})


def test_derived_facts_and_settled_tasks_agree(tmp_path: Path) -> None:
    domain = DOMAIN.replace("(seen ?x)", "(seen ?x) (idle ?t - tray)").replace(
        "  (:action go", f"  {RULE}\n  (:action go"
    )
    check(*both(tmp_path / "derived", domain), {})
    check(*both(tmp_path / "solved", problem=PROBLEM.replace("(on nut blue)", "(on nut red)")), {})
    check(*both(tmp_path / "unsolvable", problem=PROBLEM.replace("(on nut blue)", "(seen blue)")), {})


def test_a_predicate_may_be_named_like_the_translators_own(tmp_path: Path) -> None:
    """The facts of a task that the translator decided are called dummy; a task with such a predicate is compared."""
    domain, problem = (text.replace("seen", "is-dummy").replace("held", "dummy") for text in (DOMAIN, PROBLEM))
    reading, task = both(tmp_path, domain, problem)
    check(reading, task, {})
    with pytest.raises(PDDLError, match="holds initially"):
        check(reading, task, {"Atom at(red)": "Atom at(blue)"})


def test_a_variable_like_the_translators_own_does_not_make_a_task_decided(tmp_path: Path) -> None:
    domain = """(define (domain d) (:predicates (dummy ?x))
      (:action go :parameters (?a ?b) :precondition (dummy ?a) :effect (and (not (dummy ?a)) (dummy ?b))))"""
    problem = """(define (problem p) (:domain d) (:objects val1 val2) (:init (dummy val1)) (:goal (dummy val2)))"""
    _, task = both(tmp_path, domain, problem)
    assert [variable.facts for variable in task.variables] == [("Atom dummy(val1)", "Atom dummy(val2)")]
    assert not task.decided_by_translator
    assert sweep(task).h.tolist() == [1, 0]


def test_what_the_translator_says_of_a_text_that_it_does_not_read_is_shown_with_the_line_of_the_action() -> None:
    reading = read(instance("kitting/tiny"))
    undeclared = replace(reading, domain=replace(reading.domain, predicates={}))
    with pytest.raises(PDDLError, match="does not read this task: Expected logical operator or predicate") as error:
        translate(undeclared)
    first = next(iter(reading.domain.actions.values()))
    assert (error.value.file.name, error.value.line) == ("domain.pddl", first.place.line)
    without_goal = replace(reading, problem=replace(reading.problem, goal=listed()))
    with pytest.raises(PDDLError, match=r"tiny.pddl: Fast Downward's translator does not read this task: The def"):
        translate(without_goal)
