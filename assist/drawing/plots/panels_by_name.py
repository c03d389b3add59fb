"""Panels of the figures of a simulation study: by instance and measure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from .style import panels

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

MEASURES = {"actions": "human actions per person", "interventions": "robot interventions per episode"}


def instances_of(cells: DataFrame) -> list[str]:
    """Return the instances in order of appearance."""
    return list(dict.fromkeys(cells["instance"]))


def named_rows(
    rows: Sequence[str], columns: Sequence[str], *, height: float, sharey: Any = False
) -> tuple[Figure, list[dict[str, Axes]]]:
    """Return a figure with panels for each row and column, with the name of each row above its first panel."""
    figure, axes = panels(len(rows), len(columns), height=height, sharex="col", sharey=sharey)
    for name, axis in zip(rows, axes[:, 0], strict=True):
        axis.set_title(name, loc="left", fontweight="bold")
    return figure, [dict(zip(columns, row, strict=True)) for row in axes]
