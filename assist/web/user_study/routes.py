"""Requests and pages of a user study, in addition to those of the live assistant."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Request, Response

from ...declare.catalogue import catalogue
from ...declare.refusals import Refusal
from ...studies.userstudy.export import archive
from ...studies.userstudy.forms import Item
from ...studies.userstudy.plan import UserStudy
from ...studies.userstudy.views import Progress
from .. import cookies
from ..authorization import READ, WRITE, Operator, Own, refusals
from ..event_routes import told
from ..page_routes import page, piece
from ..routes import plain
from ..streams import DESCRIBED, view_stream
from ..tokens import VISITOR
from .schemas import Done, Identified, Links, Overview, Seat, Visit, Withdrawal, Withdrawn
from .service import StudyService

PAGES = Path(__file__).parent / "pages"
SEAT = "seat"
"""Names the cookie by which a browser is recognised that has joined."""

router = APIRouter()


async def study_of(request: Request) -> StudyService:
    """Return the study's service."""
    service: StudyService = request.app.state.service
    return service


Study = Annotated[StudyService, Depends(study_of)]


def form_of(study: UserStudy) -> dict[str, Any]:
    """Return the content of the study's pages: texts as HTML, and questionnaires."""
    import markdown

    return {
        "title": study.title,
        "texts": {name: markdown.markdown(text, output_format="html") for name, text in study.texts.items()},
        "questionnaires": {
            one.name: {
                "title": one.title, "introduction": one.introduction,
                "items": {item.name: _shown(item) for item in one.items},
            }
            for one in study.questionnaires
        },
    }  # fmt: skip


def _shown(item: Item) -> dict[str, Any]:
    """Return what a participant may know of a question: neither the answer to a check nor the conditions."""
    low, high, step = item.ends
    return {
        "form": item.form, "text": item.text, "required": item.required, "low": item.low, "high": item.high,
        "labels": item.labels, "options": item.options, "min": low, "max": high, "step": step,
    }  # fmt: skip


@router.post("/api/study/seats", tags=["study"], response_model=Seat, responses=WRITE)
async def visit(request: Request, coming: Annotated[Visit, told(Visit)], study: Study) -> Response:
    """Join the study by the join link's token; 409 if it is full. A repeated id returns the same participant."""
    if request.state.caller.person not in (None, VISITOR):
        raise Refusal("visitors")
    if coming.simulated and not study.rehearsal:
        raise Refusal("rehearsed")
    if not coming.simulated and study.code_of(coming.id) not in study.views:
        _throttled(study.arrivals.wait(request.state.address), "joins")
    kept = cookies.cookie_of(study.access.base, SEAT)
    seen = await study.visit(
        coming.id, key=coming.key, signature=coming.signature, simulated=coming.simulated,
        before=study.access.signed_in(SEAT, request.cookies.get(kept, "")), address=request.state.address,
    )  # fmt: skip
    code = seen["person"]
    part = study.access.join_url(code).removeprefix(study.access.base).replace("/join/", "/part/", 1)
    now = json.loads(study.view(code))  # may be later than the answer
    answer = plain(Seat(code, part, Progress(**now["study"])))
    cookies.keep(answer, study.access, kept, study.access.signed(SEAT, code))
    return answer


def _throttled(wait: float, what: str) -> None:
    """Refuse a request that is allowed only after some seconds."""
    if wait:
        raise Refusal(what, n=math.ceil(wait))


@router.post("/api/study/links", tags=["study"], response_model=Links, responses=refusals(403, 422))
async def links(_: Operator, wanted: Annotated[Identified, told(Identified)], study: Study) -> Response:
    """Return a signed join link for each participant whom another system identifies."""
    return plain(Links({one: study.participant_url(one) for one in wanted.participants}))


@router.get("/api/study/form", tags=["study"], responses=refusals())
async def form(request: Request, study: Study) -> Response:
    """Return the content of the study's pages: title, texts and questionnaires."""
    if not hasattr(request.app.state, "form"):
        request.app.state.form = json.dumps(form_of(study.study)).encode()
    return plain(request.app.state.form)


@router.get("/api/study/participants/{person}/withdrawal", tags=["study"], response_model=Withdrawal, responses=READ)
async def withdrawal(person: Own, study: Study) -> Response:
    """Return how the participant's data can be withdrawn later, without this page."""
    until = study.study.withdraw_until
    day = None if until is None else until.isoformat()
    return plain(Withdrawal(study.withdrawal_code(person), study.withdrawal_url(), day))


@router.post("/api/study/withdrawals", tags=["study"], response_model=Done, responses=WRITE)
async def withdraw_by_code(request: Request, given: Annotated[Withdrawn, told(Withdrawn)], study: Study) -> Response:
    """Withdraw a participant's data by the withdrawal code, with the join link's token, also after the end."""
    if request.state.caller.person not in (None, VISITOR):
        raise Refusal("visitors_withdraw")
    _throttled(study.guesses.wait(request.state.address), "guesses")
    await study.withdraw(given.code)
    return plain(Done())


@router.get("/api/study", tags=["study"], response_model=Overview, responses=refusals(403))
async def overview(_: Operator, study: Study) -> Response:
    """Return each participant's stage, condition and status."""
    return plain(await study.overview())


@router.get("/api/study/events", tags=["study"], response_class=Response, responses=refusals(403) | DESCRIBED)
async def overviews(_: Operator, study: Study) -> Response:
    """Stream each participant's stage, condition and status (`study`)."""

    async def overview() -> bytes:
        return json.dumps((await study.overview()).as_dict()).encode()

    return view_stream(study, "study", overview)


@router.get(
    "/api/study/export", tags=["study"], response_class=Response,
    responses={
        **refusals(403), 200: {"content": {"application/zip": {"schema": {"type": "string", "format": "binary"}}}},
    },
)  # fmt: skip
async def export(_: Operator, study: Study) -> Response:
    """Return all recorded data as a ZIP file: tables (CSV), their description, and logs for `fit`."""
    content = await asyncio.to_thread(archive, study.folder)
    headers: Mapping[str, str] = {"content-disposition": 'attachment; filename="user-study.zip"'}
    return Response(content, media_type="application/zip", headers=dict(headers))


@router.get("/study/operator", include_in_schema=False)
async def conduct_page(request: Request) -> Response:
    """Return the experimenter's page; the token is in the part of the address that browsers do not send."""
    return page(request, PAGES / "conduct.html", texts=catalogue())


@router.get("/study", include_in_schema=False)
async def visitors_page(request: Request) -> Response:
    """Return the page on which visitors join."""
    return page(request, PAGES / "visit.html")


@router.get("/part/{name}", include_in_schema=False)
async def part_page(request: Request) -> Response:
    """Return a participant's page, except for tasks, which have pages of their own."""
    return page(request, PAGES / "part.html")


@router.get("/study/pages/{name}", include_in_schema=False)
async def own_piece(name: str) -> Response:
    """Return a script or a style sheet of the study's pages."""
    return piece(PAGES, name)
