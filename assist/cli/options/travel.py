"""The distances between people's stations."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from planner.system.files import read_json

from ...declare.declared import DeclarationError, Number, checked

if TYPE_CHECKING:
    from ...declare.options import Given
    from ...person.settings import Setting
    from ...person.travel import Travel


def travel_of(setting: Setting, humans: int, distances: str | None, given: Given[Any]) -> Travel:
    """Return the distances between the stations of a team; a fault is told with the source of the file's name."""
    if distances is None:
        return setting.travel(humans)
    try:
        return setting.travel(humans, checked(list[list[Number]], read_json(Path(distances))))
    except ValueError as error:
        said = str(error).removeprefix(f"{distances}:")
        right = f"{distances}:{' ' * (said == str(error))}{said}"
        raise click.UsageError(given.told(DeclarationError(("distances",), None, right, right))) from None
