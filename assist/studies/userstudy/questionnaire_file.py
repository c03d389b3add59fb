"""Questionnaires in the file of a user study.

Keys of a questionnaire are the defaults of its items. An item may have another form than its questionnaire.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from planner.system.errors import expected as meant

from ...declare.catalogue import Catalogue
from ...declare.declared import shown
from ...declare.tables import convert, fault
from ..plan_tables import different
from .forms import FORMS, Item, Workload
from .questionnaires import BEFORE, END, Questionnaire, forms

NAME = re.compile(r"[A-Za-z][\w-]{0,40}")
ENDS = ("low", "high")
"""Labels of the ends, which points of agreement have unless others are given."""
DEFAULTS = frozenset({"required"}).union(*(one.keys for one in FORMS.values()))
"""Keys of items that a questionnaire may have for all of its items."""

Table = Mapping[str, Any]


def questionnaires_of(
    file: Path, tables: tuple[Table, ...], conditions: list[str], texts: Catalogue, *, within: bool
) -> tuple[Questionnaire, ...]:
    """Return the questionnaires of a study's file.

    Parameters
    ----------
    file : Path
    tables : tuple of mappings
        The tables of the file.
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
    places = [f"questionnaires[{number}]" for number in range(1, len(tables) + 1)]
    found = tuple(_questionnaire(file, place, table, texts) for place, table in zip(places, tables, strict=True))
    if found:
        different(file, "questionnaires", [one.name for one in found])
    for place, one in zip(places, found, strict=True):
        _check_conditions(file, place, one, conditions, within=within)
    return found


def _questionnaire(file: Path, place: str, table: Table, texts: Catalogue) -> Questionnaire:
    shared = {key: value for key, value in table.items() if key in DEFAULTS}
    convert({"name": "name", "text": "text", **shared}, Item, file, place)  # faults are in its own place
    own = {key: value for key, value in table.items() if key not in DEFAULTS}
    given = own.pop("items", None)
    found = convert(own, Questionnaire, file, place)
    base = forms(texts)[found.form]
    items = base.items
    if items and given is not None:
        raise fault(file, f"{place}.items", f"the form {found.form} has fixed items; expected none")
    if not items:
        if not isinstance(given, list) or not given or not all(isinstance(one, dict) for one in given):
            said = "is missing" if given is None else shown(given)
            raise fault(file, place, f"items: {said}; expected a list of tables with name and text")
        places = [f"{place}.items[{number}]" for number in range(1, len(given) + 1)]
        items = tuple(_item(file, *one, shared, found.form, texts) for one in zip(places, given, strict=True))
        used = {item.form for item in items}
        _refuse_unused(file, place, shared, {key for form in used for key in FORMS[form].keys}, ", ".join(sorted(used)))
    found = replace(
        found, name=found.name or base.name, title=found.title or base.title, items=items,
        introduction=found.introduction or base.introduction,
    )  # fmt: skip
    if not NAME.fullmatch(found.name):
        raise fault(file, f"{place}.name", f"'{found.name}'; expected a letter, then letters, digits, _ or -")
    for number, item in enumerate(items):
        if not NAME.fullmatch(item.name) or item.name in {other.name for other in items[:number]}:
            message = f"'{item.name}'; expected a unique name: a letter, then letters, digits, _ or -"
            raise fault(file, f"{place}.items[{number + 1}].name", message)
    return found


def _item(file: Path, place: str, own: Table, shared: Table, usual: str, texts: Catalogue) -> Item:
    """Return an item of a questionnaire, whose form and other keys are usual and shared."""
    form = own.get("form", usual)
    known = [one for one in FORMS if one != Workload.name]
    if form not in known:
        raise fault(file, f"{place}.form", f"{form!r}; {meant(str(form), known)}")
    kind = FORMS[form]
    _refuse_unused(file, place, own, kind.keys, form)
    words = {end: texts(f"form.{end}") for end in ENDS} if kind.is_ordinal else {}
    usable = {key: value for key, value in shared.items() if key == "required" or key in kind.keys}
    item = convert({"required": kind.required, **words, **usable, **own, "form": form}, Item, file, place)
    _check_item(file, place, item)
    return item


def _refuse_unused(file: Path, place: str, table: Table, known: Collection[str], form: str) -> None:
    """Refuse keys that have no meaning for a form."""
    for key in table:
        if key in DEFAULTS - {"required"} and key not in known:
            raise fault(file, f"{place}.{key}", f"not a key of the form {form}; expected none")


def _check_item(file: Path, place: str, item: Item) -> None:
    """Check the values of an item against each other."""
    wrong = item.kind.fault(item)
    if wrong is not None:
        raise fault(file, f"{place}.{wrong[0]}", wrong[1])
    if item.reversed and not item.kind.is_scale:
        raise fault(file, f"{place}.reversed", f"true; expected a likert item or a slider, not a {item.form}")
    if item.correct is not None:
        try:
            if not item.kind.has_right_answer:
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
