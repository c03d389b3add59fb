"""The command `domains`, which lists the bundled tasks."""

from __future__ import annotations

from dataclasses import asdict

from planner.pddl.instances import bundled_tasks

from .options.common import json_option
from .options.help import command
from .terminal.console import print_json, print_table


@command("domains")
@json_option
def domains(as_json: bool) -> None:
    """List the bundled tasks, whose names every command accepts."""
    found = bundled_tasks()
    if as_json:
        print_json([asdict(one) | {"problem": str(one.problem)} for one in found])
        return
    numbers = [["-" if number is None else f"{number:,}" for number in (one.states, one.cost)] for one in found]
    rows = [[one.name, *own, one.about] for one, own in zip(found, numbers, strict=True)]
    print_table(("instance", "states", "cost", "description"), rows, left=(0, 3))
