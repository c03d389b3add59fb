"""Information relaxation: penalties have mean zero, and the search over a sample path is exact."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from conftest import invoke, kit
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq, linprog
from test_joint import COSTS, pool_of

from assist.certify import RelaxationOptions, upper_bound
from assist.certify.information_relaxation.belief_nodes import (
    END,
    LEFT,
    BeliefNodes,
    SampleGraph,
    bound_at,
    decompose,
    state_of,
)
from assist.certify.information_relaxation.confidence import SampledBound
from assist.certify.information_relaxation.congestion import Scale, lost
from assist.certify.information_relaxation.path_search import SamplePath
from assist.certify.information_relaxation.sampled_bound import InformationRelaxation
from assist.certify.prices import groups_of
from assist.person import Setting, solve
from assist.person.attention_subproblem import with_actions
from assist.team import Pool, simulate

PRICE = np.array([0.0, 0.3, 0.35, 0.3, 0.3, 0.2])
USUAL = RelaxationOptions()


def made(
    price: np.ndarray, workers: int = 1, pool: Pool | None = None, options: RelaxationOptions = USUAL, robots: int = 1
) -> InformationRelaxation:
    """Return the relaxation of two people; with several robots, of three, two of whom are alike."""
    pool = pool or pool_of(*COSTS[0])
    lattices = []
    with_outer = pool.policies[0].problem.region is not None
    for group in groups_of(pool, (0, 1), pool.setting.travel(2), len(price), with_outer=with_outer):
        visits = group.at(with_actions(price))
        lattices.append(BeliefNodes(visits, solve(visits.pomdp, gap=1e-3, best=group.best(visits))))
    people = [*lattices, lattices[0]] if robots > 1 else lattices
    return InformationRelaxation(people, price, workers=workers, options=options, robots=robots)


@pytest.fixture(scope="module")
def robot() -> InformationRelaxation:
    return made(PRICE)


@pytest.fixture(scope="module")
def without_prices() -> InformationRelaxation:
    return made(np.zeros(0))


def drawn(robot: InformationRelaxation, seeds: Iterable[int]) -> list[SamplePath]:
    return robot.paths([np.random.default_rng(seed) for seed in seeds])


@pytest.fixture(scope="module")
def paths(robot: InformationRelaxation) -> list[SamplePath]:
    return drawn(robot, range(4))


def belief_at(lattice: BeliefNodes, node: int) -> np.ndarray:
    known, size = lattice.known, lattice.known.corner.shape[1]
    if node >= len(known.drop):
        return np.eye(size)[(node - len(known.drop)) % size]
    return known.point[node] / known.point[node].sum()


def chances(lattice: BeliefNodes, edge: int) -> dict[int, float]:
    """Return the probability of each successor node."""
    ends = slice(lattice.nodes.begin[edge], lattice.nodes.begin[edge + 1])
    found: dict[int, float] = {}
    for to, share in zip(lattice.nodes.to[ends], np.diff(lattice.nodes.share[ends], prepend=0.0), strict=True):
        found[int(to)] = found.get(int(to), 0.0) + float(share)
    return found


def test_what_a_belief_is_divided_among_adds_up_to_it(robot: InformationRelaxation, paths: list[SamplePath]) -> None:
    """The filter's own probabilities, multiplied with the nodes after an action, give the joint distribution."""
    lattice, graph = robot.people[0].belief_nodes, paths[0][0][0]
    pomdp = lattice.visits.pomdp
    split = 0
    for node in graph.node[:40].tolist():
        first, x = lattice.nodes.first[node], int(state_of(node, lattice.known))
        if first < 0:
            continue
        belief = belief_at(lattice, node).reshape(pomdp.grid.shape)
        for r in range(pomdp.robot_actions[x]):
            found, expected, promise = chances(lattice, first + r), {}, -float(pomdp.robot_costs[x, r])
            place = pomdp.afterstate[x, r]
            for a in np.flatnonzero(pomdp.model.choices.applicable[place]):
                one = (np.array([x]), np.array([r]), np.array([a]))
                chance = float((pomdp.likelihood(*one)[0] * belief).sum())
                after = pomdp.update(belief[None], *one)[0]
                y = int(pomdp.model.choices.targets[place, a])
                promise -= chance * float(pomdp.model.choices.costs[place, a])
                if not pomdp.model.choices.goal[y]:
                    expected[y] = expected.get(y, 0.0) + chance * after.reshape(-1)
            mixed = {y: np.zeros(pomdp.prior.size) for y in expected}
            for to, chance in found.items():
                if to != END:
                    mixed[int(state_of(to, lattice.known))] += chance * belief_at(lattice, to)
                    promise += pomdp.gamma * chance * bound_at(to, lattice.known)
            for y, whole in expected.items():
                np.testing.assert_allclose(mixed[y], whole, atol=1e-9)
            split += len(found) > len(expected) + 1
            regret = bound_at(node, lattice.known) - promise
            assert lattice.nodes.regret[first + r] == pytest.approx(regret, abs=1e-9)
    assert split > 10  # beliefs were divided


