"""Pictures of the planner's objects in notebooks: the function that `planner.system.results` finds."""

from __future__ import annotations

from planner import Plan, State, Task

from .drawn import draw
from .subject import Subject

MOST_OBJECTS = 200
"""Objects of a task that is drawn unasked, which takes less than a second; `draw` has no limit."""

MOST_FRAMES = 24
"""States of a plan that are drawn unasked; its actions are read instead."""


def svg_of(thing: object) -> str | None:
    """Return the SVG document of a task, a state or a plan; None where a line of text says more.

    A task is drawn as its initial state.
    """
    if not isinstance(thing, Task | State | Plan):
        return None
    task = thing if isinstance(thing, Task) else thing.task
    try:
        if len(Subject.of(task).objects) > MOST_OBJECTS or (isinstance(thing, Plan) and len(thing) >= MOST_FRAMES):
            return None
        return draw(thing).svg
    except ValueError:
        return None
