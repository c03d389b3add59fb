"""What follows where a part of a task breaks off: nobody gets more, and hardly less where all is looked at."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from conftest import KITTING, table_of

from assist.people.choices import Choices
from assist.people.decision import perceived_cost, perceived_value
from assist.people.human import Human, Population
from assist.person import AssistPOMDP, qmdp
from assist.person.region import never_erring
from assist.team.bounded import bounded
from assist.team.settings import Setting
from assist.team.subproblem import AWAY, HERE, Visits
from planner import Instance, LimitError, Table

ENTRY = 0.4
PRIOR = Population(sigma=(1.0, 1.0))


def kit(task: str) -> Table:
    return table_of(Instance(file := KITTING / f"{task}.pddl", file.parent / "domain.pddl"))


def somebody(noise: Any = "state") -> Human:
    (human,) = Population(sigma=(1.0, 1.0), noise=noise).sample(None, 1, np.random.default_rng(3))
    return human


def part_and_whole(
    task: str, size: int, setting: Setting, human: Human | None, steps: int = 0
) -> tuple[AssistPOMDP, np.ndarray, Choices]:
    """Give the problem on a part; and of its frontier's states the values, shape (m, 2, B, T), with all looked at."""
    table = kit(task)
    problem = bounded(table, setting, human, PRIOR, entry=ENTRY, size=size).problem
    choices = Choices.of(table)
    visits = Visits.of(setting.problem(choices, human, PRIOR), ENTRY, steps)
    values = qmdp(visits.pomdp).value_mdp
    both = np.stack([values[visits.states(0, position)] for position in (AWAY, HERE)], axis=1)
    assert problem.frontier is not None
    # States are told apart by their keys, whatever their numbers are here and there.
    place = {int(key): x for x, key in enumerate(choices.keys)}
    assert len(place) == len(choices)
    at = [place[int(key)] for key in problem.model.choices.keys[problem.frontier.states]]
    return problem, both[at], choices


@pytest.mark.parametrize(
    ("task", "size", "setting", "human"),
    [
        ("sealed", 4, Setting(c_suggest=0.2), somebody()),
        ("costs/ways", 3, Setting(c_suggest=0.2, eta=0.8), somebody()),
        ("tiny", 3, Setting(suggestions="all", gamma=0.95, lapse=0.02), somebody("action")),
        ("tiny", 4, Setting(c_suggest=0.1, knowledge="exact"), None),
    ],
)
def test_nobody_gets_more(task: str, size: int, setting: Setting, human: Human | None) -> None:
    """In tasks with dead ends, and with actions that cost nothing; and so nobody whose robot needs time to come."""
    for steps in (0, 2):
        problem, values, _ = part_and_whole(task, size, setting, human, steps)
        frontier = problem.frontier
        assert frontier is not None
        assert frontier.away is not None
        assert (frontier.away >= values[:, 0] - 1e-6).all()
        assert (frontier.upper >= values[:, 1] - 1e-6).all()
        anybody = never_erring(problem.model.choices.h[frontier.states], kit(task).task.costs, setting.gamma)
        assert (frontier.upper <= anybody[:, None, None] + 1e-9).all()
        assert steps or (frontier.away < anybody[:, None, None] - 0.1).any()  # it is known that they err
        assert (frontier.away <= frontier.upper + 1e-9).all()


def test_what_is_looked_at_as_a_whole_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the larger part is all of the task, and sweeps go on to the end, bounds are the values."""
    for name, value in (("HIDDEN", 3), ("ERROR", 1e-4), ("SWEEPS", 10_000)):
        monkeypatch.setattr(f"assist.team.bounded.{name}", value)
    problem, values, _ = part_and_whole("tiny", 100, Setting(c_suggest=0.2), somebody())
    frontier = problem.frontier
    assert frontier is not None
    assert frontier.away is not None
    np.testing.assert_allclose(frontier.away, values[:, 0], atol=1e-3)
    np.testing.assert_allclose(frontier.upper, values[:, 1], atol=1e-3)
    assert (values[:, 1] - values[:, 0]).max() > 0.3  # coming costs


def test_prices_count_on_the_larger_part_at_their_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where it is all of the task, values are those of the problem in which each state is there for every step."""
    for name, value in (("HIDDEN", 3), ("TIMED", 3), ("ERROR", 1e-6), ("SWEEPS", 10_000)):
        monkeypatch.setattr(f"assist.team.bounded.{name}", value)
    table, setting, human = kit("tiny"), Setting(c_suggest=0.2), somebody()
    found = bounded(table, setting, human, PRIOR, entry=ENTRY, size=100, around=True)
    between, timed = found.between, found.timed
    assert between is not None
    assert timed is not None
    price = np.array([0.0, 0.6, 0.3, 0.5])
    values = between.priced(price)
    whole = Visits.of(setting.problem(between.visits.alone.model.choices, human, PRIOR), ENTRY, 0, price)
    exact, layout = qmdp(whole.pomdp).value_mdp, whole.layout
    own = between.visits.layout.number(0, layout.position, layout.x)
    np.testing.assert_allclose(values[layout.step, own], exact, atol=1e-4)
    assert (values[-1] - values[0]).max() > 0.5

    visits = between.beyond(Visits.of(timed, ENTRY, 0, price), values)
    frontier, inner = visits.pomdp.frontier, visits.layout
    assert frontier is not None
    states = frontier.states
    x = between.place[inner.x[states]]
    np.testing.assert_array_equal(between.visits.alone.model.choices.keys[x], visits.pomdp.model.choices.keys[states])
    expected = exact[layout.number(inner.step[states], inner.position[states], x)]
    np.testing.assert_allclose(frontier.upper, expected, atol=1e-4)


