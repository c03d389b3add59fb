"""The content of a person's page: the state as a drawing, the goal, and actions in words."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any

from planner import CostToGo

from ..drawing import Artist
from ..people.goals import Goals, first_of


class Pictures:
    """Drawings of any number of tasks. The class is thread-safe."""

    def __init__(self) -> None:
        self._artists: dict[int, Artist] = {}
        self._lock = threading.Lock()

    def artist(self, task: CostToGo | Goals) -> Artist:
        """Return the artist of a task; of several goals, it shows none.

        Raises
        ------
        ProfileError
            The domain's `drawing.toml` cannot be used.
        """
        known = first_of(task).task
        with self._lock:
            if id(known) not in self._artists:  # holds the task, so that its id is not reused
                self._artists[id(known)] = Artist(known, goal=not isinstance(task, Goals))
            return self._artists[id(known)]

    def words(self, task: CostToGo | Goals, actions: Sequence[str]) -> dict[str, str]:
        """Return actions in the words of the task's domain, as far as it has them."""
        artist = self.artist(task)
        return {action: artist.say(action) for action in actions if artist.has_words(action)}

    def of(self, task: CostToGo | Goals, state: int, actions: Sequence[str], width: int) -> dict[str, Any]:
        """Draw a state, about `width` pixels wide, and describe actions in words."""
        artist, values = self.artist(task), first_of(task).values([state])[0].tolist()
        with self._lock:
            picture = artist.draw(values, width=width, goal=False, theme=None)
            goal = artist.scene(values).goal
        return {
            "svg": picture.svg,
            "text": picture.text,
            "goal": [{"text": text, "done": done} for text, done in goal],
            "words": {action: artist.say(action) for action in actions},
        }
