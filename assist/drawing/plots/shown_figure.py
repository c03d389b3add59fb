"""Figures that a notebook shows wherever they are the last value of a cell."""

from __future__ import annotations

from io import BytesIO

from matplotlib.figure import Figure


class ShownFigure(Figure):
    """A figure with a picture of its own. Notebooks show others only where `matplotlib.pyplot` was set up for them."""

    def _repr_png_(self) -> bytes:
        picture = BytesIO()
        self.savefig(picture, format="png", dpi=100)
        return picture.getvalue()
