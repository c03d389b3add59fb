"""Work in other processes: results, reports, errors, deaths, time limits, and Ctrl-C, which only the parent handles."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ENDS = """
import os, signal, sys, threading, time
from planner.workers import WorkerDiedError, outcomes

class Twofold(Exception):
    def __init__(self, a, b):  # pickle calls it with one argument
        super().__init__(a)

def work(what):
    if what == "fails":
        raise ValueError(what)
    if what == "fails and cannot be read":
        raise Twofold(what, 2)
    if what == "leaves":
        sys.exit(0)
    if what == "interrupts":
        raise KeyboardInterrupt
    if what == "dies":
        os.kill(os.getpid(), signal.SIGKILL)
    if what == "waits":
        time.sleep(600)
    if what == "function":
        return lambda: what
    return os.getpid(), what

DEATHS = ["fails and cannot be read", "leaves", "interrupts", "dies", "function"]

if __name__ == "__main__":
    ((item, (pid, answer)),) = outcomes(work, ["answers"])
    assert item == answer == "answers" and pid != os.getpid()
    found = dict(outcomes(work, [*DEATHS, "fails", "answers"], jobs=2))
    assert repr(found.pop("fails")) == "ValueError('fails')"
    assert found.pop("answers")[1] == "answers"
    assert set(found) == set(DEATHS)
    for what, death in found.items():
        assert isinstance(death, WorkerDiedError), (what, death)
    ((_, late),) = outcomes(work, ["waits"], timeout=0.2)
    assert isinstance(late, TimeoutError), late
    assert threading.active_count() == 1
    assert not {"numpy", "numba"} & set(sys.modules)
"""


def run(folder: Path, code: str) -> None:
    """Run a program whose functions its worker processes find."""
    file = folder / "program.py"
    file.write_text(code)
    done = subprocess.run([sys.executable, file], capture_output=True, text=True, timeout=300, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_however_work_ends_there_is_an_outcome(tmp_path: Path) -> None:
    run(tmp_path, ENDS)


SEVERAL = """
import signal
from planner.workers import outcomes

def deaf(item, report):
    report("begun", item * item)
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())

if __name__ == "__main__":
    heard = []
    coming = outcomes(deaf, [1, 2, 3], jobs=3, hear=lambda *words: heard.append(words))
    found = [result for _, result in coming]
    assert found == [True] * 3, found
    assert sorted(heard) == [(1, "begun", 1), (2, "begun", 4), (3, "begun", 9)], heard
"""


def test_workers_are_heard_and_ctrl_c_does_not_reach_them_from_their_beginning(tmp_path: Path) -> None:
    run(tmp_path, SEVERAL)
