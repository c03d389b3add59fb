"""Broken inputs for all commands: none may end in a traceback, a hang, a wrong success, or an incomplete output file.

As a script it tries many inputs, prints the figures of `docs/results/reliability.md`, and keeps faulty inputs:

    .venv/bin/python tests/fuzz.py [INPUTS] [SEED] [FOLDER] [COMMAND,...]

Each input is tried by the command itself in a forked process. For speed this process also does the work of the
command's worker processes (solving, cells of a study, unified-planning's checks), and reads the valid task only once.
No figures are drawn.
"""

from __future__ import annotations

import faulthandler
import os
import pickle
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import broken_live
import click
import numpy as np
from broken import ARGUMENTS, Fuzzer, Input
from click.testing import CliRunner

from assist.cli import main
from planner.pddl import validation
from planner.pddl.compilation import domain_text, problem_text
from planner.system.errors import InputFileError

CPU_SECONDS, SECONDS = 30, 400.0  # per input; the second allows for other load on the machine
MEMORY = 3 << 30  # bytes beyond what the process has mapped already


@dataclass
class Figures:
    """Counts of outcomes."""

    inputs: Counter[str] = field(default_factory=Counter)
    codes: Counter[str] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)


def here(
    work: Callable[..., Any], items: Sequence[Any], arguments: Sequence[Any] = (), hear: Any = None, **_: Any
) -> Iterator[Any]:
    """`planner.system.processes.outcomes` in this process."""
    if hear is not None:
        arguments = (*arguments, lambda *_: None)
    for item in items:
        try:
            yield item, work(item, *arguments)
        except Exception as error:  # noqa: BLE001  as a worker does
            yield item, error


def without_processes() -> None:
    """Run in this process the work that commands leave to others."""
    import assist.studies.reports.study_report
    import assist.studies.runner
    import assist.web.server
    import planner.batch.solve_batch
    import planner.batch.solve_instance
    from planner.grounding import fast_downward

    translate, parsed = fast_downward.translate, cache(validation.parsed)
    translated: dict[tuple[str, str], str] = {}

    def translate_once(reading: Any, *limits: Any) -> str:
        texts = domain_text(reading), problem_text(reading)
        if texts not in translated:
            translated[texts] = translate(reading, *limits)
        return translated[texts]

    class SecondReader(validation.SecondReader):
        def __init__(self, reading: Any, limits: Any = None) -> None:  # noqa: ARG002
            self._texts = domain_text(reading, list_object=True), problem_text(reading)
            self._process, self._asked = None, None

        def ask(self, plan: Sequence[str] | None) -> None:
            self._asked = plan

        def answer(self, seconds: float) -> Any:  # noqa: ARG002
            problem, why = parsed(*self._texts)
            if problem is not None and self._asked is not None:
                validation.validate(problem, self._asked)
            return why

    planner.batch.solve_batch.outcomes = assist.studies.runner.outcomes = here
    assist.studies.reports.study_report.draw_all = lambda *_, **__: None
    assist.web.server.serve = broken_live.work
    fast_downward.translate = translate_once
    planner.batch.solve_instance.SecondReader = SecondReader


def load(file: str) -> None:
    """Open a saved policy or table as a program does; their own errors are reported in one line."""
    from assist.person.solver import Solution
    from planner import open_table

    try:
        if file == "policy.npz":
            Solution.load(Path(file))
        else:
            table = open_table(Path(file))
            table.lookup(range(len(table)))
            values = table.values(range(len(table)))
            fact = values[table.initial].clip(max=table.facts.shape[1] - 1)
            table.facts[np.arange(values.shape[1]), fact].tolist()
    except (InputFileError, OSError) as error:
        click.echo(str(error), err=True)
        sys.exit(1)


