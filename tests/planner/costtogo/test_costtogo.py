"""Cost-to-go tables of graphs with known values, and their parts."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import graph_task, write_instance

from planner import (
    Instance,
    LimitError,
    Limits,
    MismatchError,
    OnDemand,
    Table,
    Task,
    astar,
    load,
    sweep,
    sweep_goals,
    verify,
)
from planner.costtogo import goal_tables
from planner.costtogo.astar import check_successors
from planner.costtogo.cost_to_go import optimal_choices
from planner.grounding import fast_downward
from planner.grounding.task import plan_cost
from planner.grounding.translation import from_sas
from planner.pddl.compilation import Compilation
from planner.pddl.reader import Reading
from planner.search.state_space import UNREACHED, compact, smallest_type

# From 1 to the goal 0: directly for 5, over 2 for 1 + 3, over 3 and 4 for 0 + 0 + 4; 5 and 6 are dead ends.
EDGES = [(1, 0, 5), (1, 2, 1), (2, 0, 3), (1, 3, 0), (3, 4, 0), (4, 0, 4), (4, 3, 0), (3, 1, 0), (2, 5, 1), (5, 6, 0)]
H = {0: 0, 1: 4, 2: 3, 3: 4, 4: 4, 5: np.inf, 6: np.inf}
LENGTHS = {0: 0, 1: 2, 2: 1, 3: 2, 4: 1, 5: UNREACHED, 6: UNREACHED}


@pytest.fixture(scope="module")
def table() -> Table:
    return sweep(graph_task(EDGES))


@pytest.fixture(scope="module")
def node(table: Table) -> dict[int, int]:
    """Return the node of each state."""
    return dict(enumerate(table.values(np.arange(len(table)))[:, 0].tolist()))


@pytest.mark.parametrize("start", H)
def test_a_table_by_hand(table: Table, node: dict[int, int], start: int) -> None:
    state = next(state for state, number in node.items() if number == start)
    assert table[state] == table.lookup([state])[0] == table.h[state] == H[start]
    assert table.plan_lengths([state]).tolist() == [LENGTHS[start]]
    assert table.is_goal([state]).tolist() == [start == 0]
    assert table.dead_end[state] == (start in (5, 6))
    plan = table.optimal_plan(state)
    assert start != 1 or table.optimal_plan() == plan == ["(go 001)", "(go 002)"]
    if start in (5, 6):
        assert plan is None
        return
    assert plan is not None
    at, paid = start, 0
    for action in plan:
        origin, at_next, cost = EDGES[int(action.strip("()").split()[1])]
        assert origin == at
        at, paid = at_next, paid + cost
    assert (at, paid, len(plan)) == (0, H[start], LENGTHS[start])


def test_optimal_choices_by_hand(table: Table, node: dict[int, int]) -> None:
    """Free actions are optimal choices only on the shortest of the cheapest paths: from 1 over 2, not over 3."""
    rows = table.choices(np.arange(len(table)))
    best = optimal_choices(table, np.arange(len(table)), rows)
    np.testing.assert_array_equal(best, table.optimal_choices())
    assert {table.task.actions[action] for action in rows.actions[best]} == {
        f"(go {number:03})" for number in (1, 2, 4, 5)
    }
    some = np.array([state for state, number in node.items() if number in (4, 5)])
    rows = table.choices(some)
    best = optimal_choices(table, some, rows)
    assert [table.task.actions[action] for action in rows.actions[best]] == ["(go 005)"]
    dead = [state for state, number in node.items() if number in (5, 6)]
    assert not optimal_choices(table, dead, table.choices(dead)).any()


def test_plan_lengths_of_several_states(table: Table, node: dict[int, int]) -> None:
    states = list(node) * 2
    assert table.plan_lengths(states).tolist() == [LENGTHS[node[state]] for state in states]


def test_distances_are_kept_in_the_smallest_type_with_room_for_dead_ends() -> None:
    for largest, kind in (
        (0, np.uint8), (254, np.uint8), (255, np.uint16), (65534, np.uint16), (65535, np.uint32), (2**32 - 1, np.uint64)
    ):  # fmt: skip
        assert smallest_type(largest) is kind
        kept = compact(np.array([0, UNREACHED, largest]))
        assert kept.dtype == kind
        assert kept.tolist() == [0, np.iinfo(kind).max, largest]
    assert compact(np.full(3, UNREACHED)).tolist() == [255, 255, 255]
    assert compact(np.empty(0, dtype=np.int64)).dtype == np.uint8


@pytest.mark.parametrize("start", [1, 2, 3])
def test_a_plan_gets_out_of_a_circle_of_free_actions(start: int) -> None:
    """Actions between 1 and 2 are free and form a cycle; leaving it is free too, and the goal costs 2 from every
    node.
    """
    table = sweep(graph_task([(1, 2, 0), (2, 1, 0), (1, 3, 0), (3, 0, 2)], start=start))
    names = {1: ["(go 002)", "(go 003)"], 2: ["(go 001)", "(go 002)", "(go 003)"], 3: ["(go 003)"]}
    assert table.optimal_plan() == names[start]
    assert table.plan_lengths([table.initial]).tolist() == [len(names[start])]
    best = table.space.transitions.actions[table.optimal_choices()]
    assert {table.task.actions[action] for action in best} == set(names[max(start, 2)])  # all but (go 000), from 1 to 2


def test_a_task_without_actions() -> None:
    there, elsewhere = sweep(graph_task([], goal=1)), sweep(graph_task([(0, 2, 1)], goal=2))
    assert there.optimal_plan() == []
    assert there.optimal_choices().tolist() == []
    assert elsewhere.optimal_plan() is None
    assert elsewhere[elsewhere.initial] == np.inf


def test_a_table_cannot_be_written_into_and_searches_for_nothing(table: Table) -> None:
    assert (table.method, table.searches) == ("sweep", False)
    with pytest.raises(ValueError, match="read-only"):
        table.distance[0] = 0


def test_states_are_compared_with_fast_downward(table: Table) -> None:
    for count, compared in ((0, 1), (1, 1), (3, 3), (7, 7), (99, 7)):
        assert verify(table, count, np.random.default_rng(0)) == compared
    assert verify(table, 7, np.random.default_rng(0), seconds=0.0) == 0
    known = {table.initial: table[table.initial]}
    assert verify(table, 7, np.random.default_rng(0), seconds=0.0, known=known) == 1
    assert verify(table, 7, np.random.default_rng(0), seconds=600, limits=Limits(seconds=60)) == 7
    assert verify(table, 7, np.random.default_rng(0), limits=Limits(memory_mb=1)) == 0


def test_a_state_that_takes_too_long_is_left_out(table: Table, monkeypatch: pytest.MonkeyPatch) -> None:
    asked, told = list[int](), list[int]()

    def search(_: Task, state: list[int], **__: object) -> tuple[float, None]:
        asked.append(state[0])
        if len(asked) == 3:
            raise LimitError("out of time")
        return H[state[0]], None

    monkeypatch.setattr("planner.costtogo.astar.astar", search)
    assert verify(table, 7, np.random.default_rng(0), progress=told.append) == 6
    assert (len(asked), told) == (7, [1, 2, 3, 4, 5, 6])


def test_states_are_compared_one_at_a_time_without_a_thread(table: Table, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("_thread.start_new_thread", lambda *_: pytest.fail("a thread was started"))
    assert verify(table, 2, np.random.default_rng(0)) == 2


def test_a_program_that_begins_late_gets_all_of_its_task(tmp_path: Path) -> None:
    """The input is larger than a pipe holds, and the stop event is checked meanwhile."""
    limits = Limits(seconds=60, stop=threading.Event())
    code, output = fast_downward._run(["sh", "-c", "sleep 0.1; wc -c"], str(tmp_path), "x" * 500_000, limits)
    assert (code, output.strip()) == (0, "500000")


def test_a_program_begins_its_task_when_its_limits_are_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a busy machine that may be late. 512 MB are 500,000 kB of 1,024 bytes."""
    limit = fast_downward.limit_process
    monkeypatch.setattr(fast_downward, "limit_process", lambda *of: (time.sleep(0.2), limit(*of)))
    says = ["sh", "-c", "read line; ulimit -v"]
    assert fast_downward._run(says, str(tmp_path), "task\n", Limits(memory_mb=512)) == (0, "500000\n")


