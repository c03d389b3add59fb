"""The options that describe a team's robots, and the distances between people's stations."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .common import INPUT_FILE, NUMBER, ROBOTS, Command, Option, with_options

if TYPE_CHECKING:
    from ...team.settings import Setting
    from ...team.travel import Travel


def travel_options(command: Command) -> Command:
    """Add the options for robots and their travel.

    `Setting` takes `--robots`, `--c-move` and `--travel-time`; `travel_of` takes `--distances`.
    """
    options: tuple[Option[Any], ...] = (
        click.option(
            "--robots", type=ROBOTS, default=1, show_default=True, metavar="M",
            help="Number of robots, or a list such as '[{c_move = 2}, {}]'.",
        ),
        click.option(
            "--c-move", type=NUMBER, default=0.5, show_default=True,
            help="Cost of moving a distance of 1 (cost units).",
        ),
        click.option(
            "--travel-time", type=NUMBER, default=0.0, show_default=True,
            help="Steps that a distance of 1 takes.",
        ),
        click.option(
            "--distances", type=INPUT_FILE, metavar="FILE",
            help="Distances between the K stations and the base, which comes last (JSON list of lists). All are 1 "
                 "unless given.",
        ),
    )  # fmt: skip
    return with_options(command, options)


def travel_of(setting: Setting, humans: int, distances: Path | None) -> Travel:
    """Return the distances between the stations of a team."""
    if distances is None:
        return setting.travel(humans)
    try:
        table = json.loads(distances.read_text(encoding="utf-8"))
        if not isinstance(table, list) or not all(isinstance(row, list) for row in table):
            raise ValueError("expected a list of lists of numbers")
        for cell in (cell for row in table for cell in row):
            if not isinstance(cell, int | float) or isinstance(cell, bool):
                raise ValueError(f"{json.dumps(cell)}: expected a number")  # noqa: TRY004
        return setting.travel(humans, table)
    except ValueError as error:
        raise click.UsageError(f"--distances {distances}: {error}") from None
