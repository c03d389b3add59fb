"""Matching of action names, as people and programs write them, to ground actions.

`(fetch box-a)` and `fetch box-a` are PDDL notation; `fetch(box-a)` and `place(hammer, slot-1)` are the notation of
unified-planning and others. Case does not matter. The last arguments may be omitted if exactly one applicable ground
action matches.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from planner.system.errors import nearest

from ..declare.refusals import Refusal
from .choices import STAND_STILL

Words = tuple[str, ...]


FORMS = re.compile(r"\((?P<inner>[^()]*)\)|(?P<name>[^\s(),]+)\s*\((?P<arguments>[^()]*)\)|(?P<plain>[^()]*)")
"""Pattern of (name argument ...), name(argument, ...) and name argument ..."""


def unmatched(why: str) -> Refusal:
    """Return the refusal of words that match no action or fact, or several."""
    return Refusal("other", why=why)


def words_of(action: str, renamed: Mapping[str, str] | None = None) -> Words:
    """Return an action's name and arguments, in lower case.

    Parameters
    ----------
    action : str
        As `(name argument ...)`, `name(argument, ...)` or `name argument ...`.
    renamed : mapping of str to str, optional
        Name in the task for names that differ from it.

    Raises
    ------
    Refusal
        The brackets are not those of one action.
    """
    found = FORMS.fullmatch(action.strip())
    if found is None:
        raise unmatched(f"{action} {wrong_form(action)}")
    words = re.split(r"[\s,]+", " ".join(filter(None, found.groups())).lower().strip(" ,"))
    return ((renamed or {}).get(words[0], words[0]), *words[1:]) if words[0] else ()


def in_pddl(action: str) -> str:
    """Return an action in PDDL notation, in lower case; as it is if it has another form than those of `words_of`."""
    try:
        return f"({' '.join(words_of(action))})"
    except Refusal:
        return action


def wrong_form(action: str) -> str | None:
    """Return what is wrong with the brackets of an action; None if they are right."""
    if FORMS.fullmatch(action.strip()):
        return None
    opened, closed = action.count("("), action.count(")")
    wrong = "has brackets in the wrong places" if opened == closed else f"opens {opened} and closes {closed} brackets"
    return f"{wrong}; expected (name argument ...) or name(argument, ...)"


class Matcher:
    """Finds the ground action that matches some words."""

    def __init__(self, actions: Sequence[str]) -> None:
        self.actions = actions
        self.words = [tuple(action[1:-1].lower().split()) for action in actions]
        self.number: dict[Words, int] = {}  # the first one of a name, since the others have other costs only
        for number, words in enumerate(self.words):
            self.number.setdefault(words, number)
        self.objects = {word for words in self.words for word in words[1:]}
        self.beginnings = {words[:end] for words in self.words for end in range(1, len(words) + 1)}

    def slot(self, words: Words, options: NDArray[np.int32]) -> int:
        """Return the slot of the matching action among the applicable ones (ground actions, ascending)."""
        if not len(options):
            if words == (STAND_STILL[1:-1],):
                return 0
            raise unmatched(f"{_shown(words)} is not applicable; a person can only wait here, {STAND_STILL}")
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
            raise unmatched(f"{_shown(words)} may be any of {several}")
        near = self._nearest(words, options)
        why = self.unknown(words)
        if why is None:
            raise unmatched(f"{_shown(words)} is not applicable here; nearest in spelling {near}")
        meant = self.meant(words)
        if meant is not None and all(self.words[option][: len(meant)] != meant for option in options):
            near = f"of all actions: {_shown(meant)}; {near}"
        raise unmatched(f"{why}; nearest in spelling {near}")

    def unknown(self, words: Words) -> str | None:
        """Return why words match no action of the task in any state; None if they may match one."""
        if not words:
            return "an empty action"
        if words in self.beginnings or words == (STAND_STILL[1:-1],):
            return None
        without = "; actions that can never be done, or never change anything, are left out"
        if words[:1] not in self.beginnings:
            why = "" if nearest(words[0], {known[0] for known in self.words}) else without
            return f"{_shown(words)}: no action of the task is called '{words[0]}'{why}"
        why = "" if set(words[1:]) - self.objects else without
        return f"{_shown(words)} is no action of the task{why}"

    def meant(self, words: Words) -> Words | None:
        """Return the words of an action of the task that are the most similar ones; None if there is none."""
        names = {words[0] for words in self.words}
        near = [nearest(word, self.objects if place else names) for place, word in enumerate(words)]
        found = tuple(word for word in near if word is not None)
        return found if len(found) == len(words) and found in self.beginnings else None

    def _nearest(self, words: Words, options: NDArray[np.int32]) -> str:
        """Return up to three applicable actions of similar spelling."""
        applicable = [self.actions[option] for option in options]
        near = difflib.get_close_matches(_shown(words), applicable, n=3, cutoff=0.5) or applicable[:3]
        return f"of the {len(applicable)} applicable: {', '.join(near)}"


def _shown(words: Words) -> str:
    return f"({' '.join(words)})"
