"""Files of drawings: SVG and HTML, and with the extra `plots` also PNG and GIF."""

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


def save(artist: Artist, rows: Sequence[Row], file: str | Path, *, width: float = WIDTH) -> int:
    """Write frames to a file, atomically, and return the number of steps.

    The suffix of the file decides the format. One frame becomes a picture. Several become a strip in SVG and PNG, and
    an animation in GIF and HTML. The HTML page loads no other files.

    Parameters
    ----------
    artist : Artist
    rows : list of tuple of Frame
        One row for each person, all of one length.
    file : path
        Its suffix is one of `FORMATS`.
    width : float
        Approximate width, in pixels.

    Raises
    ------
    MissingExtraError
        The format is PNG or GIF, and the extra `plots` is not installed.
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
    """Return a GIF of pictures of one size, which repeats without end.

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
    times = [1200] * (len(frames) - 1) + [3600]  # milliseconds; time to read two lines of text, and a pause at the end
    # Equal frames are kept, since each is a step.
    frames[0].save(written, "GIF", save_all=True, append_images=frames[1:], duration=times, loop=0, optimize=False)
    return written.getvalue()


def page(artist: Artist, pictures: Sequence[Picture]) -> str:
    """Return an HTML page that shows one picture at a time, with buttons, keys and automatic playback."""
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
