"""Removal of what is recorded of a person from the records of a session, whose other people keep their course."""

from __future__ import annotations

from typing import Any

from .events import ERASED, VACANT, advised
from .store import Change


def without(person: str, label: str) -> Change:
    """Return a function that removes what is recorded of a person from a record and its answer.

    It is called for all records in order. The robot's course remains: where it went, and what it suggested to others.
    The person's place has the label.
    """
    time, here = 0.0, False

    def removed(record: dict[str, Any], answer: Any) -> tuple[dict[str, Any], Any]:
        nonlocal time, here
        advices = [_unnamed(one, person, label) for one in advised(record)]
        advice = {"advices": advices} if advices else {}
        record = record | advice
        if record.get("person") != person:
            time = record["time"]
            if answer is not None and "questions" in answer:
                answer = answer | {"questions": [one for one in answer["questions"] if one["person"] != person]}
            if answer is not None and "location" in answer and person in (answer["person"], answer["location"]):
                there = label if answer["location"] == person else answer["location"]
                answer = answer | {"location": there}
                if answer["person"] == person:
                    answer |= {"person": label, "suggestion": None, "reason": None}
            return record, answer
        # The time is that of the event before: the person's own times are theirs.
        kept: dict[str, Any] = {"n": record["n"], "time": time, "event": record["event"], "step": record["step"]}
        kept |= advice
        if not here:
            here, kept = True, kept | {"event": VACANT, "person": label, "task": record["task"]}
        elif record["event"] == "arrived":
            kept |= {"person": label} | ({"robot": record["robot"]} if "robot" in record else {})
        else:
            kept["event"] = ERASED
        return kept, None

    return removed


def _unnamed(advice: dict[str, Any], person: str, label: str) -> dict[str, Any]:
    """Return a recorded advice without what concerns a person; the label stands for them."""
    if "question" in advice and advice["question"]["person"] == person:
        advice = {name: value for name, value in advice.items() if name != "question"}
    if advice["person"] == person:
        advice = advice | {"person": label, "suggestion": None, "reason": None}
    return advice
