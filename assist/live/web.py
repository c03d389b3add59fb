"""The live assistant over HTTP and WebSocket: for pages, robots, and systems that observe.

`make_app` gives the application of a `Service`. Every answer is JSON; what is refused says why as `{"detail": "..."}`,
one sentence. A person's token opens what is theirs, the operator's everything.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Coroutine
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Annotated, Any

from fastapi import Depends, FastAPI, HTTPException, Query, Request, Response, WebSocket, WebSocketDisconnect
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, HTMLResponse, JSONResponse
from fastapi.security import HTTPBearer
from pydantic import BaseModel, ConfigDict, Field
from starlette.exceptions import HTTPException as StarletteHTTPException

from planner import LimitError

from ..drawing import svg
from . import description
from .access import Caller
from .course import AbsentError, Event
from .journal import JournalError
from .limits import Allowance, Guard
from .pictures import Pictures
from .problem import InapplicableError
from .service import BusyError, Service

PAGES = Path(__file__).parent / "pages"

DROPPED, REMOVED, DENIED, ENDS = 1013, 4404, 4403, 1012
"""Why a connection is closed: it did not read, the person is gone, it is not theirs, the service ends."""

Id = Annotated[
    str | None,
    Field(min_length=1, max_length=128, description="Made by the client; repeated, the answer is the first."),
]
Action = Annotated[str, Field(min_length=1, max_length=1000, examples=["(fetch box-a)"])]


class _Body(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class Acted(_Body):
    """What somebody did."""

    action: Action
    id: Id = None
    followed: bool | None = Field(None, description="Whether the suggestion was followed; null: not said.")
    seq: int | None = Field(
        None, ge=0, description="Of what the person saw when they acted: a later suggestion was not heard."
    )


class Once(_Body):
    """Something that happens once."""

    id: Id = None


class Begun(Once):
    """The beginning of a task, the same again unless named."""

    task: str | None = Field(None, max_length=200)


class Joined(Begun):
    """Somebody who comes, or comes back."""

    person: str = Field(min_length=1, max_length=64, examples=["ann"])


class Arrived(Once):
    """Where the robot is: with somebody, or at its base (null)."""

    person: str | None = Field(None, max_length=64)


class Paused(_Body):
    """Whether the robot says nothing."""

    paused: bool


class Problem(BaseModel):
    """Why something was refused."""

    detail: str


class Health(BaseModel):
    """Whether the service is well."""

    status: str
    people: int
    events: int


class Me(BaseModel):
    """Whose the token is."""

    person: str | None
    operator: bool


class Why(BaseModel):
    """The numbers behind a suggestion: cost units; means and the ends of nine tenths of the belief."""

    saving: float
    moving: float
    score: float
    beta: float
    beta_interval: tuple[float, float]
    theta: float
    theta_interval: tuple[float, float]


class Person(BaseModel):
    """What somebody sees. `seq` grows whenever it changes; `cost_to_go` is null in a dead end."""

    person: str
    task: str
    present: bool
    paused: bool
    applicable: list[str]
    suggestion: str | None
    reason: Why | None
    cost_to_go: float | None
    steps: int
    finished: bool
    seq: int


class Wanted(BaseModel):
    """A part of the goal, in words."""

    text: str
    done: bool


class Drawn(BaseModel):
    """Somebody's task as it is: a drawing, the same in words, the goal, and what applicable actions are called."""

    svg: str
    text: str
    goal: list[Wanted]
    words: dict[str, str]
    seq: int


class Place(BaseModel):
    """Somebody who has come, with the address of their page."""

    person: str
    join: str
    seq: int


class Robot(BaseModel):
    """Where the robot is to be and what it says there; `location` is where it is, or to whom it is under way."""

    person: str | None
    suggestion: str | None
    reason: Why | None
    arrived: bool
    location: str | None
    seq: int


class Member(Person):
    """What the operator sees of somebody: low end, mean and high end of beta and theta, and all of the belief."""

    history: list[tuple[float, float | None]]
    beta: tuple[float, float, float]
    theta: tuple[float, float, float]
    grid: dict[str, list[float]]
    belief: list[list[float]]
    connected: bool
    join: str


