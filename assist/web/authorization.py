"""Whom a request is let through to: what is theirs for a person, everything for the operator.

What decides that is quick, and runs in the event loop, to which the service belongs: FastAPI would give each function
that is not `async` a thread.
"""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Depends, HTTPException, Request
from fastapi.security import HTTPBearer

from .schemas import Problem
from .service import Service
from .tokens import Caller

SAYS = {
    400: "Not a request that can be read.", 401: "No token, or nobody's.", 403: "Another person's link.",
    404: "Nobody of that name is there.", 409: "It cannot be done now.", 413: "Too large.", 422: "Not valid.",
    429: "Too many requests.", 503: "Too much at once, or a state that could not be evaluated.",
    507: "The disk is full: it has not happened.",
}  # fmt: skip


def refusals(*codes: int) -> dict[int | str, dict[str, Any]]:
    """Describe the codes of refused requests: those that every request may meet, and more."""
    return {code: {"model": Problem, "description": SAYS[code]} for code in (400, 401, 413, 429, *codes)}


READ, WRITE = refusals(403, 404), refusals(403, 404, 409, 422, 503, 507)
bearer = HTTPBearer(auto_error=False, description="The last part of a join link, or of the operator's.")


async def operator(request: Request, _: Annotated[Any, Depends(bearer)] = None) -> None:
    """Let only the operator in."""
    if request.state.caller.person is not None:
        raise HTTPException(403, "this is for the operator")
    request.app.state.service.visited.set()


async def own(request: Request, name: str, _: Annotated[Any, Depends(bearer)] = None) -> str:
    """Let in whoever the person is, and the operator."""
    caller: Caller = request.state.caller
    if caller.person not in (None, name):
        raise HTTPException(403, "this link is another person's")
    if name not in request.app.state.service.views:
        raise HTTPException(404, f"{name[:80]!r} is not in the team")
    request.app.state.service.visited.set()
    return name


async def service_of(request: Request) -> Service:
    """Give the service of this application."""
    service: Service = request.app.state.service
    return service


Operator = Annotated[None, Depends(operator)]
Own = Annotated[str, Depends(own)]
Desk = Annotated[Service, Depends(service_of)]
