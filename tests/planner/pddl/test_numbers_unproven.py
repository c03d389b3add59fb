"""Numbers that no condition bounds: values are tried until they are all, or a plan within them is optimal."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner import LimitError, Limits, PDDLError, Task, astar, cost_to_go, instance, load, sweep
from planner.costtogo import number_values
from planner.pddl.compilation import Compilation
from planner.pddl.numeric_compiler import Compiler
from planner.pddl.reader import read
from planner.system.limits import NO_LIMITS

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


def loaded(folder: Path, domain: str, problem: str, most_values: int = 100) -> Task:
    return load(written(folder, domain, problem), most_values=most_values)


def test_a_swing_is_swept_once_all_its_states_are_known(tmp_path: Path) -> None:
    task = loaded(tmp_path, SWING, "(:init (left) (= (n) 0) (= (k) 0)) (:goal (= (n) -4))")
    table = sweep(task)
    assert not task.beyond
    assert (len(table), table[table.initial]) == (19, 8)  # up and down in turn, k from 0 to 9: n falls by one each time
    assert not any("beyond" in fact for variable in task.variables for fact in variable.facts)


@pytest.mark.cases
def test_a_sum_of_numbers_that_nothing_bounds_is_swept_or_names_one_of_them(tmp_path: Path) -> None:
    """Each tick adds both numbers to the sum: 0 + 1, then 1 + 2, then 2 + 3, where it has 9."""
    domain = """(:types bin) (:predicates (open ?b - bin) (done)) (:functions (n ?b - bin) (sum))
      (:action tick :parameters () :precondition (< (sum) 9) :effect (forall (?b - bin) (and
        (increase (sum) (n ?b)) (when (open ?b) (increase (n ?b) 1)) (when (>= (n ?b) 2) (not (open ?b))))))
      (:action fin :parameters () :precondition (and (exists (?b - bin) (> (n ?b) 2)) (= (sum) 9)) :effect (done))"""
    begin = "(:objects x y - bin) (:init (= (n x) 0) (= (n y) 1) (open x) (open y) (= (sum) 0))"
    table = sweep(loaded(tmp_path, domain, f"{begin} (:goal (done))", most_values=10))
    assert (len(table), table[table.initial]) == (5, 4)
    with pytest.raises(PDDLError, match=r"\(n x\) grows without a limit \(tick\)"):
        Compiler(read(instance(tmp_path / "p.pddl")), 200).compilation()


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
    # Nothing is said of a state that is beyond.
    ((variable, value),) = task.beyond
    state = [value if number == variable else first for number, first in enumerate(task.initial)]
    with pytest.raises(LimitError, match="may need more values of n than were tried"):
        astar(task, state)


def test_a_plan_that_needs_more_values_is_refused_by_name(tmp_path: Path) -> None:
    problem = "(:init (= (n) 0)) (:goal (= (n) 40))"
    with pytest.raises(PDDLError, match=r"\(n\) grows without a limit \(up\) and falls without a limit \(down\)"):
        loaded(tmp_path, FREE, problem, most_values=16)
    assert astar(loaded(tmp_path, FREE, problem, most_values=128))[0] == 20


def test_a_plan_that_leaves_the_values_is_never_taken_for_one(tmp_path: Path) -> None:
    """The cheapest plan goes through a value that is far away; within few values there is a dear one."""
    domain = """(:functions (n)) (:action double :parameters () :effect (scale-up (n) 2))
      (:action less :parameters () :effect (decrease (n) 1))
      (:action leap :parameters () :precondition (>= (n) 64) :effect (assign (n) -9))"""
    task = loaded(tmp_path, domain, "(:init (= (n) 2)) (:goal (= (n) -9))")
    assert astar(task)[0] == 6  # five times double, then leap


def test_an_action_that_reads_a_number_without_a_value_breaks_no_bound(tmp_path: Path) -> None:
    """All parts together are 5, as nothing can be taken from the table, whose stock is never said."""
    domain = """(:types place) (:predicates (full)) (:functions (stock ?p - place))
      (:action take :parameters (?p - place) :precondition (not (full)) :effect (and (full) (decrease (stock ?p) 1)))
      (:action put :parameters (?p - place) :precondition (full) :effect (and (not (full)) (increase (stock ?p) 1)))"""
    domain = domain.replace("(not (full))", "(and (not (full)) (>= (stock ?p) 1))", 1)
    problem = """(:objects shelf bin table - place) (:init (= (stock shelf) 5) (= (stock bin) 0))
      (:goal (= (stock bin) 2))"""
    task = loaded(tmp_path, domain, problem)
    assert (task.note, len(sweep(task))) == (None, 11)  # 0 to 5 in the bin, and 0 to 4 with one part in hand


def test_a_way_beyond_the_values_that_is_as_cheap_as_the_plan_asks_for_more_values(tmp_path: Path) -> None:
    """The plan costs 8, so that n has all values that fewer than 9 actions lead to."""
    domain = """(:functions (n) (total-cost)) (:predicates (done))
      (:action up :parameters () :effect (and (increase (n) 1) (increase (total-cost) 1)))
      (:action down :parameters () :effect (and (decrease (n) 1) (increase (total-cost) 1)))
      (:action finish :parameters () :effect (and (done) (increase (total-cost) 8)))"""
    problem = "(:init (= (n) 0) (= (total-cost) 0)) (:goal (and (done) (= (n) 0))) (:metric minimize (total-cost))"
    task = loaded(tmp_path, domain, problem)
    assert astar(task)[0] == 8
    assert {f"Atom n() = {n}" for n in range(-8, 9)} <= {fact for each in task.variables for fact in each.facts}


def test_conditions_for_all_objects_make_no_derived_variables(tmp_path: Path) -> None:
    domain = """(:types bin) (:predicates (closed ?b - bin)) (:functions (n))
      (:action close :parameters (?b - bin) :effect (closed ?b))
      (:action count :parameters () :precondition (and (< (n) 3) (forall (?b - bin) (closed ?b)))
        :effect (increase (n) 1))
      (:action clear :parameters (?b - bin) :effect (and (not (closed ?b)) (assign (n) 0)))"""
    problem = "(:objects a b - bin) (:init (= (n) 0)) (:goal (and (= (n) 2) (forall (?b - bin) (not (closed ?b)))))"
    task = loaded(tmp_path, domain, problem)
    assert not task.axioms
    assert all(not effect.conditions for operator in task.operators for effect in operator.effects)
    assert cost_to_go(task).lookup([0]).tolist() == [float("inf")]


@pytest.mark.parametrize(
    "unused", [":timed-initial-literals", ":continuous-effects", ":preferences", ":constraints", ":object-fluents"]
)
def test_a_requirement_that_is_not_used_is_accepted(unused: str, tmp_path: Path) -> None:
    file = written(tmp_path, FREE.replace("(n)", "(m)"), "(:init (= (m) 0)) (:goal (= (m) 1))")
    domain = file.with_name("domain.pddl")
    domain.write_text(domain.read_text().replace(":fluents", f":fluents {unused}"))
    assert read(instance(file)).numeric


def test_what_facts_say_of_a_number_bounds_it_on_both_sides(tmp_path: Path) -> None:
    """Taken parts and free ones are 3 together, also after all were put back at once."""
    domain = """(:types part) (:predicates (free ?p - part)) (:functions (n))
      (:action take :parameters (?p - part) :precondition (free ?p) :effect (and (not (free ?p)) (increase (n) 1)))
      (:action put :parameters (?p - part) :precondition (not (free ?p)) :effect (and (free ?p) (decrease (n) 1)))
      (:action reset :effect (and (assign (n) 0) (forall (?p - part) (free ?p))))"""
    problem = "(:objects a b c - part) (:init (= (n) 0) (free a) (free b) (free c)) (:goal (= (n) 3))"
    task = loaded(tmp_path, domain, problem)
    assert (task.note, len(sweep(task))) == (None, 8)
    numbers = {fact for each in task.variables for fact in each.facts if fact.startswith("Atom n(")}
    assert numbers == {f"Atom n() = {number}" for number in range(4)}


@pytest.mark.parametrize(("after", "begin", "said"), [
    ("(/ (n) 2)", 8, "comes ever closer to 0"), ("(/ (n) 2)", -8, "has no proven limit"),
    ("(+ (/ (n) 2) 1)", 8, "has no proven limit"), ("(* (n) -2)", 8, "has no proven limit"),
    ("(* (n) 2)", 8, "grows without a limit"), ("(+ (n) (+ (n) 1))", 0, "grows without a limit"),
])  # fmt: skip
def test_how_a_number_leads_to_ever_more_values_is_said(after: str, begin: int, said: str, tmp_path: Path) -> None:
    file = written(
        tmp_path, f"(:functions (n)) (:action a :effect (assign (n) {after}))",
        f"(:init (= (n) {begin})) (:goal (= (n) 3))",
    )  # fmt: skip
    with pytest.raises(PDDLError, match=rf"\(n\) {said} \(a\)"):
        Compiler(read(instance(file)), 200).compilation()


COUNTERS = """(:functions (n) (m)) (:predicates (done) (open))
  (:action more :effect (increase (n) 1)) (:action less :effect (decrease (n) 1))
  (:action longer :effect (increase (m) 1)) (:action shorter :effect (decrease (m) 1))
  (:action finish :precondition {} :effect (done))"""


@pytest.mark.parametrize(("condition", "goal"), [
    ("(= (n) 2000)", "(and (> (- (n) (m)) 6) (done))"), ("(and (= (n) 2000) (or (open) (> (- (n) (m)) 6)))", "(done)"),
], ids=["goal", "condition"])  # fmt: skip
def test_numbers_compared_with_each_other_are_not_tried_in_vain(
    condition: str, goal: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A relation of two numbers grows with the square of their values; it is counted before it is grounded."""
    made = list[int]()
    grounded = number_values.ground

    def ground(compilation: Compilation, limits: Limits = NO_LIMITS) -> Task:
        made.append(len(compilation.reading.problem.facts))
        return grounded(compilation, limits)

    monkeypatch.setattr(number_values, "ground", ground)
    monkeypatch.setattr(number_values, "MOST_ROWS_OF_TRIAL", 1_000)
    begin = f"(:init (= (n) 0) (= (m) 0)) (:goal {goal})"
    with pytest.raises(PDDLError, match=r"\(n\) grows without a limit \(more\)"):
        load(written(tmp_path, COUNTERS.format(condition), begin))
    assert 300 < max(made) < 1_010
    near = COUNTERS.format(condition.replace("2000", "1"))
    assert astar(load(written(tmp_path, near, begin)))[0] == 8  # one of them to 7, of the other one step, and finish


