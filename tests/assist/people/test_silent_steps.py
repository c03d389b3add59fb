"""Trust rules that see steps without a suggestion: everything that moves theta, compared with brute force."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from conftest import graph_task, thinned
from joint import joint_bounds
from silence import Belief, HalfSeen, Joint, OnePerson, Rested, ThreeInARow, TwoPeople
from test_trust_fit import recorded, seen

from assist.certify.team_bound import upper_bound
from assist.connect.observed import Observed
from assist.learning.likelihood import Method
from assist.learning.likelihood_table import LikelihoodTable
from assist.people.belief import Grid
from assist.people.choices import Choices
from assist.people.decision import NOTHING, Floats
from assist.people.human import Human, HumanModel
from assist.people.ranges import Population
from assist.people.trust_rules import Event, TrustRule, constant, outcome
from assist.people.user_code import UserCodeError
from assist.person.behaviour import Behaviour
from assist.person.joint_belief import JointBelief
from assist.person.observation_model import ObservationModel
from assist.person.pomdp import AssistPOMDP
from assist.person.qmdp import qmdp
from assist.person.robots import OfRobots
from assist.person.settings import Setting
from assist.person.solver import solve
from assist.team.pool import Pool
from assist.team.simulate import simulate
from assist.team.state import NOBODY, TeamAction, TeamState
from planner import sweep

GRID = Grid(np.array([0.4, 2.0]), np.array([0.0, 0.5, 1.0]))
GAMMA = 0.4
ON_GRID = [ThreeInARow(0.5, 0.0), ThreeInARow(0.5, 0.5)]
"""Rules that lead from points of the grid to such points, so that the grid's beliefs are those of people."""

RULES = [*ON_GRID, Rested(0.5)]


def chain() -> Choices:
    """Return a chain of three steps to the goal, on which one may go back."""
    return Choices.of(sweep(graph_task([(3, 2, 1), (2, 1, 1), (1, 0, 1), (2, 3, 2), (1, 2, 1)], start=3)))


def problem(rule: TrustRule, c_suggest: float = 0.05, of: Choices | None = None) -> AssistPOMDP:
    """Return one person's problem; on a task that is given, every action may be suggested."""
    model = HumanModel.exact(of or chain(), lapse=0.02)
    return AssistPOMDP.of(
        model, grid=GRID, gamma=GAMMA, robot=OfRobots(c_suggest=c_suggest), behaviour=Behaviour(trust=rule),
        suggestions="optimal" if of is None else "all",
    )  # fmt: skip


def beliefs_of(pomdp: AssistPOMDP) -> Belief:
    """Return the prior of a problem by single values."""
    found: Belief = {}
    for (b, t), p in np.ndenumerate(pomdp.prior):
        if p > 0:
            key = float(pomdp.grid.beta[b]), float(pomdp.grid.theta[t]), int(pomdp.grid.count[t])
            found[key] = float(p)
    return found


def exact(rule: TrustRule, c_suggest: float = 0.05) -> OnePerson:
    return OnePerson(chain(), rule, GAMMA, c_suggest, lapse=0.02)


@pytest.mark.parametrize("rule", thinned(ON_GRID[::-1]), ids=str)
def test_the_optimal_value_is_between_the_solvers_bounds(rule: TrustRule) -> None:
    """The values of the rule and of a constant theta are further apart than the depth of the tree leaves open."""
    pomdp, depth = problem(rule), 8
    rest = 2.1 * GAMMA**depth / (1 - GAMMA)  # no step costs more
    best = exact(rule).value(beliefs_of(pomdp), pomdp.model.choices.initial, depth)
    found = solve(pomdp, gap=1e-3)
    assert found.lower - 1e-9 <= best
    assert best - rest <= found.upper + 1e-9
    assert found.upper - found.lower < 2e-3 * abs(found.upper)


def test_silence_is_worth_something() -> None:
    """A robot that knows of it has another plan than one that counts suggestions alone."""
    silent, talking = (solve(problem(rule), gap=1e-3) for rule in (Rested(0.5), Rested(0.0)))
    assert silent.lower > talking.upper


def speaks(step: int) -> bool:
    return step % 4 != 1


