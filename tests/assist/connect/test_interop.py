"""Exported problems are equal to the original in every number, and SARSOP's policies are read correctly."""

from __future__ import annotations

import dataclasses
import json
import re
import sys
import xml.etree.ElementTree as ElementTree
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import KITTING, TESTS, invoke, table_of, thinned, write_instance
from scipy.sparse import csr_array
from test_alpha_vectors import lockers, problems
from test_bounded import Clearheaded
from test_qmdp import GRID, make

from assist.connect import read_policy, to_pomdp_py, write_pomdp, write_pomdpx
from assist.connect.observed import Observed, action_names
from assist.people import Choices, HumanModel, remembered
from assist.person import AssistPOMDP, Assumptions, OfRobots, TruncatedTask, evaluate
from assist.person.behaviour import Behaviour
from assist.person.closed_problem import closed_problem
from assist.person.qmdp import qmdp
from planner import InputFileError, Instance, Table, load, sweep
from planner.system.errors import MissingExtraError

# SARSOP's own output for `make(tiny_choices, h)`, exported by `write_pomdpx`: `pomdpsol -p 0.02 -o tiny.policy
# tiny.pomdpx` (APPL 0.9) ended with the bounds below. That person's misconceptions were drawn state by state.
POLICY = TESTS / "data" / "tiny.policy"
LOWER, UPPER = -7.24383, -7.2274

NAMES = ["optimal", "all", "execute", "lockers", "no lapses"]


class Pomdpx:
    """A reader of POMDPX, which evaluates each table at values of the parents and the variable."""

    def __init__(self, path: Path) -> None:
        root = ElementTree.parse(path).getroot()
        self.gamma = float(root.findtext("Discount", ""))
        self.values: dict[str, list[str]] = {}
        self.observed = []
        for node in root.findall("Variable/StateVar"):
            for name in (node.get("vnamePrev", ""), node.get("vnameCurr", "")):
                self.values[name] = node.findtext("ValueEnum", "").split()
            if node.get("fullyObs") == "true":
                self.observed.append(node.get("vnamePrev"))
        for node in root.findall("Variable/ActionVar"):
            self.values[node.get("vname", "")] = node.findtext("ValueEnum", "").split()
        self.tables = {}
        for node in [*root.iter("CondProb"), *root.iter("Func")]:
            name = node.findtext("Var", "")
            parents = [parent for parent in node.findtext("Parent", "").split() if parent != "null"]
            variables = parents + ([name] if node.tag == "CondProb" else [])
            table: dict[tuple[str, ...], float] = {}
            for entry in node.iter("Entry"):
                table.update(self.expand(entry, variables))
            self.tables[name] = table

    def expand(self, entry: ElementTree.Element, variables: list[str]) -> dict[tuple[str, ...], float]:
        """Return the entries of one element: `*` stands for all values with one number, `-` for each value with its
        own.
        """
        instance = entry.findtext("Instance", "").split()
        numbers = (entry.findtext("ProbTable") or entry.findtext("ValueTable") or "").split()
        each = [self.values[v] if word in "*-" else [word] for v, word in zip(variables, instance, strict=True)]
        dashes = [i for i, word in enumerate(instance) if word == "-"]
        shape = [len(each[i]) for i in dashes]
        array = np.eye(*shape) if numbers == ["identity"] else np.array(numbers, dtype=float).reshape(shape)
        return {
            tuple(values[i] for values, i in zip(each, places, strict=True)): float(
                array[tuple(places[i] for i in dashes)]
            )
            for places in product(*(range(len(values)) for values in each))
        }


def exact(pomdp: AssistPOMDP, x: int, r: int, b: int, t: int) -> tuple[list[tuple[int, float]], float]:
    """Return the target and the probability of each slot, and the expected reward, of robot action r in (x, b, t)."""
    choices = pomdp.model.choices
    if choices.goal[x]:
        return [(x, 1.0)], 0.0
    forbidden = r >= pomdp.robot_actions[x]
    r = 0 if forbidden else r
    place, reward = pomdp.afterstate[x, r], -pomdp.robot_costs[x, r] - 1.0 * forbidden
    if choices.goal[place]:
        return [(place, 1.0)], reward
    steps = []
    for a in np.flatnonzero(choices.applicable[place]):
        chance = float(pomdp.likelihood(np.array([x]), np.array([r]), np.array([a]))[0, b, t])
        steps.append((int(choices.targets[place, a]), chance))
        reward -= chance * choices.costs[place, a]
    return steps, reward


