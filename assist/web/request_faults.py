"""What is wrong with a request, in one sentence: where, what is there, and what would be right."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from fastapi import Request
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute
from starlette.routing import BaseRoute, Match

from planner.system.errors import nearest

from ..declare.declared import phrase
from .event_routes import SAID

OBJECT = "expected an object, such as {}"
JSON = {list: "a list", str: "a text", bool: "a truth value", int: "a number", float: "a number"}


async def told(request: Request, error: RequestValidationError) -> str:
    """Return the first fault of a request's body or parameters."""
    first = error.errors()[0]
    if first["type"] == SAID:
        return str(first["msg"])
    if first["loc"][0] != "body":
        return _of_parameter(request, str(first["loc"][-1]), first)
    if first["type"] == "json_invalid":
        why = str(first["ctx"]["error"])
        return f"request body: no JSON at character {first['loc'][1] + 1} ({why[:1].lower()}{why[1:]}); {OBJECT}"
    kind = request.headers.get("content-type", "")
    if "json" not in kind and await request.body():
        found = f"Content-Type: {kind[:80]}" if kind else "the header Content-Type is missing"
        return f"{found}; expected Content-Type: application/json"
    if first["type"] == "missing" or first["input"] is None:
        return f"request body: is missing; {OBJECT}"
    return f"request body: {JSON.get(type(first['input']), 'no object')}; {OBJECT}"


def _of_parameter(request: Request, name: str, fault: dict[str, Any]) -> str:
    """Return the fault of a parameter of the address."""
    route = request.scope["route"]
    fields = [*route.dependant.path_params, *route.dependant.query_params] if isinstance(route, APIRoute) else []
    kinds = (Annotated[one.field_info.annotation, one, *one.field_info.metadata] for one in fields if one.alias == name)
    right = next(map(phrase, kinds), "another value")
    if fault["type"] == "missing":
        return f"parameter {name!r} of the address: is missing; expected {right}"
    return f"{name} {str(fault['input'])[:80]!r}: expected {right}"


def unread(error: BaseException | None) -> str:
    """Return why a body could not be read at all."""
    why = "is nested too deeply"
    if isinstance(error, ValueError):
        why = "is not in UTF-8" if isinstance(error, UnicodeDecodeError) else "has a number of too many digits"
    return f"request body: {why}; {OBJECT}"


def unknown(request: Request, routes: Sequence[BaseRoute]) -> str:
    """Return that an address of the interface does not exist, with the most similar one."""
    path = request.scope["path"]
    known = [one.path for one in routes if isinstance(one, APIRoute) and one.include_in_schema]
    near = nearest(path.removeprefix("/api/"), [one.removeprefix("/api/") for one in known])
    right = "see /docs for those that there are" if near is None else f"did you mean /api/{near}?"
    return f"{path[:200]}: there is no such address; {right}"


def allowed(request: Request, routes: Sequence[BaseRoute]) -> list[str]:
    """Return the methods that an address takes."""
    here = [one for one in routes if isinstance(one, APIRoute) and one.matches(request.scope)[0] is not Match.NONE]
    return sorted({method for one in here for method in one.methods or ()})
