"""Trust rules: their laws, the filter against plain arithmetic, and what people do in simulations."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pytest
from conftest import KITTING, costly, invoke, kit, thinned
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field
from silence import OnePerson, ThreeInARow

from assist.certify.team_bound import upper_bound
from assist.connect.observed import Observed
from assist.declare.declared import Number, declared, plain, sentences
from assist.learning.method import Method
from assist.learning.rule_families import families
from assist.live.assistant import Assistant
from assist.people import (
    NOTHING,
    Choices,
    Grid,
    Human,
    HumanModel,
    Population,
    advice_takers,
    perceived_cost_to_go,
)
from assist.people.decision import Floats
from assist.people.trust_rules import (
    LEAST,
    RULES,
    EquationSeven,
    Event,
    Fitted,
    LogitSteps,
    Reliability,
    TrustRule,
    constant,
    counts_of,
    described,
    of_table,
    outcome,
    outcome_at_disagreement,
    plain_rule,
)
from assist.person import AssistPOMDP, OfRobots, Setting, solve
from assist.person.belief_filter import update
from assist.person.pomdp import Behaviour
from assist.person.problem_arrays import ProblemArrays
from assist.studies.protocol import read
from assist.team.pool import Pool
from assist.team.simulate import simulate

ALL: dict[str, TrustRule] = {
    "paper": EquationSeven(0.3),
    "constant": constant(),
    "outcome": outcome(0.5, 1.0),
    "outcome, exact": outcome(0.5, 1.0, "true"),
    "outcome-at-disagreement": outcome_at_disagreement(0.2, 0.5, 1.0),
    "reliability": Reliability(2.0, 0.1, 2),
    "three in a row": ThreeInARow(0.3, 0.1),
}


def event(
    gain: float = 1.0, agrees: bool = False, followed: bool = True, shown: bool = True, right: bool = True
) -> Event:
    return Event(*(np.asarray(each) for each in (gain, agrees, followed, shown, right)))


@declared
class Sluggish:
    """A rule by which theta moves by a share of the way."""

    share: Annotated[
        Number, Fitted(0.01, 1.0, (0.1, 0.3), logarithm=True), Field(gt=0, le=1, description="A share.")
    ] = 0.2
    feedback: Literal["never"] = "never"
    uses_answer: ClassVar[bool] = False
    tag: ClassVar[Mapping[str, str]] = {"rule": "sluggish"}

    def update(self, theta: Floats, event: Event) -> Floats:
        return theta + self.share * (np.where(event.gain > 0, 1.0, 0.0) - theta)


def test_all_that_a_shipped_rule_needs_is_its_class(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(RULES, "sluggish", Sluggish)
    assert Setting(trust="sluggish").trust_rule() == Sluggish()
    setting = Setting(trust={"rule": "sluggish", "share": 0.4})  # type: ignore[arg-type]
    assert setting.trust == Sluggish(0.4)
    assert Setting(**plain(setting)) == setting
    assert of_table(RULES, plain_rule(Sluggish(0.3))) == Sluggish(0.3)
    assert described(Sluggish) == "A rule by which theta moves by a share of the way"
    family = families(Method())["sluggish"]
    assert family.tried == ((np.log(0.1),), (np.log(0.3),))
    assert family.rule((np.log(0.5),)) == Sluggish(0.5)
    assert family.ranges == {"share": (np.log(0.01), 0.0)}


def test_every_shipped_rule_is_described_and_can_be_tried() -> None:
    assert set(families(Method())) == set(RULES)
    assert all(described(make) for make in RULES.values())
    assert all(name in sentences(Setting)["trust"] for name in RULES)
    known = families(Method(eta=0.3, utility_scale=2.0))["paper"]
    assert (known.ranges, known.rule(())) == ({}, EquationSeven(0.3, 2.0))


@given(st.floats(0, 1), st.floats(-50, 50), st.booleans(), st.booleans(), st.booleans())
def test_a_constant_theta_stays(theta: float, gain: float, agrees: bool, shown: bool, right: bool) -> None:
    seen = event(gain, agrees, shown=shown, right=right)
    assert constant().update(np.array(theta), seen) == theta


@given(st.floats(0, 1), st.booleans(), st.floats(0.01, 5), st.floats(0.01, 5))
def test_theta_moves_with_the_outcome_and_stays_without(theta: float, agrees: bool, gain: float, loss: float) -> None:
    rule = outcome(gain, loss)
    start = np.clip(theta, LEAST, 1 - LEAST)
    up, down = (rule.update(np.array(theta), event(agrees=agrees, right=right)) for right in (True, False))
    assert down <= start <= up
    assert LEAST <= down <= up <= 1 - LEAST
    assert rule.update(np.array(theta), event(agrees=agrees, shown=False)) == theta
    careful = outcome_at_disagreement(0.0, gain, loss)
    assert careful.update(np.array(theta), event(agrees=True)) == theta
    assert careful.update(np.array(theta), event(agrees=False)) == up


def test_what_cannot_be_is_refused() -> None:
    for rule, words in (
        ("papr", "trust: 'papr'; did you mean 'paper'"),
        (3, "expected a name, or an object"),
        ({"steps": 1}, "rule is missing; expected one of paper, constant"),
        ({"rule": "outcome", "steps": 1}, "trust: steps: unknown; expected one of agreement, gain"),
    ):
        with pytest.raises(ValueError, match=words):
            Setting(trust=rule)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="believed_trust: 'vanity'; expected one of paper"):
        Setting(believed_trust="vanity")
    with pytest.raises(ValueError, match="gain -1: expected a number from 0"):
        outcome(gain=-1)
    with pytest.raises(ValueError, match="feedback 'soon'"):
        LogitSteps(feedback="soon")  # type: ignore[arg-type]


def problem(rule: TrustRule | None, *, lapse: float = 0.05, h: Floats | None = None) -> AssistPOMDP:
    """Return the problem of a person whose perceived cost-to-go is known, if it is given."""
    choices = Choices.of(kit("tiny"))
    person = Human(1.0, 0.6, h=choices.h if h is None else h)
    model = HumanModel.own(choices, person, eta=0.3, lapse=lapse)
    grid = Grid(np.array([0.3, 1.5]), np.array([0.0, 0.4, 0.6, 1.0]))
    return AssistPOMDP.of(
        model, grid=grid, gamma=0.95, robot=OfRobots(c_suggest=0.1), suggestions="all", behaviour=Behaviour(trust=rule)
    )


def test_the_papers_rule_is_what_there_is_without_one() -> None:
    given, default = problem(EquationSeven(0.3)), problem(None)
    assert given.followed_low is None
    np.testing.assert_array_equal(given.low, default.low)
    np.testing.assert_array_equal(given.weight, default.weight)


@pytest.mark.parametrize("rule", ALL.values(), ids=ALL)
@given(seed=st.integers(0, 10_000))
@costly(3, 10)
def test_the_filter_is_that_of_plain_arithmetic(rule: TrustRule, seed: int) -> None:
    """The person's misconceptions and actions are random; a theta between grid points is shared between these."""
    rng = np.random.default_rng(seed)
    h = perceived_cost_to_go(Choices.of(kit("tiny")), 0.7, rng)
    pomdp = problem(rule, h=h)
    grid, choices, arrays = pomdp.grid, pomdp.model.choices, ProblemArrays.of(pomdp)
    one, hats = OnePerson(replace(choices, h=h), rule, 0.95, 0.1, lapse=0.05), np.eye(len(grid.values))
    x, plain = choices.initial, pomdp.prior
    belief, compiled = pomdp.prior[None], pomdp.prior.ravel().copy()
    for _ in range(4):
        action, slot = int(rng.integers(pomdp.robot_actions[x])), int(rng.integers(choices.applicable[x].sum()))
        said = None if pomdp.suggested[x, action] == NOTHING else int(pomdp.suggested[x, action])
        after = np.zeros((grid.shape[0], counts_of(rule) + 1, len(hats)))
        for (b, t), p in np.ndenumerate(plain):
            theta, count = one.moved(x, said, slot, grid.theta[t], int(grid.count[t]))
            chance = one.chances(x, said, grid.beta[b], grid.theta[t])[slot]
            after[b, count] += p * chance * np.array([np.interp(theta, grid.values, hat) for hat in hats])
        plain = after.reshape(grid.shape) / after.sum()
        belief = pomdp.update(belief, *(np.array([each]) for each in (x, action, slot)))
        update(compiled, np.empty_like(compiled), x, action, slot, arrays)
        np.testing.assert_allclose(belief[0], plain, atol=1e-12)
        np.testing.assert_allclose(compiled, plain.ravel(), atol=1e-12)
        x = int(choices.targets[x, slot])
        if choices.goal[x]:
            break


