"""The distances between people's stations."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from planner.system.files import read_json

from ...declare.declared import Number, checked

if TYPE_CHECKING:
    from ...person.settings import Setting
    from ...person.travel import Travel


def travel_of(setting: Setting, humans: int, distances: str | None) -> Travel:
    """Return the distances between the stations of a team."""
    if distances is None:
        return setting.travel(humans)
    try:
        return setting.travel(humans, checked(list[list[Number]], read_json(Path(distances))))
    except ValueError as error:
        told = str(error).removeprefix(f"{distances}:")
        raise click.UsageError(f"distances: {distances}:{' ' * (told == str(error))}{told}") from None
