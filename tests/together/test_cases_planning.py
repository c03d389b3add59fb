"""Inputs that were met in use: the second reader, costs without a metric, names, limits, and one plan."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import test_cases
from conftest import KITTING, invoke, write_instance

import planner.costtogo.portfolio
from assist.cli.output.solve_records import Answers
from planner import LimitError, Limits, MismatchError, PDDLError, Table, astar, instance, load
from planner.batch import solve_instance as solving
from planner.batch.results_folder import SWEEPING, SolveOptions
from planner.batch.solve_instance import solve_instance
from planner.costtogo.astar import check_plan
from planner.grounding import fast_downward
from planner.grounding.task import plan_cost
from planner.pddl import validation
from planner.pddl.validation import LATE

pytestmark = pytest.mark.cases

TINY = KITTING / "tiny.pddl"


def test_a_second_reader_that_says_nothing_costs_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is stopped at once, as if it read for ever; the plan is there before it is waited for."""
    idle = validation._Process.idle

    def stopped(*arguments: object) -> object:
        process = idle(*arguments)  # type: ignore[arg-type]
        os.kill(process.popen.pid, signal.SIGSTOP)
        return process

    told: list[dict] = []
    monkeypatch.setattr(validation._Process, "idle", stopped)
    monkeypatch.setattr(solving, "SECOND_READER", 0.01)
    record = solve_instance(instance(TINY), SolveOptions(verify=1), tell=lambda record, _: told.append(record))
    assert (record["status"], record["cost"], told[0]["plan"]) == ("solved", 6, record["plan"])
    assert record["note"] == f"read by Fast Downward's translator, not checked by unified-planning: {LATE}"