def theta_after(pomdp: AssistPOMDP, x: int, r: int, t: int) -> np.ndarray:
    shares = np.zeros(len(pomdp.grid.theta))
    if pomdp.model.choices.goal[x] or r >= pomdp.robot_actions[x]:
        shares[t] = 1
    else:
        shares[pomdp.low[x, r, 0, t]] = 1 - pomdp.weight[x, r, 0, t]
        shares[pomdp.low[x, r, 0, t] + 1] += pomdp.weight[x, r, 0, t]
    return shares


@pytest.mark.parametrize("name", [*NAMES[:3], pytest.param("lockers", marks=pytest.mark.slow), NAMES[4]])
def test_pomdpx_holds_the_problems_own_numbers(tiny_choices: Choices, tmp_path: Path, name: str) -> None:
    pomdp = problems(tiny_choices)[name]
    write_pomdpx(pomdp, tmp_path / "problem.pomdpx")
    file, observed = Pomdpx(tmp_path / "problem.pomdpx"), Observed.of(pomdp)
    betas, thetas = pomdp.grid.shape
    hidden = list(product(range(betas), range(thetas)))
    assert file.gamma == pomdp.gamma
    assert file.observed == ["x_0"]
    x_after: dict[tuple[str, ...], list[tuple[int, float]]] = {}
    for (*given, after), chance in file.tables["x_1"].items():
        x_after.setdefault(tuple(given), []).append((file.values["x_1"].index(after), chance))
    for (r, action), value in product(enumerate(file.values["action"]), range(len(observed.state))):
        x, here = int(observed.state[value]), file.values["x_0"][value]
        for b, t in hidden:
            given = action, here, f"b{b}", f"t{t}"
            steps, reward = exact(pomdp, x, r, b, t)
            # The writer chooses which copy belongs to which choice; that each has one is tested below.
            written = sorted((int(observed.state[y]), p) for y, p in x_after[given] if p > 0)
            if len(steps) == 1:
                assert written == [(steps[0][0], pytest.approx(1))]
            else:
                merged: dict[int, list[float]] = {}
                for y, p in steps:
                    merged.setdefault(y, []).append(p)
                expected = [
                    (y, p)
                    for y, chances in merged.items()
                    for p in ([sum(chances)] if pomdp.model.choices.goal[y] else chances)
                    if p > 0
                ]
                assert [y for y, _ in written] == [y for y, _ in sorted(expected)]
                np.testing.assert_allclose([p for _, p in written], [p for _, p in sorted(expected)], rtol=1e-14)
            assert sum(p for _, p in x_after[given]) == pytest.approx(1, abs=1e-12)
            assert file.tables["reward"][given] == pytest.approx(reward, rel=1e-11)
        for t in range(thetas):
            row = [file.tables["theta_1"][action, here, f"t{t}", f"t{u}"] for u in range(thetas)]
            np.testing.assert_array_equal(row, theta_after(pomdp, x, r, t))
    assert all(file.tables["beta_1"][f"b{b}", f"b{c}"] == (b == c) for b in range(betas) for c in range(betas))
    prior = [
        [file.tables["beta_0"][f"b{b}",] * file.tables["theta_0"][f"t{t}",] for t in range(thetas)]
        for b in range(betas)
    ]
    np.testing.assert_allclose(prior, pomdp.prior, rtol=1e-14, atol=1e-16)
    initial = {name for (name,), p in file.tables["x_0"].items() if p == 1}
    assert initial == {f"s{pomdp.model.choices.initial}"}


