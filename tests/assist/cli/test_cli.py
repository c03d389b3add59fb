"""The commands as users script them: options, records, exit codes, and the streams of their output."""

from __future__ import annotations

import errno
import json
import re
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from conftest import DOMAINS, KITTING, ROOT, invoke, kitassist, thinned, understood, write_instance

from assist.cli import main
from assist.cli.command_group import COMMANDS
from assist.cli.options.help import GROUPS
from assist.declare.options import FieldOption
from planner import Packing, Table, load
from planner.batch.results_folder import SolveOptions
from planner.batch.solve_instance import solve_instance
from planner.grounding.fast_downward import ASTAR
from planner.pddl.validation import validate
from planner.system.processes import NO_MORE_THREADS

FIELDS = [
    "instance", "domain", "status", "cost", "plan", "plan_by", "states", "transitions", "dead_ends", "max_cost_to_go",
    "method", "verified", "consistent", "compiled", "seconds", "peak_memory_mb", "versions", "error", "note",
]  # fmt: skip


def test_every_instance_is_recorded_and_printed_and_a_bad_one_does_not_disturb_the_rest(tmp_path: Path) -> None:
    """Unsolvable tasks, dead ends, costs, and a file with a fault."""
    bad = write_instance(tmp_path / "bad", "(define (domain kitting)", "(define (problem p) (:domain kitting))")
    names = [KITTING / "unsolvable.pddl", f"{KITTING}/s[e]aled.pddl", KITTING / "costs" / "ways.pddl", bad.problem]
    result = invoke("solve", *names, "--out", tmp_path / "out", "--verify", 1, "--jobs", 1)
    assert result.exit_code == 1
    records = [json.loads(line) for line in (tmp_path / "out" / "results.jsonl").read_text().splitlines()]
    found = {Path(record["instance"]).stem: record for record in records}
    assert all(f"{name}.pddl " in result.stdout for name in ("unsolvable", "sealed", "ways", "problem"))
    assert [found["unsolvable"][key] for key in ("status", "cost", "plan")] == ["unsolvable", None, None]
    assert [found["sealed"][key] for key in ("status", "cost", "dead_ends")] == ["solved", 10, 620]
    assert [found["ways"][key] for key in ("cost", "verified")] == [18, 1]
    assert (found["problem"]["instance"], found["problem"]["status"]) == (str(bad.problem), "invalid")
    assert [list(record) for record in records] == [FIELDS] * 4
    assert set(found["ways"]["seconds"]) >= {"read", "translate", "search", "verify", "plan", "validate", "total"}
    assert found["ways"]["versions"]["fast_downward"].startswith("26.")
    assert found["ways"]["plan_by"] == ASTAR
    said = "')' is missing between here and the end of the file"
    assert found["problem"]["error"] == {"file": str(bad.domain), "line": 1, "message": said}
    assert result.stderr.splitlines() == [f"{bad.domain}:1: {said}"]


def test_tables_and_plans_are_saved(tmp_path: Path, tiny: Table, monkeypatch: pytest.MonkeyPatch) -> None:
    instance = write_instance(
        tmp_path / "in", (KITTING / "domain.pddl").read_text(), (KITTING / "tiny.pddl").read_text()
    )
    out = tmp_path / "out"
    monkeypatch.chdir(tmp_path)
    assert invoke("solve", "in/problem.pddl", "--out", "out").exit_code == 0
    assert sorted(str(f.relative_to(out)) for f in out.rglob("*.*")) == [
        "in/problem.npz",
        "in/problem.plan",
        "results.jsonl",
    ]
    (record,) = [json.loads(line) for line in (out / "results.jsonl").read_text().splitlines()]
    lines = (out / "in" / "problem.plan").read_text().splitlines()
    assert lines == [*record["plan"], "; cost = 6 (unit cost)"]
    validate(understood(instance), lines[:-1])
    with np.load(out / "in" / "problem.npz") as saved:
        np.testing.assert_array_equal(saved["cost_to_go"], tiny.distance)
        packing = Packing(saved["word"], saved["shift"], saved["bits"], saved["states"].shape[1])
        values = packing.unpack(saved["states"])
        facts = [str(saved["facts"][variable, value]) for variable, value in enumerate(values[tiny.initial])]
        assert "(in-storage box-a)" in facts
        np.testing.assert_array_equal(values, tiny.values(np.arange(21)))


