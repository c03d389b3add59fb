"""Which events have been answered under which id, so that the same again is answered as the first, however long ago.

What was answered stands in the journal. Here is only where: the latest by their ids, all before them by a hash, with
the place of the line in 16 bytes. Equal hashes do no harm, since the line itself says whose it is.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .journal import Journal

Key = tuple[str, str]
"""Whom an event is about, "" for nobody, and its id."""

LATEST = 1024
"""Answers that are known by their names; when there are so many they go to the others."""


class AnsweredIds:
    """Finds the line of a journal in which an event of some id was answered.

    Parameters
    ----------
    journal : Journal
    hashed : callable
        Gives a number of 64 bits, the same for the same key as long as the process runs.
    """

    def __init__(self, journal: Journal, hashed: Callable[[Key], int] = hash) -> None:
        self._journal, self._hashed = journal, hashed
        self._latest: dict[Key, int] = {}
        self._hashes, self._begins = (np.zeros(0, dtype=np.int64) for _ in range(2))  # ascending hashes

    def __len__(self) -> int:
        return len(self._latest) + len(self._hashes)

    def add(self, key: Key, begin: int) -> None:
        """Take note of the place of the line that answers."""
        self._latest[key] = begin
        if len(self._latest) >= LATEST:
            self._pack()

    def find(self, key: Key) -> dict[str, Any] | None:
        """Give the record that answers; None if nothing has happened under this id."""
        if key in self._latest:
            return self._journal.at(self._latest[key])
        for begin in self._candidates(np.int64(self._hashed(key))):
            record = self._journal.at(int(begin))
            if key_of(record) == key:
                return record
        return None

    def _candidates(self, wanted: np.int64) -> NDArray[np.int64]:
        first = int(np.searchsorted(self._hashes, wanted))
        last = first
        while last < len(self._hashes) and self._hashes[last] == wanted:
            last += 1
        return self._begins[first:last]

    def _pack(self) -> None:
        """Leave of the latest what finds them: they are merged into the others, which stay in order."""
        hashes = np.array([self._hashed(key) for key in self._latest], dtype=np.int64)
        begins = np.array(list(self._latest.values()), dtype=np.int64)
        order = np.argsort(hashes, kind="stable")
        at = np.searchsorted(self._hashes, hashes[order])
        self._hashes = np.insert(self._hashes, at, hashes[order])
        self._begins = np.insert(self._begins, at, begins[order])
        self._latest.clear()


def key_of(record: dict[str, Any]) -> Key:
    """Give the key of a record that has an id."""
    return record.get("person") or "", record.get("id") or ""
