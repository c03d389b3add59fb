"""The distances between people's stations."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from planner.system.files import read_json

if TYPE_CHECKING:
    from ...person.settings import Setting
    from ...person.travel import Travel


def travel_of(setting: Setting, humans: int, distances: str | None) -> Travel:
    """Return the distances between the stations of a team."""
    if distances is None:
        return setting.travel(humans)
    try:
        table = read_json(Path(distances))
        if not isinstance(table, list) or not all(isinstance(row, list) for row in table):
            raise ValueError("expected a list of lists of numbers")
        for cell in (cell for row in table for cell in row):
            if not isinstance(cell, int | float) or isinstance(cell, bool):
                raise ValueError(f"{json.dumps(cell)}: expected a number")  # noqa: TRY004
        return setting.travel(humans, table)
    except ValueError as error:
        told = str(error).removeprefix(f"{distances}:")
        raise click.UsageError(f"distances: {distances}:{' ' * (told == str(error))}{told}") from None
