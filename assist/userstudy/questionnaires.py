"""Questionnaires: their items, which answers are valid, and scores.

NASA-TLX is the six scales of Hart and Staveland, "Development of NASA-TLX" (1988), a work of the United States
government in the public domain, from 0 to 100 in steps of 5, without weights ("raw").
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

LONGEST = 4000
"""Signs of an answer in words."""

STEP = 5
"""Of NASA-TLX."""


@dataclass(frozen=True)
class Item:
    """A question.

    Attributes
    ----------
    name : str
        As in results.
    text : str
    low, high : str
        What the ends of its scale are called, where they are its own.
    reversed : bool
        Whether a high answer stands for a low score.
    """

    name: str
    text: str
    low: str = ""
    high: str = ""
    reversed: bool = False


@dataclass(frozen=True)
class Questionnaire:
    """Questions that are asked together.

    Attributes
    ----------
    name : str
        As in results.
    form : str
        "nasa-tlx", "likert" or "text".
    title, introduction : str
    items : tuple of Item
    points : int
        Of a Likert scale, which begins at 1.
    low, high : str
        What the ends of the scale are called.
    """

    name: str
    form: str
    title: str
    introduction: str
    items: tuple[Item, ...] = ()
    points: int = 7
    low: str = ""
    high: str = ""

    def check(self, answers: Mapping[str, Any]) -> dict[str, int | str]:
        """Give the answers in the order of the items.

        Raises
        ------
        ValueError
            An answer is missing, unknown or not valid.
        """
        known = {item.name for item in self.items}
        for name in answers:
            if name not in known:
                raise ValueError(f"answers.{name[:40]}: unknown; expected {', '.join(sorted(known))}")
        found: dict[str, int | str] = {}
        for item in self.items:
            answer = answers.get(item.name)
            if self.form == "text":
                if not isinstance(answer, str | None) or len(answer or "") > LONGEST:
                    raise ValueError(f"answers.{item.name}: expected a text of up to {LONGEST} signs")
                found[item.name] = answer or ""
                continue
            low, high, step = (0, 100, STEP) if self.form == "nasa-tlx" else (1, self.points, 1)
            if isinstance(answer, bool) or not isinstance(answer, int) or not low <= answer <= high or answer % step:
                steps = f" in steps of {step}" if step > 1 else ""
                raise ValueError(f"answers.{item.name}: expected a whole number from {low} to {high}{steps}")
            found[item.name] = answer
        return found

    def score(self, item: Item, answer: float) -> float:
        """Give what an answer counts, reversed items turned round."""
        if not item.reversed:
            return answer
        return (100 if self.form == "nasa-tlx" else self.points + 1) - answer


_TLX = (
    Item("mental", "How mentally demanding was the task?", "Very low", "Very high"),
    Item("physical", "How physically demanding was the task?", "Very low", "Very high"),
    Item("temporal", "How hurried or rushed was the pace of the task?", "Very low", "Very high"),
    Item("performance", "How successful were you in accomplishing what you were asked to do?", "Perfect", "Failure"),
    Item("effort", "How hard did you have to work to accomplish your level of performance?", "Very low", "Very high"),
    Item(
        "frustration", "How insecure, discouraged, irritated, stressed, and annoyed were you?", "Very low", "Very high"
    ),
)  # fmt: skip

FORMS = {
    "nasa-tlx": Questionnaire(
        "nasa-tlx", "nasa-tlx", "How the task was",
        "Mark the point on each scale that fits the task you have just done.", _TLX,
    ),
    "likert": Questionnaire("likert", "likert", "Your view", "How much do you agree with each statement?"),
    "text": Questionnaire("text", "text", "In your own words", "You may leave a field empty."),
}  # fmt: skip
"""What a file can name; forms without items have those of the file."""