def test_alternatives_on_one_number_are_not_combined(tmp_path: Path) -> None:
    """Each bin is closed, or less full than n: in Fast Downward's translator that is one value of n, not one a bin."""
    domain = """(:types bin) (:predicates (closed ?b - bin) (done)) (:functions (n))
      (:action more :effect (increase (n) 1)) (:action close :parameters (?b - bin) :effect (closed ?b))
      (:action finish :precondition (forall (?b - bin) (or (closed ?b) (> (n) 2))) :effect (done))"""
    bins = " ".join(f"b{number}" for number in range(7))
    file = written(tmp_path, domain, f"(:objects {bins} - bin) (:init (= (n) 0)) (:goal (and (done) (< (n) 9)))")
    task = load(file)
    assert astar(task)[0] == 4
    assert len(task.operators) < 2_000


@pytest.mark.parametrize("each", ["(> (n ?b) 2)", "(or (closed ?b) (> (n ?b) 2))"])
def test_conditions_on_many_numbers_are_refused_before_they_are_grounded(each: str, tmp_path: Path) -> None:
    domain = """(:types bin) (:predicates (closed ?b - bin) (done)) (:functions (n ?b - bin))
      (:action more :parameters (?b - bin) :precondition (< (n ?b) 40) :effect (increase (n ?b) 1))
      (:action less :parameters (?b - bin) :precondition (> (n ?b) 0) :effect (decrease (n ?b) 1))
      (:action close :parameters (?b - bin) :effect (closed ?b))
      (:action finish :precondition (forall (?b - bin) {}) :effect (done))"""
    names = [f"b{number}" for number in range(9)]
    begin = " ".join(f"(= (n {name}) 0)" for name in names)
    problem = f"(:objects {' '.join(names)} - bin) (:init {begin}) (:goal (done))"
    with pytest.raises(PDDLError, match="action 'finish' compares or changes numbers in too many combinations"):
        load(written(tmp_path, domain.format(each), problem))


