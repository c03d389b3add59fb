"""Signals, and consoles that cannot print all characters."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import click
import pytest
from click.testing import CliRunner, Result
from userstudies import written

from assist.cli import main
from assist.cli.terminal.console import one_line_errors
from assist.cli.terminal.interrupts import PATIENCE, SIGNALS, interruptible

WAITING = """
import os
from assist.cli.terminal import interrupts
from assist.cli.terminal.console import one_line_errors
from assist.cli.terminal.interrupts import interruptible

def wait(what):
    print(what, flush=True)
    os.read(0, 1)  # nothing ever comes

interrupts.PATIENCE = {patience}
with interruptible(), one_line_errors("interrupted; all is kept"):
    {wait}
print("ended by itself")
"""
ASLEEP = "wait('started')"
STUCK = """try: wait('started')
    finally: wait('stuck')"""


@contextmanager
def waiting(
    wait: str, *, ignored: tuple[signal.Signals, ...] = (), patience: float = PATIENCE
) -> Iterator[subprocess.Popen[str]]:
    """A process in a command that waits indefinitely; the signal handlers of the test run are not inherited."""
    nothing, end = os.pipe()
    before = {number: signal.signal(number, signal.SIG_DFL) for number in SIGNALS}
    try:
        for number in ignored:
            signal.signal(number, signal.SIG_IGN)
        process = subprocess.Popen(
            [sys.executable, "-c", WAITING.format(wait=wait, patience=patience)],
            stdin=nothing, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert process.stdout is not None
    assert process.stdout.readline() == "started\n"
    try:
        yield process
    finally:
        process.kill()
        process.communicate()
        os.close(nothing)
        os.close(end)


@pytest.mark.parametrize("number", SIGNALS)
def test_signals_end_a_command(number: signal.Signals) -> None:
    with waiting(ASLEEP) as process:
        process.send_signal(number)
        assert process.communicate(timeout=300) == ("", "interrupted; all is kept\n")
    assert process.returncode == 128 + number


def test_ctrl_c_stays_ignored_where_it_was_and_sigterm_is_heard() -> None:
    with waiting(ASLEEP, ignored=(signal.SIGINT,)) as process:
        process.send_signal(signal.SIGINT)  # else the first of two: another exit code, or other words
        process.send_signal(signal.SIGTERM)
        assert process.communicate(timeout=300) == ("", "interrupted; all is kept\n")
    assert process.returncode == 143


@pytest.mark.parametrize(("again", "patience"), [(True, 1e6), (False, 0.0)])
def test_no_command_takes_long_to_end(again: bool, patience: float) -> None:
    """The process ends at the second signal, or after `PATIENCE` seconds."""
    assert PATIENCE <= 3
    with waiting(STUCK, patience=patience) as process:
        process.send_signal(signal.SIGTERM)
        if again:
            assert process.stdout is not None
            assert process.stdout.readline() == "stuck\n"
            process.send_signal(signal.SIGTERM)
        out, words = process.communicate(timeout=300)
        assert words == "interrupted\n"
        assert out == "" if again else "stuck\n".startswith(out)  # without patience it ends anywhere in that line
    assert process.returncode == 143


@pytest.mark.parametrize(
    "wait",
    [
        "import slow",
        """try: wait('started')
    except KeyboardInterrupt: raise ImportError("half-loaded")""",
    ],
)
def test_an_interrupt_is_no_other_error(wait: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Modules that are being imported and compilers turn an interrupt into errors of their own."""
    (tmp_path / "slow.py").write_text(
        "import os\ntry:\n  print('started', flush=True)\n  os.read(0, 1)\nexcept BaseException: pass"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with waiting(wait) as process:
        process.send_signal(signal.SIGTERM)
        assert process.communicate(timeout=300) == ("", "interrupted\n")
    assert process.returncode == 143


def test_handlers_are_given_back() -> None:
    before = [signal.getsignal(number) for number in SIGNALS]
    with pytest.raises(SystemExit) as ended, interruptible():
        signal.raise_signal(signal.SIGTERM)
    assert ended.value.code == 143
    assert [signal.getsignal(number) for number in SIGNALS] == before


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (OSError("refused,\n  after 30 s"), 1, "refused, after 30 s"),
        (OSError(), 1, "OSError"),
        (OSError(28, "No space left on device"), 1, "No space left on device"),
        (FileNotFoundError(2, "No such file or directory", "x.pddl"), 1, "x.pddl: No such file or directory"),
        (BrokenPipeError(32, "Broken pipe", "pipe"), 1, "pipe: Broken pipe"),
        (MemoryError(), 1, "out of memory"),
        (KeyboardInterrupt(signal.SIGHUP), 129, "interrupted"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (RuntimeError("can't start new thread"), 1, "out of memory: can't start new thread"),
    ],
)
def test_what_ends_a_command_is_said_in_one_line(error: BaseException, code: int, words: str) -> None:
    result = ended_in(error)
    assert (result.exit_code, result.stderr, result.stdout) == (code, f"{words}\n", "")


def test_nobody_reads_the_output() -> None:
    result = ended_in(BrokenPipeError(32, "Broken pipe"))
    assert (result.exit_code, result.stderr, result.stdout) == (1, "", "")


def ended_in(error: BaseException) -> Result:
    @click.command()
    def command() -> None:
        with one_line_errors():
            raise error

    return CliRunner().invoke(command)


def test_the_version_is_said() -> None:
    assert CliRunner().invoke(main, ["--version"], prog_name="kitassist").stdout.startswith("kitassist, version ")


def test_what_is_no_signal_passes_through() -> None:
    with pytest.raises(KeyboardInterrupt) as raised, interruptible():
        raise KeyboardInterrupt
    assert not raised.value.args
    before = signal.getsignal(signal.SIGINT)

    def in_a_thread() -> object:  # where signal handlers cannot be set
        with interruptible():
            return signal.getsignal(signal.SIGINT)

    with ThreadPoolExecutor(1) as threads:
        assert threads.submit(in_a_thread).result() is before


@pytest.mark.slow
def test_a_rehearsal_ends_at_a_signal_in_the_midst_of_its_requests(tmp_path: Path) -> None:
    file, data = written(tmp_path / "study.toml"), tmp_path / "data"
    words = ["serve", "--study", str(file), "--rehearse", "40", "--data", str(data), "--port", "0"]
    with subprocess.Popen(
        [str(Path(sys.executable).with_name("kitassist")), *words],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        assert "operator" in process.stdout.readline()
        time.sleep(1)
        process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=60)  # five seconds, on a machine that has nothing else to do
    assert process.returncode == 128 + signal.SIGTERM
    assert said.endswith(f"interrupted; `kitassist study-report {data}` reports on those who were there\n")
    assert not (data / "report").exists()