def test_larger_tasks_are_solved_on_demand() -> None:
    (record,) = json.loads(invoke("solve", KITTING / "paper.pddl", "--max-states", 500, "--json").stdout)
    assert (record["status"], record["cost"], record["method"]) == ("solved", 10, "on-demand")
    assert record["states"] is record["transitions"] is record["dead_ends"] is record["max_cost_to_go"] is None
    assert len(record["plan"]) == 10


def test_a_reason_names_the_instance_once(tmp_path: Path) -> None:
    dear = "(:action x :effect (and (a) (increase (total-cost) 1000000000000)))"
    problem = "(define (problem p) (:domain d) (:init) (:goal (a)) (:metric minimize (total-cost)))"
    cheap = "(:action y :effect (and (not (a)) (increase (total-cost) 1)))"  # so that the costs have no divisor
    instance = write_instance(tmp_path, f"(define (domain d) (:predicates (a)) {dear} {cheap})", problem)
    result = invoke("solve", instance.problem, "--max-states", 1)
    what = "a cost of 1000000000000 is more than Fast Downward can read; not swept: more than 1 state"
    assert result.stderr == f"{instance.problem}: {what}\n"


@pytest.mark.slow
def test_a_time_limit_holds_and_disturbs_nobody() -> None:
    names = [DOMAINS / "depot" / "four-boxes.pddl", KITTING / "tiny.pddl"]  # the first takes minutes with either method
    result = kitassist("solve", *names, "--time-limit", 5, "--max-states", 10**12, "--json")
    assert result.returncode == 1
    big, small = json.loads(result.stdout)
    assert (big["status"], small["status"]) == ("limit", "solved")
    assert "out of time" in big["error"]["message"]


@pytest.mark.slow
def test_a_memory_limit_holds() -> None:
    names = [KITTING / "ladder-4x9.pddl", KITTING / "tiny.pddl"]
    result = kitassist("solve", *names, "--memory-limit", 300, "--time-limit", 600, "--max-states", 10**9, "--json")
    assert result.returncode == 0
    big, small = json.loads(result.stdout)
    assert (big["status"], big["cost"], big["method"], big["states"]) == ("solved", 17, "on-demand", None)
    assert "memory" in big["note"]
    assert big["note"] in result.stderr
    assert big["peak_memory_mb"] < 1.2 * 300
    assert (small["status"], small["method"], small["note"]) == ("solved", "sweep", None)


@pytest.mark.cases
@pytest.mark.parametrize("limit", thinned([30, 1]))
def test_a_limit_below_what_python_takes_is_told_as_such(limit: int) -> None:
    result = kitassist("solve", KITTING / "tiny.pddl", "--memory-limit", limit)
    assert re.search(
        rf"out of memory.*; a limit of {limit} MB is below what Python itself takes here, \d+ MB; expected more\n$",
        result.stderr + result.stdout,
    )


