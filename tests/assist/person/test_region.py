"""Truncated tasks: bounds proven on a part hold for the whole."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from conftest import KITTING, costly, graph_task, invoke, table_of, thinned
from hypothesis import given
from hypothesis import strategies as st
from test_unknown_goals import three_goals
from test_wide import HABITS, task_of

from assist.people import Choices, Goals, Human, HumanModel, Misconception, Population, Reliability
from assist.person import AssistPOMDP, Assumptions, OfRobots, PersonProblem, Setting, Solution, TruncatedTask, solve
from assist.person import truncated_task as region
from assist.person.closed_problem import closed_problem
from assist.person.each_goal import given_goals
from assist.person.likely_states import perceived_of_states
from assist.person.mdp_values import evaluate
from assist.person.pomdp import Behaviour
from assist.person.qmdp import qmdp
from planner import InputFileError, Instance, OnDemand, Table, sweep

SETTING = {"gamma": 0.97, "robot": OfRobots(c_suggest=0.3)}
INSTANCES = {name: Instance(KITTING / f"{name}.pddl", KITTING / "domain.pddl") for name in ("paper-fixed", "sealed")}
WAYS = Instance(KITTING / "costs" / "ways.pddl", KITTING / "costs" / "domain.pddl")


def whole(table: Table) -> AssistPOMDP:
    return AssistPOMDP.of(HumanModel.exact(Choices.of(table)), **SETTING)  # type: ignore[arg-type]


@pytest.mark.parametrize("several", [False, True])
def test_a_part_has_the_choices_of_the_task(several: bool) -> None:
    task = three_goals("sealed") if several else table_of(INSTANCES["paper-fixed"])
    full = task.choices() if isinstance(task, Goals) else Choices.of(task)
    part = TruncatedTask.of(task, states=30)
    ours, rows = part.choices, part.states
    inside = np.setdiff1d(np.arange(len(ours)), part.frontier)
    assert several or len(inside) == 30 + ours.goal[inside].sum()
    for x in inside[ours.applicable[inside].any(axis=1)]:
        theirs, count = int(rows[x]), ours.applicable[x].sum()
        assert full.applicable[theirs].sum() == count
        assert sorted(rows[ours.targets[x, :count]]) == sorted(full.targets[theirs, :count])
        for own, whole in zip(ours.of_each_goal, full.of_each_goal, strict=True):
            assert set(own.actions[x][own.optimal[x]]) == set(whole.actions[theirs][whole.optimal[theirs]])
    assert not ours.applicable[part.frontier].any()
    np.testing.assert_array_equal(ours.goals.h, full.goals.h[:, rows])
    np.testing.assert_array_equal(ours.goals.goal, full.goals.goal[:, rows])
    np.testing.assert_array_equal(part.local(rows), np.arange(len(rows)))
    outside = np.setdiff1d(np.arange(len(full)), rows)
    assert (part.local(outside) == -1).all()
    assert part.local(np.array([len(full), rows[0]])).tolist() == [-1, 0]  # a number beyond all of them


def test_each_goals_problem_is_that_of_people_with_that_goal() -> None:
    goals = three_goals("tiny")
    more: dict[str, Any] = {"suggestions": "all", "robot": OfRobots(c_suggest=0.2)}
    every = given_goals(AssistPOMDP.of(HumanModel.exact(goals.choices()), **more))
    assert [share for share, _ in every] == list(goals.prior.values())
    for (_, problem), table in zip(every, goals.tables.values(), strict=True):
        alone = AssistPOMDP.of(HumanModel.exact(Choices.of(table)), **more)
        np.testing.assert_allclose(problem.prior, alone.prior, rtol=1e-12)
        np.testing.assert_allclose(qmdp(problem).value_mdp, qmdp(alone).value_mdp, atol=1e-5)


def test_a_truncated_task_of_all_goals_has_bounds_for_each() -> None:
    """Compared with the values on the whole task: of a robot that is told the goal, and of one that does nothing."""
    goals = three_goals("sealed")
    problem = AssistPOMDP.of(HumanModel.exact(goals.choices()), **SETTING)  # type: ignore[arg-type]
    best, never = qmdp(problem).value_mdp, evaluate(problem, np.zeros(len(problem.ends), dtype=np.int64))
    for states in (4, 60):
        part = TruncatedTask.of(goals, states=states)
        frontier = closed_problem(part, Assumptions(**SETTING)).frontier  # type: ignore[arg-type]
        assert frontier.floor is not None
        leaves = part.states[part.frontier]
        assert len(frontier.states) == len(leaves) > 0
        assert (best[leaves] <= frontier.upper + 1e-9).all()
        assert (never[leaves] >= frontier.lower - 1e-8).all()  # `evaluate` is lowered by its rounding errors
        assert (frontier.lower > frontier.floor).any()


def test_a_truncated_task_holds_the_likeliest_states_of_all_goals() -> None:
    """With the whole prior on one goal it is that goal's, and misconceptions are the same for every goal."""
    goals = three_goals("sealed")
    for number, (name, table) in enumerate(goals.tables.items()):
        certain = Goals(goals.tables, {other: float(other == name) for other in goals.tables})
        own, joint = (TruncatedTask.of(task, states=20) for task in (table, certain))
        expanded = [np.delete(part.states, part.frontier) for part in (own, joint)]
        assert set(expanded[0][table.h[expanded[0]] > 0]) <= set(expanded[1])
        human = Human(1.0, 0.5, 1.0, Misconception(1.0, 5))
        one = TruncatedTask.of(table, states=20, among=goals)
        assert one.choices.offered is not None
        assert (one.choices.offered >= one.choices.optimal)[~one.choices.goal].all()
        perceived = human.expects(joint.choices.of_goal(number))
        place = joint.local(one.states)
        np.testing.assert_array_equal(perceived[place[place >= 0]], human.expects(one.choices)[place >= 0])


