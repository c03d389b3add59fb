"""Files that are written whole or not at all, and records as JSON Lines.

What a user points an output at stays what it is: a link goes on leading to its file, which is what is replaced; into
a pipe or a device it is written; a file without write permission is refused, to the superuser as well.
"""

from __future__ import annotations

import errno
import json
import math
import os
import shutil
import stat
import tempfile
import uuid
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

from .errors import DamagedFileError

UNFINISHED = ".unfinished-"  # what the names of files begin with that `atomic` has not put into their place
LONGEST_NAME = 200  # bytes of a name that are kept in them


@contextmanager
def atomic(file: Path) -> Iterator[Path]:
    """Write to the path that is given, and put it in the place of `file` when it is complete and on the disk.

    Raises
    ------
    OSError
        With `file` as its `filename`, also where the system names none (a full disk).
    """
    try:
        status = writable(file)
        if status is not None and _is_stream(status):
            with tempfile.TemporaryDirectory(prefix="kitassist-") as folder:
                path = Path(folder) / file.name
                yield path
                with path.open("rb") as source, _opened(file, status) as target:
                    shutil.copyfileobj(source, target)
            return
        place = Path(os.path.realpath(file))  # not `resolve`, which refuses links in a circle only later
        place.parent.mkdir(parents=True, exist_ok=True)
        # In the same folder, where it can be renamed; the ending is kept, since libraries choose a format by it. The
        # name is used once: other threads, and machines with the same disk, may write the same file.
        ending = place.name.encode(errors="surrogateescape")[-LONGEST_NAME:].decode(errors="ignore")
        path = place.with_name(f"{UNFINISHED}{uuid.uuid4().hex}-{ending}")
        try:
            yield path
            if status is not None:
                path.chmod(stat.S_IMODE(status.st_mode))
            _flush(path)
            path.replace(place)
            with suppress(OSError):  # some file systems cannot do it for folders
                _flush(place.parent)
        finally:
            with suppress(OSError):  # what went wrong before says more
                path.unlink(missing_ok=True)
    except OSError as error:
        # One without a number has words of its own, which a name would hide.
        if error.errno and (error.filename is None or Path(str(error.filename)).name.startswith(UNFINISHED)):
            error.filename = str(file)
        raise


def writable(file: Path) -> os.stat_result | None:
    """Give the status of an output, None if there is no such file yet, links followed.

    Raises
    ------
    OSError
        It is a folder, or must not be written.
    """
    try:
        status = file.stat()
    except (FileNotFoundError, NotADirectoryError):  # the latter is said when it is made
        return None
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, "is a folder, not a file", str(file))
    if not status.st_mode & 0o222 or not os.access(file, os.W_OK):
        raise PermissionError(errno.EACCES, "is write-protected", str(file))
    return status


def _is_stream(status: os.stat_result) -> bool:
    """Whether a file has to be written to as it stands: a pipe, a device, or what this process prints to."""
    return not stat.S_ISREG(status.st_mode) or _printed_to(status) is not None


def _printed_to(status: os.stat_result) -> int | None:
    for descriptor in (1, 2):
        with suppress(OSError):
            if os.path.samestat(os.fstat(descriptor), status):
                return descriptor
    return None


def _opened(file: Path, status: os.stat_result) -> BinaryIO:
    """Open a stream; what this process prints to goes on where its output stands."""
    printed = _printed_to(status)
    return os.fdopen(os.open(file, os.O_WRONLY) if printed is None else os.dup(printed), "wb")


def _flush(path: Path) -> None:
    """Wait until a file, or what a folder lists, is on the disk, so that a fall of the system does not lose it."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def remove_unfinished(folders: Iterable[Path]) -> None:
    """Remove what killed processes have left in folders of results; no other process may be writing there."""
    for folder in set(folders):
        for path in folder.glob(f"{UNFINISHED}*"):
            path.unlink(missing_ok=True)


def finite(number: float) -> float | None:
    """Give a number as JSON can hold it: infinite ones, and what is none, are null."""
    return float(number) if math.isfinite(number) else None


def write_records(file: Path, records: Iterable[Mapping[str, Any]]) -> None:
    """Write records as JSON Lines."""
    with atomic(file) as path, path.open("w", encoding="utf-8") as stream:
        stream.writelines(json.dumps(record) + "\n" for record in records)


def append_record(file: Path, record: Mapping[str, Any]) -> None:
    """Add a record to a file of JSON Lines, and wait until it is on the disk."""
    append(file, json.dumps(record) + "\n")


def append(file: Path, text: str) -> None:
    """Add whole lines to a file, all or none, and wait until they are on the disk.

    Raises
    ------
    OSError
        With `file` as its `filename`.
    """
    try:
        with file.open("ab") as stream:
            before = stream.tell()
            try:
                stream.write(text.encode())
                stream.flush()
                os.fsync(stream.fileno())
            except OSError:  # not what was written whole when Ctrl-C came
                os.truncate(file, before)
                raise
    except OSError as error:
        error.filename = str(file)
        raise


def read_records(file: Path) -> list[dict[str, Any]]:
    """Read records from JSON Lines; none if there is no file. A last line that was cut off is left out.

    Raises
    ------
    DamagedFileError
        A line that is no record.
    """
    found = []
    for record in each_record(file):
        if isinstance(record, DamagedFileError):
            raise record
        found.append(record)
    return found


def each_record(file: Path) -> Iterator[dict[str, Any] | DamagedFileError]:
    """Give each line of JSON Lines as `read_records` does, and what is wrong with it in the place of what is none."""
    if not file.is_file():
        return
    for number, line in enumerate(file.read_bytes().split(b"\n")[:-1], start=1):
        try:
            yield _record(file, number, line)
        except DamagedFileError as error:
            yield error


def _record(file: Path, number: int, line: bytes) -> dict[str, Any]:
    try:
        record = json.loads(line.decode())
    except UnicodeDecodeError:
        raise DamagedFileError(file, number, "is not text (UTF-8); expected a record as JSON") from None
    except (ValueError, RecursionError):
        raise DamagedFileError(file, number, "is no JSON; expected a record, all of it on this line") from None
    if not isinstance(record, dict):
        raise DamagedFileError(file, number, "expected a record: a JSON object")
    return record
