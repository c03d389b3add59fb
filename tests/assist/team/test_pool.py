"""Pools: the people from whom teams are drawn, the robot's knowledge of them, and memory."""

from __future__ import annotations

import pickle
import re
from dataclasses import replace
from functools import partial
from typing import Annotated, Any

import numpy as np
import pytest
from conftest import thinned
from pydantic import Field
from teams import reachable

from assist.declare.declared import Number, declared
from assist.people import Choices, Human, Population
from assist.person import AssistPOMDP, ObservationModel, Policy, Setting, qmdp
from assist.team import Pool, simulate
from assist.team.trace import Trace
from planner import LimitError, Table


def test_pools_that_cannot_be(tiny_choices: Choices) -> None:
    for size in (0, -1, 2.0, True):
        with pytest.raises(ValueError, match="size"):
            Pool.sample(tiny_choices, size, seed=0)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="goal cannot be reached"):
        Pool.sample(replace(tiny_choices, h=np.full(len(tiny_choices), np.inf)), 2, seed=0)


@pytest.mark.parametrize("options", [{}, {"suggestions": "all"}, {"execute": True}, {"knowledge": "exact"}])
def test_memory_is_known_before_it_is_taken(fixed: Table, options: dict[str, Any]) -> None:
    """The predicted memory of a pool is that of its arrays, and a pool beyond the limit is refused."""
    setting, choices = Setting(**options), Choices.of(fixed)
    pool = Pool.sample(choices, 2, seed=0, setting=setting)
    arrays = [array for p in pool.policies for array in reachable(p, "", {}).items() if ".choices." not in array[0]]
    taken = sum(array.nbytes for array in {id(array): array for _, array in arrays}.values()) / 1e6
    needed = taken * (1 + 1 / len(pool.policies))  # one of them is there twice for a time
    Pool.sample(choices, 2, seed=0, setting=setting, memory_limit_mb=1.03 * needed)
    with pytest.raises(LimitError, match=r"states take about .* MB of memory, and .* are allowed") as refused:
        Pool.sample(choices, 2, seed=0, setting=setting, memory_limit_mb=0.97 * needed)
    assert ("knowledge 'exact'" in str(refused.value)) == (len(pool.policies) > 1)


@pytest.mark.parametrize("policy", thinned(["none", "reactive", "attention", "attention-never", "priority"]))
def test_only_people_who_are_drawn_are_solved_and_results_are_the_same(tiny_choices: Choices, policy: str) -> None:
    solved: list[AssistPOMDP] = []

    def solver(pomdp: AssistPOMDP) -> Policy:
        solved.append(pomdp)
        return qmdp(pomdp)

    setting = Setting(c_suggest=0.1, c_move=0.1)
    lazy = Pool.sample(tiny_choices, 8, seed=0, setting=setting, solver=solver)
    assert not solved
    told: list[tuple[str, int, int | None]] = []
    found = simulate(lazy, policy, humans=2, episodes=3, seed=4, jobs=2, progress=lambda *what: told.append(what))
    drawn = set(found.people.ravel().tolist())
    assert 2 <= len(drawn) < 8
    needs = policy.startswith("attention")  # priority has its own problems; the other policies have none
    assert {id(one) for one in solved} == {id(lazy.policies[n].pomdp) for n in drawn if needs}
    assert len(solved) == len(drawn) * needs  # once each
    if policy not in ("none", "reactive"):
        assert ("solving people's POMDPs", len(drawn), len(drawn)) in told
    assert told[-1] == (f"simulating {policy}", 3, 3)
    eager = Pool.sample(tiny_choices, 8, seed=0, setting=setting)
    for one in eager.policies:
        one.prepare()
    assert list(simulate(eager, policy, humans=2, episodes=3, seed=4)) == list(found)


class ByCostToGo(Policy):
    """A policy of the user for one person: suggest something where the goal is at least so many cost units away."""

    def __init__(self, pomdp: AssistPOMDP, least: float) -> None:
        self.pomdp, self.least = pomdp, least  # type: ignore[misc]

    def q_values(self, x: np.ndarray, belief: np.ndarray) -> np.ndarray:  # noqa: ARG002
        action = np.arange(self.pomdp.suggested.shape[1])
        worth = np.where(self.pomdp.model.choices.h[x] >= self.least, 3.0, -1.0)[:, None] * (action > 0)
        return np.where(action < self.pomdp.robot_actions[x][:, None], worth, -np.inf)


