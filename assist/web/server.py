"""The server process of a live session: it listens, lets simulated people act, and stops at a signal."""

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

from planner import CostToGo

from ..declare.catalogue import catalogue
from ..declare.refusals import InapplicableError, Refusal
from ..live.event_base import TeamEvent
from ..live.events import Acted, Answered, Elapsed, Joined
from ..live.live_setting import LiveSetting
from ..live.people_store import PeopleStore
from ..live.session import Session
from ..live.simulated_person import SimulatedPerson
from ..live.store import JournalError
from ..people.goals import Goals
from ..people.ranges import Population
from ..person.observation_model import ObservationModel
from ..team.state import TeamPolicy
from . import connections
from .app import END_STREAMS, make_app
from .request_limits import Networks
from .service import Bridge, ReadAgain, Service
from .tokens import AccessTokens

WAITING = 1024
"""Connections that may wait to be accepted, such as those of a full waiting room."""

JOURNAL = "journal.sqlite"
"""Name of a session's file in its folder."""


def listen(host: str, port: int, *, otherwise: int | None = None, unread: float = 20.0) -> socket.socket:
    """Return a listening socket. If the port is taken, use `otherwise` (0: any free port) if given.

    A connection is closed when the client has taken in nothing for `unread` seconds of what it was sent: it has gone
    without a word, or does not read. With a stream's signs of life each 15 s, this is noticed within 35 s.

    Raises
    ------
    OSError
        No port is available.
    """
    try:
        listening = socket.create_server(
            (host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET, backlog=WAITING
        )
    except OSError as error:
        if otherwise is not None and error.errno == errno.EADDRINUSE:
            return listen(host, otherwise, unread=unread)
        raise OSError(error.errno, error.strerror, f"{host}, port {port}") from None
    # Connections inherit it. Otherwise the body of an answer waits until the client has acknowledged the head: 40 ms.
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(1000 * unread))
    return listening


def address(listening: socket.socket, *, here: bool = False) -> str:
    """Return the address with which all links to a service begin, or that for programs on this machine (`here`)."""
    host, port = listening.getsockname()[:2]
    if host in ("0.0.0.0", "::"):  # all networks: clients elsewhere need the name of this machine
        host = ("127.0.0.1" if host == "0.0.0.0" else "::1") if here else socket.gethostname()
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


@dataclass
class SimulatedSeats:
    """Simulated people and their pace.

    Attributes
    ----------
    people : mapping of str to SimulatedPerson
    pace : float
        Mean seconds between two actions of a person.
    observation : ObservationModel or None
        How their actions are seen; they are then in states of their own. After a restart these are the most probable.
    """

    people: Mapping[str, SimulatedPerson] = field(default_factory=dict)
    pace: float = 3.0
    observation: ObservationModel | None = None

    async def fill(self, service: Service, *, alone: bool) -> None:
        """Let simulated people act until they finish. Unless `alone`, start when a real person has connected."""
        if not alone:
            await service.visited.wait()
        await asyncio.gather(*(self._work(service, name, person) for name, person in self.people.items()))

    async def _work(self, service: Service, name: str, person: SimulatedPerson) -> None:
        while True:
            await asyncio.sleep(self.pace * float(person.rng.gamma(4.0, 0.25)))
            with suppress(Refusal, JournalError):  # try again
                event = await asyncio.to_thread(self._chosen, service.session, name, person)
                if event is None:
                    return
                try:
                    if not isinstance(event, Elapsed):
                        await service.report(event)
                except InapplicableError:
                    if event.instead is not None:
                        await service.report(event.instead)

    def _chosen(self, session: Session, name: str, person: SimulatedPerson) -> TeamEvent | None:
        """Let a simulated person answer or act; return the event, or None if they have reached their own goal.

        An action that the robot misses is an event of elapsed time.
        """
        with session.lock:  # tasks solved on demand are not thread-safe
            seen = session.person(name)
            person.hear(session.history.news(name))
            every, state = session.task_and_state(name)
            task, asked = person.pursued(every), seen.get("question")
            if person.state is None or (person.reported and not seen["steps"]):  # at first, or after the task has begun
                person.state, person.reported = state, None
            here = state if self.observation is None else person.state
            if task.is_goal([here])[0]:
                return None
            if asked is not None and not seen["paused"]:
                return Answered(person=name, answer=person.answer(every, asked["goal"]))
            suggestion = None if seen["paused"] else seen["suggestion"]
            if self.observation is None:
                return Acted(person=name, action=person.act(task, state, seen["applicable"], suggestion))
            action = person.act_unseen(task, suggestion, self.observation)
            return Elapsed() if action is None else Acted(person=name, action=action)


