"""Mutation tests: one small change of a function at a time, and whether a test fails.

    python bench/mutants.py [MODULE]... [--sample N] [--seed S] [--only TESTS] [--record FILE [--more]]

A change replaces a comparison or an operator, increases a number by one, negates a condition, or removes an argument or
a statement. MODULE is a file, or a room: then `--sample` draws from all its files. The tests are collected once. Each
mutant then runs, in a forked process, the tests that call the changed function, fastest first. The mutant is killed
when a test fails, or exceeds a multiple of its processor time without the change. Compiled functions, module-level
code, error messages, default values and tests that are marked as long or slow are excluded.
"""

from __future__ import annotations

import ast
import copy
import functools
import importlib
import os
import pickle
import random
import resource
import signal
import sys
import tempfile
import time
import traceback
import types
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click
import pytest
from _pytest.main import pytest_runtestloop as all_tests
from hypothesis import Phase, settings
from tables import ROOT, Columns, cell, more_option, record_option, write_record

TESTS = {
    "assist/people/human.py": "test_human test_people test_weights test_choice_models",
    "assist/people/hidden_type.py": "test_unknown_goals test_goal_bounds",
    "assist/people/type_kernels.py": "test_unknown_goals test_goal_bounds",
    "assist/people/belief.py": "test_belief test_unknown_goals test_trust_rules",
    "assist/people/decision.py": "test_human test_equations test_misconception test_choice_models",
    "planner/costtogo/table.py": "test_costtogo test_ondemand test_tables",
    "planner/pddl/declarations.py": "test_pddl test_reading test_second_reader test_numbers_refused",
    "planner/pddl/formulas.py": "test_pddl test_reading test_second_reader test_numbers_refused",
    "planner/pddl/reader.py": "test_pddl test_reading test_second_reader test_numbers_refused",
    "assist/person/truncated_task.py": "test_region test_frontier test_wide",
    "assist/person/frontier_bounds.py": "test_region test_frontier",
    "assist/learning/advice_log.py": "test_advice",
    "assist/learning/comparison.py": "test_trust_fit test_weights",
    "assist/learning/diagnostics.py": "test_fit",
    "assist/learning/evidence.py": "test_people test_goals test_cases_python",
    "assist/learning/fit.py": "test_people test_goal_fit test_fit_own",
    "assist/learning/log.py": "test_log test_log_files",
    "assist/learning/maximum_likelihood.py": "test_fit test_learning_figures",
    "assist/learning/observations.py": "test_fit test_goal_fit",
    "assist/learning/replay.py": "test_log test_people test_weights",
    "assist/team/assignment.py": "test_robots",
    "assist/team/attention.py": "test_policies",
    "assist/person/attention_subproblem.py": "test_attention_subproblem test_bounds test_robots",
    "assist/certify/team_bound.py": "test_certify test_solver test_robots",
    "assist/certify/certificate.py": "test_certify",
    "assist/certify/prices.py": "test_attention_prices test_certify test_robots",
    "planner/system": "planner/system planner/batch",
    "planner/pddl": "planner/pddl test_engine test_engine_numbers",
    "planner/grounding": "planner/grounding test_engine test_engine_numbers",
    "planner/search": "planner/search test_engine test_engine_numbers",
    "planner/costtogo": "planner/costtogo test_state_indices test_engine test_engine_numbers",
    "planner/batch": "planner/batch",
    "assist/declare": "assist/declare assist/people",
    "assist/people": "assist/people",
    "assist/person": "assist/person",
    "assist/team": "assist/team",
    "assist/certify": "assist/certify",
    "assist/learning": "assist/learning",
    "assist/drawing": "assist/drawing",
    "assist/live": "assist/live",
    "assist/studies": "assist/studies",
    "assist/web": "assist/web",
    "assist/connect": "assist/connect",
    "assist/cli": "assist/cli",
}
"""The modules and rooms, and the files and folders of tests that should detect changes of them."""

