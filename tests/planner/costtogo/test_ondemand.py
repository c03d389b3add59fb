"""Cost-to-go on demand compared with tables, its cache, and the choice between the two."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import DOMAINS, KITTING, graph_task, table_of, write_instance
from plain import task_of

from planner import Cache, Instance, LimitError, Limits, OnDemand, PDDLError, Table, Task, cost_to_go, load, sweep
from planner.costtogo import portfolio
from planner.costtogo.astar import fastest_search
from planner.grounding.fast_downward import ASTAR, ASTAR_WITH_AXIOMS
from planner.grounding.task import plan_cost

HUGE = KITTING / "ladder-6x12.pddl"


def walk(task_answers: OnDemand | Table, steps: int, rng: np.random.Generator) -> list[int]:
    """A random walk's states."""
    states = [task_answers.initial]
    for _ in range(steps):
        targets = task_answers.choices([states[-1]]).targets
        if len(targets):
            states.append(int(rng.choice(targets)))
    return states


@pytest.mark.parametrize(
    "name", ["kitting/sealed", "delivery/round-trip", pytest.param("lockers/two-lockers", marks=pytest.mark.slow)]
)
def test_answers_equal_the_tables(name: str) -> None:
    problem = DOMAINS / f"{name}.pddl"
    table = table_of(Instance(problem, problem.parent / "domain.pddl"))
    asked = OnDemand(table.task)
    states = np.random.default_rng(0).permutation(len(table))[:25]
    numbers = asked.numbers(table.values(states))
    np.testing.assert_array_equal(asked.lookup(numbers), table.lookup(states))
    np.testing.assert_array_equal(asked.is_goal(numbers), table.is_goal(states))
    np.testing.assert_array_equal(asked.values(numbers), table.values(states))
    own, theirs = asked.choices(numbers), table.choices(states)
    np.testing.assert_array_equal(own.offsets, theirs.offsets)
    np.testing.assert_array_equal(own.actions, theirs.actions)
    np.testing.assert_array_equal(asked.values(own.targets), table.values(theirs.targets))
    assert asked.lookup([asked.initial])[0] == table[table.initial]
    plan = asked.optimal_plan()
    assert plan is not None
    assert plan_cost(asked.task, plan) == table[table.initial]


@pytest.mark.slow
def test_any_thread_may_ask() -> None:
    """Each state is numbered once, and no array is read while it is moved."""
    table = table_of(Instance(KITTING / "ladder-3x5.pddl", KITTING / "domain.pddl"))
    asked, found = OnDemand(table.task), np.full((8, len(table)), -1)

    def ask(thread: int) -> None:
        for block in np.array_split(np.random.default_rng(thread).permutation(len(table))[:6000], 60):
            found[thread, block] = asked.numbers(table.values(block))
            np.testing.assert_array_equal(asked.values(found[thread, block]), table.values(block))
            targets = asked.choices(found[thread, block[:3]]).targets
            np.testing.assert_array_equal(asked.values(targets), table.values(table.choices(block[:3]).targets))

    with ThreadPoolExecutor(8) as threads:
        list(threads.map(ask, range(8)))
    for state in range(len(table)):
        assert len(set(found[:, state]) - {-1}) <= 1
    assert len(np.unique(found)) - 1 <= len(asked) <= len(table)


# Two ways of cost 6, of two actions and of three; a free way that is longer; a circle, and a dead end.
EDGES = [(1, 2, 3), (2, 0, 3), (1, 3, 2), (3, 4, 2), (4, 0, 2), (1, 5, 1), (4, 1, 1), (5, 5, 1), (3, 2, 1)]


