"""Small numeric and durative tasks with right answers, found by hand or by a direct search."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import pytest

from planner import Instance, PDDLError, cost_to_go
from planner.costtogo.number_values import grounded
from planner.grounding import fast_downward
from planner.grounding.translation import from_sas
from planner.pddl.compilation import Compilation
from planner.pddl.numeric_compiler import Compiler
from planner.pddl.reader import read


@dataclass(frozen=True)
class Case:
    """The bodies of a domain and a problem, and what is right: a cost and a number of states, or words of a refusal.

    `cost` is None where there is no plan; `states` is None where the translator alone decides, or states are merged.
    """

    domain: str
    problem: str
    cost: str | None = None
    states: int | None = None
    said: str = ""


CASES = {
    "capacity": Case(
        "(:types crate box) (:predicates (in ?b - box ?c - crate) (free ?b - box)) (:functions (load ?c - crate) "
        "(capacity ?c - crate) (weight ?b - box)) (:action put :parameters (?b - box ?c - crate) :precondition "
        "(and (free ?b) (<= (+ (load ?c) (weight ?b)) (capacity ?c))) :effect (and (not (free ?b)) (in ?b ?c) "
        "(increase (load ?c) (weight ?b)))) (:action out :parameters (?b - box ?c - crate) :precondition (in ?b "
        "?c) :effect (and (free ?b) (not (in ?b ?c)) (decrease (load ?c) (weight ?b))))",
        "(:objects c1 c2 - crate b1 b2 b3 - box) (:init (free b1) (free b2) (free b3) (= (load c1) 0) (= (load "
        "c2) 0) (= (capacity c1) 5) (= (capacity c2) 4) (= (weight b1) 2) (= (weight b2) 3) (= (weight b3) 4)) "
        "(:goal (and (not (free b1)) (not (free b2)) (not (free b3))))",
        cost="3",
        states=15,
    ),
    "duration expression": Case(
        "(:types place robot) (:predicates (at ?r - robot ?p - place) (road ?a ?b - place)) (:functions (distance "
        "?a ?b - place) (speed ?r - robot)) (:durative-action drive :parameters (?r - robot ?a ?b - place) "
        ":duration (= ?duration (/ (distance ?a ?b) (speed ?r))) :condition (and (at start (at ?r ?a)) (over all "
        "(road ?a ?b))) :effect (and (at start (not (at ?r ?a))) (at end (at ?r ?b))))",
        "(:objects r - robot a b c - place) (:init (at r a) (road a b) (road b c) (road a c) (= (distance a b) "
        "10) (= (distance b c) 5) (= (distance a c) 16) (= (speed r) 3)) (:goal (at r c))",
        cost="5",
        states=3,
    ),
    "start effect blocks": Case(
        "(:predicates (free) (done)) (:durative-action work :parameters () :duration (= ?duration 4) :condition "
        "(and (at start (free)) (over all (free))) :effect (and (at start (not (free))) (at end (free)) (at end "
        "(done))))",
        "(:init (free)) (:goal (done))",
    ),
    "delete then add": Case(
        "(:types place) (:predicates (in ?p - place) (seen ?p - place)) (:durative-action walk :parameters (?a ?b "
        "- place) :duration (= ?duration 1) :condition (at start (in ?a)) :effect (and (at start (not (in ?a))) "
        "(at end (in ?b)) (at end (seen ?b))))",
        "(:objects x y - place) (:init (in x)) (:goal (and (in x) (seen x)))",
        cost="1",
    ),
    "decimals exact": Case(
        "(:functions (charge)) (:predicates (ready)) (:action use :parameters () :precondition (>= (charge) 0.1) "
        ":effect (decrease (charge) 0.1)) (:action stop :parameters () :precondition (= (charge) 0.7) :effect "
        "(ready))",
        "(:init (= (charge) 1)) (:goal (ready))",
        cost="4",
        states=19,
    ),
    "two fluents compared": Case(
        "(:types pile) (:functions (height ?p - pile)) (:predicates (level)) (:action move :parameters (?a ?b - "
        "pile) :precondition (and (not (= ?a ?b)) (> (height ?a) (height ?b))) :effect (and (decrease (height ?a) "
        "1) (increase (height ?b) 1))) (:action check :parameters (?a ?b - pile) :precondition (and (not (= ?a "
        "?b)) (= (height ?a) (height ?b))) :effect (level))",
        "(:objects x y - pile) (:init (= (height x) 4) (= (height y) 0)) (:goal (level))",
        cost="3",
        states=4,
    ),
    "assign swap": Case(
        "(:functions (x) (y)) (:action swap :parameters () :precondition (and) :effect (and (assign (x) (y)) "
        "(assign (y) (x)))) (:action copy :parameters () :precondition (and) :effect (assign (x) (y)))",
        "(:init (= (x) 1) (= (y) 2)) (:goal (and (= (x) 2) (= (y) 1)))",
        cost="1",
        states=4,
    ),
    "scale": Case(
        "(:functions (x)) (:action double :parameters () :precondition (<= (x) 8) :effect (scale-up (x) 2)) "
        "(:action third :parameters () :precondition (= (x) 9) :effect (scale-down (x) 3)) (:action add "
        ":parameters () :precondition (<= (x) 8) :effect (increase (x) 1))",
        "(:init (= (x) 4)) (:goal (= (x) 3))",
        cost="3",
        states=11,
    ),
    "undefined at start": Case(
        "(:types bin) (:predicates (counted ?b - bin)) (:functions (n ?b - bin)) (:action count :parameters (?b - "
        "bin) :precondition (and) :effect (and (assign (n ?b) 0) (counted ?b))) (:action add :parameters (?b - "
        "bin) :precondition (<= (n ?b) 3) :effect (increase (n ?b) 1))",
        "(:objects a b - bin) (:init (= (n a) 0)) (:goal (and (= (n a) 1) (= (n b) 1)))",
        cost="3",
        states=60,
    ),
    "metric time and fluent": Case(
        "(:predicates (done)) (:functions (energy)) (:durative-action quick :parameters () :duration (= ?duration "
        "2) :condition (and) :effect (and (at end (done)) (at end (increase (energy) 10)))) (:durative-action "
        "slow :parameters () :duration (= ?duration 5) :condition (and) :effect (and (at end (done)) (at start "
        "(increase (energy) 1))))",
        "(:init (= (energy) 0)) (:goal (done)) (:metric minimize (+ (* 2 (total-time)) (* 0.5 (energy))))",
        cost="9",
        states=2,
    ),
    "changes under conditions that exclude each other": Case(
        "(:functions (n) (m)) (:predicates (p)) (:action turn :parameters () :precondition (<= (m) 5) :effect (and "
        "(when (= (n) 1) (assign (n) 2)) (when (= (n) 2) (assign (n) (- (m) 1))) (when (> (n) 2) (decrease (n) 2)) "
        "(increase (m) 1))) (:action press :parameters () :effect (p)) (:action add :parameters () :precondition "
        "(and (= (n) 3) (= (m) 5)) :effect (and (when (p) (assign (n) 9)) (when (not (p)) (increase (n) 4))))",
        "(:init (= (n) 1) (= (m) 2)) (:goal (= (n) 9))",
        cost="5",
        states=16,
    ),
    "changes under conditions that may hold together": Case(
        "(:functions (n)) (:predicates (p)) (:action turn :parameters () :effect (and (when (p) (assign (n) 2)) "
        "(when (> (n) 4) (increase (n) 1))))",
        "(:init (= (n) 1)) (:goal (= (n) 2))",
        said="action 'turn' perhaps changes '(n)' twice at one time, on line",
    ),
    "changes for all objects under conditions of another one": Case(
        "(:types bin) (:predicates (p ?b - bin)) (:functions (n)) (:action turn :parameters (?a - bin) :effect "
        "(forall (?b - bin) (and (when (p ?b) (assign (n) 2)) (when (not (p ?b)) (assign (n) 1)))))"
        "(:action flip :parameters (?a - bin) :effect (not (p ?a)))",
        "(:objects x y - bin) (:init (= (n) 0) (p x)) (:goal (= (n) 2))",
        said="action 'turn' perhaps changes '(n)' twice at one time, on line",
    ),
    "halved without a limit": Case(
        "(:functions (n)) (:predicates (done)) (:action halve :parameters () :effect (scale-down (n) 2)) (:action "
        "stop :parameters () :precondition (= (n) 0.3) :effect (done))",
        "(:init (= (n) 1)) (:goal (done))",
        said="(n) comes ever closer to 0 (halve); expected conditions that bound it, such as (>= (n) LEAST) where",
    ),
    "halved to a limit": Case(
        "(:functions (n)) (:predicates (done)) (:action halve :parameters () :precondition (>= (n) 0.2) :effect "
        "(scale-down (n) 2)) (:action stop :parameters () :precondition (= (n) 0.125) :effect (done))",
        "(:init (= (n) 1)) (:goal (done))",
        cost="4",
        states=5,
    ),
    "a number computed from others": Case(
        "(:functions (a) (b)) (:predicates (done)) (:action sum :parameters () :precondition (< (a) 50) :effect (and "
        "(assign (a) (+ (a) (b))) (assign (b) (a)))) (:action part :parameters () :precondition (> (a) 1) :effect "
        "(scale-down (a) (b))) (:action stop :parameters () :precondition (= (a) 1.5) :effect (done))",
        "(:init (= (a) 1) (= (b) 1)) (:goal (done))",
        said="(a) has no proven limit (part, sum); expected conditions",
    ),
    "conserved": Case(
        "(:types place) (:functions (stock ?p - place)) (:predicates (next ?a ?b - place)) (:action carry "
        ":parameters (?a ?b - place) :precondition (and (next ?a ?b) (>= (stock ?a) 1)) :effect (and (decrease "
        "(stock ?a) 1) (increase (stock ?b) 1)))",
        "(:objects x y z - place) (:init (next x y) (next y z) (next z y) (next y x) (= (stock x) 2) (= (stock y) "
        "0) (= (stock z) 1)) (:goal (and (= (stock z) 3)))",
        cost="4",
        states=10,
    ),
    "til": Case(
        "(:predicates (open) (done)) (:durative-action enter :parameters () :duration (= ?duration 1) :condition "
        "(over all (open)) :effect (at end (done)))",
        "(:init (at 5 (open)) (at 9 (not (open)))) (:goal (done)) (:metric minimize (total-time))",
        said="timed initial literals",
    ),
    "continuous": Case(
        "(:predicates (done)) (:functions (level)) (:durative-action fill :parameters () :duration (= ?duration "
        "5) :condition (over all (<= (level) 10)) :effect (and (increase (level) (* #t 2)) (at end (done))))",
        "(:init (= (level) 0)) (:goal (done))",
        said="continuous effects (#t)",
    ),
    "duration interval": Case(
        "(:predicates (done)) (:durative-action wait :parameters () :duration (and (>= ?duration 2) (<= ?duration "
        "5)) :condition (and) :effect (at end (done)))",
        "(:init) (:goal (done)) (:metric minimize (total-time))",
        cost="2",
        states=2,
    ),
    "either": Case(
        "(:types cup jar spoon) (:predicates (full ?x - (either cup jar))) (:functions (vol ?x - (either cup "
        "jar))) (:action fill :parameters (?x - (either cup jar)) :precondition (< (vol ?x) 2) :effect (and "
        "(increase (vol ?x) 1) (full ?x)))",
        "(:objects c - cup j - jar s - spoon) (:init (= (vol c) 0) (= (vol j) 1)) (:goal (and (= (vol c) 2) (= "
        "(vol j) 2)))",
        cost="3",
        states=6,
    ),
    "conditional numeric": Case(
        "(:types item) (:predicates (fragile ?i - item) (packed ?i - item)) (:functions (care) (slack)) (:action "
        "pack :parameters (?i - item) :precondition (and (not (packed ?i)) (or (not (fragile ?i)) (>= (slack) "
        "1))) :effect (and (packed ?i) (when (fragile ?i) (and (decrease (slack) 1) (increase (care) 2))))) "
        "(:action rest :parameters () :precondition (< (slack) 2) :effect (assign (slack) 2))",
        "(:objects a b c d - item) (:init (fragile a) (fragile b) (fragile c) (= (care) 0) (= (slack) 2)) (:goal "
        "(and (packed a) (packed b) (packed c) (packed d) (>= (care) 5)))",
        cost="5",
    ),
    "quantified comparison": Case(
        "(:types part kit) (:predicates (sent ?k - kit)) (:functions (have ?k - kit ?p - part) (need ?k - kit ?p "
        "- part)) (:action insert :parameters (?k - kit ?p - part) :precondition (and (not (sent ?k)) (< (have ?k "
        "?p) (need ?k ?p))) :effect (increase (have ?k ?p) 1)) (:action send :parameters (?k - kit) :precondition "
        "(forall (?p - part) (= (have ?k ?p) (need ?k ?p))) :effect (sent ?k))",
        "(:objects screw rotor - part k1 k2 - kit) (:init (= (have k1 screw) 0) (= (have k1 rotor) 0) (= (need k1 "
        "screw) 2) (= (need k1 rotor) 0) (= (have k2 screw) 0) (= (have k2 rotor) 1) (= (need k2 screw) 1) (= "
        "(need k2 rotor) 1)) (:goal (forall (?k - kit) (sent ?k)))",
        cost="5",
        states=12,
    ),
    "preference": Case(
        "(:predicates (a) (b)) (:action go :parameters () :precondition (and) :effect (a))",
        "(:init) (:goal (and (a) (preference p1 (b)))) (:metric minimize (is-violated p1))",
        said="preferences",
    ),
    "process": Case(
        "(:functions (level)) (:predicates (on)) (:action start :parameters () :precondition (not (on)) :effect "
        "(on)) (:process fill :parameters () :precondition (on) :effect (increase (level) (* #t 1)))",
        "(:init (= (level) 0)) (:goal (>= (level) 3))",
        said="processes",
    ),
    "duration in effect": Case(
        "(:types place) (:predicates (in ?p - place)) (:functions (battery) (d ?a ?b - place)) (:durative-action "
        "drive :parameters (?a ?b - place) :duration (= ?duration (d ?a ?b)) :condition (and (at start (in ?a)) "
        "(at start (>= (battery) (* 2 (d ?a ?b))))) :effect (and (at start (not (in ?a))) (at end (in ?b)) (at "
        "end (decrease (battery) (* 2 ?duration))))) (:durative-action charge :parameters () :duration (= "
        "?duration 1) :condition (at start (< (battery) 10)) :effect (at end (assign (battery) 10)))",
        "(:objects a b c - place) (:init (in a) (= (battery) 7) (= (d a b) 3) (= (d b c) 4)) (:goal (in c))",
        cost="8",
    ),
    "cap": Case(
        "(:functions (n) (top)) (:predicates (done)) (:action up :parameters () :precondition (< (n) (top)) "
        ":effect (increase (n) 1)) (:action down :parameters () :precondition (> (n) 0) :effect (decrease (n) 1)) "
        "(:action stop :parameters () :precondition (= (n) 3) :effect (done))",
        "(:init (= (n) 0) (= (top) 100000)) (:goal (done))",
        said="(n) has more than 1000 values, from 0 to 100000; expected fewer, by a smaller capacity or larger "
        "steps, or a larger --most-values",
    ),
    "object and number equality": Case(
        "(:types slot) (:predicates (used ?s - slot)) (:functions (n ?s - slot)) (:action use :parameters (?a ?b "
        "- slot) :precondition (and (not (= ?a ?b)) (= (n ?a) (n ?b)) (not (= (n ?a) 3))) :effect (and (used ?a) "
        "(increase (n ?b) 1)))",
        "(:objects x y z - slot) (:init (= (n x) 2) (= (n y) 2) (= (n z) 3)) (:goal (used y))",
        cost="1",
        states=3,
    ),
    "many assigns": Case(
        "(:types part) (:predicates (reset)) (:functions (n ?p - part)) (:action add :parameters (?p - part) "
        ":precondition (< (n ?p) 4) :effect (increase (n ?p) 1)) (:action clear :parameters () :precondition "
        "(and) :effect (and (reset) (forall (?p - part) (assign (n ?p) 0))))",
        "(:objects p1 p2 p3 p4 p5 p6 - part) (:init (= (n p1) 1) (= (n p2) 1) (= (n p3) 1) (= (n p4) 1) (= (n p5) "
        "1) (= (n p6) 1)) (:goal (and (reset) (= (n p1) 1)))",
        cost="2",
        states=19721,
    ),
    "goal two fluents": Case(
        "(:types c) (:functions (v ?x - c) (top)) (:action up :parameters (?x - c) :precondition (<= (+ (v ?x) 1) "
        "(top)) :effect (increase (v ?x) 1)) (:action down :parameters (?x - c) :precondition (>= (v ?x) 1) "
        ":effect (decrease (v ?x) 1))",
        "(:objects c0 c1 c2 c3 - c) (:init (= (top) 6) (= (v c0) 0) (= (v c1) 0) (= (v c2) 0) (= (v c3) 0)) "
        "(:goal (and (< (v c0) (v c1)) (< (v c1) (v c2)) (< (v c2) (v c3))))",
        cost="6",
        states=2401,
    ),
}


def written(folder: Path, domain: str, problem: str) -> Instance:
    """Write the two files of a case."""
    requirements = "(:requirements :typing :fluents :durative-actions :negative-preconditions)"
    files = folder / "p.pddl", folder / "domain.pddl"
    files[0].write_text(f"(define (problem p) (:domain bench)\n{problem})")
    files[1].write_text(f"(define (domain bench)\n{requirements}\n{domain})")
    return Instance(*files)


def answer(compilation: Compilation) -> tuple[Fraction | None, int, bool]:
    """Return the cost of an optimal plan, the number of reachable states, and whether the translator decided alone."""
    task = from_sas(fast_downward.translate(compilation.reading), compilation.reading.instance)
    answers = cost_to_go(task, max_states=100_000)
    cost = answers.lookup([answers.initial])[0]
    found = None if cost == float("inf") else int(cost) * compilation.unit
    return found, len(answers), task.decided_by_translator


@pytest.mark.parametrize("name", CASES)
def test_cases_have_their_right_answers(tmp_path: Path, name: str) -> None:
    case = CASES[name]
    instance = written(tmp_path, case.domain, case.problem)
    if case.said:
        with pytest.raises(PDDLError) as error:
            Compiler(read(instance)).compilation()
        assert case.said in str(error.value)
        assert error.value.line is not None
        return
    compilation = Compiler(read(instance)).compilation()
    cost, states, decided = answer(compilation)
    assert cost == (None if case.cost is None else Fraction(case.cost))
    assert case.states is None or (states, decided) == (case.states, False)


def test_a_counter_is_shown_as_a_number(tmp_path: Path) -> None:
    case = CASES["undefined at start"]
    compilation = Compiler(read(written(tmp_path, case.domain, case.problem))).compilation()
    assert compilation.actions["add"] == ("add", 1)
    (name, shown) = compilation.numbers["is-n"]
    assert name == "n"
    assert {"0", "1", "2", "3", "4", "undefined"} <= set(shown.values())


def test_a_classical_instance_is_its_own_compilation(tmp_path: Path) -> None:
    domain = "(:predicates (p)) (:action go :parameters () :effect (and (p) (increase (total-cost) 2)))"
    reading = read(written(tmp_path, domain, "(:init (= (total-cost) 0)) (:goal (p)) (:metric minimize (total-cost))"))
    compilation = grounded(reading)[0]
    assert compilation.reading is reading
    assert (compilation.unit, compilation.actions, compilation.numbers) == (1, {}, {})


@pytest.mark.parametrize(("cost", "unit"), [("(+ 1 0.5)", "3/2"), ("(* 2 0.1)", "1/5"), ("(/ 1 3)", "1/3")])
def test_costs_are_scaled_exactly(tmp_path: Path, cost: str, unit: str) -> None:
    domain = f"(:predicates (p)) (:action go :parameters () :effect (and (p) (increase (total-cost) {cost})))"
    compilation = Compiler(
        read(written(tmp_path, domain, "(:init) (:goal (p)) (:metric minimize (total-cost))"))
    ).compilation()
    assert answer(compilation)[0] == Fraction(unit)
