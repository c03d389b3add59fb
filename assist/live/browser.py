"""What a browser loads: the pages of people and operators, which hold no data, and the description of the interface."""

from __future__ import annotations

from pathlib import Path

from fastapi import APIRouter, HTTPException, Request, Response
from fastapi.responses import FileResponse, HTMLResponse

from ..drawing import svg
from . import description

PAGES = Path(__file__).parent / "pages"

router = APIRouter(include_in_schema=False)


def _page(name: str) -> Response:
    file = PAGES / name
    if not file.is_file():
        raise HTTPException(404, "there is no such page")
    return FileResponse(file)


def _of(request: Request, token: str, person: str | None, page: str) -> Response:
    """Give somebody's page, or the one that says that a link is not right."""
    caller = request.app.state.service.access.whose(token)
    if caller is None or caller.person != person:
        return FileResponse(PAGES / "nowhere.html", 403)
    return _page(page)


@router.get("/")
async def nowhere() -> Response:
    """Say that a link is needed."""
    return FileResponse(PAGES / "nowhere.html", 404)


@router.get("/docs")
async def docs(request: Request) -> Response:
    """Describe the interface."""
    return HTMLResponse(description.page(request.app.openapi()))


@router.get("/join/{name}/{token}")
async def worker(request: Request, name: str, token: str) -> Response:
    """Give the page of whoever works."""
    return _of(request, token, name, "worker.html")


@router.get("/operator/{token}")
async def operators(request: Request, token: str) -> Response:
    """Give the page of whoever looks after the team."""
    return _of(request, token, None, "operator.html")


@router.get("/pages/{name}")
async def part(name: str) -> Response:
    """Give what pages load."""
    if name == "drawing.css":
        return Response(svg.style(), media_type="text/css")
    if name not in {file.name for file in PAGES.glob("*")}:
        raise HTTPException(404, "there is no such page")
    return _page(name)