@pytest.mark.parametrize(
    "case",
    thinned([(rule, world) for world in ("model", "people") for rule in (ON_GRID if world == "model" else RULES)]),
    ids=str,
)
def test_simulated_people_have_the_value_of_plain_arithmetic(case: tuple[TrustRule, str]) -> None:
    """People of the robot's model, and people of a pool with one beta and theta."""
    rule, world = case
    pomdp, c = problem(rule), chain()
    human = Human(2.0, 0.5, 0.0, c.h)
    setting = Setting(
        gamma=GAMMA, c_suggest=0.05, c_move=0.0, lapse=0.02, trust=rule, max_steps=12, knowledge="exact"
    )  # fmt: skip
    pool = Pool(setting, (human,), (qmdp(pomdp),), np.zeros(1, dtype=np.int64))

    def act(team: TeamState) -> TeamAction:
        person = np.full(team.location.shape, 0 if speaks(team.step) else NOBODY)
        person[~team.active.any(axis=1)] = NOBODY
        return team.act(person, team.first_optimal())

    found = simulate(pool, act, humans=[0], episodes=6_000, seed=0, world=world).discounted_return  # type: ignore[arg-type]
    plain = exact(rule) if world == "model" else replace(exact(rule), lapse=0.0)
    people: Belief = beliefs_of(pomdp) if world == "model" else {(2.0, 0.5, 0): 1.0}

    def says(step: int, x: int) -> int | None:
        return int(np.flatnonzero(c.optimal[x])[0]) if speaks(step) else None

    expected = plain.value(people, c.initial, 12, says)
    assert found.mean() == pytest.approx(expected, abs=4 * found.std() / np.sqrt(len(found)))


@pytest.mark.parametrize("rule", RULES, ids=str)
def test_theta_in_a_trace_moves_in_silent_steps(rule: TrustRule) -> None:
    setting = Setting(gamma=0.9, c_suggest=0.3, c_move=0.0, trust=rule, knowledge="exact")
    pool = Pool.sample(chain(), 1, seed=0, setting=setting, population=Population((0.1, 0.1), (0.5, 0.5)))
    plain, trace, silent = exact(rule), list[dict[str, Any]](), 0
    simulate(pool, "reactive", humans=[0], episodes=30, seed=1, trace=trace)
    c, moved, x = chain(), (0.5, 0), 0
    for before, row in zip([None, *trace[:-1]], trace, strict=True):
        if before is None or before["episode"] != row["episode"]:
            moved, x = (0.5, 0), int(c.initial)
        assert row["theta"] == pytest.approx(moved[0])
        names = [c.name(x, a) for a in range(int(c.applicable[x].sum()))]
        said = None if row["suggestion"] is None else names.index(row["suggestion"])
        silent, slot = silent + (said is None), names.index(row["action"])
        moved, x = plain.moved(x, said, slot, *moved), int(c.targets[x, slot])
    assert 10 < silent < len(trace)


@pytest.mark.parametrize("rule", thinned([Rested(0.5), ON_GRID[1]]), ids=str)
def test_no_policy_is_above_the_teams_bound(rule: TrustRule) -> None:
    setting = Setting(gamma=GAMMA, c_suggest=0.05, c_move=0.05, lapse=0.02, trust=rule, knowledge="exact")
    for size in (1, 2):
        pool = Pool(
            setting, (Human(2.0, 0.5, 0.0, chain().h),) * size, (qmdp(problem(rule)),), np.zeros(size, dtype=int)
        )
        bound = upper_bound(pool, gap=1e-3)
        for name in ("none", "attention", "priority", "whittle"):
            found = simulate(pool, name, humans=list(range(size)), episodes=1500, seed=0, world="model")
            value = found.discounted_return
            assert value.mean() - 4 * value.std(ddof=1) / np.sqrt(len(value)) <= bound.proven + 1e-9


SHORT = 0.2
"""A discount factor with which five steps are nearly everything."""


def two_people(rule: TrustRule) -> tuple[Pool, TwoPeople, tuple[Any, Any], float]:
    """Return two people, their brute force, how they begin, and what is left after five steps at most."""
    setting = Setting(gamma=SHORT, c_suggest=0.02, c_move=0.01, lapse=0.02, trust=rule, knowledge="exact", max_steps=5)
    pomdp = replace(problem(rule, c_suggest=0.02), gamma=SHORT)
    pool = Pool(setting, (Human(2.0, 0.5, 0.0, chain().h),) * 2, (qmdp(pomdp),), np.zeros(2, dtype=int))
    person = pomdp.model.choices.initial, tuple(beliefs_of(pomdp).items())
    both = TwoPeople(replace(exact(rule, 0.02), gamma=SHORT), c_move=0.01)
    return pool, both, (person, person), 2 * 2.03 * SHORT**5 / (1 - SHORT)


