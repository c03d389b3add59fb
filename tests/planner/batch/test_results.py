"""A resumed batch keeps complete results that were made from the same files."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import KITTING, invoke, write_instance

from planner import InputFileError, Instance
from planner.batch import results_folder as results
from planner.batch import solve_batch as batch
from planner.batch.results_folder import Results, SolveOptions
from planner.batch.solve_batch import solve_batch
from planner.batch.solve_instance import solve_instance
from planner.system import files

OPTIONS = SolveOptions(verify=1)
DOMAIN, TINY = (KITTING / "domain.pddl").read_text(), (KITTING / "tiny.pddl").read_text()
HALF = TINY.replace("(in-slot wrench slot-2)", "").replace("(in-storage box-b)))", "))")


def solved(folder: Path, *instances: Instance) -> Results:
    results = Results(folder, instances, OPTIONS, resume=False)
    for instance in instances:
        results.add(solve_instance(instance, OPTIONS, results.place(instance)))
    results.finish(instances)
    return results


def kept(folder: Path, *instances: Instance, options: SolveOptions = OPTIONS) -> set[str]:
    records = Results(folder, instances, options, resume=True).records
    return {str(instance.problem) for instance in instances if results.key(instance) in records}


@pytest.fixture
def instance(tmp_path: Path) -> Instance:
    return write_instance(tmp_path / "in", DOMAIN, TINY)


@pytest.mark.parametrize(
    "change", ["nothing", "comment", "domain", "other domain", "states", "time", "no file", "record", "search"]
)
def test_what_an_answer_depends_on(
    change: str, tmp_path: Path, instance: Instance, monkeypatch: pytest.MonkeyPatch
) -> None:
    solved(tmp_path / "out", instance)
    asked, options = instance, OPTIONS
    match change:
        case "comment":
            instance.problem.write_text(f"{TINY}; another")
        case "domain":
            instance.domain.write_text(DOMAIN.replace("(define", "(define ", 1))
        case "other domain":
            asked = Instance(instance.problem, tmp_path / "copy.pddl")
            asked.domain.write_text(DOMAIN)
        case "states":
            options = replace(OPTIONS, max_states=3)
        case "time":
            options = replace(OPTIONS, time_limit=100.0, memory_limit=5000.0)
        case "no file":
            instance.problem.unlink()
        case "record":  # still a valid record
            records = tmp_path / "out" / "results.jsonl"
            records.write_text(records.read_text().replace('"cost": 6', '"cost": 7'))
        case "search":
            shutil.copytree(Path(results.__file__).parent, programs := tmp_path / "planner")
            with (programs / "table.py").open("a") as file:
                file.write("# changed\n")
            monkeypatch.setattr(results, "__file__", str(programs / "results.py"))
            monkeypatch.setattr(results, "_programs", results._programs.__wrapped__)
    again = set() if change not in ("nothing", "time") else {str(instance.problem)}
    assert kept(tmp_path / "out", asked, options=options) == again


def test_a_file_that_was_changed_only_while_it_was_solved_is_solved_again(tmp_path: Path, instance: Instance) -> None:
    results = Results(tmp_path / "out", [instance], OPTIONS, resume=False)
    instance.problem.write_text(HALF)
    results.add(solve_instance(instance, OPTIONS, results.place(instance)))
    results.finish([instance])
    instance.problem.write_text(TINY)
    assert kept(tmp_path / "out", instance) == set()


@pytest.mark.parametrize("ending", ["npz", "plan"])
@pytest.mark.parametrize("damage", ["missing", "cut"])
def test_damaged_tables_and_plans_are_made_again(ending: str, damage: str, tmp_path: Path, instance: Instance) -> None:
    out = tmp_path / "out"
    solved(out, instance)
    (file,) = out.rglob(f"*.{ending}")
    if damage == "missing":
        file.unlink()
    else:
        file.write_bytes(file.read_bytes()[:-1])
    assert kept(out, instance) == set()
    assert not list(out.rglob("problem.*"))  # nothing is left that no record stands for


@pytest.mark.parametrize("field", ["instance", "domain", "place"])
def test_a_fingerprint_of_nothing_keeps_no_record(field: str, tmp_path: Path, instance: Instance) -> None:
    solved(tmp_path / "out", instance)
    prints = tmp_path / "out" / "fingerprints"
    prints.write_text(json.dumps({**json.loads(prints.read_text()), field: []}) + "\n")
    assert kept(tmp_path / "out", instance) == set()


def test_results_of_other_instances_stay(tmp_path: Path, instance: Instance) -> None:
    other = write_instance(tmp_path / "other", DOMAIN, TINY)
    solved(tmp_path / "out", instance, other)
    results = Results(tmp_path / "out", [other], OPTIONS, resume=True)
    results.finish([other])
    assert [problem for problem, _ in results.records] == [str(instance.problem), str(other.problem)]
    lines = (tmp_path / "out" / "results.jsonl").read_text().splitlines()
    assert [json.loads(line)["instance"] for line in lines] == [str(other.problem), str(instance.problem)]
    assert kept(tmp_path / "out", instance, other) == {str(instance.problem), str(other.problem)}


def test_files_of_two_instances_never_get_one_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "here").mkdir()
    for folder, text in (("x", TINY), ("here/x", HALF)):
        write_instance(tmp_path / folder, DOMAIN, text)
    monkeypatch.chdir(tmp_path / "here")
    above, below = (Instance(Path(f"{x}/problem.pddl"), Path(f"{x}/domain.pddl")) for x in ("../x", "x"))
    solved(tmp_path / "out", above, below)
    plans = {file.stem: file.read_text().splitlines()[-1] for file in (tmp_path / "out").rglob("*.plan")}
    assert plans == {"problem": "; cost = 6 (unit cost)", "problem-2": "; cost = 3 (unit cost)"}
    for one, plan in ((above, "problem"), (below, "problem-2")):  # asked for by itself it keeps its name
        assert Results(tmp_path / "out", [one], OPTIONS, resume=True).place(one).name == plan


@pytest.mark.parametrize(
    ("content", "place"),
    [
        (b"PK\x03\x04\x93\xff\n", ":1: is not text"),
        (b'{"person": "ann", "beta": 1.0}\n', ":1: expected a record of `kitassist solve`"),
        (b'{"instance": "a", "status": "limit"}\n{"instance": "b", "sta\n', ":2: is no JSON"),
        (b'{"instance": ["a"], "status": "solved"}\n', ":1: expected a record of `kitassist solve`"),
        (
            b'{"instance": "a", "domain": "d", "status": "solved", "plan": [], "seconds": {}, "error": "0.1.0"}\n',
            ":1: expected a record of `kitassist solve`",
        ),
    ],
)
def test_results_of_something_else_are_refused(content: bytes, place: str, tmp_path: Path) -> None:
    (tmp_path / "results.jsonl").write_bytes(content)
    result = invoke("solve", KITTING / "tiny.pddl", "--out", tmp_path, "--resume")
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith(f"{tmp_path / 'results.jsonl'}{place}")
    assert result.stderr.count("\n") == 1
    assert [file.read_bytes() for file in tmp_path.iterdir()] == [content]


def test_an_instance_whose_worker_ends_does_not_end_the_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ends = [TimeoutError(), ChildProcessError("the worker process died with exit code -9"), RuntimeError("a fault")]
    instances = [write_instance(tmp_path / str(number), DOMAIN, TINY) for number in range(len(ends))]

    def outcomes(_: object, items: list, *__: object, **___: object) -> Iterator[tuple]:
        yield from zip(items, ends, strict=True)

    monkeypatch.setattr(batch, "outcomes", outcomes)
    records = solve_batch([*instances], replace(OPTIONS, time_limit=5.0), out=tmp_path / "out", jobs=2)
    assert [(record["status"], record["error"]["message"]) for record in records] == [
        ("limit", "out of time (5 s)"),
        ("limit", "the worker process died with exit code -9"),
        ("invalid", "internal error: RuntimeError('a fault')"),
    ]
    assert len((tmp_path / "out" / "results.jsonl").read_text().splitlines()) == len(ends)


def test_a_second_run_into_the_same_folder_is_refused(
    tmp_path: Path, instance: Instance, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each would end with a file of its own records only."""
    out = tmp_path / "out"
    monkeypatch.setattr(files, "ORPHANED", 0.2)
    with (
        files.held(out),
        pytest.raises(InputFileError, match="another run writes into it; expected another folder"),
    ):
        solve_batch([instance], out=out, jobs=0)
    assert list(out.iterdir()) == []
    heard: list[tuple[Instance, str]] = []
    (record,) = solve_batch([instance], out=out, jobs=0, stages=lambda one, what, *_: heard.append((one, what)))
    assert record["status"] == "solved"
    assert {(instance, "reading"), (instance, "saving")} <= set(heard)


def test_workers_share_memory_and_processors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch, "available_memory", lambda: 8e9)
    monkeypatch.setattr(batch, "processors", lambda: 8)
    for jobs, threads, memory, shared in ((4, None, None, (2, 2000)), (16, None, 9e9, (1, 500)), (2, 3, 600, (3, 600))):
        found = batch._shared(SolveOptions(threads=threads, memory_limit=memory), jobs)
        assert (found.threads, found.memory_limit) == shared
    assert batch._shared(OPTIONS, 1) is OPTIONS
