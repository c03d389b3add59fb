"""A few of the kills of `kills.py`, which makes a hundred."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from kills import DOMAINS, TINY, Figures, alive, kill_and_resume, small_batch, started, study, survival, uninterrupted
from recorded import lines, write_log

from planner.system.processes import guarded_group


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes that outlive their parent would do so for a minute or more; `kills.py` measures how soon they end."""
    monkeypatch.setattr("kills.LONGEST_SURVIVAL", 30.0)


@pytest.mark.long
@pytest.mark.slow
def test_killed_batches_leave_nothing_and_lose_nothing(tmp_path: Path) -> None:
    duration, reference = uninterrupted(batch := small_batch(), tmp_path / "whole")
    shares = [(0.5, signal.SIGKILL, False), (0.7, signal.SIGTERM, True)]
    kills = [(duration * share, number, group) for share, number, group in shares]
    kill_and_resume(batch, tmp_path / "killed", kills, reference, figures := Figures())
    assert figures.kills.total() == 2


CHILD = """
import os, subprocess, sys, threading
from planner.system.processes import guarded_group

def start():
    subprocess.Popen(["sleep", "60"], process_group=guarded_group())

thread = threading.Thread(target=start)  # whose end is none of its business
thread.start()
thread.join()
print("started", flush=True)
{end}
"""


@pytest.mark.parametrize("end", ["os.kill(os.getpid(), 9)", "os._exit(3)", "os.abort()", "sys.exit()"])
def test_a_process_goes_with_the_one_that_started_it(end: str) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", CHILD.format(end=end)], stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    assert process.stdout is not None
    with process.stdout:
        assert process.stdout.readline() == "started\n"
    process.wait(timeout=60)
    survival(process.pid)


def test_a_fork_does_not_keep_what_its_parent_has_started() -> None:
    """The fork inherits open files; here it lives in another session until the test ends."""
    fork = "if os.fork() == 0: os.setsid(); os.read(0, 1)\nelse: os.kill(os.getpid(), 9)"
    code = CHILD.format(end="").replace('print("started", flush=True)', f'print("started", flush=True)\n{fork}')
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    with process:
        assert process.stdout is not None
        assert process.stdout.readline() == "started\n"
        process.wait(timeout=60)
        survival(process.pid)


def test_nothing_can_be_started_in_the_group_of_one_that_is_gone() -> None:
    code = "from planner.system.processes import guarded_group; print(guarded_group())"
    group = int(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout)
    while True:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            break
    with pytest.raises(PermissionError):
        subprocess.run(["true"], process_group=group, check=True)
    code = f"from planner.system.processes import join; join({group}); print('here')"
    late = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (late.returncode, late.stdout) == (1, "")
    assert guarded_group() == guarded_group() != group


def test_fast_downward_goes_with_its_parent() -> None:
    """The search takes much longer than the test."""
    code = f"""
import threading, time
from planner import load
from planner.grounding.fast_downward import optimal_plan
task = load({str(DOMAINS / "kitting" / "ladder-6x12.pddl")!r})
threading.Thread(target=optimal_plan, args=(task.sas,), kwargs=dict(search="astar(blind())")).start()
print("started", flush=True)
time.sleep(60)
"""
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, start_new_session=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "started\n"
    kill_when_it_runs(process, "bin/downward")


def kill_when_it_runs(process: subprocess.Popen[str], other: str) -> None:
    """Kill a process while a program that it started is running; check that no such program survives."""
    with process:
        while not any(other in command for command in alive(process.pid)):
            assert process.poll() is None, process.communicate()
        process.kill()
        process.wait(timeout=60)
        survival(process.pid)


LARGE = str(DOMAINS / "kitting" / "ladder-6x12.pddl")
slow = pytest.mark.slow


@pytest.mark.parametrize(
    ("command", "other"),
    [
        pytest.param(["solve", LARGE], "planner.pddl.validation", id="solve one"),
        pytest.param(["solve", LARGE, str(TINY), "--jobs", "2"], "planner.pddl.validation", id="solve two", marks=slow),
        pytest.param(
            ["simulate", LARGE, "--humans", "1", "--set", "max_states=1"], "bin/downward", id="simulate", marks=slow
        ),
        pytest.param(["bound", LARGE, "--humans", "2"], "fast_downward.translate", id="bound", marks=slow),
        pytest.param(["policy", LARGE], "fast_downward.translate", id="policy", marks=slow),
        pytest.param(
            ["serve", LARGE, "--humans", "1", "--port", "0"], "fast_downward.translate", id="serve", marks=slow
        ),
        pytest.param(
            ["study", "--protocol", "PROTOCOL", "--jobs", "2", "--out", "OUT"], "spawn_main", id="study", marks=slow
        ),
        # On a large task, since on a small one everything may have ended before the kill.
        pytest.param(["fit", LARGE, "LOG", "--set", "max_states=1"], "bin/downward", id="fit", marks=slow),
    ],
)
def test_no_process_goes_on_after_its_command_was_killed(
    command: list[str], other: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))  # with answers of an earlier run nothing would be searched
    cases = {
        "PROTOCOL": study(tmp_path / "study.toml").arguments(tmp_path / "out", False)[2],
        "OUT": str(tmp_path / "out"),
    }
    if "LOG" in command:
        cases["LOG"] = str(write_log(tmp_path / "log.jsonl", lines("(fetch box-a)")))
    kill_when_it_runs(started([cases.get(word, word) for word in command]), other)