@pytest.mark.parametrize("execute", [False, True])
def test_states_are_called_by_facts_and_actions_explained(tiny: Table, tmp_path: Path, execute: bool) -> None:
    """Each state's name gives its difference from the initial state; the description explains the robot's actions."""
    choices = Choices.of(tiny)
    pomdp = AssistPOMDP.of(HumanModel.exact(choices), grid=GRID, robot=OfRobots(execute=execute))
    write_pomdpx(pomdp, tmp_path / "named.pomdpx", tiny)
    write_pomdpx(pomdp, tmp_path / "numbered.pomdpx")
    named, numbered = (Pomdpx(tmp_path / f"{kind}.pomdpx") for kind in ("named", "numbered"))
    called = named.values["x_0"]
    assert len(set(called)) == len(tiny)
    assert all(re.fullmatch(r"[A-Za-z0-9_.-]+", name) for name in called)
    assert called[tiny.initial] == "start"
    fetched = tiny.space.follow(["(fetch box-a)"])
    assert called[fetched] == "on-platform.box-a"
    number = dict(zip(called, numbered.values["x_0"], strict=True))
    for name, table in numbered.tables.items():
        renamed = {tuple(number.get(value, value) for value in key): p for key, p in named.tables[name].items()}
        assert renamed == table
    legend = ElementTree.parse(tmp_path / "named.pomdpx").getroot().findtext("Description", "")
    meant = f"{called[fetched]}: robot1 suggests (place hammer slot-1 box-a)"
    meant += ", robot2 does (place hammer slot-1 box-a)" if execute else ""
    assert meant in legend.splitlines()
    assert legend.count(" suggests ") == sum(
        pomdp.suggestion(x, r) is not None for x in range(len(tiny)) if not choices.goal[x]
        for r in range(int(pomdp.robot_actions[x]))
    )  # fmt: skip
    assert (" does " in legend) == execute


def test_names_are_words_that_formats_allow(tmp_path: Path) -> None:
    """Names with other characters, and rows that are the same state of the task, stay apart."""
    domain = """(define (domain d) (:requirements :strips) (:predicates (at ?x) (lit))
        (:action douse :parameters () :precondition (lit) :effect (not (lit)))
        (:action go :parameters (?x ?y) :precondition (at ?x) :effect (and (at ?y) (not (at ?x)))))"""
    problem = "(define (problem p) (:domain d) (:objects a+b a_b a<b) (:init (at a+b) (lit)) (:goal (at a<b)))"
    task = load(write_instance(tmp_path, domain, problem))
    table = sweep(task)
    for choices in (Choices.of(table), remembered(table)):
        pomdp = AssistPOMDP.of(HumanModel.exact(choices), grid=GRID)
        write_pomdpx(pomdp, tmp_path / "p.pomdpx", table)
        names = Pomdpx(tmp_path / "p.pomdpx").values["x_0"]
        assert len(set(names)) == len(Observed.of(pomdp).state)
        assert {"start", "not-lit", "at.a_b"} <= set(names)
        assert {frozenset(name.split("__")) for name in names} >= {frozenset(["at.a_b", "not-lit"])}
        assert all(re.fullmatch(r"[A-Za-z0-9_.-]+", name) for name in names)
        write_pomdp(pomdp, tmp_path / "p.pomdp", table)
        assert "# x = 0: " in (tmp_path / "p.pomdp").read_text()


def test_every_action_of_a_person_is_seen() -> None:
    """No two actions lead from a state to the same observed value, unless the task ends there."""
    choices = lockers()
    observed = Observed.of(problems(choices)["optimal"])
    assert len(observed.state) > len(choices)
    assert len(set(observed.names)) == len(observed.state)
    for x in np.flatnonzero(~choices.goal):
        slots = np.flatnonzero(choices.applicable[x])
        after = observed.targets[x, slots]
        np.testing.assert_array_equal(observed.state[after], choices.targets[x, slots])
        assert len(set(after[~choices.goal[observed.state[after]]])) == (~choices.goal[observed.state[after]]).sum()


