"""What can happen in a user study: the events of participants, and what researchers do about them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..live.events import Event

KINDS = {"visited", "onward", "acted", "elapsed", "expired", "withdrew", "left", "returned", "excluded"}
"""Kinds of events."""


@dataclass(frozen=True)
class StudyEvent(Event):
    """An event of a participant.

    Attributes
    ----------
    answers : mapping of str, or None
        Answers, if the stage is a questionnaire.
    simulated : bool
        Whether a new participant is simulated.
    reason : str or None
        Why the researchers exclude the participant from the analysis; None includes the participant again.
    late : bool
        Whether the researchers withdraw the data, which they may do after the study's last day for withdrawals.
    """

    answers: Mapping[str, Any] | None = None
    simulated: bool = False
    reason: str | None = None
    late: bool = False
