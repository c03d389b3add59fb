"""Export of a study's data as a ZIP file: tables, a data dictionary, logs for `fit`, the study's file, versions."""

from __future__ import annotations

import io
import json
import platform
import zipfile
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

from .csv_tables import written
from .plan_file import read
from .session import JOURNAL, PLAN
from .tables import COLUMNS, tables

REGISTERED = "preregistration.json"
"""The study's registration in its folder, if there is one."""


def files(folder: Path) -> Iterator[tuple[str, str]]:
    """Yield the name and content of every file of an export."""
    study = read(folder / PLAN, carried_out=True)
    found = tables(study, folder / JOURNAL)
    for name in COLUMNS:
        yield f"{name}.csv", found.csv(name)
    meanings = (
        {"table": table, "column": name, "meaning": column.about}
        for table, columns in COLUMNS.items()
        for name, column in columns.items()
    )
    yield "dictionary.csv", written(("table", "column", "meaning"), meanings)
    items = (
        {
            "questionnaire": one.name, "item": item.name, "form": item.form, "text": item.text,
            "options": "\n".join(item.options), "required": item.required, "reversed": item.reversed,
            "correct": item.correct, "conditions": ", ".join(item.conditions or one.conditions),
        }
        for one in study.questionnaires
        for item in one.items
    )  # fmt: skip
    columns = ("questionnaire", "item", "form", "text", "options", "required", "reversed", "correct", "conditions")
    yield "items.csv", written(columns, items)
    for task, log in found.logs():
        yield f"log-{task}.jsonl", log
    if (folder / REGISTERED).exists():
        yield REGISTERED, (folder / REGISTERED).read_text(encoding="utf-8")
    versions = {"kitassist": metadata.version("kitassist"), "python": platform.python_version()}
    yield "versions.json", json.dumps(versions) + "\n"
    yield PLAN, (folder / PLAN).read_text(encoding="utf-8")


def archive(folder: Path) -> bytes:
    """Return an export as a ZIP file."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, text in files(folder):
            packed.writestr(name, text)
    return content.getvalue()