def test_a_prior_whose_parts_depend_on_each_other(tiny_choices: Choices, tmp_path: Path) -> None:
    prior = np.array([[0.5, 0.0, 0.0], [0.1, 0.1, 0.3]])
    write_pomdpx(dataclasses.replace(make(tiny_choices), prior=prior), tmp_path / "problem.pomdpx")
    tables = Pomdpx(tmp_path / "problem.pomdpx").tables
    written = [[tables["beta_0"][f"b{b}",] * tables["theta_0"][f"b{b}", f"t{t}"] for t in range(3)] for b in range(2)]
    np.testing.assert_allclose(written, prior, rtol=1e-14)


class Flat:
    """A reader of the parts of Cassandra's format that are written."""

    def __init__(self, path: Path) -> None:
        head: dict[str, str] = {}
        entries: dict[str, dict[tuple[str, ...], float]] = {"T": {}, "O": {}, "R": {}}
        for line in path.read_text().splitlines():
            key, _, rest = line.partition(":")
            if key in entries:
                *instance, number = (word for word in rest.split() if word != ":")
                entries[key][tuple(instance)] = float(number)
            elif not line.startswith("#"):
                head[key] = rest
        self.gamma, size = float(head["discount"]), int(head["states"])
        self.actions, self.start = head["actions"].split(), np.array(head["start"].split(), dtype=float)
        self.transition = np.zeros((len(self.actions), size, size))
        for (action, before, after), chance in entries["T"].items():
            self.transition[self.places(action), int(before), int(after)] = chance
        self.reward = np.zeros((len(self.actions), size))
        for (action, before, *_), reward in entries["R"].items():
            self.reward[self.places(action), int(before)] = reward
        self.observation = np.array([int(o) for _, _, o in entries["O"]])

    def places(self, action: str) -> list[int]:
        return list(range(len(self.actions))) if action == "*" else [self.actions.index(action)]


def test_the_flat_format_is_the_factored_one_multiplied_out(tiny_choices: Choices, tmp_path: Path) -> None:
    pomdp = make(tiny_choices, robot=OfRobots(c_suggest=0.3, execute=True))
    write_pomdpx(pomdp, tmp_path / "problem.pomdpx")
    write_pomdp(pomdp, tmp_path / "problem.pomdp")
    tables, flat = Pomdpx(tmp_path / "problem.pomdpx").tables, Flat(tmp_path / "problem.pomdp")
    states = list(product(range(len(tiny_choices)), range(2), range(3)))
    assert flat.actions == action_names(pomdp)
    np.testing.assert_array_equal(flat.observation, [x for x, _, _ in states])
    np.testing.assert_array_equal(flat.start.reshape(-1, 6)[tiny_choices.initial], pomdp.prior.ravel())
    for (r, action), (i, (x, b, t)) in product(enumerate(flat.actions), enumerate(states)):
        row = [
            tables["x_1"].get((action, f"s{x}", f"b{b}", f"t{t}", f"s{y}"), 0.0)
            * (b == c)
            * tables["theta_1"][action, f"s{x}", f"t{t}", f"t{u}"]
            for y, c, u in states
        ]
        np.testing.assert_allclose(flat.transition[r, i], row, rtol=1e-14)
        assert flat.reward[r, i] == tables["reward"][action, f"s{x}", f"b{b}", f"t{t}"]


@pytest.mark.parametrize("name", thinned(["execute", "optimal", "lockers"]))
def test_no_value_changes(tiny_choices: Choices, tmp_path: Path, name: str) -> None:
    """The exported process has the same MDP value: forbidden actions have no effect."""
    check_values(problems(tiny_choices)[name], tmp_path)


def test_a_part_of_the_type_of_ones_own_is_exported(tiny_choices: Choices, tmp_path: Path) -> None:
    pomdp = make(tiny_choices, behaviour=Behaviour(types=Clearheaded))
    assert pomdp.prior.shape == (2 * len(GRID.beta), len(GRID.theta))
    check_values(pomdp, tmp_path)
    write_pomdpx(pomdp, tmp_path / "problem.pomdpx")
    assert len(Pomdpx(tmp_path / "problem.pomdpx").values["beta_0"]) == len(pomdp.hidden)


