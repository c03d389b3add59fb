"""People whose actions the robot misses or confuses: the joint belief, what the robot does, and the simulation."""

from __future__ import annotations

import json
from dataclasses import asdict

import numpy as np
import pytest
from conftest import invoke, kit, thinned
from histories import by_enumeration
from hypothesis import given, settings
from hypothesis import strategies as st
from test_unknown_goals import SMALL, three_goals

from assist.declare.declared import plain
from assist.people import Choices, Grid, HumanModel, ImpossibleObservationError
from assist.person import AssistPOMDP, JointBelief, ObservationModel, Setting, qmdp
from assist.person.beliefs import PersonModel
from assist.person.evidence import Evidence
from assist.person.joint_belief import expected_answers, said_in
from assist.person.known_states import KnownStates
from assist.person.lazy_policy import LazyPolicy
from assist.person.problem_arrays import Acts
from assist.person.uncertain_states import UncertainStates
from assist.team import Episodes, Pool, simulate
from assist.team.state import worth_of_actions

GRID = Grid(np.array([0.2, 1.5]), np.array([0.0, 0.4, 1.0]))


def problem(several: bool) -> AssistPOMDP:
    choices = three_goals("tiny").choices() if several else Choices.of(kit("tiny"))
    model = HumanModel.exact(choices, lapse=0.01)
    return AssistPOMDP.of(model, grid=GRID, suggestions="all", population=SMALL)


PROBLEMS = {several: problem(several) for several in (False, True)}


@settings(max_examples=25, deadline=None)
@given(st.data(), st.booleans())
def test_the_joint_belief_equals_the_enumeration_of_histories(data: st.DataObject, several: bool) -> None:
    pomdp = PROBLEMS[several]
    c, policy = pomdp.model.choices, LazyPolicy(pomdp, qmdp)
    share = st.sampled_from([0.0, 0.05, 0.3])
    pairs = st.lists(st.sampled_from(c.names), min_size=2, max_size=2, unique=True)
    belief, x, steps = JointBelief.at(c.initial, pomdp.prior), c.initial, []
    for _ in range(data.draw(st.integers(1, 3))):
        confusion = data.draw(share | pairs.map(lambda pair: {pair[0]: {pair[1]: 0.4}}))
        model = ObservationModel(data.draw(share), confusion)
        going_on = [a for a in range(int(c.applicable[x].sum())) if not c.goal[c.targets[x, a]]]
        slot = data.draw(st.sampled_from(going_on))
        uniform = data.draw(st.tuples(st.floats(0, 0.99), st.floats(0, 0.99)))
        seen = model.draw(c, x, slot, uniform)
        suggestion = data.draw(st.sampled_from([-1, *range(len(c.names))]))
        belief = belief.after(model.evidence(c, seen), suggestion, policy, least=0.0, works=True)
        said, name = c.names[suggestion] if suggestion >= 0 else None, None if seen is None else c.names[seen]
        steps.append((model, said, name))
        x = int(c.targets[x, slot])
    expected = by_enumeration(pomdp, steps)
    expected /= expected.sum()
    found = np.zeros_like(expected)
    found[belief.situations] = belief.joint.reshape(len(belief.situations), *expected.shape[1:])
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
    assert belief.pruned == pytest.approx(0, abs=1e-12)


def test_improbable_states_are_left_out_and_their_probability_is_reported() -> None:
    pomdp = AssistPOMDP.of(HumanModel.exact(Choices.of(kit("paper-fixed"))), grid=GRID)
    model = ObservationModel(0.05, 0.1)
    c, policy, rng = pomdp.model.choices, LazyPolicy(pomdp, qmdp), np.random.default_rng(1)
    few = every = JointBelief.at(c.initial, pomdp.prior)
    x = c.initial
    for _ in range(12):
        slot = int(rng.choice([a for a in range(int(c.applicable[x].sum())) if not c.goal[c.targets[x, a]]]))
        evidence = model.evidence(c, model.draw(c, x, slot, (rng.random(), rng.random())))
        few, every = (
            one.after(evidence, -1, policy, works=True, least=least) for one, least in ((few, 1e-3), (every, 0))
        )
        x = int(c.targets[x, slot])
    assert len(few.situations) < len(every.situations)
    assert 0 < few.pruned < 0.05
    likely = dict(zip(every.situations.tolist(), every.probability, strict=True))
    assert all(abs(likely[x] - p) < 0.05 for x, p in zip(few.situations.tolist(), few.probability, strict=True))


