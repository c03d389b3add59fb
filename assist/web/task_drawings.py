"""The content of a person's page: the state as a drawing, the goal, and actions in words."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any

from planner import CostToGo

from ..drawing import Artist


class Pictures:
    """Drawings of any number of tasks. The class is thread-safe."""

    def __init__(self) -> None:
        self._artists: dict[int, Artist] = {}
        self._lock = threading.Lock()

    def artist(self, task: CostToGo) -> Artist:
        """Return the artist of a task.

        Raises
        ------
        ProfileError
            The domain's `drawing.toml` cannot be used.
        """
        with self._lock:
            if id(task.task) not in self._artists:
                self._artists[id(task.task)] = Artist(task.task)  # holds the task, so that its id is not reused
            return self._artists[id(task.task)]

    def words(self, task: CostToGo, actions: Sequence[str]) -> dict[str, str]:
        """Return actions in the words of the task's domain, as far as it has them."""
        artist = self.artist(task)
        return {action: artist.say(action) for action in actions if artist.has_words(action)}

    def of(self, task: CostToGo, state: int, actions: Sequence[str], width: int) -> dict[str, Any]:
        """Draw a state, about `width` pixels wide, and describe actions in words."""
        artist, values = self.artist(task), task.values([state])[0].tolist()
        with self._lock:
            picture = artist.draw(values, width=width, goal=False, theme=None)
            goal = artist.scene(values).goal
        return {
            "svg": picture.svg,
            "text": picture.text,
            "goal": [{"text": text, "done": done} for text, done in goal],
            "words": {action: artist.say(action) for action in actions},
        }
