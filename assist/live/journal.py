"""The journal of a live session: one line per event, in a file that only grows.

A line is on the disk before the event is acknowledged. Several lines may share one write (group commit). Lines that
could not be written completely are cut off at once. An incomplete last line that a killed process left is cut off when
the file is opened, as its event was never acknowledged. One process at a time can open the file.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from planner.system.errors import DamagedFileError, ResultsExistError

PROBE = 1 << 16
"""Number of bytes that must fit on the disk, after it was full, before events are accepted again."""


class JournalError(OSError):
    """The event cannot be written to the disk, and has no effect."""


class Journal:
    """A file of JSON Lines.

    Parameters
    ----------
    file : Path
        Created, with its folder, if it does not exist.

    Raises
    ------
    ResultsExistError
        Another process uses it.
    OSError
        It cannot be written.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        file.parent.mkdir(parents=True, exist_ok=True)
        self._descriptor = os.open(file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            self._take()
            self._end = self._whole()
        except BaseException:
            os.close(self._descriptor)
            raise
        self._full = False

    def _take(self) -> None:
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ResultsExistError(
                f"{self.file}: the folder is in use by a running session; expected another folder"
            ) from None

    def _whole(self) -> int:
        """Cut off an incomplete last line, and return the end of the lines."""
        size = os.fstat(self._descriptor).st_size
        end = size
        while end > 0:
            begin = max(0, end - PROBE)
            found = os.pread(self._descriptor, end - begin, begin).rfind(b"\n")
            if found >= 0:
                end = begin + found + 1
                break
            end = begin
        if end < size:
            os.ftruncate(self._descriptor, end)
            os.fdatasync(self._descriptor)
        return end

    def __iter__(self) -> Iterator[tuple[int, dict[str, Any]]]:
        """Yield the position and the record of each line.

        Raises
        ------
        DamagedFileError
            A line is no record.
        """
        with self.file.open("rb") as stream:
            at = 0
            for number, line in enumerate(stream, start=1):
                try:
                    record = json.loads(line)
                except (ValueError, RecursionError):
                    record = None
                if not isinstance(record, dict):
                    raise DamagedFileError(self.file, number, "is no event of a session; expected a JSON object")
                yield at, record
                at += len(line)

    def __len__(self) -> int:
        """Return the number of bytes of all lines."""
        return self._end

    def at(self, begin: int) -> dict[str, Any]:
        """Return the record of the line at a position."""
        with self.file.open("rb") as stream:
            stream.seek(begin)
            record: dict[str, Any] = json.loads(stream.readline())
        return record

    def append(self, lines: Sequence[bytes]) -> list[int]:
        """Append all lines or none, wait until they are on the disk, and return their positions.

        Raises
        ------
        JournalError
            The lines cannot be written. The file is as it was before.
        """
        begins, end = [], self._end
        for line in lines:
            begins.append(end)
            end += len(line)
        try:
            self._write(b"".join(lines))
        except OSError as error:
            self._full = True
            with suppress(OSError):  # the next write overwrites it
                self._cut()
            raise _said(error, self.file) from error
        self._end = end
        return begins

    def check(self) -> None:
        """Check, after the disk was full, whether there is room again.

        Raises
        ------
        JournalError
            The disk is still full.
        """
        if self._full:
            try:
                try:
                    self._write(b" " * PROBE)
                finally:
                    self._cut()
            except OSError as error:
                raise _said(error, self.file) from error
            self._full = False

    def close(self) -> None:
        """Close the file; repeated calls have no effect."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)

    def _write(self, content: bytes) -> None:
        at = self._end
        while content:
            written = os.pwrite(self._descriptor, content, at)
            if written == 0:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            content, at = content[written:], at + written
        os.fdatasync(self._descriptor)

    def _cut(self) -> None:
        """Cut off incomplete lines now; opening the file would cut off the last one only."""
        os.ftruncate(self._descriptor, self._end)
        os.fdatasync(self._descriptor)


def _said(error: OSError, file: Path) -> JournalError:
    return JournalError(error.errno, f"{error.strerror}; nothing was recorded", str(file))