INTERVALS: dict[str, tuple[Any, dict[str, Any], dict[str, Any]]] = {
    "robots that execute": ("tiny", {"gamma": 0.9, "c_suggest": 0.3, "execute": True, "c_execute": 0.4}, {}),
    "dead ends": ("sealed", {"gamma": 0.9, "c_suggest": 0.3, "execute": True, "c_execute": 0.4}, {}),
    "a known misconception": (
        "tiny", {"gamma": 0.9, "c_suggest": 0.1}, {"misconception": Misconception.drawn(0.7, np.random.default_rng(3))}
    ),
    "terms": ("tiny", {"gamma": 0.95, "c_suggest": 0.1}, {"population": HABITS}),
    "goals": ("goals of tiny", {"gamma": 0.9, "c_suggest": 0.05}, {}),
}  # fmt: skip


@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=[pytest.mark.slow] * (one == "dead ends")) for one in INTERVALS]
)
def test_the_interval_of_a_part_overlaps_that_of_the_whole_which_it_becomes(name: str) -> None:
    task, setting, options = INTERVALS[name]
    known, gap, several = task_of(task), 1e-2 if name == "goals" else 1e-3, name == "goals"
    options = {"setting": Setting(**setting), **options}
    asked = known if several else OnDemand(known.task, jobs=1)
    exact = solve(PersonProblem.of(known, **options).pomdp, gap=gap, time_limit=20)
    for part, states in ((known, 3), (asked, 12), (asked, 10_000)):
        problem = PersonProblem.of(part, states=states, **options)
        found = solve(problem.pomdp, gap=gap, time_limit=10)
        assert found.lower <= exact.upper
        assert exact.lower <= found.upper
        assert found.value_never <= exact.upper
        frontier = problem.pomdp.frontier
        if setting.get("execute") and frontier is not None and len(frontier.states):
            inside = problem.states >= 0
            assert (problem.pomdp.afterstate[inside] >= inside.sum()).any()
            assert len(set(frontier.acting.tolist())) == (~inside).sum() // 2 * 2
    assert (found.lower, found.upper) == pytest.approx((exact.lower, exact.upper), rel=gap)
    if name == "a known misconception":
        unknown = solve(PersonProblem.of(known, setting=Setting(**setting)).pomdp, gap=1e-3)
        assert abs(unknown.lower - exact.lower) > 0.01


