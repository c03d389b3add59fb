"""Penalties have mean zero, and the search over what can come about with a luck misses nothing."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from itertools import product

import numpy as np
import pytest
from conftest import KITTING, invoke, kit
from scipy.optimize import brentq, linprog
from test_joint import COSTS, pool_of

from assist.certify.information_relaxation import congestion, sampled_bound
from assist.certify.information_relaxation.belief_nodes import END, LEFT, BeliefNodes, SampleGraph, at, divide, worth
from assist.certify.information_relaxation.confidence import SampledBound
from assist.certify.information_relaxation.congestion import DYING, FADING, LATE, OutOfTimeError, Scale, lost
from assist.certify.information_relaxation.sampled_bound import ALPHAS, InformationRelaxation, SamplePath
from assist.certify.prices import kinds_of
from assist.certify.team_bound import upper_bound
from assist.cli.output.person_bounds import show_samples
from assist.person.solver import solve
from assist.simulation.pool import Pool
from assist.simulation.simulate import simulate
from assist.team.settings import Setting

PRICE = np.array([0.0, 0.3, 0.35, 0.3, 0.3, 0.2])


def made(price: np.ndarray, workers: int = 1, pool: Pool | None = None) -> InformationRelaxation:
    pool = pool or pool_of(*COSTS[0])
    lattices = []
    for kind in kinds_of(pool, (0, 1), pool.setting.travel(2), len(price), around=pool.truncated):
        visits = kind.at(price)
        lattices.append(BeliefNodes(visits, solve(visits.pomdp, gap=1e-3, best=kind.best(visits))))
    return InformationRelaxation(lattices, price, workers=workers)


@pytest.fixture(scope="module")
def robot() -> InformationRelaxation:
    return made(PRICE)


@pytest.fixture(scope="module")
def without_prices() -> InformationRelaxation:
    return made(np.zeros(0))


@pytest.fixture(scope="module", params=[(12, 12), (2, 2), (12, 2)])
def short_sighted(request: pytest.FixtureRequest) -> InformationRelaxation:
    """With so few steps that everything can be tried; conflicts count in all of them, in the first two, two ahead."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sampled_bound, "AFTER", 1)
        patch.setattr(sampled_bound, "WISHES", request.param[0])
        patch.setattr(congestion, "AHEAD", request.param[1])
        return made(PRICE[1:4])


@pytest.fixture(scope="module")
def truncated() -> InformationRelaxation:
    """Two people whose tasks are truncated after one state, with prices, and few enough steps to try everything."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sampled_bound, "AFTER", 1)
        setting = Setting(gamma=0.95, c_suggest=0.05, c_move=0.1)
        return made(PRICE[1:4], pool=Pool.sample(kit("tiny"), 2, seed=0, setting=setting, states=3, region=1))


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
    """The chance of each node that may follow."""
    ends = slice(lattice.nodes.begin[edge], lattice.nodes.begin[edge + 1])
    found: dict[int, float] = {}
    for to, share in zip(lattice.nodes.to[ends], np.diff(lattice.nodes.share[ends], prepend=0.0), strict=True):
        found[int(to)] = found.get(int(to), 0.0) + float(share)
    return found


def test_what_a_belief_is_divided_among_adds_up_to_it(robot: InformationRelaxation, paths: list[SamplePath]) -> None:
    """By the filter's own chances: nodes after an action, times their chances, are the joint of choice and type."""
    lattice, graph = robot.people[0].lattice, paths[0][0][0]
    pomdp = lattice.visits.pomdp
    split = 0
    for node in graph.node[:40].tolist():
        first, x = lattice.nodes.first[node], int(at(node, lattice.known))
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
                    mixed[int(at(to, lattice.known))] += chance * belief_at(lattice, to)
                    promise += pomdp.gamma * chance * worth(to, lattice.known)
            for y, whole in expected.items():
                np.testing.assert_allclose(mixed[y], whole, atol=1e-9)
            split += len(found) > len(expected) + 1
            regret = worth(node, lattice.known) - promise
            assert lattice.nodes.regret[first + r] == pytest.approx(regret, abs=1e-9)
    assert split > 10  # beliefs were divided


