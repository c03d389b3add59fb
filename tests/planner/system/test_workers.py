"""Work in other processes: results, reports, errors, deaths, time limits, and Ctrl-C, which only the parent handles."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from planner.system import processes
from planner.system.processes import outcomes, python

ENDS = """
import os, signal, sys, threading, time
from planner.system.processes import outcomes

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
        assert isinstance(death, ChildProcessError), (what, death)
    (_, (own, _)), (_, fault) = outcomes(work, ["answers", "fails"], jobs=0)
    assert own != os.getpid() and repr(fault) == "ValueError('fails')"
    ((_, death),) = outcomes(work, ["dies"], jobs=0)
    assert isinstance(death, ChildProcessError), death
    sys.modules["numba"] = None
    ((_, (own, _)),) = outcomes(work, ["answers"], jobs=0)
    assert own == os.getpid()
    del sys.modules["numba"]
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
import os, signal
from planner.system.processes import outcomes

def deaf(item, report):
    report("begun", item * item)
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())

def ending(item, report):
    report("x" * 100_000)  # more than a pipe takes at once
    while item == "never":
        report(1)
    os.kill(os.getpid(), signal.SIGKILL)

if __name__ == "__main__":
    heard = []
    coming = outcomes(deaf, [1, 2, 3], jobs=3, hear=lambda *words: heard.append(words))
    found = [result for _, result in coming]
    assert found == [True] * 3, found
    assert sorted(heard) == [(1, "begun", 1), (2, "begun", 4), (3, "begun", 9)], heard
    for item, fault in (("dies", ChildProcessError), ("never", TimeoutError)):
        heard = []
        ((_, outcome),) = outcomes(ending, [item], timeout=0.5, hear=lambda *words: heard.append(words))
        assert isinstance(outcome, fault), outcome
        assert heard[0] == (item, "x" * 100_000)
"""


def reporting(item, report):
    for number in range(2_000):  # more than a pipe holds
        report(number)
    return item


def test_time_in_which_the_caller_does_something_else_is_not_that_of_an_item(monkeypatch: pytest.MonkeyPatch) -> None:
    away = [0.0]
    monkeypatch.setattr(processes, "time", SimpleNamespace(monotonic=lambda: time.monotonic() + away[0]))
    found = []
    for _, outcome in outcomes(reporting, [1, 2, 3, 4], jobs=2, timeout=300.0, hear=lambda *_: None):
        found.append(outcome)
        away[0] += 400.0
    assert sorted(map(str, found)) == ["1", "2", "3", "4"]


def test_workers_are_heard_to_their_end_and_ctrl_c_does_not_reach_them_from_their_beginning(tmp_path: Path) -> None:
    run(tmp_path, SEVERAL)


SHADOWING = (
    "planner assist fast_downward up_fast_downward unified_planning numpy numba scipy click multiprocessing "
    "json queue signal random types logging pickle threading runpy tempfile struct"
)
"""Names of modules that the programs import."""


def shadow(folder: Path) -> None:
    """Write modules to a folder, as files and as packages, that end every program that imports them."""
    for number, name in enumerate(SHADOWING.split()):
        file = folder / f"{name}.py" if number % 2 else folder / name / "__init__.py"
        file.parent.mkdir(exist_ok=True)
        file.write_text("raise SystemExit(f'{__name__} is of the working directory')")


@pytest.mark.slow
def test_modules_in_the_working_directory_are_not_imported(tmp_path: Path) -> None:
    """No program imports them: workers, the translator, the validator, and processes of multiprocessing itself."""
    shadow(tmp_path)
    command = [Path(sys.executable).with_name("kitassist"), "solve", "kitting/tiny", "gripper/balls-01", "--jobs", "2"]
    done = subprocess.run(
        [*command, "--json"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONWARNINGS": "error"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert [(record["status"], record["note"]) for record in json.loads(done.stdout)] == [("solved", None)] * 2


def test_an_interactive_session_finds_modules_of_its_folder_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Entries of the path are kept; the environment has no effect, and unusual characters do no harm."""
    (tmp_path / "made.py").write_text(
        "import json, other, planner, queue, sys; print(json.dumps([other.HERE, sys.argv[1:]]))"
    )
    for place in ("it's\n\u00e9", "elsewhere"):
        (tmp_path / place).mkdir()
        (tmp_path / place / "other.py").write_text(f"HERE = {place!r}")
    shadow(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", ["", str(tmp_path / "it's\n\u00e9"), *sys.path])
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "elsewhere"))
    done = subprocess.run(python("made", "-x", "a b"), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == ["it's\n\u00e9", ["-x", "a b"]]
