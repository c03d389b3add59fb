"""Cookies of pages: a page exchanges the token of its link for a cookie, and the token leaves the address.

A browser may have pages of several people, so there is a cookie for each person and each service. A request names the
one that it uses in a header. Browsers send cookies also with requests of other sites' pages, which are refused.
"""

from __future__ import annotations

import hashlib
from datetime import timedelta
from urllib.parse import unquote, urlsplit

from starlette.requests import HTTPConnection
from starlette.responses import Response
from starlette.types import Scope

from .tokens import AccessTokens, Caller

KEPT = timedelta(days=30)
"""Time for which a browser keeps a cookie, so that a study can continue in the next week."""

NAMED = b"kitassist-caller"
"""Header that names the cookie's owner, as `subject` does, percent-encoded."""


def subject(caller: Caller) -> str:
    """Return the name of a caller in requests."""
    return "operator" if caller.person is None else f"person {caller.person}"


def cookie_of(base: str, who: str) -> str:
    """Return the name of the cookie of a caller at a service; services on other ports share cookies."""
    return f"kitassist-{hashlib.sha256(f'{base} {who}'.encode(errors='replace')).hexdigest()[:16]}"


def keep(answer: Response, access: AccessTokens, name: str, value: str) -> None:
    """Let the browser keep a cookie, which no script reads and which goes to pages of this service only."""
    answer.set_cookie(
        name, value, max_age=int(KEPT.total_seconds()), path=f"{access.root}/",
        secure=access.base.startswith("https:"), httponly=True, samesite="strict",
    )  # fmt: skip


def token_in(scope: Scope, base: str) -> str:
    """Return the token in the cookie that a request names; empty if there is none."""
    named = [value.decode("latin-1") for name, value in scope["headers"] if name == NAMED]
    if not named:
        return ""
    return HTTPConnection(scope).cookies.get(cookie_of(base, unquote(named[0])), "")


def is_own_page(scope: Scope, base: str) -> bool:
    """Return whether a request comes from a page of this service, as far as the browser says."""
    headers = {name: value.decode("latin-1") for name, value in scope["headers"]}
    if headers.get(b"sec-fetch-site", "same-origin") != "same-origin":
        return False
    origin = headers.get(b"origin")
    if origin is None:
        return True
    at = urlsplit(base)
    try:
        return origin == f"{at.scheme}://{at.netloc}" or urlsplit(origin).netloc == headers.get(b"host", "")
    except ValueError:
        return False
