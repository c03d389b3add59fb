"""A person's problem with a robot that comes and goes: each of its states compared with the definition."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from conftest import costly, graph_task
from hypothesis import given
from hypothesis import strategies as st
from test_goal_bounds import ring
from test_qmdp import PlainBackup

from assist.people import NOTHING, Choices, Grid, HumanModel, outcome
from assist.person import QMDP, AssistPOMDP, AttentionSubproblem, LeafBounds, OfRobots, attention_subproblem, qmdp
from assist.person.attention_subproblem import backwards
from assist.person.pomdp import Behaviour
from assist.person.time_expansion import AWAY, HERE
from planner import LimitError, sweep

edges = st.tuples(st.integers(1, 5), st.integers(0, 5), st.sampled_from([1, 1, 2]))
GRID = Grid(np.array([0.3, 2.0]), np.array([0.0, 0.5, 1.0]))


def moves(position: int, actions: int, entry_steps: int) -> list[tuple[int, int, bool]]:
    """Each move of the robot: what a robot that is present would do, its position after it, and whether it comes."""
    if position == HERE:
        return [(0, AWAY, False), *((action, HERE, False) for action in range(actions))]
    if position == AWAY and entry_steps:
        return [(0, AWAY, False), (0, HERE + entry_steps, True)]
    if position == AWAY:
        return [(0, AWAY, False), *((action, HERE, True) for action in range(1, actions))]
    return [(0, position, False)]


def problem(drawn: list[tuple[int, int, int]], *, execute: bool = False) -> AssistPOMDP:
    """The problem of a person whose trust depends on what they answer, on a graph."""
    model = HumanModel.exact(Choices.of(sweep(graph_task(drawn))), lapse=0.01)
    robot = OfRobots(c_suggest=0.1, execute=execute)
    return AssistPOMDP.of(
        model, grid=GRID, gamma=0.9, robot=robot, suggestions="all", behaviour=Behaviour(trust=outcome())
    )


def is_as_defined(
    found: AttentionSubproblem, price: list[float], on_actions: tuple[list[float], list[float]] = ([], [])
) -> None:
    """Compare each state's robot actions and choices with those of the person alone.

    `price` is charged for attention, and `on_actions` in addition for a suggestion and for an execution.
    """
    alone, pomdp, layout = found.alone, found.pomdp, found.layout
    own, choices = alone.model.choices, pomdp.model.choices
    attended = found.attended()
    charged = [*price, 0.0]
    more = [[*prices, *[0.0] * len(charged)] for prices in on_actions]
    for i in range(len(layout)):
        x, step, position = int(layout.x[i]), int(layout.step[i]), int(layout.position[i])
        final = bool(alone.ends[x]) or bool(layout.cut[i])
        options = moves(position, int(alone.robot_actions[x]), found.entry_steps)
        options = options[:1] if final else options
        assert pomdp.robot_actions[i] == len(options)
        for r, (action, then, comes) in enumerate(options):
            busy = (r > 0 or position > HERE) and not final
            assert attended[i, r] == busy
            assert pomdp.suggested[i, r] == alone.suggested[x, action]
            assert pomdp.afterstate[i, r] == layout.number(step, then, alone.afterstate[x, action])
            suggests = action > 0 and alone.suggested[x, action] != NOTHING
            executes = action > 0 and not suggests
            cost = alone.robot_costs[x, action] + found.entry * comes + charged[step] * busy
            cost += (more[0][step] * suggests + more[1][step] * executes) * busy
            assert pomdp.robot_costs[i, r] == pytest.approx(cost)
            for name in ("unsuggested", "low", "weight", "followed_low", "followed_weight"):
                one, other = getattr(pomdp, name), getattr(alone, name)
                assert (one is None) == (other is None)
                if one is not None:
                    np.testing.assert_array_equal(one[i, r], other[x, action])
        assert not attended[i, len(options) :].any()
        assert (pomdp.suggested[i, len(options) :] == NOTHING).all()
        assert (pomdp.afterstate[i, len(options) :] == i).all()
        assert not pomdp.robot_costs[i, len(options) :].any()
        then = position - 1 if position > HERE else position
        for slot in range(own.applicable.shape[1]):
            leads = bool(own.applicable[x, slot]) and not final
            assert choices.applicable[i, slot] == leads
            assert choices.targets[i, slot] == (layout.number(step + 1, then, own.targets[x, slot]) if leads else i)
    for name in ("key", "h", "goal", "actions", "costs", "optimal"):
        if getattr(own, name) is not None:
            np.testing.assert_array_equal(getattr(choices, name), getattr(own, name)[layout.x])
    assert (choices.key is None) == (own.key is None)
    assert (choices.state, choices.terms, choices.features) == (None, None, None)
    assert (layout.step[choices.initial], layout.position[choices.initial]) == (0, AWAY)
    assert layout.x[choices.initial] == own.initial
    np.testing.assert_array_equal(pomdp.model.q, alone.model.q[layout.x])
    np.testing.assert_array_equal(pomdp.chosen, alone.chosen[layout.x])
    order = pomdp.order
    assert order is not None
    for one, h in zip(order, own.goals.h, strict=True):
        assert sorted(one.tolist()) == list(range(len(layout)))
        keys = [(-layout.step[i], h[layout.x[i]]) for i in one]
        assert keys == sorted(keys)


def ends_as_defined(found: AttentionSubproblem) -> None:
    """Where the person's states end, so do those of the subproblem; 0 is the bound where only the step has ended."""
    layout, frontier, alone = found.layout, found.pomdp.frontier, found.alone
    assert alone.frontier.away is not None
    bounds = {}
    for place, x in enumerate(alone.frontier.states):
        for i in np.flatnonzero(layout.x == x):
            bounds[i] = (alone.frontier.away if layout.position[i] == AWAY else alone.frontier.upper)[place]
    for i in np.flatnonzero(layout.cut & ~alone.model.choices.goal[layout.x]):
        bounds.setdefault(i, np.zeros(GRID.shape))
    assert frontier.states.tolist() == sorted(bounds)
    for i, upper in zip(frontier.states, frontier.upper, strict=True):
        np.testing.assert_array_equal(upper, bounds[i])


