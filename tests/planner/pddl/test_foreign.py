"""PDDL of others: files that Fast Downward's translator reads and unified-planning does not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import write_instance

from planner import MismatchError, load, sweep, verify
from planner.batch.solve_instance import solve_instance
from planner.grounding.task import replay
from planner.pddl import plan_execution

# Wires between places are closed and opened; a lamp is lit if a closed path connects it to the source.
POWER = """(define (domain power) (:requirements :strips :typing :derived-predicates)
  (:types place)
  (:predicates (wire ?a ?b - place) (closed ?a ?b - place) (source ?p - place) (powered ?p - place) (tested ?p - place))
  (:derived (powered ?p - place) (or (source ?p)
    (exists (?q - place) (and (powered ?q) (or (closed ?q ?p) (closed ?p ?q))))))
  (:action close :parameters (?a ?b - place)
    :precondition (and (wire ?a ?b) (not (closed ?a ?b)) (not (and (powered ?a) (powered ?b))))
    :effect (closed ?a ?b))
  (:action open :parameters (?a ?b - place) :precondition (closed ?a ?b) :effect (not (closed ?a ?b)))
  (:action test :parameters (?p - place)
    :precondition (and (powered ?p) (forall (?q - place) (imply (tested ?q) (not (powered ?q)))))
    :effect (tested ?p)))"""
POWER_PROBLEM = """(define (problem lamps) (:domain power) (:objects s a b c - place)
  (:init (source s) (wire s a) (wire a b) (wire s c) (wire b c))
  (:goal (and (tested a) (tested b))))"""

# Variants of a walk along four places; `step` is one of two or three actions.
WALK = """(define (domain walk) (:requirements {requirements}) {types}
  (:predicates (at ?p) (next ?a ?b) {predicates})
  {actions})"""
WALK_PROBLEM = """(define (problem p) (:domain walk) (:objects {objects})
  (:init (at p1) (next p1 p2) (next p2 p3) (next p3 p4) {init}) (:goal (and (at p4) {goal})))"""
STEP = """(:action {name} :parameters (?a ?b) :precondition (and (at ?a) (next ?a ?b) {condition})
  :effect (and (at ?b) (not (at ?a)) {effect}))"""

TYPED = """(define (domain walk) (:requirements :adl :typing) (:types place)
  (:predicates (at ?p - place) (next ?a ?b - place))
  (:action step :parameters ({}) :precondition (and (at ?a) (next ?a ?b) {})
    :effect (and (at ?b) (not (at {})))))"""


def walk(**parts: str) -> tuple[str, str]:
    step = STEP.format_map({"name": "step", "condition": "", "effect": ""} | parts)
    default = {"requirements": ":adl", "types": "", "predicates": "", "objects": "p1 p2 p3 p4", "init": "", "goal": ""}
    parts = {**default, "actions": step, **parts}
    return WALK.format_map(parts), WALK_PROBLEM.format_map(parts)


FOREIGN = {
    "a predicate and an action": walk(name="next"),
    "an object and a type": walk(types="(:types p1 - object)", objects="p1 p2 p3 p4"),
    "an object and a predicate": walk(predicates="(p1)"),
    "an untyped quantifier": (
        TYPED.format("?a ?b - place", "(forall (?x) (not (next ?x ?x)))", "?a"),
        WALK_PROBLEM.format(objects="p1 p2 p3 p4 - place", init="", goal=""),
    ),
    "a type and an action": walk(
        requirements=":typing", types="(:types stone step - object)", predicates="(dry ?p - (either stone step))"
    ),
}
CHECKED = {
    "a predicate declared twice": walk(predicates="(next ?a ?b - object)"),
    "an argument's name twice": walk(predicates="(far ?a ?a)", init="(far p1 p4)"),
    "requirements that it does not know": walk(requirements=":adl :derived-predicates :negation"),
    "a variable glued to its type": (
        TYPED.format("?a - place?b - place", "", "?a").replace("at ?", "at?"),
        WALK_PROBLEM.format(objects="p1 p2 p3 p4 - place", init="", goal=""),
    ),
    "either": walk(
        requirements=":typing", types="(:types stone way - object)", predicates="(dry ?p - (either stone way))"
    ),
}


@pytest.mark.parametrize("domain", FOREIGN, ids=str)
def test_the_translator_has_the_last_word(domain: str, tmp_path: Path) -> None:
    record = solve_instance(write_instance(tmp_path, *FOREIGN[domain]))
    assert record["status"] == "solved", record["error"]
    assert record["cost"] == 3
    assert record["verified"] == record["states"] == 4
    assert record["note"].startswith("read by Fast Downward's translator, not checked by unified-planning: "), record


@pytest.mark.parametrize("domain", CHECKED, ids=str)
def test_unified_planning_reads_what_is_written_anew(domain: str, tmp_path: Path) -> None:
    record = solve_instance(write_instance(tmp_path, *CHECKED[domain]))
    assert (record["status"], record["cost"], record["note"]) == ("solved", 3, None), record["error"]


def test_derived_predicates(tmp_path: Path) -> None:
    instance = write_instance(tmp_path, POWER, POWER_PROBLEM)
    record = solve_instance(instance)
    assert record["status"] == "solved", record["error"]
    assert record["method"] == "sweep"
    assert record["note"] is None
    table = sweep(load(instance))
    assert verify(table, 10, np.random.default_rng(0)) == 10
    assert replay(table.task, record["plan"]) == record["cost"] == table[table.initial]
    # A plan from any state passes the replay from that state.
    with pytest.raises(MismatchError, match="not applicable"):
        replay(table.task, record["plan"][1:])
    with pytest.raises(MismatchError, match="goal does not hold"):
        replay(table.task, record["plan"][:-1])
    with pytest.raises(MismatchError, match="no action"):
        replay(table.task, ["(fly a b)"])


def test_the_plan_with_derived_predicates_is_executed_by_the_meaning_of_the_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """unified-planning knows no derived predicates."""
    instance = write_instance(tmp_path, POWER, POWER_PROBLEM)
    monkeypatch.setattr(plan_execution, "MOST_RULES", 1)
    note = solve_instance(instance)["note"]
    assert note == "the plan was not executed by the meaning of the files: too many combinations of objects in " + (
        "derived predicates"
    )
    monkeypatch.undo()

    def without_rules(_: object, atoms: set[plan_execution.Term], values: object) -> object:
        return plan_execution._State(frozenset(atoms), values)  # type: ignore[arg-type]

    monkeypatch.setattr(plan_execution._Files, "_derived", without_rules)
    record = solve_instance(instance)
    assert record["status"] == "invalid"
    assert "is not applicable" in record["error"]["message"]


KITS = """(define (domain kits) (:requirements :adl :typing :derived-predicates) (:types part)
  (:predicates (have ?p - part) (sub ?s ?p - part) (kit ?p - part) (ready ?p - part))
  (:derived (ready ?p - part) (or (have ?p) (and (kit ?p) READY)))
  (:action fetch :parameters (?p - part) :precondition (and (not (kit ?p)) (not (have ?p))) :effect (have ?p))
  (:action lose :parameters (?p - part) :precondition (have ?p) :effect (not (have ?p))))"""
KITS_PROBLEM = """(define (problem p) (:domain kits) (:objects a b c d e f - part)
  (:init (kit a) (kit b) (kit f) (sub b a) (sub c a) (sub d b) (sub e b) (sub f f))
  (:goal (and (ready a) GOAL)))"""


@pytest.mark.parametrize("ready", [
    "(forall (?s - part) (imply (sub ?s ?p) (ready ?s)))",
    "(not (exists (?s - part) (and (sub ?s ?p) (not (ready ?s)))))",
    "(forall (?s ?q - part) (or (not (= ?q ?p)) (not (sub ?s ?q)) (exists (?t - part) (and (= ?t ?s) (ready ?t)))))",
    "(forall (?s - part) (or (not (sub ?s ?p)) (forall (?t - part) (imply (= ?t ?s) (ready ?t)))))",
])  # fmt: skip
def test_a_kit_is_ready_if_all_its_parts_are(tmp_path: Path, ready: str) -> None:
    """a has b and c, and b has d and e: c, d and e are fetched. f is a part of itself, and never ready."""
    domain = KITS.replace("READY", ready)
    instance = write_instance(tmp_path, domain, KITS_PROBLEM.replace("GOAL", ""))
    record = solve_instance(instance)
    assert (record["status"], record["cost"], record["note"]) == ("solved", 3, None), record["error"]
    assert record["verified"] == record["consistent"] == record["states"] == 8
    facts = {fact for each in load(instance).variables for fact in each.facts}
    for impossible in ("(ready f)", "(not (ready d))"):
        record = solve_instance(write_instance(tmp_path, domain, KITS_PROBLEM.replace("GOAL", impossible)))
        assert record["status"] == "unsolvable", record["error"]
    assert {"Atom ready(a)", "Atom have(c)"} <= facts
