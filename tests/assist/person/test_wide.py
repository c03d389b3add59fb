"""Tasks of any size: where both are possible, what is computed on demand is what is computed at once."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from random import Random
from typing import Any

import numpy as np
import pytest
from conftest import kit, thinned
from test_unknown_goals import three_goals

from assist.certify import BoundOptions, upper_bound
from assist.certify.information_relaxation.belief_nodes import BeliefNodes
from assist.certify.information_relaxation.sampled_bound import InformationRelaxation
from assist.certify.prices import groups_of
from assist.live import Assistant
from assist.people.ranges import Population
from assist.person import QMDP, AssistPOMDP, Setting, person_problem, qmdp, shared_task, solve, truncated_bound
from assist.person.memory_needed import depth_within, first_bounds_bytes, states_within
from assist.person.observation_model import ObservationModel
from assist.person.person_problem import PersonProblem
from assist.person.shared_task import default_size
from assist.person.truncated_policy import TruncatedPolicy
from assist.team import Episodes, Pool, Priority, Schedule, TeamAction, TeamState, simulate
from assist.team.trace import Trace
from planner import LimitError, OnDemand, Table

EVERYTHING = 10**6  # states of a region
EXACT = Setting(c_suggest=0.2, knowledge="exact")
SIGHT = Setting(c_suggest=0.2, observation=ObservationModel(0.1, 0.1))
EXECUTES = Setting(execute=True, c_suggest=0.3, c_execute=0.5, c_move=0.1)
GOALS = Setting(c_suggest=0.05, c_move=0.1, max_steps=60)
ASKS = Setting(c_suggest=0.2, c_move=0.1, c_ask=0.05, ask_error=0.1, max_steps=60)
HABITS = Population(weights={"goals": (0.2, 0.6), "arguments": (0.5, 1.5), "name": (0.1, 0.4), "back": (-1.0, -0.5)})


def task_of(name: str) -> Any:
    """Return a kitting task, or one with three goals."""
    return three_goals(name.removeprefix("goals of ")) if name.startswith("goals of ") else kit(name)


def pools(task: Any, region: int = EVERYTHING, **sample: Any) -> tuple[Pool, Pool]:
    """The same people, on the whole task and on a part of it."""
    whole = Pool.sample(task, 3, seed=1, **sample)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("assist.team.solving.MAX_ENUMERATED", 1)
        return whole, Pool.sample(task, 3, seed=1, states=1, region=region, **sample)


def assert_same(one: Episodes, other: Episodes) -> None:
    for name in ("people", "actions", "costs", "helped", "executed", "moves", "steps", "questions"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), name)
    for name, error in (("discounted_return", 1e-9), ("pruned", 1e-12)):
        if getattr(one, name) is not None or getattr(other, name) is not None:
            np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=0, atol=error)
    assert one.actions.sum() > 2 * len(one)  # people did something


def weakest(team: TeamState) -> TeamAction:
    """Attend to the person farthest from the goal, as a user's policy may."""
    return team.act(np.where(team.active, team.cost_to_go(), -1).argmax(axis=1), team.first_optimal())


