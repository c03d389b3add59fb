from __future__ import annotations

import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from assist.people.choices import Choices
from planner import Instance, Table, find_instances, load, sweep

ROOT = Path(__file__).parent.parent
DOMAINS = ROOT / "domains"
KITTING = DOMAINS / "kitting"
SHIPPED = find_instances([DOMAINS])
# Instances of more than about 20,000 states.
LARGE = {
    "ladder-2x8", "ladder-4x6", "ladder-4x7", "ladder-4x8", "ladder-4x9", "ladder-4x10", "ladder-6x12", "balls-10",
    "balls-13", "blocks-7", "blocks-8", "two-walls", "rush", "five-parcels", "two-vans", "three-benches",
    "four-boxes", "five-items",
}  # fmt: skip
SMALL = [instance for instance in SHIPPED if instance.problem.stem not in LARGE]
PAPERS = [KITTING / f"{name}.pddl" for name in ("paper", "paper-fixed", "sealed", "tiny", "unsolvable", "costs/ways")]


@cache
def table_of(instance: Instance) -> Table:
    return sweep(load(instance))


def solvable(instances: list[Instance]) -> list[Instance]:
    return [instance for instance in instances if instance.problem.stem != "unsolvable"]


def named(instance: Instance) -> str:
    return str(instance.problem.relative_to(DOMAINS))


@pytest.fixture(scope="session")
def tiny() -> Table:
    return table_of(Instance(KITTING / "tiny.pddl", KITTING / "domain.pddl"))


@pytest.fixture(scope="session")
def fixed() -> Table:
    return table_of(Instance(KITTING / "paper-fixed.pddl", KITTING / "domain.pddl"))


@pytest.fixture(scope="session")
def sealed() -> Table:
    return table_of(Instance(KITTING / "sealed.pddl", KITTING / "domain.pddl"))


@pytest.fixture(scope="session")
def tiny_choices(tiny: Table) -> Choices:
    return Choices.of(tiny)


def kitassist(*arguments: object, cwd: Path = ROOT, check: bool = False) -> subprocess.CompletedProcess[str]:
    """Run the command as a user does."""
    command = [str(Path(sys.executable).with_name("kitassist")), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=240, check=check)


def write_instance(folder: Path, domain: str, problem: str) -> Instance:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "domain.pddl").write_text(domain)
    (folder / "problem.pddl").write_text(problem)
    return Instance(folder / "problem.pddl", folder / "domain.pddl")
