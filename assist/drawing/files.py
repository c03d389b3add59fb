"""Files of drawings: SVG and HTML, and with the extra `plots` also PNG and GIF."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from html import escape
from pathlib import Path

from planner.system.files import atomic

from . import svg
from .frames import Row, draw_frames, draw_strip
from .picture import WIDTH, Artist, Picture
from .raster import png, require

FORMATS = (".svg", ".png", ".gif", ".html")
SECONDS = 1.2  # of each step of an animation: time to read two lines of text


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
    step = round(1000 * SECONDS)
    times = [step] * (len(frames) - 1) + [3 * step]  # milliseconds, with a pause at the end
    # Equal frames are kept, since each is a step.
    frames[0].save(written, "GIF", save_all=True, append_images=frames[1:], duration=times, loop=0, optimize=False)
    return written.getvalue()


def page(artist: Artist, pictures: Sequence[Picture]) -> str:
    """Return an HTML page without a script that shows one picture at a time: by hand, by keys, or one after another."""
    count = len(pictures)
    choices, steps, rules = [], [], []
    for n, one in enumerate(pictures, start=1):
        first = " checked autofocus" * (n == 1)
        choices.append(
            f'<input type="radio" name="step" autocomplete="off" id="step-{n}" aria-label="{n} of {count}"{first}>'
        )
        turns = [
            f'<label class="turn" for="step-{other}">{words}</label>'
            for other, words in ((n - 1, "Back"), (n + 1, "Next"))
            if 1 <= other <= count
        ]
        said = f"<figcaption><b>{n} of {count}</b> {escape(one.text)}</figcaption>"
        steps.append(f'<figure class="step" id="picture-{n}">{one.svg}{said}{" ".join(turns)}</figure>')
        shown = f"main:has(#step-{n}:checked) #picture-{n} {{ visibility: visible; }}"
        rules.append(f"{shown} #picture-{n} {{ animation-delay: {(n - 1 - count) * SECONDS:.1f}s; }}")
    values = {
        "title": escape(artist.subject.task.name), "steps": "\n".join(steps), "choices": "\n".join(choices),
        "style": svg.style(), "rules": "\n".join(rules), "seconds": f"{count * SECONDS:.1f}",
        "share": f"{100 / count:.4f}",
    }  # fmt: skip
    content = Path(__file__).with_name("film.html").read_text(encoding="utf-8")
    return re.sub(r"<!--(\w+)-->|/\*(\w+)\*/", lambda place: values[place[1] or place[2]], content)