@pytest.mark.parametrize("rule", ON_GRID, ids=str)
def test_the_best_that_a_robot_can_do_for_two_people_is_just_below_the_bound(rule: TrustRule) -> None:
    """Theta of both moves in each step. The values of the two rules are further apart than these bounds."""
    pool, both, people, rest = two_people(rule)
    best, bound = both.value(people, 5), upper_bound(pool, gap=1e-4).proven
    assert best - rest <= bound + 1e-9
    assert bound <= best + 0.006 * abs(best)
    run = simulate(pool, "attention", humans=[0, 1], episodes=4000, seed=0, world="model").discounted_return
    assert run.mean() <= best + 4 * run.std() / np.sqrt(len(run))


@pytest.mark.parametrize("rule", ON_GRID, ids=str)
def test_two_people_solved_together_are_worth_what_plain_arithmetic_says(rule: TrustRule) -> None:
    pool, both, people, rest = two_people(rule)
    best, joint = both.value(people, 5), joint_bounds(pool, gap=1e-3)
    assert joint.gap <= 1e-3
    assert joint.lower <= best
    assert joint.upper >= best - rest
    assert joint.lower > joint.never + 0.004


@pytest.mark.parametrize("rule", ON_GRID, ids=str)
def test_two_people_have_the_value_of_plain_arithmetic(rule: TrustRule) -> None:
    pool, both, people, _ = two_people(rule)
    turns = [0, 1, None, 0, 1]

    def act(team: TeamState) -> TeamAction:
        person = np.full(team.location.shape, NOBODY if turns[team.step] is None else turns[team.step])
        person[~team.active[np.arange(len(person)), person.ravel()]] = NOBODY
        return team.act(person, team.first_optimal())

    found = simulate(pool, act, humans=[0, 1], episodes=8000, seed=0, world="model").discounted_return
    expected = both.value(people, 5, turns.__getitem__)
    assert found.mean() == pytest.approx(expected, abs=4 * found.std() / np.sqrt(len(found)))


@cache
def two_routes() -> Choices:
    """Return a task with two routes to the goal, so that a robot that misses a step does not know what to suggest."""
    edges = [(4, 3, 1), (4, 2, 2), (3, 1, 1), (3, 4, 1), (2, 1, 1), (2, 4, 2), (1, 0, 1), (1, 3, 1), (1, 2, 1)]
    return Choices.of(sweep(graph_task(edges, start=4)))


def half_seen(rule: TrustRule, gamma: float = GAMMA) -> tuple[AssistPOMDP, HalfSeen, Joint]:
    """Return a person whose actions are missed or confused, with their brute force and how they begin."""
    pomdp = replace(problem(rule, of=two_routes()), gamma=gamma)
    one = HalfSeen(two_routes(), rule, gamma, 0.05, 0.02, miss=0.2, confusion=0.3)
    start = pomdp.model.choices.initial
    return pomdp, one, {(start, *cell): p for cell, p in beliefs_of(pomdp).items()}


def as_mapping(belief: JointBelief, grid: Grid) -> Joint:
    """Return a joint belief by single values."""
    return {
        (int(belief.situations[n]), float(grid.beta[b]), float(grid.theta[t]), int(grid.count[t])): float(p)
        for (n, b, t), p in np.ndenumerate(belief.joint)
        if p > 0
    }


@pytest.mark.parametrize("rule", [*ON_GRID, constant()], ids=str)
def test_beliefs_over_states_are_those_of_plain_arithmetic(rule: TrustRule) -> None:
    """After suggestions and without, whatever is seen; the mean over what may be seen is the belief unseen."""
    pomdp, one, start = half_seen(rule)
    c, policy, model = pomdp.model.choices, qmdp(pomdp), ObservationModel(0.2, 0.3)

    def follow(belief: JointBelief, joint: Joint, said: list[int | None]) -> None:
        if not said:
            return
        _, found = one.step(joint, said[0])
        going_on = sum(sum(after.values()) for after in found.values())
        mean, unseen = defaultdict[Any, float](float), found[None]
        for sight, after in found.items():
            mass = sum(after.values())
            word = NOTHING if said[0] is None else said[0]
            then = belief.after(model.evidence(c, sight), word, policy, least=0.0, works=True)
            expected = {key: p / mass for key, p in after.items() if p > 0}
            assert as_mapping(then, pomdp.grid) == pytest.approx(expected, rel=1e-12)
            if sight is not None:
                assert then.evidence * (1 - model.miss) == pytest.approx(mass, rel=1e-12)
            for key, p in as_mapping(then, pomdp.grid).items():
                mean[key] += mass / going_on * p
            follow(then, expected, said[1:])
        assert mean == pytest.approx({key: p / sum(unseen.values()) for key, p in unseen.items() if p > 0}, rel=1e-12)

    first, other, on, back, last = (int(c.actions[x, slot]) for x, slot in ((4, 0), (4, 1), (3, 0), (3, 1), (1, 0)))
    for said in ([first, on, last], [other, None, on], [None, on, back], [first, first, None]):
        follow(JointBelief.at(c.initial, pomdp.prior), start, said)