@pytest.mark.parametrize("changed", ["as they are", "one is free", "all are free", "all cost 7"])
def test_plan_lengths_equal_the_tables(changed: str) -> None:
    costs = {"one is free": lambda cost: cost - 1, "all are free": lambda _: 0, "all cost 7": lambda _: 7}
    cost_of = costs.get(changed, lambda cost: cost)
    table = sweep(graph_task([(*edge[:2], cost_of(edge[2])) for edge in EDGES]))
    asked, states = OnDemand(table.task), np.arange(len(table))
    lengths = asked.plan_lengths(asked.numbers(table.values(states)))
    np.testing.assert_array_equal(lengths, table.plan_lengths(states))
    assert lengths.dtype == np.int64
    assert lengths[table.initial] == (3 if changed == "one is free" else 2)
    assert (lengths == np.iinfo(np.int64).max).sum() == 1


def test_derived_variables_are_asked_for_too(tmp_path: Path) -> None:
    domain = """(define (domain d) (:requirements :adl) (:types t) (:predicates (a) (b) (c))
      (:action x :parameters () :precondition (not (a)) :effect (a))
      (:action y :parameters () :precondition (or (a) (b)) :effect (and (b) (not (a))))
      (:action z :parameters () :precondition (and (a) (b)) :effect (c)))"""
    goal = "(forall (?o - t) (imply (c) (and (a) (c))))"
    problem = f"(define (problem p) (:domain d) (:objects o - t) (:init) (:goal (and (c) {goal})))"
    task = load(write_instance(tmp_path, domain, problem))
    table = cost_to_go(task)
    assert isinstance(table, Table)
    asked = OnDemand(task)
    states = np.arange(len(table))
    np.testing.assert_array_equal(asked.lookup(asked.numbers(table.values(states))), table.h)


def test_the_cache_outlives_the_process_and_is_addressed_by_content(tmp_path: Path) -> None:
    domain, text = (KITTING / "domain.pddl").read_text(), (KITTING / "tiny.pddl").read_text()
    instance = write_instance(tmp_path / "in", domain, text)
    cache = Cache(load(instance), tmp_path / "cache")
    first = OnDemand(load(instance), cache=cache)
    states = walk(first, 10, np.random.default_rng(1))
    answers = first.lookup(states)
    assert len(cache.read()) >= len(set(states))

    again = OnDemand(load(instance), cache=Cache(load(instance), tmp_path / "cache"))
    again._ask = None  # type: ignore[assignment, method-assign]  nothing may be asked any more
    np.testing.assert_array_equal(again.lookup(again.numbers(first.values(states))), answers)

    instance.problem.write_text(text.replace("(in-slot hammer slot-1)", "(in-slot hammer slot-2)").replace(
        "(in-slot wrench slot-2)", "(in-slot wrench slot-1)"))  # fmt: skip
    other = Cache(load(instance), tmp_path / "cache")
    assert other.file != cache.file
    assert other.read() == {}


def test_a_damaged_cache_is_replaced_and_an_unusable_one_is_named(tmp_path: Path, tiny: Table) -> None:
    cache = Cache(tiny.task, tmp_path)
    cache.write({b"state": 3.0})
    assert cache.read() == {b"state": 3.0}
    cache.file.write_bytes(b"no database, but longer than the header of one " * 9)
    assert cache.read() == {}
    cache.file.write_bytes(b"no database, but longer than the header of one " * 9)
    cache.write({b"state": np.inf})
    assert Cache(tiny.task, tmp_path).read() == {b"state": np.inf}
    cache.file.unlink()
    cache.file.mkdir()
    with pytest.raises(OSError, match="unable to open database file") as error:
        cache.read()
    assert error.value.filename == str(cache.file)


