"""Answers about single states, kept on disk."""

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

DEAD_END = -1  # how the cache stores an infinite cost-to-go


def cache_folder() -> Path:
    """Name the folder of the persistent cache: `kitassist` in the user's cache folder."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "kitassist"


class Cache:
    """Costs-to-go of a task's states in a file, addressed by content; in the prices of `priced`.

    The file's name is a digest of the grounded task and Fast Downward's version, so that a change of either begins
    a new one.

    Parameters
    ----------
    task : Task
    folder : path, optional
        Where the file is; `cache_folder()` unless given.
    """

    def __init__(self, task: Task, folder: str | Path | None = None) -> None:
        digest = hashlib.sha256(f"{fast_downward.version()}\n{priced(task)[0].sas}".encode()).hexdigest()
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
        """Give all that is known."""
        with closing(self._open()) as connection:
            rows = connection.execute("SELECT state, cost FROM cost").fetchall()
        return {state: float("inf") if cost == DEAD_END else float(cost) for state, cost in rows}

    def write(self, costs: dict[bytes, float]) -> None:
        """Add costs; all of them or, if the process is killed, none."""
        rows = [(state, DEAD_END if np.isinf(cost) else int(cost)) for state, cost in costs.items()]
        with closing(self._open()) as connection, connection:
            connection.executemany("INSERT OR REPLACE INTO cost VALUES (?, ?)", rows)
