"""Functions without arguments that are written as words, and functions that never have a value, as they were met."""

from __future__ import annotations

from pathlib import Path

import pytest
from conftest import invoke, write_instance

from planner import PDDLError, cost_to_go, load, sweep

pytestmark = pytest.mark.cases

DOMAIN = """
(define (domain w) (:requirements :typing :numeric-fluents) (:types place) (:constants spare - place)
 (:predicates (at ?x - place) (road ?x ?y - place)) (:functions (battery))
 (:action walk :parameters (?x ?y - place) :precondition (and (at ?x) (road ?x ?y) (>= battery 1))
  :effect (and (not (at ?x)) (at ?y) (decrease battery (/ (+ battery battery) (* 2 battery))))))
"""
PROBLEM = """
(define (problem w1) (:domain w) (:objects a b c - place)
 (:init (at a) (road a b) (road b c) (= (battery) 3)) (:goal (and (at c) (<= battery 1))))
"""


def solved(folder: Path, domain: str, problem: str) -> str:
    done = invoke("solve", write_instance(folder, domain, problem))
    assert done.exit_code == 0, done.output
    return done.output


def test_a_function_without_brackets_is_the_function(tmp_path: Path) -> None:
    assert "(walk a b)\n(walk b c)" in solved(tmp_path, DOMAIN, PROBLEM)


WAYS = """
(define (domain ways) (:requirements :typing :durative-actions :numeric-fluents) (:types place)
 (:predicates (at ?x - place)) (:functions (distance ?x ?y - place))
 (:durative-action roll :parameters (?x ?y - place) :duration (= ?duration (distance ?x ?y))
  :condition (at start (at ?x)) :effect (and (at start (not (at ?x))) (at end (at ?y)))))
"""


def test_a_way_whose_length_was_forgotten_is_told(tmp_path: Path) -> None:
    """The action is not applicable there, so that the plan is a detour; a sparse table of ways is meant."""
    pairs = [(x, y) for x in "abc" for y in "abc" if x != y]

    def printed(known: list[tuple[str, str]]) -> str:
        ways = " ".join(f"(= (distance {x} {y}) 2)" for x, y in known)
        problem = f"(define (problem w) (:domain ways) (:objects a b c - place) (:init (at a) {ways}) (:goal (at c)))"
        return " ".join(solved(tmp_path, WAYS, problem).split())

    assert "has no value" not in printed(pairs)
    said = "(distance a c) has no value, so that roll is not applicable there"
    assert said in printed([pair for pair in pairs if pair != ("a", "c")])
    assert "has no value" not in printed([("a", "b"), ("b", "c")])


def test_a_plan_in_one_text_and_a_folder_in_place_of_a_file_are_told(tmp_path: Path) -> None:
    solved(tmp_path, DOMAIN, PROBLEM)
    with pytest.raises(TypeError, match=r"plan '\(walk a b\)': expected a list of actions, such as \['\(walk a b\)'\]"):
        sweep(tmp_path / "problem.pddl").space.follow("(walk a b)")
    with pytest.raises(PDDLError, match=r"is a folder; expected the file of a problem"):
        cost_to_go(tmp_path)


def test_a_function_that_never_has_a_value_is_told(tmp_path: Path) -> None:
    """Such a comparison never holds: here nothing can be done."""
    said = "(battery) has no value at the beginning, so that no comparison with it holds, as in the condition of walk"
    printed = solved(tmp_path, DOMAIN, PROBLEM.replace("(= (battery) 3)", ""))
    assert "unsolvable" in printed
    assert said in " ".join(printed.split())
    assert said in str(load(tmp_path / "problem.pddl").note)
    given = DOMAIN.replace(
        "(:action walk", "(:action charge :parameters () :effect (assign (battery) 2)) (:action walk"
    )
    needs = given.replace("charge :parameters ()", "charge :parameters () :precondition (and (< (battery) 3))")
    timed = DOMAIN.replace(
        "(:action walk",
        """(:durative-action charge :parameters () :duration (= ?duration 1)
        :condition (at start (< (battery) 3)) :effect (at end (assign (battery) 2))) (:action walk""",
    )
    in_both = "so that no comparison with it holds, as in the conditions of charge, walk"
    for domain, told in ((given, False), (needs, True)):
        (tmp_path / "domain.pddl").write_text(domain)
        note = str(load(tmp_path / "problem.pddl").note)
        assert (in_both in note, "has no value" in note) == (told, told)
    assert in_both in " ".join(solved(tmp_path, timed, PROBLEM.replace("(= (battery) 3)", "")).split())
