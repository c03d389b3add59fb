"""Equations 4 to 6 and the filter: every fast implementation compared with `decision` and `belief`."""

from __future__ import annotations

from math import log

import numpy as np
from conftest import costly, graph_task
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from assist.learning.likelihood import Data, alone, by_equation_seven, heard_steps, with_trust
from assist.people import Choices, Grid, HumanModel, influence_kernels, perceived_cost_to_go
from assist.people.decision import NOTHING, choice, influence, lapse, perceived_cost, perceived_value, trust
from assist.person import AssistPOMDP, OfRobots, VectorPolicy, belief_filter, qmdp
from assist.person.problem_arrays import ProblemArrays, read_only
from planner import sweep

Floats = NDArray[np.float64]

BETA, THETA = np.array([0.0, 0.7, 40.0]), np.array([0.0, 0.3, 0.5, 1.0])
edges = st.tuples(st.integers(1, 5), st.integers(0, 5), st.sampled_from([0, 1, 1, 2]))
graphs = st.lists(edges, min_size=2, max_size=12)
people = st.fixed_dictionaries(
    {
        "eta": st.sampled_from([0.0, 0.2, 3.0]),
        "lapse": st.sampled_from([0.0, 1e-3]),
        "utility_scale": st.sampled_from([1.0, 2.5]),
    }
)
ends = st.one_of(st.sampled_from([0.0, 0.5, 1.0]), st.floats(0, 1))
examples = costly(12, 60)


def problem_of(drawn: list[tuple[int, int, int]], person: dict[str, float], sigma: float) -> AssistPOMDP:
    choices = Choices.of(sweep(graph_task(drawn)))
    q = perceived_cost(choices, perceived_cost_to_go(choices, sigma, np.random.default_rng(1)))
    model, grid = HumanModel(choices, q[:, :, None], **person), Grid(BETA.copy(), THETA.copy())
    return AssistPOMDP.of(model, grid=grid, gamma=0.9, robot=OfRobots(c_suggest=0.3), suggestions="all")


def response(problem: AssistPOMDP, x: int, r: int) -> Floats:
    """Return the probability of each slot, shape (B, T, A), by the equations of `people.decision`."""
    model, applicable = problem.model, problem.model.choices.applicable[x]
    p = np.array([choice(model.q[x, :, 0], applicable, beta) for beta in BETA])
    heard = [[influence(row, int(problem.suggested[x, r]), theta) for theta in THETA] for row in p]
    return lapse(np.array(heard), applicable, model.lapse)


def moves(problem: AssistPOMDP, x: int, r: int) -> Floats:
    """Return the transition matrix of theta, shape (T, T), by the equations of `people.decision`."""
    model, choices = problem.model, problem.model.choices
    value, slot = perceived_value(choices, model.q[:, :, 0]), problem.suggested[x, r]
    after = THETA
    if slot != NOTHING:
        after = trust(THETA, value[x], value[choices.targets[x, slot]], model.eta, model.utility_scale)
    low, up = problem.grid.shares(after)
    chances = np.zeros((len(THETA), len(THETA)))
    chances[np.arange(len(THETA)), low] += 1 - up
    chances[np.arange(len(THETA)), low + 1] += up
    return chances


@examples
@given(graphs, people, st.sampled_from([0.0, 0.8]), st.integers(0, 1000))
def test_every_step_of_a_problem_is_that_of_the_equations(
    drawn: list[tuple[int, int, int]], person: dict[str, float], sigma: float, seed: int
) -> None:
    """Likelihood, filter (array at a time and compiled), QMDP, alpha vectors, and the search's children."""
    problem = problem_of(drawn, person, sigma)
    choices, arrays, rng = problem.model.choices, ProblemArrays.of(problem), np.random.default_rng(seed)
    for array in (problem.weight, problem.chosen, problem.unsuggested):
        assert np.isfinite(array).all()
    best = qmdp(problem)
    vectors = -rng.uniform(0, 20, (len(choices), *problem.grid.shape)) * ~choices.goal[:, None, None]
    policy = VectorPolicy(problem, vectors, np.zeros(len(choices), dtype=np.int64), np.arange(len(choices) + 1))
    belief = rng.dirichlet(np.ones(problem.prior.size)).reshape(problem.grid.shape)
    for x in np.flatnonzero(~choices.goal).tolist():
        slots = np.flatnonzero(choices.applicable[x])
        ahead = policy.q_values(np.array([x]), belief[None])[0]
        for r in range(problem.robot_actions[x]):
            chance, theta = response(problem, x, r), moves(problem, x, r)
            child = np.empty(problem.prior.size)
            parts = belief_filter.new_parts(problem.prior.size, arrays.uses_answer)
            place, slot = belief_filter.split(parts, belief.reshape(-1), x, r, arrays)
            expected, gained = np.zeros(problem.grid.shape), 0.0
            for a in slots.tolist():
                y = choices.targets[x, a]
                robot, state, action = np.array([r]), np.array([x]), np.array([a])
                likelihood = problem.likelihood(state, robot, action)[0]
                np.testing.assert_allclose(likelihood, chance[:, :, a], rtol=1e-12, atol=1e-300)
                joint = (belief * chance[:, :, a]) @ theta
                mass = belief_filter.child(child, place, a, slot, parts, arrays)
                np.testing.assert_allclose(child.reshape(joint.shape), joint, rtol=1e-11, atol=1e-280)
                np.testing.assert_allclose(mass, joint.sum(), rtol=1e-11, atol=1e-280)
                if joint.sum() > 1e-250:
                    updated = problem.update(belief[None], state, robot, action)[0]
                    np.testing.assert_allclose(updated, joint / joint.sum(), rtol=1e-11, atol=1e-200)
                    own = belief.reshape(-1).copy()
                    belief_filter.update(own, np.empty(own.shape), x, r, a, arrays)
                    np.testing.assert_allclose(own.reshape(joint.shape), joint / joint.sum(), rtol=1e-11, atol=1e-200)
                future = best.value_mdp[y] @ theta.T if not choices.goal[y] else np.zeros(problem.grid.shape)
                expected += chance[:, :, a] * (problem.gamma * future - choices.costs[x, a])
                gained += problem.gamma * (joint * vectors[y]).sum() - choices.costs[x, a] * joint.sum()
            charge = problem.robot_costs[x, r]
            np.testing.assert_allclose(best.q_mdp[x, r], expected - charge, rtol=1e-9, atol=1e-12)
            np.testing.assert_allclose(ahead[r], gained - charge, rtol=1e-9, atol=1e-12)


