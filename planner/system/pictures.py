"""Pictures of planning objects in notebooks.

The planner draws nothing. A package that draws declares a function in the entry point group `planner.pictures`. The
function gets an object and returns an SVG document, or None if it has no picture of it. So neither package imports the
other by name, and users need not import the one that draws.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUP = "planner.pictures"


@cache
def _drawers() -> tuple[EntryPoint, ...]:
    """Return the installed functions that draw. To find them takes some milliseconds."""
    from importlib.metadata import entry_points  # slow to import

    return tuple(entry_points(group=GROUP))


class Pictured:
    """An object that is a picture in a notebook if an installed package draws it, and else a line."""

    def _repr_svg_(self) -> str | None:
        return next((svg for drawer in _drawers() if (svg := drawer.load()(self)) is not None), None)
