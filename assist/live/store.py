"""The events of a session in an SQLite database, each with its answer, the client's id and the time in UTC.

A transaction contains a batch of events. It is on the disk as a whole before its events are acknowledged
(`synchronous=FULL`), or has no effect. `rewrite` and `purge` remove a person's records for good.

One connection per database writes, and a lock file keeps other sessions out. SQLite before 3.51.3, and so Debian's, can
damage a database in WAL mode if two connections write or move the log into the database at the same moment. This cannot
happen here. The connections of `stored` only read, which the fault does not concern.
"""

from __future__ import annotations

import errno
import fcntl
import json
import logging
import os
import sqlite3
import stat
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

from pydantic import Field

from planner.system.errors import InputFileError

from ..declare.declared import AnyText, View, Whole, declared
from ..declare.rows import created, insert, select
from .event_base import Event
from .record import Record, require_version

R = TypeVar("R", bound=Record)

OWNER_ONLY = stat.S_IRUSR | stat.S_IWUSR


class JournalError(OSError):
    """The event cannot be written to the disk, and has no effect."""


@declared
class Tombstone(View):
    """What remains of a person whose records were erased."""

    label: Annotated[AnyText, Field(description="Stands for the person in what remains.")]
    at: Annotated[AnyText, Field(description="Time of the erasure, UTC.")]
    reason: Annotated[AnyText, Field(description="Why, without the person's name.")]
    events: Annotated[Whole, Field(description="Number of erased events.")]


@declared(kw_only=True)
class Buried(Tombstone):
    """A row of the table `erased`."""

    purged: Annotated[Whole, Field(description="Whether no traces remain in the files, 0 or 1.")] = 0


@declared
class EventRow:
    """A row of the table `events`."""

    n: Annotated[Whole, Field(ge=1, description="Number of the event.")]
    at: Annotated[AnyText | None, Field(description="When it was stored, UTC; null for erased events.")]
    person: Annotated[AnyText, Field(description="Of whom it is; empty for events without a person.")]
    record: Annotated[AnyText, Field(description="The record, as JSON.")]
    reporter: Annotated[AnyText, Field(description="Whose ids its id is one of.")]
    id: Annotated[AnyText | None, Field(description="Chosen by the reporter.")]
    reported: Annotated[AnyText | None, Field(description="What was reported, as JSON; kept if there is an id.")]
    answer: Annotated[AnyText | None, Field(description="What was answered, as JSON; kept if there is an id.")]


@declared
class Unchanged:
    """A row of the table `unchanged`: a report that has changed nothing, so that it is no event."""

    reporter: Annotated[AnyText, Field(description="Whose ids its id is one of.")]
    id: Annotated[AnyText, Field(description="Chosen by the reporter.")]
    reported: Annotated[AnyText, Field(description="What was reported, as JSON.")]


TABLES = ";".join((
    "CREATE TABLE IF NOT EXISTS header (document TEXT NOT NULL)",
    created("events", EventRow, {"n": "PRIMARY KEY"},
            "CHECK ((id IS NULL) = (answer IS NULL) AND (id IS NULL) = (reported IS NULL))"),
    "CREATE UNIQUE INDEX IF NOT EXISTS answered ON events (reporter, id) WHERE id IS NOT NULL",
    created("unchanged", Unchanged, {}, "PRIMARY KEY (reporter, id)"),
    created("erased", Buried, {"label": "PRIMARY KEY"}),
))  # fmt: skip


