"""A task is defined by its fields: its SAS text is generated from them, and parsed back to the same task."""

from __future__ import annotations

import random
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import KITTING, SMALL, named, solvable, thinned
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_sweep import COMPILED, UNLISTED, SweepOptions, counter, random_task

from assist.people.action_names import Matcher
from planner import Effect, Instance, OnDemand, Operator, Task, astar, load, sweep
from planner.costtogo.astar import ADMISSIBLE
from planner.costtogo.number_values import grounded
from planner.grounding import fast_downward
from planner.grounding.translation import from_sas
from planner.pddl.reader import read


def plain(task: Task) -> Task:
    """The same task with its goal and the conditions of its operators in order."""
    ordered = [replace(one, preconditions=tuple(sorted(one.preconditions))) for one in task.operators]
    return replace(task, operators=tuple(ordered), goal=tuple(sorted(task.goal)), note=None)


def check(task: Task) -> float:
    """Compare Fast Downward's answer with that of the sweep."""
    table = sweep(task)
    cost, _ = astar(task)
    assert cost == table[table.initial]
    assert OnDemand(task).lookup([0])[0] == cost
    return cost


@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.integers(0, 2**32), st.booleans(), st.sampled_from([range(1, 2), range(3), range(0, 30, 3)]))
def test_what_is_written_is_read_back(seed: int, axioms: bool, costs: range) -> None:
    task = random_task(random.Random(seed), axioms=axioms, costs=costs)
    used = sorted({operator.action for operator in task.operators})  # the text has no actions without operators
    place = {action: number for number, action in enumerate(used)}
    groups = [g for g in task.mutexes if sum(task.initial[v] == value for v, value in g) <= 1]
    task = replace(
        task,
        actions=tuple(task.actions[action] for action in used),
        costs=tuple(task.costs[action] for action in used),
        operators=tuple(replace(operator, action=place[operator.action]) for operator in task.operators),
        mutexes=tuple(groups),
    )
    assert plain(from_sas(task.sas, task.instance)) == plain(task)
    assert from_sas(task.sas, task.instance).sas == task.sas


@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.integers(0, 2**32), st.booleans())
def test_fast_downward_accepts_what_is_written(seed: int, axioms: bool) -> None:
    task = random_task(random.Random(seed), axioms=axioms, costs=range(3))
    check(replace(task, mutexes=()))


@pytest.mark.parametrize("instance", thinned(solvable(SMALL), 3), ids=named)
def test_shipped_tasks_are_written_as_the_translator_writes_them(instance: Instance) -> None:
    text = fast_downward.translate(grounded(read(instance))[0].reading)
    task = from_sas(text, instance)
    if set(task.costs) == {1}:  # a metric under which all actions cost 1 is none
        text = text.replace("begin_metric\n1\n", "begin_metric\n0\n")
    assert task.sas == text
    assert from_sas(task.sas, instance) == task


