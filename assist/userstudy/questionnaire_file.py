"""Questionnaires in the file of a user study: the only place where they are validated.

Keys of a questionnaire are the defaults of its items. An item may have another form than its questionnaire.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from planner.system.errors import expected as meant

from ..declare.declared import Expected, Number, Text, Texts, Truth, Whole, declared, shown
from ..declare.tables import fault
from ..texts.catalogue import Catalogue
from .questionnaires import (
    AFTER,
    BEFORE,
    CHOICE,
    CHOICES,
    END,
    GRID,
    LIKERT,
    NUMBER,
    SLIDER,
    TEXT,
    TLX,
    Item,
    Questionnaire,
    forms,
)

Points = Annotated[Whole, Field(ge=2, le=11), Expected("a whole number from 2 to 11")]
Correct = Annotated[Whole | Number | Text, Expected("an answer: a number or an option")]
NAME = re.compile(r"[A-Za-z][\w-]{0,40}")
SCALE, LIMITS = {"low", "high"}, {"min", "max", "step"}
KEYS = {
    LIKERT: {"points", "labels", *SCALE}, GRID: {"points", "labels", *SCALE}, SLIDER: SCALE | LIMITS, NUMBER: LIMITS,
    CHOICE: {"options"}, CHOICES: {"options"}, TEXT: set[str](), TLX: set[str](),
}  # fmt: skip
"""Keys of the forms of items, in addition to those of all forms."""


@declared(kw_only=True)
class _Form:
    """Keys that an item may have, and that a questionnaire may have as defaults for its items."""

    required: Truth | None = None
    points: Points | None = None
    low: Text | None = None
    high: Text | None = None
    labels: Texts | None = None
    min: Number | None = None
    max: Number | None = None
    step: Number | None = None
    options: Texts | None = None


@declared(kw_only=True)
class ItemTable(_Form):
    """A table of a questionnaire's `items`."""

    name: Text
    text: Text
    form: Text | None = None
    reversed: Truth = False
    correct: Correct | None = None
    conditions: Texts | None = None


@declared(kw_only=True)
class QuestionnaireTable(_Form):
    """A table of `questionnaires`."""

    form: Text
    name: Text | None = None
    title: Text | None = None
    introduction: Text | None = None
    items: tuple[ItemTable, ...] | None = None
    shuffle: Truth = False
    when: Text = AFTER
    conditions: Texts | None = None


def questionnaires_of(
    file: Path, tables: tuple[QuestionnaireTable, ...], conditions: list[str], texts: Catalogue, *, within: bool
) -> tuple[Questionnaire, ...]:
    """Return the questionnaires of a study's file.

    Parameters
    ----------
    file : Path
    tables : tuple of QuestionnaireTable
    conditions : list of str
        Names of the study's conditions.
    texts : Catalogue
        Default texts.
    within : bool
        Whether each participant has all conditions.

    Raises
    ------
    InputFileError
        A table is invalid; the message names its place and what would be right.
    """
    found: list[Questionnaire] = []
    for number, table in enumerate(tables, start=1):
        place = f"questionnaires[{number}]"
        one = _questionnaire(file, place, table, texts)
        if one.name in {other.name for other in found}:
            raise fault(file, place, f"there are two questionnaires '{one.name}'; expected different names")
        _check_conditions(file, place, one, conditions, within=within)
        found.append(one)
    return tuple(found)


def _questionnaire(file: Path, place: str, table: QuestionnaireTable, texts: Catalogue) -> Questionnaire:
    if table.form not in KEYS:
        raise fault(file, f"{place}.form", f"'{table.form}'; {meant(table.form, KEYS)}")
    base = forms(texts)[table.form]
    name = table.name or base.name
    if not NAME.fullmatch(name):
        raise fault(file, f"{place}.name", f"'{name}'; expected a letter, then letters, digits, _ or -")
    if table.when not in (BEFORE, AFTER, END):
        raise fault(file, f"{place}.when", f"'{table.when}'; {meant(table.when, (BEFORE, AFTER, END))}")
    items = base.items
    if base.items and table.items is not None:
        raise fault(file, f"{place}.items", f"the form {table.form} has fixed items; expected none")
    if not base.items:
        if not table.items:
            raise fault(file, place, "items: is missing; expected a list of tables with name and text")
        used = {own.form or table.form for own in table.items} & set(KEYS)
        _refuse_unused(file, place, table, set().union(*(KEYS[form] for form in used)), ", ".join(sorted(used)))
        items = tuple(
            _item(file, f"{place}.items[{number}]", own, table, texts)
            for number, own in enumerate(table.items, start=1)
        )
    for number, item in enumerate(items):
        if not NAME.fullmatch(item.name) or item.name in {other.name for other in items[:number]}:
            message = f"'{item.name}'; expected a unique name: a letter, then letters, digits, _ or -"
            raise fault(file, f"{place}.items[{number + 1}].name", message)
    return replace(
        base, name=name, title=table.title or base.title, introduction=table.introduction or base.introduction,
        items=items, shuffle=table.shuffle, when=table.when, conditions=table.conditions or (),
    )  # fmt: skip


