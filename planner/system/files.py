"""Atomic writing of files, records as JSON Lines, and folders of results that can be resumed.

An output path keeps its kind. A symbolic link is kept, and its target is replaced. Pipes and devices are written to
directly. A file without write permission is refused, also for the superuser.
"""

from __future__ import annotations

import difflib
import errno
import fcntl
import json
import math
import os
import shutil
import stat
import tempfile
import time
import uuid
from collections.abc import Hashable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO, Generic, TypeVar

from .errors import InputFileError, in_words

ORPHANED = 5.0
"""Seconds for which a folder may still be held by the last processes of a run that was killed; they end after three."""
UNFINISHED = ".unfinished-"
"""Prefix of the temporary files of `atomic`."""


@contextmanager
def atomic(file: Path) -> Iterator[Path]:
    """Yield a temporary path, and move it to `file` when it is complete and flushed to disk.

    The `filename` of an `OSError` is `file`, also where the system reports none (a full disk).
    """
    # Bytes of the file's name that the temporary name keeps: together 245, below the usual limit of 255.
    longest_name = 200
    try:
        status = writable(file)
        if status is not None and _is_stream(status):
            with tempfile.TemporaryDirectory(prefix="kitassist-") as folder:
                path = Path(folder) / file.name
                yield path
                with path.open("rb") as source, _opened(file, status) as target:
                    shutil.copyfileobj(source, target)
            return
        place = Path(os.path.realpath(file))  # `resolve` would report circular links only later
        place.parent.mkdir(parents=True, exist_ok=True)
        # The temporary file is in the same folder, so that it can be renamed. It keeps the file's ending, from which
        # libraries derive the format. Its name is unique, since other threads and machines may write the same file.
        ending = place.name.encode(errors="surrogateescape")[-longest_name:].decode(errors="ignore")
        path = place.with_name(f"{UNFINISHED}{uuid.uuid4().hex}-{ending}")
        try:
            yield path
            if status is not None:
                path.chmod(stat.S_IMODE(status.st_mode))
            _flush(path)
            path.replace(place)
            with suppress(OSError):  # some file systems cannot flush folders
                _flush(place.parent)
        finally:
            with suppress(OSError):  # the first error is more informative
                path.unlink(missing_ok=True)
    except OSError as error:
        # An error without a number has its own message, which a file name would hide.
        if error.errno and (error.filename is None or Path(str(error.filename)).name.startswith(UNFINISHED)):
            error.filename = str(file)
        raise


def writable(file: Path) -> os.stat_result | None:
    """Return the status of an output file, following links; None if the file does not exist yet.

    A folder and a write-protected file raise an `OSError`.
    """
    try:
        status = file.stat()
    except (FileNotFoundError, NotADirectoryError):  # creating the file reports the latter
        return None
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, "is a folder, not a file", str(file))
    if not status.st_mode & 0o222 or not os.access(file, os.W_OK):
        raise PermissionError(errno.EACCES, "is write-protected", str(file))
    return status


def _is_stream(status: os.stat_result) -> bool:
    """Whether a file is written to directly: a pipe, a device, or this process's own standard output or error."""
    return not stat.S_ISREG(status.st_mode) or _printed_to(status) is not None


def _printed_to(status: os.stat_result) -> int | None:
    """Return the descriptor, 1 or 2, with which this process prints to the file; None if it does not."""
    for descriptor in (1, 2):
        with suppress(OSError):
            if os.path.samestat(os.fstat(descriptor), status):
                return descriptor
    return None


def _opened(file: Path, status: os.stat_result) -> BinaryIO:
    """Open a stream for writing. This process's own output continues at its current position."""
    printed = _printed_to(status)
    return os.fdopen(os.open(file, os.O_WRONLY) if printed is None else os.dup(printed), "wb")


