"""Names of actions as people write them, and which ground action is meant.

An action is matched without regard to case, and brackets are optional. It may be given by its name and the first of
its arguments where exactly one applicable ground action begins so.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..people.choices import STAND_STILL

Words = tuple[str, ...]


def words_of(action: str, renamed: Mapping[str, str] | None = None) -> Words:
    """Split an action into its name and arguments, in lower case; brackets are optional."""
    words = action.lower().replace("(", " ").replace(")", " ").split()
    return ((renamed or {}).get(words[0], words[0]), *words[1:]) if words else ()


class UnmatchedError(ValueError):
    """Words that stand for no applicable action, or for several."""


class Matcher:
    """Finds the ground action that is meant."""

    def __init__(self, actions: Sequence[str]) -> None:
        self.actions = actions
        self.words = [tuple(action[1:-1].lower().split()) for action in actions]
        self.number = {words: number for number, words in enumerate(self.words)}
        self.beginnings = {words[:end] for words in self.words for end in range(1, len(words) + 1)}

    def slot(self, words: Words, options: NDArray[np.int32]) -> int:
        """Give the slot of the action that is meant among those that are applicable (ground actions, ascending)."""
        if not len(options):
            if words == (STAND_STILL[1:-1],):
                return 0
            raise UnmatchedError(f"{_shown(words)} is not applicable; here one can only stand still, {STAND_STILL}")
        number = self.number.get(words)
        if number is not None:
            slot = int(np.searchsorted(options, number))
            if slot < len(options) and options[slot] == number:
                return slot
        slots = [slot for slot, option in enumerate(options) if self.words[option][: len(words)] == words]
        if words and len(slots) == 1:
            return slots[0]
        if words and slots:
            several = ", ".join(self.actions[options[slot]] for slot in slots)
            raise UnmatchedError(f"{_shown(words)} may be any of {several}")
        why = self.unknown(words) or f"{_shown(words)} is not applicable here"
        raise UnmatchedError(f"{why}; {self._nearest(words, options)}")

    def unknown(self, words: Words) -> str | None:
        """Say why words stand for no action of the task, in whatever state; None if they may."""
        if not words:
            return "an empty action"
        if words in self.beginnings or words == (STAND_STILL[1:-1],):
            return None
        if words[:1] not in self.beginnings:
            return f"{_shown(words)}: no action of the task is called '{words[0]}'"
        return f"{_shown(words)} is no action of the task"

    def _nearest(self, words: Words, options: NDArray[np.int32]) -> str:
        """Name the applicable actions that are nearest in writing, three at the most."""
        applicable = [self.actions[option] for option in options]
        near = difflib.get_close_matches(_shown(words), applicable, n=3, cutoff=0.5) or applicable[:3]
        return f"nearest of the {len(applicable)} applicable: {', '.join(near)}"


def _shown(words: Words) -> str:
    return f"({' '.join(words)})"