def _item(file: Path, place: str, own: ItemTable, table: QuestionnaireTable, texts: Catalogue) -> Item:
    form = own.form or table.form
    if form not in KEYS or form == TLX:
        known = [one for one in KEYS if one != TLX]
        raise fault(file, f"{place}.form", f"'{form}'; {meant(form, known)}")
    _refuse_unused(file, place, own, KEYS[form], form)

    def given(key: str, otherwise: Any) -> Any:
        """Return the item's value, or the questionnaire's where it belongs to this form, or the default."""
        for one in (own, table):
            if (value := getattr(one, key)) is not None and (key == "required" or key in KEYS[form]):
                return value
        return otherwise

    agree = form in (LIKERT, GRID)
    item = Item(
        own.name, own.text, form, given("required", form != TEXT),
        given("low", texts("form.low") if agree else ""), given("high", texts("form.high") if agree else ""),
        given("points", 7), given("labels", ()), given("min", 0.0), given("max", 100.0), given("step", 1.0),
        given("options", ()), own.reversed, own.correct, own.conditions or (),
    )  # fmt: skip
    _check_item(file, place, item)
    return item


def _refuse_unused(file: Path, place: str, table: _Form, known: set[str], form: str) -> None:
    """Refuse keys that have no meaning for a form."""
    for key in KEYS[LIKERT] | KEYS[SLIDER] | KEYS[CHOICE]:
        if key not in known and getattr(table, key) is not None:
            raise fault(file, f"{place}.{key}", f"not a key of the form {form}; expected none")


def _check_item(file: Path, place: str, item: Item) -> None:
    """Check the values of an item against each other."""
    low, high, step = item.ends
    for key, value, is_right, right in (
        ("max", high, math.isfinite(high) and low < high, f"a number above min ({low:g})"),
        ("step", step, 0 < step <= high - low, "a number above 0, and at most max - min"),
    ):
        if not is_right:
            raise fault(file, f"{place}.{key}", f"{value:g}; expected {right}")
    if item.labels and len(item.labels) != item.points:
        message = f"{len(item.labels)} labels; expected one for each of {item.points} points"
        raise fault(file, f"{place}.labels", message)
    if item.form in (CHOICE, CHOICES) and (len(item.options) < 2 or len(set(item.options)) < len(item.options)):
        raise fault(file, place, f"options: {shown(item.options)}; expected two or more different texts")
    if item.reversed and item.form not in (LIKERT, GRID, SLIDER):
        raise fault(file, f"{place}.reversed", f"true; expected a likert item or a slider, not a {item.form}")
    if item.correct is not None:
        try:
            if item.form in (CHOICES, TEXT):
                raise ValueError(f"no answer to a question of the form {item.form}")
            item.check(item.correct)
        except ValueError as error:
            text = str(error).removeprefix("expected ")
            raise fault(file, f"{place}.correct", f"{shown(item.correct)}; expected {text}") from None


def _check_conditions(file: Path, place: str, one: Questionnaire, known: list[str], *, within: bool) -> None:
    """Check that the named conditions exist, and are assigned when the questionnaire is shown."""
    parts: Mapping[str, tuple[str, ...]] = {
        f"{place}.conditions": one.conditions,
        **{f"{place}.items[{number}].conditions": item.conditions for number, item in enumerate(one.items, start=1)},
    }
    for where, names in parts.items():
        for name in names:
            if name not in known:
                raise fault(file, where, f"'{name}'; {meant(name, known)}")
        if names and (one.when == BEFORE or (one.when == END and within)):
            raise fault(file, where, f"expected none, since no single condition is given {one.when!r}")
