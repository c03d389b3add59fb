"""Tasks of any size: evaluation on demand gives the same results as evaluation at once, where both are possible."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from random import Random
from typing import Any

import numpy as np
import pytest
from conftest import kit, thinned

from assist.certify.information_relaxation.belief_nodes import BeliefNodes
from assist.certify.information_relaxation.sampled_bound import InformationRelaxation
from assist.certify.options import BoundOptions
from assist.certify.prices import groups_of
from assist.certify.relaxed_value import relaxed_value
from assist.certify.team_bound import TeamBound, upper_bound
from assist.live import Assistant
from assist.people.ranges import Population
from assist.person import person_problem, shared_task, truncated_bound, truncated_policy
from assist.person.attention_subproblem import with_actions
from assist.person.frontier_bounds import never_erring
from assist.person.observation_model import ObservationModel
from assist.person.pomdp import AssistPOMDP
from assist.person.qmdp import QMDP, qmdp
from assist.person.settings import Setting
from assist.person.solver import solve
from assist.team.episodes import Episodes
from assist.team.pool import Pool
from assist.team.priority import Priority
from assist.team.schedule import Schedule
from assist.team.simulate import simulate
from assist.team.state import TeamAction, TeamState
from assist.team.trace import Trace
from planner import CostToGo, OnDemand, Table

EVERYTHING = 10**6  # states of a region
SIGHT = Setting(c_suggest=0.2, observation=ObservationModel(0.1, 0.1))
HASTY = BoundOptions(price_rounds=8)  # bounds hold at all prices


def episodes(known: CostToGo, policy: Any, *, states: int, world: Any = "people", **options: Any) -> Episodes:
    sample = {name: options.pop(name) for name in ("setting", "population", "region") if name in options}
    pool = Pool.sample(known, 3, seed=1, states=states, **sample)
    return simulate(pool, policy, humans=2, episodes=5, seed=2, world=world, **options)


def assert_same(one: Episodes, other: Episodes, number: int = 5) -> None:
    for name in ("people", "actions", "costs", "helped", "moves", "steps", "discounted_return"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), name)
    if one.pruned is not None or other.pruned is not None:
        np.testing.assert_allclose(one.pruned, other.pruned, rtol=0, atol=1e-12)
    assert one.actions.sum() > number * 2  # people did something


def weakest(team: TeamState) -> TeamAction:
    """Attend to the person farthest from the goal, as a user's policy may."""
    return team.act(np.where(team.active, team.cost_to_go(), -1).argmax(axis=1), team.first_optimal())


WAYS: list[tuple[Any, dict[str, Any]]] = [
    ("none", {}),
    ("reactive", {}),
    ("attention", {}),
    ("priority", {}),
    (weakest, {}),
    ("attention", {"setting": Setting(knowledge="exact", c_suggest=0.2)}),
    ("priority", {"setting": Setting(c_suggest=0.2, travel_time=2)}),
    ("attention", {"setting": Setting(c_suggest=0.2, suggestions="all"), "population": Population(noise="action")}),
    ("reactive", {"world": "model"}),
    ("priority", {"world": "model"}),
    ("attention", {"setting": SIGHT}),
    ("priority", {"setting": SIGHT}),
    ("rollout", {"setting": Setting(c_suggest=0.2, knowledge="exact")}),
]
CASES = [
    pytest.param(task, *way, marks=[] if way in quick else [pytest.mark.slow])
    for task, quick in (
        ("sealed", [WAYS[5], WAYS[8]]),  # what is seen badly: `test_states_that_are_possible_keep_their_rows`
        ("costs/ways", [WAYS[5]]),
    )
    for way in WAYS
]


@pytest.mark.parametrize(("task", "policy", "options"), CASES)
def test_small_tasks_looked_at_step_by_step(task: str, policy: Any, options: dict[str, Any]) -> None:
    """The same people with the same random numbers act equally, in tasks with dead ends and with free actions."""
    table = kit(task)
    whole = episodes(table, policy, states=len(table), **options)
    assert_same(whole, episodes(table, policy, states=len(table) - 1, region=EVERYTHING, **options))


def who_executes(monkeypatch: pytest.MonkeyPatch, suggestions: Any, knowledge: Any, region: int) -> tuple[Pool, Pool]:
    """The same people and a robot that executes, on the whole task and on a region of it."""
    setting = Setting(
        execute=True, c_suggest=0.3, c_execute=0.5, c_move=0.1, suggestions=suggestions, knowledge=knowledge
    )
    whole = Pool.sample(kit("sealed"), 3, seed=1, setting=setting)
    monkeypatch.setattr("assist.team.solving.MAX_ENUMERATED", 1)
    monkeypatch.setattr(shared_task, "ROWS", 300)
    return whole, Pool.sample(kit("sealed"), 3, seed=1, setting=setting, region=region)


