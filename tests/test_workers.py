"""Work in other processes: results, reports, errors, deaths and times are told, and Ctrl-C is left to the parent."""

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
        time.sleep(600)
    return os.getpid(), what

def outcome(what, timeout=None):
    ((item, result),) = outcomes(work, [what], timeout=timeout)
    assert item == what
    return result

def told(what, report):
    for n in range(3):
        report("step", n)
    report("too long" * 100)
    return what

heard = []
assert list(outcomes(told, ["item"], hear=lambda *words: heard.append(words))) == [("item", "item")]
assert heard == [("item", "step", n) for n in range(3)], heard

pid, answer = outcome("answers")
assert answer == "answers" and pid != os.getpid()
assert repr(outcome("fails")) == "ValueError('fails')"
assert isinstance(outcome("dies"), WorkerDiedError), outcome("dies")
assert isinstance(outcome("waits", 0.2), TimeoutError)
assert not {"numpy", "pebble"} & set(sys.modules)
"""


def test_one_thing_in_a_copy_of_the_process() -> None:
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr


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
    file = tmp_path / "several.py"
    file.write_text(SEVERAL)
    done = subprocess.run([sys.executable, file], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
