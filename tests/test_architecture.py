"""Data flows one way: a module imports only those above it."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from conftest import ROOT

ORDER = [
    "planner.errors", "planner.storage", "planner.pddl", "planner.fast_downward", "planner.task", "planner.budget",
    "planner.successors", "planner.statespace", "planner.costtogo", "planner.moves", "planner.kernels",
    "planner.coding", "planner.sweep", "planner.ondemand", "planner.methods", "planner.solving", "planner.batch",
    "assist.choices", "assist.human", "assist.belief", "assist.archive", "assist.pomdp", "assist.region",
    "assist.mdp", "assist.vectors", "assist.search", "assist.envelope", "assist.solver", "assist.exchange",
    "assist.attention", "assist.simulate", "assist.log", "assist.fit", "assist.misconception", "assist.crowd",
    "assist.diagnostics", "assist.profile", "assist.figures", "assist.fit_figures", "assist.cli",
]  # fmt: skip
MAY_READ_PDDL = {"assist.cli"}
ARRAYS = {"planner", "planner.errors", "planner.storage"}
READING = {"load", "find_instances", "instance", "Instance", "Task"}


def modules() -> list[str]:
    files = [f for package in ("planner", "assist") for f in sorted((ROOT / package).rglob("*.py"))]
    return [".".join(f.relative_to(ROOT).with_suffix("").parts) for f in files if f.name != "__init__.py"]


def imports(module: str, source: str) -> list[tuple[str, str]]:
    """The project's modules that a module imports, each with the name that it takes from it."""
    package = module.rpartition(".")[0]
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                base = f"{package}.{base}".rstrip(".")
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
        confined = module.startswith("assist.") and module not in MAY_READ_PDDL and name.startswith("planner")
        if confined and (name not in ARRAYS or what in READING):
            wrong.append(f"{module} takes {what or name} from the planner; only arrays may be used there")
    return wrong


def test_every_module_has_its_place() -> None:
    assert sorted(modules()) == sorted(ORDER)


@pytest.mark.parametrize("module", ORDER)
def test_import_direction(module: str) -> None:
    assert faults(module, Path(ROOT, *module.split(".")).with_suffix(".py").read_text()) == []


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("planner.task", "from .costtogo import Table"),
        ("planner.pddl", "import assist.human"),
        ("assist.human", "from .simulate import Episode"),
        ("assist.pomdp", "from planner import load"),
        ("assist.mdp", "from planner.pddl import read"),
    ],
)
def test_a_wrong_import_is_found(module: str, line: str) -> None:
    assert faults(module, line)
