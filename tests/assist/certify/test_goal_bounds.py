"""Bounds on all policies for people whose goals are unknown, compared with exact values and with certain goals."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT, invoke, thinned
from crosscheck import EASY
from graphs import graph_task

from assist.certify import TeamBound, upper_bound
from assist.certify.relaxed_value import relaxed_value
from assist.people import Goals, HumanModel, Population, outcome
from assist.person import AssistPOMDP, Behaviour, OfRobots, Setting, Solution, SolverOptions, evaluate, qmdp, solve
from assist.person.each_goal import given_goals
from assist.team import Pool, simulate
from planner import sweep_goals

KITS = ROOT / "docs" / "examples" / "kits"
PEOPLE = Population(beta=(0.2, 1.4), theta=(0.3, 0.8))
RING = [(a, b, 1) for a, b in pairwise([*range(5), 0])] + [(b, a, 1) for a, b in pairwise([*range(5), 0])]


@cache
def ring(shares: tuple[float, ...] = (0.5, 0.3, 0.2), start: int = 0) -> Goals:
    """Five places in a circle, of which people want to reach one; a step may serve two of the goals."""
    task = graph_task(RING, goal=2, start=start)
    tables = sweep_goals([replace(task, goal=((0, node),)) for node in (2, 3, 1)])
    names = [f"place-{node}" for node in (2, 3, 1)]
    return Goals(dict(zip(names, tables, strict=True)), dict(zip(names, shares, strict=True)))


def exact(pomdp: AssistPOMDP, steps: int) -> tuple[float, float]:
    """Bounds on the optimal value: all histories of `steps` steps, then the best or no help without a hidden part."""
    choices, betas = pomdp.model.choices, len(pomdp.grid.beta)
    reached = choices.goals.goal
    least, most = evaluate(pomdp, np.zeros(len(choices), dtype=np.int64)), qmdp(pomdp).value_mdp

    def going_on(x: int, weight: np.ndarray) -> np.ndarray:
        """The weight of those who have not reached their goal: who has is seen to stop."""
        return np.where(reached[:, x].repeat(betas)[:, None], 0.0, weight)

    def value(x: int, weight: np.ndarray, left: int) -> np.ndarray:
        weight = going_on(x, weight)
        if (mass := weight.sum()) == 0:
            return np.zeros(2)
        if left == 0:
            return np.array([(one[x] * weight).sum() for one in (least, most)])
        found = []
        at = np.array([x])
        for action in range(pomdp.robot_actions[x]):
            total = np.full(2, -pomdp.robot_costs[x, action] * mass)
            for slot in np.flatnonzero(choices.applicable[x]):
                with_robot = at, np.array([action]), np.array([slot])
                chance = float((weight * pomdp.likelihood(*with_robot)[0]).sum())
                if chance > 0:
                    after = pomdp.update(weight[None] / mass, *with_robot)[0] * chance
                    then = value(int(choices.targets[x, slot]), after, left - 1)
                    total += pomdp.gamma * then - choices.costs[x, slot] * chance
            found.append(total)
        return np.max(found, axis=0)

    low, high = value(choices.initial, pomdp.prior, steps)
    return float(low), float(high)


@pytest.mark.parametrize("suggestions", ["optimal", "all"])
def test_the_bound_of_one_person_is_the_mean_value_with_known_goals(suggestions: Any) -> None:
    """It is above the value with unknown goals, from an enumeration of histories: the goal is worth knowing here."""
    people, goals = Population(beta=(0.1, 0.5), theta=(0.8, 0.95)), ring((0.45, 0.45, 0.1))
    options: dict[str, Any] = {"gamma": 0.5, "suggestions": suggestions}
    setting = Setting(**options, c_suggest=0.01, eta=0.1, c_move=0.0, knowledge="exact", lapse=0.01)
    found = upper_bound(Pool.sample(goals, 1, seed=1, setting=setting, population=people), gap=1e-3, jobs=1)
    model = HumanModel.exact(goals.choices(), eta=0.1, lapse=0.01)
    problem = AssistPOMDP.of(model, population=people, robot=OfRobots(c_suggest=0.01), **options)
    low, high = exact(problem, 3)
    assert high - low < 0.01
    known = np.array([share * np.array(exact(one, 3)) for share, one in given_goals(problem)]).sum(axis=0)
    assert known[0] <= found.upper + 1e-9
    assert found.upper - found.slack <= known[1] + 1e-9
    assert found.upper - found.slack > high


def bound_of(goals: Any, **more: Any) -> TeamBound:
    setting = Setting(gamma=0.9, c_suggest=0.05, suggestions="all", c_move=0.1, **more)
    pool = Pool.sample(goals, 3, seed=2, setting=setting, population=PEOPLE)
    return upper_bound(pool, window=6, gap=0.02, jobs=1, options=EASY)


@cache
def bound_without_certainty(travel_time: float = 0.0) -> TeamBound:
    return bound_of(ring(), knowledge="exact", travel_time=travel_time)


def test_with_certainty_the_bound_is_that_of_people_with_that_goal() -> None:
    goals = ring()
    certain, known = (bound_of(one, knowledge="exact") for one in (ring((0.0, 1.0, 0.0)), goals.tables["place-3"]))
    assert certain.price == pytest.approx(known.price)
    assert certain.upper == pytest.approx(known.upper, rel=1e-9)


@pytest.mark.parametrize("travel_time", thinned([0.0, 1.0]))
def test_policies_are_compared_with_the_bound(travel_time: float) -> None:
    found = bound_without_certainty(travel_time)
    assert len(found.price)
    for name in ("none", "attention", "priority"):
        certificate = found.certify(name, episodes=200)
        assert certificate.value - 4 * certificate.value_stderr <= certificate.upper
    mean, error = relaxed_value(found, episodes=200)
    assert mean - 4 * error <= found.upper
    run = simulate(found.pool, found.policy(), humans=list(found.team), episodes=300, seed=1, world="model")
    mean, error = run.discounted_return.mean(), run.discounted_return.std() / 300**0.5
    assert mean - 4 * error <= found.upper


def test_a_bound_is_the_same_for_robots_that_may_ask() -> None:
    """It is that of robots that know the goals, to whom an answer tells nothing."""
    asks = bound_of(ring(), knowledge="exact", c_ask=0.05, ask_error=0.1)
    assert len(asks.price)
    assert asks.upper == bound_without_certainty().upper
    certificate = asks.certify("attention", episodes=200)
    assert certificate.value - 4 * certificate.value_stderr <= asks.upper


def test_the_command() -> None:
    given = ["bound", KITS / "travel.pddl", "--goals", KITS, "--humans", "1", "--policy", "none"]
    more = ["--value-episodes", "50", "--gap", ".5", "--set", "goal_prior=travel=.5,mend=.5,mount=0"]
    result = invoke(*given, *more, "--set", "gamma=0.7", "--json")
    assert result.exit_code == 0
    assert re.fullmatch(r"a first answer, [^\n]+: gap at most \d+\.\d\d %; a tighter bound follows\n", result.stderr)
    found = json.loads(result.stdout)
    assert found["goals"] == {"travel": 0.5, "mend": 0.5, "mount": 0}
    assert found["value"] - 4 * found["value_stderr"] <= found["upper"]
    result = invoke(*given, "--samples", "30")
    assert (result.exit_code, "--samples with --goals: expected people whose goal is known" in result.stderr) == (
        2,
        True,
    )


def problem(goals: Goals, **more: Any) -> AssistPOMDP:
    model, people = (
        HumanModel.exact(goals.choices(), eta=0.1, lapse=0.01),
        Population(beta=(0.1, 0.5), theta=(0.8, 0.95)),
    )
    return AssistPOMDP.of(model, population=people, gamma=0.5, robot=OfRobots(c_suggest=0.01), **more)


def solved(**more: Any) -> Solution:
    return solve(problem(ring((0.45, 0.45, 0.1)), **more), gap=1e-5)


@pytest.mark.parametrize(
    "more", [{"suggestions": "all"}, {"behaviour": Behaviour(trust=outcome())}], ids=["all", "rule"]
)
def test_the_solver_encloses_the_value_with_unknown_goals(more: dict[str, Any]) -> None:
    """Compared with an enumeration of histories; the value with known goals is out of reach here."""
    found = solved(**more)
    low, high = exact(found.pomdp, 4)
    assert found.stopped == "gap"
    assert found.lower <= high
    assert found.upper >= low
    assert found.upper < found.value_qmdp - 0.05
    assert found.lower > max(found.value_never, found.value_always)


@pytest.mark.parametrize("order", [(1, 6), (6, 1)])
def test_the_solver_goes_on_where_a_goal_is_reached_that_may_be_another_persons(order: tuple[int, int]) -> None:
    """Trials do not end in a state that is the goal of some people only, whichever goal comes first."""
    roads = [(a, a + 1, 1) for a in range(6)] + [(a + 1, a, 1) for a in range(6)]
    tables = sweep_goals([replace(graph_task(roads, goal=6, start=0), goal=((0, node),)) for node in order])
    goals = Goals(
        {f"place-{node}": table for node, table in zip(order, tables, strict=True)},
        {f"place-{node}": 0.2 if node == 1 else 0.8 for node in order},
    )
    pomdp = AssistPOMDP.of(
        HumanModel.exact(goals.choices(), lapse=0.01), population=PEOPLE, gamma=0.9, robot=OfRobots(c_suggest=0.3)
    )
    solution = solve(pomdp, gap=1e-3)
    assert solution.gap <= 1e-3
    assert solution.lower <= -4.9258
    assert solution.upper >= -4.9297


def test_bounds_at_further_beliefs_count_people_who_have_not_finished() -> None:
    """In a state that is the goal of some people, the bound that is stored is that of the others."""
    pomdp, plain = problem(ring((0.45, 0.45, 0.1))), solved()
    states = np.flatnonzero(~pomdp.final[0])
    beliefs = np.repeat(pomdp.prior[None], len(states), axis=0)
    solution = solve(pomdp, gap=1e-5, options=SolverOptions(further_beliefs=(states, beliefs)))
    assert solution.lower <= solution.upper
    assert solution.lower <= plain.upper + 1e-9
    assert solution.upper >= plain.lower - 1e-9
    assert (solution.value(states, beliefs) <= solution.upper_bound(states, beliefs) + 1e-9).all()


def test_with_certainty_the_solution_is_that_of_the_goal() -> None:
    goals = ring((0.0, 1.0, 0.0))
    ((_, known),) = given_goals(problem(goals))
    known, unknown = (solve(one, gap=1e-6) for one in (known, problem(goals)))
    assert unknown.lower == pytest.approx(known.lower, rel=3e-6)
    assert unknown.upper == pytest.approx(known.upper, rel=3e-6)


def test_the_policy_reaches_its_lower_bound_and_is_saved(tmp_path: Path) -> None:
    setting = Setting(gamma=0.8, c_suggest=0.05, c_move=0.0, knowledge="exact", lapse=0.01)
    people = Population(beta=(0.1, 0.5), theta=(0.8, 0.95))
    pool = Pool.sample(ring((0.45, 0.45, 0.1)), 1, seed=1, setting=setting, population=people, solver=solve)
    found = pool.policies[0].prepare()
    assert isinstance(found, Solution)
    run = simulate(pool, "attention", humans=1, episodes=4000, seed=3, world="model")
    mean, error = run.discounted_return.mean(), run.discounted_return.std() / 4000**0.5
    assert found.lower - 4 * error <= mean <= found.upper + 4 * error
    found.save(tmp_path / "policy.npz")
    again, x = Solution.load(tmp_path / "policy.npz"), np.array([0])
    assert again.pomdp.hidden.goals == {"place-2": 0.45, "place-3": 0.45, "place-1": 0.1}
    belief = found.pomdp.prior[None]
    assert (again.q_values(x, belief) == found.q_values(x, belief)).all()


def test_the_command_for_one_person(tmp_path: Path) -> None:
    given = ["policy", KITS / "travel.pddl", "--goals", KITS]
    prior = ["--set", "goal_prior=travel=.5,mend=.5,mount=0"]
    file = tmp_path / "policy.npz"
    result = invoke(*given, *prior, "--gap", "1", "--set", "gamma=0.7", "--json", "--out", file)
    assert (result.exit_code, result.stderr) == (0, "")
    found = json.loads(result.stdout)
    assert found["goals"] == {"travel": 0.5, "mend": 0.5, "mount": 0}
    assert (found["states"], found["hidden"]) == (836, 180)
    assert found["lower"] <= found["upper"] <= found["value_qmdp"] + 1e-6
    assert Solution.load(file).lower == found["lower"]
    some = invoke(*given, "--set", "region_states=20", "--set", "sigma=1", "--set", "gamma=0.7", "--gap", "1", "--json")
    assert some.exit_code == 0, some.stderr
    assert json.loads(some.stdout)["frontier"] > 0
    result = invoke(*given, "--set", "execute=true")
    assert result.exit_code == 2
    assert "execute: expected people whose goal is known, and there are 3 goals" in result.stderr
