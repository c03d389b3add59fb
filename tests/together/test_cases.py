"""Small inputs of each kind that once failed: the same answer from the command line and from Python."""

from __future__ import annotations

import json
import warnings
from dataclasses import dataclass
from pathlib import Path

import pytest
from conftest import invoke, thinned, understood

from assist.live import Assistant
from planner import PDDLError, cost_to_go, find_instances, instance, load
from planner.engine import Engine
from planner.grounding.task import plan_cost

DOMAIN = """(define (domain packing)
  (:requirements :strips :typing :action-costs)
  (:types part bin - object)
  (:predicates (in ?p - part ?b - bin) (held ?p - part) (free) (here ?b - bin) (path ?a ?b - bin))
  (:functions (total-cost) (far ?a ?b - bin) - number)
  (:action go :parameters (?a ?b - bin) :precondition (and (here ?a) (path ?a ?b))
    :effect (and (not (here ?a)) (here ?b) (increase (total-cost) GO)))
  (:action pick :parameters (?p - part ?b - bin) :precondition (and (here ?b) (in ?p ?b) (free))
    :effect (and (held ?p) (not (in ?p ?b)) (not (free)) (increase (total-cost) PICK)))
  (:action put :parameters (?p - part ?b - bin) :precondition (and (here ?b) (held ?p))
    :effect (and (in ?p ?b) (free) (not (held ?p)) (increase (total-cost) 1))))
"""
PROBLEM = """(define (problem p) (:domain packing)
  (:objects bolt nut - part shelf kit - bin)
  (:init (free) (here shelf) (path shelf kit) (path kit shelf) (in bolt shelf) (in nut shelf)
    (= (total-cost) 0) (= (far shelf kit) 2) (= (far kit shelf) 2))
  (:goal (and (in bolt kit) (in nut kit)))
  (:metric minimize (total-cost)))
"""


@dataclass(frozen=True)
class Case:
    """A change of the files, and the cost of an optimal plan or the place and message of the error."""

    changed: tuple[tuple[str, str], ...] = ()
    cost: int | None = None
    said: str = ""
    go: str = "1"
    pick: str = "1"
    names: tuple[str, str] = ("domain.pddl", "p.pddl")

    def write(self, folder: Path) -> Path:
        """Write the files, and return the path of the problem."""
        for name, text in zip(self.names, (DOMAIN, PROBLEM), strict=True):
            for old, new in (("GO", self.go), ("PICK", self.pick), *self.changed):
                text = text.replace(old, new)
            (folder / name).write_text(text, encoding="utf-8")
        return folder / self.names[1]


CASES = {
    "nothing changed": Case(cost=7),
    "a hyphen glued to a type": Case((("nut - part", "nut -part"),), said="p.pddl:2: '-part': expected a blank"),
    "two costs, and a type without a parent": Case(
        (("part bin - object", "part bin - object tray - bin bin"),), go="3) (increase (total-cost) 4",
        said="domain.pddl:7: action 'go' has two costs",
    ),
    "costs of a hundred million": Case(go="100000000", pick="70000000", cost=440_000_002),
    "costs whose sum exceeds 32 bits": Case(go="1500000000", cost=4_500_000_004),
    "costs that exceed 32 bits": Case(go="5000000000", cost=15_000_000_004),
    "a cost beyond all": Case(go="1000000000001", said="domain.pddl:7: a cost of 1000000000001 is too large"),
    "a value beyond all": Case(
        (("(= (far kit shelf) 2)", "(= (far kit shelf) 100000000000000000000)"),), go="(far ?a ?b)",
        said="p.pddl:4: a cost of 100000000000000000000 is too large; expected at most 1000000000000",
    ),
    "the largest costs": Case(go="1000000000000", cost=3_000_000_000_004),
    "a cost of a function that is not there": Case(go="(fra ?a ?b)", said="did you mean 'far'"),
    "a wrong type beside a derived predicate": Case(
        ((":action-costs)", ":action-costs :derived-predicates)"),
         ("(held ?p - part) (free)", "(held ?p - part) (busy) (free)"),
         ("  (:action go", "  (:derived (busy) (exists (?p - part) (held ?p)))\n  (:action go"),
         ("(in bolt shelf)", "(in shelf bolt)")),
        said="p.pddl:3: in has an argument of the wrong type",
    ),
    "a domain by another name": Case(names=("packing_domain.pddl", "packing_problem.pddl"), cost=7),
    "a domain of one problem": Case(names=("p01-domain.pddl", "p01.pddl"), cost=7),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_from_python(tmp_path: Path, name: str) -> None:
    case = CASES[name]
    problem = case.write(tmp_path)
    if case.cost is None:
        for ask in (lambda: load(problem), lambda: understood(instance(problem))):
            with pytest.raises(PDDLError) as error:
                ask()
            assert case.said in str(error.value)
        return
    table = cost_to_go(load(problem))
    assert table.lookup([table.initial])[0] == case.cost
    assistant = Assistant(table, ["ann"])
    for action in table.optimal_plan():
        assert not assistant.finished
        assistant.recommend()
        assistant.observe("ann", action)
    assert assistant.finished


@pytest.mark.parametrize("name", thinned([name for name, case in CASES.items() if case.cost is not None], 3))
def test_from_the_engine(tmp_path: Path, name: str) -> None:
    problem = CASES[name].write(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # unified-planning calls it unsupported where some values are not given
        with Engine() as engine:
            engine.error_on_failed_checks = False
            result = engine.solve(understood(instance(problem)))
    assert result.status.name == "SOLVED_OPTIMALLY"
    plan = [f"({' '.join([step.action.name, *map(str, step.actual_parameters)])})" for step in result.plan.actions]
    assert plan_cost(load(problem), plan) == CASES[name].cost


def test_from_the_command_line(tmp_path: Path) -> None:
    """Instances are solved at once, as a folder; a refused one does not stop the others."""
    problems, cases = {}, dict(list(CASES.items())[::3])
    for number, (name, case) in enumerate(cases.items()):
        (tmp_path / f"{number:02}").mkdir()
        problems[name] = case.write(tmp_path / f"{number:02}")
    done = invoke("solve", tmp_path, "--verify", "1", "--jobs", "1", "--json")
    records = dict(zip(cases, json.loads(done.stdout), strict=True))
    assert done.exit_code == 1
    assert [one.problem for one in find_instances([tmp_path])] == list(problems.values())
    for name, case in cases.items():
        record = records[name]
        assert (record["instance"], record["cost"]) == (str(problems[name]), case.cost)
        assert record["status"] == ("invalid" if case.cost is None else "solved")
        assert case.said in done.stderr
        assert case.cost is not None or str(problems[name].parent) in done.stderr