def test_what_is_replaced_is_replaced_for_everybody() -> None:
    task = load(KITTING / "paper-fixed.pddl")
    table = sweep(task)
    assert check(task) == 10
    state = int(np.flatnonzero(table.h == 4)[0])
    values = tuple(table.values([state])[0].tolist())
    assert check(replace(task, goal=tuple(enumerate(task.initial)))) == 0
    assert check(replace(task, initial=values)) == 4
    assert check(replace(task, costs=tuple(6 for _ in task.costs))) == 60
    assert check(replace(task, operators=task.operators[1:])) >= 10
    free = replace(task, costs=tuple(int(not name.startswith("(fetch")) for name in task.actions))
    assert 0 < check(free) < 10
    assert check(replace(task, goal=(*task.goal[:-1], (task.goal[-1][0], 1 - task.goal[-1][1])))) != 10


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"costs": (-1, 1)}, "costs (-1, 1): expected whole numbers of 0 or more"),
        ({"costs": (0.5, 1)}, "costs (0.5, 1): expected whole numbers of 0 or more"),
        ({"costs": (1,)}, "1 costs; expected one for each of the 2 actions"),
        ({"initial": (0,)}, "an initial state of 1 values; expected 2"),
        ({"initial": (0, 2)}, "initial state: value 2 of variable 1; expected 0 to 1"),
        ({"initial": (-1, 0)}, "initial state: value -1 of variable 0; expected 0 to 1"),
        ({"goal": ((0, 2),)}, "goal: value 2 of variable 0; expected 0 to 1"),
        ({"goal": ((9, 0),)}, "goal: variable 9; expected 0 to 1"),
    ],
)
def test_what_no_task_has_is_refused(changed: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        replace(counter(2), **changed)


def test_a_group_that_the_initial_state_breaks_says_nothing() -> None:
    """Both facts hold in the initial state, so searches must not take them for mutually exclusive."""
    task = replace(counter(2), mutexes=(((0, 1), (1, 1)),))
    assert "begin_mutex_group" in task.sas
    assert "begin_mutex_group" not in replace(task, initial=(1, 1)).sas
    assert check(replace(task, initial=(1, 1))) == 0


@pytest.mark.parametrize("changed", [0, 1])
def test_conditions_that_contradict_each_other(changed: int) -> None:
    task = counter(2)
    never = Operator(0, ((0, 0), (0, 1)), (Effect((), changed, 1),))
    task = replace(task, operators=(never, *task.operators[1:]))
    assert check(task) == float("inf")
    assert set(from_sas(task.sas, task.instance).operators[0].preconditions) == set(never.preconditions)


def test_goals_that_fast_downward_does_not_read() -> None:
    assert check(replace(counter(2), goal=())) == 0
    assert astar(replace(counter(2), goal=()))[1] == []
    assert check(replace(counter(2), goal=((0, 1), (0, 1)))) == 1
    for facts in [((0, 1), (0, 0)), ((0, 0), (0, 1))]:
        never = replace(counter(2), goal=facts)
        assert check(never) == float("inf")
        for options in (None, COMPILED, UNLISTED, SweepOptions(0, small_bitmap=0)):
            table = sweep(never, options=options)
            assert not table.is_goal(np.arange(len(table))).any()
            assert table.dead_end.all()
        assert not OnDemand(never).is_goal([0]).any()


@pytest.mark.parametrize("search", ADMISSIBLE)
def test_the_order_of_a_goal_does_not_matter(search: str) -> None:
    switches = tuple(Operator(v, (), (Effect((), v, 1),)) for v in range(2))
    both = replace(counter(2), operators=switches, goal=((1, 1), (0, 1)))
    assert astar(both, search=search)[0] == 2


def test_costs_are_divided_by_what_divides_all() -> None:
    task = replace(counter(2), costs=(6, 9))
    assert task.reduced.costs == (2, 3)
    assert task.reduced.reduced is task.reduced
    assert check(task) == 21
    assert replace(task, costs=(0, 0)).reduced.costs == (0, 0)


@pytest.mark.parametrize("effect", ["(and)", "(increase (total-cost) 5)", "(when (on) (increase (unread) 1))"])
def test_an_action_without_an_effect_on_states_is_left_out_and_named(tmp_path: Path, effect: str) -> None:
    (tmp_path / "domain.pddl").write_text(
        "(define (domain d) (:predicates (on) (seen)) (:functions (total-cost) (unread)) (:action press :parameters () "
        ":effect (on)) (:action look :parameters () :effect (when (on) (seen))) "
        f"(:action idle :parameters () :effect {effect}))"
    )
    problem = tmp_path / "p.pddl"
    problem.write_text(
        "(define (problem p) (:domain d) (:init (= (unread) 0)) (:goal (on)) (:metric minimize (total-cost)))"
    )
    task = load(problem)
    assert task.actions == ("(look)", "(press)")
    assert str(task.note).endswith("actions without an effect on states are left out: idle")
    refused = Matcher(task.actions).unknown(("idle",))
    assert str(refused).endswith("; actions that can never be done, or never change anything, are left out")