def test_who_may_have_finished_does_nothing_more() -> None:
    pomdp = PROBLEMS[False]
    c, policy = pomdp.model.choices, LazyPolicy(pomdp, qmdp)
    last = int(np.flatnonzero((c.h == 1) & c.applicable.any(axis=1))[0])
    belief = JointBelief.at(last, pomdp.prior).after(Evidence.none(c), -1, policy)
    finished = belief.situations[c.goal[belief.situations]]
    assert finished.size
    again = belief.after(Evidence.none(c), -1, policy)
    still = again.probability[np.isin(again.situations, finished)].sum()
    assert still >= belief.probability[c.goal[belief.situations]].sum()
    with pytest.raises(ImpossibleObservationError, match="impossible in all states"):
        JointBelief.at(int(finished[0]), pomdp.prior).after(Evidence(np.ones(len(c.names) + 1)), -1, policy)


def test_the_robot_acts_on_the_expected_advantage_over_states() -> None:
    """A suggestion that one state does not have costs there as much as elsewhere, and changes nothing."""
    pomdp = PROBLEMS[False]
    c, policy = pomdp.model.choices, qmdp(pomdp)
    here, there = (int(x) for x in np.flatnonzero(~c.goal)[[0, 5]])
    joint = JointBelief(np.array([here, there]), np.stack([0.7 * pomdp.prior, 0.3 * pomdp.prior]))
    found = expected_answers(worth_of_actions, policy, np.array([here]), [joint])[0]
    alone = [policy.q_values(np.array([x]), pomdp.prior[None])[0] for x in (here, there)]
    said = [said_in(pomdp, np.array([x]))[0].tolist() for x in (here, there)]
    for action in range(int(pomdp.robot_actions[here])):
        other = said[1].index(said[0][action]) if action and said[0][action] in said[1] else 0
        elsewhere = alone[1][other] - (0 if other or not action else pomdp.robot_costs[here, action])
        assert found[action] == pytest.approx(0.7 * alone[0][action] + 0.3 * elsewhere)
    assert (found[int(pomdp.robot_actions[here]) :] == -np.inf).all()


def bytes_of(episodes: Episodes) -> bytes:
    return b"".join(np.asarray(value).tobytes() for name, value in vars(episodes).items() if name != "pruned")


@pytest.mark.parametrize("policy", thinned(["attention", "reactive", "priority"], 3))
def test_a_simulation_without_errors_is_that_of_perfect_observation(tiny_choices: Choices, policy: str) -> None:
    def run(observation: ObservationModel | None) -> Episodes:
        # a robot that may err suggests any applicable action
        setting = Setting(c_suggest=0.2, suggestions="all", observation=observation)
        pool = Pool.sample(tiny_choices, 3, seed=1, setting=setting)
        return simulate(pool, policy, humans=2, episodes=40, seed=4)

    exact = run(None)
    assert Setting(observation=ObservationModel(0, 0)).observation is None
    assert bytes_of(run(ObservationModel(0, 0))) == bytes_of(exact)
    nearly = run(ObservationModel(1e-12, 1e-12))  # the joint belief then has one state
    np.testing.assert_allclose(nearly.discounted_return, exact.discounted_return, rtol=0, atol=1e-9)
    assert exact.pruned is None
    assert nearly.pruned is not None


