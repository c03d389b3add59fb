"""The distances between people's stations."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from planner.system.errors import InputFileError
from planner.system.files import read_json

from ...declare.declared import DeclarationError, Number, checked

if TYPE_CHECKING:
    from ...declare.options import Given
    from ...person.settings import Setting
    from ...person.travel import Travel


def travel_of(setting: Setting, humans: int, distances: str | None, given: Given[Any], *, more: bool = False) -> Travel:
    """Return the distances between the stations of a team, of which there may be `more` than people.

    A fault is told with the source of the file's name.
    """
    if distances is None:
        return setting.travel(humans)
    try:
        matrix = checked(list[list[Number]], read_json(Path(distances)))
        return setting.travel(max(humans, len(matrix) - 1) if more else humans, matrix)
    except ValueError as error:
        right = str(error) if isinstance(error, InputFileError) else f"{distances}: {error}"
        raise click.UsageError(given.told(DeclarationError(("distances",), None, right, right))) from None
