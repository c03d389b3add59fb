"""Content for browsers: the pages, which contain no data, and the description of the interface."""

from __future__ import annotations

import html
import json
import re
from functools import cache
from importlib.resources import files
from pathlib import Path

from fastapi import APIRouter, Request, Response
from fastapi.responses import FileResponse, HTMLResponse

from ..declare.catalogue import Catalogue, catalogue
from ..declare.refusals import AbsentError
from ..drawing import svg
from ..live.event_base import OfPerson
from ..live.events import kinds
from ..live.lines import line_of
from ..live.views import MemberView

PAGES = Path(__file__).parent / "pages"
SECTIONS = ("page", "task", "study", "question")
"""Sections of the catalogue of texts from which scripts take theirs."""
SWAGGER = ("swagger-ui.css", "swagger-ui-bundle.js")
"""Files of Swagger UI, which FastAPI would have browsers load from another server."""

router = APIRouter(include_in_schema=False)


def document(request: Request, content: str, status: int = 200, texts: Catalogue | None = None) -> Response:
    """Return a page: the common head, followed by `content`, which begins with the title.

    Addresses in the page are made relative, so that the service may be under any path. Keys in braces are replaced by
    their texts, in English by default. The script `texts.js` reads its texts from the page.
    """
    texts = catalogue() if texts is None else texts
    up = "../" * (request.scope["path"].count("/") - 1)
    whole = (_read(PAGES / "head.html") + content).replace('="/', f'="{up}')
    return HTMLResponse(_worded(whole, texts), status)


def _worded(content: str, texts: Catalogue) -> str:
    content = re.sub(r"\{(\w+\.\w+)\}", lambda found: html.escape(texts.texts[found[1]]), content)
    own = {f"{name}.{key}": text for name in SECTIONS for key, text in texts.section(name).items()}
    fields = {name: line_of(one) for name, one in MemberView.__pydantic_fields__.items()}  # type: ignore[attr-defined]
    events = {name: one.line for name, one in kinds(OfPerson).items() if one.line is not None}
    lines = {
        "person": [
            {name: texts.texts[one.person] for name, one in part.items() if one.person} for part in (fields, events)
        ],
        "operator": [{name: one.operator for name, one in part.items() if one.operator} for part in (fields, events)],
    }
    for name, written in (("texts", own), ("lines", lines)):
        content = content.replace(f"{{{name}}}", json.dumps(written).replace("<", "\\u003c"))
    return content.replace("{language}", texts.tag)


def page(request: Request, file: Path, status: int = 200, *, texts: Catalogue | None = None) -> Response:
    """Return the page in a file, in the service's language or, with `texts`, in another one."""
    return document(request, _read(file), status, request.app.state.service.texts if texts is None else texts)


@cache
def _read(file: Path) -> str:
    return file.read_text(encoding="utf-8")


def piece(folder: Path, name: str) -> Response:
    """Return a script or a style sheet."""
    if name not in {file.name for kind in ("*.js", "*.css") for file in folder.glob(kind)}:
        raise AbsentError("page")
    return FileResponse(folder / name)


@router.get("/")
async def nowhere(request: Request) -> Response:
    """Return the page that says that a link is needed."""
    return page(request, PAGES / "nowhere.html", 404)


@router.get("/docs")
async def docs() -> Response:
    """Return the description of the interface."""
    return HTMLResponse(_read(PAGES / "docs.html"))


@router.get("/join/{name}")
async def worker_page(request: Request) -> Response:
    """Return a person's page; the token is in the part of the address that browsers do not send."""
    return page(request, PAGES / "worker.html")


@router.get("/operator")
async def operators_page(request: Request) -> Response:
    """Return the operator's page."""
    return page(request, PAGES / "operator.html", texts=catalogue())


@router.get("/pages/{name}")
async def part(name: str) -> Response:
    """Return a script or a style sheet of the pages."""
    if name == "drawing.css":
        return Response(svg.style(), media_type="text/css")
    if name in SWAGGER:
        return FileResponse(str(files("fastapi_offline") / "static" / name))
    return piece(PAGES, name)