def test_a_second_reader_that_contradicts_makes_the_answer_invalid(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def rejects(*_: object) -> None:
        raise MismatchError("unified-planning's validator rejects the plan: so there")

    monkeypatch.setattr(validation._Process, "asked", rejects)
    record = solve_instance(instance(TINY), SolveOptions(verify=1), tmp_path / "tiny")
    assert (record["status"], record["plan"]) == ("invalid", None)
    assert record["error"]["message"] == "unified-planning's validator rejects the plan: so there"
    assert list(tmp_path.iterdir()) == []


DOMAIN = test_cases.DOMAIN.replace(" (increase (total-cost) PICK)", "").replace(" (increase (total-cost) 1)", "")
PROBLEM = test_cases.PROBLEM.replace(
    "(= (far shelf kit) 2) (= (far kit shelf) 2)", "(= (far shelf kit) 4) (= (far kit shelf) 1)"
)
NO_METRIC = ("(:metric minimize (total-cost))", "")
NO_BEGIN = ("(= (total-cost) 0)", "")
TIDY = "(:action tidy :parameters (?b - bin) :precondition (here ?b) :effect (and (free) (increase (total-cost) 3)))"
UNIT = (
    "line 7 of the domain has an action cost, but the problem has no (:metric minimize (total-cost)), "
    "so that each action costs 1"
)
ASSUMED = "the initial state has no (= (total-cost) 0), which is assumed"


@pytest.mark.parametrize(
    ("go", "changes", "cost", "note"),
    [
        ("2", (), 6, None),
        ("(far ?a ?b)", (), 9, None),
        ("2", (NO_METRIC,), 7, UNIT),
        ("2", (NO_METRIC, NO_BEGIN), 7, UNIT),
        ("(far ?a ?b)", (NO_METRIC,), 7, UNIT),
        ("(far ?a ?b)", (NO_METRIC, NO_BEGIN), 7, UNIT),
        ("2", (NO_METRIC, NO_BEGIN, ("(:functions (total-cost) (far ?a ?b - bin) - number)", "")), 7, UNIT),
        ("2", (NO_METRIC, ("(increase (total-cost) 2)", "")), 7, None),
        ("2", (NO_METRIC, ("(increase (total-cost) 2)", ""), ("(:action pick", f"{TIDY} (:action pick")), 6,
         UNIT.replace("line 7", "line 8")),
        ("2", (NO_BEGIN,), 6, ASSUMED),
        ("(far ?a ?b)", (NO_BEGIN,), 9, ASSUMED),
        ("2", (NO_BEGIN, ("(:functions (total-cost) (far", "(:functions (far")), 6, ASSUMED),
        ("2", (("(increase (total-cost) 2)", ""),), 0,
         "the problem minimizes (total-cost), but no action increases it, so that each action costs 0"),
    ],
)  # fmt: skip
def test_costs_without_a_metric_or_a_beginning(
    tmp_path: Path, go: str, changes: tuple[tuple[str, str], ...], cost: int, note: str | None
) -> None:
    texts = [DOMAIN.replace("GO", go), PROBLEM]
    for old, new in changes:
        texts = [text.replace(old, new) for text in texts]
    if "(far" not in texts[0]:
        texts[1] = texts[1].replace("(= (far shelf kit) 4) (= (far kit shelf) 1)", "")
    record = solve_instance(write_instance(tmp_path, *texts), SolveOptions(verify=3))
    assert (record["status"], record["cost"], record["note"]) == ("solved", cost, note), record["error"]
    assert load(tmp_path / "problem.pddl").note == note


def test_every_command_says_what_was_assumed_of_costs(tmp_path: Path) -> None:
    problem = write_instance(tmp_path, DOMAIN.replace("GO", "2"), PROBLEM.replace(*NO_METRIC))
    done = invoke("simulate", problem, "--humans", 1, "--pool", 1, "--policy", "none", "--episodes", 1)
    assert done.stderr.splitlines().count(f"{problem}: {UNIT}") == 1


def plans(words: list[str]) -> list[str]:
    return [line for line in words if line.startswith("(")]


def test_a_task_has_one_plan_whichever_is_first(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A table has another plan here. The plan is told, printed, and saved."""
    paper = KITTING / "paper.pddl"
    expected = fast_downward.optimal_plan(load(paper).sas, search=fast_downward.ASTAR)
    other = [*reversed(expected or [])]
    monkeypatch.setattr("planner.costtogo.table.optimal_plan", lambda *_: other)
    sweep, told = planner.costtogo.portfolio.cost_to_go, threading.Event()
    for waits in (False, True):  # for the plan, before the sweep ends

        def swept(*arguments: object, **ways: object) -> object:
            assert told.wait(60)
            return sweep(*arguments, **ways)  # type: ignore[arg-type]

        if waits:
            monkeypatch.setattr(planner.costtogo.portfolio, "cost_to_go", swept)
        seen: list[list[str]] = []

        def tell(record: dict, _: bool, seen: list[list[str]] = seen) -> None:
            seen.append(record["plan"])
            told.set()

        place = tmp_path / f"paper-{waits}"
        record = solve_instance(instance(paper), SolveOptions(verify=1), place, tell=tell)
        assert (record["plan"], record["plan_by"]) == (expected, fast_downward.ASTAR)
        assert plans(place.with_name(f"{place.name}.plan").read_text().splitlines()) == expected
        assert all(plan == expected for plan in seen)
    done = invoke("solve", paper)
    assert plans(done.stdout.splitlines()) == expected


def test_the_first_plan_of_a_task_with_rules_does_not_wait_for_its_sweep(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A sweep is slow where predicates are derived. This one waits until the plan of A* has been told."""
    sweep, told, seen = planner.costtogo.portfolio.cost_to_go, threading.Event(), list[dict]()

    def swept(*arguments: object, **ways: object) -> object:
        assert told.wait(60)
        return sweep(*arguments, **ways)  # type: ignore[arg-type]

    def tell(record: dict, _: bool) -> None:
        seen.append(record)
        told.set()

    monkeypatch.setattr(planner.costtogo.portfolio, "cost_to_go", swept)
    domain = DOMAIN.replace("GO", "2").replace(":action-costs", ":action-costs :derived-predicates")
    domain = domain.replace("(free) (here", "(free) (busy) (here").replace(
        "(in ?p ?b) (free))", "(in ?p ?b) (not (busy)))"
    )
    domain = domain.replace("  (:action go", "  (:derived (busy) (exists (?p - part) (held ?p)))\n  (:action go")
    options = SolveOptions(verify=1, first_answer_after=0.0)
    record = solve_instance(write_instance(tmp_path, domain, PROBLEM), options, tell=tell)
    assert (record["status"], record["cost"], record["states"] > 10) == ("solved", 6, True), record
    assert (seen[0]["plan"], seen[0]["plan_by"]) == (record["plan"], record["plan_by"])
    assert record["plan_by"].startswith("astar")
    assert seen[0]["note"].endswith(SWEEPING)


@pytest.mark.slow
def test_a_number_without_a_bound_is_said_once(tmp_path: Path) -> None:
    domain = """(define (domain d) (:requirements :fluents) (:predicates (done)) (:functions (n))
      (:action halve :parameters () :effect (scale-down (n) 2))
      (:action stop :parameters () :precondition (= (n) 0.25) :effect (done)))"""
    file = write_instance(tmp_path, domain, "(define (problem p) (:domain d) (:init (= (n) 1)) (:goal (done)))")
    done = invoke("solve", file.problem)
    assert done.exit_code == 0
    said = "(n) comes ever closer to 0 (halve): no bound is proven, so that states are solved on demand"
    assert done.stderr == f"{file.problem}: {said}\n"


def test_a_type_and_a_predicate_of_one_name_are_said_once(tmp_path: Path) -> None:
    """unified-planning does not read such files; their other notes are those of each."""
    texts = [text.replace("GO", "2").replace("(free)", "(bin)") for text in (DOMAIN, PROBLEM)]
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        write_instance(tmp_path / name, *texts)
    done = invoke("solve", tmp_path, "--verify", 1, "--jobs", 1)
    assert (done.exit_code, done.stdout.count(" solved ")) == (0, 2)
    lines = done.stderr.splitlines()
    assert len(lines) == 2, done.stderr
    assert "not checked by unified-planning: it says '" in lines[0]
    assert "environment flag" not in lines[0]
    assert lines[1] == f"1 other instance: {lines[0].partition(': ')[2]}"


def test_where_a_star_does_not_answer_soon_the_table_is_checked_at_once(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def never(*_: object, limits: Limits, **__: object) -> None:
        while limits.stop is not None and not limits.stop.is_set():
            time.sleep(0.001)
        raise LimitError("Fast Downward was stopped")

    monkeypatch.setattr("planner.costtogo.astar.astar", never)
    monkeypatch.setattr(solving, "verify", None)  # nothing more may be asked of it
    options = SolveOptions(soon=0.2, small=0, first_answer_after=0.0)
    told: list[dict] = []
    record = solve_instance(instance(TINY), options, tmp_path / "tiny", tell=lambda record, _: told.append(record))
    assert (record["status"], record["cost"], record["plan_by"], record["verified"]) == ("solved", 6, "table", 0)
    assert record["note"] == (
        "the plan is that of the table: A* did not answer within 0 s; A* does not answer soon: h* was checked along "
        "the plan (7 states), and against the successors of 20 states"
    )
    assert (told[0]["cost"], told[0]["plan"], told[0]["note"]) == (6, None, "A* had not found its plan")
    assert plan_cost(load(TINY), record["plan"]) == 6


def test_a_table_that_is_wrong_along_the_plan_is_found_out(tiny: Table) -> None:
    plan = tiny.optimal_plan() or []
    assert check_plan(tiny, plan) == 7
    state = tiny.initial
    for action in plan[:3]:
        rows = tiny.choices([state])
        state = int(rows.targets[[tiny.task.actions[number] for number in rows.actions].index(action)])
    distance = tiny.distance.copy()
    distance[state] += 1
    with pytest.raises(MismatchError, match="after step 3 of the plan is 4, but its other steps cost 3"):
        check_plan(Table(tiny.space, distance), plan)


def test_what_is_compared_of_a_small_task_does_not_depend_on_time() -> None:
    options = SolveOptions(comparison_share=0.0, comparison_seconds=0.0, verify=5)
    records = [solve_instance(instance(TINY), options) for _ in range(2)]
    assert [(one["verified"], one["consistent"], one["note"]) for one in records] == [(5, 5, None)] * 2


def test_a_folder_is_a_line_for_each_instance_in_order_of_completion(capsys: pytest.CaptureFixture[str]) -> None:
    """Each line is there when its instance is done, below one header; a note that several share is said once."""
    record = solve_instance(instance(TINY), SolveOptions(verify=1))
    names = ["late.pddl", "a/longer/name.pddl", "third.pddl"]
    records = [{**record, "instance": name, "note": "read by a; so said"} for name in names]
    answers = Answers(names, as_json=False)
    answers.first({**records[0], "note": SWEEPING})
    assert capsys.readouterr() == ("", "")
    answers.add(records[1])
    shown = capsys.readouterr()
    header, line = shown.out.splitlines()
    assert " ".join(header.split()) == "instance status cost states dead ends largest h* verified seconds"
    assert line.split()[:4] == ["a/longer/name.pddl", "solved", "6", "21"]
    assert shown.err == "a/longer/name.pddl: read by a; so said\n"
    answers.add({**records[0], "note": "read by a; only this"})
    shown = capsys.readouterr()
    assert len(shown.out.splitlines()) == 1
    assert len(shown.out.splitlines()[0]) == len(line) == len(header)
    assert shown.err == "late.pddl: only this\n"
    answers.add(records[2])
    assert capsys.readouterr().err == ""
    answers.show(records)
    assert capsys.readouterr() == ("", "2 other instances: read by a\n1 other instance: so said\n")


def test_a_limit_of_states_is_no_computation_of_all_of_them() -> None:
    done = invoke("solve", TINY, "--max-states", 1)
    assert done.stderr == f"{TINY}: solved on demand: more than 1 state\n"


@pytest.mark.parametrize("name", ["type@part", "type@object", "@goal-reachable", "new-axiom@0"])
def test_names_of_fast_downwards_own_are_refused(tmp_path: Path, name: str) -> None:
    for old in ("(free)", "(far "):
        texts = [text.replace(old, old.replace(old.strip("( )"), name)) for text in (DOMAIN, PROBLEM)]
        with pytest.raises(PDDLError, match=f"'{name}' cannot be the name of a .*: Fast Downward has names") as error:
            load(write_instance(tmp_path, *texts))
        assert error.value.line in (4, 5)


@pytest.mark.parametrize("name", ["dummy", "object", "number", "total-cost", "atom", "val1", "at"])
def test_other_names_are_names(tmp_path: Path, name: str) -> None:
    texts = [text.replace("(free)", f"({name})").replace("GO", "2") for text in (DOMAIN, PROBLEM)]
    task = load(write_instance(tmp_path, *texts))
    assert astar(task)[0] == 6


def test_what_is_nested_too_deep_is_refused_with_its_line(tmp_path: Path) -> None:
    deep = PROBLEM.replace("(in nut kit)", "(and " * 400 + "(in nut kit)" + ")" * 400)
    with pytest.raises(PDDLError, match="more than 200 parentheses are open here") as error:
        load(write_instance(tmp_path, DOMAIN.replace("GO", "2"), deep))
    assert error.value.line == 5


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no fork that is safe")
def test_a_kill_for_lack_of_memory_leaves_a_record(tmp_path: Path) -> None:
    """The fork that solves a single instance is killed while all states are being computed."""

    def forks(process: int) -> list[int]:
        tasks = Path(f"/proc/{process}/task").iterdir()
        found = [int(child) for task in tasks for child in (task / "children").read_text().split()]
        return [child for child in found if b"kitassist" in Path(f"/proc/{child}/cmdline").read_bytes()]

    results = tmp_path / "out" / "results.jsonl"
    command = [Path(sys.executable).with_name("kitassist"), "solve", KITTING / "ladder-6x12.pddl", "--json"]
    with subprocess.Popen(
        [*command, "--out", results.parent], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        while process.poll() is None and not (results.exists() and results.read_text()):
            time.sleep(0.02)
        (fork,) = forks(process.pid)
        os.kill(fork, signal.SIGKILL)
        printed, said = process.communicate(timeout=60)
    (record,) = json.loads(printed)
    assert (record["status"], record["cost"], process.returncode) == ("solved", 24, 0)
    assert record["note"].endswith("the worker process died with exit code -9, probably out of memory")
    assert json.loads(results.read_text().splitlines()[-1]) == record
    assert record["note"] in said


def test_a_kill_before_the_first_answer_is_a_limit(tmp_path: Path) -> None:
    code = f"""
import os, signal
from planner import instance
from planner.batch import solve_batch as batch

def killed(*_, **__):
    os.kill(os.getpid(), signal.SIGKILL)

batch.solve_instance = killed
(record,) = batch.solve_batch([instance({str(TINY)!r})], jobs=0)
print(record["status"], record["error"]["message"])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, cwd=tmp_path)
    assert done.stdout == "limit the worker process died with exit code -9, probably out of memory\n", done.stderr
