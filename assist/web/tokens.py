"""Access tokens: one link for each person and one for the operator, each with a secret token.

Links have the token behind a `#`. Browsers do not send this part of an address, so no proxy can record it.

All tokens are derived from one secret that is stored with the session. Links therefore stay valid when a session is
resumed.
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

VISITOR = "?"
"""Owner of the join link's token of a user study. It is no participant's code, since codes contain letters."""

PARTICIPANT = "participant "
"""Begins the ids of participants whom another system, such as a recruiting service, identifies."""

OWN = frozenset({"api", "docs", "join", "metrics", "openapi.json", "operator", "pages", "part", "study"})
"""First components of the service's own paths."""


def public_address(url: str) -> str:
    """Return a normalised public address of the service, without a trailing slash.

    The path must not contain any of the service's own names. It then does not matter whether a proxy strips the path,
    and the address can be separated from the rest of a link.

    Raises
    ------
    ValueError
        The text is not such an address.
    """
    wrong = ValueError(f"{url[:80]}: expected the address of the service, such as https://host.example/kits")
    try:
        parts = urlsplit(url)
        named = parts.scheme in ("http", "https") and parts.hostname and parts.port != 0
    except ValueError:  # the port is not a number, or the host is malformed
        raise wrong from None
    names = parts.path.strip("/").split("/") if parts.path.strip("/") else []
    more = any(sign in url for sign in "?#@\\") or not url.isascii() or not url.isprintable() or " " in url
    if not named or more or any(unquote(name) in ("", ".", "..") or "/" in unquote(name) for name in names):
        raise wrong
    for name in names:
        if unquote(name) in OWN:
            raise ValueError(f"{url[:80]}: expected a path without {name!r}, a name of the service's own pages")
    return f"{parts.scheme}://{parts.netloc}{''.join(f'/{name}' for name in names)}"


class Caller(NamedTuple):
    """The authenticated caller: a person, or the operator (`person` is None)."""

    person: str | None


class AccessTokens:
    """The tokens of a session.

    Parameters
    ----------
    secret : bytes
        Key from which all tokens are derived (HMAC-SHA-256).
    base : str
        Address of the service, with which all links begin, without a trailing slash.
    """

    def __init__(self, secret: bytes, base: str) -> None:
        self._secret, self.base = secret, base
        self.operator = self._token("operator")
        self._people: dict[str, str] = {}
        self._callers = {_digest(self.operator): Caller(None)}

    @classmethod
    def kept(cls, file: Path, base: str) -> AccessTokens:
        """Return the tokens for the secret in a file. A missing file is created, readable by its owner only."""
        return cls(secret_in(file), base)

    @property
    def root(self) -> str:
        """Path under which the service is reached: empty, or a path that begins with a slash."""
        return urlsplit(self.base).path

    def within(self, path: str) -> str:
        """Return a decoded path relative to the service, whether or not a proxy stripped the service's prefix."""
        root = unquote(self.root)
        return (path[len(root) :] or "/") if root and f"{path}/".startswith(f"{root}/") else path

    def _token(self, what: str) -> str:
        made = hmac.new(self._secret, what.encode(), hashlib.sha256).digest()[:24]
        return base64.urlsafe_b64encode(made).decode()

    def token(self, person: str) -> str:
        """Return the token of a person."""
        if person not in self._people:
            self._people[person] = self._token(f"person {person}")
            self._callers[_digest(self._people[person])] = Caller(person)
        return self._people[person]

    def whose(self, token: str) -> Caller | None:
        """Return the caller that a token belongs to, or None if the token is invalid.

        The lookup uses the token's digest and a comparison in constant time. Response times therefore reveal nothing
        about valid tokens.
        """
        caller = self._callers.get(_digest(token))
        if caller is None:
            return None
        known = self.operator if caller.person is None else self._people[caller.person]
        return caller if hmac.compare_digest(token.encode(), known.encode()) else None

    def signature(self, text: str) -> str:
        """Return the signature of a text, which only the owner of the secret can make."""
        return self._token(f"signed {text}")

    def is_signed(self, text: str, signature: str) -> bool:
        """Return whether this is the signature of a text."""
        return hmac.compare_digest(self.signature(text).encode(), signature.encode(errors="replace"))

    def signed(self, what: str, text: str) -> str:
        """Return a text with its signature, for one use (`what`)."""
        return f"{text}.{self.signature(f'{what} {text}')}"

    def signed_in(self, what: str, signed: str) -> str | None:
        """Return the text that `signed` returned this for; None if it is not signed, or for another use."""
        text, _, signature = signed.rpartition(".")
        return text if text and self.is_signed(f"{what} {text}", signature) else None

    def join_url(self, person: str) -> str:
        """Return the address of a person's page."""
        return f"{self.base}/join/{quote(person, safe='')}#{self.token(person)}"

    def operator_url(self) -> str:
        """Return the address of the operator's page."""
        return f"{self.base}/operator#{self.operator}"


def _digest(token: str) -> bytes:
    return hashlib.sha256(token.encode(errors="replace")).digest()


def secret_in(file: Path) -> bytes:
    """Return the secret in a file. A missing file is created, readable by its owner only.

    Raises
    ------
    OSError
        The file cannot be read or written, or holds something else.
    """
    size = hashlib.sha256().digest_size  # a longer key adds no security to HMAC
    if not file.exists():
        with atomic(file) as path:
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(descriptor, "wb") as stream:
                stream.write(secrets.token_bytes(size))
    secret = file.read_bytes()
    if len(secret) != size:
        raise OSError(f"{file}: expected the {size} bytes of the session's secret; found {len(secret)}")
    return secret
