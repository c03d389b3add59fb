"""What every request has to keep to before anybody looks at it: whose it is, its size, and how often they come.

Pure ASGI. Answers get the headers by which a page loads nothing from elsewhere and tells nobody its address.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from .tokens import AccessTokens

LARGEST = 64 * 1024
"""Bytes of a request's body."""

RATE, BURST = 100.0, 400.0
"""Requests a second of one person, and how many at once after a pause."""

OPERATOR = 10.0
"""How many times as many are the operator's."""

MOST_CALLERS = 20_000

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "form-action 'none'; base-uri 'none'; frame-ancestors 'none'"
)
"""What a page may load: nothing but what this service has."""

HEADERS = [
    (b"content-security-policy", POLICY.encode()),
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
    (b"cache-control", b"no-store"),
]


class Allowance:
    """How many requests of each caller there may be: so many a second, and some more at once (a token bucket)."""

    def __init__(self, rate: float = RATE, burst: float = BURST, clock: Callable[[], float] = time.monotonic) -> None:
        self.rate, self.burst, self._clock = rate, burst, clock
        self._left: dict[str, tuple[float, float]] = {}

    def wait(self, caller: str, share: float = 1.0) -> float:
        """Count a request; give the seconds after which it may come again, 0 if it may now."""
        now = self._clock()
        left, since = self._left.pop(caller, (self.burst * share, now))
        left = min(self.burst * share, left + (now - since) * self.rate * share)
        allowed = left >= 1
        if len(self._left) >= MOST_CALLERS:
            del self._left[next(iter(self._left))]  # who has not called for longest
        self._left[caller] = (left - allowed, now)
        return 0.0 if allowed else (1 - left) / (self.rate * share)


class Guard:
    """Lets in who has a token, as often and with as much as is allowed, and puts `HEADERS` on every answer.

    What may be seen without a token are the pages, which hold no data, the description of the interface, and whether
    the service is well. Who calls is in the scope's state as `caller`; the path is that within the service.
    """

    def __init__(self, app: ASGIApp, access: AccessTokens, allowance: Allowance | None = None) -> None:
        self.app, self._access, self._allowance = app, access, allowance or Allowance()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Take a request, or a connection."""
        if "path" in scope:
            scope = {**scope, "path": self._access.within(scope["path"])}
        if scope["type"] == "websocket":
            caller = self._access.whose(token_of(scope))
            scope.setdefault("state", {})["caller"] = caller
            if caller is None:
                await receive()
                await send({"type": "websocket.close", "code": 4401})
            else:
                await self.app(scope, receive, send)
        elif scope["type"] == "http":
            await self._request(scope, receive, _guarded(send))
        else:
            await self.app(scope, receive, send)

    async def _request(self, scope: Scope, receive: Receive, send: Send) -> None:
        token = token_of(scope)
        caller = self._access.whose(token) if token else None
        scope.setdefault("state", {})["caller"] = caller
        # Who has no token of this session shares what there is for all of them at that address.
        who = f"caller {caller.person}" if caller else f"address {(scope.get('client') or ('',))[0]}"
        wait = self._allowance.wait(who, OPERATOR if caller and caller.person is None else 1.0)
        if wait:
            await refuse(send, 429, "too many requests; to be tried again later", retry_after=math.ceil(wait))
            return
        if scope["path"].startswith("/api/") and scope["path"] != "/api/health" and caller is None:
            what = "invalid token" if token else "a token is missing"
            await refuse(
                send, 401, f"{what}; expected the header Authorization: Bearer, with the last part of the link"
            )
            return
        length = dict(scope["headers"]).get(b"content-length", b"0")
        body = None if length.isdigit() and int(length) > LARGEST else await _body(receive)
        if body is None:
            await refuse(send, 413, f"the body is larger than {LARGEST} bytes")
            return
        unread = [body]

        async def read() -> Message:
            return unread.pop() if unread else await receive()

        await self.app(scope, read, send)


def token_of(scope: Scope) -> str:
    """Give the token that a request has, in its header; a page's connection has it among its subprotocols."""
    for name, value in scope["headers"]:
        if name == b"authorization":
            scheme, _, token = value.decode("latin-1").partition(" ")
            return token.strip() if scheme.lower() == "bearer" else ""
    for protocol in scope.get("subprotocols", ()):
        if protocol.startswith("token."):
            return str(protocol.removeprefix("token."))
    return ""


async def _body(receive: Receive) -> Message | None:
    """Read a body, which is small; None: it is not."""
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
    """Answer with what is wrong, as everything here does."""
    body = json.dumps({"detail": detail}).encode()
    headers = [(b"content-type", b"application/json"), (b"content-length", str(len(body)).encode())]
    if status == 401:
        headers.append((b"www-authenticate", b"Bearer"))
    if status == 413:
        headers.append((b"connection", b"close"))  # nobody reads the rest
    if retry_after is not None:
        headers.append((b"retry-after", str(retry_after).encode()))
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
