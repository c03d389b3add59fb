"""What a long sweep keeps: used when it is whole and of the same task, ignored otherwise."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import KITTING

from planner import Task, load, sweep
from planner.grounding.task import Effect
from planner.search.checkpoint import Checkpoint
from planner.system.limits import LimitError

INDICES = (np.arange(3),)
ARRAYS = {"bits": np.arange(40, dtype=np.uint64), "frontier": np.array([3, 1, 2])}


@pytest.fixture(scope="module")
def task() -> Task:
    return load(KITTING / "paper.pddl")


def saved(file: Path, task: Task) -> bytes:
    Checkpoint(file, task, INDICES).save("forward", {"found": 7}, ARRAYS)
    return file.read_bytes()


def test_what_is_saved_is_loaded(tmp_path: Path, task: Task) -> None:
    saved(tmp_path / "kept", task)
    loaded = Checkpoint(tmp_path / "kept", task, INDICES).load("forward")
    assert loaded is not None
    assert loaded[0] == {"found": 7}
    assert list(loaded[1]) == list(ARRAYS)
    for name, array in loaded[1].items():
        np.testing.assert_array_equal(array, ARRAYS[name])
        assert array.dtype == ARRAYS[name].dtype
    assert list(tmp_path.iterdir()) == [tmp_path / "kept"]


def test_what_is_of_something_else_is_not_loaded(tmp_path: Path, task: Task) -> None:
    saved(tmp_path / "kept", task)
    first = task.operators[0]
    others = [
        replace(task, goal=task.goal[:1]),
        replace(task, initial=((task.initial[0] + 1) % len(task.variables[0].facts), *task.initial[1:])),
        replace(task, costs=(task.costs[0] + 1, *task.costs[1:])),
        replace(task, operators=(replace(first, effects=(*first.effects, Effect((), 0, 0))), *task.operators[1:])),
    ]
    for other in others:
        assert Checkpoint(tmp_path / "kept", other, INDICES).load("forward") is None
    assert Checkpoint(tmp_path / "kept", task, (np.arange(3, 0, -1),)).load("forward") is None
    assert Checkpoint(tmp_path / "kept", task, INDICES).load("backward") is None
    assert Checkpoint(tmp_path / "none", task, INDICES).load("forward") is None


def test_what_is_damaged_anywhere_is_not_loaded(tmp_path: Path, task: Task) -> None:
    file = tmp_path / "kept"
    whole = saved(file, task)
    cut = [whole[:length] for length in range(0, len(whole), 5)]
    changed = [whole[:at] + bytes([whole[at] ^ 4]) + whole[at + 1 :] for at in range(0, len(whole), 5)]
    checkpoint = Checkpoint(file, task, INDICES)
    for content in [*cut, *changed, whole + b"\0"]:
        file.write_bytes(content)
        checkpoint.fault = None
        assert checkpoint.load("forward") is None
        assert checkpoint.fault == f"{file} is damaged, so that the sweep began from the start"


def kept_half(file: Path, task: Task) -> None:
    """Interrupt a sweep in its fifth layer."""
    layers = iter(range(5))

    def progress(*_: object) -> None:
        if next(layers) == 4:
            raise LimitError("interrupted")

    with pytest.raises(LimitError, match="interrupted"):
        sweep(task, progress=progress, checkpoint=file)


def test_a_sweep_does_without_what_is_damaged(tmp_path: Path, task: Task, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("planner.search.checkpoint.EVERY", 0.0)
    expected, file = sweep(task), tmp_path / "kept"
    kept_half(file, task)
    file.write_bytes(file.read_bytes()[:-1])
    table = sweep(task, checkpoint=file)
    np.testing.assert_array_equal(table.distance, expected.distance)
    assert table.note == f"{file} is damaged, so that the sweep began from the start"
    assert not file.exists()


def test_a_sweep_does_without_what_cannot_be_written(
    tmp_path: Path, task: Task, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("planner.search.checkpoint.EVERY", 0.0)
    (tmp_path / "file").touch()
    table = sweep(task, checkpoint=tmp_path / "file" / "kept")
    np.testing.assert_array_equal(table.distance, sweep(task).distance)
    assert table.note is not None
    assert table.note.startswith("what the sweep had found could not be kept for --resume: ")