def test_a_program_that_finds_no_room_to_begin_is_out_of_memory() -> None:
    for why in ("failed to map segment from shared object", "cannot map zero-fill pages"):
        said = f"downward: error while loading shared libraries: libm.so.6: {why}"
        with pytest.raises(LimitError, match="ran out of memory"):
            fast_downward._check_limits("A*", 127, said, Limits(memory_mb=1))
    fast_downward._check_limits("A*", 127, said, Limits())  # no limit was set
    fast_downward._check_limits("A*", 127, "libm.so.6: cannot open shared object file", Limits(memory_mb=1))


@pytest.mark.parametrize("wrong", [1, 5])
def test_a_wrong_table_is_noticed(table: Table, node: dict[int, int], wrong: int) -> None:
    state = next(state for state, number in node.items() if number == wrong)
    distance = table.distance.copy()
    distance[state] = 9
    says = {1: 4, 5: "inf"}[wrong]
    message = rf"^cost-to-go of state {state} is 9, but Fast Downward's A\* says {says} \(.*at\({wrong}\)"
    with pytest.raises(MismatchError, match=message):
        verify(Table(table.space, distance), 7, np.random.default_rng(0))
    with pytest.raises(MismatchError, match=r"^cost-to-go of state \d is .*, but its successors say "):
        check_successors(Table(table.space, distance), 7, np.random.default_rng(0))


