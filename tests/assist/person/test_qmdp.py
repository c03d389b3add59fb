"""QMDP: values with observed beta and theta, compared with plain value iteration."""

from __future__ import annotations

import itertools
import pickle
import time
from dataclasses import replace

import numba
import numpy as np
import pytest
from conftest import costly, graph_task, kit
from hypothesis import given
from hypothesis import strategies as st
from silence import Rested
from test_unknown_goals import three_goals

from assist.people import Choices, Grid, Human, HumanModel, Population, constant, perceived_cost_to_go
from assist.people.trust_rules import Reliability, TrustRule, outcome, outcome_at_disagreement
from assist.person import (
    AssistPOMDP,
    Behaviour,
    LeafBounds,
    OfRobots,
    VectorPolicy,
    policy_iteration,
    qmdp,
    sparse_iteration,
)
from assist.person.attention_subproblem import AttentionSubproblem
from assist.person.mdp_values import evaluate, initial_upper_bounds, value_iteration
from assist.person.policy_iteration import rounding_error
from assist.person.problem_arrays import ProblemArrays
from assist.person.rounding import ROUNDING, rounding
from assist.person.solution_cache import SolutionCache
from planner import sweep

GRID = Grid(np.array([0.3, 2.0]), np.array([0.0, 0.4, 1.0]))


def make(choices: Choices, h: np.ndarray | None = None, **options: object) -> AssistPOMDP:
    h = perceived_cost_to_go(choices, 0.9, np.random.default_rng(11)) if h is None else h
    model = HumanModel.own(choices, Human(1.0, 0.6, 0.9, h))
    return AssistPOMDP.of(model, grid=GRID, **{"gamma": 0.95, "robot": OfRobots(c_suggest=0.3), **options})  # type: ignore[arg-type]


@pytest.mark.parametrize("options", [{"gamma": 1.0}, {"gamma": float("nan")}])
def test_parameters_are_checked(tiny_choices: Choices, options: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="expected"):
        make(tiny_choices, **options)


@pytest.mark.parametrize("sent", [False, True])
def test_one_compiled_form_serves_every_problem(tiny_choices: Choices, sent: bool) -> None:
    """Whether it was made here or sent by another process, which writes protection does not survive."""
    problem, other = make(tiny_choices), AssistPOMDP.of(HumanModel.exact(Choices.of(sweep(graph_task([(1, 0, 1)])))))
    vectors = VectorPolicy(other, np.zeros((2, *other.prior.shape)), np.zeros(2, np.int64), np.arange(3))
    assert vectors._arrays.gamma == other.gamma
    if sent:
        other, vectors = pickle.loads(pickle.dumps((other, vectors)))
        assert other.chosen.flags.writeable
    assert (
        numba.typeof(ProblemArrays.of(problem))
        == numba.typeof(ProblemArrays.of(other))
        == numba.typeof(vectors._arrays)
    )


def test_kept_solutions_are_those_of_the_solver_and_only_for_equal_problems(tiny_choices: Choices) -> None:
    solutions = SolutionCache()
    wide, high = Population(theta=(0.0, 1.0)), Population(theta=(0.7, 0.9))

    def values(**options: object) -> np.ndarray:
        problem = make(tiny_choices, **options)
        found = solutions.qmdp(problem)
        assert (found.q_mdp == qmdp(problem).q_mdp).all()
        return found.value_mdp

    first = values(population=wide)
    assert values(population=high) is first, "the prior does not matter to the values"
    for other in ({"robot": OfRobots(c_suggest=0.2)}, {"behaviour": Behaviour(trust=constant())}):
        assert values(population=wide, **other) is not first
    nothing = SolutionCache(limit_mb=0.0)
    assert (nothing.qmdp(make(tiny_choices)).value_mdp == first).all(), "what is not kept is solved again"


