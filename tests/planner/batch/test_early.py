"""First answers are reported and saved at once, and kept whatever happens to the remaining work."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import KITTING

import planner.costtogo.portfolio
from assist.cli.output.solve_records import Answers
from planner import LimitError, Limits, MismatchError, Table, instance, load, sweep, verify
from planner.batch import solve_batch as batch
from planner.batch.results_folder import COMPARING, SWEEPING, Results, SolveOptions, SolveRecord, saved_files
from planner.batch.solve_batch import solve_batch
from planner.batch.solve_instance import solve_instance
from planner.costtogo.astar import Early
from planner.grounding import fast_downward
from planner.grounding.task import plan_cost
from planner.system.limits import Budget, MemoryLimitError

TINY = KITTING / "tiny.pddl"
Told = list[tuple[SolveRecord, bool]]


def solved_late(
    monkeypatch: pytest.MonkeyPatch,
    place: Path | None,
    then: Callable[[Table], object],
    options: SolveOptions | None = None,
) -> tuple[Told, SolveRecord]:
    """Solve a task whose sweep ends only after the first answer was reported; `then` modifies its result."""
    original, first = planner.costtogo.portfolio.cost_to_go, threading.Event()
    told: Told = []

    def late(*arguments: object, **ways: object) -> object:
        assert first.wait(60)
        return then(original(*arguments, **ways))  # type: ignore[arg-type]

    def tell(record: SolveRecord, saved: bool) -> None:
        told.append((record, saved))
        first.set()

    monkeypatch.setattr(planner.costtogo.portfolio, "cost_to_go", late)
    options = replace(options or SolveOptions(), first_answer_after=0.0)
    return told, solve_instance(instance(TINY), options, place, tell=tell)


def test_cost_and_plan_are_there_before_all_states_are(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    table_file, plan_file = saved_files(tmp_path / "tiny")
    seen: list[list[bool]] = []

    def swept(table: Table) -> Table:
        seen.append([table_file.exists(), plan_file.exists()])
        return table

    told, record = solved_late(monkeypatch, tmp_path / "tiny", swept)
    (first, saved), *later = told
    assert (first["status"], first["cost"], first["method"], first["verified"]) == ("solved", 6, "on-demand", 1)
    assert (first["note"], first["states"], saved) == (SWEEPING, None, False)
    assert plan_cost(load(TINY), first["plan"]) == 6
    assert seen == [[False, True]]
    assert all(saved and each["note"] == COMPARING and each["states"] == 21 for each, saved in later)
    verified = [each["verified"] for each, _ in later]
    assert verified == [1, *range(1, 21)]  # the first answer counts
    assert (record["status"], record["note"], record["states"], record["cost"]) == ("solved", None, 21, 6)
    assert record["verified"] == 20


@pytest.mark.parametrize(
    ("fault", "note"),
    [
        (LimitError("out of time after 7 states"), "solved on demand: out of time after 7 states"),
        (MemoryError(), f"{SWEEPING}; out of memory"),
        (OSError(28, "No space left on device"), f"{SWEEPING}; No space left on device"),
        (RuntimeError("can't start new thread"), f"{SWEEPING}; out of memory"),
    ],
)
def test_the_plan_is_there_whatever_limit_ends_the_sweep(
    monkeypatch: pytest.MonkeyPatch, fault: Exception, note: str
) -> None:
    def ends(_: Table) -> None:
        raise fault

    _, record = solved_late(monkeypatch, None, ends)
    assert (record["status"], record["cost"], record["error"], record["note"]) == ("solved", 6, None, note)
    assert len(record["plan"]) == 6


def test_a_table_that_contradicts_the_first_answer_is_not_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def wrong(table: Table) -> Table:
        distance = table.distance.copy()
        distance[table.initial] += 1
        found = Table(table.space, distance)
        with pytest.raises(MismatchError, match="no cheapest way leads on"):
            found.optimal_plan()
        return found

    _, record = solved_late(monkeypatch, tmp_path / "tiny", wrong)
    assert (record["status"], record["cost"], record["plan"]) == ("invalid", None, None)
    assert "is 7, but Fast Downward's A* says 6" in record["error"]["message"]
    assert list(tmp_path.iterdir()) == []


def test_comparing_takes_a_part_of_the_search_unless_more_is_asked_for() -> None:
    shortest = SolveOptions(comparison_share=1e-9, comparison_seconds=0.0, small=0)
    short = solve_instance(instance(TINY), shortest)
    assert (short["status"], short["verified"], short["consistent"]) == ("solved", 1, 1)
    assert short["note"] == "A* was asked for 20 states, and answered for 1 in time"
    assert solve_instance(instance(TINY), replace(shortest, verify=21))["verified"] == 21
    assert solve_instance(instance(TINY), replace(shortest, comparison_seconds=600.0))["verified"] == 20
    assert solve_instance(instance(TINY), replace(shortest, small=21))["verified"] == 20


def test_a_comparison_that_is_killed_leaves_the_result(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The system kills a search for lack of memory: nothing is known about the state."""
    killed = tmp_path / "killed"
    killed.write_text("#!/bin/sh\nkill -9 $$\n")
    killed.chmod(0o755)
    monkeypatch.setattr(fast_downward, "_binary", lambda: killed)
    record = solve_instance(instance(TINY), SolveOptions(verify=3), tmp_path / "tiny")
    assert (record["status"], record["cost"], record["verified"], record["consistent"]) == ("solved", 6, 0, 3)
    assert (len(record["plan"]), record["plan_by"]) == (6, "table")
    assert "the plan is that of the table: Fast Downward's search failed" in record["note"]
    assert record["note"].endswith("A* was asked for 3 states, and answered for 0 in time")
    assert all(file.is_file() for file in saved_files(tmp_path / "tiny"))


