"""Questionnaires: items, valid answers and scores.

NASA-TLX consists of the six scales of Hart and Staveland, "Development of NASA-TLX" (1988), a work of the United States
government in the public domain. Answers range from 0 to 100 in steps of 5 and are not weighted ("raw TLX").
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

STEP = 5
"""Step of the scales of NASA-TLX."""


@dataclass(frozen=True)
class Item:
    """A question.

    Attributes
    ----------
    name : str
        Name in results.
    text : str
    low, high : str
        Labels of the ends of the item's own scale; empty: those of the questionnaire.
    reversed : bool
        Whether a high answer means a low score.
    """

    name: str
    text: str
    low: str = ""
    high: str = ""
    reversed: bool = False


@dataclass(frozen=True)
class Questionnaire:
    """A group of questions on one page.

    Attributes
    ----------
    name : str
        Name in results.
    form : str
        "nasa-tlx", "likert" or "text".
    title, introduction : str
    items : tuple of Item
    points : int
        Number of points of a Likert scale, which begins at 1.
    low, high : str
        Labels of the ends of the scale.
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
        """Return the answers in the order of the items.

        Raises
        ------
        ValueError
            An answer is missing, unknown or invalid.
        """
        known, most = {item.name for item in self.items}, 4000  # characters of a text, as in the page
        for name in answers:
            if name not in known:
                raise ValueError(f"answers.{name[:40]}: unknown; expected {', '.join(sorted(known))}")
        found: dict[str, int | str] = {}
        for item in self.items:
            answer = answers.get(item.name)
            if self.form == "text":
                if not isinstance(answer, str | None) or len(answer or "") > most:
                    raise ValueError(f"answers.{item.name}: expected a text of at most {most:,} characters")
                found[item.name] = answer or ""
                continue
            low, high, step = (0, 100, STEP) if self.form == "nasa-tlx" else (1, self.points, 1)
            if isinstance(answer, bool) or not isinstance(answer, int) or not low <= answer <= high or answer % step:
                steps = f" in steps of {step}" if step > 1 else ""
                raise ValueError(f"answers.{item.name}: expected a whole number from {low} to {high}{steps}")
            found[item.name] = answer
        return found

    def score(self, item: Item, answer: float) -> float:
        """Return the score of an answer; reversed items are recoded."""
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
        "nasa-tlx", "nasa-tlx", "Workload",
        "On each scale, mark the point that describes the task you have just done.", _TLX,
    ),
    "likert": Questionnaire("likert", "likert", "Your view", "How much do you agree with each statement?"),
    "text": Questionnaire("text", "text", "In your own words", "You may leave a field empty."),
}  # fmt: skip
"""Available forms. Forms without items take them from the study's file."""
