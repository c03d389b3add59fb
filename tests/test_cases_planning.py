"""Inputs that were met in use: the second reader, costs without a metric, names, limits, and one plan."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from conftest import KITTING, invoke, write_instance

from planner import instance, load
from planner.batch import solve_instance as solving
from planner.batch.solve_instance import solve_instance
from planner.batch.solve_record import SolveOptions
from planner.pddl import validation_process
from planner.pddl.validation import InvalidPlanError
from planner.pddl.validation_process import LATE

TINY = KITTING / "tiny.pddl"


def test_a_second_reader_that_says_nothing_costs_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is stopped at once, as if it read for ever; the plan is there before it is waited for."""
    idle = validation_process._Process.idle

    def stopped(*arguments: object) -> object:
        process = idle(*arguments)  # type: ignore[arg-type]
        os.kill(process._popen.pid, signal.SIGSTOP)
        return process

    told: list[dict] = []
    monkeypatch.setattr(validation_process._Process, "idle", stopped)
    monkeypatch.setattr(solving, "SECOND_READER", 0.01)
    record = solve_instance(instance(TINY), SolveOptions(verify=1), tell=lambda record, _: told.append(record))
    assert (record["status"], record["cost"], told[0]["plan"]) == ("solved", 6, record["plan"])
    assert record["note"] == f"read by Fast Downward's translator, not checked by unified-planning: {LATE}"


def test_a_second_reader_that_contradicts_makes_the_answer_invalid(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def rejects(*_: object) -> None:
        raise InvalidPlanError("unified-planning's validator rejects the plan: so there")

    monkeypatch.setattr(validation_process._Process, "answer", rejects)
    record = solve_instance(instance(TINY), SolveOptions(verify=1), tmp_path / "tiny")
    assert (record["status"], record["plan"]) == ("invalid", None)
    assert record["error"]["message"] == "unified-planning's validator rejects the plan: so there"
    assert list(tmp_path.iterdir()) == []


DOMAIN = """(define (domain packing)
  (:requirements :strips :typing :action-costs)
  (:types part bin - object)
  (:predicates (in ?p - part ?b - bin) (held ?p - part) (free) (here ?b - bin) (path ?a ?b - bin))
  (:functions (total-cost) (far ?a ?b - bin) - number)
  (:action go :parameters (?a ?b - bin) :precondition (and (here ?a) (path ?a ?b))
    :effect (and (not (here ?a)) (here ?b) (increase (total-cost) GO)))
  (:action pick :parameters (?p - part ?b - bin) :precondition (and (here ?b) (in ?p ?b) (free))
    :effect (and (held ?p) (not (in ?p ?b)) (not (free))))
  (:action put :parameters (?p - part ?b - bin) :precondition (and (here ?b) (held ?p))
    :effect (and (in ?p ?b) (free) (not (held ?p)))))
"""
PROBLEM = """(define (problem p) (:domain packing)
  (:objects bolt nut - part shelf kit - bin)
  (:init (free) (here shelf) (path shelf kit) (path kit shelf) (in bolt shelf) (in nut shelf)
    (= (total-cost) 0) (= (far shelf kit) 4) (= (far kit shelf) 1))
  (:goal (and (in bolt kit) (in nut kit)))
  (:metric minimize (total-cost)))
"""
NO_METRIC = ("(:metric minimize (total-cost))", "")
NO_BEGIN = ("(= (total-cost) 0)", "")
UNIT = (
    "line 7 of the domain has an action cost, but the problem has no :metric, so that each action costs 1; "
    "to use costs, write (:metric minimize (total-cost))"
)
ASSUMED = "the initial state has no (= (total-cost) 0), which is assumed"


@pytest.mark.parametrize(
    ("go", "changes", "cost", "note"),
    [
        ("2", (), 6, None),
        ("(far ?a ?b)", (), 9, None),
        ("2", (NO_METRIC,), 7, UNIT),
        ("2", (NO_METRIC, NO_BEGIN), 7, UNIT),
        ("(far ?a ?b)", (NO_METRIC,), 7, UNIT),
        ("(far ?a ?b)", (NO_METRIC, NO_BEGIN), 7, UNIT),
        ("2", (NO_METRIC, NO_BEGIN, ("(:functions (total-cost) (far ?a ?b - bin) - number)", "")), 7, UNIT),
        ("2", (NO_METRIC, ("(increase (total-cost) 2)", "")), 7, None),
        ("2", (NO_BEGIN,), 6, ASSUMED),
        ("(far ?a ?b)", (NO_BEGIN,), 9, ASSUMED),
        ("2", (NO_BEGIN, ("(:functions (total-cost) (far", "(:functions (far")), 6, ASSUMED),
        (
            "2", (("(increase (total-cost) 2)", ""),), 0,
            "the problem minimizes (total-cost), but no action increases it, so that each action costs 0",
        ),
    ],
)  # fmt: skip
def test_costs_without_a_metric_or_a_beginning(
    tmp_path: Path, go: str, changes: tuple[tuple[str, str], ...], cost: int, note: str | None
) -> None:
    texts = [DOMAIN.replace("GO", go), PROBLEM]
    for old, new in changes:
        texts = [text.replace(old, new) for text in texts]
    if "(far" not in texts[0]:
        texts[1] = texts[1].replace("(= (far shelf kit) 4) (= (far kit shelf) 1)", "")
    record = solve_instance(write_instance(tmp_path, *texts), SolveOptions(verify=3))
    assert (record["status"], record["cost"], record["note"]) == ("solved", cost, note), record["error"]
    assert load(tmp_path / "problem.pddl").note == note


def test_every_command_says_what_was_assumed_of_costs(tmp_path: Path) -> None:
    problem = write_instance(tmp_path, DOMAIN.replace("GO", "2"), PROBLEM.replace(*NO_METRIC))
    done = invoke("simulate", problem, "--humans", 1, "--pool", 1, "--policy", "none", "--episodes", 1)
    assert done.stderr.splitlines().count(f"{problem}: {UNIT}") == 1
