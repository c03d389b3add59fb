"""Limits on every request before it is handled: authentication, size and rate.

This is pure ASGI middleware. It also adds headers to every answer: pages load nothing from elsewhere and disclose their
address to no other server.
"""

from __future__ import annotations

import asyncio
import ipaddress
import json
import math
import time
from collections.abc import Callable, Sequence

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ..declare.catalogue import Catalogue, catalogue
from . import cookies
from .tokens import VISITOR, AccessTokens, Caller

LARGEST = 64 * 1024
"""Largest request body in bytes. Real requests have less than 1 kB; the limit bounds memory under attack."""

SLOWEST = 30.0
"""Seconds within which a body has to arrive. Slower clients would keep connections for nothing."""

HEADERS = [
    (
        b"content-security-policy",  # pages load nothing from other servers
        b"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
        b"form-action 'none'; base-uri 'none'; frame-ancestors 'none'",
    ),
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
    (b"cache-control", b"no-store"),
]


Networks = Sequence[str]
"""Networks of proxies that report the client's address."""


def networks(texts: Sequence[str]) -> Networks:
    """Return the networks of proxies, given as addresses such as 127.0.0.1 or networks such as 10.0.0.0/8.

    Raises
    ------
    ValueError
        A text is neither.
    """
    found = []
    for text in texts:
        try:
            found.append(str(ipaddress.ip_network(text.strip(), strict=False)))
        except ValueError:
            raise ValueError(f"{text[:60]}: expected an address such as 127.0.0.1, or a network 10.0.0.0/8") from None
    return found


def address_of(scope: Scope) -> str:
    """Return the network address of a client, for limits; what trusted proxies report of it is in the scope by now.

    Of an IPv6 address the first half counts: a household or a site has the other half to itself, 2^64 addresses.
    """
    address = str((scope.get("client") or ("",))[0])
    try:
        found = ipaddress.ip_address(address)
    except ValueError:
        return address  # of a test, or of a socket of this machine
    if isinstance(found, ipaddress.IPv4Address):
        return address
    return str(found.ipv4_mapped or ipaddress.ip_network((found.packed, 64), strict=False))


