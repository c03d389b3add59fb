"""What somebody's page shows of their task: the state as a drawing, the goal, and actions in words."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any

from planner import CostToGo

from ..drawing import Artist


class Pictures:
    """Drawings of the tasks of a session; any thread may ask.

    Parameters
    ----------
    tasks : sequence of CostToGo

    Raises
    ------
    ProfileError
        A domain's `drawing.toml` cannot be used.
    """

    def __init__(self, tasks: Sequence[CostToGo]) -> None:
        self._artists = {id(task.task): Artist(task.task) for task in tasks}
        self._lock = threading.Lock()

    def of(self, task: CostToGo, state: int, actions: Sequence[str], width: int) -> dict[str, Any]:
        """Draw a state of one of the tasks, about as wide as given in pixels, and say actions in words."""
        artist, values = self._artists[id(task.task)], task.values([state])[0].tolist()
        with self._lock:
            picture = artist.draw(values, width=width, goal=False, theme=None)
            goal = artist.scene(values).goal
        return {
            "svg": picture.svg,
            "text": picture.text,
            "goal": [{"text": text, "done": done} for text, done in goal],
            "words": {action: artist.say(action) for action in actions},
        }
