"""The events of a live session, as reported, and the records of them that are stored."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

FIELDS: Mapping[str, type | tuple[type, ...]] = {
    "n": int, "time": (int, float), "event": str, "step": int, "person": str, "task": str, "id": str, "action": str,
    "followed": bool, "unheard": bool, "advices": list, "robot": int, "belief": list,
    "distance": list, "likelihoods": dict, "missed": (int, float), "answer": (str, bool),
}  # fmt: skip
"""Fields of an event's record, and their types."""

BY_PEOPLE = frozenset({"joined", "left", "began", "acted", "undone", "answered", "retracted"})
"""Kinds of events of one person."""

KINDS = BY_PEOPLE | {"arrived", "elapsed", "paused", "resumed", "rearranged"}
"""Kinds of events that can be reported."""

LONGEST_REASON = 200
"""Number of characters of a reason for an erasure, a withdrawal or an exclusion; more would invite personal data."""

VACANT, ERASED = "vacant", "erased"
"""Kinds of records in place of a person's first event and of the later ones, after their records were erased."""

LONGEST_NAME = 64
"""Number of characters of a name, which is part of addresses of pages."""

BETWEEN_LETTERS = frozenset(" .-_'\u2019\u05f3\u00b7")
"""Signs of names besides letters, marks and digits: among others apostrophes, also typographic and Hebrew ones."""

JOINERS = frozenset("\u200c\u200d")
"""Invisible signs that some scripts need within words: behind a mark, as in Sinhala, or an Arabic letter."""


def name_of(text: str) -> str:
    """Return a name without blanks around it and in its composed form (NFC), so that it is the same for all."""
    return unicodedata.normalize("NFC", text).strip()


def is_name(text: str) -> bool:
    """Whether this is a valid name, in any script, as `name_of` returns it."""
    if not 0 < len(text) <= LONGEST_NAME or text.strip(" .") != text:
        return False
    for before, sign in zip(f" {text}", text, strict=False):
        if sign in JOINERS:
            if unicodedata.category(before) != "Mn" and unicodedata.bidirectional(before) != "AL":
                return False
        elif unicodedata.category(sign)[0] not in "LMN" and sign not in BETWEEN_LETTERS:
            return False
    return any(unicodedata.category(sign)[0] in "LN" for sign in text)


@dataclass(frozen=True)
class Event:
    """An event, as reported.

    Attributes
    ----------
    kind : str
        "joined", "left", "began", "acted", "undone", "answered", "retracted", "arrived", "elapsed", "paused", "resumed"
        or "rearranged".
    person : str or None
        The person who acted, joined or left, or at whom the robot has arrived, as `name_of` returns it; None for other
        events.
    action : str or None
        The action, in PDDL notation.
    followed : bool or None
        Whether the suggestion was followed; None if it is not reported.
    seen : int or None
        The `seq` of the view on which the person acted or answered; they have not seen a later suggestion or question.
    task : str or None
        The task of a person who joins or begins.
    id : str or None
        The client's id: a repeated event with this id has no effect, and gets the first answer.
    robot : int
        Number of the robot that has arrived, from 1.
    belief : tuple of float or None
        The belief about a person who joins for the first time, from an earlier session, flattened; None for the prior.
    distance : tuple of tuple of float or None
        The distances after people's places were rearranged.
    likelihoods : mapping of str to float, or None
    missed : float or None
        What is known of an action that was not seen as it is, as in `Assistant.observe`.
    answer : str, bool or None
        The answer to a question, as in `Assistant.answer`.
    stage : str or None
        In a user study, the stage that a participant completes, or at which they acted; another tab may be further.
    """

    kind: str
    person: str | None = None
    action: str | None = None
    followed: bool | None = None
    seen: int | None = None
    task: str | None = None
    id: str | None = None
    robot: int = 1
    belief: tuple[float, ...] | None = None
    distance: tuple[tuple[float, ...], ...] | None = None
    likelihoods: Mapping[str, float] | None = field(default=None, hash=False)
    missed: float | None = None
    answer: str | bool | None = None
    stage: str | None = None

    def __post_init__(self) -> None:
        if self.person is not None:
            object.__setattr__(self, "person", name_of(self.person))


def advised(record: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the advice of each robot in a record; empty if it has none, as it is then the same as before."""
    found: list[dict[str, Any]] = record.get("advices", [])
    return found


def require_record(record: Mapping[str, Any]) -> None:
    """Check a record of an event.

    Raises
    ------
    ValueError
        A field is missing, unknown, or of the wrong type.
    """
    for name, value in record.items():
        expected = FIELDS.get(name, ())
        truth = expected is bool or (isinstance(expected, tuple) and bool in expected)
        if not isinstance(value, expected) or (isinstance(value, bool) and not truth):
            raise ValueError(f"'{name[:40]}' is {str(value)[:40]!r}")
    if missing := [name for name in ("n", "time", "event", "step") if name not in record]:
        raise ValueError(f"there is no '{missing[0]}'")
    kind = record["event"]
    if kind not in (*KINDS, VACANT, ERASED) or not math.isfinite(record["time"]):
        raise ValueError(f"event {kind[:40]!r} at time {record['time']}; expected one of {', '.join(sorted(KINDS))}")
    needed = {"person": kind in (*BY_PEOPLE, VACANT), "task": kind == VACANT}
    needed["action"] = kind == "acted" and "likelihoods" not in record and "missed" not in record
    needed["distance"] = kind == "rearranged"
    if missing := [name for name, so in needed.items() if so and name not in record]:
        raise ValueError(f"there is no '{missing[0]}'")
