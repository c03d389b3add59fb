"""Weakly coupled problems: the bound against the joint optimum and a linear program, policies, simulation, errors."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import costly, thinned
from hypothesis import given
from hypothesis import strategies as st
from scipy import sparse
from scipy.optimize import linprog

from assist.certify import coupled
from assist.certify.coupled import (
    Agents,
    RolloutOptions,
    bound,
    certify,
    policy,
    sampled_bound,
    simulate,
    whittle_index,
)
from assist.certify.coupled.rollout import serve
from planner import LimitError

GAMMA = 0.8


def problem(seed: int, agents: int, states: int = 2, actions: int = 2) -> Agents:
    """Return random agents with random initial states."""
    rng = np.random.default_rng(seed)
    P = rng.dirichlet(np.full(states, 0.6), size=(agents, actions, states))
    R = rng.normal(size=(agents, actions, states))
    return Agents(P, R, initial=rng.integers(states, size=agents), gamma=GAMMA)


def matrices(agents: Agents) -> np.ndarray:
    """Return all transition probabilities, shape (K, A, S, S)."""
    K, A, S = agents.shape
    dense = agents.P.toarray().reshape(A, K, S, K, S)
    return np.array([[dense[a, k, :, k, :] for a in range(A)] for k in range(K)])


def joint_optimum(agents: Agents, resources: float) -> float:
    """Return the optimal value by value iteration over all joint states and joint actions."""
    K, A, S = agents.shape
    P, states = matrices(agents), list(itertools.product(range(S), repeat=K))
    now = {}
    for joint in itertools.product(range(A), repeat=K):
        now[joint] = np.full((S,) * K, -np.inf)
        for x in states:
            if sum(agents.uses[k, joint[k], x[k]] for k in range(K)) <= resources:
                now[joint][x] = sum(agents.R[k, joint[k], x[k]] for k in range(K))
    value = np.zeros((S,) * K)
    for _ in range(120):
        best = np.full(value.shape, -np.inf)
        for joint, reward in now.items():
            after = value
            for k in range(K):
                after = np.moveaxis(np.tensordot(P[k, joint[k]], after, axes=(1, k)), 0, k)
            best = np.maximum(best, reward + GAMMA * after)
        value = best
    return float(value[tuple(agents.initial.argmax(axis=1))])


def best_in_expectation(agents: Agents, resources: float, window: int) -> float:
    """Return the value of the linear program in which the resource suffices in expectation at each of some steps."""
    K, A, S = agents.shape
    P, size = matrices(agents), K * A * S
    tail = np.zeros((K, S))
    for _ in range(200):
        tail = (agents.R + GAMMA * np.einsum("kast,kt->kas", P, tail)).max(axis=1)
    gain, flow, start = np.zeros(window * size), np.zeros((window * K * S, window * size)), np.zeros(window * K * S)
    units = np.zeros((window, window * size))
    start[: K * S] = agents.initial.ravel()
    for t, k, a, s in itertools.product(range(window), range(K), range(A), range(S)):
        column = t * size + (k * A + a) * S + s
        gain[column] = GAMMA**t * agents.R[k, a, s]
        units[t, column] = agents.uses[k, a, s]
        flow[t * K * S + k * S + s, column] += 1
        for y in range(S):
            if t + 1 < window:
                flow[(t + 1) * K * S + k * S + y, column] -= P[k, a, s, y]
            else:
                gain[column] += GAMMA**window * P[k, a, s, y] * tail[k, y]
    solved = linprog(-gain, A_ub=units, b_ub=np.full(window, resources), A_eq=flow, b_eq=start, method="highs")
    return -float(solved.fun)


@costly(3, 10)
@given(st.integers(0, 10**6), st.integers(1, 3), st.integers(2, 3), st.integers(0, 2))
def test_no_policy_exceeds_the_bound(seed: int, count: int, states: int, resources: int) -> None:
    agents = problem(seed, count, states)
    found = coupled.joint_optimum(agents, resources)
    best, solved = found.value - found.error, bound(agents, resources, window=16)
    assert solved.upper >= best - 1e-9
    prices = np.random.default_rng(seed).uniform(0, 1, 5)  # any prices give a bound
    assert bound(agents, resources, prices=prices).upper >= best - 1e-9
    if resources >= count:
        assert solved.upper == pytest.approx(best, abs=1e-3)


@pytest.mark.parametrize("seed", range(4))
def test_the_joint_optimum_is_that_of_brute_force(seed: int) -> None:
    agents = problem(seed, 3, 2 + seed % 2, 2 + seed // 2)
    found = coupled.joint_optimum(agents, 1)
    assert found.value == pytest.approx(joint_optimum(agents, 1), abs=1e-6)
    assert exact_value(agents, found, 1) == pytest.approx(found.value, abs=1e-6)
    with pytest.raises(LimitError, match=r"3 agents of . states have .* joint states; expected at most 7"):
        coupled.joint_optimum(agents, 1, largest=7)


@costly(3, 10)
@given(st.integers(0, 10**6), st.integers(1, 3), st.integers(2, 3), st.integers(0, 2))
def test_samples_are_between_the_optimum_and_the_prices_bound(seed: int, count: int, states: int, M: int) -> None:
    """Prices of a sample path never give a lower bound than the best actions on it, whichever prices it begins with."""
    agents = problem(seed, count, states)
    best = coupled.joint_optimum(agents, M).value
    solved = bound(agents, M, prices=np.random.default_rng(seed).uniform(0, 1, 30))
    exact, by_prices = (
        sampled_bound(agents, M, paths=30, seed=seed, solved=solved, largest=largest) for largest in (5000, 1)
    )
    assert best - 4 * exact.stderr - 1e-6 <= exact.mean <= by_prices.mean + 1e-9
    assert by_prices.mean <= solved.upper + 1e-9


@costly(2, 7)
@given(st.integers(0, 10**6), st.integers(1, 3), st.floats(0, 2))
def test_without_chance_samples_give_the_optimum(seed: int, count: int, M: float) -> None:
    rng = np.random.default_rng(seed)
    P = np.eye(3)[rng.integers(3, size=(count, 2, 3))]
    uses = np.stack([np.zeros((count, 3)), rng.uniform(0.2, 1.5, size=(count, 3))], axis=1)
    agents = Agents(P, rng.normal(size=(count, 2, 3)), uses, gamma=GAMMA)
    found = sampled_bound(agents, M, paths=2, solved=bound(agents, M, prices=rng.uniform(0, 1, 70)))
    assert found.mean == pytest.approx(coupled.joint_optimum(agents, M).value, abs=1e-5)
    assert found.stderr < 1e-9


@pytest.mark.parametrize("seed", thinned(range(3), 3))
def test_the_best_prices_are_those_of_the_linear_program(seed: int) -> None:
    agents = problem(seed, 4, 3)
    wanted = best_in_expectation(agents, 1, 12)
    found = bound(agents, 1, window=12)
    assert found.upper >= wanted - 1e-7
    assert found.upper == pytest.approx(wanted, abs=2e-3)


def exact_value(agents: Agents, act: Any, resources: float) -> float:
    """Return the value of a policy that does not depend on the step, by iteration over joint states."""
    K, _, S = agents.shape
    P, states = matrices(agents), list(itertools.product(range(S), repeat=K))
    actions = act(10**6, np.array(states))
    value = np.zeros((S,) * K)
    for _ in range(150):
        new = np.empty_like(value)
        for x, joint in zip(states, actions, strict=True):
            assert sum(agents.uses[k, joint[k], x[k]] for k in range(K)) <= resources
            after = value
            for k in reversed(range(K)):
                after = np.tensordot(after, P[k, joint[k], x[k]], axes=(k, 0))
            new[x] = sum(agents.R[k, joint[k], x[k]] for k in range(K)) + GAMMA * after
        value = new
    return float(value[tuple(agents.initial.argmax(axis=1))])


@pytest.mark.parametrize("seed", thinned(range(3), 3))
def test_simulated_means_are_the_policys_value(seed: int) -> None:
    agents = problem(seed, 3)
    act, solved = policy(agents, "benefit", 1), bound(agents, 1, window=12)
    wanted = exact_value(agents, act, 1)
    plain, varied = (simulate(agents, act, 1, runs=600, seed=seed, control=one) for one in (None, solved))
    for run in (plain, varied):
        assert abs(run.value - wanted) < 4 * run.stderr + run.rest
    assert varied.stderr < plain.stderr
    np.testing.assert_array_equal(plain.rewards, varied.rewards)
    first = simulate(agents, act, 1, runs=10, seed=seed)
    np.testing.assert_array_equal(first.rewards, plain.rewards[:10])  # more runs do not change the first ones


@costly(12, 40)
@given(st.integers(0, 10**6), st.integers(1, 6), st.integers(2, 3), st.integers(0, 4))
def test_compiled_choices_are_those_of_the_index(seed: int, count: int, actions: int, resources: int) -> None:
    rng = np.random.default_rng(seed)
    one = problem(seed, count, 3, actions)
    uses = np.pad(rng.integers(1, 3, (count, actions - 1)), ((0, 0), (1, 0)))
    agents = Agents(matrices(one), one.R, uses=uses, gamma=GAMMA)
    act = policy(agents, "benefit", resources)
    states = rng.integers(3, size=(20, count))
    expected, found = act(0, states), np.empty((20, count), dtype=np.int64)
    use, left = agents.flat[1].copy(), float(resources)  # as in `propose`, so that it is compiled once
    for row, place in zip(found, states + agents.kind * 3, strict=True):
        serve(act.gain[0], use, act.rest[0], place, left, np.zeros(count, dtype=bool), row)
    np.testing.assert_array_equal(found, expected)


def test_rollout_is_better_than_the_policy_it_begins_from() -> None:
    better = []
    for seed in (2, 11):
        agents = problem(seed, 3, 2)
        solved = bound(agents, 1, window=12)
        options = RolloutOptions(samples=1000, horizon=25, alternatives=6)
        act = policy(agents, "rollout", 1, solved=solved, rollout=options)
        # After the last step with a price, the base policy is the one without prices.
        value = exact_value(agents, act, 1)
        better.append(value - exact_value(agents, act.base, 1))
        assert better[-1] > -1e-3, seed
        assert value <= joint_optimum(agents, 1) + 1e-9
        states = np.array(list(itertools.product(range(2), repeat=3)))
        np.testing.assert_array_equal(act(3, states), act(3, states[::-1])[::-1])
    assert max(better) > 1e-2


@pytest.mark.parametrize(("seed", "name"), [(0, "prices"), (1, "benefit")])
def test_policies_are_below_the_bound(seed: int, name: str) -> None:
    found = certify(problem(seed, 4, 2), name, 2, runs=500, seed=seed)
    assert found.runs.value <= found.bound.upper + 4 * found.runs.stderr + found.runs.rest
    assert found.gap_percent >= -1


def test_a_given_bound_is_for_the_same_units_of_the_resource() -> None:
    agents = problem(3, 2)
    solved = bound(agents, 1, window=12)
    assert joint_optimum(agents, 2) > solved.upper
    with pytest.raises(ValueError, match="resources 2: expected 1, as the given bound is for"):
        sampled_bound(agents, 2, solved=solved)
    with pytest.raises(ValueError, match="resources 2: expected 1, as the given bound is for"):
        certify(agents, "prices", 2, solved=solved)


def test_a_policy_without_value_has_no_finite_gap() -> None:
    agents = Agents(np.ones((1, 2, 1, 1)), [[[0.0], [1.0]]], gamma=GAMMA)
    assert certify(agents, lambda _, states: np.zeros_like(states), 1, runs=5).gap_percent == np.inf
    assert certify(agents, "prices", 1, runs=5).gap_percent == pytest.approx(0, abs=1e-3)


def test_the_whittle_index_is_the_price_of_indifference() -> None:
    checked = 0
    for seed in range(12):
        agents = problem(seed, 1, 4)
        found, P = whittle_index(agents), matrices(agents)[0]
        if not found.indexable.all():
            continue
        for s in range(4):
            price = found.index[0, s] * np.array([0.0, 1.0])[:, None]
            value = np.zeros(4)
            for _ in range(300):
                q = agents.R[0] - price + GAMMA * P @ value
                value = q.max(axis=0)
            assert q[1, s] == pytest.approx(q[0, s], abs=1e-7)
            checked += 1
    assert checked > 20


@pytest.mark.parametrize(("reward", "indexable", "index"), [(1.0, False, None), (-1.0, True, -np.inf)])
def test_an_action_may_lead_to_where_it_is_not_allowed(reward: float, indexable: bool, index: float | None) -> None:
    # State 0 leads to 1, where the agent may act for ever, or by acting to 2, where it may not act. At a very low price
    # it therefore waits in state 0. With a reward of 1, it acts there at prices from -1/8 to 1.
    P = np.zeros((1, 2, 3, 3))
    P[0, 0, 0, 1] = P[0, 1, 0, 2] = P[0, :, 1, 1] = P[0, :, 2, 2] = 1
    R = np.zeros((1, 2, 3))
    R[0, 1, 0] = reward
    agents = Agents(P, R, gamma=0.9, allowed=np.array([[[True] * 3, [True, True, False]]]))
    found = whittle_index(agents)
    assert found.indexable[0] == indexable
    if indexable:
        np.testing.assert_allclose(found.index[0], [index, 0.0, -np.inf], atol=1e-9)
    else:
        with pytest.raises(ValueError, match="not indexable"):
            policy(agents, "whittle", 1)


def test_kinds_are_shared_and_archives_are_read_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    P, R = rng.dirichlet(np.ones(3), size=(2, 2, 3)), rng.normal(size=(2, 2, 3))
    kinds = [0, 1, 1, 0]
    few = Agents(P, R, gamma=GAMMA, kind=kinds)
    many = Agents([P[k] for k in kinds], [R[k] for k in kinds], gamma=GAMMA)
    prices = rng.uniform(0, 1, 10)
    assert bound(few, 1, prices=prices).upper == pytest.approx(bound(many, 1, prices=prices).upper, abs=1e-9)
    few.save(tmp_path / "problem.npz")
    again = Agents.load(tmp_path / "problem.npz")
    np.testing.assert_array_equal(again.P.toarray(), few.P.toarray())
    assert bound(again, 1, prices=prices).upper == bound(few, 1, prices=prices).upper
    (tmp_path / "other.npz").write_bytes(b"")
    with pytest.raises(ValueError, match=r"other\.npz: expected a file that Agents\.save wrote"):
        Agents.load(tmp_path / "other.npz")


def test_actions_may_use_different_units() -> None:
    agents = problem(3, 4, 3, actions=3)
    agents = Agents(matrices(agents), agents.R, uses=[[0, 1, 2]] * 4, gamma=GAMMA)
    solved = bound(agents, 3, window=6)
    act = policy(agents, "prices", 3, solved=solved)
    states = np.array(list(itertools.product(range(3), repeat=4)))
    assert (act(0, states).sum(axis=1) <= 3).all()
    assert solved.upper >= simulate(agents, act, 3, runs=500).value - 1e-9
    with pytest.raises(ValueError, match="two actions"):
        policy(agents, "whittle", 3)


P2 = np.full((1, 2, 2, 2), 0.5)
R2 = np.zeros((1, 2, 2))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"P": P2 * 1.1}, "P of agent 0, action 0, state 0: the row sums to 1.1; expected 1"),
        ({"P": P2 - 1}, "expected probabilities from 0 to 1"),
        ({"R": np.zeros((2, 2, 2))}, "R: 2 agents, but P has 1"),
        ({"R": np.zeros((1, 2, 3))}, r"R of agent 0: shape \(2, 3\); expected \(2, 2\)"),
        ({"R": np.full((1, 2, 2), np.nan)}, "finite"),
        ({"gamma": 1.0}, "gamma 1.0: expected at least 0 and below 1"),
        ({"uses": [[1, 1]]}, "expected an allowed action that uses nothing"),
        ({"uses": [[0, -1]]}, "uses: expected units of 0 or more"),
        ({"initial": [2]}, "initial: expected states of each agent"),
        ({"initial": [[0.5, 0.6]]}, "initial: expected distributions"),
        ({"kind": [1]}, "kind: expected one whole number from 0 to 0"),
        ({"allowed": [[True, True]]}, "allowed: "),
    ],
)
def test_what_is_no_problem_is_refused_in_one_sentence(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Agents(**({"P": P2, "R": R2} | given))


def test_numbers_below_zero_by_a_rounding_error_are_zero() -> None:
    """As 0.3 - 3 * 0.1 is -5.6e-17; rows may be off by 1e-9, and so may their entries."""
    below = 0.3 - 3 * 0.1
    assert below < 0
    P, uses = P2.copy(), np.array([[below, 1.0]])
    P[0, 0, 0] = [1.0, below]
    for kinds in (list(P), [[sparse.csr_array(p) for p in P[0]]]):
        agents = Agents(kinds, R2, uses=uses, initial=[[1.0, below]])
        np.testing.assert_array_equal(matrices(agents)[0, 0, 0], [1, 0])
        np.testing.assert_array_equal(agents.initial, [[1, 0]])
        np.testing.assert_array_equal(agents.uses[0, 0], [0, 0])
    assert P[0, 0, 0, 1] == below  # what was given is unchanged
    P[0, 0, 0] = [1.0, -2e-9]
    with pytest.raises(ValueError, match="expected probabilities from 0 to 1"):
        Agents(P, R2)


def test_wrong_policies_are_refused() -> None:
    agents = problem(0, 3)
    little = Agents(np.ones((1, 2, 1, 1)), [[[0.0], [1.0]]], uses=[[0.0, 5e-7]])  # a unit may be as small as one likes
    with pytest.raises(ValueError, match="use more than 0 units"):
        simulate(little, lambda _, x: np.ones_like(x), 0)
    assert simulate(little, lambda _, x: np.ones_like(x), 5e-7, runs=2).value > 0
    with pytest.raises(ValueError, match="use more than 1 units"):
        simulate(agents, lambda _, x: np.ones_like(x), 1)
    with pytest.raises(ValueError, match="expected actions"):
        simulate(agents, lambda *_: np.zeros(3), 1)
    with pytest.raises(ValueError, match="policy 'best': expected"):
        policy(agents, "best", 1)