def check_values(problem: AssistPOMDP, folder: Path, **leaves: Any) -> np.ndarray:
    """Compare the MDP value of the exported process with the problem's own; return it for each observed value."""
    write_pomdp(problem, folder / "problem.pomdp", **leaves)
    flat, observed = Flat(folder / "problem.pomdp"), Observed.of(problem, **leaves)
    np.testing.assert_allclose(flat.transition.sum(axis=2), 1, rtol=1e-12)
    size = flat.transition.shape[1]
    transition, value = csr_array(flat.transition.reshape(-1, size)), np.zeros(size)
    for _ in range(10_000):
        before, value = value, (flat.reward + flat.gamma * (transition @ value).reshape(-1, size)).max(axis=0)
        if np.abs(value - before).max() * flat.gamma / (1 - flat.gamma) < 1e-8:
            break
    expected = qmdp(problem, tolerance=1e-8).value_mdp[observed.state]
    np.testing.assert_allclose(value.reshape(expected.shape), expected, atol=1e-7)
    return expected


@pytest.mark.parametrize(
    ("leaves", "execute"),
    [
        ("lower", True),
        ("upper", False),
        pytest.param("lower", False, marks=pytest.mark.slow),
        pytest.param("upper", True, marks=pytest.mark.slow),
    ],
)
def test_a_truncated_problem_is_written_with_its_bounds(
    tiny: Table, tmp_path: Path, leaves: Any, execute: bool
) -> None:
    """The file has the same MDP value; it is a bound on that of the whole task, whose file a part of all states is."""
    assumed, values = Assumptions(gamma=0.9, robot=OfRobots(execute=execute)), list[float]()
    for states in (3, 8, 100):
        part = TruncatedTask.of(tiny, states=states)
        problem = closed_problem(part, assumed)
        assert problem.frontier is not None
        problem = dataclasses.replace(
            problem, frontier=dataclasses.replace(problem.frontier, upper=getattr(problem.frontier, leaves))
        )
        expected = check_values(problem, tmp_path, leaves=leaves)
        values.append(float((expected[problem.model.choices.initial] * problem.prior).sum()))
        write_pomdpx(problem, tmp_path / "part.pomdpx", leaves=leaves)
        tables = Pomdpx(tmp_path / "part.pomdpx").tables
        for x in problem.frontier.states.tolist():
            given = "nothing", f"s{x}", "b0", "t0"
            bound = np.broadcast_to(
                getattr(problem.frontier, leaves), (len(problem.frontier.states), *problem.prior.shape)
            )
            own = bound[problem.frontier.states.tolist().index(x), 0, 0]
            assert tables["reward"][given] / (1 - 0.9) == pytest.approx(own)
            assert tables["x_1"][*given, f"s{x}"] == 1
    whole = qmdp(assumed.problem(Choices.of(tiny)), tolerance=1e-9)
    exact = float((whole.value_mdp[tiny.initial] * whole.pomdp.prior).sum())
    assert values[2] == pytest.approx(exact, abs=1e-7)
    assert (sorted(values) if leaves == "lower" else sorted(values)[::-1]) == values
    assert abs(values[0] - exact) > 0.1


def test_what_cannot_be_written_is_refused(tiny_choices: Choices, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="leaves 'middle'"):
        write_pomdpx(make(tiny_choices), tmp_path / "problem", leaves="middle")  # type: ignore[arg-type]
    large = invoke("export", KITTING / "paper.pddl", "--format", "pomdp", "--out", tmp_path / "paper.pomdp")
    assert large.exit_code == 1
    assert large.stderr.count("\n") == 1
    assert "836 observed values times 60 pairs (beta, theta)" in large.stderr
    assert not list(tmp_path.iterdir())


