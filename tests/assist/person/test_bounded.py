"""Bounds at the frontier of truncated tasks: no value exceeds them, and they are tight if all states are included."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import pytest
from conftest import kit
from crosscheck import MODELS
from graphs import graph_task
from test_robots import Waits

from assist.declare.declared import declared
from assist.people import Choices, Grid, Human, HumanModel, Population, perceived_cost, perceived_value
from assist.people.hidden_type import HiddenType
from assist.person import AssistPOMDP, Assumptions, OfRobots, Setting, qmdp, solve, truncated_bound, truncated_task
from assist.person.attention_subproblem import AttentionSubproblem
from assist.person.compliance_relaxation import breadth_first, compliance_bounds
from assist.person.each_goal import BoundLimits
from assist.person.frontier_bounds import never_erring
from assist.person.observation_model import ObservationModel
from assist.person.time_expansion import AWAY, HERE
from assist.person.truncated_bound import BoundSizes, bounded, likely
from assist.team import Pool
from planner import LimitError, sweep

ENTRY = 0.4
PRIOR = Population(sigma=(1.0, 1.0))


def somebody(noise: Any = "state", sigma: float = 1.0) -> Human:
    (human,) = Population(sigma=(sigma, sigma), noise=noise).sample(None, 1, np.random.default_rng(3))
    return human


def part_and_whole(
    task: str, size: int, setting: Setting, human: Human | None, steps: int = 0
) -> tuple[AssistPOMDP, np.ndarray, Choices]:
    """Return the truncated problem, and the frontier's exact values, shape (m, 2, B, T)."""
    table = kit(task)
    problem = bounded(table, Assumptions.of(setting, human, PRIOR), entry=ENTRY, size=size).problem
    choices = Choices.of(table)
    visits = AttentionSubproblem.of(Assumptions.of(setting, human, PRIOR).problem(choices), ENTRY, steps)
    values = qmdp(visits.pomdp).value_mdp
    both = np.stack([values[visits.states(0, position)] for position in (AWAY, HERE)], axis=1)
    # States are identified by their keys, whose numbers differ between the two tasks.
    place = {int(key): x for x, key in enumerate(choices.keys)}
    assert len(place) == len(choices)
    at = [place[int(key)] for key in problem.model.choices.keys[problem.frontier.states]]
    return problem, both[at], choices


@pytest.mark.parametrize(
    ("task", "size", "setting", "human"),
    [
        ("sealed", 4, Setting(c_suggest=0.2), somebody()),
        pytest.param("costs/ways", 3, Setting(c_suggest=0.2, eta=0.8), somebody(), marks=pytest.mark.slow),
        ("tiny", 3, Setting(suggestions="all", gamma=0.95, lapse=0.02), somebody("action")),
        ("tiny", 4, Setting(c_suggest=0.1, knowledge="exact"), None),
    ],
)
def test_nobody_gets_more(task: str, size: int, setting: Setting, human: Human | None) -> None:
    """This holds in tasks with dead ends and with free actions, and for a robot whose travel takes time."""
    for steps in (0, 2):
        problem, values, _ = part_and_whole(task, size, setting, human, steps)
        frontier = problem.frontier
        assert frontier.away is not None
        assert (frontier.away >= values[:, 0] - 1e-6).all()
        assert (frontier.upper >= values[:, 1] - 1e-6).all()
        anybody = never_erring(problem.model.choices.h[frontier.states], kit(task).task.costs, setting.gamma)
        assert (frontier.upper <= anybody[:, None, None] + 1e-9).all()
        assert steps or (frontier.away < anybody[:, None, None] - 0.1).any()  # it is known that they err
        assert (frontier.away <= frontier.upper + 1e-9).all()