@pytest.mark.parametrize("policy", ["attention", "priority"])
def test_a_policy_of_the_user_needs_a_problem_and_values(tiny_choices: Choices, policy: str) -> None:
    setting = Setting(c_move=0.0, knowledge="exact")
    pools = [
        Pool.sample(tiny_choices, 2, seed=0, setting=setting, solver=partial(ByCostToGo, least=least))
        for least in (np.inf, 0.0)
    ]
    never, always = (simulate(pool, policy, humans=2, episodes=5, seed=1) for pool in pools)
    if policy == "attention":
        assert never.interventions.sum() == 0
        assert (always.interventions >= always.steps - 1).all()
    else:  # it solves problems of its own
        assert list(never) == list(always)
    direct = replace(pools[0], policies=(ByCostToGo(pools[0].policies[0].pomdp, np.inf),))
    assert list(simulate(direct, policy, humans=2, episodes=5, seed=1)) == list(never)


def test_people_of_large_tasks_are_solved_when_they_are_drawn(tiny: Table) -> None:
    pool = Pool.sample(tiny, 8, seed=0, setting=Setting(c_suggest=0.1, c_move=0.1), states=5)
    for name in ("attention", "priority", "attention-never"):
        found = simulate(pool, name, humans=2, episodes=1, seed=1)
        drawn = set(found.people.ravel().tolist())
        assert {n for n, one in enumerate(pool.policies) if one.solved} == drawn  # type: ignore[attr-defined]


def test_the_robots_grid_covers_the_people_it_is_told_of(tiny_choices: Choices) -> None:
    experts = Population(beta=(5.0, 8.0), theta=(0.8, 0.9))
    pomdp = Pool.sample(tiny_choices, 1, seed=0, population=experts).policies[0].pomdp
    assert 5 < pomdp.grid.beta[0] < pomdp.grid.beta[-1] < 8
    assert pomdp.prior.sum(axis=1) @ pomdp.grid.beta == pytest.approx(6.5)
    assert pomdp.prior.sum(axis=0) @ pomdp.grid.theta == pytest.approx(0.85)


def test_exact_knowledge_shares_one_policy(tiny_choices: Choices) -> None:
    assert len(Pool.sample(tiny_choices, 6, seed=0, setting=Setting(knowledge="exact")).policies) == 1


def test_a_team_of_different_tasks_costs_and_models(tiny_choices: Choices, fixed: Table) -> None:
    """Each person of a mixed team acts as in a pool of their own kind."""
    small = Pool.sample(tiny_choices, 2, seed=1, setting=Setting(c_suggest=0.05, c_move=0.1))
    large = Pool.sample(Choices.of(fixed), 2, seed=2, setting=Setting(c_suggest=0.1, c_move=0.1))
    mixed = Pool.joined([small, large])
    assert [len(mixed.choices(i)) for i in range(4)] == [21, 21, 128, 128]
    trace: Trace = []
    episodes = simulate(mixed, mixed.policy("attention"), humans=[2, 1, 3], episodes=100, seed=0, trace=trace)
    assert episodes.finished.all()
    assert episodes.actions.min(axis=0).tolist() == [10, 6, 10]
    assert episodes.helped.sum(axis=0).min() > 0
    for row in trace:
        charged = 0.05 if row["place"] == 1 else 0.1
        paid = -row["reward"] - row["cost"] - charged * (row["suggestion"] is not None)
        assert paid == pytest.approx(0, abs=1e-9) or paid == pytest.approx(0.1)


def test_people_may_be_mistaken_about_actions(tiny_choices: Choices) -> None:
    pool = Pool.sample(tiny_choices, 2, seed=0, population=Population(noise="action"))
    assert simulate(pool, pool.policy("attention"), humans=2, episodes=3, seed=0).finished.all()


