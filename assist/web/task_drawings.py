"""The content of a person's page: the state as a drawing, the goal, and actions in words."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from typing import Any

from planner import CostToGo

from ..declare.catalogue import FIRST
from ..drawing import Artist
from ..people.goals import Goals, each_of, first_of
from ..people.hidden_type import several
from .schemas import Drawn, Wanted


class Pictures:
    """Drawings of any number of tasks. The class is thread-safe.

    Parameters
    ----------
    language : str
        Of drawings and words, as far as a domain has them; as in `catalogue`.
    """

    def __init__(self, language: str = FIRST) -> None:
        self.language = language
        self._artists: dict[tuple[int, str], Artist] = {}
        self._lock = threading.Lock()

    def artist(self, task: CostToGo | Goals, language: str | None = None) -> Artist:
        """Return the artist of a task, who speaks another language if it is given; of several goals, it shows none.

        Raises
        ------
        InputFileError
            The domain's `drawing.toml` cannot be used.
        """
        known = first_of(task).task
        key = id(known), language or self.language
        with self._lock:
            if key not in self._artists:  # holds the task, so that its id is not reused
                self._artists[key] = Artist(known, goal=not several(each_of(task)), language=key[1])
            return self._artists[key]

    def words(self, task: CostToGo | Goals, actions: Sequence[str], language: str) -> dict[str, str]:
        """Return actions in the words of the task's domain, as far as it has them."""
        artist = self.artist(task, language)
        return {action: artist.say(action) for action in actions if artist.has_words(action)}

    def of(self, task: CostToGo | Goals, state: int, seen: Mapping[str, Any], width: int) -> Drawn:
        """Draw the state of a person's view, about `width` pixels wide, and describe its actions in words."""
        artist, values = self.artist(task), first_of(task).values([state])[0].tolist()
        with self._lock:
            picture = artist.draw(values, width=width, goal=False, theme=None)
            goal = artist.scene(values).goal
        return Drawn(
            svg=picture.svg, text=picture.text, goal=tuple(Wanted(*one) for one in goal),
            words={action: artist.say(action) for action in seen["applicable"]}, language=artist.profile.language,
            seq=seen["seq"],
        )  # fmt: skip