LATE = {"presence": Schedule.of(2, joins=[3, 1])}  # in the first step no person is present
ALL = Setting(c_suggest=0.2, suggestions="all")
SLOW = Setting(c_suggest=0.2, travel_time=2)
WAYS: list[tuple[Any, Setting, dict[str, Any]]] = [
    *((policy, Setting(c_suggest=0.2), {}) for policy in ("none", "reactive", "attention", "priority", weakest)),
    ("attention", EXACT, {}), ("priority", SLOW, {}), ("rollout", EXACT, {}),
    ("attention", ALL, {"population": Population(noise="action")}),
    *((policy, Setting(), {"world": "model"}) for policy in ("reactive", "priority")),
    *((policy, SIGHT, {}) for policy in ("attention", "priority")),
]  # fmt: skip
KNOWN = [Setting(c_suggest=0.1, c_move=0.1, knowledge=knows) for knows in ("own", "exact")]
QUICK = [
    ("sealed", "attention", EXACT, {}), ("sealed", "reactive", Setting(), {"world": "model"}),
    ("costs/ways", "attention", EXACT, {}), ("tiny", "attention", Setting(c_suggest=0.2), LATE),
    ("sealed", "priority", replace(EXECUTES, knowledge="exact"), {}), ("goals of tiny", "attention", GOALS, {}),
    ("goals of tiny", "attention", replace(GOALS, knowledge="exact"), {"goals": "likeliest"}),
    ("tiny", "priority", KNOWN[0], {"population": HABITS}),
]  # fmt: skip
RARE = [
    *((task, *way) for task in ("sealed", "costs/ways") for way in WAYS),
    *(("sealed", policy, replace(EXECUTES, knowledge=knows, suggestions=suggests), {})
      for policy in ("attention", "priority") for knows in ("exact", "own") for suggests in ("optimal", "all")),
    *(("goals of tiny", policy, GOALS, {"world": world})
      for policy in ("none", "attention", "priority", "whittle") for world in ("people", "model")),
    *(("goals of tiny", "attention", replace(GOALS, knowledge="exact"), {"goals": goals})
      for goals in ("inferred", "known")),
    *(("goals of sealed", policy, setting, {})
      for policy, setting in (("priority", GOALS), ("attention", ASKS), ("attention-never", ASKS))),
    *((task, policy, setting, {"population": HABITS, "prior": prior}) for task in ("tiny", "sealed")
      for policy in ("none", "attention") for setting in KNOWN for prior in (None, Population())),
    ("tiny", "attention", EXACT, LATE),
]  # fmt: skip
CASES = [*QUICK, *(pytest.param(*case, marks=pytest.mark.slow) for case in RARE if case not in QUICK)]


@pytest.mark.parametrize(("task", "policy", "setting", "options"), CASES)
def test_the_same_people_act_equally_on_a_part(
    task: str, policy: Any, setting: Setting, options: dict[str, Any]
) -> None:
    """With the same random numbers: with dead ends, free actions, several goals, habits, and robots that execute."""
    sample = {name: options[name] for name in ("population", "prior") if name in options}
    run: dict[str, Any] = {name: value for name, value in options.items() if name not in sample}
    traces = [Trace(), Trace()]
    found = [
        simulate(pool, policy, humans=2, episodes=8, seed=3, trace=trace, **run)
        for pool, trace in zip(pools(task_of(task), setting=setting, **sample), traces, strict=True)
    ]
    assert_same(*found)
    for name in ("action", "suggestion", "executed"):
        assert [row.get(name) for row in traces[0]] == [row.get(name) for row in traces[1]]
    assert (policy == "none") == (not found[0].interventions.any())
    assert setting.execute == bool(found[0].executed.any() if found[0].executed is not None else False)
    assert (setting.c_ask is not None) == (found[0].questions is not None and found[0].questions.any())


def by_halves(pomdp: AssistPOMDP) -> QMDP:
    """A solver whose policy no other one gives."""
    solved = qmdp(pomdp)
    return QMDP(pomdp, solved.value_mdp / 2, solved.q_mdp / 2)