@pytest.mark.parametrize("free", [False, True])
def test_the_penalty_has_mean_zero(
    free: bool, robot: InformationRelaxation, without_prices: InformationRelaxation
) -> None:
    """The mean of U over all that two people may do next is what the search takes for it."""
    compared = []
    robot = without_prices if free else robot
    for path in drawn(robot, range(4)):
        graphs, wishes = path.graphs, path.wishes
        for t in range(min(4, *(len(graph.layer) - 2 for graph in graphs))):
            edges, after = [], []
            for person, graph in zip(robot.people, graphs, strict=True):
                j = int(graph.layer[t])
                edge = int(graph.edge[j + 1]) - 1
                edges.append(edge)
                lattice = person.lattice
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
    """What is lost in each step is nothing at least: the search takes that for granted where later steps count less."""
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
    """U is the sum over steps ahead of what is lost in each, by hand for two people who want the robot at once."""
    scale = Scale.of(np.array([0.3, 0.2]), 0.9, 1.0)
    rows = np.zeros((2, 2 * scale.size))
    rows.reshape(2, 2, -1)[:, :, 4:-1] = 1.0  # both want it at 0.5 above its price, in both steps
    rows.reshape(2, 2, -1)[:, :, -1] = 0.5
    each = 0.5  # two times 0.5 above the price, and one is served: lambda + 0.5 + 0.5 - (lambda + 0.5)
    assert lost(0, rows, scale) == pytest.approx(each + FADING * 0.9 * each)
    assert lost(1, rows, scale) == pytest.approx(0.9 * each)


def test_late_conflicts_never_count_in_full() -> None:
    """However near they are: two people who want the robot at once in any step of a long episode."""
    scale = Scale.of(np.zeros(LATE + 4), 1.0, 1.0)
    rows = np.zeros((2, len(scale.weight) * scale.size))
    rows.reshape(2, -1, scale.size)[:, 0, 4:-1] = 1.0  # both want it at 0.5 now, and nothing afterwards
    rows.reshape(2, -1, scale.size)[:, 0, -1] = 0.5
    rows.reshape(2, -1, scale.size)[:, 1:, :-1] = 1.0
    assert [lost(step, rows, scale) for step in range(LATE - 1, LATE + 4)] == pytest.approx(
        [0.5, 0.5, *(0.5 * np.exp(-np.arange(1, 4) / DYING))]
    )


def test_a_belief_is_divided_so_that_least_is_promised(robot: InformationRelaxation) -> None:
    """Among nodes that are known, by the linear program: no other parts make a smaller mean of bounds."""
    lattice, rng, spread = robot.people[0].lattice, np.random.default_rng(0), 0
    known, size = lattice.known, lattice.known.corner.shape[1]
    part, node = np.empty(2 * size), np.empty(2 * size, dtype=np.int64)
    for x in np.argsort(-np.diff(known.first))[:10].tolist():
        points = slice(known.first[x], known.first[x + 1])
        for belief in rng.dirichlet(np.ones(size), 12):
            count = divide(belief, x, known, part, node)
            found = sum(p * worth(n, known) for p, n in zip(part[:count], node[:count].tolist(), strict=True))
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
    """The least sum of D from a state on, by trying everything."""
    graphs, wishes = path.graphs, path.wishes
    if (t, *state) in seen:
        return seen[t, *state]

    def loss(step: int, rows: list[np.ndarray]) -> float:
        return alpha * float(lost(step, np.array(rows), robot.scale))

    people = robot.people
    ended = {END: 0, LEFT: 1}
    here = [p.rows.row[w.of[j] if j >= 0 else ended[j]] for p, w, j in zip(people, wishes, state, strict=True)]
    paid = robot.price * robot.discount * (LEFT not in state)
    if all(j < 0 for j in state):
        return float(paid[t:].sum()) - loss(t, here)
    if t == robot.steps:
        return -loss(t, here)

    def edges(graph: SampleGraph, j: int) -> list[int]:
        return [j] if j < 0 else list(range(graph.edge[j], graph.edge[j + 1]))

    best = np.inf
    for chosen in product(*(edges(graph, j) for graph, j in zip(graphs, state, strict=True))):
        with_robot = sum(bool(g.attends[e]) for g, e in zip(graphs, chosen, strict=True) if e >= 0)
        if with_robot > 1:
            continue
        cost = (1 - with_robot) * paid[t] - loss(t, here)
        cost += sum(float(g.cost[e]) for g, e in zip(graphs, chosen, strict=True) if e >= 0)
        after = [w.mean[e] if e >= 0 else p.rows.row[ended[e]] for p, w, e in zip(people, wishes, chosen, strict=True)]
        cost += loss(t + 1, after)
        then = tuple(int(g.to[e]) if e >= 0 else e for g, e in zip(graphs, chosen, strict=True))
        best = min(best, cost + least(robot, path, alpha, then, t + 1, seen))
    seen[t, *state] = best
    return best


