"""Questionnaires: items, valid answers and scores."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from ...declare.catalogue import Catalogue
from ...declare.declared import Truth, declared
from .forms import FORMS, Answer, FormName, Item, Several, Words, Workload

STEP = 5
"""Step of the scales of NASA-TLX."""

BEFORE, AFTER, END = "before", "after", "end"
"""When a questionnaire is shown: before practice, after the tasks of each condition, or once at the end."""


@declared
class Questionnaire:
    """A group of questions on one page."""

    form: Annotated[FormName, Field(description="The form of the items that have none of their own.")]
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