@pytest.mark.parametrize("dear", [10**6, 10**6 + 1, 10**6 + 3, 10**7 + 9])
def test_a_suggestion_against_a_dear_action_keeps_its_precision(dear: int) -> None:
    """Nobody follows; who is advised to take the dear action takes one of two that cost 1 for sure."""
    roads = [(1, 0, dear), (1, 2, 1), (2, 0, 0), (1, 3, 1), (3, 0, 0)]
    model = HumanModel.exact(Choices.of(sweep(graph_task(roads))), lapse=0.0)
    grid = Grid(np.array([0.0]), np.array([0.0, 1.0]))
    pomdp = AssistPOMDP.of(
        model,
        grid=grid,
        gamma=0.9,
        robot=OfRobots(c_suggest=0.1),
        suggestions="all",
        behaviour=Behaviour(trust=constant()),
    )
    found = qmdp(pomdp, tolerance=1e-13).value_mdp[model.choices.initial, 0, 0]
    assert found == pytest.approx(-1.1, rel=1e-14)


class PlainBackup:
    """The Bellman operator in numpy, from the likelihoods of `AssistPOMDP`: one dense array for each part."""

    def __init__(self, pomdp: AssistPOMDP) -> None:
        c, (n, actions) = pomdp.model.choices, pomdp.suggested.shape
        x, r = (part.ravel() for part in np.indices((n, actions)))
        self.pomdp, self.acting, cells = pomdp, pomdp.afterstate, pomdp.grid.shape[1]
        slots = range(c.targets.shape[1])
        with np.errstate(divide="ignore", invalid="ignore"):  # final states have no choices
            chance = np.stack([pomdp.likelihood(x, r, np.full(len(x), a)) for a in slots], axis=1)
        self.chance = np.where(c.applicable[self.acting.ravel()][:, :, None, None], chance, 0.0)
        self.chance = self.chance.reshape(n, actions, len(slots), *pomdp.grid.shape)
        own = np.arange(cells)
        self.moves = np.zeros((n, actions, len(slots), cells, cells))  # from theta to theta after each choice
        for a in slots:
            follows = (pomdp.suggested == a)[:, :, None]
            low, up = pomdp.low[:, :, 0], pomdp.weight[:, :, 0]
            if pomdp.followed_low is not None and pomdp.followed_weight is not None:
                low = np.where(follows, pomdp.followed_low[:, :, 0], low)
                up = np.where(follows, pomdp.followed_weight[:, :, 0], up)
            for cell in own:
                reached = np.minimum(low[..., cell] + 1, cells - 1)
                np.add.at(self.moves, (*np.indices((n, actions)), a, cell, low[..., cell]), 1 - up[..., cell])
                np.add.at(self.moves, (*np.indices((n, actions)), a, cell, reached), up[..., cell])

    def values(self, value: np.ndarray) -> np.ndarray:
        """Return the Q-values of values, shape (n, B, T), for all robot actions: shape (n, R, B, T)."""
        c, pomdp = self.pomdp.model.choices, self.pomdp
        then = value[c.targets[self.acting]]  # (n, R, A, B, T)
        later = np.einsum("nratz,nrabz->nrabt", self.moves, then)
        returns = pomdp.gamma * later - c.costs[self.acting][..., None, None]
        total = (self.chance * returns).sum(axis=2)
        total[c.goal[self.acting]] = 0.0
        total -= pomdp.robot_costs[:, :, None, None]
        total[np.arange(total.shape[1]) >= pomdp.robot_actions[:, None]] = -np.inf
        return total

    def backup(self, value: np.ndarray, action: np.ndarray | None = None) -> np.ndarray:
        """Return values after one more step with the best robot action, or given ones, in states that are not final."""
        q = self.values(value)
        best = q.max(axis=1) if action is None else q[np.arange(len(q)), action]
        return np.where(self.pomdp.ends[:, None, None], value, best)

    def of(self, value: np.ndarray, policy: np.ndarray) -> np.ndarray:
        """Return the values of a policy, shape (n, B, T), by dense linear equations; final states keep theirs."""
        c, (n, betas, cells) = self.pomdp.model.choices, value.shape
        found, going = value.copy(), np.flatnonzero(~self.pomdp.ends)
        for b in range(betas):
            matrix, right = np.eye(n * cells), value[:, b].ravel().copy()
            for x, t in itertools.product(going, range(cells)):
                r, row = policy[x, b, t], x * cells + t
                acting = self.acting[x, r]
                right[row] = -self.pomdp.robot_costs[x, r]
                for a in np.flatnonzero(c.applicable[acting] & ~c.goal[acting]):
                    p, y = self.chance[x, r, a, b, t], c.targets[acting, a]
                    right[row] -= p * c.costs[acting, a]
                    matrix[row, y * cells : (y + 1) * cells] -= self.pomdp.gamma * p * self.moves[x, r, a, t]
            found[:, b] = np.linalg.solve(matrix, right).reshape(n, cells)
        return found

    def best(self, value: np.ndarray) -> np.ndarray:
        """Return the best values, shape (n, B, T), by Howard's policy iteration; those of final states are given."""
        policy = np.zeros(value.shape, dtype=np.int64)
        while True:
            value = self.of(value, policy)
            q = self.values(value)
            now = np.take_along_axis(q, policy[:, None], axis=1)[:, 0]
            better = ~self.pomdp.ends[:, None, None] & (q.max(axis=1) > now + 1e-11 * np.abs(now) + 1e-12)
            if not better.any():
                return value
            policy = np.where(better, q.argmax(axis=1), policy)


