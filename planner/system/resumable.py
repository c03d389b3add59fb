"""A folder of results that is filled item by item, so that interrupted work can be resumed.

Two files hold what is done: one has the lines of each item, the other one record for each item, such as what the
results depend on, or the seconds that they took. The lines of an item are appended at once when it is complete. At the
end, both files are sorted. The same work therefore gives the same bytes, however it was divided or interrupted.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from pathlib import Path
from typing import Any, Generic, TypeVar

from .errors import ResultsExistError
from .files import append, append_record, remove_unfinished, write_records, write_text

Key = TypeVar("Key", bound=Hashable)


class ResumableFolder(Generic[Key]):
    """The results of some work while it is done: `lines` and `records` are those of each item that is complete."""

    def __init__(self, results: Path, beside: Path, *, resume: bool) -> None:
        """Name both files. Results without `resume` raise a `ResultsExistError`; `begun` says whether there are any."""
        self._results, self._beside = results, beside
        self._folders: set[Path] = {results.parent}
        self.lines: dict[Key, str] = {}
        self.records: dict[Key, Mapping[str, Any]] = {}
        self.begun = results.exists() and results.stat().st_size > 0
        if self.begun and not resume:
            raise ResultsExistError(f"{results} exists; resume it, or choose another folder")

    def begin(
        self, lines: Mapping[Key, str], records: Mapping[Key, Mapping[str, Any]], folders: Iterable[Path] = ()
    ) -> None:
        """Keep these results of an earlier run, and no others.

        `folders` are all other folders into which the work writes. Unfinished files of a killed run are removed.
        """
        self.lines, self.records = dict(lines), dict(records)
        self._folders |= set(folders)
        self.remove_unfinished()
        self.finish(self.lines)

    def add(self, item: Key, lines: str, record: Mapping[str, Any]) -> None:
        """Store the results of an item that is complete; they replace earlier ones."""
        append_record(self._beside, record)  # first: without it, lines may not be kept
        append(self._results, lines)
        self.lines[item], self.records[item] = lines, record

    def add_passing(self, lines: str) -> None:
        """Store lines that no later run keeps."""
        append(self._results, lines)

    def finish(self, order: Iterable[Key]) -> None:
        """Sort both files."""
        done = [item for item in dict.fromkeys(order) if item in self.lines]
        write_text(self._results, (self.lines[item] for item in done))
        write_records(self._beside, (self.records[item] for item in done if item in self.records))

    def remove_unfinished(self) -> None:
        """Remove temporary files that stopped processes have left."""
        remove_unfinished(self._folders)