def _flush(path: Path) -> None:
    """Wait until a file, or the entries of a folder, are on disk, so that they survive a system crash."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def remove_unfinished(folders: Iterable[Path]) -> None:
    """Remove the temporary files of killed processes. No other process may be writing to the folders."""
    for folder in set(folders):
        for path in folder.glob(f"{UNFINISHED}*"):
            path.unlink(missing_ok=True)


def finite(number: float) -> float | None:
    """Return the number if it is finite, else None, since JSON has neither infinity nor NaN."""
    return float(number) if math.isfinite(number) else None


def write_records(file: Path, records: Iterable[Mapping[str, Any]]) -> None:
    """Write records as JSON Lines."""
    write_text(file, (json.dumps(record) + "\n" for record in records))


def write_text(file: Path, texts: Iterable[str]) -> None:
    """Write texts, one after another, as one file."""
    with atomic(file) as path, path.open("w", encoding="utf-8") as stream:
        stream.writelines(texts)


def append(file: Path, text: str) -> None:
    """Append whole lines to a file, all or none, and wait until they are on disk.

    The `filename` of an `OSError` is `file`.
    """
    try:
        with file.open("ab") as stream:
            before = stream.tell()
            try:
                stream.write(text.encode())
                stream.flush()
                os.fsync(stream.fileno())
            except OSError:  # Ctrl-C keeps what was written completely
                os.truncate(file, before)
                raise
    except OSError as error:
        error.filename = str(file)
        raise


def read_records(file: Path) -> list[dict[str, Any]]:
    """Return the records of a JSON Lines file; an empty list if there is no file. An incomplete last line is ignored.

    A line that is not a record raises an `InputFileError`.
    """
    found = []
    for record in each_record(file):
        if isinstance(record, InputFileError):
            raise record
        found.append(record)
    return found


def bytes_of(file: Path) -> bytes:
    """Return the bytes of a file that a user has named; an `InputFileError` says why it cannot be read."""
    try:
        return file.read_bytes()
    except FileNotFoundError:
        raise InputFileError(f"{file}: {no_such(file)}") from None
    except OSError as error:
        raise InputFileError(in_words(error)) from None


def read_json(file: Path) -> Any:
    """Return the content of a JSON file; an `InputFileError` says why it cannot be read, or where it has no JSON."""
    data = bytes_of(file)
    if not data.strip():
        raise InputFileError.of(file, None, "the file is empty; expected JSON")
    try:
        return json.loads(data.decode("utf-8-sig"))
    except UnicodeDecodeError:
        raise InputFileError.of(file, None, "not text in UTF-8; expected JSON") from None
    except json.JSONDecodeError as error:
        raise InputFileError.of(file, error.lineno, f"not JSON (column {error.colno}: {error.msg})") from None
    except (ValueError, RecursionError):
        raise InputFileError.of(file, None, "not JSON: a number or the depth of its lists is too large") from None


def no_such(file: Path, what: str = "no such file") -> str:
    """Return what is said of a path that does not exist, beginning with `what`: the most similar name in its folder."""
    near: list[str] = []
    with suppress(OSError, ValueError):  # there is no such folder, or no path can have this name
        others = sorted(one.name for one in file.parent.iterdir() if one.name != file.name)
        stems = difflib.get_close_matches(file.stem, {Path(name).stem for name in others}, n=5, cutoff=0.75)
        alike = [name for name in others if Path(name).stem in stems]
        near = difflib.get_close_matches(file.name, alike, n=1, cutoff=0.0)
    return f"{what}; did you mean '{file.parent / near[0]}'?" if near else what


def each_record(file: Path) -> Iterator[dict[str, Any] | InputFileError]:
    """Yield each line of a JSON Lines file as a record, or else the `InputFileError` that says why it is none.

    An incomplete last line is ignored.
    """
    if not file.is_file():
        return
    for number, line in enumerate(file.read_bytes().split(b"\n")[:-1], start=1):
        try:
            yield _record(file, number, line)
        except InputFileError as error:
            yield error


def _record(file: Path, number: int, line: bytes) -> dict[str, Any]:
    try:
        record = json.loads(line.decode())
    except UnicodeDecodeError:
        raise InputFileError.of(file, number, "is not text (UTF-8); expected a record as JSON") from None
    except (ValueError, RecursionError):
        raise InputFileError.of(file, number, "is no JSON; expected a record, all of it on this line") from None
    if not isinstance(record, dict):
        raise InputFileError.of(file, number, "expected a record: a JSON object")
    return record


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Create a folder if it is not there, and hold it as the only run that writes results into it.

    Where it cannot be created, opened or locked, nothing is held: what is written into it then says why. An
    `InputFileError` says that another run holds it.
    """
    with ExitStack() as opened:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            number = os.open(folder, os.O_RDONLY)
            opened.callback(os.close, number)
            if not locked(number, ORPHANED):
                raise InputFileError(f"{folder}: another run writes into it; expected another folder")
        except OSError:
            pass
        yield


def locked(number: int, seconds: float) -> bool:
    """Lock an open file or folder for this process alone; return whether no other one held it after so many seconds."""
    until = time.monotonic() + seconds
    while True:
        try:
            fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > until:
                return False
            time.sleep(0.02)
        else:
            return True


Key = TypeVar("Key", bound=Hashable)


class ResumableFolder(Generic[Key]):
    """A folder that some work fills item by item: `lines` and `records` are those of each item that is complete.

    Two files hold what is done: one has the lines of each item, the other one record for each item, such as what the
    results depend on, or the seconds that they took. The lines of an item are appended at once when it is complete. At
    the end, both files are sorted. The same work thus gives the same bytes, however it was divided or interrupted.
    """

    def __init__(self, results: Path, beside: Path, *, resume: bool) -> None:
        """Name both files. Results without `resume` raise a `InputFileError`; `begun` says whether there are any."""
        self._results, self._beside = results, beside
        self._folders: set[Path] = {results.parent}
        self.lines: dict[Key, str] = {}
        self.records: dict[Key, Mapping[str, Any]] = {}
        self.begun = results.exists() and results.stat().st_size > 0
        if self.begun and not resume:
            raise InputFileError(f"{results} exists; resume it, or choose another folder")

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
        append(self._beside, json.dumps(record) + "\n")  # first: without it, lines may not be kept
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
