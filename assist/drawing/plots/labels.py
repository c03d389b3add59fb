"""Placement of text in figures without overlap: next to the ends of curves, and around points.

Texts are placed after everything else is drawn and the figure's layout is known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import TYPE_CHECKING

import numpy as np

from ...people.decision import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.text import Annotation

FONT, NOTE_FONT = 8.5, 8  # points


@dataclass(frozen=True)
class Note:
    """A text and the point (in data coordinates) that it belongs to.

    Attributes
    ----------
    text : str
    x, y : float
    color : str
        Colour of the line between them.
    """

    text: str
    x: float
    y: float
    color: str


def name_curves(figure: Figure, ends: Mapping[Axes, Sequence[Note]]) -> None:
    """Write the names of curves to the right of each panel, connected to their ends and without overlap."""
    from scipy.optimize import isotonic_regression

    figure.draw_without_rendering()
    for axis, own in ends.items():
        if not own:
            continue
        low, high = axis.get_ylim()
        # In data units, for a line spacing of 10.5 points.
        lines = max(note.text.count("\n") + 1 for note in own)
        gap = 10.5 * lines * (high - low) / (axis.get_window_extent().height * 72 / figure.dpi)
        order = sorted(own, key=lambda note: note.y)
        steps = gap * np.arange(len(order))
        # The heights that are closest to the ends in the least-squares sense, with distances of at least `gap`.
        heights = isotonic_regression(np.array([note.y for note in order]) - steps).x + steps
        axis.set_ylim(low, high)
        for note, height in zip(order, heights, strict=True):
            axis.annotate(
                note.text, (note.x, note.y), xytext=(1.03, height), textcoords=axis.get_yaxis_transform(), va="center",
                fontsize=FONT, linespacing=0.95, annotation_clip=False,
                arrowprops={
                    "arrowstyle": "-", "color": note.color, "linewidth": 0.9, "shrinkA": 1, "shrinkB": 4,
                    "relpos": (0, 0.5),
                },
            )  # fmt: skip


def note_points(figure: Figure, notes: Mapping[Axes, Sequence[Note]]) -> None:
    """Write notes next to their points, where they cover least. Distant notes are connected to their points."""
    from matplotlib.text import Text

    figure.draw_without_rendering()
    distances = (6, 14, 24)  # points from a mark to its text; the nearest free place is used
    for axis, own in notes.items():
        covered = _ink(axis)
        room = axis.get_window_extent()
        written: list[tuple[Floats, Floats]] = []  # centre and size of each, in pixels
        for note in own:
            words = _words(axis, note)
            box = Text.get_window_extent(words)  # without the line to the point
            size = np.array([box.width, box.height])
            at = axis.transData.transform((note.x, note.y))
            places = [
                (distance, right, up)
                for distance, right, up in product(distances, (1, 0, -1), (1, 0, -1)) if right or up
            ]  # fmt: skip
            pixels = figure.dpi / 72
            middles = [at + np.array([right, up]) * (size / 2 + distance * pixels) for distance, right, up in places]
            hidden = []
            for (distance, _, _), middle in zip(places, middles, strict=True):
                out = (np.abs(middle - [(room.x0 + room.x1) / 2, (room.y0 + room.y1) / 2]) + size / 2) > (
                    np.array([room.width, room.height]) / 2 + 20 * pixels
                )
                over = sum(bool((np.abs(other - middle) < (size + its) / 2 + pixels).all()) for other, its in written)
                lines = (np.abs(covered - middle) < size / 2 + pixels).all(axis=1).sum()
                tie = _samples(at, middle) if distance > distances[0] else np.empty((0, 2))
                over += sum(bool((np.abs(tie - other) < its / 2 + pixels).all(axis=1).any()) for other, its in written)
                hidden.append(len(covered) * (over + out.any()) + lines + distance / 10)
            best = int(np.argmin(hidden))
            distance, right, up = places[best]
            written.append((middles[best], size))
            words.set(ha=("center", "left", "right")[right], va=("center", "bottom", "top")[up])
            words.xyann = (distance * right, distance * up)
            if distance > distances[0]:
                covered = np.concatenate([covered, _samples(at, middles[best])])
            elif words.arrow_patch is not None:
                words.arrow_patch.set_visible(False)


def _words(axis: Axes, note: Note) -> Annotation:
    from matplotlib.patheffects import withStroke

    return axis.annotate(
        note.text, (note.x, note.y), xytext=(0, 0), textcoords="offset points", fontsize=NOTE_FONT, zorder=7,
        path_effects=[withStroke(linewidth=2.5, foreground=axis.get_facecolor())], annotation_clip=False,
        arrowprops={"arrowstyle": "-", "color": note.color, "linewidth": 0.6, "shrinkA": 0, "shrinkB": 3},
    )  # fmt: skip


def _samples(start: Floats, end: Floats, count: int = 60) -> Floats:
    """Return evenly spaced points of a line, shape (count, 2), dense enough to show whether it crosses a text."""
    return np.linspace(start, end, count)


def _ink(axis: Axes) -> Floats:
    """Return dense samples of everything that is drawn, in pixels, shape (n, 2)."""
    from matplotlib.collections import LineCollection

    drawn = [np.asarray(line.get_xydata(), dtype=float) for line in axis.get_lines()]
    drawn += [
        np.asarray(part, dtype=float)
        for bars in axis.collections if isinstance(bars, LineCollection) for part in bars.get_segments()
    ]  # fmt: skip
    # The interval of a single pool is NaN.
    lines = [axis.transData.transform(points) for points in drawn if points.ndim == 2 and np.isfinite(points).all()]
    pieces = [_samples(start, end) for line in lines for start, end in pairwise(line)]
    return np.concatenate([*pieces, *lines, np.empty((0, 2))])