def random_problem(draw: st.DataObject, gamma: float) -> AssistPOMDP:
    """Draw a problem on a random graph with dead ends, most of which lead to each other."""
    pick = draw.draw
    nodes = pick(st.integers(2, 9))
    node, cost = st.integers(0, nodes - 1), st.integers(0, 5)
    roads = pick(st.lists(st.tuples(node, node, cost), min_size=nodes, max_size=4 * nodes))
    choices = Choices.of(sweep(graph_task([road for road in roads if road[0] != road[1]] or [(1, 0, 1)])))
    rng = np.random.default_rng(pick(st.integers(0, 99)))
    model = HumanModel.exact(choices)
    if pick(st.booleans()):
        model = HumanModel.own(choices, Human(1.0, 0.6, 0.9, perceived_cost_to_go(choices, 0.9, rng)))
    rules: list[TrustRule | None] = [
        None,
        outcome(),
        outcome_at_disagreement(),
        outcome(feedback="true"),
        Rested(),
        Reliability(counts=2),
    ]
    frontier, inside = None, np.flatnonzero(~choices.goal & (np.arange(len(choices)) != choices.initial))
    execute = pick(st.booleans())
    if not execute and len(inside) and pick(st.booleans()):
        leaves = np.sort(rng.choice(inside, pick(st.integers(1, len(inside))), replace=False))
        most = -rng.uniform(0, 9, (len(leaves), *(GRID.shape if pick(st.booleans()) else (1, 1))))
        frontier = LeafBounds(leaves, np.full((len(leaves), 1, GRID.shape[1]), -9.0 / (1 - gamma)), most)
    trust = rules[pick(st.integers(0, 4 if frontier else 5))]
    return AssistPOMDP.of(
        model, grid=GRID, gamma=gamma,
        robot=OfRobots(c_suggest=pick(st.sampled_from([0.0, 0.1, 50.0])), execute=execute),
        suggestions=pick(st.sampled_from(["optimal", "all"])), frontier=frontier, behaviour=Behaviour(trust=trust),
    )  # fmt: skip


@pytest.fixture
def compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let compiled code solve small problems, too."""
    monkeypatch.setattr(sparse_iteration, "MOST_VALUES", 0)


@pytest.mark.parametrize("most_values", [sparse_iteration.MOST_VALUES, 0])
@costly(3, 15)
@given(draw=st.data(), gamma=st.sampled_from([0.9, 0.99, 0.999]))
def test_values_are_those_of_plain_policy_iteration(gamma: float, most_values: int, draw: st.DataObject) -> None:
    """Both in numpy and compiled; also for a robot that visits, and for one that pays for its attention."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sparse_iteration, "MOST_VALUES", most_values)
        check_values(random_problem(draw, gamma), gamma)