@pytest.mark.parametrize("free", [False, True])
def test_the_penalty_has_mean_zero(
    free: bool, robot: InformationRelaxation, without_prices: InformationRelaxation
) -> None:
    """The mean of U over both people's next actions equals the value in the search."""
    compared = []
    robot = without_prices if free else robot
    for path in drawn(robot, range(4)):
        graphs, wishes = path.graphs, path.demand
        for t in range(min(4, *(len(graph.layer) - 2 for graph in graphs))):
            edges, after = [], []
            for person, graph in zip(robot.people, graphs, strict=True):
                j = int(graph.layer[t])
                edge = int(graph.edge[j + 1]) - 1
                edges.append(edge)
                lattice = person.belief_nodes
                number = lattice.nodes.first[graph.node[j]] + edge - graph.edge[j]
                after.append(chances(lattice, number))
            mean = np.array([wish.mean[edge] for wish, edge in zip(wishes, edges, strict=True)])
            total = 0.0
            for ends in product(*(some.items() for some in after)):
                rows = [
                    person.rows.row[person.rows.of[to] if to != END else 0]
                    for person, (to, _) in zip(robot.people, ends, strict=True)
                ]
                total += math.prod(chance for _, chance in ends) * lost(t + 1, np.array(rows), robot.scale)
            compared.append(total)
            assert lost(t + 1, mean, robot.scale) == pytest.approx(total, abs=1e-9)
    assert max(compared) > 0.05


def test_nobody_gains_by_a_conflict(robot: InformationRelaxation) -> None:
    """The loss in each step is nonnegative, which the search assumes for its discounting of later steps."""
    steps, rng, found = len(robot.scale.weight), np.random.default_rng(0), []
    for s in range(steps):
        nodes = [np.flatnonzero(person.rows.depth > s) for person in robot.people]
        rows = [person.rows.row[person.rows.of[own]] for person, own in zip(robot.people, nodes, strict=True)]
        for own in rows:
            own[:, (s + 1) * robot.scale.size :] = 0.0  # not worked out for all of them
        one = robot.scale._replace(weight=np.eye(steps)[s])
        for _ in range(200):
            met = np.array([own[rng.integers(len(own))] for own in rows + rows])
            found.append(lost(0, met, one))
    assert min(found) >= -1e-9
    assert max(found) > 0.5


