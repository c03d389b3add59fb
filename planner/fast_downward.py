"""The one place that runs Fast Downward.

Its translator grounds an instance into a finite-domain task (the SAS text that `task` reads), its A*
finds an optimal plan from the initial state or from any other state. Both run as subprocesses: Fast
Downward is GPL-3.0-only and is never imported.

Handed on: SAS text, and plans as lists of ground action names; `None` where there is provably no plan.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.resources
import os
import re
import resource
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from .pddl import Instance, PDDLError
from .processes import guarded_group

TRANSLATE_OPTIONS = ("--add-implied-preconditions", "--keep-unimportant-variables")

# The fastest admissible configuration on kitting, and the only kind that supports derived variables.
ASTAR = "astar(landmark_cost_partitioning(lm_rhw()))"
ASTAR_WITH_AXIOMS = "astar(blind())"

EXIT_UNSOLVABLE = {10, 11}  # found by the translator, proven by the search
EXIT_OUT_OF_MEMORY = {20, 22}
EXIT_OUT_OF_TIME = {21, 23}
EXIT_INPUT_ERROR = {30, 31}


class FastDownwardError(RuntimeError):
    """Fast Downward ended in a way that says nothing about the task."""


class LimitError(RuntimeError):
    """A limit of time, memory or states was reached before the answer was known."""


class MemoryLimitError(LimitError):
    """More memory would be needed than is allowed."""


@dataclass(frozen=True)
class Limits:
    """What one call may use: seconds of wall-clock time and MB of memory, `None` for no limit."""

    seconds: float | None = None
    memory_mb: float | None = None


NO_LIMITS = Limits()


def version() -> str:
    """Name the version of Fast Downward that the installed package bundles."""
    return importlib.metadata.version("fast-downward.translate")


def digest(instance: Instance) -> str:
    """Name what the translation of an instance depends on: both files' contents, and the versions of the readers."""
    found = hashlib.sha256(f"{version()} {importlib.metadata.version('unified-planning')}".encode())
    for file in (instance.domain, instance.problem):
        found.update(hashlib.sha256(file.read_bytes()).digest())
    return found.hexdigest()


def translate(instance: Instance, limits: Limits = NO_LIMITS) -> str:
    """Ground an instance and return its finite-domain task as SAS text.

    A goal that cannot be reached even if nothing is ever deleted, or that always holds, gives a dummy task
    without operators (`Task.decided_by_translator`).

    Raises
    ------
    PDDLError
        The translator refuses the input.
    LimitError
        Out of time or memory.
    """
    with tempfile.TemporaryDirectory(prefix="kitassist-") as folder:
        sas = Path(folder) / "output.sas"
        # The translator reads PDDL in lower case, as `pddl.read` does.
        command = [sys.executable, "-m", "fast_downward.translate", *TRANSLATE_OPTIONS, "--sas-file", str(sas)]
        command += [str(instance.domain.absolute()), str(instance.problem.absolute())]
        code, output = _run(command, folder, None, limits)
        _check_limits("translation", code, limits)
        if code in EXIT_INPUT_ERROR:
            raise _refused(instance, output)
        if code != 0 or not sas.is_file():
            raise FastDownwardError(f"Fast Downward's translator failed (exit {code}): {_last_line(output)}")
        return sas.read_text(encoding="utf-8")


def optimal_plan(
    sas: str, state: Sequence[int] | None = None, *, search: str | None = None, limits: Limits = NO_LIMITS
) -> list[str] | None:
    """Find an optimal plan with A*, from the initial state or from `state`.

    Parameters
    ----------
    sas : str
        The task, as `translate` returns it.
    state : sequence of int, shape (variables,), optional
        The value of every variable. It has to be reachable from the initial state: the translator has
        dropped all that is not.
    search : str, optional
        Fast Downward's search configuration; an admissible default is chosen.
    limits : Limits
        Time and memory of the search.

    Returns
    -------
    list of str or None
        Ground actions as `(name arg ...)`; None where no plan exists, proven.

    Raises
    ------
    LimitError
        Out of time or memory: nothing is known about the state.
    FastDownwardError
        Any other end of the search.
    """
    if state is not None:
        sas = with_initial_state(sas, state)
    if search is None:
        search = ASTAR_WITH_AXIOMS if has_axioms(sas) else ASTAR
    binary = importlib.resources.files("up_fast_downward") / "downward" / "builds" / "release" / "bin" / "downward"
    with tempfile.TemporaryDirectory(prefix="kitassist-") as folder, importlib.resources.as_file(binary) as program:
        plan = Path(folder) / "plan"
        command = [str(program), "--internal-plan-file", str(plan), "--search", search]
        code, output = _run(command, folder, sas, limits)
        if code == 0 and plan.is_file():
            # An action without arguments is written with a space before the bracket.
            lines = plan.read_text(encoding="utf-8").splitlines()
            return [f"({line[1:-1].strip()})" for line in lines if line.startswith("(")]
    if code in EXIT_UNSOLVABLE:
        return None
    _check_limits("A*", code, limits)
    raise FastDownwardError(f"Fast Downward's search failed (exit {code}): {_last_line(output)}")


