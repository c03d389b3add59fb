"""Index of answered events by their id, so that a repeated event gets the first answer again.

The answers are in the journal. The index holds their positions: the latest by id, and all earlier ones by a hash, in 16
bytes each. Equal hashes do no harm, because the line itself contains the id.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .journal import Journal

Key = tuple[str, str]
"""The person of an event ("" for none) and its id."""

LATEST = 1024
"""Number of latest answers that are indexed by id; then they are merged into the hashed ones."""


class AnsweredIds:
    """Finds the line of a journal that contains the answer to an event.

    Parameters
    ----------
    journal : Journal
    hashed : callable
        Returns a number of 64 bits, the same for equal keys while the process runs.
    """

    def __init__(self, journal: Journal, hashed: Callable[[Key], int] = hash) -> None:
        self._journal, self._hashed = journal, hashed
        self._latest: dict[Key, int] = {}
        self._hashes, self._begins = (np.zeros(0, dtype=np.int64) for _ in range(2))  # ascending hashes

    def __len__(self) -> int:
        return len(self._latest) + len(self._hashes)

    def add(self, key: Key, begin: int) -> None:
        """Record the position of the line that contains an answer."""
        self._latest[key] = begin
        if len(self._latest) >= LATEST:
            self._pack()

    def find(self, key: Key) -> dict[str, Any] | None:
        """Return the record with the answer; None if there is no event of this id."""
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
        """Merge the latest entries into the sorted hashes."""
        hashes = np.array([self._hashed(key) for key in self._latest], dtype=np.int64)
        begins = np.array(list(self._latest.values()), dtype=np.int64)
        order = np.argsort(hashes, kind="stable")
        at = np.searchsorted(self._hashes, hashes[order])
        self._hashes = np.insert(self._hashes, at, hashes[order])
        self._begins = np.insert(self._begins, at, begins[order])
        self._latest.clear()


def key_of(record: dict[str, Any]) -> Key:
    """Return the key of a record that has an id."""
    return record.get("person") or "", record.get("id") or ""