def test_an_observation_model_is_saved_with_its_setting_and_wrong_ones_are_refused() -> None:
    table = {"(fetch box-a)": {"fetch box-b": 0.2}}
    for observation in (ObservationModel(0.1, 0.2), ObservationModel(0.1, table)):
        setting = Setting(observation=observation)
        again = Setting(**json.loads(json.dumps(plain(setting))))
        assert asdict(again.observation or ObservationModel()) == asdict(observation)
    assert "observation" not in plain(Setting(observation=ObservationModel()))
    with pytest.raises(ValueError, match=r"miss 1: expected a number of 0 or more and below 1"):
        ObservationModel(1.0)
    with pytest.raises(ValueError, match="expected other actions only"):
        ObservationModel(0.0, {"(a)": {"(a)": 0.5}})
    with pytest.raises(ValueError, match="seen as they are"):
        Setting(observation=ObservationModel(0.1), execute=True)


def test_confusions_with_actions_that_the_task_does_not_have_are_refused() -> None:
    unknown = Setting(observation=ObservationModel(0, {"(fetch box-a)": {"(fetch box-x)": 0.5}}))
    with pytest.raises(ValueError, match=r"\(fetch box-x\) is no action of the task; .*such as \(fetch box-[ab]\)"):
        Pool.sample(kit("tiny"), 1, seed=1, setting=unknown)
    found = invoke("serve", "kitting/tiny", "--humans", 1, "--set", "observation.confusion={fetch = {return = 0.1}}")
    assert found.exit_code == 2
    assert "confusion: (fetch) is no action of the task; expected actions with all arguments" in found.stderr


def test_the_command_simulates_errors_of_observation() -> None:
    printed = json.loads(
        invoke(
            "simulate", "kitting/tiny", "--humans", "2", "--pool", "2", "--episodes", "20", "--policy", "attention",
            "--set", "observation.miss=0.05", "--set", "observation.confusion=0.1", "--json",
        ).stdout
    )  # fmt: skip
    assert printed["setting"]["observation"] == {"miss": 0.05, "confusion": 0.1}
    assert 0 <= printed["policies"][0]["pruned"] < 1e-3
    assert (
        "observation.miss"
        in invoke("simulate", "kitting/tiny", "--humans", "1", "--set", "observation.miss=1.5").stderr
    )


def test_an_action_that_is_seen_updates_a_belief_over_states_too() -> None:
    """Of two people one is in a known state, and the other one in either of two: what both do is seen as it is."""
    pomdp = PROBLEMS[False]
    policy, c = qmdp(pomdp), pomdp.model.choices
    first = c.initial
    slots = np.flatnonzero(c.applicable[first])[:2]
    second = int(c.targets[first, slots[0]])
    joint = JointBelief(np.array([first, second]), np.stack([0.6 * pomdp.prior, 0.4 * pomdp.prior]))
    belief = np.repeat(pomdp.prior[None], 2, axis=0)
    known = UncertainStates(np.array([first, first]), belief.copy(), np.zeros(2, dtype=bool), joints={1: joint})
    acts = Acts(np.full(2, first), np.array([1, 1]), np.full(2, slots[1]), np.zeros(2, dtype=bool))
    known.update(np.arange(2), acts, PersonModel.of(policy))
    alone = KnownStates(np.array([first, first]), belief.copy(), np.zeros(2, dtype=bool))
    alone.update(np.arange(2), acts, PersonModel.of(policy))
    np.testing.assert_array_equal(known.belief[0], alone.belief[0])
    said, done = int(said_in(pomdp, np.array([first]))[0, 1]), int(c.actions[first, slots[1]])
    expected = joint.after(Evidence.of(c, {done: 1.0}), said, policy)
    assert known.joints.keys() == {1}
    np.testing.assert_array_equal(known.joints[1].situations, expected.situations)
    np.testing.assert_allclose(known.belief[1], expected.belief, rtol=1e-12)
    assert policy.situations(known.x[1:]) == expected.likeliest
