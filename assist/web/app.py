"""The live assistant's web application, for pages, robots and observing systems.

`make_app` returns the application of a `Service`. Every answer is JSON; a refusal is `{"detail": "..."}` with one
sentence, to people in the language of their pages. A person's token gives access to what concerns this person, the
operator's token to everything.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import Any

from fastapi import APIRouter, Depends, FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException as StarletteHTTPException
from starlette.routing import BaseRoute
from uvicorn.middleware.proxy_headers import ProxyHeadersMiddleware

from planner import LimitError

from ..declare.catalogue import catalogue
from ..declare.refusals import Refusal
from ..live.store import JournalError
from . import event_routes, metrics, page_routes, request_faults, routes, streams
from .authorization import known_query
from .request_limits import Allowance, Guard, Networks
from .service import Service
from .task_drawings import Pictures

END_STREAMS = "end_streams"
"""Key, in the state of the application's lifespan, of the function that a server calls before it ends."""


def make_app(
    service: Service, *, allowance: Allowance | None = None, more: Sequence[APIRouter] = (),
    trusted_proxies: Networks = (),
) -> FastAPI:  # fmt: skip
    """Return the application of a service. The application starts and stops the service.

    Parameters
    ----------
    service : Service
    allowance : Allowance, optional
        Limit on the rate of requests.
    more : sequence of APIRouter
        Further requests and pages. They use the dependencies `Desk`, `Own` and `Operator`.
    trusted_proxies : sequence of networks
        Proxies whose header X-Forwarded-For names the client's address.
    """

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[dict[str, Any]]:
        service.start()
        yield {END_STREAMS: service.end_streams}
        await service.stop()

    app = FastAPI(
        title="kitassist", summary="The live assistant: whom to help, when, and with which suggestion.",
        version="1", lifespan=lifespan, docs_url=None, redoc_url=None, redirect_slashes=not service.access.root,
        servers=[{"url": service.access.root}] if service.access.root else None,
    )  # fmt: skip
    app.state.service, app.state.pictures = service, Pictures(str(service.texts.file))
    service.measures.registry.register(metrics.Present(service))
    events = event_routes.event_routes(service.events, service.shown)
    routers = (events, routes.router, metrics.router, streams.router, page_routes.router, *more)
    _says_what_is_wrong(app, [one for router in routers for one in router.routes])
    for router in routers:
        checked = [] if router is metrics.router else [Depends(known_query)]  # what reads metrics adds its own
        app.include_router(router, dependencies=checked)
    app.add_middleware(Guard, access=service.access, allowance=allowance, texts=service.texts)
    app.add_middleware(ProxyHeadersMiddleware, trusted_hosts=list(trusted_proxies))
    return app


def _says_what_is_wrong(app: FastAPI, known: Sequence[BaseRoute]) -> None:
    def says(request: Request, status: int, headers: Any = None, /, key: str = "other", **values: Any) -> JSONResponse:
        """Return a refusal, in the language of the pages if a person asked, and in English to everybody else."""
        caller = getattr(request.state, "caller", None)
        texts = catalogue() if caller is None or caller.person is None else app.state.service.texts
        return JSONResponse({"detail": texts.refusal(key, **values)}, status, headers)

    @app.exception_handler(StarletteHTTPException)
    async def refused(request: Request, error: StarletteHTTPException) -> Response:
        if error.status_code == 404:
            if "text/html" in request.headers.get("accept", ""):  # somebody follows a link
                return await page_routes.nowhere(request)
            if request.scope["path"].startswith("/api/"):
                return says(request, 404, why=request_faults.unknown(request, known))
            return says(request, 404, None, "page")
        if error.status_code == 405:
            methods = request_faults.allowed(request, known)
            why = f"{request.method}: expected {' or '.join(methods)} at this address"
            return says(request, 405, {"allow": ", ".join(methods)}, why=why)
        why = request_faults.unread(error.__cause__) if error.status_code == 400 else error.detail
        return says(request, error.status_code, error.headers, why=why)

    @app.exception_handler(RequestValidationError)
    async def invalid(request: Request, error: RequestValidationError) -> Response:
        return says(request, 422, why=await request_faults.told(request, error))

    @app.exception_handler(Refusal)
    async def refuses(request: Request, error: Refusal) -> Response:
        if error.status == 404 and "text/html" in request.headers.get("accept", ""):
            return await page_routes.nowhere(request)
        headers = {"retry-after": str(error.values["n"])} if error.status == 429 and "n" in error.values else None
        return says(request, error.status, headers, error.key, **error.values)

    @app.exception_handler(JournalError)
    async def unsaved(request: Request, error: JournalError) -> Response:
        return says(request, 507, None, "disk", why=error.strerror)

    @app.exception_handler(Exception)
    async def failed(request: Request, error: Exception) -> Response:
        return says(request, 500, None, "failed", error=type(error).__name__)

    async def wrong(request: Request, error: Exception) -> Response:
        return says(request, 503 if isinstance(error, LimitError) else 422, why=str(error))

    for kind in (ValueError, LimitError):
        app.add_exception_handler(kind, wrong)