@pytest.mark.parametrize("rule", ALL.values(), ids=ALL)
@pytest.mark.slow
def test_bounds_of_the_solver_hold_the_simulated_return(rule: TrustRule) -> None:
    pomdp = problem(rule, lapse=0.01)
    solution = solve(pomdp, gap=0.02)
    human = Population().sample(pomdp.model.choices, 1, np.random.default_rng(0))[0]
    setting = Setting(gamma=0.95, c_suggest=0.1, c_move=0.0, lapse=0.01, suggestions="all", trust=rule, max_steps=400)
    pool = Pool(setting, (human,), (solution,), np.zeros(1, dtype=np.int64))
    found = simulate(pool, "attention", humans=[0], episodes=4000, seed=1, world="model").discounted_return
    error = found.std(ddof=1) / np.sqrt(len(found))
    assert found.mean() - 4 * error <= solution.upper
    assert solution.lower <= found.mean() + 4 * error


@pytest.mark.parametrize(
    "rule",
    [
        "constant",
        outcome(0.5, 1.0),
        outcome_at_disagreement(0.5, 1.0, 1.0),
        Reliability(2.0, 0.1, 2),
        ThreeInARow(0.4, 0.1),
    ],
    ids=str,
)
@pytest.mark.parametrize("states", [20_000, 5])
@pytest.mark.slow
def test_no_policy_exceeds_a_bound(rule: str | TrustRule, states: int) -> None:
    setting = Setting(c_suggest=0.1, c_move=0.1, trust=rule)
    pool = Pool.sample(kit("tiny"), 2, seed=0, setting=setting, states=states, region=4)
    bound = upper_bound(pool, gap=0.05, window=0)
    for name in ("none", "attention", "priority"):
        found = simulate(pool, name, humans=[0, 1], episodes=2000, seed=0, world="model").discounted_return
        assert found.mean() - 4 * found.std(ddof=1) / np.sqrt(len(found)) <= bound.proven + 1e-9