class EventStore(Generic[R]):
    """The database of a session.

    Parameters
    ----------
    file : Path
        Created, with its folder, if it does not exist.
    kind : type
        The class of the records.

    Raises
    ------
    InputFileError
        Another process uses it, or it is no database of a session, or is damaged.
    OSError
        It cannot be written.
    """

    def __init__(self, file: Path, kind: type[R]) -> None:
        self.file, self._kind = file, kind
        file.parent.mkdir(parents=True, exist_ok=True)
        self._lock = os.open(self.file.with_suffix(".lock"), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, OWNER_ONLY)
        self._db: sqlite3.Connection = None  # type: ignore[assignment]  # until it is connected
        self._failed: str | None = None  # why the last transaction could not be written
        try:
            self._lock_file()
            private(self.file)  # SQLite gives its log the same permissions
            self._db = self._connected()
            try:
                self.purge()
            except JournalError as error:
                logging.getLogger(__name__).warning("%s", error)
        except BaseException:
            self.close()
            raise

    def _lock_file(self) -> None:
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputFileError(
                f"{self.file}: the folder is in use by a running session; expected another folder"
            ) from None

    def _connected(self) -> sqlite3.Connection:
        with self._sqlite_errors():
            # It waits up to ten seconds for a reader, which needs much less.
            db = sqlite3.connect(self.file, timeout=10.0, isolation_level=None, check_same_thread=False)
            try:
                # A sort or a VACUUM must not leave personal data in a temporary file.
                db.executescript(
                    "PRAGMA temp_store=MEMORY; PRAGMA secure_delete=ON; PRAGMA journal_mode=WAL;PRAGMA synchronous=FULL"
                )
                fault = db.execute("PRAGMA quick_check(1)").fetchone()[0]
                if fault != "ok":
                    raise InputFileError.of(self.file, None, f"is damaged ({fault}); expected the journal of a session")
                if db.execute("SELECT 1 FROM sqlite_master WHERE name = 'header'").fetchone() is not None:
                    require_version(self.file, _header(db, self.file) or {}, self._kind.format)
                db.executescript(TABLES)
            except BaseException:
                db.close()
                raise
        return db

    @contextmanager
    def _sqlite_errors(self) -> Iterator[None]:
        """Turn errors of SQLite into the errors of this class."""
        try:
            yield
        except sqlite3.Error as error:
            raise _as_error(error, self.file) from error

    # Reading.

    def header(self) -> dict[str, Any] | None:
        """Return the header of the session; None in a new database."""
        return _header(self._db, self.file)

    def __iter__(self) -> Iterator[R]:
        """Yield the record of each event in order, without answers."""
        with self._sqlite_errors():
            for n, text in self._db.execute("SELECT n, record FROM events ORDER BY n"):
                yield self._record(text, n)

    def _record(self, text: str, n: int) -> R:
        try:
            return self._kind.of(text)
        except (TypeError, ValueError) as error:
            raise self.damaged(n, error) from error

    def answer(self, event: Event) -> tuple[str, dict[str, Any] | None] | None:
        """Return what the reporter of an event has reported under its id, with the answer; None if nothing.

        What has changed nothing is stored without an answer.
        """
        if event.id is None:
            return None
        whose = "WHERE reporter = :reporter AND id = :id"
        with self._sqlite_errors():
            row = self._db.execute(
                f"SELECT n, reported, answer FROM events {whose} "
                f"UNION ALL SELECT 0, reported, NULL FROM unchanged {whose}",
                {"reporter": event.reporter, "id": event.id},
            ).fetchone()
        if row is None:
            return None
        n, reported, answer = row
        return reported, None if answer is None else _document(answer, self.file, n)

    def next_label(self) -> str:
        """Return a label for the next person whose records are erased."""
        labels = [stone.label for stone in self.tombstones()]
        return f"(erased {1 + sum(label.startswith('(erased ') for label in labels)})"

    def tombstones(self) -> list[Tombstone]:
        """Return what remains of the people whose records were erased."""
        with self._sqlite_errors():
            return select(self._db, Tombstone, "erased")

    # Writing.

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Write everything in the block, or nothing if there is an exception.

        Raises
        ------
        JournalError
            It cannot be written.
        """
        try:
            with self._sqlite_errors():
                self._db.execute("BEGIN IMMEDIATE")
            yield
            with self._sqlite_errors():
                self._db.execute("COMMIT")
        except BaseException as error:
            if isinstance(error, JournalError):
                self._failed = str(error.strerror).partition(";")[0]
            self._abandon()
            raise

    def _abandon(self) -> None:
        """End a transaction without effect."""
        try:
            if self._db.in_transaction:
                self._db.execute("ROLLBACK")
        except BaseException:  # noqa: BLE001  a new connection does not have the transaction
            self._db.close()
            self._db = self._connected()

    def begin(self, header: Mapping[str, Any]) -> None:
        """Write the header of a new session."""
        with self._sqlite_errors():
            self._db.execute("INSERT INTO header VALUES (?)", (_text(header),))

    def add(self, record: R, answer: Any, event: Event, *, at: str) -> None:
        """Add the record of a reported event within a transaction; `answer` is stored if the event has an id."""
        known = (None, None, None) if event.id is None else (event.id, event.reported, _text(answer))
        row = EventRow(record.n, at, record.event.who or "", record.text(), event.reporter, *known)
        with self._sqlite_errors():
            insert(self._db, "events", row)

    def remember(self, event: Event) -> None:
        """Add a report that has changed nothing within a transaction, if it has an id."""
        if event.id is not None:
            with self._sqlite_errors():
                insert(self._db, "unchanged", Unchanged(event.reporter, event.id, event.reported))

    def check(self, room: int = 1 << 16) -> None:
        """Check, after something could not be written, whether there is room again for at least `room` bytes.

        Raises
        ------
        JournalError
            The disk is still full, or cannot be written.
        """
        if self._failed is not None:
            with self.transaction():
                self.begin({"room": " " * room})
            with self.transaction(), self._sqlite_errors():
                self._db.execute("DELETE FROM header WHERE rowid > 1")
            self._failed = None

    def fault(self) -> str | None:
        """Return why events cannot be saved now, as far as it is known without an attempt; None if they can."""
        if self._failed is not None:
            return f"{self._failed} at the last attempt"
        writable = os.access(self.file, os.W_OK) and os.access(self.file.parent, os.W_OK)
        return None if writable else f"{self.file.name} cannot be written"

    def damaged(self, n: int, error: object) -> InputFileError:
        """Return the error for the stored event number `n`, which cannot be applied."""
        return InputFileError.of(self.file, None, f"event {n} cannot have happened: {error}")

    # Erasing.

    def bury(self, person: str, label: str, reason: str) -> Tombstone:
        """Add the tombstone of a person within a transaction, in which `rewrite` follows."""
        with self._sqlite_errors():
            count = self._db.execute("SELECT count(*) FROM events WHERE person = ?", (person,)).fetchone()[0]
            stone = Buried(label, utc(), reason, count)
            self._db.execute("DELETE FROM erased WHERE label = ?", (person,))  # who withdrew and is erased later
            self._db.execute("DELETE FROM unchanged WHERE reporter = ?", (person,))
            insert(self._db, "erased", stone)
        return Tombstone(stone.label, stone.at, stone.reason, stone.events)

    def rewrite(self, person: str, change: Callable[[R, Any], tuple[R, Any]]) -> Iterator[R]:
        """Apply a change to all events within a transaction; yield the record of each as it is stored now."""
        with self._sqlite_errors():
            rows = self._db.execute("SELECT n, person, record, answer FROM events ORDER BY n").fetchall()
        for n, owner, text, answer in rows:
            record = self._record(text, n)
            after, answered = change(record, given := None if answer is None else json.loads(answer))
            if owner != person and (after, answered) == (record, given):
                yield record
                continue
            new: dict[str, Any] = {"record": after.text(), "answer": None if answered is None else _text(answered)}
            if owner == person:
                id = after.event.id
                new |= {"person": after.event.who or "", "reporter": after.event.reporter}
                new |= {} if after.begins_for_others else {"at": None}
                new |= {"id": id, "reported": None if id is None else after.event.reported}
            with self._sqlite_errors():
                self._db.execute(
                    f"UPDATE events SET {', '.join(f'{name} = :{name}' for name in new)} WHERE n = :n", new | {"n": n}
                )
            yield self._record(new["record"], n)

    def purge(self) -> None:
        """Remove what erased records have left in the files. Does nothing if it has been done.

        Raises
        ------
        JournalError
            There is no room, or another program reads the database. It is done when the session is opened again.
        """
        try:
            if not self._db.execute("SELECT count(*) FROM erased WHERE purged = 0").fetchone()[0]:
                return
            self._db.execute("VACUUM")
            if self._db.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()[0]:
                raise sqlite3.OperationalError("another program reads it")
            self._db.execute("UPDATE erased SET purged = 1")
        except (sqlite3.Error, OSError) as error:
            left = f"the records are erased, but traces may remain until the session is opened again ({error})"
            raise JournalError(errno.EIO, left, str(self.file)) from error

    def close(self) -> None:
        """Close the database; repeated calls have no effect."""
        lock, self._lock = self._lock, -1
        if lock >= 0:
            if self._db is not None:
                with suppress(sqlite3.Error):  # the log is moved into the database when it is opened again
                    self._db.close()
            os.close(lock)


def stored(file: Path) -> tuple[dict[str, Any], list[tuple[str | None, dict[str, Any]]]]:
    """Return the header of a session, and the time in UTC and the record of each event. The session may be running.

    Raises
    ------
    InputFileError
        The file is not of a session.
    OSError
        There is no such file.
    """
    file.stat()  # the operating system's own error, if there is none
    # On a medium that cannot be written there is no log beside the database, so nothing can change.
    fixed = not os.access(file.parent, os.W_OK) and not file.with_name(f"{file.name}-wal").exists()
    address = f"{file.absolute().as_uri()}?mode=ro{'&immutable=1' * fixed}"
    try:
        with closing(sqlite3.connect(address, uri=True, timeout=10.0)) as db:
            header = _header(db, file)
            rows = db.execute("SELECT n, at, record FROM events ORDER BY n").fetchall()
    except sqlite3.Error as error:
        raise _as_error(error, file) from error
    if header is None:
        raise InputFileError.of(file, None, "is not the journal of a session")
    return header, [(at, _document(record, file, n)) for n, at, record in rows]


def private(file: Path) -> None:
    """Create a file, with its folder, unless it exists, and let only its owner read it."""
    file.parent.mkdir(parents=True, exist_ok=True)
    os.close(os.open(file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, OWNER_ONLY))
    with suppress(PermissionError):  # the file is another user's, who shares it
        file.chmod(OWNER_ONLY)


def utc() -> str:
    """Return the present time in UTC, to the millisecond."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def _header(db: sqlite3.Connection, file: Path) -> dict[str, Any] | None:
    try:
        row = db.execute("SELECT document FROM header ORDER BY rowid").fetchone()
    except sqlite3.Error as error:
        raise _as_error(error, file) from error
    return None if row is None else _document(row[0], file, 0)


def _text(document: Any) -> str:
    return json.dumps(document, separators=(",", ":"), default=str)


def _document(text: Any, file: Path, n: int) -> dict[str, Any]:
    try:
        found = json.loads(text)
    except (ValueError, TypeError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise InputFileError.of(file, None, f"event {n} is not an event of a session; expected a JSON object")
    return found


def _as_error(error: sqlite3.Error, file: Path) -> Exception:
    """Return the exception of this module, or of Python, that stands for an error of SQLite."""
    code = getattr(error, "sqlite_errorcode", None) or 0
    if code & 0xFF in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR):
        return InputFileError.of(file, None, f"is damaged ({error}); expected the journal of a session")
    if code & 0xFF == sqlite3.SQLITE_FULL:
        return JournalError(errno.ENOSPC, f"{os.strerror(errno.ENOSPC)}; nothing was recorded", str(file))
    return JournalError(errno.EIO, f"{error}; nothing was recorded", str(file))