def attempt(made: Input, folder: Path) -> dict[str, Any]:
    """Run an input in a forked process; return how it ended."""
    answer, stuck = folder.with_suffix(".answer"), folder.with_suffix(".stuck")
    child = os.fork()
    if child == 0:
        with suppress(BaseException):
            os.chdir(folder)
            faulthandler.dump_traceback_later(SECONDS - 10, file=stuck.open("w"))  # where it waits, and for what
            _limit(resource.RLIMIT_CPU, CPU_SECONDS)
            mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
            _limit(resource.RLIMIT_AS, mapped + MEMORY)
            null = os.open(os.devnull, os.O_RDWR)
            for descriptor in (0, 1, 2):
                os.dup2(null, descriptor)
            command = main
            if made.command == "load":
                command = click.Group(commands={"load": click.command()(click.argument("file")(load))})
            result = CliRunner().invoke(command, list(made.arguments))
            failure = result.exc_info if result.exception and not isinstance(result.exception, SystemExit) else None
            done = {
                "code": result.exit_code,
                "stdout": result.stdout,
                "stderr": result.stderr,
                "trace": "".join(traceback.format_exception(*failure)) if failure else "",
            }
            answer.write_bytes(pickle.dumps(done))
        os._exit(0)
    start = time.monotonic()
    while os.waitpid(child, os.WNOHANG) == (0, 0):
        if time.monotonic() - start > SECONDS:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            break
        time.sleep(0.005)
    where = stuck.read_text(errors="replace") if stuck.exists() else ""
    stuck.unlink(missing_ok=True)
    if not answer.exists():
        return {"code": "hang or crash", "stdout": "", "stderr": where, "trace": ""}
    done = pickle.loads(answer.read_bytes())
    answer.unlink()
    return done


def _limit(what: int, value: int) -> None:
    resource.setrlimit(what, (value, resource.getrlimit(what)[1]))


def fuzz(count: int, seed: int, keep: Path, commands: Sequence[str], say: Callable[[str], None]) -> Figures:
    """Try `count` inputs, or as many as possible before an interrupt; keep faulty ones in a folder."""
    without_processes()
    figures, before = Figures(), Path.cwd()
    with tempfile.TemporaryDirectory() as name:
        try:
            fuzzer = Fuzzer(Path(name), seed, commands)
            for number in range(count):
                folder = Path(name) / f"{number}"
                made = fuzzer.make(folder)
                done = attempt(made, folder)
                wrong = fuzzer.check(made, folder, done)
                figures.inputs[made.kind] += 1
                figures.codes[f"{made.kind} {done['code']}"] += 1
                if wrong:
                    figures.faults.append(f"{number} {made.kind}: {' '.join(made.arguments)}: {'; '.join(wrong)}")
                    say(figures.faults[-1])
                    shutil.copytree(folder, keep / str(number), dirs_exist_ok=True)
                    (keep / str(number) / "ended").write_text(
                        f"{made}\n{wrong}\n{done['code']}\n{done['stderr']}\n{done['trace']}", errors="replace"
                    )
                shutil.rmtree(folder)
                if number % 20 == 19:
                    say(f"{number + 1} inputs, {len(figures.faults)} faults")
        except (KeyboardInterrupt, SystemExit):
            say("interrupted")
        finally:
            os.chdir(before)
    return figures


def report(figures: Figures) -> None:
    """Print the figures."""
    print(f"{figures.inputs.total()} broken inputs, {len(figures.faults)} faults")
    for kind, number in sorted(figures.inputs.items()):
        codes = {key.split(" ", 1)[1]: n for key, n in sorted(figures.codes.items()) if key.startswith(f"{kind} ")}
        print(f"  {kind}: {number}, by exit code {codes}")


if __name__ == "__main__":
    words = sys.argv[1:]
    inputs, seed = (int(words[at]) if at < len(words) else default for at, default in enumerate((10_000, 0)))
    keep = Path(words[2] if len(words) > 2 else tempfile.mkdtemp(prefix="fuzz-")).absolute()
    commands = words[3].split(",") if len(words) > 3 else list(ARGUMENTS)
    figures = fuzz(inputs, seed, keep, commands, lambda line: print(line, file=sys.stderr, flush=True))
    report(figures)
    print(f"what was found is in {keep}")
    sys.exit(bool(figures.faults))
