"""Data flows one way: a module imports only those above it."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from conftest import ROOT

ORDER = [
    "planner.errors", "planner.storage", "planner.workers", "planner.pddl", "planner.fast_downward", "planner.task",
    "planner.budget",
    "planner.successors", "planner.statespace", "planner.costtogo", "planner.moves", "planner.kernels",
    "planner.coding", "planner.sweep", "planner.ondemand", "planner.methods", "planner.solving", "planner.batch",
    "assist.choices", "assist.human", "assist.belief", "assist.archive", "assist.pomdp", "assist.region",
    "assist.mdp", "assist.vectors", "assist.search", "assist.envelope", "assist.solver", "assist.exchange",
    "assist.team", "assist.attention", "assist.visits", "assist.priority", "assist.pool", "assist.acting",
    "assist.episodes", "assist.simulate", "assist.watching", "assist.bounds", "assist.joint",
    "assist.log", "assist.fit", "assist.misconception", "assist.crowd", "assist.diagnostics",
    "assist.profile", "assist.figures", "assist.fit_figures", "assist.study_figures",
    "assist.statistics", "assist.study", "assist.protocol", "assist.running", "assist.summary", "assist.report",
    "assist.cli.console", "assist.cli.task", "assist.cli.person", "assist.cli.team", "assist.cli.solve",
    "assist.cli.simulate", "assist.cli.policy", "assist.cli.bound", "assist.cli.export", "assist.cli.fit",
    "assist.cli.study", "assist.cli",
]  # fmt: skip
MAY_READ_PDDL = ("assist.study", "assist.protocol", "assist.cli")  # with all that is in them
ARRAYS = {"planner", "planner.errors", "planner.storage", "planner.workers"}
READING = {"load", "find_instances", "instance", "Instance", "Task"}


def modules() -> dict[str, Path]:
    """The file of each module; a package within `planner` or `assist` is one too, since its file has code."""
    files = [f for package in ("planner", "assist") for f in sorted((ROOT / package).rglob("*.py"))]
    named = {".".join(f.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): f for f in files}
    return {name: f for name, f in named.items() if "." in name}


def within(module: str, package: str) -> bool:
    return f"{module}.".startswith(f"{package}.")


def is_package(module: str) -> bool:
    return any(within(other, module) for other in ORDER if other != module)


def imports(module: str, source: str) -> list[tuple[str, str]]:
    """The project's modules that a module imports, each with the name that it takes from it."""
    package = module.split(".")
    if not is_package(module):
        package.pop()
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                base = ".".join([*package[: len(package) + 1 - node.level], base]).rstrip(".")
            for alias in node.names:
                whole = f"{base}.{alias.name}"
                found.append((whole, "") if whole in ORDER else (base, alias.name))
        elif isinstance(node, ast.Import):
            found += [(alias.name, "") for alias in node.names]
    return [(name, what) for name, what in found if name.partition(".")[0] in ("planner", "assist")]


def faults(module: str, source: str) -> list[str]:
    wrong = []
    for name, what in imports(module, source):
        if name == "planner" and module.startswith("assist."):
            pass  # the package's own list of what it hands over
        elif name not in ORDER or ORDER.index(name) >= ORDER.index(module):
            wrong.append(f"{module} imports {name}, which comes after it")
        may_read = any(within(module, one) for one in MAY_READ_PDDL)
        confined = module.startswith("assist.") and not may_read and name.startswith("planner")
        if confined and (name not in ARRAYS or what in READING):
            wrong.append(f"{module} takes {what or name} from the planner; only arrays may be used there")
    return wrong


def test_every_module_has_its_place() -> None:
    assert sorted(modules()) == sorted(ORDER)


@pytest.mark.parametrize("module", ORDER)
def test_import_direction(module: str) -> None:
    assert faults(module, modules()[module].read_text()) == []


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("planner.task", "from .costtogo import Table"),
        ("planner.pddl", "import assist.human"),
        ("assist.human", "from .simulate import Episode"),
        ("assist.pomdp", "from planner import load"),
        ("assist.mdp", "from planner.pddl import read"),
        ("assist.running", "from planner import sweep"),
        ("assist.simulate", "from .study import Study"),
        ("assist.profile", "from .cli import main"),
        ("assist.figures", "from .cli.console import fail"),
        ("assist.cli.console", "from .task import one_instance"),
        ("assist.cli.solve", "from .fit import fit"),
        ("assist.cli.person", "from . import policy"),
        ("assist.cli.person", "from .. import cli"),
    ],
)
def test_a_wrong_import_is_found(module: str, line: str) -> None:
    assert faults(module, line)
