"""A compiled task is shown with the names and numbers of its file."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from assist import Assistant
from assist.people.choices import Choices
from planner import Instance, OnDemand, Task, astar, sweep, verify
from planner.costtogo.astar import check_successors
from planner.grounding import fast_downward
from planner.grounding.task import replay
from planner.grounding.translation import from_sas, in_the_files_terms
from planner.pddl.compilation import Compilation
from planner.pddl.reader import read

DOMAIN = """(define (domain bins) (:requirements :typing :action-costs) (:types bin number-value)
(:constants v0 v1 v2 - number-value)
(:predicates (stock-is ?b - bin ?v - number-value) (one-less ?old ?new - number-value) (empty ?b - bin))
(:functions (price ?v - number-value) - number (total-cost) - number)
(:action pick :parameters (?b - bin ?old ?new - number-value)
  :precondition (and (stock-is ?b ?old) (one-less ?old ?new))
  :effect (and (not (stock-is ?b ?old)) (stock-is ?b ?new) (increase (total-cost) (price ?old))))
(:action close :parameters (?b - bin) :precondition (stock-is ?b v0)
  :effect (and (empty ?b) (increase (total-cost) 2))))"""
PROBLEM = """(define (problem one) (:domain bins) (:objects bin-1 - bin)
(:init (stock-is bin-1 v2) (one-less v2 v1) (one-less v1 v0) (= (price v2) 1) (= (price v1) 3) (= (price v0) 0)
  (= (total-cost) 0)) (:goal (empty bin-1)) (:metric minimize (total-cost)))"""


@pytest.fixture(scope="module")
def stock(tmp_path_factory: pytest.TempPathFactory) -> Task:
    """Two parts in a bin, of which the second one costs more to take."""
    files = tmp_path_factory.mktemp("bins")
    instance = Instance(files / "problem.pddl", files / "domain.pddl")
    instance.domain.write_text(DOMAIN)
    instance.problem.write_text(PROBLEM)
    shown = {"v0": "0", "v1": "1", "v2": "2"}
    compilation = Compilation(
        read(instance), Fraction(1, 2), {"pick": ("take", 1)}, {"stock-is": ("stock", shown)}, {"numbers": 1}
    )
    return in_the_files_terms(from_sas(fast_downward.translate(compilation.reading), instance), compilation)


def test_actions_and_numbers_are_those_of_the_file(stock: Task) -> None:
    assert stock.actions == ("(close bin-1)", "(take bin-1)", "(take bin-1)")
    assert stock.costs == (2, 1, 3)
    assert stock.unit == Fraction(1, 2)
    assert "stock(bin-1) = 2" in stock.facts(stock.initial)
    assert {len(operator.effects) for operator in stock.operators} == {1}


def test_the_state_decides_what_an_action_costs(stock: Task) -> None:
    plan = ["(take bin-1)", "(take bin-1)", "(close bin-1)"]
    table = sweep(stock)
    assert astar(stock) == (3.0, plan)
    assert stock.in_unit(replay(stock, plan)) == table[table.initial] == 3.0
    assert table.optimal_plan() == OnDemand(stock).optimal_plan() == plan
    assert verify(table, 4, np.random.default_rng(0)) == check_successors(table, 4, np.random.default_rng(0)) == 4
    state = table.initial
    for cost, action in ((0.5, plan[0]), (1.5, plan[1]), (1.0, plan[2])):
        rows = table.choices([state])
        assert (table.space.options(state).keys(), stock.action_costs[rows.actions].tolist()) == ({action}, [cost])
        state = table.space.follow([action], state)


def test_people_tell_actions_apart_by_their_names(stock: Task) -> None:
    table = sweep(stock)
    choices = Choices.of(table)
    start, then = table.initial, table.space.follow(["(take bin-1)"])
    assert choices.name(start, 0) == choices.name(then, 0) == "(take bin-1)"
    assert choices.actions[start, 0] == choices.actions[then, 0]
    assert choices.costs[[start, then], 0].tolist() == [0.5, 1.5]
    desk = Assistant(table, ["ann"])
    for action in ("(take bin-1)", "take(bin-1)", "(close bin-1)"):
        desk.observe("ann", action)
    assert desk.finished


def test_a_stored_task_keeps_them(stock: Task) -> None:
    assert replace(from_sas(stock.sas, stock.instance), unit=stock.unit) == stock
