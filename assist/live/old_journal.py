"""Reader of journals in JSON Lines, the format of sessions before `EventStore`."""

from __future__ import annotations

import fcntl
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from planner.system.errors import DamagedFileError, ResultsExistError


def lines(file: Path) -> Iterator[dict[str, Any]]:
    """Yield the header and the records of a journal. An incomplete last line was never acknowledged and is skipped.

    Raises
    ------
    ResultsExistError
        A running session uses the file.
    DamagedFileError
        A line is no record.
    """
    with file.open("rb") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ResultsExistError(
                f"{file}: the folder is in use by a running session; expected another folder"
            ) from None
        for number, line in enumerate(stream, start=1):
            if not line.endswith(b"\n"):
                return
            try:
                record = json.loads(line)
            except (ValueError, RecursionError):
                record = None
            if not isinstance(record, dict):
                raise DamagedFileError(file, number, "is not an event of a session; expected a JSON object")
            yield record
