"""Questionnaires: items, their forms, valid answers and scores.

NASA-TLX consists of the six scales of Hart and Staveland, "Development of NASA-TLX" (1988), a work of the United States
government in the public domain. Answers range from 0 to 100 in steps of 5 and are not weighted ("raw TLX").
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, Strict

from ...declare.catalogue import Catalogue
from ...declare.declared import Expected, Number, Text, Truth, Whole, declared

STEP = 5
"""Step of the scales of NASA-TLX."""

CHOICE, CHOICES, NUMBER, SLIDER, TEXT, LIKERT, GRID, TLX = (
    "choice", "choices", "number", "slider", "text", "likert", "likert-grid", "nasa-tlx",
)  # fmt: skip
"""Forms of items: a choice or several, a number, a slider, words, points of agreement alone or in a grid, and a scale
of NASA-TLX."""

BEFORE, AFTER, END = "before", "after", "end"
"""When a questionnaire is shown: before practice, after the tasks of each condition, or once at the end."""

NO_TEXT = re.compile(r"[\x00\ud800-\udfff]")
"""Signs that files and other programs do not take as text: NUL, and halves of signs."""

Answer = int | float | str | list[str] | None


Points = Annotated[Whole, Field(ge=2, le=11), Expected("a whole number from 2 to 11")]
Words = Annotated[str, Strict(), Expected("a text")]
Several = Annotated[tuple[Text, ...], Expected("a list of texts")]
Correct = Annotated[Whole | Number | Text, Expected("an answer: a number or an option")]


@declared
class Item:
    """A question."""

    name: Annotated[Text, Field(description="Name in results.")]
    text: Annotated[Text, Field(description="The question.")]
    form: Annotated[Text, Field(description="The form of its answer; the questionnaire's unless given.")] = LIKERT
    required: Annotated[Truth, Field(description="Whether an answer is required; unless given, except in words.")] = (
        True
    )
    low: Annotated[Words, Field(description="Label of the lowest answer of a scale or slider.")] = ""
    high: Annotated[Words, Field(description="Label of the highest answer.")] = ""
    points: Annotated[Points, Field(description="Points of a Likert scale, which begins at 1.")] = 7
    labels: Annotated[Several, Field(description="A label for each point, if not only the ends have one.")] = ()
    min: Annotated[Number, Field(description="Smallest answer of a number or slider.")] = 0.0
    max: Annotated[Number, Field(description="Largest answer.")] = 100.0
    step: Annotated[Number, Field(description="Step between two answers.")] = 1.0
    options: Annotated[Several, Field(description="What can be chosen.")] = ()
    reversed: Annotated[Truth, Field(description="Whether a high answer means a low score.")] = False
    correct: Annotated[
        Correct | None, Field(description="The answer that an attention check asks for; it is part of no score.")
    ] = None
    conditions: Annotated[
        Several, Field(description="The conditions in which it is asked, and then part of no score; unless given, all.")
    ] = ()

    @property
    def ends(self) -> tuple[float, float, float]:
        """Smallest and largest number that can be answered, and the step between two numbers."""
        if self.form in (LIKERT, GRID):
            return 1, self.points, 1
        return self.min, self.max, self.step

    @property
    def is_scored(self) -> bool:
        """Whether the answer is a number that is part of the results; attention checks are not."""
        return self.form not in (CHOICE, CHOICES, TEXT) and self.correct is None

    def check(self, answer: Any, *, longest: int = 4000) -> Answer:
        """Return the answer. None, an empty text and an empty list mean that there is none.

        Parameters
        ----------
        answer : object
        longest : int
            Number of characters of an answer in words, as in the page.

        Raises
        ------
        ValueError
            The answer is invalid, or there is none to a required question; the message says what is expected.
        """
        if answer in (None, "", []) and not isinstance(answer, bool):
            if self.required:
                raise ValueError(f"expected {self._expected(longest)}")
            return [] if self.form == CHOICES else "" if self.form == TEXT else None
        if not self._is_valid(answer, longest):
            raise ValueError(f"expected {self._expected(longest)}")
        if self.form == CHOICES:
            return [option for option in self.options if option in answer]
        if self.form in (NUMBER, SLIDER) and float(answer).is_integer():
            return int(answer)
        found: Answer = answer
        return found

    def _is_valid(self, answer: Any, longest: int) -> bool:
        if self.form == TEXT:
            return isinstance(answer, str) and len(answer) <= longest and not NO_TEXT.search(answer)
        if self.form == CHOICE:
            return isinstance(answer, str) and answer in self.options
        if self.form == CHOICES:
            return (
                isinstance(answer, list)
                and all(isinstance(one, str) and one in self.options for one in answer)
                and len(set(answer)) == len(answer)
            )
        low, high, step = self.ends
        kinds = (int, float) if self.form in (NUMBER, SLIDER) else (int,)
        if isinstance(answer, bool) or not isinstance(answer, kinds) or not low <= answer <= high:
            return False
        steps = (answer - low) / step
        # Decimal steps such as 0.1 have no exact binary fraction.
        return math.isclose(steps, round(steps), rel_tol=0.0, abs_tol=1e-6)

    def _expected(self, longest: int) -> str:
        if self.form == TEXT:
            return f"a text of {'1 to' if self.required else 'at most'} {longest:,} characters"
        if self.form in (CHOICE, CHOICES):
            return f"{'one' if self.form == CHOICE else 'one or more'} of {', '.join(self.options)}"
        low, high, step = self.ends
        whole = all(float(one).is_integer() for one in (low, high, step))
        steps = f" in steps of {step:g}" if step != 1 else ""
        return f"a {'whole ' if whole else ''}number from {low:g} to {high:g}{steps}"

    def score(self, answer: Answer) -> float | None:
        """Return the score of an answer, recoded if the item is reversed; None if the answer is not a number."""
        if not isinstance(answer, int | float):
            return None
        low, high, _ = self.ends
        return low + high - answer if self.reversed else answer

    def passed(self, answer: Answer) -> bool | None:
        """Return whether an attention check was answered correctly; None for other items."""
        return None if self.correct is None else answer == self.correct


@declared
class Questionnaire:
    """A group of questions on one page."""

    form: Annotated[Text, Field(description="The form of the items that have none of their own.")]
    name: Annotated[Words, Field(description="Name in results; that of its form unless given.")] = ""
    title: Annotated[Words, Field(description="Title; that of its form unless given.")] = ""
    introduction: Annotated[Words, Field(description="What is above the items; that of its form unless given.")] = ""
    items: Annotated[tuple[Item, ...], Field(description="The questions; a form with fixed ones has none.")] = ()
    shuffle: Annotated[Truth, Field(description="Whether each participant sees the items in a random order.")] = False
    when: Annotated[
        Literal["before", "after", "end"],
        Field(description="Before practice, after the tasks of each condition, or once at the end."),
    ] = "after"
    conditions: Annotated[Several, Field(description="The conditions in which it is shown; unless given, all.")] = ()

    def shown(self, condition: str | None, seed: Sequence[int]) -> tuple[Item, ...]:
        """Return the items that a participant sees, in their order.

        Parameters
        ----------
        condition : str or None
            The participant's present condition; None: not assigned yet, or all.
        seed : sequence of int
            Seed of the order, different for each participant.
        """
        if self.conditions and condition not in self.conditions:
            return ()
        items = [item for item in self.items if not item.conditions or condition in item.conditions]
        if self.shuffle:
            items = [items[place] for place in np.random.default_rng(seed).permutation(len(items))]
        return tuple(items)

    def check(self, answers: Mapping[str, Any], shown: Sequence[Item] | None = None) -> dict[str, Answer]:
        """Return the answers to the items that were shown (default: all), in their order.

        Raises
        ------
        ValueError
            An answer is missing, unknown or invalid.
        """
        items = self.items if shown is None else shown
        known = {item.name for item in items}
        for name in answers:
            if name not in known:
                raise ValueError(f"answers.{name[:40]}: unknown; expected {', '.join(sorted(known))}")
        found: dict[str, Answer] = {}
        for item in items:
            try:
                found[item.name] = item.check(answers.get(item.name))
            except ValueError as error:
                raise ValueError(f"answers.{item.name}: {error}") from None
        return found

    @property
    def scale(self) -> tuple[Item, ...]:
        """The items whose mean is the questionnaire's score: those of its own form, if this is a scale.

        Items that are asked in some conditions only are left out, since means of different items cannot be compared.
        """
        if self.form not in (LIKERT, GRID, SLIDER, TLX):
            return ()
        own = tuple(item for item in self.items if item.form == self.form and item.is_scored and not item.conditions)
        return own if len({item.ends for item in own}) == 1 else ()

    def mean(self, scores: Mapping[str, float | None]) -> float | None:
        """Return the mean score of the answered items of the scale; None without any."""
        given = [score for item in self.scale if (score := scores.get(item.name)) is not None]
        return fmean(given) if given else None


SCALES = {
    "mental": ("low", "high"), "physical": ("low", "high"), "temporal": ("low", "high"),
    "performance": ("perfect", "failure"), "effort": ("low", "high"), "frustration": ("low", "high"),
}  # fmt: skip
"""Scales of NASA-TLX, with the keys of the labels of their ends."""


def forms(texts: Catalogue) -> dict[str, Questionnaire]:
    """Return the available forms, with default texts in a language.

    Forms without items take them from the study's file.

    Parameters
    ----------
    texts : Catalogue
    """

    def form(name: str, title: str, introduction: str = "", items: tuple[Item, ...] = ()) -> Questionnaire:
        key = f"form.{introduction}"
        return Questionnaire(name, name, texts(f"form.{title}"), texts(key) if introduction else "", items)

    tlx = tuple(
        Item(name, texts(f"tlx.{name}"), TLX, low=texts(f"tlx.{low}"), high=texts(f"tlx.{high}"), step=STEP)
        for name, (low, high) in SCALES.items()
    )
    found = (
        form(TLX, "workload", "workload_introduction", tlx), form(LIKERT, "view", "agreement"),
        form(GRID, "view", "agreement"), form(SLIDER, "view", "mark"), form(CHOICE, "about"), form(CHOICES, "about"),
        form(NUMBER, "about"), form(TEXT, "words", "words_introduction"),
    )  # fmt: skip
    return {one.name: one for one in found}
