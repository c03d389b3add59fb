"""Questionnaires: items, valid answers and scores."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, Strict

from ...declare.catalogue import Catalogue
from ...declare.declared import Expected, Number, Text, Truth, Whole, declared
from .forms import FORMS, Answer, Form, Likert, Workload

STEP = 5
"""Step of the scales of NASA-TLX."""

BEFORE, AFTER, END = "before", "after", "end"
"""When a questionnaire is shown: before practice, after the tasks of each condition, or once at the end."""

Points = Annotated[Whole, Field(ge=2, le=11), Expected("a whole number from 2 to 11")]
Words = Annotated[str, Strict(), Expected("a text")]
Several = Annotated[tuple[Text, ...], Expected("a list of texts")]
Correct = Annotated[Whole | Number | Text, Expected("an answer: a number or an option")]


@declared
class Item:
    """A question."""

    name: Annotated[Text, Field(description="Name in results.")]
    text: Annotated[Text, Field(description="The question.")]
    form: Annotated[Text, Field(description="The form of its answer; the questionnaire's unless given.")] = Likert.name
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
    def kind(self) -> Form:
        """The form of its answer."""
        return FORMS[self.form]

    @property
    def ends(self) -> tuple[float, float, float]:
        """Smallest and largest number that can be answered, and the step between two numbers."""
        return self.kind.ends(self)

    @property
    def is_scored(self) -> bool:
        """Whether the answer is a number that is part of the results; attention checks are not."""
        return self.kind.is_number and self.correct is None

    def check(self, answer: Any) -> Answer:
        """Return the answer. None, an empty text and an empty list mean that there is none.

        Raises
        ------
        ValueError
            The answer is invalid, or there is none to a required question; the message says what is expected.
        """
        none = answer in (None, "", []) and not isinstance(answer, bool)
        if none and not self.required:
            return self.kind.empty
        if none or not self.kind.is_valid(self, answer):
            raise ValueError(f"expected {self.kind.expected(self)}")
        return self.kind.kept(self, answer)

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
        if not FORMS[self.form].is_scale:
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
    """Return a questionnaire of each form, with the usual texts in a language.

    Forms without items take them from the study's file.

    Parameters
    ----------
    texts : Catalogue
    """
    tlx = tuple(
        Item(name, texts(f"tlx.{name}"), Workload.name, low=texts(f"tlx.{low}"), high=texts(f"tlx.{high}"), step=STEP)
        for name, (low, high) in SCALES.items()
    )
    return {
        name: Questionnaire(
            name, name, texts(f"form.{one.title}"), texts(f"form.{one.introduction}") if one.introduction else "",
            tlx if name == Workload.name else (),
        )
        for name, one in FORMS.items()
    }  # fmt: skip
