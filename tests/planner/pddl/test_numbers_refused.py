"""Wrong files with numbers and durations, of kinds that people write, get one line with the place and what is right."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner import Instance, PDDLError
from planner.pddl.numeric_compiler import Compiler
from planner.pddl.reader import read

DOMAIN = """(define (domain cell)
(:requirements :typing :fluents :durative-actions)
(:types bin)
(:predicates (ready) (open ?b - bin))
(:functions (stock ?b - bin) (level) (rate) (far ?a ?b - bin) (spent))
(:action take :parameters (?b - bin)
 :precondition (>= (stock ?b) 1)
 :effect (and (decrease (stock ?b) 1) (increase (spent) 2)))
(:durative-action move :parameters (?a ?b - bin)
 :duration (= ?duration (far ?a ?b))
 :condition (and (at start (open ?a)) (over all (open ?b)))
 :effect (and (at start (not (open ?a))) (at end (ready))))
)
"""
PROBLEM = """(define (problem p) (:domain cell)
(:objects x y - bin)
(:init (= (stock x) 3) (= (stock y) 2) (= (level) 0) (= (rate) 0)
 (= (far x y) 2) (= (far y x) 2) (open x) (open y))
(:goal (and (ready) (<= (stock x) 1)))
(:metric minimize (+ (total-time) (spent)))
)
"""
WRONG = [
    (
        "domain.pddl:8: (stock x) falls without a limit (take); expected conditions that bound it",
        "(>= (stock ?b) 1)", "(ready)", "(<= (stock x) 1)", "(= (stock x) (stock y))",
    ),
    (
        "domain.pddl:10: action 'move' divides by zero in '(/ (far ?a ?b) (rate))' for (x y)", "(far ?a ?b))",
        "(/ (far ?a ?b) (rate)))",
    ),
    (
        "domain.pddl:7: action 'take' divides by zero in '(/ 1 (rate))' for (x); expected a divisor other than 0",
        "(>= (stock ?b) 1)", "(or (ready) (= (/ 1 (rate)) 2))",
    ),
    (
        "domain.pddl:8: no such function 'stok' in (:functions ...); did you mean 'stock'?",
        "(decrease (stock ?b) 1)", "(decrease (stok ?b) 1)",
    ),
    ("domain.pddl:11: '3' is a number, and the name of an object is", "(open ?a))", "(open 3))"),
    (
        "domain.pddl:7: '?b' is no number; expected a number or (FUNCTION ARGUMENT ...)", "(>= (stock ?b) 1)",
        "(>= (stock ?b) ?b)",
    ),
    (
        "domain.pddl:9: durative action 'move' has no :duration; expected :duration (= ?duration NUMBER)",
        " :duration (= ?duration (far ?a ?b))\n", "",
    ),
    (
        "domain.pddl:11: durative action 'move': '(at strat (open ?a))' is no time with one formula",
        "(at start (open ?a))", "(at strat (open ?a))",
    ),
    (
        "domain.pddl:11: durative action 'move': '(open ?a)' has no time; expected (at start CONDITION)",
        "(at start (open ?a))", "(open ?a)",
    ),
    (
        "domain.pddl:12: durative action 'move': '(ready)' has no time; expected (at start EFFECT) or (at end EFFECT)",
        "(at end (ready))", "(ready)",
    ),
    ("domain.pddl:12: 'when' expects exactly two arguments", "(at end (ready))", "(when (at start (ready)))"),
    (
        "domain.pddl:11: durative action 'move': 'or' joins conditions of different times", "(at start (open ?a))",
        "(or (at start (open ?a)) (over all (open ?b)))",
    ),
    ("domain.pddl:12: durative action 'move': effects happen", "(at end (ready))", "(over all (ready))"),
    (
        "domain.pddl:11: ':precondition' is not expected in action 'move'; did you mean ':condition'?", " :condition",
        " :precondition",
    ),
    ("p.pddl:6: no such function 'total-tme' in (:functions ...)", "(total-time)", "(total-tme)"),
    ("domain.pddl:8: action 'take' lets '(stock ?b)' fall", "(+ (total-time) (spent))", "(stock x)"),
    (
        "domain.pddl:8: action 'take' assigns '(spent)', which the metric minimizes; expected that it only grows",
        "(increase (spent) 2)", "(assign (spent) 2)",
    ),
    ("p.pddl:6: the metric subtracts '(spent)'", "(+ (total-time) (spent))", "(- (total-time) (spent))"),
    ("p.pddl:6: the metric is not linear", "(+ (total-time) (spent))", "(* (total-time) (spent))"),
    ("domain.pddl:8: action 'take' lets '(spent)' fall", "(increase (spent) 2)", "(increase (spent) -2)"),
    ("domain.pddl:9: (move x y) has a duration of -2", "(= (far x y) 2)", "(= (far x y) -2)"),
    ("domain.pddl:9: (move x y) has a duration of -2", "(= (far x y) 2)", "(= (far x y) -2)", "?a", "?value"),
    (
        "domain.pddl:8: 'decrease' expects exactly two arguments; expected (decrease (FUNCTION ARGUMENT ...) NUMBER)",
        "(decrease (stock ?b) 1)", "(decrease (stock ?b) 1 2)",
    ),
    (
        "domain.pddl:7: unknown predicate '=='; expected (= (FUNCTION ARGUMENT ...) NUMBER)", "(>= (stock ?b) 1)",
        "(== (stock ?b) 1)",
    ),
    (
        "domain.pddl:8: unknown predicate 'subtract'; expected (decrease (FUNCTION ARGUMENT ...) NUMBER)",
        "(decrease (stock ?b) 1)", "(subtract (stock ?b) 1)",
    ),
    (
        "p.pddl:3: unknown predicate 'assign'; expected (= (FUNCTION ARGUMENT ...) NUMBER)", "(= (stock x) 3)",
        "(assign (stock x) 3)",
    ),
    ("p.pddl:3: '2,5' is no number; expected", "(= (stock x) 3)", "(= (stock x) 2,5)"),
    ("p.pddl:4: '2min' is no number", "(= (far x y) 2)", "(= (far x y) 2min)"),
    ("domain.pddl:10: durative action 'move': '5' is no duration", "(= ?duration (far ?a ?b))", "5"),
    ("domain.pddl:7: 'open' is a predicate, and a number is", "(>= (stock ?b) 1)", "(>= (open ?b) 1)"),
    ("domain.pddl:7: unknown predicate 'stock': it is a function", "(>= (stock ?b) 1)", "(stock ?b)"),
    (
        "p.pddl:6: trajectory constraints (:constraints) are not supported; write them as conditions of actions",
        "(:metric", "(:constraints (always (ready)))\n(:metric",
    ),
    ("domain.pddl:7: ?duration is known in durative actions only", "(>= (stock ?b) 1)", "(>= (stock ?b) ?duration)"),
    (
        "domain.pddl:10: durative action 'move': '(> ?duration 2)' is no duration; expected (= ?duration NUMBER)",
        "(= ?duration (far ?a ?b))", "(> ?duration 2)",
    ),
    (
        "domain.pddl:7: '((stock ?b) >= 1)': '>=' stands first; expected (>= NUMBER NUMBER)", "(>= (stock ?b) 1)",
        "((stock ?b) >= 1)",
    ),
    (
        "domain.pddl:8: '((rate) + 2)': '+' stands first; expected (+ NUMBER NUMBER)", "(increase (spent) 2)",
        "(increase (spent) ((rate) + 2))",
    ),
    (
        "domain.pddl:7: unknown predicate 'decrease'; it changes a number, and is expected in :effect only",
        "(>= (stock ?b) 1)", "(decrease (stock ?b) 1)",
    ),
    (
        "domain.pddl:7: '<=' expects exactly two arguments; expected (<= NUMBER NUMBER)", "(>= (stock ?b) 1)",
        "(<= 1 (stock ?b) 5)",
    ),
    (
        "p.pddl:3: '(>= (stock x) 3)' is a condition; expected the number itself, (= (FUNCTION ARGUMENT ...) NUMBER)",
        "(= (stock x) 3)", "(>= (stock x) 3)",
    ),
    ("domain.pddl:7: (total-time) is known in (:metric ...) only", "(>= (stock ?b) 1)", "(<= (total-time) 30)"),
    (
        "domain.pddl:8: no such function 'max' in (:functions ...); expected a function, or + - * /",
        "(increase (spent) 2)", "(increase (spent) (max 2 (rate)))",
    ),
    ("p.pddl:3: '(stock x)' has another value on line 3", "(= (stock x) 3)", "(= (stock x) 3) (= (stock x) 4)"),
    ("domain.pddl:11: action 'move' has a second :duration", " :duration", " :duration (= ?duration 3)\n :duration"),
    (
        "domain.pddl:8: (stock x)", "(decrease (stock ?b) 1)", "(scale-up (stock ?b) 1000000000000)",
        "(<= (stock x) 1)", "(= (stock x) 7)",
    ),
    (
        "domain.pddl:8: action 'take' changes '(stock ?b)' twice at one time", "(decrease (stock ?b) 1)",
        "(decrease (stock ?b) 1) (assign (stock ?b) 4)",
    ),
]  # fmt: skip
"""Words of a message, and the changes that lead to it: what is replaced in one of the files, and by what."""


def faults(folder: Path, domain: str, problem: str) -> str:
    """Return the message for the two texts of files."""
    instance = Instance(folder / "p.pddl", folder / "domain.pddl")
    instance.domain.write_text(domain)
    instance.problem.write_text(problem)
    with pytest.raises(PDDLError) as error:
        Compiler(read(instance)).compilation()
    assert "\n" not in str(error.value)
    assert error.value.line is not None
    return str(error.value)


@pytest.mark.parametrize("fault", WRONG, ids=lambda fault: fault[0])
def test_a_wrong_file_gets_one_line_with_its_place(tmp_path: Path, fault: tuple[str, ...]) -> None:
    texts = [DOMAIN, PROBLEM]
    for old, new in zip(fault[1::2], fault[2::2], strict=True):
        assert any(old in text for text in texts)
        texts = [text.replace(old, new) for text in texts]
    assert fault[0] in faults(tmp_path, *texts).replace(str(tmp_path) + "/", "")


def test_the_files_without_faults_are_compiled(tmp_path: Path) -> None:
    instance = Instance(tmp_path / "p.pddl", tmp_path / "domain.pddl")
    instance.domain.write_text(DOMAIN)
    instance.problem.write_text(PROBLEM)
    compilation = Compiler(read(instance)).compilation()
    assert dict(compilation.compiled) == {"durations": 1, "numbers": 1}


def test_a_free_duration_cannot_be_read(tmp_path: Path) -> None:
    domain = DOMAIN.replace("(= ?duration (far ?a ?b))", "(>= ?duration 2)").replace(
        "(at end (ready))", "(at end (ready)) (at end (increase (spent) ?duration))"
    )
    assert "reads ?duration, and the duration is free; expected (= ?duration NUMBER)" in faults(
        tmp_path, domain, PROBLEM
    )


def test_costs_beyond_the_largest_after_scaling_are_refused(tmp_path: Path) -> None:
    domain = DOMAIN.replace("(increase (spent) 2)", "(increase (spent) 100000000000.001)")
    assert "more than 1000000000000 units of 0.001, the unit in which" in faults(tmp_path, domain, PROBLEM)


@pytest.mark.slow  # ten seconds of work are done first
def test_very_many_comparisons_are_refused_soon(tmp_path: Path) -> None:
    """Work is counted: a learned precondition of hundreds of comparisons is no reason to wait for a minute."""
    guards = " ".join(f"(<= (+ (* (level) -0.{n:03}) (far ?a ?b)) {n})" for n in range(1, 400))
    domain = f"""(define (domain d) (:requirements :typing :fluents) (:types bin)
      (:functions (far ?a ?b - bin) (level))
      (:action move :parameters (?a ?b ?c - bin) :precondition (and (< (level) 9) {guards} (<= (far ?b ?c) 99))
       :effect (increase (level) (+ (far ?a ?b) (far ?b ?c)))))"""
    bins = [f"b{n}" for n in range(20)]
    values = " ".join(f"(= (far {a} {b}) 1)" for a in bins for b in bins)
    problem = f"""(define (problem p) (:domain d) (:objects {" ".join(bins)} - bin)
      (:init (= (level) 0) {values}) (:goal (= (level) 4)))"""
    (tmp_path / "domain.pddl").write_text(domain)
    (tmp_path / "p.pddl").write_text(problem)
    with pytest.raises(PDDLError, match="action 'move' changes numbers for too many combinations of objects"):
        Compiler(read(Instance(tmp_path / "p.pddl", tmp_path / "domain.pddl"))).compilation()
