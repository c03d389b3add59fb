"""What was learned about people in earlier sessions: their beliefs by name, in an SQLite database of its own.

A session that has a store takes the belief in a person who joins from it, in place of the prior, and saves the belief
when the person finishes a task, leaves, or the session ends. Theta, the state of the trust rule, is part of the belief.
A belief is used only where it means the same: for the same grid, population and trust rule.

Beliefs expire, and `erase` removes a person for good: what SQLite frees it overwrites with zeros, and no log remains.
"""

from __future__ import annotations

import errno
import hashlib
import json
import sqlite3
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import closing, contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from planner.system.errors import InputFileError

from ..declare.declared import AnyText, declared
from ..declare.rows import created, insert
from ..people.decision import Floats
from .store import JournalError, private


@declared
class PersonRow:
    """A row of the table `people`."""

    name: Annotated[AnyText, Field(description="The person.")]
    model: Annotated[AnyText, Field(description="What the belief means, as `model_of` says it.")]
    shape: Annotated[AnyText, Field(description="The shape of the belief, as JSON.")]
    belief: Annotated[bytes, Field(description="The belief, in numbers of eight bytes, the lowest first.")]
    expires: Annotated[AnyText, Field(description="When the row is removed, UTC.")]


TABLE = f"{created('people', PersonRow, {'name': 'PRIMARY KEY'})} WITHOUT ROWID"


def _now() -> datetime:
    return datetime.now(UTC)


class PeopleStore:
    """A database of beliefs. Several sessions may use it at a time; the last to save a person prevails.

    Parameters
    ----------
    file : str or Path
        Created, with its folder, if it does not exist.
    days : float
        Days after which a belief that is not saved again expires, up to 36,500.
    except_for : collection of str
        People who are neither saved nor looked up, such as simulated ones.
    now : callable
        Returns the present time in UTC.

    Raises
    ------
    InputFileError
        The file is no such database.
    JournalError
        It cannot be read or written.
    """

    def __init__(
        self,
        file: str | Path,
        days: float = 30.0,
        *,
        except_for: Collection[str] = (),
        now: Callable[[], datetime] = _now,
    ) -> None:
        most = 36_500  # a hundred years; dates end with the year 9999
        if not 0 < days <= most:
            raise ValueError(f"days {days}: expected a number above 0 and up to {most:,}")
        self.file, self._days, self._except, self._now = Path(file), days, frozenset(except_for), now
        private(self.file)
        with self._connected() as db:
            db.execute(TABLE)
        self.expire()

    @contextmanager
    def _connected(self) -> Iterator[sqlite3.Connection]:
        """Connect for one transaction, since sessions save rarely."""
        try:
            with closing(sqlite3.connect(self.file, timeout=10.0)) as db:  # seconds, for another session to finish
                db.executescript(
                    "PRAGMA temp_store=MEMORY; PRAGMA secure_delete=ON; PRAGMA journal_mode=DELETE; "
                    "PRAGMA synchronous=FULL"
                )
                with db:
                    yield db
        except sqlite3.DatabaseError as error:
            if isinstance(error, sqlite3.OperationalError):
                raise JournalError(errno.EIO, str(error), str(self.file)) from error
            raise InputFileError.of(self.file, None, f"is no store of people ({error})") from error

    def names(self) -> list[str]:
        """Return whose beliefs are stored and have not expired, in alphabetical order."""
        self.expire()
        with self._connected() as db:
            return [name for (name,) in db.execute("SELECT name FROM people ORDER BY name")]

    def belief(self, person: str, model: str) -> Floats | None:
        """Return the stored belief in a person, shape (B, T), bit for bit; None if there is none for this model.

        Parameters
        ----------
        person : str
        model : str
            As from `model_of`.
        """
        if person in self._except:
            return None
        with self._connected() as db:
            row = db.execute(
                "SELECT shape, belief FROM people WHERE name = ? AND model = ? AND expires > ?",
                (person, model, self._now().isoformat()),
            ).fetchone()
        if row is None:
            return None
        try:
            return np.frombuffer(row[1], dtype="<f8").reshape(json.loads(row[0])).astype(float)
        except (ValueError, TypeError) as error:
            raise InputFileError.of(self.file, None, f"the belief in {person!r} is damaged ({error})") from error

    def save(self, person: str, model: str, belief: Floats) -> None:
        """Save the belief in a person, in place of an earlier one."""
        if person in self._except:
            return
        expires = (self._now() + timedelta(days=self._days)).isoformat()
        row = PersonRow(person, model, json.dumps(belief.shape), belief.astype("<f8").tobytes(), expires)
        with self._connected() as db:
            insert(db, "people", row, instead=True)

    def erase(self, person: str) -> bool:
        """Remove what is stored of a person, for good; return whether there was anything."""
        with self._connected() as db:
            found = db.execute("DELETE FROM people WHERE name = ?", (person,)).rowcount
        self._vacuum()  # pages that were moved within the file may hold copies
        return found > 0

    def expire(self) -> None:
        """Remove, for good, what has expired."""
        with self._connected() as db:
            found = db.execute("DELETE FROM people WHERE expires <= ?", (self._now().isoformat(),)).rowcount
        if found:
            self._vacuum()

    def _vacuum(self) -> None:
        with self._connected() as db:
            db.commit()  # it cannot run within a transaction
            db.execute("VACUUM")


def model_of(
    population: Mapping[str, Any], setting: Mapping[str, Any], own: Mapping[str, Any] = MappingProxyType({})
) -> str:
    """Return a text that is the same for beliefs that mean the same.

    Parameters
    ----------
    population, setting : mapping
        As `as_dict` returns them. The population determines the grid.
    own : mapping, optional
        Hashes of the user's own code, as a header has them: `chances` of a choice model, `moves` of trust rules.
    """
    rule = [setting.get(name) for name in ("trust", "believed_trust", "eta", "utility_scale", "lapse")]
    return hashlib.sha256(
        json.dumps([population, rule, own.get("chances"), own.get("moves")], default=str).encode()
    ).hexdigest()[:32]