def check_values(alone: AssistPOMDP, gamma: float) -> None:
    problems = [alone, AttentionSubproblem.of(alone, 0.5).pomdp]
    if alone.frontier is None:
        problems.append(AttentionSubproblem.of(alone, 0.5, 1, [0.3, 0.1]).pomdp)
    for problem in problems:
        plain = PlainBackup(problem)
        # No decision is made in a state that only an execution reaches: a second one may lead out of its step.
        known = (problem.afterstate >= 0).all(axis=1)
        found = qmdp(problem, tolerance=1e-9).value_mdp
        best = plain.best(initial_upper_bounds(problem))
        np.testing.assert_allclose(found[known], best[known], rtol=1e-10, atol=1e-8)
        action = problem.robot_actions - 1
        least = evaluate(problem, action, tolerance=1e-9)
        policy = np.broadcast_to(action[:, None, None], least.shape)
        rtol = 1e-12 + ROUNDING / (1 - gamma)  # the margin of a certified bound
        np.testing.assert_allclose(
            least[known], plain.of(least, policy)[known], rtol=0, atol=1e-8 + 2 * rtol * np.abs(least).max(initial=0.0)
        )


@pytest.mark.parametrize("several", [False, True])
@pytest.mark.parametrize("rule", [None, outcome(), Reliability(counts=2)])
@pytest.mark.parametrize("lapse", [0.0, 0.05])
def test_both_forms_have_the_same_values(several: bool, rule: TrustRule | None, lapse: float) -> None:
    """They are held to 1e-9, with the Q-values, values of a given policy, and expected values of beliefs."""
    choices = three_goals("tiny").choices() if several else Choices.of(kit("tiny"))
    pomdp = AssistPOMDP.of(
        replace(HumanModel.exact(choices), lapse=lapse),
        gamma=0.99,
        robot=OfRobots(c_suggest=0.3),
        behaviour=Behaviour(trust=rule),
        suggestions="all",
    )
    action, rng, found = pomdp.robot_actions - 1, np.random.default_rng(0), []
    x, belief = rng.integers(0, len(choices), 50), rng.dirichlet(np.ones(pomdp.prior.size), 50)
    for most_values in (0, 10**9):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sparse_iteration, "MOST_VALUES", most_values)
            policy = qmdp(pomdp, tolerance=1e-9)
            expected = policy.q_values(x, belief.reshape(50, *pomdp.prior.shape))
            found.append((policy.value_mdp, policy.q_mdp, expected, evaluate(pomdp, action, tolerance=1e-9)))
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-9)


def test_one_state_alone_may_be_alive() -> None:
    """Whoever leaves the start without reaching the goal goes round in circles for ever."""
    ring = [(i, i + 1, 2) for i in range(2, 40)] + [(40, 2, 2)]
    model = HumanModel.exact(Choices.of(sweep(graph_task([(1, 0, 1), (1, 2, 1), *ring]))))
    pomdp = AssistPOMDP.of(model, grid=GRID, gamma=0.999)
    found = qmdp(pomdp, tolerance=1e-9).value_mdp
    np.testing.assert_allclose(found[np.isinf(pomdp.model.choices.h)], -2 / (1 - 0.999), rtol=1e-11)
    plain = PlainBackup(pomdp)
    np.testing.assert_allclose(found, plain.best(initial_upper_bounds(pomdp)), atol=1e-8)


def sweeps_of(pomdp: AssistPOMDP, monkeypatch: pytest.MonkeyPatch) -> int:
    """Return the number of sweeps that QMDP needs."""
    done, sweep_once = [], policy_iteration.sweep
    with monkeypatch.context() as patch:
        patch.setattr(policy_iteration, "sweep", lambda *given: done.append(None) or sweep_once(*given))
        qmdp(pomdp)
    return len(done)


