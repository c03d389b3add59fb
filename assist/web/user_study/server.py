"""The server process of a user study or of a rehearsal."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Mapping
from pathlib import Path

from planner import CostToGo

from ...studies.userstudy.plan import UserStudy
from ...studies.userstudy.session import StudySession
from ..app import make_app
from ..request_limits import Allowance, Networks
from ..server import address, run
from ..tokens import AccessTokens
from .rehearsal import Rehearsal
from .routes import router
from .service import StudyService


def serve(
    study: UserStudy, tasks: Mapping[str, CostToGo], folder: Path, listening: socket.socket,
    ready: Callable[[StudyService], None], *, rehearsal: Rehearsal | None = None, public_url: str | None = None,
    trusted_proxies: Networks = (),
) -> None:  # fmt: skip
    """Serve a study until a signal ends it, or until a rehearsal is complete.

    Parameters
    ----------
    study : UserStudy
    tasks : mapping of str to CostToGo
        Tasks by name; the practice task is "practice".
    folder : Path
        Folder in which the study is saved, and from which it is resumed.
    listening : socket
    ready : callable
        Called when the service accepts requests.
    rehearsal : Rehearsal, optional
        Simulated participants; without them it is a real study.
    public_url : str, optional
        Public address of the service, as `public_address` returns it, if it differs from where the service listens.
    trusted_proxies : sequence of networks
        Proxies that report the client's address, as `networks` returns them.

    Raises
    ------
    KeyboardInterrupt
        A signal, its argument, ended a rehearsal.
    """
    number = asyncio.run(_serve(study, tasks, folder, listening, ready, rehearsal, public_url, trusted_proxies))
    if rehearsal is not None and number is not None:
        raise KeyboardInterrupt(number)


async def _serve(
    study: UserStudy, tasks: Mapping[str, CostToGo], folder: Path, listening: socket.socket,
    ready: Callable[[StudyService], None], rehearsal: Rehearsal | None, public_url: str | None,
    trusted_proxies: Networks,
) -> int | None:  # fmt: skip
    session = StudySession(study, tasks, folder)
    access = AccessTokens.kept(folder / "secret", public_url or address(listening))
    service = StudyService(session, access, ticks=rehearsal is None, rehearsal=rehearsal is not None)
    begun = asyncio.Event()

    def is_ready() -> None:
        ready(service)
        begun.set()

    async def rehearsing() -> None:
        await begun.wait()
        if rehearsal is not None:
            try:
                await asyncio.to_thread(rehearsal.run, service, tasks, address(listening))
            finally:
                rehearsal.end()

    # Simulated participants send requests faster than people do.
    allowance = Allowance(rate=1e6, burst=1e6) if rehearsal is not None else None
    app = make_app(service, allowance=allowance, more=[router], trusted_proxies=trusted_proxies)
    return await run(app, listening, is_ready, rehearsing(), ends=rehearsal is not None)