class Team(BaseModel):
    """What the operator sees."""

    seq: int
    time: float
    paused: bool
    robot: Robot
    log: list[dict[str, Any]]
    people: list[Member]


SAYS = {
    400: "Not a request that can be read.", 401: "No token, or nobody's.", 403: "Another person's link.",
    404: "Nobody of that name is there.", 409: "It cannot be done now.", 413: "Too large.", 422: "Not valid.",
    429: "Too many requests.", 503: "Too much at once, or a state that could not be evaluated.",
    507: "The disk is full: it has not happened.",
}  # fmt: skip


def _refusals(*codes: int) -> dict[int | str, dict[str, Any]]:
    return {code: {"model": Problem, "description": SAYS[code]} for code in (400, 401, 413, 429, *codes)}


READ, WRITE = _refusals(403, 404), _refusals(403, 404, 409, 422, 503, 507)
bearer = HTTPBearer(auto_error=False, description="The last part of a join link, or of the operator's.")


def operator(request: Request, _: Annotated[Any, Depends(bearer)] = None) -> None:
    """Let only the operator in."""
    if request.state.caller.person is not None:
        raise HTTPException(403, "this is for the operator")
    request.app.state.service.visited.set()


def own(request: Request, name: str, _: Annotated[Any, Depends(bearer)] = None) -> str:
    """Let in whoever the person is, and the operator."""
    caller: Caller = request.state.caller
    if caller.person not in (None, name):
        raise HTTPException(403, "this link is another person's")
    if name not in request.app.state.service.views:
        raise HTTPException(404, f"{name[:80]!r} is not in the team")
    request.app.state.service.visited.set()
    return name


def service_of(request: Request) -> Service:
    """Give the service of this application."""
    service: Service = request.app.state.service
    return service


Operator = Annotated[None, Depends(operator)]
Own = Annotated[str, Depends(own)]
Desk = Annotated[Service, Depends(service_of)]


def plain(body: bytes | dict[str, Any], media_type: str = "application/json") -> Response:
    """Answer with JSON that is there already, or with what can be made JSON."""
    return Response(body if isinstance(body, bytes) else json.dumps(body), media_type=media_type)


def make_app(service: Service, *, allowance: Allowance | None = None) -> FastAPI:
    """Give the application of a service, which it starts and stops."""

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        service.start()
        yield
        await service.stop()

    app = FastAPI(
        title="kitassist", summary="The live assistant: whom to help, when, and with which suggestion.",
        version="1", lifespan=lifespan, docs_url=None, redoc_url=None,
    )  # fmt: skip
    app.state.service, app.state.pictures = service, Pictures()
    _says_what_is_wrong(app)
    _people(app)
    _team(app)
    _watching(app)
    _pages(app)
    app.add_middleware(Guard, access=service.access, allowance=allowance)
    return app


def _says_what_is_wrong(app: FastAPI) -> None:
    def says(status: int, detail: str, headers: Any = None) -> JSONResponse:
        return JSONResponse({"detail": detail}, status, headers)

    @app.exception_handler(StarletteHTTPException)
    async def refused(_: Request, error: StarletteHTTPException) -> Response:
        return says(error.status_code, str(error.detail), error.headers)

    @app.exception_handler(RequestValidationError)
    async def invalid(_: Request, error: RequestValidationError) -> Response:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"] if part != "body")
        return says(422, f"{where}: {first['msg']}" if where else f"the body: {first['msg']}")

    statuses = {
        AbsentError: 404, InapplicableError: 409, ValueError: 422, LimitError: 503, BusyError: 503, JournalError: 507,
    }  # fmt: skip
    for kind, status in statuses.items():

        async def cannot(_: Request, error: Exception, status: int = status) -> Response:
            return says(status, str(error) if status != 507 else str(getattr(error, "strerror", error)))

        app.add_exception_handler(kind, cannot)