class Allowance:
    """Rate limit of each caller, a token bucket.

    Parameters
    ----------
    rate : float
        Requests per second. A page sends a few.
    burst : float
        Requests at once after a pause.
    for_operator : float
        Factor on both for the operator, whose programs may report for many people.
    for_pages : float
        Factor on both for pages, by network address: 100 people in one room who open a page at the same second request
        some 15 files each.
    callers : int
        Callers whose rate is remembered, some hundred bytes each. The limit bounds memory under attack.
    clock : callable
        Returns the time in seconds.
    """

    def __init__(
        self, rate: float = 100.0, burst: float = 400.0, *, for_operator: float = 10.0, for_pages: float = 20.0,
        callers: int = 20_000, clock: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        self.rate, self.burst, self.for_operator, self.for_pages = rate, burst, for_operator, for_pages
        self._callers, self._clock = callers, clock
        self._left: dict[str, tuple[float, float]] = {}

    def wait(self, caller: str, share: float = 1.0) -> float:
        """Count a request; return the seconds after which it is allowed, 0 if it is allowed now."""
        now = self._clock()
        left, since = self._left.pop(caller, (self.burst * share, now))
        left = min(self.burst * share, left + (now - since) * self.rate * share)
        allowed = left >= 1
        if len(self._left) >= self._callers:
            del self._left[next(iter(self._left))]  # the caller that has been idle longest
        self._left[caller] = (left - allowed, now)
        return 0.0 if allowed else (1 - left) / (self.rate * share)


class Guard:
    """Middleware that admits authenticated requests within the limits and adds `HEADERS` to every answer.

    Pages, which contain no data, the description of the interface and the state of the service need no token. The
    caller is stored in the scope's state as `caller`; the scope's path is made relative to the service.
    """

    def __init__(
        self, app: ASGIApp, access: AccessTokens, allowance: Allowance | None = None,
        texts: Catalogue | None = None,
    ) -> None:  # fmt: skip
        self.app, self._access, self._allowance = app, access, allowance or Allowance()
        self._texts = texts or catalogue()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a request."""
        if "path" in scope:
            scope = {**scope, "path": self._access.within(scope["path"])}
        if scope["type"] == "http":
            await self._request(scope, receive, _guarded(send))
        else:
            await self.app(scope, receive, send)

    def _token(self, scope: Scope) -> tuple[str, bool]:
        """Return the token of a request, and whether it is refused because another site's page sends its cookie."""
        token = token_of(scope)
        if not token and (kept := cookies.token_in(scope, self._access.base)):
            return (kept, False) if cookies.is_own_page(scope, self._access.base) else ("", True)
        return token, False

    def _worded(self, caller: Caller | None, key: str, **values: object) -> str:
        """Return the text of a refusal, in the language of the pages for people."""
        texts = catalogue() if caller is None or caller.person is None else self._texts
        return texts.refusal(key, **values)

    def _wait(self, scope: Scope, caller: Caller | None) -> float:
        """Count a request; return the seconds after which it is allowed.

        Callers without a valid token share a limit for each network address. It is larger for pages, and for visitors
        of a study, who all have the same token, since a whole waiting room may be behind one address.
        """
        address = address_of(scope)
        if caller is not None and caller.person == VISITOR:
            return self._allowance.wait(f"visitors {address}", self._allowance.for_pages)
        if caller is not None:
            share = self._allowance.for_operator if caller.person is None else 1.0
            return self._allowance.wait(f"caller {caller.person}", share)
        if scope["path"].startswith("/api/"):
            return self._allowance.wait(f"address {address}")
        return self._allowance.wait(f"pages {address}", self._allowance.for_pages)

    async def _request(self, scope: Scope, receive: Receive, send: Send) -> None:
        token, foreign = self._token(scope)
        caller = self._access.whose(token) if token else None
        scope.setdefault("state", {}).update(caller=caller, address=address_of(scope))
        wait = self._wait(scope, caller)
        if wait:
            said = self._worded(caller, "many")
            await refuse(send, 429, said, retry_after=math.ceil(wait))
            return
        if foreign:
            await refuse(send, 403, catalogue().refusal("foreign"))
            return
        path = scope["path"]
        if path.startswith(("/api/", "/metrics")) and path != "/api/health" and caller is None:
            what = "invalid token" if token else "missing token"
            await refuse(
                send,
                401,
                f"{what}; expected the header 'Authorization: Bearer TOKEN' with the part of the link after #",
            )
            return
        length = dict(scope["headers"]).get(b"content-length", b"0")
        try:
            async with asyncio.timeout(SLOWEST):
                body = None if length.isdigit() and int(length) > LARGEST else await _body(receive)
        except TimeoutError:
            await refuse(send, 408, self._worded(caller, "slow", n=f"{SLOWEST:g}"))
            return
        if body is None:
            await refuse(send, 413, self._worded(caller, "large", n=LARGEST))
            return
        unread = [body]

        async def read() -> Message:
            return unread.pop() if unread else await receive()

        await self.app(scope, read, send)


def token_of(scope: Scope) -> str:
    """Return the token in a request's header `Authorization`; empty if there is none."""
    for name, value in scope["headers"]:
        if name == b"authorization":
            scheme, _, token = value.decode("latin-1").partition(" ")
            return token.strip() if scheme.lower() == "bearer" else ""
    return ""


async def _body(receive: Receive) -> Message | None:
    """Return the request body as one message, or None if it exceeds `LARGEST`."""
    parts, size, more = [], 0, True
    while more:
        message = await receive()
        if message["type"] != "http.request":
            return message
        parts.append(message.get("body", b""))
        size, more = size + len(parts[-1]), message.get("more_body", False)
        if size > LARGEST:
            return None
    return {"type": "http.request", "body": b"".join(parts), "more_body": False}


def _guarded(send: Send) -> Send:
    async def guarded(message: Message) -> None:
        if message["type"] == "http.response.start":
            own = {name.lower() for name, _ in message.get("headers", ())}
            message["headers"] = [*message.get("headers", ()), *(one for one in HEADERS if one[0] not in own)]
        await send(message)

    return guarded


async def refuse(send: Send, status: int, detail: str, *, retry_after: int | None = None) -> None:
    """Send a refusal as JSON, in the form of all refusals."""
    body = json.dumps({"detail": detail}).encode()
    headers = [(b"content-type", b"application/json"), (b"content-length", str(len(body)).encode())]
    if status == 401:
        headers.append((b"www-authenticate", b"Bearer"))
    if status in (408, 413):
        headers.append((b"connection", b"close"))  # the rest of the body is not read
    if retry_after is not None:
        headers.append((b"retry-after", str(retry_after).encode()))
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