def looked_at(table: Table, human: Human | None = None) -> list[int]:
    """Return the nodes of a graph that truncated tasks expand, in order."""
    nodes = table.values(np.arange(len(table)))[:, 0]
    beyond = [set[int]()]
    for count in range(1, len(table)):
        part = TruncatedTask.of(table, states=count, population=Population(beta=(1.0, 1.0)), human=human)
        beyond.append(set(nodes[np.delete(part.states, part.frontier)].tolist()) - {0})
    return [node for before, after in pairwise(beyond) for node in after - before]


@pytest.fixture
def one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Expand states one at a time."""
    monkeypatch.setitem(region.BATCH, "sweep", 1)


@pytest.mark.usefixtures("one_by_one")
def test_a_part_looks_at_the_states_that_are_met_most_likely() -> None:
    """From 1 through 2 to the goal the probability is 0.9. A step that costs 2 more than the best has probability 1 /
    (1 + e^2) = 0.12: through 3 from 1, through 4 from 2 (0.9 * 0.12), through 5 from 3 (0.12 * 0.12).
    """
    edges = [(3, 5, 1), (5, 0, 4), (1, 3, 1), (2, 4, 1), (1, 2, 1), (2, 0, 1), (3, 0, 3), (4, 0, 2)]
    assert looked_at(sweep(graph_task(edges))) == [1, 2, 3, 4, 5]


def test_states_that_are_looked_at_together_have_optimal_choices_of_their_own() -> None:
    """From 3, the step to 5 is the best of nine (0.9 * 0.9), and that from 2 to 4 the second of two (0.9 * 0.27)."""
    others = [edge for node in range(6, 14) for edge in ((3, node, 1), (node, 0, 3))]
    edges = [(1, 2, 3), (1, 3, 1), (2, 0, 1), (2, 4, 1), (4, 0, 1), (3, 5, 1), (5, 0, 2), *others]
    assert looked_at(sweep(graph_task(edges)))[:5] == [1, 2, 3, 5, 4]


@pytest.mark.usefixtures("one_by_one")
def test_a_part_is_where_somebodys_mistakes_lead() -> None:
    """Four wrong steps cost the same, except to a person who is mistaken about where they lead."""
    for prices in ((3, 3, 3, 3), (6, 5, 4, 3)):
        ways = [(1, 2, 1), (2, 0, 1), *((1, node, 1) for node in range(3, 7))]
        table = sweep(graph_task([*ways, *((node, 0, price) for node, price in enumerate(prices, start=3))]))
        nodes = table.values(np.arange(len(table)))[:, 0].tolist()
        for seed in range(3):
            human = Human(1.0, 0.5, 2.0, Misconception(2.0, seed))
            taken = dict(zip(nodes, human.expects(Choices.of(table)).tolist(), strict=True))
            wrong = [node for node in looked_at(table, human) if node > 2]
            assert wrong == sorted(range(3, 7), key=taken.__getitem__)
        # For misconceptions about single actions, nothing is known in advance.
        other = Human(1.0, 0.5, 2.0, Misconception(2.0, 0, "action"))
        assert looked_at(table, other) == looked_at(table)
    assert looked_at(table) == [1, 2, 6, 5, 4, 3]


@pytest.mark.usefixtures("one_by_one")
def test_in_a_dead_end_without_actions_people_wait() -> None:
    table = sweep(graph_task([(1, 2, 1), (1, 3, 1), (3, 0, 9)]))
    part = TruncatedTask.of(table, states=3)
    (end,) = np.flatnonzero(np.isinf(part.choices.h))
    assert end not in part.frontier
    assert part.choices.name(int(end), 0) == "(wait)"
    assert (part.choices.costs[end, 0], part.choices.targets[end, 0]) == (1, end)


def test_people_are_the_same_in_a_part_as_in_the_whole() -> None:
    table = table_of(INSTANCES["sealed"])
    human, part = Human(1.0, 0.5, 1.0, Misconception(1.0, 5)), TruncatedTask.of(table, states=30)
    whole = human.expects(Choices.of(table))
    np.testing.assert_array_equal(human.expects(part.choices), whole[part.states])
    np.testing.assert_array_equal(perceived_of_states(human, table, part.states, part.choices.h), whole[part.states])


def test_a_part_begins_where_it_is_told_and_ends_with_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    table, told = table_of(INSTANCES["paper-fixed"]), list[int]()
    monkeypatch.setitem(region.BATCH, "sweep", 3)
    part = TruncatedTask.of(table, start=7, states=8, time_limit=1e9, progress=told.append)
    assert (part.states[0], told[0], max(told), sum(told)) == (7, 1, 3, 8)
    everything = TruncatedTask.of(table, progress=told.append)
    assert (len(everything.states), len(everything.frontier)) == (len(table), 0)
    assert sum(told) == 8 + len(table) - table.space.goal.sum()
    now = iter([10.0, 11.0, 15.0, 17.0])
    monkeypatch.setattr(region, "time", SimpleNamespace(monotonic=lambda: next(now)))
    short = TruncatedTask.of(table, time_limit=7.0)  # it has passed when no time is left
    assert len(short.states) - len(short.frontier) - short.choices.goal.sum() == 1 + 3


def test_a_parts_problem_is_of_the_people_and_prices_that_are_given() -> None:
    part = TruncatedTask.of(table_of(INSTANCES["sealed"]), states=15)
    some = Population.mixed((Population(beta=(0.1, 0.3), theta=(0.8, 0.9)), Population(theta=(0.2, 0.3))), (0.75, 0.25))
    people = {"eta": 0.4, "lapse": 0.02, "utility_scale": 3.0}
    prices = {"gamma": 0.9, "robot": OfRobots(c_suggest=0.3), "suggestions": "all"}
    for population in (Population(), some):
        ours = closed_problem(part, Assumptions(population, **people, **prices))  # type: ignore[arg-type]
        model = HumanModel.exact(part.choices, **people)
        theirs = AssistPOMDP.of(model, population=population, frontier=ours.frontier, **prices)  # type: ignore[arg-type]
        assert (ours.gamma, ours.model.lapse) == (0.9, 0.02)
        for name in ("prior", "robot_costs", "suggested", "chosen", "low", "weight"):
            np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
        assert ours.frontier.lower.shape == (len(part.frontier), 1, len(ours.grid.theta))
    rule = Reliability(2, 0.1, 2)
    ours = closed_problem(part, Assumptions(trust=rule))
    theirs = AssistPOMDP.of(HumanModel.exact(part.choices), behaviour=Behaviour(trust=rule))
    assert ours.grid.shape == theirs.grid.shape == (6, 30)
    assert ours.frontier.lower.shape == (len(part.frontier), 1, 30)
    np.testing.assert_array_equal(
        ours.low[part.choices.optimal.any(axis=1)], theirs.low[part.choices.optimal.any(axis=1)]
    )


@costly(5, 30)
@given(st.integers(1, 150), st.floats(0.5, 0.995), st.floats(0, 2), st.floats(0.5, 2))
def test_bounds_of_any_part_are_ordered(states: int, gamma: float, c_suggest: float, gap: float) -> None:
    """They are ordered exactly, wherever the search ends: at a gap of 2, it mostly does so before its first trial."""
    part = TruncatedTask.of(table_of(INSTANCES["sealed"]), states=states)
    problem = closed_problem(part, Assumptions(gamma=gamma, robot=OfRobots(c_suggest=c_suggest)))
    bounds = solve(problem, gap=gap)
    assert bounds.stopped in {"gap", "stalled"}
    assert max(bounds.value_never, bounds.value_always) <= bounds.lower <= bounds.upper <= bounds.value_qmdp
    observed = qmdp(problem).value_mdp[problem.model.choices.initial] * problem.prior
    assert observed.sum() < bounds.value_qmdp == pytest.approx(observed.sum(), rel=1e-7)  # the margin for rounding


def test_the_value_of_never_suggesting_is_at_most_that_on_the_whole_task() -> None:
    """At the frontier, too, nothing is suggested; else suggestions that pay seem not to be worth their cost."""
    edges = [(0, 1, 2), (1, 0, 2), (1, 2, 3), (2, 0, 3), (2, 3, 1), (3, 0, 1), (3, 2, 3)]
    table, people = sweep(graph_task(edges, goal=3, start=0)), Population(beta=(0.0, 0.3), theta=(0.8, 1.0))
    setting = Setting(gamma=0.9, c_suggest=0.05, trust="constant")
    whole = solve(PersonProblem.of(table, setting=setting, population=people).pomdp)
    part = solve(PersonProblem.of(table, setting=setting, population=people, states=1).pomdp)
    assert part.pomdp.frontier is not None
    assert whole.suggests
    assert part.suggests
    assert part.value_never <= whole.value_never < whole.lower - 1


def test_nothing_is_executed_where_a_problem_breaks_off() -> None:
    """Executions stay inside; their numbers are those of the suggestions, and what they are called does not change."""
    part = TruncatedTask.of(table_of(INSTANCES["paper-fixed"]), states=5)
    frontier = closed_problem(part).frontier
    problem = AssistPOMDP.of(HumanModel.exact(part.choices), robot=OfRobots(execute=True), frontier=frontier)
    leads = inside = 0
    for x in range(len(problem.ends)):
        suggestions = (int(problem.robot_actions[x]) - 1) // 2
        for r in range(1, 1 + suggestions):
            target = part.choices.targets[x, problem.suggested[x, r]]
            ends = target in part.frontier
            assert problem.afterstate[x, r + suggestions] == (x if ends else target)
            assert problem.executes(x, r + suggestions) == problem.suggestion(x, r) != problem.executes(x, r)
            leads, inside = leads + ends, inside + (not ends)
    assert leads
    assert inside


@pytest.mark.parametrize("c_execute", thinned([0.7, 0.0, 3.0], 3))
@pytest.mark.parametrize("instance", [*INSTANCES.values(), WAYS], ids=["fixed", "dead ends", "costs"])
def test_a_parts_bounds_hold_where_robots_execute(instance: Instance, c_execute: float) -> None:
    table, robot = table_of(instance), OfRobots(c_suggest=0.3, execute=True, c_execute=c_execute)
    exact = qmdp(AssistPOMDP.of(HumanModel.exact(Choices.of(table)), gamma=0.97, robot=robot)).value_mdp
    begin, gaps = Choices.of(table).initial, []
    for states in (1, 20, 10_000):
        part = TruncatedTask.of(table, states=states)
        problem = closed_problem(part, Assumptions(gamma=0.97, robot=robot))
        rows = np.flatnonzero(part.states >= 0)
        upper = qmdp(problem).value_mdp[rows] - exact[part.states]
        assert upper.min() > -1e-6
        gaps.append(upper[problem.model.choices.initial].max())
        assert begin == part.states[0]
        frontier = problem.frontier
        beyond = frontier.states < len(rows)
        known = exact[part.states[frontier.states[beyond]]]
        assert (frontier.upper[beyond] - known).min(initial=0.0) > -1e-6
        assert (known - frontier.lower[beyond]).min(initial=0.0) > -1e-6
    assert gaps[-1] < 1e-6
    assert sorted(gaps, reverse=True) == pytest.approx(gaps, abs=1e-6)


def test_a_solution_is_saved_with_its_bounds(tmp_path: Path) -> None:
    part = closed_problem(TruncatedTask.of(table_of(WAYS), states=20))
    for problem, gap in ((whole(table_of(INSTANCES["sealed"])), 0.05), (part, 1.0)):
        solution = solve(problem, gap=gap)
        solution.save(tmp_path / "policy", note=np.array("kept"))
        assert [file.name for file in tmp_path.iterdir()] == ["policy"]
        again = Solution.load(tmp_path / "policy")
        x = np.flatnonzero(~problem.ends)
        belief = (
            np.random.default_rng(0).dirichlet(np.ones(problem.prior.size), len(x)).reshape(-1, *problem.grid.shape)
        )
        for name in ("value", "upper_bound", "choose", "q_values"):
            np.testing.assert_array_equal(getattr(solution, name)(x, belief), getattr(again, name)(x, belief))
        facts = ("lower", "upper", "value_qmdp", "value_never", "value_always", "seconds", "backups", "stopped")
        assert all(getattr(solution, name) == getattr(again, name) for name in facts)
        assert again.pomdp.model.choices.names == problem.model.choices.names
        assert (again.pomdp.frontier is None) == (problem.frontier is None)


def test_a_problem_covers_all_of_a_small_table_and_a_region_of_anything_else(tiny: Table) -> None:
    problem = PersonProblem.of(tiny, setting=Setting(gamma=0.97, c_suggest=0.3))
    assert problem.pomdp.frontier is None
    assert problem.pomdp.afterstate.tolist() == whole(tiny).afterstate.tolist()
    assert problem.states.tolist() == list(range(len(tiny)))
    asked = OnDemand(tiny.task)
    for known, states in ((tiny, 5), (asked, 5), (asked, 10_000)):
        part = PersonProblem.of(known, states=states, setting=Setting(gamma=0.97, c_suggest=0.3))
        region = TruncatedTask.of(known, states=states)
        assert part.states.tolist() == region.states.tolist()
        assert part.pomdp.frontier.states.tolist() == region.frontier.tolist()


def test_another_file_is_no_solution(tmp_path: Path) -> None:
    text, other = tmp_path / "text.npz", tmp_path / "other.npz"
    text.write_text("nothing of the kind")
    np.savez(other, lower=np.zeros(3))
    for file in (text, other):
        with pytest.raises(InputFileError, match=f"{file.name}.*expected a saved Solution"):
            Solution.load(file)


def test_the_command_cuts_down_what_is_too_large(tmp_path: Path) -> None:
    """Also for robots that execute, whose problem then has states of its own."""
    size, out = ("--set", "region_states=20", "--set", "execute=true"), tmp_path / "policy.npz"
    done = invoke("policy", KITTING / "paper.pddl", *size, "--time-limit", 0.1, "--out", out)
    assert (done.exit_code, "frontier states" in done.stdout) == (0, True)
    with np.load(out) as stored:
        assert (stored["task_states"] == -1).any()
        assert len(stored["task_states"]) == len(stored["values"])
    asked = invoke("policy", KITTING / "tiny.pddl", "--set", "max_states=5", "--time-limit", 5, "--json")
    record = json.loads(asked.stdout)
    assert (record["method"], record["states"], record["frontier"]) == ("on-demand", 21, 0)


def test_the_command_gives_bounds_and_a_file(tmp_path: Path) -> None:
    out = tmp_path / "policy.npz"
    done = invoke("policy", KITTING / "tiny.pddl", "--gap", "1e-3", "--set", "sigma=0.5", "--out", out, "--json")
    assert (done.exit_code, done.stderr) == (0, "")
    record = json.loads(done.stdout)
    assert {"states", "hidden", "lower", "upper", "gap", "value_qmdp", "value_never", "value_always", "seconds",
            "alpha_vectors"} <= set(record)  # fmt: skip
    assert (record["states"], record["hidden"], record["stopped"]) == (21, 60, "gap")
    assert record["value_never"] <= record["lower"] <= record["upper"] <= record["value_qmdp"]
    assert record["gap"] == pytest.approx((record["upper"] - record["lower"]) / abs(record["lower"]))
    assert record["gap"] <= 1e-3
    again = Solution.load(out)
    assert again.lower == record["lower"]
    with np.load(out) as arrays:
        found = dict(arrays)
    assert len(found["values"]) == len(found["task_states"]) == 21
    for name in ("lower", "corner", "policy.pomdp.model.lapse", "policy.pomdp.robot_actions"):
        np.savez(out, **{**found, name: np.array(["text"])})
        with pytest.raises(InputFileError, match=f"'{name}' is of the kind <U4"):
            Solution.load(out)
    np.savez(out, **{**found, "policy.pomdp.robot_actions": found["policy.pomdp.robot_actions"][:1]})
    with pytest.raises(InputFileError, match="expected a saved Solution"):
        Solution.load(out)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["unsolvable.pddl"], 1, "the goal cannot be reached"),
        (["tiny.pddl", "--set", "gamma=1"], 2, "gamma: 1; expected a number above 0 and below 1"),
        (["tiny.pddl", "--gap", "-1"], 2, "-1; expected a fraction from 0 to 1"),
        (["tiny.pddl", "--out", "policy.txt"], 2, "expected a name that ends in .npz"),
        (["absent.pddl"], 2, "absent.pddl"),
    ],
)
def test_what_cannot_be_is_said_in_one_line(arguments: list[str], code: int, message: str) -> None:
    done = invoke("policy", KITTING / arguments[0], *arguments[1:])
    assert (done.exit_code, done.stdout) == (code, "")
    assert message in done.stderr
    assert isinstance(done.exception, SystemExit)
