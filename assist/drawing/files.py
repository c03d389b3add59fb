"""Drawings as files: SVG and HTML as they are, PNG and GIF with the extra `plots`."""

from __future__ import annotations

import io
from collections.abc import Sequence
from html import escape
from pathlib import Path

from planner.system.files import atomic

from . import svg
from .frames import Row, draw_frames, draw_strip
from .picture import WIDTH, Artist, Picture
from .raster import png, require

FORMATS = (".svg", ".png", ".gif", ".html")
SECONDS = 1.2  # for each step of a GIF


def save(artist: Artist, rows: Sequence[Row], file: str | Path, *, width: float = WIDTH) -> int:
    """Write frames in the format that a file's name asks for, at once or not at all; give their number.

    One frame is a picture. More are a strip in SVG and PNG, an animation in GIF and HTML; the latter loads nothing from
    elsewhere.

    Parameters
    ----------
    artist : Artist
    rows : list of tuple of Frame
    file : path
    width : float
        About how wide it is to be, in pixels.

    Raises
    ------
    MissingExtraError
        PNG or GIF without the extra `plots`.
    """
    file = Path(file)
    require(file.suffix)
    pictures = [] if file.suffix in (".svg", ".png") else draw_frames(artist, rows, width=width, theme=_theme(file))
    if pictures:
        content = animation(pictures) if file.suffix == ".gif" else page(artist, pictures).encode()
    else:
        single = len(rows) == 1 and len(rows[0]) == 1
        theme = _theme(file) or "auto"
        picture = (
            artist.draw(rows[0][0].values, width=width, theme=theme)
            if single
            else draw_strip(artist, rows, width=width, theme=theme)
        )
        content = png(picture.svg, picture.width) if file.suffix == ".png" else picture.svg.encode()
    with atomic(file) as path:
        path.write_bytes(content)
    return len(rows[0])


def _theme(file: Path) -> svg.Theme | None:
    return {".svg": "auto", ".html": None}.get(file.suffix, "light")


def animation(pictures: Sequence[Picture]) -> bytes:
    """Make a GIF of pictures of one size; it begins again at its end.

    Raises
    ------
    MissingExtraError
        The extra `plots` is not installed.
    """
    require(".gif")
    from PIL import Image

    frames = [
        Image.open(io.BytesIO(png(picture.svg, picture.width, 1.0))).convert("P", palette=Image.Palette.ADAPTIVE)
        for picture in pictures
    ]
    written = io.BytesIO()
    times = [round(1000 * SECONDS)] * (len(frames) - 1) + [round(3000 * SECONDS)]
    # Frames that are equal are kept: each is a step.
    frames[0].save(written, "GIF", save_all=True, append_images=frames[1:], duration=times, loop=0, optimize=False)
    return written.getvalue()


def page(artist: Artist, pictures: Sequence[Picture]) -> str:
    """Make a page that shows pictures one after the other: by buttons, keys, or by itself."""
    folder = Path(__file__).parent
    steps = "\n".join(
        f'<figure class="step"{" hidden" * bool(number)}>{one.svg}<figcaption>{escape(one.text)}</figcaption></figure>'
        for number, one in enumerate(pictures)
    )
    values = {
        "title": escape(artist.subject.task.name), "steps": steps, "last": str(len(pictures) - 1),
        "style": svg.style(), "count": str(len(pictures)),
    }  # fmt: skip
    content = (folder / "film.html").read_text(encoding="utf-8")
    for name, value in values.items():
        content = content.replace(f"<!--{name}-->", value).replace(f"/*{name}*/", value)
    return content