def with_initial_state(sas: str, state: Sequence[int]) -> str:
    """Write another initial state into a SAS text."""
    before, after = sas.split("begin_state\n", 1)
    old, after = after.split("\nend_state", 1)
    if len(state) != len(old.split("\n")):
        raise ValueError(f"the state has {len(state)} values, the task {len(old.split(chr(10)))} variables")
    return before + "begin_state\n" + "\n".join(str(int(value)) for value in state) + "\nend_state" + after


def has_axioms(sas: str) -> bool:
    """Whether a SAS text has derived variables."""
    return sas.rsplit("end_operator" if "end_operator" in sas else "end_goal", 1)[1].split()[-1:] != ["0"]


def _run(command: list[str], folder: str, text: str | None, limits: Limits) -> tuple[int, str]:
    """Run a program in a folder of its own; return its exit code and all it printed.

    It ends with this process, however that ends.
    """
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    process = subprocess.Popen(
        command,
        cwd=folder,
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        encoding="utf-8",
        errors="replace",
        process_group=guarded_group(),
    )
    try:
        if hasattr(resource, "prlimit"):
            if limits.seconds is not None:
                seconds = int(limits.seconds) + 1
                _limit(process.pid, resource.RLIMIT_CPU, seconds)
            if limits.memory_mb is not None:
                _limit(process.pid, resource.RLIMIT_AS, int(limits.memory_mb * 1e6))
        output, _ = process.communicate(text, timeout=limits.seconds)
    except subprocess.TimeoutExpired:
        raise LimitError(f"Fast Downward ran out of time ({limits.seconds:g} s)") from None
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                pipe.close()
    return process.returncode, output


def _check_limits(what: str, code: int, limits: Limits) -> None:
    """Raise if a program ended because of a limit; one that a signal ended under a memory limit did as well."""
    if code in EXIT_OUT_OF_TIME or -code == signal.SIGXCPU:
        raise LimitError(f"{what} ran out of time")
    if code in EXIT_OUT_OF_MEMORY or (code < 0 and limits.memory_mb is not None):
        raise MemoryLimitError(f"{what} ran out of memory")


def _limit(pid: int, what: int, value: int) -> None:
    try:
        _, hard = resource.prlimit(pid, what)
        resource.prlimit(pid, what, (value if hard == resource.RLIM_INFINITY else min(value, hard), hard))
    except ProcessLookupError:
        pass  # it has ended already


def _last_line(output: str) -> str:
    """The last line that says why a program ended."""
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    lines = [line for line in lines if not line.startswith(("Peak memory", "Remove intermediate", "["))]
    return " ".join(lines[-2:]) if lines else "no output"


def _refused(instance: Instance, output: str) -> PDDLError:
    """What the translator says when it refuses, as one line, with the place of the word that it names."""
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    lines = [line for line in lines if line != "Parsing..." and not line.startswith(("->", "Parsing "))]
    file, number = instance.problem, None
    got = next((line.removeprefix("Got: ") for line in lines if line.startswith("Got: ")), None)
    if got:
        for candidate in (instance.domain, instance.problem):
            text = candidate.read_text(encoding="utf-8").lower()
            if match := re.search(rf"(?<![\w-]){re.escape(got)}(?![\w-])", text):
                file, number = candidate, text[: match.start()].count("\n") + 1
                break
    return PDDLError(file, number, " ".join(lines) or "refused by Fast Downward's translator")