class _Server(uvicorn.Server):
    """Uvicorn's server, which leaves signals to this process and calls `ready` when it listens."""

    ready: Callable[[], None]

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave signals alone."""
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start to listen."""
        await super().startup(sockets)
        for listening in sockets or ():
            listening.listen(WAITING)  # asyncio takes the number of those that it accepts at once for this one, too
        if not self.should_exit:
            self.ready()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End the streams, which would go on forever, and then the service."""
        self.lifespan.state.get(END_STREAMS, lambda: None)()
        await super().shutdown(sockets)


def server_of(app: ASGIApp, ready: Callable[[], None]) -> uvicorn.Server:
    """Return the server of an application; it calls `ready` when it listens."""
    # No access log, since addresses of pages contain names. Open connections have two seconds to end at shutdown,
    # which has to be done within five.
    server = _Server(
        uvicorn.Config(
            app, log_config=None, access_log=False, lifespan="on", proxy_headers=False,
            server_header=False, timeout_graceful_shutdown=2, timeout_keep_alive=75, ws="none",
            backlog=connections.AT_ONCE, http=connections.protocol(connections.most()),
        )
    )  # fmt: skip
    server.ready = ready
    return server


@dataclass(frozen=True)
class ServedTeam:
    """The session to be served.

    Attributes
    ----------
    tasks : mapping of str to CostToGo or Goals
    folder : Path
        Folder of the session: its journal, and the secret of the links.
    people : mapping of str to str
        Initial people, with the names of their tasks. A resumed session has its own.
    policy : str or callable
        A team policy, as in `Assistant`.
    setting : LiveSetting
        Beliefs in simulated people are not kept.
    population : Population
        The robot's prior over people, from which simulated people are drawn too.
    distance : array, optional
        Distances between the stations of people, in their order, and the base, as in `Assistant`.
    simulated : sequence of str
        Names of the people who are simulated.
    public_url : str or None
        Public address of the service, as `public_address` returns it, if it differs from where the service listens.
    trusted_proxies : sequence of networks
        Proxies that report the client's address, as `networks` returns them.
    """

    tasks: Mapping[str, CostToGo | Goals]
    folder: Path
    people: Mapping[str, str]
    policy: str | TeamPolicy
    setting: LiveSetting
    population: Population
    distance: ArrayLike | None
    simulated: Sequence[str]
    public_url: str | None = None
    trusted_proxies: Networks = ()

    def session(self) -> Session:
        """Open the session. The initial people join a new session.

        Raises
        ------
        InputFileError, OSError
            As in `Session`.
        ValueError
            An invalid combination, such as a choice model and a task that is too large for it.
        """
        people = None
        if self.setting.people_store is not None:
            store = Path(self.setting.people_store)
            people = PeopleStore(store, self.setting.keep_people, except_for=self.simulated)
        session = Session(
            self.tasks, self.folder / JOURNAL, policy=self.policy, setting=self.setting,
            population=self.population, distance=self.distance, humans=len(self.people), people=people,
        )  # fmt: skip
        if not session.outlook().seq:
            for outcome in session.report_all([Joined(person=name, task=task) for name, task in self.people.items()]):
                if isinstance(outcome, Exception):
                    session.close()
                    raise outcome
        return session

    def seats(self) -> SimulatedSeats:
        """Draw the simulated people."""
        rule = self.setting.rule_of_people()
        people = {
            name: SimulatedPerson(self.population, trust=rule, seed=self.setting.seed + number)
            for number, name in enumerate(self.simulated)
        }
        return SimulatedSeats(people, self.setting.pace, self.setting.observation)


Ready = Callable[[AccessTokens, tuple[str, ...]], None]


Beside = Callable[[str], Bridge]
"""Returns a bridge, given the operator's link at an address of this machine."""