def _people(app: FastAPI) -> None:
    @app.get("/api/health", tags=["service"], response_model=Health, responses=_refusals())
    async def health(service: Desk) -> Any:
        """Whether the service is well; without a token."""
        return {"status": "ok", "people": len(service.views), "events": service.outlook.events}

    @app.get("/api/me", tags=["service"], response_model=Me, responses=_refusals(), dependencies=[Depends(bearer)])
    async def me(request: Request) -> Any:
        """Whose the token is."""
        person = request.state.caller.person
        return {"person": person, "operator": person is None}

    @app.get("/api/people/{name}", tags=["people"], response_model=Person, responses=READ)
    async def person(name: Own, service: Desk) -> Response:
        """What somebody sees: what can be done, what is suggested and why."""
        return plain(service.views[name])

    @app.get("/api/people/{name}/drawing", tags=["people"], response_model=Drawn, responses=READ | _refusals(422))
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

    @app.post("/api/people/{name}/actions", tags=["people"], response_model=Person, responses=WRITE)
    async def act(name: Own, acted: Acted, service: Desk) -> Response:
        """Report what somebody did; 409 if it cannot be done now, 422 if there is no such action."""
        event = Event("acted", name, acted.action, acted.followed, acted.seq, id=acted.id)
        return plain(await service.report(event))

    @app.post("/api/people/{name}/undo", tags=["people"], response_model=Person, responses=WRITE)
    async def undo(name: Own, service: Desk, once: Once | None = None) -> Response:
        """Take somebody's last action back, as if it had not been observed."""
        return plain(await service.report(Event("undone", name, id=None if once is None else once.id)))

    @app.post("/api/people/{name}/begin", tags=["people"], response_model=Person, responses=WRITE)
    async def begin(name: Own, service: Desk, begun: Begun | None = None) -> Response:
        """Begin the next task, finished or not: the same again unless named."""
        begun = begun or Begun(task=None)
        return plain(await service.report(Event("began", name, task=begun.task, id=begun.id)))


def _team(app: FastAPI) -> None:
    @app.get("/api/robot", tags=["robot"], response_model=Robot, responses=_refusals(403))
    async def robot(_: Operator, service: Desk) -> Response:
        """Where the robot is to go, and what it is to say there."""
        return plain(service.outlook.robot)

    @app.post("/api/robot/arrived", tags=["robot"], response_model=Robot, responses=WRITE)
    async def arrived(_: Operator, where: Arrived, service: Desk) -> Response:
        """Report where the robot is."""
        return plain(await service.report(Event("arrived", where.person, id=where.id)))

    @app.get("/api/team", tags=["operator"], response_model=Team, responses=_refusals(403))
    async def team(_: Operator, service: Desk) -> Response:
        """Everybody, what is believed of them, the robot, and the last events."""
        return plain(await service.team())

    @app.post("/api/team/people", tags=["operator"], response_model=Place, responses=WRITE)
    async def join(_: Operator, joined: Joined, service: Desk) -> Any:
        """Let somebody come, or come back; give the address of their page."""
        seen = await service.report(Event("joined", joined.person, task=joined.task, id=joined.id))
        return plain({**seen, "join": service.access.join_url(joined.person)})

    @app.delete("/api/team/people/{name}", tags=["operator"], response_model=Person, responses=WRITE)
    async def leave(_: Operator, name: Own, service: Desk) -> Response:
        """Let somebody go; they can come back."""
        return plain(await service.report(Event("left", name)))

    @app.post("/api/team/pause", tags=["operator"], response_model=Robot, responses=WRITE)
    async def pause(_: Operator, paused: Paused, service: Desk) -> Response:
        """Let the robot say nothing, or speak again; people can go on acting."""
        if service.outlook.paused == paused.paused:
            return plain(service.outlook.robot)
        return plain(await service.report(Event("paused" if paused.paused else "resumed")))

    @app.get(
        "/api/log", tags=["operator"], response_class=Response,
        responses=_refusals(403) | {200: {"content": {"application/x-ndjson": {"schema": {"type": "string"}}}}},
    )  # fmt: skip
    async def log(_: Operator, service: Desk) -> Response:
        """Everybody's actions as JSON Lines, which `kitassist fit` reads."""
        rows = await asyncio.to_thread(service.session.log)
        return plain("".join(json.dumps(row) + "\n" for row in rows).encode(), "application/x-ndjson")