@pytest.mark.parametrize(
    ("task", "setting", "solver"),
    [("sealed", EXECUTES, qmdp), ("goals of tiny", GOALS, qmdp), ("goals of tiny", GOALS, by_halves)],
)
@pytest.mark.parametrize("knowledge", thinned(["own", "exact"]))
@pytest.mark.parametrize("suggestions", thinned(["all", "optimal"]))
def test_values_on_a_part_are_those_on_the_whole_task(
    task: str, setting: Setting, solver: Any, knowledge: Any, suggestions: Any
) -> None:
    """For any beliefs; the robot may suggest what is optimal for any goal."""
    setting = replace(setting, knowledge=knowledge, suggestions=suggestions)
    whole, part = (pool.policies[0] for pool in pools(task_of(task), setting=setting, solver=solver))
    assert isinstance(part, TruncatedPolicy)
    states = len(kit(task.removeprefix("goals of ")))
    x, prior = np.arange(states)[:: max(1, states // 200)], whole.pomdp.prior
    belief = np.random.default_rng(4).dirichlet(np.ones(prior.size), len(x)).reshape(-1, *prior.shape)
    expected, found = (policy.q_values(policy.rows(x), belief) for policy in (whole, part))
    assert not np.isfinite(expected[:, found.shape[1] :]).any()
    np.testing.assert_allclose(found, expected[:, : found.shape[1]], rtol=0, atol=1e-9)


@pytest.mark.parametrize("task", thinned(["tiny", "sealed"]))
def test_values_with_terms_are_those_of_the_whole_task(task: str) -> None:
    """Q-values along random walks, to 1e-9, and probabilities of choices and effects on trust to rounding."""
    setting, rng = Setting(c_suggest=0.1, suggestions="all"), Random(5)
    whole, part = (pool.policies[0] for pool in pools(kit(task), setting=setting, population=HABITS))
    every, compared = whole.pomdp.model.choices, 0
    task_states = every.of_task(np.arange(every.task_states))
    for _ in range(12):
        row, place = every.initial, part.problem.task.initial
        for _ in range(15):
            if every.goal[row]:
                break
            belief = np.random.default_rng(compared).dirichlet(np.ones(60)).reshape(1, 6, 10)
            own = part.rows(np.array([place]))
            expected, found = whole.q_values(np.array([row]), belief)[0], part.q_values(own, belief)[0]
            count = int(whole.pomdp.robot_actions[row])
            np.testing.assert_allclose(found[:count], expected[:count], rtol=0, atol=1e-9)
            slots = int(every.applicable[row].sum())
            for name, size in (("chosen", slots), ("weight", count)):
                one, other = (getattr(policy.pomdp, name) for policy in (part, whole))
                np.testing.assert_allclose(one[own[0], :size], other[row, :size], rtol=1e-12)
            compared += 1
            slot = rng.randrange(slots)
            row = int(every.targets[row, slot])
            place = int(part.situations(part.pomdp.model.choices.targets[own, slot])[0])
            assert part.problem.states(np.array([place])).tolist() == [task_states[row]]
    assert compared > 60


@pytest.mark.parametrize(
    "case", thinned([("tiny", 1e-9, 2), ("tiny", 1e-9, 0), ("sealed", 1e-6, 0), ("sealed", 1e-6, 2)])
)
def test_prices_of_steps_on_rows_are_those_on_the_whole_task(case: tuple[str, float, int]) -> None:
    """At each step, for each position of the robot, in all states that are reachable by then."""
    task, error, travel_time = case  # the larger one is solved to 1e-6
    setting, price = Setting(c_suggest=0.1, travel_time=travel_time), np.array([0.4, 0.0, 0.7, 0.2])
    both, travel, compared = pools(kit(task), setting=setting), setting.travel(2), 0
    one, other = (pool.policies[0] for pool in both)
    priced = Priority.of([one, other], travel, price)
    exact, found = one.with_robot(priced), other.with_robot(priced)
    for step, layer in enumerate(exact.visits.layout.layers):
        belief = np.repeat(one.pomdp.prior[None], len(layer), axis=0)
        for position in range(2 + priced.longest):
            expected = exact.q_values(step, position, layer, belief)
            q = found.q_values(step, position, other.rows(layer), belief)
            q = np.pad(q, ((0, 0), (0, expected.shape[1] - q.shape[1])), constant_values=-np.inf)
            np.testing.assert_allclose(q, expected, rtol=0, atol=error)
            compared += len(layer)
    assert compared > 5 * 2 * 3
    runs = [
        simulate(pool, Priority.of(pool.policies, travel, price), humans=[0, 0], episodes=8, seed=2) for pool in both
    ]
    assert_same(*runs)


EVICTED: list[tuple[str, int, Setting, str, dict[str, Any]]] = [
    ("tiny", 30, Setting(c_suggest=0.1, knowledge="exact", trust="outcome"), "attention", {}),
    ("sealed", 60, replace(SIGHT, knowledge="exact"), "attention", {"humans": 1}),  # states that are possible stay
    ("tiny", 25, Setting(c_suggest=0.1, knowledge="exact"), "attention", {"episodes": 256, "jobs": 2}),  # threads
    *(("tiny", 30, Setting(c_suggest=0.1, knowledge="exact", trust="outcome"), policy, {})
      for policy in ("none", "priority", "reactive")),
    # A row may stay while the choices after its suggestions are evicted.
    *(("sealed", 200, Setting(), policy, {"episodes": 100}) for policy in ("none", "reactive")),
]  # fmt: skip


@pytest.mark.parametrize("case", [*EVICTED[:3], *(pytest.param(one, marks=pytest.mark.slow) for one in EVICTED[3:])])
def test_rows_that_nobody_holds_are_evicted_and_computed_again(case: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    task, rows, setting, policy, options = case
    monkeypatch.setattr(shared_task, "ROWS", rows)
    whole, part = pools(kit(task), setting=setting)
    jobs = options.get("jobs", 1)
    for seed in range(2):
        run = {"humans": 2, "episodes": 1, "seed": seed} | options
        assert_same(simulate(whole, policy, **run | {"jobs": 1}), simulate(part, policy, **run))
        for one in part.policies if jobs == 1 else ():
            assert len(one.problem.now.pomdp.robot_actions) < len(kit(task))  # type: ignore[attr-defined]
    stamps = part.policies[0].problem.now.stamps  # type: ignore[attr-defined]
    assert task == "tiny" or stamps.max() > len(stamps)  # rows were used again


LIVE: dict[str, tuple[str, Setting, Population | None]] = {
    "one goal": ("tiny", Setting(c_suggest=0.05, c_move=0.0), Population(beta=(0.1, 0.5))),
    "habits": ("tiny", Setting(c_suggest=0.05, c_move=0.0), HABITS),
    "goals": ("goals of tiny", Setting(c_suggest=0.05, c_move=0.0), None),
    "questions": ("goals of tiny", Setting(c_suggest=0.2, c_move=0.0, c_ask=0.02), None),
}


@pytest.mark.parametrize("name", LIVE)
def test_a_live_team_keeps_the_rows_of_people_and_decisions(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beliefs, suggestions, questions, what is taken back and later explanations are those of the whole task."""
    task, setting, population = LIVE[name]
    monkeypatch.setattr(shared_task, "ROWS", 25)
    said = list[list[Any]]()
    for whole in (True, False):
        monkeypatch.setattr(person_problem, "is_whole", lambda _, whole=whole: whole)
        desk = Assistant(task_of(task), ["ann", "bob"], setting=setting, population=population)
        rng, advice, found = Random(1), list[Any](), list[Any]()
        for step in range(14):
            advice.append(desk.recommend())
            if (asked := advice[-1].question) is not None:
                found.append((asked.person, asked.goal))
                desk.answer(asked.person, asked.goal == "b")
            for person in desk.people:
                seen = desk.person(person)
                found.append((seen.applicable, seen.state, seen.cost_to_go, dict(seen.goals), seen.belief.tobytes()))
                if seen.applicable:
                    desk.observe(person, rng.choice(seen.applicable))
                    if step % 5 == 4:
                        desk.undo(person)
        assert isinstance(desk.roster.records[0].problem.policy, TruncatedPolicy) == (not whole)
        suggested = [one for one in advice if one.suggestion is not None]
        found += [one.suggestion for one in advice]
        found += [one.explanation.text() for one in suggested if one.explanation is not None]
        said.append(found)
    assert said[0] == said[1]
    assert len(suggested) >= 3
    assert (name == "questions") == any(one.question is not None for one in advice)


def test_people_of_enumerated_tasks_and_of_others_are_in_one_team(tiny: Table) -> None:
    whole, part = pools(tiny, setting=Setting(c_suggest=0.2))
    asked = Pool.sample(OnDemand(tiny.task), 3, seed=1, setting=Setting(c_suggest=0.2), region=EVERYTHING)
    same, *others = (
        simulate(Pool.joined([whole, other]), "priority", humans=3, episodes=8, seed=2)
        for other in (whole, part, asked)
    )
    for other in others:
        assert_same(same, other)


def test_outside_its_region_a_policy_goes_by_the_cost_to_go(fixed: Table) -> None:
    """A policy computed on a twentieth of the states is hardly worse, and better than no assistance."""
    whole, part = pools(fixed, region=40, setting=Setting(c_suggest=0.2))
    returns = {
        (name, policy): simulate(pool, policy, humans=2, episodes=40, seed=4).discounted_return
        for name, pool in (("whole", whole), ("part", part))
        for policy in ("none", "attention")
    }
    np.testing.assert_array_equal(returns["whole", "none"], returns["part", "none"])
    gained = (returns["whole", "attention"] - returns["whole", "none"]).mean()
    assert (returns["part", "attention"] - returns["whole", "none"]).mean() > 0.8 * gained > 0
    (ground,) = {policy.ground for policy in part.policies}  # type: ignore[attr-defined]
    assert all(len(policy.regions[0].frontier) > 0 for policy in part.policies)  # type: ignore[attr-defined]
    assert len(ground.visited) < len(fixed)


TEAMS: dict[str, tuple[str, dict[str, Any], Population | None]] = {
    "goals": ("goals of tiny", {"c_suggest": 0.1, "c_move": 0.1, "knowledge": "exact", "gamma": 0.9}, None),
    "goals, misconceptions": ("goals of tiny", {"c_suggest": 0.1, "c_move": 0.1, "gamma": 0.9}, None),
    "terms": ("tiny", {"c_suggest": 0.2, "gamma": 0.95}, HABITS),
    "misconceptions": ("tiny", {"c_suggest": 0.2}, None),
    "executes": ("sealed", {"c_suggest": 0.3, "execute": True, "c_execute": 0.5, "c_move": 0.1, "gamma": 0.9}, None),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", TEAMS)
def test_a_bound_on_a_part_is_one_of_the_whole_task_which_it_becomes(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    """Also where theta is seen on a part only, and people comply beyond it."""
    task, setting, population = TEAMS[name]
    bound = partial(upper_bound, team=[0, 1], window=3, gap=1e-2, seed=1, options=BoundOptions(price_rounds=8))
    whole, every = pools(task_of(task), setting=Setting(**setting), population=population)
    exact, same = bound(whole), bound(every)
    assert same.upper == pytest.approx(exact.upper, rel=1e-3)
    for seen in (8, 20_000):
        monkeypatch.setattr(truncated_bound, "SIZES", replace(truncated_bound.SIZES, seen=seen))
        above = bound(pools(task_of(task), 2, setting=Setting(**setting), population=population)[1])
        assert above.upper >= exact.upper - exact.slack
    value = above.certify("priority", episodes=300, seed=2)
    assert value.value - 4 * value.value_stderr <= above.upper


def test_lucks_go_on_around_the_region(tiny: Table, monkeypatch: pytest.MonkeyPatch) -> None:
    """People who leave the part with hidden beta and theta conflict as before, and the bound holds."""
    monkeypatch.setattr(truncated_bound, "SIZES", replace(truncated_bound.SIZES, hidden=3))
    setting, team = Setting(c_suggest=0.1, c_move=0.2), (0, 1)
    pool = Pool.sample(tiny, 2, seed=0, setting=setting, states=5)
    groups = groups_of(pool, team, setting.travel(2), 0, with_outer=True)
    parts = [(visits := group.at(np.zeros((3, 0))), solve(visits.pomdp, gap=1e-3)) for group in groups]
    means, steps = [], []
    for outers in ([None, None], [group.problem.outer for group in groups]):
        lattices = [BeliefNodes(*part, outer) for part, outer in zip(parts, outers, strict=True)]
        for lattice, (_, solution) in zip(lattices, parts, strict=True):
            assert lattice.value == pytest.approx(solution.upper, abs=1e-9)
        robot = InformationRelaxation(lattices, np.zeros(0), 12)
        paths = robot.paths([np.random.default_rng(number) for number in range(30)])
        means.append(np.mean([robot.bound(path, 0.3) for path in paths]))
        steps.append(np.mean([len(graph.layer) for path in paths for graph in path.graphs]))
    assert steps[1] > steps[0] + 2
    run = simulate(pool, "priority", humans=[0, 1], episodes=800, seed=0, world="model").discounted_return
    error = run.std(ddof=1) / np.sqrt(len(run))
    proven = sum(solution.upper for _, solution in parts)
    assert run.mean() - 4 * error < means[1] < means[0] - 0.05 < proven - 0.05


def silent(pomdp: AssistPOMDP) -> QMDP:
    """A robot for which every suggestion is dearer than anything."""
    costs = pomdp.robot_costs.copy()
    costs[:, 1:] = 1e6
    return qmdp(replace(pomdp, robot_costs=costs))


@pytest.mark.parametrize("knowledge", thinned(["exact", "own"]))
def test_a_solver_of_ones_own_acts_in_the_states_of_a_truncated_task(tiny: Table, knowledge: Any) -> None:
    """With all states its policy is that on the whole task; with few, suggestions are made beyond its states only."""
    setting = Setting(c_suggest=0.05, c_move=0.05, gamma=0.9, knowledge=knowledge)
    options: dict[str, Any] = {"humans": 2, "episodes": 20, "seed": 3}
    whole, cut = pools(tiny, setting=setting, solver=partial(solve, gap=1e-4))
    assert_same(*(simulate(pool, "attention", **options) for pool in (whole, cut)))
    said = []
    for region in (1, 8, 100):
        pool = Pool.sample(OnDemand(tiny.task), 3, seed=1, setting=setting, solver=silent, region=region)
        said.append(int(simulate(pool, "attention", **options).interventions.sum()))
    assert said[0] > said[1] > said[2] == 0


def test_who_executes_meets_people_without_memory(tiny: Table) -> None:
    with pytest.raises(ValueError, match="execute: expected people without memory"):
        pools(tiny, population=HABITS, setting=Setting(execute=True))


def test_the_size_of_a_part_counts_goals_and_memory() -> None:
    goals = three_goals("sealed")
    table = goals.tables["a"]
    assert (default_size(table), default_size(goals)) == (20_000, 20_000 // 3)
    assert states_within(4000, range(50), 12) > 1_000 > states_within(4000, range(50), 100)
    values = 4 * len(goals) * 60 * 8 / 1e6  # of enumerated policies for three people, and of a copy
    found = Pool.sample(goals, 3, seed=1, memory_limit_mb=values / 2)
    assert isinstance(found.policies[0], TruncatedPolicy)
    policies = Pool.sample(table, 3, seed=1, states=1, memory_limit_mb=1.0).policies
    assert {policy.ground.size for policy in policies} == {states_within(1.0, [table], 3)} == {41}  # type: ignore[attr-defined]
    for task, limit, said in ((goals, 0.5, "3 people with 3 goals, on as few as 20 states, take about 1 MB of memory"),
                              (table, 0.4, "3 people, on as few as 20 states, take about 0 MB of memory")):  # fmt: skip
        with pytest.raises(LimitError, match=f"policies for {said}"):
            Pool.sample(task, 3, seed=1, states=1, memory_limit_mb=limit)


def test_a_problem_has_as_many_states_as_a_solver_can_keep() -> None:
    goals, sizes = three_goals("sealed"), []
    for limit in (np.inf, 17.0, 1.0):
        found = PersonProblem.of(goals, states=100, memory_limit_mb=limit)
        assert found.pomdp.frontier is not None
        sizes.append(len(found.states))
        if limit > 1:
            depth = depth_within(found.pomdp, limit)
            assert first_bounds_bytes(found.pomdp, depth) <= 0.8e6 * limit
            assert depth == (500 if limit == np.inf else 125)
    assert sizes[0] > sizes[1] > sizes[2] > 20
    bounds = solve(found.pomdp, gap=1.0, memory_limit_mb=20.0)
    assert bounds.lower < bounds.upper
