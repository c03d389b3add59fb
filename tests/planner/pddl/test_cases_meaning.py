"""Instances whose costs were computed against their meaning, with the right ones: of each state, and of a plan."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from planner import PDDLError, load, sweep
from planner.pddl.plan_execution import execute

pytestmark = pytest.mark.cases

COUNTER = "(:predicates (q)) (:functions (n)) (:action a :effect (and (q) (increase (n) 1)))"
FALLING = "(:predicates (q)) (:functions (n)) (:action a :precondition (<= (n) -1) :effect (and (q) (decrease (n) 2)))"
DERIVED = "(:predicates (q) (full)) (:functions (n)) (:derived (full) (> (n) 3)) "
PARTS = "(:types part) (:functions (made ?p - part) (wanted ?p - part)) "
BEYOND = {
    "one number": (COUNTER, "(:init (= (n) 5)) (:goal (and (q) (>= (n) 3)))", 1),
    "one that falls": (FALLING, "(:init (= (n) -2.5)) (:goal (q))", 1),
    "a derived predicate": (
        DERIVED + "(:action a :precondition (full) :effect (and (q) (increase (n) 1)))",
        "(:init (= (n) 5)) (:goal (and (q) (full)))", 1,
    ),
    "one of two": (
        PARTS + "(:action run :effect (forall (?p - part) (increase (made ?p) 1)))",
        "(:objects bolt nut - part) (:init (= (made bolt) 0) (= (wanted bolt) 2) (= (made nut) 3) (= (wanted nut) 1)) "
        "(:goal (forall (?p - part) (>= (made ?p) (wanted ?p))))", 2,
    ),
    "one that is assigned": (
        "(:functions (n)) (:action a :precondition (> (n) 3) :effect (assign (n) 1)) (:action b :effect (increase (n) "
        "1))", "(:init (= (n) 9)) (:goal (< (n) 3))", 1,
    ),
}  # fmt: skip
"""Numbers that begin beyond the last threshold at which they are compared."""


def durative(condition: str, effects: str, duration: str = "1") -> str:
    return (f"(:types o) (:predicates (p ?x - o)) (:functions (f ?x - o) (g ?x - o)) (:durative-action go :parameters "
            f"(?a - o) :duration (= ?duration {duration}) :condition (at start {condition}) :effect (and {effects})) "
            "(:durative-action down :parameters (?a - o) :duration (= ?duration 1) :condition (at start (>= (f ?a) 1)) "
            ":effect (at start (decrease (f ?a) 1)))")  # fmt: skip


SMALL = "(<= (f ?a) 3)"
UP = "(at start (increase (f ?a) 1))"
TWO = "(:objects a b - o) (:init (= (f a) 0) (= (f b) 0) (= (g a) 0) (= (g b) 0)) (:goal {})"
STARTED = {
    "a fact": (durative(SMALL, f"{UP} (at end (forall (?x - o) (when (>= (f ?x) 1) (p ?x))))"), TWO.format("(p a)"), 1),
    "a condition at end": (
        durative(SMALL, f"{UP} (forall (?x - o) (when (at end (>= (f ?x) 1)) (at end (p ?x))))"),
        TWO.format("(p a)"), 1,
    ),
    "a comparison that is not satisfied": (
        durative(SMALL, f"{UP} (at end (forall (?x - o) (when (not (>= (f ?x) 1)) (p ?x))))"),
        TWO.format("(and (p a) (not (p b)))"), 1,
    ),
    "a number": (
        durative(SMALL, f"{UP} (at end (forall (?x - o) (when (>= (f ?x) 1) (assign (g ?x) 1))))"),
        TWO.format("(and (>= (g a) 1) (<= (g b) 0))"), 1,
    ),
    "an assignment": (
        durative(SMALL, "(at start (assign (f ?a) 2)) (at end (forall (?x - o) (when (= (f ?x) 2) (p ?x))))"),
        TWO.format("(p b)"), 1,
    ),
    "numbers of all objects": (
        durative("(forall (?x - o) (<= (f ?x) 3))", "(at start (forall (?x - o) (increase (f ?x) 1))) (at end (forall "
                 "(?x - o) (when (>= (f ?x) 1) (p ?x))))"), TWO.format("(and (p a) (p b))"), 1,
    ),
    "a number that falls": (
        durative("(>= (f ?a) 1)", "(at start (decrease (f ?a) 1)) (at end (forall (?x - o) (when (>= (f ?x) 1) "
                 "(p ?x))))"), "(:objects a - o) (:init (= (f a) 1)) (:goal (p a))", math.inf,
    ),
}  # fmt: skip
"""Changes at the start of an action, which conditions within forall read at its end."""

DURATIONS = {
    "read before the start": (
        "(:types o) (:predicates (done)) (:functions (f ?x - o)) (:durative-action go :parameters (?a - o) :duration "
        "(at end (= ?duration (f ?a))) :condition (at start (<= (f ?a) 3)) :effect (and (at start (increase (f ?a) 1)) "
        "(at end (done))))", "(:objects a - o) (:init (= (f a) 2)) (:goal (done))", 2,
    ),
    **{
        f"read by the condition of an effect {time}": (
            "(:predicates (done)) (:functions (n)) (:durative-action wait :parameters () :duration (= ?duration (n)) "
            ":condition (at start (<= (n) 3)) :effect (and (at end (increase (n) 1)) (when (at start (<= 3 ?duration)) "
            f"({time} (done)))))", "(:init (= (n) 1)) (:goal (done))", 6,
        ) for time in ("at start", "at end")
    },
}  # fmt: skip
"""Durations that are stated at the end, or read by a condition at the start of an effect on a fact."""

SHRINKING = (
    "(:predicates (done)) (:functions (n) (k) (total-cost)) (:durative-action work :parameters () :duration "
    "(= ?duration {}) :condition (at start (>= (n) -1)) :effect (and (at end (decrease (n) 2)) {}))"
)
LEFT = "(:init (= (n) 1)) (:goal (= (n) {})) {}"
NEGATIVE = {
    f"{name}, {kind}": (SHRINKING.format(amount, effect), LEFT.format(left, metric), cost)
    for kind, effect, metric in (
        ("is the cost", "", ""),
        ("beside a cost", "(at end (increase (total-cost) 1))", "(:metric minimize (total-cost))"),
    )
    for name, amount, left, cost in (
        ("a duration above 0", "(n)", -1, 1),
        ("a duration below 0", "(n)", -3, math.inf),
        ("a duration without a value", "(k)", -1, math.inf),
        ("a quotient by 0", "(/ 1 (- (n) 1))", -1, math.inf),
    )
}
"""Durations of numbers that change: without one of 0 or more, an action is not applicable, whatever the metric is."""

RULES = (
    "(:predicates (ok) (done)) (:functions (n) (m)) (:derived (ok) (>= (n) 2)) (:action add :precondition (< (n) 5) "
    ":effect (increase (n) 1)) (:durative-action end :parameters () :duration (= ?duration 1) :condition (over all "
    "(ok)) :effect (and (at start ({} 1)) (at end (done))))"
)
DEPENDENT = {
    "on what the start leaves": (
        RULES.format("increase (m)"), "(:init (= (n) 0) (= (m) 0)) (:goal (and (done) (<= (m) 1)))", 3
    ),
}  # fmt: skip
"""A derived predicate whose rule reads a number, and which is read after a change at start of another number."""

TYPES = "(:types a b) (:predicates (s) (q) (r ?x - b)) "
LIKE = "(:objects o - a) (:init (s)) (:goal (q))"
COUNTED = TYPES + "(:functions (n)) (:action go :precondition (<= (n) 3) :effect (increase (n) 1))"
WANTED = "(:objects o - a) (:init (s) (= (n) 0)) (:goal (and (>= (n) 1) {}))"
EMPTY = {
    "some, in a precondition": (
        TYPES + "(:action go :precondition (exists (?x - b) (and)) :effect (q))", LIKE, math.inf
    ),
    "all, in a precondition": (
        TYPES + "(:action go :precondition (forall (?x - b) (or)) :effect (q))", LIKE, 1
    ),
    "not all, around an effect": (
        TYPES + "(:action go :effect (when (not (forall (?x - b) (and))) (q)))", LIKE, math.inf
    ),
    "some, in a derived predicate": (
        TYPES + "(:derived (r ?y - b) (s)) (:derived (q) (exists (?x - b) (and)))", LIKE, math.inf
    ),
    "some of two types": (
        TYPES + "(:action go :precondition (exists (?x - a ?y - (either b)) (s)) :effect (q))", LIKE, math.inf
    ),
    "some, in a goal with numbers": (COUNTED, WANTED.format("(exists (?x - b) (s))"), math.inf),
    "not all, in a goal with numbers": (COUNTED, WANTED.format("(not (forall (?x - b) (not (s))))"), math.inf),
    "all, in a goal with numbers": (COUNTED, WANTED.format("(forall (?x - b) (q))"), 1),
    "some, in a durative action": (
        TYPES + "(:durative-action go :parameters () :duration (= ?duration 1) :condition (exists (?x - b) (at end "
        "(and))) :effect (at end (q)))", LIKE, math.inf,
    ),
    "some or another, in a durative action": (
        TYPES + "(:durative-action go :parameters () :duration (= ?duration 1) :condition (or (exists (?x - b) (at "
        "start (s))) (over all (s))) :effect (at end (q)))", LIKE, 1,
    ),
}  # fmt: skip
"""Quantifiers over a type without objects."""

DOWN = "(assign (n) (- (n) 1))"
OBJECTS = "(:objects u v - t) (:init (= (n) 4)) (:goal {})"
BIG = "(:types t) (:predicates (p ?x - t)) (:functions (n)) (:action a :precondition (>= (n) 2) :effect {})"
ASSIGNED = {
    "for all objects": (
        BIG.format(f"(forall (?x - t) {DOWN})"), OBJECTS.format("(= (n) 1)"), 3
    ),
    "for some objects": (
        BIG.format(f"(forall (?x - t) (and (when (not (p ?x)) {DOWN}) (p ?x)))"), OBJECTS.format("(= (n) 3)"), 1
    ),
    "twice": (BIG.format(f"(and {DOWN} {DOWN})"), OBJECTS.format("(<= (n) 1)"), 3),
    "at the start and at the end": (
        "(:types t) (:functions (n)) (:durative-action a :parameters () :duration (= ?duration 1) :condition (at start "
        f"(>= (n) 2)) :effect (and (at start {DOWN}) (at end {DOWN})))", OBJECTS.format("(= (n) 0)"), 2,
    ),
    "one term by two names": (
        "(:types t) (:functions (n ?x - t)) (:action a :parameters (?x ?y - t) :precondition (and (>= (n ?x) 2) (>= "
        "(n ?y) 2)) :effect (and (assign (n ?x) (- (n ?x) 1)) (assign (n ?y) (- (n ?y) 1))))",
        "(:objects u - t) (:init (= (n u) 4)) (:goal (<= (n u) 1))", 3,
    ),
    "what is minimized": (
        "(:types t) (:functions (spent)) (:predicates (q)) (:action a :effect (and (q) (forall (?x - t) (assign "
        "(spent) (+ (spent) 1)))))",
        "(:objects u v - t) (:init (= (spent) 0)) (:goal (q)) (:metric minimize (spent))", 1,
    ),
    "what is minimized, by two names": (
        "(:types t) (:functions (spent ?x - t)) (:predicates (q)) (:action a :parameters (?x ?y - t) :effect (and (q) "
        "(assign (spent ?x) (+ (spent ?x) 1)) (assign (spent ?y) (+ (spent ?y) 1))))",
        "(:objects u - t) (:init (= (spent u) 0)) (:goal (q)) (:metric minimize (spent u))", 1,
    ),
}  # fmt: skip
"""Assignments of a number that is computed from the assigned one; several are one, since they read what was before."""

STEPS = ("(:functions (n) (m)) (:predicates (q) (r)) (:action b :precondition (<= (n) 2) :effect (increase (n) 1)) "
         "(:action c :precondition (>= (n) 1) :effect (decrease (n) 1)) ")  # fmt: skip
NONE = "(:init (= (n) 0) (= (m) 0)) (:goal {})"
THIRD = "(>= (/ 6 (n)) 2)"
DIVIDED = {
    "around a fact": (
        STEPS + f"(:action a :effect (and (q) (when {THIRD} (r))))", NONE.format("(and (q) (not (r)))"), 1
    ),
    "around a number": (
        STEPS + f"(:action a :precondition (<= (m) 3) :effect (and (q) (when {THIRD} (increase (m) 1))))",
        NONE.format("(and (q) (= (m) 0))"), 1,
    ),
    "negated": (STEPS + f"(:action a :precondition (not {THIRD}) :effect (q))", NONE.format("(q)"), math.inf),
    "in an effect": (
        STEPS + "(:action a :effect (and (q) (assign (m) (/ 6 (n)))))", NONE.format("(and (q) (>= (m) 0))"), 2
    ),
}  # fmt: skip
"""Divisions by a number that begins with 0."""

PRICED = "(:types t) (:predicates (q)) (:functions (k ?x - t) (m) (total-cost)) (:action a :parameters (?x - t) {})"
PAID = "(increase (total-cost) (k ?x))"
UNREAD = {
    "without a metric": (
        PRICED.format(f":effect (and (q) {PAID})"), "(:objects u - t) (:init) (:goal (q))", 1
    ),
    "without a metric, beside a number": (
        PRICED.format(f":precondition (>= (m) 0) :effect (and (q) {PAID})"),
        "(:objects u - t) (:init (= (m) 0)) (:goal (q))", 1,
    ),
    "beside what is minimized": (
        PRICED.format(f":effect (and (q) {PAID} (increase (m) 3))"),
        "(:objects u - t) (:init (= (m) 0)) (:goal (q)) (:metric minimize (m))", 3,
    ),
    "what is minimized": (
        PRICED.format(f":effect (and (q) {PAID})"),
        "(:objects u - t) (:init) (:goal (q)) (:metric minimize (total-cost))", math.inf,
    ),
}  # fmt: skip
"""Costs without a value, which matter only if the sum of costs does."""

WORKED = ("(:functions (n) (m) (total-cost)) (:predicates (q)) (:action work :precondition {} :effect (and (increase "
          "(total-cost) {}) (decrease (n) 1))) (:action more :precondition (< (m) 3) :effect (and (increase (m) 1) "
          "(increase (total-cost) 3))) (:action finish :precondition (<= (n) 2) :effect (q))")  # fmt: skip
PAY = "(:init (= (n) 5) (= (m) 1) (= (total-cost) 0)) (:goal (and (q) (>= (m) {}))) (:metric minimize (total-cost))"
EXCLUDED = {
    "by a number": (WORKED.format("(>= (n) 2)", "(- (n) 2)"), PAY.format(1), 6),
    "negated": (WORKED.format("(not (< (n) 2))", "(- (n) 2)"), PAY.format(1), 6),
    "by another number": (WORKED.format("(and (> (n) 0) (>= (n) (m)))", "(- (n) (m))"), PAY.format(2), 9),
    "around the cost": (
        WORKED.format("(> (n) 0)", "0").replace("(increase (total-cost) 0)",
        "(when (>= (n) 4) (increase (total-cost) (- (n) 3)))"), PAY.format(1), 3,
    ),
    "of each object": (
        "(:types bin) (:functions (n ?b - bin) (least ?b - bin) (total-cost)) (:predicates (q)) (:action work "
        ":parameters (?b - bin) :precondition (>= (n ?b) (least ?b)) :effect (and (increase (total-cost) (* 2 (- "
        "(n ?b) (least ?b)))) (decrease (n ?b) 1))) (:action finish :precondition (forall (?b - bin) (< (n ?b) 3)) "
        ":effect (q))",
        "(:objects a b - bin) (:init (= (n a) 5) (= (n b) 6) (= (least a) 1) (= (least b) 2) (= (total-cost) 0)) "
        "(:goal (q)) (:metric minimize (total-cost))", 38,
    ),
    "of a number that never changes": (
        "(:functions (n) (least ?x) (total-cost)) (:predicates (q ?x)) (:action work :parameters (?x) :precondition "
        "(>= (least ?x) (n)) :effect (and (q ?x) (increase (total-cost) (- (least ?x) 2)))) (:action more "
        ":precondition (< (n) 4) :effect (and (increase (n) 1) (increase (total-cost) 1)))",
        "(:objects a b) (:init (= (n) 2) (= (least a) 1) (= (least b) 5) (= (total-cost) 0)) (:goal (and (q b) "
        "(>= (n) 3))) (:metric minimize (total-cost))", 4,
    ),
    "for a duration": (
        "(:functions (n)) (:predicates (q)) (:durative-action work :parameters () :duration (= ?duration (- (n) 2)) "
        ":condition (at start (>= (n) 2)) :effect (at end (decrease (n) 1))) (:action finish :precondition "
        "(<= (n) 2) :effect (q))", "(:init (= (n) 5)) (:goal (q))", 7,
    ),
}  # fmt: skip
"""Costs that are negative for some values of their numbers, which a condition excludes."""
NAMED = {
    "objects like numbers": (
        "(:types t) (:constants 1 2 - t) (:predicates (q)) (:functions (n)) (:action a :parameters (?x - t) "
        ":precondition (and (= ?x 2) (not (= 1 ?x)) (>= (n) 2)) :effect (q)) (:action b :effect (increase (n) 1))",
        "(:init (= (n) 0)) (:goal (q))", 3,
    ),
}  # fmt: skip

CASES = {
    f"{kind}: {name}": case
    for kind, cases in {
        "beyond": BEYOND,
        "started": STARTED,
        "duration": DURATIONS,
        "negative": NEGATIVE,
        "dependent": DEPENDENT,
        "empty": EMPTY,
        "assigned": ASSIGNED,
        "divided": DIVIDED,
        "unread": UNREAD,
        "excluded": EXCLUDED,
        "named": NAMED,
    }.items()
    for name, case in cases.items()
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_costs_are_those_of_the_meaning(tmp_path: Path, case: tuple[str, str, float]) -> None:
    domain, problem, cost = case
    (tmp_path / "domain.pddl").write_text(f"(define (domain d)\n{domain})")
    (tmp_path / "p.pddl").write_text(f"(define (problem p) (:domain d)\n{problem})")
    task = load(tmp_path / "p.pddl")
    table = sweep(task)
    assert table[table.initial] == cost
    if (plan := table.optimal_plan()) is not None:
        assert execute(task.instance, plan).cost == cost


@pytest.mark.parametrize("other", ["(assign (n) (- (n) 2))", "(increase (n) 1)", "(assign (n) 3)"])
def test_assignments_that_differ_are_refused(tmp_path: Path, other: str) -> None:
    (tmp_path / "domain.pddl").write_text(f"(define (domain d)\n{BIG.format(f'(and {DOWN} {other})')})")
    (tmp_path / "p.pddl").write_text(f"(define (problem p) (:domain d)\n{OBJECTS.format('(= (n) 1)')})")
    with pytest.raises(PDDLError, match=r"domain.pddl:2: action 'a' changes '\(n\)' twice at one time, on line 2"):
        load(tmp_path / "p.pddl")


def test_a_negative_cost_that_no_condition_excludes_is_refused(tmp_path: Path) -> None:
    (tmp_path / "domain.pddl").write_text(f"(define (domain d)\n{WORKED.format('(>= (n) 1)', '(- (n) 2)')})")
    (tmp_path / "p.pddl").write_text(f"(define (problem p) (:domain d)\n{PAY.format(1)})")
    with pytest.raises(PDDLError, match=r"domain.pddl:2: action 'work' may cost -1; expected a comparison among its"):
        load(tmp_path / "p.pddl")


@pytest.mark.parametrize("change", ["increase (n)", "decrease (n)"])
def test_a_rule_that_depends_on_a_number_that_the_start_changes_is_refused(tmp_path: Path, change: str) -> None:
    (tmp_path / "domain.pddl").write_text(f"(define (domain d)\n{RULES.format(change)})")
    (tmp_path / "p.pddl").write_text("(define (problem p) (:domain d) (:init (= (n) 0) (= (m) 0)) (:goal (done)))")
    with pytest.raises(PDDLError, match=r"domain.pddl:2: .*'\(ok\)' is derived, and read after effects at start on"):
        load(tmp_path / "p.pddl")


def test_a_refused_time_of_an_effect_has_a_line(tmp_path: Path) -> None:
    domain = (
        "(:predicates (q) (r)) (:durative-action a :parameters () :duration (= ?duration 3) :effect (when (at end (r)) "
        "(at start (q))))"
    )
    (tmp_path / "domain.pddl").write_text(f"(define (domain d)\n{domain})")
    (tmp_path / "p.pddl").write_text("(define (problem p) (:domain d) (:init) (:goal (q)))")
    with pytest.raises(PDDLError, match=r"domain.pddl:2: durative action 'a': an effect at start depends on"):
        load(tmp_path / "p.pddl")
