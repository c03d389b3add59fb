"""Work on a Dask cluster: the same results as on this machine. All tests share one cluster, which takes seconds to
start.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import KITTING, invoke, write_instance
from studies import write

from assist.studies import Study, run_study
from planner.system.errors import InputFileError


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    from distributed import LocalCluster

    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        yield cluster.scheduler_address


def stable(records: list[dict]) -> list[dict]:
    """Records without what differs from run to run."""
    return [{k: v for k, v in record.items() if k not in ("seconds", "peak_memory_mb")} for record in records]


@pytest.mark.slow
def test_a_batch_has_the_same_records(scheduler: str, tmp_path: Path) -> None:
    """Solved, unsolvable, with costs, and a file that is no PDDL."""
    names = [KITTING / f"{name}.pddl" for name in ("tiny", "unsolvable", "costs/ways")]
    names.append(write_instance(tmp_path / "bad", "(", ")").problem)
    here = invoke("solve", *names, "--verify", 1, "--json", "--jobs", 2)
    there = invoke("solve", *names, "--verify", 1, "--json", "--scheduler", scheduler, "--out", tmp_path / "out")
    assert here.exit_code == there.exit_code == 1
    assert {record["status"] for record in json.loads(there.stdout)} == {"solved", "unsolvable", "invalid"}
    assert stable(json.loads(here.stdout)) == stable(json.loads(there.stdout))
    assert len(list((tmp_path / "out").rglob("*.npz"))) == 2


@pytest.mark.slow
def test_a_study_has_the_same_bytes(scheduler: str, small_study: tuple[Study, Path, dict], tmp_path: Path) -> None:
    study, whole, _ = small_study
    assert run_study(study, tmp_path / "out", scheduler=scheduler) == []
    for name in ("episodes.jsonl", "study.json"):
        assert (tmp_path / "out" / name).read_bytes() == (whole / name).read_bytes()


@pytest.mark.slow
def test_the_command_hands_a_study_to_the_scheduler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def sent(*_: object, scheduler: str, **__: object) -> None:
        raise InputFileError(f"sent to {scheduler}")

    monkeypatch.setattr("assist.studies.runner.run_study", sent)
    result = invoke("study", "--protocol", write(tmp_path), "--out", tmp_path / "out", "--scheduler", "tcp://there:1")
    assert (result.exit_code, result.stderr) == (2, "sent to tcp://there:1\n")
