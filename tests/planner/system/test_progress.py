"""Progress of commands: lines at intervals, a bar on a terminal, and messages about compilation."""

from __future__ import annotations

import io
import os
import pty
import re
import sys
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded import people_at_work

from assist import Pool, compare, fit, simulate
from assist.certify import certify, upper_bound
from assist.cli.output.solve_progress import LARGE_SEARCH, solving
from assist.learning import Log
from assist.people.choices import Choices
from assist.person import Setting, qmdp, solve
from assist.studies.runner import run_study
from assist.team import TeamAction, TeamState
from planner import Instance, Table, cost_to_go, sweep
from planner.system import jit, progress
from planner.system.jit import compiling
from planner.system.processes import outcomes


class Heard(io.StringIO):
    """A file that is not a terminal, and that signals when the awaited text was written."""

    def __init__(self, awaited: str) -> None:
        super().__init__()
        self.awaited, self.said = awaited, threading.Event()

    def write(self, text: str) -> int:
        written = super().write(text)
        if re.search(self.awaited, self.getvalue(), re.M):
            self.said.set()
        return written


def on_terminal(monkeypatch: pytest.MonkeyPatch, work: Callable[[], object]) -> str:
    """Return what a piece of work shows on a terminal."""
    inner, outer = pty.openpty()
    shown: list[str] = []

    def read() -> None:
        with suppress(OSError):  # Linux reports a closed terminal as an error
            while more := os.read(inner, 1 << 16):
                shown.append(more.decode())

    reader = threading.Thread(target=read)
    reader.start()
    with os.fdopen(outer, "w") as terminal, monkeypatch.context() as changed:
        changed.setattr(sys, "stderr", terminal)
        changed.setenv("TERM", "xterm")
        changed.setenv("COLUMNS", "100")
        work()
    reader.join()
    os.close(inner)
    return "".join(shown)