def test_the_search_beside_a_sweep_borrows_memory() -> None:
    task, told = load(TINY), threading.Event()
    with Early(task, Limits(memory_mb=10_000), lambda _: told.set()) as early:
        assert 0 < early.reserved_bytes() <= 0.25 * 10_000e6
        assert early.wait(Limits()) == (6.0, early.answer[1] if early.answer else None)
        assert told.wait(60)
        assert early.reserved_bytes() == 0.0
    lent = [1e12]
    with pytest.raises(MemoryLimitError):
        sweep(task, reserved_bytes=lambda: lent[0])
    lent[0] = 0.0
    assert len(sweep(task, reserved_bytes=lambda: lent[0])) == 21
    assert Budget(None, 10.0, None, None, lambda: 4.0).room == 6.0


def test_a_search_that_is_stopped_says_so_and_can_be_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("planner.costtogo.astar.astar", never)
        with Early(load(TINY), Limits(), lambda _: pytest.fail("nobody is waiting"), delay=60.0) as early:
            assert not early.ended_within(0.0)
            assert early.within(0.1, Limits()) == "A* did not answer within 0 s"
            assert early.answer is None
        with Early(load(TINY), Limits(), lambda _: None) as early:
            assert early.within(60.0, Limits(seconds=0.01)) == "A* did not answer within 0 s"
    with Early(load(TINY), Limits(), lambda _: pytest.fail("nobody is waiting"), delay=60.0) as early:
        assert early.within(60.0, Limits()) is None
        assert early.answer is not None


def never(*_: object, limits: Limits, **__: object) -> None:
    """Search until stopped."""
    while limits.stop is not None and not limits.stop.is_set():
        time.sleep(0.001)
    raise LimitError("Fast Downward was stopped")


def test_a_comparison_that_is_over_leaves_no_search_behind(tiny: Table, monkeypatch: pytest.MonkeyPatch) -> None:
    """A search that never ends is stopped with the time for all: otherwise this test would not end."""
    monkeypatch.setattr(fast_downward, "ASTAR", "astar(blind(),max_time=infinity)")
    assert verify(tiny, 21, np.random.default_rng(0), seconds=1e-3) <= 1


