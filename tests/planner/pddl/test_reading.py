"""The project's own PDDL parser: all legal forms are read, by unified-planning too, and faults are reported.

Names, arities and types are checked everywhere. An argument may be of a supertype of the expected type, but not of a
disjoint type.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from conftest import write_instance

from planner import PDDLError, Table, Task, load, sweep
from planner.pddl.reader import read
from planner.pddl.validation import SecondReader

DOMAIN = """(define (domain sorting)
  (:requirements :strips :typing :action-costs :conditional-effects)
  (:types tool part - thing thing tray - object)
  (:constants spare - tool)
  (:predicates (on ?p - thing ?t - tray) (held ?p - thing) (free) (at ?t - tray) (seen ?x))
  (:functions (total-cost) - number (way ?a ?b - tray) - number)
  (:action go :parameters (?a ?b - tray)
    :precondition (at ?a)
    :effect (and (not (at ?a)) (at ?b)
      (forall (?p - part)
        (when (on ?p ?a) (seen ?p)))
      (increase (total-cost) (way ?a ?b))))
  (:action take :parameters (?p - thing ?t - tray)
    :precondition (and (at ?t) (on ?p ?t) (free)
      (not (exists (?o - thing) (held ?o))))
    :effect (and (held ?p) (not (on ?p ?t)) (not (free))
      (increase (total-cost) 1)))
  (:action lay :parameters (?p - thing ?t - tray)
    :precondition (and (at ?t) (held ?p))
    :effect (and (on ?p ?t) (free) (not (held ?p))
      (increase (total-cost) 2))))
"""
PROBLEM = """(define (problem one) (:domain sorting)
  (:objects nut - part
    red blue - tray)
  (:init (free) (at red) (on nut red)
    (= (total-cost) 0)
    (= (way red blue) 4) (= (way blue red) 4)
    (= (way red red) 0) (= (way blue blue) 0))
  (:goal (and (not (held spare))
    (on nut blue)))
  (:metric minimize (total-cost)))
