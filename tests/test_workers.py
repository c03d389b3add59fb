"""Work in other processes: results, errors, deaths and times are told, and Ctrl-C is left to the parent."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

CODE = """
import os, signal, sys, time
from planner.workers import WorkerDiedError, outcomes

def work(what):
    if what == "fails":
        raise ValueError(what)
    if what == "dies":
        os.kill(os.getpid(), signal.SIGKILL)
    if what == "waits":
        time.sleep(60)
    return os.getpid(), what

def outcome(what, timeout=None):
    ((item, result),) = outcomes(work, [what], timeout=timeout)
    assert item == what
    return result

pid, answer = outcome("answers")
assert answer == "answers" and pid != os.getpid()
assert repr(outcome("fails")) == "ValueError('fails')"
assert isinstance(outcome("dies"), WorkerDiedError), outcome("dies")
assert isinstance(outcome("waits", 0.2), TimeoutError)
assert not {"numpy", "pebble"} & set(sys.modules)
"""


def test_one_thing_in_a_copy_of_the_process() -> None:
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, timeout=50, check=False)
    assert done.returncode == 0, done.stderr


SEVERAL = """
import signal
from planner.workers import outcomes

def deaf(item):
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())

if __name__ == "__main__":
    found = [result for _, result in outcomes(deaf, [1, 2, 3], jobs=3)]
    assert found == [True] * 3, found
"""


def test_ctrl_c_does_not_reach_workers_from_their_beginning(tmp_path: Path) -> None:
    file = tmp_path / "several.py"
    file.write_text(SEVERAL)
    done = subprocess.run([sys.executable, file], capture_output=True, text=True, timeout=200, check=False)
    assert done.returncode == 0, done.stderr