@pytest.mark.parametrize("saved", [False, True])
def test_what_a_worker_has_told_outlives_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, saved: bool) -> None:
    """A resumed run keeps the record if its table and plan were saved."""
    told: Told = []
    solve_instance(instance(TINY), SolveOptions(verify=1), tell=lambda *what: told.append(what))
    note = COMPARING if saved else SWEEPING
    record = {**told[0][0], "note": note}

    def outcomes(_: object, items: list, *__: object, hear: Callable, **___: object) -> Iterator[tuple]:
        (item,) = items
        hear(item, batch.NEW_RECORD, record, saved)
        yield item, TimeoutError()

    monkeypatch.setattr(batch, "outcomes", outcomes)
    options = SolveOptions(time_limit=5.0, verify=1)
    assert solve_batch([instance(TINY)], options, out=tmp_path / "out") == [
        {**record, "note": f"{note}; out of time (5 s)"}
    ]

    def interrupted(_: object, items: list, *__: object, hear: Callable, **___: object) -> Iterator[tuple]:
        (item,) = items
        hear(item, batch.NEW_RECORD, {**record, "verified": 0}, saved)
        hear(item, batch.NEW_RECORD, record, saved)  # which is only stored at the end
        yield from [(item, None)][:0]
        raise KeyboardInterrupt

    monkeypatch.setattr(batch, "outcomes", interrupted)
    heard: list[SolveRecord] = []
    with pytest.raises(KeyboardInterrupt):
        solve_batch([instance(TINY)], options, out=tmp_path / "second", tell=heard.append)
    assert heard == [{**record, "verified": 0}, record]
    lines = (tmp_path / "second" / "results.jsonl").read_text().splitlines()
    assert json.loads(lines[-1]) == record
    assert len(Results(tmp_path / "second", [instance(TINY)], options, resume=True).records) == int(saved)


def test_an_answer_is_shown_once(capsys: pytest.CaptureFixture[str]) -> None:
    told: Told = []
    record = solve_instance(instance(TINY), SolveOptions(verify=1), tell=lambda *what: told.append(what))
    first = {**record, "states": None, "note": SWEEPING}
    answers = Answers([str(TINY)], as_json=False)
    answers.first(first)
    answers.first({**record, "note": COMPARING})
    shown = capsys.readouterr()
    assert shown.out.splitlines() == record["plan"]
    assert shown.err == f"{TINY}: cost 6, by the plan above; computing the cost-to-go of all states\n"
    answers.show([record])
    shown = capsys.readouterr()
    assert [line.split()[0] for line in shown.out.splitlines()] == ["instance", str(TINY)]
    assert shown.err == ""
    answers = Answers([str(TINY)], as_json=False)
    answers.first({**record, "note": COMPARING})
    shown = capsys.readouterr()
    assert (shown.out.splitlines(), shown.err) == (record["plan"], "")
    for silent in (Answers([str(TINY)], as_json=True), Answers([str(TINY)] * 2, as_json=False)):
        silent.first(first)
        assert capsys.readouterr() == ("", "")
    answers = Answers([str(TINY)], as_json=False)
    answers.first({**first, "status": "unsolvable", "cost": None, "plan": None})
    assert capsys.readouterr() == ("", f"{TINY}: unsolvable; computing the cost-to-go of all states\n")


@pytest.mark.slow
def test_ctrl_c_in_the_comparison_keeps_the_record(tmp_path: Path) -> None:
    out, command = tmp_path / "out", Path(sys.executable).with_name("kitassist")
    words = ["solve", str(KITTING / "paper.pddl"), "--verify", "836", "--out", str(out)]
    with subprocess.Popen([command, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        results = out / "results.jsonl"  # the first record may be one without the table
        while process.poll() is None and not (results.exists() and '"states": 836' in results.read_text()):
            time.sleep(0.02)
        while process.poll() is None and not results.read_text().endswith("\n"):
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        printed, said = process.communicate(timeout=120)
    assert process.returncode == 130
    record = json.loads((out / "results.jsonl").read_text().splitlines()[-1])
    assert (record["status"], record["cost"], record["states"], record["note"]) == ("solved", 10, 836, COMPARING)
    assert 0 <= record["verified"] < 836
    assert len(list(out.rglob("*.npz"))) == len(list(out.rglob("*.plan"))) == 1
    assert printed.splitlines()[:-2] == record["plan"]
    assert said.splitlines()[-2:] == [
        f"{KITTING / 'paper.pddl'}: {COMPARING}", "interrupted; finished results are saved, --resume continues",
    ]  # fmt: skip
    again = subprocess.run([command, *words, "--resume", "--json"], capture_output=True, text=True, timeout=300)
    assert json.loads(again.stdout) == [record]
