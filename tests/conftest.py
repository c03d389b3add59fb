from __future__ import annotations

import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from assist.choices import Choices
from planner import CostToGo, Instance, cost_to_go, explore, find_instances, load

ROOT = Path(__file__).parent.parent
DOMAINS = ROOT / "domains"
KITTING = DOMAINS / "kitting"
SHIPPED = find_instances([DOMAINS])


@cache
def table_of(instance: Instance) -> CostToGo:
    return cost_to_go(explore(load(instance)))


def solvable(instances: list[Instance]) -> list[Instance]:
    return [instance for instance in instances if instance.problem.stem != "unsolvable"]


def named(instance: Instance) -> str:
    return str(instance.problem.relative_to(DOMAINS))


@pytest.fixture(scope="session")
def tiny() -> CostToGo:
    return table_of(Instance(KITTING / "tiny.pddl", KITTING / "domain.pddl"))


@pytest.fixture(scope="session")
def fixed() -> CostToGo:
    return table_of(Instance(KITTING / "paper-fixed.pddl", KITTING / "domain.pddl"))


@pytest.fixture(scope="session")
def sealed() -> CostToGo:
    return table_of(Instance(KITTING / "sealed.pddl", KITTING / "domain.pddl"))


@pytest.fixture(scope="session")
def tiny_choices(tiny: CostToGo) -> Choices:
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