class Clearheaded(HiddenType):
    """Types with a part of one's own: half of the people choose with 30 times their expertise."""

    factor = np.array([1.0, 30.0])

    @cached_property
    def parts(self) -> Mapping[str, int]:
        return {**super().parts, "clear": 2}

    @cached_property
    def expertise(self) -> np.ndarray:
        return super().expertise * self.factor[self.part("clear")]

    def prior(self, person: np.ndarray) -> np.ndarray:
        return super().prior(0.5 * person[:, None].repeat(2, axis=1).reshape(-1, person.shape[1]))


FORKS = [(0, a, a // 10 + 1) for a in (10, 20)] + [(12, 8, 1), (22, 8, 1), (8, 9, 60)]
FORKS += [(s, t, 1) for a in (10, 20) for s, t in ((a, a + 1), (a + 1, a + 2), (a + 2, 9))]
MIXED = partial(Population, beta=(0.3, 2.0), theta=(0.6, 0.9), sigma=(1.0, 1.0))
EXECUTES = {"c_suggest": 0.2, "execute": True, "gamma": 0.95}
SEEN = {"knowledge": "exact", "c_suggest": 0.3, "gamma": 0.9}


def waiting(c_wait: float) -> tuple[Any, ...]:
    """People leave the part while the robot is on its way: then it has paid for coming, and does not wait."""
    setting: dict[str, Any] = {
        "robots": (Waits(c_wait=c_wait),),
        "c_suggest": 5.0,
        "gamma": 0.95,
        "trust": "constant",
        "knowledge": "exact",
    }
    return FORKS, setting, Population(beta=(0.0, 0.0), theta=(1.0, 1.0)), 8.0, (0, 3), {}


AT_LEAST: dict[str, tuple[Any, ...]] = {
    # The task, the setting, the people, what coming costs, how many steps it takes, and sizes of the bound.
    "execute, all": ("tiny", EXECUTES | {"c_execute": 0.8, "suggestions": "all"}, None, ENTRY, (0, 2), {}),
    "execute": ("sealed", EXECUTES | {"c_execute": 0.8}, None, ENTRY, (0,), {}),
    "waiting": waiting(5.0),
    "own types": ("tiny", SEEN, Population(beta=(0.1, 3.0)), 0.0, (0,), {"hidden": 2, "hidden_least": 2, "seen": 4}),
    **{
        f"{model}, {knows}": ("tiny", {"c_suggest": 0.05, "eta": 0.8, "gamma": 0.95, "knowledge": knows},
                              MIXED(chooses=chooses), 0.0, (0,), {})
        for knows in ("own", "exact") for model, chooses in MODELS.items()
    },
    "execute, dead ends": ("sealed", EXECUTES | {"c_execute": 0.8}, None, ENTRY, (2,), {}),
    "execute for nothing": ("tiny", EXECUTES | {"c_execute": 0.0, "suggestions": "all"}, None, ENTRY, (0, 2), {}),
    "execute, free actions": ("costs/ways", EXECUTES | {"c_execute": 0.8}, None, ENTRY, (0, 2), {}),
    "waiting for little": waiting(1.0),
    "own types, novices": ("tiny", SEEN, Population(beta=(0.1, 0.1)), 0.0, (0,), {"hidden": 2, "seen": 4}),
}  # fmt: skip
QUICK = 4 + len(MODELS)
CASES = [pytest.param(name, marks=[pytest.mark.slow] * (n >= QUICK)) for n, name in enumerate(AT_LEAST)]


@pytest.mark.cases
@pytest.mark.parametrize("name", CASES)
def test_a_bound_on_a_part_is_one_of_the_task(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """For robots that execute or pay for waiting, types of one's own, and every choice model and trust rule."""
    task, given, people, entry, ways, sizes = AT_LEAST[name]
    table = kit(task) if isinstance(task, str) else sweep(graph_task(task, goal=9, start=0))
    setting = Setting(**given)
    (human,) = (people or PRIOR).sample(None, 1, np.random.default_rng(3))
    assumed = Assumptions.of(setting, human if setting.knowledge == "own" else None, people or PRIOR)
    if name.startswith("own types"):
        assumed = replace(assumed, types=Clearheaded)
    monkeypatch.setitem(truncated_task.BATCH, "sweep", 1)

    def value(problem: AssistPOMDP, steps: int) -> np.ndarray:
        visits = AttentionSubproblem.of(problem, entry, steps)
        return qmdp(visits.pomdp, tolerance=1e-9).value_mdp[visits.pomdp.model.choices.initial]

    for steps in ways:
        exact, gaps = value(assumed.problem(Choices.of(table)), steps), []
        for size, seen in ((1, 0), (4, 0), (12, 0), (12, 30), (10_000, 20_000)):
            least = {"hidden": size, "hidden_least": size, "seen": seen, "tolerance": 1e-6, "sweeps": 10_000}
            monkeypatch.setattr(truncated_bound, "SIZES", replace(truncated_bound.SIZES, **least | sizes))
            gap = value(bounded(table, assumed, entry=entry, entry_steps=steps, size=size).problem, steps) - exact
            assert gap.min() > -1e-6
            gaps.append(gap.max())
        assert gaps[-1] <= gaps[1] + 1e-9
        if setting.execute:
            assert gaps[-1] < 1e-8
            assert gaps[1] > gaps[2] >= gaps[3] - 1e-9


def test_what_is_looked_at_as_a_whole_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """If the larger part is the whole task and sweeps converge, the bounds are the values."""
    sizes = replace(truncated_bound.SIZES, hidden=3, tolerance=1e-4, sweeps=10_000)
    monkeypatch.setattr(truncated_bound, "SIZES", sizes)
    problem, values, _ = part_and_whole("tiny", 100, Setting(c_suggest=0.2), somebody())
    frontier = problem.frontier
    assert frontier.away is not None
    np.testing.assert_allclose(frontier.away, values[:, 0], atol=1e-3)
    np.testing.assert_allclose(frontier.upper, values[:, 1], atol=1e-3)
    assert (values[:, 1] - values[:, 0]).max() > 0.3  # coming costs


@pytest.mark.parametrize("steps", [0, 2])
def test_prices_count_on_the_larger_part_at_their_steps(monkeypatch: pytest.MonkeyPatch, steps: int) -> None:
    """If it is the whole task, the values are those of the problem in which each state exists at every step.

    For a robot whose travel takes time they are upper bounds.
    """
    sizes = replace(truncated_bound.SIZES, hidden=3, tolerance=1e-6, sweeps=10_000)
    monkeypatch.setattr(truncated_bound, "SIZES", sizes)
    table, setting, human = kit("tiny"), Setting(c_suggest=0.2), somebody()
    found = bounded(table, Assumptions.of(setting, human, PRIOR), entry=ENTRY, size=100, outer="kept")
    assert found.between is not None
    price = np.array([0.0, 0.6, 0.3, 0.5])
    everything = Assumptions.of(setting, human, PRIOR).problem(found.outer.visits.alone.model.choices)
    whole = AttentionSubproblem.of(everything, ENTRY, steps, price)
    exact, layout = qmdp(whole.pomdp).value_mdp, whole.layout
    for around in (found.outer, found.between) if not steps else ():
        values = dict(around.priced(price))
        own = around.visits.layout.number(0, layout.position, layout.x)
        priced = np.array([values[step][state] for step, state in zip(layout.step.tolist(), own.tolist(), strict=True)])
        np.testing.assert_allclose(priced, exact, atol=1e-4)
        assert (values[len(price)] - values[0]).max() > 0.5

    kept = likely(found.problem, len(price), 6)
    free = qmdp(AttentionSubproblem.of(found.problem, ENTRY, steps).pomdp).value_mdp
    visits = found.outer.beyond(AttentionSubproblem.of(found.problem, ENTRY, steps, price, kept=kept), free)
    frontier, inner = visits.pomdp.frontier, visits.layout
    states = frontier.states
    assert 0 < found.problem.ends[inner.x[states]].sum() < len(states)  # some are only left out at their step
    x = found.outer.index[inner.x[states]]
    np.testing.assert_array_equal(
        found.outer.visits.alone.model.choices.keys[x], visits.pomdp.model.choices.keys[states]
    )
    expected = exact[layout.number(inner.step[states], inner.position[states], x)]
    if steps:
        assert (frontier.upper > expected - 1e-4).all()
    else:
        np.testing.assert_allclose(frontier.upper, expected, atol=1e-4)


def test_the_likeliest_states_at_each_step_are_kept() -> None:
    """Counted by hand: the visits of people with and without advice, at each step and later."""
    setting, human = Setting(), somebody()
    problem, _, _ = part_and_whole("tiny", 8, setting, human)
    choices, betas = problem.model.choices, range(len(problem.grid.beta))
    visits: dict[tuple[int, int], float] = dict.fromkeys(np.ndindex(4, len(choices)), 0.0)
    for b in betas:
        there = {choices.initial: float(problem.prior[b].sum())}
        for step in range(9):
            after: dict[int, float] = {}
            for x, chance in there.items():
                visits[min(step, 3), x] += chance
                if problem.ends[x]:
                    continue
                best = choices.optimal[x].sum()
                for slot in np.flatnonzero(choices.applicable[x]):
                    p = 0.7 * problem.chosen[x, slot, b] + 0.3 * choices.optimal[x, slot] / best
                    y = int(choices.targets[x, slot])
                    after[y] = after.get(y, 0.0) + chance * p
            there = after
    chances = np.array([0.0 if problem.ends[x] else chance for (_, x), chance in visits.items()])
    kept = likely(problem, 3, 9).ravel()
    assert kept.sum() == 9
    assert chances[kept].min() >= chances[~kept].max() - 1e-12
    assert kept[choices.initial]
    assert likely(problem, 3, 10**6).sum() == (chances > 0).sum()


def test_what_is_expected_beyond_is_known() -> None:
    """A suggestion changes trust by the person's expectation of its successor, inside the part or not."""
    setting, human = Setting(), somebody()
    problem, _, choices = part_and_whole("tiny", 3, setting, human)
    expected = perceived_value(choices, perceived_cost(choices, human.expects(choices)))
    place = {int(key): x for x, key in enumerate(choices.keys)}
    part = problem.model.choices
    inside = np.setdiff1d(np.arange(len(part)), problem.frontier.states)
    moved = 0
    for x in inside[~part.goal[inside]]:
        for action in range(1, int(problem.robot_actions[x])):
            y = part.targets[x, problem.suggested[x, action]]
            gain = expected[place[int(part.keys[y])]] - expected[place[int(part.keys[x])]]
            after = np.clip(problem.grid.theta + setting.eta * gain, 0.0, 1.0)
            low, weight = problem.grid.shares(after)
            np.testing.assert_allclose(
                problem.low[x, action, 0] + problem.weight[x, action, 0], low + weight, atol=1e-9
            )
            moved += y in problem.frontier.states
    assert moved > 0


def test_memory_is_asked_for_beforehand() -> None:
    with pytest.raises(LimitError, match=r"^bounding a person's value on \d+ states takes about \d+ MB"):
        bounded(
            kit("tiny"),
            Assumptions.of(Setting(), somebody(), PRIOR),
            entry=ENTRY,
            size=2,
            limits=BoundLimits(memory_mb=0.01),
        )


def test_where_memory_is_short_they_are_seen_on_a_smaller_part(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(truncated_bound, "SIZES", replace(truncated_bound.SIZES, hidden=3))
    table, who = kit("paper"), somebody()
    found = [
        bounded(
            table,
            Assumptions.of(Setting(), who, PRIOR),
            entry=ENTRY,
            size=10,
            outer="kept",
            limits=BoundLimits(memory_mb=most),
        ).outer
        for most in (math.inf, 3.0)
    ]
    large, small = found
    assert 10 < len(small.value) < len(large.value) / 2
    # Less is known on it, and no bound is lower.
    initial = [
        (one.value[one.visits.pomdp.model.choices.initial] * one.visits.pomdp.prior).sum() for one in (large, small)
    ]
    assert initial[0] < initial[1]


def test_they_are_hidden_on_as_many_states_as_time_and_memory_allow(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes = replace(truncated_bound.SIZES, hidden=40, hidden_least=5, pairs=300, pairs_least=50)
    monkeypatch.setattr(truncated_bound, "SIZES", sizes)
    looked_at, assumed = [], Assumptions.of(Setting(), somebody(), PRIOR)
    for limits in (BoundLimits(), BoundLimits(kept_mb=0.1), BoundLimits(kept_mb=4.0), BoundLimits(until=0.0)):
        found = bounded(kit("paper"), assumed, entry=ENTRY, size=50, outer="kept", limits=limits)
        looked_at.append([int((~found.problem.ends).sum()), found.pairs])
    everything, short, some, late = looked_at
    assert everything == [40, 300]
    assert short[0] == late[0] == 5
    assert 5 < some[0] < 40


def test_without_time_nobody_errs_beyond() -> None:
    """Without time the bounds are those of people who never err, which are always valid."""
    table, assumed = kit("tiny"), Assumptions.of(Setting(), somebody(), PRIOR)
    at_once, in_time = (
        bounded(table, assumed, entry=ENTRY, size=3, limits=BoundLimits(until)).problem for until in (0.0, math.inf)
    )
    hurried, bound = at_once.frontier, in_time.frontier
    anybody = never_erring(at_once.model.choices.h[hurried.states], table.task.costs, assumed.gamma)
    np.testing.assert_allclose(hurried.upper, np.broadcast_to(anybody[:, None, None], hurried.upper.shape))
    assert (bound.upper <= hurried.upper).all()
    assert (bound.upper < hurried.upper - 0.1).any()


def test_a_robot_that_may_mistake_the_state_considers_all_suggestions(monkeypatch: pytest.MonkeyPatch) -> None:
    """An action that is not optimal is better, due to the discount: the bound holds for a robot that suggests it."""
    monkeypatch.setattr(truncated_bound, "SIZES", BoundSizes(hidden=1, hidden_least=1, seen=2))
    roads = [
        (0, 1, 1),
        (1, 2, 1),
        (2, 9, 10),
        (2, 3, 1),
        (3, 4, 1),
        (4, 5, 1),
        (5, 6, 1),
        (6, 9, 8),
        (2, 7, 11),
        (7, 9, 1),
    ]
    table, people = sweep(graph_task(roads, goal=9)), Population(beta=(0.2, 0.3), theta=(1.0, 1.0))
    setting = Setting(
        knowledge="exact", c_suggest=0.01, gamma=0.6, trust="constant", observation=ObservationModel(miss=0.01)
    )
    pool = Pool.sample(table, 1, seed=1, setting=setting, population=people, states=1, region=1)
    ((_, one),) = pool.policies[0].problem.bounded(0.0)
    whole = solve(Assumptions.of(setting, None, people).problem(Choices.of(table)))
    assert solve(one.problem).upper >= whole.lower - 1e-9
    only_optimal = Assumptions.of(replace(setting, observation=None), None, people).problem(Choices.of(table))
    assert solve(only_optimal).upper < whole.lower - 1


GAMMA, LAPSE = 0.95, 0.02
ROBOT = OfRobots(c_suggest=0.3)


@declared
class Discounted(OfRobots):
    """A robot whose suggestions cost a tenth of what the setting says."""

    @property
    def costs(self) -> tuple[float, float, float]:
        return 0.0, 0.1 * self.c_suggest, self.c_execute


def compliant(
    task: str, human: Human | None, grid: Grid, eta: float, most: int, robot: OfRobots = ROBOT, **options: Any
) -> tuple[Any, Any, Any]:  # fmt: skip
    """Return the MDP values of some states, (m, B, T), the bound, (m, B), and the bound without errors."""
    table = kit(task)
    choices = Choices.of(table)
    known = {"eta": eta, "lapse": LAPSE}
    model = HumanModel.exact(choices, **known) if human is None else HumanModel.own(choices, human, **known)
    suggestions = "optimal" if options.get("optimal", True) else "all"
    pomdp = AssistPOMDP.of(model, grid=grid, gamma=GAMMA, robot=robot, suggestions=suggestions)
    states = breadth_first(table, np.array([table.initial]), most)
    assumed = Assumptions(human=human, gamma=GAMMA, robot=robot, lapse=LAPSE)
    found = compliance_bounds(table, states, grid.beta, assumed, **options)
    np.testing.assert_array_equal(found.at(states[::-1]), found.value[::-1])
    nobody_errs = never_erring(choices.h[states], table.task.costs, GAMMA)[:, None]
    return qmdp(pomdp).value_mdp[states], found.value, nobody_errs


@pytest.mark.parametrize(
    ("task", "most", "optimal", "known"),
    [
        ("sealed", 10**6, True, True),
        ("costs/ways", 10**6, True, True),
        ("tiny", 10**6, False, True),
        ("tiny", 12, True, False),
    ],
)
def test_nobody_gets_more_than_who_complies(task: str, most: int, optimal: bool, known: bool) -> None:
    """This holds for every theta, with dead ends, with free actions, and at the frontier of a part."""
    grid = Grid(np.array([0.0, 0.5, 3.0]), np.array([0.0, 0.3, 0.7, 1.0]))
    values, bound, nobody_errs = compliant(task, somebody() if known else None, grid, 0.2, most, optimal=optimal)
    assert (bound[:, :, None] >= values - 1e-6).all()
    assert (bound <= nobody_errs + 1e-9).all()
    assert (bound < nobody_errs - 0.3).any()  # it is known that they err
    assert (bound - values[:, :, 1]).max() > 0.2  # with a doubtful person the value is lower


def test_a_suggestion_costs_what_the_robot_says() -> None:
    grid, robot = Grid(np.array([0.0, 0.5]), np.array([0.0, 0.3, 1.0])), Discounted(c_suggest=3.0)
    values, bound, _ = compliant("tiny", None, grid, 0.0, 10**6, robot=robot)
    assert (bound[:, :, None] >= values - 1e-6).all()


def test_who_always_complies_gets_as_much() -> None:
    """If theta is always 1 and avoiding a suggestion never pays, the bound is the value."""
    grid = Grid(np.array([0.2, 2.0]), np.array([0.0, 1.0]))
    values, bound, _ = compliant("tiny", somebody(sigma=0.5), grid, 0.0, 10**6)
    np.testing.assert_allclose(bound, values[:, :, 1], atol=0.2)


def test_states_are_met_layer_by_layer() -> None:
    table = kit("tiny")
    layers = [np.array([table.initial])]
    for _ in range(3):
        targets = [table.choices(layers[-1]).targets]
        layers.append(np.unique(np.concatenate([layers[-1], *targets])))
    for layer in layers:
        np.testing.assert_array_equal(breadth_first(table, np.array([table.initial]), len(layer)), layer)
    assert len(breadth_first(table, layers[1], 1)) == len(layers[1])  # the given states are always included
    assert len(breadth_first(table, layers[0], 10**6)) == len(table)


def test_people_who_are_mistaken_about_actions_are_refused() -> None:
    (human,) = Population(noise="action").sample(None, 1, np.random.default_rng(0))
    with pytest.raises(ValueError, match="expected a person who is mistaken about states"):
        compliant("tiny", human, Grid(np.array([1.0]), np.array([0.0, 1.0])), 0.2, 10**6)
