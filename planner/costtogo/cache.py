"""A cache on disk for the cost-to-go of single states."""

from __future__ import annotations

import hashlib
import os
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np

from ..grounding import fast_downward
from ..grounding.task import Task
from .astar import priced


def cache_folder() -> Path:
    """Return the folder of the persistent cache: `kitassist` in the user's cache folder."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "kitassist"


class Cache:
    """A file with the cost-to-go of a task's states, in the combined costs of `priced`.

    An infinite cost is stored as -1. The file name is a digest of the grounded task, Fast Downward's version and
    `FORMAT`. A change of any starts a new file.

    Parameters
    ----------
    task : Task
    folder : path, optional
        Folder of the file; `cache_folder()` by default.
    """

    FORMAT = 2
    """Version of the packing of states and of the search, part of the digest."""

    def __init__(self, task: Task, folder: str | Path | None = None) -> None:
        contents = f"{self.FORMAT}\n{fast_downward.version()}\n{priced(task)[0].sas}"
        digest = hashlib.sha256(contents.encode()).hexdigest()
        folder = cache_folder() if folder is None else Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        self.file = folder / f"{digest}.sqlite"
        with closing(self._open()) as connection, connection:
            connection.execute(
                "CREATE TABLE IF NOT EXISTS cost (state BLOB PRIMARY KEY, cost INTEGER NOT NULL) WITHOUT ROWID"
            )

    def _open(self) -> sqlite3.Connection:
        return sqlite3.connect(self.file, timeout=60)

    def read(self) -> dict[bytes, float]:
        """Return all stored costs, by the bytes of the packed state."""
        with closing(self._open()) as connection:
            rows = connection.execute("SELECT state, cost FROM cost").fetchall()
        return {state: float("inf") if cost == -1 else float(cost) for state, cost in rows}

    def write(self, costs: dict[bytes, float]) -> None:
        """Store costs atomically: all of them or, if the process is killed, none."""
        rows = [(state, -1 if np.isinf(cost) else int(cost)) for state, cost in costs.items()]
        with closing(self._open()) as connection, connection:
            connection.executemany("INSERT OR REPLACE INTO cost VALUES (?, ?)", rows)
