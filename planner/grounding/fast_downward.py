"""The only module that runs Fast Downward.

Its translator grounds an instance into a finite-domain task: the SAS text that `translation` reads. Its A* search finds
an optimal plan from the initial state or from another state. Both run as subprocesses. Fast Downward is GPL-3.0-only,
and is never imported.

Results are SAS text, and plans as lists of ground action names; None means that there is provably no plan.
"""

from __future__ import annotations

import hashlib
import importlib.util
import math
import re
import signal
import subprocess
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path

from ..pddl.compilation import domain_text, problem_text
from ..pddl.instances import Instance, PDDLError
from ..pddl.reader import Reading
from ..system.limits import NO_LIMITS, LimitError, Limits, MemoryLimitError, limit_process
from ..system.processes import guarded_group, python

TRANSLATE_OPTIONS = ("--add-implied-preconditions", "--keep-unimportant-variables")

# The fastest admissible configuration on kitting, and one that supports derived variables.
ASTAR = "astar(landmark_cost_partitioning(lm_rhw()))"
ASTAR_WITH_AXIOMS = "astar(blind())"

EXIT_UNSOLVABLE = {10, 11}  # found by the translator, proven by the search
EXIT_NOT_READ = 31  # by the translator, whose last lines say why
EXIT_OUT_OF_MEMORY = {20, 22}
EXIT_OUT_OF_TIME = {21, 23}


class FastDownwardError(RuntimeError):
    """Fast Downward ended in a way that gives no information about the task."""


def version() -> str:
    """Return the version of the bundled Fast Downward."""
    import importlib.metadata  # slow to import

    return importlib.metadata.version("fast-downward.translate")


def digest(instance: Instance, most_values: int) -> str:
    """Return a hash of what the translation depends on.

    These are the contents of both files, the versions of the readers, and the limit of values of a number.
    """
    import importlib.metadata

    found = hashlib.sha256(f"8 {most_values} {version()} {importlib.metadata.version('unified-planning')}".encode())
    for file in (instance.domain, instance.problem):
        found.update(hashlib.sha256(file.read_bytes()).digest())
    return found.hexdigest()


def translate(reading: Reading, limits: Limits = NO_LIMITS) -> str:
    """Ground an instance and return its finite-domain task as SAS text.

    If the goal is unreachable even when delete effects are ignored, or if it always holds, the result is a dummy task
    without operators (`Task.decided_by_translator`). If the translator refuses the input, this raises a `PDDLError`.
    """
    with tempfile.TemporaryDirectory(prefix="kitassist-") as folder:
        sas, domain, problem = (Path(folder) / name for name in ("output.sas", "domain.pddl", "problem.pddl"))
        # The normalised texts, which all other readers use too.
        domain.write_text(domain_text(reading), encoding="utf-8")
        problem.write_text(problem_text(reading), encoding="utf-8")
        command = python("fast_downward.translate", *TRANSLATE_OPTIONS, "--sas-file", str(sas))
        code, output = _run([*command, str(domain), str(problem)], folder, None, limits)
        _check_limits("translation", code, output, limits)
        if code != 0 or not sas.is_file():
            raise _refused(reading, code, output)
        return sas.read_text(encoding="utf-8")


def optimal_plan(
    sas: str, state: Sequence[int] | None = None, *, search: str = ASTAR, limits: Limits = NO_LIMITS
) -> list[str] | None:
    """Return an optimal plan that A* finds, as ground actions; None if it has proven that no plan exists.

    The plan is from the initial state, or from `state`, the values of all variables. That state must be reachable,
    since the translator has removed everything else. After a `LimitError` or a `FastDownwardError`, nothing is known
    about the state.
    """
    if state is not None:
        sas = with_initial_state(sas, state)
    with tempfile.TemporaryDirectory(prefix="kitassist-") as folder:
        plan = Path(folder) / "plan"
        command = [str(_binary()), "--internal-plan-file", str(plan), "--search", search]
        code, output = _run(command, folder, sas, limits)
        if code == 0 and plan.is_file():
            # An action without arguments is written with a space before the bracket.
            lines = plan.read_text(encoding="utf-8").splitlines()
            return [f"({line[1:-1].strip()})" for line in lines if line.startswith("(")]
    if code in EXIT_UNSOLVABLE:
        return None
    _check_limits("A*", code, output, limits)
    raise FastDownwardError(f"Fast Downward's search failed (exit {code}): {_last_line(output)}")


@cache
def _binary() -> Path:
    """Return the path of the search program without importing its package, which is slow to import."""
    package = importlib.util.find_spec("up_fast_downward")
    if package is None or not package.submodule_search_locations:
        raise FastDownwardError("the package up-fast-downward is not installed")
    return Path(package.submodule_search_locations[0], "downward", "builds", "release", "bin", "downward")


