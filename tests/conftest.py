from __future__ import annotations

import asyncio
import fcntl
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import cache
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from graphs import graph_task as graph_task
from hypothesis import HealthCheck, settings
from numba.core import event
from translator import Translator

from assist.certify import BoundOptions, computation
from assist.cli import main
from assist.cli.options import task
from assist.cli.output import solve_progress
from assist.people.choices import Choices
from assist.person.settings import Setting
from assist.studies import Study, read
from assist.studies.reports import study_report
from assist.team.pool import Pool
from planner import Instance, Limits, PDDLError, Table, find_instances, load, sweep
from planner.costtogo.number_values import TRIAL_SECONDS
from planner.grounding import fast_downward
from planner.pddl import reader
from planner.pddl.compilation import domain_text, problem_text
from planner.pddl.validation import parsed
from planner.system import progress
from planner.system.limits import NO_LIMITS
from planner.system.processes import python

ROOT = Path(__file__).parent.parent
TESTS = Path(__file__).parent
# A file of tests may take from any other, whatever their folders: names of files are unique.
sys.path[:0] = sorted({str(file.parent) for file in TESTS.rglob("test_*.py")})
DOMAINS = ROOT / "domains"
KITTING = DOMAINS / "kitting"
SHIPPED = find_instances([DOMAINS])
# Instances of more than about 20,000 states.
LARGE = {
    "ladder-2x8", "ladder-4x6", "ladder-4x7", "ladder-4x8", "ladder-4x9", "ladder-4x10", "ladder-6x12", "balls-10",
    "balls-13", "blocks-7", "blocks-8", "two-walls", "rush", "five-parcels", "two-vans", "three-benches",
    "four-boxes", "five-items", "six-items", "eight-items", "nine-items", "day", "five-parts",
}  # fmt: skip
PROGRESS = re.compile(r"^.+, \d+ s(: [\d,]+(,| of) .+)?\n", re.M)
COMPILING = re.compile(f"^{progress.COMPILING_LINE.format(purpose='.+')}\n", re.M)
SMALL = [instance for instance in SHIPPED if instance.problem.stem not in LARGE]


# Examples of each law, where it does not say how many itself: as many as find a fault within a few runs, and many.
# No example has a deadline, which it would miss on a busy machine.
settings.register_profile("quick", max_examples=30, deadline=None)
settings.register_profile("thorough", max_examples=100, deadline=None)

# A shell starts what runs in the background with Ctrl-C ignored, which processes that tests start would inherit.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_xdist_auto_num_workers() -> int:
    """Return two more than there are processors: about two workers wait for a browser or a service at any time."""
    return len(os.sched_getaffinity(0)) + 2


def pytest_sessionstart(session: pytest.Session) -> None:
    """Let each worker first import another part of the files, if all are asked for.

    In a fresh checkout pytest rewrites each file once then, and not once in each worker, which takes it 4 s.
    """
    worker = getattr(session.config, "workerinput", None)
    if worker is None or [Path(one).resolve() for one in session.config.args] != [TESTS]:
        return
    files = sorted(TESTS.rglob("test_*.py"))
    first = len(files) * int(worker["workerid"].removeprefix("gw")) // worker["workercount"]
    for file in files[first:] + files[:first]:
        with suppress(Exception, pytest.skip.Exception):  # the collection reports it
            import_module(file.stem)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Run files with long tests first, so that no worker runs one of them alone at the end.

    Every worker first receives an equal part of the list, the rest of which may later move to other workers. Each part
    therefore begins with its share of such files.
    """
    workers = getattr(config, "workerinput", {"workercount": 1})["workercount"]
    long = list(dict.fromkeys(item.path for item in items if item.get_closest_marker("long")))
    others, ordered = iter([item for item in items if item.path not in long]), list[pytest.Item]()
    for worker in range(workers):
        first = [item for item in items if item.path in long[worker::workers]]
        part = (len(items) - len(ordered)) // (workers - worker)
        ordered += [*first, *islice(others, max(0, part - len(first)))]
    items[:] = ordered


compiled: Counter[str] = Counter()
"""Seconds in which each function of this project was compiled while tests ran, since it was in no cache."""


class Compiled(event.Listener):
    def on_start(self, event: event.Event) -> None:  # noqa: ARG002
        self.start = time.process_time()

    def on_end(self, event: event.Event) -> None:
        function = event.data["dispatcher"].py_func
        if function.__module__.startswith(("planner.", "assist.")):
            compiled[f"{function.__module__}.{function.__name__}"] += time.process_time() - self.start


event.register("numba:compile", Compiled())


def pytest_sessionfinish(session: pytest.Session) -> None:
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["compiled"] = dict(compiled)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    compiled.update(getattr(node, "workeroutput", {}).get("compiled", {}))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print which functions were compiled while tests ran, in one process for all."""
    if compiled:
        terminalreporter.write_line(f"compiled while tests ran, {sum(compiled.values()):.0f} s of processor time:")
        terminalreporter.write_line(", ".join(f"{name} {seconds:.1f}" for name, seconds in compiled.most_common()))


