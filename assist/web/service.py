"""A live session as a service: one thread writes, and connected clients receive every change.

Reports from all connections enter a queue. The writer takes all waiting reports at once, so that they share one write
to the disk. Only then are they answered, and clients receive their new views. Views are computed once, by the writer;
requests for views never wait for the disk.

Watchers (`watchers`) are independent: a connection that ends late never ends another one.
"""

from __future__ import annotations

import asyncio
import json
import logging
import queue
import threading
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import chain, groupby
from typing import Any, ClassVar, Protocol

from ..declare.catalogue import Catalogue, catalogue
from ..declare.refusals import AbsentError, InapplicableError, Refusal
from ..live.event_base import Event, TeamEvent
from ..live.explanation import Explanation
from ..live.session import Outcome, Session
from ..live.store import JournalError
from ..live.views import Outlook, PersonView, RobotView
from .measures import Measures
from .schemas import Place
from .tokens import AccessTokens
from .watchers import Watcher, streamed

REPORTS = logging.getLogger(f"{__package__}.reports")
"""Log of all answered reports, without names of people, for which records could not be erased."""


WAITING = 5000
"""Largest number of queued reports; further ones are refused with status 503."""
BATCH = 256
"""Largest number of reports in one write to the disk. More would delay the first answer of a full batch."""


class Bridge(Protocol):
    """A connection between the service and another protocol, which works while the service runs."""

    @property
    def name(self) -> str:
        """The name of the protocol."""

    @property
    def counts(self) -> Mapping[str, int]:
        """The bridge's counts, such as those of messages, by name."""

    @property
    def connected(self) -> bool:
        """Whether the other side can be reached."""

    @property
    def waits(self) -> Sequence[str]:
        """What keeps the bridge from delivering reports that it has received, each as a sentence."""

    async def run(self) -> None:
        """Work until cancelled."""


@dataclass(frozen=True)
class ReadAgain:
    """What follows from a configuration that was read again.

    Attributes
    ----------
    events : list of TeamEvent
        By which the session follows it.
    restart : list of str
        Changed fields that need a restart.
    new_session : list of str
        Changed fields that need a new session: opened with them again, the present one would be refused.
    """

    events: list[TeamEvent]
    restart: list[str]
    new_session: list[str]


@dataclass(frozen=True)
class Erasure:
    """A request to erase what is recorded of a person; arguments as in `Session.erase`."""

    person: str
    reason: str


