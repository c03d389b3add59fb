"""One thing done in a copy of this process: its result, its error, its death, and its time are told."""

from __future__ import annotations

import subprocess
import sys

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
