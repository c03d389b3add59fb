"""Authorisation: people may access what concerns themselves, the operator everything.

These functions are fast and run in the event loop, which owns the service. They are `async` because FastAPI runs other
functions in threads.
"""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Depends, Request
from fastapi.routing import APIRoute
from fastapi.security import HTTPBearer

from planner.system.errors import expected

from ..declare.declared import Kind
from ..declare.refusals import Refusal
from ..live.names import name_of
from .schemas import Problem
from .service import Service
from .tokens import Caller

SAYS = {
    400: "Malformed request.", 401: "Missing or invalid token.", 403: "The link is another person's.",
    404: "Unknown person.", 408: "The body did not arrive in time.", 409: "Not possible in the present state.",
    413: "Too large.", 422: "Invalid.",
    429: "Too many requests.", 503: "Overloaded, or a state could not be evaluated.",
    507: "The disk is full; nothing was recorded.",
}  # fmt: skip


def refusals(*codes: int) -> dict[int | str, dict[str, Any]]:
    """Return the descriptions of error codes: those that any request may receive, and the given ones."""
    return {code: {"model": Problem, "description": SAYS[code]} for code in (400, 401, 408, 413, 429, *codes)}


READ, WRITE = refusals(403, 404), refusals(403, 404, 409, 422, 503, 507)
bearer = HTTPBearer(auto_error=False, description="The part of a join link or of the operator's link after #.")


async def operator(request: Request, _: Annotated[Any, Depends(bearer)] = None) -> None:
    """Refuse every caller except the operator."""
    if request.state.caller.person is not None:
        raise Refusal("operator_only")
    request.app.state.service.heard(None)


async def own(request: Request, person: str, _: Annotated[Any, Depends(bearer)] = None) -> str:
    """Refuse every caller except the person and the operator."""
    caller: Caller = request.state.caller
    person = name_of(person)
    if caller.person not in (None, person):
        raise Refusal("another")
    service: Service = request.app.state.service
    service.view(person)
    service.heard(caller.person)
    return person


async def known_query(request: Request) -> None:
    """Refuse parameters in the address of a request that it does not have. Those of pages are read by their scripts."""
    route = request.scope.get("route")
    if isinstance(route, APIRoute) and route.include_in_schema:
        known = [field.alias for field in route.dependant.query_params]  # of the requests, not of what they depend on
        for name in request.query_params:
            if name not in known:
                right = expected(name, known) if known else "expected none"
                raise Refusal("other", why=f"parameter {name[:80]!r} of the address: unknown; {right}")


async def service_of(request: Request) -> Service:
    """Return the service of this application."""
    service: Service = request.app.state.service
    return service


Operator = Annotated[None, Depends(operator)]
Own = Annotated[str, Depends(own)]
Desk = Annotated[Service, Depends(service_of)]
Numbered = Annotated[int, Kind("a whole number")]
