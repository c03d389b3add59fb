"""Choice models: terms, memory, and user models, in the filter, in bounds and in simulation."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import KITTING, graph_task, invoke, thinned
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from joint import joint_bounds
from numpy.typing import NDArray
from scipy.special import softmax
from test_terms import situation

from assist.declare import plain
from assist.live.assistant import Assistant
from assist.people.belief import Grid
from assist.people.choice_model import Weighted, boltzmann, chances
from assist.people.choices import Choices
from assist.people.decision import NOTHING, choice, influence, lapse, perceived_value, trust
from assist.people.human import Human, HumanModel
from assist.people.memory import remembered
from assist.people.ranges import Population
from assist.people.terms import NOTHING_YET, TERMS, features, goals_met
from assist.people.user_code import UserCodeError
from assist.person.person_problem import PersonProblem
from assist.person.pomdp import AssistPOMDP, Behaviour
from assist.person.qmdp import qmdp
from assist.person.robots import OfRobots
from assist.person.settings import Setting
from assist.person.solver import Solution, solve
from assist.studies.cells import carry_out
from assist.studies.protocol import read
from assist.team.pool import Pool
from assist.team.simulate import simulate
from planner import LimitError, OnDemand, Table, sweep
from planner.system.errors import InputFileError

Floats = NDArray[np.float64]

WEIGHTS = {"goals": 0.4, "arguments": 2.0, "name": 0.6, "back": -1.5}
RANGES = {name: (weight, weight) for name, weight in WEIGHTS.items()}
some = settings(max_examples=20, deadline=None, suppress_health_check=list(HealthCheck))
costs = st.lists(st.one_of(st.floats(0, 30), st.just(float("inf"))), min_size=1, max_size=5)
edges = st.tuples(st.integers(1, 4), st.integers(0, 4), st.sampled_from([0, 1, 1, 2]))
graphs = st.lists(edges, min_size=2, max_size=9)


@some
@given(costs, st.one_of(st.just(0.0), st.floats(0, 20)), st.data())
def test_terms_speak_beside_cost(q: list[float], beta: float, data: st.DataObject) -> None:
    bias = np.array(data.draw(st.lists(st.floats(-900, 900), min_size=len(q), max_size=len(q))))
    cost, applicable = np.array(q), np.ones(len(q), dtype=bool)
    silent = beta == 0 or np.isinf(cost).all()  # then costs have no effect
    expected = softmax(bias if silent else np.where(np.isfinite(cost), -beta * cost, -np.inf) + bias)
    np.testing.assert_allclose(choice(cost, applicable, beta, bias), expected, rtol=1e-9, atol=1e-300)
    np.testing.assert_array_equal(choice(cost, applicable, beta, np.zeros(len(q))), choice(cost, applicable, beta))
    assert choice(np.append(cost, np.inf), np.append(applicable, False), beta, np.append(bias, 0.0))[-1] == 0


@some
@given(graphs, st.integers(0, 1000))
def test_a_walk_with_memory_is_a_walk_of_the_task(drawn: list[tuple[int, int, int]], seed: int) -> None:
    """Every row has the features of its state and history, whatever the earlier history was."""
    table = sweep(graph_task(drawn))
    plain, rng = Choices.of(table), np.random.default_rng(seed)
    odd = {"odd": lambda s: (s.actions % 2) * (s.last[:, None] % 3) + 0.5 * s.previous[:, None]}
    choices = remembered(table, {**TERMS, **odd})
    row, x, last, previous = choices.initial, plain.initial, NOTHING_YET, NOTHING_YET
    states = choices.of_task(np.arange(choices.task_states))
    for _ in range(25):
        assert states[row] == x
        for name in ("h", "goal", "applicable", "actions", "costs", "optimal"):
            np.testing.assert_array_equal(getattr(choices, name)[row], getattr(plain, name)[x])
        if plain.goal[x]:
            break
        expected = features(situation(table, x, last, previous), {**TERMS, **odd})[0]
        assert choices.features is not None
        np.testing.assert_array_equal(choices.features[row], expected)
        slot = int(rng.choice(np.flatnonzero(plain.applicable[x])))
        row, x, last, previous = choices.targets[row, slot], plain.targets[x, slot], plain.actions[x, slot], x
    rows = [(int(states[r]), choices.features[r].tobytes()) for r in range(len(choices))]
    assert len(set(rows)) == len(rows)
    assert {x for x, _ in rows} == set(range(len(plain)))


def test_what_needs_no_memory_costs_no_state(tiny: Table) -> None:
    for terms in ({}, {"goals": TERMS["goals"]}):
        choices = remembered(tiny, terms)
        assert choices.state is None
        np.testing.assert_array_equal(choices.targets, Choices.of(tiny).targets)
    assert len(tiny) < len(remembered(tiny)) < len(tiny) + tiny.space.transition_count
    with pytest.raises(LimitError, match="pairs of a state"):
        remembered(tiny, memory_limit_mb=1e-3)


def test_the_filter_is_that_of_all_histories(tiny: Table) -> None:
    """Beliefs and the probabilities of whole histories equal their enumeration by the equations."""
    plain, goals = Choices.of(tiny), goals_met(tiny, np.arange(len(tiny)))
    choices = remembered(tiny)
    grid = Grid(np.array([0.0, 1.3]), np.array([0.0, 0.4, 1.0]))
    model = HumanModel.exact(choices, eta=0.15)
    pomdp = AssistPOMDP.of(model, behaviour=Behaviour(Weighted(WEIGHTS)), grid=grid, suggestions="all")
    prior = np.random.default_rng(2).dirichlet(np.ones(6)).reshape(2, 3)
    q = np.where(plain.applicable, plain.costs + plain.h[plain.targets], np.inf)
    value = perceived_value(plain, q)
    weights, robots, depth = np.array(list(WEIGHTS.values())), (1, 0, 2, 1), 4
    seen = {"histories": 0, "chance": 0.0}

    def follow(
        step: int, x: int, last: int, previous: int, joint: dict[tuple[int, ...], Floats], row: int, belief: Floats,
        chance: float,
    ) -> None:  # fmt: skip
        """Enumerate all histories; `joint` has the probability of each history of theta, shape (B,)."""
        if step == depth or plain.goal[x]:
            by_theta = np.zeros((2, 3))
            for path, p in joint.items():
                by_theta[:, path[-1]] += p
            np.testing.assert_allclose(by_theta / by_theta.sum(), belief, rtol=0, atol=1e-12)
            np.testing.assert_allclose(by_theta.sum(), chance, rtol=1e-12)
            seen["histories"] += 1
            seen["chance"] += chance
            return
        action = robots[step] if robots[step] < pomdp.robot_actions[row] else 0
        told = int(pomdp.suggested[row, action])
        bias = features(situation(tiny, x, last, previous))[0] @ weights
        alone = choice(q[x], plain.applicable[x], grid.beta, bias)
        for slot in np.flatnonzero(plain.applicable[x]).tolist():
            after: dict[tuple[int, ...], Floats] = {}
            for path, mass in joint.items():
                theta = grid.theta[path[-1]]
                p = lapse(influence(alone, told, theta), plain.applicable[x], model.lapse)[:, slot]
                moved = theta
                if told != NOTHING:
                    moved = trust(theta, value[x], value[plain.targets[x, told]], model.eta)
                low, up = grid.shares(moved)
                for at, share in ((int(low), 1 - float(up)), (int(low) + 1, float(up))):
                    if share > 0:
                        after[(*path, at)] = mass * p * share
            at = np.array([row]), np.array([action]), np.array([slot])
            likelihood = float((pomdp.likelihood(*at)[0] * belief).sum())
            follow(
                step + 1, int(plain.targets[x, slot]), int(plain.actions[x, slot]), x, after,
                int(choices.targets[row, slot]), pomdp.update(belief[None], *at)[0], chance * likelihood,
            )  # fmt: skip

    assert goals[plain.goal].min() > goals[plain.initial]
    start = {(t,): prior[:, t] for t in range(3)}
    follow(0, plain.initial, NOTHING_YET, NOTHING_YET, start, choices.initial, prior, 1.0)
    assert seen["histories"] > 15
    assert seen["chance"] == pytest.approx(1, abs=1e-12)


@pytest.mark.slow
def test_bounds_with_memory_agree_with_another_solver(tiny: Table, tmp_path: Path) -> None:
    choices = remembered(tiny)
    population = Population()
    setting = Setting(gamma=0.95, c_suggest=0.1, c_move=0.0, knowledge="exact")
    grid = Grid(np.array([0.3, 1.5]), np.array([0.0, 0.5, 1.0]))
    pomdp = AssistPOMDP.of(
        HumanModel.exact(choices), behaviour=Behaviour(Weighted(WEIGHTS)), grid=grid, population=population, gamma=0.95,
        robot=OfRobots(c_suggest=0.1),
    )  # fmt: skip
    pool = Pool(
        setting, tuple(population.sample(choices, 1, np.random.default_rng(0))), (qmdp(pomdp),), np.zeros(1, int)
    )
    own, other = solve(pomdp, gap=1e-4), joint_bounds(pool, gap=1e-3)
    own.save(tmp_path / "own.npz")
    kept = Solution.load(tmp_path / "own.npz").policy.pomdp.model.choices
    assert kept.terms == choices.terms
    np.testing.assert_array_equal(kept.state, choices.state)
    assert own.gap <= 1e-4
    assert other.gap <= 1e-3
    assert own.lower <= other.upper
    assert own.upper >= other.lower
    assert own.value_never == pytest.approx(other.never, abs=1e-3)
    assert own.lower > own.value_never + 0.1
    plain = AssistPOMDP.of(HumanModel.exact(Choices.of(tiny)), grid=grid, gamma=0.95, robot=OfRobots(c_suggest=0.1))
    assert abs(solve(plain, gap=1e-4).value_never - own.value_never) > 0.5  # terms matter


def episodes(pool: Pool, policy: str = "attention", **options: Any) -> list[dict[str, Any]]:
    trace: list[dict[str, Any]] = []
    simulate(pool, policy, humans=2, episodes=30, seed=4, trace=trace, **options)
    return trace


@pytest.mark.parametrize("knowledge", thinned(["own", "exact"]))
def test_weights_of_0_change_nothing(tiny: Table, knowledge: Any) -> None:
    setting = Setting(knowledge=knowledge, suggestions="all", c_suggest=0.2)
    without = Pool.sample(tiny, 4, seed=3, setting=setting)
    with_0 = Pool.sample(
        tiny, 4, seed=3, setting=setting, population=Population(weights=dict.fromkeys(WEIGHTS, (0, 0)))
    )
    assert len(with_0.choices(0)) > len(without.choices(0))
    for world, policy in (("people", "attention"), ("model", "priority")):
        assert episodes(with_0, policy, world=world) == episodes(without, policy, world=world)


def test_people_with_terms_are_otherwise_the_same(tiny: Table) -> None:
    without = Population().sample(Choices.of(tiny), 3, np.random.default_rng(0))
    choices = remembered(tiny)
    found = Population(weights={"goals": (0.2, 0.5), "back": (-2, -1)}).sample(choices, 3, np.random.default_rng(0))
    for one, other in zip(without, found, strict=True):
        assert (one.beta, one.theta, one.sigma, one.weights) == (other.beta, other.theta, other.sigma, {})
        np.testing.assert_array_equal(one.h[choices.state], other.h)
        assert 0.2 <= other.weights["goals"] <= 0.5
        assert -2 <= other.weights["back"] <= -1
    assert len({tuple(one.weights.values()) for one in found}) == 3


def test_a_robot_may_believe_in_boltzmann(tiny: Table) -> None:
    people = Population(weights=RANGES)
    for knowledge in ("own", "exact"):
        setting = Setting(knowledge=knowledge)
        knows = Pool.sample(tiny, 2, seed=3, setting=setting, population=people)
        believes = Pool.sample(tiny, 2, seed=3, setting=setting, population=people, prior=Population())
        plain = Pool.sample(tiny, 2, seed=3, setting=setting)
        state = believes.choices(0).state
        assert state is not None
        for one, other, third in zip(believes.policies, plain.policies, knows.policies, strict=True):
            np.testing.assert_array_equal(one.pomdp.chosen, other.pomdp.chosen[state])
            np.testing.assert_allclose(one.value_mdp, other.value_mdp[state], atol=1e-6)
            assert np.abs(one.pomdp.chosen - third.pomdp.chosen).max() > 0.2
        rows = np.flatnonzero(~believes.choices(0).goal)
        np.testing.assert_array_equal(
            believes.people[0].chances(believes.choices(0))[rows], knows.people[0].chances(knows.choices(0))[rows]
        )
    mixture = Population.mixed((Population(weights=RANGES), Population()), (0.25, 0.75))
    assert mixture.typical.weights == {name: pytest.approx(0.25 * weight) for name, weight in WEIGHTS.items()}


@pytest.mark.parametrize("weight", thinned([-30.0, 30.0]))
def test_who_never_goes_back_does_not_and_who_always_does_does(tiny: Table, weight: float) -> None:
    """The trace shows it, since it names the actions of the task."""
    people = Population(beta=(0.1, 0.1), sigma=(0, 0), weights={"back": (weight, weight)})
    pool, choices = Pool.sample(tiny, 2, seed=3, population=people), Choices.of(tiny)
    walks: dict[tuple[str, str], list[str]] = {}
    for row in episodes(pool, "none"):
        walks.setdefault((row["person"], row["episode"]), []).append(row["action"])
    free = 0
    for walk in walks.values():
        x, previous = choices.initial, NOTHING_YET
        for action in walk:
            slots = np.flatnonzero(choices.applicable[x]).tolist()
            slot = next(slot for slot in slots if choices.name(x, slot) == action)
            before = [slot for slot in slots if choices.targets[x, slot] == previous]
            if before and len(slots) > len(before):
                free += 1
                assert (slot in before) == (weight > 0)
            x, previous = int(choices.targets[x, slot]), x
    assert free > 50


def short_sighted(choices: Choices, _: Floats, beta: Floats) -> Floats:
    """Choose a goal state if one is a step away, and otherwise a random action."""
    near = (choices.goal[choices.targets] & choices.applicable).any(axis=1, keepdims=True)
    liked = np.where(near, choices.goal[choices.targets], 1.0) * choices.applicable
    careless = choices.applicable / np.maximum(choices.applicable.sum(axis=1, keepdims=True), 1)
    careful = liked / np.maximum(liked.sum(axis=1, keepdims=True), 1)
    share = np.exp(-beta)[:, None, None]
    return share * careless + (1 - share) * careful


def test_a_model_of_ones_own_is_used_everywhere(tiny: Table) -> None:
    choices, grid = Choices.of(tiny), Grid(np.array([0.5, 2.0]), np.array([0.0, 0.5, 1.0]))
    pomdp = AssistPOMDP.of(HumanModel.exact(choices), behaviour=Behaviour(short_sighted), grid=grid)
    expected = short_sighted(choices, pomdp.model.q[:, :, 0], grid.beta)
    expected = np.where(choices.goal[:, None], 0.0, expected)  # who has reached the goal does nothing
    np.testing.assert_array_equal(pomdp.chosen, np.moveaxis(expected, 0, 2))
    people = Population(beta=(2, 2), sigma=(0, 0), chooses=short_sighted)
    assert plain(people)["chooses"] == "short_sighted"
    pool = Pool.sample(tiny, 3, seed=0, population=people)
    np.testing.assert_array_equal(
        pool.people[0].chances(choices), short_sighted(choices, pomdp.model.q[:, :, 0], np.array([2.0]))[0]
    )
    alone = simulate(pool, "none", humans=1, episodes=400, seed=0)
    value = qmdp(
        AssistPOMDP.of(
            HumanModel.exact(choices, lapse=0.0),
            behaviour=Behaviour(short_sighted),
            grid=Grid(np.array([2.0]), grid.theta),
        )
    )
    never = value.q_mdp[choices.initial, 0, 0, 1]
    assert alone.discounted_return.mean() < never + 4 * alone.discounted_return.std() / np.sqrt(400)
    problem = PersonProblem.of(tiny, population=people)
    exact = solve(problem.pomdp, gap=0.2)
    assert exact.gap <= 0.2
    part = solve(PersonProblem.of(OnDemand(tiny.task), population=people, states=len(tiny)).pomdp, gap=0.2)
    assert part.lower <= exact.upper
    assert exact.lower <= part.upper
    assert part.lower == pytest.approx(exact.lower, abs=0.01)


def test_what_trust_looks_at_may_be_ones_own(tiny: Table) -> None:
    choices = Choices.of(tiny)

    def blind(choices: Choices, q: Floats, beta: Floats) -> Floats:
        return boltzmann(choices, q, beta)

    blind.value = lambda choices, _: np.zeros(len(choices))  # type: ignore[attr-defined]
    pomdp = AssistPOMDP.of(HumanModel.exact(choices), behaviour=Behaviour(blind))
    thetas = np.arange(len(pomdp.grid.theta))
    moved = pomdp.low + pomdp.weight
    np.testing.assert_allclose(moved, np.broadcast_to(thetas, moved.shape), atol=1e-12)


@pytest.mark.parametrize(
    ("own", "message"),
    [
        (lambda *_: np.ones(3), "shape \\(3,\\); expected \\(2, 21, 3\\)"),
        (lambda c, q, beta: 0.5 * boltzmann(c, q, beta), "adding up to 1"),
        (lambda _, q, __: np.full((2, *q.shape), 1 / 3), "0 in empty slots"),
        (lambda c, q, beta: boltzmann(c, q, beta) * np.nan, "expected 0 or more"),
        (Weighted({"haste": 1.0}), "terms haste: the choices do not have them"),
    ],
)
def test_what_gives_no_chances_is_refused(tiny: Table, own: Any, message: str) -> None:
    choices = Choices.of(tiny)
    with pytest.raises(UserCodeError, match=message):
        chances(own, choices, HumanModel.exact(choices).q[:, :, 0], np.array([0.5, 2.0]))


def test_chances_that_almost_add_up_to_one_are_scaled(tiny: Table) -> None:
    choices = Choices.of(tiny)
    found = chances(
        lambda c, q, beta: boltzmann(c, q, beta) * (1 + 9e-10),
        choices,
        HumanModel.exact(choices).q[:, :, 0],
        np.array([0.5]),
    )
    np.testing.assert_allclose(found.sum(axis=2)[0], choices.applicable.any(axis=1), atol=1e-15)


def test_populations_with_weights_are_checked(tiny: Table) -> None:
    with pytest.raises(ValueError, match="no term 'haste'; expected one of goals, arguments, name, back"):
        Pool.sample(tiny, 2, seed=0, population=Population(weights={"haste": (0, 1)}))
    with pytest.raises(ValueError, match="no term 'goals'; the choices have none"):
        Pool.sample(Choices.of(tiny), 2, seed=0, population=Population(weights=RANGES))
    with pytest.raises(ValueError, match="expected people without memory"):
        Pool.sample(tiny, 2, seed=0, setting=Setting(execute=True), population=Population(weights=RANGES))
    assert isinstance(Human(1.0, 0.5, 0.0, np.zeros(3)).weights, dict)


def test_a_live_team_remembers(tiny: Table) -> None:
    """After each action the belief is that of the person's problem with memory, also after saving and loading."""
    people = Population(weights=RANGES)
    desk = Assistant(tiny, people=["ann"], population=people)
    problem = PersonProblem.of(tiny, population=people)
    pomdp, choices = problem.pomdp, problem.pomdp.model.choices
    row, belief = choices.initial, pomdp.prior[None]
    for action in ("(fetch box-a)", "(return box-a)", "(fetch box-a)", "(place hammer slot-2 box-a)"):
        slot = next(s for s in np.flatnonzero(choices.applicable[row]) if choices.name(row, s) == action)
        belief = pomdp.update(belief, np.array([row]), np.array([0]), np.array([slot]))
        row = int(choices.targets[row, slot])
        desk.observe("ann", action)
        ann = desk.person("ann")
        assert (ann.state, ann.cost_to_go) == (problem.states[row], choices.h[row])
        np.testing.assert_allclose(ann.belief, belief[0], rtol=1e-9)
    again = Assistant.from_json(desk.to_json(), tiny)
    np.testing.assert_array_equal(again.person("ann").belief, desk.person("ann").belief)
    assert again.population == people
    for _ in range(4):
        desk.undo("ann")
    np.testing.assert_allclose(desk.person("ann").belief, pomdp.prior)