some_costs = st.lists(st.one_of(st.floats(0, 30), st.just(float("inf"))), min_size=1, max_size=5)
some_values = st.one_of(st.just(-float("inf")), st.floats(-30, 0))
some_beta = st.one_of(st.just(0.0), st.floats(0, 50))


@settings(deadline=None)
@given(some_costs, some_beta, ends, st.integers(-1, 4), st.tuples(some_values, some_values))
@example([float("inf"), 0.0], 1.0, 1e-310, 1, (0.0, 0.0))
def test_compiled_equations_are_those_of_the_model(
    q: list[float], beta: float, theta: float, suggestion: int, gained: tuple[float, float]
) -> None:
    costs, told = np.array(q), min(suggestion, len(q) - 1)
    expected = choice(costs, np.ones(len(q), dtype=bool), beta)
    p = expected.copy()
    heard = influence(expected, told, theta)
    if told >= 0:
        same, other = influence_kernels.influence_factors(
            theta, expected[told], expected[np.arange(len(q)) != told].sum()
        )
        answered = expected * np.where(np.arange(len(q)) == told, same, other)
        np.testing.assert_allclose(answered, heard, rtol=1e-9, atol=1e-300)  # below that doubles are not as exact
        influence_kernels.weigh_by_influence(p, len(q), told, theta)
    np.testing.assert_allclose(p / p.sum(), heard, rtol=1e-9, atol=1e-300)
    value, after = gained
    if np.isinf(value):  # from a perceived dead end, the next state is one too
        after = value
    for eta in (0.0, 0.2, 2.0):
        moved = float(trust(theta, value, after, eta))
        assert 0 <= moved <= 1
        if eta == 0 or value == after:
            assert moved == theta
        elif np.isinf(after):
            assert moved == 0
        gain = 0.0 if value == after else after - value
        assert influence_kernels.update_trust(theta, eta, gain) == moved


@examples
@given(graphs, people, ends, st.sampled_from(BETA.tolist()), st.integers(0, 1000))
def test_the_likelihood_of_a_walk_is_that_of_the_equations(
    drawn: list[tuple[int, int, int]], person: dict[str, float], first: float, beta: float, seed: int
) -> None:
    """The likelihood that `fit` maximises, on any task, with suggestions into dead ends, eta 0 and extreme values of
    theta.
    """
    problem = problem_of(drawn, person, 0.0)
    model, choices, rng = problem.model, problem.model.choices, np.random.default_rng(seed)
    q = model.q[:, :, 0]
    value, lowest = perceived_value(choices, q), q.min(axis=1, keepdims=True)
    x, theta, total = choices.initial, first, 0.0
    steps = []
    for _ in range(12):
        if choices.goal[x]:
            break
        applicable = choices.applicable[x]
        told = int(rng.choice([NOTHING, *np.flatnonzero(applicable & (choices.actions[x] >= 0))]))
        p = lapse(influence(choice(q[x], applicable, beta), told, theta), applicable, model.lapse)
        a = int(rng.choice(len(p), p=p / p.sum()))
        total += log(p[a])
        gain = 0.0
        if told >= 0:
            y = choices.targets[x, told]
            gain = 0.0 if value[x] == value[y] else float(value[y] - value[x])
            theta = float(trust(theta, value[x], value[y], model.eta, model.utility_scale))
        excess = np.where(np.isfinite(lowest[x]), q[x] - np.where(np.isfinite(lowest[x]), lowest[x], 0.0), 0.0)
        steps.append((excess, int(applicable.sum()), a, told, gain / model.utility_scale))
        x = int(choices.targets[x, a])
    if not steps:
        return
    excess, options, chosen, suggested, gains = (np.array(column) for column in zip(*steps, strict=True))
    begins = np.arange(len(steps)) == 0
    parts = (
        excess, options, chosen, suggested, gains, model.lapse, np.zeros(0), np.zeros((0, 0, 0)),
        *heard_steps(suggested, begins), np.zeros(len(steps), dtype=np.int64), np.zeros(1), 1, 1,
    )  # fmt: skip
    data = Data(*(read_only(part) if isinstance(part, np.ndarray) else part for part in parts))
    chances, silent = np.empty((1, 3, len(data.heard))), np.empty((1, 1))
    alone(data, beta, chances[0], silent[0])
    path = by_equation_seven(data, np.array([first]), np.array([model.eta]))
    np.testing.assert_allclose(with_trust(data, chances, silent, path).item(), total, rtol=1e-9, atol=1e-9)