def test_a_grounded_task_is_kept_by_content(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It names no file of the instance that was read first, and a damaged entry is written again."""
    domain, tiny = (KITTING / "domain.pddl").read_text(), (KITTING / "tiny.pddl").read_text()
    one, other = (write_instance(tmp_path / name, domain, tiny) for name in ("one", "other"))
    task = load(one, cache=tmp_path / "cache")
    with monkeypatch.context() as patch:
        patch.setattr("planner.grounding.fast_downward.translate", None)  # nothing may be grounded any more
        assert load(other, cache=tmp_path / "cache") == replace(task, instance=other)
    one.problem.write_text(tiny.replace("(in-slot wrench slot-2)", "(in-slot wrnch slot-2)"))
    with pytest.raises(PDDLError, match="wrnch"):
        load(one, cache=tmp_path / "cache")
    (entry,) = (tmp_path / "cache").iterdir()
    whole = entry.read_bytes()
    for damaged in (b"", whole[:30], whole[:-1], whole[:-9] + b"\xff" * 9, whole.replace(b"begin_goal", b"begin_gaol")):
        entry.write_bytes(damaged)
        assert load(other, cache=tmp_path / "cache") == replace(task, instance=other)
        assert len(entry.read_bytes()) > len(whole) / 2


@pytest.mark.slow
def test_what_was_found_survives_a_kill(tmp_path: Path) -> None:
    code = f"""
from pathlib import Path
from types import SimpleNamespace
import numpy as np
from planner import Cache, OnDemand, load
task = load({str(HUGE)!r})
asked = OnDemand(task, cache=Cache(task, Path({str(tmp_path)!r})))
state, states = asked.initial, []
rng = np.random.default_rng(0)
for _ in range(60):
    state = int(rng.choice(asked.choices([state]).targets))
    states.append(state)
asked.lookup(states, progress=lambda n: print(n, flush=True))
"""
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    lines = [process.stdout.readline() for _ in range(3)]
    process.kill()
    process.wait()
    process.stdout.close()
    assert all(lines)
    known = Cache(load(HUGE), tmp_path).read()
    assert len(known) > 20  # every answer labels a whole plan
    assert 24.0 in known.values() or 23.0 in known.values()


def test_limits_are_errors_and_never_dead_ends() -> None:
    asked = OnDemand(load(HUGE), limits=Limits(seconds=0.01))
    with pytest.raises(LimitError):
        asked.lookup([asked.initial])
    assert asked._known == {}


def test_no_states_have_no_answers(tiny: Table) -> None:
    for answers in (tiny, OnDemand(tiny.task)):
        assert answers.lookup([]).shape == answers.is_goal([]).shape == answers.plan_lengths([]).shape == (0,)
        assert answers.values([]).shape == (0, len(tiny.task.variables))
        assert len(answers.choices([]).targets) == 0


def test_the_choice_of_the_method(tiny: Table, monkeypatch: pytest.MonkeyPatch) -> None:
    assert cost_to_go(tiny.task).method == "sweep"
    limited = cost_to_go(tiny.task, max_states=10)
    assert isinstance(limited, OnDemand)
    assert limited.reason == "more than 10 states"
    middle, sweep_of = load(KITTING / "ladder-4x6.pddl"), portfolio.sweep
    little = cost_to_go(middle, memory_limit_mb=0.3)
    assert isinstance(little, OnDemand)
    assert "memory" in (little.reason or "")

    def endless(task: Task, *, stop: threading.Event, **options: Any) -> Table:
        assert stop.wait(60)
        return sweep_of(task, stop=stop, **options)

    with monkeypatch.context() as patch:  # one of its states is wanted, and found before all are swept
        patch.setattr(portfolio, "sweep", endless)
        few = cost_to_go(tiny.task, states=np.array([tiny.task.initial]))
    assert isinstance(few, OnDemand)
    assert "asking for 1 states took" in (few.reason or "")
    assert few.known([few.initial])[0] == 6
    hasty = cost_to_go(middle, states=np.array([middle.initial]), max_states=10**4, limits=Limits(seconds=0.001))
    assert isinstance(hasty, OnDemand)  # no search answers in a millisecond, so that the sweep had to try
    assert hasty.reason == "more than 10000 states"
    with monkeypatch.context() as patch:  # the sweep would be faster anyway, except on a busy machine
        patch.setattr("planner.costtogo.portfolio.FIRST", 60)
        assert isinstance(cost_to_go(tiny.task, states=tiny.values([0, 1])), Table)
    with pytest.raises(LimitError):
        cost_to_go(middle, deadline=time.monotonic())


def test_the_search_is_chosen_by_measurement(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tiny = load(KITTING / "tiny.pddl")

    def fastest(*searches: str) -> str:
        monkeypatch.setattr("planner.costtogo.astar.ADMISSIBLE", searches)
        return fastest_search(tiny).search

    assert fastest("astar(no_such_heuristic())", ASTAR) == ASTAR
    with pytest.raises(LimitError):
        fastest("astar(no_such_heuristic())")
    empty = write_instance(
        tmp_path,
        (KITTING / "domain.pddl").read_text(),
        (KITTING / "tiny.pddl").read_text().split("(:goal")[0] + "(:goal (and)))",
    )
    assert fastest_search(load(empty)).search == ASTAR_WITH_AXIOMS


def corridor(jump: int | None = None) -> Task:
    """Return five free steps and then a bell, which costs 2; or a bell at once, at the cost of a jump."""
    moves = [*(({0: at}, {0: at + 1}) for at in range(5)), ({0: 5}, {1: 1}), ({}, {1: 1})]
    count = len(moves) - (jump is None)
    return task_of([6, 2], moves[:count], costs=(0, 0, 0, 0, 0, 2, jump or 0)[:count], goal=((1, 1),))


def test_where_actions_are_free_a_plan_too_long_from_the_start_is_no_reason_to_refuse_other_states(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for module in ("astar", "on_demand"):
        monkeypatch.setattr(f"planner.costtogo.{module}.UNIT", 4)
    asked = OnDemand(corridor())
    state = np.array([asked.initial])
    for _ in range(4):
        state = asked.choices(state).targets
    assert asked.lookup(state).tolist() == [2.0]
    with pytest.raises(LimitError, match="a plan of 6 actions and cost 2: where actions cost nothing, at most 3"):
        asked.lookup([asked.initial])


def test_where_actions_are_free_a_cheaper_plan_of_many_more_actions_is_not_overlooked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In combined costs the jump is 13 and the walk 14, though the walk costs less."""
    for module in ("astar", "on_demand"):
        monkeypatch.setattr(f"planner.costtogo.{module}.UNIT", 4)
    task = corridor(jump=3)
    table, asked = sweep(task), OnDemand(task)
    assert table[table.initial] == 2
    assert plan_cost(task, asked.optimal_plan() or []) == 2
    with pytest.raises(LimitError, match="the optimal plan has more than 4 actions"):
        asked.lookup([asked.initial])
    for answers in (asked, OnDemand(task)):  # before and after the choice of a search
        for state in range(len(table)):
            number = answers.numbers(table.values([state]))
            try:
                assert answers.lookup(number)[0] == table[state]
            except LimitError:
                assert table.plan_lengths([state])[0] >= 4


def test_asking_ends_when_all_states_are_enumerated_and_most_are_not_answered(tmp_path: Path) -> None:
    table = table_of(Instance(KITTING / "ladder-3x5.pddl", KITTING / "domain.pddl"))
    some = np.random.default_rng(0).permutation(len(table))[:100]
    cache, told = Cache(table.task, tmp_path), list[int]()

    def wait(what: str, *_: object) -> None:
        """Delay the sweep after its enumeration, until no further answers arrive."""
        while what == "cost-to-go" and (not told or told[-1] < len(cache.read())):
            told.append(len(cache.read()))
            time.sleep(0.3)

    answers = cost_to_go(load(KITTING / "ladder-3x5.pddl"), table.values(some), cache=cache, progress=wait)
    np.testing.assert_array_equal(answers.lookup(answers.numbers(table.values(some))), table.lookup(some))
    assert isinstance(answers, Table)


def test_values_that_no_variable_has_are_refused(tiny: Table) -> None:
    asked = OnDemand(tiny.task)
    with pytest.raises(ValueError, match="expected values"):
        asked.numbers([[99] * len(tiny.task.variables)])
    halves = tiny.values([0]) + 0.5
    with pytest.raises(ValueError, match="expected values"):
        asked.numbers(halves)
    with pytest.raises(KeyError, match="values are integers, not float64"):
        tiny.numbers(halves)
