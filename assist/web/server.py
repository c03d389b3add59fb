"""A process that serves a session: listens, says where, lets simulated people act, and ends when it is told to."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import signal
import socket
from collections.abc import Callable, Coroutine, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import uvicorn
from numpy.typing import ArrayLike
from starlette.types import ASGIApp
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from planner import CostToGo

from ..live.course import AbsentError, Event
from ..live.journal import JournalError
from ..live.live_task import InapplicableError
from ..live.session import Session
from ..live.simulated_person import SimulatedPerson
from ..people.human import Mixture, Population
from ..team.settings import Setting
from ..team.state import TeamPolicy
from .app import make_app
from .request_limits import LARGEST
from .service import BusyError, Service
from .tokens import AccessTokens

PATIENCE = 2
"""Seconds for connections to end by themselves."""

LINGER = 3.0
"""Seconds after which a connection that has ended is gone, read to its end or not."""

PING = 10.0
"""Seconds between two signs of life of a connection, and in which each is to be answered."""

ENDING = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)


def listen(host: str, port: int, *, otherwise: int | None = None) -> socket.socket:
    """Take a port; another one (0 for any) if it is taken and one is given.

    Raises
    ------
    OSError
        It cannot be had.
    """
    try:
        return socket.create_server(
            (host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET, backlog=1024
        )
    except OSError as error:
        if otherwise is not None and error.errno == errno.EADDRINUSE:
            return listen(host, otherwise)
        raise OSError(error.errno, error.strerror, f"{host}, port {port}") from None


def address(listening: socket.socket) -> str:
    """Give what all addresses of a service begin with."""
    host, port = listening.getsockname()[:2]
    if host in ("0.0.0.0", "::"):  # every network: those who come need a name of this machine
        host = socket.gethostname()
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


@dataclass
class SimulatedSeats:
    """Simulated people, and how fast they are.

    Attributes
    ----------
    people : mapping of str to SimulatedPerson
    pace : float
        Seconds between two of their actions, on the average.
    """

    people: Mapping[str, SimulatedPerson] = field(default_factory=dict)
    pace: float = 3.0

    async def fill(self, service: Service, *, alone: bool) -> None:
        """Let them act until they have finished; where real people are expected, from when the first has come."""
        if not alone:
            await service.visited.wait()
        await asyncio.gather(*(self._work(service, name, person) for name, person in self.people.items()))

    async def _work(self, service: Service, name: str, person: SimulatedPerson) -> None:
        while True:
            await asyncio.sleep(self.pace * float(person.rng.gamma(4.0, 0.25)))
            with suppress(AbsentError, InapplicableError, BusyError, JournalError):  # they try again
                action = await asyncio.to_thread(_chosen, service.session, name, person)
                if action is None:
                    return
                await service.report(Event("acted", name, action))


def _chosen(session: Session, name: str, person: SimulatedPerson) -> str | None:
    """Let somebody choose; None if they have finished."""
    with session.lock:  # tasks that are asked on demand are one thread's at a time
        seen = session.person(name)
        task, state = session.place(name)
        if seen["finished"]:
            return None
        return person.act(task, state, seen["applicable"], None if seen["paused"] else seen["suggestion"])


class _Server(uvicorn.Server):
    """Uvicorn's, which leaves signals to the process and says when it listens."""

    ready: Callable[[], None]

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave them alone."""
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to listen."""
        await super().startup(sockets)
        if not self.should_exit:
            self.ready()


class _Connection(WebSocketsSansIOProtocol):
    """Uvicorn's, whose end does not wait for whoever does not read what is left."""

    def on_task_complete(self, task: asyncio.Task[None]) -> None:
        """Let go of the connection."""
        super().on_task_complete(task)
        self.loop.call_later(LINGER, self.transport.abort)

    def keepalive_timeout(self) -> None:
        """Let go of a connection without a sign of life."""
        super().keepalive_timeout()
        self.loop.call_later(LINGER, self.transport.abort)


def server_of(app: ASGIApp, ready: Callable[[], None]) -> uvicorn.Server:
    """Give the server of an application, which calls `ready` when it listens."""
    # No access log: addresses of pages have tokens in them.
    server = _Server(
        uvicorn.Config(
            app, log_config=None, access_log=False, lifespan="on", proxy_headers=False,
            server_header=False, timeout_graceful_shutdown=PATIENCE, timeout_keep_alive=75, ws=_Connection,
            ws_max_size=LARGEST, ws_per_message_deflate=False, ws_ping_interval=PING, ws_ping_timeout=PING,
            backlog=1024,
        )
    )  # fmt: skip
    server.ready = ready
    return server