@pytest.mark.parametrize(
    ("told", "seconds", "line"),
    [
        (("reading", 0, None), 3, "reading, 3 s"),
        (("states", 3000, None), 2, "states, 2 s: 3,000, 1,500/s"),
        (("cost-to-go", 0, 4000), 5, "cost-to-go, 5 s: 0 of 4,000"),
        (("cost-to-go", 3000, 4000), 6, "cost-to-go, 6 s: 3,000 of 4,000, about 2 s left"),
        (("cost-to-go", 1, 4000), 10, "cost-to-go, 10 s: 1 of 4,000, about 30 s left"),  # the work ends by then
    ],
)
def test_a_line_says_what_is_known_and_nothing_else(
    told: tuple[str, int, int | None], seconds: float, line: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown, now = list[str](), [1000.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    monkeypatch.setattr("planner.system.progress._Display.show", lambda _, stage: shown.append(str(stage)))
    with progress.stages(within=40.0) as show:
        show(told[0], 0, told[2])
        now[0] += seconds
        show(*told)
    assert shown[-1] == line


def test_what_was_done_before_says_nothing_about_the_time_that_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """A resumed run has 90 of 100 at once; its next one after 10 s makes 90 s for the others, not 1 s."""
    monkeypatch.setattr(progress.time, "monotonic", lambda: 1010.0)
    assert str(progress.Stage("episodes", 91, 100, 1000.0, first=90)) == "episodes, 10 s: 91 of 100, about 90 s left"


@pytest.mark.parametrize(
    ("display", "told", "line"),
    [
        (lambda: progress.stages(), ("people", 1, 12), r"^people, \d+ s: 1 of 12$"),
        (lambda: progress.status_line("reading"), ("searching",), r"^searching, \d+ s$"),
    ],
    ids=["stages", "status_line"],
)
def test_a_line_comes_now_and_then(
    display: Callable[[], AbstractContextManager[Callable[..., None]]],
    told: tuple[object, ...],
    line: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys, "stderr", heard := Heard(line))
    monkeypatch.setattr(progress, "BETWEEN_LINES", 0.01)
    with display() as tell:
        tell(*told)
        assert heard.said.wait(60), heard.getvalue()
    assert "\x1b" not in heard.getvalue()


def test_what_takes_no_time_says_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", heard := Heard("."))
    with progress.stages() as show:
        progress.adding(show, "solving", 3)(3)
    assert heard.getvalue() == ""


def test_on_a_terminal_there_is_a_bar_which_goes_away(monkeypatch) -> None:
    def work() -> None:
        with progress.stages() as show:
            show("states", 0, None)
            show("cost-to-go", 5, 10)

    assert re.search(r"cost-to-go, \d+ s: 5 of 10", on_terminal(monkeypatch, work))


def test_compiling_is_said_at_once_and_once_with_its_purpose(capsys, monkeypatch) -> None:
    twice = jit._numba().njit(lambda number: 2 * number)
    monkeypatch.setitem(globals(), "COMPILED_FOR", "doubled numbers: a second")

    with compiling(progress.compiling_line()):
        assert capsys.readouterr().err == ""
        twice(1)
        assert capsys.readouterr().err == "compiling doubled numbers: a second; once after an installation\n"
        twice(1.5)
    twice(1j)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("count", "expected"),
    [(1, ["compiling", "states"]), (2, ["0 of 2 solved; p.pddl: compiling", "1 of 2 solved; q.pddl: states"])],
)
def test_instances_say_how_far_they_are(count, expected, monkeypatch, capsys) -> None:
    shown = []
    monkeypatch.setattr("planner.system.progress._Display.show", lambda _, line, *__: shown.append(line.what))
    monkeypatch.setattr("assist.cli.output.solve_progress.compiling_line", progress.compiling_line)
    with solving(count, lambda _: None) as (solved, told):
        told(Instance(Path("p.pddl"), Path("domain.pddl")), "compiling", 0, None)
        solved({})
        told(Instance(Path("q.pddl"), Path("domain.pddl")), "states", 5, None)
    assert shown == expected
    assert capsys.readouterr().err == f"{progress.COMPILING_LINE.format(purpose=LARGE_SEARCH)}\n"


QUICK = {"window": 0, "gap": 0.5}

LONG: dict[str, tuple[str, Callable[..., object]]] = {
    "sweep": ("cost-to-go", lambda told, task, **_: sweep(task, **told)),
    "cost_to_go": ("cost-to-go", lambda told, task, **_: cost_to_go(task, **told)),
    "Pool.sample": ("setting up people's POMDPs", lambda told, table, **_: Pool.sample(table, 2, seed=0, **told)),
    "qmdp": ("solving a person's POMDP: sweeps", lambda told, pomdp, **_: qmdp(pomdp, **told)),
    "solve": ("solving a person's POMDP: backups", lambda told, pomdp, **_: solve(pomdp, **told)),
    "simulate": (
        "simulating none",
        lambda told, pool, **_: simulate(pool, "none", humans=2, episodes=3, seed=0, **told),
    ),
    "upper_bound": ("bounding people's problems", lambda told, pool, **_: upper_bound(pool, **QUICK, **told)),
    "certify": (
        "simulating policies",
        lambda told, pool, **_: certify(pool, {"none": "none"}, episodes=2, **QUICK, **told),
    ),
    "fit": ("fitting people", lambda told, table, log, **_: fit(table, log, **told)),
    "distribution": (
        "fitting the population",
        lambda told, people, **_: people.distribution(family="histogram", **told),
    ),
    "run_study": ("episodes", lambda told, study, results, **_: run_study(study, results, resume=True, **told)),
}
"""Functions that may take minutes: a stage that each shows, and how it is called."""


@pytest.fixture(scope="module")
def things(tiny: Table) -> dict[str, Any]:
    """Record the arguments of calls to these functions."""
    setting = Setting(c_suggest=0.2, c_move=0.1)
    pool = Pool.sample(tiny, 2, seed=0, setting=setting)
    rows = people_at_work(Choices.of(tiny), [0.5, 1.0], np.random.default_rng(0), suggest=0.4, episodes=2)
    log = Log.of(rows)
    return {
        "task": tiny.task, "table": tiny, "pool": pool, "pomdp": pool.policies[0].pomdp, "log": log,
        "people": fit(tiny, log),
    }  # fmt: skip


LONGEST = {"run_study"}


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name in LONGEST)) for name in LONG])
def test_long_work_shows_how_far_it_is(
    name: str, things: dict[str, Any], request: pytest.FixtureRequest, monkeypatch, capsys
) -> None:
    """Progress is shown on a terminal by default after a while, or passed to a function."""
    stage, call = LONG[name]
    given = dict(things)
    if name == "run_study":
        given |= {"study": request.getfixturevalue("small_study")[0], "results": request.getfixturevalue("results")}
    told: list[tuple[str, int, int | None]] = []
    call({"progress": lambda *what: told.append(what)}, **given)
    assert stage in {what for what, *_ in told}
    assert all(done <= (total or done) for _, done, total in told)
    monkeypatch.setattr(progress, "AFTER", 0.0)
    assert stage in on_terminal(monkeypatch, lambda: call({}, **given))
    # Nothing else is shown, whatever is called within.
    assert on_terminal(monkeypatch, lambda: call({"progress": lambda *_: None}, **given)) == ""
    if name == "simulate":
        assert on_terminal(monkeypatch, lambda: call({"progress": False}, **given)) == ""
        monkeypatch.setattr(progress, "AFTER", 60.0)
        assert on_terminal(monkeypatch, lambda: call({}, **given)) == ""
    assert capsys.readouterr().err == ""  # which is no terminal


