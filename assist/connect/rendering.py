"""Pictures of environments: the state of each person's task, and the robot."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..drawing.frames import Frame, draw_frames
from ..drawing.picture import Artist
from ..drawing.raster import png, require


def draw_team(
    artist: Artist, done: Sequence[tuple[int, str]], finished: NDArray[np.bool_], robots: Sequence[int], step: int, *,
    as_svg: bool,
) -> Any:  # fmt: skip
    """Draw all tasks after a sequence of actions.

    Parameters
    ----------
    artist : Artist
        Of the task that all people do.
    done : sequence of (int, str)
        The person (0 to K - 1) and the ground action, in order.
    finished : bool array, shape (K,)
    robots : sequence of int
        The person whom each robot is with; any other number if it is with none.
    step : int
    as_svg : bool
        Return the text of an SVG document instead of an array of shape (height, width, 3).

    Raises
    ------
    MissingExtraError
        An array is asked for, and the extra `plots` is not installed.
    """
    rows = []
    for place, ended in enumerate(finished):
        actions = [action for at, action in done if at == place]
        values = artist.subject.follow(actions)[-1]
        last = "has finished" if ended else artist.say(actions[-1]) if actions else ""
        rows.append((Frame(tuple(values), f"person {place + 1}, step {step}", last, robot=place in robots),))
    (picture,) = draw_frames(artist, rows, theme="light")
    if as_svg:
        return picture.svg
    require(".gif")  # Pillow decodes the PNG
    from PIL import Image

    with Image.open(io.BytesIO(png(picture.svg, picture.width, 1.0))) as image:
        return np.array(image.convert("RGB"))