def test_sarsops_policy_is_read(tiny_choices: Choices) -> None:
    h = tiny_choices.h + 0.9 * np.random.default_rng(11).standard_normal(len(tiny_choices))
    pomdp = make(tiny_choices, np.where(tiny_choices.goal, 0.0, h))
    policy = read_policy(POLICY, pomdp)
    at, prior = np.array([tiny_choices.initial]), pomdp.prior[None]
    assert policy.value(at, prior)[0] == pytest.approx(LOWER, abs=1e-5)
    assert qmdp(pomdp).value(at, prior)[0] >= UPPER
    for action in (np.zeros(len(tiny_choices), dtype=np.int64), pomdp.first_optimal[:, 0]):
        assert (evaluate(pomdp, action)[tiny_choices.initial] * pomdp.prior).sum() <= UPPER
    # Every vector is valid: where it is best, a one-step look-ahead is not worse. With states, beta and theta in
    # another order it would be.
    x = np.flatnonzero(~tiny_choices.goal).repeat(30)
    belief = np.random.default_rng(1).dirichlet(np.full(6, 0.5), len(x)).reshape(-1, 2, 3)
    q, value, action = policy.q_values(x, belief), policy.value(x, belief), policy.choose(x, belief)
    assert (q.max(axis=1) >= value - 1e-4).all()
    assert (value <= qmdp(pomdp).value(x, belief) + 1e-4).all()
    assert (q[np.arange(len(x)), action] >= value - 1e-4).all()


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        ("<Vector", "<Vektor", 4, "expected <Policy>"),
        ('vectorLength="6"', 'vectorLength="60"', 3, "hidden pairs"),
        ('numObsValue="21"', 'numObsValue="836"', 3, "the problem has 21 states"),
        (
            '<AlphaVector vectorLength="6" numObsValue="21" numVectors="101">',
            "<Policy>",
            4,
            "<Vector> outside of <AlphaVector>",
        ),
        ('numVectors="101"', 'numVectors="102"', 105, "the file declares 102"),
        ('obsValue="0"', 'obsValue="21"', 4, "expected 0 to 20"),
        ('action="0"', 'action="-1"', 4, "expected 0 to 2"),
        ("-14.929 ", "-14.9.29 ", 4, "-14.9.29"),
        ("-14.929 ", "", 4, "a vector of 5 numbers"),
        ("-14.929 ", "nan ", 4, "finite"),
        ("</Vector>", "</Sector>", 4, "XML"),
        ('obsValue="0"', 'obsValue="1"', 105, "no alpha vector for state 0"),
    ],
)
def test_a_policy_that_cannot_be_right_is_refused(
    tiny_choices: Choices, tmp_path: Path, old: str, new: str, line: int, message: str
) -> None:
    file = tmp_path / "wrong.policy"
    text = POLICY.read_text()
    assert old in text
    file.write_text(text.replace(old, new) if "obsValue" in old and line > 4 else text.replace(old, new, 1))
    with pytest.raises(InputFileError) as caught:
        read_policy(file, make(tiny_choices))
    found, number, *_ = str(caught.value).split(":")
    assert found == str(file)
    assert message in str(caught.value)
    assert abs(int(number) - line) <= 1


def test_pomdp_py_has_the_same_chances_and_rewards(tiny_choices: Choices) -> None:
    pytest.importorskip("pomdp_py")
    from pomdp_py.utils.templates import SimpleAction, SimpleObservation, SimpleState

    pomdp = make(tiny_choices, robot=OfRobots(c_suggest=0.3, execute=True))
    problem = to_pomdp_py(pomdp, np.random.default_rng(0))
    states = problem.transition.get_all_states()
    assert len(states) == 21 * 6
    for (r, name), state in product(enumerate(action_names(pomdp)), states):
        (x, b, t), action = state.data, SimpleAction(name)
        steps, reward = exact(pomdp, x, r, b, t)
        assert problem.reward.sample(state, action, state) == pytest.approx(reward)
        theta = theta_after(pomdp, x, r, t)
        total = 0.0
        for y, chance in steps:
            for u in range(3):
                p = problem.transition.probability(SimpleState((y, b, u)), state, action)
                assert p == pytest.approx(chance * theta[u])
                total += p
        assert total == pytest.approx(1)
        sampled = problem.transition.sample(state, action)
        assert problem.transition.probability(sampled, state, action) > 0
        assert problem.observation.sample(sampled, action) == SimpleObservation(sampled.data[0])
    agent = problem.agent()
    assert {s.data for s in agent.belief} == {
        (tiny_choices.initial, b, t) for b, t in product(range(2), range(3)) if pomdp.prior[b, t] > 0
    }
    assert len(agent.policy_model.get_all_actions(states[0])) == pomdp.robot_actions[0]


