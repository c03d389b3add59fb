"""Requests of the live assistant: what each takes, and how it is answered. Every answer is JSON."""

from __future__ import annotations

import asyncio
import json
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request, Response

from ..live.course import Event
from .authorization import READ, WRITE, Desk, Operator, Own, bearer, refusals
from .schemas import Acted, Arrived, Begun, Drawn, Health, Joined, Me, Once, Paused, Person, Place, Robot, Team
from .task_drawings import Pictures

router = APIRouter()


def plain(body: bytes | dict[str, Any], media_type: str = "application/json") -> Response:
    """Answer with JSON that is there already, or with what can be made JSON."""
    return Response(body if isinstance(body, bytes) else json.dumps(body), media_type=media_type)


@router.get("/api/health", tags=["service"], response_model=Health, responses=refusals())
async def health(service: Desk) -> Any:
    """Whether the service is well; without a token."""
    return {"status": "ok", "people": len(service.views), "events": service.outlook.events}


@router.get("/api/me", tags=["service"], response_model=Me, responses=refusals(), dependencies=[Depends(bearer)])
async def me(request: Request) -> Any:
    """Whose the token is."""
    person = request.state.caller.person
    return {"person": person, "operator": person is None}


@router.get("/api/people/{name}", tags=["people"], response_model=Person, responses=READ)
async def person(name: Own, service: Desk) -> Response:
    """What somebody sees: what can be done, what is suggested and why."""
    return plain(service.views[name])


@router.get("/api/people/{name}/drawing", tags=["people"], response_model=Drawn, responses=READ | refusals(409, 422))
async def drawing(
    name: Own, request: Request, service: Desk, width: Annotated[int, Query(ge=240, le=2000)] = 760
) -> Response:
    """Somebody's task as a drawing of about a width in pixels, for pages that bring `/pages/drawing.css`."""
    pictures: Pictures = request.app.state.pictures

    def drawn() -> dict[str, Any]:
        seen = json.loads(service.views[name])  # before the state is asked for: then never newer than what is drawn
        task, state = service.session.place(name)
        return {**pictures.of(task, state, seen["applicable"], width), "seq": seen["seq"]}

    return plain(await asyncio.to_thread(drawn))


@router.post("/api/people/{name}/actions", tags=["people"], response_model=Person, responses=WRITE)
async def act(name: Own, acted: Acted, service: Desk) -> Response:
    """Report what somebody did; 409 if it cannot be done now, 422 if there is no such action."""
    event = Event("acted", name, acted.action, acted.followed, acted.seq, id=acted.id)
    return plain(await service.report(event))


@router.post("/api/people/{name}/undo", tags=["people"], response_model=Person, responses=WRITE)
async def undo(name: Own, service: Desk, once: Once | None = None) -> Response:
    """Take somebody's last action back, as if it had not been observed."""
    return plain(await service.report(Event("undone", name, id=None if once is None else once.id)))


@router.post("/api/people/{name}/begin", tags=["people"], response_model=Person, responses=WRITE)
async def begin(name: Own, service: Desk, begun: Begun | None = None) -> Response:
    """Begin the next task, finished or not: the same again unless named."""
    begun = begun or Begun(task=None)
    return plain(await service.report(Event("began", name, task=begun.task, id=begun.id)))


@router.get("/api/robot", tags=["robot"], response_model=Robot, responses=refusals(403))
async def robot(_: Operator, service: Desk) -> Response:
    """Where the robot is to go, and what it is to say there."""
    return plain(service.outlook.robot)


@router.post("/api/robot/arrived", tags=["robot"], response_model=Robot, responses=WRITE)
async def arrived(_: Operator, where: Arrived, service: Desk) -> Response:
    """Report where the robot is."""
    return plain(await service.report(Event("arrived", where.person, id=where.id)))


@router.get("/api/team", tags=["operator"], response_model=Team, responses=refusals(403))
async def team(_: Operator, service: Desk) -> Response:
    """Everybody, what is believed of them, the robot, and the last events."""
    return plain(await service.team())


@router.post("/api/team/people", tags=["operator"], response_model=Place, responses=WRITE)
async def join(_: Operator, joined: Joined, service: Desk) -> Any:
    """Let somebody come, or come back; give the address of their page."""
    seen = await service.report(Event("joined", joined.person, task=joined.task, id=joined.id))
    return plain({**seen, "join": service.access.join_url(joined.person)})


@router.delete("/api/team/people/{name}", tags=["operator"], response_model=Person, responses=WRITE)
async def leave(_: Operator, name: Own, service: Desk) -> Response:
    """Let somebody go; they can come back."""
    return plain(await service.report(Event("left", name)))


@router.post("/api/team/pause", tags=["operator"], response_model=Robot, responses=WRITE)
async def pause(_: Operator, paused: Paused, service: Desk) -> Response:
    """Let the robot say nothing, or speak again; people can go on acting."""
    if service.outlook.paused == paused.paused:
        return plain(service.outlook.robot)
    return plain(await service.report(Event("paused" if paused.paused else "resumed")))


@router.get(
    "/api/log", tags=["operator"], response_class=Response,
    responses=refusals(403, 422) | {200: {"content": {"application/x-ndjson": {"schema": {"type": "string"}}}}},
)  # fmt: skip
async def log(_: Operator, service: Desk, task: Annotated[str | None, Query(max_length=200)] = None) -> Response:
    """Everybody's actions as JSON Lines, which `kitassist fit` reads; those in one task, if it is named."""
    rows = await asyncio.to_thread(service.session.log, task)
    return plain("".join(json.dumps(row) + "\n" for row in rows).encode(), "application/x-ndjson")