def advised(follows: Callable[[int], bool], **given: Any) -> tuple[list[float], list[int]]:
    """Return the believed mean of theta after each of twelve suggestions, and the steps at which these were made.

    Where nothing is suggested any action is taken, so that there is something to suggest again.
    """
    given = {"setting": Setting(c_suggest=0.05)} | given
    desk, rng = Assistant(kit("paper"), ["ann"], **given), np.random.default_rng(0)
    theta, at = [], []
    for step in range(400):
        if desk.person("ann").finished:
            desk.begin("ann")
        told, applicable = desk.recommend().suggestion, desk.person("ann").applicable
        others = [action for action in applicable if action != told]
        if told is not None and (follows(len(at)) or not others):
            desk.observe("ann", told)
        else:
            desk.observe("ann", others[int(rng.integers(len(others)))])
        if told is not None:
            at.append(step)
            chances = desk.person("ann").belief.sum(axis=0)
            theta.append(float(chances @ np.linspace(0, 1, len(chances))))
        if len(at) == 12:
            break
    return theta, at


def test_somebody_who_ignores_suggestions_is_believed_to() -> None:
    """All twelve suggestions are ignored: the believed theta falls, and suggestions become rarer than under equation
    (7).
    """
    theta, at = advised(lambda _: False)
    assert theta[11] < 0.3
    assert theta == sorted(theta, reverse=True)
    paper = {"setting": Setting(c_suggest=0.05, trust="paper"), "population": Population()}
    before, often = advised(lambda _: False, **paper)
    assert before[-1] > 0.99
    assert at[11] - at[3] > 2 * (often[11] - often[3])


def test_somebody_who_follows_every_second_suggestion_is_believed_to() -> None:
    theta, at = advised(lambda number: number % 2 == 1)
    assert len(at) == 12
    assert 0.35 < theta[11] < 0.65


def test_a_rule_that_looks_at_answers_is_not_exported() -> None:
    with pytest.raises(ValueError, match="depends on whether advice is followed"):
        Observed.of(problem(outcome(0.5, 1.0)))
    Observed.of(problem(constant()))


def test_commands_take_a_rule() -> None:
    """People with constant trust have another mean return, and the record names the rule."""
    tiny = ("simulate", KITTING / "tiny.pddl", "--humans", 2, "--episodes", 10, "--policy", "reactive", "--json")
    found = [json.loads(invoke(*tiny, *more).stdout) for more in ((), ("--trust", "constant"))]
    assert "trust" not in found[0]["setting"]
    assert found[1]["setting"]["trust"] == "constant"
    assert found[0]["policies"] != found[1]["policies"]
    values = [
        json.loads(invoke("policy", KITTING / "tiny.pddl", "--trust", rule, "--gap", 1, "--json").stdout)
        for rule in list(RULES)[:2]
    ]
    assert values[0]["value_always"] != values[1]["value_always"]
    refused = invoke("policy", KITTING / "tiny.pddl", "--trust", "blind")
    assert (refused.exit_code, "--trust: 'blind'; expected one of paper" in refused.stderr) == (2, True)


def test_a_study_has_a_condition_for_each_rule(tmp_path: Path) -> None:
    file = tmp_path / "study.toml"
    file.write_text(
        f'instances = ["{KITTING / "tiny.pddl"}"]\nhumans = [2]\n[[conditions]]\nname = "rules"\n'
        'settings = [{trust = "constant"}, {trust = {rule = "outcome-at-disagreement", gain = 0.5, loss = 1.0}}]\n'
    )
    study = read(file)
    rules = [setting.trust for _, setting in study.conditions[0].settings]
    assert rules == ["constant", LogitSteps(0.03, gain=0.5, loss=1.0)]
    saved = study.record()["conditions"][0]["settings"][1][1]["trust"]
    assert of_table(RULES, saved) == rules[1]