def test_what_is_expected_beyond_is_known() -> None:
    """A suggestion moves trust by what the person expects of the state it leads to, looked at or not."""
    setting, human = Setting(), somebody()
    problem, _, choices = part_and_whole("tiny", 3, setting, human)
    assert problem.frontier is not None
    expected = perceived_value(choices, perceived_cost(choices, human.expects(choices)))
    place = {int(key): x for x, key in enumerate(choices.keys)}
    part = problem.model.choices
    inside = np.setdiff1d(np.arange(len(part)), problem.frontier.states)
    moved = 0
    for x in inside[~part.goal[inside]]:
        for robot in range(1, int(problem.robot_actions[x])):
            y = part.targets[x, problem.suggested[x, robot]]
            gain = expected[place[int(part.keys[y])]] - expected[place[int(part.keys[x])]]
            after = np.clip(problem.grid.theta + setting.eta * gain, 0.0, 1.0)
            low, weight = problem.grid.shares(after)
            np.testing.assert_allclose(problem.low[x, robot] + problem.weight[x, robot], low + weight, atol=1e-9)
            moved += y in problem.frontier.states
    assert moved > 0


def test_memory_is_asked_for_beforehand() -> None:
    with pytest.raises(LimitError, match=r"^bounding what somebody gets on \d+ states takes about \d+ MB"):
        bounded(kit("tiny"), Setting(), somebody(), PRIOR, entry=ENTRY, size=2, memory_limit_mb=0.01)


def test_where_memory_is_short_they_are_seen_on_a_smaller_part(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("assist.team.bounded.HIDDEN", 3)
    table, who = kit("paper"), somebody()
    found = [
        bounded(table, Setting(), who, PRIOR, entry=ENTRY, size=10, around=True, memory_limit_mb=most).outer
        for most in (math.inf, 3.0)
    ]
    large, small = found
    assert large is not None
    assert small is not None
    assert 10 < len(small.value) < len(large.value) / 2
    # Less is known on it, and no bound is lower.
    initial = [
        (one.value[one.visits.pomdp.model.choices.initial] * one.visits.pomdp.prior).sum() for one in (large, small)
    ]
    assert initial[0] < initial[1]


def test_they_are_hidden_on_as_many_states_as_time_and_memory_allow(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("HIDDEN", 40), ("FEW", 5), ("TIMED", 30), ("TIMED_FEW", 4)):
        monkeypatch.setattr(f"assist.team.bounded.{name}", value)
    looked_at = []
    for limits in ({}, {"kept_mb": 0.1}, {"kept_mb": 4.0}, {"until": 0.0}):
        found = bounded(kit("paper"), Setting(), somebody(), PRIOR, entry=ENTRY, size=50, around=True, **limits)
        looked_at.append([0 if one is None else int((~one.final).sum()) for one in (found.problem, found.timed)])
    everything, short, some, late = looked_at
    assert everything == [40, 30]
    assert short[0] == late[0] == 5
    assert 5 < some[0] < 40


def test_without_time_nobody_errs_beyond() -> None:
    """The bounds are those of people who never err, which hold in any case."""
    table, setting = kit("tiny"), Setting()
    at_once, in_time = (
        bounded(table, setting, somebody(), PRIOR, entry=ENTRY, size=3, until=until).problem
        for until in (0.0, math.inf)
    )
    hurried, bound = at_once.frontier, in_time.frontier
    assert hurried is not None
    assert bound is not None
    anybody = never_erring(at_once.model.choices.h[hurried.states], table.task.costs, setting.gamma)
    np.testing.assert_allclose(hurried.upper, np.broadcast_to(anybody[:, None, None], hurried.upper.shape))
    assert (bound.upper <= hurried.upper).all()
    assert (bound.upper < hurried.upper - 0.1).any()
