"""Requests that report events. Each follows from the class of the event: its path, its fields, and what is answered."""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Mapping
from functools import cache, partial
from typing import Annotated, Any

from fastapi import APIRouter, Response
from pydantic import BaseModel, ValidationError, ValidatorFunctionWrapHandler, WrapValidator, create_model
from pydantic_core import PydanticCustomError

from ..live.event_base import Event, Recorded, fault_of
from ..live.events import kinds
from .authorization import WRITE, Desk, Numbered, Operator, Own

SAID = "said"
"""Type of the errors whose message is a whole sentence."""


def event_routes(base: type[Event], views: Mapping[str, type[Any]]) -> APIRouter:
    """Return the requests that report the events below a class.

    Parameters
    ----------
    base : type
        `TeamEvent`, or the events of a study.
    views : mapping of str to type
        What is answered, by `Event.shows`.
    """
    reported = [kind for kind in kinds(base).values() if kind.path is not None]
    return _router(*((kind, views[kind.shows]) for kind in reported))


@cache
def _router(*reported: tuple[type[Event], type[BaseModel]]) -> APIRouter:
    """Return requests that report events; they are the same for all services in a process."""
    router = APIRouter()
    for kind, view in reported:
        _add(router, kind, view)
    return router


def body_of(kind: type[Event]) -> type[BaseModel]:
    """Return the class of the body of a request: the fields that are not in the path."""
    inside = inside_path(kind)
    fields: dict[str, Any] = {
        name: (kind.model_fields[name].annotation, kind.model_fields[name])
        for name in kind.fields()
        if name not in inside
    }
    return create_model(kind.__name__, __base__=Recorded, __doc__=kind.__doc__, **fields)


def inside_path(kind: type[Event]) -> list[str]:
    """Return the fields that are in the path of an event."""
    return re.findall(r"\{(\w+)\}", kind.path or "")


def told(body: type[BaseModel]) -> WrapValidator:
    """Return what an annotation of the body of a request has, so that its faults are told in one sentence."""
    return WrapValidator(partial(_said, body))


def _said(body: type[BaseModel], given: Any, checked: ValidatorFunctionWrapHandler) -> Any:
    """Return a body; a fault in it is told in the sentence that a bridge or a file would get, too."""
    try:
        return checked(given)
    except ValidationError as error:
        if not isinstance(given, dict):
            raise
        raise PydanticCustomError(SAID, "{why}", {"why": fault_of(body, error, given)}) from None


def _add(router: APIRouter, kind: type[Event], view: type[Any]) -> None:
    inside, body = inside_path(kind), body_of(kind)

    async def take(service: Any, body: Any = None, **given: Any) -> Response:
        named = {name: given[name] for name in inside}
        said = {} if body is None else {name: getattr(body, name) for name in body.model_fields_set}
        answer = await service.report(kind(**named, **said))
        if kind.shows == "place":
            answer = {**answer, "join": service.access.join_url(answer["person"])}
        return Response(json.dumps(answer), media_type="application/json")

    parameter = inspect.Parameter
    # A person need not be present when the operator's report is repeated; otherwise the event says who has to be.
    known = {"person": str if kind.by_operator else Own, "robot": Numbered}
    needed = [("service", Desk), *((name, known[name]) for name in inside)]
    if kind.by_operator:
        needed.append(("_", Operator))
    parameters = [parameter(name, parameter.KEYWORD_ONLY, annotation=one) for name, one in needed]
    required = any(field.is_required() for field in body.model_fields.values())
    whole = {} if required else {"default": None}
    checked: Any = Annotated[body, told(body)]
    annotation: Any = checked if required else checked | None
    parameters.append(parameter("body", parameter.KEYWORD_ONLY, annotation=annotation, **whole))
    take.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    take.__name__, take.__doc__ = kind.kind_name(), kind.__doc__
    path = str(kind.path)
    router.add_api_route(path, take, methods=["POST"], tags=[path.split("/")[2]], response_model=view, responses=WRITE)