@costly(7, 30)
@given(
    st.lists(edges, min_size=2, max_size=9), st.sampled_from([(0, None), (2, None), (1, 3)]),
    st.lists(st.sampled_from([0.25, 1.0]), max_size=3), st.booleans(), st.integers(0, 10**6),
)  # fmt: skip
def test_each_state_is_as_defined(
    drawn: list[tuple[int, int, int]], way: tuple[int, int | None], price: list[float], execute: bool, seed: int
) -> None:
    """The person has all states of their task, or only some at each step."""
    alone, (steps, longest) = problem(drawn, execute=execute), way
    rng = np.random.default_rng(seed)
    kept = rng.random((len(price) + 1, len(alone.ends))) < 0.7
    kept[0, alone.model.choices.initial] = True
    leaves = np.flatnonzero(~alone.model.choices.goal & (rng.random(len(alone.ends)) < 0.2))
    away, here = -rng.random((2, len(leaves), *GRID.shape))
    part = replace(alone, frontier=LeafBounds(leaves, here, here, away=away))
    for person, mask in ((alone, None), (part, kept)) if price else ((alone, None),):
        found = AttentionSubproblem.of(person, 0.4, steps, price, longest=longest, kept=mask)
        if mask is not None:
            ends_as_defined(found)
        assert found.layout.positions == 2 + max(steps, longest or 0)
        is_as_defined(found, price)
        other = found.priced(np.full(len(price), 2.0))
        np.testing.assert_array_equal(other.price, 2.0)
        is_as_defined(other, [2.0] * len(price))
        np.testing.assert_allclose(found.at_price(0.5).robot_costs, found.pomdp.robot_costs + 0.5 * found.attended())
        for step, position in ((0, AWAY), (len(price), HERE)):
            at = found.states(step, position)
            np.testing.assert_array_equal(at, [found.layout.number(step, position, x) for x in range(len(alone.ends))])


@costly(7, 30)
@given(
    st.lists(edges, min_size=2, max_size=9), st.sampled_from([0, 2]), st.integers(1, 3), st.booleans(),
    st.integers(0, 10**6),
)  # fmt: skip
def test_actions_have_prices_of_their_own(
    drawn: list[tuple[int, int, int]], steps: int, length: int, execute: bool, seed: int
) -> None:
    """Prices of suggestions and executions are added, changed and taken off again."""
    alone = problem(drawn, execute=execute)
    first, second = np.random.default_rng(seed).uniform(0.1, 2.0, (2, 3, length))
    free = AttentionSubproblem.of(alone, 0.4, steps, [0.5] * length)
    assert not free.on_actions.any()
    one = free.priced(first)
    other = one.priced(second)
    back = other.priced(first[0])
    for found, rows in ((one, first), (other, second), (back, np.vstack([first[:1], np.zeros((2, length))]))):
        np.testing.assert_array_equal(found.price, rows[0])
        np.testing.assert_array_equal(found.on_actions, rows[1:])
        is_as_defined(found, rows[0].tolist(), (rows[1].tolist(), rows[2].tolist()))


