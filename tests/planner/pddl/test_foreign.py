"""PDDL of others: files that Fast Downward's translator reads and unified-planning does not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import write_instance

from planner import MismatchError, load, sweep, verify
from planner.batch.solve_instance import solve_instance
from planner.grounding.semantics import replay

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
    line = POWER.split("(:derived")[0].count("\n") + 1
    assert f"it knows no derived predicates (line {line} of the domain)" in record["note"]
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