"""
RULE = "(:derived (idle ?t - tray) (and (at ?t) (free)))"


def second(task: Task) -> str | None:
    """Return why unified-planning does not read the files of a task, as they are written for it; None if it does."""
    with SecondReader(read(task.instance)) as reader:
        return reader.answer(60.0)


def swept(folder: Path, domain: str, problem: str) -> Table:
    return sweep(load(write_instance(folder, domain, problem)))


def changed(old: str, new: str) -> tuple[str, str]:
    """Return the files with one part replaced, in the domain if it occurs there, otherwise in the problem."""
    assert DOMAIN.count(old) + PROBLEM.count(old) >= 1, old
    return (DOMAIN.replace(old, new, 1), PROBLEM) if old in DOMAIN else (DOMAIN, PROBLEM.replace(old, new, 1))


def moved(text: str, begin: str, end: str, before: str) -> str:
    start, stop = text.index(begin), text.index(end)
    part, rest = text[start:stop], text[:start] + text[stop:]
    at = rest.index(before)
    return rest[:at] + part + rest[at:]


def test_the_task_that_is_changed_below(tmp_path: Path) -> None:
    table = swept(tmp_path, DOMAIN, PROBLEM)
    assert (table[table.initial], second(table.task)) == (7, None)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("tool part - thing thing tray - object", "tool part - thing tray"),
        ("tool part - thing thing tray - object", "tool part - thing thing - thing tray"),
        ("tool part - thing thing tray - object", "thing tray object - object tool part - thing"),
        ("tool part - thing thing tray - object", "object - object tray - object tool part - thing"),
        ("tool part - thing thing tray - object", "tool - thing part - thing tray - tray"),
        ("tool part - thing thing tray - object", "nut-part tool part - thing thing tray - object"),
        ("(define (domain", "\ufeff(define (domain"),
        ("(define (problem", "\ufeff(define (problem"),
        ("(way ?a ?b))))\n", "( way   ?a\t?b ))))\n"),
        ("(seen ?x)", "(seen ?x - (either part tray))"),
        ("(seen ?x)", "(seen ?x) (= ?a ?b)"),
        ("(seen ?x)", "(seen ?x) (seen ?y - part)"),
        ("(total-cost) - number (way ?a ?b - tray) - number", "(way ?a ?b - tray)"),
        ("(increase (total-cost) 1)", "(increase (total-cost) 1.0)"),
        ("(?o - thing) (held ?o)", "(?p - thing) (held ?p)"),
        ("(?o - thing) (held ?o)", "() (not (free))"),
        ("(?o - thing) (held ?o)", "(?o - (either part tool)) (held ?o)"),
        ("(at ?a)\n", "(and () (at ?a))\n"),
        (
            "(forall (?p - part)\n        (when (on ?p ?a) (seen ?p)))",
            "(when (at ?a) (forall (?p - part) (and (seen ?p) (when (on ?p ?b) (seen ?p)))))",
        ),
        (
            "(at ?a)\n    :effect",
            "(and (at ?a) (exists (?a - part) (or (seen ?a) (on ?a red) (on ?a blue))))\n    :effect",
        ),
        ("(free) (at red)", "(free) (not (at blue)) (at red) (at red)"),
        ("(= (total-cost) 0)", "(= (way red blue) 4.0)"),
    ],
)  # fmt: skip
def test_ways_to_write_the_same(tmp_path: Path, old: str, new: str) -> None:
    domain, problem = changed(old, new)
    if "red)" in new and "exists" in new:  # objects that the domain names are constants
        domain = domain.replace("spare - tool", "spare - tool red blue - tray")
        problem = problem.replace("red blue - tray", "")
    table = swept(tmp_path, domain, problem)
    assert (table[table.initial], second(table.task)) == (7, None)


def test_an_object_belongs_to_all_supertypes_of_its_type(tmp_path: Path) -> None:
    domain = DOMAIN.replace("thing tray - object", "thing box - object tray - thing tray - box")
    table = swept(
        tmp_path, domain.replace("(on ?p - thing ?t - tray)", "(on ?p - thing ?t - (either part box))"), PROBLEM
    )
    assert table[table.initial] == 7


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_lines_may_end_as_any_system_writes_them(tmp_path: Path, end: str) -> None:
    """A comment ends with its line, whatever that is."""
    commented = DOMAIN.replace("(:types", "; what there is\n  (:types")
    instance = write_instance(tmp_path, "", "")
    instance.domain.write_bytes(commented.replace("\n", end).encode())
    instance.problem.write_bytes(PROBLEM.replace("\n", end).encode())
    table = sweep(load(instance))
    assert table[table.initial] == 7
    instance.domain.write_bytes(commented.replace("1)))", "one)))").replace("\n", end).encode())
    with pytest.raises(PDDLError, match=r":18: action 'take' costs 'one'"):
        load(instance)


def test_sections_may_stand_in_any_order(tmp_path: Path) -> None:
    """unified-planning and the translator want the initial state before the goal, and predicates before actions."""
    table = swept(
        tmp_path,
        moved(moved(DOMAIN, "(:predicates", "(:functions", "(:types"), "(:types", "(:constants", "(:action take"),
        moved(PROBLEM, "(:goal", "(:metric", "(:init"),
    )
    assert (table[table.initial], second(table.task)) == (7, None)


def test_an_action_that_only_costs_is_none(tmp_path: Path) -> None:
    idle = DOMAIN.replace("  (:action take", "  (:action idle :effect (increase (total-cost) 1))\n  (:action take")
    table = swept(tmp_path, idle, PROBLEM)
    assert (table[table.initial], second(table.task)) == (7, None)


def test_an_action_whose_cost_has_no_value_is_not_applicable(tmp_path: Path) -> None:
    """Undefined values are legal: roads that are not there have no length."""
    domain, problem = changed("(= (way red blue) 4)", "")
    task = load(write_instance(tmp_path, domain, problem))
    assert (task.actions, second(task)) == ((), None)


@pytest.mark.parametrize("metric", [True, False])
def test_a_cost_that_names_a_parameter_twice_needs_all_values(tmp_path: Path, metric: bool) -> None:
    """The translator either fails at such a task, or grounds actions that have no cost."""
    problem = PROBLEM if metric else PROBLEM.replace("(:metric minimize (total-cost))", "")
    domain = DOMAIN.replace("(increase (total-cost) (way ?a ?b))", "(increase (total-cost) (way ?b ?b))")
    assert second(swept(tmp_path, domain, problem).task) is None
    with pytest.raises(PDDLError, match=r"domain.pddl:\d+: action 'go' costs .*; \(way blue blue\) has no value"):
        swept(tmp_path, domain, problem.replace("(= (way blue blue) 0)", ""))


def test_variables_of_one_name_do_not_disturb_each_other(tmp_path: Path) -> None:
    """The translator renames the second ?x to ?x1, which is another variable here."""
    condition = "(and (at ?x1) (exists (?x - part) (on ?x ?x1)) (exists (?x - tray) (and (at ?x) (not (at ?x1)))))"
    domain = DOMAIN.replace(
        "(?a ?b - tray)\n    :precondition (at ?a)", f"(?x1 ?b - tray)\n    :precondition {condition}"
    )
    domain = (
        domain.replace("?a)", "?x1)")
        .replace("(way ?a ?b)", "(way ?x1 ?b)")
        .replace("(way ?x1 ?b - t", "(way ?a ?b - t")
    )
    table = swept(tmp_path, domain, PROBLEM)
    assert not table.task.actions or table[table.initial] == float("inf")


def test_what_is_of_a_supertype_may_be_of_the_type(tmp_path: Path) -> None:
    """Such files are read as the translator reads them, although unified-planning does not accept them."""
    table = swept(
        tmp_path, DOMAIN.replace("(held ?p - thing)", "(held ?p - part)"), PROBLEM.replace(" (not (held spare))", "")
    )
    assert table[table.initial] == 7
    assert "is not well-formed" in str(second(table.task))


@pytest.mark.parametrize(
    ("old", "new", "line", "column", "words"),
    [
        # Types.
        ("thing thing tray - object", "thing tray - object thing - part", 3, 11, "circular types: thing - part"),
        ("tool part - thing thing", "tool part - (either thing tray) thing", 3, 11, "'tool' is under \\(either"),
        ("tray - object", "tray - object object - thing", 3, 49, "'object' is above all types"),
        ("tray - object", "tray - ", 3, 40, "expected a type after '-'"),
        ("thing tray - object", "- object", 3, 29, "expected a type before '-'"),
        ("spare - tool", "spare - tol", 4, 23, "unknown type 'tol'; did you mean 'tool'"),
        ("spare - tool", "spare - (either tool part)", 4, 15, "object 'spare' is of \\(either"),
        ("spare - tool", "spare ?a - tool", 4, 21, "'\\?a' is not an object"),
        ("thing tray - object)", "thing tray -object)", 3, 40, "'-object'"),
        # Predicates and functions.
        ("(held ?p - thing)", "(held ?p -thing)", 5, 51, "'-thing': expected a blank before and after the hyphen"),
        ("(seen ?x)", "(seen x)", 5, 88, "'x' is not a variable"),
        ("(seen ?x)", "(and ?x)", 5, 82, "'and' cannot be the name of a predicate"),
        ("(seen ?x)", "seen", 5, 82, "'seen' declares no predicate"),
        ("(seen ?x)", "(seen ?x) (seen ?x ?y)", 5, 92, "declared with 2 arguments, and with 1 on line 5"),
        ("(way ?a ?b - tray) - number", "(way ?a ?b - tray) - tray", 6, 56, "functions give numbers"),
        # Actions.
        ("(?a ?b - tray)\n", "(?a ?b ?a - tray)\n", 7, 34, "'\\?a' occurs twice"),
        (":precondition (at ?a)\n", ":precondition (at ?a) :observe (at ?b)\n", 8, 27, "sensing actions are not"),
        (":precondition (at ?a)", ":preconditon (at ?a)", 8, 5, "did you mean ':precondition'"),
        (":precondition (at ?a)", ":effect (at ?a)", 9, 5, "a second :effect"),
        # Conditions.
        ("(at ?a)\n", "(at ?aa)\n", 8, 23, "unknown variable '\\?aa'; did you mean '\\?a'"),
        ("(at ?a)\n", "(att ?a)\n", 8, 19, "unknown predicate 'att'; did you mean 'at'"),
        ("(at ?a)\n", "(at ?a ?b)\n", 8, 19, "'at' takes 1 argument, not 2"),
        ("(at ?a)\n", "(at spare)\n", 8, 23, "'spare' is of type tool, and tray is expected"),
        ("(at ?a)\n", "at\n", 8, 19, "'at' is not expected here: expected condition"),
        ("(at ?a)\n", "((at ?a))\n", 8, 19, "is no condition"),
        ("(at ?a)\n", "(> (way ?a ?b))\n", 8, 19, "'>' expects exactly two arguments"),
        ("(at ?a)\n", "(= ?a ?b ?a)\n", 8, 19, "'=' expects exactly two arguments"),
        ("(at ?a)\n", "(imply (at ?a))\n", 8, 19, "'imply' expects exactly two arguments"),
        ("(at ?a)\n", "(when (at ?a) (at ?b))\n", 8, 19, "unknown predicate 'when'"),
        ("(?o - thing) (held ?o)", "(?o - tray) (held ?o)", 15, 38, "held has an argument of the wrong type"),
        ("(?o - thing) (held ?o)", "(?o - (either tray part)) (at ?p)", 15, 50, "'\\?p' is of type thing"),
        ("(?o - thing) (held ?o)", "(?o - thing) (held ?o) (free)", 15, 12, "'exists' expects exactly two arguments"),
        ("(?o - thing) (held ?o)", "?o (held ?o)", 15, 20, "not a list of variables"),
        # Effects.
        ("(when (on ?p ?a) (seen ?p))", "(when (on ?p ?a) (at ?p))", 11, 30, "'\\?p' is of type part, and tray is"),
        ("(when (on ?p ?a) (seen ?p))", "(when (on ?a ?p) (seen ?p))", 11, 19, "'\\?a' is of type tray"),
        ("(when (on ?p ?a) (seen ?p))", "(when (on ?p ?a))", 11, 9, "'when' expects exactly two arguments"),
        ("(held ?p) (not (on ?p ?t))", "(held ?p) (not (on ?p ?t) (free))", 16, 28, "exactly one argument"),
        ("(held ?p) (not (on ?p ?t))", "(held ?p) (not (not (on ?p ?t)))", 16, 28, "is not an effect"),
        ("(held ?p) (not (on ?p ?t))", "(held ?p) (or (on ?p ?t))", 16, 28, "'\\(or .*' is not an effect"),
        ("(held ?p) (not (on ?p ?t))", "(held ?p) (not (on ?t ?p))", 16, 37, "'\\?t' is of type tray"),
        ("(total-cost) (way ?a ?b)", "(total-cost) (way ?a spare)", 12, 38, "'spare' is of type tool, and tray is"),
        ("(total-cost) (way ?a ?b)", "(total-cost) (way ?a ?c)", 12, 38, "unknown variable '\\?c'"),
        ("(total-cost) (way ?a ?b)", "(total-cost ?a) (way ?a ?b)", 12, 17, "'total-cost' takes 0 arguments"),
        ("(total-cost) (way ?a ?b)", "(total-cost) (total-cost)", 12, 30, "which changes"),
        ("(total-cost) (way ?a ?b)", "(total-cost) (way ?a)", 12, 30, "'way' takes 2 arguments, not 1"),
        ("(total-cost) 1)", "(total-cost) one)", 17, 30, "action 'take' costs 'one'; expected a number"),
        ("(total-cost) 1)", "(total-cost) 1,5)", 17, 30, "costs '1,5'"),
        ("(total-cost) 1)", "(total-cost) -1)", 17, 30, "may not be negative"),
        ("(total-cost) 1)", "(total-cost) (- 1))", 17, 30, "may not be negative"),
        ("(total-cost) 1)", "(total-cost))", 17, 7, "'increase' expects exactly two arguments"),
        ("(total-cost) 1)", "(total-cost) 1) (increase (total-cost) 5)", 17, 33, "action 'take' has two costs"),
        # Problems.
        ("(on nut red)", "(on red nut)", 4, 30, "on has an argument of the wrong type: 'red' is of type tray"),
        ("(at red)", "(at nut)", 4, 21, "'nut' is of type part, and tray is expected"),
        ("(at red)", "(at\u200b red)", 4, None, r"zero width space is not ASCII \(U\+200B, column 20\)"),
        ("(at red)", "(at réd)", 4, None, r"'é' is not ASCII \(U\+00E9, column 22\)"),
        ("(on nut blue)", "(and " * 200 + "(on nut blue)" + ")" * 200, 9, None, "more than 200 parentheses"),
        ("nut - part", "nut spare - part", 2, 17, "'spare' is defined twice, on line 4 of .*domain.pddl as well"),
        ("(= (way red blue) 4)", "(= (wya red blue) 4)", 6, 8, "no such function 'wya' .*did you mean 'way'"),
        ("(= (way red blue) 4)", "(= (way red blue) four)", 6, 23, "'four' is no number; expected a number"),
        ("(= (way red blue) 4)", "(= (way blue red) 5)", 6, 26, "has another value on line 6"),
        ("(= (way red blue) 4)", "(way red blue)", 6, 5, "unknown predicate 'way'"),
        ("(= (way red blue) 4)", "(= way 4)", 6, 5, "expected \\(= \\(FUNCTION"),
        ("(= (total-cost) 0)", "(= (total-cost) 2)", 5, 5, "begins with 0"),
        ("(at red)", "(at red) (not (at red))", 4, 26, "holds on line 4, and does not hold here"),
        ("(at red)", "(at ?red)", 4, 21, "unknown variable '\\?red'"),
        ("(on nut blue)", "(forall (?t - tray) (on ?t nut))", 9, 29, "'\\?t' is of type tray"),
    ],
)  # fmt: skip
def test_faults_are_told_with_their_place(
    tmp_path: Path, old: str, new: str, line: int, column: int | None, words: str
) -> None:
    with pytest.raises(PDDLError, match=words) as error:
        load(write_instance(tmp_path, *changed(old, new)))
    file = "domain.pddl" if old in DOMAIN else "problem.pddl"
    assert (error.value.file.name, error.value.line, error.value.column) == (file, line, column)


@pytest.mark.parametrize(
    ("rule", "words"),
    [
        (RULE, None),
        ("(:derived (idle ?t) (and (at ?t) (free)))", None),
        ("(:derived (idle ?t - part) (free))", "'\\?t' is of type part, and tray is expected"),
        ("(:derived (idle) (free))", "'idle' takes 1 argument, not 0"),
        ("(:derived (idl ?t) (free))", "unknown predicate 'idl'; did you mean 'idle'"),
        ("(:derived (idle ?t) (att ?t))", "unknown predicate 'att'"),
        ("(:derived (idle ?t))", "expected \\(:derived"),
        ("(:derived (idle ?t) (not (idle ?t)))", "depend on their own negation"),
        ("(:derived (idle ?t) (forall (?u - tray) (not (idle ?u))))", "depend on their own negation"),
        ("(:derived (at ?t - tray) (free))", "action 'go' changes 'at', which is derived \\(line 7\\)"),
    ],
)
def test_rules(tmp_path: Path, rule: str, words: str | None) -> None:
    domain = DOMAIN.replace("(seen ?x)", "(seen ?x) (idle ?t - tray)").replace(
        "  (:action go", f"  {rule}\n  (:action go"
    )
    domain = domain.replace("(and (at ?t) (on ?p ?t) (free)", "(and (idle ?t) (on ?p ?t)")
    if words is None:
        table = swept(tmp_path, domain, PROBLEM)
        assert table[table.initial] == 7
    else:
        with pytest.raises(PDDLError, match=words) as error:
            load(write_instance(tmp_path, domain, PROBLEM))
        assert error.value.line is not None


def test_a_derived_fact_is_not_stated(tmp_path: Path) -> None:
    domain = DOMAIN.replace("(seen ?x)", "(seen ?x) (idle ?t - tray)").replace(
        "  (:action go", f"  {RULE}\n  (:action go"
    )
    with pytest.raises(PDDLError, match="'idle' is derived \\(line 7 of the domain\\), and not stated") as error:
        load(write_instance(tmp_path, domain, PROBLEM.replace("(at red)", "(at red) (idle red)")))
    assert error.value.line == 4