class Service:
    """A session with its writer and its watchers. Everything except the writer runs in one event loop.

    Parameters
    ----------
    session : Session
    access : AccessTokens
    connections : int
        Largest number of open connections for one person's view, such as those of several tabs.
    texts : Catalogue
        Texts of people's pages; default: English.
    ping : float
        Seconds between two signs of life in a stream. Clients count a connection as lost after 8/3 of it, 40 s.
    check : float
        Seconds between two looks at what keeps the service from its work.

    Attributes
    ----------
    bridges : dict of str to Bridge
        The bridges that work beside the service, by name.
    changed_settings : callable or None
        Reads the service's configuration again, and returns the events by which the session is to follow it.
    events : type
        The class of the events that can be reported.
    shown : mapping of str to type
        What their reporters get, by `Event.shows`.
    """

    events: ClassVar[type[Event]] = TeamEvent
    shown: ClassVar[Mapping[str, type[Any]]] = {"person": PersonView, "place": Place, "robot": RobotView}

    def __init__(
        self, session: Session, access: AccessTokens, *, connections: int = 64, texts: Catalogue | None = None,
        ping: float = 15.0, check: float = 1.0,
    ) -> None:  # fmt: skip
        self.texts = catalogue() if texts is None else texts
        self.ping, self._every = ping, check
        self._most_connections = connections
        self.session, self.access = session, access
        session.changed = self._seen
        self.views = {person: _json(self.session.person(person)) for person in self.session.people}
        for person in self.views:
            access.token(person)
        self.outlook = self.session.outlook()
        self.visited = asyncio.Event()
        self.simulated: frozenset[str] = frozenset()
        self.measures, self.bridges = Measures(), dict[str, Bridge]()
        self.changed_settings: Callable[[], ReadAgain] | None = None
        self._entries: dict[str, bytes] = {}
        self._outdated = Counter[str]()  # how often a person's entry has become outdated
        self._watchers: dict[str, set[Watcher]] = {}
        self._operators, self._followers = set[Watcher](), set[Watcher]()
        self._ending = False
        self._reports: queue.Queue[tuple[Event | Erasure, asyncio.Future[Outcome]] | None] = queue.Queue(WAITING)
        self._changes: dict[str, bytes | None] = {}
        self._writer: threading.Thread | None = None
        self._unanswered = set[asyncio.Future[Outcome]]()
        self._accepts = True  # until the writer ends
        self._late: str | None = None  # why it is not known what time has caused

    # Writing.

    def start(self) -> None:
        """Start the writer and the clock in the running event loop."""
        self._loop = asyncio.get_running_loop()
        self._writer = threading.Thread(target=self._write, name="writer", daemon=True)
        self._writer.start()
        self._ticking = self._loop.create_task(self._keep_time())
        self._checking = self._loop.create_task(self._check())

    def end_streams(self) -> None:
        """End all streams, and those that begin later."""
        self._ending = True
        for watcher in (*chain(*self._watchers.values()), *self._operators, *self._followers):
            watcher.end()

    async def stop(self) -> None:
        """Answer all queued reports, end all streams, and close the session."""
        self._ticking.cancel()
        self._checking.cancel()
        self.end_streams()
        if self._writer is not None:
            if self._accepts:
                await asyncio.to_thread(self._reports.put, None)
            await asyncio.to_thread(self._writer.join)
        self.session.close()

    def _write(self) -> None:
        try:
            while self._carry_out_queued():
                pass
        except BaseException:
            logging.getLogger(__name__).exception("no report is accepted any more; expected a restart")
        finally:
            with suppress(RuntimeError):  # the event loop has ended, and nobody waits
                self._loop.call_soon_threadsafe(self._end_reports)

    def _end_reports(self) -> None:
        """Refuse the reports that wait and those to come."""
        self._accepts = False
        with suppress(queue.Empty):
            while True:
                self._reports.get_nowait()
        for future in self._unanswered:
            if not future.done():
                future.set_exception(Refusal("ended"))

    def _carry_out_queued(self) -> bool:
        """Carry out what is queued, in the order of its arrival; return whether there will be more."""
        taken = [self._reports.get()]
        with suppress(queue.Empty):
            while len(taken) < BATCH:
                taken.append(self._reports.get_nowait())
        reports = [report for report in taken if report is not None]
        for erases, run in groupby(reports, key=lambda report: isinstance(report[0], Erasure)):
            some, futures = zip(*run, strict=True)
            work = self._erase_all if erases else self.session.report_all
            self._carry_out(partial(work, some), futures)
        return len(reports) == len(taken)

    def _erase_all(self, erasures: Sequence[Erasure]) -> list[Outcome]:
        outcomes = list[Outcome]()
        for erasure in erasures:
            try:
                outcomes.append(self.session.erase(erasure.person, erasure.reason).as_dict())
            except Exception as error:  # noqa: BLE001  as below
                outcomes.append(error)
        return outcomes

    def _carry_out(self, work: Callable[[], list[Outcome]], futures: Sequence[asyncio.Future[Outcome]]) -> None:
        """Change the session, and deliver the outcomes and the new views."""
        self._changes = {}
        try:
            outcomes = work()
        except Exception as error:  # noqa: BLE001  every error is passed to the clients that wait
            outcomes = [error] * len(futures)
        try:
            outlook: Outlook | None = self.session.outlook()
        except Exception:
            logging.getLogger(__name__).exception("the team's part of the operator's view is that of before")
            outlook = None
        self._loop.call_soon_threadsafe(self._deliver, futures, outcomes, dict(self._changes), outlook)

    def _seen(self, touched: set[str], followed: Sequence[bool]) -> None:
        """Update the views of people for whom something changed. The writer calls it after saving the events."""
        self.measures.answered(followed)
        for person in touched:
            try:
                self._changes[person] = _json(self.session.person(person))
            except AbsentError:
                self._changes[person] = None

    def _deliver(
        self, futures: Sequence[asyncio.Future[Outcome]], outcomes: list[Outcome], changes: dict[str, bytes | None],
        outlook: Outlook | None,
    ) -> None:  # fmt: skip
        outlook = outlook or self.outlook
        if outlook.fault not in (None, self.outlook.fault):
            logging.getLogger(__name__).warning("the policy: %s", outlook.fault)
        before, self.outlook = self.outlook, outlook
        for person, view in changes.items():
            self._outdate(person)
            if view is None:
                self.views.pop(person, None)
            else:
                self.views[person] = view
                self.access.token(person)
            for watcher in self._watchers.get(person, ()):
                if view is None:
                    watcher.end()
                else:
                    watcher.tell("view", streamed("view", view))
            for follower in self._followers:
                follower.tell(f"person {person}", _changed(person, view))
        for number, robot in enumerate(outlook.robots, start=1):
            if robot not in before.robots[number - 1 : number]:
                for follower in self._followers:
                    follower.tell(f"robot {number}", _instruction(number, robot))
        self._tell_operators()
        for future, outcome in zip(futures, outcomes, strict=True):
            if future.done():  # the client has disconnected
                continue
            if isinstance(outcome, Exception):
                future.set_exception(outcome)
            else:
                future.set_result(outcome)

    async def report(self, event: Event | Erasure) -> dict[str, Any]:
        """Record an event; return the new view of the person concerned, or what remains of an erased one.

        Raises
        ------
        Refusal
            Too many reports are queued, or none is accepted any more.
        Exception
            Any error of `Session.report` or `Session.erase`.
        """
        kind = event.kind if isinstance(event, Event) else "erased"
        began, outcome = self._loop.time(), "failed"
        try:
            answer = await self._queued(event)
            outcome = "recorded"
        except ValueError:
            outcome = "refused"
            raise
        finally:
            seconds = self._loop.time() - began
            self.measures.add(kind, outcome, seconds)
            REPORTS.info("report", extra={"event": kind, "outcome": outcome, "seconds": round(seconds, 6)})
        return answer

    async def _queued(self, event: Event | Erasure) -> dict[str, Any]:
        """Queue a report, and return its answer; errors as in `report`."""
        if not self._accepts:
            raise Refusal("ended")
        future: asyncio.Future[Any] = self._loop.create_future()
        self._unanswered.add(future)
        try:
            self._reports.put_nowait((event, future))
            answer: dict[str, Any] = await future
        except queue.Full:
            raise Refusal("busy", n=self._reports.maxsize) from None
        finally:
            self._unanswered.discard(future)
        return answer

    def unready(self) -> list[str]:
        """Return why the service is not ready to do all its work; empty if it is."""
        found = [f"{name} is not connected" for name, bridge in self.bridges.items() if not bridge.connected]
        if (fault := self.session.fault()) is not None:
            found.append(f"events cannot be saved: {fault}")
        if self._writer is None or not self._accepts:
            found.append("the service does not accept reports")
        if self._late is not None:
            found.append(f"what time causes is not known: {self._late}")
        return found

    async def reload(self) -> ReadAgain:
        """Read the configuration again, and change distances and people's tasks accordingly; return what it says.

        Raises
        ------
        InapplicableError
            There is no configuration to read.
        ValueError
            It is faulty, and nothing has changed.
        """
        if self.changed_settings is None:
            raise InapplicableError("other", why="there is nothing to reload; expected a service started with --config")
        found = await asyncio.to_thread(self.changed_settings)
        for event in found.events:
            await self.report(event)
        for needed, changed in (
            ("a restart", found.restart), ("a new session, in another folder,", found.new_session),
        ):  # fmt: skip
            if changed:
                said = "%s is needed for what else has changed: %s"
                logging.getLogger(__name__).warning(said, needed, ", ".join(changed))
        return found

    async def _keep_time(self) -> None:
        """Report what time causes. What cannot be saved now is tried again, if it is still due then."""
        pause = 0.0
        while True:
            await asyncio.sleep(min(self._every, max(0.01, pause)))
            try:
                events, later = await asyncio.to_thread(self.due)
            except Exception as error:
                if self._late is None:
                    logging.getLogger(__name__).exception("the clock: it is not known what is due")
                self._late, pause = str(error), self._every
                continue
            self._late, pause = None, 0.0 if events else later
            for event in events:
                try:
                    await self.report(event)
                except (Refusal, JournalError):  # the state changed, or the queue or the disk is full
                    pause = self._every
                except Exception:
                    logging.getLogger(__name__).exception("%s: the event of the clock failed", event.kind)
                    pause = self._every

    def due(self) -> tuple[list[Event], float]:
        """Return the events that time has caused by now, and the seconds until it causes the next one."""
        return self.session.due()

    def problems(self) -> list[str]:
        """Return everything that keeps events from being stored or delivered, for the operator."""
        return [*self.unready(), *chain(*(_waits(name, bridge) for name, bridge in self.bridges.items()))]

    def faults(self) -> list[str]:
        """Return what keeps people's actions from being saved, in the language of the pages; empty if nothing does."""
        fault = self.session.fault()
        return [] if fault is None else [self.texts("page.unsaved", why=fault)]

    async def _check(self) -> None:
        """Tell people and operators when what keeps the service from its work has changed."""
        before: tuple[list[str], list[str]] | None = None
        failed = False
        while True:
            try:
                now = self.problems(), self.faults()
            except Exception:
                if not failed:
                    logging.getLogger(__name__).exception("it is not known what keeps the service from its work")
                failed = True
            else:
                if before not in (None, now):
                    self._tell_operators()
                    for watcher in chain(*self._watchers.values()):
                        watcher.tell("faults", streamed("faults", _json(now[1])))
                before, failed = now, False
            await asyncio.sleep(self._every)

    # Watching.

    def view(self, person: str) -> bytes:
        """Return a person's view as JSON.

        Raises
        ------
        AbsentError
            The person is not present.
        """
        found = self.views.get(person)
        if found is None:
            raise AbsentError("unknown", person=repr(person[:80]))
        return found

    def heard(self, person: str | None) -> None:  # noqa: ARG002  a user study needs it
        """Note a request or a connection of a person, or of the operator (None)."""
        self.visited.set()

    def is_crowded(self, person: str) -> bool:
        """Whether no further connection for a person's view is accepted."""
        return len(self._watchers.get(person, ())) >= self._most_connections

    def _begun(self, watcher: Watcher, among: set[Watcher]) -> Watcher:
        among.add(watcher)
        if self._ending:
            watcher.end()
        return watcher

    def watch(self, person: str) -> Watcher:
        """Register a watcher of a person's view; errors as in `view`."""
        seen = self.view(person)
        watcher = self._begun(Watcher(), self._watchers.setdefault(person, set()))
        watcher.tell("faults", streamed("faults", _json(self.faults())))
        watcher.tell("view", streamed("view", seen))
        self._connected(person)
        return watcher

    def leave(self, person: str, watcher: Watcher) -> None:
        """Remove one watcher of a person's view."""
        watchers = self._watchers.get(person, set())
        watchers.discard(watcher)
        if not watchers:
            self._watchers.pop(person, None)
        self._connected(person)

    def _outdate(self, person: str) -> None:
        """Let the operator's next view compute a person's entry again, and discard one that is being computed."""
        self._entries.pop(person, None)
        self._outdated[person] += 1

    def _connected(self, person: str) -> None:
        self._outdate(person)
        self._tell_operators()

    def _tell_operators(self) -> None:
        for operator in self._operators:
            operator.tell("changed")

    def operator(self) -> Watcher:
        """Register an operator; the watcher is told of every change."""
        watcher = self._begun(Watcher(), self._operators)
        watcher.tell("changed")
        return watcher

    def operator_leaves(self, watcher: Watcher) -> None:
        """Remove an operator."""
        self._operators.discard(watcher)

    def follow(self) -> Watcher:
        """Register a program that follows the team; it is told who is present, and of each person and robot."""
        watcher = self._begun(Watcher(), self._followers)
        watcher.tell("people", streamed("people", _json({"people": list(self.views)})))
        for person, view in self.views.items():
            watcher.tell(f"person {person}", _changed(person, view))
        for number, robot in enumerate(self.outlook.robots, start=1):
            watcher.tell(f"robot {number}", _instruction(number, robot))
        return watcher

    def unfollow(self, watcher: Watcher) -> None:
        """Remove a program that followed the team."""
        self._followers.discard(watcher)

    @property
    def pause_between(self) -> float:
        """Seconds between two messages to the same operator, increasing with the size of the team."""
        return min(2.0, max(0.1, len(self.views) / 400))  # readable for small teams, cheap for large ones

    async def team(self) -> bytes:
        """Return the operator's view as JSON: all people, the robots and the latest events."""
        missing = {person: self._outdated[person] for person in self.views if person not in self._entries}
        found = await asyncio.to_thread(self._entries_of, list(missing)) if missing else {}
        for person, entry in found.items():
            if self._outdated[person] == missing[person]:
                self._entries[person] = entry
        rest = self.outlook.as_dict() | {"time": round(self.session.now(), 3), "tasks": list(self.session.tasks)}
        rest["problems"] = self.problems()
        entries = found | self._entries
        people = b",".join(entries[person] for person in self.views if person in entries)
        return _json(rest)[:-1] + b',"people":[' + people + b"]}"

    def explain(self, person: str, against: str | None = None) -> Explanation:
        """Return why a person has their suggestion, or none; with `against`, the step against another action.

        The session is locked only while the team's state is copied, not while the explanation is computed.

        Raises
        ------
        Refusal
            As in `Assistant.explain`.
        """
        later: Callable[[], Explanation] = self.session.see(lambda history: history.explain_later(person, against))
        return later()

    def _entries_of(self, people: list[str]) -> dict[str, bytes]:
        found = {}
        for person in people:
            with suppress(AbsentError):
                entry = self.session.entry(person)
                of_page = {"connected": person in self._watchers, "join": self.access.join_url(person)}
                found[person] = _json({"simulated": person in self.simulated} | entry | of_page)
        return found


def _waits(name: str, bridge: Bridge) -> Sequence[str]:
    """Return what keeps a bridge from delivering reports, or that this is not known."""
    try:
        return bridge.waits
    except Exception as error:  # noqa: BLE001  the service goes on without it
        return [f"{name}: it is not known what it waits for: {error or type(error).__name__}"]


def _changed(person: str, view: bytes | None) -> bytes:
    return streamed("left", _json({"person": person})) if view is None else streamed("view", view)


def _instruction(number: int, robot: RobotView) -> bytes:
    return streamed("robot", _json({"robot": number, "instruction": robot.as_dict()}))


def _json(document: Any) -> bytes:
    return json.dumps(document, separators=(",", ":")).encode()