def _watching(app: FastAPI) -> None:
    async def converse(socket: WebSocket, send: Coroutine[Any, Any, int], dropped: asyncio.Event) -> None:
        """Send until there is no more to be sent, whoever watches has gone, or they do not read."""

        async def read() -> None:
            with suppress(RuntimeError, WebSocketDisconnect):
                while (await socket.receive())["type"] != "websocket.disconnect":
                    pass

        sending, reading = asyncio.create_task(send), asyncio.create_task(read())
        tasks = sending, reading, asyncio.create_task(dropped.wait())
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            gone = reading.done()
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)
        failed = not sending.cancelled() and sending.exception() is not None
        if dropped.is_set() or not (gone or failed or sending.cancelled()):
            await hang_up(socket, DROPPED if sending.cancelled() else sending.result())

    async def hang_up(socket: WebSocket, code: int) -> None:
        with suppress(RuntimeError, WebSocketDisconnect, asyncio.TimeoutError):
            await asyncio.wait_for(socket.close(code), 1.0)

    def accepted(socket: WebSocket) -> str | None:
        return "kitassist" if "kitassist" in socket.scope.get("subprotocols", ()) else None

    @app.websocket("/api/people/{name}/events")
    async def person_events(socket: WebSocket, name: str) -> None:
        service: Service = socket.app.state.service
        if socket.state.caller.person not in (None, name) or name not in service.views:
            await socket.close(DENIED)
            return
        await socket.accept(accepted(socket))
        if name not in service.views:
            await hang_up(socket, REMOVED)
            return
        service.visited.set()
        watcher = service.watch(name)

        async def send() -> int:
            while (message := await watcher.messages.get()) is not None:
                await socket.send_text(message.decode())
            return ENDS if name in service.views else REMOVED

        try:
            await converse(socket, send(), watcher.dropped)
        finally:
            service.leave(name, watcher)

    @app.websocket("/api/team/events")
    async def team_events(socket: WebSocket) -> None:
        service: Service = socket.app.state.service
        if socket.state.caller.person is not None:
            await socket.close(DENIED)
            return
        await socket.accept(accepted(socket))
        changed = service.operator()

        async def send() -> int:
            while True:
                await changed.wait()
                changed.clear()
                await socket.send_text((await service.team()).decode())
                await asyncio.sleep(service.pause_between)

        try:
            await converse(socket, send(), asyncio.Event())
        finally:
            service.operator_leaves(changed)


def _pages(app: FastAPI) -> None:
    def page(name: str) -> Response:
        file = PAGES / name
        if not file.is_file():
            raise HTTPException(404, "there is no such page")
        return FileResponse(file)

    def visited(request: Request, token: str, person: str | None) -> None:
        caller = request.app.state.service.access.whose(token)
        if caller is None or caller.person != person:
            raise HTTPException(403, "this link is nobody's here; expected it as it was given, to its last sign")

    @app.get("/docs", include_in_schema=False)
    async def docs() -> Response:
        return HTMLResponse(description.page(app.openapi()))

    @app.get("/join/{name}/{token}", include_in_schema=False)
    async def worker(request: Request, name: str, token: str) -> Response:
        visited(request, token, name)
        return page("worker.html")

    @app.get("/operator/{token}", include_in_schema=False)
    async def operators(request: Request, token: str) -> Response:
        visited(request, token, None)
        return page("operator.html")

    @app.get("/pages/{name}", include_in_schema=False)
    async def part(name: str) -> Response:
        if name == "drawing.css":
            return Response(svg.style(), media_type="text/css")
        if name not in {file.name for file in PAGES.glob("*")}:
            raise HTTPException(404, "there is no such page")
        return page(name)
