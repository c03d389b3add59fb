"""Tasks built in Python with unified-planning: the same answers as from files, with the problem's own names."""

from __future__ import annotations

import itertools
import warnings

import pytest
from conftest import KITTING, understood

from planner import Instance, PDDLError, astar, load, sweep

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    from unified_planning.model import Fluent, InstantaneousAction, Problem
    from unified_planning.model.metrics import MinimizeActionCosts
    from unified_planning.shortcuts import BoolType, Int, UserType


def tour() -> Problem:
    place, robot = UserType("Place"), UserType("Robot")
    at, road = Fluent("At", BoolType(), r=robot, p=place), Fluent("road", BoolType(), a=place, b=place)
    drive = InstantaneousAction("Drive.To", r=robot, a=place, b=place)
    drive.add_precondition(at(drive.r, drive.a))
    drive.add_precondition(road(drive.a, drive.b))
    drive.add_effect(at(drive.r, drive.a), False)
    drive.add_effect(at(drive.r, drive.b), True)
    problem = Problem("Tour")
    problem.add_fluent(at, default_initial_value=False)
    problem.add_fluent(road, default_initial_value=False)
    problem.add_action(drive)
    places = [problem.add_object(f"P{i}", place) for i in range(4)]
    r2 = problem.add_object("R2 D2", robot)
    for a, b in itertools.pairwise(places):
        problem.set_initial_value(road(a, b), True)
    problem.set_initial_value(at(r2, places[0]), True)
    problem.add_goal(at(r2, places[3]))
    problem.add_quality_metric(MinimizeActionCosts({drive: Int(3)}))
    return problem


def test_names_are_the_problems_own() -> None:
    task = load(tour())
    plan = [f"(Drive.To r2_d2 P{i} P{i + 1})" for i in range(3)]  # a name with a space stays as PDDL writes it
    assert task.name == "Tour"
    assert list(task.actions) == plan
    assert task.facts(task.initial) == ["At(r2_d2, P0)"]
    assert astar(task) == (9, plan)
    assert sweep(task).optimal_plan() == plan


def test_a_problem_and_its_files_are_the_same_task() -> None:
    instance = Instance(KITTING / "costs" / "ways.pddl", KITTING / "costs" / "domain.pddl")
    files, built = sweep(load(instance)), sweep(load(understood(instance)))
    assert built.task.actions == files.task.actions
    assert built[built.initial] == files[files.initial]
    assert sorted(built.distance) == sorted(files.distance)


def test_what_is_not_supported_is_refused_in_one_line() -> None:
    problem = tour()
    problem.add_fluent(Fluent("home", problem.user_type("Place")), default_initial_value=problem.object("P0"))
    with pytest.raises(PDDLError, match=r"^Tour: object fluents: not supported$"):
        load(problem)
