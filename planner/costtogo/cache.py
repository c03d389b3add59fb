"""A cache on disk for the cost-to-go of single states."""

from __future__ import annotations

import errno
import hashlib
import os
import sqlite3
from collections.abc import Sequence
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
    `FORMAT`. A change of any starts a new file. A file that cannot be used raises an `OSError`.

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

    def read(self) -> dict[bytes, float]:
        """Return all stored costs, by the bytes of the packed state."""
        rows = self._executed("SELECT state, cost FROM cost")
        return {state: float("inf") if cost == -1 else float(cost) for state, cost in rows}

    def write(self, costs: dict[bytes, float]) -> None:
        """Store costs atomically: all of them or, if the process is killed, none."""
        rows = [(state, -1 if np.isinf(cost) else int(cost)) for state, cost in costs.items()]
        self._executed("INSERT OR REPLACE INTO cost VALUES (?, ?)", rows)

    def _executed(self, statement: str, inserted: Sequence[tuple[bytes, int]] | None = None) -> list[tuple[bytes, int]]:
        """Return the rows that a statement selects, or insert rows; a damaged file is replaced by an empty one."""
        try:
            with closing(sqlite3.connect(self.file, timeout=60)) as connection, connection:
                connection.execute(
                    "CREATE TABLE IF NOT EXISTS cost (state BLOB PRIMARY KEY, cost INTEGER NOT NULL) WITHOUT ROWID"
                )
                if inserted is None:
                    return connection.execute(statement).fetchall()
                connection.executemany(statement, inserted)
                return []
        except sqlite3.OperationalError as error:
            raise OSError(errno.EIO, str(error), str(self.file)) from None
        except sqlite3.DatabaseError as error:
            if error.sqlite_errorcode not in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB):
                raise
            self.file.unlink(missing_ok=True)
        return self._executed(statement, inserted)
