"""Benchmarks: every script is listed, and its requirements are available. `make bench-smallest` runs them."""

from __future__ import annotations

import ast
import importlib

import click
import pytest
from conftest import ROOT

from assist.team import engine

RUN = importlib.import_module("run")
CASES: dict[str, tuple[str, str]] = RUN.CASES


def commands(script: str) -> dict[str, click.Command]:
    """The commands of a script, by the names under which they are run."""
    main = getattr(importlib.import_module(script), "main", None)
    if isinstance(main, click.Group):
        return {f"{script} {name}": command for name, command in main.commands.items()}
    return {} if main is None else {script: main}


def test_every_benchmark_is_run() -> None:
    others = {"graphs", "random_tasks", "random_writing", "run", "tables", *RUN.NEED_DATA}
    scripts = sorted(file.stem for file in (ROOT / "bench").glob("*.py") if file.stem not in others)
    assert {name for script in scripts for name in commands(script)} == set(CASES)


@pytest.mark.parametrize("name", CASES)
def test_a_benchmark_has_the_options_it_is_run_with(name: str) -> None:
    command = commands(name.split()[0])[name]
    for arguments in CASES[name]:
        with command.make_context(name, arguments.split()):
            pass


def test_a_mutant_differs_in_one_place() -> None:
    mutants = importlib.import_module("mutants").mutants_of(engine)
    lines = ast.unparse(mutants[0].tree).splitlines()
    assert len(mutants) > 20
    for mutant in mutants[:: len(mutants) // 5]:
        changed = ast.unparse(mutant.program()).splitlines()
        assert sum(one != other for one, other in zip(lines, changed, strict=True)) == 1, mutant.told