def serve(
    plan: ServedTeam, session: Session, listening: socket.socket, ready: Ready, beside: Beside | None = None,
    changed_settings: Callable[[], ReadAgain] | None = None,
) -> None:  # fmt: skip
    """Serve a session until a signal ends it.

    Parameters
    ----------
    plan : ServedTeam
    session : Session
        The plan's session.
    listening : socket
    ready : callable
        Called with the links and the people present when the service accepts requests.
    beside : callable, optional
        A bridge, which ends with the service. If it fails, the service continues.
    changed_settings : callable, optional
        As in `Service`. SIGHUP then reloads the configuration, instead of ending the service.
    """
    asyncio.run(_serve(plan, session, listening, ready, beside, changed_settings))


async def _serve(
    plan: ServedTeam, session: Session, listening: socket.socket, ready: Ready, beside: Beside | None,
    changed_settings: Callable[[], ReadAgain] | None,
) -> None:  # fmt: skip
    access = AccessTokens.kept(plan.folder / "secret", plan.public_url or address(listening))
    service = Service(session, access, texts=catalogue(plan.setting.language))
    service.simulated = frozenset(plan.simulated)
    app = make_app(service, trusted_proxies=plan.trusted_proxies)
    bridge = None if beside is None else beside(f"{address(listening, here=True)}/operator#{access.operator}")
    others = plan.seats().fill(service, alone=set(plan.simulated) >= set(service.session.people))
    if bridge is not None:
        service.bridges[bridge.name] = bridge
        others = _both(others, bridge)
    service.changed_settings = changed_settings
    reloads: set[asyncio.Task[None]] = set()

    def reload() -> None:
        task = asyncio.get_running_loop().create_task(_reload(service))
        reloads.add(task)  # the loop itself keeps no task alive
        task.add_done_callback(reloads.discard)

    await run(
        app, listening, lambda: ready(access, service.session.people), others,
        reload=None if changed_settings is None else reload,
    )  # fmt: skip


async def _reload(service: Service) -> None:
    """Reload the configuration; log the outcome, and nothing but that if it is faulty."""
    log = logging.getLogger(__name__)
    try:
        log.info("reloaded", extra={"changes": len((await service.reload()).events)})
    except Exception as error:  # noqa: BLE001 a faulty file is no reason to end
        log.error("the configuration is not reloaded: %s", error)


async def _both(seats: Coroutine[Any, Any, None], bridge: Bridge) -> None:
    async def logged() -> None:
        try:
            await bridge.run()
        except Exception:
            logging.getLogger(__name__).exception("the bridge has ended")

    await asyncio.gather(seats, logged())


async def run(
    app: ASGIApp, listening: socket.socket, ready: Callable[[], None], beside: Coroutine[Any, Any, None],
    *, ends: bool = False, reload: Callable[[], None] | None = None,
) -> int | None:  # fmt: skip
    """Serve an application until a signal ends it, and run a coroutine at the same time; return the signal's number.

    Parameters
    ----------
    app : ASGIApp
    listening : socket
    ready : callable
        Called when the service accepts requests.
    beside : coroutine
        Starts at once and may end first.
    ends : bool
        Whether the service ends with the coroutine.
    reload : callable, optional
        Called at SIGHUP, which otherwise ends the service.
    """
    connections.allow_files()
    # Warnings are about requests that are none, of which anybody can send as many as they want.
    logging.getLogger("uvicorn.error").setLevel(logging.ERROR)
    server = server_of(app, ready)
    loop = asyncio.get_running_loop()
    come: int | None = None

    def end(number: int) -> None:
        nonlocal come
        come, server.should_exit = number, True

    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            loop.add_signal_handler(number, end, number)
    if reload is not None:
        loop.add_signal_handler(signal.SIGHUP, reload)
    other = asyncio.create_task(beside)
    if ends:
        other.add_done_callback(lambda _: setattr(server, "should_exit", True))
    try:
        await server.serve([listening])
    finally:
        other.cancel()
        with suppress(asyncio.CancelledError):
            await other
    return come
