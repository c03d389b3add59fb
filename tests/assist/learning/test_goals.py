"""Which goal people pursue: the posterior over goals, the tables of several goals, and the command."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import DOMAINS, KITTING, ROOT, costly, invoke
from hypothesis import given
from hypothesis import strategies as st
from test_unknown_goals import three_goals

from assist.learning import Log, fit, infer_goals
from planner import Instance, PDDLError, Table, load, sweep, sweep_goals

KITS = ROOT / "docs" / "examples" / "kits"
BETA = (0.2, 1.0, 4.0)
LAPSE = 0.01
UNREACHABLE = "is unreachable or holds in the initial state; expected one that has to be pursued"
PRIOR = {"a": 0.5, "b": 0.2, "c": 0.3}


TABLES = {name: dict(three_goals(name).tables) for name in ("tiny", "sealed")}


def walk(goals: dict[str, Table], rng: np.random.Generator, length: int) -> list[int]:
    """A random walk, as numbers of ground actions; it ends where all goals hold."""
    first = next(iter(goals.values()))
    at, actions = first.initial, list[int]()
    while len(actions) < length and not all(table.is_goal([at])[0] for table in goals.values()):
        rows = first.choices([at])
        picked = rng.integers(len(rows.actions))
        actions.append(int(rows.actions[picked]))
        at = int(rows.targets[picked])
    return actions


def log_of(people: dict[str, list[list[int]]], names: tuple[str, ...]) -> Log:
    return Log.of(
        {"person": person, "episode": f"e{number}", "step": step, "action": names[action]}
        for person, episodes in people.items()
        for number, episode in enumerate(episodes)
        for step, action in enumerate(episode)
    )


def probability(table: Table, beta: float, actions: list[int]) -> float:
    """The probability of a history if a person pursues a goal, by the definitions."""
    at, p = table.initial, 1.0
    for action in actions:
        rows = table.choices([at])
        n = len(rows.actions)
        q = [table.task.costs[a] + table[int(x)] for a, x in zip(rows.actions, rows.targets, strict=True)]
        best = min(q)
        weights = [1.0] * n if best == math.inf else [math.exp(-beta * (cost - best)) for cost in q]
        place = rows.actions.tolist().index(action)
        chosen = 0.0 if table.is_goal([at])[0] else weights[place] / sum(weights)
        p *= (1 - LAPSE) * chosen + LAPSE / n
        at = int(rows.targets[place])
    return p


def by_enumeration(goals: dict[str, Table], episodes: list[list[int]]) -> list[list[list[float]]]:
    """The posterior over goals after each action of each episode: a sum over all betas and goals of all episodes."""
    known = []
    for number, episode in enumerate(episodes):
        known.append(list[list[float]]())
        for length in range(1, len(episode) + 1):
            seen = [*episodes[:number], episode[:length]]
            total = dict.fromkeys(goals, 0.0)
            for beta, *pursued in itertools.product(BETA, *[goals] * len(seen)):
                p = 1 / len(BETA)
                for goal, actions in zip(pursued, seen, strict=True):
                    p *= PRIOR[goal] * probability(goals[goal], beta, actions)
                total[pursued[-1]] += p
            known[-1].append([total[goal] / sum(total.values()) for goal in goals])
    return known


@pytest.mark.parametrize("name", TABLES)
@costly(4, 40)
@given(seed=st.integers(0, 2**31), lengths=st.lists(st.integers(1, 4), min_size=2, max_size=3))
def test_the_posterior_is_that_of_enumerated_histories(name: str, seed: int, lengths: list[int]) -> None:
    goals, rng = TABLES[name], np.random.default_rng(seed)
    first, *others = [walk(goals, rng, length) for length in lengths]
    people = {"ann": [first], "bob": others}
    found = infer_goals(goals, log_of(people, goals["a"].task.actions), prior=PRIOR, beta=BETA, lapse=LAPSE)
    known = [posterior for episodes in people.values() for posterior in by_enumeration(goals, episodes)]
    assert len(found.episodes) == len(known)
    for one, posterior in zip(found.episodes, known, strict=True):
        np.testing.assert_allclose(one.posterior, posterior, rtol=0, atol=1e-12)


def test_a_single_goal_is_certain(tiny: Table) -> None:
    log = log_of({"ann": [walk({"a": tiny}, np.random.default_rng(0), 20)]}, tiny.task.actions)
    (episode,) = infer_goals({"kit": tiny}, log).episodes
    assert (episode.posterior == 1).all()


def test_a_log_is_read_as_fit_reads_it(tiny: Table) -> None:
    """The good episodes are used, and the faults are the same."""
    rows = [("e1", 0, "(fetch box-a)"), ("e1", 1, "(fetch box-b)"), ("e2", 0, "(fetch box-a)"), ("e2", 2, "(dance)")]
    plan = tiny.optimal_plan()
    assert plan is not None
    rows += [("e3", step, action) for step, action in enumerate([*plan, "(fetch box-a)"])]
    log = Log.of({"person": "ann", "episode": e, "step": step, "action": action} for e, step, action in rows)
    with pytest.warns(UserWarning, match=r"log:2: .*\(and 2 more"):
        found = infer_goals({"kit": tiny}, log)
    with pytest.warns(UserWarning, match="log:2"):
        assert found.faults == fit(tiny, log).faults
    assert [(one.episode, one.actions) for one in found.episodes] == [("e3", tuple(plan))]


def kits(*names: str) -> list[Instance]:
    return [Instance(KITS / f"{name}.pddl", KITS / "domain.pddl") for name in names]


def optimal_log(table: Table, episode: str = "monday") -> Log:
    plan = table.optimal_plan()
    assert plan is not None
    return Log.of({"person": "ann", "episode": episode, "step": n, "action": action} for n, action in enumerate(plan))


def test_tables_of_goals_share_states_and_equal_single_sweeps() -> None:
    tasks = [load(instance) for instance in kits("travel", "mend", "mount")]
    tables = sweep_goals(tasks)
    assert len({id(table.space.numbering) for table in tables}) == 1
    for task, table in zip(tasks, tables, strict=True):
        alone = sweep(task)
        assert str(table.task.instance) == str(task.instance)
        order = [variable.facts for variable in table.task.variables]
        places = [order.index(variable.facts) for variable in task.variables]
        states = alone.numbers(table.values(np.arange(len(table)))[:, places])
        np.testing.assert_array_equal(table.h, alone.h[states])


@pytest.mark.parametrize("name", ["kitting/costs/ways", "stations/one-bench", "delivery/one-parcel"])
def test_goals_of_other_tasks_have_tables_too(name: str) -> None:
    """With several costs, and in other domains."""
    file = DOMAINS / f"{name}.pddl"
    task = load(file)
    swept = sweep(task)
    reached = swept.values([len(swept) - 1])[0].tolist()
    other = replace(task, goal=tuple(enumerate(reached))[:2])
    both = sweep_goals([task, other, task])
    for table, alone in zip(both, [swept, sweep(other), swept], strict=True):
        np.testing.assert_array_equal(table.distance, alone.distance)


@pytest.fixture
def everywhere(tmp_path: Path) -> Instance:
    """A kit whose goal has a quantifier, which the translator turns into derived facts."""
    text = (KITS / "travel.pddl").read_text().partition("(:goal")[0]
    file = tmp_path / "everywhere.pddl"
    file.write_text(f"{text}(:goal (forall (?s - slot) (or (not (slot-free ?s)) (slot-free slot-2)))))")
    return Instance(file, KITS / "domain.pddl")


def test_a_goal_with_quantifiers_is_on_the_same_states(everywhere: Instance) -> None:
    tasks = [load(one) for one in (*kits("travel", "mend"), everywhere)]
    tables = dict(zip("abc", sweep_goals(tasks), strict=True))
    assert tables["a"].space.numbering is tables["b"].space.numbering is tables["c"].space.numbering
    found = infer_goals(tables, optimal_log(tables["a"]))
    alone = infer_goals({"a": tables["a"], "b": tables["b"]}, optimal_log(tables["a"]))
    two = found.episodes[0].posterior[:, :2]
    np.testing.assert_allclose(two / two.sum(axis=1, keepdims=True), alone.episodes[0].posterior, atol=0.05)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"prior": {"a": 0.5, "b": 0.5}}, "prior: 'c' is missing; expected a, b, c"),
        ({"prior": {"a": 0.5, "b": 0.5, "c": 0.5}}, "prior: sum 1.5; expected"),
        ({"beta": [-1.0]}, "expected one or more finite values"),
        ({"lapse": 0}, "lapse 0: expected 0 < lapse < 1"),
    ],
)
def test_invalid_parameters(change: dict, message: str) -> None:
    goals = TABLES["tiny"]
    with pytest.raises(ValueError, match=message):
        infer_goals(goals, optimal_log(goals["a"]), **change)


def test_tasks_must_have_the_same_states(tiny: Table, sealed: Table) -> None:
    with pytest.raises(PDDLError, match=r"actions: .* is in .* only; expected problems that differ in their goals"):
        sweep_goals([tiny.task, sealed.task])
    with pytest.raises(ValueError, match="goal 'b' has other actions"):
        infer_goals({"a": tiny, "b": sealed}, optimal_log(tiny))


def test_a_goal_that_cannot_be_reached(tiny: Table) -> None:
    """Facts that can be reached, but not together."""
    states = set(map(tuple, tiny.values(np.arange(len(tiny))).tolist()))
    combined = itertools.product(*map(sorted, map(set, zip(*states, strict=True))))
    never = next(values for values in combined if values not in states)
    table = sweep(replace(tiny.task, goal=tuple(enumerate(never))))
    with pytest.raises(ValueError, match="goal 'never' cannot be reached from the initial state"):
        infer_goals({"kit": tiny, "never": table}, optimal_log(tiny))


@pytest.fixture
def log(tmp_path: Path) -> Path:
    file = tmp_path / "log.csv"
    actions = "(fetch box-a)", "(place hammer slot-1 box-a)", "(return box-a)", "(fetch box-c)"
    rows = [f"ann,monday,{step},{action}" for step, action in enumerate(actions)]
    file.write_text("\n".join(["person,episode,step,action", *rows, ""]))
    return file


def test_the_command_prints_the_posterior_at_the_end(log: Path, tmp_path: Path) -> None:
    result = invoke("infer", KITS, log, "--out", tmp_path / "out.jsonl")
    assert (result.exit_code, result.stderr) == (0, "")
    names, row = map(str.split, result.stdout.splitlines())
    assert names == ["person", "episode", "actions", "beta", "mend", "mount", "travel"]
    assert row[:3] == ["ann", "monday", "4"]
    assert [float(p) for p in row[4:]] == pytest.approx([0.031, 0.001, 0.968], abs=1e-3)
    printed = json.loads(invoke("infer", KITS, log, "--json").stdout)
    assert [json.loads(line) for line in (tmp_path / "out.jsonl").read_text().splitlines()] == printed
    (episode,) = printed
    assert episode["goal"] == "travel"
    assert [step["action"] for step in episode["steps"]][-1] == "(fetch box-c)"
    assert all(sum(step["posterior"].values()) == pytest.approx(1) for step in episode["steps"])


def test_the_command_takes_a_prior(log: Path) -> None:
    shares = ["--set", "goal_prior=mend=1,mount=0,travel=0"]
    (episode,) = json.loads(invoke("infer", KITS, log, *shares, "--json").stdout)
    assert episode["posterior"] == {"mend": 1, "mount": 0, "travel": 0}


def test_the_command_on_a_task_that_is_too_large_to_enumerate(log: Path, tmp_path: Path) -> None:
    log.write_text("\n".join(log.read_text().splitlines()[:2]) + "\n")
    given = ["infer", KITS / "travel.pddl", KITS / "mount.pddl", log, "--json"]
    result = invoke(*given, "--set", "max_states=10", "--set", f"cache={tmp_path / 'cache'}")
    assert result.stderr == "evaluating states on demand: more than 10 states\n"
    assert json.loads(result.stdout) == json.loads(invoke(*given).stdout)


def test_errors_of_the_command_are_one_line(log: Path, tmp_path: Path) -> None:
    travel, stuck = KITS / "travel.pddl", tmp_path / "stuck.pddl"
    stuck.write_text(travel.read_text().replace("(in-slot tape slot-2)", "(in-slot tape slot-1)"))
    own = ["--domain", KITS / "domain.pddl"]

    def fault(*arguments: object) -> tuple[int, str]:
        """The exit code and what is said, without the usage that precedes a usage error."""
        result = invoke("infer", *arguments)
        assert result.stdout == ""
        said = result.stderr if result.exit_code == 1 else result.stderr.partition("\n\n")[2]
        (line,) = said.splitlines()
        return result.exit_code, line

    code, line = fault(travel, DOMAINS / "gripper" / "balls-01.pddl", log)
    assert code == 1
    assert "balls-01.pddl: its domain is" in line
    assert line.endswith(f"expected {KITS / 'domain.pddl'}, as for {travel}")
    code, line = fault(travel, KITTING / "tiny.pddl", log)
    assert (code, "expected problems that differ in their goals" in line) == (1, True)
    assert fault(travel, stuck, log, *own) == (1, f"{stuck}: the goal {UNREACHABLE}")
    assert fault(travel, log, "--set", "goal_prior=mend=1") == (
        2, "Error: goal_prior: 'mend' is no goal; expected one of travel",
    )  # fmt: skip
    assert fault(travel, KITS / "mend.pddl", log, "--set", "goal_prior=travel=.5,mennd=.5") == (
        2, "Error: goal_prior: 'mennd' is no goal; did you mean 'mend'?",
    )  # fmt: skip
    assert fault(travel, log, "--set", "goal_prior=travel") == (
        2,
        "Error: --set goal_prior: travel; expected GOAL=PROBABILITY, once for each goal",
    )
    assert fault(travel, travel)[0] == 2
    log.write_text(log.read_text().replace("(fetch box-c)", "(dance)"))
    strict = invoke("infer", travel, log, "--strict")
    assert (strict.exit_code, strict.stdout) == (1, "")
    assert strict.stderr.startswith(f"{log}:5: person 'ann', episode 'monday', which is left out: step 3:")