def test_later_conflicts_count_less() -> None:
    """U is the discounted sum of the losses in the steps ahead; by hand for two people who want the robot at once."""
    scale = Scale.of(np.array([0.3, 0.2]), 0.9, 1.0, USUAL)
    rows = np.zeros((2, 2 * scale.size))
    rows.reshape(2, 2, -1)[:, :, 4:-1] = 1.0  # both want it at 0.5 above its price, in both steps
    rows.reshape(2, 2, -1)[:, :, -1] = 0.5
    each = 0.5  # two times 0.5 above the price, and one is served: lambda + 0.5 + 0.5 - (lambda + 0.5)
    assert lost(0, rows, scale) == pytest.approx(each + USUAL.fading * 0.9 * each)
    assert lost(1, rows, scale) == pytest.approx(0.9 * each)


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 5), st.lists(st.floats(0, 1), min_size=1, max_size=5), st.floats(0, 2))
def test_a_step_loses_what_fewer_robots_than_people_cannot_do(robots: int, below: list[float], price: float) -> None:
    """U of one step equals the mean over all combinations of people who need a robot at 0.5 above its price."""
    scale = Scale.of(np.array([price]), 0.9, 1.0, USUAL, robots)
    rows = np.zeros((len(below), scale.size))
    rows[:, 4:-1] = 1.0
    rows[:, 1:4] = np.array(below)[:, None]
    rows[:, -1] = 0.5 * (1 - np.array(below))
    expected = robots * price - min(robots, len(below)) * price + rows[:, -1].sum()
    for need in product([0, 1], repeat=len(below)):
        expected -= 0.5 * min(robots, sum(need)) * np.where(need, 1 - np.array(below), below).prod()
    assert lost(0, rows, scale) == pytest.approx(expected, abs=1e-9)


def test_late_conflicts_never_count_in_full() -> None:
    """Two people want the robot at once in each step of a long episode; late steps count less, however near they
    are.
    """
    full = USUAL.full_weight_steps
    scale = Scale.of(np.zeros(full + 4), 1.0, 1.0, USUAL)
    rows = np.zeros((2, len(scale.weight) * scale.size))
    rows.reshape(2, -1, scale.size)[:, 0, 4:-1] = 1.0  # both want it at 0.5 now, and nothing afterwards
    rows.reshape(2, -1, scale.size)[:, 0, -1] = 0.5
    rows.reshape(2, -1, scale.size)[:, 1:, :-1] = 1.0
    assert [lost(step, rows, scale) for step in range(full - 1, full + 4)] == pytest.approx(
        [0.5, 0.5, *(0.5 * np.exp(-np.arange(1, 4) / USUAL.decay_steps))]
    )


def test_a_belief_is_divided_so_that_least_is_promised(robot: InformationRelaxation) -> None:
    """The linear program confirms that no other weights of the known nodes have a smaller mean of bounds."""
    lattice, rng, spread = robot.people[0].belief_nodes, np.random.default_rng(0), 0
    known, size = lattice.known, lattice.known.corner.shape[1]
    part, node = np.empty(2 * size), np.empty(2 * size, dtype=np.int64)
    for x in np.argsort(-np.diff(known.first))[:10].tolist():
        points = slice(known.first[x], known.first[x + 1])
        for belief in rng.dirichlet(np.ones(size), 12):
            count = decompose(belief, x, known, part, node)
            found = sum(p * bound_at(n, known) for p, n in zip(part[:count], node[:count].tolist(), strict=True))
            best = linprog(known.drop[points], A_ub=known.point[points].T, b_ub=belief)
            assert found == pytest.approx(float(known.corner[x] @ belief) + best.fun, abs=1e-4)
            spread += np.sum(node[:count] < len(known.drop)) > 1
    assert spread > 10


def least(
    robot: InformationRelaxation,
    path: SamplePath,
    alpha: float,
    state: tuple[int, ...],
    t: int,
    seen: dict[tuple[int, ...], float],
) -> float:
    """Return the least sum of D from a state on, by enumeration."""
    graphs, wishes = path.graphs, path.demand
    if (t, *state) in seen:
        return seen[t, *state]

    def loss(step: int, rows: list[np.ndarray]) -> float:
        return alpha * float(lost(step, np.array(rows), robot.scale))

    people = robot.people
    ended = {END: 0, LEFT: 1}
    here = [p.rows.row[w.of[j] if j >= 0 else ended[j]] for p, w, j in zip(people, wishes, state, strict=True)]
    paid, unpaid = robot.price * robot.discount, max(0, robot.robots - state.count(LEFT))
    if all(j < 0 for j in state):
        return unpaid * float(paid[t:].sum()) - loss(t, here)
    if t == robot.steps:
        return -loss(t, here)

    def edges(graph: SampleGraph, j: int) -> list[int]:
        return [j] if j < 0 else list(range(graph.edge[j], graph.edge[j + 1]))

    best = np.inf
    for chosen in product(*(edges(graph, j) for graph, j in zip(graphs, state, strict=True))):
        with_robot = sum(bool(g.attends[e]) for g, e in zip(graphs, chosen, strict=True) if e >= 0)
        if with_robot > robot.robots:
            continue
        cost = max(0, unpaid - with_robot) * paid[t] - loss(t, here)
        cost += sum(float(g.cost[e]) for g, e in zip(graphs, chosen, strict=True) if e >= 0)
        after = [w.mean[e] if e >= 0 else p.rows.row[ended[e]] for p, w, e in zip(people, wishes, chosen, strict=True)]
        cost += loss(t + 1, after)
        then = tuple(int(g.to[e]) if e >= 0 else e for g, e in zip(graphs, chosen, strict=True))
        best = min(best, cost + least(robot, path, alpha, then, t + 1, seen))
    seen[t, *state] = best
    return best