def with_initial_state(sas: str, state: Sequence[int]) -> str:
    """Return the SAS text with another initial state."""
    before, after = sas.split("begin_state\n", 1)
    old, after = after.split("\nend_state", 1)
    if len(state) != len(old.split("\n")):
        raise ValueError(f"the state has {len(state)} values, the task {len(old.split(chr(10)))} variables")
    return before + "begin_state\n" + "\n".join(str(int(value)) for value in state) + "\nend_state" + after


def _run(command: list[str], folder: str, text: str | None, limits: Limits) -> tuple[int, str]:
    """Run a program in a folder; return its exit code and its output.

    The program does not outlive this process.
    """
    process = subprocess.Popen(
        command,
        cwd=folder,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        encoding="utf-8",
        errors="replace",
        process_group=guarded_group(),
    )
    try:
        given = [each for each in (limits.seconds, limits.processor_seconds) if each is not None]
        limit_process(process.pid, limits.memory_mb, min(given, default=None))
        _give(process, text or "")
        output = _output(process, limits)
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with suppress(BrokenPipeError):
                    pipe.close()
    return process.returncode, output


def _give(process: subprocess.Popen[str], text: str) -> None:
    """Write the input of a program whose limits have been set: it waits for its input, so that it cannot be faster.

    The whole input is written at once, since a repeated call of `communicate` loses the unwritten part. These programs
    read all input before they print anything, or they end.
    """
    given, process.stdin = process.stdin, None
    assert given is not None
    with suppress(BrokenPipeError), given:
        given.write(text)


def _output(process: subprocess.Popen[str], limits: Limits) -> str:
    """Wait for the program to end, and return its output."""
    # Longest timeout of one system call in seconds: it counts milliseconds in a 32-bit integer.
    longest_wait = 2_000_000.0
    end = math.inf if limits.seconds is None else time.monotonic() + limits.seconds
    while True:
        wait = min(end - time.monotonic(), math.inf if limits.stop is None else 0.02)
        try:
            return process.communicate(timeout=None if wait > longest_wait else max(wait, 0.0))[0]
        except subprocess.TimeoutExpired:
            if limits.stop is not None and limits.stop.is_set():
                raise LimitError("Fast Downward was stopped") from None
            if time.monotonic() >= end:
                raise LimitError(f"Fast Downward ran out of time ({limits.seconds:g} s)") from None


def _check_limits(what: str, code: int, output: str, limits: Limits) -> None:
    """Raise if a program ended because of a limit. Under a memory limit, an end by a signal counts as out of memory."""
    exit_not_loaded = 127  # the system's loader could not start the program
    if code in EXIT_OUT_OF_TIME or -code == signal.SIGXCPU:
        raise LimitError(f"{what} ran out of time")
    no_memory = ("failed to map", "cannot map", "annot allocate")  # parts of the loader's messages
    unloaded = code == exit_not_loaded and any(words in output for words in no_memory)
    in_python = re.search(r"^MemoryError\b", output, re.M) is not None
    if code in EXIT_OUT_OF_MEMORY or (limits.memory_mb is not None and (code < 0 or unloaded or in_python)):
        raise MemoryLimitError(f"{what} ran out of memory")


def _last_line(output: str) -> str:
    """Return the last two lines that say why a program ended."""
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    lines = [line for line in lines if not line.startswith(("Peak memory", "Remove intermediate", "["))]
    return " ".join(lines[-2:]) if lines else "no output"


def _refused(reading: Reading, code: int, output: str) -> PDDLError:
    """Return the error for a task that the translator refuses although it has passed all checks."""
    if "not stratifiable" in output:
        line = next((rule.head.place.line for rule in reading.domain.rules), None)
        return PDDLError(reading.instance.domain, line, "derived predicates depend on their own negation")
    if code == EXIT_NOT_READ:
        *where, said = re.split(r"^\s*->", output, flags=re.M)
        reason = "; ".join(line.strip().rstrip(".") for line in said.splitlines()[bool(where) :] if line.strip())
        action = next(
            (reading.domain.actions.get(name) for name in re.findall(r"->Parsing action '(.*)'", output)), None
        )
        file, place = reading.instance.problem, None
        if action is not None or "Parsing domain" in where[0]:
            file, place = reading.instance.domain, None if action is None else action.place.line
        return PDDLError(file, place, f"Fast Downward's translator does not read this task: {reason}")
    fault = re.search(r"^(\w+(?:Error|Exception))\b", output, re.M)
    kind = f" ({fault[1]})" if fault else ""
    return PDDLError(
        reading.instance.problem, None, f"Fast Downward's translator fails at this task, exit code {code}{kind}"
    )
