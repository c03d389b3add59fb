"""Requests of the live assistant and their answers, which are JSON."""

from __future__ import annotations

import asyncio
import json
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request, Response
from fastapi.responses import JSONResponse

from ..declare.catalogue import languages
from ..declare.declared import Expected, Kind, View
from ..declare.refusals import AbsentError, Refusal
from ..live.names import LONGEST_REASON
from ..live.robot_places import robot_numbers
from ..live.store import Tombstone
from ..live.views import PersonView, RobotView
from ..studies.userstudy.views import ParticipantView
from . import cookies
from .authorization import READ, Desk, Numbered, Operator, Own, bearer, refusals
from .schemas import Drawn, Explained, Health, Me, Reloaded, Team
from .service import Erasure
from .task_drawings import Pictures
from .tokens import Caller

router = APIRouter()
Reason = Annotated[
    str, Query(min_length=1, max_length=LONGEST_REASON), Expected(f"a reason of 1 to {LONGEST_REASON} characters")
]
Width = Annotated[int, Kind("a whole number"), Query(ge=240, le=2000)]
TaskName = Annotated[str, Query(max_length=200), Expected("the name of a task, of up to 200 characters")]


def plain(body: bytes | View, media_type: str = "application/json") -> Response:
    """Return a view as JSON, or what is encoded already."""
    return Response(body if isinstance(body, bytes) else json.dumps(body.as_dict()), media_type=media_type)


@router.get("/api/health", tags=["service"], response_model=Health, responses=refusals(422) | {503: {"model": Health}})
async def health(service: Desk, ready: Annotated[bool, Kind("true or false")] = False) -> Any:
    """Return the state of the service; needs no token. With `ready=true` the status is 503 if it is not ready."""
    reasons = service.unready()
    state = Health(
        ready=not reasons, reasons=tuple(reasons), people=len(service.views), events=service.outlook.seq
    )  # fmt: skip
    return JSONResponse(state.as_dict(), 503 if ready and reasons else 200)


@router.get("/api/me", tags=["service"], response_model=Me, responses=refusals(), dependencies=[Depends(bearer)])
async def me(request: Request) -> Response:
    """Return the owner of the token."""
    person = request.state.caller.person
    return plain(Me(person=person, operator=person is None))


@router.post("/api/session", tags=["service"], response_model=Me, responses=refusals(), dependencies=[Depends(bearer)])
async def session(request: Request, service: Desk) -> Response:
    """Set a cookie in place of the token, for the requests of pages."""
    caller: Caller = request.state.caller
    access = service.access
    answer = plain(Me(person=caller.person, operator=caller.person is None))
    token = access.operator if caller.person is None else access.token(caller.person)
    cookies.keep(answer, access, cookies.cookie_of(access.base, cookies.subject(caller)), token)
    return answer


@router.get("/api/people/{person}", tags=["people"], response_model=PersonView | ParticipantView, responses=READ)
async def view(person: Own, service: Desk) -> Response:
    """Return a person's view: the applicable actions, the suggestion and its reasons."""
    return plain(service.view(person))


@router.get("/api/people/{person}/drawing", tags=["people"], response_model=Drawn, responses=READ | refusals(409, 422))
async def drawing(person: Own, request: Request, service: Desk, width: Width = 760) -> Response:
    """Return a drawing of the person's task, about `width` pixels wide; pages also load `/pages/drawing.css`."""
    pictures: Pictures = request.app.state.pictures

    def drawn() -> View:
        seen = json.loads(service.view(person))  # read before the state: `seq` is then never newer than the drawing
        task, state = service.session.task_and_state(person)
        return pictures.of(task, state, seen, width)

    return plain(await asyncio.to_thread(drawn))


@router.get(
    "/api/people/{person}/explanation", tags=["people"], response_model=Explained, responses=READ | refusals(409, 422)
)
async def explanation(
    person: Own, request: Request, service: Desk,
    against: Annotated[
        str | None,
        Query(min_length=1, max_length=1000, examples=["(fetch box-b)"]),
        Expected("an action, as (name argument ...)"),
    ] = None,
    language: Annotated[str | None, Query(max_length=35), Expected("the name of a language, such as en")] = None,
) -> Response:  # fmt: skip
    """Return why the person has this suggestion now, or none; with `against`, the step against another action.

    The language is that of the pages, unless another one that comes with the package is named.
    """
    own = language in (None, service.texts.tag)
    if not own and language not in languages():
        raise Refusal("other", why=f"language: expected one of {', '.join(languages())}")
    spoken = str(service.texts.file) if own or language is None else language
    pictures: Pictures = request.app.state.pictures
    named = request.state.caller.person is None

    def explained() -> View:
        seq = json.loads(service.view(person))["seq"]  # read before the state, as above
        task, _ = service.session.task_and_state(person)
        found = service.explain(person, against)
        found = found.in_words(pictures.words(task, found.actions, spoken))
        if not named:  # a person learns about others what could be gained, not who they are
            found = found.without_names()
        return Explained(**vars(found), sentences=tuple(found.sentences(spoken)), seq=seq)

    return plain(await asyncio.to_thread(explained))


@router.get("/api/robots/{robot}", tags=["robots"], response_model=RobotView, responses=refusals(403, 404, 422))
async def instruction(_: Operator, robot: Numbered, service: Desk) -> Response:
    """Return where a robot, by its number from 1, should go and what it should suggest there."""
    robots = service.outlook.robots
    if not 1 <= robot <= len(robots):
        raise AbsentError("other", why=f"robot {robot}: expected {robot_numbers(len(robots))}")
    return plain(robots[robot - 1])


@router.get("/api/team", tags=["team"], response_model=Team, responses=refusals(403))
async def team(_: Operator, service: Desk) -> Response:
    """Return all people with the beliefs about them, the robots, and the latest events."""
    return plain(await service.team())


@router.delete(
    "/api/people/{person}/records", tags=["team"], response_model=Tombstone, responses=refusals(403, 404, 422, 503, 507)
)
async def erase(_: Operator, person: str, service: Desk, reason: Reason) -> Response:
    """Erase all that is recorded of a person, for good; present or not, they leave first."""
    return plain(Tombstone(**await service.report(Erasure(person, reason))))


@router.post("/api/reload", tags=["team"], response_model=Reloaded, responses=refusals(403, 409, 422, 503, 507))
async def reload(_: Operator, service: Desk) -> Response:
    """Read the service's configuration again, and follow changed distances and people's tasks."""
    found = await service.reload()
    return plain(Reloaded(len(found.events), tuple(found.restart), tuple(found.new_session)))


@router.get(
    "/api/log", tags=["team"], response_class=Response,
    responses=refusals(403, 422) | {200: {"content": {"application/x-ndjson": {"schema": {"type": "string"}}}}},
)  # fmt: skip
async def log(_: Operator, service: Desk, task: TaskName | None = None) -> Response:
    """Return recorded actions as JSON Lines for `kitassist fit`; with `task`, only those in this task."""
    rows = await asyncio.to_thread(service.session.log, task)
    return plain("".join(json.dumps(row) + "\n" for row in rows).encode(), "application/x-ndjson")