def test_values_that_relations_connect_are_counted_as_a_join(tmp_path: Path) -> None:
    """A robot one cell from a ball: two relations of two coordinates each leave few of the pairs of cells."""
    moves = "".join(
        f"(:action {name} :parameters (?o - thing) :precondition (<= ({axis} ?o) 13) :effect (increase ({axis} ?o) 1))"
        for name, axis in (("right", "x"), ("up", "y"))
    )
    grab = (
        "(:action grab :parameters (?r - robot ?b - ball) :precondition (and (= (x ?b) (+ (x ?r) 1)) "
        "(= (y ?b) (+ (y ?r) 1))) :effect (got ?b))"
    )
    domain = (
        "(:types robot ball - thing) (:predicates (got ?b - ball)) (:functions (x ?o - thing) (y ?o - thing)) "
        f"{moves} {grab}"
    )
    problem = "(:objects r - robot b - ball) (:init (= (x r) 0) (= (y r) 0) (= (x b) 7) (= (y b) 7)) (:goal (got b))"
    compiler = Compiler(read(instance(written(tmp_path, domain, problem))))
    assert compiler.compilation(most_grounded=1_000)
    with pytest.raises(PDDLError, match="action 'grab' compares or changes numbers in too many combinations"):
        compiler.compilation(most_grounded=200)
