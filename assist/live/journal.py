"""What has happened in a live session, line by line in a file that only grows.

A line is on the disk before anybody is told that it has happened; several may share one wait for the disk (group
commit). Lines that could not be written whole are cut off again at once, and what a killed process has left of its last
line is when the file is opened: nobody was told of it. One process at a time has the file.
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
"""Bytes that have to find room after a disk was full, before anything is written again."""


class JournalError(OSError):
    """The disk does not take what has happened; so it has not happened."""


class Journal:
    """A file of JSON Lines.

    Parameters
    ----------
    file : Path
        Made, with its folder, if there is none.

    Raises
    ------
    ResultsExistError
        Another process has it.
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
        """Cut off what is left of a last line that was not finished; give where the lines end."""
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
        """Give each line, with where it begins.

        Raises
        ------
        DamagedFileError
            A line that is no record.
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
        """Count the bytes of all lines."""
        return self._end

    def at(self, begin: int) -> dict[str, Any]:
        """Read the line that begins there."""
        with self.file.open("rb") as stream:
            stream.seek(begin)
            record: dict[str, Any] = json.loads(stream.readline())
        return record

    def append(self, lines: Sequence[bytes]) -> list[int]:
        """Add lines, all or none, and wait until they are on the disk; give where each begins.

        Raises
        ------
        JournalError
            They are not on the disk. The file is as it was before.
        """
        begins, end = [], self._end
        for line in lines:
            begins.append(end)
            end += len(line)
        try:
            self._write(b"".join(lines))
        except OSError as error:
            self._full = True
            with suppress(OSError):  # it is overwritten by what comes next
                self._cut()
            raise _said(error, self.file) from error
        self._end = end
        return begins

    def check(self) -> None:
        """Try, after a disk was full, whether there is room again.

        Raises
        ------
        JournalError
            There is not.
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
        """Let go of the file; more than once does no harm."""
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
        """Leave nothing half: also before the next start, which would do the same for the last line only."""
        os.ftruncate(self._descriptor, self._end)
        os.fdatasync(self._descriptor)


def _said(error: OSError, file: Path) -> JournalError:
    return JournalError(error.errno, f"{error.strerror}; nothing was recorded", str(file))