def test_states_are_compared_with_their_successors(table: Table, tiny: Table) -> None:
    for count, compared in ((0, 1), (3, 3), (99, 7)):
        assert check_successors(table, count, np.random.default_rng(0)) == compared
    assert check_successors(table, 7, np.random.default_rng(0), seconds=0.0) == 1
    assert check_successors(table, 7, np.random.default_rng(0), seconds=600) == 7
    assert check_successors(tiny, 99, np.random.default_rng(0)) == len(tiny)  # some with a part of the goal only
    np.testing.assert_array_equal(tiny.is_goal(np.arange(len(tiny))), tiny.h == 0)


@pytest.mark.parametrize("start", H)
def test_one_state_by_fast_downward(table: Table, start: int) -> None:
    cost, plan = astar(table.task, [start], limits=Limits(seconds=60))
    assert (cost, type(cost)) == (H[start], float)
    assert (plan is None) == (start in (5, 6))
    if plan is not None:
        assert plan_cost(table.task, plan) == cost
    if start == 1:
        with pytest.raises(ValueError, match="argument"):
            astar(table.task, [1, 0])  # the task has only one variable
        assert astar(table.task)[0] == 4
        assert astar(table.task, [1], search="astar(blind())")[0] == 4
        with pytest.raises(fast_downward.FastDownwardError, match="of_no_kind"):
            astar(table.task, [1], search="astar(of_no_kind())")
        with pytest.raises(LimitError, match="out of memory"):
            astar(table.task, [1], limits=Limits(memory_mb=1))