@cache
def of_few_steps(name: str) -> InformationRelaxation:
    """Return a relaxation with few enough steps to enumerate all decisions."""
    if not name.startswith("truncated"):
        counted, ahead, robots = OF_FEW_STEPS[name]
        options = RelaxationOptions(free_steps=1, congestion_steps=counted, steps_ahead=ahead)
        return made(PRICE[1:4], options=options, robots=robots)
    setting = Setting(gamma=0.95, c_suggest=0.05, c_move=0.1)
    pool = Pool.sample(kit("tiny"), 2, seed=0, setting=setting, states=3, region=1)
    return made(PRICE[1:4], pool=pool, options=RelaxationOptions(free_steps=1), robots=1 + name.endswith("2"))


OF_FEW_STEPS = {"all": (12, 12, 1), "first two": (2, 2, 1), "two ahead": (12, 2, 1), "two robots": (12, 12, 2)}
"""In how many steps conflicts count, how many steps ahead, and the number of robots."""


@pytest.mark.parametrize("alpha", [0.75, pytest.param(0.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", [*OF_FEW_STEPS, "truncated, 1", "truncated, 2"])
def test_the_search_finds_the_least(name: str, alpha: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """The search equals enumeration; if it stops early, its bound is not lower.

    As many robots as people have left truncated tasks are not refunded the prices of steps without a person.
    """
    robot, found, given_up, left = of_few_steps(name), [], 0, 0
    for seed in range(3 if name == "two robots" else 6):
        (path,) = drawn(robot, [seed])
        left += any((graph.to == LEFT).any() for graph in path.graphs)
        whole = least(robot, path, alpha, (0,) * len(robot.people), 0, {})
        bound = robot.bound(path, alpha)
        assert bound == pytest.approx(robot.value - alpha * robot.lost - whole, abs=1e-9)
        with monkeypatch.context() as patch:
            patch.setattr(robot, "options", replace(robot.options, max_expansions=4))
            early = robot.bound(path, alpha)
        assert early >= bound - 1e-9
        given_up += early > bound + 1e-3
        found.append(whole)
    if name.startswith("truncated"):
        assert left > 2
    else:
        assert np.ptp(found) > 0.01
        assert given_up


@pytest.mark.slow
@pytest.mark.parametrize(("cost", "region"), [(0.0, 1), (0.05, 4)])
def test_sampled_bounds_of_truncated_tasks_are_not_below_what_priority_gets(cost: float, region: int) -> None:
    """With prices, priority is computed on the whole task for the same people.

    A bound that refunds the prices of people who have left is too low: by 1.8 for six people, region 1 and no costs.
    """
    setting = Setting(c_suggest=cost, c_move=cost)
    whole = Pool.sample(kit("tiny"), 4, seed=0, setting=setting)
    run = simulate(whole, "priority", humans=[0, 1, 2, 3], episodes=3000, seed=0, world="model")
    value, error = run.discounted_return.mean(), run.discounted_return.std(ddof=1) / np.sqrt(len(run))
    pool = Pool.sample(kit("tiny"), 4, seed=0, setting=setting, states=5, region=region)
    bound = upper_bound(pool, window=8, gap=0.1, paths=4, jobs=1)
    assert len(bound.price) > 3
    assert bound.proven >= value - 4 * error
    assert bound.sampled.mean + 4 * bound.sampled.stderr >= value - 4 * error


def test_prices_are_paid_in_steps_whose_conflicts_do_not_count() -> None:
    """Each person's bound is at these prices, so the team's bound is their sum plus the sum of the prices."""
    robot = of_few_steps("first two")
    lattices = [person.belief_nodes for person in robot.people]
    gamma = lattices[0].relaxed.m.gamma
    paid = sum(gamma**step * price for step, price in enumerate((0.3, 0.35, 0.3)))
    assert robot.value == pytest.approx(paid + sum(lattice.value for lattice in lattices), abs=1e-12)


@pytest.mark.slow
def test_a_bound_from_samples_is_named_beside_the_proven_one() -> None:
    """The command says which bound holds with certainty, and with which confidence the other does."""
    setting = ("--c-suggest", 0.1, "--c-move", 0.2, "--set", "knowledge=exact", "--set", "gamma=0.9")
    for paths, confidence in ((4, 1.0), (30, 0.95)):
        options = ("--policy", "none", "--value-episodes", 50, "--gap", 0.05, "--samples", paths, "--json")
        found = json.loads(invoke("bound", "kitting/tiny", "--humans", 2, *setting, *options).stdout)
        sampled = SampledBound(**found["sampled"]).upper
        assert (found["sampled"]["paths"], found["confidence"]) == (paths, confidence)
        assert sampled < found["upper_proven"]
        assert found["upper"] == pytest.approx(sampled if paths == 30 else found["upper_proven"], abs=1e-9)


@pytest.mark.parametrize(("skewness", "paths"), [(0.0, 2), (-2.0, 11), (0.3, 30), (1.0, 40), (2.0, 100), (6.0, 30)])
def test_a_skewed_mean_has_the_bound_at_which_halls_cubic_is_students_t(skewness: float, paths: int) -> None:
    """Numbers of standard errors above the mean, from a table of Student's t; two paths give a very wide interval."""
    from_table = {2: 31.821, 11: 2.764, 30: 2.4620, 40: 2.4258, 100: 2.3646}[paths]

    def cubic(w: float) -> float:
        g = skewness
        return w + g * w**2 / 3 + g**2 * w**3 / 27 + g / (6 * paths) + from_table / math.sqrt(paths)

    above = -brentq(cubic, -50, 1) * math.sqrt(paths) if skewness > 0 else from_table
    sampled = SampledBound(-9.0, 0.5, paths, 0.3, skewness)
    assert sampled.upper == pytest.approx(-9.0 + 0.5 * above, abs=1e-3)
    assert above > from_table or skewness <= 0


def test_the_correction_for_skewness_misses_less_often_than_students_t() -> None:
    """Means of a distribution with a long tail above, known by its formula; Student's t alone misses too often."""
    rng, seeds, mean = np.random.default_rng(0), 2000, math.exp(0.5)
    found = [SampledBound.of(rng.lognormal(size=30).tolist(), 30, 0.0) for _ in range(seeds)]
    missed = np.mean([one.upper < mean for one in found])
    student = np.mean([one.mean + 2.462 * one.stderr < mean for one in found])
    assert missed < 0.75 * student
    small = [SampledBound.of(rng.gamma(2.0, size=30).tolist(), 30, 0.0) for _ in range(seeds)]
    assert np.mean([one.upper < 2.0 for one in small]) <= 0.05 + 3 * math.sqrt(0.05 * 0.95 / seeds)


def test_alpha_is_chosen_on_two_lucks_at_least(robot: InformationRelaxation, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two paths are used even without time, since on a single one the choice would adapt to that path."""
    robot.sampled(2, 0)  # the wishes after these paths take time too
    drawn, paths = [], robot.paths
    monkeypatch.setattr(robot, "paths", lambda of: drawn.extend(of) or paths(of))
    monkeypatch.setattr(robot, "left", lambda _: -0.2)
    assert robot.sampled(10, 0).paths == 2
    assert len(drawn) == 2 + 2
    monkeypatch.setattr(robot, "left", lambda _: -0.3)  # more than a quarter too late
    with pytest.raises(TimeoutError):
        robot.sampled(10, 0)


def test_the_paths_of_a_bound_do_not_decide_on_their_number(
    robot: InformationRelaxation, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Paths that take long are worse here: left out where the time ends, they would make the bound too low."""
    rng, clock = np.random.default_rng(0), [0.0]
    long: dict[int, bool] = {}

    def bounds(paths: Sequence[int], _alpha: float) -> list[float]:
        for path in paths:
            clock[0] += 3.0 if long.setdefault(path, rng.random() < 0.3) else 1.0
        return [-50.0 + 10.0 * long[path] for path in paths]

    monkeypatch.setattr(robot, "paths", lambda of: [int(one.integers(2**62)) for one in of])
    monkeypatch.setattr(robot, "_bounds", bounds)
    monkeypatch.setattr(robot, "left", lambda _: 1 - clock[0] / 100)
    found = []
    for seed in range(400):
        clock[0] = 0.0
        with suppress(TimeoutError):
            found.append(robot.sampled(30, seed))
    assert len(found) > 380
    assert all(2 <= one.paths <= 30 for one in found)
    every = np.array([one.mean for one in found])
    assert every.mean() == pytest.approx(-47.0, abs=4 * every.std() / math.sqrt(len(every)))


@pytest.mark.parametrize("best", range(len(USUAL.alphas)))
def test_alpha_is_best_on_lucks_of_its_own(
    best: int, robot: InformationRelaxation, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The levels of the values do not matter, only which bound has the lowest mean on the same sample paths."""
    tried: list[tuple[float, int]] = []

    def bounds(paths: Sequence[SamplePath], alpha: float) -> list[float]:
        """Return bounds that are lowest at `best` on average, but at another alpha on some paths."""
        tried.append((alpha, len(paths)))
        far = abs(USUAL.alphas.index(alpha) - best)
        return [(-50.0, -58.0)[luck % 2] + (far if luck % 5 < 4 else -2 * far) for luck in range(len(paths))]

    monkeypatch.setattr(robot, "paths", lambda of: [[] for _ in of])
    monkeypatch.setattr(robot, "_bounds", bounds)
    assert robot.sampled(100, 0).alpha == USUAL.alphas[best]
    pilot = [alpha for alpha, lucks in tried if lucks == 10]
    assert len(pilot) == len(set(pilot)) <= abs(USUAL.alphas.index(0.45) - best) + 3  # the other side costs nothing


def test_what_is_sampled_does_not_depend_on_how_many_work_at_a_time() -> None:
    found = [made(PRICE, workers).sampled(7, 0) for workers in (1, 3)]
    assert found[0] == found[1]
    assert found[0].paths == 7


def test_a_time_limit_holds_while_wishes_are_worked_out(
    robot: InformationRelaxation, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There is no bound if the time ends before all paths were evaluated whose number the pilot has decided."""
    asked = iter((1.0, 1.0, 1.0, 0.0))
    with pytest.raises(TimeoutError):
        InformationRelaxation(
            [person.belief_nodes for person in robot.people],
            PRICE,
            left=lambda _: next(asked),
            options=RelaxationOptions(rows_per_check=20),
        )
    assert list(asked) == []  # it went on while there was time

    def sampled(draws: int) -> int:
        """Let time end after a number of draws, of which two serve for the choice of alpha."""
        paths, drawn = robot.paths, []

        def until(generators: list[np.random.Generator]) -> list[SamplePath]:
            drawn.extend(generators)
            if len(drawn) > draws:
                raise TimeoutError
            return paths(generators)

        with monkeypatch.context() as patch:
            patch.setattr(robot, "paths", until)
            return robot.sampled(6, 0).paths

    assert sampled(2 + 6) == 6
    for draws in (1, 3, 7):
        with pytest.raises(TimeoutError):
            sampled(draws)