@pytest.mark.parametrize("alpha", [0.0, 0.75])
def test_the_search_finds_the_least(
    alpha: float, short_sighted: InformationRelaxation, monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    """All that can be done is tried; and where the search is given up, the bound is not below."""
    robot, found, given_up = short_sighted, [], 0
    for seed in range(6):
        (path,) = drawn(robot, [seed])
        whole = least(robot, path, alpha, (0, 0), 0, {})
        bound = robot.bound(path, alpha)
        assert bound == pytest.approx(robot.value - alpha * robot.lost - whole, abs=1e-9)
        with monkeypatch.context() as patch:
            patch.setattr(sampled_bound, "POPPED", 4)
            early = robot.bound(path, alpha)
        assert early >= bound - 1e-9
        given_up += early > bound + 1e-3
        found.append(whole)
    assert np.ptp(found) > 0.05
    assert given_up


@pytest.mark.parametrize("alpha", [0.0, 0.75])
def test_the_search_finds_the_least_where_people_leave_truncated_tasks(
    alpha: float, truncated: InformationRelaxation
) -> None:
    """Once a person has left, steps in which the robot attends to no other person are not refunded."""
    left = 0
    for path in drawn(truncated, range(6)):
        whole = least(truncated, path, alpha, (0, 0), 0, {})
        expected = truncated.value - alpha * truncated.lost - whole
        assert truncated.bound(path, alpha) == pytest.approx(expected, abs=1e-9)
        left += any((graph.to == LEFT).any() for graph in path.graphs)
    assert left > 2


@pytest.mark.parametrize(("cost", "region"), [(0.0, 1), (0.05, 4)])
def test_sampled_bounds_of_truncated_tasks_are_not_below_what_priority_gets(cost: float, region: int) -> None:
    """With prices: priority is worked out on the whole task, for the same people.

    A bound that refunds the prices of people who have left is below: by 1.8 for six people, region 1 and no costs.
    """
    setting = Setting(c_suggest=cost, c_move=cost)
    whole = Pool.sample(kit("tiny"), 4, seed=0, setting=setting)
    run = simulate(whole, "priority", humans=[0, 1, 2, 3], episodes=4000, seed=0, world="model")
    value, error = run.discounted_return.mean(), run.discounted_return.std(ddof=1) / np.sqrt(len(run))
    pool = Pool.sample(kit("tiny"), 4, seed=0, setting=setting, states=5, region=region)
    bound = upper_bound(pool, window=10, gap=0.05, paths=6, jobs=1)
    assert bound.sampled is not None
    assert len(bound.price) > 3
    assert bound.proven >= value - 4 * error
    assert bound.sampled.mean + 4 * bound.sampled.stderr >= value - 4 * error


def test_prices_are_paid_in_steps_whose_conflicts_do_not_count(short_sighted: InformationRelaxation) -> None:
    """Each person's bound is at these prices, so that the team's is theirs and all that the prices come to."""
    lattices = [person.lattice for person in short_sighted.people]
    gamma = lattices[0].arrays.gamma
    paid = sum(gamma**step * price for step, price in enumerate((0.3, 0.35, 0.3)))
    assert short_sighted.value == pytest.approx(paid + sum(lattice.value for lattice in lattices), abs=1e-12)


def test_sample_paths_on_the_command_line() -> None:
    result = invoke(
        "bound", str(KITTING / "tiny.pddl"), "--humans", "2", "--c-suggest", "0.1", "--c-move", "0.2",
        "--episodes", "500", "--policy", "priority", "--paths", "30", "--time-limit", "3600", "--json",
    )  # fmt: skip
    assert result.exit_code == 0, result.stderr
    document = json.loads(result.stdout)
    sampled, errors = document["sampled"], 2.462  # Student's t of 29 degrees of freedom, from a table
    assert (sampled["paths"], document["confidence"]) == (30, 0.95)
    assert document["upper"] >= sampled["mean"] + errors * sampled["stderr"] - 1e-3
    assert document["upper"] < document["upper_proven"]


def test_too_few_sample_paths_give_no_bound(capsys: pytest.CaptureFixture[str]) -> None:
    """Their mean is reported, and what is proven is the bound."""
    bound = upper_bound(pool_of(*COSTS[0]), window=4, gap=0.05, paths=5, jobs=1)
    assert bound.sampled is not None
    assert (bound.sampled.paths, bound.upper) == (5, bound.proven)
    show_samples(bound)
    assert "5 sample paths are too few for a bound; 30 are needed" in capsys.readouterr().out


def test_few_paths_say_less() -> None:
    """Standard errors above the mean, from a table of Student's t; two paths hardly say anything."""
    for paths, errors in ((2, 31.821), (3, 6.965), (11, 2.764), (100_000, 2.326)):
        assert SampledBound(-9.0, 0.5, paths, 0.3).upper == pytest.approx(-9.0 + 0.5 * errors, abs=1e-3)
        assert SampledBound(-9.0, 0.5, paths, 0.3, skewness=-2.0).upper == pytest.approx(-9.0 + 0.5 * errors, abs=1e-3)


@pytest.mark.parametrize(("skewness", "paths"), [(0.3, 30), (1.0, 40), (2.0, 100), (6.0, 30)])
def test_a_skewed_mean_has_the_bound_at_which_halls_cubic_is_students_t(skewness: float, paths: int) -> None:
    from_table = {30: 2.4620, 40: 2.4258, 100: 2.3646}[paths]

    def cubic(w: float) -> float:
        g = skewness
        return w + g * w**2 / 3 + g**2 * w**3 / 27 + g / (6 * paths) + from_table / math.sqrt(paths)

    above = -brentq(cubic, -50, 1) * math.sqrt(paths)
    sampled = SampledBound(-9.0, 0.5, paths, 0.3, skewness)
    assert sampled.upper == pytest.approx(-9.0 + 0.5 * above, abs=1e-3)
    assert above > from_table


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
    """Also where there is no time at all: on one it would be the best of what that luck happens to have."""
    robot.sampled(2, 0)  # what people will want after these lucks takes time, too
    drawn, paths = [], robot.paths
    monkeypatch.setattr(robot, "paths", lambda of: drawn.extend(of) or paths(of))
    monkeypatch.setattr(robot, "left", lambda _: -1.0)
    assert robot.sampled(10, 0).paths == 2
    assert len(drawn) == 2 + 2


@pytest.mark.parametrize("best", range(len(ALPHAS)))
def test_alpha_is_best_on_lucks_of_its_own(
    best: int, robot: InformationRelaxation, monkeypatch: pytest.MonkeyPatch
) -> None:
    """How well people fare is the same for all: what counts is which bound is lowest on the mean of the same lucks."""
    tried: list[tuple[float, int]] = []

    def bounds(paths: Sequence[SamplePath], alpha: float) -> list[float]:
        """Give bounds that are lowest at the one, but on some lucks at another."""
        tried.append((alpha, len(paths)))
        far = abs(ALPHAS.index(alpha) - best)
        return [(-50.0, -58.0)[luck % 2] + (far if luck % 5 < 4 else -2 * far) for luck in range(len(paths))]

    monkeypatch.setattr(robot, "paths", lambda of: [[] for _ in of])
    monkeypatch.setattr(robot, "_bounds", bounds)
    assert robot.sampled(100, 0).alpha == ALPHAS[best]
    pilot = [alpha for alpha, lucks in tried if lucks == 10]
    assert len(pilot) == len(set(pilot)) <= abs(ALPHAS.index(0.45) - best) + 3  # the other side costs nothing


def test_an_alpha_that_takes_the_search_long_leaves_time_for_few_lucks(
    robot: InformationRelaxation, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On the same lucks 0.6 is the lowest, but with what is left of the time 0.45 comes to less."""
    clock, each = [0.0], dict.fromkeys(ALPHAS, 1.0)

    def bounds(paths: Sequence[SamplePath], alpha: float) -> list[float]:
        clock[0] += each[alpha] * len(paths)
        return [(-50.0, -54.0)[luck % 2] + abs(alpha - 0.6) for luck in range(len(paths))]

    monkeypatch.setattr(robot, "paths", lambda of: [[] for _ in of])
    monkeypatch.setattr(robot, "_bounds", bounds)
    monkeypatch.setattr(robot, "left", lambda _: 1 - clock[0] / 1000)
    at_leisure = robot.sampled(200, 0)
    assert (at_leisure.alpha, at_leisure.paths) == (0.6, 200)
    clock[0] = 0.0
    each[0.6] = 20.0
    in_time = robot.sampled(200, 0)
    assert (in_time.alpha, in_time.paths) == (0.45, 200)


def test_what_is_sampled_does_not_depend_on_how_many_work_at_a_time() -> None:
    found = [made(PRICE, workers).sampled(7, 0) for workers in (1, 2, 5)]
    assert found[0] == found[1] == found[2]
    assert found[0].paths == 7


def test_wishes_are_worked_out_bit_by_bit(
    robot: InformationRelaxation, paths: list[SamplePath], monkeypatch: pytest.MonkeyPatch
) -> None:
    """However often it is asked whether to go on, they are the same."""
    monkeypatch.setattr(congestion, "PAUSE", 3)
    asked: list[int] = []
    again = InformationRelaxation(
        [person.lattice for person in robot.people], PRICE, left=lambda done: asked.append(done) or 1.0
    )
    assert again.lost == robot.lost
    assert len(asked) > 20
    (path,) = drawn(again, [0])
    assert [again.bound(path, alpha) for alpha in (0.3, 0.8)] == [robot.bound(paths[0], alpha) for alpha in (0.3, 0.8)]


def test_a_time_limit_holds_while_wishes_are_worked_out(
    robot: InformationRelaxation, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is sampled where time is over before two lucks have been looked at; later, those are what there is."""
    monkeypatch.setattr(congestion, "PAUSE", 20)
    asked = iter((1.0, 1.0, 1.0, 0.0))
    with pytest.raises(OutOfTimeError):
        InformationRelaxation([person.lattice for person in robot.people], PRICE, left=lambda _: next(asked))
    assert list(asked) == []  # it went on while there was time

    def sampled(draws: int) -> int:
        """Let time be over while so many draws are followed by another: two, on which alpha is chosen, come first."""
        paths, drawn = robot.paths, []

        def until(generators: list[np.random.Generator]) -> list[SamplePath]:
            drawn.extend(generators)
            if len(drawn) > draws:
                raise OutOfTimeError
            return paths(generators)

        with monkeypatch.context() as patch:
            patch.setattr(robot, "paths", until)
            return robot.sampled(6, 0).paths

    assert [sampled(draws) for draws in (4, 5, 9)] == [2, 3, 6]
    with pytest.raises(OutOfTimeError):
        sampled(3)