def test_derived_variables_have_their_defaults_wherever_a_search_begins() -> None:
    """A lamp is lit at 1, where the plan begins, and must not be lit at 2, one step away."""
    text = """begin_version/3/end_version/begin_metric/1/end_metric/2
begin_variable/var0/-1/3/Atom at(0)/Atom at(1)/Atom at(2)/end_variable
begin_variable/var1/0/2/Atom lit()/NegatedAtom lit()/end_variable
0/begin_state/0/1/end_state/begin_goal/2/0 2/1 1/end_goal/2
begin_operator/go 0/0/1/0 0 0 1/1/end_operator
begin_operator/go 1/0/1/0 0 1 2/1/end_operator
1/begin_rule/1/0 1/1 1 0/end_rule
"""
    task = from_sas(text.replace("/", "\n"), Instance(Path("lamp.pddl"), Path("domain.pddl")))
    assert astar(task)[0] == 2
    assert astar(task, [1, 0])[0] == 1
    assert astar(task, [2, 1])[0] == 0


@pytest.mark.parametrize(
    ("costs", "right"),
    [
        ((10**9, 10**9, 2 * 10**9 + 10**8), True),  # the sum of the long way is beyond 2^31
        ((3, 2, 6), True), ((10**8, 1, 10**8 + 1), True), ((5 * 10**8, 7, 10**9), False),
        ((2 * 10**9 + 1, 2 * 10**9, 10**9 + 7), False), ((10**10 + 1, 3, 5), False),
    ],
)  # fmt: skip
def test_large_costs_are_right_or_refused(costs: tuple[int, int, int], right: bool) -> None:
    """Fast Downward's sums overflow beyond 2^31: no answer is given that may be wrong. The sweep's is right."""
    task = graph_task([(1, 2, costs[0]), (2, 3, costs[1]), (3, 0, costs[1]), (1, 0, costs[2])])
    least = min(costs[0] + 2 * costs[1], costs[2])
    table = sweep(task)
    assert table[table.initial] == least
    if right:
        assert astar(task)[0] == least
        assert OnDemand(task).lookup([0])[0] == least
    else:
        with pytest.raises(LimitError, match="Fast Downward"):
            astar(task)


MOVES = """(define (domain d) (:requirements :adl :typing) (:types box place)
  (:predicates (at ?b - box ?p - place) (full ?p - place) (seen ?b - box))
  (:action move :parameters (?b - box ?p ?q - place) :precondition (and (at ?b ?p) (not (full ?q)) (not (= ?p ?q)))
    :effect (and (not (at ?b ?p)) (at ?b ?q) (not (full ?p)) (full ?q)))
  (:action look :parameters (?b - box) :precondition (not (seen ?b)) :effect (seen ?b)))"""
BOXES = """(define (problem p) (:domain d) (:objects a b - box x y z w - place)
  (:init (at a x) (at b y) (full x) (full y)) (:goal {}))"""
OF_BOXES = [
    "(at a z)", "(or (at a w) (and (at b x) (seen a)))", "(not (at a x))", "(and (not (at a x)) (seen b))",
    "(exists (?p - place) (and (at a ?p) (at b ?p)))", "(forall (?b - box) (or (seen ?b) (at ?b w)))",
    "(imply (at a x) (seen b))",
]  # fmt: skip
COUNTS = """(define (domain d) (:requirements :adl :fluents) (:functions (n)) (:predicates (q))
  (:action up :parameters () :precondition (< (n) 6) :effect (increase (n) 1))
  (:action down :parameters () :precondition (> (n) 0) :effect (decrease (n) 1))
  (:action q :parameters () :effect (q)))"""
NUMBER = "(define (problem p) (:domain d) (:init (= (n) 2)) (:goal {}))"
OF_COUNTS = ["(and (q) (= (n) 5))", "(>= (n) 4)", "(not (<= (n) 3))", "(or (q) (> (n) 5))"]


def of_goals(folder: Path, domain: str, problem: str, goals: list[str]) -> list[Task]:
    """Load a problem with each of several goals."""
    return [
        load(write_instance(folder / str(number), domain, problem.format(goal))) for number, goal in enumerate(goals)
    ]


def costs_by_facts(table: Table) -> dict[tuple[str, ...], float]:
    found = {tuple(table.space.facts(state)): table[state] for state in range(len(table))}
    assert len(found) == len(table)
    return found