def test_a_person_who_is_solved_when_first_asked_is_shown(tiny: Table, monkeypatch) -> None:
    monkeypatch.setattr(progress, "AFTER", 0.0)
    whole, part = (Pool.sample(tiny, 1, seed=0, **options).policies[0] for options in ({}, {"states": 5, "region": 9}))
    for policy in (whole, part):
        assert "solving a person's POMDP" in on_terminal(monkeypatch, policy.prepare)


@pytest.mark.parametrize(("wanted", "lines"), [("1", True), pytest.param(None, False, marks=pytest.mark.slow)])
def test_the_environment_decides_where_nobody_looks(
    wanted: str | None, lines: bool, tiny: Table, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress, "AFTER", 0.0)
    monkeypatch.setattr(progress, "BETWEEN_LINES", 0.001)
    monkeypatch.delenv(progress.UNSHOWN, raising=False)
    if wanted is not None:
        monkeypatch.setenv(progress.UNSHOWN, wanted)
    pool = Pool.sample(tiny, 3, seed=0)

    def slow(team: TeamState) -> TeamAction:
        time.sleep(0.002)
        return team.act(np.full(team.location.shape, -1), np.zeros_like(team.x))

    compare(pool, slow, humans=2, episodes=1)
    assert ("simulating slow" in capsys.readouterr().err) == lines


def test_worker_processes_show_nothing_by_themselves() -> None:
    ((_, shown),) = outcomes(os.getenv, [progress.UNSHOWN])
    assert shown == "0"


@pytest.mark.parametrize("behind", [KeyboardInterrupt(), KeyError("x")])
def test_an_interrupt_of_compiled_code_is_an_interrupt(behind: BaseException) -> None:
    """Python makes a `SystemError` of an exception that is set when compiled code returns."""

    @progress.shows_progress
    def calls_compiled_code(progress: progress.Wanted = None) -> None:  # noqa: ARG001
        try:
            raise SystemError("returned a result with an exception set") from behind
        except SystemError as error:
            raise SystemError("and again") from error

    with pytest.raises(KeyboardInterrupt if isinstance(behind, KeyboardInterrupt) else SystemError):
        calls_compiled_code()
