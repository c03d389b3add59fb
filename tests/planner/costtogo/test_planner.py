"""States, transitions and cost-to-go compared with independent sources: Fast Downward, unified-planning, scipy."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from conftest import DOMAINS, KITTING, SMALL, kit, named, solvable, table_of, thinned, understood, write_instance
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from planner import Instance, LimitError, Limits, Table, astar, instance, load, sweep, verify
from planner.batch.results_folder import SolveOptions
from planner.batch.solve_instance import solve_instance
from planner.grounding.task import plan_cost

WITH_STATES = solvable(SMALL)


@pytest.mark.parametrize("instance", thinned(WITH_STATES, 5), ids=named)
def test_cost_to_go_equals_fast_downwards(instance: Instance) -> None:
    table = table_of(instance)
    compared = verify(table, 6, np.random.default_rng(1))
    assert compared == min(6, len(table.space))


@pytest.mark.parametrize("instance", thinned(WITH_STATES), ids=named)
def test_cost_to_go_equals_scipys_dijkstra(instance: Instance) -> None:
    table = table_of(instance)
    space = table.space
    # A state can have two actions to the same target; scipy would add their costs up.
    order = np.lexsort((space.costs, space.transitions.targets, space.sources))
    pair = np.stack([space.sources, space.transitions.targets])[:, order]
    keep = np.concatenate([[True], (np.diff(pair) != 0).any(axis=0)])
    shape = (len(space), len(space))
    graph = csr_array((space.costs[order][keep].astype(float), (pair[1][keep], pair[0][keep])), shape=shape)
    expected = dijkstra(graph, indices=np.flatnonzero(space.goal), min_only=True)
    np.testing.assert_array_equal(table.h, table.task.in_unit(expected))


@pytest.mark.parametrize("instance", thinned(WITH_STATES), ids=named)
def test_plan_read_off_the_table_reaches_the_goal_at_its_cost(instance: Instance) -> None:
    table = table_of(instance)
    finite = np.flatnonzero(~table.dead_end)
    for state in np.random.default_rng(2).choice(finite, min(6, len(finite)), replace=False):
        plan, values = table.optimal_plan(int(state)), table.values([state])[0].tolist()
        assert plan is not None
        assert table.task.in_unit(plan_cost(table.task, plan, state=values)) == table[int(state)]
        assert table.space.goal[table.space.follow(plan, int(state))]


def test_a_plan_has_the_fewest_actions_of_the_cheapest() -> None:
    """Loading and unloading are free: shortest paths by (cost, number of actions), with scipy."""
    table = table_of(Instance(DOMAINS / "delivery" / "three-parcels.pddl", DOMAINS / "delivery" / "domain.pddl"))
    space = table.space
    weights = 1000.0 * space.costs + 1
    graph = csr_array((weights, (space.transitions.targets, space.sources)), shape=(len(space), len(space)))
    both = dijkstra(graph, indices=np.flatnonzero(space.goal), min_only=True)
    for state in range(0, len(space), 37):
        plan = table.optimal_plan(state)
        assert plan is not None
        assert 1000 * table[state] + len(plan) == both[state]


def test_shipped_instances_are_what_their_readme_says(tiny: Table, fixed: Table, sealed: Table) -> None:
    paper = kit("paper")
    assert (len(paper.space), paper[paper.initial]) == (
        836,
        10,
    )  # 4 platform states, sum_k C(4,k)^2 k! = 209 arrangements
    assert (len(fixed.space), fixed[fixed.initial]) == (4 * 2**5, 10)
    assert (len(tiny.space), tiny[tiny.initial]) == (3 * 7, 6)
    assert paper.dead_end.sum() == tiny.dead_end.sum() == fixed.dead_end.sum() == 0
    # Items in slot-1 and slot-2 cannot be removed. A state is alive if slot-1 is free or right (and likewise slot-2).
    # With both free, hammer and pliers can be elsewhere; each right one leaves one fewer item and slot to permute.
    two_open = sum(arrangements(4 - right, 2) for right in (0,))
    one_open = 2 * arrangements(3, 2)
    none_open = arrangements(2, 2)
    assert (~sealed.dead_end).sum() == 4 * (two_open + one_open + none_open)


def arrangements(items: int, slots: int) -> int:
    """Ways to put some of the items into some of the slots."""
    from math import comb, factorial

    return sum(comb(items, k) * comb(slots, k) * factorial(k) for k in range(min(items, slots) + 1))


def test_transitions_equal_unified_plannings(tiny: Table) -> None:
    """Walk the whole space of the tiny instance with unified-planning's simulator."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from unified_planning.engines.sequential_simulator import UPSequentialSimulator

        problem = understood(tiny.space.task.instance)
        simulator = UPSequentialSimulator(problem)
        start = simulator.get_initial_state()
        space = tiny.space
        where = {tiny.initial: start}
        stack = [tiny.initial]
        while stack:
            state = stack.pop()
            theirs = {}
            for action, parameters in simulator.get_applicable_actions(where[state]):
                name = f"({' '.join([action.name, *map(str, parameters)])})"
                theirs[name] = simulator.apply(where[state], action, parameters)
            ours = space.options(state)
            assert sorted(ours) == sorted(theirs)
            assert bool(space.goal[state]) == bool(simulator.is_goal(where[state]))
            for name, target in ours.items():
                if target not in where:
                    where[target] = theirs[name]
                    stack.append(target)
    assert len(where) == len(space)


