"""Inputs that were met in use, each with its right answer: `pytest -m cases` runs these and their siblings."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path

import pytest
from conftest import invoke, write_instance

from planner import load
from planner.batch import solve_instance as solving
from planner.batch.results_folder import SolveOptions
from planner.batch.solve_instance import solve_instance

pytestmark = pytest.mark.cases

ANN = ["(fetch box-a)", "(place hammer slot-2 box-a)", "(remove hammer slot-2 box-a)", "(place hammer slot-1 box-a)",
       "(return box-a)", "(fetch box-b)", "(place wrench slot-2 box-b)", "(return box-b)"]  # fmt: skip
BOB = [ANN[0], *ANN[3:]]
RIGHT = ANN[3]
ROWS = [[person, "1", str(step), action] for person, actions in (("ann", ANN), ("bob", BOB)) for step, action in
        enumerate(actions)]  # fmt: skip
HEAD = ["person", "episode", "step", "action"]


def table(rows: list[list[str]], separator: str = ",", around: tuple[str, str] = ("", "")) -> str:
    return "".join(f"{around[0]}{separator.join(row)}{around[1]}\n" for row in rows)


def told(nothing: str = "", *, rows: list[list[str]] = ROWS) -> list[list[str]]:
    """Return rows with a suggestion at step 1; elsewhere there is `nothing`."""
    return [[*row, RIGHT if row[2] == "1" else nothing] for row in rows]


def with_pause(action: str) -> list[list[str]]:
    """Return the rows with a step of ann at which she does nothing."""
    later = [[person, "1", str(int(step) + 1), what] for person, _, step, what in ROWS[2:8]]
    return told(rows=[*ROWS[:2], ["ann", "1", "2", action], *later, *ROWS[8:]])


FULL = [*HEAD, "suggestion"]
PSQL = table([[f" {cell:<27}" for cell in row] for row in (HEAD, *ROWS)], "|")
JSPSYCH = ["rt", "trial_type", "trial_index", "subject", "block", "move", "hint"]
TRIALS = [["512", "html-button-response", str(1 + 2 * int(step)), person, *rest]
          for person, _, step, *rest in ([row[0], row[1], row[2], "1", *row[3:]] for row in told())]  # fmt: skip
SUBJECTS = "person=subject,episode=block,step=trial_index,action=move,suggestion=hint"
PSYCHOPY = ["action", "hint", "trials.thisN", "key_resp.rt", "participant", "session", ""]
ROUTINES = [[action, hint, step, "0.5", "ann", "001", ""] for _, _, step, action, hint in told(rows=ROWS[:8])]
ALIKE = [*told(rows=ROWS[:8]), *([who, "2", *row] for who, _, *row in told(rows=ROWS[:8]))]
ANN_AND_BOB = {"ann": 8, "bob": 6}


def two_names(one: str, other: str) -> str:
    """Return a log of one person whose name is written in two ways."""
    return table([FULL, *([one if row[1] == "1" else other, *row[1:]] for row in ALIKE)])


@dataclass(frozen=True)
class Case:
    """A log, the options that it needs, and the number of actions of each person that are used."""

    text: str
    actions: dict[str, int]
    options: tuple[str, ...] = ()
    said: str = ""
    name: str = "log.csv"


LOGS = {
    "bars between blanks": Case(table([HEAD, *ROWS], " | ", (" ", " ")), ANN_AND_BOB, name="log.txt"),
    "a table of psql": Case(
        PSQL.replace("\n", "\n" + "+".join(["-" * 28] * 4) + "\n", 1) + "(14 rows)\n", ANN_AND_BOB, name="log.txt"
    ),
    "commas between blanks": Case(table([HEAD, *ROWS], " , "), ANN_AND_BOB),
    "semicolons between blanks": Case(table([HEAD, *ROWS], " ; "), ANN_AND_BOB),
    "tabs between blanks": Case(table([HEAD, *ROWS], " \t "), ANN_AND_BOB, name="log.tsv"),
    "nothing done, as null": Case(
        "".join(
            json.dumps({**dict(zip(FULL, row, strict=True)), "step": int(row[2]), "action": row[3] or None,
                        "suggestion": row[4] or None}) + "\n"
            for row in with_pause("")
        ), ANN_AND_BOB, name="log.jsonl",
    ),
    "nothing done, as an empty cell": Case(table([FULL, *with_pause("")]), ANN_AND_BOB),
    "suggestions of what is dropped": Case(
        table([FULL, *([*row[:4], "wait" if row[:3] in (["ann", "1", "0"], ["ann", "1", "1"]) else row[4]]
                       for row in with_pause("wait"))]), ANN_AND_BOB, ("--drop", "wait"),
    ),
    "none as no suggestion": Case(table([FULL, *told("none")]), ANN_AND_BOB, ("--drop", "none")),
    "noop as no suggestion": Case(table([FULL, *told("noop")]), ANN_AND_BOB, ("--drop", "noop")),
    "a dash as no suggestion": Case(
        table([FULL, *(["ann", "1", str(step), action, "-"] for step, action in
                       enumerate(("fetch box-a", "place hammer slot-1 box-a", "return box-a"), 1))]), {"ann": 3},
    ),
    "routines of PsychoPy": Case(
        table([PSYCHOPY, ["", "", "", "3.21", "ann", "001", ""], *ROUTINES, ["", "", "", "", "ann", "001", ""]]),
        {"ann": 8}, ("--columns", "person=participant,episode=session,step=trials.thisN,suggestion=hint"),
    ),
    "trials of jsPsych": Case(
        table([JSPSYCH, ["9000", "instructions", "0", "ann", "", "", ""], *TRIALS[:8],
               ["9000", "instructions", "0", "bob", "", "", ""], *TRIALS[8:]]), ANN_AND_BOB,
        ("--columns", SUBJECTS, "--set", "gaps=true"),
    ),
    "trials of jsPsych, instructions within the block": Case(
        table([JSPSYCH, *(["9000", "instructions", "0", who, "1", "", ""] for who in ANN_AND_BOB), *TRIALS]),
        ANN_AND_BOB, ("--columns", SUBJECTS, "--set", "gaps=true"),
    ),
    "a space of no width in actions": Case(
        table([FULL, *([*row[:3], f"{row[3]}\u200b", row[4] and f"{row[4]}\u200b"] for row in told())]), ANN_AND_BOB,
        said="U+200B",
    ),
    "a space of no width in a name": Case(two_names("ann", "ann\u200b"), {"ann": 16}, said="U+200B"),
    "a letter in two parts": Case(two_names("Zo\u00eb", "Zoe\u0308"), {"Zo\u00eb": 16}, said="decomposed letters"),
    "a mark of direction": Case(two_names("ann", "\u200fann"), {"ann": 16}, said="U+200F"),
    "a space that does not break": Case(two_names("ann lee", "ann\u00a0lee"), {"ann lee": 16}, said="U+00A0"),
    "two files with a mark of byte order, joined": Case(
        "\ufeff" + table([FULL, *told(rows=ROWS[:8])]) + "\ufeff" + table(told(rows=ROWS[8:])), ANN_AND_BOB,
        said="U+FEFF",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", LOGS)
def test_logs_are_read(tmp_path: Path, name: str) -> None:
    case = LOGS[name]
    file = tmp_path / case.name
    file.write_text(case.text, encoding="utf-8", newline="")
    done = invoke("fit", "kitting/tiny", file, *case.options, "--json")
    assert done.exit_code == 0, done.stderr
    people = json.loads(done.stdout)
    assert {person["person"]: person["actions"] for person in people} == case.actions
    assert case.said in done.stderr
    assert "left out" not in done.stderr


def machines(parts: int, bins: int, running: int) -> tuple[str, str]:
    """Return a grounded domain, in which each action needs many machines, and its problem of two parts to move."""
    at, every = [range(bins), range(parts)]
    on = [f"(machine-{n}-is-running)" for n in range(running)]
    lies = [f"(in-part-{part}-bin-{place})" for part in every for place in at]
    facts = ["(free)", *(f"(here-{place})" for place in at), *(f"(held-{part})" for part in every), *lies, *on]
    actions = []

    def action(name: str, needs: list[str], adds: list[str], removes: list[str]) -> None:
        gone = "".join(f"(not {fact})" for fact in removes)
        effect = f"(and {''.join(adds)}{gone})"
        actions.append(f"(:action {name} :precondition (and {' '.join(needs + on)}) :effect {effect})")

    for one, other in permutations(at, 2):
        action(f"go-{one}-{other}", [f"(here-{one})"], [f"(here-{other})"], [f"(here-{one})"])
    for part in every:
        for place in at:
            here, lying, held = f"(here-{place})", f"(in-part-{part}-bin-{place})", f"(held-{part})"
            action(f"pick-{part}-{place}", ["(free)", here, lying], [held], ["(free)", lying])
            action(f"put-{part}-{place}", [here, held], ["(free)", lying], [held])
    domain = f"(define (domain flat) (:requirements :strips)\n(:predicates {' '.join(facts)})\n{chr(10).join(actions)})"
    begin = ["(free)", "(here-0)", *on, *(f"(in-part-{part}-bin-0)" for part in every)]
    return domain, (
        f"(define (problem flat-1) (:domain flat) (:init {' '.join(begin)})\n"
        "(:goal (and (in-part-0-bin-1) (in-part-1-bin-1))))"
    )


PACKING = """(define (domain packing)
  (:requirements :strips :typing :action-costs)
  (:types part bin - object)
  (:predicates (in ?p - part ?b - bin) (held ?p - part) (free) (here ?b - bin) (path ?a ?b - bin))
  (:functions (total-cost) - number)
  (:action go :parameters (?a ?b - bin) :precondition (and (here ?a) (path ?a ?b))
    :effect (and (not (here ?a)) (here ?b) (increase (total-cost) GO)))
  (:action pick :parameters (?p - part ?b - bin) :precondition (and (here ?b) (in ?p ?b) (free))
    :effect (and (held ?p) (not (in ?p ?b)) (not (free)) (increase (total-cost) 1)))
  (:action put :parameters (?p - part ?b - bin) :precondition (and (here ?b) (held ?p))
    :effect (and (in ?p ?b) (free) (not (held ?p)) (increase (total-cost) 2))))