@pytest.mark.parametrize(
    ("domain", "problem", "goals"), [(MOVES, BOXES, OF_BOXES), (COUNTS, NUMBER, OF_COUNTS)], ids=["facts", "numbers"]
)
def test_goals_of_any_form_have_tables_on_one_enumeration(
    domain: str, problem: str, goals: list[str], tmp_path: Path
) -> None:
    """Each table is that of a sweep of its goal alone, state by state, and what A* finds."""
    tasks = of_goals(tmp_path, domain, problem, goals)
    tables = sweep_goals(tasks)
    assert len({id(table.space.numbering) for table in tables}) == 1
    for task, table in zip(tasks, tables, strict=True):
        assert costs_by_facts(table) == costs_by_facts(sweep(task))
        assert verify(table, 5, np.random.default_rng(0)) == 5


LAMPS = """(define (domain d) (:requirements :adl :derived-predicates)
  (:predicates (on ?x) (next ?x ?y) (lit ?x) (two) (seen))
  (:derived (lit ?x) (or (on ?x) (exists (?y) (and (next ?y ?x) (lit ?y)))))
  (:derived (two) (exists (?x ?y) (and (lit ?x) (lit ?y) (not (= ?x ?y)))))
  (:action flip :parameters (?x) :precondition (not (on ?x)) :effect (on ?x))
  (:action off :parameters (?x) :precondition LIT :effect (not (on ?x))))"""
ROW = "(define (problem p) (:domain d) (:objects a b c) (:init (next a b) (next b c)) (:goal {}))"
OF_LAMPS = ["(lit c)", "(two)", "(on a)", "(and (on b) (not (on c)))", "(or (on a) (on c))", "(not (lit a))",
            "(and (two) (not (lit b)))", "(forall (?x) (lit ?x))"]  # fmt: skip


@pytest.mark.parametrize("off", ["(on ?x)", "(lit ?x)", "(forall (?y) (or (on ?y) (= ?x ?y)))"])
def test_goals_and_operators_that_read_derived_predicates_share_an_enumeration(off: str, tmp_path: Path) -> None:
    tasks = of_goals(tmp_path, LAMPS.replace("LIT", off), ROW, OF_LAMPS)
    tables = sweep_goals(tasks)
    assert len({id(table.space.numbering) for table in tables}) == 1
    for task, table in zip(tasks, tables, strict=True):
        by_facts = {on_of(facts): cost for facts, cost in costs_by_facts(table).items()}
        assert by_facts == {on_of(facts): cost for facts, cost in costs_by_facts(sweep(task)).items()}
        assert verify(table, 5, np.random.default_rng(0)) == 5


def on_of(facts: tuple[str, ...]) -> frozenset[str]:
    return frozenset(fact for fact in facts if fact.startswith("on("))


def test_the_time_limit_holds_for_all_groundings_of_goals(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tasks = of_goals(tmp_path, MOVES, BOXES, OF_BOXES)
    clock, given, ground = [0.0], [], goal_tables.grounded

    def slow(reading: Reading, limits: Limits) -> tuple[Compilation, Task]:
        given.append(limits.seconds)
        clock[0] += 30
        return ground(reading)

    monkeypatch.setattr(goal_tables, "grounded", slow)
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    with pytest.raises(LimitError, match="out of time after grounding some of the goals"):
        sweep_goals(tasks, time_limit=100)
    assert given == [100, 70, 40, 10]


def test_a_goal_that_was_made_in_python_is_not_read_from_its_file(tmp_path: Path) -> None:
    tasks = of_goals(tmp_path, MOVES, BOXES, ["(at a z)", "(not (at a x))"])
    variable = next(n for n, each in enumerate(tasks[0].variables) if "Atom seen(b)" in each.facts)
    seen = replace(tasks[0], goal=((variable, tasks[0].variables[variable].facts.index("Atom seen(b)")),))
    table = sweep_goals([seen, tasks[1]])[0]
    assert table[table.initial] == 1
    assert costs_by_facts(table) == costs_by_facts(sweep(seen))
