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
from urllib.parse import quote, unquote, urlsplit

from planner.system.files import atomic

SECRET = 32
"""Bytes."""

OWN = frozenset({"api", "docs", "join", "openapi.json", "operator", "pages", "part", "study"})
"""What the service's own paths begin with."""


def public_address(url: str) -> str:
    """Return the address at which others reach the service, without a slash at the end.

    Its path has none of the service's own names: so it does not matter whether a proxy strips it, and where it ends in
    a link is clear.

    Raises
    ------
    ValueError
        It is none.
    """
    wrong = ValueError(f"{url[:80]}: expected the address of the service, such as https://host.example/kits")
    try:
        parts = urlsplit(url)
        named = parts.scheme in ("http", "https") and parts.hostname and parts.port != 0
    except ValueError:  # a port or a number that is none
        raise wrong from None
    names = parts.path.strip("/").split("/") if parts.path.strip("/") else []
    more = any(sign in url for sign in "?#@\\") or not url.isascii() or not url.isprintable() or " " in url
    if not named or more or any(unquote(name) in ("", ".", "..") or "/" in unquote(name) for name in names):
        raise wrong
    for name in names:
        if unquote(name) in OWN:
            raise ValueError(f"{url[:80]}: expected a path without {name!r}, which the service's own pages have")
    return f"{parts.scheme}://{parts.netloc}{''.join(f'/{name}' for name in names)}"


class Caller(NamedTuple):
    """Who calls: a person, or the operator, who has no name."""

    person: str | None


class AccessTokens:
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
    def kept(cls, file: Path, base: str) -> AccessTokens:
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

    @property
    def root(self) -> str:
        """The path under which the service is: empty, or one that begins with a slash."""
        return urlsplit(self.base).path

    def within(self, path: str) -> str:
        """Return a decoded path within the service, whether or not a proxy has stripped what comes before."""
        root = unquote(self.root)
        return (path[len(root) :] or "/") if root and f"{path}/".startswith(f"{root}/") else path

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
