"""Who may see and do what: a link for each person, and the operator's, each with a token that cannot be guessed.

Tokens follow from one secret that is kept with the session, so that links stay what they are when it goes on.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import os
import secrets
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

from planner.storage import atomic

SECRET = 32
"""Bytes."""


class Caller(NamedTuple):
    """Who calls: a person, or the operator, who has no name."""

    person: str | None


class Access:
    """The tokens of a session.

    Parameters
    ----------
    secret : bytes
    base : str
        Where the service is: what all addresses begin with, without a slash at the end.
    """

    def __init__(self, secret: bytes, base: str) -> None:
        self._secret, self.base = secret, base
        self.operator = self._token("operator")
        self._people: dict[str, str] = {}
        self._callers = {_digest(self.operator): Caller(None)}

    @classmethod
    def kept(cls, file: Path, base: str) -> Access:
        """Take the secret from a file, which is made if there is none, for its owner alone to read."""
        if not file.exists():
            with atomic(file) as path:
                descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
                with os.fdopen(descriptor, "wb") as stream:
                    stream.write(secrets.token_bytes(SECRET))
        secret = file.read_bytes()
        if len(secret) != SECRET:
            raise OSError(f"{file}: expected {SECRET} bytes, from which the links' tokens follow; found {len(secret)}")
        return cls(secret, base)

    def _token(self, what: str) -> str:
        made = hmac.new(self._secret, what.encode(), hashlib.sha256).digest()[:24]
        return base64.urlsafe_b64encode(made).decode()

    def token(self, person: str) -> str:
        """Give somebody's token."""
        if person not in self._people:
            self._people[person] = self._token(f"person {person}")
            self._callers[_digest(self._people[person])] = Caller(person)
        return self._people[person]

    def whose(self, token: str) -> Caller | None:
        """Find out whose token it is, in a time that tells nothing about any; None: nobody's.

        It is looked up by its digest, of which nothing can be learned bit by bit.
        """
        caller = self._callers.get(_digest(token))
        if caller is None:
            return None
        known = self.operator if caller.person is None else self._people[caller.person]
        return caller if hmac.compare_digest(token.encode(), known.encode()) else None

    def join_url(self, person: str) -> str:
        """Give the address of somebody's page."""
        return f"{self.base}/join/{quote(person, safe='')}/{self.token(person)}"

    def operator_url(self) -> str:
        """Give the address of the operator's page."""
        return f"{self.base}/operator/{self.operator}"


def _digest(token: str) -> bytes:
    return hashlib.sha256(token.encode(errors="replace")).digest()
