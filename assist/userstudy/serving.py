"""A process that serves a user study, or rehearses it."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Callable, Mapping
from pathlib import Path

from planner import CostToGo

from ..live.access import Access
from ..live.limits import Allowance
from ..live.server import address, run
from ..live.web import make_app
from .plan import UserStudy
from .rehearsal import rehearse
from .routes import router
from .service import StudyService
from .session import StudySession


def serve(
    study: UserStudy, tasks: Mapping[str, CostToGo], folder: Path, listening: socket.socket,
    ready: Callable[[StudyService], None], *, participants: int = 0,
) -> None:  # fmt: skip
    """Serve a study until a signal ends it, or a rehearsal is over.

    Parameters
    ----------
    study : UserStudy
    tasks : mapping of str to CostToGo
        By name; that of the practice is "practice".
    folder : Path
        Where the study is kept, and goes on from.
    listening : socket
    ready : callable
        Called when the first request can come.
    participants : int
        Simulated ones, who rehearse the study; 0 for real ones.
    """
    logging.getLogger("uvicorn.error").setLevel(logging.WARNING)
    asyncio.run(_serve(study, tasks, folder, listening, ready, participants))


async def _serve(
    study: UserStudy, tasks: Mapping[str, CostToGo], folder: Path, listening: socket.socket,
    ready: Callable[[StudyService], None], participants: int,
) -> None:  # fmt: skip
    session = StudySession(study, tasks, folder)
    access = Access.kept(folder / "secret", address(listening))
    service = StudyService(session, access, ticks=not participants)
    begun = asyncio.Event()

    def is_ready() -> None:
        ready(service)
        begun.set()

    async def rehearsing() -> None:
        await begun.wait()
        if participants:
            await asyncio.to_thread(rehearse, service, tasks, participants)

    # Whoever rehearses is faster than people are.
    allowance = Allowance(rate=1e6, burst=1e6) if participants else None
    app = make_app(service, allowance=allowance, more=[router])
    await run(app, listening, is_ready, rehearsing(), ends=participants > 0)
