"""The command `domains`, which lists the bundled tasks."""

from __future__ import annotations

from dataclasses import asdict

from rich.table import Table

from planner.pddl.instance_finder import bundled_tasks

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
    table = Table(box=None, pad_edge=False)
    table.add_column("instance")
    table.add_column("states", justify="right")
    table.add_column("cost", justify="right")
    table.add_column("description", overflow="fold")
    for one in found:
        numbers = ("-" if number is None else f"{number:,}" for number in (one.states, one.cost))
        table.add_row(one.name, *numbers, one.about)
    print_table(table)