@pytest.mark.parametrize("rule", thinned([ON_GRID[1], ON_GRID[0], constant()], 3), ids=str)
def test_what_a_robot_loses_that_sees_badly_is_that_of_plain_arithmetic(rule: TrustRule) -> None:
    """Compared in pairs with a robot that sees all, for the same people and chances."""
    pomdp, one, start = half_seen(rule, gamma=0.9)
    c = two_routes()

    def act(team: TeamState) -> TeamAction:
        person = np.full(team.location.shape, 0 if speaks(team.step) else NOBODY)
        person[~team.active.any(axis=1)] = NOBODY
        return team.act(person, team.first_optimal())

    def says(step: int, x: int) -> int | None:
        return int(c.actions[x, np.flatnonzero(c.optimal[x])[0]]) if speaks(step) else None

    def returns(seen: ObservationModel | None) -> Floats:
        setting = Setting(
            gamma=0.9, c_suggest=0.05, c_move=0.0, lapse=0.02, trust=rule, max_steps=5, knowledge="exact",
            observation=seen,
        )  # fmt: skip
        pool = Pool(setting, (Human(2.0, 0.5, 0.0, c.h),), (qmdp(pomdp),), np.zeros(1, dtype=np.int64))
        return simulate(pool, act, humans=[0], episodes=4000, seed=0, world="model").discounted_return

    lost = returns(None) - returns(ObservationModel(one.miss, one.confusion))
    expected = [each.policy_value(start, 5, says) for each in (replace(one, miss=0.0, confusion=0.0), one)]
    error = lost.std() / np.sqrt(len(lost))
    assert lost.mean() == pytest.approx(expected[0] - expected[1], abs=4 * error)
    assert expected[0] - expected[1] > 4 * error


@pytest.mark.parametrize("carry", [True, False])
@pytest.mark.parametrize("rule", [ThreeInARow(0.2, 0.05), Rested(0.1)], ids=str)
def test_estimates_have_the_theta_that_people_had(rule: TrustRule, carry: bool) -> None:
    """From each first theta, that at each suggestion and the last one follow step by step through the log."""
    rows = recorded(constant(), 3, 12, 1)
    log = LikelihoodTable.of(seen(rows), Method(lapse=0.01))
    before, last = log.thetas(rule, carry=carry)
    assert log.silences.sum() > 5
    for k, person in enumerate(log.people):
        own = [row for row in rows if row["person"] == person]
        for t in (0, 20, 40):
            theta, count, h, episode = log.theta[t], 0, 0, own[0]["episode"]
            for row in own:
                if row["episode"] != episode and not carry:
                    theta, count = log.theta[t], 0
                episode = row["episode"]
                event = Event.silent()
                if row["suggestion"] is not None:
                    assert before[k, h, t] == pytest.approx(theta, abs=1e-12)
                    h += 1
                    followed = np.asarray(row["action"] == row["suggestion"])
                    event = replace(event, followed=followed, suggested=np.asarray(True))
                counting: Any = rule
                theta = float(
                    counting.update(theta, event, count) if hasattr(rule, "counts") else rule.update(theta, event)
                )
                count = int(counting.counted(count, event)) if hasattr(rule, "counts") else 0
            if carry:
                assert last[k, t] == pytest.approx(theta, abs=1e-12)


def test_rules_that_do_not_look_are_not_moved() -> None:
    pomdp = problem(outcome(0.5, 1.0))
    silent = pomdp.suggested == NOTHING
    np.testing.assert_array_equal(pomdp.weight[silent], problem(constant()).weight[silent])
    assert not pomdp.moves[silent].any()
    assert problem(ON_GRID[0]).moves.all()


def test_exported_problems_move_theta_in_silence() -> None:
    pomdp = problem(ON_GRID[1])
    moves = Observed.of(pomdp).moves(pomdp.model.choices.initial, 0)
    assert moves is not None
    assert moves[:, :3].argmax(axis=1).tolist() == [1, 2, 2] * 3  # theta rises by a cell, and the count is 0
    assert Observed.of(problem(constant())).moves(pomdp.model.choices.initial, 0) is None


class Leaves(Rested):
    """A rule that leads out of the range in silence."""

    def update(self, theta: Any, event: Event) -> Any:
        return np.where(event.suggested, theta, theta + 0.5)


def test_a_rule_that_leads_out_of_the_range_in_silence_is_told() -> None:
    with pytest.raises(UserCodeError, match=r"leads to theta 1\.1 in silence; expected a number from 0 to 1"):
        Setting(trust=Leaves())