def test_follow_refuses_an_inapplicable_action(tiny: Table) -> None:
    with pytest.raises(
        ValueError, match=r"step 1: \(fetch box-b\) is not applicable; applicable are .*\(return box-a\)"
    ):
        tiny.space.follow(["(fetch box-a)", "(fetch box-b)"])
    with pytest.raises(ValueError, match=r"step 0: fetsh box-a is not applicable; applicable are \(fetch box-a\)"):
        tiny.space.follow(["fetsh box-a"])


def test_follow_takes_actions_in_any_notation(tiny: Table) -> None:
    there = tiny.space.follow(["(fetch box-a)", "(place hammer slot-1 box-a)"])
    assert tiny.space.follow(["fetch box-a", "Place(hammer, slot-1, box-a)"]) == there


def test_a_limit_may_be_longer_than_the_system_can_wait() -> None:
    """Calls that wait count milliseconds in 32 bits, which is 25 days."""
    assert astar(load(KITTING / "tiny.pddl", limits=Limits(seconds=1e9)), limits=Limits(seconds=1e9))[0] == 6


LAMPS = """
(define (domain lamps)
  (:requirements :adl :action-costs)
  (:types lamp)
  (:predicates (on ?l - lamp) (next ?l ?m - lamp) (broken))
  (:functions (total-cost) - number)
  (:action press :parameters (?l - lamp) :precondition (not (broken))
    :effect (and (when (on ?l) (not (on ?l))) (when (not (on ?l)) (on ?l))
                 (forall (?m - lamp) (when (next ?l ?m) (on ?m))) (increase (total-cost) 3)))
  (:action look :parameters (?l - lamp)
    :precondition (or (on ?l) (exists (?m - lamp) (and (next ?l ?m) (on ?m))))
    :effect (and (not (on ?l)) (increase (total-cost) 0)))
  (:action drop :parameters () :precondition (forall (?l - lamp) (on ?l))
    :effect (and (broken) (increase (total-cost) 1))))
"""
LAMPS_PROBLEM = """
(define (problem p) (:domain lamps)
  (:objects a b c d - lamp)
  (:init (next a b) (next b c) (next c d) (on b) (= (total-cost) 0))
  (:goal (and (on a) (not (on b)) (not (on c)) (on d)))
  (:metric minimize (total-cost)))
"""


def test_conditional_effects_quantifiers_disjunctions_axioms_and_zero_costs(tmp_path: Path) -> None:
    task = load(write_instance(tmp_path, LAMPS, LAMPS_PROBLEM))
    assert any(effect.conditions for operator in task.operators for effect in operator.effects)
    assert 0 in task.costs
    table = sweep(task)
    assert table.dead_end.any()
    assert verify(table, 1000, np.random.default_rng(0)) == len(table.space)
    for state in np.flatnonzero(~table.dead_end):
        plan = table.optimal_plan(int(state))
        assert plan is not None
        assert plan_cost(task, plan) == table[int(state)]


def test_an_empty_goal_and_a_goal_that_holds(tmp_path: Path) -> None:
    domain, problem = (KITTING / "domain.pddl").read_text(), (KITTING / "tiny.pddl").read_text()
    start = problem[: problem.index("(:goal")]
    for goal in ("(and)", "(platform-free)"):
        table = sweep(load(write_instance(tmp_path, domain, f"{start}(:goal {goal}))")))
        assert len(table.space) == 21
        assert table[table.initial] == 0
        assert verify(table, 30, np.random.default_rng(0)) == 21


def test_where_neither_way_is_done_both_reasons_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def slow(*_: object, **__: object) -> None:
        raise LimitError("Fast Downward ran out of time (1 s)")

    monkeypatch.setattr("planner.costtogo.astar.astar", slow)
    record = solve_instance(instance(KITTING / "tiny.pddl"), SolveOptions(max_states=5))
    assert record["status"] == "limit"
    assert record["error"]["message"] == "Fast Downward ran out of time (1 s); not swept: more than 5 states"


def test_where_a_sweep_takes_too_long_there_is_time_left_for_the_initial_state() -> None:
    options = SolveOptions(time_limit=600, sweep_share=1e-9)  # the time is over before the sweep begins
    record = solve_instance(instance(KITTING / "tiny.pddl"), options)
    assert (record["status"], record["method"], record["cost"]) == ("solved", "on-demand", 6)
    assert record["note"].startswith("solved on demand: out of time")


def test_who_solves_an_instance_can_use_its_table() -> None:
    tables: list[Table] = []
    record = solve_instance(instance(KITTING / "tiny.pddl"), SolveOptions(verify=0), use=tables.append)
    assert [len(table) for table in tables] == [record["states"]]
    assert (record["verified"], record["consistent"], record["cost"]) == (1, 0, 6)