@pytest.mark.usefixtures("compiled")
@pytest.mark.parametrize("gamma", [0.99, 0.999])
def test_dead_ends_cost_one_more_sweep_for_each_beta(gamma: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """They took 1,833 sweeps for each beta at .99, the horizon of a return that never ends."""
    roads = [(i, j, 1 + (i + j) % 3) for i in range(1, 60) for j in (i - 1, min(i + 7, 59), i // 2)]
    lost = [(i, 60 + i, 1) for i in range(1, 60)] + [(60 + i, 60 + (3 * i + 1) % 60, 2) for i in range(60)]
    number = {
        name: sweeps_of(AssistPOMDP.of(HumanModel.exact(Choices.of(sweep(graph_task(part)))), gamma=gamma), monkeypatch)
        for name, part in (("alive", roads), ("with dead ends", roads + lost))
    }
    assert number["with dead ends"] <= 2 * number["alive"]


@pytest.mark.usefixtures("compiled")
def test_people_who_rarely_arrive_need_few_sweeps(monkeypatch: pytest.MonkeyPatch) -> None:
    """A novice's way through a square is a random walk, and gamma is close to 1."""
    side = 30
    roads = [
        (i * side + j, (i + a) * side + j + b, 1)
        for i in range(side) for j in range(side) for a, b in ((0, 1), (1, 0), (0, -1), (-1, 0))
        if 0 <= i + a < side and 0 <= j + b < side
    ]  # fmt: skip
    pomdp = AssistPOMDP.of(
        HumanModel.exact(Choices.of(sweep(graph_task(roads)))), gamma=0.999, robot=OfRobots(c_suggest=20.0)
    )
    assert sweeps_of(pomdp, monkeypatch) <= 3 * len(pomdp.grid.beta)


def test_a_limit_leaves_bounds() -> None:
    """Whenever the iteration ends, values are upper bounds, and those of a policy lower ones."""
    pomdp = AssistPOMDP.of(HumanModel.exact(Choices.of(kit("sealed"))), grid=GRID, gamma=0.99)
    exact = qmdp(pomdp, tolerance=1e-10).value_mdp
    action = pomdp.robot_actions - 1
    return_of = evaluate(pomdp, action, tolerance=1e-10)
    for sweeps in range(1, 6):
        value = initial_upper_bounds(pomdp)
        value_iteration(pomdp, value, tolerance=1e-12, max_sweeps=sweeps)
        assert (value >= exact - 1e-8).all()
        assert (evaluate(pomdp, action, max_sweeps=sweeps) <= return_of + 1e-8).all()
    late = initial_upper_bounds(pomdp)
    assert not value_iteration(pomdp, late, tolerance=1e-9, deadline=time.perf_counter())
    assert (late == initial_upper_bounds(pomdp)).all()


@pytest.mark.usefixtures("compiled")
def test_a_matrix_that_would_be_too_large_is_not_built(monkeypatch: pytest.MonkeyPatch) -> None:
    pomdp = AssistPOMDP.of(HumanModel.exact(Choices.of(kit("tiny"))), grid=GRID, gamma=0.9)
    found = qmdp(pomdp, tolerance=1e-9).value_mdp
    monkeypatch.setattr(policy_iteration, "MOST_ENTRIES", 10)
    np.testing.assert_allclose(qmdp(pomdp, tolerance=1e-9).value_mdp, found, atol=1e-8)


@pytest.mark.parametrize("dear", [10**4, 10**9, 10**12])
def test_values_of_very_different_size_converge(dear: int) -> None:
    """Rounding alone moves such values by more than the tolerance of 1e-6."""
    roads = [(1, 2, dear), (2, 1, dear), (1, 3, 1), (3, 1, 2), (2, 0, 1), (3, 4, 1), (4, 4, dear), (4, 2, 2)]
    pomdp = AssistPOMDP.of(HumanModel.exact(Choices.of(sweep(graph_task([r for r in roads if r[0] != r[1]])))))
    found = qmdp(pomdp).value_mdp
    plain = PlainBackup(pomdp)
    np.testing.assert_allclose(found, plain.best(initial_upper_bounds(pomdp)), rtol=1e-11, atol=1e-8)


def test_the_margin_of_rounding_grows_with_the_number_of_terms() -> None:
    assert rounding(2) == rounding(800) == ROUNDING
    assert rounding(8000) == pytest.approx(10 * ROUNDING)
    many = [(1, 0, 1), *((1, 2, 1 + i) for i in range(2000)), (2, 1, 1)]
    few = [(1, 0, 1), *((1, 2, 1 + i) for i in range(20)), (2, 1, 1)]
    margin = {}
    for name, roads in (("many", many), ("few", few)):
        pomdp = AssistPOMDP.of(HumanModel.exact(Choices.of(sweep(graph_task(roads)))), grid=GRID, gamma=0.9)
        margin[name] = rounding_error(-np.ones((1, *GRID.shape)), ProblemArrays.of(pomdp)).max()
    assert margin["many"] > 2 * margin["few"]