COLUMNS: Columns = {
    "module": lambda row: f"`{row['module']}`",
    "mutants": cell("count"),
    "of these run": cell("run"),
    "killed": cell("killed"),
    "survived": lambda row: f"{row['run'] - row['killed']}",
    "share of killed": lambda row: f"{100 * row['killed'] / max(1, row['run']):.0f} %",
}
SWAPPED: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Add: ast.Sub, ast.Sub: ast.Add,
    ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult, ast.Pow: ast.Mult,
    ast.And: ast.Or, ast.Or: ast.And, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
    ast.Break: ast.Continue, ast.Continue: ast.Break,
}  # fmt: skip
NAMES = {"min": "max", "any": "all", "argmin": "argmax", "minimum": "maximum", "zeros": "ones", "floor": "ceil"}
NAMES |= {other: name for name, other in NAMES.items()}
WRAPPED = ("__wrapped__", "__func__", "fget", "func")
"""Attributes in which decorators store the decorated function."""
MOST = 5  # times the processor time of a test without the change, plus
LEAST = 5  # seconds, since the first test also pays for shared fixtures


def others(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the replacements of a syntax node."""

    def with_(**fields: Any) -> ast.AST:
        other = copy.copy(node)
        vars(other).update(fields)
        return other

    match node:
        case ast.Compare(ops=ops):
            for at, op in enumerate(ops):
                yield with_(ops=[*ops[:at], SWAPPED[type(op)](), *ops[at + 1 :]])
        case ast.BinOp(op=op) | ast.BoolOp(op=op) | ast.AugAssign(op=op) if type(op) in SWAPPED:
            yield with_(op=SWAPPED[type(op)]())
        case ast.UnaryOp(operand=operand):
            yield operand
        case ast.Constant(value=bool(value)):
            yield with_(value=not value)
        case ast.Constant(value=int(value) | float(value)):
            yield with_(value=value + 1)
        case ast.Name(id=name) if name in NAMES:
            yield with_(id=NAMES[name])
        case ast.Attribute(attr=name) if name in NAMES:
            yield with_(attr=NAMES[name])
        case ast.If(test=test) | ast.While(test=test) | ast.IfExp(test=test):
            yield with_(test=ast.UnaryOp(ast.Not(), test))
        case ast.Break() | ast.Continue():
            yield SWAPPED[type(node)]()
        case ast.Call(keywords=keywords):
            for at, keyword in enumerate(keywords):
                if keyword.arg is not None:
                    yield with_(keywords=[*keywords[:at], *keywords[at + 1 :]])
    left_out = isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
    kept = isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Subscript | ast.Attribute)
    if left_out or kept or isinstance(node, ast.AugAssign):
        yield ast.Pass()


class Change(ast.NodeTransformer):
    """Applies one of the changes of a function. All changes are counted and described."""

    def __init__(self, wanted: int | None = None) -> None:
        self.wanted, self.count, self.told = wanted, 0, list[str]()

    def visit(self, node: ast.AST) -> Any:
        for other in others(node):
            self.count += 1
            if self.count - 1 == self.wanted:
                return ast.fix_missing_locations(ast.copy_location(other, node))
            self.told.append(f"line {node.lineno}: {shown(node)} -> {shown(other)}")  # type: ignore[attr-defined]
        return super().visit(node)

    def visit_Raise(self, node: ast.Raise) -> ast.Raise:
        return node

    def visit_JoinedStr(self, node: ast.JoinedStr) -> ast.JoinedStr:
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AnnAssign:
        if node.value is not None:
            node.value = self.visit(node.value)
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        node.body = [self.visit(statement) for statement in node.body]
        return node

    def visit_arguments(self, node: ast.arguments) -> ast.arguments:
        return node


def shown(node: ast.AST) -> str:
    """Return the first line of a node's source."""
    return ast.unparse(node).splitlines()[0][:100]


class Mutant:
    """One change of one function of a module."""

    def __init__(self, module: types.ModuleType, tree: ast.Module, path: list[str], number: int, told: str) -> None:
        self.module, self.tree, self.path, self.number, self.told = module, tree, path, number, told
        self.name = ".".join(path)

    @property
    def function(self) -> tuple[str, str]:
        """Return the file and the qualified name of the function."""
        return str(self.module.__file__), self.name

    def program(self) -> ast.Module:
        """Return the syntax tree of the module with the change."""
        tree = copy.deepcopy(self.tree)
        parent: Any = tree
        for part in self.path:
            parent = next(node for node in parent.body if getattr(node, "name", None) == part)
        change = Change(self.number)
        parent.body = [change.visit(statement) for statement in parent.body]
        return ast.fix_missing_locations(tree)

    def take_place(self) -> None:
        """Replace the code of the module's function by the changed code."""
        code = compile(self.program(), str(self.module.__file__), "exec")
        function = function_of(self.module, self.path)
        assert function is not None
        function.__code__ = next(inner for inner in codes(code) if inner.co_qualname == self.name)


def codes(code: types.CodeType) -> Iterator[types.CodeType]:
    """Yield a code object and all nested ones."""
    yield code
    for inner in code.co_consts:
        if isinstance(inner, types.CodeType):
            yield from codes(inner)


def function_of(module: types.ModuleType, path: list[str]) -> types.FunctionType | None:
    """Return the undecorated function of a path in a module; None for compiled code."""
    found: Any = module
    for part in path:
        found = vars(found)[part]
    if hasattr(found, "py_func"):
        return None
    while inner := [getattr(found, name) for name in WRAPPED if getattr(found, name, None) is not None]:
        found = inner[0]
    return found if isinstance(found, types.FunctionType) else None


def mutants_of(module: types.ModuleType) -> list[Mutant]:
    """Return all mutants of the interpreted functions and methods of a module."""
    tree = ast.parse(Path(str(module.__file__)).read_text(encoding="utf-8"))
    found = []
    places = [([node.name], node) for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)]
    for path, node in places:
        if isinstance(node, ast.ClassDef):
            places += [([*path, inner.name], inner) for inner in node.body if isinstance(inner, ast.FunctionDef)]
        elif function_of(module, path) is not None:
            counted = Change()
            for statement in copy.deepcopy(node).body:
                counted.visit(statement)
            found += [Mutant(module, tree, path, number, told) for number, told in enumerate(counted.told)]
    return found