OF_EXECUTION = thinned([(suggests, knows) for knows in ("exact", "own") for suggests in ("optimal", "all")], 4)


@pytest.mark.parametrize("case", OF_EXECUTION)
def test_robots_execute_on_rows_as_on_the_whole_task(case: tuple[Any, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    whole, part = who_executes(monkeypatch, *case, EVERYTHING)
    (one, *_), (other, *_), rng = whole.policies, part.policies, Random(1)
    for _ in range(20):
        states = np.array(rng.sample(range(len(kit("sealed"))), 10))
        belief = np.repeat(one.pomdp.prior[None], len(states), axis=0)
        expected, found = (policy.q_values(policy.rows(states), belief) for policy in (one, other))
        shown = found.shape[1]
        assert not np.isfinite(expected[:, shown:]).any()
        np.testing.assert_allclose(found, expected[:, :shown], rtol=0, atol=1e-9)
    for policy in ("attention", "priority"):
        runs = [simulate(pool, policy, humans=2, episodes=8, seed=3) for pool in (whole, part)]
        assert_same(*runs, 8)
        np.testing.assert_array_equal(runs[0].executed, runs[1].executed)
        assert runs[0].executed.any()


@pytest.mark.slow
@pytest.mark.parametrize("case", OF_EXECUTION)
def test_robots_that_execute_on_a_part_are_nearly_as_good(case: tuple[Any, Any], monkeypatch: Any) -> None:
    whole, cut = who_executes(monkeypatch, *case, region=40)
    none, best, near = (
        simulate(pool, policy, humans=2, episodes=50, seed=4).discounted_return.mean()
        for pool, policy in ((cut, "none"), (whole, "attention"), (cut, "attention"))
    )
    assert near - none > 0.8 * (best - none) > 0
    part = Pool.sample(kit("sealed"), 3, seed=1, setting=whole.setting, region=EVERYTHING)
    exact, same, above = (upper_bound(pool, [0, 1], window=0, gap=1e-3, seed=1).upper for pool in (whole, part, cut))
    assert best - 0.1 < exact
    assert exact == pytest.approx(same, rel=2e-3)
    assert above > exact - 0.02


@pytest.mark.parametrize(
    "case",
    thinned([("tiny", 1e-9, 2), ("tiny", 1e-9, 0), ("sealed", 1e-6, 0), ("sealed", 1e-6, 2)]),
)
def test_prices_of_steps_on_rows_are_those_on_the_whole_task(case: tuple[str, float, int]) -> None:
    """At each step, for each position of the robot, in all states that are reachable by then."""
    task, error, travel_time = case  # the larger one is solved to 1e-6
    table = kit(task)
    setting, price = Setting(c_suggest=0.1, travel_time=travel_time), np.array([0.4, 0.0, 0.7, 0.2])
    whole, part = (
        Pool.sample(table, 1, seed=1, setting=setting, states=states, region=EVERYTHING) for states in (len(table), 0)
    )
    priced = Priority.of([*whole.policies, *part.policies], setting.travel(2), price)
    (one,), (other,) = whole.policies, part.policies
    exact, found = one.with_robot(priced), other.with_robot(priced)
    compared = 0
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
        simulate(pool, Priority.of(pool.policies, setting.travel(2), price), humans=[0, 0], episodes=8, seed=2)
        for pool in (whole, part)
    ]
    assert_same(*runs)


@pytest.mark.parametrize("policy", thinned(["attention", "none", "priority", "reactive"]))
def test_rows_that_nobody_holds_are_evicted_and_computed_again(policy: str, tiny: Table, monkeypatch: Any) -> None:
    monkeypatch.setattr(shared_task, "ROWS", 30)
    setting = Setting(c_suggest=0.1, knowledge="exact", trust="outcome")
    whole, part = (
        Pool.sample(tiny, 3, seed=1, setting=setting, states=states, region=EVERYTHING) for states in (len(tiny), 0)
    )
    (only,) = part.policies
    assert isinstance(only, truncated_policy.TruncatedPolicy)
    options: dict[str, Any] = {"humans": 2, "episodes": 1, "world": "people"}
    for seed in range(4):
        assert_same(*(simulate(pool, policy, seed=seed, **options) for pool in (whole, part)), 1)
        assert len(only.problem.now.pomdp.robot_actions) < len(tiny)


@pytest.mark.slow
def test_suggestions_after_which_choices_were_forgotten_are_heard_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """A row may stay while the choices after its suggestions are evicted; people act as on the whole task then, too."""
    monkeypatch.setattr(shared_task, "ROWS", 200)
    table = kit("sealed")
    whole, part = (Pool.sample(table, 3, seed=1, states=states, region=EVERYTHING) for states in (len(table), 0))
    for policy in ("none", "reactive"):
        assert_same(*(simulate(pool, policy, humans=2, episodes=100, seed=3) for pool in (whole, part)), 100)


def test_states_that_are_possible_keep_their_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beliefs over states are those on the whole task, although rows are evicted between the steps."""
    monkeypatch.setattr(shared_task, "ROWS", 60)
    table = kit("sealed")
    setting = replace(SIGHT, knowledge="exact")
    whole, part = (
        Pool.sample(table, 3, seed=1, setting=setting, states=states, region=EVERYTHING) for states in (len(table), 0)
    )
    for seed in range(2):
        assert_same(*(simulate(pool, "attention", humans=1, episodes=1, seed=seed) for pool in (whole, part)), 1)
    (stamps,) = (policy.problem.now.stamps for policy in part.policies)
    assert stamps.max() > len(stamps)  # rows were used again


def test_threads_do_not_evict_each_others_rows(tiny: Table, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared_task, "ROWS", 25)
    setting = Setting(c_suggest=0.1, knowledge="exact")
    whole, part = (
        Pool.sample(tiny, 3, seed=1, setting=setting, states=states, region=EVERYTHING) for states in (len(tiny), 0)
    )
    options: dict[str, Any] = {"humans": 2, "episodes": 256, "seed": 3}
    assert_same(simulate(whole, "attention", **options), simulate(part, "attention", jobs=2, **options), 256)


def test_a_live_team_keeps_the_rows_of_people_and_decisions(tiny: Table, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beliefs, suggestions, what is taken back and later explanations are those of the whole task."""
    monkeypatch.setattr(shared_task, "ROWS", 25)
    said = list[list[Any]]()
    for whole in (True, False):
        monkeypatch.setattr(person_problem, "is_whole", lambda _, whole=whole: whole)
        desk = Assistant(
            tiny, ["ann", "bob"], setting=Setting(c_suggest=0.05, c_move=0.0), population=Population(beta=(0.1, 0.5))
        )  # fmt: skip
        rng, advice = Random(1), []
        found: list[Any] = []
        for step in range(14):
            advice.append(desk.recommend())
            for person in desk.people:
                if actions := desk.person(person).applicable:
                    desk.observe(person, rng.choice(actions))
                if step % 5 == 4:
                    desk.undo(person)
                found.append((advice[-1].suggestion, desk.person(person).belief.tobytes()))
        found += [
            None if one.explanation is None or one.suggestion is None else one.explanation.text() for one in advice
        ]
        said.append(found)
    assert said[0] == said[1]
    assert sum(isinstance(one, str) for one in said[0]) >= 3


def test_people_of_enumerated_tasks_and_of_others_are_in_one_team(tiny: Table) -> None:
    setting = Setting(c_suggest=0.2)
    whole, part = (
        Pool.sample(tiny, 2, seed=1, setting=setting, states=states, region=EVERYTHING) for states in (len(tiny), 0)
    )
    same, mixed = (
        simulate(Pool.joined([whole, other]), "priority", humans=3, episodes=8, seed=2) for other in (whole, part)
    )
    assert_same(same, mixed)


@pytest.mark.parametrize("knowledge", thinned(["own", "exact"]))
def test_everybody_may_join_late(tiny: Table, knowledge: Any) -> None:
    """In the first steps no person is present."""
    late, setting = Schedule.of(2, joins=[3, 1]), Setting(knowledge=knowledge, c_suggest=0.2)
    whole, part = (
        episodes(tiny, "attention", states=states, region=EVERYTHING, presence=late, setting=setting)
        for states in (len(tiny), 0)
    )
    assert_same(whole, part)


def test_a_trace_names_the_same_actions(tiny: Table) -> None:
    traces: list[Trace] = [[], []]
    for trace, states in zip(traces, (len(tiny), 1), strict=True):
        episodes(tiny, "attention", states=states, trace=trace, setting=Setting(c_suggest=0.2), region=EVERYTHING)
    assert traces[0] == traces[1]
    assert {row["suggestion"] is None for row in traces[0]} == {True, False}


def test_a_task_that_is_asked_on_demand(tiny: Table) -> None:
    asked = OnDemand(tiny.task)
    assert_same(episodes(tiny, "reactive", states=len(tiny)), episodes(asked, "reactive", states=0))


def test_outside_its_region_a_policy_goes_by_the_cost_to_go(fixed: Table) -> None:
    """A policy computed on a twentieth of the states is hardly worse, and better than no assistance."""
    setting = Setting(c_suggest=0.2)
    whole = Pool.sample(fixed, 2, seed=3, setting=setting)
    part = Pool.sample(fixed, 2, seed=3, setting=setting, states=0, region=40)
    returns = {
        (name, policy): simulate(pool, policy, humans=2, episodes=40, seed=4).discounted_return
        for name, pool in (("whole", whole), ("part", part))
        for policy in ("none", "attention", "priority")
    }
    np.testing.assert_array_equal(returns["whole", "none"], returns["part", "none"])
    for policy in ("attention", "priority"):
        gained = (returns["whole", policy] - returns["whole", "none"]).mean()
        assert (returns["part", policy] - returns["whole", "none"]).mean() > 0.8 * gained > 0
    (ground,) = {policy.ground for policy in part.policies}  # type: ignore[attr-defined]
    assert all(len(policy.regions[0].frontier) > 0 for policy in part.policies)  # type: ignore[attr-defined]
    assert len(ground.visited) < len(fixed)


@pytest.mark.slow
def test_a_bound_on_a_region_is_one_on_the_task(tiny: Table) -> None:
    """With a region of one state, of some and of all states, the bound is at least that on the whole task's known
    part.
    """
    setting = Setting(c_suggest=0.2)

    def bound(**part: int) -> TeamBound:
        pool = Pool.sample(tiny, 2, seed=3, setting=setting, **part)
        return upper_bound(pool, window=3, gap=1e-4, seed=1, options=HASTY)

    whole = bound()
    parts = [bound(states=0, region=region) for region in (1, 6, EVERYTHING)]
    assert parts[2].upper == pytest.approx(whole.upper, rel=1e-3)
    assert parts[0].upper > parts[1].upper > whole.upper - whole.slack
    nobody_errs = 2 * never_erring(tiny.lookup([tiny.initial]), tiny.task.costs, setting.gamma)[0]
    assert parts[0].upper < nobody_errs - 0.5  # although hardly a state is looked at
    certificate = parts[1].certify("priority", episodes=500)
    assert certificate.value == pytest.approx(whole.certify("priority", episodes=500).value, rel=0.05)
    assert certificate.value < parts[1].upper
    with pytest.raises(ValueError, match="relaxed_value: expected an enumerated task"):
        relaxed_value(parts[1])


@pytest.mark.slow
def test_prices_on_a_region(tiny: Table, monkeypatch: pytest.MonkeyPatch) -> None:
    """Prices tighten the bound, but not below that of the whole task at the same prices; some prices are used."""
    sizes = replace(truncated_bound.SIZES, hidden=4, pairs=9, pairs_least=9, tolerance=1e-4, sweeps=10_000)
    monkeypatch.setattr(truncated_bound, "SIZES", sizes)
    setting, team = Setting(c_suggest=0.1, c_move=0.2), (0, 1, 2)
    pools = [Pool.sample(tiny, 3, seed=0, setting=setting, **part) for part in ({"states": 0}, {})]
    price = np.array([0.0, 0.3, 0.35, 0.3, 0.3, 0.2])
    values = []
    for pool in pools:
        groups = groups_of(pool, team, setting.travel(3), len(price), with_outer=True)
        assert all((group.problem.between is not None) == (pool is pools[0]) for group in groups)
        parts = [(visits := group.at(with_actions(price)), group.best(visits)) for group in groups]
        solved = [solve(visits.pomdp, gap=1e-4, best=best) for visits, best in parts]
        assert all(one.lower <= one.upper for one in solved)
        values.append([one.upper for one in solved])
        busy = sum(group.simulated(with_actions(price), len(price), 4000, 1)[0][0] for group in groups)
        values.append(busy)
    part, part_busy, whole, busy = values
    assert (np.array(part) > np.array(whole) - 1e-3).all()
    assert np.sum(part) < np.sum(whole) + 1.0
    np.testing.assert_allclose(part_busy, busy, atol=0.06)  # the larger part is all of the task
    with_prices, without = (upper_bound(pools[0], window=window, seed=1, options=HASTY) for window in (None, 0))
    assert len(with_prices.price)
    assert with_prices.upper < without.upper - 0.1
    assert not len(upper_bound(pools[0], seed=1, options=replace(HASTY, price_memory_mb=1e9)).price)


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
    own: dict[str, Any] = {"seed": 1, "setting": setting, "solver": partial(solve, gap=1e-4)}
    whole, cut = Pool.sample(tiny, 3, **own), Pool.sample(OnDemand(tiny.task), 3, region=100, **own)
    runs = [simulate(pool, "attention", humans=2, episodes=40, seed=3) for pool in (whole, cut)]
    np.testing.assert_array_equal(runs[0].actions, runs[1].actions)
    np.testing.assert_allclose(runs[0].discounted_return, runs[1].discounted_return, rtol=1e-9)
    assert runs[0].interventions.sum() > 20
    said = []
    for region in (1, 8, 100):
        pool = Pool.sample(OnDemand(tiny.task), 3, seed=1, setting=setting, solver=silent, region=region)
        said.append(int(simulate(pool, "attention", humans=2, episodes=40, seed=3).interventions.sum()))
    assert said[0] > said[1] > said[2] == 0