OWN = '''
import numpy as np

def hasty(choices, q, beta):
    """Takes a goal that is one step away; the more surely, the larger beta is."""
    near = choices.goal[choices.targets] & choices.applicable
    liked = np.where(near.any(axis=1, keepdims=True), near, choices.applicable)
    p = np.exp(beta[:, None, None] * liked) * choices.applicable
    return p / np.maximum(p.sum(axis=2, keepdims=True), 1)

def broken(choices, q, beta):
    return q[99, 99]
'''

STUDY = f"""
seed = 5
repeats = 1
instances = ["{KITTING}/tiny.pddl"]
humans = [2]
pool = 2
draws = 1
trials = 3
policies = ["none", "attention"]
[populations.boltzmann]
[populations.habits]
weights = {{ goals = [0.4, 0.4], back = [-2, -1] }}
[populations.hasty]
chooses = "own.py:hasty"
[[conditions]]
name = "people"
populations = ["habits", "hasty", "boltzmann"]
priors = ["own", "boltzmann"]
"""


def test_people_of_a_file_are_used_by_the_commands(tmp_path: Path) -> None:
    own = tmp_path / "own.py"
    own.write_text(OWN)
    part = {"share": 1.0, "beta": [0.5, 2], "theta": [0.5, 0.9], "sigma": [0, 0.5], "weights": {"back": [-2, -1]}}
    for name, parts in (("habits", part), ("plain", {key: part[key] for key in part if key != "weights"})):
        (tmp_path / f"{name}.json").write_text(json.dumps({"parts": [parts]}))
    team = ("simulate", KITTING / "tiny.pddl", "--humans", 2, "--pool", 2, "--episodes", 20, "--json")
    found = {}
    for name, options in {
        "hasty": ("--set", f"population.chooses={own}:hasty"),
        "knows": ("--population", tmp_path / "habits.json"),
        "believes": ("--population", tmp_path / "habits.json", "--set", f"prior={tmp_path / 'plain.json'}"),
        "plain": ("--population", tmp_path / "plain.json"),
    }.items():
        result = invoke(*team, "--policy", "none", "--policy", "attention", "--c-suggest", 0.05, *options)
        assert result.exit_code == 0, result.output
        found[name] = json.loads(result.stdout)
    assert found["hasty"]["population"]["chooses"] == f"{own}:hasty"
    assert found["knows"]["population"]["parts"][0]["weights"] == {"back": [-2, -1]}
    none = {name: record["policies"][0] for name, record in found.items()}
    helped = {name: record["policies"][1] for name, record in found.items()}
    assert none["knows"] == none["believes"] != none["plain"]
    assert helped["knows"] != helped["believes"]
    assert none["hasty"]["human_actions_per_person"]["mean"] > 2 * none["plain"]["human_actions_per_person"]["mean"]
    values = [
        json.loads(invoke("policy", KITTING / "tiny.pddl", "--gap", 1, "--json", *options).stdout)["value_never"]
        for options in ((), ("--set", f"population.chooses={own}:hasty"), ("--population", tmp_path / "habits.json"))
    ]
    assert len({round(value, 6) for value in values}) == 3
    for options, message in (
        (("--set", f"population.chooses={own}:broken"), f"{own}:12: IndexError"),
        (("--set", f"population.chooses={own}:absent"), "has no function 'absent'"),
        (("--set", "population.chooses=absent"), "expected FILE.py:FUNCTION"),
        (("--set", f"population.chooses={own}:hasty", "--population", tmp_path / "plain.json"), "expected one value"),
        (("--set", f"prior={own}"), f"--set prior: {own}"),
    ):
        result = invoke(*team, *options)
        assert (result.exit_code, result.stdout) == (2, "")
        assert message in result.stderr
        assert "Traceback" not in result.stderr


