"""SVG drawings as pixels, with the extra `plots`."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from planner.system.errors import MissingExtraError

SCALE = 1.5  # pixels of a PNG for each of the drawing


def require(suffix: str) -> None:
    """Check that a format can be written.

    Raises
    ------
    MissingExtraError
    """
    needed = {".png": ("resvg_py", "matplotlib"), ".gif": ("resvg_py", "matplotlib", "PIL")}.get(suffix, ())
    for package in needed:
        if importlib.util.find_spec(package) is None:
            raise MissingExtraError(f"{suffix} files need", package, "plots")


def png(svg: str, width: float, scale: float = SCALE) -> bytes:
    """Return the PNG of an SVG document that was drawn for one theme.

    Parameters
    ----------
    svg : str
    width : float
        Its natural width, in pixels.
    scale : float
        Pixels of the PNG for each of these.

    Raises
    ------
    MissingExtraError
        The extra `plots` is not installed.
    """
    require(".png")
    import resvg_py
    from matplotlib import get_data_path

    fonts = [str(Path(get_data_path()) / "fonts" / "ttf" / f"DejaVuSans{kind}.ttf") for kind in ("", "-Bold")]
    return bytes(
        resvg_py.svg_to_bytes(svg_string=svg, font_files=fonts, skip_system_fonts=True, width=round(width * scale))
    )