@pytest.mark.parametrize(
    "error",
    thinned(
        [OSError(errno.ENOMEM, "Cannot allocate memory", "/bin/sh"), MemoryError(), RuntimeError(NO_MORE_THREADS)], 3
    ),
)
def test_whoever_finds_no_memory_it_is_said_of_the_instance(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    def full(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("planner.costtogo.portfolio.cost_to_go", full)
    record = solve_instance(load(KITTING / "tiny.pddl").instance, SolveOptions(memory_limit=3000.0))
    assert (record["status"], record["error"]["message"]) == ("limit", "out of memory (3000 MB)")
    assert record["error"]["file"] == str(KITTING / "tiny.pddl")


@pytest.mark.slow
def test_memory_is_shared_by_those_that_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory is shared among running processes, not by their largest number: 3 GB suffice for one, a thousandth of it
    for none.
    """
    monkeypatch.setattr("planner.batch.solve_batch.available_memory", lambda: 3e9)
    result = invoke("solve", KITTING / "tiny.pddl", "--jobs", 1000, "--json")
    assert [record["status"] for record in json.loads(result.stdout)] == ["solved"]


@pytest.mark.slow
def test_resume_keeps_what_is_finished(tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert invoke("solve", KITTING / "tiny.pddl", "--out", out).exit_code == 0
    again = invoke("solve", KITTING / "tiny.pddl", "--out", out)
    assert again.exit_code == 2
    assert "exists" in again.stderr
    before = json.loads((out / "results.jsonl").read_text())
    with (out / "results.jsonl").open("a") as stream:
        stream.write('{"instance": "cut o')
    names = [KITTING / "paper-fixed.pddl", KITTING / "tiny.pddl"]
    result = invoke("solve", *names, "--out", out, "--resume", "--json")
    assert result.exit_code == 0
    assert json.loads(result.stdout)[1] == before  # the very record, seconds included
    assert [json.loads(line) for line in (out / "results.jsonl").read_text().splitlines()] == json.loads(result.stdout)
    assert invoke("solve", names[1], "--out", out, "--resume").exit_code == 0
    assert len((out / "results.jsonl").read_text().splitlines()) == 2  # the other record is kept


def test_a_wrong_table_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    import planner.costtogo.portfolio

    def broken(*arguments: object, **options: object) -> Table:
        table = original(*arguments, **options)  # type: ignore[arg-type]
        distance = table.distance.copy()  # type: ignore[attr-defined]
        distance[table.initial] += 1
        return Table(table.space, distance)  # type: ignore[attr-defined]

    original = planner.costtogo.portfolio.cost_to_go
    monkeypatch.setattr(planner.costtogo.portfolio, "cost_to_go", broken)
    record = solve_instance(load(KITTING / "tiny.pddl").instance, SolveOptions())
    assert record["status"] == "invalid"
    assert re.search("is 7, but (its successors say|Fast Downward's A\\* says) 6", record["error"]["message"])
    assert record["cost"] is record["plan"] is None


TEAM = ("simulate", "kitting/tiny", "--humans", 2, "--episodes", 10, "--pool", 3, "--set", "max_steps=60", "--seed", 5)
THREE = ("--policy", "none", "--policy", "reactive", "--policy", "attention")


def test_simulate_gives_identical_bytes_for_a_seed(tmp_path: Path) -> None:
    runs = []
    for number in range(2):
        files = {name: tmp_path / f"{number}-{name}" for name in ("episodes.jsonl", "trace.jsonl")}
        result = invoke(*TEAM, *THREE, "--json", "--out", files["episodes.jsonl"], "--trace", files["trace.jsonl"])
        assert result.stderr == ""
        runs.append((result.stdout, *(file.read_bytes() for file in files.values())))
    assert runs[0] == runs[1]
    other = invoke(*TEAM[:-1], 6, *THREE, "--json")
    assert json.loads(other.stdout)["policies"] != json.loads(runs[0][0])["policies"]

    document = json.loads(runs[0][0])
    assert [p["policy"] for p in document["policies"]] == ["none", "reactive", "attention"]
    episodes = [json.loads(line) for line in runs[0][1].splitlines()]
    assert len(episodes) == 30
    for summary in document["policies"]:
        own = [e for e in episodes if e["policy"] == summary["policy"]]
        assert summary["human_actions_per_person"]["mean"] == pytest.approx(
            np.mean([np.mean(e["actions"]) for e in own])
        )
        assert summary["interventions"]["mean"] == pytest.approx(np.mean([e["interventions"] for e in own]))
        assert summary["return"]["mean"] == pytest.approx(np.mean([e["discounted_return"] for e in own]))
    trace = [json.loads(line) for line in runs[0][2].splitlines()]
    assert {"person", "episode", "step", "action", "suggestion"} <= set(trace[0])
    assert len(trace) == sum(sum(e["actions"]) for e in episodes)


def test_simulate_prints_a_table_and_draws_a_picture(tmp_path: Path) -> None:
    result = invoke(*TEAM, *THREE, "--figure", tmp_path / "one.svg")
    assert (result.exit_code, result.stderr) == (0, "")
    lines = result.stdout.splitlines()
    assert lines[0].split()[:1] == ["policy"]
    assert [line.split()[0] for line in lines[1:4]] == ["none", "reactive", "attention"]
    assert all("±" in line for line in lines[1:4])
    assert (tmp_path / "one.svg").read_bytes().startswith(b"<?xml")
    assert (tmp_path / "one.svg").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        ((KITTING / "tiny.pddl",), 2, "--humans"),
        ((KITTING / "tiny.pddl", "kitting/paper", "--humans", 2), 2, "expected one INSTANCE at a time"),
        ((KITTING / "tiny.pddl", "--humans", 0), 2, "--humans"),
        ((KITTING / "tiny.pddl", "--humans", 5, "--pool", 3), 2, "more than --pool 3"),
        ((KITTING / "tiny.pddl", "--humans", 2, "--policy", "psychic"), 2, "psychic"),
        ((KITTING / "tiny.pddl", "--humans", 2, "--set", "gamma=1.5"), 2, "gamma: 1.5; expected a number"),
        ((KITTING / "tiny.pddl", "--humans", 2, "--c-move", -1), 2, "--c-move: -1; expected a number from 0"),
        ((KITTING / "tiny.pddl", "--humans", 2, "--set", "population.theta=[0.5, 1.5]"), 2,
         "theta: [0.5, 1.5]; expected"),
        ((KITTING / "tiny.pddl", "--humans", 2, "--figure", "x.doc"), 2, ".png"),
        ((KITTING, "--humans", 2), 2, "expected one"),
        ((KITTING / "unsolvable.pddl", "--humans", 2), 1, "cannot be reached"),
        ((KITTING / "tiny.pddl", "--humans", 2, "--out", "/dev/null/x"), 1, "/dev/null"),
    ],
)  # fmt: skip
def test_simulate_refuses_what_makes_no_sense(arguments: tuple[object, ...], code: int, words: str) -> None:
    result = invoke("simulate", *arguments)
    assert result.exit_code == code
    assert isinstance(result.exception, SystemExit)
    assert words in result.stderr
    assert result.stdout == ""


def test_every_shipped_instance_is_described() -> None:
    for problem in DOMAINS.rglob("*.pddl"):
        readme = next(p / "README.md" for p in problem.parents if (p / "README.md").exists())
        if problem.name != "domain.pddl":
            assert problem.name in readme.read_text(), (
                f"{problem.relative_to(ROOT)} is not in {readme.relative_to(ROOT)}"
            )


WITHIN = {"compare": ("models", "rules")}
EVERY = [
    " ".join((name, *inner))
    for name in COMMANDS
    for inner in ([(one,) for one in WITHIN[name]] if name in WITHIN else [()])
]


def options_of(name: str) -> list[click.Option]:
    command: click.Command | None = main
    for part in name.split():
        assert isinstance(command, click.Group)
        command = command.get_command(click.Context(command), part)
    assert command is not None
    return [option for option in command.params if isinstance(option, click.Option)]


def test_an_option_has_one_meaning_one_type_and_one_default_on_all_commands() -> None:
    """`--policy` may be repeated on some, and `--out` says what is written there."""
    found: dict[str, set[tuple[Any, ...]]] = {}
    for name in EVERY:
        for option in options_of(name):
            said = str(option.help).removesuffix(" Repeat it to compare several.")
            if option.opts[0] == "--out":
                said = said.partition(":")[0]
            kind = type(option.type), *(getattr(option.type, limit, None) for limit in ("min", "max", "choices"))
            default = option.default[0] if isinstance(option.default, tuple) else option.default
            found.setdefault(option.opts[0], set()).add((said, kind, default))
    assert {name: means for name, means in found.items() if len(means) > 1} == {}


@pytest.mark.parametrize("name", EVERY)
def test_the_help_shows_an_example_and_every_option_in_a_group(name: str) -> None:
    text = invoke(*name.split(), "--help").output
    assert f"Example: kitassist {name}" in text
    assert "…" not in text  # choices are never cut
    options = options_of(name)
    grouped = {option for group in GROUPS.values() for option in group}
    for option in options:
        assert option.opts[0] in grouped or isinstance(option, FieldOption)
        assert option.help
        assert option.opts[0] in text
    assert text.count("\n") < 110


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("recorded") / "log.jsonl"
    simulated = ("simulate", KITTING / "tiny.pddl", "--humans", 2, "--episodes", 2, "--c-suggest", 0, "--c-move", 0)
    assert invoke(*simulated, "--trace", file).exit_code == 0
    return file


@pytest.mark.parametrize(
    "command",
    thinned(
        [
            ("simulate", "TINY", "--humans", 2, "--episodes", 1),
            ("bound", "TINY", "--humans", 1, "--policy", "none", "--value-episodes", 2, "--gap", 1),
            ("policy", "TINY", "--gap", 1),
            ("export", "TINY", "--out", "NEW.pomdpx"),
            ("fit", "TINY", "LOG"),
            ("compare", "models", "TINY", "LOG", "--folds", 2),
            ("draw", "TINY", "--out", "NEW.svg"),
            ("compare", "rules", "TINY", "LOG", "--folds", 2),
            ("infer", "TINY", "LOG"),
        ]
    ),
    ids=lambda command: str(command[0]),
)
def test_a_printed_setting_is_accepted_unedited(command: tuple[object, ...], recorded: Path, tmp_path: Path) -> None:
    (file := tmp_path / "all.toml").write_text(invoke("settings", command[0]).stdout)
    words = {"TINY": KITTING / "tiny.pddl", "LOG": recorded, "NEW.pomdpx": tmp_path / "a.pomdpx"}
    words["NEW.svg"] = tmp_path / "a.svg"
    result = invoke(*(words.get(str(one), one) for one in command), "--setting", file)
    assert result.exit_code == 0, result.stderr


@pytest.mark.parametrize(
    "settings",
    [
        ["neighbours.rule=outcome"],
        ["population.noise=action"],
        ["population.sigma=[0.5,2.0]"],
        ["believed_trust=constant", "trust=paper"],
        ["believed_trust=constant", "eta=0.3"],
    ],
)
def test_one_person_has_neither_neighbours_nor_draws_of_a_population(settings: list[str], tmp_path: Path) -> None:
    given = [word for one in settings for word in ("--set", one)]
    result = invoke("export", KITTING / "tiny.pddl", "--out", tmp_path / "a.pomdpx", *given)
    name = settings[-1].partition("=")[0]
    assert f"--set {name} has no effect on the problem of one person" in result.stderr
    assert (result.exit_code, [*tmp_path.iterdir()]) == (2, [])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["trust.rule=outcome"], "--set trust.rule: trust has no parts; expected --set trust=VALUE, which is"),
        (["c_suggest=1\ngamma=0.2"], "expected a number from 0 to 1e+15"),
        (["population={beta=[1,2]}", "population.beta=[1,3]"], "--set population.beta: it is set twice"),
        (["population.beta=[1,3]", "population={beta=[1,2]}"], "--set population: it is set twice"),
    ],
)  # fmt: skip
def test_a_value_on_the_command_line_is_one_value(words: list[str], message: str, tmp_path: Path) -> None:
    given = [word for one in words for word in ("--set", one)]
    result = invoke("export", KITTING / "tiny.pddl", "--out", tmp_path / "a.pomdpx", *given)
    assert (result.exit_code, message in result.stderr) == (2, True), result.stderr


def test_values_without_effect_in_a_file_are_named_with_their_lines(tmp_path: Path) -> None:
    (file := tmp_path / "all.toml").write_text("gamma = 0.95\nmemory_limit = 1\nmax_states = 7\n")
    result = invoke("export", KITTING / "tiny.pddl", "--out", tmp_path / "a.pomdpx", "--setting", file)
    why = "has no effect on an export"
    assert f"Error: {file}:3: max_states {why}; {file}:2: memory_limit {why}\n" in result.stderr
