"""Alpha vectors: the compiled look-ahead compared with a direct implementation."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from conftest import DOMAINS, table_of
from test_qmdp import GRID, make
from test_unknown_goals import three_goals

from assist.people import Choices, Grid, HumanModel
from assist.person import AssistPOMDP, OfRobots, VectorPolicy
from assist.person.belief_filter import Parts, child
from assist.person.problem_arrays import ProblemArrays
from planner import Instance


def random_vectors(pomdp: AssistPOMDP, seed: int = 3) -> VectorPolicy:
    """Return a policy with one to four vectors for every state except goals."""
    rng = np.random.default_rng(seed)
    counts = np.where(pomdp.model.choices.goal, 0, rng.integers(1, 5, len(pomdp.robot_actions)))
    first = np.concatenate([[0], np.cumsum(counts)])
    action = rng.integers(0, np.repeat(pomdp.robot_actions, counts))
    return VectorPolicy(pomdp, -10 * rng.random((first[-1], *pomdp.prior.shape)), action, first)


def worth(policy: VectorPolicy, x: int, belief: np.ndarray) -> float:
    rows = policy.vectors[policy.first[x] : policy.first[x + 1]]
    return max((float((row * belief).sum()) for row in rows), default=0.0)


def look_ahead(policy: VectorPolicy, x: int, r: int, belief: np.ndarray) -> float:
    """Return the value of robot action r, summed over the person's actions, with the filter of `AssistPOMDP`."""
    pomdp, choices = policy.pomdp, policy.pomdp.model.choices
    place, value = pomdp.afterstate[x, r], -pomdp.robot_costs[x, r]
    if choices.goal[place]:
        return value
    stays = ~choices.goals.goal[pomdp.hidden.goal_of, x]  # who has reached their goal costs no more
    total, going = belief.sum(), belief * stays[:, None]
    for a in np.flatnonzero(choices.applicable[place]):
        at = np.array([x]), np.array([r]), np.array([a])
        chance = float((pomdp.likelihood(*at)[0] * going).sum()) / total
        if chance > 0:
            after = pomdp.update(going[None] / going.sum(), *at)[0]
            value += chance * (-choices.costs[place, a] + pomdp.gamma * worth(policy, choices.targets[place, a], after))
    return value


def lockers() -> Choices:
    """A task with dead ends, in which two actions may lead to the same state."""
    folder = DOMAINS / "lockers"
    return Choices.of(table_of(Instance(folder / "two-lockers.pddl", folder / "domain.pddl")))


def problems(tiny_choices: Choices) -> dict[str, AssistPOMDP]:
    return {
        "optimal": make(tiny_choices),
        "all": make(tiny_choices, suggestions="all"),
        "execute": make(tiny_choices, robot=OfRobots(c_suggest=0.3, execute=True, c_execute=0.7)),
        "lockers": AssistPOMDP.of(HumanModel.exact(lockers()), grid=GRID),
        "goals": AssistPOMDP.of(HumanModel.exact(three_goals("tiny").choices()), grid=GRID, suggestions="all"),
        # With theta 1 a person always follows; with beta 1000, always takes the best action.
        "no lapses": AssistPOMDP.of(
            HumanModel.exact(tiny_choices, lapse=0.0), suggestions="all",
            grid=Grid(np.array([0.0, 1000.0]), np.array([0.0, 1.0])),
        ),
    }  # fmt: skip


@pytest.mark.parametrize("name", ["optimal", "all", "execute", "lockers", "goals", "no lapses"])
def test_action_values_equal_those_of_a_plain_look_ahead(tiny_choices: Choices, name: str) -> None:
    pomdp = problems(tiny_choices)[name]
    policy = random_vectors(pomdp)
    rng = np.random.default_rng(5)
    x = rng.permutation(np.flatnonzero(~pomdp.model.choices.goal))[:20]
    belief = rng.dirichlet(np.full(pomdp.prior.size, 0.3), len(x)).reshape(-1, *pomdp.prior.shape)
    q = policy.q_values(x, belief)
    for i, state in enumerate(x):
        expected = [look_ahead(policy, state, r, belief[i]) for r in range(pomdp.robot_actions[state])]
        np.testing.assert_allclose(q[i, : len(expected)], expected, rtol=1e-12)
        assert (q[i, len(expected) :] == -np.inf).all()


def test_the_best_vector_gives_value_and_action(tiny_choices: Choices) -> None:
    policy = random_vectors(make(tiny_choices))
    x = np.arange(len(tiny_choices))
    belief = np.random.default_rng(0).dirichlet(np.ones(6), len(x)).reshape(-1, 2, 3)
    value, action = policy.value(x, belief), policy.choose(x, belief)
    for i in x:
        assert value[i] == pytest.approx(worth(policy, i, belief[i]), rel=1e-12)
        if not tiny_choices.goal[i]:
            rows = slice(policy.first[i], policy.first[i + 1])
            products = (policy.vectors[rows] * belief[i]).sum(axis=(1, 2))
            assert action[i] == policy.action[rows][products.argmax()]
    assert (value[tiny_choices.goal] == 0).all()
    assert (action[tiny_choices.goal] == 0).all()


def test_what_does_not_fit_is_refused(tiny_choices: Choices) -> None:
    policy = random_vectors(make(tiny_choices))
    for wrong in (
        {"vectors": policy.vectors[:-1]},
        {"first": policy.first[:-1]},
        {"action": np.full_like(policy.action, 99)},
        {"first": np.concatenate([[0, 0], policy.first[2:]])},  # removes the first state's vectors
    ):
        with pytest.raises(ValueError, match="expected"):
            dataclasses.replace(policy, **wrong)  # type: ignore[arg-type]


def test_posteriors_do_not_depend_on_where_arrays_are_in_memory(tiny_choices: Choices) -> None:
    """A saved solution has the values of the one that was saved to the last bit, wherever its arrays come to lie."""
    pomdp = AssistPOMDP.of(HumanModel.exact(tiny_choices))
    m, size, found = ProblemArrays.of(pomdp), pomdp.prior.size, set()
    beliefs = np.random.default_rng(0).dirichlet(np.ones(size), 4)
    for order in ([4, 3, 2, 1, 0], [2, 3, 4, 0, 1], [0, 1, 2, 3, 4]):  # the posterior's array follows one of the parts
        memory = np.zeros(5 * size)
        after, *parts = (memory[place * size : (place + 1) * size] for place in order)
        for part, belief in zip(parts, beliefs, strict=True):
            part[:] = belief
        states = np.flatnonzero(~tiny_choices.goal).tolist()
        found.add(tuple(child(after, x, a, -1, Parts(*parts), m) for x in states for a in range(int(m.counts[x]))))
    assert len(found) == 1