@pytest.mark.parametrize("trust", thinned(["outcome", "paper", "constant"], 3))
def test_what_the_robot_believes_changes_the_robot_and_nobody_else(trust: str) -> None:
    """People who get the same advice act alike; attention, which plans by its belief, advises otherwise."""
    found: dict[str, dict[str | None, list[tuple[float, ...]]]] = {"reactive": {}, "attention": {}}
    for believed in (None, "paper", "constant", "outcome"):
        setting = Setting(c_suggest=0.05, c_move=0.0, trust=trust, believed_trust=believed)
        pool = Pool.sample(kit("tiny"), 2, seed=1, setting=setting, population=advice_takers())
        for policy, by in found.items():
            trace: list[dict] = []
            result = simulate(pool, policy, humans=[0, 1], episodes=15, seed=2, trace=trace)
            by[believed] = [tuple(row["theta"] for row in trace), tuple(result.discounted_return.tolist())]
    assert found["reactive"][None] == found["reactive"]["paper"] == found["reactive"]["constant"]
    for by in found.values():
        assert by[trust] == by[None]
    assert len({str(by) for by in found["attention"].values()}) > 1


def test_the_shipped_study_of_trust_crosses_rules_and_beliefs() -> None:
    study = read("trust")
    assert dict(study.populations)["advice takers"] == advice_takers()
    assert study.repeats >= 30
    rules = {setting.trust_rule() for one in study.conditions for _, setting in one.settings}
    assert rules == {constant(), outcome(), outcome_at_disagreement(), EquationSeven()}
    for one in study.conditions[:4]:
        beliefs = [setting.believed_rule() for _, setting in one.settings]
        assert len(set(beliefs)) == len(beliefs)
        assert beliefs[0] == one.settings[0][1].trust_rule()
        assert {constant(), EquationSeven()} <= set(beliefs)


def by_hand(theta: float, count: int, right: bool) -> float:
    """Return theta after an outcome with weight 2 and forgetting .1, where the sum of counts moves twice."""
    n = 0.9 * (2.0, 2.8, 3.52)[min(count, 2)]
    return min(max((n * min(max(theta, 0.01), 0.99) + right) / (n + 1), 0.01), 0.99)


def test_a_robot_has_a_grid_for_each_number_of_outcomes() -> None:
    pomdp = problem(Reliability(2.0, 0.1, 2, "true"))
    assert pomdp.grid.theta.tolist() == [0.0, 0.4, 0.6, 1.0] * 3
    assert pomdp.prior[:, 4:].sum() == 0
    assert pomdp.followed_low is not None
    assert pomdp.followed_weight is not None
    for x, r in zip(*np.nonzero(pomdp.suggested != NOTHING), strict=True):
        right = bool(pomdp.model.choices.optimal[x, pomdp.suggested[x, r]])
        for t, theta in enumerate(pomdp.grid.theta):
            count = t // 4
            assert pomdp.low[x, r, 0, t] // 4 == count
            low, up = pomdp.followed_low[x, r, 0, t], pomdp.followed_weight[x, r, 0, t]
            assert low // 4 == (low + 1) // 4 == min(count + 1, 2)
            mean = (1 - up) * pomdp.grid.theta[low] + up * pomdp.grid.theta[low + 1]
            assert mean == pytest.approx(by_hand(theta, count, right), abs=1e-12)


@pytest.mark.parametrize("world", ["people", "model"])
def test_people_count_outcomes(world: str) -> None:
    """Theta in a trace equals values by hand; in the robot's model, the mean over many people does."""
    setting = Setting(c_suggest=0.0, c_move=0.0, trust=Reliability(2.0, 0.1, 2, "true"))
    trace: list[dict] = []
    pool = Pool.sample(kit("tiny"), 1, seed=0, setting=setting)
    episodes = 150 if world == "model" else 20
    simulate(pool, "reactive", humans=[0], episodes=episodes, seed=0, trace=trace, world=world)  # type: ignore[arg-type]
    by: dict[str, list[dict]] = {}
    for row in trace:
        by.setdefault(row["episode"], []).append(row)
    off, outcomes = [], 0
    for rows in by.values():
        count = 0
        for before, after in itertools.pairwise(rows):
            seen = before["suggestion"] is not None and before["suggestion"] == before["action"]
            off.append(after["theta"] - (by_hand(before["theta"], count, True) if seen else before["theta"]))
            count += seen
        outcomes = max(outcomes, count)
    assert outcomes > 2
    allowed = 1e-12 if world == "people" else 5 * np.std(off) / np.sqrt(len(off))
    assert abs(np.mean(off)) <= allowed
    assert world == "model" or np.max(np.abs(off)) < 1e-12
