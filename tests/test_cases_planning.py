"""Inputs that were met in use: the second reader, costs without a metric, names, limits, and one plan."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from conftest import KITTING

from planner import instance
from planner.batch import solve_instance as solving
from planner.batch.solve_instance import solve_instance
from planner.batch.solve_record import SolveOptions
from planner.pddl import validation_process
from planner.pddl.validation import InvalidPlanError
from planner.pddl.validation_process import LATE

TINY = KITTING / "tiny.pddl"


def test_a_second_reader_that_says_nothing_costs_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is stopped at once, as if it read for ever; the plan is there before it is waited for."""
    idle = validation_process._Process.idle

    def stopped(*arguments: object) -> object:
        process = idle(*arguments)  # type: ignore[arg-type]
        os.kill(process._popen.pid, signal.SIGSTOP)
        return process

    told: list[dict] = []
    monkeypatch.setattr(validation_process._Process, "idle", stopped)
    monkeypatch.setattr(solving, "SECOND_READER", 0.01)
    record = solve_instance(instance(TINY), SolveOptions(verify=1), tell=lambda record, _: told.append(record))
    assert (record["status"], record["cost"], told[0]["plan"]) == ("solved", 6, record["plan"])
    assert record["note"] == f"read by Fast Downward's translator, not checked by unified-planning: {LATE}"


def test_a_second_reader_that_contradicts_makes_the_answer_invalid(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def rejects(*_: object) -> None:
        raise InvalidPlanError("unified-planning's validator rejects the plan: so there")

    monkeypatch.setattr(validation_process._Process, "answer", rejects)
    record = solve_instance(instance(TINY), SolveOptions(verify=1), tmp_path / "tiny")
    assert (record["status"], record["plan"]) == ("invalid", None)
    assert record["error"]["message"] == "unified-planning's validator rejects the plan: so there"
    assert list(tmp_path.iterdir()) == []