def test_the_robot_may_take_people_for_others(tiny_choices: Choices) -> None:
    novices = Population(beta=(0.1, 0.5))
    matched = Pool.sample(tiny_choices, 2, seed=0, population=novices)
    general = Pool.sample(tiny_choices, 2, seed=0, population=novices, prior=Population())
    assert [p.beta for p in matched.people] == [p.beta for p in general.people]
    assert matched.policies[0].pomdp.grid.beta.max() < 0.5
    assert general.policies[0].pomdp.grid.beta.max() > 2.5


@pytest.mark.parametrize(
    ("name", "one", "other"),
    [
        ("trust", {}, {"trust": "constant"}), ("observation", {}, {"observation": ObservationModel(miss=0.3)}),
        ("c_ask", {}, {"c_ask": 0.1}), ("robots", {}, {"robots": 2}),
        ("neighbours", {}, {"neighbours": {"rule": "followed"}}),
    ],
)  # fmt: skip
def test_pools_whose_world_differs_are_not_joined(
    tiny: Table, name: str, one: dict[str, Any], other: dict[str, Any]
) -> None:
    """What holds for the whole team is read from the first pool's setting."""
    pools = [Pool.sample(tiny, 1, seed=1, setting=Setting(knowledge="exact", **each)) for each in (one, other)]
    for pair in (pools, pools[::-1]):
        with pytest.raises(ValueError, match=f"joined: {name} is"):
            Pool.joined(pair)


@declared
class Shift(Setting):
    """A setting with a field of the whole team that no other code knows."""

    length: Annotated[Number, Field(ge=0, description="Length of a shift, in steps.")] = 0.0


def test_a_field_of_ones_own_is_one_of_the_whole_team(tiny: Table) -> None:
    pools = [Pool.sample(tiny, 1, seed=1, setting=Shift(length=length)) for length in (8, 9)]
    with pytest.raises(ValueError, match=re.escape("joined: length is [8.0, 9.0] in these pools; expected the same")):
        Pool.joined(pools)
    assert Pool.joined(pools[:1] * 2).setting == pools[0].setting


@pytest.mark.cases
def test_a_pool_alone_is_no_list_of_pools(tiny: Table) -> None:
    with pytest.raises(TypeError, match=r"joined: expected a list of pools, such as \[pool, other\]"):
        Pool.joined(Pool.sample(tiny, 1, seed=1))  # type: ignore[arg-type]


def test_pools_with_other_rates_of_trust_are_joined(tiny: Table) -> None:
    """The rate of equation 7 belongs to each person's model, whether the rule is named or not."""
    people = Population(beta=(0.1, 0.3), theta=(0.3, 0.3))
    slow, quick = (
        Pool.sample(tiny, 1, seed=seed, population=people, setting=Setting(knowledge="exact", eta=eta, trust=trust))
        for seed, eta, trust in ((1, 0.0, None), (2, 0.5, "paper"))
    )
    for pools, person in (([slow, quick], 1), ([quick, slow], 0)):
        alone, both = (simulate(pool, "attention", humans=[who], episodes=20, seed=3)
                       for pool, who in ((quick, 0), (Pool.joined(pools), person)))  # fmt: skip
        np.testing.assert_array_equal(alone.discounted_return, both.discounted_return)


def test_given_people_are_at_a_task_under_any_setting(tiny: Table) -> None:
    drawn = Pool.sample(tiny, 3, seed=1)
    same = Pool.of(tiny, drawn.people, prior=Population())
    for setting in (drawn.setting, Setting(c_suggest=0.1)):
        one, other = drawn.under(setting), same.under(setting)
        assert one == other == pickle.loads(pickle.dumps(other))
        assert simulate(one, "attention", humans=2, episodes=3, seed=2) == simulate(
            other, "attention", humans=2, episodes=3, seed=2
        )


@pytest.mark.parametrize(
    ("people", "error", "words"),
    [
        ([1.0], TypeError, "expected Human(beta, theta) for each, not what is a float"),
        ([], ValueError, "number of people 0: expected a whole number of 1 or more"),
        ([Human(1, 0.5, name="ann")] * 2, ValueError, "two people are called ann; expected a name for each"),
    ],
)
def test_people_who_cannot_be(people: Any, error: type[Exception], words: str, tiny: Table) -> None:
    with pytest.raises(error, match=re.escape(words)):
        Pool.of(tiny, people)