Called = dict[tuple[str, str], dict[str, float]]
"""For each function, by file and qualified name: the tests that call it, with their seconds."""


class Run:
    """A pytest plugin that runs the tests of each mutant after all tests were collected."""

    def __init__(self, place: str, sample: int | None, seed: int) -> None:
        self.place, self.sample, self.seed = place, sample, seed
        self.called: Called | None = None  # while calls are recorded
        self.count, self.results = 0, list[tuple[Mutant, str]]()
        self.allowed: dict[str, float] = {}  # tests of a mutant, with their seconds without the change

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Run the mutants, instead of the tests once."""
        path = ROOT / self.place
        files = sorted(path.rglob("*.py")) if path.is_dir() else [path]
        names = [".".join(file.relative_to(ROOT).with_suffix("").parts) for file in files if file.stem != "__init__"]
        mutants = [mutant for name in names for mutant in mutants_of(importlib.import_module(name))]
        called = self.calls(session, {str(file) for file in files})
        self.count = len(mutants)
        if self.sample is not None and self.sample < len(mutants):
            drawn = random.Random(self.seed).sample(range(len(mutants)), self.sample)
            mutants = [mutants[number] for number in sorted(drawn)]
        for mutant in mutants:
            tests = called.get(mutant.function, {})
            end = self.end_of(session, mutant, tests) if tests else "not reached"
            self.results.append((mutant, end))
            print(f"{mutant.module.__name__} {mutant.name}, {mutant.told}: {end}", flush=True)
        return True

    def calls(self, session: pytest.Session, files: set[str]) -> Called:
        """Run the unchanged tests; return the tests that call each function. Calls during setup count for all tests."""

        def work() -> Called | None:
            self.called, self.files, self.in_setup = defaultdict(dict), files, set[tuple[str, str]]()
            failed = run(session)
            for function in self.in_setup:
                self.called[function] = {item.nodeid: 1.0 for item in session.items} | self.called[function]
            return None if failed else dict(self.called)

        found = forked(work)
        if found is None:
            raise pytest.UsageError(f"{self.place}: its tests fail without a change")
        return found

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Iterator[None]:
        if item.nodeid in self.allowed:
            seconds = int(time.process_time() + MOST * self.allowed[item.nodeid] + LEAST)
            resource.setrlimit(resource.RLIMIT_CPU, (seconds, resource.RLIM_INFINITY))
            signal.alarm(
                60 * (int(MOST * self.allowed[item.nodeid]) + LEAST)
            )  # for a test that waits without computing
        return (yield from self.watched("setup", item))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Iterator[None]:
        return (yield from self.watched("call", item))

    def watched(self, phase: str, item: pytest.Item) -> Iterator[None]:
        """Record the functions of the files that are called."""
        if self.called is None:
            return (yield)
        functions, begun = set[tuple[str, str]](), time.process_time()

        def called(frame: types.FrameType, event: str, _: Any) -> None:
            if event == "call" and frame.f_code.co_filename in self.files:
                functions.add((frame.f_code.co_filename, frame.f_code.co_qualname.partition(".<locals>")[0]))

        sys.setprofile(called)
        try:
            return (yield)
        finally:
            sys.setprofile(None)
            if phase == "setup":
                self.in_setup |= functions
            else:
                for function in functions:
                    self.called[function][item.nodeid] = time.process_time() - begun

    def end_of(self, session: pytest.Session, mutant: Mutant, tests: dict[str, float]) -> str:
        """Return the outcome of a mutant."""
        if (child := os.fork()) == 0:
            self.allowed = tests
            session.items[:] = sorted((i for i in session.items if i.nodeid in tests), key=lambda i: tests[i.nodeid])
            mutant.take_place()
            os._exit(run(session))
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        if status < 0:  # SIGXCPU: processor time exceeded; SIGALRM: wall-clock time exceeded
            return f"killed by {signal.Signals(-status).name}"
        return "killed" if status else "survived"


def run(session: pytest.Session) -> int:
    """Run the tests of a session in this process, silently; return 1 if a test fails."""
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    try:
        all_tests(session)
    except BaseException:  # noqa: BLE001  the first failure ends the session
        return 1
    return int(session.testsfailed > 0)


def forked(work: Callable[[], Any]) -> Any:
    """Return the result of a function that runs in a forked process, or None if it fails."""
    reading, writing = os.pipe()
    sys.stdout.flush()
    if (child := os.fork()) == 0:
        code = 1
        try:
            os.close(reading)
            found = work()
            with os.fdopen(writing, "wb") as stream:
                pickle.dump(found, stream)
            code = 0
        except Exception:  # noqa: BLE001  printed here, since the parent does not see it
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
    os.close(writing)
    with os.fdopen(reading, "rb") as stream:
        content = stream.read()
    return pickle.loads(content) if os.waitpid(child, 0)[1] == 0 else None


def mutate(place: str, sample: int | None, seed: int, only: str | None) -> tuple[int, list[tuple[str, str]]]:
    """Run the mutants of a module or room; return their total number, and the outcomes of those that were run."""
    plugin = Run(place, sample, seed)
    folder = ROOT / "tests"
    tests = [
        str(folder / name if (folder / name).is_dir() else next(folder.rglob(f"{name}.py")))
        for name in TESTS[place].split()
    ]
    with tempfile.TemporaryDirectory() as temporary:
        options = [
            "-x",
            "-s",
            "-q",
            "--hypothesis-profile=mutants",
            "-p",
            "no:cacheprovider",
            "-W",
            "ignore::pytest.PytestAssertRewriteWarning",
            "-W",
            "ignore::pytest.PytestUnraisableExceptionWarning",  # of processes that the parent process still uses
            "-m",
            "not long and not slow",
        ]
        pytest.main(
            [*tests, *options, *(["-k", only] if only else []), f"--basetemp={temporary}/run"], plugins=[plugin]
        )
    return plugin.count, [
        (f"{mutant.module.__name__} {mutant.name}, {mutant.told}", end) for mutant, end in plugin.results
    ]


@click.command()
@click.argument("modules", nargs=-1, type=click.Choice(list(TESTS)))
@click.option(
    "--sample", type=click.IntRange(1), help="Number of a module's mutants, drawn at random. All unless given."
)
@click.option("--seed", default=0, show_default=True)
@click.option("--only", help="Run only tests that match this expression (pytest's -k).")
@record_option
@more_option
def main(
    modules: tuple[str, ...], sample: int | None, seed: int, only: str | None, record: Path | None, more: bool
) -> None:
    """Run the mutants of modules or rooms, and print those that survive."""
    os.chdir(ROOT)
    phases = [Phase.explicit, Phase.generate]
    settings.register_profile("mutants", phases=phases, database=None, deadline=None, max_examples=30)
    rows = []
    for module in modules or TESTS:
        found = forked(
            functools.partial(mutate, module, sample, seed, only)
        )  # tests are collected in a new process for each module
        if found is None or not found[0]:
            sys.exit(1)
        count, results = found
        killed = sum(end.startswith("killed") for _, end in results)
        rows.append({"module": module, "count": count, "run": len(results), "killed": killed})
        for told, end in results:
            if not end.startswith("killed"):
                print(f"{told}: {end}")
        for name, show in COLUMNS.items():
            print(f"{name}: {show(rows[-1])}")
    write_record(record, COLUMNS, rows, more=more)


if __name__ == "__main__":
    main()
