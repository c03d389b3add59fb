"""Files that are written whole or not at all, and records as JSON Lines."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def atomic(file: Path) -> Iterator[Path]:
    """Write to the path that is given, beside `file`, and put it in its place when it is complete."""
    file.parent.mkdir(parents=True, exist_ok=True)
    # The ending is kept, since libraries choose a format by it.
    path = file.with_name(f".{os.getpid()}-{file.name}")
    try:
        yield path
        path.replace(file)
    finally:
        path.unlink(missing_ok=True)


def write_records(file: Path, records: Iterable[dict[str, Any]]) -> None:
    """Write records as JSON Lines."""
    with atomic(file) as path, path.open("w", encoding="utf-8") as stream:
        stream.writelines(json.dumps(record) + "\n" for record in records)


def append_record(file: Path, record: dict[str, Any]) -> None:
    """Add a record to a file of JSON Lines."""
    with file.open("a", encoding="utf-8") as stream:
        stream.write(json.dumps(record) + "\n")


def read_records(file: Path) -> list[dict[str, Any]]:
    """Read records from JSON Lines; none if there is no file. A last line that was cut off is left out."""
    if not file.is_file():
        return []
    return [json.loads(line) for line in file.read_text(encoding="utf-8").split("\n")[:-1]]