def costly(quick: int, thorough: int) -> settings:
    """Return settings of a law whose examples take long: how many `make test` has, and how many `make test-all`."""
    number = thorough if settings.default.max_examples == settings.get_profile("thorough").max_examples else quick
    return settings(max_examples=number, deadline=None, suppress_health_check=[HealthCheck.too_slow])


def thinned(values: Iterable[Any], every: int = 2) -> list[Any]:
    """Return parameters of a test: `make test` runs the first and every `every`-th after it; the others are `slow`."""
    return [pytest.param(value, marks=[pytest.mark.slow] * (k % every > 0)) for k, value in enumerate(values)]


@cache
def table_of(instance: Instance) -> Table:
    return sweep(load(instance))


def kit(name: str) -> Table:
    """Return the table of a shipped kitting task, computed once in each process."""
    file = KITTING / f"{name}.pddl"
    return table_of(Instance(file, file.parent / "domain.pddl"))


def solvable(instances: list[Instance]) -> list[Instance]:
    return [instance for instance in instances if instance.problem.stem != "unsolvable"]


def named(instance: Instance) -> str:
    return str(instance.problem.relative_to(DOMAINS))


@pytest.fixture(scope="session", autouse=True)
def no_line_comes_between() -> None:
    """Make the output of commands in this process independent of their speed and of compiled code."""
    progress.BETWEEN_LINES = 1e6  # seconds
    task.compiling_line = solve_progress.compiling_line = lambda *_: lambda _: None