def test_a_study_compares_people_and_what_the_robot_takes_them_for(tmp_path: Path) -> None:
    own = tmp_path / "own.py"
    own.write_text(OWN)
    file = tmp_path / "people.toml"
    file.write_text(STUDY)
    study = pickle.loads(pickle.dumps(read(file)))  # as other processes receive it
    found = {(cell.population, cell.prior): carry_out(cell, study).lines.splitlines() for cell in study.cells()}
    assert len(found) == 6
    assert found["boltzmann", "own"] == [
        line.replace('"prior": "boltzmann"', '"prior": "own"') for line in found["boltzmann", "boltzmann"]
    ]
    actions = {
        key: [json.loads(line)["actions"] for line in lines if '"policy": "none"' in line]
        for key, lines in found.items()
    }
    assert actions["habits", "own"] == actions["habits", "boltzmann"] != actions["boltzmann", "own"]
    before = study.fingerprint()
    own.write_text(OWN + "\n")
    assert read(file).fingerprint() != before
    for bad, message in (
        ('chooses = "own.py:absent"', "populations.hasty.chooses: .*has no function 'absent'"),
        ('chooses = "own.py"', "expected FILE.py:FUNCTION"),
        ("weights = { haste = [0, 1] }", "populations.hasty.weights: 'haste'; expected one of goals"),
    ):
        file.write_text(STUDY.replace('chooses = "own.py:hasty"', bad))
        with pytest.raises(InputFileError, match=message):
            read(file)