def test_other_prices_change_the_bounds_where_the_task_ends() -> None:
    """The same as if the subproblem had been built with them; rows keep nothing of a memory of actions."""
    alone = problem([(3, 2, 1), (2, 1, 1), (1, 0, 1), (2, 3, 2), (1, 2, 1)])
    own = alone.model.choices
    memory = {"state": np.arange(len(own)), "terms": ("near",), "features": np.ones((*own.costs.shape, 1))}
    alone = replace(
        alone,
        model=replace(alone.model, choices=replace(own, **memory)),
        frontier=LeafBounds(np.array([2]), np.full((1, 1, 3), -7.0), np.full((1, 1, 1), -2.0), floor=-9.0),
    )
    one, other = (AttentionSubproblem.of(alone, 0.4, 1, price) for price in ([0.5, 0.25], [2.0, 1.0]))
    is_as_defined(one, [0.5, 0.25])
    moved = one.priced(np.array([2.0, 1.0]))
    np.testing.assert_array_equal(moved.pomdp.frontier.lower, other.pomdp.frontier.lower)
    assert (moved.pomdp.frontier.lower < one.pomdp.frontier.lower).any()


def test_a_robot_does_not_see_who_has_reached_one_of_several_goals() -> None:
    alone = AssistPOMDP.of(HumanModel.exact(ring().choices()), grid=GRID)
    for price in ([], [1.0, 1.0]):
        is_as_defined(AttentionSubproblem.of(alone, 0.4, 0, price), price)


def test_whole_numbers_are_prices_too(monkeypatch: pytest.MonkeyPatch) -> None:
    alone = problem([(2, 1, 1), (1, 0, 1)])
    found = AttentionSubproblem.of(alone, 0.4, 0, [1, 2])
    assert found.price.dtype == float
    assert AttentionSubproblem.of(alone, 0.4).price.shape == (0,)
    is_as_defined(found, [1.0, 2.0])
    monkeypatch.setattr("assist.person.attention_subproblem.available_memory", lambda: 1e8)
    with pytest.raises(LimitError, match="with ways of up to 200,000 steps"):
        AttentionSubproblem.of(alone, 0.4, 200_000)


def test_values_with_prices_go_backwards_from_those_without(monkeypatch: pytest.MonkeyPatch) -> None:
    chain = [(3, 2, 1), (2, 1, 1), (1, 0, 1), (2, 3, 1), (1, 2, 1)]
    alone = AssistPOMDP.of(HumanModel.exact(Choices.of(sweep(graph_task(chain, start=3)))), grid=GRID, gamma=0.6)
    cheap = np.where(alone.suggested == NOTHING, alone.robot_costs, 0.01)
    alone = replace(alone, robot_costs=cheap)
    free = AttentionSubproblem.of(alone, 0.3, 1)
    tail = qmdp(free.pomdp, tolerance=1e-12).value_mdp
    visits = AttentionSubproblem.of(alone, 0.3, 1, [0.5, 0.0, 1.0])
    found: QMDP = backwards(visits, tail)
    plain, exact = PlainBackup(visits.pomdp), np.zeros_like(found.value_mdp)
    for _ in range(60):
        exact = plain.backup(exact)
    np.testing.assert_allclose(found.value_mdp, exact, atol=1e-5)
    assert (found.value_mdp >= exact - 1e-9).all()
    begun: dict[str, Any] = {}
    monkeypatch.setattr(attention_subproblem, "qmdp", lambda _, **options: begun.update(options))
    backwards(visits, tail)
    layout = visits.layout
    for i in range(len(layout)):
        free_from = tail[layout.position[i] * layout.states + layout.x[i]] if layout.step[i] == 3 else 0.0
        assert (begun["above"][i] == free_from).all()
    assert begun["tolerance"] == 1e-5