@pytest.fixture(scope="session")
def shared_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of all processes that run tests."""
    own = tmp_path_factory.getbasetemp()
    return own.parent if "PYTEST_XDIST_WORKER" in os.environ else own


@pytest.fixture(scope="session", autouse=True)
def the_same_texts_are_grounded_once(shared_folder: Path) -> Iterator[None]:
    """Ground equal texts once, and start the translator once, since its start takes time.

    Where limits are given, they hold; a limit that all trials of values have is above what these texts take.
    """
    translate, run = fast_downward.translate, fast_downward._run
    translator: list[Translator] = []
    program = python("fast_downward.translate")
    usual = NO_LIMITS, Limits(processor_seconds=TRIAL_SECONDS)

    def started_once(command: list[str], folder: str, text: str | None, limits: Limits) -> tuple[int, str]:
        if command[: len(program)] != program or limits not in usual:
            return run(command, folder, text, limits)
        if not translator:
            translator.append(Translator())
        return translator[0].run(command[len(program) :], folder) or run(command, folder, text, limits)

    def once(reading: reader.Reading, limits: Limits = NO_LIMITS) -> str:
        if limits not in usual:
            return translate(reading, limits)
        texts = json.dumps([domain_text(reading), problem_text(reading)])
        grounded = shared_folder / f"{hashlib.sha256(texts.encode()).hexdigest()}.sas"
        if not grounded.exists():
            part = grounded.with_suffix(f".{os.getpid()}-{threading.get_ident()}")
            part.write_text(translate(reading))
            part.replace(grounded)
        return grounded.read_text()

    fast_downward.translate, fast_downward._run = once, started_once
    yield
    fast_downward.translate, fast_downward._run = translate, run
    for one in translator:
        one.close()


@pytest.fixture(scope="session")
def tiny() -> Table:
    return kit("tiny")


@pytest.fixture(scope="session")
def fixed() -> Table:
    return kit("paper-fixed")


@pytest.fixture(scope="session")
def sealed() -> Table:
    return kit("sealed")


@pytest.fixture(scope="session")
def tiny_choices(tiny: Table) -> Choices:
    return Choices.of(tiny)


@pytest.fixture(scope="session")
def pool(tiny_choices: Choices) -> Pool:
    return Pool.sample(tiny_choices, 5, seed=3, setting=Setting(c_suggest=0.5))


@pytest.fixture(scope="session")
def small_study(shared_folder: Path) -> tuple[Study, Path, dict]:
    """A study run by the command: the study, its folder (with a single figure), and the printed summary.

    It takes seconds, so it is run once for all processes that run tests.
    """
    from fuzz import here  # which import this file
    from studies import write

    folder = shared_folder / "small-study"
    folder.mkdir(exist_ok=True)
    printed = folder / "printed.json"
    with (folder / "lock").open("w") as lock, pytest.MonkeyPatch.context() as patched:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not printed.exists():
            draw_first_picture(patched)
            patched.setattr("assist.studies.runner.outcomes", here)
            result = invoke("study", "--protocol", write(folder), "--out", folder / "out", "--json")
            assert (result.exit_code, result.stderr) == (0, "")
            printed.write_text(result.stdout)
    return read(folder / "small.toml"), folder / "out", json.loads(printed.read_text())


@pytest.fixture
def results(small_study: tuple[Study, Path, dict], tmp_path: Path) -> Path:
    """A folder of its results, to be changed."""
    return Path(shutil.copytree(small_study[1], tmp_path / "out", ignore=shutil.ignore_patterns("figures")))


def draw_first_picture(patched: pytest.MonkeyPatch) -> None:
    """Let reports in this process draw only their first figure, since each takes two seconds."""

    draw = study_report.draw_all
    patched.setattr(study_report, "draw_all", lambda pictures, folder, **_: draw(pictures[:1], folder))


@pytest.fixture
def one_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """See `draw_first_picture`."""
    draw_first_picture(monkeypatch)


FEW = BoundOptions(price_rounds=5, price_episodes=64, belief_episodes=300)
"""Options of bounds whose prices are optimised in a twentieth of the time; a bound holds at all prices."""


@pytest.fixture(scope="session", autouse=True)
def few_rounds() -> Iterator[None]:
    """Let bounds have these options in this process, unless options are given."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(computation, "BoundOptions", lambda: FEW)
        yield


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let reports of user studies draw no figures, each of which takes half a second."""
    monkeypatch.setattr("assist.studies.reports.userstudy_report._pictures", lambda *_: iter(()))


@pytest.fixture(scope="session")
def browser() -> Iterator[tuple[Any, asyncio.AbstractEventLoop]]:
    """A Chromium for all tests of this process, whose start takes two seconds, and the event loop of its driver."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright, of the extra `test`, is not installed")
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if program is None:
        pytest.skip("no Chromium is installed: `apt-get install chromium`")
    with sync_api.sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=program, args=["--no-sandbox", "--disable-gpu"])
        loop = asyncio.get_running_loop()
        asyncio._set_running_loop(None)
        yield started, loop
        asyncio._set_running_loop(loop)
        started.close()


@pytest.fixture
def chromium(browser: tuple[Any, asyncio.AbstractEventLoop]) -> Iterator[Any]:
    """The browser. Its loop runs during the test alone, so that other tests can run theirs; pages are closed then."""
    started, loop = browser
    asyncio._set_running_loop(loop)
    yield started
    for context in started.contexts:
        context.close()
    asyncio._set_running_loop(None)


def kitassist(*arguments: object, cwd: Path = ROOT, check: bool = False) -> subprocess.CompletedProcess[str]:
    """Run the command as a user does.

    That something is compiled first, which depends on the past, and how far it is, on the machine's load, are left out.
    """
    command = [str(Path(sys.executable).with_name("kitassist")), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=600, check=check)
    done.stderr = PROGRESS.sub("", COMPILING.sub("", done.stderr))
    return done


def invoke(*arguments: object) -> Result:
    """Run the command in this process, which takes a tenth of the time."""
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.fixture
def one_name_for_two(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """unified-planning lets two kinds of things have one name, and prints and warns of nothing."""
    from unified_planning.environment import get_environment

    monkeypatch.setattr(get_environment(), "error_used_name", False)
    monkeypatch.setattr(get_environment(), "credits_stream", None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def understood(instance: Instance) -> Any:
    """Return an instance as a problem of unified-planning."""
    reading = reader.read(instance)
    problem, why = parsed(domain_text(reading, list_object=True), problem_text(reading))
    if why is not None:
        raise PDDLError(instance.problem, None, f"unified-planning: {why}")
    return problem


def write_instance(folder: Path, domain: str, problem: str) -> Instance:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "domain.pddl").write_text(domain)
    (folder / "problem.pddl").write_text(problem)
    return Instance(folder / "problem.pddl", folder / "domain.pddl")