def test_rewards_are_expected_costs_where_actions_differ_in_cost() -> None:
    folder = KITTING.parent / "delivery"
    choices = Choices.of(table_of(Instance(folder / "one-parcel.pddl", folder / "domain.pddl")))
    pomdp = AssistPOMDP.of(HumanModel.exact(choices), grid=GRID, robot=OfRobots(execute=True))
    observed = Observed.of(pomdp)
    differ = 0
    for x in range(0, len(choices), 9):
        for r in range(int(pomdp.robot_actions.max())):
            found = np.broadcast_to(observed.reward(x, r), pomdp.grid.shape)
            wanted = [[exact(pomdp, x, r, b, t)[1] for t in range(found.shape[1])] for b in range(len(found))]
            assert found == pytest.approx(np.array(wanted))
            differ += len(np.unique(found)) > 1
    assert differ


def test_pomdp_pys_planner_runs(tiny_choices: Choices) -> None:
    pomdp_py = pytest.importorskip("pomdp_py")
    pomdp = make(tiny_choices)
    agent = to_pomdp_py(pomdp, np.random.default_rng(0)).agent()
    planner = pomdp_py.POUCT(
        max_depth=60, discount_factor=pomdp.gamma, num_sims=200, exploration_const=5, rollout_policy=agent.policy_model
    )
    action = planner.plan(agent)
    upper = qmdp(pomdp).value(np.array([tiny_choices.initial]), pomdp.prior[None])[0]
    assert action.name in action_names(pomdp)
    assert -25 < agent.tree[action].value < upper + 2


def test_without_pomdp_py_the_extra_is_named(tiny_choices: Choices, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pomdp_py", None)  # as if it were not installed
    with pytest.raises(MissingExtraError, match=r"pomdp-py: .* -m pip install .*\[pomdp-py\]"):
        to_pomdp_py(make(tiny_choices), np.random.default_rng(0))


def test_export_command(tmp_path: Path) -> None:
    out = tmp_path / "tiny.pomdpx"
    words = "--set gamma=0.9 --set population.beta=[1,2] --set sigma=0.5 --seed 4 --set execute=true"

    def exported(*more: str) -> tuple[dict[str, Any], bytes]:
        result = invoke("export", KITTING / "tiny.pddl", "--out", out, "--json", *words.split(), *more)
        assert result.exit_code == 0
        return json.loads(result.stdout), out.read_bytes()

    record, first = exported()
    assert record == {
        "instance": str(KITTING / "tiny.pddl"), "domain": str(KITTING / "domain.pddl"), "format": "pomdpx",
        "out": str(out), "states": 21,
        "frontier": 0, "hidden": 60, "robot_actions": 5, "bytes": out.stat().st_size,
    }  # fmt: skip
    assert Pomdpx(out).gamma == 0.9
    assert exported()[1] == first
    parts = [exported("--set", "region_states=6", "--leaves", leaves) for leaves in ("lower", "upper")]
    assert all(part["frontier"] > 0 and part["states"] < 21 for part, _ in parts)
    assert parts[0][1] != parts[1][1]
    assert exported("--set", "region_states=6")[1] in (parts[0][1], parts[1][1])


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("--out", "tiny.xml"), 2, "ends in .pomdpx or .pomdp"),
        (("--out", "tiny.pomdpx", "--set", "gamma=1"), 2, "gamma: 1; expected a number above 0"),
        ((), 2, "--out"),
        (("--out", "file/tiny.pomdpx"), 1, "file"),
    ],
)
def test_export_says_what_is_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], code: int, message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("not a folder")
    result = invoke("export", KITTING / "tiny.pddl", *arguments)
    assert result.exit_code == code
    assert message in result.stderr
    assert isinstance(result.exception, SystemExit)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["file"]
