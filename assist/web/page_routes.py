"""What a browser loads: the pages of people and operators, which hold no data, and the description of the interface."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from fastapi import APIRouter, HTTPException, Request, Response
from fastapi.responses import FileResponse, HTMLResponse

from ..drawing import svg
from . import openapi_page
from .tokens import AccessTokens

PAGES = Path(__file__).parent / "pages"

router = APIRouter(include_in_schema=False)


def document(request: Request, content: str, status: int = 200) -> Response:
    """Return a page: the head that all of them have, and what follows, from its title on.

    What it loads is named from where the page is, so that it does not matter under which path the service is.
    """
    up = "../" * (request.scope["path"].count("/") - 1)
    return HTMLResponse((_read(PAGES / "head.html") + content).replace('="/', f'="{up}'), status)


def page(request: Request, file: Path, status: int = 200) -> Response:
    """Return the page whose title and what follows are in a file."""
    return document(request, _read(file), status)


@cache
def _read(file: Path) -> str:
    return file.read_text(encoding="utf-8")


def piece(folder: Path, name: str) -> Response:
    """Give what pages load: a script, or a style."""
    if name not in {file.name for kind in ("*.js", "*.css") for file in folder.glob(kind)}:
        raise HTTPException(404, "there is no such page")
    return FileResponse(folder / name)


def page_of(request: Request, token: str, person: str | None, file: Path) -> Response:
    """Return the page of whoever has this token, or the one that says that a link is not right."""
    access: AccessTokens = request.app.state.service.access
    caller = access.whose(token)
    if caller is None or caller.person != person:
        return page(request, PAGES / "nowhere.html", 403)
    return page(request, file)


@router.get("/")
async def nowhere(request: Request) -> Response:
    """Say that a link is needed."""
    return page(request, PAGES / "nowhere.html", 404)


@router.get("/docs")
async def docs(request: Request) -> Response:
    """Describe the interface."""
    return document(request, openapi_page.page(request.app.openapi()))


@router.get("/join/{name}/{token}")
async def worker(request: Request, name: str, token: str) -> Response:
    """Give the page of whoever works."""
    return page_of(request, token, name, PAGES / "worker.html")


@router.get("/operator/{token}")
async def operators(request: Request, token: str) -> Response:
    """Give the page of whoever looks after the team."""
    return page_of(request, token, None, PAGES / "operator.html")


@router.get("/pages/{name}")
async def part(name: str) -> Response:
    """Give what pages load."""
    if name == "drawing.css":
        return Response(svg.style(), media_type="text/css")
    return piece(PAGES, name)