"""
PACKED = """(define (problem p) (:domain packing)
  (:objects bolt nut - part shelf kit - bin)
  (:init (free) (here shelf) (path shelf kit) (path kit shelf) (in bolt shelf) (in nut shelf) (= (total-cost) 0))
  (:goal (and (in bolt kit) (in nut kit)))
  (:metric minimize (total-cost)))
"""
UNMEASURED = PACKED.replace("(:metric minimize (total-cost))", "").replace("(= (total-cost) 0)", "")
FUNCTION = "(:functions (total-cost) - number)"
TIDY = """
  (:action tidy :parameters (?b - bin) :precondition (here ?b) :effect (and (free) (increase (total-cost) 3))))
"""


def one_cost(domain: str, go: str = "2") -> str:
    """Return the domain with a cost of `go` alone."""
    return domain.replace(" (increase (total-cost) 1)", "").replace(" (increase (total-cost) 2)", "").replace("GO", go)


CHORES = (
    """(define (domain d) (:requirements :strips :typing :action-costs) (:types part)
  (:predicates (todo ?p - part) (done ?p - part)) (:functions (total-cost) - number)
  (:action pick :parameters (?p - part) :precondition (todo ?p)
    :effect (and (not (todo ?p)) (done ?p) (increase (total-cost) 2))))""",
    """(define (problem p) (:domain d) (:objects a b - part) (:init (todo a) (todo b) (= (total-cost) 0))
  (:goal (and (done a) (done b))))""",
)
TASKS: dict[str, tuple[Callable[[], tuple[str, str]], int, int | None]] = {
    "many preconditions, which a second reader takes long to read": (lambda: machines(5, 5, 50), 7, None),
    "a cost without a metric": (lambda: (one_cost(PACKING), UNMEASURED), 7, 7),
    "a cost by a function without a metric": (
        lambda: (
            one_cost(PACKING.replace("(total-cost) -", "(total-cost) (dist ?a ?b - bin) -"), "(dist ?a ?b)"),
            UNMEASURED.replace("(in nut shelf)", "(in nut shelf) (= (dist shelf kit) 4) (= (dist kit shelf) 1)"),
        ), 7, 7,
    ),
    "a cost that is not declared, without a metric": (
        lambda: (one_cost(PACKING.replace(FUNCTION, "")), UNMEASURED), 7, 7,
    ),
    "a cost of another action, without a metric": (
        lambda: (one_cost(PACKING).replace(" (increase (total-cost) 2)", "").removesuffix(")\n") + TIDY, UNMEASURED),
        6, 12,
    ),
    "a cost and its beginning, without a metric": (lambda: CHORES, 2, 4),
}  # fmt: skip


@pytest.mark.parametrize("name", TASKS)
def test_tasks_are_solved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """`line` is that of the domain with a cost that does not count. The second reader is hardly waited for."""
    monkeypatch.setattr(solving, "SECOND_READER", 0.01)
    texts, cost, line = TASKS[name]
    record = solve_instance(write_instance(tmp_path, *texts()), SolveOptions(verify=1))
    assert (record["status"], record["cost"]) == ("solved", cost), record["error"]
    note = load(tmp_path / "problem.pddl").note
    assert (note or "").startswith("" if line is None else f"line {line} of the domain has an action cost, but the")


@pytest.fixture(scope="module")
def compiled_code(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Compilation, once after an installation, is in no limit of time."""
    write_instance(folder := tmp_path_factory.mktemp("usual"), PACKING.replace("GO", "3"), PACKED)
    invoke("bound", folder / "problem.pddl", "--humans", 2, "--time-limit", 1, "--episodes", 2)


@pytest.mark.usefixtures("compiled_code")
@pytest.mark.parametrize(("cost", "problem"), [
    (10**4, PACKED), (10**5, PACKED), (10**9, PACKED), (10**12, PACKED.replace(" (= (total-cost) 0)", "")),
])  # fmt: skip
def test_costs_of_very_different_size_are_bounded_and_simulated(tmp_path: Path, cost: int, problem: str) -> None:
    """Memory and time do not grow with the ratio of costs; a limit is kept in time of this process, as others work."""
    write_instance(tmp_path, PACKING.replace("GO", str(cost)), problem)
    begun, limit, team = time.process_time(), 15, (tmp_path / "problem.pddl", "--humans", 2, "--json", "--episodes")
    bound = json.loads(invoke("bound", *team, 1024, "--time-limit", limit).stdout)
    run = json.loads(invoke("simulate", *team, 20, "--policy", "priority").stdout)["policies"][0]
    assert time.process_time() - begun < limit
    assert -9 * cost < bound["value"] - 3 * bound["value_stderr"] < bound["upper"] < -4 * cost
    assert -9 * cost < run["return"]["mean"] < -4 * cost
    assert math.isfinite(bound["slack_percent"])