@dataclass(frozen=True)
class ServedTeam:
    """What is served.

    Attributes
    ----------
    tasks : mapping of str to CostToGo
    folder : Path
        Where the session is kept: its journal, and the secret from which links follow.
    people : mapping of str to str
        Who is there when a session begins, with the name of their task; one that goes on has its own.
    policy : str or callable
        A team policy, as in `Assistant`.
    setting : Setting
    population : Population or Mixture
        Of whom people are taken to be, and simulated ones drawn.
    distance : array, optional
        Between the places of people, in their order, and the base, as in `Assistant`.
    simulated : sequence of str
        Whose seats simulated people take.
    pace, seed
        As in `SimulatedSeats` and `SimulatedPerson`.
    tick : float
        Seconds without an event after which time is taken to have elapsed.
    public_url : str or None
        Where others reach the service, as `public_address` gives it, if it is not where it listens.
    """

    tasks: Mapping[str, CostToGo]
    folder: Path
    people: Mapping[str, str]
    policy: str | TeamPolicy
    setting: Setting
    population: Population | Mixture
    distance: ArrayLike | None
    simulated: Sequence[str]
    pace: float
    seed: int
    tick: float
    public_url: str | None = None

    def session(self) -> Session:
        """Open the session; at its very beginning people come.

        Raises
        ------
        ResultsExistError, DamagedFileError, OSError
            As in `Session`.
        ValueError
            What cannot be, such as people of whom the task is too large for a choice model.
        """
        session = Session(
            self.tasks, self.folder / "journal.jsonl", policy=self.policy, setting=self.setting,
            population=self.population, distance=self.distance,
        )  # fmt: skip
        if not session.outlook().events:
            for outcome in session.report([Event("joined", name, task=task) for name, task in self.people.items()]):
                if isinstance(outcome, Exception):
                    session.close()
                    raise outcome
        return session

    def seats(self) -> SimulatedSeats:
        """Draw simulated people."""
        eta, scale = self.setting.eta, self.setting.utility_scale
        people = {
            name: SimulatedPerson(self.population, eta=eta, utility_scale=scale, seed=self.seed + number)
            for number, name in enumerate(self.simulated)
        }
        return SimulatedSeats(people, self.pace)


Ready = Callable[[AccessTokens, tuple[str, ...]], None]


def serve(plan: ServedTeam, session: Session, listening: socket.socket, ready: Ready) -> None:
    """Serve a session until a signal ends it.

    Parameters
    ----------
    plan : ServedTeam
    session : Session
        That of the plan.
    listening : socket
    ready : callable
        Called with the links and who is there when the first request can come.
    """
    logging.getLogger("uvicorn.error").setLevel(logging.WARNING)
    asyncio.run(_serve(plan, session, listening, ready))


async def _serve(plan: ServedTeam, session: Session, listening: socket.socket, ready: Ready) -> None:
    access = AccessTokens.kept(plan.folder / "secret", plan.public_url or address(listening))
    service = Service(session, access, tick=plan.tick)
    service.simulated = frozenset(plan.simulated)
    app = make_app(service)
    seats = plan.seats().fill(service, alone=set(plan.simulated) >= set(service.session.people))
    await run(app, listening, lambda: ready(access, service.session.people), seats)


async def run(
    app: ASGIApp, listening: socket.socket, ready: Callable[[], None], beside: Coroutine[Any, Any, None],
    *, ends: bool = False,
) -> None:  # fmt: skip
    """Serve an application until a signal ends it, and let something else go on beside it as long.

    Parameters
    ----------
    app : ASGIApp
    listening : socket
    ready : callable
        Called when the first request can come.
    beside : coroutine
        Begins at once, and may be done before.
    ends : bool
        Whether the service ends when that is done.
    """
    server = server_of(app, ready)
    loop = asyncio.get_running_loop()
    for number in ENDING:
        if signal.getsignal(number) is not signal.SIG_IGN:
            loop.add_signal_handler(number, setattr, server, "should_exit", True)
    other = asyncio.create_task(beside)
    if ends:
        other.add_done_callback(lambda _: setattr(server, "should_exit", True))
    try:
        await server.serve([listening])
    finally:
        other.cancel()
        with suppress(asyncio.CancelledError):
            await other
