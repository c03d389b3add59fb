"""`draw`: a state or a plan as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from math import isinf
from typing import TYPE_CHECKING

from planner import Plan, State

from .frames import draw_strip, plan_frames
from .picture import WIDTH, Artist, Picture

if TYPE_CHECKING:
    from planner import AnyTask


def draw(task: AnyTask | State | Plan, values: Sequence[int] | None = None, *, width: float = WIDTH) -> Picture:
    """Draw a state of a task, or a plan as a strip of its states.

    Of a `State`, the picture says whether it is a dead end.

    Parameters
    ----------
    task : Task, or whatever `planner.load` takes, State or Plan
    values : sequence of int, shape (variables,), optional
        The state; unless given, the initial one, or the `State` itself.
    width : float
        Approximate width of the picture, in pixels.

    Raises
    ------
    InputFileError
        The domain's `drawing.toml` is invalid.
    """
    if isinstance(task, Plan):
        artist = Artist(task.task)
        return draw_strip(artist, plan_frames(artist, task, task.start), width=width)
    if isinstance(task, State) and values is None:
        return Artist(task.task).draw(task.values, width=width, lost=isinf(task.h))
    return Artist(task).draw(values, width=width)
