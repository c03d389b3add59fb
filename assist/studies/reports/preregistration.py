"""Preregistration of a user study: a record, made before the first participant, of its file and of the analysis code.

The report compares it with the study that was carried out. The digests are those of `sha256sum`, so that anyone can
check them.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from planner.system.errors import InputFileError
from planner.system.files import atomic, read_json

from ...declare.catalogue import catalogue
from ..userstudy.export import REGISTERED
from ..userstudy.plan import UserStudy
from ..userstudy.plan_file import first_difference
from ..userstudy.session import JOURNAL
from ..userstudy.tables import Tables

PACKAGE = Path(__file__).parents[2]
ANALYSIS = (
    "learning/intervals.py", "studies/statistics.py", "studies/repeated_measures.py", "studies/userstudy/*.py",
    "studies/reports/userstudy_*.py", "studies/reports/wording.py",
)  # fmt: skip
"""Files of the package on which a report may depend, as patterns."""


def analysis_digests() -> dict[str, str]:
    """Return the SHA-256 digest of each file of the analysis."""
    files = sorted(file for pattern in ANALYSIS for file in PACKAGE.glob(pattern))
    return {str(file.relative_to(PACKAGE)): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def register(study: UserStudy, folder: Path) -> dict[str, Any]:
    """Write the record of a study into its folder, and return it.

    Parameters
    ----------
    study : UserStudy
    folder : Path
        Folder in which the study will be saved.

    Raises
    ------
    InputFileError
        As in `require_new`.
    """
    require_new(folder)
    record = {
        "format": "kitassist preregistration 1", "registered": datetime.now(UTC).isoformat(timespec="seconds"),
        "version": metadata.version("kitassist"), "study": hashlib.sha256(study.file.read_bytes()).hexdigest(),
        "text": study.file.read_text(encoding="utf-8"),
        "analysis": analysis_digests(), "confirmatory": list(study.confirmatory), "reference": study.reference,
        "participants": study.participants, "exclude_failed_checks": study.exclude_failed_checks,
    }  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    with atomic(folder / REGISTERED) as path:
        path.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return record


def unregister(folder: Path) -> None:
    """Delete the record of a study that cannot be carried out, and its folder if that is empty then.

    The record stays once the study has begun.
    """
    if not (folder / JOURNAL).exists():
        (folder / REGISTERED).unlink(missing_ok=True)
        with suppress(OSError):
            folder.rmdir()


def require_new(folder: Path) -> None:
    """Check that a folder has neither a study that has begun nor a registration.

    Raises
    ------
    InputFileError
    """
    if (folder / JOURNAL).exists():
        raise InputFileError(f"{folder / JOURNAL}: the study has begun; a registration comes first")
    if (folder / REGISTERED).exists():
        at = _recorded(folder / REGISTERED)["registered"]
        raise InputFileError(
            f"{folder / REGISTERED}: already registered at {at}; to register another plan, choose another folder"
        )


def _recorded(file: Path) -> dict[str, Any]:
    """Return a registration.

    Raises
    ------
    InputFileError
        The file is none.
    """
    try:
        record: dict[str, Any] = read_json(file)
        datetime.fromisoformat(record["registered"])
        return record | {"study": record["study"], "text": str(record["text"]), "analysis": dict(record["analysis"])}
    except InputFileError:
        raise
    except (ValueError, KeyError, TypeError) as error:
        raise InputFileError.of(file, None, f"not a preregistration: {error}") from None


def compared(study: UserStudy, tables: Tables, folder: Path) -> dict[str, Any] | None:
    """Return when a study was registered, and how it differs from the record, in words of the study's language.

    The result is None if it was not registered.

    Raises
    ------
    InputFileError
        The file is not such a record.
    """
    file = folder / REGISTERED
    if not file.exists():
        return None
    record = _recorded(file)
    at, phrase = datetime.fromisoformat(record["registered"]), study.catalogue.phrase
    deviations = _changes(study, record, phrase)
    first = min((row["arrived"] for row in tables.participants if row["arrived"] is not None), default=None)
    if first is not None and datetime.fromisoformat(first) < at:
        deviations.insert(0, phrase("report.registered_late"))
    return {"registered": record["registered"], "deviations": deviations}


def changed(study: UserStudy, folder: Path) -> str | None:
    """Return in a sentence how a study differs from its registration in a folder; None if it does not, or is not there.

    Raises
    ------
    InputFileError
        The file is no registration.
    """
    file = folder / REGISTERED
    found = _changes(study, _recorded(file), catalogue().phrase) if file.exists() else []
    return f"{file}: since the registration, {' and '.join(found)}; the report will say so" if found else None


def _changes(study: UserStudy, record: Mapping[str, Any], phrase: Callable[..., str]) -> list[str]:
    """Return what has changed since a registration: the study's file, and the code of the analysis."""
    found = []
    if record["study"] != hashlib.sha256(study.file.read_bytes()).hexdigest():
        difference = first_difference(record["text"], study.file.read_text(encoding="utf-8"))
        found.append(phrase("report.file_changed", **difference))
    files = [name for name, own in analysis_digests().items() if record["analysis"].get(name) != own]
    if files:
        found.append(phrase("report.analysis_changed", files=", ".join(files)))
    return found
