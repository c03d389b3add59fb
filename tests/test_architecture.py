"""Data flows one way: a module imports only those above it."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from conftest import ROOT

ROOMS = {
    "planner": """errors storage processes workers pddl fast_downward built task budget successors statespace
        costtogo moves kernels coding sweep ondemand methods solving batch""",
    "assist.people": "choices human belief",
    "assist.person": "archive pomdp region qmdp alpha_vectors hsvi upper_hull solver",
    "assist.learning": "actions log recording fit misconception population diagnostics record",
    "assist.team": "arguments travel state attention subproblem priority policies settings pool",
    "assist.interop": "exchange",
    "assist.simulation": "dynamics episodes luck presence run simulate belief_trace",
    "assist.certify": "certificate prices bound",
    "assist.plots": "style labels episode people study",
    "assist.study": "statistics study protocol runner summary wording claims pictures report",
    "assist.cli": "interrupts options console progress task person team solve simulate policy bound export fit study",
    "assist.live": "advice problem assistant",
}
"""The folders in the order in which they build on each other, and the files of each likewise."""

ORDER = [module for room, files in ROOMS.items() for module in (*(f"{room}.{file}" for file in files.split()), room)]
ORDER.remove("planner")
MAY_READ_PDDL = ("assist.study.study", "assist.study.protocol", "assist.cli")  # with all that is in them
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
        ("planner.pddl", "import assist.people.human"),
        ("assist.people.human", "from ..simulation.episodes import Episode"),
        ("assist.person.pomdp", "from planner import load"),
        ("assist.person.qmdp", "from planner.pddl import read"),
        ("assist.study.runner", "from planner import sweep"),
        ("assist.simulation.simulate", "from ..study.study import Study"),
        ("assist.learning.record", "from ..cli import main"),
        ("assist.plots.episode", "from ..cli.console import fail"),
        ("assist.cli.console", "from .task import one_instance"),
        ("assist.cli.solve", "from .fit import fit"),
        ("assist.cli.person", "from . import policy"),
        ("assist.cli.person", "from .. import cli"),
    ],
)
def test_a_wrong_import_is_found(module: str, line: str) -> None:
    assert faults(module, line)
