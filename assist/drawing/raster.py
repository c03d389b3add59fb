"""Conversion of SVG to PNG, with the extra `plots`."""

from __future__ import annotations

from pathlib import Path

from planner.system.errors import require_package


def require(suffix: str) -> None:
    """Check that the packages for a file format are installed.

    Raises
    ------
    MissingExtraError
        A package is missing.
    """
    needed = {".png": ("resvg_py", "matplotlib"), ".gif": ("resvg_py", "matplotlib", "PIL")}.get(suffix, ())
    for package in needed:
        require_package(f"{suffix} files need", package, "plots")


def png(svg: str, width: float, scale: float = 1.5) -> bytes:
    """Return the PNG of an SVG document with fixed colours (theme "light" or "dark").

    Parameters
    ----------
    svg : str
    width : float
        Natural width of the document, in pixels.
    scale : float
        Pixels of the PNG per pixel of the document. At the default text is sharp on common screens.

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
