"""The live assistant over HTTP and WebSocket: for pages, robots, and systems that observe.

`make_app` gives the application of a `Service`. Every answer is JSON; what is refused says why as `{"detail": "..."}`,
one sentence. A person's token opens what is theirs, the operator's everything.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import Any

from fastapi import APIRouter, FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException as StarletteHTTPException

from planner import LimitError

from ..live.course import AbsentError
from ..live.journal import JournalError
from ..live.live_task import InapplicableError
from . import page_routes, routes, websocket
from .request_limits import Allowance, Guard
from .service import BusyError, Service
from .task_drawings import Pictures


def make_app(service: Service, *, allowance: Allowance | None = None, more: Sequence[APIRouter] = ()) -> FastAPI:
    """Give the application of a service, which it starts and stops.

    Parameters
    ----------
    service : Service
    allowance : Allowance, optional
        How many requests there may be.
    more : sequence of APIRouter
        Further requests and pages; they have the service as `Desk`, and let people in as `Own` and `Operator` do.
    """

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        service.start()
        yield
        await service.stop()

    app = FastAPI(
        title="kitassist", summary="The live assistant: whom to help, when, and with which suggestion.",
        version="1", lifespan=lifespan, docs_url=None, redoc_url=None, redirect_slashes=not service.access.root,
        servers=[{"url": service.access.root}] if service.access.root else None,
    )  # fmt: skip
    app.state.service, app.state.pictures = service, Pictures()
    _says_what_is_wrong(app)
    for router in (routes.router, websocket.router, page_routes.router, *more):
        app.include_router(router)
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
