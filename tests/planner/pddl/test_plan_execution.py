"""Plans are executed by the meaning of numeric and durative files, as an independent search executes them."""

from __future__ import annotations

import heapq
import itertools
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from conftest import write_instance
from direct_search import Direct, UnsupportedError
from random_numeric import draw

from planner import MismatchError
from planner.pddl.plan_execution import execute

DOMAIN = """(define (domain cell) (:requirements :durative-actions :numeric-fluents) (:types bin tray)
(:predicates (lit) (ready ?t - tray)) (:functions (stock ?b - bin) (weight ?t - tray) (speed) (spare ?b - bin))
(:durative-action light :parameters () :duration (= ?duration 0.5) :condition ()
  :effect (and (at start (lit)) (at end (not (lit)))))
(:durative-action pick :parameters (?b - bin ?t - tray) :duration (= ?duration (/ 3 (speed)))
  :condition (and (at start (not (lit))) (over all (lit)) (at start (>= (stock ?b) 1)))
  :effect (and (at start (lit)) (at start (decrease (stock ?b) 1)) (at end (not (lit)))
    (at end (when (at start (>= (stock ?b) 2)) (increase (weight ?t) 0.1)))))
(:action ship :parameters (?t - tray) :precondition (>= (weight ?t) 0.2) :effect (ready ?t)))"""
PROBLEM = """(define (problem one) (:domain cell) (:objects bin-1 bin-2 - bin tray-1 - tray)
(:init (= (stock bin-1) 3) (= (weight tray-1) 0) (= (speed) 2)) (:goal (ready tray-1)) METRIC)"""


PICK, SHIP = "(pick bin-1 tray-1)", "(ship tray-1)"


@pytest.mark.parametrize(
    ("metric", "cost"),
    [
        ("", Fraction(4)),  # a plain action counts 1
        ("(:metric minimize (total-time))", Fraction(3)),  # and takes no time
        ("(:metric minimize (+ (* 0.5 (total-time)) (* 10 (weight tray-1))))", Fraction(7, 2)),
    ],
)
def test_a_plan_costs_what_the_metric_says(tmp_path: Path, metric: str, cost: Fraction) -> None:
    assert execute(write_instance(tmp_path, DOMAIN, PROBLEM.replace("METRIC", metric)), [PICK, PICK, SHIP]).cost == cost


@pytest.mark.parametrize(
    ("plan", "message"),
    [
        ([PICK, SHIP], r"step 1: \(ship tray-1\) is not applicable"),
        ([PICK, PICK], "the goal does not hold after the plan"),
        ([PICK, PICK, PICK, PICK], r"step 3: \(pick bin-1 tray-1\) is not applicable"),
        (["(pick bin-2 tray-1)"], r"step 0: \(pick bin-2 tray-1\) reads \(stock bin-2\), which has no value"),
        (["(pick tray-1 tray-1)"], "step 0: .* has arguments of other types"),
        (["(take bin-1)"], r"step 0: \(take bin-1\) is no action of the domain"),
    ],
)
def test_a_plan_that_is_none_is_refused(tmp_path: Path, plan: list[str], message: str) -> None:
    with pytest.raises(MismatchError, match=message):
        execute(write_instance(tmp_path, DOMAIN, PROBLEM.replace("METRIC", "")), plan)


def test_derived_predicates_follow_numbers(tmp_path: Path) -> None:
    domain = """(define (domain d) (:predicates (full ?x) (chain ?x ?y) (low ?x) (done)) (:functions (n ?x))
    (:derived (full ?x) (= (n ?x) 2)) (:derived (low ?x) (not (full ?x)))
    (:derived (chain ?x ?y) (or (= ?x ?y) (exists (?z) (and (full ?z) (chain ?x ?z) (full ?y)))))
    (:action add :parameters (?x) :precondition (low ?x) :effect (increase (n ?x) 1))
    (:action end :parameters (?x ?y) :precondition (and (not (= ?x ?y)) (chain ?x ?y)) :effect (done)))"""
    problem = """(define (problem p) (:domain d) (:objects a b) (:init (= (n a) 1) (= (n b) 1)) (:goal (done)))"""
    instance = write_instance(tmp_path, domain, problem)
    assert execute(instance, ["(add a)", "(add b)", "(end a b)"]).cost == 3
    for wrong in (["(add a)", "(add a)"], ["(add a)", "(end a b)"]):
        with pytest.raises(MismatchError, match=r"step 1: .* is not applicable"):
            execute(instance, wrong)


def planned(direct: Direct, most: int = 200) -> tuple[Fraction, list[str]] | None:
    """An optimal plan and its cost; None if there is none, or none among so many states."""
    best, number = {direct.initial.key: Fraction(0)}, itertools.count()
    queue = [(Fraction(0), next(number), direct.initial, list[str]())]
    for _ in range(most):
        if not queue:
            return None
        cost, _, state, plan = heapq.heappop(queue)
        if direct.solved(state):
            return cost, plan
        for name, after, price in direct.successors(state):
            if after.key not in best or cost + price < best[after.key]:
                best[after.key] = cost + price
                heapq.heappush(queue, (cost + price, next(number), after, [*plan, name]))
    return None


def test_random_plans_are_judged_as_by_a_direct_search(tmp_path: Path) -> None:
    right = wrong = 0
    for seed in range(12):
        texts = draw(seed)
        instance = write_instance(tmp_path, texts.domain, texts.problem)
        direct, rng = Direct(instance.domain, instance.problem), np.random.default_rng(seed)
        names = [name for name, _, _ in direct.ground]
        plans = [[str(one) for one in rng.choice(names, size=size)] for size in range(4)] if names else []
        try:
            if (found := planned(direct)) is not None:
                plans.append(found[1])
            for plan in plans:
                try:
                    expected = direct.replay(plan)
                except AssertionError:
                    expected = None
                if expected is not None:
                    assert execute(instance, plan).cost == expected
                else:
                    with pytest.raises(MismatchError):
                        execute(instance, plan)
                right, wrong = right + (expected is not None), wrong + (expected is None)
        except UnsupportedError:
            continue
    assert right >= 3
    assert wrong >= 30
